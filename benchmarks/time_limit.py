"""How far a search runs beyond its limit in seconds.

    python benchmarks/time_limit.py --document docs/benchmarks.md

Every search gets the limits on 137 loose blocks, where there are too many orders to enumerate, and on the largest
assemblies of the data sets. Kernels are compiled and loaded before. A search that ends by itself says nothing about its
limit; those are shown as such.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from takeapart.experiments.tables import markdown_table, replace_between_markers
from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.model.assembly import Assembly, Connector, Part
from takeapart.model.geometry import Box, OrientedBox, pose
from takeapart.planning import PlanningOptions, build_problem, search
from takeapart.search.registry import SEARCHES
from takeapart.search.result import Budget
from takeapart.workcell import Workcell

BLOCK = (0.08, 0.02, 0.02)  # m
PITCH = (0.09, 0.055)  # m, between the middles of blocks
RADIUS = 0.5  # m, from the base of the arm: blocks lie near this circle
FLOOR = 0.03  # m, height at which they lie


@dataclass(frozen=True)
class Measured:
    """One search with one limit.

    Args:
        limit: s.
        taken: wall time of the search, s.
        worked: its processor time, s.
        found: whether there was a plan.
    """

    limit: float
    taken: float
    worked: float
    found: bool


def loose_blocks(count: int, workcell: Workcell) -> Assembly:
    """Short bars that lie around the arm, each in a holder of its own on one plate; any may leave at any time."""
    base = workcell.T_world_base[:2, 3]
    places = np.stack(np.meshgrid(base[0] + PITCH[0] * np.arange(-4, 11), base[1] + PITCH[1] * np.arange(-12, 13)), -1)
    places = places.reshape(-1, 2)
    distances = np.linalg.norm(places - base, axis=1)
    nearest = places[np.argsort(np.abs(distances - RADIUS), kind="stable")][:count]
    parts = [Part("plate", Box((1.56, 1.38, 0.01)), pose([0.10, 0.20, 0.005]), 5.0, fixed=True)]
    connectors = []
    for k, (x, y) in enumerate(nearest.tolist()):
        parts.append(Part(f"block-{k}", Box(BLOCK), pose([x, y, FLOOR + BLOCK[2] / 2]), 0.1))
        x, y = x - 0.10, y - 0.20  # in the frame of the plate
        floor = OrientedBox(pose([x, y, FLOOR / 2]), np.array([0.028, 0.005, (FLOOR - 0.01) / 2]))
        connectors.append(Connector(f"holder-{k}", "U", "plate", f"block-{k}", (floor,)))
    return Assembly(f"loose-{count}", tuple(parts), tuple(connectors))


def measure(assembly: Assembly, workcell: Workcell, options: PlanningOptions) -> Measured:
    """One search on a problem of which nothing is known."""
    problem = build_problem(assembly, workcell, options)
    started, worked = time.perf_counter(), time.process_time()
    result = search(problem, options)
    taken, worked = time.perf_counter() - started, time.process_time() - worked
    return Measured(options.budget.seconds, taken, worked, bool(result.removals))


def rows_of(
    assemblies: Sequence[Assembly], searches: Sequence[str], limits: Sequence[float], workers: int
) -> list[list[str]]:
    """The rows of the table: per assembly and search the time beyond each limit."""
    workcell = load_workcell("panda")
    for small in (loose_blocks(4, workcell), load_assembly(data_path("single/01.json"))):  # loads kernels
        measure(small, workcell, PlanningOptions(search="exact", budget=Budget(queries=60)))
    rows = []
    for assembly in assemblies:
        for name in searches:
            cells = []
            for seconds in limits:
                chosen = SEARCHES[name].options()
                chosen = replace(chosen, workers=workers) if name == "exact" else chosen
                options = PlanningOptions(search=name, budget=Budget(seconds=seconds), search_options=chosen)
                made = measure(assembly, workcell, options)
                cells.append(_cell(made))
            rows.append([assembly.name, name, *cells])
            print(*rows[-1], sep=" | ", flush=True)
    return rows


def _cell(made: Measured) -> str:
    end = f"{made.taken - made.limit:+.2f}" if made.taken >= made.limit else f"ended at {made.taken:.2f}"
    return end if made.found else f"{end}, no plan"


def main() -> None:
    """Prints the table, and fills it into a document."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, nargs="+", default=[2.0, 5.0, 10.0])
    parser.add_argument("--searches", nargs="+", choices=SEARCHES, default=list(SEARCHES))
    parser.add_argument("--blocks", type=int, nargs="*", default=[137, 20], help="loose blocks of made-up assemblies")
    parser.add_argument("--sources", nargs="*", default=["single/01", "double/01"], help="assemblies of the data sets")
    parser.add_argument("--workers", type=int, default=1, help="threads of exact search")
    parser.add_argument("--document", type=Path, help="document with the markers 'time limit'")
    arguments = parser.parse_args()
    assemblies = [loose_blocks(count, load_workcell("panda")) for count in arguments.blocks]
    assemblies += [load_assembly(data_path(f"{source}.json")) for source in arguments.sources]
    rows = rows_of(assemblies, arguments.searches, arguments.seconds, arguments.workers)
    heads = ["assembly", "search", *(f"beyond {seconds:g} s" for seconds in arguments.seconds)]
    table = markdown_table(heads, rows)
    print(table)
    if arguments.document:
        load = ", ".join(f"{x:.1f}" for x in os.getloadavg())
        text = f"Seconds of wall time beyond the limit; {os.cpu_count()} cores, load {load}.\n\n{table}"
        replace_between_markers(arguments.document, "time limit", text)


if __name__ == "__main__":
    main()
