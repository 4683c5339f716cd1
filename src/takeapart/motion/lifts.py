"""Lifts: the tool follows a given motion in equal steps, mostly straight up, until the part in the hand is clear."""

from __future__ import annotations

import math

import numpy as np

from takeapart.compilation import compiled, compiled_lean
from takeapart.motion.blockers import path_blockers, touches
from takeapart.motion.scene import Scene
from takeapart.robot.arrays import Flags, Floats
from takeapart.robot.kinematics import forward, jacobian

LARGEST_LIFT_TURN = 0.025  # rad, of a joint between two rows of a lift: more would bend the line between them


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
def lift_rows(scene: Scene, q_start: Floats, motion: Floats, rows: Floats) -> bool:
    """Rows (L, n) that move the tool from q_start as a motion (L, 3, 4) of the world says, its first pose the identity;
    False if the arm cannot.

    Newton's method on all six coordinates, started at the row before, so all rows are on the branch of the first one.
    """
    arm, work, J = scene.arm, scene.work, scene.J
    n, count = len(q_start), len(rows) - 1
    rows[0] = q_start
    forward(arm, q_start, work)
    R0, p0 = work.R_tool.copy(), work.p_tool.copy()
    e = np.empty(6)
    A = np.empty((6, 6))
    R_k = np.empty((3, 3))
    for k in range(1, count + 1):
        q = rows[k]
        M = motion[k]
        for i in range(3):
            for j in range(3):
                R_k[i, j] = M[i, 0] * R0[0, j] + M[i, 1] * R0[1, j] + M[i, 2] * R0[2, j]
        x = M[0, 0] * p0[0] + M[0, 1] * p0[1] + M[0, 2] * p0[2] + M[0, 3]
        y = M[1, 0] * p0[0] + M[1, 1] * p0[1] + M[1, 2] * p0[2] + M[1, 3]
        z = M[2, 0] * p0[0] + M[2, 1] * p0[1] + M[2, 2] * p0[2] + M[2, 3]
        for j in range(n):  # where the two rows before lead to
            q[j] = rows[k - 1, j] if k == 1 else 2.0 * rows[k - 1, j] - rows[k - 2, j]
        converged = False
        for _ in range(8):
            forward(arm, q, work)
            R, p = work.R_tool, work.p_tool
            e[0], e[1], e[2] = x - p[0], y - p[1], z - p[2]
            # Rotation error as half the sum of the cross products of matching axes.
            for i in range(3):
                u, v = (i + 1) % 3, (i + 2) % 3
                total = 0.0
                for c in range(3):
                    total += R[u, c] * R_k[v, c] - R[v, c] * R_k[u, c]
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
def lift_ends(scene: Scene, starts: Floats, motion: Floats, rows: Floats, hits: Flags, good: Flags) -> None:
    """Lifts from every start configuration (S, n): rows (S, L, n), what the ends of each would hit (S, parts + 1), and
    which are possible as far as that tells.

    Args:
        scene: its load has flags of its own for what meets the world; they are overwritten.
        motion: (L, 3, 4), see `lift_rows`.
    """
    last = hits.shape[1] - 1
    for s in range(len(starts)):
        good[s] = 0
        _let_part_meet_world(scene, False)
        mark = hits[s]
        mark[:] = 0
        if not touches(scene, starts[s], mark) or mark[last] or not lift_rows(scene, starts[s], motion, rows[s]):
            continue
        _let_part_meet_world(scene, True)
        if touches(scene, rows[s, rows.shape[1] - 1], mark) and not mark[last]:
            good[s] = 1


@compiled_lean
def _let_part_meet_world(scene: Scene, meets: bool) -> None:
    """Whether the part is checked against the world: it touches its neighbours until it is lifted."""
    for h in range(scene.held.group[1], scene.held.group[2]):
        scene.held.meets_world[h] = meets


@compiled
def complete_lifts(scene: Scene, rows: Floats, hits: Flags, good: Flags) -> None:
    """Adds what lifts with rows (S, L, n) would hit between their ends (S, parts + 1), and says which are possible.

    Args:
        scene: as of `lift_ends`.
    """
    _let_part_meet_world(scene, False)
    for s in range(len(rows)):
        good[s] = path_blockers(scene, rows[s], hits[s])
