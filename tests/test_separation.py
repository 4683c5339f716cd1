"""Distances of convex bodies against least squares."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from brute_force import frames, gap_between_bodies, gap_to_box, hull_distance
from conftest import random_configurations, random_rotation
from takeapart.model.geometry import Array
from takeapart.robot.kinematics import place
from takeapart.robot.model import RobotModel
from takeapart.robot.separation import ACCURACY, bodies_meet, body_meets_box, separation

ORACLE_ACCURACY = 1e-5  # m


def a_hull(rng: np.random.Generator) -> Array:
    """Corners (V, 3) of anything from a needle to a ball."""
    points = rng.normal(size=(int(rng.integers(4, 80)), 3)) * rng.uniform(0.001, 0.1, 3)
    return np.ascontiguousarray(trimesh.convex.convex_hull(points).vertices)


def test_separation_of_hulls_is_their_distance_and_never_more() -> None:
    rng, simplex, apart = np.random.default_rng(1), np.zeros((5, 3)), 0
    for _ in range(400):
        first, second = a_hull(rng), a_hull(rng)
        R, p = random_rotation(rng), rng.normal(size=3) * 0.15
        found = separation(first, second, R, p, 0.0, np.inf, simplex)
        true = hull_distance(first, second @ R.T + p)
        assert found == pytest.approx(true, abs=ORACLE_ACCURACY)
        apart += found > 0.0
        # Whatever ends the search early is said of the distance itself.
        for limit in (0.5 * true, true + 1e-4):
            assert (separation(first, second, R, p, limit, limit, simplex) > limit) == (limit < found)
    assert 100 < apart < 380


def test_separation_of_boxes_face_to_face_edge_to_edge_and_corner_to_corner() -> None:
    corners = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]) * 0.05
    simplex = np.zeros((5, 3))
    for gap in (0.0, 1e-6, 1e-3, 0.2):
        for direction in np.array([[1, 0, 0], [0, 1, 1], [1, 1, 1]]):
            shift = direction * (0.1 + gap)
            found = separation(corners, corners, np.eye(3), shift, 0.0, np.inf, simplex)
            true = gap * np.linalg.norm(direction)
            assert true - 2 * ACCURACY <= found <= true + 1e-12


def test_a_body_meets_a_box_from_the_padding_on(robot: RobotModel) -> None:
    rng, work, outcomes = np.random.default_rng(2), robot.workspace(), {True: 0, False: 0}
    for q in random_configurations(robot, 60, rng):
        place(robot.arm, robot.held(0.02), q, work)
        T = frames(robot.arm, q[None])
        for body in range(len(robot.bodies)):
            box = np.eye(4)
            box[:3, :3] = random_rotation(rng)
            box[:3, 3] = work.body[body] + rng.normal(size=3) * 0.09
            half = rng.uniform(0.0005, 0.05, 3)
            true = float(gap_to_box(robot.arm, T, body, box[None], half, near=np.inf)[0])
            axes = np.ascontiguousarray(box[:3, :3].T[None])
            for padding in (0.0, 0.004, true - 2 * ORACLE_ACCURACY, true + 2 * ORACLE_ACCURACY):
                if padding < 0.0 or abs(padding - true) < ORACLE_ACCURACY:
                    continue
                met = body_meets_box(robot.arm, body, box[None, :3, 3], axes, half[None], 0, padding, work)
                assert met == (true <= padding), (robot.bodies[body], true, padding)
                outcomes[met] += 1
    assert min(outcomes.values()) > 400


def test_two_bodies_of_the_arm_meet_from_the_padding_on(robot: RobotModel) -> None:
    rng, work, outcomes = np.random.default_rng(3), robot.workspace(), {True: 0, False: 0}
    for q in random_configurations(robot, 150, rng):
        place(robot.arm, robot.held(0.02), q, work)
        T = frames(robot.arm, q[None])
        for a, b in robot.arm.self_pairs.tolist():
            true = float(gap_between_bodies(robot.arm, T, a, b, near=np.inf)[0])
            for padding in (0.0, true - 2 * ORACLE_ACCURACY, true + 2 * ORACLE_ACCURACY):
                if padding < 0.0 or abs(padding - true) < ORACLE_ACCURACY:
                    continue
                met = bodies_meet(robot.arm, a, b, padding, work)
                assert met == (true <= padding), (robot.bodies[a], robot.bodies[b], true, padding)
                outcomes[met] += 1
    assert min(outcomes.values()) > 400
