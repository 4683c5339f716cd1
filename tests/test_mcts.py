"""MCTS against brute force, hand-computed trees and the paper's accounting of planner calls."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from synthetic import (
    Hidden,
    InterruptedProblem,
    SyntheticProblem,
    exact_guide,
    problem_with_dead_ends,
    random_problem,
)
from takeapart.model.errors import InputError, UnknownNameError
from takeapart.removal.result import Blocked, Effort
from takeapart.search.mcts import MctsOptions, Node, TreeSearch, mcts, normalised_returns, uct_values
from takeapart.search.result import Budget, Progress, SearchResult
from takeapart.search.session import Session

WHOLE_TREE = MctsOptions(patience=10**9)


def run(problem: SyntheticProblem, options: MctsOptions = WHOLE_TREE, seed: int = 0, **budget: float) -> SearchResult:
    return mcts(problem, options, Budget(**budget), np.random.default_rng(seed))


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


def free_problem(parts: int) -> SyntheticProblem:
    """Any order is possible; part i costs 1 m, and 0.1 m less for each lower-numbered part that is gone."""
    hidden = [
        [Hidden(1.0 - 0.1 * part + 0.1 * bin(kept).count("1"), ~kept & ((1 << part) - 1)) for kept in range(1 << part)]
        for part in range(parts)
    ]
    return SyntheticProblem(hidden)


@pytest.mark.parametrize("memory", ["library", "paper"])
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("parts", [5, 6])
def test_whole_tree_gives_the_optimum_over_all_orders(parts: int, seed: int, memory: str) -> None:
    problem = random_problem(parts, seed)
    result = run(problem, MctsOptions(memory=memory, patience=10**9), seed)  # type: ignore[arg-type]
    assert result.statistics["explored"] == 1.0
    assert result.length == pytest.approx(problem.optimum_by_orders(), abs=1e-12)
    assert_executable(problem, result)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("parts", [5, 6, 7])
def test_optimum_beside_dead_ends(parts: int, seed: int) -> None:
    problem = problem_with_dead_ends(parts, seed)
    result = run(problem)
    assert result.statistics["explored"] == 1.0
    assert result.length == pytest.approx(problem.optimum_by_orders(), abs=1e-12)
    assert_executable(problem, result)


def test_seven_free_parts_are_solved_long_before_all_orders_are_tried() -> None:
    problem = free_problem(7)
    result = run(problem, MctsOptions(), episodes=60)
    assert problem.optimum_by_orders() == pytest.approx(7.0 - 0.1 * 21)  # ascending order
    assert result.statistics["explored"] == 0.0
    assert result.length <= 7.0 - 0.1 * 19  # of 21 pairs, at most two in the wrong order
    assert_executable(problem, result)


def test_uct_on_a_tree_worked_out_by_hand() -> None:
    best, worst, without_sequence = (
        Node(1, [], visits=4, best_return=-15.0),
        Node(2, [], visits=5, best_return=-17.0),
        Node(4, [], visits=1),
    )
    root = Node(7, [], children=[best, worst, without_sequence], visits=10)
    extremes = (-20.0, -14.0)
    # Siblings span -17 to -15: Q-hat 1, 0, and 0 where no sequence is known. 2 ln 10 = 4.60517; over 4, 5 and 1 the
    # roots are 1.072983, 0.959705 and 2.145966; c = 0.5 halves them.
    assert normalised_returns(root.children, extremes) == pytest.approx([1.0, 0.0, 0.0])
    assert uct_values(root, extremes, 0.5) == pytest.approx([1.536491, 0.479853, 1.072983], abs=2e-6)
    assert uct_values(root, extremes, 0.0) == pytest.approx([1.0, 0.0, 0.0])

    search = TreeSearch(
        free_problem(3), MctsOptions(exploration=0.5), log_of(free_problem(3)), np.random.default_rng(0)
    )
    search.extremes = extremes
    assert search.select(root) is best
    best.closed = True
    assert search.select(root) is without_sequence


def log_of(problem: SyntheticProblem) -> Session:
    return Session(problem, Budget())


def test_normalisation_falls_back_to_the_whole_search_without_spread() -> None:
    extremes = (-20.0, -14.0)
    only, same, new = Node(1, [], best_return=-15.0), Node(2, [], best_return=-15.0), Node(4, [])
    assert normalised_returns([only], extremes) == pytest.approx([5.0 / 6.0])
    assert normalised_returns([only, same], extremes) == pytest.approx([5.0 / 6.0, 5.0 / 6.0])
    assert normalised_returns([only, new], extremes) == pytest.approx([5.0 / 6.0, 0.0])
    assert normalised_returns([only, same], (-15.0, -15.0)) == [0.0, 0.0]
    assert normalised_returns([new], (math.inf, -math.inf)) == [0.0]


def test_backpropagation_keeps_the_maximum_up_to_the_root_and_closes_what_is_explored() -> None:
    problem = free_problem(3)
    search = TreeSearch(problem, MctsOptions(), log_of(problem), np.random.default_rng(0))
    root = search.root
    root.untried.clear()
    left, right = Node(6, [], root), Node(5, [0], root)
    leaf = Node(4, [], left)
    root.children, left.children = [left, right], [leaf]
    for node, value in ((leaf, -3.0), (right, -2.0), (leaf, -4.0), (left, -math.inf)):
        search.backpropagate(node, value)
    assert [root.best_return, left.best_return, right.best_return, leaf.best_return] == [-2.0, -3.0, -2.0, -3.0]
    assert [root.visits, left.visits, right.visits, leaf.visits] == [4, 3, 1, 2]
    assert search.extremes == (-4.0, -2.0)
    search.close_if_explored(leaf)
    assert [root.closed, left.closed, right.closed, leaf.closed] == [False, True, False, True]
    right.untried.clear()
    search.close_if_explored(right)
    assert root.closed


def test_paper_memory_plans_k_times_in_expansion_once_in_simulation_and_keeps_nothing() -> None:
    problem = random_problem(6, 3, noise=0.3)
    result = run(problem, MctsOptions(memory="paper", attempts=4), episodes=3)
    expansion, simulation = Effort(attempts=4, fresh=True), Effort(attempts=1, fresh=True)
    efforts = [effort for _, _, effort in problem.asked]
    assert set(efforts) == {expansion, simulation}
    # The first query expands a child of the root, and then a simulation goes down from there.
    state, part, effort = problem.asked[0]
    assert (state, effort) == (problem.root, expansion)
    simulated = list(itertools.takewhile(lambda query: query[2] == simulation, problem.asked[1:]))
    assert simulated[0][0] == problem.root & ~(1 << part)
    assert simulated[-1][0].bit_count() == 1
    # Expansions come from the tree alone: one for every node, one for every edge found blocked.
    edges = [query[:2] for query in problem.asked if query[2] == expansion]
    blocked = sum(problem.true_cost(*edge) == math.inf for edge in edges)
    assert len(edges) == result.statistics["nodes"] - 1 + blocked
    assert all(problem.upper(state, part) == math.inf for state, part, _ in problem.asked)


def test_library_memory_pays_no_query_twice() -> None:
    problem = random_problem(6, 3, noise=0.3)
    result = run(problem, MctsOptions(memory="library"), episodes=10)
    edges = [query[:2] for query in problem.asked]
    assert len(edges) == len(set(edges)) > 0
    assert not any(effort.fresh for _, _, effort in problem.asked)
    assert {effort.attempts for _, _, effort in problem.asked} == {1, 4}
    again = random_problem(6, 3, noise=0.3)
    run(again, MctsOptions(memory="paper"), episodes=10)
    assert problem.counts.removal_queries < again.counts.removal_queries / 5
    assert_executable(problem, result)


def test_an_episode_goes_down_to_a_leaf_and_the_tree_stays() -> None:
    # Six free parts, five iterations a step: steps with 6, 5, 4, 3 and 2 parts left. With 3 left there are 15 nodes
    # below, more than a step explores; with 2 left there are 4, so that the fifth step closes the node it stands on.
    first = run(free_problem(6), MctsOptions(), episodes=1)
    assert first.statistics["steps"] == 5
    nodes = [run(free_problem(6), MctsOptions(), episodes=episodes).statistics["nodes"] for episodes in (1, 2, 3)]
    assert nodes[0] < nodes[1] < nodes[2]


@pytest.mark.parametrize("memory", ["library", "paper"])
def test_same_seed_same_sequence(memory: str) -> None:
    options = MctsOptions(memory=memory)  # type: ignore[arg-type]

    def outcome(seed: int) -> tuple[list[tuple[int, float]], dict[str, float]]:
        result = run(random_problem(9, 1, noise=0.2), options, seed, episodes=3)
        return [(removal.part, removal.length) for removal in result.removals], result.statistics

    assert outcome(5) == outcome(5)
    assert len({str(outcome(seed)) for seed in range(4)}) > 1


@pytest.mark.parametrize("interrupt_at", [1, 3, 20, 50, 81])
def test_interruption_keeps_the_best_sequence(interrupt_at: int) -> None:
    problem = InterruptedProblem(random_problem(8, 2, noise=0.3), interrupt_at)
    seen: list[Progress] = []
    options = MctsOptions(memory="paper")
    result = mcts(problem, options, Budget(episodes=50), np.random.default_rng(0), listen=seen.append)
    assert result.interrupted
    assert problem.counts.removal_queries == interrupt_at - 1
    if interrupt_at <= 8:  # no sequence of eight parts can be complete yet
        assert result.removals == () and result.length == math.inf
    else:
        assert result.length == seen[-1].length < math.inf
        assert_executable(problem, result)


def test_budgets(monkeypatch: pytest.MonkeyPatch) -> None:
    for queries in (1, 7, 40):
        problem = random_problem(8, 2)
        assert run(problem, MctsOptions(memory="paper"), queries=queries).interrupted is False
        assert problem.counts.removal_queries == queries
    assert run(random_problem(8, 2), episodes=3).statistics["episodes"] == 3

    ticks = itertools.count()
    monkeypatch.setattr("takeapart.search.session.time.monotonic", lambda: float(next(ticks)))
    problem = random_problem(8, 2)
    run(problem, MctsOptions(memory="paper"), seconds=30.0)
    assert 0 < problem.counts.removal_queries <= 30


def test_a_budget_of_queries_ends_although_the_library_answers_everything() -> None:
    problem = random_problem(10, 4)
    result = run(problem, MctsOptions(patience=5), queries=10**6)
    assert result.statistics["explored"] == 0.0
    assert_executable(problem, result)


def test_statistics_say_where_the_best_sequence_was_found() -> None:
    problem = random_problem(9, 3)
    seen: list[Progress] = []
    result = mcts(problem, MctsOptions(), Budget(episodes=12), np.random.default_rng(1), listen=seen.append)
    statistics = result.statistics
    found = int(statistics["found_episode"])
    assert found > 1  # otherwise this seed shows nothing
    assert seen[0].length == statistics["initial_length"] > result.length == statistics["shortest_length"]
    assert run(random_problem(9, 3), MctsOptions(), seed=1, episodes=found).length == result.length
    assert run(random_problem(9, 3), MctsOptions(), seed=1, episodes=found - 1).length > result.length
    assert 1 <= statistics["found_step"] <= 9
    assert [each.length for each in seen] == sorted((each.length for each in seen), reverse=True)


def test_observer_sees_every_transition() -> None:
    problem = random_problem(6, 2, noise=0.2)
    seen: list[tuple[int, int, float, int, list[int]]] = []
    mcts(
        problem,
        MctsOptions(memory="paper"),
        Budget(queries=200),
        np.random.default_rng(0),
        observe=lambda state, part, reward, following, after: seen.append(
            (state, part, reward, following, list(after))
        ),
    )
    planned = [(state, part) for state, part, _ in problem.asked if problem.true_cost(state, part) < math.inf]
    assert [(state, part) for state, part, *_ in seen] == planned
    assert len(planned) > len(set(planned))  # repeated plans are told, too
    for state, part, reward, following, after in seen:
        assert 1.0 <= -reward / problem.true_cost(state, part) <= 1.2
        assert following == state & ~(1 << part)
        assert after == problem.candidates(following)


def test_infeasible_problem_is_explored_and_refused() -> None:
    problem = random_problem(5, 1, feasible=False)
    result = run(problem)
    assert result.removals == () and result.length == math.inf
    assert result.statistics["explored"] == 1.0
    assert "shortest_length" not in result.statistics
    deepest = min(state.bit_count() for state, removable in problem.reachable().items() if not removable)
    assert result.refusals
    for state, refusals in result.refusals:
        assert state.bit_count() == deepest
        assert sorted(refusal.part for refusal in refusals) == problem.candidates(state)
        assert all(problem.true_cost(state, refusal.part) == math.inf for refusal in refusals)
        assert all(isinstance(refusal, Blocked) and refusal.blamed & state for refusal in refusals)


def test_guide_leads_the_simulation() -> None:
    problem = random_problem(8, 5)
    options = MctsOptions(epsilon=0.0)
    expected = exact_guide(problem)([problem.root])[0]
    lengths: list[Progress] = []
    # The first simulation starts behind one random part and then follows the true Q-function to the end.
    problem_again = random_problem(8, 5)
    mcts(problem_again, options, Budget(episodes=1), np.random.default_rng(0), exact_guide(problem), lengths.append)
    first_part = problem_again.asked[0][1]
    assert lengths[0].length == pytest.approx(-expected[first_part], abs=1e-12)

    asked: list[int] = []

    def counting(states: Sequence[int]) -> Sequence[Mapping[int, float]]:
        asked.extend(states)
        return exact_guide(problem)(states)

    mcts(random_problem(8, 5), MctsOptions(epsilon=1.0), Budget(episodes=2), np.random.default_rng(0), counting)
    assert asked == []
    mcts(random_problem(8, 5), MctsOptions(epsilon=0.2), Budget(episodes=2), np.random.default_rng(0), counting)
    assert len(asked) == len(set(asked)) > 0


def test_options_are_checked() -> None:
    with pytest.raises(UnknownNameError, match="'none'; valid: library, paper"):
        MctsOptions(memory="none")  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"mcts\.search_budget: 0"):
        MctsOptions(search_budget=0)
    with pytest.raises(InputError, match=r"mcts\.epsilon"):
        MctsOptions(epsilon=math.nan)
    with pytest.raises(InputError, match=r"mcts\.exploration"):
        MctsOptions(exploration=-1.0)


def test_one_part_takes_one_step_and_two_nodes() -> None:
    result = mcts(random_problem(1, 0), MctsOptions(), Budget(episodes=5), np.random.default_rng(0))
    expected = {"steps": 1, "nodes": 2, "explored": 1, "episodes": 1, "found_step": 1, "found_episode": 1}
    assert {name: result.statistics[name] for name in expected} == expected
