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
from takeapart.robot.arrays import Indices, Workspace, WorldArrays
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
        lifted: (A, n) rad, where these lifts end.
        goals: (G, n) rad.
    """

    def __init__(self, lifted: Array, goals: Array) -> None:
        self.lifted, self._goals = lifted, goals

    @cached_property
    def pairs(self) -> Indices:
        """(P, 2) of a lifted configuration and a goal, see `near_pairs`."""
        return near_pairs(self.lifted, self._goals, GOALS_PER_LIFT)

    @cached_property
    def closest(self) -> list[int]:
        """The LOOKED_AT goals nearest in joint space to any of the lifted configurations, and others as far as the last
        of them: the beginning of `order`.
        """
        if len(self._goals) <= LOOKED_AT:
            return self.order
        distances = joint_distances(self.lifted, self._goals)
        near = np.flatnonzero(distances <= np.partition(distances, LOOKED_AT - 1)[LOOKED_AT - 1])
        closest: list[int] = near[np.argsort(distances[near], kind="stable")].tolist()
        return closest

    @cached_property
    def order(self) -> list[int]:
        """All goals, the nearest first; `closest` is mostly enough."""
        order: list[int] = np.argsort(joint_distances(self.lifted, self._goals), kind="stable").tolist()
        return order


class GoalConfigurations:
    """Goal configurations of the bare arm, free of what never leaves; computed when first asked for.

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
        self._found: Array | None = None
        self._neighbours: dict[tuple[LiftBranch, ...], Neighbours] = {}
        self._blockers: dict[Hand, dict[int, int]] = {}
        self._lock = threading.Lock()

    def solutions(self) -> Iterator[Array]:
        """Configurations (n,), rad, that put the tool at the goal, whatever they hit."""
        for quaternion in super_fibonacci(ORIENTATIONS):
            for q in self._ik.solve(pose(self._goal, quaternion)):
                yield np.ascontiguousarray(q)

    def is_reached(self, work: Workspace) -> bool:
        """Whether there is any free configuration; looks no further than the first."""
        return next(self._solve(work), None) is not None

    def all(self, work: Workspace) -> Array:
        """(G, n) rad."""
        with self._lock:
            if self._found is None:
                self._found = np.array(list(self._solve(work))).reshape(-1, self._robot.joints)
            return self._found

    def neighbours(self, branches: tuple[LiftBranch, ...], work: Workspace) -> Neighbours:
        """Goal configurations near where these lifts of a part, at least one, end."""
        found = self._neighbours.get(branches)
        if found is None:
            goals, lifted = self.all(work), np.array([branch.rows[-1] for branch in branches])
            found = Neighbours(lifted, goals)
            if len(self._neighbours) >= KEPT_NEIGHBOURS:
                self._neighbours.clear()
            self._neighbours[branches] = found
        return found

    def free(self, near: Neighbours, part: int, hand: Hand, others: int, most: int, work: Workspace) -> Array:
        """The nearest goal configurations (B, n) that are free with a part in the hand and others standing around."""
        numbers, looked_at = near.closest, 0
        found: list[int] = []
        while numbers:
            found += [numbers[k] for k in self._free(numbers, part, hand, others, work)]
            if len(found) >= most:
                break
            looked_at += len(numbers)
            numbers = near.order[looked_at : looked_at + LOOKED_AT]
        return self.all(work)[found[:most]]

    def free_pairs(
        self, near: Neighbours, part: int, hand: Hand, others: int, most: int, work: Workspace
    ) -> tuple[Array, Array]:
        """The first so many of the pairs whose goal is free: their lifted and their goal configurations (P, n)."""
        chosen = near.pairs[self._free(near.pairs[:, 1].tolist(), part, hand, others, work)[:most]]
        return near.lifted[chosen[:, 0]], self.all(work)[chosen[:, 1]]

    def forget(self) -> None:
        """Starts anew with what belongs to grasps and lifts."""
        self._neighbours.clear()
        self._blockers.clear()

    def _free(self, numbers: Sequence[int], part: int, hand: Hand, others: int, work: Workspace) -> list[int]:
        """Places in a list of goals of those that are free."""
        known = self._blockers.setdefault(hand, {})
        unknown = [number for number in dict.fromkeys(numbers) if number not in known]
        if unknown:
            known.update(zip(unknown, self._blockers_of(unknown, part, hand, work), strict=True))
        standing = others | 1 << self._parts
        return [place for place, number in enumerate(numbers) if not known[number] & standing]

    def _blockers_of(self, numbers: Sequence[int], part: int, hand: Hand, work: Workspace) -> list[int]:
        """Owners that arm or load touch at some goals; the last one also where the arm touches itself."""
        everything = np.ones(self._parts + 1, dtype=np.uint8)
        everything[part] = 0
        step = 0.0  # no motion is looked at
        scene = new_scene(self._robot.arm, hand.held, self._world, everything, self._padding, step, work)
        hits = np.zeros((len(numbers), self._parts + 1), dtype=np.uint8)
        folded = configuration_blockers(scene, self.all(work)[numbers], hits)
        hits[:, -1] |= folded
        return owners_of(hits)

    def _solve(self, work: Workspace) -> Iterator[Array]:
        held = self._robot.held(0.0)
        present = flags_of(0, self._parts)
        for q in self.solutions():
            if check(self._robot.arm, held, self._world, present, self._padding, q, work) == FREE:
                yield q


def super_fibonacci(count: int) -> Array:
    """Evenly spread unit quaternions (count, 4). Alexa: Super-Fibonacci Spirals, CVPR 2022."""
    s = np.arange(count) + 0.5
    t = s / count
    d = 2 * np.pi * s
    r, R = np.sqrt(t), np.sqrt(1 - t)
    alpha, beta = d / np.sqrt(2), d / 1.533751168755204288118041
    return np.column_stack([r * np.sin(alpha), r * np.cos(alpha), R * np.sin(beta), R * np.cos(beta)])
