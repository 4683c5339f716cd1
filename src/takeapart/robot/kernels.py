"""Compiled kernels: forward kinematics, collision of arm and held part with the world and with the arm itself.

Everything here works on the arrays of `takeapart.robot.arrays`, allocates nothing, and releases the interpreter lock.
"""

from __future__ import annotations

import math

import numpy as np

from takeapart.compilation import compiled, compiled_lean
from takeapart.robot.arrays import FIELD_STEP, ArmArrays, Flags, Floats, HeldArrays, Integers, Workspace, WorldArrays

FREE, HIT_WORLD, HIT_SELF = 0, 1, 2


@compiled_lean
def _place(work: Workspace, f: int, o: Floats, k: int) -> tuple[float, float, float]:
    """World coordinates of point k of an array (K, 3) given in link frame f."""
    R, p = work.R, work.p
    x = R[f, 0, 0] * o[k, 0] + R[f, 0, 1] * o[k, 1] + R[f, 0, 2] * o[k, 2] + p[f, 0]
    y = R[f, 1, 0] * o[k, 0] + R[f, 1, 1] * o[k, 1] + R[f, 1, 2] * o[k, 2] + p[f, 1]
    z = R[f, 2, 0] * o[k, 0] + R[f, 2, 1] * o[k, 1] + R[f, 2, 2] * o[k, 2] + p[f, 2]
    return x, y, z


@compiled_lean
def forward(arm: ArmArrays, q: Floats, work: Workspace) -> None:
    """Poses of all links and of the tool at a configuration (n,), rad; written to the workspace."""
    R, p = work.R, work.p
    for i in range(3):
        for j in range(3):
            R[0, i, j] = arm.T_world_base[i, j]
        p[0, i] = arm.T_world_base[i, 3]
    for k in range(len(q)):
        c, s = math.cos(q[k]), math.sin(q[k])
        T = arm.T_joint
        for i in range(3):
            a, b, d = R[k, i, 0], R[k, i, 1], R[k, i, 2]
            x = a * T[k, 0, 0] + b * T[k, 1, 0] + d * T[k, 2, 0]
            y = a * T[k, 0, 1] + b * T[k, 1, 1] + d * T[k, 2, 1]
            R[k + 1, i, 0] = c * x + s * y
            R[k + 1, i, 1] = c * y - s * x
            R[k + 1, i, 2] = a * T[k, 0, 2] + b * T[k, 1, 2] + d * T[k, 2, 2]
            p[k + 1, i] = a * T[k, 0, 3] + b * T[k, 1, 3] + d * T[k, 2, 3] + p[k, i]
    n = len(q)
    for i in range(3):
        a, b, d = R[n, i, 0], R[n, i, 1], R[n, i, 2]
        for j in range(3):
            work.R_tool[i, j] = a * arm.T_tool[0, j] + b * arm.T_tool[1, j] + d * arm.T_tool[2, j]
        work.p_tool[i] = a * arm.T_tool[0, 3] + b * arm.T_tool[1, 3] + d * arm.T_tool[2, 3] + p[n, i]


@compiled_lean
def jacobian(work: Workspace, J: Floats) -> None:
    """Geometric Jacobian (6, n) of the tool: linear above angular velocity. Needs `forward` first."""
    linear_jacobian(work, J)
    for k in range(J.shape[1]):
        J[3, k], J[4, k], J[5, k] = work.R[k + 1, 0, 2], work.R[k + 1, 1, 2], work.R[k + 1, 2, 2]


@compiled_lean
def linear_jacobian(work: Workspace, J: Floats) -> None:
    """The upper half of `jacobian`: linear velocity of the tool, rows 0 to 2 of J (6, n)."""
    for k in range(J.shape[1]):
        zx, zy, zz = work.R[k + 1, 0, 2], work.R[k + 1, 1, 2], work.R[k + 1, 2, 2]
        dx, dy, dz = (
            work.p_tool[0] - work.p[k + 1, 0],
            work.p_tool[1] - work.p[k + 1, 1],
            work.p_tool[2] - work.p[k + 1, 2],
        )
        J[0, k], J[1, k], J[2, k] = zy * dz - zz * dy, zz * dx - zx * dz, zx * dy - zy * dx


@compiled_lean
def _ball_meets_box(x: float, y: float, z: float, r: float, c: Floats, A: Floats, h: Floats, w: int) -> bool:
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
def _cell(world: WorldArrays, x: float, y: float, z: float) -> int:
    """Number of the grid cell that holds a point; -1 outside of the grid, where nothing is near."""
    i = math.floor((x - world.origin[0]) / world.cell)
    j = math.floor((y - world.origin[1]) / world.cell)
    k = math.floor((z - world.origin[2]) / world.cell)
    if i < 0 or j < 0 or k < 0 or i >= world.shape[0] or j >= world.shape[1] or k >= world.shape[2]:
        return -1
    return int((i * world.shape[1] + j) * world.shape[2] + k)


@compiled_lean
def _row(world: WorldArrays, r: float) -> int:
    """Row of the grid for balls of radius r. Nobody may ask for larger ones than the last row serves."""
    row = 0
    while row < len(world.row_radius) - 1 and world.row_radius[row] < r:
        row += 1
    return row


@compiled_lean
def place_held(held: HeldArrays, work: Workspace) -> None:
    """World poses of the held boxes. Needs `forward` first."""
    R, p = work.R_tool, work.p_tool
    for h in range(len(held.half)):
        c, A = held.center, held.axes
        for i in range(3):
            work.box_center[h, i] = R[i, 0] * c[h, 0] + R[i, 1] * c[h, 1] + R[i, 2] * c[h, 2] + p[i]
            for a in range(3):
                work.box_axes[h, a, i] = R[i, 0] * A[h, a, 0] + R[i, 1] * A[h, a, 1] + R[i, 2] * A[h, a, 2]


@compiled_lean
def _held_hits_world(
    held: HeldArrays, world: WorldArrays, present: Flags, padding: float, work: Workspace, hits: Flags, collect: bool
) -> bool:
    R, p = work.R_tool, work.p_tool
    found = False
    for c in range(len(held.probe_radius)):
        h = held.probe_box[c]
        if not held.meets_world[h]:
            continue
        o = held.probe_center
        x = R[0, 0] * o[c, 0] + R[0, 1] * o[c, 1] + R[0, 2] * o[c, 2] + p[0]
        y = R[1, 0] * o[c, 0] + R[1, 1] * o[c, 1] + R[1, 2] * o[c, 2] + p[1]
        z = R[2, 0] * o[c, 0] + R[2, 1] * o[c, 1] + R[2, 2] * o[c, 2] + p[2]
        cell = _cell(world, x, y, z)
        r = held.probe_radius[c] + padding
        if cell < 0 or world.field[cell] * FIELD_STEP > r:
            continue
        row = _row(world, r)
        for e in range(world.start[row, cell], world.start[row, cell + 1]):
            w = world.entry[e]
            owner = world.owner[w]
            if not present[owner] or (collect and hits[owner]):
                continue
            if not _ball_meets_box(x, y, z, r, world.center, world.axes, world.half, w):
                continue
            if boxes_meet(
                work.box_center[h],
                work.box_axes[h],
                held.half[h],
                world.center[w],
                world.axes[w],
                world.half[w],
                padding,
            ):
                if not collect:
                    return True
                hits[owner] = 1
                found = True
    return found


@compiled_lean
def ball_near_world(world: WorldArrays, present: Flags, x: float, y: float, z: float, r: float) -> bool:
    """Whether a ball touches any box that counts."""
    cell = _cell(world, x, y, z)
    if cell < 0 or world.field[cell] * FIELD_STEP > r:
        return False
    row = _row(world, r)
    for e in range(world.start[row, cell], world.start[row, cell + 1]):
        w = world.entry[e]
        if present[world.owner[w]] and _ball_meets_box(x, y, z, r, world.center, world.axes, world.half, w):
            return True
    return False


@compiled_lean
def mark_ball(world: WorldArrays, x: float, y: float, z: float, r: float, hits: Flags) -> None:
    """Marks in `hits` every owner that a ball touches."""
    cell = _cell(world, x, y, z)
    if cell < 0:
        return
    row = _row(world, r)
    for e in range(world.start[row, cell], world.start[row, cell + 1]):
        w = world.entry[e]
        if not hits[world.owner[w]] and _ball_meets_box(x, y, z, r, world.center, world.axes, world.half, w):
            hits[world.owner[w]] = 1


@compiled_lean
def collect_hand(
    arm: ArmArrays,
    held: HeldArrays,
    world: WorldArrays,
    present: Flags,
    padding: float,
    T: Floats,
    work: Workspace,
    hits: Flags,
) -> None:
    """Marks every owner that gripper, wrist and load touch with the tool at a pose T (4, 4), whatever the arm does."""
    n = len(arm.lower)
    for i in range(3):
        work.p_tool[i] = T[i, 3]
        for j in range(3):
            work.R_tool[i, j] = T[i, j]
    for i in range(3):  # the last link's frame: R = R_tool * R(T_tool)^T
        for j in range(3):
            total = 0.0
            for k in range(3):
                total += work.R_tool[i, k] * arm.T_tool[j, k]
            work.R[n, i, j] = total
    for i in range(3):
        total = 0.0
        for k in range(3):
            total += work.R[n, i, k] * arm.T_tool[k, 3]
        work.p[n, i] = work.p_tool[i] - total
    place_held(held, work)
    _held_hits_world(held, world, present, padding, work, hits, True)
    for b in range(len(arm.body_frame)):
        if arm.body_frame[b] == n:
            for s in range(arm.body_start[b], arm.body_start[b + 1]):
                x, y, z = _place(work, n, arm.sphere_center, s)
                cell = _cell(world, x, y, z)
                r = arm.sphere_radius[s] + padding
                if cell < 0 or world.field[cell] * FIELD_STEP > r:
                    continue
                row = _row(world, r)
                for e in range(world.start[row, cell], world.start[row, cell + 1]):
                    w = world.entry[e]
                    owner = world.owner[w]
                    if (
                        present[owner]
                        and not hits[owner]
                        and _ball_meets_box(x, y, z, r, world.center, world.axes, world.half, w)
                    ):
                        hits[owner] = 1


@compiled_lean
def hand_hits_load(arm: ArmArrays, held: HeldArrays, padding: float, work: Workspace) -> bool:
    """Whether palm, wrist or fingers touch what they must not touch of the carried part.

    That is the whole part for palm and wrist, and the walls of its connectors for the fingers. It is the same at every
    configuration. Needs `collect_hand` first.
    """
    n = len(arm.lower)
    for b in range(len(arm.body_frame)):
        if arm.body_frame[b] == n:
            for s in range(arm.body_start[b], arm.body_start[b + 1]):
                x, y, z = _place(work, n, arm.sphere_center, s)
                r = arm.sphere_radius[s] + padding
                for h in range(held.group[1], held.group[2]):
                    if _ball_meets_box(x, y, z, r, work.box_center, work.box_axes, held.half, h):
                        return True
    for f in range(held.group[0], held.group[1]):
        for h in range(held.first_wall, held.group[2]):
            if boxes_meet(
                work.box_center[f],
                work.box_axes[f],
                held.half[f],
                work.box_center[h],
                work.box_axes[h],
                held.half[h],
                padding,
            ):
                return True
    return False


@compiled_lean
def tool_poses(arm: ArmArrays, rows: Floats, work: Workspace, positions: Floats, rotations: Floats) -> None:
    """Tool positions (M, 3), m, and rotations (M, 3, 3) of configurations (M, n)."""
    for k in range(len(rows)):
        forward(arm, rows[k], work)
        for i in range(3):
            positions[k, i] = work.p_tool[i]
            for j in range(3):
                rotations[k, i, j] = work.R_tool[i, j]


@compiled_lean
def place_bodies(arm: ArmArrays, work: Workspace) -> None:
    """World centres of the balls around the bodies. Needs `forward` first."""
    for b in range(len(arm.body_frame)):
        x, y, z = _place(work, arm.body_frame[b], arm.body_center, b)
        work.body[b, 0], work.body[b, 1], work.body[b, 2] = x, y, z


@compiled_lean
def _arm_hits_world(
    arm: ArmArrays, world: WorldArrays, present: Flags, padding: float, work: Workspace, hits: Flags, collect: bool
) -> bool:
    """Bodies far from the base come first: they are the likely ones. The base (body 0) may touch the world."""
    found = False
    for b in range(len(arm.body_frame) - 1, 0, -1):
        cell = _cell(world, work.body[b, 0], work.body[b, 1], work.body[b, 2])
        if cell >= 0 and world.field[cell] * FIELD_STEP > arm.body_radius[b] + padding:
            continue
        f = arm.body_frame[b]
        for s in range(arm.body_start[b], arm.body_start[b + 1]):
            x, y, z = _place(work, f, arm.sphere_center, s)
            cell = _cell(world, x, y, z)
            r = arm.sphere_radius[s] + padding
            if cell < 0 or world.field[cell] * FIELD_STEP > r:
                continue
            row = _row(world, r)
            for e in range(world.start[row, cell], world.start[row, cell + 1]):
                w = world.entry[e]
                owner = world.owner[w]
                if not present[owner] or (collect and hits[owner]):
                    continue
                if _ball_meets_box(x, y, z, r, world.center, world.axes, world.half, w):
                    if not collect:
                        return True
                    hits[owner] = 1
                    found = True
    return found


@compiled_lean
def _bodies_touch(arm: ArmArrays, a: int, b: int, padding: float, work: Workspace) -> bool:
    for s in range(arm.body_start[a], arm.body_start[a + 1]):
        x, y, z = _place(work, arm.body_frame[a], arm.sphere_center, s)
        r = arm.sphere_radius[s] + padding
        dx, dy, dz = x - work.body[b, 0], y - work.body[b, 1], z - work.body[b, 2]
        if dx * dx + dy * dy + dz * dz > (r + arm.body_radius[b]) ** 2:
            continue
        for t in range(arm.body_start[b], arm.body_start[b + 1]):
            u, v, w = _place(work, arm.body_frame[b], arm.sphere_center, t)
            if (x - u) ** 2 + (y - v) ** 2 + (z - w) ** 2 <= (r + arm.sphere_radius[t]) ** 2:
                return True
    return False


@compiled_lean
def _hits_itself(arm: ArmArrays, held: HeldArrays, padding: float, work: Workspace) -> bool:
    """Arm against itself and against what it holds. Needs `place_bodies` and `place_held`."""
    for k in range(len(arm.self_pairs)):
        a, b = arm.self_pairs[k, 0], arm.self_pairs[k, 1]
        dx, dy, dz = (
            work.body[a, 0] - work.body[b, 0],
            work.body[a, 1] - work.body[b, 1],
            work.body[a, 2] - work.body[b, 2],
        )
        if dx * dx + dy * dy + dz * dz > (arm.body_radius[a] + arm.body_radius[b] + padding) ** 2:
            continue
        if _bodies_touch(arm, a, b, padding, work):
            return True
    R, p = work.R_tool, work.p_tool
    for g in range(2):  # the fingers, then the part: a ball around each first
        first, last = held.group[g], held.group[g + 1]
        if first == last:
            continue
        o = held.group_center
        gx = R[0, 0] * o[g, 0] + R[0, 1] * o[g, 1] + R[0, 2] * o[g, 2] + p[0]
        gy = R[1, 0] * o[g, 0] + R[1, 1] * o[g, 1] + R[1, 2] * o[g, 2] + p[1]
        gz = R[2, 0] * o[g, 0] + R[2, 1] * o[g, 1] + R[2, 2] * o[g, 2] + p[2]
        for k in range(len(arm.held_bodies)):
            b = arm.held_bodies[k]
            x, y, z = work.body[b, 0], work.body[b, 1], work.body[b, 2]
            r = arm.body_radius[b] + padding
            if (x - gx) ** 2 + (y - gy) ** 2 + (z - gz) ** 2 > (r + held.group_radius[g]) ** 2:
                continue
            for h in range(first, last):
                if not _ball_meets_box(x, y, z, r, work.box_center, work.box_axes, held.half, h):
                    continue
                for s in range(arm.body_start[b], arm.body_start[b + 1]):
                    u, v, w = _place(work, arm.body_frame[b], arm.sphere_center, s)
                    if _ball_meets_box(
                        u, v, w, arm.sphere_radius[s] + padding, work.box_center, work.box_axes, held.half, h
                    ):
                        return True
    return False


@compiled_lean
def check(
    arm: ArmArrays, held: HeldArrays, world: WorldArrays, present: Flags, padding: float, q: Floats, work: Workspace
) -> int:
    """Collision of a configuration: FREE, HIT_WORLD or HIT_SELF.

    Args:
        present: (parts + 1,) which owners of world boxes count; the last stands for what never leaves.
        padding: distance below which two things count as touching, m.
        q: (n,) rad.
    """
    forward(arm, q, work)
    place_held(held, work)
    if _held_hits_world(held, world, present, padding, work, present, False):
        return HIT_WORLD
    place_bodies(arm, work)
    if _arm_hits_world(arm, world, present, padding, work, present, False):
        return HIT_WORLD
    return HIT_SELF if _hits_itself(arm, held, padding, work) else FREE


@compiled_lean
def collect(
    arm: ArmArrays,
    held: HeldArrays,
    world: WorldArrays,
    present: Flags,
    padding: float,
    q: Floats,
    work: Workspace,
    hits: Flags,
) -> bool:
    """Marks in `hits` (parts + 1,) every owner that the configuration touches; False if the arm touches itself."""
    forward(arm, q, work)
    place_held(held, work)
    place_bodies(arm, work)
    _held_hits_world(held, world, present, padding, work, hits, True)
    _arm_hits_world(arm, world, present, padding, work, hits, True)
    return not _hits_itself(arm, held, padding, work)


@compiled_lean
def reach_of_joints(arm: ArmArrays, held: HeldArrays, q: Floats, work: Workspace, reach: Floats) -> None:
    """For every joint the greatest distance (n,), m, of anything it moves from its axis, at a configuration.

    A small turn dq of joint j moves no point by more than reach[j] * |dq|, so sum_j reach[j] |dq_j| bounds the motion
    of every point of arm, gripper and held part.
    """
    forward(arm, q, work)
    place_held(held, work)
    place_bodies(arm, work)
    n = len(q)
    for j in range(n):
        reach[j] = 0.0
    for b in range(1, len(arm.body_frame)):
        f = arm.body_frame[b]
        x, y, z = work.body[b, 0], work.body[b, 1], work.body[b, 2]
        for j in range(f):
            reach[j] = max(reach[j], _distance_to_axis(work, j, x, y, z) + arm.body_radius[b])
    for h in range(len(held.half)):
        size = math.sqrt(held.half[h, 0] ** 2 + held.half[h, 1] ** 2 + held.half[h, 2] ** 2)
        x, y, z = work.box_center[h, 0], work.box_center[h, 1], work.box_center[h, 2]
        for j in range(n):
            reach[j] = max(reach[j], _distance_to_axis(work, j, x, y, z) + size)


@compiled_lean
def _distance_to_axis(work: Workspace, j: int, x: float, y: float, z: float) -> float:
    zx, zy, zz = work.R[j + 1, 0, 2], work.R[j + 1, 1, 2], work.R[j + 1, 2, 2]
    dx, dy, dz = x - work.p[j + 1, 0], y - work.p[j + 1, 1], z - work.p[j + 1, 2]
    along = dx * zx + dy * zy + dz * zz
    return math.sqrt(max(dx * dx + dy * dy + dz * dz - along * along, 0.0))


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
                    if _ball_meets_box(x, y, z, reach, center, axes, half, w):
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
