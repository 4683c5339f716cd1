"""Writes down what `reproduce paper` found: CSV, plots, a report, and the marked blocks of docs/results.md."""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import takeapart
from takeapart.experiments import paper_csv, paper_tables
from takeapart.experiments.paired_statistics import Comparison
from takeapart.experiments.paper_figures import draw_all
from takeapart.experiments.paper_jobs import Product, load_products
from takeapart.experiments.paper_results import (
    TITLES,
    EqualCost,
    Replanning,
    Row,
    Saving,
    comparisons,
    equal_costs,
    replannings,
    savings,
    table_rows,
)
from takeapart.experiments.paper_settings import DOUBLE, SINGLE, PaperSettings
from takeapart.experiments.paper_values import TABLES
from takeapart.experiments.schedule import Kept
from takeapart.experiments.tables import replace_between_markers
from takeapart.formats.documents import write_atomically
from takeapart.planning import versions

REPORT = "report.md"
TARGET = 0.05  # reduction of the mean length that the guide should reach
SHIPPED = {"single": SINGLE, "double": DOUBLE}


@dataclass(frozen=True, eq=False)
class Findings:
    """Everything that tables and plots are made of."""

    settings: PaperSettings
    results: Mapping[str, Kept]
    rows: Sequence[Row]
    replannings: Sequence[Replanning]
    equal: Sequence[EqualCost]
    savings: Sequence[Saving]
    comparisons: Mapping[tuple[str, str, str], Comparison]


def findings(settings: PaperSettings, results: Mapping[str, Kept]) -> Findings:
    """From the results of all jobs."""
    products: list[Product] = load_products(settings)
    rows = table_rows(products, results)
    compared = comparisons(rows, settings.seed)
    return Findings(settings, results, rows, replannings(products, results), equal_costs(rows), savings(rows), compared)


def write_results(found: Findings, out: Path) -> list[Path]:
    """All files: CSV, plots and report.

    Raises:
        InputError: one cannot be written.
        MissingExtraError: matplotlib is not installed.
    """
    texts = {
        "table1.csv": paper_csv.table_csv("single", found.rows),
        "table2.csv": paper_csv.table_csv("double", found.rows),
        "figure5.csv": paper_csv.figure_csv(found.replannings),
        "equal_plans.csv": paper_csv.equal_csv(found.equal),
        "savings.csv": paper_csv.savings_csv(found.savings),
        "traces.csv": paper_csv.traces_csv(found.rows),
        "reference.csv": paper_csv.reference_csv(found.rows),
        "orders.csv": paper_csv.orders_csv(found.rows),
    }
    plots = draw_all(found.rows, found.replannings, found.savings, out)
    blocks = report_blocks(found)
    report = [f"# {title}\n\n{blocks[name]}" for name, title in BLOCK_TITLES.items()]
    report += [f"![{plot.stem}]({plot.name})" for plot in plots]
    texts[REPORT] = "\n\n".join(report) + "\n"
    for name, text in texts.items():
        write_atomically(out / name, text)
    return [out / name for name in texts] + plots


BLOCK_TITLES = {
    "results-settings": "Settings",
    "results-table1": "Table I",
    "results-table2": "Table II",
    "results-paper": "Beside the paper",
    "results-training": "Training",
    "results-comparison": "Guided against vanilla search",
    "results-equal": "At equal motion plans",
    "results-savings": "Planner calls saved",
    "results-reference": "Room to gain",
    "results-orders": "Order and paths",
    "results-figure5": "Fig. 5",
    "results-time": "Where the time goes",
}


def report_blocks(found: Findings) -> dict[str, str]:
    """Text of every block, by the name of its markers."""
    shipped = {kind: getattr(found.settings, kind) == names for kind, names in SHIPPED.items()}
    return {
        "results-settings": settings_text(found.settings),
        "results-table1": paper_tables.table_markdown("single", found.rows, shipped["single"]),
        "results-table2": paper_tables.table_markdown("double", found.rows, shipped["double"]),
        "results-paper": paper_text(found),
        "results-training": paper_tables.training_markdown(found.results),
        "results-comparison": paper_tables.comparison_markdown(found.comparisons) + "\n\n" + verdict_text(found),
        "results-equal": paper_tables.equal_markdown(found.rows),
        "results-savings": paper_tables.savings_markdown(found.savings),
        "results-reference": paper_tables.reference_markdown(found.rows),
        "results-orders": paper_tables.orders_markdown(found.rows),
        "results-figure5": paper_tables.figure_markdown(found.replannings),
        "results-time": paper_tables.time_markdown(found.results),
    }


def fill_document(found: Findings, document: Path) -> None:
    """Puts every block between its markers in a document.

    Raises:
        InputError: the document or a marker is missing.
    """
    for name, text in report_blocks(found).items():
        replace_between_markers(document, name, text)


def settings_text(settings: PaperSettings) -> str:
    """What was run."""
    options = asdict(settings)
    queries = options.pop("queries")
    options["queries"] = queries if math.isfinite(queries) else None
    for kind in SHIPPED:
        options[kind] = len(options[kind])
    shaping = ", ".join(f"{name} {version}" for name, version in versions().items() if name != "takeapart")
    return (
        f"takeapart {takeapart.__version__}; {shaping}; Python {platform.python_version()}, {platform.machine()}.\n\n"
        f"```json\n{json.dumps(options, indent=1)}\n```"
    )


def paper_text(found: Findings) -> str:
    """Our means beside the paper's, one sentence each."""
    lines = []
    for kind, trained_on, name in found.comparisons:
        ours = found.comparisons[kind, trained_on, name]
        if name != "all episodes":
            continue
        table = TABLES[kind]
        vanilla = sum(row.vanilla.shortest for row in table) / len(table)
        guided = sum(row.guided[trained_on].shortest for row in table) / len(table)
        shorter = sum(row.guided[trained_on].shortest < row.vanilla.shortest for row in table)
        lines.append(
            f"- {TITLES[kind]}, guide of {TITLES[trained_on]}: ours {ours.first:.2f} m vanilla, {ours.second:.2f} m "
            f"guided ({ours.reduction:+.1%} saved, shorter for {ours.smaller} of {ours.pairs}); paper {vanilla:.2f} m, "
            f"{guided:.2f} m ({1 - guided / vanilla:+.1%}, {shorter} of {len(table)})."
        )
    for kind in SHIPPED:
        own = [row.vanilla for row in found.rows if row.product.kind == kind and row.vanilla.trace]
        if own:
            ours_share = 1 - sum(run.shortest.length for run in own) / sum(run.initial.length for run in own)
            table = TABLES[kind]
            theirs = 1 - sum(row.vanilla.shortest for row in table) / sum(row.initial for row in table)
            lines.append(
                f"- {TITLES[kind]}, vanilla: from the first sequence to the shortest, {ours_share:.1%} are saved; "
                f"in the paper {theirs:.1%}."
            )
    return "\n".join(lines)


def verdict_text(found: Findings) -> str:
    """Whether the guide reaches what it should, in one sentence per comparison at equal cost."""
    lines = []
    for (kind, trained_on, name), compared in found.comparisons.items():
        if name == "equal motion plans":
            reached = "reached" if compared.reduction >= TARGET else "not reached"
            lines.append(
                f"- {TITLES[kind]}, guide of {TITLES[trained_on]}: {compared.reduction:.1%} shorter at equal motion "
                f"plans; the {TARGET:.0%} aimed at are {reached}."
            )
    shares = [run.guide_share for row in found.rows for run in row.guided.values()]
    if shares:
        lines.append(f"- The guide takes {max(shares):.0%} of a search's processor time at most.")
    return "\n".join(lines)
