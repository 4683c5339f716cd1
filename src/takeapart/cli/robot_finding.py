"""What ``takeapart robot`` finds of an arm and a gripper: in a URDF, or in a description that is there already.

Imported only when it is asked: what it imports takes a second.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from takeapart.formats.messages import shown
from takeapart.formats.robot_files import AT_FLANGE, Mount, load_robot_file
from takeapart.model.description import ArmDescription, GripperDescription, RobotDescription, RobotFiles
from takeapart.model.errors import InputError
from takeapart.model.geometry import quaternion_from_rotation
from takeapart.robot.chain import arm_bodies, arm_chain, robot_bodies
from takeapart.robot.describe.arm import find_arm
from takeapart.robot.describe.gripper import find_gripper
from takeapart.robot.describe.groups import longest_chain
from takeapart.robot.describe.home import find_home
from takeapart.robot.describe.solver import prebuilt_solver
from takeapart.robot.urdf import Urdf, read_urdf

DESCRIBING = (".urdf", ".xacro", ".xml")  # endings of URDF files; any other file is a description that is made
ABOVE = 8  # folders above a URDF in which its packages are looked for


@dataclass(frozen=True)
class Stated:
    """What the options say of an arm and its gripper, as it is typed; None where they say nothing.

    Args:
        gripper: what sits on the flange: a URDF, or the name or file of a description.
        packages: of a URDF, each NAME=FOLDER.
        payload: beyond the gripper, kg.
        force: with which each finger presses, N.
        friction: between a finger's pad and a part.
        base: link that is fixed to the world.
        flange: link that the gripper is mounted on.
        mount: pose of the gripper's base in the flange: six numbers, m and rad.
        name: of the arm.
    """

    gripper: str | None = None
    packages: tuple[str, ...] = ()
    payload: float | None = None
    force: float | None = None
    friction: float | None = None
    base: str | None = None
    flange: str | None = None
    mount: str | None = None
    name: str | None = None


@dataclass(frozen=True)
class Found:
    """What the command found, and what it could not know.

    Args:
        named_gripper: name or path of the description that has the gripper, where the URDF has none.
        described: name or path of the description, where one was given and no URDF.
        mount: pose of the gripper's base in the flange.
        unknown: what neither the URDF nor an option says, a sentence each.
        remarks: the same for the file, by the keys behind which they stand.
    """

    arm: ArmDescription | None = None
    gripper: GripperDescription | None = None
    named_gripper: str = ""
    described: str = ""
    mount: Mount = AT_FLANGE
    unknown: tuple[str, ...] = ()
    remarks: Mapping[str, str] = field(default_factory=dict)

    @property
    def robot(self) -> RobotDescription | None:
        """Both as one robot; None where one is missing."""
        if self.arm is None or self.gripper is None:
            return None
        return RobotDescription(self.arm, self.gripper, self.mount)


def described_robot(named: str, gripper: str | None) -> Found:
    """What a shipped description or a file says, for a look at it or for a place.

    Args:
        gripper: name or file of another gripper.

    Raises:
        InputError: there is no such description, or it cannot be read.
    """
    file = load_robot_file(named)
    if gripper is None:
        return Found(file.arm, file.gripper, described=named, mount=file.mount)
    return Found(file.arm, load_robot_file(gripper).gripper, described=named, named_gripper=gripper)


def found_in_urdf(file: Path, stated: Stated) -> Found:
    """The arm, the gripper, or both that a URDF or xacro file holds.

    Raises:
        InputError: the file cannot be read, or holds neither; an option is no value that it can have.
    """
    known = _packages(stated.packages)
    urdf = read_urdf(_files(file, known))
    of_a_gripper = stated.base is None and stated.flange is None and stated.gripper is None
    if of_a_gripper and not longest_chain(urdf):
        hand = find_gripper(urdf, None, stated.name, stated.force, stated.friction)
        found = Found(gripper=hand.gripper)
    else:
        found = _found_arm(urdf, known, stated)
    if stated.mount is not None:
        found = replace(found, mount=_mount(stated.mount))
    if found.gripper is not None and not found.named_gripper:
        found = _with_assumed_grip(found, found.gripper, stated)
    return replace(found, arm=_completed(found, found.arm)) if found.arm is not None else found


def _found_arm(urdf: Urdf, known: Mapping[str, Path], stated: Stated) -> Found:
    """The arm, without solver and home, and what sits on it."""
    arm = find_arm(urdf, stated.base, stated.flange, stated.name, stated.payload)
    found = Found(arm.arm)
    if stated.payload is None:
        unknown = f"payload: {arm.arm.payload:g} kg is assumed; state it by --payload"
        remark = "kg beyond the gripper; not in the URDF: assumed"
        found = replace(found, unknown=(unknown,), remarks={"arm.payload": remark})
    gripper = stated.gripper
    if gripper is None and arm.gripper_base is not None:
        hand = find_gripper(urdf, arm.gripper_base, None, stated.force, stated.friction).gripper
        return replace(found, gripper=hand, mount=_between(urdf, arm.arm.flange_link, arm.gripper_base))
    if gripper is None:
        unknown = "gripper: there are no fingers in the URDF; name one by --gripper"
        return replace(found, unknown=(*found.unknown, unknown))
    if gripper.endswith((".urdf", ".xacro")):
        own = read_urdf(_files(Path(gripper), known))
        return replace(found, gripper=find_gripper(own, None, None, stated.force, stated.friction).gripper)
    described = load_robot_file(gripper, None, "--gripper").gripper
    if described is None:
        raise InputError(f"{gripper} describes no gripper", "--gripper")
    return replace(found, gripper=described, named_gripper=gripper)


def _with_assumed_grip(found: Found, hand: GripperDescription, stated: Stated) -> Found:
    """With what is assumed of force and friction, where no option states them."""
    unknown, remarks = list(found.unknown), dict(found.remarks)
    if stated.force is None:
        unknown.append(f"gripping force: {hand.gripping_force:g} N is assumed; state it by --force")
        remarks["gripper.gripping_force"] = "not in the URDF: assumed"
    if stated.friction is None:
        unknown.append(f"friction: {hand.friction:g} is assumed; state it by --friction")
        remarks["gripper.friction"] = "not in the URDF: assumed"
    return replace(found, unknown=tuple(unknown), remarks=remarks)


def _completed(found: Found, arm: ArmDescription) -> ArmDescription:
    """The arm with solver and home."""
    arm = replace(arm, inverse_kinematics=prebuilt_solver(arm))
    chain = arm_chain(read_urdf(arm.files), arm)
    if found.gripper is None:
        return replace(arm, home=find_home(arm, arm_bodies(arm, chain), np.eye(4)))
    robot = RobotDescription(arm, found.gripper, found.mount)
    T_flange_tool = robot.T_flange_tool(robot.maximum_opening)
    return replace(arm, home=find_home(arm, robot_bodies(robot, chain), T_flange_tool))


def _packages(stated: Sequence[str]) -> dict[str, Path]:
    found = {}
    for text in stated:
        name, mark, folder = text.partition("=")
        if not mark or not name or not folder:
            raise InputError(f"{text!r}; must be NAME=FOLDER", "--package")
        if not Path(folder).is_dir():
            raise InputError(f"{shown(folder)} of package {name!r} is no folder", "--package")
        found[name] = Path(folder).resolve()
    return found


def _files(file: Path, known: Mapping[str, Path]) -> RobotFiles:
    """A URDF with the packages that it names: those that are stated, else folders of that name beside it or above."""
    file = file.resolve()
    found: dict[str, Path] = {}
    try:
        text = file.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return RobotFiles(file)  # what is wrong is told when it is read
    for name in sorted(set(re.findall(r"package://([^/\"'<>\s]+)/", text))):
        folder = known.get(name) or _package_folder(file, name)
        if folder is not None:
            found[name] = folder
    return RobotFiles(file, found)


def _package_folder(file: Path, name: str) -> Path | None:
    for folder in list(file.parents)[:ABOVE]:
        if folder.name == name:
            return folder
        if (folder / name).is_dir():
            return folder / name
    return None


def _between(urdf: Urdf, flange: str, base: str) -> Mount:
    T = urdf.pose(flange, base)
    x, y, z = (round(float(value), 9) for value in T[:3, 3])
    w, i, j, k = (round(float(value), 12) for value in quaternion_from_rotation(T[:3, :3]))
    return x, y, z, w, i, j, k


def _mount(text: str) -> Mount:
    words = text.replace(",", " ").split()
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) != 6 or not all(map(math.isfinite, numbers)):
        raise InputError(f'{text!r}; must be six numbers "X Y Z ROLL PITCH YAW", m and rad', "--mount")
    x, y, z, *angles = numbers
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a / 2), math.sin(a / 2)) for a in angles)
    w = cr * cp * cy + sr * sp * sy
    i, j, k = sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    return x, y, z, w, i, j, k
