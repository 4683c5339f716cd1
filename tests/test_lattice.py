"""Enumeration, bounds of all edges, and dynamic programming against plain Python."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synthetic import (
    SyntheticProblem,
    problem_with_dead_ends,
    problem_with_many_ways,
    random_problem,
    synthetic_removal,
)
from takeapart.model.errors import InputError
from takeapart.removal.bounds import EdgeBounds
from takeapart.search.lattice import (
    Lattice,
    TooLarge,
    cost_from_root,
    cost_to_go,
    enumerate_states,
)
from takeapart.search.lattice_bounds import LatticeBounds, SequenceBounds
from takeapart.search.lattice_standing import LatticeStanding
from takeapart.search.orders import smallest_states
from takeapart.search.result import Budget
from takeapart.search.session import Session
from takeapart.states import pack, unpack


class MaskedProblem(SyntheticProblem):
    """The synthetic problem with its gravity and ways out as `freedom`, over freely numbered parts."""

    def __init__(self, problem: SyntheticProblem, numbers: list[int] | None = None) -> None:
        count = len(problem.hidden)
        numbers = numbers or list(range(count))
        self.numbers = numbers
        super().__init__([[] for _ in range(max(numbers) + 1)])
        self.root = sum(1 << number for number in numbers)
        for part, number in enumerate(numbers):
            self.gravity[number] = self.renumber(problem.gravity[part])
            self.ways[number] = [self.renumber(way) for way in problem.ways[part]]

    def renumber(self, state: int) -> int:
        return sum(1 << number for part, number in enumerate(self.numbers) if state >> part & 1)

    @property
    def freedom(self) -> list[tuple[int, ...]]:
        return [tuple(way | mask for way in ways) for mask, ways in zip(self.gravity, self.ways, strict=True)]


def enumerated(problem: SyntheticProblem) -> Lattice:
    lattice = enumerate_states(problem, 100_000)
    assert isinstance(lattice, Lattice)
    return lattice


def reachable(problem: SyntheticProblem) -> dict[int, list[int]]:
    """Breadth-first search in plain Python."""
    found: dict[int, list[int]] = {}
    waiting = [problem.root]
    while waiting:
        state = waiting.pop(0)
        if state not in found:
            found[state] = problem.candidates(state)
            waiting += [state & ~(1 << part) for part in found[state]]
    return found


def edges_of(lattice: Lattice) -> dict[int, list[tuple[int, int]]]:
    """State -> (part, state behind), as the lattice has them."""
    return {
        lattice.state(row): [
            (lattice.part(edge), lattice.state(int(lattice.child[edge]))) for edge in lattice.edges(row)
        ]
        for row in range(len(lattice.states))
    }


def check(problem: SyntheticProblem) -> Lattice:
    lattice = enumerated(problem)
    truth = {state: [(part, state & ~(1 << part)) for part in parts] for state, parts in reachable(problem).items()}
    assert edges_of(lattice) == truth
    assert len(lattice.states) == len(truth)
    sizes = [lattice.state(row).bit_count() for row in range(len(lattice.states))]
    assert sizes == sorted(sizes, reverse=True)
    assert lattice.state(0) == problem.root
    assert (lattice.goal >= 0) == (0 in truth)
    for k, part in enumerate(lattice.parts):
        group = slice(lattice.first_of_part[k], lattice.first_of_part[k + 1])
        for edge, row in zip(lattice.part_edge[group], lattice.part_source[group], strict=True):
            assert lattice.part(edge) == part
            assert edge in lattice.edges(row)
    assert sorted(lattice.part_edge) == list(range(len(lattice.child)))
    return lattice


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), parts=st.integers(1, 8), ways=st.booleans())
def test_states_and_edges_equal_a_plain_search(seed: int, parts: int, ways: bool) -> None:
    problem = problem_with_many_ways(parts, seed) if ways else random_problem(parts, seed)
    asked = check(problem)
    compiled = check(MaskedProblem(problem))
    assert (asked.states == compiled.states).all()
    assert (asked.child == compiled.child).all()


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 10**6), parts=st.integers(1, 8), masks=st.integers(1, 3))
def test_what_must_wait_for_a_part_is_there_whenever_it_leaves(seed: int, parts: int, masks: int) -> None:
    """What is common to all states, found by a plain search, that the part leaves."""
    rng = np.random.default_rng(seed)
    problem = MaskedProblem(SyntheticProblem([[]] * parts))
    problem.root = int(rng.integers(1, 1 << parts))
    problem.ways = [
        [sum(1 << k for k in range(parts) if k != part and rng.random() < 1.5 / parts) for _ in range(masks)]
        for part in range(parts)
    ]
    problem.ways[int(rng.integers(parts))] = []
    common: dict[int, int] = {}
    for state, leaving in reachable(problem).items():
        for part in leaving:
            common[part] = common.get(part, problem.root) & state
    found = smallest_states(problem.root, problem.freedom)
    assert {part: found[part] for part in common} == common
    assert set(found) == {part for part in range(parts) if problem.root >> part & 1}
    assert all(state >> part & 1 for part, state in found.items())
    assert smallest_states(problem.root, None) == {part: 1 << part for part in found}


def test_part_numbers_may_have_gaps_and_more_than_one_word() -> None:
    numbers = [0, 2, 63, 64, 70, 130, 200]
    check(MaskedProblem(random_problem(len(numbers), 5), numbers))


def test_more_than_64_removable_parts() -> None:
    """A stack of 65 parts with six free ones on either side of the word border."""
    count = 70
    problem = SyntheticProblem([[] for _ in range(count)])
    free = [0, 1, 62, 63, 64, 65]
    stack = [part for part in range(count) if part not in free]
    for below, above in itertools.pairwise(stack):
        problem.gravity[below] = 1 << above
    problem.root = (1 << count) - 1
    lattice = check(MaskedProblem(problem))
    assert lattice.states.shape == (65 * 2**6, 2)


def test_dead_ends_and_an_unreachable_goal() -> None:
    check(problem_with_dead_ends(6, 3))
    stuck = SyntheticProblem([[], [], []], gravity=[0b010, 0b001, 0])
    lattice = check(stuck)
    assert lattice.goal == -1
    assert len(lattice.states) == 2


@pytest.mark.parametrize("masked", [False, True])
def test_the_limit_is_kept(masked: bool) -> None:
    problem: SyntheticProblem = SyntheticProblem([[] for _ in range(8)])
    problem = MaskedProblem(problem) if masked else problem
    assert enumerate_states(problem, 255) == TooLarge(255)
    assert isinstance(enumerate_states(problem, 256), Lattice)
    with pytest.raises(InputError, match="state limit"):
        enumerate_states(problem, 0)


def test_smallest_states_are_in_every_state_that_the_part_leaves() -> None:
    for seed in range(20):
        problem = MaskedProblem(problem_with_many_ways(7, seed) if seed % 2 else random_problem(7, seed))
        leaving = {part: [s for s, parts in reachable(problem).items() if part in parts] for part in range(7)}
        smallest = enumerated(problem).smallest_states()
        assert smallest == {part: min(states, key=int.bit_count) for part, states in leaving.items() if states}
        assert all(smallest[part] & ~state == 0 for part, states in leaving.items() for state in states)


def test_packing_keeps_states() -> None:
    parts = [1, 5, 63, 64, 99, *range(100, 170)]
    rng = np.random.default_rng(0)
    for _ in range(50):
        state = sum(1 << part for part in parts if rng.random() < 0.5)
        assert unpack(pack(state | 1, parts), parts) == state  # part 0 is not removable


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_dynamic_programming_equals_plain_python(seed: int) -> None:
    lattice = enumerated(random_problem(7, seed))
    rng = np.random.default_rng(seed)
    cost = np.where(rng.random(len(lattice.child)) < 0.2, math.inf, rng.random(len(lattice.child)))
    rows = np.arange(len(lattice.states) - 1, dtype=np.int32)
    to_go, from_root = np.zeros(len(lattice.states)), np.full(len(lattice.states), math.inf)
    from_root[0] = 0.0
    cost_to_go(lattice.first_edge, lattice.child, cost, rows, to_go)
    cost_from_root(lattice.first_edge, lattice.child, cost, rows, from_root)
    edges = [(row, int(lattice.child[e]), float(cost[e])) for row in rows for e in lattice.edges(int(row))]
    truth_to_go = [math.inf] * len(rows) + [0.0]
    truth_from_root = [0.0] + [math.inf] * len(rows)
    for _ in range(8):  # Bellman and Ford: as many rounds as a sequence has edges
        for row, child, value in edges:
            truth_to_go[row] = min(truth_to_go[row], value + truth_to_go[child])
            truth_from_root[child] = min(truth_from_root[child], value + truth_from_root[row])
    np.testing.assert_allclose(to_go, truth_to_go, rtol=1e-12)
    np.testing.assert_allclose(from_root, truth_from_root, rtol=1e-12)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), wide=st.booleans())
def test_bounds_of_all_edges_and_sequences_equal_those_of_single_edges(seed: int, wide: bool) -> None:
    """Random removals and closed edges, among them removals that undercut closed edges, taken in one by one."""
    numbers = [3, 7, 61, 64, 65, 128] if wide else list(range(6))
    problem = MaskedProblem(random_problem(6, seed), numbers)
    lattice = enumerated(problem)
    states = [lattice.state(row) for row in range(len(lattice.states))]
    rng = np.random.default_rng(seed)
    bounds = EdgeBounds([0.3] * (max(numbers) + 1))
    table = LatticeBounds(lattice, bounds)
    standing = LatticeStanding(lattice, Session(problem, Budget()))
    sequences = SequenceBounds(lattice, LatticeBounds(lattice, bounds), standing)
    before = table.lower.copy()
    for _ in range(30):
        for _ in range(int(rng.integers(1, 4))):
            part = int(rng.choice(numbers))
            state = states[int(rng.integers(len(states)))]
            if rng.random() < 0.6:
                blockers = state & ~(1 << part) & sum(1 << n for n in numbers if rng.random() < 0.4)
                bounds.add_removal(synthetic_removal(part, float(rng.uniform(0.3, 1.0)), blockers | 1 << 2))
            else:
                bounds.close(state | 1 << part, part)
        _, fell = table.update()
        sequences.update()
        for row, state in enumerate(states):
            for edge in lattice.edges(row):
                assert table.lower[edge] == bounds.lower(state, lattice.part(edge))
                assert table.upper[edge] == bounds.upper(state, lattice.part(edge))
        assert fell or not (table.lower < before).any()
        before = table.lower.copy()
        lower, upper = shortest(lattice, table.lower), shortest(lattice, table.upper)
        assert sequences.upper == pytest.approx(upper)
        assert min(sequences.lower, sequences.upper) == pytest.approx(lower)
        if math.isfinite(upper):
            assert sum(table.upper[edge] for _, edge, _ in sequences.best_known()) == pytest.approx(upper)
        if lower < upper:
            assert sum(table.lower[edge] for _, edge, _ in sequences.most_promising()) == pytest.approx(lower)


def shortest(lattice: Lattice, cost: np.ndarray) -> float:
    """Length of the shortest sequence, by recursion over all states."""
    value = {lattice.goal: 0.0}
    for row in reversed(range(len(lattice.states))):
        if row != lattice.goal:
            value[row] = min(
                (float(cost[e]) + value[int(lattice.child[e])] for e in lattice.edges(row)), default=math.inf
            )
    return value[0]
