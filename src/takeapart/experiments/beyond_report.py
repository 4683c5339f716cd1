"""Tables and plot of the searches beyond exact search."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from takeapart.experiments.paired_statistics import compare
from takeapart.experiments.paper_csv import as_csv
from takeapart.experiments.paper_figures import figure_modules
from takeapart.experiments.paper_tables import metres
from takeapart.experiments.tables import markdown_table

SHARES = (0.1, 0.25, 0.5, 1.0)
"""Of the budget in removal queries; there lengths are compared."""

GUIDED = {False: "no guide", True: "guide"}
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")
COLUMNS = 3  # of panels


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


def beyond_markdown(runs: Sequence[BeyondRun], queries: int) -> str:
    """Both tables: means over all assemblies, and every assembly."""
    return f"{means_markdown(runs, queries)}\n\n{lengths_markdown(runs)}"


def means_markdown(runs: Sequence[BeyondRun], queries: int) -> str:
    """How far searches are above the best of all, at the shares of the budget, and what the guide gains in the end.

    A cell is the mean over the assemblies for which the search had a sequence by then.
    """
    best = best_lengths(runs)
    rows: list[list[str]] = []
    for search in dict.fromkeys(run.search for run in runs):
        both = [[run for run in runs if run.search == search and run.guided is guided] for guided in GUIDED]
        for guided, own in zip(GUIDED, both, strict=True):
            cells = [_excess_at(own, best, share * queries) for share in SHARES]
            spent = f"{np.mean([run.queries for run in own]):,.0f}"
            plans = f"{np.mean([run.motion_plans for run in own]):,.0f}"
            rows.append([f"{search}, {GUIDED[guided]}", *cells, spent, plans, _gain(*both) if guided else ""])
    header = ["above the best of all searches", *(f"at {round(share * queries):,} queries" for share in SHARES)]
    return markdown_table([*header, "queries", "motion plans", "guide shorter by [95 %]"], rows)


def lengths_markdown(runs: Sequence[BeyondRun]) -> str:
    """What every search found in the end for every assembly; the best in bold."""
    best = best_lengths(runs)
    searches = list(dict.fromkeys((run.search, run.guided) for run in runs))
    rows = []
    for name, shortest in best.items():
        own = {(run.search, run.guided): run for run in runs if run.assembly == name}
        lengths = [own[key].length_at(math.inf) for key in searches]
        cells = [f"**{metres(each)}**" if each <= shortest < math.inf else metres(each) for each in lengths]
        rows.append([name, own[searches[0]].parts, *cells])
    header = ["length in the end, m", "parts", *(f"{search}, {GUIDED[guided]}" for search, guided in searches)]
    return markdown_table(header, rows)


def best_lengths(runs: Sequence[BeyondRun]) -> dict[str, float]:
    """The shortest length that any search found, m, by name of the assembly; infinite where none found one."""
    names = dict.fromkeys(run.assembly for run in runs)
    return {name: min(run.length_at(math.inf) for run in runs if run.assembly == name) for name in names}


def _excess_at(runs: Sequence[BeyondRun], best: dict[str, float], queries: float) -> str:
    lengths = [(run.length_at(queries), best[run.assembly]) for run in runs]
    found = [length / shortest - 1 for length, shortest in lengths if math.isfinite(length)]
    if not found:
        return "-"
    missing = "" if len(found) == len(lengths) else f" ({len(found)} of {len(lengths)})"
    return f"{np.mean(found):.1%}{missing}"


def _gain(plain: Sequence[BeyondRun], guided: Sequence[BeyondRun]) -> str:
    ends = [[run.length_at(math.inf) for run in own] for own in (plain, guided)]
    found = compare(ends[0], ends[1], np.random.default_rng(0))
    if not found.pairs:
        return "-"
    return f"{found.reduction:.1%} [{found.reduction_low:.1%}, {found.reduction_high:.1%}]"


def draw(runs: Sequence[BeyondRun], queries: int) -> Any:
    """Length so far against removal queries, a panel per assembly; what found nothing is not there."""
    names = list(best_lengths(runs))
    columns = min(COLUMNS, len(names))
    lines = math.ceil(len(names) / columns)
    figure = figure_modules()(figsize=(3.6 * columns + 0.4, 2.8 * lines + 0.8), layout="constrained")
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    colours = dict(zip(dict.fromkeys(run.search for run in runs), COLOURS, strict=False))
    asked = np.unique(np.geomspace(10, max(queries, 11), 150).round())
    marks = sorted({max(round(share * queries), 1) for share in SHARES})
    for axes, name in zip(panels, names, strict=False):
        own = [run for run in runs if run.assembly == name]
        axes.set_title(f"{name}, {own[0].parts} parts", fontsize="medium")
        for run in own:
            lengths = np.array([run.length_at(count) for count in asked])
            lengths[~np.isfinite(lengths)] = math.nan
            style = "-" if run.guided else "--"
            label = f"{run.search}, {GUIDED[run.guided]}"
            axes.plot(asked, lengths, linestyle=style, color=colours[run.search], label=label)
        axes.set_xscale("log")
        axes.set_xticks(marks, [f"{mark:,}" for mark in marks])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
    for axes in panels[len(names) :]:
        axes.set_visible(False)
    figure.supxlabel("removal queries")
    figure.supylabel("shortest length so far, m")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
    return figure
