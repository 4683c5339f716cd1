"""Removal queries of several arms side by side. ``python benchmarks/arm_speed.py --workcells panda ur5e``.

Every arm is asked the same queries on the same assemblies, in turn, with nothing known before: no library, no grasp, no
lift. Only goal configurations are solved before. Times are processor times of one thread: what else the machine does
counts less than in wall times.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from speed import fresh_assemblies, new_problem, random_edges
from takeapart.experiments.tables import markdown_table
from takeapart.formats.files import load_workcell
from takeapart.model.assembly import Assembly
from takeapart.problem import AssemblyProblem
from takeapart.removal.result import Removal
from takeapart.robot.loading import load_robot
from takeapart.workcell import Workcell


@dataclass
class Queries:
    """What one arm answered.

    Args:
        found, refused: processor seconds of its queries.
        lengths: of the removals found, m.
    """

    found: list[float] = field(default_factory=list)
    refused: list[float] = field(default_factory=list)
    lengths: list[float] = field(default_factory=list)


def measure_arms(
    workcells: Sequence[Workcell], assemblies: Sequence[Assembly], each: int, rng: np.random.Generator
) -> list[Queries]:
    """Queries of every arm, in the order of the workcells.

    Args:
        each: queries on one assembly; the same for all arms.
    """
    robots = [load_robot(workcell) for workcell in workcells]
    measured = [Queries() for _ in workcells]
    for assembly in assemblies:
        problems = [new_problem(assembly, *pair) for pair in zip(workcells, robots, strict=True)]
        for state, part in random_edges(problems[0], each, rng):
            seed = int(rng.integers(1 << 62))
            for problem, queries in zip(problems, measured, strict=True):
                _ask(problem, state, part, seed, queries)
    return measured


def _ask(problem: AssemblyProblem, state: int, part: int, seed: int, queries: Queries) -> None:
    problem.planner.forget_grasps()
    rng = np.random.default_rng(seed)
    started = time.process_time()
    answer = problem.planner.plan(part, state, rng=rng)
    taken = time.process_time() - started
    if isinstance(answer, Removal):
        queries.found.append(taken)
        queries.lengths.append(answer.length)
    else:
        queries.refused.append(taken)


def main() -> None:
    """Prints a table with one line for every arm."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--workcells", nargs="+", default=["panda"], help="names or files; by the first assemblies are drawn"
    )
    parser.add_argument("--assemblies", type=int, default=4)
    parser.add_argument("--queries", type=int, default=15, help="on each assembly")
    arguments = parser.parse_args()
    workcells = [load_workcell(name) for name in arguments.workcells]
    assemblies = fresh_assemblies(arguments.assemblies, workcells[0], load_robot(workcells[0]))
    measured = measure_arms(workcells, assemblies, arguments.queries, np.random.default_rng(0))
    rows = [
        (
            workcell.description.name,
            f"{len(workcell.home)}",
            f"{len(queries.found)} of {len(queries.found) + len(queries.refused)}",
            f"{1e3 * statistics.median(queries.found):.1f}" if queries.found else "",
            f"{1e3 * statistics.mean(queries.found):.1f}" if queries.found else "",
            f"{1e3 * statistics.median(queries.refused):.1f}" if queries.refused else "",
            f"{statistics.mean(queries.lengths):.3f}" if queries.found else "",
        )
        for workcell, queries in zip(workcells, measured, strict=True)
    ]
    heads = ("arm", "joints", "found", "median, ms", "mean, ms", "refused, median, ms", "mean length, m")
    print(markdown_table(heads, rows))


if __name__ == "__main__":
    main()
