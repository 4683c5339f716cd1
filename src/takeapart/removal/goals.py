"""Configurations with the tool at the goal position: its orientation is free (Sec. IV-A), so there is a
four-dimensional set.

The tool's position does not depend on what it holds, so one sample serves every grasp of every part. Which of them are
near the ways to lift a part, and what the arm would hit there, is the same in every state: it is kept, the latter as
masks.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np

from takeapart.model.geometry import Array, pose
from takeapart.motion.blockers import configuration_blockers
from takeapart.motion.legs import joint_distances, near_pairs
from takeapart.motion.scene import new_scene
from takeapart.removal.masks import flags_of, owners_of
from takeapart.removal.reach import Hand, LiftBranch
from takeapart.robot.arrays import ArmArrays, Indices, Workspace, WorldArrays
from takeapart.robot.ik import InverseKinematics
from takeapart.robot.kernels import FREE, check
from takeapart.robot.model import RobotModel
from takeapart.workcell import Workcell

ORIENTATIONS = 240
GOALS_PER_LIFT = 4  # with which each lifted configuration is paired
LOOKED_AT = 32  # goal configurations that are judged at a time
KEPT_NEIGHBOURS = 4096  # sets of lifts


class Neighbours:
    """The goal configurations near some ways to lift a part, by their numbers; each answer is found when asked for.

    Args:
        arm: by whose limits a goal can be wound.
        lifted: (A, n) rad, where these lifts end.
        goals: (G, n) rad.
    """

    def __init__(self, arm: ArmArrays, lifted: Array, goals: Array) -> None:
        self._arm, self.lifted, self.goals = arm, lifted, goals

    @cached_property
    def pairs(self) -> Indices:
        """(P, 2) of a lifted configuration and a goal, see `near_pairs`."""
        return near_pairs(self._arm, self.lifted, self.goals, GOALS_PER_LIFT)

    @cached_property
    def closest(self) -> list[int]:
        """The LOOKED_AT goals nearest in joint space to any of the lifted configurations, and others as far as the last
        of them: the beginning of `order`.
        """
        if len(self.goals) <= LOOKED_AT:
            return self.order
        distances = joint_distances(self._arm, self.lifted, self.goals)
        near = np.flatnonzero(distances <= np.partition(distances, LOOKED_AT - 1)[LOOKED_AT - 1])
        closest: list[int] = near[np.argsort(distances[near], kind="stable")].tolist()
        return closest

    @cached_property
    def order(self) -> list[int]:
        """All goals, the nearest first; `closest` is mostly enough."""
        order: list[int] = np.argsort(joint_distances(self._arm, self.lifted, self.goals), kind="stable").tolist()
        return order


class GoalConfigurations:
    """Goal configurations of the bare arm, free of what never leaves; computed when first asked for.

    One set serves every opening of the fingers where the tool does not move with it; otherwise each has its own.

    Args:
        world: everything that can stand around.
        padding: distance kept, m.
        parts: of the assembly; the owner of what never leaves.
    """

    def __init__(
        self,
        workcell: Workcell,
        robot: RobotModel,
        ik: InverseKinematics,
        world: WorldArrays,
        padding: float,
        parts: int,
    ) -> None:
        self._goal, self._robot, self._ik, self._world, self._padding = workcell.goal, robot, ik, world, padding
        self._parts = parts
        self._found: dict[float, Array] = {}  # by opening
        self._neighbours: dict[tuple[LiftBranch, ...], Neighbours] = {}
        self._blockers: dict[Hand, dict[int, int]] = {}
        self._lock = threading.Lock()

    def solutions(self, opening: float = 0.0) -> Iterator[Array]:
        """Configurations (n,), rad, that put the tool at the goal at an opening of the fingers, m, whatever they
        hit.
        """
        for quaternion in super_fibonacci(ORIENTATIONS):
            for q in self._ik.solve(pose(self._goal, quaternion), opening):
                yield np.ascontiguousarray(q)

    def is_reached(self, work: Workspace) -> bool:
        """Whether there is any free configuration; looks no further than the first."""
        found = (next(self._solve(opening, work), None) for opening in self._robot.tool_openings)
        return any(q is not None for q in found)

    def all(self, work: Workspace, opening: float = 0.0) -> Array:
        """(G, n) rad, at an opening of the fingers, m."""
        key = opening if self._robot.tool_moves else 0.0
        with self._lock:
            if key not in self._found:
                self._found[key] = np.array(list(self._solve(key, work))).reshape(-1, self._robot.joints)
            return self._found[key]

    def neighbours(self, branches: tuple[LiftBranch, ...], work: Workspace, opening: float = 0.0) -> Neighbours:
        """Goal configurations near where these lifts of a part, at least one, end; all have one opening, m."""
        found = self._neighbours.get(branches)
        if found is None:
            goals, lifted = self.all(work, opening), np.array([branch.rows[-1] for branch in branches])
            found = Neighbours(self._robot.arm, lifted, goals)
            if len(self._neighbours) >= KEPT_NEIGHBOURS:
                self._neighbours.clear()
            self._neighbours[branches] = found
        return found

    def free(self, near: Neighbours, part: int, hand: Hand, others: int, most: int, work: Workspace) -> Array:
        """The nearest goal configurations (B, n) that are free with a part in the hand and others standing around."""
        numbers, looked_at = near.closest, 0
        found: list[int] = []
        while numbers:
            found += [numbers[k] for k in self._free(near, numbers, part, hand, others, work)]
            if len(found) >= most:
                break
            looked_at += len(numbers)
            numbers = near.order[looked_at : looked_at + LOOKED_AT]
        return near.goals[found[:most]]

    def free_pairs(
        self, near: Neighbours, part: int, hand: Hand, others: int, most: int, work: Workspace
    ) -> tuple[Array, Array]:
        """The first so many of the pairs whose goal is free: their lifted and their goal configurations (P, n)."""
        chosen = near.pairs[self._free(near, near.pairs[:, 1].tolist(), part, hand, others, work)[:most]]
        return near.lifted[chosen[:, 0]], near.goals[chosen[:, 1]]

    def forget(self) -> None:
        """Starts anew with what belongs to grasps and lifts."""
        self._neighbours.clear()
        self._blockers.clear()

    def _free(
        self, near: Neighbours, numbers: Sequence[int], part: int, hand: Hand, others: int, work: Workspace
    ) -> list[int]:
        """Places in a list of goals of those that are free."""
        known = self._blockers.setdefault(hand, {})
        unknown = [number for number in dict.fromkeys(numbers) if number not in known]
        if unknown:
            known.update(zip(unknown, self._blockers_of(near.goals[unknown], part, hand, work), strict=True))
        standing = others | 1 << self._parts
        return [place for place, number in enumerate(numbers) if not known[number] & standing]

    def _blockers_of(self, goals: Array, part: int, hand: Hand, work: Workspace) -> list[int]:
        """Owners that arm or load touch at some goals (K, n); the last one also where the arm touches itself."""
        everything = np.ones(self._parts + 1, dtype=np.uint8)
        everything[part] = 0
        step = 0.0  # no motion is looked at
        arm = self._robot.arm_at(hand.candidate.width)
        scene = new_scene(arm, hand.held, self._world, everything, self._padding, step, work)
        hits = np.zeros((len(goals), self._parts + 1), dtype=np.uint8)
        folded = configuration_blockers(scene, goals, hits)
        hits[:, -1] |= folded
        return owners_of(hits)

    def _solve(self, opening: float, work: Workspace) -> Iterator[Array]:
        arm, held = self._robot.arm_at(opening), self._robot.held(opening)
        present = flags_of(0, self._parts)
        for q in self.solutions(opening):
            if check(arm, held, self._world, present, self._padding, q, work) == FREE:
                yield q


def super_fibonacci(count: int) -> Array:
    """Evenly spread unit quaternions (count, 4). Alexa: Super-Fibonacci Spirals, CVPR 2022."""
    s = np.arange(count) + 0.5
    t = s / count
    d = 2 * np.pi * s
    r, R = np.sqrt(t), np.sqrt(1 - t)
    alpha, beta = d / np.sqrt(2), d / 1.533751168755204288118041
    return np.column_stack([r * np.sin(alpha), r * np.cos(alpha), R * np.sin(beta), R * np.cos(beta)])
