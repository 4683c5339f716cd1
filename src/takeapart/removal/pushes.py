"""Ways out that are not straight: a few pushes and turns, each until something stops it, or the turns of a thread.

Pushes are searched best first, those with the fewest first: where a part stops is where the next channel begins, as
with a bayonet or a slide around a corner, so few poses are worth a look.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from takeapart.collision.contact import MARGIN, Contacts
from takeapart.collision.fields import Field, least_distance
from takeapart.collision.screws import Screw
from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Array, pose_inverse

MOST_POSES = 24  # of a part that are looked at
MOST_PUSHES = 4
LEAST_PUSH = 1e-3  # m; a push that goes no further leads nowhere
BACK = 2e-4  # m, by which a push ends before what stops it
SAME_PLACE, SAME_TURN = 1e-3, math.radians(3)  # poses that differ by less are one
STOPS = 4  # of a push on its way, where a straight way out is looked for as well
POSE_STEP = math.radians(2)  # between the poses of a turn that is handed on


@dataclass(frozen=True)
class Way:
    """A motion that frees a part.

    Args:
        poses: (K, 4, 4) T_world_part, the first as assembled, the last where the straight way out begins.
        direction: (3,) of the straight way out.
    """

    poses: Array
    direction: Array


def pushed_free(
    assembly: Assembly,
    contacts: Contacts,
    part: int,
    others: Sequence[int],
    obstacles: Sequence[Field],
    directions: Sequence[Array],
    is_free: Callable[[Array, Array], bool],
) -> Way | None:
    """Pushes that bring a part to where it leaves straight; None where none are found.

    Args:
        others: parts that stand in the way.
        obstacles: boxes of the environment, in the world; the part may lie on them.
        directions: (3,) unit vectors along which the part is pushed and may leave.
        is_free: whether the part leaves straight from a pose (4, 4) along a direction.
    """
    start = assembly.parts[part].T_world_part
    body = assembly.parts[part].shape.bounding_box()
    reach = float(np.linalg.norm(body.half_extents))
    axes = body.moved(start).T_frame_box[:3, :3]
    longest = 4 * reach
    queue: list[tuple[int, int, Array, list[Array]]] = [(0, 0, start, [start])]
    seen = [start]
    count, looked_at = 0, 0
    while queue and looked_at < MOST_POSES:
        pushes, _, T, path = heapq.heappop(queue)
        looked_at += 1
        middle = T[:3, :3] @ body.T_frame_box[:3, 3] + T[:3, 3]
        for screw, length, lever in _moves(axes, middle, longest, reach):
            stopped = stop(assembly, contacts, part, T, others, obstacles, screw, length)
            stopped = length if stopped >= length else stopped - BACK / lever
            if stopped * lever < LEAST_PUSH:
                continue
            for k in range(STOPS, 0, -1):
                s = stopped * k / STOPS
                reached = screw.pose(s) @ T
                if any(_same(reached, other) for other in seen):
                    continue
                seen.append(reached)
                way = [*path, *_between(screw, s, T)]
                for direction in directions:
                    if is_free(reached, direction):
                        return Way(np.array(way), direction)
                if pushes + 1 < MOST_PUSHES and k == STOPS:
                    count += 1
                    heapq.heappush(queue, (pushes + 1, count, reached, way))
    return None


def unscrewed(
    assembly: Assembly,
    contacts: Contacts,
    part: int,
    others: Sequence[int],
    obstacles: Sequence[Field],
    is_free: Callable[[Array, Array], bool],
) -> Way | None:
    """Turns along a thread with a known pitch until the part leaves straight along it; None where there is none."""
    name = assembly.parts[part].name
    start = assembly.parts[part].T_world_part
    for joint in assembly.joints:
        if joint.kind != "screw" or joint.pitch == 0.0 or name not in (joint.first, joint.second):
            continue
        outward = joint.axis if name == joint.second else -joint.axis
        turn = math.copysign(2 * math.pi, joint.pitch)
        screw = Screw(outward * abs(joint.pitch), turn, outward, joint.points.mean(axis=0))
        most = 4 * float(np.linalg.norm(assembly.parts[part].shape.bounding_box().half_extents)) / abs(joint.pitch)
        stopped = stop(assembly, contacts, part, start, others, obstacles, screw, most)
        for turns in np.arange(0.25, stopped, 0.25).tolist():
            if is_free(screw.pose(turns) @ start, outward):
                return Way(np.array([start, *_between(screw, turns, start)]), outward)
    return None


def stop(
    assembly: Assembly,
    contacts: Contacts,
    part: int,
    T: Array,
    others: Sequence[int],
    obstacles: Sequence[Field],
    screw: Screw,
    length: float,
) -> float:
    """How far, in the parameter of a motion, a part goes from a pose until it meets one of others."""
    body = contacts.body(part)
    nearest = length
    for other in others:
        theirs, T_other = contacts.body(other), assembly.parts[other].T_world_part
        kept = -contacts.tolerance(part, other)
        back = pose_inverse(T_other)
        points = _placed(body.points, back @ T)
        nearest = screw.seen_from(back).travel(theirs.field, points, nearest, kept)
        mine = pose_inverse(T)
        came = screw.seen_from(mine).backwards()
        nearest = came.travel(body.field, _placed(theirs.points, mine @ T_other), nearest, kept)
    for box in obstacles:
        points = _placed(body.points, T)
        nearest = screw.travel(box, points, nearest, min(0.0, least_distance(box, points)) - MARGIN)
    return nearest


def _placed(points: Array, T: Array) -> Array:
    return np.ascontiguousarray(points @ T[:3, :3].T + T[:3, 3])


def _moves(axes: Array, middle: Array, longest: float, reach: float) -> list[tuple[Screw, float, float]]:
    """Pushes along and turns about the axes (columns) both ways: the motion, how far it may go, and m for s = 1."""
    found = []
    for axis in np.hstack([axes, -axes]).T:
        found.append((Screw(axis, 0.0, axis, middle), longest, 1.0))
        found.append((Screw(np.zeros(3), 1.0, axis, middle), math.pi, reach))
    return found


def _between(screw: Screw, s: float, T: Array) -> list[Array]:
    """Poses of a motion from T, without the first one."""
    steps = max(1, math.ceil(abs(screw.turn) * s / POSE_STEP))
    return [screw.pose(s * k / steps) @ T for k in range(1, steps + 1)]


def _same(a: Array, b: Array) -> bool:
    turn = (np.trace(a[:3, :3].T @ b[:3, :3]) - 1) / 2
    return float(np.linalg.norm(a[:3, 3] - b[:3, 3])) < SAME_PLACE and turn > math.cos(SAME_TURN)
