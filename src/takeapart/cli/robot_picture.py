"""``takeapart robot --picture``: an arm as the planner has it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from takeapart.cli.output import note, progress_bar, require_output
from takeapart.formats.messages import shown
from takeapart.model.errors import InputError

if TYPE_CHECKING:
    from takeapart.robot.model import RobotModel

EDGE = 1000  # pixels


def require_picture(picture: Path, inputs: Sequence[Path]) -> None:
    """Refuses a picture that could not be written, before the work."""
    if picture.suffix.lower() != ".png":
        raise InputError(f"unknown ending {picture.suffix!r}; give a name that ends in .png", shown(picture))
    require_output(picture, *inputs)


def draw_robot(model: RobotModel | None, picture: Path) -> None:
    """Writes the picture of a described arm."""
    if model is None:
        raise InputError("a picture needs an arm with a gripper; name one by --gripper", "--picture")
    from takeapart.pictures.model import RenderOptions
    from takeapart.pictures.output import save_png
    from takeapart.pictures.robot import robot_picture

    with progress_bar(f"drawing {model.description.name}"):
        save_png(robot_picture(model, RenderOptions(EDGE, EDGE, soft=True)), picture)
    note(f"drawn in {picture}: hulls of links blue, fingers that may touch a part green, other fingers orange")
