"""How fast the geometry is: removal queries, random orders, MCTS, configuration checks (``make bench``).

All figures are wall times of one thread. Kernels are compiled before anything is measured.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import time
import timeit
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from takeapart.compilation import compiled
from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.generate.profiles import ProfileOptions, generate
from takeapart.model.assembly import Assembly
from takeapart.model.plan import Plan
from takeapart.planning import PlanningOptions, plan_of, search
from takeapart.problem import AssemblyProblem
from takeapart.removal.planner import RemovalPlanner
from takeapart.removal.result import Effort, Removal
from takeapart.robot.arrays import ArmArrays, Flags, Floats, HeldArrays, Workspace, WorldArrays
from takeapart.robot.kernels import FREE, check
from takeapart.robot.loading import load_robot
from takeapart.robot.model import RobotModel
from takeapart.search.result import Budget
from takeapart.stability import ConnectorStability
from takeapart.workcell import Workcell

FRESH_SEED = 7000  # the generator's, of the first assembly that is not shipped

Row = tuple[str, str, str]
"""What was measured, the figure, and what it should be."""


def new_problem(assembly: Assembly, workcell: Workcell, robot: RobotModel, seed: int = 0) -> AssemblyProblem:
    """A decision process with an empty library; goal configurations are solved, grasps are not."""
    planner = RemovalPlanner(assembly, workcell, robot=robot)
    for width in {
        candidate.width for part in range(len(assembly.parts)) for candidate in planner.reach.candidates(part)
    }:
        planner.goals.all(robot.workspace(), width)
    return AssemblyProblem(planner, ConnectorStability(assembly), seed)


def random_edges(problem: AssemblyProblem, count: int, rng: np.random.Generator) -> list[tuple[int, int]]:
    """Edges (state, part) on random orders that gravity and lifting allow, whatever the arm can do."""
    edges: list[tuple[int, int]] = []
    while len(edges) < count:
        state = problem.root
        visited = []
        while state:
            part = int(rng.choice(problem.candidates(state)))
            visited.append((state, part))
            state &= ~(1 << part)
        edges.append(visited[int(rng.integers(len(visited)))])
    return edges


def fresh_assemblies(count: int, workcell: Workcell, robot: RobotModel) -> list[Assembly]:
    """Single-layer assemblies that have an order, from seeds of which none is shipped."""

    def order(assembly: Assembly) -> tuple[str, ...] | str:
        result = search(new_problem(assembly, workcell, robot), PlanningOptions(search="random"))
        names = tuple(assembly.parts[removal.part].name for removal in result.removals)
        return names or "no order found"

    seeds = range(FRESH_SEED, FRESH_SEED + count)
    return [generate(ProfileOptions(), seed, order, f"fresh-{seed}").assembly for seed in seeds]


def measure_cold_queries(
    problems: Sequence[AssemblyProblem], each: int, rng: np.random.Generator
) -> tuple[list[float], list[float]]:
    """Seconds of removal queries with nothing known, no library, no grasp solved: of those that found a path, and of
    those that were refused."""
    found: list[float] = []
    refused: list[float] = []
    for problem in problems:
        planner = problem.planner
        for state, part in random_edges(problem, each, rng):
            planner.forget_grasps()
            query = np.random.default_rng(int(rng.integers(1 << 62)))
            started = time.perf_counter()
            answer = planner.plan(part, state, rng=query)
            taken = time.perf_counter() - started
            (found if isinstance(answer, Removal) else refused).append(taken)
    return found, refused


def measure_hits(problem: AssemblyProblem, rng: np.random.Generator) -> list[float]:
    """Seconds of removal queries that the library answers."""
    seconds = []
    for state, part in random_edges(problem, 20, rng):
        if isinstance(problem.remove(state, part, Effort()), Removal):
            for _ in range(50):
                started = time.perf_counter()
                problem.remove(state, part, Effort())
                seconds.append(time.perf_counter() - started)
    return seconds


def measure_orders(
    assemblies: Sequence[Assembly], workcell: Workcell, robot: RobotModel, options: PlanningOptions
) -> tuple[list[float], list[float]]:
    """Seconds and plan lengths, m, of a search on each assembly, library empty at the start."""
    seconds, lengths = [], []
    for assembly in assemblies:
        problem = new_problem(assembly, workcell, robot, options.seed)
        started = time.perf_counter()
        result = search(problem, options)
        seconds.append(time.perf_counter() - started)
        found = plan_of(problem, result, options, seconds[-1])
        if isinstance(found, Plan):
            lengths.append(found.total_length)
    return seconds, lengths


@compiled
def count_free(
    arm: ArmArrays, held: HeldArrays, world: WorldArrays, present: Flags, padding: float, qs: Floats, work: Workspace
) -> int:
    """How many of the configurations (K, n) are free."""
    free = 0
    for q in qs:
        free += check(arm, held, world, present, padding, q, work) == FREE
    return free


def measure_checks(problem: AssemblyProblem, rng: np.random.Generator) -> tuple[float, float, int]:
    """Seconds of one check of a free random configuration with a held bar, in compiled code and called from Python,
    and the number of boxes that stand around.
    """
    planner = problem.planner
    work = planner.robot.workspace()
    arm, world = planner.robot.arm, planner.world
    held = planner.reach.hands(problem.candidates(problem.root)[0], work)[0].held
    present = np.ones(len(problem.assembly.parts) + 1, dtype=np.uint8)
    drawn = rng.uniform(arm.lower, arm.upper, (20_000, len(arm.lower)))
    free = np.array([q for q in drawn if check(arm, held, world, present, 0.001, q, work) == FREE])

    def called() -> None:
        for q in free:
            check(arm, held, world, present, 0.001, q, work)

    count_free(arm, held, world, present, 0.001, free, work)  # compile first
    inside = min(timeit.repeat(lambda: count_free(arm, held, world, present, 0.001, free, work), number=1))
    outside = min(timeit.repeat(called, number=1))
    return inside / len(free), outside / len(free), len(world.half)


def report(count: int, seed: int) -> list[Row]:
    """All measurements on the first `count` single-layer assemblies, as many fresh ones, and up to seven double-layer
    ones."""
    rng = np.random.default_rng(seed)
    workcell = load_workcell("panda")
    robot = load_robot(workcell)
    single = [load_assembly(data_path(f"single/{k:02d}.json")) for k in range(1, 15)][:count]
    double = [load_assembly(data_path(f"double/{k:02d}.json")) for k in range(1, 8)][:count]
    compile_all = new_problem(single[0], workcell, robot)
    search(compile_all, PlanningOptions(search="random"))

    rows: list[Row] = []
    fresh = fresh_assemblies(count, workcell, robot)
    for name, assemblies in (("single", single), ("double", double), ("single, fresh", fresh)):
        problems = [new_problem(assembly, workcell, robot) for assembly in assemblies]
        found, refused = measure_cold_queries(problems, min(40 * count, 560) // len(problems), rng)
        both = found + refused
        rows.append((f"removal query, cold, `{name}`", _spread(both, 1e3, "ms"), "median <= 10 ms, p95 <= 100 ms"))
        rows.append((f"... found, {len(found)} of {len(both)}", _spread(found, 1e3, "ms"), ""))
        rows.append((f"... refused, {len(refused)} of {len(both)}", _spread(refused, 1e3, "ms"), ""))
    hits = measure_hits(new_problem(single[0], workcell, robot), rng)
    rows.append(("removal query, from the library", _spread(hits, 1e6, "us"), "<= 10 us"))
    for name, assemblies in (("single", single), ("double", double)):
        seconds, lengths = measure_orders(assemblies, workcell, robot, PlanningOptions(search="random", seed=seed))
        target = "median <= 2 s" if name == "single" else ""
        rows.append((f"random order, `{name}`, library empty", _spread(seconds, 1, "s"), target))
        paper = "14 to 20 m (paper: 14.3 to 19.2)" if name == "single" else "(paper: 26.7 to 31.7)"
        rows.append((f"length of random orders, `{name}`", _spread(lengths, 1, "m"), paper))
    options = PlanningOptions(search="mcts", seed=seed, budget=Budget(episodes=20))
    seconds, lengths = measure_orders(single, workcell, robot, options)
    rows.append(("MCTS, 20 episodes, library memory, `single`", _spread(seconds, 1, "s"), "<= 60 s"))
    rows.append(("length found by MCTS, `single`", _spread(lengths, 1, "m"), ""))
    inside, outside, boxes = measure_checks(compile_all, rng)
    what = f"configuration check, held bar, {boxes} boxes, free random configurations"
    rows.append((what, f"{1e-6 / inside:.2f} million/s", ">= 1 million/s (60 boxes)"))
    rows.append(("the same called from Python, one by one", f"{1e6 * outside:.1f} us", ""))
    return rows


def _spread(values: Sequence[float], factor: float, unit: str) -> str:
    if not values:
        return "none"
    scaled = sorted(factor * value for value in values)
    p95 = scaled[min(len(scaled) - 1, int(0.95 * len(scaled)))]
    ends = f"{scaled[0]:.3g} to {scaled[-1]:.3g} {unit}"
    return f"median {statistics.median(scaled):.3g} {unit}, p95 {p95:.3g} {unit}, {ends}"


def as_markdown(rows: Sequence[Row]) -> str:
    """A table, with the machine and its load above."""
    load = ", ".join(f"{x:.1f}" for x in os.getloadavg())
    lines = [f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, load {load}.", ""]
    lines += ["| what | measured | must reach |", "|---|---|---|"]
    return "\n".join(lines + [f"| {what} | {figure} | {target} |" for what, figure, target in rows]) + "\n"


def main() -> None:
    """Prints the table; with --write it replaces the one in a document."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=14, help="assemblies of each data set")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--write", type=Path, help="document with the lines <!-- speed --> and <!-- /speed -->")
    arguments = parser.parse_args()
    table = as_markdown(report(arguments.count, arguments.seed))
    print(table)
    if arguments.write:
        text = arguments.write.read_text()
        before, _, rest = text.partition("<!-- speed -->\n")
        _, _, after = rest.partition("<!-- /speed -->")
        arguments.write.write_text(f"{before}<!-- speed -->\n{table}<!-- /speed -->{after}")


if __name__ == "__main__":
    main()
