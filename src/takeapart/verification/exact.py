"""Pairs of geoms of the judge's model of which at least one is a part's mesh: by exact triangles.

MuJoCo takes the hull of every mesh, and a part is rarely convex. So in the model a part's mesh stands as the box around
it, which takes part in nothing; what stands near it and how near is found here.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from takeapart.model.geometry import BOX_TRIANGLES, Array, TriangleMesh
from takeapart.verification.robot import mujoco
from takeapart.verification.solids import Solid, hull_solid, solid_distance

ROUND = 48  # corners around a ball or a cylinder, which is replaced by what is around it (0.2 % of its radius at most)


class ExactPairs:
    """Distances between a part's mesh and any other geom.

    Args:
        meshes: number of the geom -> its surface, in the geom's frame.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, meshes: Mapping[int, Solid]) -> None:
        self._model, self._data = model, data
        self._solids = dict(meshes)
        self.geoms = frozenset(meshes)

    def distance(self, first: int, second: int) -> float:
        """Distance of two geoms where they stand now, m; negative where they are in each other."""
        solids = self.solid(first), self.solid(second)
        return solid_distance(solids[0], self.pose(first), solids[1], self.pose(second))

    def pose(self, geom: int) -> Array:
        """Pose (4, 4) of a geom in the world."""
        T = np.eye(4)
        T[:3, :3] = self._data.geom_xmat[geom].reshape(3, 3)
        T[:3, 3] = self._data.geom_xpos[geom]
        return T

    def solid(self, geom: int) -> Solid:
        """The body of a geom in its own frame: of the robot's meshes the hull, as MuJoCo has them."""
        if geom not in self._solids:
            self._solids[geom] = _solid_of(self._model, geom)
        return self._solids[geom]

    def near(
        self, moving: NDArray[np.intp], standing: NDArray[np.intp], sight: float
    ) -> tuple[NDArray[np.intp], Array]:
        """Pairs (k, 2) of one geom of each whose extents along the world's axes are closer than the sight, m, with a
        lower bound (k,), m, of their distance."""
        if not len(moving) or not len(standing):
            return np.empty((0, 2), dtype=np.intp), np.empty(0)
        (center, reach), (there, size) = self._extents(moving), self._extents(standing)
        gap = np.abs(center[:, None] - there) - reach[:, None] - size  # (moving, standing, 3) m
        apart = np.linalg.norm(np.maximum(gap, 0.0), axis=2)
        rows, columns = np.nonzero(apart < sight)
        return np.column_stack([moving[rows], standing[columns]]), apart[rows, columns]

    def _extents(self, geoms: NDArray[np.intp]) -> tuple[Array, Array]:
        """Middle and half extents (k, 3), m, of geoms along the world's axes."""
        R = self._data.geom_xmat[geoms].reshape(-1, 3, 3)
        middle, half = self._model.geom_aabb[geoms, :3], self._model.geom_aabb[geoms, 3:]
        return (
            np.einsum("kij,kj->ki", R, middle) + self._data.geom_xpos[geoms],
            np.einsum("kij,kj->ki", np.abs(R), half),
        )


def _solid_of(model: mujoco.MjModel, geom: int) -> Solid:
    kind, size = int(model.geom_type[geom]), np.asarray(model.geom_size[geom], dtype=float)
    shapes = mujoco.mjtGeom
    if kind == int(shapes.mjGEOM_MESH):
        first, count = (int(table[model.geom_dataid[geom]]) for table in (model.mesh_vertadr, model.mesh_vertnum))
        return hull_solid(np.asarray(model.mesh_vert[first : first + count], dtype=float))
    if kind == int(shapes.mjGEOM_BOX):
        corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * size
        return Solid(TriangleMesh(corners, BOX_TRIANGLES))
    turns = 2 * np.pi * np.arange(ROUND) / ROUND
    outwards = 1 / np.cos(np.pi / ROUND)
    circle = np.column_stack([np.cos(turns), np.sin(turns)]) * outwards
    if kind == int(shapes.mjGEOM_CYLINDER):
        rings = [(size[0], -size[1]), (size[0], size[1])]
    else:  # a ball, or a capsule: two half balls
        half = size[1] if kind == int(shapes.mjGEOM_CAPSULE) else 0.0
        heights = np.linspace(0.0, np.pi / 2, ROUND // 4 + 1)
        rings = [
            (size[0] * np.cos(h) * outwards, sign * (half + size[0] * np.sin(h) * outwards))
            for h in heights
            for sign in (-1.0, 1.0)
        ]
    points = np.vstack([np.column_stack([circle * radius, np.full(ROUND, z)]) for radius, z in rings])
    return hull_solid(np.unique(points.round(12), axis=0))


def around(solid: Solid) -> tuple[Array, Array]:
    """Middle and half extents (3,), m, of the box along the axes of a body's frame around it."""
    low, high = solid.bounds
    return (low + high) / 2, (high - low) / 2


def as_array(geoms: Sequence[int]) -> NDArray[np.intp]:
    """Numbers of geoms as an index."""
    return np.array(geoms, dtype=np.intp)
