"""Geometry against scipy: rotations, Minkowski differences, and closest points by bounded least squares."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from takeapart.model.geometry import (
    Box,
    OrientedBox,
    Shape,
    box_separation,
    pose,
    pose_inverse,
    quaternion_from_rotation,
    rotation_from_quaternion,
)

SEEDS = st.integers(0, 2**32 - 1)


def random_pose(rng: np.random.Generator, reach: float = 0.5) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.random(rng=rng).as_matrix()
    T[:3, 3] = rng.uniform(-reach, reach, 3)
    return T


def corners(T: np.ndarray, half: np.ndarray) -> np.ndarray:
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    return np.array([T[:3, :3] @ (sign * half) + T[:3, 3] for sign in signs])


def distance(T_a: np.ndarray, half_a: np.ndarray, T_b: np.ndarray, half_b: np.ndarray) -> float:
    """Distance of two boxes: the closest pair of points, one in each, as a bounded least-squares problem."""
    A = np.hstack([T_a[:3, :3], -T_b[:3, :3]])
    bounds = np.concatenate([half_a, half_b])
    result = lsq_linear(A, T_b[:3, 3] - T_a[:3, 3], (-bounds, bounds), method="bvls", tol=1e-14)
    return float(np.linalg.norm(result.fun))


@given(SEEDS)
@settings(max_examples=100, deadline=None)
def test_rotation_of_a_quaternion_is_scipys(seed: int) -> None:
    q = np.random.default_rng(seed).normal(size=4)
    expected = Rotation.from_quat(q, scalar_first=True).as_matrix()
    assert np.allclose(rotation_from_quaternion(q), expected, atol=1e-12)
    assert np.allclose(rotation_from_quaternion(7 * q), expected, atol=1e-12)


@given(SEEDS, st.sampled_from([0.0, 1e-9, 1e-4, 1.0, np.pi - 1e-4, np.pi - 1e-9, np.pi]))
@settings(max_examples=200, deadline=None)
def test_quaternion_of_a_rotation_is_scipys_up_to_half_turns(seed: int, angle: float) -> None:
    axis = np.random.default_rng(seed).normal(size=3)
    R = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
    q = quaternion_from_rotation(R.as_matrix())
    assert q[0] >= 0
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-12)
    assert abs(q @ R.as_quat(scalar_first=True)) == pytest.approx(1.0, abs=1e-12)  # q and -q are the same rotation


@pytest.mark.parametrize("axis", range(3))
def test_half_turns_about_the_axes(axis: int) -> None:
    R = Rotation.from_rotvec(np.pi * np.eye(3)[axis]).as_matrix().round(15)
    assert np.allclose(np.abs(quaternion_from_rotation(R)), np.eye(4)[axis + 1], atol=1e-12)


def test_pose_maps_points_like_scipy() -> None:
    rng = np.random.default_rng(0)
    q, t, points = rng.normal(size=4), rng.normal(size=3), rng.normal(size=(20, 3))
    expected = Rotation.from_quat(q, scalar_first=True).apply(points) + t
    mapped = np.column_stack([points, np.ones(20)]) @ pose(t, q).T
    assert np.allclose(mapped[:, :3], expected, atol=1e-12)
    assert np.array_equal(pose(), np.eye(4))


def test_pose_inverse_is_the_matrix_inverse_also_of_stacks() -> None:
    rng = np.random.default_rng(1)
    T = np.array([[random_pose(rng) for _ in range(3)] for _ in range(4)])
    assert np.allclose(pose_inverse(T), np.linalg.inv(T), atol=1e-12)
    assert np.allclose(pose_inverse(T[0, 0]), np.linalg.inv(T[0, 0]), atol=1e-12)


def test_corners_of_a_moved_box() -> None:
    rng = np.random.default_rng(2)
    T_other_frame, T_frame_box, half = random_pose(rng), random_pose(rng), rng.uniform(0.01, 0.3, 3)
    found = OrientedBox(T_frame_box, half).moved(T_other_frame).corners()
    expected = corners(T_other_frame @ T_frame_box, half)
    assert {tuple(row) for row in found.round(9)} == {tuple(row) for row in expected.round(9)}


def test_box_is_its_own_cover_and_has_the_volume_of_its_hull() -> None:
    box = Box((0.1, 0.2, 0.4))
    assert isinstance(box, Shape)
    (cover,) = box.boxes()
    assert np.array_equal(cover.T_frame_box, np.eye(4))
    assert np.array_equal(cover.corners(), box.bounding_box().corners())
    assert box.volume() == pytest.approx(ConvexHull(cover.corners()).volume)


@given(SEEDS, st.sampled_from([0.05, 0.3, 0.8]))
@settings(max_examples=150, deadline=None)
def test_separation_is_the_depth_of_the_origin_in_the_minkowski_difference(seed: int, reach: float) -> None:
    # In general position every separating axis of two boxes is a facet normal of their Minkowski difference.
    rng = np.random.default_rng(seed)
    T_a, T_b = random_pose(rng, reach), random_pose(rng, reach)
    half_a, half_b = rng.uniform(0.02, 0.3, 3), rng.uniform(0.02, 0.3, 3)
    difference = (corners(T_b, half_b)[:, None] - corners(T_a, half_a)[None]).reshape(-1, 3)
    expected = ConvexHull(difference).equations[:, 3].max()
    found = box_separation(T_a[None], half_a[None], T_b[None], half_b[None])
    assert found.shape == (1,)
    assert found[0] == pytest.approx(expected, abs=1e-9)


@given(SEEDS, st.booleans(), st.sampled_from([0.1, 0.5]))
@settings(max_examples=150, deadline=None)
def test_separation_bounds_the_distance_and_has_its_sign(seed: int, parallel: bool, reach: float) -> None:
    rng = np.random.default_rng(seed)
    n = 5
    T_a = np.array([random_pose(rng, reach) for _ in range(n)])
    T_b = np.array([random_pose(rng, reach) for _ in range(n)])
    if parallel:  # edges parallel: the cross products vanish
        T_b[:, :3, :3] = T_a[:, :3, :3] @ Rotation.from_rotvec([0, 0, np.pi / 2]).as_matrix()
    half_a, half_b = rng.uniform(0.02, 0.3, (n, 3)), rng.uniform(0.02, 0.3, (n, 3))
    found = box_separation(T_a, half_a, T_b, half_b)
    for i in range(n):
        true = distance(T_a[i], half_a[i], T_b[i], half_b[i])
        assert found[i] <= true + 1e-7
        assert (found[i] > 1e-7) == (true > 1e-7)


@pytest.mark.parametrize("offset", [0.05, 0.0, -0.003])
@pytest.mark.parametrize("axis", range(3))
def test_separation_of_facing_boxes_is_the_gap(axis: int, offset: float) -> None:
    frame = random_pose(np.random.default_rng(3))
    half = np.array([0.01, 0.02, 0.03])
    shift = np.eye(4)
    shift[axis, 3] = 2 * half[axis] + offset
    found = box_separation(frame[None], half[None], (frame @ shift)[None], half[None])
    assert found[0] == pytest.approx(offset, abs=1e-12)


def test_crossed_bars_are_parted_by_an_edge_axis_only() -> None:
    # Two long bars crossing at 45 degrees, both tilted so that only edge x edge parts them.
    half = np.array([0.5, 0.01, 0.01])
    T_a, T_b = np.eye(4), np.eye(4)
    T_a[:3, :3] = Rotation.from_euler("x", 45, degrees=True).as_matrix()
    T_b[:3, :3] = (Rotation.from_euler("z", 70, degrees=True) * Rotation.from_euler("x", 45, degrees=True)).as_matrix()
    T_b[2, 3] = 2 * 0.01 * np.sqrt(2) + 0.004
    found = box_separation(T_a[None], half[None], T_b[None], half[None])[0]
    assert found == pytest.approx(0.004, abs=1e-9)
    assert distance(T_a, half, T_b, half) == pytest.approx(0.004, abs=1e-6)
