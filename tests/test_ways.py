"""Ways out compared with one another, and what is stuck, from their definitions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from takeapart.model.geometry import pose
from takeapart.removal.exits import Exit
from takeapart.removal.following import lead_lengths
from takeapart.removal.selection import is_no_worse, stuck
from takeapart.states import members


def way(blockers: int | None, length: float = 0.1, poses: int = 2) -> Exit:
    """Straight up."""
    places = np.array([pose((0.0, 0.0, z)) for z in np.linspace(0.0, length, poses)])
    return Exit("straight", places, blockers, None, ())


@pytest.mark.parametrize("seed", range(20))
def test_stuck_is_what_is_left_when_parts_leave_one_by_one_in_any_order(seed: int) -> None:
    rng = np.random.default_rng(seed)
    parts = [0, 1, 3, 4, 6, 7]
    everything = sum(1 << part for part in parts)
    ways = {}
    for part in parts:
        masks = [int(rng.integers(256)) & int(rng.integers(256)) & everything & ~(1 << part) for _ in range(2)]
        ways[part] = tuple(way(None if rng.random() < 0.3 else mask) for mask in masks[: int(rng.integers(3))])
    reached, left = {everything}, [everything]
    while left:
        state = left.pop()
        for part in members(state):
            if any(each.blockers is not None and not each.blockers & state for each in ways[part]):
                rest = state & ~(1 << part)
                left += [rest] if rest not in reached else []
                reached.add(rest)
    assert stuck(ways) == min(reached, key=int.bit_count)


def test_a_way_is_no_worse_if_it_hits_nothing_else_and_is_no_longer() -> None:
    assert is_no_worse(way(0b001), way(0b011))
    assert is_no_worse(way(0b011), way(0b011))
    assert not is_no_worse(way(0b011), way(0b001))
    assert not is_no_worse(way(0b100), way(0b011))
    assert not is_no_worse(way(0b001, 0.2), way(0b011, 0.1))
    assert is_no_worse(way(0b001, 0.1), way(0b011, 0.2))


def test_points_go_as_far_as_the_part_on_a_straight_way_and_by_their_arcs_on_others() -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.0, 0.1, 0.2]])
    for count in (2, 5, 30):
        assert lead_lengths(way(0, 0.12, count), points) == pytest.approx([0.12] * 3)
    turns = np.array([pose() for _ in range(200)])
    turns[:, :3, :3] = Rotation.from_rotvec(np.linspace(0, np.pi / 2, 200)[:, None] * [0.0, 0.0, 1.0]).as_matrix()
    radii = np.linalg.norm(points[:, :2], axis=1)
    found = lead_lengths(Exit("pushes", turns, 0, None, ()), points)
    assert found == pytest.approx(radii * np.pi / 2, rel=1e-4)
