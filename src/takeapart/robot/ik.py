"""Inverse kinematics by the library ssik: every branch, at machine precision."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Protocol

import numpy as np

from takeapart.model.errors import MissingExtraError
from takeapart.model.geometry import Array, pose_inverse
from takeapart.robot.model import RobotModel

NEARLY = 0.1  # rad; where a sample of all solutions is so near to the limits, some may be inside


# What the library imports and only its solvers of arms without any structure use: computer algebra, and through the
# second, scipy's signal processing and statistics. It takes longer to import than a small problem takes to plan.
POSTPONED = ("sympy", "mpmath", "ssik.solvers.husty_pfurner.general_6r")


class Solver(Protocol):
    """What the planner asks of inverse kinematics."""

    def solve(self, T_world_tool: Array) -> Array:
        """Solutions (S, n), rad, inside the joint limits for a tool pose (4, 4); S is 0 where there is none."""
        ...

    def solve_both(self, T_world_tool: Array) -> tuple[Array, Array]:
        """As `solve`, for a pose and for the same pose turned by half a turn about the tool's approach direction."""
        ...


class InverseKinematics:
    """Configurations that put the tool at a pose.

    A redundant arm has a continuum of them; the library samples the part of it inside the joint limits (on average
    about 7 configurations for the Panda). `docs/benchmarks.md` says what that loses.
    """

    def __init__(self, robot: RobotModel) -> None:
        try:
            self._solver = import_solver(robot.description.ik_module)
        except ImportError as error:
            raise MissingExtraError("inverse kinematics", "", "ssik") from error
        self._T_base_world = pose_inverse(robot.T_world_base)
        self._T_tool_flange = pose_inverse(robot.T_flange_tool)
        self._lower, self._upper = robot.arm.lower, robot.arm.upper
        T_tool = robot.arm.T_tool
        # Whether the last joint turns the tool about its own approach direction: both finger orders are then one.
        self._turns_on_the_spot = bool(np.allclose(T_tool[:2, 3], 0, atol=1e-9) and np.isclose(T_tool[2, 2], 1))
        # The library loads its machine code at its first call. A second thread that calls meanwhile gets an answer of
        # its interpreted code, which rounds otherwise: a plan would depend on which thread came first.
        self.solve(robot.tool_pose(np.zeros(robot.joints)))

    def solve(self, T_world_tool: Array) -> Array:
        """Solutions (S, n), rad, inside the joint limits for a tool pose (4, 4); S is 0 where there is none."""
        return self._inside(self._sampled(T_world_tool), T_world_tool)

    def solve_both(self, T_world_tool: Array) -> tuple[Array, Array]:
        """As `solve`, for a pose and for the same pose turned by half a turn about the tool's approach direction."""
        turned = T_world_tool.copy()
        turned[:3, :2] *= -1
        if not self._turns_on_the_spot:
            return self.solve(T_world_tool), self.solve(turned)
        found = self._sampled(T_world_tool)
        other = found.copy()
        other[:, -1] += np.where(other[:, -1] > 0, -np.pi, np.pi)
        # For the turned pose the library takes other samples, and near the limits there are better ones among them.
        return self._inside(found, T_world_tool), self._within_limits(other, turned)

    def _sampled(self, T_world_tool: Array) -> Array:
        """Solutions (S, n), rad, inside the limits or not."""
        found = self._solver.solve(self._to_flange(T_world_tool), allow_rescue=False, respect_limits="wrap")
        return np.array([solution.q for solution in found]).reshape(-1, len(self._lower))

    def _inside(self, sampled: Array, T_world_tool: Array) -> Array:
        """Solutions inside the limits from the library's own samples for the pose: those of them that are inside, which
        are all that it gives for these limits, or what it finds near the limits where none is.
        """
        inside = sampled[((sampled >= self._lower) & (sampled <= self._upper)).all(axis=1)]
        return inside if len(inside) else self._within_limits(sampled, T_world_tool)

    def _within_limits(self, sampled: Array, T_world_tool: Array) -> Array:
        """The library's own choice of solutions inside the limits; it is asked only where the samples say that there
        are some, because it takes a hundred times longer to find that there are none.
        """
        beyond = np.maximum(self._lower - sampled, sampled - self._upper).max(axis=1, initial=-np.inf)
        if not len(sampled) or beyond.min() >= NEARLY:
            return np.empty((0, len(self._lower)))
        found = self._solver.solve(self._to_flange(T_world_tool), allow_rescue=False)
        return np.array([solution.q for solution in found]).reshape(-1, len(self._lower))

    def _to_flange(self, T_world_tool: Array) -> Array:
        T: Array = self._T_base_world @ T_world_tool @ self._T_tool_flange
        return T


class _Postponing:
    """Finds the modules of `POSTPONED` so that they are executed when something of theirs is first used."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path, target) if name in POSTPONED else None
        if spec is not None and spec.loader is not None:
            spec.loader = importlib.util.LazyLoader(spec.loader)
        return spec


def import_solver(name: str) -> ModuleType:
    """A module of the library, by its full name, without what it imports and does not use.

    Raises:
        ImportError: there is none.
    """
    sys.meta_path.insert(0, _Postponing)
    try:
        return importlib.import_module(name)
    finally:
        sys.meta_path.remove(_Postponing)
