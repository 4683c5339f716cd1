"""Edges between two configurations: straight in joint space, or straight for the tool.

An edge that is *straight for the tool* moves the point between the fingertips on the straight line between its ends,
the shortest there is (Eq. 1); the rest of the arm's freedom (all but three joints' worth) follows the interpolation of
the joint angles as closely as the line allows. Each row is the previous one plus its share of what is left to the end,
projected onto the line by Newton's method on the tool's position. From row to row the joints move evenly, and that
motion is what is proved free.
"""

from __future__ import annotations

import math

import numpy as np

from takeapart.compilation import compiled, compiled_apart, compiled_lean
from takeapart.motion.scene import (
    HIT,
    MAXIMUM_PIECES,
    OPEN,
    Scene,
    is_free,
    look_at,
    motion_bound,
    piece_count,
    piece_free,
)
from takeapart.robot.arrays import Floats
from takeapart.robot.kinematics import forward, linear_jacobian

MAXIMUM_ROWS = 4096
PIECE = 0.08  # m, about as far as the first pieces of a joint-space edge take anything
LARGEST_ROW_TURN = 0.09  # rad, of a joint from one row of an executable path to the next


@compiled_lean
def bisection(k: int, count: int) -> int:
    """The k-th of `count` (a power of two) numbers in the order in which bisection visits them."""
    found, size = 0, count
    while k > 0:
        size //= 2
        if k % 2:
            found += size
        k //= 2
    return found


@compiled_apart
def joint_edge_free(scene: Scene, a: Floats, b: Floats) -> bool:
    """Whether the straight joint-space edge is free, end b included.

    Its end and its pieces, in bisection order, get one look each, which ends most attempts; then the pieces that are
    not proved free by it are cut further.
    """
    count, enough = 1, min(piece_count(scene, a, b, PIECE), MAXIMUM_PIECES)
    while count < enough:
        count *= 2
    if not is_free(scene, b):
        return False
    doubtful = 0
    for i in range(count):
        k = bisection(count - 1 - i, count)
        seen = look_at(scene, a, b, k / count, (k + 1) / count)
        if seen == HIT:
            return False
        if seen == OPEN:
            scene.doubtful[doubtful] = k
            doubtful += 1
    for i in range(doubtful):
        k = scene.doubtful[i]
        for j in range(len(a)):
            scene.ends[0, j] = a[j] + (b[j] - a[j]) * k / count
            scene.ends[1, j] = a[j] + (b[j] - a[j]) * (k + 1) / count
        if not piece_free(scene, scene.ends[0], scene.ends[1]):
            return False
    return True


@compiled_lean
def project_to_point(scene: Scene, q: Floats, x: float, y: float, z: float) -> bool:
    """Moves q (n,) in place to the nearest configuration with the tool at a point, m; False if that fails or breaks
    limits.
    """
    arm, J, work = scene.arm, scene.J, scene.work
    n = len(q)
    for _ in range(8):
        forward(arm, q, work)
        ex, ey, ez = x - work.p_tool[0], y - work.p_tool[1], z - work.p_tool[2]
        if ex * ex + ey * ey + ez * ez < 1e-13:
            for j in range(n):
                if q[j] < arm.lower[j] or q[j] > arm.upper[j]:
                    return False
            return True
        linear_jacobian(work, J)
        a00, a01, a02, a11, a12, a22 = 1e-10, 0.0, 0.0, 1e-10, 0.0, 1e-10
        for j in range(n):
            a00 += J[0, j] * J[0, j]
            a01 += J[0, j] * J[1, j]
            a02 += J[0, j] * J[2, j]
            a11 += J[1, j] * J[1, j]
            a12 += J[1, j] * J[2, j]
            a22 += J[2, j] * J[2, j]
        c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
        determinant = a00 * c00 + a01 * c01 + a02 * c02
        if determinant < 1e-12:
            return False  # the arm is stretched or folded: it cannot move the tool in some direction
        c11, c12, c22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
        ux = (c00 * ex + c01 * ey + c02 * ez) / determinant
        uy = (c01 * ex + c11 * ey + c12 * ez) / determinant
        uz = (c02 * ex + c12 * ey + c22 * ez) / determinant
        for j in range(n):
            q[j] += J[0, j] * ux + J[1, j] * uy + J[2, j] * uz
    return False


@compiled_apart
def tool_edge(scene: Scene, a: Floats, b: Floats, spacing: float, rows: Floats) -> int:
    """Rows (R, n) of the tool-straight edge from a to b, both free, without a, with b; 0 if there is none that is free.

    Rows are as close as `piece_count` says for `spacing`, m. The joint-space motion from row to row is free in the
    sense of `piece_free`.
    """
    count = piece_count(scene, a, b, spacing)
    if count > min(len(rows), MAXIMUM_PIECES):
        return 0
    if not tool_line(scene, a, b, count, rows):
        return 0
    every = 1
    while every < count:
        every *= 2
    doubtful = 0
    for i in range(every):
        k = bisection(every - 1 - i, every)
        if k < count:
            seen = look_at(scene, a if k == 0 else rows[k - 1], rows[k], 0.0, 1.0)
            if seen == HIT:
                return 0
            if seen == OPEN:
                scene.doubtful[doubtful] = k
                doubtful += 1
    for i in range(doubtful):
        k = scene.doubtful[i]
        if not piece_free(scene, a if k == 0 else rows[k - 1], rows[k]):
            return 0
    return count


@compiled_lean
def tool_line(scene: Scene, a: Floats, b: Floats, count: int, rows: Floats) -> bool:
    """Writes `count` rows that follow the tool-straight edge; False if the projection fails or leaves its branch.

    A row three times as far from the one before as an even share of the way ends the attempt.
    """
    n = len(a)
    largest = 0.0
    for j in range(n):
        largest = max(largest, abs(b[j] - a[j]))
    jump = 3.0 * largest / count + 1e-3
    forward(scene.arm, b, scene.work)
    bx, by, bz = scene.work.p_tool[0], scene.work.p_tool[1], scene.work.p_tool[2]
    forward(scene.arm, a, scene.work)
    ax, ay, az = scene.work.p_tool[0], scene.work.p_tool[1], scene.work.p_tool[2]
    for k in range(1, count + 1):
        row = rows[k - 1]
        for j in range(n):
            before = a[j] if k == 1 else rows[k - 2, j]
            row[j] = before + (b[j] - before) / (count - k + 1)
        if k < count:
            s = k / count
            if not project_to_point(scene, row, ax + s * (bx - ax), ay + s * (by - ay), az + s * (bz - az)):
                return False
        for j in range(n):
            before = a[j] if k == 1 else rows[k - 2, j]
            if abs(row[j] - before) > jump:
                return False
    return True


@compiled_lean
def tool_positions(scene: Scene, rows: Floats, count: int, points: Floats) -> float:
    """Tool positions (count, 3), m, of the first rows; returns the length of the tool path, m (Eq. 2)."""
    length = 0.0
    for k in range(count):
        forward(scene.arm, rows[k], scene.work)
        squared = 0.0
        for i in range(3):
            points[k, i] = scene.work.p_tool[i]
            if k:
                squared += (points[k, i] - points[k - 1, i]) ** 2
        length += math.sqrt(squared)
    return length


@compiled
def waypoints(scene: Scene, corners: Floats, spacing: float) -> Floats:
    """Rows (N, n) of a joint path through corners (M, n), as close as `piece_count` says; (0, n) if too many."""
    n = corners.shape[1]
    found = np.empty((MAXIMUM_ROWS, n))
    found[0] = corners[0]
    total = 1
    for k in range(1, len(corners)):
        count = piece_count(scene, corners[k - 1], corners[k], spacing)
        if total + count > MAXIMUM_ROWS:
            return np.empty((0, n))
        _interpolate(corners[k - 1], corners[k], count, found[total:])
        total += count
    return found[:total].copy()


@compiled_lean
def _interpolate(a: Floats, b: Floats, count: int, rows: Floats) -> None:
    for i in range(count):
        for j in range(len(a)):
            rows[i, j] = a[j] + (b[j] - a[j]) * (i + 1) / count


@compiled
def resampled(scene: Scene, rows: Floats, spacing: float, straighten: bool) -> Floats:
    """Closer rows of a joint path (M, n): nothing moves more than `spacing`, m, from row to row, and no joint turns by
    more than LARGEST_ROW_TURN.

    Args:
        spacing: m; also bounds what the motion between rows can bend.
        straighten: move the tool on straight lines between the given rows, where that is possible; the motion is then
            another one than that between the given rows, and not yet proved free.

    Returns:
        (N, n) rows, or (0, n) where they would be too many.
    """
    n = rows.shape[1]
    found = np.empty((MAXIMUM_ROWS, n))
    found[0] = rows[0]
    total = 1
    for k in range(1, len(rows)):
        a, b = rows[k - 1], rows[k]
        largest = 0.0
        for j in range(n):
            largest = max(largest, abs(b[j] - a[j]))
        count = max(1, math.ceil(motion_bound(scene, a, b) / spacing), math.ceil(largest / LARGEST_ROW_TURN))
        if total + count > MAXIMUM_ROWS:
            return np.empty((0, n))
        if not straighten or not tool_line(scene, a, b, count, found[total:]):
            _interpolate(a, b, count, found[total:])
        total += count
    return found[:total].copy()
