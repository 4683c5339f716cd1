"""What keeping a clearance costs: greedy plans of some assemblies with several clearances of the workcell.

Command: ``python benchmarks/clearance_cost.py``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

from takeapart.experiments.tables import markdown_table, replace_between_markers
from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.model.plan import Plan
from takeapart.planning import PlanningOptions, plan
from takeapart.verification import verify_plan

ASSEMBLIES = ("single/01", "single/03", "single/08", "single/11", "double/01")
CLEARANCES = (0.0, 0.0005, 0.001, 0.0013, 0.003, 0.005)  # m
MARKER = "clearance-cost"


@dataclass(frozen=True)
class Outcome:
    """One plan with one clearance.

    Args:
        length: m; NaN where there is no plan.
        clearance: m, smallest distance that the verification saw; infinite if nothing came in sight.
        holds: whether the plan passes at the clearance for which it was made.
    """

    length: float
    clearance: float
    holds: bool


def outcome(name: str, clearance: float, seed: int) -> Outcome:
    """Plans an assembly greedily in the shipped workcell with another clearance, and verifies the plan with it."""
    assembly, workcell = load_assembly(data_path(f"{name}.json")), replace(load_workcell("panda"), clearance=clearance)
    made = plan(assembly, workcell, PlanningOptions(search="greedy", seed=seed))
    if not isinstance(made, Plan):
        return Outcome(float("nan"), float("nan"), False)
    report = verify_plan(made, assembly, workcell)
    near = report.smallest_clearance
    return Outcome(made.total_length, near.distance if near else float("inf"), report.passed)


def table(names: Sequence[str], outcomes: Sequence[Outcome]) -> str:
    """One row per assembly, one column per clearance; `outcomes` in the same order, assembly by assembly."""
    rows = []
    for i, name in enumerate(names):
        of_name = outcomes[i * len(CLEARANCES) : (i + 1) * len(CLEARANCES)]
        rows.append([name, *(_cell(found, of_name[0]) for found in of_name)])
    return markdown_table(["assembly", *(f"{1e3 * clearance:g} mm" for clearance in CLEARANCES)], rows)


def _cell(found: Outcome, without: Outcome) -> str:
    if not found.length > 0:
        return "no plan"
    more = "" if found is without else f" ({100 * (found.length / without.length - 1):+.1f} %)"
    return f"{found.length:.3f} m{more}" + ("" if found.holds else " REFUSED")


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns 4 if a plan is refused at its clearance, else 0."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--assemblies", nargs="+", default=list(ASSEMBLIES), metavar="KIND/NUMBER")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--document", type=Path, help="document whose table is replaced")
    given = parser.parse_args(arguments)
    cases = [(name, clearance, given.seed) for name in given.assemblies for clearance in CLEARANCES]
    outcomes: list[Outcome] = []
    with ProcessPoolExecutor(given.processes, get_context("spawn")) as pool:
        for (name, clearance, _), found in zip(cases, pool.map(outcome, *zip(*cases, strict=True)), strict=True):
            outcomes.append(found)
            seen = f"smallest seen {1e3 * found.clearance:.2f} mm, {'holds' if found.holds else 'REFUSED or no plan'}"
            print(f"{name} with {1e3 * clearance:g} mm: {found.length:.3f} m, {seen}", flush=True)
    print(table(given.assemblies, outcomes))
    if given.document is not None:
        replace_between_markers(given.document, MARKER, table(given.assemblies, outcomes))
    return 4 if any(found.length > 0 and not found.holds for found in outcomes) else 0


if __name__ == "__main__":
    sys.exit(main())
