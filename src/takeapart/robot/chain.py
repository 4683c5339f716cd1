"""The chain of an arm, from its base to its flange, and the bodies that its joints and its gripper carry along."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from takeapart.model.description import ArmDescription, RobotDescription
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, pose_inverse
from takeapart.robot.urdf import Urdf, read_urdf
from takeapart.robot.urdf.tree import TURNING

LARGEST_ANGLE = 1000.0  # rad, of a joint's limits


@dataclass(frozen=True, eq=False)
class Chain:
    """Joints in a row, each frame turned so that its joint turns about z.

    Args:
        T_joint: (n, 3, 4) pose of each joint's frame, at angle zero, in that of the joint before.
        lower, upper: (n,) rad.
        links: (n + 1) the base link, and the link that each joint moves.
        T_frame_link: per link its pose (4, 4) in the frame of its joint.
        T_last_flange: (4, 4) pose of the flange in the frame of the last joint.
    """

    T_joint: Array
    lower: Array
    upper: Array
    links: tuple[str, ...]
    T_frame_link: tuple[Array, ...]
    T_last_flange: Array


@dataclass(frozen=True, eq=False)
class Body:
    """A link with collision geometry that moves with the frame of a joint.

    Args:
        urdf: of arm or gripper, where its geometry is.
        frame: number of the joint, 0 for the base.
        T_frame_link: (4, 4).
        in_line: whether it is part of the arm's own line from joint to joint; what hangs beside it, and the gripper,
            is not.
        of_gripper: whether it belongs to the gripper.
    """

    urdf: Urdf
    link: str
    frame: int
    T_frame_link: Array
    in_line: bool
    of_gripper: bool = False


def arm_chain(urdf: Urdf, arm: ArmDescription) -> Chain:
    """The chain of an arm.

    Raises:
        InputError: it is not in the URDF as the description says, or has joints that do not turn.
    """
    where = f"{arm.name}: {urdf.where}"
    path = urdf.path(arm.base_link, arm.flange_link)
    found = tuple(joint.name for joint in path if joint.kind != "fixed")
    if found != arm.joints:
        raise InputError(
            f"from {arm.base_link!r} to {arm.flange_link!r} the joints are {', '.join(found) or 'none'}; "
            f"the description says {', '.join(arm.joints) or 'none'}",
            where,
        )
    if not found:
        raise InputError(f"no joint moves {arm.flange_link!r} relative to {arm.base_link!r}", where)
    T_joint: list[Array] = []
    limits: list[tuple[float, float]] = []
    links, T_frame_link = [arm.base_link], [np.eye(4)]
    T_last = np.eye(4)  # the link before the next joint in the frame of the last joint
    for joint in path:
        if joint.kind == "fixed":
            T_last = T_last @ joint.T_parent
            continue
        if joint.kind not in TURNING:
            raise InputError(f"joint {joint.name!r} is of type {joint.kind!r}; an arm's joints must turn", where)
        if joint.mimic is not None:
            raise InputError(f"joint {joint.name!r} mimics {joint.mimic.joint!r}; an arm's joints move alone", where)
        turn = _align_z(joint.axis)
        T_joint.append(T_last @ joint.T_parent @ turn)
        limits.append(urdf.limits(joint.name))
        if max(map(abs, limits[-1])) > LARGEST_ANGLE or limits[-1][0] == limits[-1][1]:
            raise InputError(f"joint {joint.name!r} has the limits {limits[-1][0]:g} and {limits[-1][1]:g} rad", where)
        T_last = pose_inverse(turn)
        links.append(joint.child)
        T_frame_link.append(T_last)
    return Chain(
        T_joint=np.ascontiguousarray([T[:3] for T in T_joint]),
        lower=np.array([low for low, _ in limits]),
        upper=np.array([high for _, high in limits]),
        links=tuple(links),
        T_frame_link=tuple(T_frame_link),
        T_last_flange=T_last,
    )


def robot_bodies(description: RobotDescription, chain: Chain) -> tuple[Body, ...]:
    """Everything of a robot that has collision geometry and does not move with the opening of the gripper: links and
    what is fixed on them, joint by joint, then the gripper's.

    Raises:
        InputError: a link of the arm's line, or the gripper's base, has no collision geometry.
    """
    arm, gripper = description.arm, description.gripper
    hand = read_urdf(gripper.files)
    cut = frozenset({gripper.base_link}) if gripper.files.urdf == arm.files.urdf else frozenset()
    T_gripper = chain.T_last_flange @ description.T_flange_gripper
    fixed = {name: T for name, T in hand.fixed_on(gripper.base_link).items() if hand.links[name].collisions}
    if not fixed:
        raise InputError(
            f"the gripper's base {gripper.base_link!r} has no collision geometry, nor has what is fixed on it",
            f"{gripper.name}: {hand.where}",
        )
    last = len(chain.links) - 1
    on_flange = (Body(hand, name, last, T_gripper @ T, False, True) for name, T in fixed.items())
    return (*arm_bodies(arm, chain, cut), *on_flange)


def arm_bodies(arm: ArmDescription, chain: Chain, cut: frozenset[str] = frozenset()) -> tuple[Body, ...]:
    """The links of an arm that have collision geometry, and what is fixed on them, joint by joint.

    Args:
        cut: links that are left out besides `arm.left_out`, with all that hangs on them.

    Raises:
        InputError: a link of the arm's line has no collision geometry, nor has what is fixed on it.
    """
    urdf = read_urdf(arm.files)
    cut |= frozenset(arm.left_out)
    line = {arm.base_link, *(joint.child for joint in urdf.path(arm.base_link, arm.flange_link))}
    found: list[Body] = []
    for frame, (link, T) in enumerate(zip(chain.links, chain.T_frame_link, strict=True)):
        bodies = [
            Body(urdf, name, frame, T @ T_link, name in line)
            for name, T_link in urdf.fixed_on(link, cut).items()
            if urdf.links[name].collisions
        ]
        if not any(body.in_line for body in bodies):
            raise InputError(
                f"link {link!r} has no collision geometry, nor has what is fixed on it; "
                "without it no motion can be checked",
                f"{arm.name}: {urdf.where}",
            )
        found += bodies
    return tuple(found)


def _align_z(axis: Array) -> Array:
    """Rotation as a pose (4, 4) that takes the z axis to a given axis (3,)."""
    axis = axis / np.linalg.norm(axis)
    T = np.eye(4)
    if axis[2] > 1 - 1e-12:
        return T
    side = np.cross([0.0, 0.0, 1.0], axis)
    side = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(side) < 1e-9 else side / np.linalg.norm(side)
    T[:3, :3] = np.column_stack([side, np.cross(axis, side), axis])
    return T
