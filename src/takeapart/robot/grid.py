"""Compiled predicates on balls and boxes, and the grid that tells which boxes are near a point."""

from __future__ import annotations

import math

import numpy as np

from takeapart.compilation import compiled, compiled_lean
from takeapart.robot.arrays import FIELD_STEP, Flags, Floats, Integers, WorldArrays


@compiled_lean
def ball_meets_box(x: float, y: float, z: float, r: float, c: Floats, A: Floats, h: Floats, w: int) -> bool:
    """Whether a ball touches box w of arrays of centres (W, 3), axes (W, 3, 3) and half sizes (W, 3)."""
    dx, dy, dz = x - c[w, 0], y - c[w, 1], z - c[w, 2]
    ex = max(abs(A[w, 0, 0] * dx + A[w, 0, 1] * dy + A[w, 0, 2] * dz) - h[w, 0], 0.0)
    ey = max(abs(A[w, 1, 0] * dx + A[w, 1, 1] * dy + A[w, 1, 2] * dz) - h[w, 1], 0.0)
    ez = max(abs(A[w, 2, 0] * dx + A[w, 2, 1] * dy + A[w, 2, 2] * dz) - h[w, 2], 0.0)
    return ex * ex + ey * ey + ez * ez <= r * r


@compiled_lean
def boxes_meet(ca: Floats, A: Floats, ha: Floats, cb: Floats, B: Floats, hb: Floats, padding: float) -> bool:
    """Whether two oriented boxes, the first one grown by `padding` on every side, overlap.

    Separating axis test (Gottschalk, Lin, Manocha: OBBTree, SIGGRAPH 1996). Rows of A and B are the axes. A grown box
    contains every point within `padding` of the box, so a gap of the grown box is a gap of more than `padding`.
    """
    d0, d1, d2 = cb[0] - ca[0], cb[1] - ca[1], cb[2] - ca[2]
    t0 = A[0, 0] * d0 + A[0, 1] * d1 + A[0, 2] * d2
    t1 = A[1, 0] * d0 + A[1, 1] * d1 + A[1, 2] * d2
    t2 = A[2, 0] * d0 + A[2, 1] * d1 + A[2, 2] * d2
    a0, a1, a2 = ha[0] + padding, ha[1] + padding, ha[2] + padding
    b0, b1, b2 = hb[0], hb[1], hb[2]
    r00 = A[0, 0] * B[0, 0] + A[0, 1] * B[0, 1] + A[0, 2] * B[0, 2]
    r01 = A[0, 0] * B[1, 0] + A[0, 1] * B[1, 1] + A[0, 2] * B[1, 2]
    r02 = A[0, 0] * B[2, 0] + A[0, 1] * B[2, 1] + A[0, 2] * B[2, 2]
    q00, q01, q02 = abs(r00), abs(r01), abs(r02)
    if abs(t0) > a0 + b0 * q00 + b1 * q01 + b2 * q02:
        return False
    r10 = A[1, 0] * B[0, 0] + A[1, 1] * B[0, 1] + A[1, 2] * B[0, 2]
    r11 = A[1, 0] * B[1, 0] + A[1, 1] * B[1, 1] + A[1, 2] * B[1, 2]
    r12 = A[1, 0] * B[2, 0] + A[1, 1] * B[2, 1] + A[1, 2] * B[2, 2]
    q10, q11, q12 = abs(r10), abs(r11), abs(r12)
    if abs(t1) > a1 + b0 * q10 + b1 * q11 + b2 * q12:
        return False
    r20 = A[2, 0] * B[0, 0] + A[2, 1] * B[0, 1] + A[2, 2] * B[0, 2]
    r21 = A[2, 0] * B[1, 0] + A[2, 1] * B[1, 1] + A[2, 2] * B[1, 2]
    r22 = A[2, 0] * B[2, 0] + A[2, 1] * B[2, 1] + A[2, 2] * B[2, 2]
    q20, q21, q22 = abs(r20), abs(r21), abs(r22)
    if abs(t2) > a2 + b0 * q20 + b1 * q21 + b2 * q22:
        return False
    if abs(t0 * r00 + t1 * r10 + t2 * r20) > b0 + a0 * q00 + a1 * q10 + a2 * q20:
        return False
    if abs(t0 * r01 + t1 * r11 + t2 * r21) > b1 + a0 * q01 + a1 * q11 + a2 * q21:
        return False
    if abs(t0 * r02 + t1 * r12 + t2 * r22) > b2 + a0 * q02 + a1 * q12 + a2 * q22:
        return False
    # Edge against edge. Where two edges are parallel both sides are nearly zero and the test must not decide.
    e = 1e-12
    if abs(t2 * r10 - t1 * r20) > a1 * q20 + a2 * q10 + b1 * q02 + b2 * q01 + e:
        return False
    if abs(t2 * r11 - t1 * r21) > a1 * q21 + a2 * q11 + b0 * q02 + b2 * q00 + e:
        return False
    if abs(t2 * r12 - t1 * r22) > a1 * q22 + a2 * q12 + b0 * q01 + b1 * q00 + e:
        return False
    if abs(t0 * r20 - t2 * r00) > a0 * q20 + a2 * q00 + b1 * q12 + b2 * q11 + e:
        return False
    if abs(t0 * r21 - t2 * r01) > a0 * q21 + a2 * q01 + b0 * q12 + b2 * q10 + e:
        return False
    if abs(t0 * r22 - t2 * r02) > a0 * q22 + a2 * q02 + b0 * q11 + b1 * q10 + e:
        return False
    if abs(t1 * r00 - t0 * r10) > a0 * q10 + a1 * q00 + b1 * q22 + b2 * q21 + e:
        return False
    if abs(t1 * r01 - t0 * r11) > a0 * q11 + a1 * q01 + b0 * q22 + b2 * q20 + e:
        return False
    return not abs(t1 * r02 - t0 * r12) > a0 * q12 + a1 * q02 + b0 * q21 + b1 * q20 + e


@compiled_lean
def cell_of(world: WorldArrays, x: float, y: float, z: float) -> int:
    """Number of the grid cell that holds a point; -1 outside of the grid, where nothing is near."""
    i = math.floor((x - world.origin[0]) * world.per_cell)
    j = math.floor((y - world.origin[1]) * world.per_cell)
    k = math.floor((z - world.origin[2]) * world.per_cell)
    if i < 0 or j < 0 or k < 0 or i >= world.shape[0] or j >= world.shape[1] or k >= world.shape[2]:
        return -1
    return int((i * world.shape[1] + j) * world.shape[2] + k)


@compiled_lean
def is_far(world: WorldArrays, centers: Floats, k: int, r: float) -> bool:
    """Whether the ball of radius r around centre k (K, 3) is certainly far from everything that counts."""
    cell = cell_of(world, centers[k, 0], centers[k, 1], centers[k, 2])
    if cell < 0:
        return r <= world.row_radius[-1]  # so far the grid reaches beyond everything
    return world.field[cell] * FIELD_STEP > r


@compiled_lean
def row_for(world: WorldArrays, r: float) -> int:
    """Row of the grid for balls of radius r. Nobody may ask for larger ones than the last row serves."""
    row = 0
    while row < len(world.row_radius) - 1 and world.row_radius[row] < r:
        row += 1
    return row


@compiled_lean
def ball_near_world(world: WorldArrays, present: Flags, x: float, y: float, z: float, r: float) -> bool:
    """Whether a ball touches any box that counts."""
    cell = cell_of(world, x, y, z)
    if cell < 0 or world.field[cell] * FIELD_STEP > r:
        return False
    row = row_for(world, r)
    for e in range(world.start[row, cell], world.start[row, cell + 1]):
        w = world.entry[e]
        if present[world.owner[w]] and ball_meets_box(x, y, z, r, world.center, world.axes, world.half, w):
            return True
    return False


@compiled_lean
def line_free(world: WorldArrays, present: Flags, a: Floats, b: Floats, radius: float) -> bool:
    """Whether a ball can move straight from a to b (3,), m, as far as its samples tell."""
    length = math.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)
    count = max(1, math.ceil(length / (2.0 * radius)))
    for k in range(count + 1):
        s = k / count
        x, y, z = a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1]), a[2] + s * (b[2] - a[2])
        if ball_near_world(world, present, x, y, z, radius):
            return False
    return True


@compiled_lean
def mark_ball(world: WorldArrays, x: float, y: float, z: float, r: float, hits: Flags) -> None:
    """Marks in `hits` every owner that a ball touches."""
    cell = cell_of(world, x, y, z)
    if cell < 0:
        return
    row = row_for(world, r)
    for e in range(world.start[row, cell], world.start[row, cell + 1]):
        w = world.entry[e]
        if not hits[world.owner[w]] and ball_meets_box(x, y, z, r, world.center, world.axes, world.half, w):
            hits[world.owner[w]] = 1


@compiled_lean
def mark_line(world: WorldArrays, a: Floats, b: Floats, radius: float, hits: Flags) -> None:
    """Marks in `hits` (parts + 1,) every owner that a ball moving straight from a to b (3,), m, touches at its
    samples.
    """
    length = math.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)
    count = max(1, math.ceil(length / max(0.5 * radius, 0.004)))
    for k in range(count + 1):
        s = k / count
        mark_ball(world, a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1]), a[2] + s * (b[2] - a[2]), radius, hits)


@compiled
def grid_fill(
    center: Floats,
    axes: Floats,
    half: Floats,
    origin: Floats,
    cell: float,
    shape: Integers,
    reach: float,
    start: Integers,
    entry: Integers,
    count_only: bool,
) -> int:
    """Lists for every grid cell the boxes within `reach` of its centre; one call counts into start[1:], a second
    fills.
    """
    total = 0
    lower, upper = np.zeros(3, np.int64), np.zeros(3, np.int64)
    for w in range(len(half)):
        for i in range(3):
            extent = abs(axes[w, 0, i]) * half[w, 0] + abs(axes[w, 1, i]) * half[w, 1] + abs(axes[w, 2, i]) * half[w, 2]
            lower[i] = max(0, math.floor((center[w, i] - extent - reach - origin[i]) / cell))
            upper[i] = min(shape[i] - 1, math.floor((center[w, i] + extent + reach - origin[i]) / cell))
        for i in range(lower[0], upper[0] + 1):
            for j in range(lower[1], upper[1] + 1):
                for k in range(lower[2], upper[2] + 1):
                    x = origin[0] + (i + 0.5) * cell
                    y = origin[1] + (j + 0.5) * cell
                    z = origin[2] + (k + 0.5) * cell
                    if ball_meets_box(x, y, z, reach, center, axes, half, w):
                        number = (i * shape[1] + j) * shape[2] + k
                        if count_only:
                            start[number + 1] += 1
                        else:
                            entry[start[number]] = w
                            start[number] += 1
                        total += 1
    return total


@compiled
def clearance_fields(
    center: Floats,
    axes: Floats,
    half: Floats,
    owner: Integers,
    origin: Floats,
    cell: float,
    shape: Integers,
    reach: float,
    fields: Flags,
) -> None:
    """Per owner and grid cell (owners, cells) a lower bound of the distance from any point of the cell to the owner.

    In units of FIELD_STEP, rounded down; exact up to `reach`, m, and no more than that beyond.
    """
    slack = 0.5 * math.sqrt(3.0) * cell
    largest = min(255, math.floor(reach / FIELD_STEP))
    fields[:] = largest
    lower, upper = np.zeros(3, np.int64), np.zeros(3, np.int64)
    for w in range(len(half)):
        for i in range(3):
            extent = abs(axes[w, 0, i]) * half[w, 0] + abs(axes[w, 1, i]) * half[w, 1] + abs(axes[w, 2, i]) * half[w, 2]
            beyond = extent + reach + slack
            lower[i] = max(0, math.floor((center[w, i] - beyond - origin[i]) / cell))
            upper[i] = min(shape[i] - 1, math.floor((center[w, i] + beyond - origin[i]) / cell))
        for i in range(lower[0], upper[0] + 1):
            for j in range(lower[1], upper[1] + 1):
                for k in range(lower[2], upper[2] + 1):
                    dx = origin[0] + (i + 0.5) * cell - center[w, 0]
                    dy = origin[1] + (j + 0.5) * cell - center[w, 1]
                    dz = origin[2] + (k + 0.5) * cell - center[w, 2]
                    total = 0.0
                    for a in range(3):
                        e = abs(axes[w, a, 0] * dx + axes[w, a, 1] * dy + axes[w, a, 2] * dz) - half[w, a]
                        if e > 0.0:
                            total += e * e
                    steps = (math.sqrt(total) - slack) / FIELD_STEP
                    number = (i * shape[1] + j) * shape[2] + k
                    value = max(0, math.floor(steps))
                    if value < fields[owner[w], number]:
                        fields[owner[w], number] = value
