"""An arm with six joints, four of which turn twice round, and a gripper of a linkage: fingers that swing, tool and all.

Written as URDF by hand, of boxes, cylinders and spheres. Its fingers stay parallel while their knuckles swing, so the
pads move forward while they close; what is right of it follows from one angle (`knuckle_angle`).
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from takeapart.model.description import ArmDescription, GripperDescription, RobotDescription, RobotFiles

TWICE = 2 * math.pi
LIMITS = ((-TWICE, TWICE), (-TWICE, TWICE), (-3.0, 3.0), (-TWICE, TWICE), (-TWICE, TWICE), (-TWICE, TWICE))
HOME = (0.0, -1.9, 1.9, -1.57, -1.57, 0.0)  # rad

KNUCKLE, PIVOT_Y, PIVOT_Z = 0.055, 0.030, 0.045  # m: length of a knuckle, and where it swings
PAD_Z, PAD_Y = 0.028, 0.030  # m: middle of the pad beyond the knuckle's end, and its face towards the middle
OPENINGS = (0.0, 0.085)  # m

_JOINTS = (  # parent's frame to the joint's: position and roll, pitch, yaw; axis
    ("0 0 0.16", "0 0 0", "0 0 1"),
    ("0 0.13 0", "0 1.5707963267948966 0", "0 1 0"),
    ("0 -0.11 0.42", "0 0 0", "0 1 0"),
    ("0 0 0.38", "0 1.5707963267948966 0", "0 1 0"),
    ("0 0.10 0", "0 0 0", "0 0 1"),
    ("0 0 0.10", "0 0 0", "0 1 0"),
)
_GEOMETRY = (  # of the base and of every link
    '<geometry><cylinder radius="0.07" length="0.14"/></geometry><origin xyz="0 0 0.07"/>',
    '<geometry><cylinder radius="0.055" length="0.12"/></geometry><origin xyz="0 0.02 0"/>',
    '<geometry><box size="0.09 0.09 0.46"/></geometry><origin xyz="0 0 0.21"/>',
    '<geometry><box size="0.07 0.07 0.40"/></geometry><origin xyz="0 0 0.19"/>',
    '<geometry><cylinder radius="0.04" length="0.09"/></geometry><origin xyz="0 0.05 0" rpy="1.5707963267948966 0 0"/>',
    '<geometry><cylinder radius="0.038" length="0.09"/></geometry><origin xyz="0 0 0.05"/>',
    '<geometry><sphere radius="0.036"/></geometry><origin xyz="0 0.03 0"/>',
)


def knuckle_angle(opening: float) -> float:
    """Angle of the knuckles, rad, at which the pads are so far apart, m."""
    return math.asin((opening / 2 + PAD_Y - PIVOT_Y) / KNUCKLE)


def tool_point(opening: float) -> tuple[float, float, float]:
    """Middle between the pads in the gripper's base, m."""
    return 0.0, 0.0, PIVOT_Z + KNUCKLE * math.cos(knuckle_angle(opening)) + PAD_Z


def _arm(limits: tuple[tuple[float, float], ...]) -> str:
    text = '<robot name="six"><link name="base"><collision>' + _GEOMETRY[0] + "</collision></link>\n"
    for k, ((xyz, rpy, axis), geometry, (low, high)) in enumerate(zip(_JOINTS, _GEOMETRY[1:], limits, strict=True), 1):
        text += f'<link name="link{k}"><collision>{geometry}</collision></link>\n'
        text += f'<joint name="joint{k}" type="revolute"><parent link="{f"link{k - 1}" if k > 1 else "base"}"/>'
        text += f'<child link="link{k}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
        text += f'<limit lower="{low}" upper="{high}" effort="1" velocity="1"/></joint>\n'
    text += '<link name="flange"/><joint name="mount" type="fixed"><parent link="link6"/><child link="flange"/>'
    return text + '<origin xyz="0 0.07 0" rpy="-1.5707963267948966 0 0"/></joint></robot>\n'


def _gripper() -> str:
    text = '<robot name="linkage"><link name="palm"><collision><geometry><box size="0.07 0.09 0.05"/></geometry>'
    text += '<origin xyz="0 0 0.025"/></collision></link>\n'
    for side, sign in (("left", 1), ("right", -1)):
        mimic = "" if sign > 0 else '<mimic joint="left_knuckle_joint" multiplier="-1" offset="0"/>'
        text += f'<link name="{side}_knuckle"><collision><geometry><box size="0.016 0.012 {KNUCKLE}"/></geometry>'
        text += f'<origin xyz="0 0 {KNUCKLE / 2}"/></collision></link>\n'
        text += (
            f'<joint name="{side}_knuckle_joint" type="revolute"><parent link="palm"/><child link="{side}_knuckle"/>'
        )
        text += f'<origin xyz="0 {sign * PIVOT_Y} {PIVOT_Z}"/><axis xyz="-1 0 0"/>{mimic}'
        text += '<limit lower="-1.2" upper="1.2" effort="1" velocity="1"/></joint>\n'
        text += f'<link name="{side}_pad"><collision><geometry><box size="0.02 0.01 0.04"/></geometry>'
        text += f'<origin xyz="0 {-sign * (PAD_Y - 0.005)} {PAD_Z}"/></collision></link>\n'
        text += (
            f'<joint name="{side}_pad_joint" type="revolute"><parent link="{side}_knuckle"/><child link="{side}_pad"/>'
        )
        text += f'<origin xyz="0 0 {KNUCKLE}"/><axis xyz="1 0 0"/>'
        text += f'<mimic joint="left_knuckle_joint" multiplier="{sign}" offset="0"/>'
        text += '<limit lower="-1.2" upper="1.2" effort="1" velocity="1"/></joint>\n'
    return text + "</robot>\n"


def linkage_robot(folder: Path, limits: tuple[tuple[float, float], ...] = LIMITS) -> RobotDescription:
    """Writes the files and describes them.

    Args:
        limits: of the joints, rad.
    """
    files = {name: folder / f"{name}.urdf" for name in ("six", "linkage")}
    files["six"].write_text(_arm(limits))
    files["linkage"].write_text(_gripper())
    openings = tuple(np.linspace(*OPENINGS, 35).tolist())
    six = ArmDescription(
        "six", RobotFiles(files["six"]), "base", "flange", tuple(f"joint{k}" for k in range(1, 7)), 5.0, HOME
    )
    linkage = GripperDescription(
        name="linkage",
        files=RobotFiles(files["linkage"]),
        base_link="palm",
        finger_links=("left_pad", "right_pad"),
        joints=("left_knuckle_joint",),
        openings=openings,
        positions=(tuple(knuckle_angle(opening) for opening in openings),),
        tool_points=tuple(tool_point(opening) for opening in openings),
        tool_orientation=(1.0, 0.0, 0.0, 0.0),
        gripping_force=60.0,
        friction=0.5,
    )
    return RobotDescription(six, linkage)
