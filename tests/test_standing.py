"""States that do not stand, asked lazily: every search against brute force, with several ways out a part."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from order_search_cases import MaskedProblem
from synthetic import SyntheticProblem, members, problem_that_may_fall, problem_with_many_ways, random_problem
from takeapart.problem import Standing
from takeapart.removal.result import Blocked
from takeapart.search.exact import ExactOptions, exact
from takeapart.search.registry import SEARCHES
from takeapart.search.result import Budget, SearchResult

PROVING = ("exact", "best-first")
LIMITED = ("mcts", "restarts")
SEEDS = range(40)


def run(problem: SyntheticProblem, name: str, budget: Budget | None = None) -> SearchResult:
    entry = SEARCHES[name]
    budget = budget or (Budget(episodes=30) if name in LIMITED else Budget())
    return entry.run(problem, entry.options(), budget, np.random.default_rng(0))


def check_order(problem: SyntheticProblem, result: SearchResult) -> None:
    """Every removal is one of those that may happen, and the sequence ends at the goal."""
    state = problem.root
    for removal in result.removals:
        assert removal.part in problem.removable(state)
        assert removal.valid_in(state)
        state &= ~(1 << removal.part)
    assert state == 0


@pytest.mark.parametrize("name", SEARCHES)
@pytest.mark.parametrize("masked", [False, True])
def test_no_search_leads_through_a_state_that_falls(name: str, masked: bool) -> None:
    feasible = infeasible = 0
    for seed in SEEDS:
        problem = problem_that_may_fall(6, seed, share=0.2 if seed % 2 else 0.4)
        problem = MaskedProblem(problem) if masked else problem
        optimum, _ = problem.optimum()
        assert optimum == pytest.approx(problem.optimum_by_orders())
        result = run(problem, name)
        if result.removals:
            check_order(problem, result)
            assert result.length >= optimum - 1e-9
            assert not result.infeasible
            feasible += 1
        elif result.infeasible:
            assert math.isinf(optimum)
            infeasible += 1
        if name in PROVING:
            assert result.length == pytest.approx(optimum)
            assert result.infeasible == math.isinf(optimum)
            assert result.sequence_bound == (pytest.approx(optimum) if math.isfinite(optimum) else None)
        if name not in LIMITED:
            assert bool(result.removals) == math.isfinite(optimum)
        assert len(problem.asked_states) == len(set(problem.asked_states))
        assert result.statistics["stability_questions"] == len(problem.asked_states)
    assert feasible > 8 and infeasible > (8 if name not in LIMITED else 0)


@pytest.mark.parametrize("name", PROVING)
def test_the_optimum_on_larger_problems(name: str) -> None:
    detours = 0
    for seed in range(40):
        truth = problem_that_may_fall(8, seed, share=0.2)
        problem = MaskedProblem(truth)
        optimum, _ = problem.optimum()
        result = run(problem, name)
        assert result.length == pytest.approx(optimum)
        assert result.infeasible == math.isinf(optimum)
        standing = SyntheticProblem(truth.hidden, truth.gravity, ways=truth.ways)
        detours += standing.optimum()[0] + 1e-9 < optimum < math.inf
    assert detours > 3


@pytest.mark.parametrize("name", PROVING)
def test_several_ways_out_without_questions(name: str) -> None:
    infeasible = 0
    for seed in range(40):
        problem = MaskedProblem(problem_with_many_ways(7, seed, feasible=bool(seed % 4)))
        optimum, _ = problem.optimum()
        result = run(problem, name)
        assert result.length == pytest.approx(optimum)
        assert result.infeasible == math.isinf(optimum)
        assert "stability_questions" not in result.statistics
        infeasible += result.infeasible
    assert 5 < infeasible < 35


def test_far_fewer_states_are_asked_than_there_are() -> None:
    asked = reachable = 0
    for seed in range(10):
        truth = random_problem(9, seed, density=0.2)
        problem = MaskedProblem(SyntheticProblem(truth.hidden, falls=problem_that_may_fall(9, seed, share=0.1).falls))
        if exact(problem, ExactOptions(), Budget()).removals:
            asked += len(problem.asked_states)
            reachable += len(SyntheticProblem(truth.hidden).reachable())
    assert 0 < asked < reachable / 2


@pytest.mark.parametrize("name", SEARCHES)
def test_who_would_fall_is_told(name: str) -> None:
    """Part 0 is what the others rest on, whichever goes first: every order of the others lets the last one fall."""
    falls = {state: state for state in range(1, 8) if not state & 1} | {0b001: 0b001}
    truth = problem_with_many_ways(3, 0)
    problem = MaskedProblem(SyntheticProblem(truth.hidden, falls=falls))
    problem.hidden = [each[-1:] for each in SyntheticProblem(truth.hidden).hidden]
    for part in range(3):
        problem.hidden[part] = [type(each)(each.length, 0) for each in problem.hidden[part]]
    result = run(problem, name)
    assert result.infeasible and not result.removals
    for state, refusals in result.refusals:
        for refusal in refusals:
            assert refusal == Blocked(refusal.part, "stability", falls[state & ~(1 << refusal.part)])
        assert {refusal.part for refusal in refusals} == set(members(state))


def test_bounds_hold_on_the_way() -> None:
    for name, seed in itertools.product(PROVING, range(20)):
        for queries in (3, 8, 15):
            problem = MaskedProblem(problem_that_may_fall(7, seed, share=0.3))
            result = run(problem, name, Budget(queries=queries))
            optimum = problem.optimum()[0]
            assert result.sequence_bound is None or result.sequence_bound <= optimum + 1e-9
            assert not result.infeasible or math.isinf(optimum)
            if result.removals:
                check_order(problem, result)


def test_a_state_is_asked_once() -> None:
    asked = []

    def fallen_in(state: int) -> int:
        asked.append(state)
        return state & 1

    standing = Standing(fallen_in)
    assert standing.known(3) is None and not standing.is_fallen(3)
    assert [standing.fallen(state) for state in (3, 2, 3, 0)] == [1, 0, 1, 0]
    assert asked == [3, 2] and standing.questions == 2
    assert standing.is_fallen(3) and standing.known(2) == 0
    assert Standing().always and Standing().fallen(5) == 0 and not standing.always
