"""Best-first search against known optima; its bounds and its suboptimality factor."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest

from order_search_cases import (
    ForgetfulProblem,
    MaskedProblem,
    check_refusals,
    check_sequence,
    false_bounds,
    mutually_blocked,
    never_leaving,
)
from synthetic import InterruptedProblem, SyntheticProblem, exact_guide, problem_with_dead_ends, random_problem
from takeapart.model.errors import InputError
from takeapart.removal.bounds import EdgeBounds
from takeapart.search.beam import BeamOptions, beam
from takeapart.search.best_first import BestFirstOptions, best_first
from takeapart.search.exact import ExactOptions, exact
from takeapart.search.orders import smallest_states
from takeapart.search.result import Budget, Progress, ProgressListener, SearchResult
from takeapart.search.session import Clock


def run(
    problem: SyntheticProblem, listen: ProgressListener | None = None, budget: Budget | None = None, **options: Any
) -> SearchResult:
    return best_first(problem, BestFirstOptions(**options), budget or Budget(), listen)


@pytest.mark.parametrize("parts", [1, 2, 4, 6])
@pytest.mark.parametrize("seed", range(6))
def test_equals_brute_force_over_all_orders(parts: int, seed: int) -> None:
    for problem in (random_problem(parts, seed), MaskedProblem(random_problem(parts, seed))):
        result = run(problem)
        check_sequence(problem, result)
        assert result.length == pytest.approx(problem.optimum_by_orders())
        assert result.sequence_bound == pytest.approx(result.length)


@pytest.mark.parametrize("options", [{"weights": (1.0,), "beams": ()}, {"batch": 1}, {"batch": 6, "beams": (1,)}])
def test_every_way_of_asking_finds_the_optimum(options: dict[str, Any]) -> None:
    for seed in range(10):
        problem = MaskedProblem(random_problem(8, seed, density=0.6))
        assert run(problem, **options).length == pytest.approx(problem.optimum()[0])


@pytest.mark.parametrize("options", [{}, {"beams": (), "weights": (1.3, 1.1)}])
def test_bounds_never_exceed_the_optimum(options: dict[str, Any]) -> None:
    for seed in range(60):
        problem = MaskedProblem(random_problem(7, seed, density=0.5))
        assert false_bounds(problem, lambda problem, listen: run(problem, listen, **options)) == 0


def test_that_check_catches_a_wrong_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    right = EdgeBounds.lower
    monkeypatch.setattr(
        EdgeBounds, "lower", lambda self, state, part: min(2 * right(self, state, part), self.upper(state, part))
    )
    assert sum(false_bounds(random_problem(7, seed, density=0.5), run) > 0 for seed in range(50)) >= 5


def misleading_guide(states: Sequence[int]) -> Sequence[Mapping[int, float]]:
    return [
        {part: -float(np.random.default_rng((state, part)).uniform(0, 10)) for part in range(state.bit_length())}
        for state in states
    ]


@pytest.mark.parametrize("weight", [1.5, 1.2, 1.05])
@pytest.mark.parametrize("guided", [False, True])
def test_the_stated_factor_holds(weight: float, guided: bool) -> None:
    """With one sweep and nothing before it that could find a better plan by luck, whatever the guide says."""
    worse = 0
    for seed in range(40):
        problem = MaskedProblem(random_problem(8, seed, density=0.6))
        optimum, _ = problem.optimum()
        options = BestFirstOptions(weights=(weight,), beams=())
        result = best_first(problem, options, Budget(), guide=misleading_guide if guided else None)
        check_sequence(problem, result)
        assert result.length <= weight * optimum + 1e-9
        assert result.sequence_bound is not None
        assert result.length / weight - 1e-9 <= result.sequence_bound <= optimum + 1e-9
        worse += result.length > optimum + 1e-9
    assert worse > 0 or weight < 1.2  # otherwise the test would say nothing about the factor


def test_agrees_with_exact_search_on_a_larger_problem() -> None:
    for seed in range(3):
        problem = MaskedProblem(random_problem(14, seed, density=0.5, removals=5))
        truth = exact(MaskedProblem(problem), ExactOptions(), Budget())
        result = run(problem)
        assert result.length == pytest.approx(truth.length)
        assert result.sequence_bound == pytest.approx(truth.length)


def test_lazy_beams_improve_the_plan_at_few_queries() -> None:
    """No sweep is let run: descent and a beam alone, against the ordinary beam of the same width."""
    for seed in range(3):
        problem, other = (MaskedProblem(random_problem(20, seed, density=0.3, removals=5)) for _ in range(2))
        result = run(problem, beams=(8,), weights=(100.0,))
        check_sequence(problem, result)
        ordinary = beam(other, BeamOptions(width=8), Budget(), np.random.default_rng(seed))
        assert result.length <= ordinary.length * 1.02
        assert problem.counts.removal_queries < 0.7 * other.counts.removal_queries
        assert result.length < result.statistics["initial_length"] - 1e-9


def test_the_same_with_one_and_two_threads() -> None:
    for seed in range(5):
        problems = [MaskedProblem(random_problem(9, seed, density=0.5, noise=0.2)) for _ in range(2)]
        results = [run(problem, batch=3, workers=workers) for problem, workers in zip(problems, (1, 2), strict=True)]
        first, second = ([(each.part, each.length, each.blockers) for each in result.removals] for result in results)
        assert first == second
        assert results[0].sequence_bound == results[1].sequence_bound
        assert results[0].statistics == results[1].statistics
        asked = [sorted((state, part) for state, part, _ in problem.asked) for problem in problems]
        assert asked[0] == asked[1]


def test_with_noise_the_plan_is_best_for_the_costs_in_hand() -> None:
    """Closed costs fall on the way, which must not leave a bound behind that no longer holds."""
    fell = 0
    for seed in range(30):
        problem = MaskedProblem(random_problem(7, seed, density=0.6, noise=0.3))
        bounds = EdgeBounds([problem.static_lower(part) for part in range(7)])
        problem.given_bounds = bounds
        result = run(problem)
        fell += bounds.falls > 0
        best = {0: 0.0}
        for state in sorted(problem.reachable()):
            for part in problem.candidates(state):
                cost = bounds.upper(state, part)
                best[state] = min(best.get(state, math.inf), cost + best.get(state & ~(1 << part), math.inf))
        assert result.length == pytest.approx(best[problem.root])
        assert result.sequence_bound == pytest.approx(result.length)
    assert fell > 5


@pytest.mark.parametrize("seed", range(5))
def test_infeasible(seed: int) -> None:
    for problem in (mutually_blocked(6, seed), never_leaving(6, seed)):
        check_refusals(problem, run(problem))
        masked = MaskedProblem(problem)
        check_refusals(masked, run(masked))


def test_infeasible_by_gravity_alone() -> None:
    problem = random_problem(4, 0)
    problem.gravity[:2] = [0b0010, 0b0001]
    check_refusals(problem, run(problem))


def test_dead_ends_are_passed_by() -> None:
    for seed in range(10):
        problem = problem_with_dead_ends(6, seed)
        result = run(problem)
        check_sequence(problem, result)
        assert result.length == pytest.approx(problem.optimum()[0])


def test_a_refusal_is_looked_at_twice_before_there_is_no_order() -> None:
    truth = random_problem(6, 2)
    problem = ForgetfulProblem(truth, blind=0b011010, sight=4)
    check_sequence(problem, run(problem, second_look=4))
    assert not run(ForgetfulProblem(truth, blind=0b011010, sight=4), second_look=0).removals


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("query", [1, 5, 15, 35, 50])
def test_interrupt_keeps_the_best(query: int, workers: int) -> None:
    truth = random_problem(10, 1, density=0.6)
    problem = InterruptedProblem(truth, query)
    seen: list[Progress] = []
    result = run(problem, seen.append, workers=workers)
    assert result.interrupted
    assert result.sequence_bound is not None
    assert result.sequence_bound <= truth.optimum()[0] + 1e-9
    assert result.length == min(each.length for each in seen)
    if result.removals:
        check_sequence(problem, result)
    assert query < 35 or result.removals


@pytest.mark.parametrize("queries", [1, 10, 20, 40, 60])
def test_budget_in_queries(queries: int) -> None:
    for workers in (1, 2):
        problem = MaskedProblem(random_problem(10, 1, density=0.6))
        result = run(problem, budget=Budget(queries=queries), workers=workers)
        assert problem.counts.removal_queries <= queries
        assert result.sequence_bound is not None
        assert result.sequence_bound <= problem.optimum()[0] + 1e-9
        if result.removals:
            check_sequence(problem, result)


def test_budget_in_seconds_and_memory() -> None:
    problem = random_problem(10, 1, density=0.6)
    run(problem, budget=Budget(seconds=1e-9))
    assert problem.counts.removal_queries == 0
    problem = random_problem(10, 1, density=0.6)
    result = run(problem, beams=(), memory_limit=20)
    check_sequence(problem, result)
    assert result.statistics["out_of_memory"] == 1.0
    assert result.sequence_bound is not None
    assert result.sequence_bound <= problem.optimum()[0] + 1e-9


def test_a_guide_leads_the_first_descent() -> None:
    problem = random_problem(8, 5, density=0.6)
    result = best_first(problem, BestFirstOptions(), Budget(), guide=exact_guide(problem))
    assert result.statistics["initial_length"] == pytest.approx(problem.optimum()[0])


def test_a_hundred_parts() -> None:
    """More than one word, far beyond enumeration."""
    problem = MaskedProblem(random_problem(100, 0, density=0.05))
    result = run(problem, budget=Budget(queries=400), bound_states=200)
    check_sequence(problem, result)
    assert result.sequence_bound is not None
    assert result.sequence_bound <= result.length


def test_smallest_states_hold_all_that_must_wait() -> None:
    for seed in range(20):
        problem = MaskedProblem(random_problem(7, seed))
        states = problem.reachable()
        found = smallest_states(problem.root, problem.freedom)
        for part, smallest in found.items():
            leaving = [state for state in states if part in problem.candidates(state)]
            assert all(smallest & ~state == 0 for state in leaving)


@pytest.mark.parametrize(
    "options",
    [{"weights": ()}, {"weights": (1.0, 1.2)}, {"weights": (0.9,)}, {"beams": (0,)}, {"batch": 0}, {"memory_limit": 0}],
)
def test_bad_options(options: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"best_first\." + next(iter(options))):
        BestFirstOptions(**options)


def test_seconds_end_a_sweep_that_asks_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    ended = 0
    for seed in range(20):
        problem = MaskedProblem(random_problem(8, seed, density=0.6))
        problem.given_bounds = EdgeBounds([problem.static_lower(part) for part in range(8)])
        assert run(problem, beams=()).length == pytest.approx(
            problem.optimum()[0]
        )  # now every edge on the way is known
        whole = run(problem, beams=())
        with monkeypatch.context() as patch:
            patch.setattr(Clock, "late", lambda clock: True)
            cut = run(problem, beams=())
        assert cut.sequence_bound is not None and cut.sequence_bound <= problem.optimum()[0] + 1e-9
        assert "weight" not in cut.statistics
        ended += "weight" in whole.statistics
        check_sequence(problem, whole)
        assert cut.length >= whole.length - 1e-9
    assert ended > 10
