"""Tables of `reproduce paper` in Markdown, for people."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from takeapart.experiments.paired_statistics import Comparison, mean_interval
from takeapart.experiments.paper_jobs import PHASES
from takeapart.experiments.paper_results import (
    SHARES,
    TITLES,
    Replanning,
    Row,
    Saving,
    equal_costs_of,
    guide_columns,
    pairs_in,
)
from takeapart.experiments.paper_values import TABLES, PaperRun
from takeapart.experiments.schedule import Kept
from takeapart.experiments.tables import markdown_table

TRAINED = {"D1 without one": "single-without-", "D2 without one": "double-without-", "all of D1": "single-all"}
HASHES = ("hash", "weights")


def metres(value: float) -> str:
    """With the two decimals of the paper."""
    return f"{value:.2f}" if math.isfinite(value) else "-"


def table_markdown(kind: str, rows: Sequence[Row], shipped: bool) -> str:
    """Table I or II in the paper's columns.

    Args:
        shipped: whether the assemblies are the shipped ones; then the paper's value stands below ours, in italics,
            though the paper's assemblies are others.
    """
    guides = list(guide_columns(kind))
    header = ["id", "vanilla: initial, m", "shortest, m", "found after (#epi, #st)"]
    for trained_on in guides:
        header += [f"Q-function of {TITLES[trained_on]}: shortest, m", "found after (#epi, #st)"]
    lines: list[list[str]] = []
    own = [row for row in rows if row.product.kind == kind]
    for row in own:
        runs = [row.vanilla, *(row.guided[trained_on] for trained_on in guides)]
        best = min(run.shortest.length for run in runs)
        cells = [metres(row.vanilla.initial.length)]
        for run in runs:
            cells += [_bold(run.shortest.length, best), f"({run.episode}, {run.step})" if run.trace else "-"]
        lines.append([str(row.product.number), *cells])
        if shipped:
            paper = TABLES[kind][row.product.number - 1]
            published: list[PaperRun] = [paper.vanilla, *(paper.guided[trained_on] for trained_on in guides)]
            cells = [metres(paper.initial)]
            for run_ in published:
                cells += [metres(run_.shortest), f"({run_.episode}, {run_.step})"]
            lines.append(["*paper*", *(f"*{cell}*" for cell in cells)])
    means = [_mean([row.vanilla.initial.length for row in own])]
    for runs in [[row.vanilla for row in own], *([row.guided[kind_] for row in own] for kind_ in guides)]:
        means += [_mean([run.shortest.length for run in runs]), ""]
    lines.append(["mean", *means])
    return markdown_table(header, lines)


def _bold(length: float, best: float) -> str:
    return f"**{metres(length)}**" if math.isfinite(length) and length == best else metres(length)


def _mean(values: Sequence[float]) -> str:
    found = mean_interval([value for value in values if math.isfinite(value)])
    if not math.isfinite(found.low):
        return metres(found.mean)
    return f"{found.mean:.2f} ± {found.high - found.mean:.2f}"


def figure_markdown(found: Sequence[Replanning]) -> str:
    """Fig. 5 in numbers: mean and its 95 % interval."""
    rows = []
    for item in found:
        for replans in range(len(item.lengths[0])):
            lengths = [row[replans] for row in item.lengths if math.isfinite(row[replans])]
            seconds = [1e3 * row[replans] for row in item.seconds]
            plans = [row[replans] for row in item.motion_plans]
            failed = len(item.lengths) - len(lengths)
            cells = [_mean(lengths), f"{np.mean(seconds):.1f}", f"{np.mean(plans):.1f}", failed]
            rows.append([item.product.number, replans + 1, *cells])
    header = ["id", "replans", "total path length, m", "time per part, ms", "motion plans per part", "failed repeats"]
    return markdown_table(header, rows)


def comparison_markdown(found: Mapping[tuple[str, str, str], Comparison]) -> str:
    """Means, intervals and tests."""
    rows = []
    for (kind, trained_on, name), c in found.items():
        rows.append(
            [
                f"{TITLES[kind]}, guide of {TITLES[trained_on]}, {name}",
                c.pairs,
                metres(c.first),
                metres(c.second),
                f"{c.difference.mean:+.3f} [{c.difference.low:+.3f}, {c.difference.high:+.3f}]",
                f"[{c.bootstrap[0]:+.3f}, {c.bootstrap[1]:+.3f}]",
                f"{c.reduction:.1%} [{c.reduction_low:.1%}, {c.reduction_high:.1%}]",
                f"{c.smaller} / {c.equal} / {c.larger}",
                f"{c.t_p:.3g}",
                f"{c.wilcoxon_p:.3g}",
            ]
        )
    header = ["comparison", "pairs", "vanilla, m", "guided, m", "difference, m [95 %, t]", "[95 %, bootstrap]"]
    header += ["reduction [95 %, bootstrap]", "shorter / equal / longer", "p (paired t)", "p (Wilcoxon)"]
    return markdown_table(header, rows)


def equal_markdown(rows: Sequence[Row]) -> str:
    """Mean lengths of both searches at the same number of motion plans."""
    lines = []
    for kind, trained_on in pairs_in(rows):
        costs = equal_costs_of([row for row in rows if row.product.kind == kind], trained_on)
        for share in SHARES:
            both = [c for c in costs if c.share == share and math.isfinite(c.vanilla) and math.isfinite(c.guided)]
            at = [cost for cost in costs if cost.share == share]
            vanilla, guided = np.mean([(c.vanilla, c.guided) for c in both], axis=0) if both else (math.nan,) * 2
            plans = f"{np.mean([cost.motion_plans for cost in at]):,.0f}"
            reduction = f"{1 - guided / vanilla:.1%}" if both else "-"
            name = f"{TITLES[kind]}, guide of {TITLES[trained_on]}"
            lines.append([name, f"{share:.0%}", plans, len(both), metres(vanilla), metres(guided), reduction])
    header = ["comparison", "share", "motion plans, mean", "pairs with both", "vanilla, m", "guided, m", "reduction"]
    return markdown_table(header, lines)


def savings_markdown(found: Sequence[Saving]) -> str:
    """What the guide saves on the way to vanilla's final length."""
    lines = []
    for kind, trained_on in dict.fromkeys((saving.product.kind, saving.trained_on) for saving in found):
        own = [saving for saving in found if (saving.product.kind, saving.trained_on) == (kind, trained_on)]
        reached = [saving for saving in own if math.isfinite(saving.guided)]
        ratios = sorted(saving.guided / saving.vanilla for saving in own)
        median = float(np.median(ratios))
        lines.append(
            [
                f"{TITLES[kind]}, guide of {TITLES[trained_on]}",
                f"{len(reached)} of {len(own)}",
                f"{np.mean([saving.vanilla for saving in own]):,.0f}",
                f"{np.mean([saving.guided for saving in reached]):,.0f}" if reached else "-",
                f"{1 - median:.0%}" if math.isfinite(median) else "-",
            ]
        )
    header = ["comparison", "reached vanilla's length", "vanilla: motion plans, mean"]
    return markdown_table([*header, "guided: motion plans where reached, mean", "saved, median"], lines)


def reference_markdown(rows: Sequence[Row]) -> str:
    """How much there was to gain."""
    lines = []
    for kind in dict.fromkeys(row.product.kind for row in rows):
        own = [row for row in rows if row.product.kind == kind and math.isfinite(row.reference.length)]
        if own:
            vanilla = float(np.mean([row.vanilla.shortest.length for row in own]))
            length = float(np.mean([row.reference.length for row in own]))
            bound = float(np.mean([row.reference.sequence_bound for row in own]))
            plans = np.mean([(row.vanilla.motion_plans, row.reference.motion_plans) for row in own], axis=0)
            room = [f"{1 - length / vanilla:.1%}", f"{1 - bound / vanilla:.1%}"]
            lines.append(
                [TITLES[kind], len(own), metres(vanilla), f"{plans[0]:,.0f}", metres(length), f"{plans[1]:,.0f}", *room]
            )
    header = ["set", "assemblies", "vanilla, m", "its motion plans", "exact, m", "its motion plans"]
    return markdown_table([*header, "exact is shorter by", "no order is shorter by more than"], lines)


def orders_markdown(rows: Sequence[Row]) -> str:
    """How much of a search's length is its order, and how much its paths."""
    lines = []
    for kind in dict.fromkeys(row.product.kind for row in rows):
        own = [row for row in rows if row.product.kind == kind and math.isfinite(sum(row.orders.values()))]
        for key in own[0].orders if own else ():
            found = float(np.mean([_found(row, key) for row in own]))
            orders = np.array([row.orders[key] for row in own])
            best = np.array([min(row.orders.values()) for row in own])
            name = f"guided, guide of {TITLES[key]}" if key in TITLES else key
            more = mean_interval((100 * (orders / best - 1)).tolist())
            lines.append(
                [
                    f"{TITLES[kind]}, {name}",
                    str(len(own)),
                    metres(found),
                    metres(float(orders.mean())),
                    f"{1 - orders.mean() / found:.1%}" if math.isfinite(found) else "-",
                    f"{more.mean:.1f} ± {more.high - more.mean:.1f} %",
                ]
            )
    header = ["whose order", "assemblies", "as found, m", "planned again, m", "paths shorter by"]
    return markdown_table([*header, "longer than the shortest of these orders"], lines)


def _found(row: Row, key: str) -> float:
    if key == "exact":
        return row.reference.length
    if key == "random":
        return math.nan
    return (row.vanilla if key == "vanilla" else row.guided[key]).shortest.length


def training_markdown(results: Mapping[str, Kept]) -> str:
    """How well the guides rank the parts of assemblies that they were not trained on."""
    rows = []
    for title, prefix in TRAINED.items():
        own = [kept.outcome for name, kept in results.items() if name.startswith(f"guide/{prefix}")]
        if own:
            mean = {key: float(np.mean([outcome[key] for outcome in own])) for key in own[0] if key not in HASHES}
            lengths = [f"{mean[key]:.3f}" for key in ("regret", "random_regret", "error")]
            rows.append([title, len(own), f"{mean['rows']:,.0f}", f"{mean['steps']:,.0f}", *lengths])
    header = ["trained on", "guides", "removals seen", "steps", "regret, m", "regret of a random choice, m"]
    return markdown_table([*header, "mean error of Q, m"], rows)


def time_markdown(results: Mapping[str, Kept]) -> str:
    """Where the time goes."""
    lines = []
    total = sum(kept.processor_seconds for kept in results.values()) or 1.0
    for phase, title in PHASES.items():
        own = [kept for name, kept in results.items() if name.partition("/")[0] == phase]
        used = sum(kept.processor_seconds for kept in own)
        plans = sum(kept.outcome.get("motion_plans", 0) for kept in own)
        queries = sum(kept.outcome.get("removal_queries", 0) for kept in own)
        wall = sum(kept.seconds for kept in own)
        counts = [f"{queries:,}" if queries else "-", f"{plans:,}" if plans else "-"]
        lines.append([title, len(own), *counts, f"{wall:,.0f}", f"{used:,.0f}", f"{used / total:.0%}"])
    header = ["phase", "jobs", "removal queries", "motion plans", "wall time of jobs, s", "processor time, s", "share"]
    return markdown_table(header, lines)
