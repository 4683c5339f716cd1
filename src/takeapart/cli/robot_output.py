"""What ``takeapart robot`` writes and prints: descriptions, workcells, tables."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from takeapart.cli.output import note, print_json, print_table
from takeapart.formats.messages import shown
from takeapart.model.errors import InputError

if TYPE_CHECKING:
    from takeapart.cli.robot_finding import Found
    from takeapart.planning.placing import Placed
    from takeapart.robot.model import RobotModel


def list_shipped(as_json: bool) -> None:
    """Prints the descriptions that the package brings."""
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


def write_description(found: Found, out: Path) -> None:
    """Writes what was found, and reads it again."""
    import os

    from takeapart.formats.documents import write_atomically
    from takeapart.formats.robot_files import ENDING, load_robot_file
    from takeapart.formats.robot_writing import robot_toml

    named = found.named_gripper
    if named.endswith(ENDING):
        named = os.path.relpath(Path(named).resolve(), out.resolve().parent)
    write_atomically(out, robot_toml(found.arm, found.gripper, found.mount, out.parent, found.remarks, named))
    load_robot_file(out.resolve())  # what was written is read again


def write_workcell(found: Found, out: Path | None, workcell: Path, placed: Placed) -> None:
    """Writes the workcell in which the arm has its place; it names the description, wherever it is."""
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


def robot_document(found: Found, model: RobotModel | None, placed: Placed | None) -> dict[str, Any]:
    """What was found, for machines."""

    def part(data: Any) -> dict[str, Any] | None:
        if data is None:
            return None
        plain = asdict(data)
        plain["files"] = {"urdf": str(data.files.urdf), "packages": {k: str(v) for k, v in data.files.packages.items()}}
        return plain

    document: dict[str, Any] = {"arm": part(found.arm), "gripper": part(found.gripper), "mount": found.mount}
    document["not_known"] = list(found.unknown)
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


def print_robot(
    found: Found, model: RobotModel | None, placed: Placed | None, out: Path | None, cell: Path | None
) -> None:
    """What was found, as tables, what is not known, and which files were written."""
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
