"""``takeapart show`` and ``takeapart explain``: what a file holds, and what keeps parts from leaving."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from takeapart.cli.compile import compile_first
from takeapart.cli.output import (
    FILE,
    examples,
    json_option,
    metres,
    plan_assembly_option,
    print_json,
    print_table,
    progress_bar,
    seed_option,
    workcell_option,
)
from takeapart.cli.plan_output import NOT_VERIFIED, hindrance_document, plan_summary, print_plan
from takeapart.formats.messages import shown
from takeapart.model.errors import InputError, UnknownNameError

if TYPE_CHECKING:
    from takeapart.model.assembly import Assembly, Part
    from takeapart.model.geometry import Array
    from takeapart.model.plan import Plan
    from takeapart.planning import Hindrance
    from takeapart.workcell import Workcell


@click.command(
    short_help="Print a plan, an assembly or a workcell as a table.",
    epilog=examples("takeapart show product.json", "takeapart show product.plan.json", "takeapart show panda"),
)
@click.argument("file", type=FILE)
@plan_assembly_option
@json_option
def show(file: Path, assembly: Path | None, as_json: bool) -> None:
    """Print what FILE holds: a plan or assembly (JSON), a workcell (TOML, or the name of a shipped one)."""
    from takeapart.formats.documents import read_json
    from takeapart.formats.files import MAXIMUM_PLAN_BYTES, load_assembly, load_plan, load_workcell

    if file.suffix == ".toml" or (not file.suffix and not os.path.lexists(file)):
        try:
            workcell = load_workcell(str(file))
        except UnknownNameError as error:
            message = "there is no such file, and no shipped workcell of this name"
            raise InputError(message, str(file)) from error
        _show_workcell(workcell, as_json)
        return
    document = read_json(file, MAXIMUM_PLAN_BYTES)
    form = document.get("format") if isinstance(document, dict) else None
    if form == "takeapart/plan":
        plan = load_plan(file)
        _show_plan(plan, _assembly_of(plan, assembly, file), as_json)
    elif form == "takeapart/assembly":
        _show_assembly(load_assembly(file), as_json)
    else:
        raise InputError(
            "holds neither a plan ('takeapart/plan') nor an assembly ('takeapart/assembly')", f"{file}: format"
        )


def _assembly_of(plan: Plan, given: Path | None, file: Path) -> Assembly | None:
    """The assembly of a plan, which is shown without it too."""
    from takeapart.formats.files import load_assembly
    from takeapart.formats.sources import source_assembly

    if given is not None:
        return load_assembly(given)
    try:
        return source_assembly(plan, [file.parent], shown(file))
    except InputError:
        return None


def size_text(part: Part) -> str:
    """Edges of the bounding box of a part in its own frame, mm."""
    return " x ".join(f"{1000 * edge:.4g}" for edge in 2 * part.shape.bounding_box().half_extents)


def _point(values: Array) -> str:
    return " ".join(f"{value:.3f}" for value in values)


def _show_plan(plan: Plan, assembly: Assembly | None, as_json: bool) -> None:
    if as_json:
        print_json({"format": "takeapart/plan", **plan_summary(plan), "stated": NOT_VERIFIED})
        return
    print_plan(plan, {part.name: size_text(part) for part in assembly.parts} if assembly else None, stated=True)


def _show_assembly(assembly: Assembly, as_json: bool) -> None:
    from takeapart.stability import unsupported

    floating = unsupported(assembly)
    removable = assembly.root.bit_count()
    if as_json:
        print_json(
            {
                "format": "takeapart/assembly",
                "name": assembly.name,
                "parts": [
                    {
                        "name": part.name,
                        "size": (2 * part.shape.bounding_box().half_extents).tolist(),
                        "position": part.T_world_part[:3, 3].tolist(),
                        "mass": part.mass,
                        "fixed": part.fixed,
                    }
                    for part in assembly.parts
                ],
                "removable_parts": removable,
                "connectors": len(assembly.connectors),
                "floating": list(floating),
                "witness": list(assembly.witness),
            }
        )
        return
    holders: dict[str, list[str]] = {}
    for connector in assembly.connectors:
        holders.setdefault(connector.guest, []).append(connector.host)
    rows = [
        [
            part.name,
            size_text(part),
            _point(part.T_world_part[:3, 3]),
            f"{part.mass:.3f}",
            "fixed" if part.fixed else "",
            ", ".join(holders.get(part.name, [])),
        ]
        for part in assembly.parts
    ]
    print_table(f"assembly {assembly.name}", ["part", "size, mm", "position, m", ">kg", "", "ends held by"], rows)
    click.echo(f"\n{len(assembly.parts)} parts, {removable} removable, {len(assembly.connectors)} connectors")
    if floating:
        click.echo(f"floating: {', '.join(floating)}")
    if assembly.witness:
        click.echo(f"known order: {', '.join(assembly.witness)}")


def _show_workcell(workcell: Workcell, as_json: bool) -> None:
    environment = [(o.name, 2 * o.box.half_extents, o.box.T_frame_box[:3, 3]) for o in workcell.environment]
    if as_json:
        print_json(
            {
                "format": "takeapart/workcell",
                "name": workcell.name,
                "robot": workcell.robot,
                "base": workcell.T_world_base[:3, 3].tolist(),
                "home": workcell.home.tolist(),
                "goal": workcell.goal.tolist(),
                "lift_height": workcell.lift_height,
                "clearance": workcell.clearance,
                "payload": workcell.payload,
                "gripping_force": workcell.gripping_force,
                "friction": workcell.friction,
                "environment": [
                    {"name": name, "size": size.tolist(), "position": position.tolist()}
                    for name, size, position in environment
                ],
            }
        )
        return
    rows = [
        ["robot", f"{workcell.robot}, base at {_point(workcell.T_world_base[:3, 3])} m"],
        ["home", f"{' '.join(f'{math.degrees(angle):.1f}' for angle in workcell.home)} deg"],
        ["goal", f"{_point(workcell.goal)} m"],
        ["lift height", f"{1000 * workcell.lift_height:.4g} mm"],
        ["clearance", f"{1000 * workcell.clearance:.4g} mm"],
        ["payload", f"{workcell.payload:.4g} kg"],
        ["gripping force", f"{workcell.gripping_force:.4g} N, friction {workcell.friction:.4g}"],
        *([name, f"{_point(size)} m at {_point(position)} m"] for name, size, position in environment),
    ]
    print_table(f"workcell {workcell.name}", ["", ""], rows)


@click.command(
    short_help="Say which parts can leave now, and what blocks the others.",
    epilog=examples("takeapart explain product.json --without top_front --without top_left"),
)
@click.argument("assembly", type=FILE)
@workcell_option
@click.option(
    "--without", multiple=True, metavar="PART", help="A part that is gone already; may be given several times."
)
@click.option(
    "--attempts", type=click.IntRange(1), default=1, show_default=True, help="How often a removal is planned."
)
@seed_option
@json_option
def explain(assembly: Path, workcell: str, without: tuple[str, ...], attempts: int, seed: int, as_json: bool) -> None:
    """Say for each part of ASSEMBLY whether it can leave now, and otherwise what keeps it.

    A removal is planned in stages: stability (nothing else may fall), lift (a way out: straight up; from products made
    of meshes in any direction), grasp (free of collisions), ik (in reach), path (to the goal). A part that cannot leave
    is listed with the stage at which its removal ended and the reason: what is in the way, fixed parts and obstacles
    too, and by how much.
    """
    from takeapart.formats.files import load_assembly, load_workcell
    from takeapart.planning import PlanningOptions, build_problem
    from takeapart.planning import explain as hindrances_in
    from takeapart.removal.result import Blocked, Effort
    from takeapart.stability import require_standing

    product, cell = load_assembly(assembly), load_workcell(workcell)
    gone = product.state_of(without)
    fixed = [name for name in without if product.parts[product.index[name]].fixed]
    if fixed:
        raise InputError(f"part {fixed[0]!r} is fixed and never leaves; give removable parts", "--without")
    state = product.root & ~gone
    require_standing(product)
    compile_first(cell, orders=False)
    lengths: dict[str, float] = {}
    refusals: list[Blocked] = []
    with progress_bar(f"asking for the parts of {product.name}") as update:
        problem = build_problem(product, cell, PlanningOptions(seed=seed))
        candidates = problem.candidates(state)
        for number, part in enumerate(candidates):
            name = product.parts[part].name
            update(name, number / len(candidates))
            answer = problem.remove(state, part, Effort(attempts=attempts))
            if isinstance(answer, Blocked):
                refusals.append(answer)
            else:
                lengths[name] = answer.length
    hindrances = {hindrance.part: hindrance for hindrance in hindrances_in(problem, state, tuple(refusals))}
    names = product.names(state)
    if as_json:
        print_json({"assembly": product.name, "parts": [_part_document(name, lengths, hindrances) for name in names]})
        return
    rows = [_part_row(name, lengths, hindrances) for name in names]
    print_table(f"{product.name}: {len(names)} parts", ["part", "can leave", ">gripper path", "stage", "why not"], rows)
    click.echo(f"\n{len(lengths)} of {len(names)} parts can leave now")


def _part_document(name: str, lengths: dict[str, float], hindrances: dict[str, Hindrance]) -> dict[str, object]:
    if name in lengths:
        return {"part": name, "removable": True, "length": lengths[name]}
    return {"part": name, "removable": False, **hindrance_document(hindrances[name])}


def _part_row(name: str, lengths: dict[str, float], hindrances: dict[str, Hindrance]) -> list[str]:
    if name in lengths:
        return [name, "yes", metres(lengths[name]), "", ""]
    reason = hindrances[name].reason
    return [name, "no", "", reason.stage, reason.text]
