"""Plots of `reproduce paper`."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from takeapart.experiments.paired_statistics import mean_interval
from takeapart.experiments.paper_results import TITLES, Replanning, Row, Saving, guide_columns
from takeapart.formats.documents import write_atomically
from takeapart.model.errors import MissingExtraError
from takeapart.model.geometry import Array

VANILLA, REFERENCE = "#444444", "#999999"
GUIDED = {"single": "#0072b2", "double": "#d55e00"}  # a pair that colour-blind people can tell apart
GRID_POINTS = 200
TABLE_FILES = {"single": "table1", "double": "table2"}


def figure_modules() -> Any:
    """matplotlib's `Figure`, which draws without a display and without global state.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtraError("reproduce", "view", "matplotlib") from None
    return Figure


def draw_all(rows: Sequence[Row], found: Sequence[Replanning], spared: Sequence[Saving], folder: Path) -> list[Path]:
    """All plots, as PNG and SVG; returns the PNG files."""
    from matplotlib import rc_context

    figures = {"figure5": draw_figure5(found)}
    for kind, name in TABLE_FILES.items():
        figures[name] = draw_table(kind, [row for row in rows if row.product.kind == kind])
    figures |= {"equal_plans": draw_equal_plans(rows), "savings": draw_savings(spared)}
    files = []
    for name, figure in figures.items():
        for ending, metadata in (("png", {}), ("svg", {"Date": None})):
            content = io.BytesIO()
            with rc_context({"svg.hashsalt": "takeapart"}):  # the same plot is the same file
                figure.savefig(content, format=ending, dpi=150, metadata=metadata)
            write_atomically(folder / f"{name}.{ending}", content.getvalue())
        files.append(folder / f"{name}.png")
    return files


def draw_figure5(found: Sequence[Replanning]) -> Any:
    """Fig. 5: total path length and planning time per part against the number of replans."""
    figure = figure_modules()(figsize=(9, 3.8), layout="constrained")
    length_axes, time_axes = figure.subplots(1, 2)
    width = 0.8 / max(1, len(found))
    for place, item in enumerate(found):
        replans = range(1, len(item.lengths[0]) + 1)
        offset = (place - (len(found) - 1) / 2) * width
        lengths = [[row[k - 1] for row in item.lengths if math.isfinite(row[k - 1])] for k in replans]
        colour = f"C{place}"
        boxes = length_axes.boxplot(
            lengths, positions=[k + offset for k in replans], widths=0.85 * width, patch_artist=True, manage_ticks=False
        )
        for box in boxes["boxes"]:
            box.set(facecolor=colour, alpha=0.5)
        for line in boxes["medians"]:
            line.set(color="black")
        intervals = [mean_interval([1e3 * row[k - 1] for row in item.seconds]) for k in replans]
        means = np.array([interval.mean for interval in intervals])
        below = means - [interval.low if math.isfinite(interval.low) else interval.mean for interval in intervals]
        label = f"assembly {item.product.number}"
        time_axes.errorbar(replans, means, yerr=below, marker="o", markersize=4, capsize=3, color=colour, label=label)
    for axes in (length_axes, time_axes):
        axes.set_xlabel("times each removal is planned")
        axes.grid(axis="y", alpha=0.3)
        axes.xaxis.get_major_locator().set_params(integer=True)
    length_axes.set_ylabel("total path length, m")
    time_axes.set_ylabel("planning time per part, ms")
    time_axes.set_ylim(bottom=0)
    if found:
        figure.legend(*time_axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    return figure


def draw_table(kind: str, rows: Sequence[Row]) -> Any:
    """Table I or II: what every search found for every assembly."""
    figure = figure_modules()(figsize=(9, 4), layout="constrained")
    axes = figure.subplots()
    places = np.arange(len(rows))
    series: list[tuple[str, list[float], dict[str, Any]]] = [
        ("vanilla, first sequence", [row.vanilla.initial.length for row in rows], {"marker": "x", "color": VANILLA}),
        ("vanilla, shortest", [row.vanilla.shortest.length for row in rows], {"marker": "o", "color": VANILLA}),
    ]
    for trained_on in guide_columns(kind):
        lengths = [row.guided[trained_on].shortest.length for row in rows]
        look = {"marker": "D" if trained_on == "single" else "s", "color": GUIDED[trained_on]}
        series.append((f"guide of {TITLES[trained_on]}, shortest", lengths, look))
    series.append(
        ("exact search", [row.reference.length for row in rows], {"marker": "_", "color": REFERENCE, "s": 160})
    )
    spread = 0.12
    for number, (name, lengths, look) in enumerate(series):
        known = [value if math.isfinite(value) else math.nan for value in lengths]
        axes.scatter(places + (number - (len(series) - 1) / 2) * spread, known, label=name, **look)
    axes.set_xticks(places, [str(row.product.number) for row in rows])
    axes.set_xlabel(f"assembly of {TITLES[kind]}")
    axes.set_ylabel("total path length, m")
    axes.grid(axis="y", alpha=0.3)
    figure.legend(loc="outside lower center", ncols=len(series), frameon=False, fontsize="small")
    return figure


def draw_equal_plans(rows: Sequence[Row]) -> Any:
    """Shortest length so far against motion plans spent, as a share of what vanilla search found in the end."""
    figure = figure_modules()(figsize=(9, 3.8), layout="constrained")
    for axes, kind in zip(figure.subplots(1, 2), TITLES, strict=True):
        own = [row for row in rows if row.product.kind == kind and row.vanilla.trace]
        axes.set_title(TITLES[kind])
        axes.set_xlabel("motion plans")
        axes.set_ylabel("shortest length so far / vanilla's last")
        axes.grid(alpha=0.3)
        if not own:
            continue
        runs = [("vanilla", VANILLA, [row.vanilla for row in own])]
        for trained_on in guide_columns(kind):
            guided = [row.guided[trained_on] for row in own]
            runs.append((f"guide of {TITLES[trained_on]}", GUIDED[trained_on], guided))
        first = max(1, min(run.initial.motion_plans for _, _, found in runs for run in found))
        last = max(run.motion_plans for _, _, found in runs for run in found)
        grid = np.geomspace(first, max(last, first + 1), GRID_POINTS)
        for name, colour, found in runs:
            shares = np.array(
                [
                    [run.length_at(plans) / row.vanilla.shortest.length for plans in grid]
                    for run, row in zip(found, own, strict=True)
                ]
            )
            low, middle, high = _band(shares)
            axes.plot(grid, middle, color=colour, label=name)
            axes.fill_between(grid, low, high, color=colour, alpha=0.15, linewidth=0)
        axes.axhline(1.0, color=VANILLA, linewidth=0.8, linestyle=":")
        axes.set_xscale("log")
        axes.legend(frameon=False, fontsize="small")
    return figure


def _band(shares: Array) -> tuple[Array, Array, Array]:
    """Least, mean and greatest of each column (runs, points); NaN where not every run has a sequence yet."""
    known = np.isfinite(shares).all(axis=0)
    band = np.full((3, shares.shape[1]), math.nan)
    band[:, known] = shares[:, known].min(axis=0), shares[:, known].mean(axis=0), shares[:, known].max(axis=0)
    return band[0], band[1], band[2]


def draw_savings(spared: Sequence[Saving]) -> Any:
    """Motion plans until vanilla's last length was reached: guided against vanilla, one mark per assembly."""
    figure = figure_modules()(figsize=(4.8, 4.2), layout="constrained")
    axes = figure.subplots()
    axes.set_xlabel("vanilla: motion plans to its shortest length")
    axes.set_ylabel("guided: motion plans to that length")
    ends = [saving.vanilla for saving in spared] + [s.guided for s in spared if math.isfinite(s.guided)]
    if ends:
        low, high = max(1.0, 0.7 * min(ends)), 1.4 * max(ends)
        axes.plot([low, high], [low, high], color=REFERENCE, linewidth=0.8)
        for kind, trained_on in dict.fromkeys((s.product.kind, s.trained_on) for s in spared):
            own = [s for s in spared if (s.product.kind, s.trained_on) == (kind, trained_on)]
            reached = [s for s in own if math.isfinite(s.guided)]
            marker = "o" if kind == "single" else "s"
            look = {"color": GUIDED[trained_on], "marker": marker, "linestyle": "none"}
            label = f"{TITLES[kind]}, guide of {TITLES[trained_on]} ({len(reached)} of {len(own)})"
            axes.plot([s.vanilla for s in reached], [s.guided for s in reached], label=label, **look)
            never = [s.vanilla for s in own if not math.isfinite(s.guided)]
            axes.plot(never, [high] * len(never), **{**look, "marker": "^", "fillstyle": "none"})
        axes.set(xscale="log", yscale="log", xlim=(low, high), ylim=(low, 1.2 * high))
        axes.legend(frameon=False, fontsize="small", title="reached (triangles: never)")
    return figure
