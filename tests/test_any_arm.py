"""Arms with another number of joints than seven, joints that turn twice round, and grippers whose tool moves."""

from __future__ import annotations

import importlib
import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import test_motion_proofs as proofs
from conftest import random_configurations, random_rotation, scene_of, world_around
from linkage_robot import HOME, LIMITS, OPENINGS, knuckle_angle, linkage_robot, tool_point
from mesh_oracle import MeshOracle
from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, Box
from takeapart.motion.legs import joint_distances, near_pairs, one_leg
from takeapart.motion.rrt import rrt_connect
from takeapart.motion.scene import is_free
from takeapart.problem import AssemblyProblem
from takeapart.removal.planner import RemovalPlanner
from takeapart.removal.result import Removal
from takeapart.robot.hand import collect_hand, hand_hits_load
from takeapart.robot.ik import InverseKinematics
from takeapart.robot.ik_solver import brought_solver
from takeapart.robot.kinematics import nearest_winding, wind
from takeapart.robot.loading import load_robot
from takeapart.robot.model import RobotModel
from takeapart.robot.self_collision import within_one_turn
from takeapart.robot.world import build_world
from takeapart.stability import ConnectorStability
from takeapart.workcell import Workcell
from test_motion_proofs import FAR
from test_self_collision import free_means_apart

TURN = 2 * math.pi


@dataclass(frozen=True, eq=False)
class Case:
    """A robot in the usual workcell."""

    workcell: Workcell
    robot: RobotModel


@pytest.fixture(scope="module")
def six(tmp_path_factory: pytest.TempPathFactory) -> Case:
    return case_of(tmp_path_factory.mktemp("six"))


def case_of(folder: Path, limits: tuple[tuple[float, float], ...] = LIMITS) -> Case:
    """The robot of `linkage_robot` in the usual workcell, with limits of its own."""
    description = linkage_robot(folder, limits=limits)
    cell = replace(
        load_workcell("panda"),
        description=description,
        home=np.array(HOME),
        payload=math.nan,
        gripping_force=math.nan,
        friction=math.nan,
    )
    return Case(cell, load_robot(cell))


# ---- inverse kinematics


def same_pose(rows: Array, q: Array) -> Array:
    """(S,) rad, how far configurations (S, n) are from another one, full turns aside."""
    return np.asarray(2 * np.abs(np.sin((rows - q) / 2)).max(axis=1))


def found_by_newton(
    robot: RobotModel, target: Array, opening: float, tries: int, rng: np.random.Generator
) -> list[Array]:
    """Branches that damped Newton steps reach from random configurations, as angles inside one turn."""
    low, high = within_one_turn(robot.arm.lower, robot.arm.upper)
    work = robot.workspace()
    found: list[Array] = []

    def error(q: Array) -> Array:
        T = robot.tool_pose(q, work, opening)
        R = target[:3, :3] @ T[:3, :3].T
        return np.concatenate(
            [target[:3, 3] - T[:3, 3], 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])]
        )

    for _ in range(tries):
        q = rng.uniform(low, high)
        for _ in range(60):
            e = error(q)
            J = np.array([(error(q + 1e-6 * step) - e) / 1e-6 for step in np.eye(len(q))]).T
            q = q - np.clip(J.T @ np.linalg.solve(J @ J.T + 1e-8 * np.eye(6), e), -0.5, 0.5)
            if np.abs(e).max() < 1e-10:
                break
        flipped = np.trace(robot.tool_pose(q, work, opening)[:3, :3].T @ target[:3, :3]) < 0
        if np.abs(error(q)).max() > 1e-8 or flipped or np.linalg.svd(J)[1][-1] < 1e-3:
            continue
        q = q - TURN * np.round((q - (low + high) / 2) / TURN)
        if ((q >= low) & (q <= high)).all() and not any(same_pose(np.array(found), q) < 1e-4 if found else []):
            found.append(q)
    return found


def test_every_branch_that_newton_finds_is_among_the_solutions(six: Case) -> None:
    ik, rng, branches = InverseKinematics(six.robot), np.random.default_rng(1), 0
    for q in random_configurations(six.robot, 6, rng):
        opening = float(rng.uniform(*OPENINGS))
        target = six.robot.tool_pose(q, opening=opening)
        solutions = ik.solve(target, opening)
        for other in [q, *found_by_newton(six.robot, target, opening, 25, rng)]:
            assert same_pose(solutions, other).min() < 1e-5
            branches += 1
    assert branches > 20


def test_solutions_hit_the_pose_inside_the_limits_each_once(six: Case) -> None:
    ik, rng, arm = InverseKinematics(six.robot), np.random.default_rng(2), six.robot.arm
    for q in random_configurations(six.robot, 60, rng):
        opening = float(rng.uniform(*OPENINGS))
        target = six.robot.tool_pose(q, opening=opening)
        turned = target.copy()
        turned[:3, :2] *= -1
        for goal, solutions in zip((target, turned), ik.solve_both(target, opening), strict=True):
            assert len(solutions)
            for k, solution in enumerate(solutions):
                np.testing.assert_allclose(six.robot.tool_pose(solution, opening=opening), goal, atol=1e-6)
                assert (same_pose(solutions[:k], solution) > 1e-6).all()
            assert ((solutions >= arm.lower) & (solutions <= arm.upper)).all()
            assert (np.abs(solutions[:, arm.turning]) <= math.pi + 1e-9).all()


BROUGHT = "ssik.prebuilt.universal_robots.ur5e_ik"


def test_a_solver_whose_base_and_flange_stand_elsewhere_is_measured() -> None:
    module, rng = importlib.import_module(BROUGHT), np.random.default_rng(3)
    A, B = np.eye(4), np.eye(4)
    for T in (A, B):
        T[:3, :3], T[:3, 3] = random_rotation(rng), rng.uniform(-0.5, 0.5, 3)
    solver = brought_solver(BROUGHT, lambda q: A @ np.asarray(module.fk(q)) @ B, 6, "test")
    for q in rng.uniform(-2, 2, (20, 6)):
        flange = A @ np.asarray(module.fk(q)) @ B
        found = solver.solve(flange, False)
        assert same_pose(np.array(found), q).min() < 1e-6
        for other in found:
            np.testing.assert_allclose(A @ np.asarray(module.fk(other)) @ B, flange, atol=1e-6)


def test_a_solver_for_another_arm_is_refused_in_one_line() -> None:
    module = importlib.import_module("ssik.prebuilt.universal_robots.ur10e_ik")
    with pytest.raises(InputError, match="another arm") as refused:
        brought_solver(BROUGHT, lambda q: np.asarray(module.fk(q)), 6, "my_arm.toml: inverse_kinematics")
    assert "\n" not in str(refused.value)
    with pytest.raises(InputError, match="6 joints, the arm has 7"):
        brought_solver(BROUGHT, lambda q: np.eye(4), 7, "my_arm.toml")
    with pytest.raises(InputError, match="no module 'ssik.prebuilt.nothing'"):
        brought_solver("ssik.prebuilt.nothing", lambda q: np.eye(4), 6, "my_arm.toml")


# ---- windings


def test_the_nearest_winding_is_the_nearest_of_all_inside_the_limits(six: Case) -> None:
    rng = np.random.default_rng(4)
    for _ in range(400):
        low = float(rng.uniform(-9, 0))
        arm = six.robot.arm._replace(lower=np.full(6, low), upper=np.full(6, low + float(rng.uniform(TURN, 3 * TURN))))
        angle, near = rng.uniform(low, arm.upper[0]), rng.uniform(low, arm.upper[0])
        windings = [angle + k * TURN for k in range(-4, 5)]
        inside = [w for w in windings if low <= w <= arm.upper[0]]
        best = min(inside, key=lambda w: abs(w - near))
        assert abs(nearest_winding(arm, 0, angle, near) - near) == pytest.approx(abs(best - near), abs=1e-9)


def test_goals_and_starts_are_paired_by_their_nearest_windings(six: Case) -> None:
    """Against all windings of every goal, one by one."""
    arm, rng = six.robot.arm, np.random.default_rng(5)
    lifted, goals = (random_configurations(six.robot, count, rng) for count in (3, 12))
    for g, q in enumerate(goals):
        choices = [
            [w for k in range(-2, 3) if arm.lower[j] <= (w := q[j] + k * TURN) <= arm.upper[j]]
            if j in arm.turning
            else [q[j]]
            for j in range(6)
        ]
        for s, start in enumerate(lifted):
            wound = np.empty(6)
            wind(arm, q, start, wound)
            least = min(float(np.sum((np.array(w) - start) ** 2)) for w in itertools.product(*choices))
            assert float(np.sum((wound - start) ** 2)) == pytest.approx(least)
            assert joint_distances(arm, lifted[s : s + 1], goals[g : g + 1])[0] == pytest.approx(least)
    pairs = near_pairs(arm, lifted, goals, 12)
    of_first = [int(g) for s, g in pairs if s == 0]
    apart = [float(joint_distances(arm, lifted[:1], goals[g : g + 1])[0]) for g in of_first]
    assert apart == sorted(apart)


def test_no_path_unwinds_a_turn(six: Case) -> None:
    """A goal that stands a full turn away in three joints is reached at once."""
    robot = six.robot
    scene = scene_of(robot, robot.held(0.02), build_world([(FAR, 0)]), 0, 1, 0.001)
    start = np.array(HOME)
    assert is_free(scene, start)
    end = start + [0.3, 0.1, -0.1, 0.1, 0.2, 0.3] + np.array([1, 0, 0, 1, 0, -1]) * TURN
    for goal in (end, start + [0.3, 0.1, -0.1, 0.1, 0.2, 0.3]):
        rows = one_leg(scene, start[None], goal[None], 0.05)
        assert len(rows) and np.abs(rows[-1] - start).max() < 0.5
        corners = rrt_connect(scene, start[None], goal[None], 50, 0.4, 1)
        assert np.abs(np.diff(corners, axis=0)).sum(axis=0).max() < 1.5
        np.testing.assert_allclose(np.cos(corners[-1] - goal), 1.0, atol=1e-12)


@pytest.fixture(scope="module")
def once_round(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """The same robot, whose joints turn no further than once round."""
    limits = tuple((max(low, -math.pi), min(high, math.pi)) for low, high in LIMITS)
    return case_of(tmp_path_factory.mktemp("once"), limits)


def test_plans_with_limits_of_two_turns_are_no_longer_than_with_one(six: Case, once_round: Case) -> None:
    assembly, lengths = load_assembly(data_path("examples/rack.json")), []
    for case in (six, once_round):
        planner = RemovalPlanner(assembly, case.workcell, robot=case.robot)
        total = 0.0
        for part, state in departures(planner):
            found = planner.plan(part, state, rng=np.random.default_rng(7))
            assert isinstance(found, Removal)
            turned = np.abs(found.joint_path[-1] - found.joint_path[0]).max()
            assert turned < 1.2 * math.pi
            total += found.length
        lengths.append(total)
    assert lengths[0] <= 1.001 * lengths[1]


def departures(planner: RemovalPlanner) -> Iterator[tuple[int, int]]:
    """Parts and states of one order in which gravity lets them go."""
    problem = AssemblyProblem(planner, ConnectorStability(planner.assembly))
    state = problem.root
    while state:
        part = problem.candidates(state)[0]
        yield part, state
        state &= ~(1 << part)


# ---- the gripper


@pytest.mark.parametrize("opening", [0.0, 0.011, 0.04, 0.0777, 0.085])
def test_pads_stand_at_the_opening_around_the_tool_wherever_it_moved(six: Case, opening: float) -> None:
    pads, knuckles = six.robot.gripper_boxes(opening)
    assert len(pads) == len(knuckles) == 2
    for box, sign in zip(pads, (1, -1), strict=True):
        corners = box.corners()
        assert (sign * corners[:, 1]).min() == pytest.approx(opening / 2, abs=3e-5)
        assert corners[:, 2].mean() == pytest.approx(0.0, abs=3e-5)
    for box, sign in zip(knuckles, (1, -1), strict=True):
        along = np.array([0.0, sign * math.sin(knuckle_angle(opening)), math.cos(knuckle_angle(opening))])
        assert abs(box.T_frame_box[:3, 2] @ along) == pytest.approx(1.0, abs=1e-6)
    T = six.robot.arm_at(opening).T_tool
    closed = six.robot.arm_at(0.0).T_tool
    assert np.linalg.norm(T[:, 3] - closed[:, 3]) == pytest.approx(
        tool_point(0.0)[2] - tool_point(opening)[2], abs=3e-5
    )


def test_the_tool_of_an_arm_whose_tool_stands_still_is_one_object(robot: RobotModel, six: Case) -> None:
    assert robot.arm_at(0.03) is robot.arm
    assert six.robot.arm_at(0.03) is not six.robot.arm
    assert six.robot.arm_at(0.03) is six.robot.arm_at(0.03)


def test_pads_may_touch_the_part_and_knuckles_may_not(six: Case) -> None:
    robot, work, T = six.robot, six.robot.workspace(), np.eye(4)
    world, present, hits = build_world([(FAR, 0)]), np.ones(2, np.uint8), np.zeros(2, np.uint8)

    ends = [box.corners()[:, 2].max() for box in robot.gripper_boxes(0.02)[1]]
    wide = Box((0.02, 0.075, 0.02)).boxes()
    T_tool_part = np.eye(4)
    T_tool_part[2, 3] = max(ends) - 0.02
    held = robot.held(0.02, T_tool_part, wide)
    collect_hand(robot.arm_at(0.02), held, world, present, 0.001, T, work, hits)
    assert hand_hits_load(robot.arm_at(0.02), held, 0.001, work), "what stands between the knuckles is hit"
    assert not hand_hits_load(robot.arm_at(0.02), held._replace(first_knuckle=held.group[1]), 0.001, work), (
        "and by nothing but them"
    )


# ---- collisions and motions


def test_links_and_gripper_stand_where_another_library_places_them(six: Case) -> None:
    oracle, robot, rng = MeshOracle(six.workcell.description), six.robot, np.random.default_rng(8)
    T_world_base = six.workcell.T_world_base
    for q in random_configurations(robot, 50, rng):
        opening = float(rng.uniform(*OPENINGS))
        poses = oracle.poses(q, opening)
        T = robot.tool_pose(q, opening=opening)
        pads, knuckles = robot.gripper_boxes(opening)
        for name, box in zip(
            ("left_pad", "right_pad", "left_knuckle", "right_knuckle"), [*pads, *knuckles], strict=True
        ):
            collision = oracle.gripper.link_map[name].collisions[0]
            np.testing.assert_allclose(
                (T @ box.T_frame_box)[:3, 3], (T_world_base @ poses[name] @ collision.origin)[:3, 3], atol=1e-7
            )


def test_what_the_planner_calls_free_is_free_between_exact_shapes(six: Case) -> None:
    assert free_means_apart(six.robot, MeshOracle(six.workcell.description), 1_200, 9) > 200


def test_a_turn_more_changes_no_answer(six: Case) -> None:
    robot, rng = six.robot, np.random.default_rng(10)
    scene = scene_of(robot, robot.held(0.03), world_around(robot, 12, rng), 0xFFF, 12, 0.001)
    free = 0
    for q in rng.uniform(*within_one_turn(robot.arm.lower, robot.arm.upper), (500, 6)):
        turned = q.copy()
        turned[robot.arm.turning] += TURN * rng.integers(-1, 2, len(robot.arm.turning))
        assert is_free(scene, q) == is_free(scene, turned)
        free += is_free(scene, q)
    assert 50 < free < 450


@pytest.mark.parametrize("loads", [False, True], ids=["bodies", "load"])
def test_a_motion_of_six_joints_that_ends_in_the_arm_is_not_called_free(six: Case, loads: bool) -> None:
    proofs.test_a_motion_that_ends_in_the_arm_itself_is_not_called_free(six.robot, loads)


def test_proofs_of_motions_of_six_joints_hold_at_fine_steps(six: Case) -> None:
    proofs.test_motions_called_free_are_free_of_the_arm_itself_at_fine_steps(six.robot)
    proofs.test_how_far_a_point_moves_is_bounded_where_it_does_not_move_at_first(six.robot)
    proofs.test_a_motion_that_ends_in_a_box_is_not_called_free(six.robot)


def test_removals_of_six_joints_start_at_the_grasp_with_the_tool_of_its_opening(six: Case) -> None:
    assembly = load_assembly(data_path("examples/rack.json"))
    planner = RemovalPlanner(assembly, six.workcell, robot=six.robot)
    part, state = next(departures(planner))
    found = planner.plan(part, state, rng=np.random.default_rng(0))
    assert isinstance(found, Removal)
    oracle = MeshOracle(six.workcell.description)
    poses = oracle.poses(found.joint_path[0], found.grasp.width)
    pads = [six.workcell.T_world_base @ poses[f"{side}_pad"] for side in ("left", "right")]
    faces = [T[:3, 3] + T[:3, :3] @ [0, -sign * 0.03, 0.028] for T, sign in zip(pads, (1, -1), strict=True)]
    np.testing.assert_allclose(np.mean(faces, axis=0), found.grasp.center, atol=5e-5)
    assert np.linalg.norm(faces[0] - faces[1]) == pytest.approx(found.grasp.width, abs=5e-5)
    end = oracle.poses(found.joint_path[-1], found.grasp.width)
    pads = [six.workcell.T_world_base @ end[f"{side}_pad"] for side in ("left", "right")]
    faces = [T[:3, 3] + T[:3, :3] @ [0, -sign * 0.03, 0.028] for T, sign in zip(pads, (1, -1), strict=True)]
    np.testing.assert_allclose(np.mean(faces, axis=0), six.workcell.goal, atol=5e-5)
