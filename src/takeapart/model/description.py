"""What an arm and a gripper are: their files, links and joints, and what no drawing tells; data only.

An arm is the chain of a URDF from its base link to its flange link. A gripper is the tree of links that hangs on its
base link, in a file of its own or in the arm's; it is mounted on the flange by a pose that the workcell or the
description states. Arms and grippers combine freely.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, pose


@dataclass(frozen=True)
class RobotFiles:
    """A URDF and where its meshes are.

    Args:
        urdf: the file.
        packages: folder of each package that ``package://NAME/...`` names.
    """

    urdf: Path
    packages: Mapping[str, Path] = field(default_factory=dict, hash=False)

    def resolve(self, uri: str) -> Path:
        """File of a mesh as the URDF names it: ``package://NAME/...``, ``file://...``, or relative to the URDF.

        Raises:
            InputError: the package is not known, or there is no such file.
        """
        if uri.startswith("package://"):
            package, _, relative = uri.removeprefix("package://").partition("/")
            if package not in self.packages:
                known = ", ".join(sorted(self.packages)) or "none"
                raise InputError(
                    f"package {package!r} of {uri!r} is not known; known: {known}; say where it is: "
                    f"--package {package}=FOLDER, or a line under packages of the description",
                    str(self.urdf),
                )
            found = self.packages[package] / relative
        else:
            found = self.urdf.parent / unquote(uri.removeprefix("file://"))
        if not found.is_file():
            raise InputError(f"there is no file {found}, which it names as {uri!r}", str(self.urdf))
        return found


@dataclass(frozen=True)
class ArmDescription:
    """A serial chain of joints that turn.

    Args:
        base_link: fixed to the world at the workcell's base pose.
        flange_link: what a gripper is mounted on.
        joints: in the order of a configuration.
        payload: what the arm may carry beyond its gripper, kg.
        home: configuration at rest, rad; a workcell may state another one.
        inverse_kinematics: module of the library that has this arm prebuilt; empty: worked out from the URDF.
        left_out: links of the file, with all that hangs on them, that are not part of the arm: a gripper of its own.
    """

    name: str
    files: RobotFiles
    base_link: str
    flange_link: str
    joints: tuple[str, ...]
    payload: float
    home: tuple[float, ...]
    inverse_kinematics: str = ""
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True)
class GripperDescription:
    """Two fingers, or two groups of them, that close on a part; moved by one joint that others may mimic.

    Args:
        base_link: what is mounted on the flange; everything that hangs on it belongs to the gripper.
        finger_links: the links with the pads, which touch the part: first those of one side, then of the other.
        joints: that the opening sets, each by its row of `positions`; joints that mimic others are not among them.
        openings: (K,) m between the pads, ascending, at which the rest is tabulated; between them it is linear.
        positions: (len(joints), K) rad or m.
        tool_points: (K, 3) m, the point between the pads in the frame of the base link.
        tool_orientation: quaternion (w, x, y, z) of the tool frame in that of the base link: z is the approach
            direction, y the closing direction of the fingers.
        gripping_force: with which each finger presses on the part, N.
        friction: coefficient between a finger's pad and the part.
    """

    name: str
    files: RobotFiles
    base_link: str
    finger_links: tuple[str, ...]
    joints: tuple[str, ...]
    openings: tuple[float, ...]
    positions: tuple[tuple[float, ...], ...]
    tool_points: tuple[tuple[float, float, float], ...]
    tool_orientation: tuple[float, float, float, float]
    gripping_force: float
    friction: float

    @property
    def maximum_opening(self) -> float:
        """Between the pads, m."""
        return self.openings[-1]

    def joint_positions(self, opening: float) -> dict[str, float]:
        """Value of every joint of `joints`, rad or m, at an opening, m."""
        return {
            name: float(np.interp(opening, self.openings, row))
            for name, row in zip(self.joints, self.positions, strict=True)
        }

    def T_base_tool(self, opening: float) -> Array:
        """Pose (4, 4) of the tool frame in that of the base link at an opening, m."""
        point = [float(np.interp(opening, self.openings, row)) for row in np.transpose(self.tool_points)]
        return pose(point, self.tool_orientation)

    @property
    def tool_moves(self) -> bool:
        """Whether the tool frame depends on the opening."""
        return bool(np.ptp(self.tool_points, axis=0).any())


@dataclass(frozen=True)
class RobotDescription:
    """An arm with a gripper on its flange.

    Args:
        flange_gripper: position (x, y, z), m, and quaternion (w, x, y, z) of the gripper's base link in the flange.
    """

    arm: ArmDescription
    gripper: GripperDescription
    flange_gripper: tuple[float, float, float, float, float, float, float] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)

    @property
    def name(self) -> str:
        """Of the arm, and of the gripper where it is not the arm's own."""
        return self.arm.name if self.gripper.name == self.arm.name else f"{self.arm.name} + {self.gripper.name}"

    @property
    def T_flange_gripper(self) -> Array:
        """(4, 4)."""
        return pose(self.flange_gripper[:3], self.flange_gripper[3:])

    def T_flange_tool(self, opening: float) -> Array:
        """Pose (4, 4) of the tool frame in the flange at an opening of the fingers, m."""
        T: Array = self.T_flange_gripper @ self.gripper.T_base_tool(opening)
        return T

    @property
    def maximum_opening(self) -> float:
        """Between the pads, m."""
        return self.gripper.maximum_opening
