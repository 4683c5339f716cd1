"""The arm of a workcell as the planner knows it, read from URDF: chain, hulls, sphere cover, self-collision pairs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from takeapart.robot.arrays import ArmArrays
from takeapart.robot.chain import Body, arm_chain, robot_bodies
from takeapart.robot.covering import body_cover, body_hulls, inflations
from takeapart.robot.model import RobotModel
from takeapart.robot.self_collision import body_pairs, turning_joints
from takeapart.robot.urdf import read_urdf
from takeapart.workcell import Workcell


def load_robot(workcell: Workcell) -> RobotModel:
    """The robot of a workcell.

    Raises:
        InputError: the robot's files are missing or broken, its chain is not one of joints that turn, or it has links
            without collision geometry.
    """
    description = workcell.description
    chain = arm_chain(read_urdf(description.arm.files), description.arm)
    bodies = robot_bodies(description, chain)
    covers = [body_cover(body, inflation) for body, inflation in zip(bodies, inflations(bodies, chain), strict=True)]
    T_frame_body = [body.T_frame_link for body in bodies]
    centers = [c.centers @ T[:3, :3].T + T[:3, 3] for c, T in zip(covers, T_frame_body, strict=True)]
    balls = [
        (middle := c.mean(axis=0), float((np.linalg.norm(c - middle, axis=1) + k.radii).max()))
        for c, k in zip(centers, covers, strict=True)
    ]
    radii = np.concatenate([c.radii for c in covers])
    hulls = body_hulls(bodies)
    n = len(chain.T_joint)
    pairs, tables = body_pairs(hulls, chain.T_joint, chain.lower, chain.upper)
    arm = ArmArrays(
        T_world_base=np.ascontiguousarray(workcell.T_world_base[:3]),
        T_joint=chain.T_joint,
        T_tool=np.ascontiguousarray((chain.T_last_flange @ description.T_flange_tool(0.0))[:3]),
        lower=chain.lower,
        upper=chain.upper,
        turning=np.array(turning_joints(chain.lower, chain.upper), dtype=np.int32),
        sphere_center=(spheres := np.concatenate(centers)),
        sphere_x=spheres[:, 0].copy(),
        sphere_y=spheres[:, 1].copy(),
        sphere_z=spheres[:, 2].copy(),
        sphere_radius=radii,
        body_start=np.cumsum([0, *[len(c) for c in centers]]).astype(np.uint64),
        corner=np.ascontiguousarray(np.concatenate([hull.corners for hull in hulls])),
        corner_start=np.cumsum([0, *[len(hull.corners) for hull in hulls]], dtype=np.int64),
        body_frame=np.array([body.frame for body in bodies], dtype=np.uint64),
        first_moving=sum(body.frame == 0 for body in bodies),
        body_center=np.array([center for center, _ in balls]),
        body_radius=np.array([radius for _, radius in balls]),
        self_pairs=np.array(
            [(pair.first, pair.second) for pair in pairs if pair.treatment == "hulls"], dtype=np.int32
        ).reshape(-1, 2),
        near_joints=np.array([table.joints for table in tables], dtype=np.int32).reshape(-1, 2),
        near_lower=np.array([table.lower for table in tables]).reshape(-1, 2),
        near_step=np.array([table.step for table in tables]).reshape(-1, 2),
        near_shape=np.array([table.distances.shape for table in tables], dtype=np.int32).reshape(-1, 2),
        near_reach=np.array([table.reach for table in tables]).reshape(-1, 2),
        near_start=np.cumsum([0, *[table.distances.size for table in tables]], dtype=np.int64)[:-1],
        near_distance=np.concatenate([np.zeros(0, np.uint16), *[table.distances.ravel() for table in tables]]),
        held_bodies=np.array([b for b, body in enumerate(bodies) if body.frame < n], dtype=np.int32),
    )
    names = _names(bodies)
    inflation = {name: cover.inflation for name, cover in zip(names, covers, strict=True)}
    return RobotModel(description, arm, chain.T_last_flange, inflation, names, pairs, tuple(hulls))


def _names(bodies: Sequence[Body]) -> tuple[str, ...]:
    """Names of the bodies' links; one of the gripper that the arm's file has too says whose it is."""
    names: list[str] = []
    for body in bodies:
        names.append(f"gripper/{body.link}" if body.link in names else body.link)
    return tuple(names)
