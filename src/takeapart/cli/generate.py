"""``takeapart generate``: aluminium-profile assemblies as in the paper (Sec. IV-A), each with a feasible order; and the
products that are shipped, drawn in code.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from takeapart.cli.compile import compile_first
from takeapart.cli.output import (
    FOLDER,
    LARGEST_SEED,
    examples,
    json_option,
    make_folder,
    print_json,
    progress_bar,
    require_output,
    workcell_option,
)
from takeapart.model.errors import InputError

SEEDS_APART = 1000  # seeds of the cells of one file

if TYPE_CHECKING:
    from takeapart.generate.profiles import OrderFinder
    from takeapart.model.assembly import Assembly
    from takeapart.robot.model import RobotModel
    from takeapart.workcell import Workcell


@click.group(
    invoke_without_command=True,
    short_help="Make random aluminium-profile assemblies, or the shipped products.",
    epilog=examples(
        "takeapart generate --layers 2 --back 3 --front 3 --count 7 --out double",
        "takeapart generate products --out products",
    ),
)
@click.option("--layers", type=int, default=1, show_default=True, help="Levels of bars between bottom and top.")
@click.option("--back", type=int, default=4, show_default=True, help="Bars added at the back of every layer.")
@click.option("--front", type=int, default=3, show_default=True, help="Bars added in the front of every layer.")
@click.option("--length", type=float, default=0.40, show_default=True, help="Of the base along x, m.")
@click.option("--width", type=float, default=0.40, show_default=True, help="Of the base along y, m.")
@click.option("--height", type=float, default=0.60, show_default=True, help="Of the base along z, m.")
@click.option(
    "--minimum-length", type=float, default=0.10, show_default=True, help="Least length of a bar between two others, m."
)
@click.option(
    "--spacing",
    type=float,
    default=0.055,
    show_default=True,
    help="Least distance of the centre lines of parallel bars at one height, m.",
)
@click.option(
    "--clearance",
    type=float,
    default=0.002,
    show_default=True,
    help="Least distance of random bars to what they are not joined to, m.",
)
@click.option(
    "--cells",
    type=click.IntRange(1, 4),
    default=1,
    show_default=True,
    help="Assemblies around the robot in one file: in front, left, right, behind; goes with --workcell panda-cells.",
)
@click.option(
    "--seed",
    type=click.IntRange(0, LARGEST_SEED),
    default=0,
    show_default=True,
    help="Of the first file; file k has the seed SEED + k - 1, so each can be made again alone. Further cells have "
    "seeds 1000 apart.",
)
@click.option(
    "--count", type=click.IntRange(1, 9999), default=1, show_default=True, help="How many files: 01.json, 02.json, ..."
)
@click.option(
    "--out", type=FOLDER, default=Path("assemblies"), show_default=True, help="Folder of the files; made if needed."
)
@click.option(
    "--name", default="profiles", show_default=True, help="Name of the assemblies; -01, -02, ... is added to it."
)
@click.option(
    "--candidates",
    type=click.IntRange(1),
    default=1000,
    show_default=True,
    help="Give up a file after so many candidates.",
)
@workcell_option
@json_option
@click.pass_context
def generate(
    context: click.Context,
    layers: int,
    back: int,
    front: int,
    length: float,
    width: float,
    height: float,
    minimum_length: float,
    spacing: float,
    clearance: float,
    cells: int,
    seed: int,
    count: int,
    out: Path,
    name: str,
    candidates: int,
    workcell: str,
    as_json: bool,
) -> None:
    """Make random assemblies of aluminium profiles that the robot can take apart.

    Candidates are drawn until one has a feasible order of removals, which is kept in the file as its witness; how many
    were rejected, and why, is printed and kept too. The defaults give assemblies with 21 removable parts; --layers 2
    --back 3 --front 3 gives 30. The arm reaches no larger ones; more layers need less height each and a higher base
    (--workcell panda-tall), more than 100 parts stand around the robot (--cells 4 --workcell panda-cells).
    """
    if context.invoked_subcommand is not None:
        return
    from takeapart.formats.files import load_workcell, save_assembly
    from takeapart.generate import profiles
    from takeapart.generate.cells import cells_around
    from takeapart.robot.loading import load_robot

    options = profiles.ProfileOptions(layers, back, front, length, width, height, minimum_length, spacing, clearance)
    cell = load_workcell(workcell)
    files = [out / f"{number:02d}.json" for number in range(1, count + 1)]
    make_folder(out)
    for file in files:
        require_output(file)
    compile_first(cell)
    robot = load_robot(cell)
    results = []
    with progress_bar("generating") as update:
        for number, file in enumerate(files, 1):
            finder = _order_finder(cell, robot, seed + number - 1, _counter(update, file, (number - 1) / count))
            title = f"{name}-{number:02d}"
            stands = [
                profiles.generate(options, seed + number - 1 + SEEDS_APART * k, finder, title, candidates)
                for k in range(cells)
            ]
            made = stands[0]
            if cells > 1:
                assembly = cells_around([each.assembly for each in stands], cell.T_world_base, title)
                order = finder(assembly)
                if isinstance(order, str):
                    raise InputError(f"{order}, though each cell has one; try another seed", title)
                rejections = sum((Counter(each.rejections) for each in stands), Counter[str]())
                made = replace(made, assembly=replace(assembly, witness=order), rejections=dict(rejections))
            save_assembly(made.assembly, file)
            results.append(
                {
                    "file": str(file),
                    "name": made.assembly.name,
                    "seed": seed + number - 1,
                    "candidate": made.candidate,
                    "removable_parts": len(made.assembly.witness),
                    "rejections": made.rejections,
                }
            )
            if not as_json:
                click.echo(_line(file, len(made.assembly.witness), made.rejections))
    if as_json:
        print_json({"files": results})


@generate.command(
    short_help="Draw the shipped products.",
    epilog=examples("takeapart generate products --out products", "takeapart generate products gearbox --out products"),
)
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option(
    "--out", type=FOLDER, default=Path("products"), show_default=True, help="Folder of the products; made if needed."
)
@json_option
def products(names: tuple[str, ...], out: Path, as_json: bool) -> None:
    """Draw the products that come with takeapart, or those that are named: each in a folder of its own.

    Every product is a function that joins and cuts solids; the same files come out of it every time, byte for byte.
    Needs the extra "verify".
    """
    from takeapart.formats.files import save_assembly
    from takeapart.generate.products import PRODUCTS
    from takeapart.model.errors import UnknownNameError

    for name in names:
        if name not in PRODUCTS:
            raise UnknownNameError("product", name, list(PRODUCTS))
    wanted = list(dict.fromkeys(names)) or list(PRODUCTS)
    files = {name: out / name / "assembly.json" for name in wanted}
    make_folder(out)
    for file in files.values():
        make_folder(file.parent)
        require_output(file)
    results = []
    for name, file in files.items():
        assembly = PRODUCTS[name]()
        save_assembly(assembly, file)
        results.append({"file": str(file), "name": name, "parts": len(assembly.parts)})
        if not as_json:
            click.echo(f"{file}: {assembly.provenance['title']}, {len(assembly.parts)} parts")
    if as_json:
        print_json({"files": results})


def _line(file: Path, parts: int, rejections: dict[str, int]) -> str:
    total = sum(rejections.values())
    reasons = ", ".join(f"{reason}: {times}" for reason, times in sorted(rejections.items(), key=lambda item: -item[1]))
    return f"{file}: {parts} removable parts; {total} candidates rejected" + (f" ({reasons})" if reasons else "")


def _counter(update: Callable[[str, float | None], None], file: Path, share: float) -> Callable[[], None]:
    """To be called for every candidate whose order is sought."""
    asked = 0

    def count() -> None:
        nonlocal asked
        asked += 1
        update(f"{file.name}: seeking an order for layout {asked}", share)

    return count


def _order_finder(workcell: Workcell, robot: RobotModel, seed: int, started: Callable[[], None]) -> OrderFinder:
    """Feasible orders by the removal planner: a random order; its first dead end proves that there is none."""
    import numpy as np

    from takeapart.planning import blocked_parts
    from takeapart.problem import AssemblyProblem
    from takeapart.removal.planner import RemovalPlanner
    from takeapart.removal.result import STAGES
    from takeapart.search.result import Budget
    from takeapart.search.simple_orders import OrderOptions, random_order
    from takeapart.stability import stability_of

    def find(assembly: Assembly) -> tuple[str, ...] | str:
        started()
        problem = AssemblyProblem(RemovalPlanner(assembly, workcell, robot=robot), stability_of(assembly), seed)
        result = random_order(problem, OrderOptions(monotone=True), Budget(), np.random.default_rng([seed, 1]))
        if result.interrupted:
            raise KeyboardInterrupt
        if result.removals:
            return tuple(assembly.parts[removal.part].name for removal in result.removals)
        stages = [blocked.stage for dead_end in result.refusals[:1] for blocked in blocked_parts(problem, *dead_end)]
        return f"no feasible order, stage {max(stages, key=STAGES.index)}" if stages else "no feasible order"

    return find
