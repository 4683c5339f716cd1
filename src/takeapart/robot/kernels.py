"""Compiled collision tests of arm and held part with the world and with the arm itself.

A configuration is placed first (`kinematics.place`). Each test can then be asked of the configuration alone, or of a
whole piece of motion around it: then everything is padded by as much as it can move (`kinematics.set_motion`), so that
what is free stays free all along the piece. Nothing here allocates, and the interpreter lock is released.
"""

from __future__ import annotations

from takeapart.compilation import compiled_apart, compiled_lean
from takeapart.robot.arrays import (
    CLEARED,
    FIELD_STEP,
    TABLE_UNIT,
    ArmArrays,
    Flags,
    Floats,
    HeldArrays,
    Integers,
    Workspace,
    WorldArrays,
)
from takeapart.robot.grid import ball_meets_box, boxes_meet, cell_of, is_far, row_for
from takeapart.robot.kinematics import (
    motion_of_ball,
    place,
    place_box,
    place_group,
    place_spheres,
    set_still,
)
from takeapart.robot.separation import bodies_meet, body_meets_box

FREE, HIT_WORLD, HIT_SELF = 0, 1, 2
LARGEST_MARGIN = 0.05  # m; what moves further in one piece of motion counts as touching


@compiled_lean
def held_hits_world(
    arm: ArmArrays,
    held: HeldArrays,
    world: WorldArrays,
    present: Flags,
    padding: float,
    work: Workspace,
    hits: Flags,
    collect: bool,
) -> bool:
    """Whether the load touches the world."""
    R, p = work.R_tool, work.p_tool
    found = False
    n = len(arm.lower)
    far0 = is_far(world, work.group, 0, held.group_radius[0] + padding + work.group_margin[0])
    far1 = is_far(world, work.group, 1, held.group_radius[1] + padding + work.group_margin[1])
    if far0 and far1:
        return False
    moving = work.group_margin[1] > 0.0
    o = held.probe_center
    for c in range(len(held.probe_radius)):
        h = held.probe_box[c]
        if (far0 if h < held.group[1] else far1) or not held.meets_world[h]:
            continue
        x = R[0, 0] * o[c, 0] + R[0, 1] * o[c, 1] + R[0, 2] * o[c, 2] + p[0]
        y = R[1, 0] * o[c, 0] + R[1, 1] * o[c, 1] + R[1, 2] * o[c, 2] + p[1]
        z = R[2, 0] * o[c, 0] + R[2, 1] * o[c, 1] + R[2, 2] * o[c, 2] + p[2]
        grown = padding
        if moving:
            margin = motion_of_ball(work, n, 0, x, y, z, held.probe_radius[c])
            if margin > LARGEST_MARGIN:
                return True
            grown += margin
        cell = cell_of(world, x, y, z)
        r = held.probe_radius[c] + grown
        if cell < 0 or world.field[cell] * FIELD_STEP > r:
            continue
        row = row_for(world, r)
        placed = False
        for e in range(world.start[row, cell], world.start[row, cell + 1]):
            w = world.entry[e]
            owner = world.owner[w]
            if not present[owner] or (collect and hits[owner]):
                continue
            if not ball_meets_box(x, y, z, r, world.center, world.axes, world.half, w):
                continue
            if not placed:
                place_box(held, work, h)
                placed = True
            if boxes_meet(
                work.box_center[h],
                work.box_axes[h],
                held.half[h],
                world.center[w],
                world.axes[w],
                world.half[w],
                grown,
            ):
                if not collect:
                    return True
                hits[owner] = 1
                found = True
    return found


@compiled_lean
def _arm_hits_world(
    arm: ArmArrays, world: WorldArrays, present: Flags, padding: float, work: Workspace, hits: Flags, collect: bool
) -> bool:
    """Bodies far from the base come first: they are the likely ones. What stands with the base may touch the world."""
    found = False
    for b in range(len(arm.body_frame) - 1, arm.first_moving - 1, -1):
        if body_hits_world(arm, world, present, padding + work.margin[b], work, hits, collect, b):
            if not collect:
                return True
            found = True
    return found


@compiled_lean
def body_hits_world(
    arm: ArmArrays,
    world: WorldArrays,
    present: Flags,
    padding: float,
    work: Workspace,
    hits: Flags,
    collect: bool,
    b: int,
) -> bool:
    """Whether a body of the arm touches the world; the padding holds its margin."""
    if is_far(world, work.body, b, arm.body_radius[b] + padding):
        return False
    found = False
    cleared = 0
    place_spheres(arm, work, b)
    for s in range(arm.body_start[b], arm.body_start[b + 1]):
        x, y, z = work.x[s], work.y[s], work.z[s]
        cell = cell_of(world, x, y, z)
        r = arm.sphere_radius[s] + padding
        if cell < 0 or world.field[cell] * FIELD_STEP > r:
            continue
        row = row_for(world, r)
        for e in range(world.start[row, cell], world.start[row, cell + 1]):
            w = world.entry[e]
            owner = world.owner[w]
            if not present[owner] or (collect and hits[owner]):
                continue
            if not ball_meets_box(x, y, z, r, world.center, world.axes, world.half, w):
                continue
            if _is_among(work.cleared, cleared, w):
                continue
            if not body_meets_box(arm, b, world.center, world.axes, world.half, w, padding, work):
                work.cleared[cleared % CLEARED] = w
                cleared += 1
                continue
            if not collect:
                return True
            hits[owner] = 1
            found = True
    return found


@compiled_lean
def _is_among(boxes: Integers, count: int, w: int) -> bool:
    found = False
    for k in range(min(count, CLEARED)):
        found |= boxes[k] == w
    return found


@compiled_lean
def _hits_itself(arm: ArmArrays, held: HeldArrays, padding: float, work: Workspace) -> bool:
    """Arm against itself and against what it holds. Motion counts as each sees the other move."""
    n = len(arm.lower)
    for k in range(len(arm.near_start)):
        if near_pair_distance(arm, k, work) <= padding:
            return True
    for k in range(len(arm.self_pairs)):
        a, b = arm.self_pairs[k, 0], arm.self_pairs[k, 1]
        x, y, z = work.body[b, 0], work.body[b, 1], work.body[b, 2]
        dx, dy, dz = work.body[a, 0] - x, work.body[a, 1] - y, work.body[a, 2] - z
        near = arm.body_radius[a] + arm.body_radius[b] + padding
        if dx * dx + dy * dy + dz * dz > (near + work.margin[a] + work.margin[b]) ** 2:
            continue
        frame, seen_from = int(arm.body_frame[b]), int(arm.body_frame[a])
        grown = padding
        if work.group_margin[1] > 0.0:
            grown += motion_of_ball(work, frame, seen_from, x, y, z, arm.body_radius[b])
        if _bodies_touch(arm, a, b, grown, work):
            return True
    for g in range(2):  # the fingers, then the part: a ball around each first, then a box, then each box
        if held.group[g] == held.group[g + 1]:
            continue
        placed = False
        gx, gy, gz = work.group[g, 0], work.group[g, 1], work.group[g, 2]
        for k in range(len(arm.held_bodies)):
            b = arm.held_bodies[k]
            x, y, z = work.body[b, 0], work.body[b, 1], work.body[b, 2]
            r = arm.body_radius[b] + padding
            dx, dy, dz = x - gx, y - gy, z - gz
            near = r + held.group_radius[g] + work.margin[b] + work.group_margin[g]
            if dx * dx + dy * dy + dz * dz > near * near:
                continue
            margin = 0.0
            if work.group_margin[1] > 0.0:
                margin = motion_of_ball(work, n, int(arm.body_frame[b]), gx, gy, gz, held.group_radius[g])
            if not placed:
                place_group(held, work, g)
                placed = True
            if ball_meets_box(
                x, y, z, r + margin, work.group, work.group_axes, held.group_half, g
            ) and _body_meets_group(arm, held, b, g, padding + margin, work):
                return True
    return False


@compiled_lean
def near_pair_distance(arm: ArmArrays, k: int, work: Workspace) -> float:
    """Distance that the bodies of near pair k keep at least, m, at the configuration placed last and all through the
    motion that was set around it; negative where nothing is proved.
    """
    node, lost = 0, 0.0
    for side in range(2):
        joint = arm.near_joints[k, side]
        size = arm.near_shape[k, side]
        share = (work.q[joint] - arm.near_lower[k, side]) / arm.near_step[k, side]
        nearest = int(min(max(share + 0.5, 0.0), size - 1.0))
        lost += arm.near_reach[k, side] * (abs(share - nearest) * arm.near_step[k, side] + work.turn[joint])
        node = node * size + nearest
    return arm.near_distance[arm.near_start[k] + node] * TABLE_UNIT - lost


@compiled_lean
def _bodies_touch(arm: ArmArrays, a: int, b: int, padding: float, work: Workspace) -> bool:
    place_spheres(arm, work, a)
    place_spheres(arm, work, b)
    x, y, z, radius = work.x, work.y, work.z, arm.sphere_radius
    bx, by, bz = work.body[b, 0], work.body[b, 1], work.body[b, 2]
    for s in range(arm.body_start[a], arm.body_start[a + 1]):
        cx, cy, cz, r = x[s], y[s], z[s], radius[s] + padding
        if (cx - bx) ** 2 + (cy - by) ** 2 + (cz - bz) ** 2 > (r + arm.body_radius[b]) ** 2:
            continue
        touching = 0
        for t in range(arm.body_start[b], arm.body_start[b + 1]):
            dx, dy, dz, limit = x[t] - cx, y[t] - cy, z[t] - cz, r + radius[t]
            touching |= dx * dx + dy * dy + dz * dz <= limit * limit
        if touching:
            return bodies_meet(arm, a, b, padding, work)
    return False


@compiled_lean
def _body_meets_group(arm: ArmArrays, held: HeldArrays, b: int, g: int, padding: float, work: Workspace) -> bool:
    place_spheres(arm, work, b)
    x, y, z, r = work.body[b, 0], work.body[b, 1], work.body[b, 2], arm.body_radius[b] + padding
    for h in range(held.group[g], held.group[g + 1]):
        place_box(held, work, h)
        if not ball_meets_box(x, y, z, r, work.box_center, work.box_axes, held.half, h):
            continue
        if _spheres_meet_box(arm, b, work.box_center, work.box_axes, held.half, h, padding, work) and body_meets_box(
            arm, b, work.box_center, work.box_axes, held.half, h, padding, work
        ):
            return True
    return False


@compiled_lean
def _spheres_meet_box(
    arm: ArmArrays, b: int, center: Floats, axes: Floats, half: Floats, w: int, padding: float, work: Workspace
) -> bool:
    for s in range(arm.body_start[b], arm.body_start[b + 1]):
        if ball_meets_box(work.x[s], work.y[s], work.z[s], arm.sphere_radius[s] + padding, center, axes, half, w):
            return True
    return False


@compiled_apart
def placed(
    arm: ArmArrays, held: HeldArrays, world: WorldArrays, present: Flags, padding: float, work: Workspace
) -> int:
    """Collision of the configuration that was placed, or of the motion that was set around it; see `check`."""
    if held_hits_world(arm, held, world, present, padding, work, present, False):
        return HIT_WORLD
    if _arm_hits_world(arm, world, present, padding, work, present, False):
        return HIT_WORLD
    return HIT_SELF if _hits_itself(arm, held, padding, work) else FREE


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
    place(arm, held, q, work)
    set_still(work)
    return placed(arm, held, world, present, padding, work)


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
    place(arm, held, q, work)
    set_still(work)
    return collect_placed(arm, held, world, present, padding, work, hits)


@compiled_apart
def collect_placed(
    arm: ArmArrays,
    held: HeldArrays,
    world: WorldArrays,
    present: Flags,
    padding: float,
    work: Workspace,
    hits: Flags,
) -> bool:
    """As `collect`, for the configuration that was placed, or the motion that was set around it.

    The motion may take nothing further than LARGEST_MARGIN.
    """
    held_hits_world(arm, held, world, present, padding, work, hits, True)
    _arm_hits_world(arm, world, present, padding, work, hits, True)
    return not _hits_itself(arm, held, padding, work)
