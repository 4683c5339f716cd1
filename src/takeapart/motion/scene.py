"""A planning situation, and the proof that a piece of motion in it is free."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from takeapart.compilation import compiled_apart, compiled_lean
from takeapart.robot.arrays import ArmArrays, Flags, Floats, HeldArrays, Integers, Workspace, WorldArrays
from takeapart.robot.kernels import FREE, LARGEST_MARGIN, check, placed
from takeapart.robot.kinematics import forward, place, set_motion, set_still

MAXIMUM_PIECES = 256  # pieces of an edge that are looked at in bisection order
PIECE_TURN = 0.3  # rad, sum over the joints: in larger pieces the bound on the motion exceeds the motion by far

PROVED, SMALL, OPEN, HIT = 0, 1, 2, 3


class Scene(NamedTuple):
    """One planning situation: arm, what it carries, what stands around, and scratch memory."""

    arm: ArmArrays
    held: HeldArrays
    world: WorldArrays
    present: Flags  # (parts + 1,) owners of world boxes that count
    padding: float  # m
    step: float  # m, pieces in which nothing moves more than this are judged by their middle
    work: Workspace
    J: Floats  # (6, n) scratch
    q: Floats  # (n,) rad, scratch
    ends: Floats  # (2, n) rad, scratch
    doubtful: Integers  # (MAXIMUM_PIECES,) scratch


def new_scene(
    arm: ArmArrays, held: HeldArrays, world: WorldArrays, present: Flags, padding: float, step: float, work: Workspace
) -> Scene:
    """A planning situation with scratch memory of its own."""
    n = len(arm.lower)
    scratch = np.zeros((6, n)), np.zeros(n), np.zeros((2, n)), np.zeros(MAXIMUM_PIECES, np.int32)
    return Scene(arm, held, world, present, padding, step, work, *scratch)


@compiled_lean
def is_free(scene: Scene, q: Floats) -> bool:
    """Whether a configuration touches nothing."""
    return check(scene.arm, scene.held, scene.world, scene.present, scene.padding, q, scene.work) == FREE


@compiled_lean
def still_free(scene: Scene) -> bool:
    """Whether the configuration placed last is free, or the motion set around it."""
    return placed(scene.arm, scene.held, scene.world, scene.present, scene.padding, scene.work) == FREE


@compiled_lean
def motion_bound(scene: Scene, a: Floats, b: Floats) -> float:
    """How far any point of arm and load moves at most between two configurations, m."""
    place(scene.arm, scene.held, a, scene.work)
    return max(set_motion(scene.arm, scene.held, a, b, 1.0, scene.work), scene.work.group_margin[1])


@compiled_lean
def piece_count(scene: Scene, a: Floats, b: Floats, spacing: float) -> int:
    """Into how many pieces an edge is cut so that the tool moves about `spacing`, m, in each; a guess, no bound."""
    forward(scene.arm, b, scene.work)
    x, y, z = scene.work.p_tool[0], scene.work.p_tool[1], scene.work.p_tool[2]
    forward(scene.arm, a, scene.work)
    x, y, z = x - scene.work.p_tool[0], y - scene.work.p_tool[1], z - scene.work.p_tool[2]
    turn = 0.0
    for j in range(len(a)):
        turn += abs(b[j] - a[j])
    return max(1, math.ceil(math.sqrt(x * x + y * y + z * z) / spacing), math.ceil(turn / PIECE_TURN))


@compiled_lean
def set_piece(scene: Scene, a: Floats, b: Floats, first: float, last: float) -> float:
    """Places the middle of the piece of an edge between two shares of it, and sets the motion to either end of it.

    Returns:
        how far a body or a finger moves from there at most, m.
    """
    s = 0.5 * (first + last)
    for j in range(len(a)):
        scene.q[j] = a[j] + (b[j] - a[j]) * s
    place(scene.arm, scene.held, scene.q, scene.work)
    return set_motion(scene.arm, scene.held, a, b, 0.5 * (last - first), scene.work)


@compiled_apart
def look_at(scene: Scene, a: Floats, b: Floats, first: float, last: float) -> int:
    """One look at the middle of a piece: the whole piece is free, or only its middle is, or not even that."""
    moved = set_piece(scene, a, b, first, last)
    if moved <= LARGEST_MARGIN and still_free(scene):
        return PROVED
    largest = max(moved, scene.work.group_margin[1])
    set_still(scene.work)
    if not still_free(scene):
        return HIT
    return SMALL if 2.0 * largest <= scene.step else OPEN


@compiled_apart
def piece_free(scene: Scene, a: Floats, b: Floats) -> bool:
    """Whether the straight joint-space motion between two configurations is free.

    A piece is accepted with one look: if its middle stays free when everything is padded by as much as it can move
    from there to the ends of the piece, the whole piece is free. Otherwise it is halved, until nothing moves more than
    the scene's step in it.
    """
    pieces, k = 1, 0
    while True:
        seen = look_at(scene, a, b, k / pieces, (k + 1) / pieces)
        if seen == HIT:
            return False
        if seen == OPEN:
            k *= 2
            pieces *= 2
            continue
        k += 1
        while k % 2 == 0 and pieces > 1:
            k //= 2
            pieces //= 2
        if k == pieces:
            return True
