"""Contact against linear programs and sampling that know only the corners and planes of the boxes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from box_oracle import box_distance
from takeapart.model.geometry import Array, OrientedBox, pose
from takeapart.stability.contact import TOUCHING, beyond_hull, distance, seats


def drawn(rng: np.random.Generator, reach: float, tilt: float) -> OrientedBox:
    T = pose(rng.uniform(-reach, reach, 3))
    T[:3, :3] = Rotation.from_rotvec(tilt * rng.normal(size=3)).as_matrix()
    return OrientedBox(T, rng.uniform(0.01, 0.1, 3))


@pytest.mark.parametrize("tilt", [0.0, 0.01, 2.0])
def test_distance_is_that_of_the_nearest_points(tilt: float) -> None:
    rng = np.random.default_rng(3)
    apart = 0
    for _ in range(100):
        first, second = ([drawn(rng, 0.15, tilt) for _ in range(2)] for _ in range(2))
        expected = min(box_distance(a, b) for a in first for b in second)
        found = distance(first, second)
        if expected > 1e-6:
            apart += 1
            assert found == pytest.approx(expected, abs=1e-6)
        else:
            assert found < 1e-6
    assert apart > 30


def test_corner_to_corner_is_further_than_any_axis_says() -> None:
    a = OrientedBox(pose(), np.full(3, 0.01))
    b = OrientedBox(pose((0.021, 0.021, 0.021)), np.full(3, 0.01))
    assert distance([a], [b]) == pytest.approx(1e-3 * np.sqrt(3), abs=1e-12)


def furthest(above: OrientedBox, below: OrientedBox, direction: Array) -> float | None:
    """How far, seen from above, the set of places reaches where the upper box's lower side is at most `TOUCHING` above
    the lower box's upper side, by a linear program over x, y and one height in each box."""
    rows, limits = [], []
    for box, column in ((above, 2), (below, 3)):
        R, p = box.T_frame_box[:3, :3], box.T_frame_box[:3, 3]
        for axis in range(3):
            for sign in (-1, 1):
                row = np.zeros(4)
                row[:2], row[column] = sign * R[:2, axis], sign * R[2, axis]
                rows.append(row)
                limits.append(box.half_extents[axis] + sign * float(R[:, axis] @ p))
    rows.append(np.array([0.0, 0.0, 1.0, -1.0]))
    limits.append(TOUCHING)
    found = linprog(-np.array([*direction, 0.0, 0.0]), np.array(rows), np.array(limits), bounds=(None, None))
    return None if found.fun is None or found.status else -float(found.fun)


def test_seats_are_the_places_where_one_box_lies_on_another() -> None:
    """Boxes that nearly touch, one lowered onto the other, tilted by up to some degrees."""
    rng = np.random.default_rng(5)
    lying = 0
    for _ in range(60):
        below, above = drawn(rng, 0.03, 0.02), drawn(rng, 0.03, 0.02)
        low, high = 0.0, 1.0  # lower it until it just touches, by the distance alone
        for _ in range(30):
            middle = (low + high) / 2
            apart = box_distance(above.moved(pose((0, 0, middle))), below) > 1e-9
            low, high = (low, middle) if apart else (middle, high)
        above = above.moved(pose((0, 0, high + float(rng.choice([0.0, 5e-4, 3e-3])))))
        corners = seats([above], [below])
        for angle in rng.uniform(0, 2 * np.pi, 3):
            direction = np.array([np.cos(angle), np.sin(angle)])
            expected = furthest(above, below, direction)
            if expected is None:
                assert not len(corners)
            elif len(corners):
                lying += 1
                assert float((corners @ direction).max()) == pytest.approx(expected, abs=5e-5)
    assert lying > 50


def test_what_is_beside_or_above_carries_nothing() -> None:
    base = OrientedBox(pose(), np.array([0.05, 0.05, 0.01]))
    for place in ((0.1005, 0, 0), (0, 0, -0.02), (0, 0, 0.0221), (0.1005, 0, 0.02)):
        assert not len(seats([base.moved(pose(place))], [base])), place
    assert seats([base.moved(pose((0.03, 0, 0.02)))], [base])[:, 0].min() == pytest.approx(-0.02)


def test_distance_from_a_hull() -> None:
    rng = np.random.default_rng(6)
    for _ in range(60):
        corners = rng.uniform(-1, 1, (int(rng.integers(3, 9)), 2))
        point = rng.uniform(-1.2, 1.2, 2)
        angles = np.linspace(0, 2 * np.pi, 20_001)
        directions = np.column_stack([np.cos(angles), np.sin(angles)])
        expected = float((directions @ point - (directions @ corners.T).max(axis=1)).max())
        assert beyond_hull(point, corners) == pytest.approx(expected, abs=1e-3)
    line = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.0]])
    assert beyond_hull(np.array([0.5, 0.0]), line) == 0.0
    assert beyond_hull(np.array([1.3, 0.4]), line) == pytest.approx(0.5)
