"""Collision kernels against MuJoCo, which has the real meshes, and against bounded least squares.

A missed collision is never allowed. A false alarm is allowed as far as the cover reaches beyond the meshes.
"""

from __future__ import annotations

import functools

import mujoco
import numpy as np
import pytest

from box_oracle import box_distance
from conftest import (
    boxes_around,
    random_box,
    random_configurations,
    random_rotation,
    random_states,
    world_around,
    world_of,
)
from takeapart.formats.robot_files import load_robot_description
from takeapart.model.assembly import Assembly, Part, members
from takeapart.model.geometry import Array, Box, OrientedBox, pose_inverse
from takeapart.removal.planner import RemovalPlanner
from takeapart.robot.arrays import HeldArrays, WorldArrays
from takeapart.robot.grid import boxes_meet
from takeapart.robot.hand import collect_hand
from takeapart.robot.ik import InverseKinematics
from takeapart.robot.kernels import FREE, HIT_SELF, HIT_WORLD, LARGEST_MARGIN, check, collect, placed
from takeapart.robot.kinematics import forward, jacobian, motion_of_ball, place, place_held, set_motion
from takeapart.robot.model import RobotModel
from takeapart.states import flags_of
from takeapart.verification.bodies import STATIC_BITS
from takeapart.verification.model import Scene as MujocoScene
from takeapart.workcell import Obstacle, Workcell

SIGHT = 0.08  # m
BOX_SIGHT = 0.04  # m, of exact distances between boxes


# ---- boxes


def meet(a: OrientedBox, b: OrientedBox, padding: float) -> bool:
    rows = [np.ascontiguousarray(box.T_frame_box[:3, :3].T) for box in (a, b)]
    centers = [box.T_frame_box[:3, 3].copy() for box in (a, b)]
    return bool(boxes_meet(centers[0], rows[0], a.half_extents, centers[1], rows[1], b.half_extents, padding))


def turned(box: OrientedBox, R: Array) -> OrientedBox:
    T = box.T_frame_box.copy()
    T[:3, :3] = R
    return OrientedBox(T, box.half_extents)


@pytest.mark.parametrize("kind", ["any", "parallel", "nearly parallel", "one axis shared"])
def test_boxes_meet_agrees_with_least_squares(kind: str) -> None:
    rng = np.random.default_rng(["any", "parallel", "nearly parallel", "one axis shared"].index(kind))
    outcomes = {True: 0, False: 0}
    for _ in range(1200):
        a, b = (random_box(rng, np.full(3, -0.12), np.full(3, 0.12), 0.005, 0.15) for _ in range(2))
        R = a.T_frame_box[:3, :3]
        if kind == "parallel":
            b = turned(b, R[:, rng.permutation(3)] * rng.choice([-1, 1], 3))  # a mirrored frame is the same box
        elif kind == "nearly parallel":
            axis, angle = rng.normal(size=3), 10.0 ** rng.uniform(-12, -3)
            axis *= angle / np.linalg.norm(axis)
            K = np.cross(np.eye(3), axis)
            b = turned(b, R @ (np.eye(3) - K + K @ K / 2))
        elif kind == "one axis shared":
            angle = rng.uniform(0, 2 * np.pi)
            turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
            b = turned(b, R @ turn)
        padding = float(rng.choice([0.0, 0.001, 0.02]))
        distance = box_distance(a, b, padding)
        if 1e-9 < distance < 1e-6:
            continue  # too close to call for the oracle
        expected = distance <= 1e-9
        assert meet(a, b, padding) == expected, (kind, distance)
        outcomes[expected] += 1
    assert min(outcomes.values()) > 150


def test_boxes_that_slide_apart_stop_meeting_where_they_touch() -> None:
    rng = np.random.default_rng(11)
    for _ in range(300):
        a, b = (random_box(rng, np.full(3, -0.1), np.full(3, 0.1), 0.005, 0.1) for _ in range(2))
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        near, far = 0.0, 1.0  # along the direction; far away they are apart
        T = b.T_frame_box.copy()
        T[:3, 3] = a.T_frame_box[:3, 3]  # at first both have the same centre
        for _ in range(50):
            middle = (near + far) / 2
            T_moved = T.copy()
            T_moved[:3, 3] += middle * direction
            if meet(a, OrientedBox(T_moved, b.half_extents), 0.0):
                near = middle
            else:
                far = middle
        for at, touching in ((near - 1e-6, True), (far + 1e-5, False)):
            T_moved = T.copy()
            T_moved[:3, 3] += at * direction
            assert (box_distance(a, OrientedBox(T_moved, b.half_extents)) < 1e-10) == touching


# ---- arm, load and world against MuJoCo


class Oracle:
    """Which pairs of things MuJoCo sees near each other, without those that our kernels leave out on purpose."""

    def __init__(self, assembly: Assembly, workcell: Workcell) -> None:
        self.scene = MujocoScene(assembly, workcell, SIGHT)
        description = workcell.description
        self.base = description.arm.base_link
        self.hand = {
            "panda_link7",
            description.gripper.base_link,
            *description.gripper.finger_links,
        }  # never moves relative to what it holds

    def near(self, q: Array) -> list[tuple[str, str, float]]:
        """Names of the two bodies and their distance, m, negative if they penetrate."""
        self.scene.place(q)
        pairs, distances = self.scene.near()
        closest: dict[tuple[str, str], float] = {}
        for (first, second), distance in zip(pairs.tolist(), distances.tolist(), strict=True):
            a, b = sorted((self.scene.label(first), self.scene.label(second)))
            if self.matters(a, b):
                closest[a, b] = min(distance, closest.get((a, b), SIGHT))
        for first, second in self.boxes_nearby():
            a, b = sorted((self.scene.label(first), self.scene.label(second)))
            closest[a, b] = min(self.scene.distance(first, second, SIGHT), closest.get((a, b), SIGHT))
        return [(a, b, distance) for (a, b), distance in closest.items()]

    def boxes_nearby(self) -> list[tuple[int, int]]:
        """Pairs of boxes, of the load or the fingers and of what stands: MuJoCo's contacts leave out separate boxes."""
        model, data = self.scene.model, self.scene.data
        boxes = np.nonzero((model.geom_type == mujoco.mjtGeom.mjGEOM_BOX) & (model.geom_contype > 0))[0]
        moving = boxes[model.geom_contype[boxes] != STATIC_BITS[0]]
        standing = boxes[model.geom_contype[boxes] == STATIC_BITS[0]]
        R = data.geom_xmat.reshape(-1, 3, 3)
        extent = np.einsum("nij,nj->ni", np.abs(R), model.geom_size)
        apart = np.abs(data.geom_xpos[moving][:, None] - data.geom_xpos[standing][None])
        gap = np.maximum(apart - extent[moving][:, None] - extent[standing][None], 0)
        rows, columns = np.nonzero(np.linalg.norm(gap, axis=2) < BOX_SIGHT)
        return list(zip(moving[rows].tolist(), standing[columns].tolist(), strict=True))

    def matters(self, a: str, b: str) -> bool:
        static = [name.startswith(("part/", "environment/")) for name in (a, b)]
        held = [name.startswith("held/") for name in (a, b)]
        if any(static) and self.base in (a, b):
            return False  # the base may stand on the environment
        return not (any(held) and any(name in self.hand for name in (a, b)))

    def penetration(self, a: str, b: str) -> float:
        """Exact distance of two bodies over all their geoms, m."""
        first, second = self.scene.geoms(a), self.scene.geoms(b)
        return min(self.scene.distance(i, j, SIGHT) for i in first for j in second)


Drawn = tuple[int, int, Array, float, Array]


def situations(planner: RemovalPlanner, count: int, each: int, rng: np.random.Generator) -> list[Drawn]:
    """Part, state, T_tool_part, width, configurations (each, n): spread over the joint space, and near grasps."""
    assembly, robot = planner.assembly, planner.robot
    ik = InverseKinematics(robot)
    found: list[Drawn] = []
    parts = members(assembly.root)
    while len(found) < count:
        part = int(rng.choice(parts))
        state = random_states(assembly, 1, rng)[0] | 1 << part
        candidates = planner.reach.candidates(part)
        candidate = candidates[int(rng.integers(len(candidates)))]
        T_world_tool = assembly.parts[part].T_world_part @ candidate.T_part_tool
        T_world_tool[2, 3] += rng.uniform(0, 0.15)
        starts = ik.solve(T_world_tool)
        wild = random_configurations(robot, each // 3, rng)
        if not len(starts):
            continue
        near = starts[rng.integers(len(starts), size=each - each // 3)]
        near = near + rng.normal(size=near.shape) * rng.choice([0.02, 0.1, 0.4], size=(len(near), 1))
        rows = np.concatenate([wild, np.clip(near, robot.arm.lower, robot.arm.upper)])
        found.append((part, state, pose_inverse(candidate.T_part_tool), candidate.width, rows))
    return found


def compare_with_mujoco(planner: RemovalPlanner, count: int, each: int, padding: float, seed: int) -> dict[str, int]:
    """Checks `count * each` configurations; returns how many were free, hits, and false alarms."""
    assembly, robot, workcell = planner.assembly, planner.robot, planner.workcell
    oracle = Oracle(assembly, workcell)
    work = robot.workspace(64)
    tally = {"free": 0, "hit": 0, "false alarm": 0}
    for part, state, T_tool_part, width, rows in situations(planner, count, each, np.random.default_rng(seed)):
        held = robot.held(width, T_tool_part, assembly.body(part))
        present = flags_of(state & ~(1 << part), len(assembly.parts))
        oracle.scene.show(state, part)
        oracle.scene.grip(T_tool_part, width)
        for q in rows:
            answer = check(robot.arm, held, planner.world, present, padding, q, work)
            near = oracle.near(q)
            hits = [(a, b) for a, b, distance in near if distance < padding - 1e-6]
            if answer == FREE:
                tally["free"] += 1
                missed = [(a, b) for a, b in hits if oracle.penetration(a, b) < padding - 1e-6]
                assert not missed, (missed, q.tolist(), part, bin(state))
                continue
            tally["hit"] += 1
            if hits:
                continue
            tally["false alarm"] += 1
            # Padding grows boxes along their edges, so their corners grow by more.
            excess = {(a, b): d - np.sqrt(3) * padding for a, b, d in near}
            assert min(excess.values(), default=1.0) < 1e-3, (answer, excess, q.tolist(), part, bin(state))
    return tally


def test_no_missed_collision_and_no_unexplained_alarm(planner: RemovalPlanner) -> None:
    tally = compare_with_mujoco(planner, 40, 75, 0.0, 21)
    assert sum(tally[key] for key in ("free", "hit")) == 3_000
    assert min(tally["free"], tally["hit"]) > 450
    assert tally["false alarm"] < 0.25 * (tally["free"] + tally["false alarm"])


def test_padding_is_the_distance_below_which_things_touch(planner: RemovalPlanner) -> None:
    tally = compare_with_mujoco(planner, 20, 75, 0.012, 22)
    assert min(tally["free"], tally["hit"]) > 200


@pytest.mark.slow
@pytest.mark.parametrize("padding", [0.0, 0.0016, 0.03])
def test_no_missed_collision_in_other_configurations(planner: RemovalPlanner, padding: float) -> None:
    tally = compare_with_mujoco(planner, 100, 100, padding, 23)
    assert sum(tally[key] for key in ("free", "hit")) == 10_000


def test_configurations_with_more_clearance_than_the_cover_needs_are_free(planner: RemovalPlanner) -> None:
    """What is 0.1 mm from everything must never be refused; from another link of the arm with a table between 2 mm."""
    assembly, robot = planner.assembly, planner.robot
    oracle = Oracle(assembly, planner.workcell)
    work = robot.workspace(64)
    by_treatment = {"table": 0.002, "hulls": 1e-4, "never meet": 0.0}  # m
    needed = {
        frozenset((robot.bodies[pair.first], robot.bodies[pair.second])): by_treatment[pair.treatment]
        for pair in robot.pairs
        if pair.treatment in by_treatment
    }
    clear = 0
    for part, state, T_tool_part, width, rows in situations(planner, 25, 60, np.random.default_rng(24)):
        held = robot.held(width, T_tool_part, assembly.body(part))
        oracle.scene.show(state, part)
        oracle.scene.grip(T_tool_part, width)
        for q in rows:
            near = oracle.near(q)
            limits = [needed.get(frozenset((a, b)), 1e-4) for a, b, _ in near]
            if all(distance > limit for (_, _, distance), limit in zip(near, limits, strict=True)):
                clear += 1
                flags = flags_of(state & ~(1 << part), len(assembly.parts))
                assert check(robot.arm, held, planner.world, flags, 0.0, q, work) == FREE
    assert clear > 100


@functools.cache
def turned_scene(seed: int) -> tuple[Assembly, Workcell]:
    """Boxes turned anyhow around the arm: nothing is parallel to anything, and everything but the bar is fixed."""
    rng = np.random.default_rng(seed)
    home = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
    base = np.eye(4)
    base[:3, :3], base[:3, 3] = random_rotation(rng), [0.1, -0.2, 0.3]
    far = np.eye(4)
    far[:3, 3] = [5.0, 5.0, 5.0]
    bar = Part("bar", Box((0.24, 0.02, 0.03)), far, 0.1)
    post = Part("post", Box((0.01, 0.01, 0.01)), far + np.eye(4, k=3), 0.1, True)
    assembly = Assembly("turned", (bar, post))
    boxes: list[OrientedBox] = []
    while len(boxes) < 40:
        box = random_box(rng, base[:3, 3] - 0.8, base[:3, 3] + 0.8, 0.01, 0.12)
        if np.linalg.norm(box.T_frame_box[:3, 3] - base[:3, 3]) > 0.45:
            boxes.append(box)
    obstacles = tuple(Obstacle(f"box{i}", box) for i, box in enumerate(boxes))
    panda = load_robot_description("panda")
    return assembly, Workcell("turned", panda, base, home, np.array([0.3, 0.0, 0.5]), environment=obstacles)


def test_no_missed_collision_among_boxes_turned_anyhow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("takeapart.removal.planner.require_placement", lambda *_: None)  # the arm rests among them
    assembly, workcell = turned_scene(31)
    planner = RemovalPlanner(assembly, workcell)
    robot, oracle, work = planner.robot, Oracle(assembly, workcell), planner.robot.workspace(64)
    rng = np.random.default_rng(32)
    free = hits = 0
    oracle.scene.show(1, 0)
    for _ in range(20):
        T_tool_part = np.eye(4)
        T_tool_part[:3, :3] = random_rotation(rng)
        held = robot.held(0.04, T_tool_part, assembly.body(0))
        oracle.scene.grip(T_tool_part, 0.04)
        for q in random_configurations(robot, 100, rng):
            answer = check(robot.arm, held, planner.world, flags_of(0, 2), 0.0, q, work)
            near = oracle.near(q)
            deep = [(a, b) for a, b, distance in near if distance < -1e-6 and oracle.penetration(a, b) < -1e-6]
            assert answer != FREE or not deep, (deep, q.tolist())
            free += answer == FREE
            hits += bool(deep)
    assert free > 150 and hits > 400


# ---- what the kernels say among themselves


def a_load(robot: RobotModel, rng: np.random.Generator) -> HeldArrays:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = random_rotation(rng), [0, 0, 0.02]
    return robot.held(0.03, T, Box((0.3, 0.02, 0.03)).boxes() + Box((0.05, 0.06, 0.02)).boxes())


def test_collect_marks_exactly_the_owners_that_single_checks_mark(robot: RobotModel) -> None:
    rng = np.random.default_rng(41)
    owners = 12
    marked = 0
    for _ in range(12):
        boxes = boxes_around(robot, 30, rng)
        world = world_of(robot, [(box, i % (owners + 1)) for i, box in enumerate(boxes)])
        held = a_load(robot, rng)
        work = robot.workspace(64)
        for q in random_configurations(robot, 30, rng):
            padding = float(rng.choice([0.0, 0.01]))
            hits = np.zeros(owners + 1, dtype=np.uint8)
            everything = np.ones(owners + 1, dtype=np.uint8)
            apart = collect(robot.arm, held, world, everything, padding, q, work, hits)
            singles = []
            for owner in range(owners + 1):
                only = np.zeros(owners + 1, dtype=np.uint8)
                only[owner] = 1
                singles.append(check(robot.arm, held, world, only, padding, q, work) == HIT_WORLD)
            np.testing.assert_array_equal(hits.astype(bool), singles)
            nothing = np.zeros(owners + 1, dtype=np.uint8)
            assert apart == (check(robot.arm, held, world, nothing, padding, q, work) == FREE)
            marked += int(hits.sum())
            # Absent owners are not marked, whatever they hit.
            absent = rng.random(owners + 1) < 0.5
            some = np.zeros(owners + 1, dtype=np.uint8)
            collect(robot.arm, held, world, (~absent).astype(np.uint8), padding, q, work, some)
            np.testing.assert_array_equal(some.astype(bool), hits.astype(bool) & ~absent)
    assert marked > 200


def test_more_padding_never_frees_a_configuration(robot: RobotModel) -> None:
    rng = np.random.default_rng(42)
    changes = 0
    for _ in range(4):
        world, held, work = world_around(robot, 25, rng), a_load(robot, rng), robot.workspace(64)
        present = np.ones(26, dtype=np.uint8)
        for q in random_configurations(robot, 50, rng):
            answers = [check(robot.arm, held, world, present, p, q, work) == FREE for p in (0, 0.003, 0.01, 0.03, 0.05)]
            assert answers == sorted(answers, reverse=True)
            changes += answers[0] and not answers[-1]
    assert changes > 8


def test_self_collision_is_told_from_hits_of_the_world(robot: RobotModel) -> None:
    rng = np.random.default_rng(43)
    work, held = robot.workspace(64), a_load(robot, rng)
    world = world_around(robot, 5, rng)
    nothing = np.zeros(6, dtype=np.uint8)
    answers = {check(robot.arm, held, world, nothing, 0.0, q, work) for q in random_configurations(robot, 500, rng)}
    assert answers == {FREE, HIT_SELF}


def test_hand_alone_marks_what_hand_and_load_hit(planner: RemovalPlanner) -> None:
    """`collect_hand` is `collect` for the last link, gripper and load: never more."""
    assembly, robot = planner.assembly, planner.robot
    work = robot.workspace(64)
    parts = len(assembly.parts)
    oracle = Oracle(assembly, planner.workcell)
    seen = 0
    for part, state, T_tool_part, width, rows in situations(planner, 20, 30, np.random.default_rng(44)):
        held = robot.held(width, T_tool_part, assembly.body(part))
        present = flags_of(state & ~(1 << part), parts)
        oracle.scene.show(state, part)
        oracle.scene.grip(T_tool_part, width)
        for q in rows:
            hits, by_hand = np.zeros(parts + 1, dtype=np.uint8), np.zeros(parts + 1, dtype=np.uint8)
            collect(robot.arm, held, planner.world, present, 0.0, q, work, hits)
            collect_hand(robot.arm, held, planner.world, present, 0.0, robot.tool_pose(q, work), work, by_hand)
            assert not (by_hand & ~hits).any()
            carried = {*oracle.hand, f"held/{assembly.parts[part].name}"}
            for a, b, distance in oracle.near(q):
                other = b if a in carried else a
                if (
                    distance < -1e-6
                    and carried & {a, b}
                    and other.startswith("part/")
                    and oracle.penetration(a, b) < -1e-6
                ):
                    number = assembly.index[other.removeprefix("part/")]
                    assert by_hand[parts if assembly.parts[number].fixed else number]
                    seen += 1
    assert seen > 50


def test_boxes_far_from_the_grid_are_seen_and_points_outside_it_are_free(robot: RobotModel) -> None:
    work, held = robot.workspace(64), robot.held(0.02)
    q = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
    tool = robot.tool_pose(q)
    at_tool, far = tool.copy(), np.eye(4)
    at_tool[:3, 3] += tool[:3, 2] * 0.009
    far[:3, 3] = [3.0, 3.0, 3.0]
    touching = world_of(robot, [(OrientedBox(at_tool, np.full(3, 0.01)), 0), (OrientedBox(far, np.full(3, 0.01)), 1)])
    for present, expected in (([1, 1, 1], HIT_WORLD), ([1, 0, 0], HIT_WORLD), ([0, 1, 1], FREE)):
        assert check(robot.arm, held, touching, np.array(present, dtype=np.uint8), 0.0, q, work) == expected
    outside = world_of(robot, [(OrientedBox(far, np.full(3, 0.01)), 0)])
    assert check(robot.arm, held, outside, np.ones(2, dtype=np.uint8), 0.0, q, work) == FREE


@pytest.mark.parametrize("size", [(0.4, 0.4, 0.02), (0.6, 0.5, 0.3), (0.9, 0.02, 0.02)])
def test_large_parts_are_held_and_checked_too(robot: RobotModel, size: tuple[float, float, float]) -> None:
    """Parts need not be bars: a plate has no thin cross-section for the broad phase to lean on."""
    rng = np.random.default_rng(45)
    T = np.eye(4)
    T[2, 3] = size[2] / 2
    body = Box(size).boxes()
    held, work = robot.held(0.02, T, body), robot.workspace(64)
    outcomes = {True: 0, False: 0}
    for _ in range(10):
        boxes = [random_box(rng, np.array([-0.8, -0.6, 0.0]), np.array([0.4, 1.0, 1.2]), 0.01, 0.03) for _ in range(6)]
        world = world_of(robot, [(box, i) for i, box in enumerate(boxes)])
        for q in random_configurations(robot, 60, rng):
            load = body[0].moved(robot.tool_pose(q, work) @ T)
            for i, box in enumerate(boxes):
                distance = box_distance(load, box)
                only = np.zeros(7, dtype=np.uint8)
                only[i] = 1
                hit = check(robot.arm, held, world, only, 0.0, q, work) == HIT_WORLD
                assert hit or distance > 0.0 or (distance < 1e-6 and not meet(load, box, 0.0))
                outcomes[hit] += 1
    assert min(outcomes.values()) > 20


# ---- derivatives and bounds of motion


def test_jacobian_agrees_with_finite_differences(robot: RobotModel) -> None:
    h = 1e-6
    for q in random_configurations(robot, 100, np.random.default_rng(51)):
        work, J = robot.workspace(64), np.zeros((6, robot.joints))
        forward(robot.arm, q, work)
        jacobian(work, J)
        for j in range(robot.joints):
            step = np.zeros(robot.joints)
            step[j] = h
            before, after = robot.tool_pose(q - step), robot.tool_pose(q + step)
            linear = (after[:3, 3] - before[:3, 3]) / (2 * h)
            spin = (after[:3, :3] - before[:3, :3]) / (2 * h) @ robot.tool_pose(q)[:3, :3].T
            angular = np.array([spin[2, 1] - spin[1, 2], spin[0, 2] - spin[2, 0], spin[1, 0] - spin[0, 1]]) / 2
            np.testing.assert_allclose(J[:, j], np.concatenate([linear, angular]), atol=1e-7)


def points_of(robot: RobotModel, held: HeldArrays, q: Array) -> list[tuple[int, Array]]:
    """Points (K, 3) in the world of every body and then of fingers and part, each with the frame it moves with."""
    work = robot.workspace(64)
    forward(robot.arm, q, work)
    place_held(held, work)
    directions = np.concatenate([np.eye(3), -np.eye(3)])
    found = []
    for body in range(len(robot.arm.body_frame)):
        frame = int(robot.arm.body_frame[body])
        some = slice(int(robot.arm.body_start[body]), int(robot.arm.body_start[body + 1]))
        local = robot.arm.sphere_center[some, None] + robot.arm.sphere_radius[some, None, None] * directions
        found.append((frame, local.reshape(-1, 3) @ work.R[frame].T + work.p[frame]))
    for g in range(2):
        corners = []
        for h in range(held.group[g], held.group[g + 1]):
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = work.box_axes[h].T, work.box_center[h]
            corners.append(OrientedBox(T, held.half[h]).corners())
        found.append((robot.joints, np.concatenate(corners)))
    return found


def test_margins_bound_every_motion_however_far_the_joints_turn(robot: RobotModel) -> None:
    rng = np.random.default_rng(52)
    tight = []
    for q in random_configurations(robot, 150, rng):
        held, work = a_load(robot, rng), robot.workspace(64)
        start = points_of(robot, held, q)
        for size in (1e-3, 0.05, 0.3, 1.5):
            turn = rng.normal(size=robot.joints) * (rng.random(robot.joints) < rng.choice([0.3, 1.0]))
            turn *= size / max(float(np.abs(turn).sum()), 1e-9)
            place(robot.arm, held, q, work)
            set_motion(robot.arm, held, q - turn, q + turn, 0.5, work)
            bounds = [*work.margin, *work.group_margin]
            for share in (-1.0, 0.4, 1.0):
                ends = points_of(robot, held, q + share * turn)
                moved = [
                    float(np.linalg.norm(after - before, axis=1).max())
                    for (_, before), (_, after) in zip(start, ends, strict=True)
                ]
                assert all(m <= bound + 1e-12 for m, bound in zip(moved, bounds, strict=True))
            if size == 0.05 and bounds[-1] > 1e-6:
                tight.append(moved[-1] / bounds[-1])
    assert np.median(tight) > 0.6, "a bound this loose would cost most checks"


def test_margins_between_two_frames_bound_what_one_sees_of_the_other(robot: RobotModel) -> None:
    rng = np.random.default_rng(54)
    arm = robot.arm
    for q in random_configurations(robot, 60, rng):
        held, work, other = a_load(robot, rng), robot.workspace(64), robot.workspace(64)
        turn = rng.normal(size=robot.joints) * rng.choice([0.01, 0.1])
        place(arm, held, q, work)
        set_motion(arm, held, q - turn, q + turn, 0.5, work)
        place(arm, held, q + turn, other)
        for a, b in arm.self_pairs:
            f, g = int(arm.body_frame[a]), int(arm.body_frame[b])
            before, after = (w.R[f].T @ (w.body[b] - w.p[f]) for w in (work, other))
            x, y, z = work.body[b].tolist()
            bound = motion_of_ball(work, g, f, x, y, z, float(arm.body_radius[b]))
            assert np.linalg.norm(after - before) <= bound + 1e-12


def test_a_motion_that_is_free_is_free_at_all_its_configurations(robot: RobotModel) -> None:
    rng = np.random.default_rng(55)
    proved = 0
    for _ in range(30):
        world = world_around(robot, 14, rng)
        held, work = a_load(robot, rng), robot.workspace(64)
        present = np.ones(15, dtype=np.uint8)
        for q in random_configurations(robot, 25, rng):
            turn = rng.normal(size=robot.joints) * rng.choice([0.005, 0.02, 0.05])
            place(robot.arm, held, q, work)
            if set_motion(robot.arm, held, q - turn, q + turn, 0.5, work) > LARGEST_MARGIN:
                continue
            if placed(robot.arm, held, world, present, 0.001, work) != FREE:
                continue
            proved += 1
            for share in rng.uniform(-1, 1, 12):
                assert check(robot.arm, held, world, present, 0.001, q + share * turn, work) == FREE
    assert proved > 100


def test_grid_gives_what_a_full_list_gives(robot: RobotModel) -> None:
    """The same boxes, each in a world of its own, mark the same owners: no cell of the grid loses a box."""
    rng = np.random.default_rng(53)
    boxes = boxes_around(robot, 40, rng)
    together: WorldArrays = world_of(robot, [(box, i) for i, box in enumerate(boxes)])
    alone = [world_of(robot, [(box, 0)]) for box in boxes]
    held, work = a_load(robot, rng), robot.workspace(64)
    for q in random_configurations(robot, 60, rng):
        hits = np.zeros(41, dtype=np.uint8)
        collect(robot.arm, held, together, np.ones(41, dtype=np.uint8), 0.005, q, work, hits)
        for i, world in enumerate(alone):
            only = np.zeros(2, dtype=np.uint8)
            collect(robot.arm, held, world, np.ones(2, dtype=np.uint8), 0.005, q, work, only)
            assert only[0] == hits[i]
