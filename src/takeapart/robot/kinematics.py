"""Compiled kinematics: where links, spheres and load are at a configuration, and how far a motion takes them.

Everything here works on the arrays of `takeapart.robot.arrays`, allocates nothing, and releases the interpreter lock.

How far anything moves (`set_motion`). Let a configuration q turn by dq, the joints evenly. A point x of a link moves by
its first-order motion J(x) dq, and by no more than half the largest second derivative along the way besides. That is
at most sum_k rho_k |dq_k| (|dq_k| + 2 sum_{j<k} |dq_j|), since the derivative of x by q_j and q_k, j <= k, is
z_j x (z_k x (x - p_k)), which is no longer than x is far from axis k: rho_k bounds that distance all along the way.
While the joints beyond k turn, x comes no further from axis k than they can move it:
rho_k = reach_k + sum_{j>k} rho_j |dq_j|, with reach_k the distance at q.
"""

from __future__ import annotations

import math

import numpy as np

from takeapart.compilation import compiled_lean
from takeapart.robot.arrays import ArmArrays, ChainArrays, ChainFrames, Flags, Floats, HeldArrays, Integers, Workspace

FULL_TURN = 2.0 * math.pi
LARGEST_ERROR = 1e-6  # m, rad; what puts the tool further from a pose is no solution of its inverse kinematics
SAME_SOLUTION = 1e-6  # rad; configurations in which no joint differs by more are one


@compiled_lean
def forward(arm: ArmArrays | ChainArrays, q: Floats, work: Workspace | ChainFrames) -> None:
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
def tool_poses(arm: ArmArrays, rows: Floats, work: Workspace, poses: Floats) -> None:
    """Poses of the tool (M, 7) at configurations (M, n): x, y, z, m, and unit quaternion w, x, y, z with w >= 0."""
    for k in range(len(rows)):
        forward(arm, rows[k], work)
        for i in range(3):
            poses[k, i] = work.p_tool[i]
        _write_quaternion(work.R_tool, poses[k, 3:])


@compiled_lean
def _write_quaternion(R: Floats, q: Floats) -> None:
    """Shepperd's method, as in `geometry.quaternion_from_rotation`."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    largest, greatest = 0, 1.0 + trace
    for i in range(3):
        squared = 1.0 + 2.0 * R[i, i] - trace
        if squared > greatest:
            largest, greatest = i + 1, squared
    # Row k of the symmetric matrix 4 q q' is 4 q_k q: the row of the largest component is the best conditioned one.
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        if largest == 0:
            q[i + 1] = R[k, j] - R[j, k]
        elif largest == i + 1:
            q[0] = R[k, j] - R[j, k]
        else:
            q[i + 1] = R[largest - 1, i] + R[i, largest - 1]
    q[largest] = greatest
    length = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    if q[0] < 0.0:
        length = -length
    for i in range(4):
        q[i] /= length


@compiled_lean
def tool_steps(arm: ArmArrays, rows: Floats, work: Workspace, steps: Floats) -> None:
    """How far the tool gets from each configuration of (M, n) to the next, m; written to `steps` (M - 1,)."""
    x = y = z = 0.0
    for k in range(len(rows)):
        forward(arm, rows[k], work)
        if k:
            dx, dy, dz = work.p_tool[0] - x, work.p_tool[1] - y, work.p_tool[2] - z
            steps[k - 1] = math.sqrt(dx * dx + dy * dy + dz * dz)
        x, y, z = work.p_tool[0], work.p_tool[1], work.p_tool[2]


@compiled_lean
def mark_solutions(chain: ChainArrays, rows: Floats, T: Floats, frames: ChainFrames, right: Flags) -> None:
    """Marks in `right` (M,) which configurations (M, n), rad, put the tool at a pose T (4, 4) within `LARGEST_ERROR`,
    each once: what differs from an earlier one by rounding and full turns alone is not marked.
    """
    for k in range(len(rows)):
        forward(chain, rows[k], frames)
        moved = turned = 0.0
        for i in range(3):
            moved += (frames.p_tool[i] - T[i, 3]) ** 2
            for j in range(3):
                turned += (frames.R_tool[i, j] - T[i, j]) ** 2  # in all 8 sin^2(angle / 2)
        right[k] = max(moved, 0.5 * turned) <= LARGEST_ERROR * LARGEST_ERROR
        for m in range(k):
            if right[k] and right[m]:
                apart = 0.0
                for j in range(rows.shape[1]):
                    apart = max(apart, abs(nearest_angle(rows[k, j], rows[m, j]) - rows[m, j]))
                    if apart > SAME_SOLUTION:
                        break
                if apart <= SAME_SOLUTION:
                    right[k] = 0


@compiled_lean
def wind_to_middle(lower: Floats, upper: Floats, turning: Integers, rows: Floats, inside: Flags) -> None:
    """Brings every joint of configurations (M, n), rad, by full turns inside its limits (n,), if there is such an
    angle: of the joints `turning` to that nearest to the middle, if it is inside. Marks in `inside` (M,) which
    configurations are inside the limits then.
    """
    for m in range(len(rows)):
        for i in range(len(turning)):
            k = turning[i]
            found = nearest_angle(rows[m, k], 0.5 * (lower[k] + upper[k]))
            if found >= lower[k] and found <= upper[k]:
                rows[m, k] = found
        inside[m] = 1
        for k in range(rows.shape[1]):
            angle = rows[m, k]
            if angle < lower[k] or angle > upper[k]:
                found = nearest_angle(angle, 0.5 * (lower[k] + upper[k]))
                if found >= lower[k] and found <= upper[k]:
                    rows[m, k] = found
                else:
                    inside[m] = 0


@compiled_lean
def nearest_angle(angle: float, near: float) -> float:
    """The same angle, rad, full turns added, so that it is no more than half a turn from another one."""
    return angle + FULL_TURN * math.floor((near - angle) / FULL_TURN + 0.5)


@compiled_lean
def nearest_winding(arm: ArmArrays, k: int, angle: float, near: float) -> float:
    """The angle, rad, of joint k of those that turn further than once round, full turns added: inside the limits, and
    as near to another angle as that allows.
    """
    found = nearest_angle(angle, near)
    if found > arm.upper[k]:
        found = nearest_angle(angle, arm.upper[k] - 0.5 * FULL_TURN)
    elif found < arm.lower[k]:
        found = nearest_angle(angle, arm.lower[k] + 0.5 * FULL_TURN)
    return min(max(found, arm.lower[k]), arm.upper[k])  # rounding takes none beyond


@compiled_lean
def wind(arm: ArmArrays, q: Floats, near: Floats, wound: Floats) -> None:
    """Writes to `wound` (n,) a configuration q (n,), rad, that puts every link where q does, as near to another one as
    the limits allow: joints that turn further than once round have full turns added.
    """
    for j in range(len(q)):
        wound[j] = q[j]
    for i in range(len(arm.turning)):
        k = arm.turning[i]
        wound[k] = nearest_winding(arm, k, q[k], near[k])


@compiled_lean
def squared_distance(arm: ArmArrays, a: Floats, b: Floats) -> float:
    """In joint space, rad^2, between a configuration (n,) and another one wound as near to it as the limits allow."""
    total = 0.0
    for j in range(len(a)):
        d = b[j] - a[j]
        total += d * d
    for i in range(len(arm.turning)):
        k = arm.turning[i]
        d, wound = b[k] - a[k], nearest_winding(arm, k, b[k], a[k]) - a[k]
        total += wound * wound - d * d
    return total


@compiled_lean
def place(arm: ArmArrays, held: HeldArrays, q: Floats, work: Workspace) -> None:
    """Everything that the collision tests need of a configuration (n,), rad; written to the workspace."""
    for k in range(len(q)):
        work.q[k] = q[k]
    for i in range(len(arm.turning)):
        k = arm.turning[i]
        work.q[k] = nearest_angle(q[k], 0.5 * (arm.lower[k] + arm.upper[k]))
    forward(arm, q, work)
    place_bodies(arm, work)
    place_groups(held, work)


@compiled_lean
def place_bodies(arm: ArmArrays, work: Workspace) -> None:
    """World centres of the balls around the arm's bodies. Needs `forward` first."""
    R, p, c = work.R, work.p, arm.body_center
    for b in range(np.uint64(len(arm.body_frame))):
        f = arm.body_frame[b]
        for i in range(3):
            work.body[b, i] = R[f, i, 0] * c[b, 0] + R[f, i, 1] * c[b, 1] + R[f, i, 2] * c[b, 2] + p[f, i]
        work.placed[b] = 0


@compiled_lean
def place_spheres(arm: ArmArrays, work: Workspace, b: int) -> None:
    """World centres of the spheres of a body, unless they are there already. Needs `place_bodies` first."""
    if work.placed[b]:
        return
    work.placed[b] = 1
    R, p, f = work.R, work.p, arm.body_frame[b]
    x, y, z = arm.sphere_x, arm.sphere_y, arm.sphere_z
    r00, r01, r02 = R[f, 0, 0], R[f, 0, 1], R[f, 0, 2]
    r10, r11, r12 = R[f, 1, 0], R[f, 1, 1], R[f, 1, 2]
    r20, r21, r22 = R[f, 2, 0], R[f, 2, 1], R[f, 2, 2]
    px, py, pz = p[f, 0], p[f, 1], p[f, 2]
    for s in range(arm.body_start[b], arm.body_start[b + 1]):
        work.x[s] = r00 * x[s] + r01 * y[s] + r02 * z[s] + px
        work.y[s] = r10 * x[s] + r11 * y[s] + r12 * z[s] + py
        work.z[s] = r20 * x[s] + r21 * y[s] + r22 * z[s] + pz


@compiled_lean
def place_groups(held: HeldArrays, work: Workspace) -> None:
    """World middles of the boxes around fingers and part. Needs `forward` first."""
    R, p, o = work.R_tool, work.p_tool, held.group_center
    for g in range(2):
        work.group[g, 0] = R[0, 0] * o[g, 0] + R[0, 1] * o[g, 1] + R[0, 2] * o[g, 2] + p[0]
        work.group[g, 1] = R[1, 0] * o[g, 0] + R[1, 1] * o[g, 1] + R[1, 2] * o[g, 2] + p[1]
        work.group[g, 2] = R[2, 0] * o[g, 0] + R[2, 1] * o[g, 1] + R[2, 2] * o[g, 2] + p[2]


@compiled_lean
def place_held(held: HeldArrays, work: Workspace) -> None:
    """World poses of the held boxes. Needs `forward` first."""
    for h in range(len(held.half)):
        place_box(held, work, h)


@compiled_lean
def place_box(held: HeldArrays, work: Workspace, h: int) -> None:
    """World pose of held box h: the few boxes that come near anything are placed when they do."""
    R, p, c, A = work.R_tool, work.p_tool, held.center, held.axes
    for i in range(3):
        work.box_center[h, i] = R[i, 0] * c[h, 0] + R[i, 1] * c[h, 1] + R[i, 2] * c[h, 2] + p[i]
        for a in range(3):
            work.box_axes[h, a, i] = R[i, 0] * A[h, a, 0] + R[i, 1] * A[h, a, 1] + R[i, 2] * A[h, a, 2]


@compiled_lean
def place_group(held: HeldArrays, work: Workspace, g: int) -> None:
    """World axes of the box around group g. Needs `place_groups`."""
    R, A = work.R_tool, held.group_axes
    for i in range(3):
        for a in range(3):
            work.group_axes[g, a, i] = R[i, 0] * A[g, a, 0] + R[i, 1] * A[g, a, 1] + R[i, 2] * A[g, a, 2]


@compiled_lean
def set_motion(arm: ArmArrays, held: HeldArrays, a: Floats, b: Floats, share: float, work: Workspace) -> float:
    """Bounds how far everything moves from the configuration placed last while the joints turn by share * (b - a).

    Either way along that line, so a piece of motion is bounded from its middle with half of its share. The bounds are
    written to the workspace: `margin` per body, `group_margin` for fingers and part.

    Returns:
        the largest margin of a body or of the fingers, m; the part may move further where it is long.
    """
    n = len(a)
    beyond = 0.0
    for k in range(n, 0, -1):
        turn = abs(share * (b[k - 1] - a[k - 1]))
        work.rho[k - 1] = _reach(arm, held, work, k) + beyond
        beyond += work.rho[k - 1] * turn
    R, p, w, v = work.R, work.p, work.omega, work.velocity
    for i in range(3):
        w[0, i] = v[0, i] = 0.0
    work.second[0] = before = 0.0
    for k in range(1, n + 1):
        dq = share * (b[k - 1] - a[k - 1])
        dx, dy, dz = p[k, 0] - p[k - 1, 0], p[k, 1] - p[k - 1, 1], p[k, 2] - p[k - 1, 2]
        wx, wy, wz = w[k - 1, 0], w[k - 1, 1], w[k - 1, 2]
        v[k, 0] = v[k - 1, 0] + wy * dz - wz * dy
        v[k, 1] = v[k - 1, 1] + wz * dx - wx * dz
        v[k, 2] = v[k - 1, 2] + wx * dy - wy * dx
        w[k, 0], w[k, 1], w[k, 2] = wx + dq * R[k, 0, 2], wy + dq * R[k, 1, 2], wz + dq * R[k, 2, 2]
        turn = abs(dq)
        work.turn[k - 1] = turn
        work.second[k] = work.second[k - 1] + 0.5 * work.rho[k - 1] * turn * (turn + 2.0 * before)
        before += turn
    largest = 0.0
    for b_ in range(len(arm.body_frame)):
        x, y, z = work.body[b_, 0], work.body[b_, 1], work.body[b_, 2]
        work.margin[b_] = motion_of_ball(work, int(arm.body_frame[b_]), 0, x, y, z, arm.body_radius[b_])
        largest = max(largest, work.margin[b_])
    for g in range(2):
        x, y, z = work.group[g, 0], work.group[g, 1], work.group[g, 2]
        work.group_margin[g] = motion_of_ball(work, n, 0, x, y, z, held.group_radius[g])
    return max(largest, work.group_margin[0])


@compiled_lean
def motion_of_ball(work: Workspace, frame: int, seen_from: int, x: float, y: float, z: float, r: float) -> float:
    """How far any point of a ball that moves with a frame gets at most, m, as seen from another frame before it.

    Needs `set_motion`. Seen from a frame, only the joints between the two turn.
    """
    w, v, p, f, g = work.omega, work.velocity, work.p, frame, seen_from
    wx, wy, wz = w[f, 0], w[f, 1], w[f, 2]
    dx, dy, dz = x - p[f, 0], y - p[f, 1], z - p[f, 2]
    vx = v[f, 0] + wy * dz - wz * dy
    vy = v[f, 1] + wz * dx - wx * dz
    vz = v[f, 2] + wx * dy - wy * dx
    if g > 0:
        ux, uy, uz = w[g, 0], w[g, 1], w[g, 2]
        dx, dy, dz = x - p[g, 0], y - p[g, 1], z - p[g, 2]
        vx -= v[g, 0] + uy * dz - uz * dy
        vy -= v[g, 1] + uz * dx - ux * dz
        vz -= v[g, 2] + ux * dy - uy * dx
        wx, wy, wz = wx - ux, wy - uy, wz - uz
    turning = r * math.sqrt(wx * wx + wy * wy + wz * wz) if r > 0.0 else 0.0
    return math.sqrt(vx * vx + vy * vy + vz * vz) + turning + work.second[f]


@compiled_lean
def set_still(work: Workspace) -> None:
    """Sets all margins to zero: the configuration placed last stands for itself only."""
    for b in range(len(work.margin)):
        work.margin[b] = 0.0
    work.group_margin[0] = work.group_margin[1] = 0.0
    for k in range(len(work.turn)):
        work.turn[k] = 0.0
    for k in range(len(work.second)):
        work.second[k] = 0.0
        for i in range(3):
            work.omega[k, i] = work.velocity[k, i] = 0.0


@compiled_lean
def _reach(arm: ArmArrays, held: HeldArrays, work: Workspace, k: int) -> float:
    """Greatest distance, m, of anything that joint k (1..n) moves from its axis, at the configuration placed last."""
    px, py, pz = work.p[k, 0], work.p[k, 1], work.p[k, 2]
    zx, zy, zz = work.R[k, 0, 2], work.R[k, 1, 2], work.R[k, 2, 2]
    farthest = radius = 0.0
    for b in range(len(arm.body_frame) - 1, 0, -1):
        if arm.body_frame[b] < k:
            break  # bodies are in the order of their frames
        dx, dy, dz = work.body[b, 0] - px, work.body[b, 1] - py, work.body[b, 2] - pz
        along = dx * zx + dy * zy + dz * zz
        farthest = max(farthest, dx * dx + dy * dy + dz * dz - along * along)
        radius = max(radius, arm.body_radius[b])
    reach = math.sqrt(max(farthest, 0.0)) + radius
    for g in range(2):
        dx, dy, dz = work.group[g, 0] - px, work.group[g, 1] - py, work.group[g, 2] - pz
        along = dx * zx + dy * zy + dz * zz
        squared = dx * dx + dy * dy + dz * dz - along * along
        reach = max(reach, math.sqrt(max(squared, 0.0)) + held.group_radius[g])
    return reach
