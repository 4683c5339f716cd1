"""Random order, greedy, restarts and beam against the truth of synthetic problems."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest

from order_search_cases import ForgetfulProblem
from synthetic import (
    Hidden,
    InterruptedProblem,
    SyntheticProblem,
    exact_guide,
    problem_with_dead_ends,
    random_problem,
)
from takeapart.model.errors import InputError
from takeapart.removal.result import Blocked, Effort, Removal
from takeapart.search.beam import BeamOptions, beam
from takeapart.search.mcts import MctsOptions, mcts
from takeapart.search.result import Budget, Progress, SearchResult
from takeapart.search.session import SECOND_LOOK
from takeapart.search.simple_orders import OrderOptions, RestartOptions, greedy, random_order, random_restarts

Search = Callable[[SyntheticProblem, Budget, int], SearchResult]


def run_random(problem: SyntheticProblem, budget: Budget, seed: int) -> SearchResult:
    return random_order(problem, OrderOptions(), budget, np.random.default_rng(seed))


def run_greedy(problem: SyntheticProblem, budget: Budget, seed: int) -> SearchResult:
    return greedy(problem, OrderOptions(), budget, np.random.default_rng(seed))


def run_restarts(problem: SyntheticProblem, budget: Budget, seed: int) -> SearchResult:
    return random_restarts(problem, RestartOptions(patience=100), budget, np.random.default_rng(seed))


def run_beam(problem: SyntheticProblem, budget: Budget, seed: int) -> SearchResult:
    return beam(problem, BeamOptions(width=2), budget, np.random.default_rng(seed))


def run_mcts(problem: SyntheticProblem, budget: Budget, seed: int) -> SearchResult:
    return mcts(problem, MctsOptions(attempts=1, patience=5), budget, np.random.default_rng(seed))


ALL = pytest.mark.parametrize("search", [run_random, run_greedy, run_restarts, run_beam])


def assert_executable(problem: SyntheticProblem, result: SearchResult) -> None:
    """Every removal is allowed in the state in which it happens, and all parts leave."""
    state = problem.root
    for removal in result.removals:
        assert removal.part in problem.candidates(state)
        assert removal.valid_in(state & ~(1 << removal.part))
        assert removal.length >= problem.true_cost(state, removal.part) - 1e-12
        state &= ~(1 << removal.part)
    assert state == 0
    assert result.length == pytest.approx(sum(removal.length for removal in result.removals), abs=1e-12)


def optimum_for_known_costs(problem: SyntheticProblem) -> float:
    """Shortest order if every edge costs what the library offers for it, m; by dynamic programming."""
    best = {0: 0.0}

    def solve(state: int) -> float:
        if state not in best:
            best[state] = min(
                (problem.upper(state, part) + solve(state & ~(1 << part)) for part in problem.candidates(state)),
                default=math.inf,
            )
        return best[state]

    return solve(problem.root)


@ALL
@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_sequences_are_executable(search: Search, noise: float) -> None:
    for seed in range(8):
        problem = random_problem(9, seed, noise=noise)
        result = search(problem, Budget(), seed)
        assert_executable(problem, result)
        assert result.length >= problem.optimum()[0] - 1e-9
        assert result.refusals == () and not result.interrupted


@ALL
def test_a_sequence_is_found_behind_dead_ends(search: Search) -> None:
    met = 0.0
    for seed in range(12):
        problem = problem_with_dead_ends(7, seed)
        result = search(problem, Budget(), seed)
        assert_executable(problem, result)
        assert not result.infeasible
        met += result.statistics["episodes"] > 1 or result.statistics["states"] > 8
    assert met  # some searches stepped back: eight states are a straight way down


@ALL
def test_infeasible_problem_is_proved_and_refused(search: Search) -> None:
    for seed in range(6):
        problem = random_problem(7, seed, feasible=False)
        reachable = problem.reachable()
        result = search(problem, Budget(), seed)
        assert result.removals == () and result.length == math.inf
        assert result.infeasible
        assert result.statistics["states"] == len(reachable)
        deepest = min(state.bit_count() for state, removable in reachable.items() if not removable)
        assert result.refusals
        for state, refusals in result.refusals:
            assert state.bit_count() == deepest and reachable[state] == []
            assert sorted(refusal.part for refusal in refusals) == problem.candidates(state)


@pytest.mark.parametrize("search", [run_random, run_greedy])
def test_no_state_is_entered_twice(search: Search, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = random_problem(7, 3, feasible=False)
    reachable = problem.reachable()
    entered: list[int] = []
    remove = problem.remove

    def spy(state: int, part: int, effort: Effort) -> Removal | Blocked:
        if effort != SECOND_LOOK:  # of dead ends; the problem answers it for nothing
            entered.append(state)
        return remove(state, part, effort)

    monkeypatch.setattr(problem, "remove", spy)
    search(problem, Budget(), 0)
    # One question per candidate of every state, and none again.
    assert len(entered) == sum(len(problem.candidates(state)) for state in reachable)


@ALL
def test_infeasibility_is_not_claimed_when_the_budget_runs_out(search: Search) -> None:
    result = search(random_problem(7, 0, feasible=False), Budget(queries=5), 0)
    assert result.removals == () and not result.infeasible


def test_feasible_monotone_problems_have_no_dead_ends() -> None:
    for seed in range(30):
        assert all(removable or not state for state, removable in random_problem(8, seed).reachable().items())


def test_first_dead_end_proves_infeasibility_of_a_monotone_problem() -> None:
    whole, first = random_problem(9, 2, feasible=False), random_problem(9, 2, feasible=False)
    assert run_random(whole, Budget(), 0).infeasible
    result = random_order(first, OrderOptions(monotone=True), Budget(), np.random.default_rng(0))
    assert result.infeasible and len(result.refusals) == 1
    assert first.counts.removal_queries < whole.counts.removal_queries
    feasible = random_problem(9, 2)
    assert_executable(feasible, random_order(feasible, OrderOptions(monotone=True), Budget(), np.random.default_rng(0)))


@ALL
def test_interruption_and_query_budget(search: Search) -> None:
    for queries in (1, 4, 9):
        problem = random_problem(9, 1)
        search(problem, Budget(queries=queries), 0)
        assert problem.counts.removal_queries == queries
        interrupted = InterruptedProblem(random_problem(9, 1), queries)
        result = search(interrupted, Budget(), 0)
        assert result.interrupted and interrupted.counts.removal_queries == queries - 1
        if result.removals:
            assert_executable(interrupted, result)


@ALL
def test_same_seed_same_sequence(search: Search) -> None:
    def outcome(seed: int) -> tuple[list[tuple[int, float]], dict[str, float]]:
        result = search(random_problem(10, 3, noise=0.3), Budget(episodes=3), seed)
        return [(removal.part, removal.length) for removal in result.removals], result.statistics

    assert outcome(7) == outcome(7)


def test_random_orders_differ_and_a_descent_asks_only_what_it_needs() -> None:
    # Two parts without any constraint: both orders come up, one query per part.
    orders = set()
    for seed in range(20):
        problem = SyntheticProblem([[Hidden(1.0, 0)], [Hidden(1.0, 0)]])
        orders.add(tuple(removal.part for removal in run_random(problem, Budget(), seed).removals))
        assert problem.counts.removal_queries == 2
    assert orders == {(0, 1), (1, 0)}


def test_greedy_takes_the_shortest_next_removal_and_misses_the_optimum() -> None:
    # Part 0 costs 1.0 m now and 0.1 m once part 1 is gone; part 1 costs 1.1 m always.
    problem = SyntheticProblem([[Hidden(1.0, 0), Hidden(0.1, 0b10)], [Hidden(1.1, 0)]])
    result = run_greedy(problem, Budget(), 0)
    assert [removal.part for removal in result.removals] == [0, 1]
    assert result.length == pytest.approx(2.1) and problem.optimum()[0] == pytest.approx(1.2)
    for seed in range(6):
        problem = random_problem(10, seed)
        state = problem.root
        for removal in run_greedy(problem, Budget(), seed).removals:
            assert removal.length == min(problem.true_cost(state, part) for part in problem.candidates(state))
            state &= ~(1 << removal.part)


def test_true_guide_makes_greedy_optimal_with_one_query_per_part() -> None:
    better = 0
    for seed in range(10):
        problem = random_problem(8, seed)
        result = greedy(problem, OrderOptions(), Budget(), np.random.default_rng(seed), guide=exact_guide(problem))
        assert result.length == pytest.approx(problem.optimum()[0])
        assert problem.counts.removal_queries == 8
        better += result.length < run_greedy(random_problem(8, seed), Budget(), seed).length - 1e-9
    assert better  # or the guide would not be told from the shortest next removal


def test_restarts_keep_the_best_and_reach_the_optimum_of_a_small_problem() -> None:
    for seed in range(4):
        problem = random_problem(5, seed)
        seen: list[Progress] = []
        options = RestartOptions(patience=2000)
        result = random_restarts(problem, options, Budget(queries=10**6), np.random.default_rng(seed), seen.append)
        assert result.length == pytest.approx(problem.optimum_by_orders(), abs=1e-12)
        assert [each.length for each in seen] == sorted((each.length for each in seen), reverse=True)
        assert result.statistics["initial_length"] == seen[0].length
    assert run_restarts(random_problem(8, 0), Budget(episodes=7), 0).statistics["episodes"] == 7


def test_wide_beam_is_exact() -> None:
    for parts, seed in itertools.product((5, 6, 7), range(5)):
        problem = random_problem(parts, seed)
        result = beam(problem, BeamOptions(width=10**6), Budget(), np.random.default_rng(seed))
        assert result.length == pytest.approx(problem.optimum_by_orders(), abs=1e-12)
        assert result.sequence_bound == pytest.approx(result.length, abs=1e-12)
        assert_executable(problem, result)


def test_wide_beam_uses_what_the_library_learned_later() -> None:
    improved = 0
    for seed in range(10):
        problem = random_problem(7, seed, noise=0.5)
        result = beam(problem, BeamOptions(width=10**6), Budget(), np.random.default_rng(seed))
        assert result.length == pytest.approx(optimum_for_known_costs(problem), abs=1e-12)
        assert result.sequence_bound == pytest.approx(result.length, abs=1e-12)
        assert_executable(problem, result)
        improved += result.length > problem.optimum()[0] + 1e-9
    assert improved  # noise matters here


def test_beam_bound_holds_at_every_width_and_budget() -> None:
    gaps = 0
    for seed, width, queries in itertools.product(range(15), (1, 2, 4), (10, 40, 10**6)):
        problem = random_problem(8, seed)
        result = beam(problem, BeamOptions(width=width), Budget(queries=queries), np.random.default_rng(seed))
        assert result.sequence_bound is not None
        assert result.sequence_bound <= problem.optimum()[0] + 1e-9
        assert result.length >= problem.optimum()[0] - 1e-9
        gaps += result.sequence_bound < result.length - 1e-9
    assert gaps  # the bound is not just the length


def test_beam_ranks_by_cost_and_bound_of_the_rest() -> None:
    # As for greedy above. Bounds are 0.8 of a part's shortest removal, so that removing part 0 first promises
    # 1.0 + 0.88 and part 1 first 1.1 + 0.08: the narrowest beam asks both, keeps the latter, and asks once more.
    for seed in range(10):
        problem = SyntheticProblem([[Hidden(1.0, 0), Hidden(0.1, 0b10)], [Hidden(1.1, 0)]])
        result = beam(problem, BeamOptions(width=1), Budget(), np.random.default_rng(seed))
        assert [removal.part for removal in result.removals] == [1, 0]
        assert result.length == pytest.approx(1.2) and result.sequence_bound == pytest.approx(1.2)
        assert problem.counts.removal_queries == 3


def test_narrow_beam_asks_less_than_a_wide_one() -> None:
    queries = []
    for width in (1, 4, 10**6):
        problem = random_problem(12, 6)
        assert_executable(problem, beam(problem, BeamOptions(width=width), Budget(), np.random.default_rng(0)))
        queries.append(problem.counts.removal_queries)
    assert queries[0] < queries[1] < queries[2]


def test_true_guide_makes_the_narrowest_beam_optimal() -> None:
    unguided = []
    for seed in range(8):
        problem = random_problem(8, seed)
        optimum = problem.optimum()[0]
        options, rng = BeamOptions(width=1), np.random.default_rng(seed)
        guided = beam(problem, options, Budget(), rng, guide=exact_guide(problem))
        assert guided.length == pytest.approx(optimum, abs=1e-12)
        unguided.append(beam(random_problem(8, seed), options, Budget(), rng).length - optimum)
    assert max(unguided) > 1e-3  # without the guide it is not


def test_options_are_checked() -> None:
    with pytest.raises(InputError, match=r"beam\.width: 0; must be at least 1"):
        BeamOptions(width=0)
    with pytest.raises(InputError, match=r"order\.attempts"):
        OrderOptions(attempts=0)
    with pytest.raises(InputError, match=r"restarts\.patience"):
        RestartOptions(patience=0)


@pytest.mark.parametrize("search", [run_random, run_greedy, run_restarts, run_beam, run_mcts])
def test_a_dead_end_is_looked_at_twice_before_it_is_believed(search: Search) -> None:
    truth = random_problem(6, 2)
    blind = truth.root & ~1  # the planner misses every other part at first
    seeing = ForgetfulProblem(truth, blind=blind, sight=SECOND_LOOK.attempts)
    assert_executable(seeing, search(seeing, Budget(queries=2000), 0))
    unseeing = ForgetfulProblem(truth, blind=blind, sight=SECOND_LOOK.attempts + 1)
    assert not search(unseeing, Budget(queries=2000), 0).removals
