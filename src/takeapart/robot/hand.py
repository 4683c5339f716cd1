"""Compiled tests of the hand alone: what gripper, wrist and load would touch in a grasp, whatever the arm does."""

from __future__ import annotations

from takeapart.compilation import compiled_lean
from takeapart.robot.arrays import ArmArrays, Flags, Floats, HeldArrays, Workspace, WorldArrays
from takeapart.robot.grid import boxes_meet, mark_line
from takeapart.robot.kernels import body_hits_world, held_hits_world
from takeapart.robot.kinematics import place_bodies, place_groups, place_held, set_still
from takeapart.robot.separation import body_meets_box


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
    place_groups(held, work)
    place_bodies(arm, work)  # only those of the last frame stand where they should
    set_still(work)
    held_hits_world(arm, held, world, present, padding, work, hits, True)
    for b in range(len(arm.body_frame)):
        if arm.body_frame[b] == n:
            body_hits_world(arm, world, present, padding, work, hits, True, b)


@compiled_lean
def hand_hits_load(arm: ArmArrays, held: HeldArrays, padding: float, work: Workspace) -> bool:
    """Whether palm, wrist or fingers touch what they must not touch of the carried part.

    That is the whole part for palm, wrist and knuckles, and the walls of its connectors for the pads. It is the same at
    every configuration. Needs `collect_hand` first.
    """
    n = len(arm.lower)
    for b in range(len(arm.body_frame)):
        if arm.body_frame[b] == n:
            for h in range(held.group[1], held.group[2]):
                if body_meets_box(arm, b, work.box_center, work.box_axes, held.half, h, padding, work):
                    return True
    for f in range(held.group[0], held.group[1]):
        for h in range(held.group[1] if f >= held.first_knuckle else held.first_wall, held.group[2]):
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
def move_load(load: HeldArrays, T: Floats, moved: HeldArrays) -> None:
    """Writes to `moved` the load with its part (not its fingers) moved by a pose (4, 4) in the tool frame."""
    first = load.group[1]
    for h in range(len(load.half)):
        _move(load.center, h, T, h >= first, moved.center)
        _turn(load.axes, h, T, h >= first, moved.axes)
    for c in range(len(load.probe_radius)):
        _move(load.probe_center, c, T, load.probe_box[c] >= first, moved.probe_center)
    for g in range(2):
        _move(load.group_center, g, T, g == 1, moved.group_center)
        _turn(load.group_axes, g, T, g == 1, moved.group_axes)


@compiled_lean
def _move(points: Floats, k: int, T: Floats, moves: bool, moved: Floats) -> None:
    x, y, z = points[k, 0], points[k, 1], points[k, 2]
    for i in range(3):
        moved[k, i] = T[i, 0] * x + T[i, 1] * y + T[i, 2] * z + T[i, 3] if moves else points[k, i]


@compiled_lean
def _turn(axes: Floats, k: int, T: Floats, moves: bool, moved: Floats) -> None:
    for a in range(3):
        x, y, z = axes[k, a, 0], axes[k, a, 1], axes[k, a, 2]
        for i in range(3):
            moved[k, a, i] = T[i, 0] * x + T[i, 1] * y + T[i, 2] * z if moves else axes[k, a, i]


@compiled_lean
def _carry(M: Floats, T: Floats) -> None:
    """Moves a pose T (4, 4) by a motion of the world (3, 4), in place."""
    for j in range(4):
        x, y, z = T[0, j], T[1, j], T[2, j]
        for i in range(3):
            T[i, j] = M[i, 0] * x + M[i, 1] * y + M[i, 2] * z + (M[i, 3] if j == 3 else 0.0)


@compiled_lean
def hand_masks(
    arm: ArmArrays,
    load: HeldArrays,
    world: WorldArrays,
    present: Flags,
    padding: float,
    clearance: float,
    lift: Floats,
    T_world_tool: Floats,
    T_tool_part: Floats,
    goal: Floats,
    radius: float,
    scratch: HeldArrays,
    work: Workspace,
    hits: Flags,
    lines: Flags,
) -> None:
    """What hand and load touch in every one of K grasps, at the start without the part, at the end of its exit with it.

    Args:
        load: fingers, and the part with its own frame for the tool's.
        clearance: from the load itself, m.
        lift: (3, 4) motion of the world that takes the part from its place to where it is clear.
        T_world_tool: (K, 4, 4) at the start; overwritten.
        T_tool_part: (K, 4, 4).
        goal: (3,) m; a ball of the radius, m, moves there straight from the lifted tool.
        scratch: a load of the same size.
        hits: (K, parts + 1) owners touched; the last stands for what never leaves, and for the load itself.
        lines: (K, parts + 1) owners that the ball touches.
    """
    first, last = load.group[1], len(load.half)
    fixed = hits.shape[1] - 1
    for k in range(len(T_world_tool)):
        move_load(load, T_tool_part[k], scratch)
        T = T_world_tool[k]
        for h in range(first, last):
            scratch.meets_world[h] = 0  # the part touches its neighbours until it is lifted
        collect_hand(arm, scratch, world, present, padding, T, work, hits[k])
        for h in range(first, last):
            scratch.meets_world[h] = 1
        _carry(lift, T)
        collect_hand(arm, scratch, world, present, padding, T, work, hits[k])
        if hand_hits_load(arm, scratch, clearance, work):
            hits[k, fixed] = 1
        mark_line(world, T[:3, 3], goal, radius, lines[k])
