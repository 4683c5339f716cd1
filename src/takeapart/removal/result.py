"""What a removal query returns: a removal, or a typed refusal."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from takeapart.model.geometry import Array
from takeapart.model.plan import Grasp

Stage = Literal["stability", "lift", "grasp", "ik", "path"]
STAGES: tuple[Stage, ...] = ("stability", "lift", "grasp", "ik", "path")


@dataclass(frozen=True, eq=False)
class Removal:
    """A way to take one part away.

    Args:
        part: number of the part.
        grasp: where and how the gripper holds it.
        joint_path: (M, n) joint angles, rad, from the grasp to the goal, lift included.
        tool_path: (M, 7) poses of the tool at the same rows: x, y, z, m, and the quaternion w, x, y, z; world frame.
        length: of the tool path, m (Eq. 2).
        blockers: state of the parts that the whole motion would hit; valid in every state that shares no part with it.
    """

    part: int
    grasp: Grasp
    joint_path: Array
    tool_path: Array
    length: float
    blockers: int

    def valid_in(self, state: int) -> bool:
        """Whether the motion is free of collisions in a state."""
        return not self.blockers & state


@dataclass(frozen=True)
class Blocked:
    """Why a part cannot leave, as far as the planner can tell.

    Args:
        part: number of the part.
        stage: the furthest stage that was reached.
        blamed: state of the parts that stand in the way; 0 where only fixed parts, environment or reach do.
    """

    part: int
    stage: Stage
    blamed: int


class OutOfTimeError(Exception):
    """Leaves a query whose time is over: it has no answer, and nothing of it is kept. No search lets it out."""


def never() -> bool:
    """Time is not limited."""
    return False


@dataclass(frozen=True)
class Effort:
    """How hard to try.

    Args:
        attempts: how often the removal is planned, with different random seeds; the shortest is kept (k of Sec. V-B).
        shorter_than: only a removal shorter than this is of interest, m.
        fresh: ignore the removal library and keep nothing in it (the paper's simulation step).
        is_late: whether the time is over; looked at again and again while the removal is planned. What it cuts off is
            no refusal: the query raises OutOfTimeError.
    """

    attempts: int = 1
    shorter_than: float = math.inf
    fresh: bool = False
    is_late: Callable[[], bool] = field(default=never, compare=False, repr=False)


@dataclass
class Counts:
    """Calls of the planner: the cost at which searches are compared.

    Args:
        motion_plans: calls of a path planner for one grasp.
        removal_queries: best removal of one part in one state, over all grasps.
    """

    motion_plans: int = 0
    removal_queries: int = 0
