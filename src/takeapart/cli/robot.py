"""``takeapart robot``: from a URDF to the description of an arm and a gripper, and to a workcell for a product."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from takeapart.cli.compile import compile_first
from takeapart.cli.output import (
    FILE,
    FiniteNumber,
    examples,
    json_option,
    note,
    print_json,
    print_table,
    progress_bar,
    require_output,
)
from takeapart.formats.messages import shown
from takeapart.model.errors import InputError

if TYPE_CHECKING:
    from takeapart.formats.robot_files import Mount
    from takeapart.model.assembly import Assembly
    from takeapart.model.description import ArmDescription, GripperDescription, RobotDescription, RobotFiles
    from takeapart.planning.placing import Placed
    from takeapart.robot.model import RobotModel
    from takeapart.workcell import Workcell

ABOVE = 8  # folders above a URDF in which its packages are looked for


@dataclass
class Found:
    """What the command found, and what it could not know.

    Args:
        named_gripper: name or path of the description that has the gripper, where the URDF has none.
        described: name or path of the description, where one was given and no URDF.
    """

    arm: ArmDescription | None = None
    gripper: GripperDescription | None = None
    named_gripper: str = ""
    described: str = ""
    mount: Mount = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    unknown: list[str] = field(default_factory=list)
    remarks: dict[str, str] = field(default_factory=dict)


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
@json_option
def robot(
    file: Path | None,
    out: Path | None,
    gripper: str | None,
    packages: Sequence[str],
    payload: float | None,
    force: float | None,
    friction: float | None,
    base: str | None,
    flange: str | None,
    mount: str | None,
    name: str | None,
    products: tuple[Path, ...],
    workcell: Path | None,
    as_json: bool,
) -> None:
    """Describe the arm and the gripper in a URDF or a xacro file; without any list what is shipped.

    Found from the URDF alone: chain, base, flange, limits, a configuration at rest, whether the library of inverse
    kinematics brings the arm (by comparing forward kinematics), fingers, opening, and where the tool is at every
    opening. What no URDF says, as payload, force and friction, is taken from the options, or stated as not known.
    With --product and --workcell a place for the arm is looked for from which it takes the product apart.
    """
    if file is None:
        _list_shipped(as_json)
        return
    if bool(products) != (workcell is not None):
        raise click.UsageError("--product and --workcell go together")
    described = file.suffix not in (".urdf", ".xacro", ".xml")
    inputs = [file, *products]
    for target in (out, workcell):
        if target is not None:
            if target.suffix != ".toml":
                raise InputError("must end in .toml", shown(target))
            require_output(target, *inputs)
    if workcell is not None and out is None and not described:
        raise click.UsageError("--workcell names the description: give --out too")
    if described and out is not None:
        raise click.UsageError(f"{shown(file)} is described already; --out is for a URDF")
    assemblies = _assemblies(products)

    if described:
        found = _described(str(file), gripper)
    else:
        found = _found(file, gripper, packages, payload, force, friction, base, flange, mount, name)
    description = _whole(found)
    model = None
    if description is not None:
        model = _model(description)
    placed = _placed(description, assemblies, workcell)
    if out is not None:
        _write(found, out)
    if workcell is not None and placed is not None:
        _write_workcell(found, out, workcell, placed)
    if as_json:
        print_json(_document(found, model, placed))
    else:
        _print(found, model, placed, out, workcell)


def _list_shipped(as_json: bool) -> None:
    from takeapart.formats.robot_files import load_robot_file, shipped_robots

    rows = []
    for name in shipped_robots():
        try:
            file = load_robot_file(name)
        except InputError as error:
            rows.append([name, "", "", error.message])
            continue
        arm = f"{file.arm.name}, {len(file.arm.joints)} joints, {file.arm.payload:g} kg" if file.arm else ""
        hand = f"{file.gripper.name}, opens {1e3 * file.gripper.maximum_opening:.0f} mm" if file.gripper else ""
        rows.append([name, arm, hand, ""])
    if as_json:
        print_json([dict(zip(("name", "arm", "gripper", "missing"), row, strict=True)) for row in rows])
    else:
        print_table("shipped robots", ["name", "arm", "gripper", ""], rows)


# ---- finding


def _described(named: str, gripper: str | None) -> Found:
    """What a shipped description or a file says, for a look at it or for a place."""
    from takeapart.formats.robot_files import AT_FLANGE, load_robot_file

    file = load_robot_file(named)
    found = Found(file.arm, file.gripper, described=named, mount=file.mount)
    if gripper is not None:
        found.gripper, found.named_gripper, found.mount = load_robot_file(gripper).gripper, gripper, AT_FLANGE
    return found


def _found(
    file: Path,
    gripper: str | None,
    packages: Sequence[str],
    payload: float | None,
    force: float | None,
    friction: float | None,
    base: str | None,
    flange: str | None,
    mount: str | None,
    name: str | None,
) -> Found:
    from takeapart.robot.describe.arm import find_arm
    from takeapart.robot.describe.gripper import find_gripper
    from takeapart.robot.describe.groups import longest_chain
    from takeapart.robot.urdf import read_urdf

    known = _packages(packages)
    urdf = read_urdf(_files(file, known))
    found = Found()
    if not longest_chain(urdf) and base is None and flange is None and gripper is None:
        hand = find_gripper(urdf, None, name, force, friction)
        found.gripper = hand.gripper
    else:
        arm = find_arm(urdf, base, flange, name, payload)
        found.arm = arm.arm
        if payload is None:
            found.unknown.append(f"payload: {arm.arm.payload:g} kg is assumed; state it by --payload")
            found.remarks["arm.payload"] = "kg beyond the gripper; not in the URDF: assumed"
        if gripper is None and arm.gripper_base is not None:
            found.gripper = find_gripper(urdf, arm.gripper_base, None, force, friction).gripper
            found.mount = _between(urdf, arm.arm.flange_link, arm.gripper_base)
        elif gripper is None:
            found.unknown.append("gripper: there are no fingers in the URDF; name one by --gripper")
        elif gripper.endswith((".urdf", ".xacro")):
            own = read_urdf(_files(Path(gripper), known))
            found.gripper = find_gripper(own, None, None, force, friction).gripper
        else:
            from takeapart.formats.robot_files import load_robot_file

            found.gripper, found.named_gripper = load_robot_file(gripper, None, "--gripper").gripper, gripper
            if found.gripper is None:
                raise InputError(f"{gripper} describes no gripper", "--gripper")
    if mount is not None:
        found.mount = _stated_mount(mount)
    if found.gripper is not None and not found.named_gripper:
        for key, value, stated, unit in (
            ("gripping_force", found.gripper.gripping_force, force, " N"),
            ("friction", found.gripper.friction, friction, ""),
        ):
            if stated is None:
                option = "--force" if unit else "--friction"
                found.unknown.append(f"{key.replace('_', ' ')}: {value:g}{unit} is assumed; state it by {option}")
                found.remarks[f"gripper.{key}"] = "not in the URDF: assumed"
    if found.arm is not None:
        found.arm = _completed(found)
    return found


def _completed(found: Found) -> ArmDescription:
    """The arm with solver and home."""
    import numpy as np

    from takeapart.model.description import RobotDescription
    from takeapart.robot.chain import arm_bodies, arm_chain, robot_bodies
    from takeapart.robot.describe.home import find_home
    from takeapart.robot.describe.solver import prebuilt_solver
    from takeapart.robot.urdf import read_urdf

    assert found.arm is not None
    arm = replace(found.arm, inverse_kinematics=prebuilt_solver(found.arm))
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


def _files(file: Path, known: dict[str, Path]) -> RobotFiles:
    """A URDF with the packages that it names: those that are stated, else folders of that name beside it or above."""
    from takeapart.model.description import RobotFiles

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


def _between(urdf: Any, flange: str, base: str) -> Mount:
    from takeapart.model.geometry import quaternion_from_rotation

    T = urdf.pose(flange, base)
    x, y, z = (round(float(value), 9) for value in T[:3, 3])
    w, i, j, k = (round(float(value), 12) for value in quaternion_from_rotation(T[:3, :3]))
    return x, y, z, w, i, j, k


def _stated_mount(text: str) -> Mount:
    import math

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


def _whole(found: Found) -> RobotDescription | None:
    from takeapart.model.description import RobotDescription

    if found.arm is None or found.gripper is None:
        return None
    return RobotDescription(found.arm, found.gripper, found.mount)


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


# ---- what is written and printed


def _write(found: Found, out: Path) -> None:
    import os

    from takeapart.formats.documents import write_atomically
    from takeapart.formats.robot_files import ENDING, load_robot_file
    from takeapart.formats.robot_writing import robot_toml

    named = found.named_gripper
    if named.endswith(ENDING):
        named = os.path.relpath(Path(named).resolve(), out.resolve().parent)
    write_atomically(out, robot_toml(found.arm, found.gripper, found.mount, out.parent, found.remarks, named))
    load_robot_file(out.resolve())  # what was written is read again


def _write_workcell(found: Found, out: Path | None, workcell: Path, placed: Placed) -> None:
    import os

    from takeapart.formats.documents import write_atomically
    from takeapart.formats.robot_files import ENDING
    from takeapart.formats.robot_writing import workcell_toml

    def near(path: str) -> str:
        is_file = path.endswith(ENDING)
        return os.path.relpath(Path(path).resolve(), workcell.resolve().parent) if is_file else path

    named = near(found.described or str(out))
    gripper = near(found.named_gripper) if found.described else ""
    heading = [f"The arm takes away {placed.removable} of {placed.of} parts; {placed.tried} places were tried."]
    write_atomically(workcell, workcell_toml(placed.workcell, named, named.endswith(ENDING), heading, gripper))


def _document(found: Found, model: RobotModel | None, placed: Placed | None) -> dict[str, Any]:
    def part(data: Any) -> dict[str, Any] | None:
        if data is None:
            return None
        plain = asdict(data)
        plain["files"] = {"urdf": str(data.files.urdf), "packages": {k: str(v) for k, v in data.files.packages.items()}}
        return plain

    document: dict[str, Any] = {"arm": part(found.arm), "gripper": part(found.gripper), "mount": found.mount}
    document["not_known"] = found.unknown
    if model is not None:
        starts = model.arm.body_start.tolist()
        document["bodies"] = [
            {"link": link, "spheres": after - before, "inflation": model.inflation[link]}
            for link, before, after in zip(model.bodies, starts, starts[1:], strict=False)
        ]
        document["pairs"] = [
            {
                "links": [model.bodies[pair.first], model.bodies[pair.second]],
                "treatment": pair.treatment,
                "least_distance": pair.least,
            }
            for pair in model.pairs
        ]
        document["lower"], document["upper"] = model.arm.lower.tolist(), model.arm.upper.tolist()
    if placed is not None:
        document["placed"] = {"removable": placed.removable, "of": placed.of, "tried": placed.tried}
    return document


def _print(found: Found, model: RobotModel | None, placed: Placed | None, out: Path | None, cell: Path | None) -> None:
    rows: list[list[str]] = []
    if found.arm is not None:
        arm = found.arm
        rows += [
            ["arm", f"{arm.name}: {len(arm.joints)} joints from {arm.base_link} to {arm.flange_link}"],
            ["payload", f"{arm.payload:g} kg"],
            ["at rest", "  ".join(f"{angle:.3f}" for angle in arm.home) + " rad"],
            ["inverse kinematics", arm.inverse_kinematics or "worked out from the URDF when it is first needed"],
        ]
    if found.gripper is not None:
        hand = found.gripper
        shift = 1e3 * (hand.tool_points[0][2] - hand.tool_points[-1][2])
        moves = f", the tool moves {abs(shift):.1f} mm meanwhile" if hand.tool_moves else ""
        rows += [
            ["gripper", f"{hand.name}, moved by {', '.join(hand.joints)}"],
            ["fingers", ", ".join(hand.finger_links)],
            ["opening", f"{1e3 * hand.openings[0]:.1f} to {1e3 * hand.maximum_opening:.1f} mm{moves}"],
            ["grip", f"{hand.gripping_force:g} N, friction {hand.friction:g}"],
        ]
    print_table("", ["", ""], rows)
    if model is not None:
        _print_model(model)
    for line in found.unknown:
        note(f"not known: {line}")
    if placed is not None:
        note(f"placed: {placed.removable} of {placed.of} parts are taken away; {placed.tried} places tried")
    for path in (out, cell):
        if path is not None:
            click.echo(f"written: {shown(path)}")


def _print_model(model: RobotModel) -> None:
    arm = model.description.arm
    limits = zip(arm.joints, model.arm.lower.tolist(), model.arm.upper.tolist(), strict=True)
    click.echo("")
    print_table("", ["joint", ">lower, rad", ">upper, rad"], [[n, f"{a:.3f}", f"{b:.3f}"] for n, a, b in limits])
    starts = model.arm.body_start.tolist()
    click.echo("")
    print_table(
        "",
        ["link", ">spheres", ">inflation, mm"],
        [
            [link, str(after - before), f"{1e3 * model.inflation[link]:.1f}"]
            for link, before, after in zip(model.bodies, starts, starts[1:], strict=False)
        ],
    )
    counts: dict[str, int] = {}
    for pair in model.pairs:
        counts[pair.treatment] = counts.get(pair.treatment, 0) + 1
    click.echo("")
    click.echo("pairs of links: " + ", ".join(f"{count} {treatment}" for treatment, count in counts.items()))
