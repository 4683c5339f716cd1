"""What the files must look like: one strict pydantic model per format, and one clear line for whatever is wrong.

The models check form: keys, types, finite numbers, ranges, counts. What needs the whole assembly (overlap, unknown
hosts, the witness) is checked by the data classes themselves. docs/file-formats.md describes the formats.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from takeapart.formats.messages import kind_of, place, sentence, shortened
from takeapart.model.assembly import LONGEST_EDGE, MAXIMUM_PARTS, NAME_PATTERN, SHORTEST_EDGE
from takeapart.model.errors import InputError

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

MAXIMUM_CONNECTORS = 5000
MAXIMUM_WALLS = 64  # of one connector
MAXIMUM_OBSTACLES = 256
MAXIMUM_ROWS = 100_000  # of one path
MAXIMUM_JOINTS = 16
MAXIMUM_FASTENED = 10_000  # joints between parts
MAXIMUM_POINTS = 1000  # of one such joint
MAXIMUM_OVERLAPS = 10_000
MAXIMUM_TEXT = 4096
MAXIMUM_FREE_DEPTH = 8  # of values whose form is free (provenance, search)
MAXIMUM_FREE_VALUES = 20_000
UNIT_TOLERANCE = 1e-3  # of the norm of a quaternion


def _unit(quaternion: list[float]) -> list[float]:
    norm = math.hypot(*quaternion)
    if abs(norm - 1) > UNIT_TOLERANCE:
        raise PydanticCustomError("unit", "its norm is {norm}; must be a unit quaternion", {"norm": f"{norm:.6g}"})
    return quaternion


def _free(value: dict[str, object]) -> dict[str, object]:
    """Values whose form is free are still bounded, finite, and of the kinds that JSON knows."""
    count = 0
    stack: list[tuple[object, int]] = [(value, 1)]
    while stack:
        item, depth = stack.pop()
        count += 1
        if depth > MAXIMUM_FREE_DEPTH:
            raise PydanticCustomError("depth", f"nested deeper than {MAXIMUM_FREE_DEPTH} levels")
        if count > MAXIMUM_FREE_VALUES:
            raise PydanticCustomError("count", f"more than {MAXIMUM_FREE_VALUES} values")
        if isinstance(item, dict):
            stack += [(child, depth + 1) for pair in item.items() for child in pair]
        elif isinstance(item, list):
            stack += [(child, depth + 1) for child in item]
        elif isinstance(item, str):
            if len(item) > MAXIMUM_TEXT:
                raise PydanticCustomError("text", f"holds a text longer than {MAXIMUM_TEXT} characters")
        elif not (item is None or isinstance(item, bool | int) or (isinstance(item, float) and math.isfinite(item))):
            raise PydanticCustomError("free", "holds {bad}; only finite numbers are allowed", {"bad": shortened(item)})
    return value


Finite = Annotated[float, Field(allow_inf_nan=False)]
Length = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]
Edge = Annotated[float, Field(ge=SHORTEST_EDGE, le=LONGEST_EDGE, allow_inf_nan=False)]
Coordinate = Annotated[float, Field(ge=-100, le=100, allow_inf_nan=False)]
Angle = Annotated[float, Field(ge=-1000, le=1000, allow_inf_nan=False)]
Position = Annotated[list[Coordinate], Field(min_length=3, max_length=3, fail_fast=True)]
Size = Annotated[list[Edge], Field(min_length=3, max_length=3, fail_fast=True)]
Quaternion = Annotated[list[Finite], Field(min_length=4, max_length=4, fail_fast=True), AfterValidator(_unit)]
Name = Annotated[str, Field(max_length=64, pattern=f"^{NAME_PATTERN.pattern}$")]
Pair = Annotated[list[Name], Field(min_length=2, max_length=2, fail_fast=True)]
Force = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]
Text = Annotated[str, Field(max_length=MAXIMUM_TEXT)]
Hash = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Count = Annotated[int, Field(ge=0, le=2**63 - 1)]
Free = Annotated[dict[str, object], AfterValidator(_free)]


class _Model(BaseModel):
    """Strict: no conversion between types, and no key that is not known."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, defer_build=True)

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: object) -> object:
        unknown = [key for key in data if key not in cls.model_fields] if isinstance(data, dict) else []
        if unknown:
            text = f"unknown key {shortened(unknown[0])}; valid: {', '.join(cls.model_fields)}"
            raise PydanticCustomError("unknown_key", "{text}", {"text": text})
        return data


class PoseModel(_Model):
    """A pose; the orientation is a quaternion w, x, y, z."""

    position: Position
    orientation: Quaternion = [1.0, 0.0, 0.0, 0.0]


class BoxModel(PoseModel):
    """A box with the pose of its centre."""

    size: Size


class BoxShapeModel(_Model):
    """The shape of a part: a box around the origin of its frame."""

    kind: Literal["box"]
    size: Size


class MeshShapeModel(_Model):
    """The shape of a part: the surface in a file, in the part's frame; version 2."""

    kind: Literal["mesh"]
    file: Annotated[str, Field(min_length=1, max_length=256)]
    hash: Hash


SHAPES = ("box", "mesh")


class PartModel(_Model):
    """`takeapart.model.assembly.Part`."""

    name: Name
    shape: Annotated[BoxShapeModel | MeshShapeModel, Field(discriminator="kind")]
    pose: PoseModel
    mass: Annotated[float, Field(gt=0, le=1e5, allow_inf_nan=False)]
    fixed: bool = False


class ConnectorModel(_Model):
    """`takeapart.model.assembly.Connector`."""

    name: Name
    kind: Literal["U", "O"]
    host: Name
    guest: Name
    walls: Annotated[list[BoxModel], Field(min_length=1, max_length=MAXIMUM_WALLS, fail_fast=True)]


class JointModel(_Model):
    """`takeapart.model.assembly.Joint`."""

    name: Name
    kind: Literal["clutch", "snap", "screw", "glue"]
    first: Name
    second: Name
    points: Annotated[list[Position], Field(min_length=1, max_length=MAXIMUM_POINTS, fail_fast=True)]
    axis: Annotated[list[Finite], Field(min_length=3, max_length=3, fail_fast=True)]
    strength: Force
    release: Force = 0.0
    pitch: Annotated[float, Field(ge=-1, le=1, allow_inf_nan=False)] = 0.0


class AssemblyModel(_Model):
    """Assembly file; version 1 knows boxes and connectors alone."""

    format: Literal["takeapart/assembly"]
    version: Literal[1, 2]
    name: Name
    parts: Annotated[list[PartModel], Field(min_length=1, max_length=MAXIMUM_PARTS, fail_fast=True)]
    connectors: Annotated[list[ConnectorModel], Field(max_length=MAXIMUM_CONNECTORS, fail_fast=True)] = []
    joints: Annotated[list[JointModel], Field(max_length=MAXIMUM_FASTENED, fail_fast=True)] | None = None
    friction: Annotated[float, Field(ge=0, le=10, allow_inf_nan=False)] | None = None
    contact_gap: Annotated[float, Field(ge=0, le=0.01, allow_inf_nan=False)] | None = None
    allowed_overlaps: Annotated[list[Pair], Field(max_length=MAXIMUM_OVERLAPS, fail_fast=True)] | None = None
    witness: Annotated[list[Name], Field(max_length=MAXIMUM_PARTS, fail_fast=True)] = []
    provenance: Free = {}

    @model_validator(mode="after")
    def _version_of_keys(self) -> AssemblyModel:
        if self.version == 1:
            keys = ("joints", "friction", "contact_gap", "allowed_overlaps")
            newer = [f"key {key!r}" for key in keys if getattr(self, key) is not None]
            newer += [f"mesh, of part {part.name!r}" for part in self.parts if part.shape.kind == "mesh"]
            if newer:
                text = f"there is a {newer[0]}; version 1 has none, version 2 has"
                raise PydanticCustomError("version", "{text}", {"text": text})
        return self


class GraspModel(_Model):
    """`takeapart.model.plan.Grasp`."""

    center: Position
    orientation: Quaternion
    width: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


JointRow = Annotated[list[Angle], Field(min_length=1, max_length=MAXIMUM_JOINTS, fail_fast=True)]


def _tool_row(row: list[float]) -> list[float]:
    _unit(row[3:])
    return row


ToolRow = Annotated[list[Coordinate], Field(min_length=7, max_length=7, fail_fast=True), AfterValidator(_tool_row)]


class StepModel(_Model):
    """`takeapart.model.plan.PlanStep`."""

    part: Name
    grasp: GraspModel
    joint_path: Annotated[list[JointRow], Field(min_length=2, max_length=MAXIMUM_ROWS, fail_fast=True)]
    tool_path: Annotated[list[ToolRow], Field(min_length=2, max_length=MAXIMUM_ROWS, fail_fast=True)]
    length: Length

    @model_validator(mode="after")
    def _same_rows(self) -> StepModel:
        rows, joints = len(self.joint_path), len(self.joint_path[0])
        if len(self.tool_path) != rows:
            text = f"joint_path has {rows} rows and tool_path {len(self.tool_path)}; they must have the same number"
            raise PydanticCustomError("rows", "{text}", {"text": text})
        for i, row in enumerate(self.joint_path):
            if len(row) != joints:
                text = f"joint_path[{i}] has {len(row)} angles; every row must have {joints}, as the first has"
                raise PydanticCustomError("rows", "{text}", {"text": text})
        return self


class CountsModel(_Model):
    """Planner calls spent."""

    motion_plans: Count
    removal_queries: Count


class HashesModel(_Model):
    """SHA-256 of what the plan was made for."""

    assembly: Hash
    workcell: Hash


LinkName = Annotated[str, Field(min_length=1, max_length=256)]  # of a robot, link or joint, as its URDF has it


class PlanModel(_Model):
    """Plan file. `remaining` and `extra` are written only where there is something in them; version 1 has neither robot
    nor joints."""

    format: Literal["takeapart/plan"]
    version: Literal[1, 2]
    robot: LinkName | None = None
    joints: Annotated[list[LinkName], Field(min_length=1, max_length=MAXIMUM_JOINTS, fail_fast=True)] | None = None
    assembly: Name
    workcell: Name
    direction: Literal["disassembly", "assembly"] = "disassembly"
    total_length: Length
    straight_line_bound: Length
    sequence_bound: Length | None
    counts: CountsModel
    seconds: Length
    seed: Annotated[int, Field(ge=0, le=2**64 - 1)]
    search: Free
    hashes: HashesModel
    versions: Annotated[dict[Text, Text], Field(max_length=100)]
    steps: Annotated[list[StepModel], Field(max_length=MAXIMUM_PARTS, fail_fast=True)]
    remaining: Annotated[list[Name], Field(max_length=MAXIMUM_PARTS, fail_fast=True)] = []
    extra: Free = {}

    @model_validator(mode="after")
    def _remaining_stay(self) -> PlanModel:
        moved = {step.part for step in self.steps}
        for name in self.remaining:
            if name in moved or self.remaining.count(name) > 1:
                why = "is moved by a step" if name in moved else "stands twice"
                text = f"remaining: {shortened(name)} {why}; it names, once each, the parts that stay"
                raise PydanticCustomError("remaining", "{text}", {"text": text})
        return self

    @model_validator(mode="after")
    def _joints_of_paths(self) -> PlanModel:
        for key in ("robot", "joints"):
            absent = getattr(self, key) is None
            if absent == (self.version == 2):
                text = f"there is {'no' if absent else 'a'} key {key!r}; version 1 has none, version 2 has one"
                raise PydanticCustomError("version", "{text}", {"text": text})
        if self.joints is None:
            return self
        if len(set(self.joints)) < len(self.joints):
            twice = next(name for name in self.joints if self.joints.count(name) > 1)
            text = f"joints: {shortened(twice)} stands twice; every joint has a name of its own"
            raise PydanticCustomError("joints", "{text}", {"text": text})
        for i, step in enumerate(self.steps):
            angles = len(step.joint_path[0])
            if angles != len(self.joints):
                text = f"steps[{i}].joint_path has {angles} angles in a row, but {len(self.joints)} joints are named"
                raise PydanticCustomError("joints", "{text}", {"text": text})
        return self


class RobotModel(_Model):
    """Which robot, where it stands, how it rests and what it carries; what is left out is the robot's own."""

    model: Text | None = None
    description: Text | None = None
    gripper: Text | None = None
    mount: PoseModel | None = None
    base: PoseModel
    home: JointRow | None = None
    payload: Annotated[float, Field(gt=0, le=1e4, allow_inf_nan=False)] | None = None
    gripping_force: Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)] | None = None
    friction: Annotated[float, Field(gt=0, le=10, allow_inf_nan=False)] | None = None

    @model_validator(mode="after")
    def _one_robot(self) -> RobotModel:
        if (self.model is None) == (self.description is None):
            text = "must have either model (a shipped name) or description (a path that ends in .toml)"
            raise PydanticCustomError("rows", "{text}", {"text": text})
        return self


class ObstacleModel(BoxModel):
    """A box that must never be hit."""

    name: Name


class WorkcellModel(_Model):
    """Workcell file."""

    format: Literal["takeapart/workcell"]
    version: Literal[1]
    name: Name
    goal: Position
    lift_height: Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)] = 0.05
    clearance: Annotated[float, Field(ge=0, le=0.02, allow_inf_nan=False)] = 0.001
    robot: RobotModel
    environment: Annotated[list[ObstacleModel], Field(max_length=MAXIMUM_OBSTACLES, fail_fast=True)] = []


Model = TypeVar("Model", bound=_Model)


def validated(model: type[Model], data: object, where: str) -> Model:
    """The data in the form of a model.

    Args:
        data: what JSON or TOML gave.
        where: file name for messages.

    Raises:
        InputError: another format or version, or the first thing that is wrong: file, path
            inside it, value, what is valid.
    """
    _check_heading(model, data, where)
    try:
        return model.model_validate(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
    inside = place(_without_kinds(first))
    raise InputError(sentence(first), f"{where}: {inside}" if inside else where)


def _without_kinds(error: ErrorDetails) -> tuple[int | str, ...]:
    """Where it stands in the file: pydantic names the kind of a shape as if it were a step on the way to it."""
    steps: list[int | str] = []
    for step in error["loc"]:
        if not (steps and steps[-1] == "shape" and step in SHAPES):
            steps.append(step)
    return (*steps, "kind") if error["type"].startswith("union_tag") else tuple(steps)


def _check_heading(model: type[_Model], data: object, where: str) -> None:
    (form,) = model.model_fields["format"].annotation.__args__  # type: ignore[union-attr]
    versions = model.model_fields["version"].annotation.__args__  # type: ignore[union-attr]
    if not isinstance(data, dict):
        raise InputError(f'holds {kind_of(data)}; must be an object with "format": "{form}"', where)
    if data.get("format") != form:
        found = f"format {shortened(data['format'])}" if "format" in data else "there is no key 'format'"
        raise InputError(f"{found}; must be {form!r}", f"{where}: format")
    if type(data.get("version")) is not int or data["version"] not in versions:
        found = f"version {shortened(data['version'])}" if "version" in data else "there is no key 'version'"
        readable = " and ".join(str(version) for version in versions)
        raise InputError(f"{found}; this release reads version {readable}", f"{where}: version")
