"""Where the time of a removal query goes. ``python benchmarks/query_profile.py``.

The stages are wrapped by timers of processor time; what a stage calls counts for the callee alone.
"""

from __future__ import annotations

import argparse
import functools
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from speed import new_problem, random_edges
from takeapart.experiments.tables import markdown_table, replace_between_markers
from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.removal import goals, grasps, paths, planner, reach, situation
from takeapart.robot.ik import InverseKinematics
from takeapart.robot.loading import load_robot

# What is timed: where it is looked up, its name there, what to call it.
STAGES: tuple[tuple[Any, str, str], ...] = (
    (grasps, "grasp_candidates", "grasps of a part"),
    (reach, "hand_masks", "hands: what each grasp would hit"),
    (InverseKinematics, "_sampled", "inverse kinematics"),
    (InverseKinematics, "_within_limits", "inverse kinematics, near the limits"),
    (reach, "lift_ends", "lifts: their ends"),
    (reach, "complete_lifts", "lifts: between the ends"),
    (goals, "joint_distances", "goals: which are near"),
    (goals, "near_pairs", "goals: which are near"),
    (goals, "configuration_blockers", "goals: what the arm would hit"),
    (paths, "bends", "where a path may bend"),
    (situation, "one_leg", "one straight leg"),
    (paths, "two_legs", "two straight legs"),
    (paths, "rrt_connect", "trees"),
    (paths, "shorten", "shortening"),
    (planner, "resampled", "rows of the result"),
    (planner, "path_blockers", "blockers of the result"),
)


class StageTimes:
    """Processor time per stage, s, without that of the stages that it calls."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self.calls: Counter[str] = Counter()
        self._inner: list[float] = []

    def timed(self, function: Callable[..., Any], name: str) -> Callable[..., Any]:
        """The function with a timer around it."""

        @functools.wraps(function)
        def wrapped(*arguments: Any, **named: Any) -> Any:
            self._inner.append(0.0)
            started = time.thread_time()
            try:
                return function(*arguments, **named)
            finally:
                spent = time.thread_time() - started
                self.seconds[name] += spent - self._inner.pop()
                self.calls[name] += 1
                if self._inner:
                    self._inner[-1] += spent

        return wrapped


def profile(names: list[str], each: int, seed: int) -> tuple[StageTimes, int]:
    """Times of cold queries in random reachable states, and their number; changes the modules of the planner."""
    workcell = load_workcell("panda")
    robot = load_robot(workcell)
    problems = [new_problem(load_assembly(data_path(f"{name}.json")), workcell, robot) for name in names]
    for problem in problems:  # compile first
        part = problem.candidates(problem.root)[0]
        problem.planner.plan(part, problem.root, rng=np.random.default_rng(seed))
    times = StageTimes()
    for owner, attribute, name in STAGES:
        setattr(owner, attribute, times.timed(getattr(owner, attribute), name))
    rng = np.random.default_rng(seed)
    for problem in problems:
        plan = times.timed(problem.planner.plan, "everything else")
        for state, part in random_edges(problem, each, rng):
            problem.planner.forget_grasps()
            plan(part, state, rng=np.random.default_rng(int(rng.integers(1 << 62))))
    return times, each * len(problems)


def main() -> None:
    """Prints the table; with --document it replaces the one there."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--assemblies", nargs="+", default=["single/01", "single/06", "double/01", "double/03"])
    parser.add_argument("--each", type=int, default=40, help="queries for each")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--document", type=Path)
    arguments = parser.parse_args()
    times, queries = profile(arguments.assemblies, arguments.each, arguments.seed)
    total = sum(times.seconds.values())
    rows = [
        [name, f"{seconds / total:.1%}", f"{times.calls[name] / queries:.1f}"]
        for name, seconds in sorted(times.seconds.items(), key=lambda item: -item[1])
    ]
    text = f"{queries} cold queries of {', '.join(arguments.assemblies)}.\n\n"
    text += markdown_table(["stage", "share of processor time", "calls per query"], rows)
    print(text)
    if arguments.document:
        replace_between_markers(arguments.document, "profile", text)


if __name__ == "__main__":
    main()
