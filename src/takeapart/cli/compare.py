"""``takeapart compare``: all searches at equal removal queries."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from takeapart.cli.compile import compile_first
from takeapart.cli.output import (
    FILE,
    FOLDER,
    examples,
    json_option,
    make_folder,
    note,
    print_json,
    progress_bar,
    workcell_option,
)
from takeapart.experiments.compared import COMPARED
from takeapart.model.errors import InputError


@click.command(
    short_help="Compare the searches at equal cost.",
    epilog=examples("takeapart compare data/single --budget-queries 300 --seeds 3"),
)
@click.argument("dataset", type=FILE)
@click.option("--budget-queries", type=click.IntRange(1), required=True, help="Removal queries that every run may ask.")
@click.option("--seeds", type=click.IntRange(1), default=1, show_default=True, help="Runs of each search per assembly.")
@click.option("--count", type=click.IntRange(1), help="Only the first so many assemblies.  [default: all]")
@click.option(
    "--search", "searches", type=click.Choice(COMPARED), multiple=True, help="Only these searches.  [default: all]"
)
@click.option(
    "--out", type=FOLDER, default=Path("comparison"), show_default=True, help="Folder of all results; made if needed."
)
@workcell_option
@json_option
def compare(
    dataset: Path,
    budget_queries: int,
    seeds: int,
    count: int | None,
    searches: tuple[str, ...],
    out: Path,
    workcell: str,
    as_json: bool,
) -> None:
    """Run all searches on the assemblies of DATASET, a folder or one file, with equal removal queries.

    Writes table.md, table.csv and lengths.png (best length against queries). Every run is kept at once: given again,
    the same command goes on where it was stopped.
    """
    from takeapart.experiments import comparison as experiment
    from takeapart.formats.documents import write_atomically
    from takeapart.formats.files import load_assembly, load_workcell

    files = sorted(dataset.glob("*.json")) if dataset.is_dir() else [dataset]
    if not files:
        raise InputError("holds no assembly files (*.json)", str(dataset))
    cell = load_workcell(workcell)
    assemblies = [load_assembly(file) for file in files[:count]]
    settings = experiment.Comparison(budget_queries, seeds, searches or COMPARED)
    make_folder(out)
    compile_first(cell)
    with progress_bar("comparing") as update:
        outcomes = list(experiment.compare(assemblies, cell, settings, out, update))
    lines = experiment.summary(outcomes)
    write_atomically(out / "table.md", experiment.table(lines) + "\n")
    write_atomically(out / "table.csv", experiment.comma_separated(lines))
    try:
        experiment.plot(outcomes, out / "lengths.png")
    except InputError as error:
        note(f"no plot: {error}")
    if as_json:
        known = [{key: value if value == value else None for key, value in asdict(each).items()} for each in lines]
        print_json({"folder": str(out), "queries": budget_queries, "searches": known})
        return
    click.echo(experiment.table(lines))
    if all(each.runs == 1 for each in lines):
        note("one run of each search says little; --seeds 3 or a folder of assemblies gives intervals")
    click.echo(f"written to {out}: table.md, table.csv, lengths.png")
