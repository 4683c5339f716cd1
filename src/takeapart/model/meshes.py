"""Parts of any form: triangle meshes.

A `Mesh` answers what every shape answers. Equal shapes are one object: whoever reads a product shares them by `hash`,
so that fields, covers and grasps are worked out once for all screws.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from takeapart.model.bounding import tight_box
from takeapart.model.covering import box_cover
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, OrientedBox, TriangleMesh

MOST_TRIANGLES = 200_000  # of one shape
SMALLEST_EXTENT = 1e-4  # m, of the longest edge of a mesh's bounds
LONGEST_EXTENT = 100.0  # m


@dataclass(frozen=True, eq=False)
class Mesh:
    """A shape given by its surface, in the part's frame.

    Args:
        triangle_mesh: the surface; it should be closed. What is open is marked (`is_closed`), and who needs a closed
            one says so.

    Raises:
        InputError: numbers that are not finite, corners that do not exist, no triangles, too many, or no extent.
    """

    triangle_mesh: TriangleMesh

    def __post_init__(self) -> None:
        vertices, triangles = self.triangle_mesh.vertices, self.triangle_mesh.triangles
        if not len(triangles):
            raise InputError("the mesh has no triangles; at least four are needed", "mesh")
        if len(triangles) > MOST_TRIANGLES:
            raise InputError(f"{len(triangles)} triangles; at most {MOST_TRIANGLES} are allowed in one shape", "mesh")
        if not np.isfinite(vertices).all():
            raise InputError("the mesh has a corner that is not finite", "mesh")
        if triangles.min() < 0 or triangles.max() >= len(vertices):
            raise InputError(f"a triangle names corner {int(triangles.max())} of {len(vertices)}", "mesh")
        extent = float(np.ptp(vertices[triangles.ravel()], axis=0).max())
        if not SMALLEST_EXTENT <= extent <= LONGEST_EXTENT:
            raise InputError(
                f"the mesh is {extent:.4g} m long; {SMALLEST_EXTENT:g} to {LONGEST_EXTENT:g} m is valid; "
                "are the units metres?",
                "mesh",
            )

    @cached_property
    def hash(self) -> str:
        """SHA-256 of corners and triangles."""
        mesh = self.triangle_mesh
        content = np.ascontiguousarray(mesh.vertices, "<f8").tobytes()
        return hashlib.sha256(content + np.ascontiguousarray(mesh.triangles, "<i4").tobytes()).hexdigest()

    @cached_property
    def is_closed(self) -> bool:
        """Whether every edge joins exactly two triangles that run along it in opposite directions."""
        triangles = self.triangle_mesh.triangles.astype(np.int64)
        edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
        count = len(self.triangle_mesh.vertices)
        there, back = edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0]
        return len(np.unique(there)) == len(there) and bool(np.array_equal(np.sort(there), np.sort(back)))

    @cached_property
    def _cover(self) -> tuple[OrientedBox, ...]:
        return box_cover(self.triangle_mesh)

    def boxes(self) -> tuple[OrientedBox, ...]:
        return self._cover

    @cached_property
    def _bounding_box(self) -> OrientedBox:
        return tight_box(self.triangle_mesh)

    def bounding_box(self) -> OrientedBox:
        return self._bounding_box

    def surface(self) -> TriangleMesh:
        return self.triangle_mesh

    @cached_property
    def _volume(self) -> float:
        a, b, c = np.moveaxis(self.triangle_mesh.corners - self.triangle_mesh.corners[0, 0], 1, 0)
        return abs(float(np.einsum("ni,ni->n", a, np.cross(b, c)).sum()) / 6)

    def volume(self) -> float:
        return self._volume

    @cached_property
    def _center_of_mass(self) -> Array:
        """(3,) m, of the enclosed volume; the middle of the surface where the mesh encloses none."""
        corners = self.triangle_mesh.corners
        origin = corners[0, 0]
        a, b, c = np.moveaxis(corners - origin, 1, 0)
        volumes = np.einsum("ni,ni->n", a, np.cross(b, c)) / 6
        if not self.is_closed or abs(volumes.sum()) < 1e-18:
            areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
            return np.asarray(origin + ((a + b + c) / 3 * areas[:, None]).sum(axis=0) / areas.sum())
        return np.asarray(origin + ((a + b + c) / 4 * volumes[:, None]).sum(axis=0) / volumes.sum())

    def center_of_mass(self) -> Array:
        return self._center_of_mass
