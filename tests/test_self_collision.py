"""The arm does not pass through itself: planner and judge against exact meshes, each with its own list of pairs."""

from __future__ import annotations

import json
import math
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from mesh_oracle import MeshOracle
from takeapart.formats.files import data_path, load_assembly
from takeapart.model.geometry import Array, OrientedBox, pose
from takeapart.model.plan import Grasp, PlanStep
from takeapart.robot.arrays import TABLE_UNIT
from takeapart.robot.kernels import FREE, HIT_SELF, check, near_pair_distance, placed
from takeapart.robot.kinematics import place, set_motion, set_still
from takeapart.robot.model import RobotModel
from takeapart.robot.self_collision import ConvexBody, body_pairs, distance_table, relative_pose
from takeapart.robot.separation import separation
from takeapart.robot.world import build_world
from takeapart.verification.replay import Replay
from takeapart.verification.report import VerificationOptions
from takeapart.verification.robot import unchecked_pairs
from takeapart.workcell import Workcell

BELIEVED_BEFORE = (  # the hand stands in link 5, which the robot's SRDF says need not be checked
    [-0.907024, 0.208524, 1.089352, -1.859654, 0.161373, 0.524067, -0.668408],
    [0.4233, 0.0248, -1.3776, -2.3939, 0.9422, -0.017, -1.5282],
)
OPENING = 0.04  # m


@pytest.fixture(scope="module")
def oracle(workcell: Workcell) -> MeshOracle:
    return MeshOracle(workcell.description)


class Alone:
    """The planner's check with nothing held and nothing near."""

    def __init__(self, robot: RobotModel) -> None:
        self.robot, self.work, self.held = robot, robot.workspace(), robot.held(OPENING)
        self.world = build_world([(OrientedBox(pose((9.0, 9.0, 9.0)), np.full(3, 0.01)), 0)])
        self.present = np.ones(2, dtype=np.uint8)

    def __call__(self, q: Array, padding: float = 0.0) -> int:
        return check(self.robot.arm, self.held, self.world, self.present, padding, q, self.work)


def draw(robot: RobotModel, count: int, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    return rng.uniform(robot.arm.lower, robot.arm.upper, size=(count, robot.joints))


@pytest.mark.parametrize("angles", BELIEVED_BEFORE)
def test_configurations_that_a_believed_file_let_pass_are_refused(
    robot: RobotModel, oracle: MeshOracle, angles: list[float]
) -> None:
    q = np.array(angles)
    oracle.place(q, OPENING)
    assert ("panda_link5", "panda_hand") in [tuple(sorted(pair, reverse=True)) for pair in oracle.meeting()]
    assert Alone(robot)(q) == HIT_SELF


def free_means_apart(robot: RobotModel, oracle: MeshOracle, count: int, seed: int) -> int:
    alone, free = Alone(robot), 0
    for q in draw(robot, count, seed):
        if alone(q) != FREE:
            continue
        free += 1
        oracle.place(q, OPENING)
        assert oracle.meeting() == [], q.tolist()
    return free


def test_what_the_planner_calls_free_is_free_between_exact_meshes(robot: RobotModel, oracle: MeshOracle) -> None:
    assert free_means_apart(robot, oracle, 1_500, 1) > 600


@pytest.mark.slow
def test_what_the_planner_calls_free_is_free_between_exact_meshes_20000_times(
    robot: RobotModel, oracle: MeshOracle
) -> None:
    assert free_means_apart(robot, oracle, 20_000, 2) > 8_000


def test_only_neighbours_are_left_out_and_what_is_said_never_to_meet_does_not(
    robot: RobotModel, oracle: MeshOracle
) -> None:
    """Judged by the meshes' own distances; the Panda has no pair of other links that always touches."""
    treatment = {frozenset((robot.bodies[p.first], robot.bodies[p.second])): p for p in robot.pairs}
    arm_pairs = [pair for pair in oracle.pairs if not any("finger" in link for link in pair)]
    assert {frozenset(pair) for pair in arm_pairs} == {
        pair for pair, found in treatment.items() if found.treatment != "neighbours"
    }
    assert not any(found.treatment == "always touch" for found in robot.pairs)
    never = {pair: found.least for pair, found in treatment.items() if found.treatment == "never meet"}
    assert never
    for q in draw(robot, 150, 3):
        oracle.place(q, OPENING)
        for pair, least in never.items():
            assert oracle.distance(*pair) >= least


def test_tables_never_exceed_the_distance_of_the_meshes_and_are_close_to_it(
    robot: RobotModel, oracle: MeshOracle
) -> None:
    tables = [p for p in robot.pairs if p.treatment == "table"]
    assert {robot.bodies[p.first] for p in tables} >= {"panda_link5"}
    work, held, lost = robot.workspace(), robot.held(OPENING), []
    for q in draw(robot, 400, 4):
        place(robot.arm, held, q, work)
        set_still(work)
        oracle.place(q, OPENING)
        meeting = {frozenset(pair) for pair in oracle.meeting()}
        for k, pair in enumerate(tables):
            first, second = robot.bodies[pair.first], robot.bodies[pair.second]
            proved = near_pair_distance(robot.arm, k, work)
            true = 0.0 if {first, second} in meeting else oracle.distance(first, second)
            assert proved <= true + 1e-9
            if 0.002 < true < 0.04:
                lost.append(true - proved)
    assert len(lost) > 50
    assert max(lost) < 0.002


def test_the_proof_of_a_motion_holds_at_fine_steps_all_along_it(robot: RobotModel, oracle: MeshOracle) -> None:
    """What is proved of a motion is no more than the distance of the meshes anywhere on it."""
    rng = np.random.default_rng(5)
    work, held = robot.workspace(), robot.held(OPENING)
    tables = [(robot.bodies[p.first], robot.bodies[p.second]) for p in robot.pairs if p.treatment == "table"]
    alone, proved, near = Alone(robot), 0, 0
    for q in draw(robot, 250, 6):
        turn = rng.normal(size=robot.joints) * rng.choice([0.01, 0.05])
        place(robot.arm, held, q, work)
        set_motion(robot.arm, held, q - turn, q + turn, 0.5, work)
        bounds = [near_pair_distance(robot.arm, k, work) for k in range(len(tables))]
        if placed(robot.arm, held, alone.world, alone.present, 0.001, work) != FREE:
            continue
        proved += 1
        for share in np.linspace(-1, 1, 7):
            oracle.place(q + share * turn, OPENING)
            assert oracle.meeting() == []
            for pair, bound in zip(tables, bounds, strict=True):
                near += bound < 0.03
                assert oracle.distance(*pair) >= bound - 1e-9
    assert proved > 40
    assert near > 100


@pytest.fixture(scope="module")
def judge(workcell: Workcell) -> Replay:
    return Replay(load_assembly(data_path("single/13.json")), workcell, VerificationOptions())


@pytest.mark.parametrize("angles", BELIEVED_BEFORE)
def test_the_judge_sees_the_hand_in_link_5(judge: Replay, angles: list[float]) -> None:
    judge.scene.show(judge.assembly.root, None)
    judge.scene.place(np.array(angles))
    pairs, _ = judge.scene.near()
    inside = {
        tuple(sorted((judge.scene.label(a), judge.scene.label(b))))
        for a, b in pairs.tolist()
        if judge.scene.distance(a, b) < -0.005
    }
    assert ("panda_hand", "panda_link5") in inside


def test_the_judge_refuses_a_plan_that_it_once_passed(judge: Replay) -> None:
    """Two steps of a plan of a planner that believed the robot's file: the hand is up to 38 mm inside link 5."""
    known = json.loads((Path(__file__).parent / "data" / "through_itself.json").read_text(encoding="utf-8"))
    index, order = judge.assembly.index, known["order"]
    deepest = {}
    for row in known["steps"]:
        k = order.index(row["part"])
        state = judge.assembly.root & ~sum(1 << index[name] for name in order[:k])
        held = row["grasp"]
        grasp = Grasp(np.array(held["center"]), np.array(held["orientation"]), held["width"])
        paths = (np.array(row["joint_path"]), np.array(row["tool_path"]))
        found = judge.step(PlanStep(row["part"], grasp, *paths, row["length"]), k, state).findings
        hand = [f.depth for f in found if f.check == "collision" and "panda_hand" in f.message and "link5" in f.message]
        deepest[row["part"]] = max(hand)
    assert deepest["back_0_0"] == pytest.approx(0.038, abs=0.002)
    assert deepest["support_1"] == pytest.approx(0.012, abs=0.002)


def test_the_judge_leaves_out_the_next_link_in_the_chain_and_the_gripper_with_itself_and_nothing_else(
    workcell: Workcell, oracle: MeshOracle
) -> None:
    links = set(oracle.objects)
    pairs = {frozenset(pair) for pair in combinations(links, 2)}
    left_out = {frozenset(pair) for pair in unchecked_pairs(workcell.description)}
    fingers = frozenset({"panda_leftfinger", "panda_rightfinger"})
    assert left_out == pairs - {frozenset(pair) for pair in oracle.pairs} | {fingers}


def box_corners(half: float) -> Array:
    return np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half


def test_separation_of_boxes_is_that_of_the_formula() -> None:
    rng = np.random.default_rng(7)
    corners = box_corners(0.05)
    scratch = np.zeros((5, 3))
    for _ in range(300):
        shift = rng.normal(size=3) * 0.15
        gap = np.maximum(np.abs(shift) - 0.1, 0.0)
        found = separation(corners, corners, np.eye(3), shift, 0.0, np.inf, scratch)
        assert found <= np.linalg.norm(gap) + 1e-12
        assert found == pytest.approx(float(np.linalg.norm(gap)), abs=2e-6)


def test_a_table_over_two_joints_proves_less_than_the_distance_at_every_angle() -> None:
    """Two boxes on two skew axes, at angles between the nodes."""
    chain = np.stack([pose((0.0, 0.0, 0.05))[:3], pose((0.05, 0.0, 0.0), (0.8, 0.6, 0.0, 0.0))[:3]])
    corners = box_corners(0.04)
    first, second = ConvexBody(corners, 0), ConvexBody(corners * 0.6 + [0.06, 0.0, 0.0], 2)
    lower, upper = np.array([-1.0, -0.7]), np.array([0.9, 1.1])
    table = distance_table(first, second, chain, lower, upper)
    rng, scratch, worst = np.random.default_rng(8), np.zeros((5, 3)), 0.0
    for angles in rng.uniform(lower, upper, size=(2000, 2)):
        T = relative_pose(chain, 0, 2, angles)
        true = separation(corners, second.corners, T[:3, :3].copy(), T[:3, 3].copy(), 0.0, np.inf, scratch)
        node = np.round((angles - table.lower) / table.step).astype(int)
        off = np.abs(angles - table.lower - node * table.step)
        proved = float(table.distances[tuple(node)]) * TABLE_UNIT - float(table.reach @ off)
        assert proved <= true + 1e-6
        if 0.005 < true < 0.04:
            worst = max(worst, true - proved)
    assert 0.0 < worst < 0.002


def test_bodies_that_touch_whatever_the_angles_are_left_out() -> None:
    chain = np.stack([pose()[:3], pose()[:3], pose((0.001, 0.0, 0.0))[:3]])
    corners = box_corners(0.05)
    bodies = [ConvexBody(corners, 0), ConvexBody(corners, 1), ConvexBody(corners, 3)]
    pairs, tables = body_pairs(bodies, chain, np.full(3, -math.pi), np.full(3, math.pi))
    assert [pair.treatment for pair in pairs] == ["neighbours", "always touch", "always touch"]
    assert tables == ()
