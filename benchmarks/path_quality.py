"""How near a first answer of the removal planner is to the best one. ``python benchmarks/path_quality.py``.

The first query of a removal is compared with the shortest of many more, planned again and again with other random
numbers until the seconds are over, or until it is as short as its candidate bound. Removals are those of random
reachable states of all shipped assemblies.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import islice
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from speed import new_problem, random_edges
from takeapart.experiments.tables import markdown_table, replace_between_markers
from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.problem import AssemblyProblem
from takeapart.removal.planner import RemovalPlanner
from takeapart.removal.result import Removal
from takeapart.robot.loading import load_robot
from takeapart.stability import ConnectorStability


@dataclass(frozen=True)
class Sample:
    """One removal.

    Args:
        first: length of the first answer, m.
        best: of the shortest of all answers, m.
        bound: the straight line of the best grasp candidate, m.
        attempts: how many answers there were.
    """

    first: float
    best: float
    bound: float
    attempts: int

    @property
    def ratio(self) -> float:
        """Length of the first answer to that of the shortest."""
        return self.first / self.best


def refined(name: str, count: int, seconds: float, seed: int) -> list[Sample]:
    """The first `count` random removals of a shipped assembly that the planner finds."""
    workcell = load_workcell("panda")
    planner = new_problem(load_assembly(data_path(f"{name}.json")), workcell, load_robot(workcell)).planner
    kind, _, number = name.partition("/")
    rng = np.random.default_rng([seed, int(number), kind == "double"])
    samples = []
    for state, part, first in islice(_removals(planner, rng), count):
        best, attempts = first, 1
        started = time.monotonic()
        while best > planner.candidate_bound(part) + 1e-4 and time.monotonic() - started < seconds:
            found = planner.plan(part, state, rng=rng)
            attempts += 1
            if isinstance(found, Removal):
                best = min(best, found.length)
        samples.append(Sample(first, best, planner.candidate_bound(part), attempts))
    return samples


def _removals(planner: RemovalPlanner, rng: np.random.Generator) -> Iterator[tuple[int, int, float]]:
    """State, part and length, m, of random removals, endless."""
    problem = AssemblyProblem(planner, ConnectorStability(planner.assembly), 0)
    while True:
        ((state, part),) = random_edges(problem, 1, rng)
        found = planner.plan(part, state, rng=rng)
        if isinstance(found, Removal):
            yield state, part, found.length


def table(samples: Sequence[Sample], seconds: float) -> str:
    """In Markdown."""
    ratios = np.array([each.ratio for each in samples])
    over = np.array([each.best / each.bound for each in samples])
    attempts = int(np.median([each.attempts for each in samples]))
    figures = [str(len(samples)), str(attempts)]
    figures += [f"{np.percentile(ratios, share):.4f}" for share in (50, 90)] + [f"{ratios.mean():.4f}"]
    figures += [f"{100 * np.mean(ratios <= 1.03):.0f} %", f"{np.median(over):.3f}"]
    header = ["removals", f"attempts in {seconds:g} s, median", "first to best, median", "p90", "mean"]
    return markdown_table([*header, "within 3 %", "best to candidate bound, median"], [figures])


def main() -> None:
    """Prints the table; with --document it replaces the one there."""
    shipped = [
        f"{kind}/{file.stem}" for kind in ("single", "double") for file in sorted(data_path(kind).glob("*.json"))
    ]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--assemblies", nargs="+", default=shipped, metavar="KIND/NUMBER")
    parser.add_argument("--each", type=int, default=5, help="removals of each assembly")
    parser.add_argument("--seconds", type=float, default=30.0, help="of planning again, for each removal")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--document", type=Path)
    arguments = parser.parse_args()
    job = partial(refined, count=arguments.each, seconds=arguments.seconds, seed=arguments.seed)
    samples: list[Sample] = []
    with ProcessPoolExecutor(arguments.processes, get_context("spawn")) as pool:
        for name, found in zip(arguments.assemblies, pool.map(job, arguments.assemblies), strict=True):
            samples += found
            print(f"{name}: first answer to the best " + ", ".join(f"{each.ratio:.3f}" for each in found), flush=True)
    text = table(samples, arguments.seconds)
    print(text)
    if arguments.document:
        replace_between_markers(arguments.document, "path quality", text)


if __name__ == "__main__":
    main()
