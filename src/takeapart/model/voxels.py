"""Which cells of a grid a body touches: every cell that any point of it is in, surface and interior.

The grid stands in a frame of its own and is not even: the planes of flat faces along its axes are planes of the grid,
so that what is made of boxes is told exactly.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from takeapart.model.geometry import Array, OrientedBox, TriangleMesh, area_normals

Cells = NDArray[np.bool_]
Integers = NDArray[np.int64]

ROUNDING = 1e-6  # of the longest edge; what reaches less far into a cell is not in it
FLAT_SHARE = 2e-3  # of a side's area; flat faces as large get a plane of their own
MOST_PLANES = 24  # of flat faces along an axis, besides the two ends
LEAST_CELL = 0.3  # of the wanted edge; planes closer than this are not both wanted
MOST_PAIRS = 4_000_000  # of triangles and cells, looked at at once
CLEAR_MAJORITY = 0.9  # of the cells of a pocket that a closed surface agrees on
RAY_OFFSET = (0.1371, 0.2719)  # of a cell; rays through cells avoid edges


@dataclass(frozen=True, eq=False)
class VoxelGrid:
    """A body in the cells of a grid.

    Args:
        T_part_grid: (4, 4) pose of the grid's frame in the part's.
        planes: along each axis, ascending, m; cells lie between them.
        filled: (X, Y, Z) cells that hold any point of the body.
        rounding: m; the body may reach this far into cells that are not filled.
    """

    T_part_grid: Array
    planes: tuple[Array, Array, Array]
    filled: Cells
    rounding: float

    def middles(self, axis: int) -> Array:
        """Middles of the cells along an axis, m."""
        return np.asarray((self.planes[axis][1:] + self.planes[axis][:-1]) / 2)


def voxel_grid(mesh: TriangleMesh, box: OrientedBox, cell: float) -> VoxelGrid:
    """The cells of a grid in the frame of a box that the body inside a surface touches.

    Where the surface is open, its inside is what most of six rays along the axes take for it.

    Args:
        box: that holds the surface, in the part's frame.
        cell: longest edge of a cell, m.
    """
    R, origin = box.T_frame_box[:3, :3], box.T_frame_box[:3, 3]
    corners = ((mesh.vertices - origin) @ R)[mesh.triangles]  # (T, 3, 3)
    rounding = ROUNDING * float(2 * box.half_extents.max())
    normals = area_normals(corners)  # twice the area long
    x, y, z = (_planes(corners, normals, box.half_extents, axis, cell, rounding) for axis in range(3))
    planes = (x, y, z)
    surface = _touched(corners, normals, planes, rounding)
    filled = surface | _inside(corners, normals, planes, surface)
    return VoxelGrid(box.T_frame_box, planes, filled, rounding)


def _planes(corners: Array, normals: Array, half: Array, axis: int, cell: float, rounding: float) -> Array:
    """Planes of the grid along one axis: its ends, large flat faces, and what is needed between them."""
    low, high = -float(half[axis]), float(half[axis])
    if high - low <= 4 * rounding:  # a sheet
        return np.array([low - 2 * rounding, high + 2 * rounding])
    heights = corners[:, :, axis]
    flat = np.ptp(heights, axis=1) <= rounding
    areas = np.abs(normals[flat, axis]) / 2
    places = np.round(heights[flat].mean(axis=1) / (4 * rounding)).astype(np.int64)
    unique, member = np.unique(places, return_inverse=True)
    weights = np.bincount(member, areas, len(unique))
    means = np.bincount(member, heights[flat].mean(axis=1) * areas, len(unique)) / np.maximum(weights, 1e-300)
    side = 4 * float(half[(axis + 1) % 3] * half[(axis + 2) % 3])
    chosen = [low, high]
    for k in np.argsort(-weights, kind="stable")[:MOST_PLANES].tolist():
        if weights[k] < FLAT_SHARE * side:
            break
        if min(abs(float(means[k]) - other) for other in chosen) > LEAST_CELL * cell:
            chosen.append(float(means[k]))
    chosen.sort()
    between = [np.linspace(a, b, max(1, int(np.ceil((b - a) / cell - 1e-6))) + 1)[:-1] for a, b in pairwise(chosen)]
    return np.concatenate([*between, [high]])


def _pairs(first: Integers, last: Integers) -> Iterator[tuple[Integers, Integers, Integers]]:
    """Numbers (K,) of triangles, and of two coordinates of every cell between corner cells (T, 2); piece by piece."""
    counts = np.maximum(last - first + 1, 0)
    total = counts.prod(axis=1)
    ends = np.cumsum(total)
    start = 0
    while start < len(total):
        done = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, done + MOST_PAIRS, "right")))
        triangle = np.repeat(np.arange(start, stop), total[start:stop])
        within = np.arange(len(triangle)) - np.repeat(ends[start:stop] - total[start:stop] - done, total[start:stop])
        rows = counts[triangle, 1]
        yield triangle, first[triangle, 0] + within // rows, first[triangle, 1] + within % rows
        start = stop


def _cell_range(low: Array, high: Array, planes: Array, rounding: float) -> tuple[Integers, Integers]:
    """First and last cells that intervals reach into; the last is before the first where one lies in a plane."""
    first = np.searchsorted(planes, low + rounding, "right") - 1
    last = np.searchsorted(planes, high - rounding, "left") - 1
    return np.clip(first, 0, len(planes) - 2), np.clip(last, 0, len(planes) - 2)


def _touched(corners: Array, normals: Array, planes: tuple[Array, Array, Array], rounding: float) -> Cells:
    """Cells (X, Y, Z) that triangles reach into. A triangle in a plane between cells is in those behind it."""
    touched = np.zeros([len(p) - 1 for p in planes], dtype=np.bool_)
    dominant = np.argmax(np.abs(normals), axis=1)
    for k in range(3):
        some = dominant == k
        if some.any():
            _touch(corners[some], normals[some], planes, rounding, k, touched)
    return touched


def _touch(
    corners: Array, normals: Array, planes: tuple[Array, Array, Array], rounding: float, k: int, touched: Cells
) -> None:
    """Marks the cells of triangles whose normals are steepest along axis k: column by column."""
    u, v = [axis for axis in range(3) if axis != k]
    low, high = corners.min(axis=1), corners.max(axis=1)
    first_u, last_u = _cell_range(low[:, u], high[:, u], planes[u], rounding)
    first_v, last_v = _cell_range(low[:, v], high[:, v], planes[v], rounding)
    first, last = np.column_stack([first_u, first_v]), np.column_stack([last_u, last_v])
    last = np.maximum(first, last)
    middle_u, middle_v = (planes[u][1:] + planes[u][:-1]) / 2, (planes[v][1:] + planes[v][:-1]) / 2
    half_u, half_v = np.diff(planes[u]) / 2, np.diff(planes[v]) / 2
    steep = np.where(np.abs(normals[:, k]) > 0, normals[:, k], 1.0)
    slopes = -normals[:, [u, v]] / steep[:, None]  # of the plane's height along k
    turn = np.where(normals[:, k] * (1 if (u, v) in ((1, 2), (0, 1)) else -1) < 0, -1.0, 1.0)
    for t, i, j in _pairs(first, last):
        du, dv = middle_u[i] - corners[t, 0, u], middle_v[j] - corners[t, 0, v]
        meets = np.ones(len(t), dtype=np.bool_)
        for edge in range(3):
            a, b = corners[:, edge], corners[:, (edge + 1) % 3]
            n_u, n_v = (b[:, v] - a[:, v]) * turn, (a[:, u] - b[:, u]) * turn  # outward, in the projection
            length = np.hypot(n_u, n_v)
            offset = n_u * (a[:, u] - corners[:, 0, u]) + n_v * (a[:, v] - corners[:, 0, v])
            inner = n_u[t] * du + n_v[t] * dv - np.abs(n_u[t]) * half_u[i] - np.abs(n_v[t]) * half_v[j]
            meets &= inner <= (offset - rounding * length)[t] + (length <= rounding)[t]
        t, i, j, du, dv = t[meets], i[meets], j[meets], du[meets], dv[meets]
        height = corners[t, 0, k] + slopes[t, 0] * du + slopes[t, 1] * dv
        spread = np.abs(slopes[t, 0]) * half_u[i] + np.abs(slopes[t, 1]) * half_v[j]
        bottom = np.clip(height - spread, low[t, k], high[t, k])
        top = np.clip(height + spread, low[t, k], high[t, k])
        lowest, highest = _cell_range(bottom, top, planes[k], rounding)
        in_plane = lowest > highest
        behind = np.where(normals[t, k] > 0, highest, lowest)
        lowest, highest = np.where(in_plane, behind, lowest), np.where(in_plane, behind, highest)
        while len(lowest):
            at: list[Integers] = [i, j]
            at.insert(k, lowest)
            touched[at[0], at[1], at[2]] = True
            more = lowest < highest
            i, j, lowest, highest = i[more], j[more], lowest[more] + 1, highest[more]


def _inside(corners: Array, normals: Array, planes: tuple[Array, Array, Array], surface: Cells) -> Cells:
    """Cells (X, Y, Z) of the interior among those that the surface does not touch.

    Rays along the axes vote. Where a pocket's cells agree, as in a closed surface, the majority decides for all of
    them, else each for itself.
    """
    from scipy.ndimage import label

    votes = np.zeros(surface.shape, dtype=np.int8)
    outward = 1 if np.einsum("ti,ti->", corners.mean(axis=1), normals) >= 0 else -1
    for k in range(3):
        crossings = outward * _crossings(corners, normals, planes, k)
        below = np.cumsum(crossings, axis=k, dtype=np.int16)
        above = np.take(below, [-1], axis=k) - below
        cells = tuple(slice(0, -1) if axis == k else slice(None) for axis in range(3))
        votes += (below[cells] > 0).astype(np.int8) + (above[cells] < 0).astype(np.int8)
    pockets, count = label(~surface)
    sizes = np.bincount(pockets.ravel(), minlength=count + 1)
    agreed = np.bincount(pockets.ravel(), votes.ravel(), count + 1) / (6 * np.maximum(sizes, 1))
    clear = (agreed >= CLEAR_MAJORITY) | (agreed <= 1 - CLEAR_MAJORITY)
    found = np.where(clear[pockets], (agreed > 0.5)[pockets], votes >= 3)
    return np.asarray(found & ~surface)


def _crossings(corners: Array, normals: Array, planes: tuple[Array, Array, Array], k: int) -> NDArray[np.int16]:
    """Signed crossings of rays along axis k through the middles of cells: 1 where they enter a body, -1 where they
    leave it, at the first cell whose middle lies behind; one cell more along k than the grid has."""
    u, v = [axis for axis in range(3) if axis != k]
    middles = [(p[1:] + p[:-1]) / 2 for p in planes]
    ray_u = middles[u] + RAY_OFFSET[0] * np.diff(planes[u]) / 2
    ray_v = middles[v] + RAY_OFFSET[1] * np.diff(planes[v]) / 2
    shape = [len(m) for m in middles]
    shape[k] += 1
    some = np.abs(normals[:, k]) > 0
    corners, normals = corners[some], normals[some]
    low, high = corners.min(axis=1), corners.max(axis=1)
    first = np.column_stack([np.searchsorted(ray, low[:, a]) for a, ray in ((u, ray_u), (v, ray_v))])
    last = np.column_stack([np.searchsorted(ray, high[:, a]) - 1 for a, ray in ((u, ray_u), (v, ray_v))])
    total = np.zeros(int(np.prod(shape)), dtype=np.int64)
    for t, i, j in _pairs(first, last):
        x, y = ray_u[i], ray_v[j]
        sides = []
        for edge in range(3):
            a, b = corners[t, edge], corners[t, (edge + 1) % 3]
            sides.append((b[:, u] - a[:, u]) * (y - a[:, v]) - (b[:, v] - a[:, v]) * (x - a[:, u]) > 0)
        hit = (sides[0] == sides[1]) & (sides[1] == sides[2])
        t, i, j, x, y = t[hit], i[hit], j[hit], x[hit], y[hit]
        n, a = normals[t], corners[t, 0]
        height = a[:, k] - (n[:, u] * (x - a[:, u]) + n[:, v] * (y - a[:, v])) / n[:, k]
        at: list[Integers] = [i, j]
        at.insert(k, np.searchsorted(middles[k], height))
        flat = np.ravel_multi_index((at[0], at[1], at[2]), (shape[0], shape[1], shape[2]))
        total += np.bincount(flat, np.where(n[:, k] < 0, 1.0, -1.0), len(total)).astype(np.int64)
    return total.reshape(shape).astype(np.int16)
