"""The workcell: arm, gripper, drop-off point and obstacles; data only, read from TOML by `takeapart.formats.files`.

The world frame is the assembly's frame: a workcell says where its arm stands relative to the assembly.
"""

from __future__ import annotations

import importlib.util
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from takeapart.model.errors import InputError, UnknownNameError
from takeapart.model.geometry import Array, OrientedBox

GRAVITY = 9.81  # m/s^2
GRIPPER_LIMITS = (("payload", " kg", 1e4), ("gripping_force", " N", 1e6), ("friction", "", 10.0))  # name, unit, most


@dataclass(frozen=True)
class RobotDescription:
    """Where a known robot's files are and what its links are called.

    Args:
        package: Python distribution module whose install folder holds the files.
        folder: folder of the package's shared files, relative to the site folder.
        urdf: file name relative to `folder`.
        base_link: fixed to the world at the workcell's base pose.
        flange_link: target frame of the inverse kinematics.
        arm_joints: in the order of a configuration.
        hand_links: links beyond the flange that belong to the gripper, fingers included.
        finger_links: the links that touch the part.
        finger_joints: prismatic; each stands at half the opening.
        T_hand_tool: (x, y, z) m of the point between the fingertips in the first hand link's frame; the tool frame has
            this frame's axes: z is the approach direction, y the closing direction of the fingers.
        maximum_opening: between the fingers, m.
        payload: what the gripper may carry, kg.
        gripping_force: with which each finger presses on the part, N.
        friction: coefficient between a finger's pad and the part.
        ik_module: module of the inverse kinematics library.
    """

    name: str
    folder: str
    urdf: str
    base_link: str
    flange_link: str
    arm_joints: tuple[str, ...]
    hand_links: tuple[str, ...]
    finger_links: tuple[str, ...]
    finger_joints: tuple[str, ...]
    T_hand_tool: tuple[float, float, float]
    maximum_opening: float
    payload: float
    gripping_force: float
    friction: float
    ik_module: str

    def path(self, relative: str) -> Path:
        """A file of the robot, for example ``path(description.urdf)``.

        Raises:
            InputError: the package with the robot's files is not installed.
        """
        specification = importlib.util.find_spec("cmeel")
        site = Path(str(specification.origin)).parents[1] if specification and specification.origin else Path()
        found = site / self.folder / relative
        if not found.is_file():
            raise InputError(
                f"robot file {relative!r} not found; install it with: pip install example-robot-data", self.name
            )
        return found

    def resolve(self, uri: str) -> Path:
        """File of a mesh as the URDF names it (``package://example-robot-data/robots/...``)."""
        return self.path(uri.removeprefix("package://example-robot-data/"))


ROBOTS = {
    "panda": RobotDescription(
        name="panda",
        folder="cmeel.prefix/share/example-robot-data",
        urdf="robots/panda_description/urdf/panda.urdf",
        base_link="panda_link0",
        flange_link="panda_link8",
        arm_joints=tuple(f"panda_joint{i}" for i in range(1, 8)),
        hand_links=("panda_hand", "panda_leftfinger", "panda_rightfinger"),
        finger_links=("panda_leftfinger", "panda_rightfinger"),
        finger_joints=("panda_finger_joint1", "panda_finger_joint2"),
        T_hand_tool=(0.0, 0.0, 0.1034),
        maximum_opening=0.08,
        payload=3.0,  # Franka Emika, Panda datasheet (2020): payload 3 kg, grasping force continuous 70 N
        gripping_force=70.0,
        friction=0.5,  # rubber on dry aluminium is above it
        ik_module="ssik.prebuilt.franka_panda_ik",
    )
}


def robot_description(name: str, where: str = "") -> RobotDescription:
    """The known robot of a given name.

    Raises:
        UnknownNameError: no such robot; the message lists the known ones.
    """
    if name not in ROBOTS:
        raise UnknownNameError("robot", name, list(ROBOTS), where)
    return ROBOTS[name]


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
        for name, unit, most in GRIPPER_LIMITS:
            if math.isnan(getattr(self, name)):
                object.__setattr__(self, name, getattr(description, name))
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
        return ROBOTS[self.robot]
