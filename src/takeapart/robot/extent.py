"""How far the arm reaches: the greatest distance of the tool from the shoulder."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from takeapart.model.geometry import Array
from takeapart.robot.kinematics import tool_poses
from takeapart.robot.model import RobotModel

SAMPLES, KEPT, ROUNDS = 4096, 32, 200
FIRST_STEP, SHRINKING = 0.2, 0.95  # of a joint's range, standard deviation in the first round; from round to round


@dataclass(frozen=True, eq=False)
class Extent:
    """What the position of a tool can be compared with.

    Args:
        shoulder: (3,) m, origin of the first joint's frame, world frame; no joint moves it.
        length: greatest distance of the point between the fingertips from there within the joint limits, m.
    """

    shoulder: Array
    length: float

    def distances(self, points: Array) -> Array:
        """Distances (K,), m, of points (K, 3) in the world frame from the shoulder."""
        return np.asarray(np.linalg.norm(points - self.shoulder, axis=1))


def arm_extent(robot: RobotModel) -> Extent:
    """Reach of the arm: all joints are sampled within their limits, and the best samples are improved.

    Where the tool moves with the fingers' opening, it is that of the opening with which it reaches furthest. The same
    for every call. It is what was found, so never more than the arm can do.
    """
    return max((_extent_at(robot, opening) for opening in robot.tool_openings), key=lambda extent: extent.length)


def _extent_at(robot: RobotModel, opening: float) -> Extent:
    rng = np.random.default_rng(0)
    arm, work = robot.arm_at(opening), robot.workspace()
    shoulder = (robot.T_world_base @ np.vstack([arm.T_joint[0], [0, 0, 0, 1]]))[:3, 3]

    def distances(rows: Array) -> Array:
        poses = np.empty((len(rows), 7))
        tool_poses(arm, np.ascontiguousarray(rows), work, poses)
        return np.asarray(np.linalg.norm(poses[:, :3] - shoulder, axis=1))

    rows = rng.uniform(arm.lower, arm.upper, (SAMPLES, robot.joints))
    rows = rows[np.argsort(distances(rows))[-KEPT:]]
    known = distances(rows)
    for turn in range(ROUNDS):
        step = (arm.upper - arm.lower) * FIRST_STEP * SHRINKING**turn
        tried = np.clip(rows + rng.normal(size=rows.shape) * step, arm.lower, arm.upper)
        found = distances(tried)
        better = found > known
        rows[better], known[better] = tried[better], found[better]
    return Extent(shoulder, float(known.max()))
