"""``takeapart plan``: from an assembly and a workcell to a plan file."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import click

from takeapart.cli.compile import compile_first
from takeapart.cli.output import (
    FILE,
    FOLDER,
    SECONDS,
    examples,
    json_option,
    note,
    print_json,
    progress_bar,
    require_output,
    search_listener,
    seed_option,
    workcell_option,
)
from takeapart.cli.plan_output import plan_summary, print_plan, save_or_explain
from takeapart.cli.search_options import options_of
from takeapart.cli.view import keep_showing, live_view
from takeapart.model.errors import MissingExtraError
from takeapart.search.registry import SEARCHES, searches_that_take

if TYPE_CHECKING:
    from takeapart.model.assembly import Assembly
    from takeapart.model.plan import Plan
    from takeapart.planning import Infeasible, PlanningOptions, Recorder
    from takeapart.problem import Guide
    from takeapart.search.result import Progress, ProgressListener
    from takeapart.workcell import Workcell

GUIDED, RECORDED = searches_that_take("guide"), searches_that_take("observe")


@click.command(
    short_help="Plan the disassembly of an assembly.",
    epilog=examples(
        "takeapart plan product.json",
        "takeapart plan product.json --workcell cell.toml --seconds 60",
        "takeapart plan product.json --out plans/product.plan.json --run runs/first",
        "takeapart plan product.json --search mcts --episodes 20 --seed 1",
    ),
)
@click.argument("assembly", type=FILE)
@workcell_option
@click.option(
    "--search",
    type=click.Choice(list(SEARCHES)),
    default="exact",
    show_default=True,
    help=" ".join(f"{name}: {entry.description}." for name, entry in SEARCHES.items()),
)
@seed_option
@click.option(
    "--episodes",
    type=click.IntRange(1),
    help="Stop after so many episodes of mcts, random orders of restarts, rounds of exact.  [default: no limit]",
)
@click.option(
    "--seconds",
    type=SECONDS,
    help="Stop after this time and keep the best plan so far; inf is no limit.  [default: no limit]",
)
@click.option(
    "--queries",
    type=click.IntRange(1),
    help="Stop after so many removal queries (best removal of one part in one state).  [default: no limit]",
)
@click.option(
    "--memory",
    type=click.Choice(["library", "paper"]),
    help="mcts only. library: no removal is planned twice. paper: planned afresh in every simulation.  "
    "[default: library]",
)
@click.option(
    "--attempts",
    type=click.IntRange(1),
    help="How often a removal is planned; the shortest is kept. The paper's mcts has 4.  [default: 1]",
)
@click.option(
    "--workers",
    type=click.IntRange(1, 256),
    help="exact only. Threads that plan removals; the plan does not depend on it.  [default: 1]",
)
@click.option(
    "--refine",
    type=click.IntRange(0),
    help="exact only. Once the order is proved, plan removals that could make it shorter again, up to so many times "
    "while that gains 0.1 % each time; 0 ends with the proof.  [default: 8]",
)
@click.option(
    "--states",
    type=click.IntRange(1, 10**9),
    help="exact only. Up to so many reachable states are enumerated, for a third of a gigabyte the million; with more, "
    "best-first search takes over.  [default: 2000000]",
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="NAME=VALUE",
    help="Any other option of the search, for example --set exploration=0.5 with mcts; a wrong name lists all.",
)
@click.option(
    "--out", type=FILE, help="The plan file.  [default: <name of the assembly file>.plan.json in the current folder]"
)
@click.option(
    "--run",
    type=FOLDER,
    metavar="DIR",
    help="Keep all that is planned in this directory at once. Given again, the same command continues a run that was "
    "killed or stopped, and ends with the same plan.",
)
@click.option(
    "--guide",
    type=FILE,
    metavar="FILE|default",
    help=f"{', '.join(GUIDED)}. Weights written by `takeapart train`, or the guide that comes with the package; it "
    "says which part to try first.",
)
@click.option(
    "--experience",
    type=FOLDER,
    metavar="DIR",
    help=f"{', '.join(RECORDED)}. Add all that the search sees to this folder, for `takeapart train`. Needs the extra "
    "guide: pip install 'takeapart[guide]'.",
)
@click.option(
    "--view",
    "watch",
    is_flag=True,
    help="Watch the search in the browser: length and bound against time, and the best plan so far. Needs the extra "
    "view.",
)
@click.option(
    "--partial",
    is_flag=True,
    help="Where no order is feasible, write the plan that takes out as many parts as can leave; it names those that "
    "remain. The exit code is 3 all the same.",
)
@json_option
def plan(
    assembly: Path,
    workcell: str,
    search: str,
    seed: int,
    episodes: int | None,
    seconds: float | None,
    queries: int | None,
    memory: str | None,
    attempts: int | None,
    workers: int | None,
    refine: int | None,
    states: int | None,
    settings: tuple[str, ...],
    out: Path | None,
    run: Path | None,
    guide: Path | None,
    experience: Path | None,
    watch: bool,
    partial: bool,
    as_json: bool,
) -> None:
    """Plan in which order, by which grasps and along which paths the robot takes ASSEMBLY apart.

    Writes a plan file and prints the order with the length of the gripper's path for each part. Ctrl-C ends the search
    and keeps the best plan so far. Where no order is feasible, the parts that are stuck are named, with the reason and
    the stage at which planning their removal ended (exit code 3), and how many parts can leave before; nothing is
    written then but by --partial. "No feasible order" is proved for the removals that the planner finds; "no feasible
    order found within the budget" says that a larger budget may find one.
    """
    from takeapart.formats.files import load_assembly, load_workcell
    from takeapart.formats.sources import with_sources
    from takeapart.model.plan import Plan

    if memory is not None and search != "mcts":
        raise click.UsageError(f"--memory goes with --search mcts only, not with {search}")
    for option, value in {"--workers": workers, "--refine": refine, "--states": states}.items():
        if value is not None and search != "exact":
            raise click.UsageError(f"{option} goes with --search exact only, not with {search}")
    if guide is not None and search not in GUIDED:
        raise click.UsageError(f"--guide goes with --search {', '.join(GUIDED)} only, not with {search}")
    if experience is not None and search not in RECORDED:
        raise click.UsageError(f"--experience goes with --search {', '.join(RECORDED)} only, not with {search}")
    out = out or Path(f"{assembly.stem}.plan.json")
    product, cell = load_assembly(assembly), load_workcell(workcell)
    require_output(out, assembly, Path(workcell))
    attempts_of = "order.attempts" if search == "restarts" else "attempts"
    named = {attempts_of: attempts, "memory": memory, "workers": workers}
    named |= {"refinement.passes": refine, "state_limit": states}
    options = options_of(search, seed, episodes, seconds, queries, named, settings)
    advice = loaded_guide(guide, product)
    with recorder(experience, product, options) as record, live_view(product, cell) if watch else nullcontext() as live:
        made, interrupted = make_plan(product, cell, options, run, advice, record, live)

        def sourced(plan: Plan) -> Plan:
            return with_sources(plan, out, assembly, workcell)

        made = sourced(made) if isinstance(made, Plan) else made
        saved = save_or_explain(made, interrupted, out, as_json, partial, sourced)
        if as_json:
            print_json({"feasible": True, "file": str(out), "interrupted": interrupted, **plan_summary(saved)})
        else:
            print_plan(saved)
            click.echo(f"written to           {out}")
        if live is not None:
            keep_showing(live, out)


def loaded_guide(guide: Path | None, assembly: Assembly) -> Guide | None:
    """The guide in a file, or the shipped one.

    Raises:
        InputError: the file is missing or broken.
    """
    if guide is None:
        return None
    from takeapart.guide.policy import load_guide

    return load_guide(guide, assembly)


@contextmanager
def recorder(folder: Path | None, assembly: Assembly, options: PlanningOptions) -> Iterator[Recorder | None]:
    """Where a search tells what it sees; None without a folder.

    Raises:
        InputError: the folder cannot be written.
        MissingExtraError: the library that writes it is not installed.
    """
    if folder is None:
        yield None
        return
    if importlib.util.find_spec("polars") is None:
        raise MissingExtraError("takeapart plan --experience", "guide", "polars")
    from takeapart.guide.experience import ExperienceWriter

    with ExperienceWriter(folder, assembly, seed=options.seed, search=options.search) as writer:
        yield writer


def make_plan(
    assembly: Assembly,
    workcell: Workcell,
    options: PlanningOptions,
    run: Path | None = None,
    guide: Guide | None = None,
    record: Recorder | None = None,
    watch: ProgressListener | None = None,
) -> tuple[Plan | Infeasible, bool]:
    """Plans with a progress bar, after the kernels are compiled.

    Args:
        run: directory of a run that is started or continued; by default nothing is kept before the end.
        guide: ranks the parts.
        record: is told what the search sees.
        watch: also hears how the search goes.

    Returns:
        the plan or why there is none, and whether Ctrl-C ended the search.

    Raises:
        InputError: a part floats, the robot's files are missing, or the run directory is refused.
    """
    from takeapart.planning import build_problem, plan_in_run, plan_of, run_identity, search
    from takeapart.planning.runs import finished_plan, open_run
    from takeapart.stability import require_standing

    require_standing(assembly)  # before a minute of compiling
    title = f"planning {assembly.name}, {options.search}"
    if run is None:
        compile_first(workcell)
        with progress_bar(title) as update:
            problem = build_problem(assembly, workcell, options)
            started = time.monotonic()
            listen = _both(search_listener(update, options.budget), watch)
            result = search(problem, options, guide, listen, record)
            return plan_of(problem, result, options, time.monotonic() - started), result.interrupted
    identity = run_identity(assembly, workcell, options, guide)
    known = finished_plan(run, identity)
    if known is not None:
        note(f"the run in {run} has ended; this is its plan")
        return known, False
    with open_run(run, identity) as opened:
        if opened.journal.answers:
            note(f"continuing the run in {run}, which has {opened.journal.answers} answers of the planner")
        compile_first(workcell)
        with progress_bar(title) as update:
            listen = _both(search_listener(update, options.budget), watch)
            return plan_in_run(opened, assembly, workcell, options, guide, listen, record)


def _both(first: ProgressListener, second: ProgressListener | None) -> ProgressListener:
    def listen(progress: Progress) -> None:
        first(progress)
        if second is not None:
            second(progress)

    return listen
