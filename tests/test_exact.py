"""Exact search against brute force, and the promises it makes on the way."""

from __future__ import annotations

import math
from typing import Any

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
from synthetic import (
    InterruptedProblem,
    SyntheticProblem,
    exact_guide,
    problem_with_dead_ends,
    random_problem,
)
from takeapart.model.errors import InputError
from takeapart.removal.bounds import EdgeBounds
from takeapart.removal.result import Blocked
from takeapart.search import lattice_bounds, session
from takeapart.search.exact import ExactOptions, exact
from takeapart.search.refinement import RefinementOptions
from takeapart.search.result import Budget, Progress, ProgressListener, SearchResult

NO_REFINEMENT = RefinementOptions(passes=0)


def run(
    problem: SyntheticProblem, listen: ProgressListener | None = None, budget: Budget | None = None, **options: Any
) -> SearchResult:
    return exact(problem, ExactOptions(**options), budget or Budget(), listen)


@pytest.mark.parametrize("parts", [1, 2, 4, 6])
@pytest.mark.parametrize("seed", range(8))
def test_equals_brute_force_over_all_orders(parts: int, seed: int) -> None:
    for problem in (random_problem(parts, seed), MaskedProblem(random_problem(parts, seed))):
        result = run(problem)
        check_sequence(problem, result)
        assert result.length == pytest.approx(problem.optimum_by_orders())
        assert result.sequence_bound == pytest.approx(result.length)


@pytest.mark.parametrize("options", [{"batch": 1}, {"batch": 5}, {"batch": 100}, {"attempts": 3}])
def test_every_way_of_asking_finds_the_optimum(options: dict[str, Any]) -> None:
    for seed in range(10):
        problem = random_problem(8, seed)
        assert run(problem, **options).length == pytest.approx(problem.optimum()[0])


def test_bounds_never_exceed_the_optimum() -> None:
    for seed in range(60):
        for problem in (random_problem(7, seed, density=0.5), MaskedProblem(random_problem(7, seed, density=0.5))):
            assert false_bounds(problem, run) == 0


def test_that_check_catches_a_wrong_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """Closed edges that count twice in larger states."""
    right = lattice_bounds._take_closed

    def wrong(states, sources, edges, closed, cost, lower, upper):  # type: ignore[no-untyped-def]
        right(states, sources, edges, closed, 2 * cost, lower, upper)

    monkeypatch.setattr(lattice_bounds, "_take_closed", wrong)
    assert sum(false_bounds(random_problem(7, seed, density=0.5), run) > 0 for seed in range(50)) > 25


def test_progress_is_anytime() -> None:
    """From the first plan on there always is one; lengths fall, without noise bounds rise, and they meet."""
    seen: list[Progress] = []
    problem = random_problem(10, 1, density=0.6)
    result = run(problem, seen.append)
    lengths, bounds = [each.length for each in seen], [each.bound for each in seen]
    assert lengths == sorted(lengths, reverse=True)
    assert bounds[1:] == sorted(bounds[1:])
    assert seen[-1].length == result.length == pytest.approx(seen[-1].bound)
    assert seen[-1].queries == problem.counts.removal_queries
    first = next(each for each in seen if math.isfinite(each.length))
    assert first.queries <= 2 * 10 + 10


def test_asks_for_far_fewer_edges_than_there_are() -> None:
    for seed in range(20):
        problem = random_problem(9, seed)
        edges = sum(len(problem.candidates(state)) for state in problem.reachable())
        result = run(problem, refinement=NO_REFINEMENT)
        asked = [(state, part) for state, part, _ in problem.asked]
        assert len(set(asked)) == len(asked) < edges / 3
        assert result.length == pytest.approx(problem.optimum()[0])


def test_is_never_longer_than_the_best_sequence_of_what_it_found() -> None:
    """With noise: no order over the removals known in the end is shorter than the result."""
    for seed in range(10):
        problem = MaskedProblem(random_problem(8, seed, noise=0.1))
        bounds = EdgeBounds([problem.static_lower(part) for part in range(8)])
        problem.given_bounds = bounds
        result = run(problem)
        known = [[(each.length, each.blockers) for each in bounds.removals(part)] for part in range(8)]
        best = {0: 0.0}
        for state in sorted(problem.reachable()):
            for part in problem.candidates(state):
                cost = min((length for length, blockers in known[part] if not blockers & state), default=math.inf)
                best[state] = min(best.get(state, math.inf), cost + best.get(state & ~(1 << part), math.inf))
        assert result.length == pytest.approx(best[problem.root])
        assert result.sequence_bound == pytest.approx(result.length)
        assert result.length <= 1.1 * problem.optimum()[0] + 1e-9


@pytest.mark.parametrize("batch", [2, 6])
def test_the_same_with_one_and_two_threads(batch: int) -> None:
    for seed in range(6):
        problems = [random_problem(9, seed, density=0.5, noise=0.2) for _ in range(2)]
        results = [
            run(problem, batch=batch, workers=workers) for problem, workers in zip(problems, (1, 2), strict=True)
        ]
        first, second = ([(each.part, each.length, each.blockers) for each in result.removals] for result in results)
        assert first == second
        assert results[0].length == results[1].length
        assert results[0].sequence_bound == results[1].sequence_bound
        assert results[0].statistics == results[1].statistics
        asked = [sorted((state, part) for state, part, _ in problem.asked) for problem in problems]
        assert asked[0] == asked[1]


@pytest.mark.parametrize("seed", range(6))
def test_infeasible(seed: int) -> None:
    for problem in (mutually_blocked(7, seed), never_leaving(7, seed)):
        assert math.isinf(problem.optimum()[0])
        check_refusals(problem, run(problem))
        masked = MaskedProblem(problem)
        check_refusals(masked, run(masked))


def test_infeasible_by_gravity_alone_asks_for_nothing_but_what_may_be_lifted() -> None:
    problem = random_problem(4, 0)
    problem.gravity[:2] = [0b0010, 0b0001]
    result = run(problem)
    check_refusals(problem, result)
    (state, refusals), *_ = result.refusals
    assert [(each.part, each.stage, each.blamed & 0b11) for each in refusals[:2]] == [
        (0, "stability", 0b10),
        (1, "stability", 0b01),
    ]
    assert state == 0b11


def test_a_problem_may_tell_gravity_from_lifting() -> None:
    problem = random_problem(4, 0)
    problem.gravity[:2] = [0b0010, 0b0001]
    problem.hindrance = lambda state, part: Blocked(part, "lift", 1 - part)  # type: ignore[method-assign]
    (_, refusals), *_ = run(problem).refusals
    assert refusals == (Blocked(0, "lift", 1), Blocked(1, "lift", 0))


def test_dead_ends_are_passed_by() -> None:
    for seed in range(10):
        problem = problem_with_dead_ends(6, seed)
        result = run(problem)
        check_sequence(problem, result)
        assert result.length == pytest.approx(problem.optimum()[0])


def test_a_refusal_is_looked_at_twice_before_there_is_no_order() -> None:
    truth = random_problem(6, 2)
    found = run(ForgetfulProblem(truth, blind=0b011010, sight=4), second_look=4)
    assert found.length == pytest.approx(truth.optimum()[0])
    given_up = run(ForgetfulProblem(truth, blind=0b011010, sight=4), second_look=0)
    assert not given_up.removals
    assert given_up.infeasible


def test_dead_ends_that_a_second_look_frees_are_not_told() -> None:
    """There is no order, and some parts that can leave are only found to when they are asked for twice."""
    freed = 0
    for seed in range(12):
        problem = ForgetfulProblem(mutually_blocked(6, seed), blind=0b111111, sight=4)
        seen: list[Progress] = []
        check_refusals(problem, run(problem, seen.append, second_look=4))
        first = {(state, part) for state, part, effort in problem.asked if effort.attempts == 1}
        freed += any(
            effort.attempts == 4 and math.isfinite(problem.true_cost(*edge)) for *edge, effort in problem.asked
        )
        assert first
    assert freed > 8


def test_every_query_is_for_less_than_what_is_known() -> None:
    problem = ForgetfulProblem(random_problem(8, 3, density=0.6))
    run(problem, batch=1)
    limits = [effort.shorter_than for _, _, effort in problem.asked]
    assert any(math.isfinite(limit) for limit in limits)
    found: list[list[tuple[float, int]]] = [[] for _ in range(8)]
    for state, part, effort in problem.asked:
        known = min((length for length, blockers in found[part] if not blockers & state), default=math.inf)
        assert effort.shorter_than == known
        valid = [each for each in problem.hidden[part] if not each.blockers & state]
        if valid:
            found[part].append((valid[0].length, valid[0].blockers))


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("query", [1, 5, 15, 35])
def test_interrupt_keeps_the_best(query: int, workers: int) -> None:
    truth = random_problem(10, 1, density=0.6)
    uninterrupted = run(random_problem(10, 1, density=0.6))
    assert truth.optimum()[0] == pytest.approx(uninterrupted.length)
    problem = InterruptedProblem(truth, query)
    seen: list[Progress] = []
    result = run(problem, seen.append, workers=workers)
    assert result.interrupted
    assert result.sequence_bound is None or result.sequence_bound <= truth.optimum()[0] + 1e-9
    if math.isfinite(min(each.length for each in seen)):
        check_sequence(problem, result)
        assert result.length == min(each.length for each in seen)
    assert query < 35 or result.removals


@pytest.mark.parametrize("queries", [1, 7, 10, 13, 25])
def test_budget_in_queries(queries: int) -> None:
    for workers in (1, 2):
        problem = random_problem(10, 1, density=0.6)
        result = run(problem, budget=Budget(queries=queries), workers=workers)
        assert problem.counts.removal_queries == queries
        assert not result.interrupted
        assert not result.infeasible
        assert result.sequence_bound is not None
        assert result.sequence_bound <= problem.optimum()[0] + 1e-9
        if result.removals:
            check_sequence(problem, result)


def test_budget_in_rounds_and_seconds() -> None:
    result = run(random_problem(10, 1, density=0.6), budget=Budget(episodes=2))
    assert result.statistics["episodes"] == 2
    problem = random_problem(10, 1, density=0.6)
    run(problem, budget=Budget(seconds=1e-9))
    assert problem.counts.removal_queries == 0


def test_a_gap_ends_the_search_early() -> None:
    problems = [random_problem(10, 1, density=0.6) for _ in range(2)]
    exactly, roughly = (run(problem, gap=gap) for problem, gap in zip(problems, (0.0, 0.1), strict=True))
    assert roughly.sequence_bound is not None
    assert roughly.length <= 1.1 * roughly.sequence_bound + 1e-9
    assert roughly.sequence_bound <= exactly.length + 1e-9
    assert problems[1].counts.removal_queries < problems[0].counts.removal_queries


def test_a_guide_leads_the_first_descent() -> None:
    problem = random_problem(8, 5, density=0.6)
    result = exact(problem, ExactOptions(), Budget(), guide=exact_guide(problem))
    assert result.statistics["initial_length"] == pytest.approx(problem.optimum()[0])
    assert run(random_problem(8, 5, density=0.6)).statistics["initial_length"] > problem.optimum()[0] + 1e-9


def test_shared_bounds_make_a_second_search_free() -> None:
    bounds = EdgeBounds([0.0] * 8)
    lengths, queries = [], []
    for _ in range(2):
        problem = random_problem(8, 6)
        problem.given_bounds = bounds
        lengths.append(run(problem, refinement=NO_REFINEMENT).length)
        queries.append(problem.counts.removal_queries)
    assert lengths[0] == lengths[1]
    assert queries[0] > 0
    assert queries[1] == 0


def test_transitions_are_told() -> None:
    problem = random_problem(7, 0)
    told: list[tuple[int, int, float, int, tuple[int, ...]]] = []
    exact(problem, ExactOptions(), Budget(), observe=lambda *args: told.append((*args[:4], tuple(args[4]))))
    assert told
    for state, part, reward, following, candidates in told:
        assert following == state & ~(1 << part)
        assert -reward == pytest.approx(problem.true_cost(state, part))
        assert list(candidates) == problem.candidates(following)


def test_too_many_states_are_left_to_best_first_search() -> None:
    problem = random_problem(8, 3)
    result = run(problem, state_limit=20)
    check_sequence(problem, result)
    assert result.length == pytest.approx(problem.optimum()[0])
    assert "states" not in result.statistics


def test_refusals_name_what_the_planner_blamed() -> None:
    problem = never_leaving(5, 2)
    (_, refusals), *_ = run(problem).refusals
    assert Blocked(2, "path", 0) in refusals


@pytest.mark.parametrize("options", [{"attempts": 0}, {"batch": -1}, {"workers": 0}, {"gap": -0.1}, {"gap": math.nan}])
def test_bad_options(options: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"exact\." + next(iter(options))):
        ExactOptions(**options)


class StoppedClock:
    """Time that only the test moves on."""

    now = 0.0

    def monotonic(self) -> float:
        return self.now


@pytest.mark.parametrize(("limit", "after", "told"), [(0.05, 0.06, "all"), (0.05, 0.2, "one"), (10.0, 0.2, "all")])
def test_what_is_settled_is_told_until_time_and_a_little_more_are_over(
    limit: float, after: float, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`after` the first is told so many seconds are over."""
    clock = StoppedClock()
    monkeypatch.setattr(session, "time", clock)
    seen: list[tuple[int, int]] = []

    def observe(state: int, part: int, *rest: object) -> None:
        seen.append((state, part))
        clock.now = after

    exact(random_problem(5, 0), ExactOptions(), Budget(seconds=limit), observe_settled=observe)
    assert len(seen) == 1 if told == "one" else len(seen) > 20
    assert seen[0][0] == random_problem(5, 0).root, "large states first"
