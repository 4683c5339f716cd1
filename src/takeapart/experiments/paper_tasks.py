"""The work behind Fig. 5 and Tables I and II (Sec. VII): replanning, searching, training, judging orders."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from takeapart.experiments.jobs import Outcome
from takeapart.formats.serialization import assembly_hash, workcell_hash
from takeapart.model.assembly import Assembly
from takeapart.model.errors import TakeapartError
from takeapart.planning import PlanningOptions, build_problem, search
from takeapart.problem import AssemblyProblem, Guide
from takeapart.removal.paths import RemovalOptions
from takeapart.removal.result import Effort, Removal
from takeapart.search.exact import ExactOptions, exact
from takeapart.search.mcts import MctsOptions, mcts
from takeapart.search.result import Budget, Progress, SearchResult
from takeapart.workcell import Workcell

GUIDE_FILE = "guide.safetensors"
ORDER_FILE = "order.txt"  # names of the parts of a search's shortest sequence, a line each
KEPT_OF_TRAINING = (".safetensors", ".csv", ".json", ".md")  # not its checkpoints
TRIED_SEEDS = 50  # random orders, until one is feasible


@dataclass(frozen=True, eq=False)
class ReplanningTask:
    """Fig. 5: path length and planning time of one order of removals, against how often each removal is planned.

    A repeat plans every removal of the order `replans` times in a row and looks at the best after each time, which is
    what a query with so many attempts does; so one repeat gives the values for all numbers of replans.

    Args:
        assembly, workcell: what is planned.
        seed: of all random choices.
        removal: how a removal is planned once.
        replans: a removal is planned at most so often.
        repeats: independent ones.
    """

    assembly: Assembly
    workcell: Workcell
    seed: int
    removal: RemovalOptions
    replans: int
    repeats: int

    @property
    def cost(self) -> float:
        """Removals planned."""
        return float(self.assembly.root.bit_count() * self.replans * self.repeats)

    def identity(self) -> Outcome:
        """Options and data."""
        return {
            **_data(self.assembly, self.workcell),
            "seed": self.seed,
            "removal": asdict(self.removal),
            "replans": self.replans,
            "repeats": self.repeats,
        }

    def run(self, needed: Mapping[str, Path], out: Path) -> Outcome:
        """Lengths, m (None where a removal was not found), seconds per part and motion plans per part: for every
        repeat one list, with a value for each number of replans.
        """
        problem = build_problem(self.assembly, self.workcell, PlanningOptions(removal=self.removal))
        edges = feasible_order(problem, self.seed)
        lengths, seconds, plans = [], [], []
        for repeat in range(self.repeats):
            total, spent, planned = np.zeros((3, self.replans))
            for place, (state, part) in enumerate(edges):
                rng = np.random.default_rng([self.seed, repeat, place])
                steps = replanned(problem, state, part, self.replans, rng)
                for column, (length, used, calls) in enumerate(steps):
                    total[column] += length
                    spent[column] += used
                    planned[column] += calls
            lengths.append([float(value) if math.isfinite(value) else None for value in total])
            seconds.append((spent / len(edges)).tolist())
            plans.append((planned / len(edges)).tolist())
        order = [self.assembly.parts[part].name for _, part in edges]
        return {"order": order, "lengths": lengths, "seconds_per_part": seconds, "motion_plans_per_part": plans}


def feasible_order(problem: AssemblyProblem, seed: int) -> list[tuple[int, int]]:
    """States and parts of a random order that can be executed.

    Raises:
        TakeapartError: none was found.
    """
    for turn in range(TRIED_SEEDS):
        result = search(problem, PlanningOptions(search="random", seed=seed + turn))
        if result.removals:
            edges, state = [], problem.root
            for removal in result.removals:
                edges.append((state, removal.part))
                state &= ~(1 << removal.part)
            return edges
    raise TakeapartError(f"{problem.assembly.name}: no feasible order in {TRIED_SEEDS} tries")


def replanned(
    problem: AssemblyProblem, state: int, part: int, replans: int, rng: np.random.Generator
) -> Iterator[tuple[float, float, int]]:
    """Plans a removal again and again: after each time the least length, m, and all seconds and motion plans so far.

    The same as `RemovalPlanner.plan` with as many attempts: later ones look for shorter paths only, and nothing is
    planned any more where nothing can be gained.
    """
    planner = problem.planner
    best, seconds, before = math.inf, 0.0, planner.counts.motion_plans
    good_enough = planner.candidate_bound(part) + planner.options.tolerance
    for _ in range(replans):
        if best > good_enough:
            started = time.perf_counter()
            found = planner.plan(part, state, rng=rng, shorter_than=best)
            seconds += time.perf_counter() - started
            if isinstance(found, Removal):
                best = found.length
        yield best, seconds, planner.counts.motion_plans - before


@dataclass(frozen=True, eq=False)
class SearchTask:
    """One row of Table I or II: a Monte Carlo tree search, vanilla or guided.

    Args:
        assembly, workcell: what is planned.
        seed: of all random choices.
        removal: how a removal is planned once.
        options: of the search.
        episodes, queries: its budget.
        record: whether experience is written, for training.
        guide: name of the job that trained the guide; None for the vanilla search.
    """

    assembly: Assembly
    workcell: Workcell
    seed: int
    removal: RemovalOptions
    options: MctsOptions
    episodes: int
    queries: float
    record: bool = False
    guide: str | None = None

    @property
    def cost(self) -> float:
        """Removals planned: per search step so many expansions and simulations, which are as long as parts are left."""
        parts = self.assembly.root.bit_count()
        per_episode = parts * self.options.search_budget * (parts / 2 + 0.6 * self.options.attempts)
        return min(per_episode * self.episodes, self.queries)

    def identity(self) -> Outcome:
        """Options and data."""
        return {
            **_data(self.assembly, self.workcell),
            "seed": self.seed,
            "removal": asdict(self.removal),
            "options": asdict(self.options),
            "episodes": self.episodes,
            "queries": self.queries if math.isfinite(self.queries) else None,
            "record": self.record,
            "guided": self.guide is not None,
        }

    def run(self, needed: Mapping[str, Path], out: Path) -> Outcome:
        """Statistics of the search; its trace: rows of episode, removal queries, motion plans, best length so far, m;
        and the processor time, s, that the guide took.
        """
        problem = build_problem(self.assembly, self.workcell, PlanningOptions(seed=self.seed, removal=self.removal))
        guide = None
        if self.guide is not None:
            guide = TimedGuide(self.assembly, needed[self.guide] / GUIDE_FILE)
        trace: list[list[float]] = []

        def listen(progress: Progress) -> None:
            if math.isfinite(progress.length):
                counts = problem.counts
                trace.append([progress.episode, counts.removal_queries, counts.motion_plans, progress.length])

        with ExitStack() as stack:
            observe = None
            if self.record:
                from takeapart.guide.experience import ExperienceWriter

                writer = ExperienceWriter(out, self.assembly, seed=self.seed, search="mcts")
                observe = stack.enter_context(writer).observe
            started = time.process_time()
            result = mcts(
                problem,
                self.options,
                Budget(episodes=self.episodes, queries=self.queries),
                np.random.default_rng([self.seed, 1]),
                guide,
                listen,
                observe,
            )
            seconds = time.process_time() - started
        _write_order(out, self.assembly, result)
        return {
            "parts": self.assembly.root.bit_count(),
            "statistics": result.statistics,
            "trace": trace,
            "removal_queries": problem.counts.removal_queries,
            "motion_plans": problem.counts.motion_plans,
            "search_seconds": seconds,
            "guide_seconds": guide.seconds if guide is not None else 0.0,
        }


class TimedGuide:
    """A guide that knows how much processor time it took, s."""

    def __init__(self, assembly: Assembly, weights: Path) -> None:
        from takeapart.guide.policy import load_guide

        self._guide: Guide = load_guide(weights, assembly)
        self.seconds = 0.0

    def __call__(self, states: Sequence[int]) -> Sequence[Mapping[int, float]]:
        started = time.process_time()
        values = self._guide(states)
        self.seconds += time.process_time() - started
        return values


@dataclass(frozen=True, eq=False)
class TrainingTask:
    """A guide from the experience of other jobs.

    Args:
        options: of `guide.training.TrainingOptions` that differ from their defaults.
        expected: removals planned in all the experience, roughly.
    """

    options: Mapping[str, Any]
    expected: float

    @property
    def cost(self) -> float:
        """Of the order of the experience."""
        return self.expected

    def identity(self) -> Outcome:
        """Options; the experience is in the keys of the jobs that wrote it."""
        return {"options": dict(self.options)}

    def run(self, needed: Mapping[str, Path], out: Path) -> Outcome:
        """Rows and hash of the experience; steps made; regret and error, m, on the states held out."""
        from takeapart.guide.experience import read_experience
        from takeapart.guide.training import TrainingOptions, train

        experience = read_experience(list(needed.values()))
        trained = train(experience, TrainingOptions(**self.options), out / GUIDE_FILE)
        for path in [path for path in out.rglob("*") if path.is_file() and path.suffix not in KEPT_OF_TRAINING]:
            path.unlink()
        return {
            "rows": len(experience.table),
            "hash": experience.hash,
            "weights": trained.hash,
            "steps": trained.steps,
            "best_step": trained.best_step,
            "regret": trained.regret,
            "random_regret": trained.random_regret,
            "error": trained.error,
        }


@dataclass(frozen=True, eq=False)
class ReferenceTask:
    """What the exact search finds with the library: how much shorter any order could be.

    Args:
        queries: its budget.
    """

    assembly: Assembly
    workcell: Workcell
    seed: int
    queries: int

    @property
    def cost(self) -> float:
        """Removal queries."""
        return float(self.queries)

    def identity(self) -> Outcome:
        """Options and data."""
        return {**_data(self.assembly, self.workcell), "seed": self.seed, "queries": self.queries}

    def run(self, needed: Mapping[str, Path], out: Path) -> Outcome:
        """Length and bounds, m; what was spent. A length of None: no order was found."""
        problem = build_problem(self.assembly, self.workcell, PlanningOptions(seed=self.seed))
        result = exact(problem, ExactOptions(), Budget(queries=self.queries))
        _write_order(out, self.assembly, result)
        straight = problem.planner.straight_line_total(result.removals)
        return {
            "length": result.length if math.isfinite(result.length) else None,
            "sequence_bound": result.sequence_bound,
            "straight_line_bound": straight if result.removals else None,
            "removal_queries": problem.counts.removal_queries,
            "motion_plans": problem.counts.motion_plans,
        }


@dataclass(frozen=True, eq=False)
class OrdersTask:
    """The orders that searches found, judged without the luck of single paths.

    Every removal of an order is planned again with all of the planner's effort; all orders share one removal library,
    so what they have in common costs the same in each.

    Args:
        attempts: how often each removal is planned.
    """

    assembly: Assembly
    workcell: Workcell
    seed: int
    attempts: int

    @property
    def cost(self) -> float:
        """Removals planned, in a few orders."""
        return 3.0 * self.assembly.root.bit_count() * self.attempts

    def identity(self) -> Outcome:
        """Options and data; the orders are in the keys of the jobs that found them."""
        return {**_data(self.assembly, self.workcell), "seed": self.seed, "attempts": self.attempts}

    def run(self, needed: Mapping[str, Path], out: Path) -> Outcome:
        """Length of every order, m, by the name of the job that found it; None where there is none. "random" is one
        that the arm can follow, whatever its length.
        """
        problem = build_problem(self.assembly, self.workcell, PlanningOptions(seed=self.seed))
        numbers = {part.name: number for number, part in enumerate(self.assembly.parts)}
        orders = {"random": [part for _, part in feasible_order(problem, self.seed)]}
        for name, folder in needed.items():
            orders[name] = [numbers[line] for line in (folder / ORDER_FILE).read_text(encoding="utf-8").splitlines()]
        lengths = {}
        for turn in (0, 1):  # the second time with all that the first has found
            for name, order in orders.items():
                lengths[name] = self._length(problem, order, 1 if turn else self.attempts)
        return {"lengths": {name: length if math.isfinite(length) else None for name, length in lengths.items()}}

    def _length(self, problem: AssemblyProblem, order: Sequence[int], attempts: int) -> float:
        total, state = 0.0, problem.root
        for part in order:
            found = problem.remove(state, part, Effort(attempts))
            total += found.length if isinstance(found, Removal) else math.inf
            state &= ~(1 << part)
        return total if order else math.inf


def _write_order(out: Path, assembly: Assembly, result: SearchResult) -> None:
    lines = [f"{assembly.parts[removal.part].name}\n" for removal in result.removals]
    (out / ORDER_FILE).write_text("".join(lines), encoding="utf-8")


def _data(assembly: Assembly, workcell: Workcell) -> Outcome:
    return {"assembly": assembly_hash(assembly), "workcell": workcell_hash(workcell)}
