"""How planning grows with the number of parts: from 21 to more than 100, by one command.

Assemblies of one and of two layers, and up to four of these around the robot (`takeapart.generate.cells`), each planned
by exact search within a budget of seconds; where there are too many states to enumerate, that is best-first search. A
case that was finished is not run again: results are kept, one JSON file each, and the table is made of what is there.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from takeapart.experiments.tables import markdown_table, replace_between_markers
from takeapart.formats.documents import readable_json, write_atomically
from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.generate.cells import cells_around
from takeapart.model.assembly import Assembly
from takeapart.model.errors import InputError
from takeapart.planning import PlanningOptions, build_problem, search
from takeapart.search.result import Budget, Progress
from takeapart.workcell import Workcell

NOT_FOUND = "-"


@dataclass(frozen=True)
class Case:
    """What is planned.

    Args:
        sources: names of shipped assemblies, one for each cell.
        workcell: name of a shipped workcell.
    """

    sources: tuple[str, ...]
    workcell: str

    @property
    def name(self) -> str:
        """Name of the result's file."""
        return "+".join(source.replace("/", "-") for source in self.sources)

    def assembly(self, workcell: Workcell) -> Assembly:
        """The product."""
        found = [load_assembly(data_path(f"{source}.json")) for source in self.sources]
        return found[0] if len(found) == 1 else cells_around(found, workcell.T_world_base, self.name)


CASES = (
    Case(("single/01",), "panda"),
    Case(("double/01",), "panda"),
    Case(("single/01", "single/02"), "panda-cells"),
    Case(("single/01", "single/02", "single/03"), "panda-cells"),
    Case(("single/01", "single/02", "single/03", "single/04"), "panda-cells"),
    Case(("double/01", "double/02", "double/03", "single/01"), "panda-cells"),
    Case(("double/01", "double/02", "double/03", "double/04"), "panda-cells"),
)


@dataclass(frozen=True)
class Outcome:
    """One case.

    Args:
        states: of the lattice; 0 where they were not enumerated.
        first_plan: seconds until there was a plan; none if there never was.
        seconds: of the whole search, building included.
        length: of the best plan, m; none if there is no plan.
        bound: sequence bound, m; none if there is none.
    """

    case: str
    parts: int
    states: int
    queries: int
    motion_plans: int
    first_plan: float | None
    seconds: float
    length: float | None
    bound: float | None


def run(case: Case, seconds: float, seed: int) -> Outcome:
    """Plans one case."""
    workcell = load_workcell(case.workcell)
    assembly = case.assembly(workcell)
    options = PlanningOptions(seed=seed, budget=Budget(seconds=seconds))
    started, first = time.monotonic(), math.inf

    def listen(progress: Progress) -> None:
        nonlocal first
        if math.isfinite(progress.length):
            first = min(first, time.monotonic() - started)

    problem = build_problem(assembly, workcell, options)
    result = search(problem, options, listen=listen)
    return Outcome(
        case.name,
        assembly.root.bit_count(),
        int(result.statistics.get("states", 0)),
        problem.counts.removal_queries,
        problem.counts.motion_plans,
        _finite(first),
        time.monotonic() - started,
        _finite(result.length),
        result.sequence_bound,
    )


def _finite(value: float) -> float | None:
    """What a file of results can hold."""
    return value if math.isfinite(value) else None


def table(outcomes: Sequence[Outcome]) -> str:
    """In Markdown, by the number of parts."""
    header = ["parts", "cells", "states", "queries", "motion plans", "first plan, s", "all, s", "length, m", "bound, m"]
    rows = []
    for each in sorted(outcomes, key=lambda each: each.parts):
        length = NOT_FOUND if each.length is None else f"{each.length:.2f}"
        bound = NOT_FOUND if each.bound is None else f"{each.bound:.2f}"
        gap = f"{100 * (each.length / each.bound - 1):.1f} %" if each.length and each.bound else NOT_FOUND
        rows.append(
            [
                each.parts,
                each.case,
                each.states or "too many",
                each.queries,
                each.motion_plans,
                NOT_FOUND if each.first_plan is None else f"{each.first_plan:.0f}",
                f"{each.seconds:.0f}",
                length,
                bound,
                gap,
            ]
        )
    return markdown_table([*header, "gap"], rows)


def load(file: Path) -> Outcome:
    """A result that was kept."""
    return Outcome(**json.loads(file.read_text(encoding="utf-8")))


def main() -> None:
    """Runs what is missing and prints the table; with --document it replaces the one there."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="budget of every case")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--parts", type=int, default=1000, help="largest number of parts to run")
    parser.add_argument("--out", type=Path, default=Path("out/growth"), help="folder of the results")
    parser.add_argument("--document", type=Path, help="document with the markers of `growth`")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    outcomes = []
    for case in CASES:
        file = arguments.out / f"{case.name}.json"
        workcell = load_workcell(case.workcell)
        if not file.exists() and case.assembly(workcell).root.bit_count() <= arguments.parts:
            print(f"planning {case.name} ...", flush=True)
            outcome = run(case, arguments.seconds, arguments.seed)
            write_atomically(file, readable_json(asdict(outcome)))
        if file.exists():
            outcomes.append(load(file))
    if not outcomes:
        raise InputError("no case is small enough", "--parts")
    load_average = ", ".join(f"{x:.1f}" for x in os.getloadavg())
    text = f"{os.cpu_count()} cores, load {load_average} at the end.\n\n{table(outcomes)}"
    print(text)
    if arguments.document:
        replace_between_markers(arguments.document, "growth", text)


if __name__ == "__main__":
    main()
