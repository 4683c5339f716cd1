"""How far a product without an order comes apart, against brute force over all reachable states."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from small_assemblies import two_bars
from synthetic import SyntheticProblem, members, problem_that_may_fall, problem_with_many_ways, random_problem
from takeapart.formats.files import load_plan, save_plan
from takeapart.planning import Infeasible, PlanningOptions, plan
from takeapart.problem import Guide, Problem
from takeapart.removal.bounds import EdgeBounds
from takeapart.search.deepest import deepen, deepest_of
from takeapart.search.exact import ExactOptions, exact
from takeapart.search.registry import SEARCHES
from takeapart.search.result import Budget, Deepest, SearchResult
from takeapart.verification import verify_plan
from verification_scene import scene_workcell


def masked(problem: SyntheticProblem) -> SyntheticProblem:
    """The problem, which says its masks now."""

    class Masked(SyntheticProblem):
        @property
        def freedom(self) -> list[tuple[int, ...]]:
            return [tuple(way | self.gravity[part] for way in ways) for part, ways in enumerate(self.ways)]

    made = Masked(
        problem.hidden, problem.gravity, seed=problem.seed, noise=problem.noise, ways=problem.ways, falls=problem.falls
    )
    made.given_bounds = EdgeBounds([0.0] * len(problem.hidden))
    return made


def truth(problem: SyntheticProblem) -> tuple[int, float, set[int]]:
    """Fewest parts left, least length to so few, and the states with so few, by trying everything."""
    costs = {problem.root: 0.0}
    for state in sorted(problem.reachable(), key=lambda each: -each.bit_count()):
        for part in problem.removable(state):
            following = state & ~(1 << part)
            costs[following] = min(costs.get(following, math.inf), costs[state] + problem.true_cost(state, part))
    fewest = min(state.bit_count() for state in costs)
    ends = {state for state in costs if state.bit_count() == fewest}
    return fewest, min(costs[state] for state in ends), ends


def found(problem: SyntheticProblem, name: str, seed: int = 0, budget: Budget | None = None) -> Deepest:
    entry = SEARCHES[name]
    budget = budget or Budget(episodes=20 if entry.anytime else math.inf)

    def run(part_of_it: object, left: Budget, guide: object = None) -> SearchResult:
        return entry.run(part_of_it, entry.options(), left, np.random.default_rng(seed))  # type: ignore[arg-type]

    result = run(problem, budget)
    assert not result.removals
    return deepen(problem, result, budget, None, run, entry.proves, (math.inf, 0))


def check_sequence(problem: SyntheticProblem, deepest: Deepest) -> None:
    """The removals can be carried out one after another and lead to the state."""
    state = problem.root
    for removal in deepest.removals:
        assert removal.part in problem.removable(state)
        assert not removal.blockers & state & ~(1 << removal.part)
        state &= ~(1 << removal.part)
    assert state == deepest.state
    assert deepest.length == pytest.approx(sum(removal.length for removal in deepest.removals))


def infeasible(kind: str, seed: int) -> SyntheticProblem:
    make = {
        "monotone": lambda: random_problem(7, seed, feasible=False),
        "many ways": lambda: problem_with_many_ways(7, seed, feasible=False),
        "statics": lambda: problem_that_may_fall(6, seed, share=0.65),
    }
    return masked(make[kind]())


@pytest.mark.parametrize("kind", ["monotone", "many ways", "statics"])
@pytest.mark.parametrize("name", ["exact", "best-first"])
def test_exact_search_proves_the_deepest_and_shortest(kind: str, name: str) -> None:
    tried, proved = 0, 0
    for seed in range(25):
        problem = infeasible(kind, seed)
        fewest, length, ends = truth(problem)
        if not fewest:
            continue
        tried += 1
        deepest = found(problem, name)
        check_sequence(problem, deepest)
        assert deepest.is_deepest
        assert deepest.state in ends
        assert deepest.length == pytest.approx(length) or not deepest.is_shortest
        proved += deepest.is_shortest
    assert tried >= 8
    assert proved >= 0.8 * tried


@pytest.mark.parametrize("name", SEARCHES)
@pytest.mark.parametrize("kind", ["monotone", "statics"])
def test_every_search_finds_the_deepest_state(name: str, kind: str) -> None:
    for seed in range(6):
        problem = infeasible(kind, seed)
        fewest, length, ends = truth(problem)
        if fewest:
            deepest = found(problem, name)
            check_sequence(problem, deepest)
            assert deepest.state in ends
            assert deepest.length >= length - 1e-9


def test_nothing_is_asked_when_the_budget_is_spent_and_nothing_is_called_proved() -> None:
    problem = infeasible("monotone", 1)
    exact(problem, ExactOptions(), Budget(queries=3))
    asked = problem.counts.removal_queries
    deepest = deepest_of(problem, Budget(), stopped=True)
    assert problem.counts.removal_queries == asked
    check_sequence(problem, deepest)
    assert not deepest.is_deepest
    assert not deepest.is_shortest


@pytest.mark.parametrize("kind", ["monotone", "statics"])
def test_longer_removals_from_a_second_search_are_not_taken(kind: str) -> None:
    tried = 0
    for seed in range(25):
        problem = infeasible(kind, seed)
        alone = deepest_of(infeasible(kind, seed), Budget())

        def longer(part_of_it: object, left: Budget) -> SearchResult:
            result = exact(part_of_it, ExactOptions(), left)  # type: ignore[arg-type]
            removals = tuple(replace(removal, length=removal.length + 1.0) for removal in result.removals)
            return replace(result, removals=removals, length=sum(removal.length for removal in removals))

        if alone.removals:
            tried += 1
            deepest = deepest_of(problem, Budget(), longer)
            assert deepest.state == alone.state and deepest.length == pytest.approx(alone.length)
            assert [removal.length for removal in deepest.removals] == [removal.length for removal in alone.removals]
    assert tried > 5


def test_guide_of_the_whole_problem_leads_the_second_search() -> None:
    problem = infeasible("monotone", 3)
    (stuck,) = truth(problem)[2]
    asked: list[int] = []
    given: list[Guide | None] = []

    def guide(states: Sequence[int]) -> list[dict[int, float]]:
        asked.extend(states)
        return [{part: float(part) for part in members(state)} for state in states]

    def run(part_of_it: Problem, left: Budget, guide: Guide | None) -> SearchResult:
        given.append(guide)
        return exact(part_of_it, ExactOptions(), left, guide=guide)

    for whole in (guide, None):
        deepest = deepen(problem, SearchResult((), math.inf), Budget(), whole, run, True, (math.inf, 0))
        assert deepest.state == stuck and deepest.is_shortest
    restricted, none = given
    assert none is None and restricted is not None
    rest = problem.root & ~stuck
    asked.clear()
    assert restricted([rest, rest & -rest]) == [
        {part: float(part) for part in members(s)} for s in (rest, rest & -rest)
    ]
    assert asked == [problem.root, rest & -rest | stuck], "the guide knows the parts that stay"


def test_parts_that_never_leave_stay_together() -> None:
    problem = infeasible("monotone", 3)
    stuck = truth(problem)[2]
    assert len(stuck) == 1  # of what is monotone there is one dead end
    deepest = found(problem, "exact")
    assert {removal.part for removal in deepest.removals} == set(members(problem.root & ~stuck.pop()))


def test_a_partial_plan_is_judged_as_one(tmp_path: Path) -> None:
    product, cell = two_bars(), scene_workcell()
    heavy = replace(product, parts=tuple(replace(p, mass=50.0) if p.name == "beam" else p for p in product.parts))
    made = plan(heavy, cell, PlanningOptions(search="greedy"))
    assert isinstance(made, Infeasible)
    assert made.proved
    assert made.remaining == ("beam",)
    assert made.partial is not None
    assert [step.part for step in made.partial.steps] == ["stub"]
    file = tmp_path / "partial.json"
    save_plan(made.partial, file)
    read = load_plan(file)
    assert read.remaining == ("beam",)
    assert read.inverted().remaining == ("beam",)
    report = verify_plan(read, heavy, cell, physics=False)
    assert report.passed, report.findings
    assert (report.remaining, report.removable) == (("beam",), 2)
    silent = verify_plan(replace(read, remaining=()), heavy, cell, physics=False)
    assert any(finding.message == "never removed: beam" for finding in silent.findings)
    false = verify_plan(replace(read, remaining=("beam", "stub")), heavy, cell, physics=False)
    assert any(finding.message == "said to remain, but removed: stub" for finding in false.findings)
    strange = verify_plan(replace(read, remaining=("beam", "ghost")), heavy, cell, physics=False)
    assert any("no removable part: ghost" in finding.message for finding in strange.findings)
