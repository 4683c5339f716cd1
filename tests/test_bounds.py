"""Edge bounds against brute force over everything that was learned."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synthetic import synthetic_removal
from takeapart.model.errors import InputError
from takeapart.removal.bounds import EdgeBounds
from takeapart.removal.result import Blocked, Removal

STATIC = 0.3  # m, for every part


def brute_upper(removals: list[Removal], state: int) -> float:
    return min((removal.length for removal in removals if not removal.blockers & state), default=math.inf)


def brute_lower(removals: list[Removal], closed: list[int], state: int) -> float:
    """The definition: static bound and closed costs of all subsets, but never above the shortest valid removal."""
    subsets = [brute_upper(removals, each) for each in closed if each & ~state == 0]
    return min(max([STATIC, *subsets]), brute_upper(removals, state))


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), parts=st.sampled_from([4, 6, 70]))
def test_bounds_equal_their_definition_after_every_event(seed: int, parts: int) -> None:
    rng = np.random.default_rng(seed)
    bounds = EdgeBounds([STATIC] * parts)
    removals: list[Removal] = []
    closed: list[int] = []
    near = (1 << 3) | sum(1 << part for part in range(parts - 3, parts))  # few bits, on both sides of a word

    def some_state() -> int:
        return int(rng.integers(0, 16)) & near | (int(rng.integers(0, 8)) << (parts - 3)) | 1

    for _ in range(25):
        if rng.random() < 0.5:
            removal = synthetic_removal(0, float(rng.choice([0.2, 0.4, 0.5, 0.6])), some_state() & ~1)
            removals.append(removal)
            bounds.add_removal(removal)
        else:
            closed.append(some_state())
            bounds.close(closed[-1], 0)
        for _ in range(10):
            state = some_state()
            assert bounds.upper(state, 0) == brute_upper(removals, state)
            assert bounds.lower(state, 0) == brute_lower(removals, closed, state)
            best = bounds.best(state, 0)
            assert (best.length if best else math.inf) == bounds.upper(state, 0)


def test_dominated_removals_are_dropped() -> None:
    bounds = EdgeBounds([0.0])
    assert bounds.add_removal(synthetic_removal(0, 0.6, 0b0010))
    assert not bounds.add_removal(synthetic_removal(0, 0.7, 0b0110))  # longer and hits more
    assert not bounds.add_removal(synthetic_removal(0, 0.6, 0b0010))  # the same
    assert bounds.add_removal(synthetic_removal(0, 0.7, 0b0100))  # longer, but hits another part
    assert bounds.add_removal(synthetic_removal(0, 0.5, 0b1110))  # shorter, hits more
    assert [removal.length for removal in bounds.removals(0)] == [0.5, 0.6, 0.7]
    assert bounds.add_removal(synthetic_removal(0, 0.4, 0b0010))  # makes 0.5 and 0.6 worthless
    assert [removal.length for removal in bounds.removals(0)] == [0.4, 0.7]


def test_the_best_removal_of_a_closed_subset_closes_larger_states_for_free() -> None:
    bounds = EdgeBounds([0.0])
    bounds.add_removal(synthetic_removal(0, 0.6, 0b1000))
    bounds.close(0b0001, 0)
    assert bounds.is_closed(0b0111, 0)
    assert not bounds.is_closed(0b1001, 0)  # the removal would hit part 3
    assert bounds.lower(0b1001, 0) == 0.6
    assert math.isinf(bounds.upper(0b1001, 0))


def test_a_refusal_holds_for_all_larger_states_until_a_removal_proves_it_wrong() -> None:
    bounds = EdgeBounds([0.0])
    refusal = Blocked(0, "path", 0b0010)
    bounds.close(0b0011, 0, refusal)
    assert math.isinf(bounds.lower(0b0111, 0))
    assert bounds.refusal(0b0111, 0) is refusal
    assert bounds.lower(0b0101, 0) == 0.0
    assert bounds.refusal(0b0101, 0) is None
    falls = bounds.falls
    bounds.add_removal(synthetic_removal(0, 0.9, 0b1000))
    assert bounds.falls == falls + 1
    assert bounds.lower(0b0111, 0) == bounds.upper(0b0111, 0) == 0.9
    assert bounds.lower(0b1011, 0) == 0.9
    assert bounds.refusal(0b1011, 0) is None


@pytest.mark.parametrize("smaller_first", [True, False])
def test_of_several_refusals_that_of_the_largest_subset_is_given(smaller_first: bool) -> None:
    """What blocks the most parts that are there is the reason nearest to the state asked for, whichever came first."""
    bounds = EdgeBounds([0.0])
    refusals = {0b0011: Blocked(0, "path", 0b0010), 0b0111: Blocked(0, "grasp", 0b0110), 0b1101: Blocked(0, "ik", 0)}
    for state in sorted(refusals, reverse=not smaller_first)[:2] + [0b1101]:
        bounds.close(state, 0, refusals[state])
    for state in (0b0011, 0b0111):
        bounds.close(state, 0, refusals[state])  # again, or those left out
    assert bounds.refusal(0b0011, 0) is refusals[0b0011]
    assert bounds.refusal(0b10011, 0) is refusals[0b0011]
    assert bounds.refusal(0b0111, 0) is refusals[0b0111]
    assert bounds.refusal(0b10111, 0) is refusals[0b0111]
    assert bounds.refusal(0b1101, 0) is refusals[0b1101]


def test_falls_count_only_what_lowers_a_closed_cost() -> None:
    bounds = EdgeBounds([0.0])
    bounds.add_removal(synthetic_removal(0, 0.6, 0b10))
    bounds.close(0b01, 0)
    assert bounds.falls == 0
    bounds.add_removal(synthetic_removal(0, 0.8, 0b00))  # longer than the closed cost, valid in more states
    assert bounds.falls == 0
    bounds.add_removal(synthetic_removal(0, 0.5, 0b10))
    assert bounds.falls == 1


@pytest.mark.parametrize("static", [-0.1, math.nan, math.inf])
def test_a_static_bound_must_be_a_length(static: float) -> None:
    with pytest.raises(InputError, match=r"static\[1\]"):
        EdgeBounds([0.5, static])
