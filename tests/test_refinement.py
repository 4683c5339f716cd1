"""Refinement: what is planned again, and what comes of it."""

from __future__ import annotations

import itertools
import math
from typing import Any, Literal

import numpy as np
import pytest

from order_search_cases import MaskedProblem, check_sequence
from synthetic import SyntheticProblem, members, random_problem, synthetic_removal
from takeapart.model.errors import InputError
from takeapart.removal.bounds import ClosedEdge, EdgeBounds
from takeapart.removal.result import Blocked, Effort, Removal
from takeapart.search.exact import ExactOptions, exact
from takeapart.search.lattice import Lattice, enumerate_states
from takeapart.search.lattice_bounds import LatticeBounds
from takeapart.search.lattice_standing import LatticeStanding
from takeapart.search.refinement import Hopes, Refinement, RefinementOptions
from takeapart.search.result import Budget, SearchResult
from takeapart.search.session import Session


class SecondTry(MaskedProblem):
    """A planner that finds the shortest removal at the second try of an edge; the first is longer by a random share.

    Args:
        shy: share of edges with other parts present that are refused at the first try.
        stage: of those refusals.
    """

    def __init__(
        self, problem: SyntheticProblem, shy: float = 0.0, stage: Literal["path", "grasp"] = "path", excess: float = 0.3
    ) -> None:
        super().__init__(problem)
        self.shy, self.stage, self.excess = shy, stage, excess

    def remove(self, state: int, part: int, effort: Effort) -> Removal | Blocked:
        with self._lock:
            self.counts.removal_queries += 1
            self.asked.append((state, part, effort))
        valid = [each for each in self.hidden[part] if not each.blockers & state]
        if not valid or (effort.attempts == 1 and is_shy((state, part), self.shy)):
            return Blocked(part, self.stage, state & ~(1 << part))
        longer = self.excess * np.random.default_rng((8, state, part)).random() if effort.attempts == 1 else 0.0
        length = valid[0].length * (1 + longer)
        return (
            synthetic_removal(part, length, valid[0].blockers)
            if length < effort.shorter_than
            else Blocked(part, "path", 0)
        )

    def asked_again(self) -> set[tuple[int, int]]:
        return {(state, part) for state, part, effort in self.asked if effort.attempts > 1}


def is_shy(edge: tuple[int, int], share: float) -> bool:
    state, part = edge
    return state != 1 << part and bool(np.random.default_rng((7, state, part)).random() < share)


def run(problem: SyntheticProblem, workers: int = 1, budget: Budget | None = None, **options: Any) -> SearchResult:
    return exact(problem, ExactOptions(workers=workers, refinement=RefinementOptions(**options)), budget or Budget())


@pytest.mark.parametrize("shy", [0.0, 0.2])
def test_with_full_optimism_the_truth_comes_out(shy: float) -> None:
    """Whatever could matter was planned twice, and the second try finds the truth."""
    longer = 0
    for seed in range(20):
        truth = random_problem(8, seed)
        rough = run(SecondTry(truth, shy), passes=0)
        problem = SecondTry(truth, shy)
        result = run(problem, passes=2, optimism=1.0, worth=0.0)
        check_sequence(problem, result)
        assert result.length == pytest.approx(truth.optimum()[0])
        assert result.sequence_bound == pytest.approx(result.length)
        assert result.statistics["closed_length"] == pytest.approx(rough.length)
        longer += rough.length > result.length + 1e-6
    assert longer > 10


def test_gains_most_of_it_at_half_the_effort() -> None:
    excess, queries = np.zeros(3), np.zeros(3)
    for seed in range(20):
        truth = random_problem(9, seed)
        cases: list[dict[str, Any]] = [{"passes": 0}, {"optimism": 0.5}, {"optimism": 1.0, "worth": 0.0}]
        for i, options in enumerate(cases):
            problem = SecondTry(truth)
            excess[i] += run(problem, **options).length / truth.optimum()[0] - 1
            queries[i] += problem.counts.removal_queries
    assert excess[1] < 0.3 * excess[0]
    assert queries[0] < queries[1] < queries[2]


def test_refusals_that_no_path_planner_can_change_are_not_doubted() -> None:
    for seed in range(10):
        doubtful, certain = (SecondTry(random_problem(8, seed), 0.4, stage, excess=0.0) for stage in ("path", "grasp"))
        for problem in (doubtful, certain):
            run(problem, passes=1, optimism=1.0, worth=0.0)
        again = {(state, part) for state, part, effort in certain.asked if effort.attempts == 2}  # 4: second look
        refused = {  # although nothing else was known
            (state, part)
            for state, part, effort in certain.asked
            if effort.attempts == 1 and math.isinf(effort.shorter_than) and is_shy((state, part), 0.4)
        }
        assert refused
        assert not refused & again
        if any(is_shy(edge, 0.4) for edge in doubtful.asked_again()):
            return
    pytest.fail("no refusal was doubted")


def test_what_cannot_be_shorter_is_not_planned_again() -> None:
    """Costs that equal the static bound, the straight line; refusals may be doubted."""
    problem = SecondTry(random_problem(8, 1), excess=0.0)
    problem.static_share = 1.0
    for part in range(8):
        problem.hidden[part] = problem.hidden[part][:1]
    run(problem, optimism=1.0, worth=0.0)
    assert all(math.isinf(problem.true_cost(*edge)) for edge in problem.asked_again())
    assert len(problem.asked_again()) < len(problem.asked) / 4


def test_no_edge_is_planned_more_often_than_there_are_passes() -> None:
    problem = SecondTry(random_problem(8, 3))
    result = run(problem, passes=3, worth=0.0)
    tries: dict[tuple[int, int], list[int]] = {}
    for state, part, effort in problem.asked:
        tries.setdefault((state, part), []).append(effort.attempts)
    assert result.statistics["passes"] == 3
    assert max(map(len, tries.values())) == 4
    for attempts in tries.values():
        assert attempts == sorted(set(attempts))


def test_the_same_with_one_and_two_threads() -> None:
    for seed in range(5):
        results = []
        for workers in (1, 2):
            problem = SecondTry(random_problem(9, seed), 0.2)
            result = run(problem, workers)
            results.append(([(each.part, each.length) for each in result.removals], result.statistics))
            assert problem.asked_again()
        assert results[0] == results[1]


@pytest.mark.parametrize("queries", [25, 40, 60])
def test_a_budget_ends_it_with_the_best_so_far(queries: int) -> None:
    truth = random_problem(9, 2)
    problem = SecondTry(truth)
    result = run(problem, budget=Budget(queries=queries), passes=1000, worth=0.0)
    assert problem.counts.removal_queries <= queries
    check_sequence(problem, result)
    rough = run(SecondTry(truth), budget=Budget(queries=queries), passes=0)
    assert result.length <= rough.length + 1e-9


def test_lengths_are_those_of_the_best_removals_known() -> None:
    problem = SecondTry(random_problem(8, 5))
    result = run(problem)
    state = problem.root
    for removal in result.removals:
        assert removal.part in members(state)
        assert removal.length >= problem.true_cost(state, removal.part) - 1e-9
        state &= ~(1 << removal.part)
    assert math.isclose(result.length, sum(each.length for each in result.removals))


class ByHand:
    """What `Refinement` is to choose, from its definition: every closed edge and every order one by one."""

    def __init__(self, problem: SyntheticProblem, bounds: EdgeBounds, optimism: float) -> None:
        self.problem, self.bounds, self.optimism = problem, bounds, optimism
        self.planned: set[tuple[int, int]] = set()

    def settled(self, part: int, closed: ClosedEdge) -> bool:
        beyond_doubt = closed.refusal is not None and closed.refusal.stage != "path"
        return beyond_doubt or (closed.state, part) in self.planned

    def hope(self, state: int, part: int) -> float:
        upper = self.bounds.upper(state, part)
        subsets = [each for each in self.bounds.closed_edges(part) if each.state & state == each.state]
        costs = [(self.bounds.upper(each.state, part), self.settled(part, each)) for each in subsets]
        static = self.bounds.static(part)
        known = min(max([static, *(cost for cost, _ in costs)]), upper)
        sure = min(max([static, *(cost for cost, settled in costs if settled)]), upper)
        return sure + (1 - self.optimism) * (known - sure) if math.isfinite(known) else sure

    def doubted(self, state: int, part: int) -> tuple[int, int]:
        found = [
            (self.bounds.upper(each.state, part), each.state.bit_count(), each.state)
            for each in self.bounds.closed_edges(part)
            if each.state & state == each.state and not self.settled(part, each)
        ]
        return (sorted(found)[-1][2] if found else state), part

    def choices(self, count: int) -> list[list[tuple[int, int]]]:
        """The edges to plan again, in order, for every order of the parts that is shortest by hopes."""
        found: list[tuple[float, list[tuple[int, int]]]] = []
        for order in itertools.permutations(members(self.problem.root)):
            state, total, gains = self.problem.root, 0.0, []
            for part in order:
                if part not in self.problem.candidates(state):
                    break
                hope = self.hope(state, part)
                total += hope
                gains.append((self.bounds.upper(state, part) - hope, (state, part)))
                state &= ~(1 << part)
            if state or math.isinf(total):
                continue
            most = sorted((each for each in gains if each[0] > 1e-9), key=lambda each: -each[0])[:count]
            found.append((total, [self.doubted(*edge) for _, edge in most]))
        least = min((total for total, _ in found), default=math.inf)
        return [edges for total, edges in found if total < least + 1e-9]


@pytest.mark.parametrize("optimism", [0.3, 0.5, 1.0])
def test_what_is_planned_again_is_what_the_shortest_sequence_by_hopes_rests_on(optimism: float) -> None:
    """Several rounds of it, each against every order of the parts; attempts grow with every try of an edge."""
    rounds = subsets = 0
    for seed in range(30):
        rng = np.random.default_rng([5, seed])
        problem = random_problem(5, seed, density=0.5)
        bounds = EdgeBounds([0.8 * min(each.length for each in problem.hidden[part]) for part in range(5)])

        def plan(edge: tuple[int, int], excess: float, problem: Any = problem, bounds: Any = bounds) -> None:
            state, part = edge
            valid = [each for each in problem.hidden[part] if not each.blockers & state]
            if valid:
                bounds.add_removal(synthetic_removal(part, valid[0].length * (1 + excess), valid[0].blockers))
            stage: Literal["path", "grasp"] = "path" if excess < 0.3 else "grasp"
            bounds.close(state, part, None if valid else Blocked(part, stage, state & ~(1 << part)))

        edges = [(state, part) for state in problem.reachable() for part in problem.candidates(state)]
        for k in rng.permutation(len(edges))[: int(rng.integers(5, 25))]:
            plan(edges[k], float(rng.uniform(0.0, 0.6)))
        lattice = enumerate_states(problem, 1000)
        assert isinstance(lattice, Lattice)
        known = LatticeBounds(lattice, bounds)
        standing = LatticeStanding(lattice, Session(problem, Budget()))
        refinement = Refinement(lattice, bounds, known, standing, 2, RefinementOptions(optimism=optimism, worth=0.0))
        truth = ByHand(problem, bounds, optimism)
        tries = {(closed.state, part): 1 for part in range(5) for closed in bounds.closed_edges(part)}
        for k in range(4):
            known.update()
            chosen = refinement.edges(99.0, 2, k)
            if refinement.passes > 1 or not chosen:
                break
            assert chosen in truth.choices(2)
            assert [refinement.attempts(edge) for edge in chosen] == [2 * (tries.get(edge, 0) + 1) for edge in chosen]
            rounds += 1
            subsets += any(edge not in edges for edge in chosen) or len(set(tries) & set(chosen))
            for edge in dict.fromkeys(chosen):
                plan(edge, float(rng.uniform(0.0, 0.2)))
                tries[edge] = tries.get(edge, 0) + 1
            truth.planned.update(chosen)
    assert rounds > 40 and subsets > 20


@pytest.mark.parametrize("options", [{"passes": -1}, {"optimism": 1.1}, {"worth": math.nan}])
def test_bad_options(options: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"refinement\." + next(iter(options))):
        RefinementOptions(**options)


class SomeBounds:
    """Bounds of edges that are what they are."""

    def __init__(self, lower: list[float], upper: list[float]) -> None:
        self.lower, self.upper = np.array(lower), np.array(upper)

    def update(self) -> tuple[bool, bool]:
        return False, False


@pytest.mark.parametrize("optimism", [0.0, 0.3, 1.0])
def test_hopes_lie_between_what_is_settled_and_what_is_known(optimism: float) -> None:
    known = SomeBounds([1.0, 2.0, math.inf, 3.0, 4.0], [1.5, 2.0, math.inf, math.inf, 4.0])
    settled = SomeBounds([0.5, 2.5, 0.7, 3.0, 1.0], [math.inf] * 5)
    hopes = Hopes(known, settled, optimism, lambda: None)  # type: ignore[arg-type]
    assert hopes.update() == (True, True)
    doubted = 1.0 - optimism
    # settled above what is known to work is no bound; refused in doubt: the settled one alone
    expected = [0.5 + doubted * 0.5, 2.0, 0.7, 3.0, 1.0 + doubted * 3.0]
    assert np.allclose(hopes.lower, expected)
    assert hopes.update() == (True, False)
    settled.lower = settled.lower - 0.1
    assert hopes.update() == (True, True), "the third edge hopes for less"
