"""Inverse kinematics: every branch, at machine precision, inside the joint limits."""

from __future__ import annotations

import threading
from typing import Protocol

import numpy as np

from takeapart.model.geometry import Array, pose_inverse
from takeapart.robot.arrays import ChainArrays, ChainFrames
from takeapart.robot.ik_solver import FlangeSolver, brought_solver, made_solver
from takeapart.robot.kinematics import forward, mark_solutions, wind_to_middle
from takeapart.robot.model import RobotModel

NEARLY = 0.1  # rad; where a sample of all solutions is so near to the limits, some may be inside


class Solver(Protocol):
    """What the planner asks of inverse kinematics."""

    def solve(self, T_world_tool: Array, opening: float = 0.0) -> Array:
        """Solutions (S, n), rad, inside the joint limits for a tool pose (4, 4) at an opening of the fingers, m; S is 0
        where there is none. Of the windings of a solution there is one.
        """
        ...

    def solve_both(self, T_world_tool: Array, opening: float = 0.0) -> tuple[Array, Array]:
        """As `solve`, for a pose and for the same pose turned by half a turn about the tool's approach direction."""
        ...


class InverseKinematics:
    """Configurations that put the tool at a pose.

    A redundant arm has a continuum of them; the library samples the part of it inside the joint limits (on average
    about 7 configurations for the Panda). `docs/benchmarks.md` says what that loses. A joint that turns further than
    once round stands within half a turn of the middle of its limits, if that is inside them: the other windings are
    found when a motion begins somewhere (`kinematics.wind`).

    Raises:
        InputError: there is no solver for this arm.
        MissingExtraError: the library is not there.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._robot, self._local = robot, threading.local()
        self._solver = solver_of(robot)
        self._T_base_world = pose_inverse(robot.T_world_base)
        self._T_tool_flange: dict[float, Array] = {}
        self._lower, self._upper = robot.arm.lower, robot.arm.upper
        self._turning = robot.arm.turning
        # Whether the last joint turns the tool about its own approach direction: both finger orders are then one.
        tools = [robot.T_last_flange @ robot.T_flange_tool(opening) for opening in robot.description.gripper.openings]
        self._turns_on_the_spot = all(np.allclose(T[:2, 3], 0, atol=1e-9) and np.isclose(T[2, 2], 1) for T in tools)
        # The library loads its machine code at its first call. A second thread that calls meanwhile gets an answer of
        # its interpreted code, which rounds otherwise: a plan would depend on which thread came first.
        self.solve(robot.tool_pose(np.zeros(robot.joints)))

    def solve(self, T_world_tool: Array, opening: float = 0.0) -> Array:
        """Solutions (S, n), rad, inside the joint limits for a tool pose (4, 4) at an opening of the fingers, m; S is 0
        where there is none.
        """
        return self._inside(self._sampled(T_world_tool, opening), T_world_tool, opening)

    def solve_both(self, T_world_tool: Array, opening: float = 0.0) -> tuple[Array, Array]:
        """As `solve`, for a pose and for the same pose turned by half a turn about the tool's approach direction."""
        turned = T_world_tool.copy()
        turned[:3, :2] *= -1
        if not self._turns_on_the_spot:
            return self.solve(T_world_tool, opening), self.solve(turned, opening)
        found = self._sampled(T_world_tool, opening)
        other = found.copy()
        other[:, -1] += np.where(other[:, -1] > 0, -np.pi, np.pi)
        if self._robot.joints == 6:  # what is turned is all that there is
            return self._inside(found, T_world_tool, opening), self._inside(other, turned, opening)
        # For the turned pose the library takes other samples, and near the limits there are better ones among them.
        return self._inside(found, T_world_tool, opening), self._within_limits(other, turned, opening)

    def _sampled(self, T_world_tool: Array, opening: float) -> Array:
        """Solutions (S, n), rad, inside the limits or not."""
        return self._rows(self._solver.solve(self._to_flange(T_world_tool, opening), False))

    def _inside(self, sampled: Array, T_world_tool: Array, opening: float) -> Array:
        """Solutions inside the limits from the library's own samples for the pose: those of them that are inside, which
        are all that it gives for these limits, or what it finds near the limits where none is.
        """
        inside = self._wound_inside(sampled)
        if len(inside) or self._robot.joints == 6:  # of a redundant arm alone there are others than the samples
            return self._right(inside, T_world_tool, opening)
        return self._within_limits(sampled, T_world_tool, opening)

    def _within_limits(self, sampled: Array, T_world_tool: Array, opening: float) -> Array:
        """The library's own choice of solutions inside the limits; it is asked only where the samples say that there
        are some, because it takes a hundred times longer to find that there are none.
        """
        self._wound_inside(sampled)
        beyond = np.maximum(self._lower - sampled, sampled - self._upper).max(axis=1, initial=-np.inf)
        if not len(sampled) or beyond.min() >= NEARLY:
            return np.empty((0, len(self._lower)))
        found = self._rows(self._solver.solve(self._to_flange(T_world_tool, opening), True))
        # Its limits may be others than those of this arm's URDF.
        return self._right(self._wound_inside(found), T_world_tool, opening)

    def _rows(self, found: list[Array]) -> Array:
        return np.array(found, dtype=float).reshape(-1, len(self._lower))

    def _wound_inside(self, rows: Array) -> Array:
        """Those of some solutions (S, n) that are inside the limits, every joint by full turns as near to the middle of
        its limits as `wind_to_middle` says; the others are wound in place, too.
        """
        inside = np.empty(len(rows), dtype=np.uint8)
        wind_to_middle(self._lower, self._upper, self._turning, rows, inside)
        return rows[inside.astype(bool)]

    def _right(self, rows: Array, T_world_tool: Array, opening: float) -> Array:
        """Those of some solutions (S, n) that put the tool where it should be, each once."""
        if not len(rows):
            return rows
        if not hasattr(self._local, "frames"):
            work = self._robot.workspace()
            self._local.frames = ChainFrames(work.R, work.p, work.R_tool, work.p_tool)
        right = np.empty(len(rows), dtype=np.uint8)
        arm = self._robot.arm_at(opening)
        chain = ChainArrays(arm.T_world_base, arm.T_joint, arm.T_tool)
        mark_solutions(chain, rows, np.ascontiguousarray(T_world_tool), self._local.frames, right)
        return rows if right.all() else rows[right.astype(bool)]

    def _to_flange(self, T_world_tool: Array, opening: float) -> Array:
        key = opening if self._robot.tool_moves else 0.0
        if key not in self._T_tool_flange:
            self._T_tool_flange[key] = pose_inverse(self._robot.T_flange_tool(key))
        T: Array = self._T_base_world @ T_world_tool @ self._T_tool_flange[key]
        return T


def solver_of(robot: RobotModel) -> FlangeSolver:
    """The library's solver for the arm of a robot.

    Raises:
        InputError: there is none, or the one that the arm's description names is for another arm.
        MissingExtraError: the library is not there.
    """
    arm, description = robot.arm, robot.description.arm
    if not description.inverse_kinematics:
        return made_solver(arm.T_joint, robot.T_last_flange, arm.lower, arm.upper, description.name)
    T_base_world, work = pose_inverse(robot.T_world_base), robot.workspace()

    def flange(q: Array) -> Array:
        forward(arm, q, work)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = work.R[-1], work.p[-1]
        return np.asarray(T_base_world @ T @ robot.T_last_flange)

    return brought_solver(
        description.inverse_kinematics, flange, robot.joints, f"{description.name}: inverse_kinematics"
    )
