"""Inverse kinematics by the library ssik: every branch, at machine precision."""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import Protocol

import numpy as np

from takeapart.errors import MissingExtraError
from takeapart.geometry import Array, pose_inverse
from takeapart.robot.model import RobotModel


class Solver(Protocol):
    """What the planner asks of inverse kinematics."""

    def solve(self, T_world_tool: Array) -> Array:
        """Solutions (S, n), rad, inside the joint limits for a tool pose (4, 4); S is 0 where there is none."""
        ...


class InverseKinematics:
    """Configurations that put the tool at a pose.

    A redundant arm has a continuum of them; the library samples it (on average about 26 configurations for the Panda),
    `docs/benchmarks.md` says what that loses.
    """

    def __init__(self, robot: RobotModel) -> None:
        try:
            self._solver: ModuleType = importlib.import_module(robot.description.ik_module)
        except ImportError as error:
            raise MissingExtraError("inverse kinematics", "", "ssik") from error
        self._T_base_world = pose_inverse(robot.T_world_base)
        self._T_tool_flange = pose_inverse(robot.T_flange_tool)
        self._joints = robot.joints

    def solve(self, T_world_tool: Array) -> Array:
        """All solutions (S, n), rad, inside the joint limits for a tool pose (4, 4); S is 0 where there is none."""
        T = self._T_base_world @ T_world_tool @ self._T_tool_flange
        found = self._solver.solve(T, allow_rescue=False)
        return np.array([solution.q for solution in found]).reshape(-1, self._joints)
