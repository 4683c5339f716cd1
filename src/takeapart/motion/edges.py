"""Edges between two configurations: straight in joint space, or straight for the tool.

An edge that is *straight for the tool* moves the point between the fingertips on the straight line between its ends,
the shortest there is (Eq. 1); the rest of the arm's freedom (four of seven joints' worth) follows the interpolation
of the
joint angles as closely as the line allows. Each row is the previous one plus its share of what is left to the end,
projected onto the line by Newton's method on the tool's position.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from takeapart.compilation import compiled, compiled_lean
from takeapart.robot.arrays import ArmArrays, Flags, Floats, HeldArrays, Workspace, WorldArrays
from takeapart.robot.kernels import FREE, check, collect, forward, jacobian, linear_jacobian, reach_of_joints

MAXIMUM_ROWS = 4096
COARSE_SPACING = 0.06  # m, of the rows in the first try of a tool-straight edge
LARGEST_LIFT_TURN = 0.025  # rad, of a joint between two rows of a lift: more would bend the line between them
LARGEST_MARGIN = 0.03  # m, of the padding by which a piece of motion is accepted with one check


class Scene(NamedTuple):
    """One planning situation: arm, what it carries, what stands around, and scratch memory."""

    arm: ArmArrays
    held: HeldArrays
    world: WorldArrays
    present: Flags  # (parts + 1,) owners of world boxes that count
    padding: float  # m
    work: Workspace
    J: Floats  # (6, n) scratch
    reach: Floats  # (n,) scratch
    bounds: Floats  # (MAXIMUM_ROWS,) m, scratch
    q: Floats  # (n,) rad, scratch


def new_scene(
    arm: ArmArrays, held: HeldArrays, world: WorldArrays, present: Flags, padding: float, work: Workspace
) -> Scene:
    """A planning situation with scratch memory of its own."""
    n = len(arm.lower)
    scratch = np.zeros((6, n)), np.zeros(n), np.zeros(MAXIMUM_ROWS), np.zeros(n)
    return Scene(arm, held, world, present, padding, work, *scratch)


@compiled_lean
def is_free(scene: Scene, q: Floats) -> bool:
    """Whether a configuration touches nothing."""
    return check(scene.arm, scene.held, scene.world, scene.present, scene.padding, q, scene.work) == FREE


@compiled_lean
def motion_bound(scene: Scene, a: Floats, b: Floats) -> float:
    """How far any point of arm and load moves at most between two near configurations, m (see `reach_of_joints`)."""
    reach_of_joints(scene.arm, scene.held, a, scene.work, scene.reach)
    total = 0.0
    for j in range(len(a)):
        total += scene.reach[j] * abs(b[j] - a[j])
    return total


@compiled_lean
def piece_free(scene: Scene, a: Floats, b: Floats, bound: float, step: float, q: Floats) -> bool:
    """Whether the straight joint-space motion between two near configurations is free.

    A piece is accepted with one check: if its middle stays free when everything is padded by as much as anything can
    move from there to the ends of the piece, the whole piece is free. Otherwise it is halved, until nothing moves more
    than `step`, m, in it.

    Args:
        bound: how far anything moves from a to b, m.
        q: (n,) scratch.
    """
    pieces = 1
    while bound / pieces > step:
        pieces *= 2
    done = 0
    while done < pieces:
        size = 1
        while (
            done % (2 * size) == 0 and 2 * size * bound / pieces <= 2.0 * LARGEST_MARGIN and done + 2 * size <= pieces
        ):
            size *= 2
        while True:
            s = (done + 0.5 * size) / pieces
            for j in range(len(a)):
                q[j] = a[j] + (b[j] - a[j]) * s
            margin = 0.5 * size * bound / pieces
            if check(scene.arm, scene.held, scene.world, scene.present, scene.padding + margin, q, scene.work) == FREE:
                break
            if not is_free(scene, q):
                return False
            if size == 1:
                break
            size //= 2
        done += size
    return True


@compiled_lean
def joint_edge_free(scene: Scene, a: Floats, b: Floats, step: float, q: Floats) -> bool:
    """Whether the straight joint-space edge is free, end b included (see `piece_free`)."""
    bound = motion_bound(scene, a, b)
    if not is_free(scene, b):
        return False
    count = 1
    while bound / count > 2.0 * LARGEST_MARGIN:
        count *= 2
    # Bisection order: an edge that is blocked is mostly blocked in the middle.
    stride = count
    while stride >= 2:
        half = stride // 2
        for k in range(half, count, stride):
            for j in range(len(a)):
                q[j] = a[j] + (b[j] - a[j]) * k / count
            if not is_free(scene, q):
                return False
        stride = half
    return piece_free(scene, a, b, bound, step, q)


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


@compiled_lean
def tool_edge(scene: Scene, a: Floats, b: Floats, spacing: float, step: float, rows: Floats) -> int:
    """Rows (R, n) of the tool-straight edge from a to b, without a, with b; 0 if there is none that is free.

    A coarse line is tried first, it ends most attempts. Rows are spaced so that nothing moves more than about
    `spacing`,
    m, between them. The joint-space motion from row to row is free in the sense of `piece_free` with `step`.
    """
    bound = motion_bound(scene, a, b)
    count = max(1, math.ceil(bound / spacing))
    if count > len(rows):
        return 0
    coarse = math.ceil(bound / COARSE_SPACING)
    if coarse > 2 and count >= 2 * coarse and not _tool_line(scene, a, b, coarse, rows, True):
        return 0
    if not _tool_line(scene, a, b, count, rows, False):
        return 0
    return count if _rows_free(scene, a, rows, count, spacing, step) else 0


@compiled_lean
def _tool_line(scene: Scene, a: Floats, b: Floats, count: int, rows: Floats, check_rows: bool) -> bool:
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
        if check_rows and not is_free(scene, row):
            return False
    return True


@compiled_lean
def _rows_free(scene: Scene, a: Floats, rows: Floats, count: int, spacing: float, step: float) -> bool:
    """Whether the motion from a through the first rows is free: bisection first, then every piece."""
    if not is_free(scene, rows[count - 1]):
        return False
    stride = 1
    while stride < count:
        stride *= 2
    while stride * spacing >= LARGEST_MARGIN and stride >= 2:
        half = stride // 2
        for k in range(half, count, stride):
            if not is_free(scene, rows[k - 1]):
                return False
        stride = half
    # Runs of rows around a middle one are accepted with one check, as in `piece_free`.
    bounds, q = scene.bounds, scene.q
    for k in range(count):
        before = a if k == 0 else rows[k - 1]
        bounds[k] = 1.02 * motion_bound(scene, before, rows[k])
    first = 0
    while first < count:
        # Pieces first .. last - 1; the middle is the row where the run up to it is as long as allowed.
        reach, middle = 0.0, first
        while middle < count and reach + bounds[middle] <= LARGEST_MARGIN:
            reach += bounds[middle]
            middle += 1
        if middle > first:
            after, last = 0.0, middle
            while last < count and after + bounds[last] <= reach:
                after += bounds[last]
                last += 1
            row = rows[middle - 1]
            if check(scene.arm, scene.held, scene.world, scene.present, scene.padding + reach, row, scene.work) == FREE:
                first = last
                continue
        before = a if first == 0 else rows[first - 1]
        if not piece_free(scene, before, rows[first], bounds[first], step, q):
            return False
        first += 1
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
def path_blockers(scene: Scene, rows: Floats, step: float, hits: Flags) -> bool:
    """Marks in `hits` (parts + 1,) every owner that the motion through the rows (M, n) may touch.

    A proof for all the others: a piece of motion is checked at its middle with the padding grown by as much as anything
    moves from there to its ends; pieces that touch something are halved until nothing moves more than `step`, m, in
    them. What still touches then counts as hit, so an owner that is passed by at `padding + step / 2` or more is never
    marked, and one that is not marked is never nearer than `padding`.

    Returns:
        False if the arm touches itself, or an owner that never leaves.
    """
    n = rows.shape[1]
    q = np.empty(n)
    near = np.zeros(len(hits), np.uint8)
    if not _settle(scene, rows[0], 0.0, hits, near, True):
        return False
    for k in range(1, len(rows)):
        bound = 1.02 * motion_bound(scene, rows[k - 1], rows[k])
        pieces = 1
        while bound / pieces > step:
            pieces *= 2
        done = 0
        while done < pieces:
            size = 1
            while (
                done % (2 * size) == 0
                and 2 * size * bound / pieces <= 2.0 * LARGEST_MARGIN
                and done + 2 * size <= pieces
            ):
                size *= 2
            while True:
                s = (done + 0.5 * size) / pieces
                for j in range(n):
                    q[j] = rows[k - 1, j] + (rows[k, j] - rows[k - 1, j]) * s
                if _settle(scene, q, 0.5 * size * bound / pieces, hits, near, size == 1):
                    break
                if size == 1:
                    return False
                size //= 2
            done += size
    return True


@compiled_lean
def _settle(scene: Scene, q: Floats, margin: float, hits: Flags, near: Flags, last: bool) -> bool:
    """Whether a piece of motion around q is decided: it touches nothing new; or, at the last size, what it touches
    is marked.
    """
    for i in range(len(hits)):
        near[i] = hits[i]  # what is marked already needs no further look
    free = collect(scene.arm, scene.held, scene.world, scene.present, scene.padding + margin, q, scene.work, near)
    if not free or near[len(near) - 1]:
        return False
    new = False
    for i in range(len(hits)):
        new = new or near[i] != hits[i]
    if new and last:
        for i in range(len(hits)):
            hits[i] = near[i]
    return last or not new


@compiled_lean
def solve_symmetric(A: Floats, x: Floats) -> bool:
    """Solves A y = x for a positive definite A (m, m), of which the lower triangle is read and overwritten; y
    replaces x.

    Cholesky's method; False if A is not positive definite.
    """
    m = len(x)
    for i in range(m):
        for j in range(i + 1):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            if i == j:
                if total <= 0.0:
                    return False
                A[i, i] = math.sqrt(total)
            else:
                A[i, j] = total / A[j, j]
    for i in range(m):
        for k in range(i):
            x[i] -= A[i, k] * x[k]
        x[i] /= A[i, i]
    for i in range(m - 1, -1, -1):
        for k in range(i + 1, m):
            x[i] -= A[k, i] * x[k]
        x[i] /= A[i, i]
    return True


@compiled
def lift_rows(scene: Scene, q_start: Floats, height: float, rows: Floats) -> bool:
    """Rows (L, n) that lift the tool straight up from q_start, orientation kept, in equal steps; False if the arm
    cannot.

    Newton's method on all six coordinates, started at the row before, so all rows are on the branch of the first one.
    """
    arm, work, J = scene.arm, scene.work, scene.J
    n, count = len(q_start), len(rows) - 1
    rows[0] = q_start
    forward(arm, q_start, work)
    R0, p0 = work.R_tool.copy(), work.p_tool.copy()
    e = np.empty(6)
    A = np.empty((6, 6))
    for k in range(1, count + 1):
        q = rows[k]
        for j in range(n):  # where the two rows before lead to
            q[j] = rows[k - 1, j] if k == 1 else 2.0 * rows[k - 1, j] - rows[k - 2, j]
        converged = False
        for _ in range(8):
            forward(arm, q, work)
            R, p = work.R_tool, work.p_tool
            e[0], e[1], e[2] = p0[0] - p[0], p0[1] - p[1], p0[2] + height * k / count - p[2]
            # Rotation error as half the sum of the cross products of matching axes.
            for i in range(3):
                u, v = (i + 1) % 3, (i + 2) % 3
                total = 0.0
                for c in range(3):
                    total += R[u, c] * R0[v, c] - R[v, c] * R0[u, c]
                e[3 + i] = 0.5 * total
            worst = 0.0
            for i in range(6):
                worst = max(worst, abs(e[i]))
            if worst < 1e-9:
                converged = True
                break
            jacobian(work, J)
            for i in range(6):
                for m in range(6):
                    total = 1e-12 if i == m else 0.0
                    if m > i:
                        continue  # the lower triangle is enough
                    for j in range(n):
                        total += J[i, j] * J[m, j]
                    A[i, m] = total
            if not solve_symmetric(A, e):
                break
            for j in range(n):
                for i in range(6):
                    q[j] += J[i, j] * e[i]
        if not converged:
            return False
        for j in range(n):
            if q[j] < arm.lower[j] or q[j] > arm.upper[j] or abs(q[j] - rows[k - 1, j]) > LARGEST_LIFT_TURN:
                return False
    return True


@compiled
def lift_branches(
    lifting: Scene, carrying: Scene, starts: Floats, height: float, step: float, rows: Floats, hits: Flags, good: Flags
) -> None:
    """Lifts from every start configuration (S, n): rows (S, L, n), what each would hit (S, parts + 1), and which are
    possible.

    Args:
        lifting: scene in which the load itself is not checked against the world.
        carrying: scene in which it is; for the end of the lift.
        step: see `path_blockers`.
    """
    last = hits.shape[1] - 1
    for s in range(len(starts)):
        good[s] = 0
        mark = hits[s]
        mark[:] = 0
        # The first configuration is looked at alone: it ends most branches.
        if not collect(
            lifting.arm, lifting.held, lifting.world, lifting.present, lifting.padding, starts[s], lifting.work, mark
        ):
            continue
        if mark[last] or not lift_rows(lifting, starts[s], height, rows[s]):
            continue
        end = rows[s, rows.shape[1] - 1]
        if not collect(
            carrying.arm, carrying.held, carrying.world, carrying.present, carrying.padding, end, carrying.work, mark
        ):
            continue
        if mark[last] or not path_blockers(lifting, rows[s], step, mark):
            continue
        good[s] = 1
