"""A limit in seconds that ends within a query: what was cut off is no answer, and nothing of it stays.

The clock of these tests runs out after a number of readings, so that every place at which it is read is reached.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from order_search_cases import MaskedProblem, check_sequence
from small_assemblies import three_bars
from synthetic import members, random_problem
from takeapart.formats.serialization import plan_document
from takeapart.model.plan import Plan
from takeapart.planning import PlanningOptions, plan_of, search
from takeapart.problem import AssemblyProblem
from takeapart.removal.bounds import EdgeBounds
from takeapart.removal.journal import RecordedAnswer, RemovalQuery
from takeapart.removal.planner import RemovalOptions, RemovalPlanner
from takeapart.removal.result import Blocked, Counts, Effort, OutOfTimeError, Removal
from takeapart.search.beam import BeamOptions, beam
from takeapart.search.best_first import BestFirstOptions, best_first
from takeapart.search.exact import ExactOptions, exact
from takeapart.search.lattice import Lattice, TooLarge, enumerate_states
from takeapart.search.mcts import MctsOptions, mcts
from takeapart.search.result import Budget, SearchResult
from takeapart.search.session import Clock
from takeapart.search.simple_orders import OrderOptions, greedy, random_order
from takeapart.stability import ConnectorStability
from verification_scene import scene_workcell

LOOKS = 4  # at the clock, in a query of a made-up problem


def running_out(readings: int) -> Callable[..., bool]:
    """Says that it is late after so many readings, and from then on."""
    count = itertools.count(1)
    return lambda *_: next(count) > readings


class MemoryJournal:
    """Keeps answers as a run does."""

    def __init__(self) -> None:
        self.answers: dict[RemovalQuery, RecordedAnswer] = {}

    def recall(self, query: RemovalQuery) -> RecordedAnswer | None:
        return self.answers.get(query)

    def record(self, query: RemovalQuery, recorded: RecordedAnswer) -> None:
        assert query not in self.answers
        self.answers[query] = recorded


@pytest.fixture(scope="module")
def bars() -> RemovalPlanner:
    return RemovalPlanner(three_bars(), scene_workcell())


def new_problem(planner: RemovalPlanner, journal: MemoryJournal | None = None) -> AssemblyProblem:
    planner.counts = Counts()
    return AssemblyProblem(planner, ConnectorStability(planner.assembly), journal=journal)


def same(a: Removal | Blocked, b: Removal | Blocked) -> bool:
    if isinstance(a, Removal) and isinstance(b, Removal):
        return a.joint_path.tobytes() == b.joint_path.tobytes() and (a.length, a.blockers) == (b.length, b.blockers)
    return a == b


def check_valid(problem: AssemblyProblem, result: SearchResult) -> None:
    state = problem.root
    for removal in result.removals:
        assert removal.part in problem.candidates(state) and removal.valid_in(state)
        state &= ~(1 << removal.part)
    assert state == 0


def facts(problem: AssemblyProblem) -> list[object]:
    """All that was counted and learned."""
    bounds, parts = problem.edge_bounds, members(problem.root)
    return [
        (problem.counts.removal_queries, problem.counts.motion_plans),
        [(r.length, r.blockers, r.joint_path.tobytes()) for part in parts for r in bounds.removals(part)],
        [(edge.state, edge.refusal) for part in parts for edge in bounds.closed_edges(part)],
    ]


@pytest.mark.parametrize("straight", [True, False], ids=["straight", "trees"])
def test_a_query_that_is_cut_leaves_nothing(straight: bool) -> None:
    options = RemovalOptions() if straight else RemovalOptions(straight_attempts=0, bend_attempts=0, tree_paths=2)
    planner = RemovalPlanner(three_bars(), scene_workcell(), options)
    root, effort = planner.assembly.root, Effort(2)
    part = new_problem(planner).candidates(root)[-1]
    whole = new_problem(planner, MemoryJournal())
    assert isinstance(whole.remove(root, part, effort), Removal)
    for readings in itertools.count():
        planner.forget_grasps()  # so that the clock is read wherever it can be
        journal = MemoryJournal()
        problem = new_problem(planner, journal)
        before = facts(problem)
        try:
            problem.remove(root, part, replace(effort, is_late=running_out(readings)))
            assert facts(problem) == facts(whole)
            break
        except OutOfTimeError:
            assert facts(problem) == before and not journal.answers
        if readings % 5 == 0:
            problem.remove(root, part, effort)
            assert facts(problem) == facts(whole), "asked again, it is as if it had not been cut"
    assert readings >= (4 if straight else 8)


def test_a_refusal_that_is_cut_is_none() -> None:
    """Grasps that the clock takes away are no reason to say that a part cannot leave."""
    poor = RemovalOptions(straight_attempts=0, bend_attempts=0, tree_paths=0)
    planner = RemovalPlanner(three_bars(), scene_workcell(), poor)
    root = planner.assembly.root
    part = new_problem(planner).candidates(root)[0]
    whole = new_problem(planner).remove(root, part, Effort(2))
    assert isinstance(whole, Blocked) and whole.stage == "path"
    for readings in itertools.count():
        planner.forget_grasps()
        problem = new_problem(planner)
        try:
            assert problem.remove(root, part, Effort(2, is_late=running_out(readings))) == whole
            break
        except OutOfTimeError:
            assert facts(problem)[0] == (0, 0) and not problem.edge_bounds.closed_edges(part)
    assert readings >= 4


@pytest.mark.parametrize("name", ["exact", "mcts", "beam", "greedy", "random"])
def test_a_run_that_was_cut_goes_on_to_the_same_plan(
    bars: RemovalPlanner, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = PlanningOptions(search=name, budget=Budget(episodes=3))

    def planned(journal: MemoryJournal) -> tuple[AssemblyProblem, SearchResult]:
        problem = new_problem(bars, journal)
        return problem, search(problem, options)

    def document(problem: AssemblyProblem, result: SearchResult) -> dict[str, Any]:
        made = plan_of(problem, result, options, 0.0)
        assert isinstance(made, Plan)
        return plan_document(made)

    whole_journal = MemoryJournal()
    whole_problem, whole = planned(whole_journal)
    expected = document(whole_problem, whole)
    cut = 0
    for readings in [0, 1, 2, 3, 5, 8, 13, 21, 34, 55, 89, 144, 233, 377]:
        journal = MemoryJournal()
        bars.forget_grasps()
        with monkeypatch.context() as patch:
            late = running_out(readings)
            patch.setattr(Clock, "late", late)
            patch.setattr(Clock, "over", late)
            problem, result = planned(journal)
        cut += len(journal.answers) < len(whole_journal.answers)
        for query, recorded in journal.answers.items():
            assert same(recorded.answer, whole_journal.answers[query].answer)
        if result.removals:
            check_valid(problem, result)
        else:
            assert not result.infeasible, "time that is over proves nothing"
        if result.sequence_bound is not None and whole.sequence_bound is not None and name == "exact":
            assert result.sequence_bound <= whole.length + 1e-9
        assert document(*planned(journal)) == expected
    assert cut >= 3


class SlowProblem(MaskedProblem):
    """Looks at the clock several times before it answers, as the removal planner does."""

    def _plan(self, state: int, part: int, effort: Effort) -> Removal | None:
        for _ in range(LOOKS):
            if effort.is_late():
                raise OutOfTimeError
        return super()._plan(state, part, effort)


def learned(problem: SlowProblem) -> EdgeBounds:
    """The bounds that a search books in, if it has not been given any."""
    bounds = EdgeBounds([problem.static_lower(part) for part in members(problem.root)])
    problem.given_bounds = bounds
    return bounds


SEARCHES: dict[str, Callable[[SlowProblem], SearchResult]] = {
    "exact": lambda problem: exact(problem, ExactOptions(), Budget()),
    "exact with threads": lambda problem: exact(problem, ExactOptions(batch=4, workers=3), Budget()),
    "best first": lambda problem: best_first(problem, BestFirstOptions(), Budget()),
    "exact, too large": lambda problem: exact(problem, ExactOptions(state_limit=3), Budget()),
    "mcts": lambda problem: mcts(problem, MctsOptions(attempts=1), Budget(episodes=2), np.random.default_rng(0)),
    "beam": lambda problem: beam(problem, BeamOptions(), Budget(), np.random.default_rng(0)),
    "greedy": lambda problem: greedy(problem, OrderOptions(monotone=True), Budget(), np.random.default_rng(0)),
    "random": lambda problem: random_order(problem, OrderOptions(monotone=True), Budget(), np.random.default_rng(0)),
}


@pytest.mark.parametrize("feasible", [True, False])
@pytest.mark.parametrize("name", sorted(SEARCHES))
def test_whenever_the_time_is_over_all_that_is_said_is_true(
    name: str, feasible: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = nothing = 0
    for readings in [*range(40), *range(40, 400, 23)]:
        problem = SlowProblem(random_problem(6, readings % 5, density=0.5, feasible=feasible))
        optimum = problem.optimum()[0]
        bounds = learned(problem)
        with monkeypatch.context() as patch:
            late = running_out(readings)
            patch.setattr(Clock, "late", late)
            patch.setattr(Clock, "over", late)
            result = SEARCHES[name](problem)
        if result.removals:
            check_sequence(problem, result)
            assert result.length >= optimum - 1e-9
            found += 1
        else:
            nothing += 1
            for state, refusals in result.refusals:
                for refusal in refusals:
                    if refusal.stage == "path":
                        assert math.isinf(problem.true_cost(state, refusal.part)), "the clock is no reason"
        assert feasible or not result.removals
        if result.infeasible:
            assert not feasible
        if result.sequence_bound is not None:
            assert result.sequence_bound <= optimum + 1e-9
        for part in members(problem.root):
            for edge in bounds.closed_edges(part):
                if edge.refusal is not None:
                    assert math.isinf(problem.true_cost(edge.state, part))
                else:
                    assert bounds.upper(edge.state, part) == pytest.approx(problem.true_cost(edge.state, part))
    assert nothing > 3
    assert not feasible or found > 3


def test_the_time_that_enumeration_takes_is_the_searchs_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where there are too many states, best-first search goes on with the clock that has been running."""
    now = [0.0]
    monkeypatch.setattr("takeapart.search.session.time.monotonic", lambda: now[0])

    def slow_enumeration(*_: object) -> TooLarge:
        now[0] += 10.0
        return TooLarge(3)

    monkeypatch.setattr("takeapart.search.exact.enumerate_states", slow_enumeration)
    problem = MaskedProblem(random_problem(6, 0))
    result = exact(problem, ExactOptions(), Budget(seconds=5.0))
    assert not result.removals and not problem.asked


def test_the_final_sweep_ends_with_the_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its bound holds all the same, and is none worse than the least costs of all parts."""
    sweeps = 0
    for seed in range(10):
        problem = MaskedProblem(random_problem(8, seed, density=0.6))
        optimum = problem.optimum()[0]
        for readings in range(0, 60, 7):
            with monkeypatch.context() as patch:
                patch.setattr(Clock, "late", lambda clock: clock.queries >= 12)
                over = running_out(readings)
                patch.setattr(Clock, "over", over)
                result = best_first(MaskedProblem(problem), BestFirstOptions(), Budget())
            assert result.sequence_bound is None or result.sequence_bound <= optimum + 1e-9
            sweeps += over()
    assert sweeps > 5


def test_a_part_of_the_seconds_is_kept_for_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr("takeapart.search.session.time.monotonic", lambda: now[0])
    clock = Clock(Budget(seconds=10.0), Counts())
    clock.reserve = 1.0
    for seconds, late, over in ((8.9, False, False), (9.1, True, False), (10.1, True, True)):
        now[0] = seconds
        assert (clock.late(), clock.over()) == (late, over)
    assert not Clock(Budget(), Counts()).late()


def test_loose_parts_are_not_enumerated() -> None:
    """20 parts that may leave at once make a million states: that is known before the first is looked at."""
    problem = MaskedProblem(random_problem(20, 0))
    problem.gravity[:] = [0] * 20
    late = running_out(0)
    assert enumerate_states(problem, 2**20 - 1, late) == TooLarge(2**20 - 1)
    problem = MaskedProblem(random_problem(8, 0))
    problem.gravity[:] = [0] * 8
    assert isinstance(enumerate_states(problem, 2**8), Lattice)
    assert enumerate_states(problem, 2**8, running_out(2)) is None


def test_where_gravity_allows_no_order_nothing_is_asked() -> None:
    problem = MaskedProblem(random_problem(6, 1))
    problem.gravity[0] |= 1 << 1
    problem.gravity[1] |= 1 << 0
    result = exact(problem, ExactOptions(), Budget())
    assert result.infeasible and result.refusals and not problem.asked
