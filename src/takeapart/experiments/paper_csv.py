"""Tables of `reproduce paper` as comma-separated values, for machines. Lengths in m; empty where there is no number."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence

from takeapart.experiments.paper_results import TITLES, EqualCost, Replanning, Row, Saving, SearchRun, guide_columns

RUN_COLUMNS = (
    "shortest",
    "episode",
    "step",
    "shortest_queries",
    "shortest_motion_plans",
    "queries",
    "motion_plans",
)
Cell = str | int | float


def as_csv(header: Sequence[str], rows: Sequence[Sequence[Cell]]) -> str:
    """Comma-separated values; lengths to 0.1 mm, and nothing where there is no number."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([_plain(cell) for cell in row] for row in rows)
    return text.getvalue()


def _plain(cell: Cell) -> Cell:
    if not isinstance(cell, float):
        return cell
    if not math.isfinite(cell):
        return ""
    return int(cell) if cell == int(cell) and abs(cell) >= 1000 else round(cell, 4)


def table_csv(kind: str, rows: Sequence[Row]) -> str:
    """table1.csv or table2.csv: lengths in m; queries and motion plans when they were found and in all."""
    header = ["id", "vanilla_initial", "vanilla_initial_queries", "vanilla_initial_motion_plans"]
    header += [f"vanilla_{column}" for column in RUN_COLUMNS]
    for prefix in guide_columns(kind).values():
        header += [f"{prefix}_{column}" for column in RUN_COLUMNS]
    lines = []
    for row in rows:
        if row.product.kind == kind:
            initial = row.vanilla.initial
            line: list[Cell] = [row.product.number, initial.length, initial.queries, initial.motion_plans]
            for run in [row.vanilla, *(row.guided[trained_on] for trained_on in guide_columns(kind))]:
                line += _run_cells(run)
            lines.append(line)
    return as_csv(header, lines)


def _run_cells(run: SearchRun) -> list[Cell]:
    shortest = run.shortest
    found: list[Cell] = [run.episode, run.step, shortest.queries, shortest.motion_plans] if run.trace else [""] * 4
    return [shortest.length, *found, run.queries, run.motion_plans]


def figure_csv(found: Sequence[Replanning]) -> str:
    """figure5.csv: a line for every number of replans and every repeat."""
    header = ["id", "replans", "repeat", "length", "seconds_per_part", "motion_plans_per_part"]
    lines = [
        [item.product.number, replans + 1, repeat + 1, lengths[replans], seconds[replans], plans[replans]]
        for item in found
        for replans in range(len(item.lengths[0]))
        for repeat, (lengths, seconds, plans) in enumerate(
            zip(item.lengths, item.seconds, item.motion_plans, strict=True)
        )
    ]
    return as_csv(header, lines)


def equal_csv(costs: Sequence[EqualCost]) -> str:
    """equal_plans.csv."""
    header = ["set", "id", "guide", "share", "motion_plans", "vanilla", "guided"]
    return as_csv(
        header,
        [
            [
                cost.product.kind,
                cost.product.number,
                TITLES[cost.trained_on],
                cost.share,
                cost.motion_plans,
                cost.vanilla,
                cost.guided,
            ]
            for cost in costs
        ],
    )


def savings_csv(found: Sequence[Saving]) -> str:
    """savings.csv."""
    header = ["set", "id", "guide", "target", "vanilla_motion_plans", "guided_motion_plans", "saved"]
    lines: list[list[Cell]] = [
        [s.product.kind, s.product.number, TITLES[s.trained_on], s.target, s.vanilla, s.guided, s.saved] for s in found
    ]
    return as_csv(header, lines)


def traces_csv(rows: Sequence[Row]) -> str:
    """traces.csv: every improvement of every search."""
    lines: list[list[Cell]] = []
    for row in rows:
        runs = {"vanilla": row.vanilla, **{f"guided by {TITLES[kind]}": run for kind, run in row.guided.items()}}
        for name, run in runs.items():
            lines += [
                [row.product.kind, row.product.number, name, point.queries, point.motion_plans, point.length]
                for point in run.trace
            ]
    return as_csv(["set", "id", "search", "queries", "motion_plans", "length"], lines)


def orders_csv(rows: Sequence[Row]) -> str:
    """orders.csv: the orders found, planned again."""
    lines: list[list[Cell]] = [
        [row.product.kind, row.product.number, TITLES.get(key, key), length]
        for row in rows
        for key, length in row.orders.items()
    ]
    return as_csv(["set", "id", "order", "length"], lines)


def reference_csv(rows: Sequence[Row]) -> str:
    """reference.csv."""
    header = ["set", "id", "length", "sequence_bound", "straight_line_bound", "queries", "motion_plans"]
    lines: list[list[Cell]] = []
    for row in rows:
        found = row.reference
        bounds = [found.length, found.sequence_bound, found.straight_line_bound]
        lines.append([row.product.kind, row.product.number, *bounds, found.queries, found.motion_plans])
    return as_csv(header, lines)
