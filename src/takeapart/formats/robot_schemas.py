"""What a file that describes an arm, a gripper, or both must look like; docs/robots.md explains it."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from takeapart.formats.messages import shortened
from takeapart.formats.schemas import (
    MAXIMUM_JOINTS,
    Finite,
    JointRow,
    Name,
    PoseModel,
    Position,
    Quaternion,
    Text,
    _Model,
)

MAXIMUM_OPENINGS = 1000
MAXIMUM_FINGER_LINKS = 32
MAXIMUM_PACKAGES = 100
SOLVERS = re.compile(r"ssik\.prebuilt(\.[A-Za-z0-9_]+)+")
FROM_URDF = "urdf"

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Label = Annotated[str, Field(min_length=1, max_length=200)]  # of a link or a joint, as the URDF has it


def _solver(name: str) -> str:
    """A file must not name just any module: it is imported."""
    if name != FROM_URDF and not SOLVERS.fullmatch(name):
        text = f"{shortened(name)}; must be 'urdf', or a module of ssik.prebuilt"
        raise PydanticCustomError("rows", "{text}", {"text": text})
    return name


def _rows(text: str) -> PydanticCustomError:
    return PydanticCustomError("rows", "{text}", {"text": text})


class PlaceModel(_Model):
    """A file or folder: relative to the file that names it, or inside an installed Python distribution."""

    path: Text
    distribution: Text = ""

    @model_validator(mode="before")
    @classmethod
    def _text(cls, data: object) -> object:
        return {"path": data} if isinstance(data, str) else data


Packages = Annotated[dict[Label, PlaceModel], Field(max_length=MAXIMUM_PACKAGES)]


class ArmModel(_Model):
    """`takeapart.model.description.ArmDescription`."""

    name: Name
    urdf: PlaceModel
    packages: Packages = Field(default_factory=dict)
    base_link: Label
    flange_link: Label
    joints: Annotated[list[Label], Field(min_length=1, max_length=MAXIMUM_JOINTS, fail_fast=True)]
    left_out: Annotated[list[Label], Field(max_length=MAXIMUM_FINGER_LINKS, fail_fast=True)] = Field(
        default_factory=list
    )
    home: JointRow
    payload: Annotated[float, Field(gt=0, le=1e4, allow_inf_nan=False)]
    inverse_kinematics: Annotated[Text, AfterValidator(_solver)] = FROM_URDF

    @model_validator(mode="after")
    def _lengths(self) -> ArmModel:
        if len(self.home) != len(self.joints):
            raise _rows(f"home has {len(self.home)} angles; must have {len(self.joints)}, one for each of the joints")
        return self


Openings = Annotated[
    list[Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]],
    Field(min_length=2, max_length=MAXIMUM_OPENINGS, fail_fast=True),
]
Values = Annotated[list[Finite], Field(min_length=2, max_length=MAXIMUM_OPENINGS, fail_fast=True)]


class GripperModel(_Model):
    """`takeapart.model.description.GripperDescription`."""

    name: Name
    urdf: PlaceModel
    packages: Packages = Field(default_factory=dict)
    base_link: Label
    finger_links: Annotated[list[Label], Field(min_length=2, max_length=MAXIMUM_FINGER_LINKS, fail_fast=True)]
    joints: Annotated[list[Label], Field(min_length=1, max_length=MAXIMUM_JOINTS, fail_fast=True)]
    openings: Openings
    positions: Annotated[list[Values], Field(min_length=1, max_length=MAXIMUM_JOINTS, fail_fast=True)]
    tool_points: Annotated[list[Position], Field(min_length=1, max_length=MAXIMUM_OPENINGS, fail_fast=True)]
    tool_orientation: Quaternion = Field(default_factory=lambda: [1.0, 0.0, 0.0, 0.0])
    gripping_force: Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)]
    friction: Annotated[float, Field(gt=0, le=10, allow_inf_nan=False)]

    @model_validator(mode="after")
    def _lengths(self) -> GripperModel:
        count = len(self.openings)
        if any(after <= before for before, after in zip(self.openings, self.openings[1:], strict=False)):
            raise _rows("openings must ascend")
        if len(self.positions) != len(self.joints):
            raise _rows(f"positions has {len(self.positions)} rows; must have one for each of the joints")
        for i, row in enumerate(self.positions):
            if len(row) != count:
                raise _rows(f"positions[{i}] has {len(row)} values; must have {count}, one for each of the openings")
        if len(self.tool_points) not in (1, count):
            raise _rows(f"tool_points has {len(self.tool_points)} rows; must have 1 or {count}, one for each opening")
        return self


class MountModel(PoseModel):
    """How a gripper sits on the flange; which one, if the file has none of its own."""

    position: Position = Field(default_factory=lambda: [0.0, 0.0, 0.0])
    gripper: Text = ""


class RobotFileModel(_Model):
    """File of an arm, of a gripper, or of both."""

    format: Literal["takeapart/robot"]
    version: Literal[1]
    arm: ArmModel | None = None
    gripper: GripperModel | None = None
    mount: MountModel = MountModel()

    @model_validator(mode="after")
    def _something(self) -> RobotFileModel:
        if self.arm is None and self.gripper is None:
            raise _rows("describes nothing; must have [arm], [gripper], or both")
        if self.gripper is not None and self.mount.gripper:
            raise _rows("mount.gripper names another gripper than [gripper]; give only one of them")
        return self
