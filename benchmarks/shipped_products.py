"""Every shipped product with several arms: planned by exact search and verified with physics.
``python benchmarks/shipped_products.py --document docs/benchmarks.md``.

What is known of a product in a workcell is kept in the output folder, and not done again while the workcell and the
sources that shape an answer are the same.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kept_rows import publish, read_row, write_and_verify, write_row
from takeapart.experiments.tables import markdown_table
from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.formats.serialization import workcell_hash
from takeapart.model.plan import Plan
from takeapart.planning import PlanningOptions, plan, sources_digest
from takeapart.search.result import Budget
from takeapart.workcell import Workcell

MARKER = "shipped products"
OF_A_KIND = 2  # reasons that are printed of a product that cannot be taken apart


@dataclass(frozen=True)
class Outcome:
    """A product in a workcell.

    Args:
        parts: removable ones.
        length: of the plan, m; None where there is none.
        straight_line: bound for any planner and grasp, m.
        queries: removal queries.
        seconds: processor time of the search.
        findings: of the verification; 0 where the plan holds.
        left: parts with which an order ended, where none was found.
        reasons: why some of them cannot leave.
    """

    product: str
    parts: int
    length: float | None
    straight_line: float | None
    queries: int
    seconds: float
    findings: int
    left: int
    reasons: tuple[str, ...]


def outcome_of(name: str, workcell: Workcell, queries: float, folder: Path) -> Outcome:
    """Plans a shipped product, ``single/01``, writes the plan, reads it again and verifies it."""
    assembly = load_assembly(data_path(f"{name}.json"))
    started = time.process_time()
    made = plan(assembly, workcell, PlanningOptions(search="exact", budget=Budget(queries=queries)))
    seconds, parts = time.process_time() - started, sum(not part.fixed for part in assembly.parts)
    if not isinstance(made, Plan):
        # Parts that gravity keeps are explained by those that they carry.
        told = [f"{each.part}: {each.reason}" for each in made.hindrances]
        reasons = tuple(line for line in told if "would fall" not in line)[:OF_A_KIND]
        return Outcome(name, parts, None, None, 0, seconds, 0, len(made.remaining), reasons)
    report = write_and_verify(made, _file(name, workcell, folder, ".plan.json"), assembly, workcell)
    asked = int(made.counts["removal_queries"])
    return Outcome(
        name, parts, made.total_length, made.straight_line_bound, asked, seconds, len(report.findings), 0, ()
    )


def kept_outcome(name: str, workcell: Workcell, queries: float, folder: Path) -> Outcome:
    """As `outcome_of`, kept in a folder."""
    file, origin = _file(name, workcell, folder, ".json"), [sources_digest(), workcell_hash(workcell), queries]
    found = read_row(Outcome, file, origin)
    if found is None:
        found = outcome_of(name, workcell, queries, folder)
        write_row(found, file, origin)
    return found


def _file(name: str, workcell: Workcell, folder: Path, ending: str) -> Path:
    return folder / f"{name.replace('/', '-')}.{workcell.name}{ending}"


def table(outcomes: Sequence[Sequence[Outcome]], workcells: Sequence[Workcell]) -> str:
    """Lengths of all products by arm, then queries and seconds, then why products cannot be taken apart."""
    head = ["product", "parts", *(f"{cell.description.name}: length, m (bound), queries, s" for cell in workcells)]
    rows = [[each[0].product, each[0].parts, *map(_cell, each)] for each in zip(*outcomes, strict=True)]
    rows.append(["mean of those planned", "", *map(_mean, outcomes)])
    refused = [
        f"- {found.product} with {cell.description.name}: no order, {found.left} parts left. {'; '.join(found.reasons)}"
        for cell, column in zip(workcells, outcomes, strict=True)
        for found in column
        if found.length is None
    ]
    return "\n\n".join([markdown_table(head, rows), *(["\n".join(refused)] if refused else [])])


def _cell(found: Outcome) -> str:
    if found.length is None:
        return f"no order, {found.left} left, {found.seconds:.0f} s"
    verdict = "" if not found.findings else f", **{found.findings} findings**"
    return f"{found.length:.3f} ({found.straight_line:.3f}), {found.queries}, {found.seconds:.0f} s{verdict}"


def _mean(column: Sequence[Outcome]) -> str:
    planned = [found for found in column if found.length is not None]
    if not planned:
        return "none"
    lengths = statistics.mean(found.length or 0.0 for found in planned)
    seconds = statistics.mean(found.seconds for found in planned)
    return f"{lengths:.3f}, {len(planned)} of {len(column)} products, {seconds:.0f} s"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workcells", nargs="+", default=["panda", "ur5e", "xarm7"], help="names or files")
    parser.add_argument("--assemblies", nargs="+", metavar="KIND/NUMBER", help="only these")
    parser.add_argument("--queries", type=float, default=600, help="budget of a search")
    parser.add_argument("--out", type=Path, default=Path("out/shipped-products"), help="folder of what is kept")
    parser.add_argument("--document", type=Path, help="document whose table is replaced")
    arguments = parser.parse_args()
    names = arguments.assemblies or [
        f"{kind}/{file.stem}" for kind in ("single", "double") for file in sorted(data_path(kind).glob("*.json"))
    ]
    arguments.out.mkdir(parents=True, exist_ok=True)
    workcells = [load_workcell(name) for name in arguments.workcells]
    outcomes: list[list[Outcome]] = []
    for workcell in workcells:
        outcomes.append([])
        for name in names:
            outcomes[-1].append(kept_outcome(name, workcell, arguments.queries, arguments.out))
            print(f"{workcell.name} {name}: {_cell(outcomes[-1][-1])}", flush=True)
    publish(table(outcomes, workcells), MARKER, arguments.document)


if __name__ == "__main__":
    main()
