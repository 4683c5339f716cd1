"""Configurations with the tool at the goal position: its orientation is free (Sec. IV-A), so there is a
four-dimensional set.

The tool's position does not depend on what it holds, so one sample serves every grasp of every part.
"""

from __future__ import annotations

import threading

import numpy as np

from takeapart.geometry import Array, pose
from takeapart.motion.legs import nearest_free
from takeapart.motion.scene import Scene
from takeapart.robot.arrays import Workspace, WorldArrays
from takeapart.robot.ik import InverseKinematics
from takeapart.robot.kernels import FREE, check
from takeapart.robot.model import RobotModel
from takeapart.workcell import Workcell

ORIENTATIONS = 240


class GoalConfigurations:
    """Goal configurations of the bare arm, free of what never leaves; computed when first asked for."""

    def __init__(
        self, workcell: Workcell, robot: RobotModel, ik: InverseKinematics, world: WorldArrays, padding: float
    ) -> None:
        self._goal, self._robot, self._ik, self._world, self._padding = workcell.goal, robot, ik, world, padding
        self._found: Array | None = None
        self._lock = threading.Lock()

    def all(self, work: Workspace) -> Array:
        """(G, n) rad; G is 0 where the goal is out of reach."""
        with self._lock:
            if self._found is None:
                self._found = self._solve(work)
            return self._found

    def free(self, scene: Scene, lifted: Array, work: Workspace, most: int = 64) -> Array:
        """Those (B, n) nearest in joint space to any of the lifted configurations (A, n) that are free in a scene."""
        goals = self.all(work)
        return nearest_free(scene, lifted, goals, most) if len(goals) else goals

    def _solve(self, work: Workspace) -> Array:
        held = self._robot.held(0.0)
        present = np.zeros(int(self._world.owner.max()) + 1, dtype=np.uint8)
        present[-1] = 1
        found = []
        for quaternion in super_fibonacci(ORIENTATIONS):
            for q in self._ik.solve(pose(self._goal, quaternion)):
                q = np.ascontiguousarray(q)
                if check(self._robot.arm, held, self._world, present, self._padding, q, work) == FREE:
                    found.append(q)
        return np.array(found).reshape(-1, self._robot.joints)


def super_fibonacci(count: int) -> Array:
    """Evenly spread unit quaternions (count, 4). Alexa: Super-Fibonacci Spirals, CVPR 2022."""
    s = np.arange(count) + 0.5
    t = s / count
    d = 2 * np.pi * s
    r, R = np.sqrt(t), np.sqrt(1 - t)
    alpha, beta = d / np.sqrt(2), d / 1.533751168755204288118041
    return np.column_stack([r * np.sin(alpha), r * np.cos(alpha), R * np.sin(beta), R * np.cos(beta)])
