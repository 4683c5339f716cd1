"""One part in one state, as a query sees it: what does not depend on chance is found once, however often it plans."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from takeapart.model.geometry import Array
from takeapart.motion.legs import one_leg
from takeapart.motion.scene import Scene, new_scene
from takeapart.removal.goals import GoalConfigurations, Neighbours
from takeapart.removal.reach import Hand, LiftBranch, Reach
from takeapart.removal.result import OutOfTimeError, never
from takeapart.robot.arrays import Flags, Workspace, WorldArrays
from takeapart.robot.kinematics import tool_steps
from takeapart.robot.model import RobotModel


class Situation:
    """A part to be removed, and what stands around.

    Args:
        part: its number.
        others: the parts that stand around.
        present: the same as flags (parts + 1,).
        world: with the clearance field of that state.
        padding: distance kept, m.
        step: see `Scene`, m.
        work: of the thread that plans.
        is_late: whether the time is over.

    Attributes:
        motion_plans: calls of a path planner for one grasp so far.
    """

    def __init__(
        self,
        robot: RobotModel,
        reach: Reach,
        goals: GoalConfigurations,
        part: int,
        others: int,
        present: Flags,
        world: WorldArrays,
        padding: float,
        step: float,
        work: Workspace,
        is_late: Callable[[], bool] = never,
    ) -> None:
        self.robot, self.reach, self.goals, self.part, self.others = robot, reach, goals, part, others
        self.present, self.world, self.padding, self.step, self.work = present, world, padding, step, work
        self.motion_plans = 0
        self._is_late = is_late
        self._scenes: dict[int, Scene] = {}
        self._branches: dict[int, tuple[LiftBranch, ...]] = {}
        self._free_goals: dict[tuple[int, int], Array] = {}
        self._straight_legs: dict[tuple[int, int, float], Array] = {}

    def look_at_clock(self) -> None:
        """Raises OutOfTimeError if the time is over; stands before whatever may take some milliseconds."""
        if self._is_late():
            raise OutOfTimeError

    @cached_property
    def hands(self) -> tuple[Hand, ...]:
        """All grasps of the part; elsewhere they go by their numbers in this order."""
        self.look_at_clock()
        return self.reach.hands(self.part, self.work)

    @property
    def steepest_first(self) -> list[int]:
        """Numbers of the grasps, those from above first."""
        return self.reach.steepest_first(self.part, self.work)

    def branches(self, number: int) -> tuple[LiftBranch, ...]:
        """The arm's ways to hold and lift the part with a grasp in this state."""
        if number not in self._branches:
            self.look_at_clock()
            self._branches[number] = self.reach.branches(self.part, number, self.others, self.work)
        return self._branches[number]

    def lifted(self, number: int) -> Array:
        """Where these ways end, (A, n), rad; there must be one."""
        return self._near(number).lifted

    def opening(self, number: int) -> float:
        """Of the fingers in a grasp, m."""
        return self.hands[number].candidate.width

    def _near(self, number: int) -> Neighbours:
        return self.goals.neighbours(self.branches(number), self.work, self.opening(number))

    def scene(self, number: int) -> Scene:
        """The planning situation of the kernels, with a grasp in the hand."""
        if number not in self._scenes:
            held = self.hands[number].held
            arm = self.robot.arm_at(self.opening(number))
            self._scenes[number] = new_scene(arm, held, self.world, self.present, self.padding, self.step, self.work)
        return self._scenes[number]

    def is_line_open(self, number: int) -> bool:
        """Whether a ball in the held part can pass on the straight line to the goal."""
        line = self.hands[number].line
        return line is not None and not line & self.others

    def straight_leg(self, number: int, attempts: int, spacing: float) -> Array:
        """Rows (M, n) of a tool-straight path to the goal with a grasp that has branches; (0, n) if there is none."""
        key = number, attempts, spacing
        if key not in self._straight_legs:
            self.look_at_clock()
            near, hand = self._near(number), self.hands[number]
            starts, ends = self.goals.free_pairs(near, self.part, hand, self.others, attempts, self.work)
            self._straight_legs[key] = one_leg(self.scene(number), starts, ends, spacing)
        return self._straight_legs[key]

    def free_goals(self, number: int, most: int) -> Array:
        """The free goal configurations (B, n) nearest to where the lifts with a grasp end."""
        key = number, most
        if key not in self._free_goals:
            self.look_at_clock()
            near, hand = self._near(number), self.hands[number]
            self._free_goals[key] = self.goals.free(near, self.part, hand, self.others, most, self.work)
        return self._free_goals[key]

    def tool_bend(self, number: int, rows: Array) -> float:
        """How much further the joints move the tool of a grasp than straight from row to row of (M, n), m.

        Halving the pieces leaves a quarter of it (a chord is shorter than its arc by the third power of its length), so
        what half as long pieces add is three quarters.
        """
        halved = np.empty((2 * len(rows) - 1, rows.shape[1]))
        halved[::2] = rows
        halved[1::2] = (rows[1:] + rows[:-1]) / 2
        return 4 / 3 * (self.tool_length(number, halved) - self.tool_length(number, rows))

    def tool_length(self, number: int, rows: Array) -> float:
        """Length, m, of the tool path (Eq. 2) of joint rows (M, n) with a grasp."""
        steps = np.empty(len(rows) - 1)
        tool_steps(self.robot.arm_at(self.opening(number)), rows, self.work, steps)
        return float(steps.sum())
