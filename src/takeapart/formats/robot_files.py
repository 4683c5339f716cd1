"""Files that describe arms and grippers: reading them, and finding the shipped ones; docs/robots.md explains them."""

from __future__ import annotations

import importlib.metadata
import os
from dataclasses import dataclass
from pathlib import Path

from takeapart.formats.documents import read_toml
from takeapart.formats.messages import shortened, shown
from takeapart.formats.robot_schemas import FROM_URDF, ArmModel, GripperModel, PlaceModel, RobotFileModel
from takeapart.formats.schemas import PoseModel, validated
from takeapart.formats.shipped import data_path
from takeapart.model.description import ArmDescription, GripperDescription, RobotDescription, RobotFiles
from takeapart.model.errors import InputError, UnknownNameError

ENDING = ".toml"  # a text with another ending is the name of a shipped description
MAXIMUM_BYTES = 2**20

PathLike = str | os.PathLike[str]
Mount = tuple[float, float, float, float, float, float, float]
AT_FLANGE: Mount = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class RobotFile:
    """What a file describes.

    Args:
        gripper: its own, or the one that it names.
        mount: position, m, and quaternion (w, x, y, z) of the gripper's base link in the flange.
    """

    arm: ArmDescription | None
    gripper: GripperDescription | None
    mount: Mount = AT_FLANGE


def shipped_robots() -> dict[str, Path]:
    """Files of the shipped descriptions by their names."""
    return {file.stem: file for file in sorted(data_path("robots").glob(f"*{ENDING}"))}


def load_robot_file(name_or_path: PathLike, folder: Path | None = None, where: str = "") -> RobotFile:
    """What a shipped description, by its name, or a TOML file describes.

    Args:
        folder: that a path is relative to; the working directory if None.
        where: place that names it, for messages.

    Raises:
        UnknownNameError: a bare name that is not shipped; the message lists the shipped ones.
        InputError: one line that names the file, the place inside it, the value, and what is valid.
    """
    text = os.fspath(name_or_path)
    if not text.endswith(ENDING):
        shipped = shipped_robots()
        if text not in shipped:
            nameable = text if len(text) <= 100 else shortened(text)
            raise UnknownNameError("robot", nameable, [*shipped, "a path that ends in .toml"], where)
        path = shipped[text]
    else:
        path = Path(text) if folder is None else folder / text
    place = shown(path)
    model = validated(RobotFileModel, read_toml(path, MAXIMUM_BYTES), place)
    mount = _mount(model.mount)
    gripper = None
    if model.gripper is not None:
        gripper = _gripper(model.gripper, path.parent, f"{place}: gripper")
    elif model.mount.gripper:
        gripper = load_robot_file(model.mount.gripper, path.parent, f"{place}: mount.gripper").gripper
        if gripper is None:
            raise InputError(f"{shortened(model.mount.gripper)} describes no gripper", f"{place}: mount.gripper")
    return RobotFile(_arm(model.arm, path.parent, f"{place}: arm") if model.arm else None, gripper, mount)


def load_robot_description(
    robot: PathLike,
    gripper: PathLike | None = None,
    mount: PoseModel | None = None,
    folder: Path | None = None,
    where: str = "",
) -> RobotDescription:
    """An arm with a gripper.

    Args:
        robot: name of a shipped description, or path of a file with an arm.
        gripper: another one than that file has: name, or path of a file with a gripper.
        mount: of the gripper on the flange; if None, that of the file for its own gripper, else none.
        folder: that paths are relative to; the working directory if None.
        where: place that names them, for messages.

    Raises:
        InputError: a file is broken or missing, describes no arm, or no gripper is there.
    """
    found = load_robot_file(robot, folder, where)
    if found.arm is None:
        raise InputError(f"{shortened(os.fspath(robot))} describes no arm; it must have [arm]", where)
    hand, at = found.gripper, found.mount
    if gripper is not None:
        hand, at = load_robot_file(gripper, folder, where).gripper, AT_FLANGE
        if hand is None:
            raise InputError(f"{shortened(os.fspath(gripper))} describes no gripper; it must have [gripper]", where)
    if hand is None:
        raise InputError(
            f"{shortened(os.fspath(robot))} has no gripper; name one: gripper = NAME or path of a file", where
        )
    return RobotDescription(found.arm, hand, at if mount is None else _mount(mount))


def _mount(model: PoseModel) -> Mount:
    x, y, z = model.position
    w, i, j, k = model.orientation
    return float(x), float(y), float(z), float(w), float(i), float(j), float(k)


def _arm(model: ArmModel, folder: Path, where: str) -> ArmDescription:
    return ArmDescription(
        name=model.name,
        files=_files(model, folder, where),
        base_link=model.base_link,
        flange_link=model.flange_link,
        joints=tuple(model.joints),
        payload=float(model.payload),
        home=tuple(float(angle) for angle in model.home),
        inverse_kinematics="" if model.inverse_kinematics == FROM_URDF else model.inverse_kinematics,
        left_out=tuple(model.left_out),
    )


def _gripper(model: GripperModel, folder: Path, where: str) -> GripperDescription:
    points = model.tool_points if len(model.tool_points) > 1 else model.tool_points * len(model.openings)
    w, i, j, k = model.tool_orientation
    return GripperDescription(
        name=model.name,
        files=_files(model, folder, where),
        base_link=model.base_link,
        finger_links=tuple(model.finger_links),
        joints=tuple(model.joints),
        openings=tuple(float(opening) for opening in model.openings),
        positions=tuple(tuple(float(value) for value in row) for row in model.positions),
        tool_points=tuple((float(x), float(y), float(z)) for x, y, z in points),
        tool_orientation=(float(w), float(i), float(j), float(k)),
        gripping_force=float(model.gripping_force),
        friction=float(model.friction),
    )


def _files(model: ArmModel | GripperModel, folder: Path, where: str) -> RobotFiles:
    packages = {
        name: _located(place, folder, f"{where}.packages.{shortened(name)}") for name, place in model.packages.items()
    }
    return RobotFiles(_located(model.urdf, folder, f"{where}.urdf"), packages)


def _located(place: PlaceModel, folder: Path, where: str) -> Path:
    """Path of a file or folder; one of a distribution is where that is installed."""
    if not place.distribution:
        found = (folder / place.path).resolve()
        if not found.exists():
            raise InputError(f"there is no file or folder {shown(found)}", where)
        return found
    install = f"install it with: pip install {shortened(place.distribution).strip(chr(39))}"
    try:
        found = Path(str(importlib.metadata.distribution(place.distribution).locate_file(place.path)))
    except (importlib.metadata.PackageNotFoundError, ValueError):
        raise InputError(
            f"needs the files of the package {shortened(place.distribution)}, which is not installed; {install}", where
        ) from None
    if not found.exists():
        raise InputError(f"the installed package {shortened(place.distribution)} has no {shortened(place.path)}", where)
    return found
