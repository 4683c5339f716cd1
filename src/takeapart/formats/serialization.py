"""Assemblies, plans and workcells as plain data, and the hashes of what a plan was made for.

Lengths are rounded to 1e-9 m, angles to 1e-9 rad, orientations to nine decimals: compact, the same on every machine,
and what is loaded and saved again gives the same bytes.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from takeapart.formats.documents import canonical_json, read_bytes
from takeapart.formats.mesh_files import mesh_files
from takeapart.model.assembly import CONTACT_GAP, FRICTION, Assembly
from takeapart.model.description import ArmDescription, GripperDescription, RobotDescription
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, Box, OrientedBox, Shape, pose, quaternion_from_rotation
from takeapart.model.meshes import Mesh
from takeapart.model.plan import Plan
from takeapart.workcell import Workcell

DECIMALS = 9
MAXIMUM_URDF_BYTES = 32 * 2**20

Document = dict[str, Any]


def assembly_hash(assembly: Assembly) -> str:
    """SHA-256 of all that matters for planning: name, parts, connectors, joints; not witness and provenance.

    Of meshes the content counts, not the files.
    """
    document = assembly_document(assembly)
    for part in document["parts"]:
        part["shape"].pop("file", None)
    return _hash({key: value for key, value in document.items() if key not in ("witness", "provenance")})


def workcell_hash(workcell: Workcell) -> str:
    """SHA-256 of the workcell's data, with its robot and the robot's files."""
    return _workcell_hash(workcell, {"description": _description_document(workcell.description)})


def workcell_hash_by_name(workcell: Workcell) -> str:
    """The hash as plan files of version 1 have it: when robots were known by name, it held the name alone."""
    return _workcell_hash(workcell, {"model": workcell.description.name})


def _workcell_hash(workcell: Workcell, robot: Document) -> str:
    return _hash(
        {
            "version": 1,
            "name": workcell.name,
            "goal": _numbers(workcell.goal),
            "lift_height": _number(workcell.lift_height),
            "clearance": _number(workcell.clearance),
            "robot": {
                **robot,
                "base": _pose_document(workcell.T_world_base),
                "home": _numbers(workcell.home),
                "payload": _number(workcell.payload),
                "gripping_force": _number(workcell.gripping_force),
                "friction": _number(workcell.friction),
            },
            "environment": [{"name": o.name, **_box_document(o.box)} for o in workcell.environment],
        }
    )


def _description_document(description: RobotDescription) -> Document:
    """What an arm and a gripper are, wherever their files are; of the URDF files the content counts."""

    def part(data: ArmDescription | GripperDescription) -> Document:
        document = {key: value for key, value in asdict(data).items() if key != "files"}
        document["urdf"] = hashlib.sha256(read_bytes(data.files.urdf, MAXIMUM_URDF_BYTES)).hexdigest()
        rounded: Document = _rounded(document)
        return rounded

    return {
        "arm": part(description.arm),
        "gripper": part(description.gripper),
        "mount": _numbers(description.flange_gripper),
    }


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    return _number(value) if isinstance(value, float) else value


def motion_hash(plan: Plan) -> str:
    """SHA-256 of what a plan has the arm do, whichever way round it is told: assembly, workcell and steps."""
    removals = plan if plan.direction == "disassembly" else plan.inverted()
    document = _plain(plan_document(removals))  # a plan with numbers missing is refused by the verification, not here
    keys = ("assembly", "workcell", "joints", "hashes", "steps", "remaining")
    return _hash({key: document[key] for key in keys if key in document})


def _hash(document: Document) -> str:
    data = {key: value for key, value in document.items() if key != "format"}
    return hashlib.sha256(canonical_json(data).encode()).hexdigest()


def _number(value: float) -> float:
    return round(float(value), DECIMALS) + 0.0  # + 0.0: no minus zero


def _numbers(values: ArrayLike) -> list[Any]:
    rounded: list[Any] = (np.round(np.asarray(values, dtype=float), DECIMALS) + 0.0).tolist()
    return rounded


def _pose_document(T: Array) -> Document:
    return {"position": _numbers(T[:3, 3]), "orientation": _orientation(T[:3, :3])}


def _orientation(R: Array) -> list[float]:
    """Rounded quaternion of a rotation, chosen so that it comes back unchanged when it is loaded and saved again.

    Loading normalises, which can move the last decimal; every such move brings the norm closer to 1, so this ends.
    """
    rounded = _numbers(quaternion_from_rotation(R))
    for _ in range(10):
        again = _numbers(quaternion_from_rotation(pose(quaternion=rounded)[:3, :3]))
        if again == rounded:
            break
        rounded = again
    return rounded


def _box_document(box: OrientedBox) -> Document:
    return {"size": _numbers(2 * box.half_extents), **_pose_document(box.T_frame_box)}


def _shape_document(shape: Shape, files: Mapping[str, str], where: str) -> Document:
    if isinstance(shape, Box):
        return {"kind": "box", "size": _numbers(shape.size)}
    if isinstance(shape, Mesh):
        return {"kind": "mesh", "file": files[shape.hash], "hash": shape.hash}
    raise InputError(f"a shape of type {type(shape).__name__} has no file format; valid: Box, Mesh", where)


def assembly_document(assembly: Assembly) -> Document:
    """The assembly as its file holds it: of version 1 where boxes and connectors are all there is."""
    contacts = _contacts_document(assembly)
    files = mesh_files(assembly)
    return {
        "format": "takeapart/assembly",
        "version": 2 if contacts or files else 1,
        "name": assembly.name,
        "parts": [
            {
                "name": part.name,
                "shape": _shape_document(part.shape, files, f"{assembly.name}: parts[{i}].shape"),
                "pose": _pose_document(part.T_world_part),
                "mass": _number(part.mass),
                "fixed": bool(part.fixed),
            }
            for i, part in enumerate(assembly.parts)
        ],
        "connectors": [
            {
                "name": connector.name,
                "kind": connector.kind,
                "host": connector.host,
                "guest": connector.guest,
                "walls": [_box_document(wall) for wall in connector.walls],
            }
            for connector in assembly.connectors
        ],
        **contacts,
        "witness": list(assembly.witness),
        "provenance": _plain(assembly.provenance),
    }


def _contacts_document(assembly: Assembly) -> Document:
    """What is said of joints and contacts; nothing where all is as it is without a word."""
    document: Document = {}
    if assembly.joints:
        document["joints"] = [
            {
                "name": joint.name,
                "kind": joint.kind,
                "first": joint.first,
                "second": joint.second,
                "points": _numbers(joint.points),
                "axis": _numbers(joint.axis),
                "strength": _number(joint.strength),
                "release": _number(joint.release),
                "pitch": _number(joint.pitch),
            }
            for joint in assembly.joints
        ]
    if assembly.friction != FRICTION:
        document["friction"] = _number(assembly.friction)
    if assembly.contact_gap != CONTACT_GAP:
        document["contact_gap"] = _number(assembly.contact_gap)
    if assembly.allowed_overlaps:
        document["allowed_overlaps"] = [list(pair) for pair in assembly.allowed_overlaps]
    return document


def plan_document(plan: Plan) -> Document:
    """The plan as its file holds it."""
    document = {
        "format": "takeapart/plan",
        **_arm_document(plan),
        "assembly": plan.assembly,
        "workcell": plan.workcell,
        "direction": plan.direction,
        "total_length": _number(plan.total_length),
        "straight_line_bound": _number(plan.straight_line_bound),
        "sequence_bound": None if plan.sequence_bound is None else _number(plan.sequence_bound),
        "counts": _plain(plan.counts),
        "seconds": _number(plan.seconds),
        "seed": int(plan.seed),
        "search": _plain(plan.search),
        "hashes": _plain(plan.hashes),
        "versions": _plain(plan.versions),
        "steps": [
            {
                "part": step.part,
                "grasp": {
                    "center": _numbers(step.grasp.center),
                    "orientation": _numbers(step.grasp.orientation),
                    "width": _number(step.grasp.width),
                },
                "joint_path": _numbers(step.joint_path),
                "tool_path": _numbers(step.tool_path),
                "length": _number(step.length),
            }
            for step in plan.steps
        ],
    }
    more = {"remaining": list(plan.remaining), "extra": _plain(plan.extra)}
    return {**document, **{key: value for key, value in more.items() if value}}


def _arm_document(plan: Plan) -> Document:
    """Version, and whose joints the paths are of: what was read from a file of version 1 is written as one, because it
    does not say that."""
    return {"version": 2, "robot": plan.robot, "joints": list(plan.joints)} if plan.joints else {"version": 1}


def _plain(value: Any) -> Any:
    """Values as JSON knows them; what is infinite or not a number (a budget without limit) becomes null."""
    if isinstance(value, dict):
        return {str(key): _plain(child) for key, child in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(child) for child in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
