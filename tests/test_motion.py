"""Edges, trees and path shortening, against dense sampling on random scenes.

What an edge promises is checked at far more configurations than the edge itself looks at. Whether one configuration
touches anything is taken from the kernels, which `test_kernels.py` holds against MuJoCo.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from ssik.prebuilt import franka_panda_ik

from conftest import random_box, random_configurations, random_rotation, scene_of, world_around, world_of
from takeapart.model.geometry import Array, Box, OrientedBox, pose_inverse
from takeapart.motion.blockers import path_blockers
from takeapart.motion.edges import (
    bisection,
    joint_edge_free,
    project_to_point,
    resampled,
    tool_edge,
    tool_positions,
    waypoints,
)
from takeapart.motion.lifts import lift_rows
from takeapart.motion.rrt import next_random, rrt_connect
from takeapart.motion.scene import Scene, is_free
from takeapart.motion.smooth import shorten
from takeapart.robot.arrays import Flags, HeldArrays
from takeapart.robot.kernels import FREE, check, collect
from takeapart.robot.model import RobotModel

PADDING, STEP, SPACING = 0.0016, 0.001, 0.01  # m
BOXES = 14
ALL = (1 << BOXES) - 1


def a_load(robot: RobotModel, rng: np.random.Generator) -> HeldArrays:
    T = np.eye(4)
    T[:3, :3] = random_rotation(rng)
    return robot.held(0.02, T, Box((float(rng.uniform(0.06, 0.3)), 0.02, 0.02)).boxes())


def random_scenes(robot: RobotModel, count: int, seed: int) -> Iterator[tuple[Scene, np.random.Generator]]:
    """Scenes with boxes all around the arm, each with another load."""
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        yield scene_of(robot, a_load(robot, rng), world_around(robot, BOXES, rng), ALL, BOXES, PADDING), rng


def free_configurations(scene: Scene, robot: RobotModel, count: int, rng: np.random.Generator) -> Array:
    """(count, n) rad."""
    found: list[Array] = []
    while len(found) < count:
        found += [q for q in random_configurations(robot, 50, rng) if is_free(scene, q)]
    return np.array(found[:count])


def touches(scene: Scene, q: Array, padding: float) -> bool:
    return bool(check(scene.arm, scene.held, scene.world, scene.present, padding, q, scene.work) != FREE)


def sampled(rows: Array, spacing: float) -> Iterator[Array]:
    """Configurations along a joint path, none farther from the next than `spacing`, rad."""
    for a, b in pairwise(rows):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / spacing)))
        for k in range(count):
            yield a + (b - a) * k / count
    yield rows[-1]


def tool_of(robot: RobotModel, q: Array) -> Array:
    """Pose of the tool by the inverse kinematics library."""
    return np.asarray(robot.T_world_base @ np.asarray(franka_panda_ik.fk(q)) @ robot.T_flange_tool(0.0))


# ---- edges


def test_accepted_joint_edges_are_free_at_dense_samples(robot: RobotModel) -> None:
    """An edge is proved with half the step of slack: nothing on it comes nearer than the padding less that slack."""
    accepted = rejected = 0
    for scene, rng in random_scenes(robot, 60, 1):
        starts = free_configurations(scene, robot, 8, rng)
        for a in starts:
            b = a + rng.normal(size=robot.joints) * rng.choice([0.03, 0.1, 0.25])
            b = np.clip(b, robot.arm.lower, robot.arm.upper)
            rows = np.array([a, b])
            if joint_edge_free(scene, a, b):
                accepted += 1
                for q in sampled(rows, 0.002):
                    assert not touches(scene, q, PADDING - STEP / 2), (a.tolist(), b.tolist())
            else:
                rejected += 1
                # What is clear by more than the step needs is not refused.
                assert any(touches(scene, q, PADDING + 1.1 * STEP) for q in sampled(rows, 0.0005))
    assert accepted > 100
    assert rejected > 30


@pytest.mark.slow
def test_long_joint_edges_are_free_at_dense_samples(robot: RobotModel) -> None:
    accepted = 0
    for scene, rng in random_scenes(robot, 200, 2):
        configurations = free_configurations(scene, robot, 20, rng)
        for a, b in zip(configurations[::2], configurations[1::2], strict=True):
            b = a + (b - a) * min(1.0, float(rng.uniform(0.3, 1.5)) / float(np.linalg.norm(b - a)))
            if joint_edge_free(scene, a, b):
                accepted += 1
                for q in sampled(np.array([a, b]), 0.002):
                    assert not touches(scene, q, PADDING - STEP / 2), (a.tolist(), b.tolist())
    assert accepted > 300


def straight_edges(robot: RobotModel, scenes: int, seed: int) -> Iterator[tuple[Scene, Array, Array, Array]]:
    """Accepted tool-straight edges: scene, ends a and b, rows (R, n)."""
    for scene, rng in random_scenes(robot, scenes, seed):
        for a in free_configurations(scene, robot, 12, rng):
            b = np.clip(a + rng.normal(size=robot.joints) * rng.choice([0.1, 0.3]), robot.arm.lower, robot.arm.upper)
            rows = np.empty((4096, robot.joints))
            count = tool_edge(scene, a, b, SPACING, rows)
            if count:
                yield scene, a, b, rows[:count].copy()


def test_tool_edges_are_straight_for_the_tool_and_end_where_they_should(robot: RobotModel) -> None:
    edges = 0
    for _, a, b, rows in straight_edges(robot, 20, 3):
        edges += 1
        np.testing.assert_array_equal(rows[-1], b)
        assert (rows >= robot.arm.lower).all() and (rows <= robot.arm.upper).all()
        start, end = tool_of(robot, a)[:3, 3], tool_of(robot, b)[:3, 3]
        length = np.linalg.norm(end - start)
        along = (end - start) / length
        positions = np.array([tool_of(robot, q)[:3, 3] for q in [a, *rows]]) - start
        off = positions - np.outer(positions @ along, along)
        assert np.linalg.norm(off, axis=1).max() < 1e-6
        assert (np.diff(positions @ along) > -1e-6).all(), "the tool turns back on its line"
        assert np.linalg.norm(np.diff(positions, axis=0), axis=1).sum() == pytest.approx(length, abs=1e-5)
    assert edges > 50


def test_tool_edges_are_free_at_ten_times_finer_samples(robot: RobotModel) -> None:
    edges = 0
    for scene, a, _, rows in straight_edges(robot, 20, 4):
        edges += 1
        path = np.concatenate([a[None], rows])
        for before, after in pairwise(path):
            for s in np.linspace(0, 1, 11):
                assert not touches(scene, before + s * (after - before), PADDING - STEP / 2)
    assert edges > 50


def test_tool_edge_refuses_a_wall_in_its_way(robot: RobotModel) -> None:
    held, q = robot.held(0.02), np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
    nothing = world_of(robot, [(OrientedBox(np.eye(4) + 9 * np.eye(4, k=3), np.full(3, 0.01)), 0)])
    open_scene = scene_of(robot, held, nothing, 1, 1, PADDING)
    rows = np.empty((4096, robot.joints))
    a, b = q.copy(), q.copy()
    a[0], b[0] = -0.5, 0.5
    count = tool_edge(open_scene, a, b, SPACING, rows)
    assert count > 10
    middle = robot.tool_pose(rows[count // 2 - 1])
    wall = np.eye(4)
    wall[:3, 3] = middle[:3, 3]
    walled = scene_of(
        robot, held, world_of(robot, [(OrientedBox(wall, np.array([0.05, 0.002, 0.05])), 0)]), 1, 1, PADDING
    )
    assert is_free(walled, a) and is_free(walled, b)
    assert tool_edge(walled, a, b, SPACING, rows) == 0
    assert not joint_edge_free(walled, a, b)
    absent = scene_of(robot, held, walled.world, 0, 1, PADDING)
    assert tool_edge(absent, a, b, SPACING, rows) == count


def test_project_to_point_moves_the_tool_there_and_no_farther_than_needed(robot: RobotModel) -> None:
    rng = np.random.default_rng(5)
    scene = scene_of(robot, robot.held(0.02), world_around(robot, BOXES, rng), 0, BOXES, PADDING)
    done = 0
    for start in random_configurations(robot, 200, rng):
        target = robot.tool_pose(start)[:3, 3] + rng.normal(size=3) * 0.02
        q = start.copy()
        if project_to_point(scene, q, *target):
            done += 1
            np.testing.assert_allclose(tool_of(robot, q)[:3, 3], target, atol=1e-6)
            assert (q >= robot.arm.lower).all() and (q <= robot.arm.upper).all()
            assert np.linalg.norm(q - start) < 1.5
    assert done > 120


# ---- what a motion would hit


def owners_hit(scene: Scene, rows: Array, padding: float, spacing: float) -> tuple[Flags, bool]:
    """Owners that dense samples of a joint path touch, and whether the arm touches itself on it."""
    hits = np.zeros(len(scene.present), dtype=np.uint8)
    clear = True
    for q in sampled(rows, spacing):
        clear &= collect(scene.arm, scene.held, scene.world, scene.present, padding, q, scene.work, hits)
    return hits, not clear


def near_path(scene: Scene, robot: RobotModel, rng: np.random.Generator) -> Array:
    """(M, n) rad: a joint path with rows as near as those of a removal."""
    a = random_configurations(robot, 1, rng)[0]
    b = np.clip(a + rng.normal(size=robot.joints) * 0.25, robot.arm.lower, robot.arm.upper)
    return np.asarray(resampled(scene, np.array([a, b]), SPACING, False))


def test_path_blockers_mark_all_that_dense_samples_hit_and_nothing_that_is_clear(robot: RobotModel) -> None:
    paths = marked = 0
    for scene, rng in random_scenes(robot, 60, 6):
        for _ in range(2):
            rows = near_path(scene, robot, rng)
            hits = np.zeros(BOXES + 1, dtype=np.uint8)
            if not path_blockers(scene, rows, hits):
                assert owners_hit(scene, rows, PADDING + 0.6 * STEP, 0.002)[1], (
                    "refused though the arm is clear of itself"
                )
                continue
            paths += 1
            found, itself = owners_hit(scene, rows, PADDING, 0.001)
            assert not itself
            assert not (found & ~hits).any(), (rows[0].tolist(), rows[-1].tolist())
            widest, _ = owners_hit(scene, rows, PADDING + 0.6 * STEP, 0.001)
            assert not (hits & ~widest).any(), "marked though clear"
            marked += int(hits.sum())
    assert paths > 40
    assert marked > 40


def test_path_blockers_refuse_what_never_leaves(robot: RobotModel) -> None:
    refused = 0
    for scene, rng in random_scenes(robot, 30, 7):
        owner = scene.world.owner.copy()
        owner[:] = BOXES  # the number of parts: what never leaves
        fixed = scene._replace(world=scene.world._replace(owner=owner))
        rows = near_path(scene, robot, rng)
        hits, fixed_hits = np.zeros(BOXES + 1, dtype=np.uint8), np.zeros(BOXES + 1, dtype=np.uint8)
        if path_blockers(scene, rows, hits):
            assert path_blockers(fixed, rows, fixed_hits) == (not hits.any())
            refused += bool(hits.any())
    assert refused > 5


# ---- lifting


def upwards(height: float, steps: int) -> Array:
    motion = np.zeros((steps + 1, 3, 4))
    motion[:, :3, :3] = np.eye(3)
    motion[:, 2, 3] = np.linspace(0.0, height, steps + 1)
    return motion


def test_lift_rows_turn_the_tool_about_any_axis_of_the_world(robot: RobotModel) -> None:
    rng = np.random.default_rng(18)
    scene = scene_of(robot, robot.held(0.02), world_around(robot, BOXES, rng), 0, BOXES, PADDING)
    followed = 0
    for q in random_configurations(robot, 60, rng):
        start, axis, steps = tool_of(robot, q), rng.normal(size=3), 20
        axis /= np.linalg.norm(axis)
        motion = np.zeros((steps + 1, 3, 4))
        for k in range(
            steps + 1
        ):  # a screw about an axis through a point 5 cm off the tool, 1 mm along it in each step
            R = Rotation.from_rotvec(axis * 0.004 * k).as_matrix()
            middle = start[:3, 3] + [0.05, 0.0, 0.0]
            motion[k] = np.column_stack([R, middle - R @ middle + 0.001 * k * axis])
        rows = np.empty((steps + 1, robot.joints))
        if not lift_rows(scene, q, motion, rows):
            continue
        followed += 1
        for M, row in zip(motion, rows, strict=True):
            np.testing.assert_allclose(
                tool_of(robot, row)[:3], M[:, :3] @ start[:3] + M[:, 3:] * [0, 0, 0, 1], atol=1e-7
            )
    assert followed > 20


def test_lift_rows_go_straight_up_and_do_not_turn(robot: RobotModel) -> None:
    rng = np.random.default_rng(8)
    scene = scene_of(robot, robot.held(0.02), world_around(robot, BOXES, rng), 0, BOXES, PADDING)
    lifted = 0
    for q in random_configurations(robot, 150, rng):
        rows = np.empty((11, robot.joints))
        if not lift_rows(scene, q, upwards(0.05, 10), rows):
            continue
        lifted += 1
        np.testing.assert_array_equal(rows[0], q)
        assert (rows >= robot.arm.lower).all() and (rows <= robot.arm.upper).all()
        start = tool_of(robot, q)
        for k, row in enumerate(rows):
            expected = start.copy()
            expected[2, 3] += 0.005 * k
            np.testing.assert_allclose(tool_of(robot, row), expected, atol=1e-7)
        assert np.abs(np.diff(rows, axis=0)).max() <= 0.025 + 1e-9
        # Between two rows the tool bends off the line by no more than what a check's step covers.
        for before, after in pairwise(rows):
            between = tool_of(robot, (before + after) / 2)
            assert np.linalg.norm(between[:2, 3] - start[:2, 3]) < 5e-4
            turn = between[:3, :3] @ start[:3, :3].T
            assert np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)) < 5e-3
    assert lifted > 60


def test_lift_rows_refuse_a_stretched_arm(robot: RobotModel) -> None:
    scene = scene_of(robot, robot.held(0.02), world_around(robot, BOXES, np.random.default_rng(9)), 0, BOXES, PADDING)
    stretched = np.array([0.0, 0.0, 0.0, float(robot.arm.upper[3]), 0.0, 1.9, 0.8])
    assert tool_of(robot, stretched)[2, 3] > robot.T_world_base[2, 3] + 0.9
    assert not lift_rows(scene, stretched, upwards(0.3, 60), np.empty((61, robot.joints)))


# ---- trees and shortening


def test_rrt_connect_joins_a_start_to_a_goal_by_free_edges(robot: RobotModel) -> None:
    solved = 0
    for scene, rng in random_scenes(robot, 15, 10):
        ends = free_configurations(scene, robot, 6, rng)
        starts, goals = ends[:3], ends[3:]
        corners = rrt_connect(scene, starts, goals, 600, 0.4, 1)
        if not len(corners):
            continue
        solved += 1
        assert any(np.array_equal(corners[0], start) for start in starts)
        assert any(np.array_equal(corners[-1], goal) for goal in goals)
        assert (corners >= robot.arm.lower).all() and (corners <= robot.arm.upper).all()
        assert not any(touches(scene, q, PADDING - STEP / 2) for q in sampled(corners, 0.004))
        np.testing.assert_array_equal(corners, rrt_connect(scene, starts, goals, 600, 0.4, 1))
    assert solved >= 8


def test_rrt_connect_goes_around_a_wall(robot: RobotModel) -> None:
    """Both ends are free and a way over the wall is known, but the straight joint motion runs into it."""
    held = robot.held(0.02)
    base = robot.T_world_base[:3, 3]
    T = np.eye(4)
    T[:3, 3] = base + [0.45, 0.0, 0.1]
    world = world_of(robot, [(OrientedBox(T, np.array([0.2, 0.01, 0.3])), 0)])
    scene = scene_of(robot, held, world, 1, 1, PADDING)
    a = np.array([-0.6, 0.3, 0.0, -2.0, 0.0, 2.3, 0.785])
    b = a.copy()
    b[0] = 0.6
    over = np.array([[-0.6, -0.6, 0.0, -1.2, 0.0, 1.571, 0.785], [0.6, -0.6, 0.0, -1.2, 0.0, 1.571, 0.785]])
    assert is_free(scene, a) and not joint_edge_free(scene, a, b)
    known = np.concatenate([a[None], over, b[None]])
    assert not any(touches(scene, q, PADDING) for q in sampled(known, 0.01)), "the known way must be free"
    solved = [rrt_connect(scene, a[None], b[None], 3000, 0.4, seed) for seed in range(8)]
    assert all(len(corners) >= 3 for corners in solved)
    assert len({corners.tobytes() for corners in solved}) > 1, "the seed must matter"
    for corners in solved:
        assert not any(touches(scene, q, PADDING - STEP / 2) for q in sampled(corners, 0.004))


def test_rrt_connect_gives_up_where_there_is_no_way(robot: RobotModel) -> None:
    """The goal stands in a box: whatever the tree does, its last edge is not free."""
    q = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
    goal = q.copy()
    goal[0] = 1.0
    T = robot.tool_pose(goal)
    scene = scene_of(robot, robot.held(0.02), world_of(robot, [(OrientedBox(T, np.full(3, 0.05)), 0)]), 1, 1, PADDING)
    assert is_free(scene, q) and not is_free(scene, goal)
    assert rrt_connect(scene, q[None], goal[None], 200, 0.4, 1).shape == (0, robot.joints)


def tool_length(robot: RobotModel, rows: Array) -> float:
    return float(np.linalg.norm(np.diff([tool_of(robot, q)[:3, 3] for q in rows], axis=0), axis=1).sum())


def test_shortening_keeps_ends_and_freedom_and_never_lengthens(robot: RobotModel) -> None:
    shortened = 0
    for scene, rng in random_scenes(robot, 14, 12):
        ends = free_configurations(scene, robot, 6, rng)
        corners = rrt_connect(scene, ends[:3], ends[3:], 600, 0.4, 3)
        if not len(corners):
            continue
        rows = waypoints(scene, corners, SPACING)
        after = shorten(scene, rows, 1e-3, 80, SPACING, np.inf, 40, 5)
        np.testing.assert_array_equal(after[[0, -1]], rows[[0, -1]])
        before_length, length = tool_length(robot, rows), tool_length(robot, after)
        assert length <= before_length + 1e-6
        straight = np.linalg.norm(tool_of(robot, rows[-1])[:3, 3] - tool_of(robot, rows[0])[:3, 3])
        assert length >= straight - 1e-6
        assert (after >= robot.arm.lower).all() and (after <= robot.arm.upper).all()
        assert not any(touches(scene, q, PADDING - STEP / 2) for q in sampled(after, 0.004))
        np.testing.assert_array_equal(after, shorten(scene, rows, 1e-3, 80, SPACING, np.inf, 40, 5))
        shortened += length < 0.9 * before_length
    assert shortened >= 5


def test_shortening_in_open_space_reaches_the_straight_line(robot: RobotModel) -> None:
    held = robot.held(0.02)
    far = world_of(robot, [(OrientedBox(np.eye(4) + 9 * np.eye(4, k=3), np.full(3, 0.01)), 0)])
    scene = scene_of(robot, held, far, 1, 1, PADDING)
    home = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
    corners = home + np.array([[-0.4, 0, 0, 0, 0, 0, 0], [-0.1, -0.5, 0, 0.4, 0, 0, 0], [0.4, 0.2, 0, 0.1, 0, 0, 0]])
    rows = waypoints(scene, corners, SPACING)
    after = shorten(scene, rows, 1e-3, 160, SPACING, np.inf, 48, 1)
    straight = float(np.linalg.norm(robot.tool_pose(corners[2])[:3, 3] - robot.tool_pose(corners[0])[:3, 3]))
    assert tool_length(robot, rows) > 1.1 * straight
    assert tool_length(robot, after) == pytest.approx(straight, abs=2e-4)


def test_bisection_visits_every_piece_once_and_spreads_out() -> None:
    for count in (1, 2, 8, 64):
        order = [bisection(count - 1 - k, count) for k in range(count)]
        assert sorted(order) == list(range(count))
    assert {bisection(7 - k, 8) // 4 for k in range(2)} == {0, 1}  # one from each half


def test_straightened_rows_shorten_the_tool_path_and_keep_its_corners(robot: RobotModel) -> None:
    rng = np.random.default_rng(15)
    gained = 0
    for scene, _ in random_scenes(robot, 5, 16):
        base = random_configurations(robot, 1, rng)[0] * 0.5
        corners = base + 0.08 * rng.normal(size=(3, robot.joints))
        plain, straight = (resampled(scene, corners, SPACING, straighten) for straighten in (False, True))
        assert tool_length(robot, straight) <= tool_length(robot, plain) + 1e-9
        gained += tool_length(robot, straight) < tool_length(robot, plain) - 1e-6
        for corner in corners:
            assert np.abs(straight - corner).sum(axis=1).min() < 1e-12
    assert gained


def test_dense_rows_are_near_and_on_the_path(robot: RobotModel) -> None:
    rng = np.random.default_rng(13)
    for scene, _ in random_scenes(robot, 5, 14):
        corners = random_configurations(robot, 3, rng) * 0.3 + 0.7 * np.array(
            [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]
        )
        rows = resampled(scene, corners, SPACING, False)
        for corner in corners:
            assert np.abs(rows - corner).sum(axis=1).min() < 1e-12
        first, second = corners[1] - corners[0], corners[2] - corners[1]
        for q in rows:
            off = [
                np.linalg.norm((q - start) - np.clip((q - start) @ edge / (edge @ edge), 0, 1) * edge)
                for start, edge in ((corners[0], first), (corners[1], second))
            ]
            assert min(off) < 1e-9
        poses = [robot.tool_pose(q) for q in rows]
        load = [Box((0.04, 0.02, 0.02)).boxes()[0].moved(T).corners() for T in poses]
        assert np.linalg.norm(np.diff(load, axis=0), axis=2).max() <= SPACING


def test_tool_positions_and_their_length(robot: RobotModel) -> None:
    rng = np.random.default_rng(15)
    scene = scene_of(robot, robot.held(0.02), world_around(robot, BOXES, rng), 0, BOXES, PADDING)
    rows = random_configurations(robot, 20, rng)
    points = np.empty((20, 3))
    length = tool_positions(scene, rows, 20, points)
    np.testing.assert_allclose(points, [tool_of(robot, q)[:3, 3] for q in rows], atol=1e-9)
    assert length == pytest.approx(tool_length(robot, rows), abs=1e-9)


def test_random_numbers_are_uniform_and_follow_the_seed() -> None:
    state = np.array([42], dtype=np.uint64)
    draw: Callable[..., float] = next_random
    drawn = np.array([draw(state) for _ in range(20_000)])
    assert (drawn >= 0).all() and (drawn < 1).all()
    counts = np.histogram(drawn, bins=20, range=(0, 1))[0]
    assert ((counts - 1000) ** 2 / 1000).sum() < 45  # chi squared with 19 degrees of freedom: 1 in 1000
    assert abs(np.corrcoef(drawn[:-1], drawn[1:])[0, 1]) < 0.03
    again = np.array([42], dtype=np.uint64)
    assert [draw(again) for _ in range(5)] == drawn[:5].tolist()


def test_random_boxes_of_these_tests_are_boxes() -> None:
    box = random_box(np.random.default_rng(16), np.zeros(3), np.ones(3), 0.01, 0.1)
    np.testing.assert_allclose(pose_inverse(box.T_frame_box) @ box.T_frame_box, np.eye(4), atol=1e-12)
