"""Ways out that are not straight: a few pushes and turns, each until something stops it, or the turns of a thread.

Pushes are searched best first, those with the fewest first: where a part stops is where the next channel begins, as
with a bayonet or a slide around a corner, so few poses are worth a look.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from takeapart.collision.screws import Screw
from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Array
from takeapart.removal.stand import Stand
from takeapart.removal.surroundings import Surroundings

MOST_POSES = 24  # of a part that are looked at
MOST_PUSHES = 4
LEAST_PUSH = 1e-3  # m; a push that goes no further leads nowhere
BACK = 2e-4  # m, by which a push ends before what stops it
SAME_PLACE, SAME_TURN = 1e-3, math.radians(3)  # poses that differ by less are one
STOPS = 4  # of a push on its way, where a straight way out is looked for as well
POSE_STEP = math.radians(2)  # between the poses of a turn that is handed on

Out = TypeVar("Out")


@dataclass(frozen=True)
class Way:
    """A motion after which a part may leave straight.

    Args:
        poses: (K, 4, 4) T_world_part, the first as assembled, without the last.
        end: (4, 4) where the straight way out begins.
        direction: (3,) of the straight way out.
        turns: whether it goes along a thread.
    """

    poses: Array
    end: Array
    direction: Array
    turns: bool = False


class Pushes:
    """Pushes that bring a part to where it leaves straight.

    Args:
        surroundings: of the product.
        part: its number.
        others: bodies that stand in the way; the part may touch what it touches as drawn.
        directions: (3,) unit vectors along which the part may leave.

    Attributes:
        count: pushes that were tried so far.
    """

    def __init__(
        self, surroundings: Surroundings, part: int, others: Sequence[int], directions: Sequence[Array]
    ) -> None:
        self._around, self._part, self._others, self._directions = surroundings, part, others, directions
        self.count = 0

    def free(self, out: Callable[[Way], Out | None]) -> Out | None:
        """What `out` makes of the first way that it takes; None where it takes none of those that were tried."""
        body = self._around.assembly.parts[self._part]
        start, box = body.T_world_part, body.shape.bounding_box()
        reach = float(np.linalg.norm(box.half_extents))
        axes = box.moved(start).T_frame_box[:3, :3]
        longest = 4 * reach
        queue: list[tuple[int, int, Array, list[Array]]] = [(0, 0, start, [start])]
        seen = [start]
        queued, looked_at = 0, 0
        while queue and looked_at < MOST_POSES:
            pushes, _, T, path = heapq.heappop(queue)
            looked_at += 1
            stand, middle = Stand(self._around, self._part, T), T[:3, :3] @ box.T_frame_box[:3, 3] + T[:3, 3]
            for screw, length, lever in _moves(axes, middle, longest, reach):
                self.count += 1
                stopped = stand.stop(screw, length, self._others)
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
                    poses = np.array(way[:-1])
                    for direction in self._directions:
                        found = out(Way(poses, reached, direction))
                        if found is not None:
                            return found
                    if pushes + 1 < MOST_PUSHES and k == STOPS:
                        queued += 1
                        heapq.heappush(queue, (pushes + 1, queued, reached, way))
        return None


def unscrewed(assembly: Assembly, stand: Stand, others: Sequence[int], out: Callable[[Way], Out | None]) -> Out | None:
    """What `out` makes of the turns along a thread with a known pitch after which the part leaves straight along it;
    None where there are none."""
    part, start = stand.part, stand.T
    name = assembly.parts[part].name
    for joint in assembly.joints:
        if joint.kind != "screw" or joint.pitch == 0.0 or name not in (joint.first, joint.second):
            continue
        outward = joint.axis if name == joint.second else -joint.axis
        turn = math.copysign(2 * math.pi, joint.pitch)
        screw = Screw(outward * abs(joint.pitch), turn, outward, joint.points.mean(axis=0))
        most = 4 * float(np.linalg.norm(assembly.parts[part].shape.bounding_box().half_extents)) / abs(joint.pitch)
        stopped = stand.stop(screw, most, others)
        for turns in np.arange(0.25, stopped, 0.25).tolist():
            *poses, end = [start, *_between(screw, turns, start)]
            found = out(Way(np.array(poses), end, outward, turns=True))
            if found is not None:
                return found
    return None


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
