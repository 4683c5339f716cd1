"""Surfaces of parts as they are drawn: smooth where they curve, sharp at edges, simpler where there is too much.

Whoever draws takes them from here, so that a part looks the same in pictures, viewer and page. Nothing but pictures is
made of them: what is planned and verified is the shape itself.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Array
from takeapart.model.meshes import Mesh as PartMesh
from takeapart.show.robot import PLAIN, simplified

MOST_DRAWN = 60_000  # triangles of one shape; one that has more is drawn with fewer
MOST_TOGETHER = 400_000  # triangles of all shapes of a product
CREASE = math.radians(40)  # edges sharper than this stay sharp
MOST_AROUND = (
    256  # triangles at one corner: more are the middle of a disc or the tip of a cone, and nothing is smooth there
)
NORMAL_STEPS = 127  # of a normal's coordinates, from 0 to 1
FINEST_CELL, COARSEST_CELL = 1e-5, 0.125  # of the longest edge: of the grid in whose cells corners become one
SLIVER = 1e-5  # height of a triangle by its longest edge; below, rounding decides where it faces
TRIALS = 14  # of cells between these


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles to be drawn, in the part's frame. A corner at a sharp edge is there once for each side of it.

    Args:
        vertices: (V, 3) float32, m.
        normals: (V, 3) float32, unit vectors that point outwards.
        faces: (F, 3) int32, anticlockwise seen from outside.
        triangles: of the shape; more than F where it is drawn with fewer.
    """

    vertices: NDArray[np.float32]
    normals: NDArray[np.float32]
    faces: NDArray[np.int32]
    triangles: int

    @property
    def is_simplified(self) -> bool:
        """Whether fewer triangles are drawn than the shape has."""
        return len(self.faces) < self.triangles


def surfaces_of(assembly: Assembly) -> dict[str, Surface]:
    """What is drawn of the parts that are meshes, by the hash of their shape: equal shapes once."""
    shapes = {part.shape.hash: part.shape for part in assembly.parts if isinstance(part.shape, PartMesh)}
    most = most_drawn({name: len(shape.triangle_mesh.triangles) for name, shape in shapes.items()})
    return {
        name: drawn_surface(shape.triangle_mesh.vertices, shape.triangle_mesh.triangles, most)
        for name, shape in shapes.items()
    }


def most_drawn(triangles: Mapping[str, int]) -> int:
    """Triangles that one shape may have in a picture, so that neither it nor all together have too many.

    Args:
        triangles: of every shape.
    """
    most, left, ascending = MOST_DRAWN, MOST_TOGETHER, sorted(triangles.values())
    for number, count in enumerate(ascending):
        share = left // (len(ascending) - number)
        if count > share:  # this one and all that have more
            return min(most, share)
        left -= count
    return most


def drawn_surface(vertices: Array, faces: NDArray[np.int32], most: int = MOST_DRAWN) -> Surface:
    """A surface of at most so many triangles, with normals."""
    kept_vertices, kept_faces = (vertices, faces) if len(faces) <= most else fewer(vertices, faces, most)
    return Surface(*creased(kept_vertices, kept_faces), len(faces))


def fewer(vertices: Array, faces: NDArray[np.int32], most: int) -> tuple[Array, NDArray[np.int32]]:
    """The same surface with at most so many triangles, and as much detail as that allows: corners in one cell of a
    grid become one, and the cells are as small as may be."""
    low, high = np.array([FINEST_CELL, COARSEST_CELL]) * np.ptp(vertices, axis=0).max()
    best = simplified(vertices, faces, PLAIN, high)
    for _ in range(TRIALS):
        cell = math.sqrt(low * high)
        found = simplified(vertices, faces, PLAIN, cell)
        if len(found.faces) > most:
            low = cell
        else:
            high, best = cell, found
    return best.vertices.astype(float), best.faces


def creased(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], angle: float = CREASE
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
    """Vertices (V, 3), m, normals (V, 3) and faces (F, 3) of a surface with sharp edges.

    The normal of a triangle's corner is the mean over the triangles that meet there and turn from it by at most the
    angle, weighted by their angles at the corner (Thürmer and Wüthrich 1998). Corners with one place and one normal are
    one vertex.

    Args:
        angle: rad.
    """
    places, owner = np.unique(np.asarray(vertices, dtype=float), axis=0, return_inverse=True)
    joined = owner.ravel()[faces]  # one place is one vertex, whoever wrote the mesh
    corners = places[joined]
    flat, weights = _flat_normals(corners), _angles(corners).ravel()
    empty = np.logical_not(flat.any(axis=1))  # triangles without area turn from nothing, and count for nothing
    weights[np.repeat(empty, 3)] = 0.0
    place = joined.ravel()
    of_face = np.repeat(np.arange(len(joined)), 3)
    order = np.argsort(place, kind="stable")
    count = np.bincount(place, minlength=len(places))
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    around = np.where(count > MOST_AROUND, 0, count)[place]  # of every corner, the corners at its place
    one = np.repeat(np.arange(len(place)), around)
    within = np.arange(len(one)) - np.repeat(np.cumsum(around) - around, around)
    other = order[first[place[one]] + within]
    alike = np.einsum("ij,ij->i", flat[of_face[one]], flat[of_face[other]]) >= math.cos(angle)
    near = np.logical_or(alike, empty[of_face[one]])
    one, other = one[near], other[near]
    share = flat[of_face[other]] * weights[other, None]
    sums = np.column_stack([np.bincount(one, weights=share[:, k], minlength=len(place)) for k in range(3)])
    smooth = np.linalg.norm(sums, axis=1, keepdims=True) > 1e-9
    chosen = _unit(np.where(smooth, sums, flat[of_face]))
    chosen[~chosen.any(axis=1)] = (0.0, 0.0, 1.0)
    steps = np.round(chosen * NORMAL_STEPS).astype(np.int64)
    width = 2 * NORMAL_STEPS + 1
    key = ((place * width + steps[:, 0] + NORMAL_STEPS) * width + steps[:, 1] + NORMAL_STEPS) * width + steps[:, 2]
    _, kept, number = np.unique(key, return_index=True, return_inverse=True)
    return (
        places[place[kept]].astype(np.float32),
        _unit(steps[kept].astype(float)).astype(np.float32),
        number.reshape(-1, 3).astype(np.int32),
    )


def _flat_normals(corners: Array) -> Array:
    """Unit normals (F, 3) of triangles (F, 3, 3); of one without area, zero."""
    edges = corners - np.roll(corners, 1, axis=1)
    normals = np.cross(edges[:, 1], edges[:, 2])
    longest = np.linalg.norm(edges, axis=2).max(axis=1)
    normals[np.linalg.norm(normals, axis=1) < SLIVER * longest**2] = 0.0
    return _unit(normals)


def _angles(corners: Array) -> Array:
    """Angles (F, 3), rad, of triangles at their corners."""
    found = []
    for k in range(3):
        a, b = _unit(corners[:, k - 2] - corners[:, k]), _unit(corners[:, k - 1] - corners[:, k])
        found.append(np.arccos(np.einsum("ij,ij->i", a, b).clip(-1, 1)))
    return np.column_stack(found)


def _unit(vectors: Array) -> Array:
    """Vectors (N, 3) of length 1; zero stays zero."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0, length, 1.0))
