"""Beyond exact search: where the states are too many to enumerate, a guide has to earn its place.

Every search, with and without a guide, plans the same assemblies within the same number of removal queries, each with a
library of its own that is empty at the start. Jobs are kept as by `paper`.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from takeapart.assembly import Assembly
from takeapart.documents import write_atomically
from takeapart.errors import InputError
from takeapart.experiments.beyond_tasks import RUNNERS, BeyondTask
from takeapart.experiments.jobs import Job
from takeapart.experiments.paired_statistics import compare
from takeapart.experiments.paper_csv import as_csv
from takeapart.experiments.paper_figures import figure_modules
from takeapart.experiments.paper_tables import metres
from takeapart.experiments.schedule import Kept, ScheduleListener, run_schedule
from takeapart.experiments.tables import markdown_table, replace_between_markers
from takeapart.experiments.workers import Workers
from takeapart.files import load_assembly, load_workcell
from takeapart.messages import reason, shown

SHARES = (0.1, 0.25, 0.5, 1.0)
"""Of the budget in removal queries; there lengths are compared."""

GUIDED = {False: "no guide", True: "guide"}
MARKER = "results-beyond"
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")


@dataclass(frozen=True)
class BeyondSettings:
    """What is compared.

    Args:
        assemblies: files.
        guide: file with the weights.
        workcell: name of a shipped one or a file.
        seed: of all random choices.
        queries: removal queries of every search.
    """

    assemblies: tuple[Path, ...]
    guide: Path
    workcell: str = "panda"
    seed: int = 0
    queries: int = 1000

    def __post_init__(self) -> None:
        if not self.assemblies:
            raise InputError("at least one assembly is needed", "settings.assemblies")
        if self.queries < 1:
            raise InputError(f"{self.queries}; must be at least 1", "settings.queries")


@dataclass(frozen=True, eq=False)
class BeyondRun:
    """A search on an assembly.

    Args:
        assembly: its name.
        parts: removable ones.
        trace: improvements: removal queries, and length, m.
        sequence_bound: m; None where the search gives none.
        queries, motion_plans: spent.
    """

    assembly: str
    parts: int
    search: str
    guided: bool
    trace: Sequence[tuple[int, float]]
    sequence_bound: float | None
    queries: int
    motion_plans: int

    def length_at(self, queries: float) -> float:
        """Of the shortest sequence known after so many queries, m; infinite if there was none."""
        return min((length for asked, length in self.trace if asked <= queries), default=math.inf)


def job_name(number: int, search: str, guided: bool) -> str:
    """Name of a job; assemblies are numbered from 1."""
    return f"beyond/{number:02d}-{search}{'-guided' if guided else ''}"


def beyond_jobs(settings: BeyondSettings, assemblies: Sequence[Assembly]) -> list[Job]:
    """A job per assembly, search, with and without the guide.

    Raises:
        InputError: the guide's file cannot be read.
    """
    workcell = load_workcell(settings.workcell)
    try:
        weights = settings.guide.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {reason(error)}", shown(settings.guide)) from None
    return [
        Job(
            job_name(number, search, guided),
            BeyondTask(assembly, workcell, settings.seed, search, settings.queries, weights if guided else None),
        )
        for number, assembly in enumerate(assemblies, 1)
        for search in RUNNERS
        for guided in GUIDED
    ]


def beyond_runs(assemblies: Sequence[Assembly], results: Mapping[str, Kept]) -> list[BeyondRun]:
    """Results of all jobs."""
    runs = []
    for number, assembly in enumerate(assemblies, 1):
        for search in RUNNERS:
            for guided in GUIDED:
                outcome = results[job_name(number, search, guided)].outcome
                trace = tuple((int(asked), float(length)) for asked, _, length in outcome["trace"])
                spent = outcome["removal_queries"], outcome["motion_plans"]
                bound = outcome["sequence_bound"]
                runs.append(BeyondRun(assembly.name, outcome["parts"], search, guided, trace, bound, *spent))
    return runs


def runs_csv(runs: Sequence[BeyondRun], queries: int) -> str:
    """beyond.csv: lengths at the shares of the budget."""
    header = ["assembly", "parts", "search", "guide"]
    header += [f"length_at_{round(share * queries)}_queries" for share in SHARES]
    header += ["sequence_bound", "queries", "motion_plans"]
    lines: list[list[str | int | float]] = []
    for run in runs:
        lengths = [run.length_at(share * queries) for share in SHARES]
        bound = math.nan if run.sequence_bound is None else run.sequence_bound
        spent = [run.queries, run.motion_plans]
        lines.append([run.assembly, run.parts, run.search, GUIDED[run.guided], *lengths, bound, *spent])
    return as_csv(header, lines)


def lengths_markdown(runs: Sequence[BeyondRun], queries: int) -> str:
    """Mean lengths over the assemblies at the shares of the budget, and what the guide gains at its end."""
    rows: list[list[str]] = []
    for search in dict.fromkeys(run.search for run in runs):
        both = [[run for run in runs if run.search == search and run.guided is guided] for guided in GUIDED]
        for guided, own in zip(GUIDED, both, strict=True):
            cells = [_mean_at(own, share * queries) for share in SHARES]
            spent = f"{np.mean([run.queries for run in own]):,.0f}"
            plans = f"{np.mean([run.motion_plans for run in own]):,.0f}"
            rows.append([f"{search}, {GUIDED[guided]}", *cells, spent, plans, _gain(*both) if guided else ""])
    header = ["search", *(f"length at {round(share * queries):,} queries, m" for share in SHARES)]
    return markdown_table([*header, "queries", "motion plans", "guide shorter by [95 %]"], rows)


def _mean_at(runs: Sequence[BeyondRun], queries: float) -> str:
    lengths = [run.length_at(queries) for run in runs]
    found = [length for length in lengths if math.isfinite(length)]
    if not found:
        return "-"
    missing = "" if len(found) == len(lengths) else f" ({len(found)} of {len(lengths)})"
    return f"{metres(float(np.mean(found)))}{missing}"


def _gain(plain: Sequence[BeyondRun], guided: Sequence[BeyondRun]) -> str:
    ends = [[run.length_at(math.inf) for run in own] for own in (plain, guided)]
    found = compare(ends[0], ends[1], np.random.default_rng(0))
    if not found.pairs:
        return "-"
    return f"{found.reduction:.1%} [{found.reduction_low:.1%}, {found.reduction_high:.1%}]"


def draw(runs: Sequence[BeyondRun], queries: int) -> Any:
    """Mean length so far, as a share of the best that any search found, against removal queries."""
    figure = figure_modules()(figsize=(7, 4.2), layout="constrained")
    axes = figure.subplots()
    best = {name: min(run.length_at(math.inf) for run in runs if run.assembly == name) for name in _names(runs)}
    asked = np.unique(np.geomspace(10, max(queries, 11), 150).round())
    for colour, search in zip(COLOURS, dict.fromkeys(run.search for run in runs), strict=False):
        for guided in GUIDED:
            own = [run for run in runs if run.search == search and run.guided is guided]
            shares = [np.mean([run.length_at(q) / best[run.assembly] for run in own]) for q in asked]
            known = np.array([share if math.isfinite(share) else math.nan for share in shares])
            style = "-" if guided else "--"
            axes.plot(asked, known, linestyle=style, color=colour, label=f"{search}, {GUIDED[guided]}")
    axes.set_xscale("log")
    axes.set_xlabel("removal queries")
    axes.set_ylabel("shortest length so far / best of all searches")
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, fontsize="small")
    return figure


def _names(runs: Sequence[BeyondRun]) -> list[str]:
    return list(dict.fromkeys(run.assembly for run in runs))


def compare_beyond(
    settings: BeyondSettings,
    out: Path,
    workers: Workers,
    listen: ScheduleListener | None = None,
    document: Path | None = None,
) -> list[Path]:
    """Runs what is missing; writes beyond.csv, beyond.md and beyond.png.

    Args:
        out: folder for them; results of jobs are kept in its folder ``work``.
        workers: who does the jobs; let go at the end.
        listen: is told about progress.
        document: whose block ``results-beyond`` is filled too.

    Raises:
        InputError: an input is broken, two assemblies have the same name, or something cannot be written.
        TakeapartError: a job failed.
    """
    try:
        figure_modules()
        assemblies = [load_assembly(path) for path in settings.assemblies]
        names = [assembly.name for assembly in assemblies]
        if len(set(names)) < len(names):
            raise InputError(f"two assemblies have the same name ({', '.join(names)})", "settings.assemblies")
        jobs = beyond_jobs(settings, assemblies)
    except BaseException:
        workers.stop(now=True)
        raise
    results = run_schedule(jobs, out / "work", workers, listen)
    runs = beyond_runs(assemblies, results)
    picture = io.BytesIO()
    draw(runs, settings.queries).savefig(picture, format="png", dpi=150)
    text = lengths_markdown(runs, settings.queries)
    files: dict[str, str | bytes] = {
        "beyond.md": f"{text}\n",
        "beyond.csv": runs_csv(runs, settings.queries),
        "beyond.png": picture.getvalue(),
    }
    for name, content in files.items():
        write_atomically(out / name, content)
    if document is not None:
        replace_between_markers(document, MARKER, text)
    return [out / name for name in files]
