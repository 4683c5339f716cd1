"""Exact search to the end on the shipped assemblies. ``python benchmarks/closing.py``.

Every assembly starts with an empty library; seconds and queries include the refinement after the first proof.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from speed import new_problem
from takeapart.experiments.tables import markdown_table, replace_between_markers
from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.robot.loading import load_robot
from takeapart.robot.model import RobotModel
from takeapart.search.exact import ExactOptions, exact
from takeapart.search.result import Budget
from takeapart.workcell import Workcell


@dataclass(frozen=True)
class Closing:
    """One assembly.

    Args:
        seconds, queries: of the whole search.
        length, sequence_bound, straight_line_bound: m.
    """

    seconds: float
    queries: int
    length: float
    sequence_bound: float
    straight_line_bound: float

    @property
    def closed(self) -> bool:
        """Whether the sequence gap is 0."""
        return self.length <= self.sequence_bound + 1e-9


def close(name: str, workcell: Workcell, robot: RobotModel, seed: int = 0) -> Closing:
    """Exact search with its default options, without any budget."""
    problem = new_problem(load_assembly(data_path(f"{name}.json")), workcell, robot, seed)
    started = time.perf_counter()
    found = exact(problem, ExactOptions(), Budget())
    seconds = time.perf_counter() - started
    straight = problem.planner.straight_line_total(found.removals)
    bound = -math.inf if found.sequence_bound is None else found.sequence_bound
    return Closing(seconds, problem.counts.removal_queries, found.length, bound, straight)


def row(kind: str, found: Sequence[Closing]) -> list[str]:
    """A line of the table."""
    seconds, queries = [each.seconds for each in found], [each.queries for each in found]
    proved = np.array([each.length / each.straight_line_bound - 1 for each in found])
    return [
        f"`{kind}`",
        f"{sum(each.closed for each in found)} of {len(found)}",
        f"{np.median(seconds):.1f}, {min(seconds):.1f} to {max(seconds):.1f}",
        f"{np.median(queries):.0f}, {min(queries)} to {max(queries)}",
        f"{np.mean([each.length for each in found]):.2f} m",
        f"{100 * np.median(proved):.1f} %",
    ]


def main() -> None:
    """Prints the table; with --document it replaces the one there."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, help="assemblies of each data set; all by default")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--document", type=Path)
    arguments = parser.parse_args()
    workcell = load_workcell("panda")
    robot = load_robot(workcell)
    close("single/01", workcell, robot)  # compile first
    rows = []
    for kind in ("single", "double"):
        names = [f"{kind}/{file.stem}" for file in sorted(data_path(kind).glob("*.json"))]
        names = names[: arguments.count]
        rows.append(row(kind, [close(name, workcell, robot, arguments.seed) for name in names]))
    header = ["set", "sequence gap 0", "seconds: median, range", "removal queries: median, range", "length, mean"]
    text = markdown_table([*header, "proved gap, median"], rows)
    print(text)
    if arguments.document:
        replace_between_markers(arguments.document, "closing", text)


if __name__ == "__main__":
    main()
