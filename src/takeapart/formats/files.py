"""Load and save assemblies, plans and workcells. docs/file-formats.md describes the formats."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from takeapart.formats.documents import read_json, read_toml, readable_json, write_atomically
from takeapart.formats.mesh_files import load_meshes, save_meshes
from takeapart.formats.messages import shortened, shown
from takeapart.formats.robot_files import load_robot_description
from takeapart.formats.schemas import (
    AssemblyModel,
    BoxModel,
    BoxShapeModel,
    JointModel,
    MeshShapeModel,
    PlanModel,
    PoseModel,
    StepModel,
    WorkcellModel,
    validated,
)
from takeapart.formats.serialization import assembly_document, assembly_hash, plan_document, workcell_hash
from takeapart.formats.shipped import data_path
from takeapart.model.assembly import CONTACT_GAP, FRICTION, Assembly, Connector, Joint, Part
from takeapart.model.errors import InputError, UnknownNameError
from takeapart.model.geometry import Array, Box, OrientedBox, Shape, pose
from takeapart.model.meshes import Mesh
from takeapart.model.plan import Grasp, Plan, PlanStep
from takeapart.workcell import Obstacle, Workcell

__all__ = [
    "assembly_hash",
    "data_path",
    "load_assembly",
    "load_plan",
    "load_workcell",
    "save_assembly",
    "save_plan",
    "workcell_hash",
]

WORKCELL_ENDING = ".toml"  # a text with another ending is the name of a shipped workcell
MAXIMUM_ASSEMBLY_BYTES = 8 * 2**20
MAXIMUM_PLAN_BYTES = 64 * 2**20
MAXIMUM_WORKCELL_BYTES = 64 * 2**10
MAXIMUM_WALLS = 8_000  # of all connectors together; the test for overlap grows with its square

PathLike = str | os.PathLike[str]


def load_assembly(path: PathLike) -> Assembly:
    """The assembly in a JSON file, with the meshes that it names.

    Raises:
        InputError: one line that names the file, the place inside it, the value, and what is valid.
    """
    where = shown(path)
    model = validated(AssemblyModel, read_json(path, MAXIMUM_ASSEMBLY_BYTES), where)
    walls = sum(len(connector.walls) for connector in model.connectors)
    if walls > MAXIMUM_WALLS:
        raise InputError(f"{walls} walls in all; at most {MAXIMUM_WALLS} are allowed", f"{where}: connectors")
    named = [
        (part.shape.file, part.shape.hash, f"{where}: parts[{i}].shape.file")
        for i, part in enumerate(model.parts)
        if part.shape.kind == "mesh"
    ]
    meshes = load_meshes(named, Path(path).parent)
    with _told_inside(where, model.name):
        return Assembly(
            name=model.name,
            parts=tuple(
                Part(part.name, _shape(part.shape, meshes), _pose(part.pose), part.mass, part.fixed)
                for part in model.parts
            ),
            connectors=tuple(
                Connector(c.name, c.kind, c.host, c.guest, tuple(_box(wall) for wall in c.walls))
                for c in model.connectors
            ),
            witness=tuple(model.witness),
            provenance=dict(model.provenance),
            joints=tuple(_joint(joint) for joint in model.joints or ()),
            friction=FRICTION if model.friction is None else model.friction,
            contact_gap=CONTACT_GAP if model.contact_gap is None else model.contact_gap,
            allowed_overlaps=tuple((first, second) for first, second in model.allowed_overlaps or ()),
        )


def save_assembly(assembly: Assembly, path: PathLike) -> None:
    """Write an assembly file, atomically, and before it the meshes of its parts below its folder.

    A mesh file that holds something else is never overwritten: until the new assembly file is there, the old one with
    its meshes is.

    Raises:
        InputError: the file cannot be written, or the assembly breaks the limits of the format.
    """
    document = assembly_document(assembly)
    validated(AssemblyModel, document, shown(path))
    save_meshes(assembly, Path(os.path.realpath(path)).parent)
    write_atomically(path, readable_json(document))


def load_plan(path: PathLike) -> Plan:
    """The plan in a JSON file; its form is checked, what it would do is for the verification.

    Raises:
        InputError: one line that names the file, the place inside it, the value, and what is valid.
    """
    model = validated(PlanModel, read_json(path, MAXIMUM_PLAN_BYTES), shown(path))
    return Plan(
        steps=tuple(_step(step) for step in model.steps),
        total_length=model.total_length,
        straight_line_bound=model.straight_line_bound,
        sequence_bound=model.sequence_bound,
        counts=model.counts.model_dump(),
        seconds=model.seconds,
        seed=model.seed,
        search=dict(model.search),
        hashes=model.hashes.model_dump(),
        versions=dict(model.versions),
        assembly=model.assembly,
        workcell=model.workcell,
        direction=model.direction,
        robot=model.robot or "",
        joints=tuple(model.joints or ()),
        remaining=tuple(model.remaining),
        extra=dict(model.extra),
    )


def save_plan(plan: Plan, path: PathLike) -> None:
    """Write a plan file, atomically.

    Raises:
        InputError: the file cannot be written, or the plan breaks the limits of the format.
    """
    document = plan_document(plan)
    validated(PlanModel, document, shown(path))
    write_atomically(path, readable_json(document))


def load_workcell(name_or_path: PathLike) -> Workcell:
    """A shipped workcell by its name, or the workcell in a TOML file.

    Raises:
        UnknownNameError: a bare name that is not shipped; the message lists the shipped ones.
        InputError: one line that names the file, the place inside it, the value, and what is valid.
    """
    text = os.fspath(name_or_path)
    if not text.endswith(WORKCELL_ENDING):
        shipped = {file.stem: file for file in data_path("workcells").glob("*.toml")}
        if text not in shipped:
            raise UnknownNameError("workcell", _nameable(text), [*shipped, "a path that ends in .toml"])
        text = str(shipped[text])
    where = shown(text)
    model = validated(WorkcellModel, read_toml(text, MAXIMUM_WORKCELL_BYTES), where)
    robot = model.robot
    key = "model" if robot.description is None else "description"
    named = robot.model if robot.description is None else robot.description
    description = load_robot_description(
        named or "", robot.gripper, robot.mount, Path(text).parent, f"{where}: robot.{key}"
    )
    with _told_inside(where, model.name):
        return Workcell(
            name=model.name,
            description=description,
            T_world_base=_pose(model.robot.base),
            home=np.array(description.arm.home if robot.home is None else robot.home, dtype=float),
            goal=np.array(model.goal, dtype=float),
            lift_height=model.lift_height,
            clearance=model.clearance,
            environment=tuple(Obstacle(obstacle.name, _box(obstacle)) for obstacle in model.environment),
            payload=_stated(model.robot.payload),
            gripping_force=_stated(model.robot.gripping_force),
            friction=_stated(model.robot.friction),
        )


@contextmanager
def _told_inside(where: str, name: str) -> Iterator[None]:
    """Errors of a data class name the file and the place inside it; they come with the name of the assembly or workcell
    instead."""
    try:
        yield
    except InputError as error:
        place = error.where.removeprefix(name).removeprefix(": ")
        raise InputError(error.message, f"{where}: {place}" if place else where) from None


def _nameable(name: str) -> str:
    """A name as a message can hold it; one that is shortened is no known name in any case."""
    return name if len(name) <= 100 else shortened(name)


def _stated(value: float | None) -> float:
    """A number as the data class takes it; not a number where the file leaves it to the robot's description."""
    return math.nan if value is None else value


def _shape(model: BoxShapeModel | MeshShapeModel, meshes: Mapping[str, Mesh]) -> Shape:
    return Box(_triple(model.size)) if model.kind == "box" else meshes[model.hash]


def _joint(model: JointModel) -> Joint:
    return Joint(
        name=model.name,
        kind=model.kind,
        first=model.first,
        second=model.second,
        points=np.array(model.points, dtype=float),
        axis=np.array(model.axis, dtype=float),
        strength=model.strength,
        release=model.release,
        pitch=model.pitch,
    )


def _triple(values: list[float]) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _pose(model: PoseModel) -> Array:
    return pose(model.position, model.orientation)


def _box(model: BoxModel) -> OrientedBox:
    return OrientedBox(_pose(model), np.array(model.size, dtype=float) / 2)


def _step(model: StepModel) -> PlanStep:
    grasp = model.grasp
    return PlanStep(
        part=model.part,
        grasp=Grasp(np.array(grasp.center, dtype=float), np.array(grasp.orientation, dtype=float), grasp.width),
        joint_path=np.array(model.joint_path, dtype=float),
        tool_path=np.array(model.tool_path, dtype=float),
        length=model.length,
    )
