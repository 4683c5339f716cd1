"""Surfaces of bodies as facets with their edges, and which facets of two bodies come near each other."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from takeapart.model.assembly import Assembly
from takeapart.model.geometry import BOX_TRIANGLES, Array, area_normals

Integers = NDArray[np.int64]

SAME_POINT = 1e-6  # m; corners as close as this are one
SMALLEST_AREA = 1e-14  # m^2; a smaller triangle has no normal


@dataclass(frozen=True, eq=False)
class Facets:
    """The surface of a body in the world.

    Args:
        vertices: (V, 3) m, every point once.
        triangles: (T, 3) numbers of vertices, counter-clockwise as seen from outside.
        normals: (T, 3) unit, outward.
    """

    vertices: Array
    triangles: Integers
    normals: Array

    @cached_property
    def corners(self) -> Array:
        """(T, 3, 3) m."""
        return np.asarray(self.vertices[self.triangles])

    @cached_property
    def bounds(self) -> Array:
        """(2, 3) m: least and greatest coordinates."""
        return np.array([self.corners.min(axis=(0, 1)), self.corners.max(axis=(0, 1))])

    @cached_property
    def across(self) -> Integers:
        """(T, 3) the triangle on the other side of each edge (edge k runs from corner k to the next); -1 for none."""
        T, count = len(self.triangles), len(self.vertices)
        ahead = self.triangles.ravel() * count + np.roll(self.triangles, -1, axis=1).ravel()
        back = np.roll(self.triangles, -1, axis=1).ravel() * count + self.triangles.ravel()
        order = np.argsort(ahead, kind="stable")
        at = np.minimum(np.searchsorted(ahead[order], back), 3 * T - 1)
        found = np.where(ahead[order][at] == back, order[at] // 3, -1)
        return np.asarray(found.reshape(T, 3))

    @cached_property
    def bend(self) -> Array:
        """(T, 3) rad: how far the surface turns at each edge, positive where it is convex; pi where it ends."""
        other = np.maximum(self.across, 0)
        edge = np.roll(self.corners, -1, axis=1) - self.corners
        turn = np.cross(self.normals[:, None], self.normals[other])
        sine = (turn * edge).sum(axis=-1) / np.maximum(np.linalg.norm(edge, axis=-1), 1e-300)
        cosine = (self.normals[:, None] * self.normals[other]).sum(axis=-1)
        return np.where(self.across < 0, np.pi, np.arctan2(sine, cosine))

    @cached_property
    def neighbours(self) -> tuple[Integers, Integers]:
        """Vertices that share an edge with each vertex: starts (V + 1,) and numbers of vertices."""
        a, b = self.triangles, np.roll(self.triangles, -1, axis=1)
        first, second = np.concatenate([a.ravel(), b.ravel()]), np.concatenate([b.ravel(), a.ravel()])
        order = np.argsort(first, kind="stable")
        return np.searchsorted(first[order], np.arange(len(self.vertices) + 1)), second[order]


def facets_of(corners: Array) -> Facets:
    """Facets of triangles (T, 3, 3), m; corners at one place are joined, triangles without area left out."""
    cross = area_normals(corners)
    area = np.linalg.norm(cross, axis=1)
    corners, cross, area = (values[area > 2 * SMALLEST_AREA] for values in (corners, cross, area))
    points = corners.reshape(-1, 3)
    _, first, number = np.unique(np.round(points / SAME_POINT), axis=0, return_index=True, return_inverse=True)
    return Facets(points[first], number.reshape(-1, 3).astype(np.int64), cross / area[:, None])


def body_facets(assembly: Assembly, i: int) -> Facets:
    """The surface of a part where it stands, with the connectors that it hosts."""
    part = assembly.parts[i]
    walls = [
        wall.moved(part.T_world_part).corners()[BOX_TRIANGLES]
        for connector in assembly.connectors
        if connector.host == part.name
        for wall in connector.walls
    ]
    return facets_of(np.concatenate([part.shape.surface().moved(part.T_world_part).corners, *walls]))


def near_pairs(first: Facets, second: Facets, reach: float) -> tuple[Integers, Integers]:
    """Numbers of the triangles of two bodies whose extents along the axes come within `reach`, m, of each other."""
    rows, columns = _close_to(first, second.bounds, reach), _close_to(second, first.bounds, reach)
    if not len(rows) or not len(columns):
        return rows[:0], columns[:0]
    upper, lower = _BoxTree.of(first.corners[rows]), _BoxTree.of(second.corners[columns])
    a, b = _meeting(upper, lower, reach)
    return rows[a], columns[b]


def _close_to(facets: Facets, bounds: Array, reach: float) -> Integers:
    low, high = facets.corners.min(axis=1), facets.corners.max(axis=1)
    return np.nonzero(((low <= bounds[1] + reach) & (high >= bounds[0] - reach)).all(axis=1))[0]


@dataclass(frozen=True, eq=False)
class _BoxTree:
    """Boxes along the axes around triangles; each level has twice as many as the one above it.

    Args:
        order: (2^L,) numbers of the triangles at the leaves; -1 where a leaf is empty.
        levels: from one box down to 2^L: lower and upper corners (2, N, 3).
    """

    order: Integers
    levels: tuple[Array, ...]

    @classmethod
    def of(cls, corners: Array) -> _BoxTree:
        """Tree over triangles (T, 3, 3) in the order of a curve through space; Morton, 1966."""
        low, high = corners.min(axis=1), corners.max(axis=1)
        middle = (low + high) / 2
        extent = np.maximum(np.ptp(middle, axis=0).max(), 1e-9)
        cells = ((middle - middle.min(axis=0)) / extent * 1023).astype(np.int64)
        code = np.zeros(len(cells), dtype=np.int64)
        for bit in range(10):
            for axis in range(3):
                code |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
        size = 1 << max(len(code) - 1, 0).bit_length()
        order = np.full(size, -1, dtype=np.int64)
        order[: len(code)] = np.argsort(code, kind="stable")
        box = np.stack([np.full((size, 3), np.inf), np.full((size, 3), -np.inf)])
        box[0, : len(code)], box[1, : len(code)] = low[order[: len(code)]], high[order[: len(code)]]
        levels = [box]
        while levels[-1].shape[1] > 1:
            box = levels[-1]
            levels.append(np.stack([np.minimum(box[0, ::2], box[0, 1::2]), np.maximum(box[1, ::2], box[1, 1::2])]))
        return cls(order, tuple(reversed(levels)))


def _meeting(first: _BoxTree, second: _BoxTree, reach: float) -> tuple[Integers, Integers]:
    """Pairs of leaves whose boxes come within `reach`: both trees are walked down level by level, all pairs at once."""
    a = b = np.zeros(1, dtype=np.int64)
    depth_a, depth_b = 0, 0
    while True:
        box_a, box_b = first.levels[depth_a], second.levels[depth_b]
        near = (box_a[0, a] <= box_b[1, b] + reach) & (box_b[0, b] <= box_a[1, a] + reach)
        keep = near.all(axis=1)
        a, b = a[keep], b[keep]
        down_a, down_b = depth_a + 1 < len(first.levels), depth_b + 1 < len(second.levels)
        if down_a:
            a, b, depth_a = np.concatenate([2 * a, 2 * a + 1]), np.concatenate([b, b]), depth_a + 1
        if down_b:
            a, b, depth_b = np.concatenate([a, a]), np.concatenate([2 * b, 2 * b + 1]), depth_b + 1
        if not down_a and not down_b:
            return first.order[a], second.order[b]
