"""``takeapart reproduce``: the experiments of the paper and ours, from nothing to tables and plots."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from takeapart.cli.compile import compile_first
from takeapart.cli.output import (
    EXIT_INTERRUPTED,
    FILE,
    FOLDER,
    examples,
    json_option,
    make_folder,
    note,
    print_json,
    progress_bar,
    require_output,
    seed_option,
    workcell_option,
)

if TYPE_CHECKING:
    from takeapart.experiments.schedule import ScheduleProgress

SHOWN_JOBS = 2
MAXIMUM_DOCUMENT_BYTES = 8 * 2**20

workers_option = click.option(
    "--workers",
    default="auto",
    show_default=True,
    metavar="N|auto|ray|ray://HOST:PORT",
    help="Processes of this machine (auto: one per core), or a Ray cluster (extra: cluster).",
)


@click.group(
    short_help="Run experiments and write their tables and plots.",
    epilog=examples("takeapart reproduce paper --quick", "takeapart reproduce beyond --help"),
)
def reproduce() -> None:
    """Run experiments and write their tables and plots. Each explains itself: takeapart reproduce NAME --help."""


@reproduce.command(
    short_help="Fig. 5, Tables I and II of the paper.",
    epilog=examples("takeapart reproduce paper --quick", "takeapart reproduce paper --out out/paper --workers 8"),
)
@click.option(
    "--out", type=FOLDER, default=Path("out/paper"), show_default=True, help="Folder of all results; made if needed."
)
@click.option("--quick", is_flag=True, help="Every table and plot within minutes, from a few short searches.")
@click.option(
    "--episodes", type=click.IntRange(1), help="Of every search, for shorter runs.  [default: 20; with --quick 1]"
)
@workers_option
@click.option(
    "--document", type=FILE, metavar="FILE.md", help="Also fill the marked blocks of this document (docs/results.md)."
)
@seed_option
@json_option
def paper(
    out: Path, quick: bool, episodes: int | None, workers: str, document: Path | None, seed: int, as_json: bool
) -> None:
    """Repeat the experiments of the paper (Sec. VII) on the shipped assemblies.

    Vanilla searches on both data sets, guides trained on their experience leaving one assembly out each, guided
    searches, and replanning (Fig. 5). Writes table1.csv, table2.csv, figure5.csv, the comparison at equal motion plans,
    plots, and report.md. Every finished job is kept: the same command goes on where it was interrupted.
    """
    from takeapart.experiments.paper import reproduce as run
    from takeapart.experiments.paper_settings import full_settings, quick_settings
    from takeapart.experiments.workers import open_workers
    from takeapart.formats.files import load_workcell

    settings = quick_settings(seed) if quick else full_settings(seed)
    settings = replace(settings, episodes=episodes or settings.episodes)
    require_document(document)
    make_folder(out)
    crew = open_workers(workers)
    try:
        compile_first(load_workcell(settings.workcell))
        with progress_bar("reproducing the paper") as update:
            done = run(settings, out, crew, schedule_listener(update), document)
    except KeyboardInterrupt:
        crew.stop(now=True)
        note(f"interrupted; finished jobs are kept in {out}, and the same command goes on from there")
        raise click.exceptions.Exit(EXIT_INTERRUPTED) from None
    files = [str(file) for file in done.files]
    if as_json:
        print_json({"files": files, "report": str(done.report), "seconds": round(done.seconds, 1)})
        return
    click.echo(done.report.read_text(encoding="utf-8"))
    click.echo(f"{len(files)} files written to {out} in {done.seconds:.0f} s")


@reproduce.command(
    short_help="Searches with and without a guide where exact search cannot close.",
    epilog=examples("takeapart reproduce beyond large/01.json large/02.json --queries 500"),
)
@click.argument("assemblies", type=FILE, nargs=-1, required=True)
@click.option(
    "--guide",
    type=FILE,
    default=Path("default"),
    show_default=True,
    metavar="FILE|default",
    help="Weights, as takeapart train writes them, or the guide that comes with the package.",
)
@click.option("--queries", type=click.IntRange(1), default=1000, show_default=True, help="Removal queries per search.")
@click.option(
    "--out", type=FOLDER, default=Path("out/beyond"), show_default=True, help="Folder of all results; made if needed."
)
@workcell_option
@workers_option
@click.option(
    "--document", type=FILE, metavar="FILE.md", help="Also fill the marked block of this document (docs/results.md)."
)
@seed_option
@json_option
def beyond(
    assemblies: tuple[Path, ...],
    guide: Path,
    queries: int,
    out: Path,
    workcell: str,
    workers: str,
    document: Path | None,
    seed: int,
    as_json: bool,
) -> None:
    """Compare greedy, beam, best-first and MCTS with and without a guide on ASSEMBLIES at equal removal queries.

    Writes beyond.csv, beyond.md and beyond.png. Every finished job is kept: the same command goes on where it was
    interrupted.
    """
    from takeapart.experiments.beyond_exact import BeyondSettings, compare_beyond
    from takeapart.experiments.workers import open_workers
    from takeapart.formats.files import load_assembly, load_workcell
    from takeapart.guide.policy import load_guide

    settings = BeyondSettings(assemblies, guide, workcell, seed, queries)
    cell = load_workcell(workcell)
    for file in assemblies:
        load_guide(guide, load_assembly(file))
    require_document(document)
    make_folder(out)
    crew = open_workers(workers)
    try:
        compile_first(cell)
        with progress_bar("beyond exact search") as update:
            files = compare_beyond(settings, out, crew, schedule_listener(update), document)
    except KeyboardInterrupt:
        crew.stop(now=True)
        note(f"interrupted; finished jobs are kept in {out}, and the same command goes on from there")
        raise click.exceptions.Exit(EXIT_INTERRUPTED) from None
    if as_json:
        print_json({"files": [str(file) for file in files]})
        return
    click.echo((out / "beyond.md").read_text(encoding="utf-8"))
    click.echo(f"{len(files)} files written to {out}")


def require_document(document: Path | None) -> None:
    """Finds out before the work starts whether the blocks of a document can be filled.

    Raises:
        InputError: it cannot be read or written.
    """
    from takeapart.formats.documents import read_bytes

    if document is not None:
        read_bytes(document, MAXIMUM_DOCUMENT_BYTES)
        require_output(document)


def schedule_listener(update: Callable[[str, float | None], None]) -> Callable[[ScheduleProgress], None]:
    """Shows the progress of a schedule in a progress bar."""

    def listen(progress: ScheduleProgress) -> None:
        shown = ", ".join(progress.running[:SHOWN_JOBS])
        left = "" if progress.seconds_left is None else f", {duration(progress.seconds_left)} left"
        update(f"{progress.done} of {progress.total} jobs{left}; {shown}", progress.share)

    return listen


def duration(seconds: float) -> str:
    """For people: 40 s, 12 min, 1 h 05 min."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"
