"""Grasps, lifting, masks and the removal planner, against brute force in single states."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from conftest import Edge, random_box, random_rotation, random_states, scene_of
from takeapart.formats.files import data_path, load_assembly
from takeapart.model.assembly import Assembly, Part, members
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, Box, OrientedBox, pose, pose_inverse
from takeapart.motion.edges import Scene, resampled
from takeapart.removal.goals import super_fibonacci
from takeapart.removal.grasps import grasp_candidates, grasp_positions, straight_line_bounds
from takeapart.removal.lifting import lift_blockers
from takeapart.removal.planner import RemovalOptions, RemovalPlanner
from takeapart.removal.result import Blocked, Removal
from takeapart.removal.situation import Situation
from takeapart.robot.kernels import FREE, check
from takeapart.robot.model import RobotModel
from takeapart.states import flags_of, state_of
from takeapart.verification.model import Scene as MujocoScene
from takeapart.workcell import Workcell

# ---- grasps


def test_grasps_stand_every_two_centimetres_from_three_off_the_ends() -> None:
    np.testing.assert_allclose(grasp_positions(0.40), np.arange(0.03, 0.3701, 0.02))
    np.testing.assert_allclose(grasp_positions(0.08), [0.03, 0.05])
    np.testing.assert_allclose(grasp_positions(0.06), [0.03])
    np.testing.assert_allclose(grasp_positions(0.05), [0.025])
    for length in np.random.default_rng(1).uniform(0.06, 1.0, 200):
        positions = grasp_positions(length)
        assert positions[0] == pytest.approx(0.03) and positions[-1] <= length - 0.03 + 1e-6
        assert length - 0.03 - positions[-1] < 0.02
        np.testing.assert_allclose(np.diff(positions), 0.02)


def test_a_length_that_went_through_32_bit_floats_has_the_same_grasps() -> None:
    for length in np.arange(6, 120) / 100:
        expected = grasp_positions(length)
        for rounded in (float(np.float32(length)), 2 * float(np.float32(length / 2))):
            np.testing.assert_allclose(grasp_positions(rounded), expected, atol=1e-7)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_grasps_come_from_all_four_sides_in_both_finger_orders(axis: int) -> None:
    size = np.full(3, 0.02)
    size[axis] = 0.40
    part = Part(
        "bar", Box((float(size[0]), float(size[1]), float(size[2]))), pose([0.3, 0.1, 0.2], [0.5, 0.1, -0.7, 0.2]), 1.0
    )
    found = grasp_candidates(part, 0.08)
    assert len(found) == 18 * 4 * 2
    along = np.eye(3)[axis]
    by_place: dict[float, set[tuple[int, ...]]] = {}
    for grasp in found:
        T = grasp.T_part_tool
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(T[:3, :3]) > 0
        assert grasp.width == pytest.approx(0.02)
        approach, closing = T[:3, 2], T[:3, 1]
        assert abs(approach @ along) < 1e-12 and abs(closing @ along) < 1e-12
        np.testing.assert_allclose(T[:3, 3], (T[:3, 3] @ along) * along, atol=1e-12)
        key = round(float(T[:3, 3] @ along), 6)
        by_place.setdefault(key, set()).add(tuple(np.rint(np.concatenate([approach, closing])).astype(int).tolist()))
    np.testing.assert_allclose(sorted(by_place), np.arange(0.03, 0.3701, 0.02) - 0.2)
    assert all(len(orientations) == 8 for orientations in by_place.values())


def test_grasps_wider_than_the_gripper_are_left_out() -> None:
    part = Part("plate", Box((0.3, 0.2, 0.02)), np.eye(4), 1.0)
    found = grasp_candidates(part, 0.08)
    assert {grasp.width for grasp in found} == {0.02}
    assert all(abs(grasp.T_part_tool[2, 1]) == 1 for grasp in found)  # the fingers close across the thin side
    assert not grasp_candidates(Part("cube", Box((0.3, 0.2, 0.1)), np.eye(4), 1.0), 0.08)


def test_straight_line_bound_is_up_and_then_straight() -> None:
    part = Part("bar", Box((0.4, 0.02, 0.02)), pose([1.0, 2.0, 3.0]), 1.0)
    grasp = grasp_candidates(part, 0.08)[0]
    start = np.array([1.0 - 0.2 + 0.03, 2.0, 3.0])
    goal = np.array([0.5, -0.4, 2.0])
    expected = 0.05 + math.dist(start + [0, 0, 0.05], goal)
    assert straight_line_bounds(part, [grasp], 0.05, goal)[0] == pytest.approx(expected)


# ---- masks and lifting


def test_states_and_flags_are_the_same_thing() -> None:
    rng = np.random.default_rng(2)
    for parts in (1, 7, 8, 9, 40, 64, 65):
        for _ in range(20):
            state = sum(1 << i for i in range(parts) if rng.random() < 0.5)
            flags = flags_of(state, parts)
            assert flags.tolist() == [state >> i & 1 for i in range(parts)] + [1]
            assert state_of(flags) == state


def corners_span(box: OrientedBox) -> Array:
    """(2, 3) lower and upper corner; exact for boxes that are parallel to the axes."""
    points = box.corners()
    return np.array([points.min(axis=0), points.max(axis=0)])


def test_lifting_of_profiles_agrees_with_sampled_heights(assembly: Assembly, workcell: Workcell) -> None:
    """All boxes are parallel to the axes here, so comparing intervals is exact; 251 heights up to 5 cm."""
    clearance = 0.0016
    obstacles = tuple(obstacle.box for obstacle in workcell.environment)
    found = lift_blockers(assembly, 0.05, clearance, obstacles)
    spans: list[list[Array]] = [
        [corners_span(box.moved(part.T_world_part)) for box in assembly.body(i)]
        for i, part in enumerate(assembly.parts)
    ]
    table = [corners_span(box) for box in obstacles]
    for i, part in enumerate(assembly.parts):
        hit, stuck = 0, part.fixed
        for k in range(len(assembly.parts) + 1):
            others = table if k == len(assembly.parts) else spans[k]
            if k != i and any(rises_into(mine, other, clearance) for mine in spans[i] for other in others):
                permanent = k == len(assembly.parts) or assembly.parts[k].fixed
                stuck, hit = stuck or permanent, hit if permanent else hit | 1 << k
        assert found[i] == (None if stuck else hit), part.name
    assert any(mask for mask in found if mask) and any(mask == 0 for mask in found)


def rises_into(mine: Array, other: Array, clearance: float) -> bool:
    if (np.minimum(mine[1], other[1]) - np.maximum(mine[0], other[0]))[:2].min() <= -clearance:
        return False
    moved = mine + np.linspace(0, 0.05, 251)[:, None, None] * [0, 0, 1]  # (heights, 2, 3)
    overlap = np.minimum(moved[:, 1], other[1]) - np.maximum(moved[:, 0], other[0])
    return bool((overlap.min(axis=1) > 1e-4).any() or overlap[-1].min() > -clearance + 1e-9)


def overlap_at(box: OrientedBox, other: OrientedBox, height: float, grown: float) -> bool:
    """Whether a lifted box, grown by `grown` on every side, meets another: least squares over the points of both."""
    A = np.column_stack([box.T_frame_box[:3, :3], -other.T_frame_box[:3, :3]])
    offset = other.T_frame_box[:3, 3] - box.T_frame_box[:3, 3] - [0, 0, height]
    bound = np.concatenate([box.half_extents + grown, other.half_extents])
    return float(np.linalg.norm(A @ lsq_linear(A, offset, (-bound, bound), method="bvls").x - offset)) < 1e-9


def test_lifting_of_turned_boxes_agrees_with_sampled_heights() -> None:
    hits = misses = 0
    for seed in range(12):
        rng = np.random.default_rng([3, seed])
        parts: list[Part] = []
        while len(parts) < 7:
            box = random_box(rng, np.zeros(3), np.array([0.25, 0.25, 0.2]), 0.01, 0.05)
            size = 2 * box.half_extents
            part = Part(f"p{len(parts)}", Box((float(size[0]), float(size[1]), float(size[2]))), box.T_frame_box, 1.0)
            if not any(overlap_at(box, p.shape.boxes()[0].moved(p.T_world_part), 0.0, 0.001) for p in parts):
                parts.append(part)
        assembly = Assembly("turned", tuple(parts))
        boxes = [part.shape.boxes()[0].moved(part.T_world_part) for part in parts]
        for i, mask in enumerate(lift_blockers(assembly, 0.05, 0.0, ())):
            assert mask is not None
            for k in range(len(parts)):
                if k == i:
                    continue
                offset = boxes[k].T_frame_box[:2, 3] - boxes[i].T_frame_box[:2, 3]
                if np.hypot(*offset) > sum(np.linalg.norm(boxes[m].half_extents) for m in (i, k)) + 0.002:
                    assert not mask >> k & 1  # far aside
                    continue
                heights = np.linspace(0, 0.05, 26)
                deep = any(overlap_at(boxes[i], boxes[k], h, -0.0003) for h in heights)
                near = any(overlap_at(boxes[i], boxes[k], h, 0.0015) for h in heights)  # covers 2 mm between samples
                assert not deep or mask >> k & 1
                assert near or not mask >> k & 1
                hits, misses = hits + deep, misses + (not near)
    assert hits > 14 and misses > 50


@pytest.mark.parametrize(("overlap", "hit"), [(-2e-4, False), (5e-5, False), (2e-4, True), (1e-3, True)])
@pytest.mark.parametrize("turn", [0.0, 0.6])
def test_on_its_way_up_a_part_may_slide_along_others_and_not_cut_into_them(
    overlap: float, hit: bool, turn: float
) -> None:
    """A ledge that the bar has passed at the end of the lift: a tenth of a millimetre is contact, more is a hit."""
    R = np.eye(4)
    R[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    ledge = R @ pose((0.02 - overlap, 0.0, 0.03 + 0.001))
    parts = (Part("bar", Box((0.02, 0.02, 0.02)), R, 0.1), Part("ledge", Box((0.02, 0.02, 0.002)), ledge, 0.1))
    assert lift_blockers(Assembly("ledge", parts), 0.05, 0.0, ())[0] == (0b10 if hit else 0)


@pytest.mark.parametrize(
    ("gap", "below", "hit"),
    [
        (0.0009, 0.003, True),  # a lip that starts above the bar, in the open
        (0.0012, 0.003, False),
        (0.0009, -0.01, False),  # a wall that stands beside the bar from the start on, and along all of its way
        (0.0002, 0.003, True),
        (-0.00009, 0.003, True),
        (-0.00009, -0.01, False),  # what overlaps at the start by a rounding
    ],
)
def test_on_its_way_up_a_part_keeps_the_clearance_from_all_that_it_does_not_touch_at_the_start(
    gap: float, below: float, hit: bool
) -> None:
    """A box that begins `below` the bar's upper side plus as much, m, beside the bar's way."""
    bar = Part("bar", Box((0.02, 0.02, 0.02)), pose((0.0, 0.0, 0.0)), 0.1)
    low = 0.01 + below
    high = low + 0.015 if below > 0 else 0.2
    side = pose((0.02 + gap, 0.0, (low + high) / 2))
    parts = (bar, Part("side", Box((0.02, 0.02, high - low)), side, 0.1))
    for turn in (0.0, 0.7):
        R = pose((0.0, 0.0, 0.0), (np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2)))
        turned = tuple(replace(part, T_world_part=R @ part.T_world_part) for part in parts)
        found = lift_blockers(Assembly("side", turned), 0.05, -1e-3, (), passing=0.001)[0]
        assert found == (0b10 if hit else 0)


def test_the_lifted_part_keeps_its_distance_at_the_end_of_the_lift() -> None:
    for gap, hit in ((0.0010, True), (0.0022, False)):
        side = Part("side", Box((0.02, 0.02, 0.02)), pose((0.02 + gap, 0.0, 0.05)), 0.1)
        parts = (Part("bar", Box((0.02, 0.02, 0.02)), pose((0.0, 0.0, 0.0)), 0.1), side)
        assert lift_blockers(Assembly("side", parts), 0.05, 0.0016, ())[0] == (0b10 if hit else 0)


def test_nothing_is_lifted_through_what_never_leaves() -> None:
    low, high = Part("low", Box((0.2, 0.02, 0.02)), pose([0, 0, 0.1]), 1.0), pose([0, 0, 0.14])
    assert lift_blockers(Assembly("a", (low, Part("high", Box((0.02, 0.2, 0.02)), high, 1.0))), 0.05, 0.001, ()) == [
        2,
        0,
    ]
    fixed = Assembly("a", (low, Part("high", Box((0.02, 0.2, 0.02)), high, 1.0, True)))
    assert lift_blockers(fixed, 0.05, 0.001, ()) == [None, None]
    alone = Assembly("a", (low,))
    shelf = OrientedBox(pose([0, 0, 0.162]), np.array([0.1, 0.1, 0.001]))
    assert lift_blockers(alone, 0.05, 0.001, (shelf,)) == [None]
    assert lift_blockers(alone, 0.0500, 0.0005, (OrientedBox(pose([0, 0, 0.162]), np.array([0.1, 0.1, 0.0005])),)) == [
        0
    ]


# ---- masks of grasps, lifts and removals


@cache
def cached_branches(planner: RemovalPlanner) -> list[tuple[int, int]]:
    """Part and grasp number of grasps that the arm can reach, over all parts."""
    rng, work = np.random.default_rng(4), planner.robot.workspace(64)
    found = []
    for part in members(planner.assembly.root):
        numbers = rng.permutation(len(planner.reach.candidates(part)))[:14]
        found += [(part, int(n)) for n in numbers if planner.reach.branches(part, int(n), 0, work)]
    return found


def rows_touch(scene: Scene, rows: Array, padding: float, spacing: float) -> bool:
    """Whether any of dense samples along a joint path touches anything."""
    for a, b in pairwise(rows):
        for s in np.linspace(0, 1, max(2, int(np.ceil(np.linalg.norm(b - a) / spacing)) + 1)):
            q = a + s * (b - a)
            if check(scene.arm, scene.held, scene.world, scene.present, padding, q, scene.work) != FREE:
                return True
    return False


PADDING = 0.0016  # m, of the default workcell and options: clearance 1 mm, half a step, planning margin


def test_branch_masks_equal_fresh_checks_in_random_states(planner: RemovalPlanner) -> None:
    """500 random states: a lift is valid by its mask exactly if nothing is hit in that state."""
    rng, work = np.random.default_rng(5), planner.robot.workspace(64)
    grasps = cached_branches(planner)
    assert len({part for part, _ in grasps}) > 10
    valid = invalid = unsure = 0
    for state in random_states(planner.assembly, 500, rng):
        part, number = grasps[int(rng.integers(len(grasps)))]
        hand = planner.reach.hands(part, work)[number]
        branches = planner.reach.branches(part, number, 0, work)
        branch = branches[int(rng.integers(len(branches)))]
        others = state & ~(1 << part)
        scene = scene_of(planner.robot, hand.held, planner.world, others, len(planner.assembly.parts), PADDING)
        fingers = hand.held.meets_world.copy()
        fingers[hand.held.group[1] :] = 0  # while it is lifted, the part itself is the business of `lift_blockers`
        lifting = scene._replace(held=hand.held._replace(meets_world=fingers))
        end = branch.rows[-1:].repeat(2, axis=0)
        touched = rows_touch(lifting, branch.rows, PADDING, 0.002) or rows_touch(scene, end, PADDING, 1)
        close = rows_touch(lifting, branch.rows, PADDING + 0.0006, 0.002) or rows_touch(scene, end, PADDING + 1e-6, 1)
        by_mask = not branch.blockers & others
        assert not (by_mask and touched), (part, number, bin(state))
        assert by_mask or close, (part, number, bin(state))
        valid, invalid, unsure = valid + (not close), invalid + touched, unsure + (close and not touched)
    assert valid > 100 and invalid > 100
    assert unsure < 25


def test_hand_masks_equal_fresh_checks_in_random_states(planner: RemovalPlanner) -> None:
    """What the hand's mask refuses, every branch refuses; and in each state it refuses by bodies of the hand alone."""
    rng, work = np.random.default_rng(6), planner.robot.workspace(64)
    oracle = MujocoScene(planner.assembly, planner.workcell, 0.05)
    gripper = planner.workcell.description.gripper
    carried = {"panda_link7", gripper.base_link, *gripper.finger_links}
    parts = members(planner.assembly.root)
    valid = invalid = 0
    for state in random_states(planner.assembly, 500, rng):
        part = int(rng.choice(parts))
        number = int(rng.integers(len(planner.reach.candidates(part))))
        hand = planner.reach.hands(part, work)[number]
        branches = planner.reach.branches(part, number, 0, work)
        others = state & ~(1 << part)
        if not branches or hand.blockers is None:
            continue
        for branch in branches:
            assert not hand.blockers & ~branch.blockers
        # MuJoCo, with the exact meshes: fingers, palm and wrist at the start, the part as well after the lift.
        branch = branches[0]
        oracle.show(others | 1 << part, part)
        oracle.grip(pose_inverse(hand.candidate.T_part_tool), hand.candidate.width)
        hit = 0
        for row, bodies in (
            (branch.rows[0], carried),
            (branch.rows[-1], carried | {f"held/{planner.assembly.parts[part].name}"}),
        ):
            oracle.place(row)
            pairs, distances = oracle.near()
            for (a, b), distance in zip(pairs.tolist(), distances.tolist(), strict=True):
                names = {oracle.label(a), oracle.label(b)}
                static = [name for name in names if name.startswith("part/")]
                if static and names & bodies and distance < 0.001 - 1e-6 and oracle.distance(a, b) < 0.001 - 1e-6:
                    number_hit = planner.assembly.index[static[0].removeprefix("part/")]
                    assert not planner.assembly.parts[number_hit].fixed
                    hit |= 1 << number_hit
        assert not hit & ~hand.blockers, (part, number, bin(state), bin(hit))
        valid += not hand.blockers & others
        invalid += bool(hand.blockers & others)
    assert valid > 50 and invalid > 50


@cache
def known_removals(planner: RemovalPlanner, edges: tuple[Edge, ...]) -> list[tuple[Edge, Removal]]:
    found = []
    for k, edge in enumerate(edges):
        answer = planner.plan(edge.part, edge.state, rng=np.random.default_rng(k))
        if isinstance(answer, Removal):
            found.append((edge, answer))
    return found


def test_removals_hold_what_they_promise(planner: RemovalPlanner, edges: list[Edge]) -> None:
    removals = known_removals(planner, tuple(edges))
    assert len(removals) > 12
    cell = planner.workcell
    for edge, removal in removals:
        assert removal.part == edge.part and removal.valid_in(edge.state & ~(1 << edge.part))
        assert not removal.blockers >> edge.part & 1
        rows, poses = removal.joint_path, removal.tool_path
        assert len(rows) == len(poses)
        assert (rows >= planner.robot.arm.lower - 1e-9).all() and (rows <= planner.robot.arm.upper + 1e-9).all()
        expected = np.array([planner.robot.tool_pose(q) for q in rows])
        np.testing.assert_allclose(poses[:, :3], expected[:, :3, 3], atol=1e-9)
        np.testing.assert_allclose([pose(p[:3], p[3:]) for p in poses], expected, atol=1e-6)
        assert removal.length == pytest.approx(
            sum(math.dist(a, b) for a, b in zip(poses[:-1, :3], poses[1:, :3], strict=True))
        )
        assert removal.length >= planner.candidate_bound(edge.part) - 1e-6
        np.testing.assert_allclose(poses[-1, :3], cell.goal, atol=1e-5)
        np.testing.assert_allclose(
            poses[0], np.concatenate([removal.grasp.center, removal.grasp.orientation]), atol=1e-9
        )
        # The first five centimetres go straight up without turning.
        height = poses[:, 2] - poses[0, 2]
        lifted = int(np.argmax(height > cell.lift_height - 1e-6))
        np.testing.assert_allclose(poses[: lifted + 1, :2], np.tile(poses[0, :2], (lifted + 1, 1)), atol=1e-6)
        np.testing.assert_allclose(np.abs(poses[: lifted + 1, 3:] @ poses[0, 3:]), 1.0, atol=1e-9)
        # The part is gripped where it stands: the grasp is one of its candidates.
        T_part_tool = pose_inverse(planner.assembly.parts[edge.part].T_world_part) @ pose(poses[0, :3], poses[0, 3:])
        away = [np.abs(T_part_tool - g.T_part_tool).max() for g in planner.reach.candidates(edge.part)]
        assert min(away) < 1e-5


def test_removal_masks_equal_fresh_checks_in_random_states(planner: RemovalPlanner, edges: list[Edge]) -> None:
    """500 random states: a removal is valid by its mask exactly if its motion hits nothing that stands there."""
    rng = np.random.default_rng(7)
    removals = known_removals(planner, tuple(edges))
    clearance = planner.workcell.clearance
    valid = invalid = 0
    for state in random_states(planner.assembly, 500, rng):
        edge, removal = removals[int(rng.integers(len(removals)))]
        others = state & ~(1 << edge.part)
        bar = planner.assembly.parts[edge.part]
        T_tool_part = pose_inverse(planner.robot.tool_pose(removal.joint_path[0])) @ bar.T_world_part
        held = planner.robot.held(removal.grasp.width, T_tool_part, planner.assembly.body(edge.part))
        fingers = held.meets_world.copy()
        fingers[held.group[1] :] = 0
        scene = scene_of(planner.robot, held, planner.world, others, len(planner.assembly.parts), clearance)
        lifting = scene._replace(held=held._replace(meets_world=fingers))
        heights = removal.tool_path[:, 2] - removal.tool_path[0, 2]
        top = int(np.argmax(heights > planner.workcell.lift_height - 1e-6))
        lift, path = removal.joint_path[: top + 1], removal.joint_path[top:]
        touched = rows_touch(lifting, lift, clearance, 0.01) or rows_touch(scene, path, clearance, 0.02)
        lifted_into = (
            planner.exits.exits(edge.part)[0].blockers or 0
        )  # tested above: what the part itself meets on its way up
        touched = touched or bool(lifted_into & others)
        by_mask = removal.valid_in(others)
        assert not (by_mask and touched), (edge.part, bin(state))
        if not by_mask and not touched:
            wide = PADDING + 0.0006
            assert rows_touch(lifting, lift, wide, 0.002) or rows_touch(scene, path, wide, 0.004), (
                edge.part,
                bin(state),
            )
        valid, invalid = valid + by_mask, invalid + touched
        subset = state & random_states(planner.assembly, 1, rng)[0]
        assert not by_mask or removal.valid_in(subset)
    assert valid > 50 and invalid > 50


# ---- the planner's answers


def bar(name: str, center: list[float], size: tuple[float, float, float], fixed: bool = False) -> Part:
    return Part(name, Box(size), pose(center), 0.1, fixed)


def plan_in(
    robot: RobotModel, workcell: Workcell, parts: list[Part], part: int = 0, **changes: object
) -> tuple[Removal | Blocked, RemovalPlanner]:
    """Plans one part of a small assembly, everything present."""
    assembly = Assembly("small", tuple(parts))
    cell = replace(workcell, **changes)  # type: ignore[arg-type]
    planner = RemovalPlanner(assembly, cell, RemovalOptions(tree_failures=3, tree_iterations=200), robot)
    return planner.plan(part, assembly.root, rng=np.random.default_rng(0)), planner


FREE_BAR = bar("bar", [0.10, 0.20, 0.15], (0.02, 0.20, 0.02))


def test_a_free_bar_leaves_almost_straight(robot: RobotModel, workcell: Workcell) -> None:
    removal, planner = plan_in(robot, workcell, [FREE_BAR])
    assert isinstance(removal, Removal)
    assert removal.blockers == 0
    assert planner.candidate_bound(0) <= removal.length < 1.1 * planner.candidate_bound(0)


def test_blocked_by_what_lies_above(robot: RobotModel, workcell: Workcell) -> None:
    above = bar("above", [0.10, 0.20, 0.19], (0.2, 0.02, 0.02))
    aside = bar("aside", [0.10, 0.45, 0.15], (0.02, 0.1, 0.02))
    answer, planner = plan_in(robot, workcell, [FREE_BAR, above, aside])
    assert answer == Blocked(0, "lift", 0b010)
    assert isinstance(planner.plan(0, 0b101, rng=np.random.default_rng(0)), Removal)
    fixed, _ = plan_in(robot, workcell, [FREE_BAR, replace(above, fixed=True)])
    assert fixed == Blocked(0, "lift", 0)


def walls(gap: float, fixed: bool) -> list[Part]:
    """Two walls along the bar, too near and too high for fingers, and two at its ends."""
    side = 0.01 + gap + 0.01
    return [
        bar("left", [0.10 + side, 0.20, 0.10], (0.02, 0.24, 0.16), fixed),
        bar("right", [0.10 - side, 0.20, 0.10], (0.02, 0.24, 0.16), fixed),
    ]


def test_blocked_where_no_hand_fits(robot: RobotModel, workcell: Workcell) -> None:
    answer, planner = plan_in(robot, workcell, [FREE_BAR, *walls(0.002, False)])
    assert isinstance(answer, Blocked) and answer.stage == "grasp"
    assert answer.blamed and not answer.blamed & ~0b110
    assert isinstance(planner.plan(0, 0b001, rng=np.random.default_rng(0)), Removal)
    fixed, _ = plan_in(robot, workcell, [FREE_BAR, *walls(0.002, True)])
    assert fixed == Blocked(0, "grasp", 0)


def test_blocked_out_of_reach(robot: RobotModel, workcell: Workcell) -> None:
    answer, _ = plan_in(robot, workcell, [bar("bar", [2.0, 0.2, 0.3], (0.02, 0.2, 0.02))], environment=())
    assert answer == Blocked(0, "ik", 0)


def test_blocked_where_the_goal_is_taken(robot: RobotModel, workcell: Workcell) -> None:
    """A block stands where the tool must end: the part can be gripped and lifted, but not brought there."""
    x, y, z = workcell.goal
    block = bar("block", [x, y, z], (0.06, 0.06, 0.06))
    answer, planner = plan_in(robot, workcell, [FREE_BAR, block, bar("aside", [0.10, 0.45, 0.15], (0.02, 0.1, 0.02))])
    assert answer == Blocked(0, "path", 0b010)
    assert isinstance(planner.plan(0, 0b101, rng=np.random.default_rng(0)), Removal)
    with pytest.raises(InputError, match=r"goal: .* lies 30 mm inside fixed part 'block'"):
        plan_in(robot, workcell, [FREE_BAR, replace(block, fixed=True)])


def planner_of_trees(robot: RobotModel, workcell: Workcell, parts: list[Part], **options: int) -> RemovalPlanner:
    """Plans with trees alone: no straight leg is tried."""
    only = RemovalOptions(leg_grasps=0, tree_iterations=200, **options)
    return RemovalPlanner(Assembly("small", tuple(parts)), workcell, only, robot)


def test_trees_find_a_path_where_legs_find_none_and_so_many_are_enough(robot: RobotModel, workcell: Workcell) -> None:
    parts = [bar("part", [0.15, 0.2, 0.1], (0.02, 0.2, 0.02)), bar("post", [3.0, 3.0, 0.1], (0.02, 0.02, 0.1), True)]
    for paths in (1, 3):
        planner = planner_of_trees(robot, workcell, parts, tree_paths=paths, tree_failures=6)
        removal = planner.plan(0, 0b1, rng=np.random.default_rng(0))
        assert isinstance(removal, Removal)
        assert removal.length < 1.5 * planner.candidate_bound(0)
        assert 1 <= planner.counts.motion_plans < paths + 6
    none = planner_of_trees(robot, workcell, parts, tree_failures=0)
    answer = none.plan(0, 0b1, rng=np.random.default_rng(0))
    assert isinstance(answer, Blocked) and answer.stage == "path" and none.counts.motion_plans == 0


def test_trees_fail_so_often_and_a_third_as_often_where_something_is_known(
    robot: RobotModel, workcell: Workcell
) -> None:
    """The goal is taken, so no tree can arrive."""
    place = [float(x) for x in workcell.goal]
    parts = [bar("part", [0.15, 0.2, 0.1], (0.02, 0.2, 0.02)), bar("in_the_goal", place, (0.06, 0.06, 0.06))]
    for limit, failures in ((np.inf, 6), (5.0, 2)):
        planner = planner_of_trees(robot, workcell, parts, tree_failures=6)
        answer = planner.plan(0, 0b11, rng=np.random.default_rng(0), shorter_than=limit)
        assert isinstance(answer, Blocked) and answer.stage == "path"
        assert planner.counts.motion_plans == failures


def test_only_shorter_removals_are_of_interest(planner: RemovalPlanner, edges: list[Edge]) -> None:
    shorter = 0
    for edge, removal in known_removals(planner, tuple(edges))[:12]:
        rng = np.random.default_rng(1)
        for limit in (removal.length, 0.97 * removal.length, planner.candidate_bound(edge.part)):
            answer = planner.plan(edge.part, edge.state, rng=rng, shorter_than=limit)
            if isinstance(answer, Removal):
                assert answer.length < limit
                shorter += 1
        assert isinstance(answer, Blocked), "nothing is shorter than the straight-line bound"
    assert shorter < 24


def test_more_attempts_are_never_longer(planner: RemovalPlanner, edges: list[Edge]) -> None:
    for edge, removal in known_removals(planner, tuple(edges))[:8]:
        seed = edges.index(edge)
        answer = planner.plan(edge.part, edge.state, rng=np.random.default_rng(seed), attempts=3)
        assert isinstance(answer, Removal)
        assert answer.length <= removal.length + 1e-12


def same(a: Removal | Blocked, b: Removal | Blocked) -> bool:
    if isinstance(a, Removal) and isinstance(b, Removal):
        return a.joint_path.tobytes() == b.joint_path.tobytes() and (a.length, a.blockers) == (b.length, b.blockers)
    return a == b


def test_answers_follow_the_seed_alone(planner: RemovalPlanner, edges: list[Edge]) -> None:
    """A planner that was asked nothing before, and one asked everything, in another order, on two threads."""
    chosen = list(enumerate(edges[:16]))
    fresh = RemovalPlanner(planner.assembly, planner.workcell, robot=planner.robot)

    def ask(asked: RemovalPlanner, entry: tuple[int, Edge]) -> Removal | Blocked:
        number, edge = entry
        return asked.plan(edge.part, edge.state, rng=np.random.default_rng(number))

    alone = [ask(planner, entry) for entry in chosen]
    with ThreadPoolExecutor(2) as pool:
        threaded = list(pool.map(lambda entry: ask(fresh, entry), reversed(chosen)))[::-1]
    assert all(same(a, b) for a, b in zip(alone, threaded, strict=True))
    assert any(isinstance(a, Removal) for a in alone)
    other = planner.plan(chosen[0][1].part, chosen[0][1].state, rng=np.random.default_rng(0))
    assert same(alone[0], other)


# ---- goals


def test_goal_configurations_stand_at_the_goal_and_are_free_of_what_never_leaves(planner: RemovalPlanner) -> None:
    work = planner.robot.workspace(64)
    goals = planner.goals.all(work)
    assert len(goals) > 100
    present = flags_of(0, len(planner.assembly.parts))
    for q in goals:
        np.testing.assert_allclose(planner.robot.tool_pose(q)[:3, 3], planner.workcell.goal, atol=1e-5)
        assert check(planner.robot.arm, planner.robot.held(0.0), planner.world, present, 0.001, q, work) == FREE
    # Its orientation is free: approach directions all around.
    directions = np.array([planner.robot.tool_pose(q)[:3, 2] for q in goals])
    assert np.linalg.eigvalsh(directions.T @ directions / len(directions))[0] > 0.05


def test_goals_kept_as_masks_are_those_that_fresh_checks_find(planner: RemovalPlanner) -> None:
    """In random states: the nearest free goals, and the free ones among the pairs, judged in that state alone."""
    rng, work = np.random.default_rng(9), planner.robot.workspace(64)
    grasps, goals = cached_branches(planner), planner.goals.all(work)
    hindered = 0
    for state in random_states(planner.assembly, 60, rng):
        part, number = grasps[int(rng.integers(len(grasps)))]
        hand, others = planner.reach.hands(part, work)[number], state & ~(1 << part)
        near = planner.goals.neighbours(planner.reach.branches(part, number, 0, work), work)
        scene = scene_of(planner.robot, hand.held, planner.world, others, len(planner.assembly.parts), PADDING)

        def is_free(q: Array, scene: Scene = scene) -> bool:
            return check(scene.arm, scene.held, scene.world, scene.present, PADDING, q, scene.work) == FREE

        distances = ((goals[:, None] - near.lifted) ** 2).sum(axis=2)  # no root: two may be equally far
        order = np.argsort(distances.min(axis=1), kind="stable")
        free = np.array([q for q in goals[order[:200]] if is_free(q)])
        assert len(free) > 40
        for most in (5, 40, len(free)):
            np.testing.assert_array_equal(planner.goals.free(near, part, hand, others, most, work), free[:most])
        hindered += not np.array_equal(free[:40], goals[order[:40]])

        starts, ends = planner.goals.free_pairs(near, part, hand, others, 10**6, work)
        by_lift = np.argsort(distances, axis=0, kind="stable")[:4]  # the four goals nearest to each lift
        expected = {(s, int(g)) for s, column in enumerate(by_lift.T) for g in column if is_free(goals[g])}
        found = {
            (int(np.abs(near.lifted - a).sum(axis=1).argmin()), int(np.abs(goals - b).sum(axis=1).argmin()))
            for a, b in zip(starts, ends, strict=True)
        }
        assert found == expected
        fewer = planner.goals.free_pairs(near, part, hand, others, 3, work)
        np.testing.assert_array_equal(fewer, (starts[:3], ends[:3]))
    assert hindered > 5


def situation_of(planner: RemovalPlanner, edge: Edge) -> Situation:
    others, parts = edge.state & ~(1 << edge.part), len(planner.assembly.parts)
    return Situation(
        planner.robot,
        planner.reach,
        planner.goals,
        edge.part,
        others,
        flags_of(others, parts),
        planner.world,
        PADDING,
        0.001,
        planner.robot.workspace(64),
    )


def test_a_leg_is_not_planned_twice_in_one_situation(planner: RemovalPlanner, edges: list[Edge]) -> None:
    """What does not depend on chance is the same object when it is asked for again."""
    edge = known_removals(planner, tuple(edges))[0][0]
    situation, others = situation_of(planner, edge), edge.state & ~(1 << edge.part)
    number = next(n for n in range(len(situation.hands)) if situation.branches(n))
    assert situation.straight_leg(number, 32, 0.05) is situation.straight_leg(number, 32, 0.05)
    assert situation.free_goals(number, 24) is situation.free_goals(number, 24)
    assert situation.branches(number) == planner.reach.branches(edge.part, number, others, situation.work)


def test_rows_are_so_close_that_the_joints_move_the_tool_no_further_than_stated(
    planner: RemovalPlanner, edges: list[Edge], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Paths that bend from row to row, followed in a hundred pieces between each two rows; first rows 6 cm apart."""
    monkeypatch.setattr(planner, "options", replace(planner.options, row_spacing=0.06))
    situation = situation_of(planner, known_removals(planner, tuple(edges))[0][0])
    robot, rng, bent = planner.robot, np.random.default_rng(91), 0

    def excess(rows: Array) -> float:
        shares = np.linspace(0.0, 1.0, 101)[:, None]
        motion = np.concatenate([a + shares * (b - a) for a, b in pairwise(rows)])
        return float(np.diff([situation.tool_length(number, motion), situation.tool_length(number, rows)][::-1])[0])

    number = next(n for n in range(len(situation.hands)) if situation.branches(n))
    scene = situation.scene(number)
    for _ in range(12):
        ends = planner.workcell.home + rng.normal(size=(6, robot.joints)) * 0.5
        ends = np.clip(ends, robot.arm.lower, robot.arm.upper)
        corners = np.concatenate([np.linspace(a, b, 12) for a, b in pairwise(ends)])  # a few centimetres apart
        rough = resampled(scene, corners, planner.options.row_spacing, True)
        assert situation.tool_bend(number, rough) == pytest.approx(excess(rough), rel=0.02)
        bent += excess(rough) > 1e-4
        rows = planner._close_rows(situation, scene, number, corners, True)
        assert excess(rows) <= 5.1e-5
        np.testing.assert_allclose(rows[[0, -1]], corners[[0, -1]])
    assert bent > 6


def test_orientations_are_spread_evenly() -> None:
    quaternions = super_fibonacci(240)
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0)
    rng = np.random.default_rng(8)
    for _ in range(200):
        R = random_rotation(rng)
        traces = [np.trace(R.T @ pose((0, 0, 0), q)[:3, :3]) for q in quaternions]
        assert np.arccos(np.clip((max(traces) - 1) / 2, -1, 1)) < np.deg2rad(45)


SHIPPED = [*(f"single/{k:02d}" for k in range(1, 15)), *(f"double/{k:02d}" for k in range(1, 8))]


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_witness_orders_of_the_shipped_assemblies_can_be_planned(
    name: str, workcell: Workcell, robot: RobotModel
) -> None:
    """Some parts leave by one way to hold them out of a thousand; whoever samples those more coarsely loses it."""
    shipped = load_assembly(data_path(f"{name}.json"))
    asked = RemovalPlanner(shipped, workcell, robot=robot)
    assert shipped.witness
    state = shipped.root
    for part in shipped.witness:
        number = shipped.index[part]
        answers = (asked.plan(number, state, rng=np.random.default_rng(seed)) for seed in range(3))
        assert any(isinstance(answer, Removal) for answer in answers), part
        state &= ~(1 << number)
    assert state == 0


@pytest.mark.parametrize(("limit", "larger"), [(math.inf, True), (1.0, False)])
def test_trees_grow_larger_where_four_attempts_found_nothing(
    planner: RemovalPlanner, monkeypatch: pytest.MonkeyPatch, limit: float, larger: bool
) -> None:
    grown = []

    def attempt(situation: Situation, rng: object, limit: float, options: RemovalOptions) -> Blocked:
        grown.append(options.tree_iterations)
        return Blocked(situation.part, "path", situation.others)

    monkeypatch.setattr(planner, "_attempt", attempt)
    part = next(part for part in members(planner.assembly.root) if planner.freedom(part))
    planner.plan(part, 1 << part, rng=np.random.default_rng(0), shorter_than=limit, attempts=6)
    usual = planner.options.tree_iterations
    assert grown == [usual] * 4 + [5 * usual if larger else usual] * 2
