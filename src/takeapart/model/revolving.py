"""Boxes around what is round about an axis: slices of discs and rings, each of a few boxes turned against each other.

Boxes along one frame follow a cylinder badly; turned about its axis, five of them stay within a tenth of its radius.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from takeapart.model.geometry import Array, OrientedBox, TriangleMesh
from takeapart.model.voxels import VoxelGrid

AS_WIDE = 1.03  # the two sides across an axis of what is round are as wide within this
MOST_BOXES = 48


@dataclass(frozen=True)
class _Slice:
    """A ring between two heights along the axis, m; a disc where the inner radius is 0."""

    low: float
    high: float
    inner: float
    outer: float

    def joined(self, other: _Slice) -> _Slice:
        return _Slice(self.low, other.high, min(self.inner, other.inner), max(self.outer, other.outer))

    def excess(self, parts: list[_Slice]) -> float:
        """How far it stands out of one of the slices that it is made of, m."""
        return max(max(self.outer - part.outer, part.inner - self.inner) for part in parts)


def revolved_cover(
    mesh: TriangleMesh, grid: VoxelGrid, distances: Array, near: float, error: float
) -> tuple[tuple[OrientedBox, ...], float] | None:
    """Boxes, in the part's frame, that hold a body that is round about an axis of its grid, and how far they stand out.

    Args:
        distances: (X, Y, Z) m, from the cells of the grid to the nearest filled one.
        near: m; no slice holds a cell farther from the body.
        error: m; no box stands farther out of its slice.

    Returns:
        None where the body is not round, or too many boxes were needed. Else the boxes, and the distance, m, of their
        farthest point from the nearest filled cell.
    """
    spans = np.array([p[-1] - p[0] for p in grid.planes])
    for axis in np.argsort(-spans, kind="stable").tolist():
        u, v = (axis + 1) % 3, (axis + 2) % 3
        if max(spans[u], spans[v]) > AS_WIDE * min(spans[u], spans[v]):
            continue
        layers = _layers(mesh, grid, axis)
        if max(layer.outer for layer in layers) > AS_WIDE * max(spans[u], spans[v]) / 2:
            continue
        slices = _merged(layers, error, near)
        farthest = _farthest(grid, distances, axis, slices)
        counts = [_count(each, error) for each in slices]
        if farthest > near or sum(counts) > MOST_BOXES:
            continue
        boxes = [box for each, count in zip(slices, counts, strict=True) for box in _boxes(each, count, axis)]
        out = max(_standing_out(each, count) for each, count in zip(slices, counts, strict=True))
        return tuple(box.moved(grid.T_part_grid) for box in boxes), farthest + out
    return None


def _layers(mesh: TriangleMesh, grid: VoxelGrid, axis: int) -> list[_Slice]:
    """A slice for each layer of cells: as wide as the surface in it, with the bore that its filled cells leave."""
    planes = grid.planes[axis]
    T = grid.T_part_grid
    corners = ((mesh.vertices - T[:3, 3]) @ T[:3, :3])[mesh.triangles]
    heights = corners[:, :, axis].reshape(-1)
    across = np.delete(corners, axis, axis=2).reshape(-1, 2)
    radii = np.hypot(*across.T)
    outer = np.zeros(len(planes) - 1)
    for side in (-1.0, 1.0):  # corners on a plane are in both layers
        layer = np.clip(np.searchsorted(planes, heights + side * 2 * grid.rounding, "right") - 1, 0, len(outer) - 1)
        np.maximum.at(outer, layer, radii)
    ends = np.roll(np.arange(len(heights)).reshape(-1, 3), -1, axis=1).reshape(-1)
    for k, plane in enumerate(planes[1:-1].tolist()):
        cut = np.nonzero((heights - plane) * (heights[ends] - plane) < 0)[0]
        if len(cut):
            share = (plane - heights[cut]) / (heights[ends[cut]] - heights[cut])
            most = float(np.hypot(*(across[cut] + share[:, None] * (across[ends[cut]] - across[cut])).T).max())
            outer[k : k + 2] = np.maximum(outer[k : k + 2], most)
    filled = np.moveaxis(grid.filled, axis, 0)
    nearest = [
        np.maximum(0.0, np.maximum(grid.planes[a][:-1], -grid.planes[a][1:])) for a in range(3) if a != axis
    ]  # m, from the axis to each cell
    distance = np.hypot(nearest[0][:, None], nearest[1][None, :])
    inner = np.where(filled, distance, math.inf).min(axis=(1, 2))
    return [
        _Slice(float(planes[k]), float(planes[k + 1]), float(min(inner[k], outer[k])), float(outer[k]))
        for k in range(len(outer))
    ]


def _merged(layers: list[_Slice], error: float, bore: float) -> list[_Slice]:
    """Neighbouring slices joined, those first that differ least, as long as none stands out by more than an error, m.
    Bores of a smaller radius are filled."""
    filled = [replace(layer, inner=0.0) if layer.inner <= bore else layer for layer in layers if layer.outer > 0]
    groups, slices = [[layer] for layer in filled], list(filled)
    while len(slices) > 1:
        excess = [slices[k].joined(slices[k + 1]).excess(groups[k] + groups[k + 1]) for k in range(len(slices) - 1)]
        k = int(np.argmin(excess))
        if excess[k] > error:
            break
        slices[k : k + 2] = [slices[k].joined(slices[k + 1])]
        groups[k : k + 2] = [groups[k] + groups[k + 1]]
    return slices


def _farthest(grid: VoxelGrid, distances: Array, axis: int, slices: list[_Slice]) -> float:
    """Greatest distance of a cell in the slices from the nearest filled one, m."""
    middles = [grid.middles(a) for a in range(3)]
    radii = np.hypot(*np.meshgrid(*(middles[a] for a in range(3) if a != axis), indexing="ij"))
    moved = np.moveaxis(distances, axis, 0)
    farthest = 0.0
    for each in slices:
        chosen = moved[(middles[axis] > each.low) & (middles[axis] < each.high)]
        held = (radii >= each.inner) & (radii <= each.outer)
        farthest = max(farthest, float(chosen[:, held].max(initial=0.0)))
    return farthest


def _count(each: _Slice, error: float) -> int:
    """Boxes of a slice that stand out of it by no more than an error, m."""
    return next((n for n in range(3, MOST_BOXES) if _standing_out(each, n) <= error), MOST_BOXES)


def _standing_out(each: _Slice, count: int) -> float:
    """How far boxes of a slice stand out of it, m."""
    angle = math.pi / count if each.inner else math.pi / (2 * count)
    return max(each.outer * (math.hypot(1, math.sin(angle)) - 1), each.inner * (1 - math.cos(angle)))


def _boxes(each: _Slice, count: int, axis: int) -> Iterator[OrientedBox]:
    """Boxes in the grid's frame: across a disc, or along the wall of a ring."""
    half_angle = math.pi / count if each.inner else math.pi / (2 * count)
    start = each.inner * math.cos(half_angle) if each.inner else -each.outer
    half = np.zeros(3)
    u, v = (axis + 1) % 3, (axis + 2) % 3
    half[axis] = (each.high - each.low) / 2
    half[u], half[v] = (each.outer - start) / 2, each.outer * math.sin(half_angle)
    for k in range(count):
        angle = 2 * half_angle * k
        T = np.zeros((4, 4))
        T[axis, axis] = T[3, 3] = 1.0
        T[u, u], T[v, u], T[u, v], T[v, v] = math.cos(angle), math.sin(angle), -math.sin(angle), math.cos(angle)
        T[:3, 3] = (start + each.outer) / 2 * T[:3, u]
        T[axis, 3] = (each.high + each.low) / 2
        yield OrientedBox(T, half + 1e-9)
