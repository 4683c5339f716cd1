"""Descriptions of robots and workcells as TOML that a person can read and change."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from takeapart.formats.robot_files import AT_FLANGE, Mount
from takeapart.formats.robot_schemas import FROM_URDF
from takeapart.model.description import ArmDescription, GripperDescription, RobotFiles
from takeapart.model.geometry import Array, quaternion_from_rotation
from takeapart.workcell import Workcell

LINE = 110  # characters of a list on one line


def robot_toml(
    arm: ArmDescription | None,
    gripper: GripperDescription | None,
    mount: Mount = AT_FLANGE,
    folder: Path = Path(),
    remarks: Mapping[str, str] | None = None,
    named_gripper: str = "",
) -> str:
    """The file of an arm, a gripper, or both.

    Args:
        folder: of the file; paths in it are relative to that.
        remarks: comments by the key that they stand behind, ``arm.payload``.
        named_gripper: name or path of another description that has the gripper.
    """
    notes = dict(remarks or {})
    lines = ['format = "takeapart/robot"', "version = 1"]
    if arm is not None:
        values: dict[str, object] = {
            "name": arm.name,
            "urdf": _relative(arm.files.urdf, folder),
            "base_link": arm.base_link,
            "flange_link": arm.flange_link,
            "joints": arm.joints,
        }
        if arm.left_out:
            values["left_out"] = arm.left_out
        values |= {
            "home": arm.home,
            "payload": arm.payload,
            "inverse_kinematics": arm.inverse_kinematics or FROM_URDF,
        }
        lines += _table("arm", values, notes) + _packages("arm", arm.files, folder)
    if gripper is not None and not named_gripper:
        points = gripper.tool_points if gripper.tool_moves else gripper.tool_points[:1]
        values = {
            "name": gripper.name,
            "urdf": _relative(gripper.files.urdf, folder),
            "base_link": gripper.base_link,
            "finger_links": gripper.finger_links,
            "joints": gripper.joints,
            "openings": gripper.openings,
            "positions": gripper.positions,
            "tool_points": points,
            "tool_orientation": gripper.tool_orientation,
            "gripping_force": gripper.gripping_force,
            "friction": gripper.friction,
        }
        lines += _table("gripper", values, notes) + _packages("gripper", gripper.files, folder)
    if named_gripper or mount != AT_FLANGE:
        values = {"gripper": named_gripper} if named_gripper else {}
        lines += _table("mount", values | {"position": mount[:3], "orientation": mount[3:]}, notes)
    return "\n".join(lines) + "\n"


def workcell_toml(workcell: Workcell, named: str, is_file: bool, heading: Sequence[str] = (), gripper: str = "") -> str:
    """The file of a workcell.

    Args:
        named: of the robot: name of a shipped description, or path of a file relative to the workcell's folder.
        is_file: whether it is a path.
        heading: comment at the top, line by line.
        gripper: another one than the description has, by name or path.
    """
    lines = [f"# {line}" for line in heading]
    lines += ['format = "takeapart/workcell"', "version = 1", f"name = {json.dumps(workcell.name)}"]
    lines += [f"goal = {_value([round(x, 4) for x in workcell.goal.tolist()])}   # m, where every removal ends"]
    lines += [f"lift_height = {workcell.lift_height!r}   # m, every removal starts with this much straight up"]
    lines += [f"clearance = {workcell.clearance!r}   # m, kept between everything that must not touch"]
    hand = {"gripper": gripper} if gripper else {}
    robot = {
        "description" if is_file else "model": named,
        **hand,
        "home": [round(x, 6) for x in workcell.home.tolist()],
    }
    lines += _table("robot", robot, {})
    lines += _table("robot.base", _pose(workcell.T_world_base), {})
    for obstacle in workcell.environment:
        size = [round(2 * half, 4) for half in obstacle.box.half_extents.tolist()]
        box = {"name": obstacle.name, "size": size} | _pose(obstacle.box.T_frame_box)
        lines += ["", "[[environment]]", *(f"{key} = {_value(value)}" for key, value in box.items())]
    return "\n".join(lines) + "\n"


def _pose(T: Array) -> dict[str, object]:
    position, orientation = T[:3, 3].tolist(), quaternion_from_rotation(T[:3, :3]).tolist()
    return {"position": [round(x, 4) for x in position], "orientation": [round(x, 9) for x in orientation]}


def _table(name: str, values: Mapping[str, object], notes: Mapping[str, str]) -> list[str]:
    lines = ["", f"[{name}]"]
    for key, value in values.items():
        remark = notes.get(f"{name}.{key}", "")
        text = f"{key} = {_value(value)}"
        if remark and "\n" in text:
            lines.append(f"# {key}: {remark}")
            remark = ""
        lines.append(f"{text}   # {remark}" if remark else text)
    return lines


def _packages(name: str, files: RobotFiles, folder: Path) -> list[str]:
    if not files.packages:
        return []
    rows = [f"{json.dumps(package)} = {_value(_relative(path, folder))}" for package, path in files.packages.items()]
    return ["", f"[{name}.packages]", *rows]


def _relative(path: Path, folder: Path) -> str:
    return os.path.relpath(path.resolve(), folder.resolve())


def _value(value: object, indent: str = "") -> str:
    """A value in TOML: texts as JSON has them, lists on one line where they fit."""
    if not isinstance(value, list | tuple):
        return json.dumps(value)
    inner = indent + "  "
    items = [_value(item, inner) for item in value]
    line = f"[{', '.join(items)}]"
    if len(line) + len(indent) <= LINE and "\n" not in line:
        return line
    rows: list[str] = []
    for item in items:
        if rows and len(rows[-1]) + len(item) < LINE and not item.startswith("["):
            rows[-1] += f" {item},"
        else:
            rows.append(f"{inner}{item},")
    return "[\n" + "\n".join(rows) + f"\n{indent}]"
