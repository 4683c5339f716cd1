"""The workcell: arm, gripper, drop-off point and obstacles; data only, read from TOML by `takeapart.formats.files`.

The world frame is the assembly's frame: a workcell says where its arm stands relative to the assembly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from takeapart.model.description import RobotDescription as RobotDescription
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, OrientedBox

GRAVITY = 9.81  # m/s^2
GRIPPER_LIMITS = (("payload", " kg", 1e4), ("gripping_force", " N", 1e6), ("friction", "", 10.0))  # name, unit, most


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
        description: of arm and gripper.
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
    """

    name: str
    description: RobotDescription
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
        joints = len(self.description.arm.joints)
        if self.home.shape != (joints,) or not np.isfinite(self.home).all():
            raise InputError(f"must be {joints} finite joint angles, rad", f"{self.name}: robot.home")
        if self.goal.shape != (3,) or not np.isfinite(self.goal).all():
            raise InputError("must be three finite coordinates, m", f"{self.name}: goal")
        if not 0 < self.lift_height <= 1:
            raise InputError(f"{self.lift_height} m; must be above 0 and at most 1", f"{self.name}: lift_height")
        if not 0 <= self.clearance <= 0.02:
            raise InputError(f"{self.clearance} m; must be from 0 to 0.02", f"{self.name}: clearance")
        arm, gripper = self.description.arm, self.description.gripper
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
    def robot(self) -> str:
        """Name of the robot."""
        return self.description.name
