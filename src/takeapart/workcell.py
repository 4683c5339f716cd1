"""The workcell: arm, gripper, drop-off point and obstacles; data only, read from TOML by `takeapart.formats.files`.

The world frame is the assembly's frame: a workcell says where its arm stands relative to the assembly.
"""

from __future__ import annotations

import importlib.util
import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from takeapart.model.description import ArmDescription, GripperDescription, RobotDescription, RobotFiles
from takeapart.model.errors import InputError, UnknownNameError
from takeapart.model.geometry import Array, OrientedBox

GRAVITY = 9.81  # m/s^2
GRIPPER_LIMITS = (("payload", " kg", 1e4), ("gripping_force", " N", 1e6), ("friction", "", 10.0))  # name, unit, most


def _panda() -> RobotDescription:
    specification = importlib.util.find_spec("cmeel")
    site = Path(str(specification.origin)).parents[1] if specification and specification.origin else Path()
    folder = site / "cmeel.prefix" / "share" / "example-robot-data"
    urdf = folder / "robots" / "panda_description" / "urdf" / "panda.urdf"
    if not urdf.is_file():
        raise InputError(
            f"robot file {urdf.name!r} not found; install it with: pip install example-robot-data", "panda"
        )
    files = RobotFiles(urdf, {"example-robot-data": folder})
    # Franka Emika, Panda datasheet (2020): payload 3 kg, grasping force continuous 70 N. Rubber on dry aluminium has a
    # friction above 0.5.
    arm = ArmDescription(
        name="panda",
        files=files,
        base_link="panda_link0",
        flange_link="panda_link8",
        joints=tuple(f"panda_joint{i}" for i in range(1, 8)),
        payload=3.0,
        home=(0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398),
        inverse_kinematics="ssik.prebuilt.franka_panda_ik",
    )
    hand = GripperDescription(
        name="panda",
        files=files,
        base_link="panda_hand",
        finger_links=("panda_leftfinger", "panda_rightfinger"),
        joints=("panda_finger_joint1",),
        openings=(0.0, 0.08),
        positions=((0.0, 0.04),),
        tool_points=((0.0, 0.0, 0.1034), (0.0, 0.0, 0.1034)),
        tool_orientation=(1.0, 0.0, 0.0, 0.0),
        gripping_force=70.0,
        friction=0.5,
    )
    # Turned by -45 degrees about z; the digits are those whose matrix is, to the last bit, that of the URDF.
    return RobotDescription(arm, hand, (0.0, 0.0, 0.0, 0.9238795325112861, 0.0, 0.0, -0.38268343236508945))


ROBOTS = {"panda": _panda}


@cache
def _description(name: str) -> RobotDescription:
    return ROBOTS[name]()


def robot_description(name: str, where: str = "") -> RobotDescription:
    """The known robot of a given name.

    Raises:
        InputError: the package with the robot's files is not installed.
        UnknownNameError: no such robot; the message lists the known ones.
    """
    if name not in ROBOTS:
        raise UnknownNameError("robot", name, list(ROBOTS), where)
    return _description(name)


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A box of the environment that must never be hit."""

    name: str
    box: OrientedBox  # world frame


@dataclass(frozen=True, eq=False)
class Workcell:
    """Everything around the assembly.

    Args:
        name: used in messages.
        robot: name of a known robot (`ROBOTS`).
        T_world_base: (4, 4) pose of the robot's base link.
        home: (n,) rad, configuration of the arm at rest.
        goal: (3,) m, where every removal ends: position of the tool; its orientation is free (Sec. IV-A).
        lift_height: every removal starts with this much straight up, m.
        clearance: distance that the planner keeps between everything that must not touch, m.
        environment: obstacles, for example table and pedestal. The robot's base link may touch them.
        payload: what the gripper may carry, kg.
        gripping_force: with which each finger presses on the part, N.
        friction: coefficient between a finger's pad and the part. What is not a number here is taken from the robot's
            description.

    Raises:
        InputError: a number out of range; the message says which and what is valid.
        UnknownNameError: unknown robot.
    """

    name: str
    robot: str
    T_world_base: Array
    home: Array
    goal: Array
    lift_height: float = 0.05
    clearance: float = 0.001
    environment: tuple[Obstacle, ...] = ()
    payload: float = math.nan
    gripping_force: float = math.nan
    friction: float = math.nan

    def __post_init__(self) -> None:
        description = robot_description(self.robot, f"{self.name}: robot.model")
        if self.home.shape != (len(description.arm_joints),) or not np.isfinite(self.home).all():
            raise InputError(
                f"must be {len(description.arm_joints)} finite joint angles, rad", f"{self.name}: robot.home"
            )
        if self.goal.shape != (3,) or not np.isfinite(self.goal).all():
            raise InputError("must be three finite coordinates, m", f"{self.name}: goal")
        if not 0 < self.lift_height <= 1:
            raise InputError(f"{self.lift_height} m; must be above 0 and at most 1", f"{self.name}: lift_height")
        if not 0 <= self.clearance <= 0.02:
            raise InputError(f"{self.clearance} m; must be from 0 to 0.02", f"{self.name}: clearance")
        arm, gripper = description.arm, description.gripper
        standard = {
            "payload": arm.payload,
            "gripping_force": gripper.gripping_force,
            "friction": gripper.friction,
        }
        for name, unit, most in GRIPPER_LIMITS:
            if math.isnan(getattr(self, name)):
                object.__setattr__(self, name, standard[name])
            value = getattr(self, name)
            if not 0 < value <= most:
                raise InputError(f"{value}{unit}; must be above 0 and at most {most:g}", f"{self.name}: robot.{name}")

    @property
    def grip(self) -> float:
        """Mass that two fingers hold by friction alone, kg: 2 * friction * force / g."""
        return 2 * self.friction * self.gripping_force / GRAVITY

    @property
    def description(self) -> RobotDescription:
        """Files and link names of the robot."""
        return robot_description(self.robot)
