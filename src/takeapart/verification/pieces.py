"""Convex pieces of a part, so that MuJoCo can let it stand: only where they are the part itself, to 0.1 mm.

What is not convex is cut by planes along its inner edges: of the planes through a few of the sharpest ones, always the
one after which the hulls of both halves hold the least that is not the part (approximate convex decomposition, Lien and
Amato: Approximate convex decomposition of polyhedra, 2007, with cuts through notches).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from takeapart.model.geometry import Array
from takeapart.verification.solids import Solid

TRUE_TO = 1e-4  # m; thickest piece that the hulls may hold beyond the part
MOST_PIECES = 48
MOST_TRIANGLES = 6000  # of a part that is cut
SAME_VOLUME = 1e-4  # relative; hulls of parts with more triangles may be so much larger
THINNEST = 1e-5  # m; what is thinner is left out
MOST_PLANES = 24  # that are tried for a cut
SHARP = 1e-3  # sine of an inner edge; smoother ones suggest no cut


def convex_pieces(solid: Solid) -> list[Array] | None:
    """Corners (N, 3), m, of convex pieces that make up a body; None where its surface is open, or where
    `MOST_PIECES` do not do."""
    if not solid.is_closed:
        return None
    done: list[Array] = []
    left = [solid.volume]
    while left:
        piece = left.pop()
        if _thickness(piece) <= THINNEST:
            continue
        if piece.num_tri() > MOST_TRIANGLES:
            if piece.hull().volume() - piece.volume() > SAME_VOLUME * piece.volume():
                return None
            done.append(np.asarray(piece.hull().to_mesh64().vert_properties[:, :3]))
            continue
        if _excess(piece) <= TRUE_TO:
            done.append(np.asarray(piece.hull().to_mesh64().vert_properties[:, :3]))
            continue
        halves = _cut(piece)
        if not halves or len(done) + len(left) + len(halves) > MOST_PIECES:
            return None
        left += halves
    return done


def _excess(piece: Any) -> float:
    """Thickness, m, of the thickest layer between a manifold and its hull."""
    return max((_thickness(part) for part in (piece.hull() - piece).decompose()), default=0.0)


def _thickness(piece: Any) -> float:
    """Twice the volume over the surface of a manifold, m."""
    area = piece.surface_area()
    return 2 * piece.volume() / area if area > 0 else 0.0


def _cut(piece: Any) -> list[Any]:
    """The two sides of a manifold along the best plane; their loose parts one by one. Empty where no plane cuts."""
    apart = piece.decompose()
    if len(apart) > 1 and all(part.volume() > 0 for part in apart):  # a void inside is no part
        return list(apart)
    best, found = math.inf, []  # the first cut through a ring gains nothing yet
    for normal, offset in _planes(piece):
        sides = [side for side in piece.split_by_plane(normal, offset) if _thickness(side) > THINNEST]
        if len(sides) == 2:
            left = sum(side.hull().volume() - side.volume() for side in sides)
            if left < best:
                best, found = left, sides
    return found


def _planes(piece: Any) -> list[tuple[tuple[float, float, float], float]]:
    """Planes (normal, offset) of the faces at the largest inner edges of a manifold, and halfway between them."""
    mesh = piece.to_mesh64()
    vertices, triangles = np.asarray(mesh.vert_properties[:, :3]), np.asarray(mesh.tri_verts, dtype=np.int64)
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    faces = np.tile(np.arange(len(triangles)), 3)
    there, back = edges[:, 0] * len(vertices) + edges[:, 1], edges[:, 1] * len(vertices) + edges[:, 0]
    order = np.argsort(there)
    other = faces[order[np.searchsorted(there[order], back)]]
    along = vertices[edges[:, 1]] - vertices[edges[:, 0]]
    turn = np.einsum("ei,ei->e", np.cross(normals[faces], normals[other]), along)  # negative at inner edges
    inner = np.nonzero((turn < -SHARP * np.linalg.norm(along, axis=1)) & (edges[:, 0] < edges[:, 1]))[0]
    planes: dict[tuple[float, ...], tuple[tuple[float, float, float], float]] = {}
    for edge in inner[np.argsort(turn[inner], kind="stable")]:
        first, second = normals[faces[edge]], normals[other[edge]]
        for normal in (first, second, first - second, first + second):
            length = float(np.linalg.norm(normal))
            if length > SHARP:
                x, y, z = (normal / length).tolist()
                plane = ((x, y, z), float(normal @ vertices[edges[edge, 0]]) / length)
                planes.setdefault(tuple(np.round([x, y, z, 100 * plane[1]], 3)), plane)
        if len(planes) >= MOST_PLANES:
            break
    return list(planes.values())
