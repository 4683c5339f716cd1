"""Which ways out are kept, against all orders of small products."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from takeapart.model.geometry import Array
from takeapart.removal.selection import MOST_EXITS, leaving_before, selected, stuck, without_worse
from takeapart.states import members


@dataclass(frozen=True, eq=False)
class Way:
    """A straight way."""

    blockers: int | None
    poses: Array
    leans: bool = False


def way(blockers: int | None, direction: tuple[float, float, float] = (0, 0, 1), length: float = 0.1) -> Way:
    poses = np.repeat(np.eye(4)[None], 2, axis=0)
    poses[1, :3, 3] = length * np.array(direction)
    return Way(blockers, poses)


def reached(ways: dict[int, tuple[Way, ...]]) -> set[int]:
    """All states that any order leads to."""
    root = sum(1 << part for part in ways)
    found, waiting = {root}, [root]
    while waiting:
        state = waiting.pop()
        for part in members(state):
            after = state & ~(1 << part)
            free = any(each.blockers is not None and not each.blockers & state for each in ways[part])
            if free and after not in found:
                found.add(after)
                waiting.append(after)
    return found


@pytest.mark.parametrize("seed", range(40))
def test_no_order_is_lost_and_every_way_that_is_kept_is_open_in_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    parts, density = 6, float(rng.uniform(0.1, 0.6))
    ways = {
        part: tuple(
            way(sum(1 << k for k in range(parts) if k != part and rng.random() < density)) for _ in range(MOST_EXITS)
        )
        for part in range(parts)
    }
    kept = {part: selected(ways[part], leaving_before(part, ways)) for part in ways}
    states = reached(ways)
    assert reached(kept) == states
    assert stuck(ways) == min(states, key=int.bit_count)
    for part in ways:
        with_it = [state for state in states if state >> part & 1]
        is_open = [any(not (each.blockers or 0) & state for state in with_it) for each in ways[part]]
        expected = sum(is_open) or len(ways[part])  # where none ever is, all are told
        assert len(kept[part]) == expected


def test_a_way_up_is_kept_beside_many_with_fewer_parts_in_the_way() -> None:
    """Nine ways sideways are behind one part each, the way up is behind two; all of these can leave."""
    sideways = [way(1 << k, (np.cos(k), np.sin(k), 0), 0.1) for k in range(1, 10)]
    ways = {0: without_worse([*sideways, way(0b11 << 10, length=0.3)])}
    ways |= {k: (way(0),) for k in range(1, 12)}
    kept = selected(ways[0], leaving_before(0, ways))
    assert len(kept) == MOST_EXITS
    assert [each.blockers for each in kept].count(0b11 << 10) == 1


def test_ways_through_parts_that_wait_for_this_one_do_not_crowd_out_others() -> None:
    """A wheel on a shaft: sideways it is behind the shaft, which cannot leave before the wheel; up, behind two caps."""
    wheel, shaft, caps = 0, 1, 0b1100
    sideways = [way(1 << shaft, (np.cos(k), np.sin(k), 0), 0.05) for k in range(12)]
    ways = {
        wheel: (*sideways, way(caps)),
        shaft: (way(1 << wheel),),
        2: (way(0),),
        3: (way(0b100),),
    }
    assert leaving_before(wheel, ways) == caps
    assert [each.blockers for each in selected(ways[wheel], caps)] == [caps]


def test_a_longer_way_past_more_parts_is_worse() -> None:
    short, other, closed = way(0b01), way(0b10), way(None)
    aside, up = way(0b11, (1, 0, 0), 0.2), way(0b11, length=0.2)
    assert without_worse([aside, closed, other, short]) == (other, short)
    assert without_worse([up, closed, other, short]) == (other, short, up)  # lifted, it goes where a lean way may not
    assert [each.blockers for each in without_worse([up, way(0)])] == [0]


def test_a_way_about_where_a_better_one_goes_is_none_of_its_own() -> None:
    up, leaning, aside = way(1), replace(way(1, (0.05, -0.13, 0.99)), leans=True), way(1, (1, 0, 0))
    assert without_worse([leaning, aside, up]) == (up, aside)
    axis = way(1, (0.05, -0.13, 0.99))  # of a hole, which suggests it
    assert without_worse([axis, aside, up]) == (up, axis, aside)
