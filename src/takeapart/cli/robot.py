"""``takeapart robot``: from a URDF to the description of an arm and a gripper, and to a workcell for a product."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from takeapart.cli.compile import compile_first
from takeapart.cli.output import (
    FILE,
    FiniteNumber,
    examples,
    json_option,
    print_json,
    progress_bar,
    require_output,
)
from takeapart.cli.robot_output import list_shipped, print_robot, robot_document, write_description, write_workcell
from takeapart.cli.robot_picture import draw_robot, require_picture
from takeapart.formats.messages import shown
from takeapart.model.errors import InputError

if TYPE_CHECKING:
    from takeapart.model.assembly import Assembly
    from takeapart.model.description import RobotDescription
    from takeapart.planning.placing import Placed
    from takeapart.robot.model import RobotModel
    from takeapart.workcell import Workcell


@click.command(
    name="robot",
    short_help="Describe an arm or a gripper from its URDF; list the shipped ones.",
    epilog=examples(
        "takeapart robot",
        "takeapart robot arm.urdf --gripper hand.urdf --payload 5 --out robot.toml",
        "takeapart robot xarm7 --product product.json --workcell cell.toml",
        "takeapart plan product.json --workcell cell.toml --out plan.json",
    ),
)
@click.argument("file", type=FILE, required=False, metavar="[URDF|NAME|FILE.toml]")
@click.option("--out", type=FILE, help="The description (.toml); without it nothing is written.")
@click.option(
    "--gripper", metavar="URDF|NAME|FILE.toml", help="What sits on the flange.  [default: the fingers in FILE, if any]"
)
@click.option(
    "--package",
    "packages",
    metavar="NAME=FOLDER",
    multiple=True,
    help="Where a package of the URDF is.  [default: looked for beside the URDF and in the folders above]",
)
@click.option("--payload", type=FiniteNumber(0.001, 1e4), help="What the arm may carry beyond the gripper, kg.")
@click.option("--force", type=FiniteNumber(0.001, 1e6), help="With which each finger presses, N.")
@click.option("--friction", type=FiniteNumber(0.001, 10), help="Coefficient between a finger's pad and a part.")
@click.option("--base", metavar="LINK", help="What is fixed to the world.  [default: found]")
@click.option("--flange", metavar="LINK", help="What the gripper is mounted on.  [default: found]")
@click.option("--mount", metavar='"X Y Z R P Y"', help="Pose of the gripper's base in the flange: m, and rad.")
@click.option("--name", help="Of the arm.  [default: that of the URDF]")
@click.option(
    "--product",
    "products",
    type=FILE,
    multiple=True,
    help="An assembly for which a place of the arm is looked for; several times for one place for all.",
)
@click.option("--workcell", type=FILE, help="The workcell with that place (.toml); goes with --product and --out.")
@click.option(
    "--picture",
    type=FILE,
    metavar="FILE.png",
    help="Draw the arm at home, and around it what the planner takes it for. Needs the extra view.",
)
@json_option
def robot(
    file: Path | None,
    out: Path | None,
    products: tuple[Path, ...],
    workcell: Path | None,
    picture: Path | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Describe the arm and the gripper in a URDF or a xacro file; without any list what is shipped.

    Found from the URDF alone: chain, base, flange, limits, a configuration at rest, whether the library of inverse
    kinematics brings the arm (by comparing forward kinematics), fingers, opening, and where the tool is at every
    opening. What no URDF says, as payload, force and friction, is taken from the options, or stated as not known.
    With --product and --workcell a place for the arm is looked for from which it takes the product apart.
    """
    if file is None:
        list_shipped(as_json)
        return
    from takeapart.cli.robot_finding import DESCRIBING, Stated, described_robot, found_in_urdf

    if bool(products) != (workcell is not None):
        raise click.UsageError("--product and --workcell go together")
    described = file.suffix not in DESCRIBING
    inputs = [file, *products]
    for target in (out, workcell):
        if target is not None:
            if target.suffix != ".toml":
                raise InputError("must end in .toml", shown(target))
            require_output(target, *inputs)
    if picture is not None:
        require_picture(picture, inputs)
    if workcell is not None and out is None and not described:
        raise click.UsageError("--workcell names the description: give --out too")
    if described and out is not None:
        raise click.UsageError(f"{shown(file)} is described already; --out is for a URDF")
    assemblies = _assemblies(products)

    stated = Stated(**options)
    found = described_robot(str(file), stated.gripper) if described else found_in_urdf(file, stated)
    model = _model(found.robot) if found.robot is not None else None
    placed = _placed(found.robot, assemblies, workcell)
    if out is not None:
        write_description(found, out)
    if workcell is not None and placed is not None:
        write_workcell(found, out, workcell, placed)
    if picture is not None:
        draw_robot(model, picture)
    if as_json:
        print_json(robot_document(found, model, placed))
    else:
        print_robot(found, model, placed, out, workcell)


def _model(description: RobotDescription) -> RobotModel:
    """The robot as the planner has it, standing alone."""
    from takeapart.robot.loading import load_robot

    with progress_bar(f"measuring {description.name}") as update:
        update("spheres and distances between links", None)
        return load_robot(_alone(description))


def _alone(description: RobotDescription) -> Workcell:
    import numpy as np

    from takeapart.workcell import Workcell

    return Workcell("alone", description, np.eye(4), np.array(description.arm.home), np.array([0.3, 0.0, 0.3]))


def _assemblies(products: Sequence[Path]) -> list[Assembly]:
    if not products:
        return []
    from takeapart.formats.files import load_assembly

    return [load_assembly(product) for product in products]


def _placed(
    description: RobotDescription | None, assemblies: Sequence[Assembly], workcell: Path | None
) -> Placed | None:
    if workcell is None:
        return None
    from takeapart.planning.placing import placed_for

    if description is None:
        raise InputError("a workcell needs an arm with a gripper; name one by --gripper", "--workcell")
    compile_first(_alone(description))
    with progress_bar(f"placing {description.name}") as update:
        return placed_for(description, assemblies, re.sub(r"[^A-Za-z0-9._-]", "-", workcell.stem)[:64], update)
