"""A few boxes around a mesh that together follow its form: every point of the body is in one of them.

The body is put into the cells of a grid (`model.voxels`). Boxes are made of cells that are filled or near filled ones:
from many cells boxes are grown until they meet what they must not hold, and those are taken that hold most of what is
not covered yet. How near is near enough is the least distance with which the boxes are few.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from heapq import heapify, heappop, heappush
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from takeapart.caching import cache_folder, read_array
from takeapart.model.bounding import tight_box
from takeapart.model.geometry import Array, OrientedBox, TriangleMesh
from takeapart.model.revolving import revolved_cover
from takeapart.model.voxels import VoxelGrid, voxel_grid

VERSION = 3  # of what is kept; grows with every change of the boxes
WANTED_ERROR, WANTED_SHARE = 0.002, 0.015  # m, or of the longest edge if that is more
MOST_BOXES, MOST_CLOSE_BOXES, MANY_BOXES = 96, 48, 24
CELLS = 320_000  # of a grid, about
CELLS_ALONG_ERROR = 3.5  # cells are no finer than that
ROUND_SHARE = 0.4  # of the wanted error, by which boxes of round slices may stand out of them
SEEDS = 420  # cells that boxes are grown from
SAME_VOLUME = 1e-6  # relative; a mesh that fills its box as well is that box

Integers = NDArray[np.int64]
_Counts = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class BoxCover:
    """Boxes whose union holds a body.

    Args:
        boxes: in the part's frame.
        error: no point of a box is farther from the body than this, m; 0 where the boxes are the body.
    """

    boxes: tuple[OrientedBox, ...]
    error: float


def box_cover(mesh: TriangleMesh) -> tuple[OrientedBox, ...]:
    """Boxes whose union holds the body inside a surface, in the part's frame; one, exact, for a mesh that is a box."""
    return cover_of(mesh).boxes


def cover_of(mesh: TriangleMesh) -> BoxCover:
    """As `box_cover`, with its error; found once per mesh and kept in the cache folder."""
    vertices = np.ascontiguousarray(mesh.vertices, "<f8").tobytes()
    return _cover(vertices, np.ascontiguousarray(mesh.triangles, "<i4").tobytes())


@lru_cache(maxsize=512)
def _cover(vertices: bytes, triangles: bytes) -> BoxCover:
    file = cache_folder() / f"cover-{VERSION}-{hashlib.sha256(vertices + triangles).hexdigest()[:32]}.npy"
    try:
        rows = read_array(file)
    except (OSError, ValueError, EOFError):
        rows = np.empty((0, 0))
    if rows.ndim != 2 or rows.shape[1:] != (16,) or not len(rows) or not np.isfinite(rows).all():
        mesh = TriangleMesh(
            np.frombuffer(vertices, "<f8").reshape(-1, 3), np.frombuffer(triangles, "<i4").reshape(-1, 3)
        )
        cover = _found(mesh)
        rows = np.array([[*box.T_frame_box[:3].ravel(), *box.half_extents, cover.error] for box in cover.boxes])
        try:
            temporary = file.with_suffix(f".{hashlib.sha256(rows.tobytes()).hexdigest()[:8]}.npy")
            np.save(temporary, rows, allow_pickle=False)
            temporary.replace(file)
        except OSError:
            pass  # it is found again next time
    poses = [np.vstack([row[:12].reshape(3, 4), [0.0, 0.0, 0.0, 1.0]]) for row in rows]
    boxes = tuple(OrientedBox(T, row[12:15].copy()) for T, row in zip(poses, rows, strict=True))
    return BoxCover(boxes, float(rows[0, 15]))


def _found(mesh: TriangleMesh) -> BoxCover:
    box = tight_box(mesh)
    edges = 2 * box.half_extents
    if abs(_volume(mesh) - edges.prod()) <= SAME_VOLUME * edges.prod():
        return BoxCover((box,), 0.0)
    wanted = max(WANTED_ERROR, WANTED_SHARE * float(edges.max()))
    thick = np.maximum(edges, edges.max() / 100)
    cell = max(wanted / CELLS_ALONG_ERROR, float((thick.prod() / CELLS) ** (1 / 3)))
    cells = _Cover(voxel_grid(mesh, box, cell))
    near = max(wanted - cells.diagonal, cell)
    while True:
        turned = revolved_cover(mesh, cells.grid, cells.distances(near), near, ROUND_SHARE * max(near, wanted))
        if turned is not None:
            return BoxCover(turned[0], turned[1] + cells.uncertainty)
        found = cells.boxes(near, MOST_CLOSE_BOXES if near < wanted else MOST_BOXES)
        if found:
            break
        near *= 1.25
        if near > CELLS_ALONG_ERROR * cell:
            cell = near / CELLS_ALONG_ERROR
            cells = _Cover(voxel_grid(mesh, box, cell))
    while len(found) <= MANY_BOXES and near:
        nearer = near / 2 if near / 2 >= cell else 0.0
        closer = cells.boxes(nearer, MANY_BOXES)
        if not closer:
            break
        near, found = nearer, closer
    return BoxCover(tuple(grid_box(cells.grid, low, high) for low, high in found), cells.error(found))


def _volume(mesh: TriangleMesh) -> float:
    a, b, c = np.moveaxis(mesh.corners - mesh.corners[0, 0], 1, 0)
    return abs(float(np.einsum("ni,ni->n", a, np.cross(b, c)).sum()) / 6)


def grid_box(grid: VoxelGrid, low: Integers, high: Integers) -> OrientedBox:
    """The box of the cells from `low` (3,) up to before `high` (3,), larger by what rounding may hide."""
    ends = np.array([[p[a], p[b]] for p, a, b in zip(grid.planes, low, high, strict=True)])
    first, last = np.array([[p[0], p[-1]] for p in grid.planes]).T
    start = np.maximum(ends[:, 0] - 3 * grid.rounding, first)
    stop = np.minimum(ends[:, 1] + 3 * grid.rounding, last)
    T = grid.T_part_grid.copy()
    T[:3, 3] += T[:3, :3] @ ((start + stop) / 2)
    return OrientedBox(T, (stop - start) / 2)


class _Cover:
    """Boxes of cells for the filled cells of a grid; a box is a pair of cells (3,), the second behind its last."""

    def __init__(self, grid: VoxelGrid) -> None:
        self.grid, self._filled = grid, grid.filled
        self._known = 0.0  # m; up to where distances are told apart
        self._seeds = _spread(np.argwhere(grid.filled), SEEDS)
        self._weights = np.prod(
            np.meshgrid(*(np.diff(p) / np.diff(p).min() for p in grid.planes), indexing="ij"), axis=0
        )

    @property
    def diagonal(self) -> float:
        """Of the largest cell, m, at most."""
        return float(np.linalg.norm([np.diff(p).max() for p in self.grid.planes]))

    @property
    def uncertainty(self) -> float:
        """How much farther than a cell from a filled one a point may be from the body, m: one cell's diagonal where the
        surface passes a cell at its far corner, and one cell where it passes beside it."""
        return self.diagonal + max(float(np.diff(p).max()) for p in self.grid.planes)

    def distances(self, near: float) -> Array:
        """(X, Y, Z) m from every cell to the nearest filled one, exact up to `near` at least."""
        if near >= self._known:
            self._known = 4 * near
            self._distances = _distances(self.grid, self._known)
        return self._distances

    def boxes(self, near: float, most: int) -> list[tuple[Integers, Integers]]:
        """Boxes that hold all filled cells and none farther than `near`, m, from those; none where that takes more than
        `most`."""
        bad = _integral((self.distances(near) > near).astype(np.int32))
        low, high = _grown(bad, self._seeds)
        left = np.where(self._filled, self._weights, 0.0)
        chosen: list[tuple[Integers, Integers]] = []
        while True:
            # What a box adds only falls while others are chosen: most need not be looked at again.
            ranked = [(-gain, k) for k, gain in enumerate(_inside(_integral(left), low, high).tolist()) if gain > 0]
            heapify(ranked)
            while ranked:
                _, k = heappop(ranked)
                where = _slices(low[k], high[k])
                gain = float(left[where].sum())
                if gain <= 0:
                    continue
                if ranked and gain < -ranked[0][0] * (1 - 1e-9):
                    heappush(ranked, (-gain, k))
                    continue
                chosen.append((low[k], high[k]))
                left[where] = 0.0
                if len(chosen) > 1.25 * most:
                    return []
            rest = np.argwhere(left)
            if not len(rest):
                break
            low, high = _grown(bad, _spread(rest, SEEDS // 6))
        shrunk = self._shrunk(chosen)
        return shrunk if len(shrunk) <= most else []

    def _shrunk(self, boxes: list[tuple[Integers, Integers]]) -> list[tuple[Integers, Integers]]:
        """Each box no larger than what only it holds, the last chosen first; those that hold nothing alone are left
        out."""
        times = np.zeros(self._filled.shape, dtype=np.int16)
        for low, high in boxes:
            times[_slices(low, high)] += 1
        kept: list[tuple[Integers, Integers]] = []
        for low, high in reversed(boxes):
            where = _slices(low, high)
            own = self._filled[where] & (times[where] == 1)
            times[where] -= 1
            if own.any():
                ends = [np.nonzero(own.any(axis=other))[0][[0, -1]] for other in ((1, 2), (0, 2), (0, 1))]
                start = low + [end[0] for end in ends]
                stop = low + [end[1] + 1 for end in ends]
                times[_slices(start, stop)] += 1
                kept.append((start, stop))
        return kept[::-1]

    def error(self, boxes: list[tuple[Integers, Integers]]) -> float:
        """Greatest distance of a point of the boxes from the body, m, at most."""
        return max(float(self._distances[_slices(low, high)].max()) for low, high in boxes) + self.uncertainty


def _slices(low: Integers, high: Integers) -> tuple[slice, slice, slice]:
    return slice(low[0], high[0]), slice(low[1], high[1]), slice(low[2], high[2])


def _spread(cells: Integers, count: int) -> Integers:
    """Some of the cells (K, 3), evenly from first to last, each axis once running fastest."""
    orders = [cells[np.lexsort(cells[:, axes].T)] for axes in ([0, 1, 2], [1, 2, 0], [2, 0, 1])]
    picked = [order[np.unique(np.linspace(0, len(order) - 1, count // 3).round().astype(int))] for order in orders]
    return np.unique(np.concatenate(picked), axis=0)


def _integral(values: NDArray[np.generic]) -> NDArray[np.generic]:
    """Sums of all values before a cell along all axes; one more cell along each."""
    sums = np.zeros([n + 1 for n in values.shape], dtype=np.int32 if values.dtype.kind == "i" else np.float64)
    inner = sums[1:, 1:, 1:]
    np.cumsum(values, axis=0, out=inner)
    np.cumsum(inner, axis=1, out=inner)
    np.cumsum(inner, axis=2, out=inner)
    return sums


def _inside(integral: NDArray[np.generic], low: Integers, high: Integers) -> Array:
    """Sums (K,) over the cells of boxes."""
    flat = integral.ravel()
    _, y, z = integral.shape
    x0, x1 = low[:, 0] * (y * z), high[:, 0] * (y * z)
    y0, y1 = low[:, 1] * z, high[:, 1] * z
    z0, z1 = low[:, 2], high[:, 2]
    upper = flat[x1 + y1 + z1] - flat[x1 + y1 + z0] - flat[x1 + y0 + z1] + flat[x1 + y0 + z0]
    lower = flat[x0 + y1 + z1] - flat[x0 + y1 + z0] - flat[x0 + y0 + z1] + flat[x0 + y0 + z0]
    return np.asarray(upper - lower)


def _grown(bad: NDArray[np.generic], seeds: Integers) -> tuple[Integers, Integers]:
    """Boxes (K, 3) grown from cells along one axis after the other, in every order, up to cells that are bad."""
    lows, highs = [], []
    for order in permutations(range(3)):
        low, high = seeds.copy(), seeds + 1
        for axis in order:
            low[:, axis] = _farthest(bad, low, high, axis, -1)
            high[:, axis] = _farthest(bad, low, high, axis, 1)
        lows.append(low)
        highs.append(high)
    both = np.unique(np.hstack([np.concatenate(lows), np.concatenate(highs)]), axis=0)
    return both[:, :3], both[:, 3:]


def _farthest(bad: NDArray[np.generic], low: Integers, high: Integers, axis: int, way: int) -> Integers:
    """How far (K,) boxes can grow along an axis, one way, by bisection."""
    edge = (high if way > 0 else low).copy()
    sure = edge[:, axis].copy()
    limit = np.full(len(sure), bad.shape[axis] - 1 if way > 0 else 0)
    while (sure != limit).any():
        middle = sure + way * ((np.abs(limit - sure) + 1) // 2)
        edge[:, axis] = middle
        free = _inside(bad, low, edge) == 0 if way > 0 else _inside(bad, edge, high) == 0
        sure = np.where(free, middle, sure)  # where nothing is left to find, the box itself is asked again
        limit = np.where(free, limit, middle - way)
    return sure


def _distances(grid: VoxelGrid, most: float) -> Array:
    """(X, Y, Z) m from the middle of every cell to that of the nearest filled one; more than `most` where it is."""
    squared = np.where(grid.filled, 0.0, 4 * most**2).astype(np.float32)
    for axis in range(3):
        middles = grid.middles(axis).astype(np.float32)
        ahead = np.moveaxis(squared, axis, 0)
        nearest = ahead.copy()
        for shift in range(1, len(middles)):
            gaps = ((middles[shift:] - middles[:-shift]) ** 2)[:, None, None]
            if gaps.min() > most**2:
                break
            np.minimum(nearest[shift:], ahead[:-shift] + gaps, out=nearest[shift:])
            np.minimum(nearest[:-shift], ahead[shift:] + gaps, out=nearest[:-shift])
        squared = np.ascontiguousarray(np.moveaxis(nearest, 0, axis))
    return np.sqrt(squared)
