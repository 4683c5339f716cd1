"""What is proved of a motion, against brute force: everything against everything at fine steps.

Most cases are made to be hard: something touches at one end of a motion only, and at its middle, where the kernels
look, even the balls around the two are apart. A kernel that forgets how far one of them moves calls such a motion free.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
import trimesh
from ssik.prebuilt import franka_panda_ik

from brute_force import box_gaps, corners, frames, load_boxes, self_gap, world_gap
from conftest import boxes_around, random_configurations, random_rotation, scene_of, world_of
from takeapart.model.geometry import Array, Box, OrientedBox, pose
from takeapart.motion.blockers import path_blockers
from takeapart.motion.edges import joint_edge_free, resampled, tool_edge
from takeapart.motion.scene import Scene, is_free, new_scene, piece_free
from takeapart.robot.arrays import ArmArrays, Flags, HeldArrays, WorldArrays, workspace
from takeapart.robot.kernels import FREE, LARGEST_MARGIN, check, collect_placed, held_hits_world, placed
from takeapart.robot.kinematics import motion_of_ball, place, set_motion
from takeapart.robot.model import RobotModel
from takeapart.robot.world import build_world, owner_fields, with_field

PADDING, STEP, SPACING = 0.0016, 0.001, 0.01  # m
READY = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])  # rad
ASIDE = READY - [0, 0, 0, 0, 0, 0, np.pi / 2]  # what is long stands across the arm
FAR = OrientedBox(pose((9.0, 9.0, 9.0)), np.full(3, 0.01))


def bar_in_hand(robot: RobotModel, length: float, turned: Array | None = None) -> HeldArrays:
    """A bar held by its middle, across the approach direction unless it is turned."""
    T = np.eye(4)
    if turned is not None:
        T[:3, :3] = turned
    return robot.held(0.02, T, Box((length, 0.02, 0.02)).boxes())


def alone(robot: RobotModel, held: HeldArrays) -> Scene:
    """Nothing stands near."""
    return scene_of(robot, held, build_world([(FAR, 0)]), 1, 1, PADDING, STEP)


# ---- the arm against itself, and against what it carries


@dataclass(frozen=True)
class Approach:
    """A motion from q + turn to q - turn, rad, that touches at its end and nowhere near its middle.

    Args:
        gap: of the balls around the two at the middle, m.
        motions: how far the two get from there to the end, m.
    """

    arm: ArmArrays
    held: HeldArrays
    q: Array
    turn: Array
    gap: float
    motions: tuple[float, float]


def with_two_bodies(arm: ArmArrays, first: tuple[int, Array], second: tuple[int, Array], radius: float) -> ArmArrays:
    """The arm with a ball as the only body on each of two frames, its middle in the frame's coordinates, m."""
    centers = np.array([np.zeros(3), first[1], second[1]])
    sphere = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    ball = np.asarray(sphere.vertices) / np.einsum("ij,ij->i", sphere.face_normals, sphere.triangles[:, 0]).min()
    hulls = [1e-3 * ball, first[1] + radius * ball, second[1] + radius * ball]  # around the balls
    reach = radius * float(np.linalg.norm(ball, axis=1).max())
    tables = {name: getattr(arm, name)[:0] for name in arm._fields if name.startswith("near_")}
    return arm._replace(
        sphere_center=centers,
        sphere_x=centers[:, 0].copy(),
        sphere_y=centers[:, 1].copy(),
        sphere_z=centers[:, 2].copy(),
        sphere_radius=np.array([2e-3, reach, reach]),
        body_start=np.arange(4, dtype=np.uint64),
        corner=np.concatenate(hulls),
        corner_start=np.arange(4) * len(ball),
        body_frame=np.array([0, first[0], second[0]], dtype=np.uint64),
        body_center=centers,
        body_radius=np.array([2e-3, reach, reach]),
        self_pairs=np.array([[1, 2]], dtype=np.int32),
        held_bodies=np.zeros(0, dtype=np.int32),
        **tables,
    )


def end_touching(
    robot: RobotModel, loads: bool, rng: np.random.Generator
) -> tuple[ArmArrays, HeldArrays, Array, tuple[int, Array], tuple[int, Array], float]:
    """An arm and a load, a configuration in which two of its bodies, or body and load, touch, and the balls around the
    two: frame and middle, and their radii in all.
    """
    n, radius, depth = robot.joints, 0.025, 0.001
    while True:
        q = random_configurations(robot, 1, rng)[0]
        T = frames(robot.arm, q[None])[0]
        f = int(rng.integers(1, n - 1))
        g = n + 1 if loads else int(rng.integers(f + 2, n + 1))  # n + 1 is the tool
        first = (f, rng.uniform(-0.12, 0.12, 3))
        touched = T[f, :3, :3] @ first[1] + T[f, :3, 3]
        towards = rng.normal(size=3)
        towards /= np.linalg.norm(towards)
        inverse = np.linalg.inv(T[g])
        if not loads:
            second = (g, inverse[:3] @ np.append(touched + towards * (2 * radius - depth), 1.0))
            if np.linalg.norm(second[1]) < 0.5:
                arm = with_two_bodies(robot.arm, first, second, radius)
                return arm, robot.held(0.02), q, first, second, 2 * radius
            continue
        T_tool_part = np.eye(4)  # a face of the part is turned towards what it touches
        T_tool_part[:3, :3] = inverse[:3, :3] @ np.linalg.qr(np.column_stack([towards, rng.normal(size=(3, 2))])).Q
        T_tool_part[:3, 3] = inverse[:3] @ np.append(touched + towards * (radius + 0.01 - depth), 1.0)
        if np.linalg.norm(T_tool_part[:3, 3]) < 0.5 and T_tool_part[:3, 3].max() > 0.1:
            arm = with_two_bodies(robot.arm, first, first, radius)
            arm = arm._replace(self_pairs=np.zeros((0, 2), np.int32), held_bodies=np.array([1], np.int32))
            held = robot.held(0.02, T_tool_part, Box((0.02, 0.02, 0.02)).boxes())
            return arm, held, q, first, (g, held.group_center[1]), radius + float(held.group_radius[1])


def approaches(robot: RobotModel, loads: bool, count: int, seed: int) -> Iterator[Approach]:
    """Motions that end where two bodies touch, and at the middle of which the balls around them are apart.

    Of the two only the first moves, only the second, or both.
    """
    rng, n, h, done = np.random.default_rng(seed), robot.joints, 1e-6, 0
    while done < count:
        arm, held, end, first, second, radii = end_touching(robot, loads, rng)

        def middles(rows: Array) -> list[Array]:
            T = frames(arm, rows)
            return [T[:, f, :3, :3] @ c + T[:, f, :3, 3] for f, c in (first, second)]

        a, b = middles(np.vstack([end, end + h * np.eye(n)]))
        Ja, Jb = (a[1:] - a[0]).T / h, (b[1:] - b[0]).T / h  # (3, n)
        slope = (a[0] - b[0]) / np.linalg.norm(a[0] - b[0]) @ (Ja - Jb)  # of the distance
        still = ((0.0, 1.0), (1.0, 0.0), (1.0, 1.0))[done % 3]
        turn = np.linalg.solve(still[0] * Ja.T @ Ja + still[1] * Jb.T @ Jb + 1e-3 * np.eye(n), slope)
        turn *= rng.uniform(0.015, 0.035) / (slope @ turn)
        q = end + turn
        rows = np.array([end, q, q + turn])
        if (rows > robot.arm.upper).any() or (rows < robot.arm.lower).any() or np.abs(turn).sum() > 0.6:
            continue
        ends, at_middle = middles(np.array([end, q])), self_gap(arm, held, q[None])[0]
        gap = float(np.linalg.norm(ends[0][1] - ends[1][1])) - radii
        work = workspace(arm, 64)
        place(arm, held, q, work)
        if gap > PADDING and at_middle > PADDING and set_motion(arm, held, q - turn, q + turn, 0.5, work) < 0.05:
            motions = [float(np.linalg.norm(middle[1] - middle[0])) for middle in ends]
            yield Approach(arm, held, q, turn, gap, (motions[0], motions[1]))
            done += 1


@pytest.mark.parametrize("loads", [False, True], ids=["bodies", "load"])
def test_a_motion_that_ends_in_the_arm_itself_is_not_called_free(robot: RobotModel, loads: bool) -> None:
    by_first, by_second, nothing = 0, 0, build_world([(FAR, 0)])
    for case in approaches(robot, loads, 60, 61):
        work = workspace(case.arm, 64)
        scene = new_scene(case.arm, case.held, nothing, np.ones(2, np.uint8), PADDING, STEP, work)
        end, start = case.q - case.turn, case.q + case.turn
        assert self_gap(case.arm, case.held, end[None])[0] < 1e-6, "the case itself"
        place(case.arm, case.held, case.q, work)
        set_motion(case.arm, case.held, start, end, 0.5, work)
        assert placed(case.arm, case.held, scene.world, scene.present, 0.0, work) != FREE
        hits = np.zeros(2, dtype=np.uint8)
        assert not collect_placed(case.arm, case.held, scene.world, scene.present, 0.0, work, hits)
        assert not path_blockers(scene, np.array([start, end]), hits)
        assert not piece_free(scene, end, start)
        by_first += case.motions[0] > 0.9 * (case.gap - 2 * PADDING) and case.motions[1] < case.gap / 2
        by_second += case.motions[1] > 0.9 * (case.gap - 2 * PADDING) and case.motions[0] < case.gap / 2
    assert by_first > 5 and by_second > 5, "either body's own motion must matter"


def test_motions_called_free_are_free_of_the_arm_itself_at_fine_steps(robot: RobotModel) -> None:
    rng = np.random.default_rng(62)
    proved = 0
    for turned in range(4):
        held = bar_in_hand(robot, 0.4, random_rotation(rng) if turned else None)
        scene = alone(robot, held)
        for q in random_configurations(robot, 30, rng):
            b = np.clip(q + rng.normal(size=robot.joints) * 0.12, robot.arm.lower, robot.arm.upper)
            if not is_free(scene, q) or not joint_edge_free(scene, q, b):
                continue
            proved += 1
            least = self_gap(robot.arm, held, np.linspace(q, b, 25)).min()
            assert least > PADDING - STEP / 2
            hits = np.zeros(2, dtype=np.uint8)
            assert not path_blockers(scene, np.array([q, b]), hits) or least > PADDING - 1e-9
    assert proved > 20


def test_kinematics_of_the_brute_force_are_those_of_the_library(robot: RobotModel) -> None:
    rows = random_configurations(robot, 50, np.random.default_rng(63))
    for q, T in zip(rows, frames(robot.arm, rows)[:, -1], strict=True):
        expected = robot.T_world_base @ np.asarray(franka_panda_ik.fk(q)) @ robot.T_flange_tool(0.0)
        np.testing.assert_allclose(T, expected, atol=1e-9)


def test_how_far_a_point_moves_is_bounded_where_it_does_not_move_at_first(robot: RobotModel) -> None:
    """Turns of several joints that hold a point still but for how the arm bends: the second order alone decides."""
    rng, h, n, work = np.random.default_rng(0), 1e-6, robot.joints, robot.workspace(64)
    held, tightest = robot.held(0.02), 0.0
    for q in random_configurations(robot, 400, rng):
        frame, local = int(rng.integers(4, n + 1)), rng.uniform(-0.2, 0.2, 3)

        def at(rows: Array, frame: int = frame, local: Array = local) -> Array:
            T = frames(robot.arm, rows)[:, frame]
            return np.asarray(T[:, :3, :3] @ local + T[:, :3, 3])

        point = at(q[None])[0]
        still = np.linalg.svd(((at(q + h * np.eye(n)) - point) / h)[:frame].T)[2][3:]
        for _ in range(6):
            turn = np.zeros(n)
            turn[:frame] = rng.normal(size=len(still)) @ still
            turn *= 0.3 / np.abs(turn).sum()
            place(robot.arm, held, q, work)
            set_motion(robot.arm, held, q - turn, q + turn, 0.5, work)
            bound = motion_of_ball(work, frame, 0, point[0], point[1], point[2], 0.0)
            moved = np.linalg.norm(at(np.array([q + turn, q - turn])) - point, axis=1).max()
            assert moved <= bound
            tightest = max(tightest, moved / bound)
    assert tightest > 0.3, "a bound that is far too large would hide any fault of it"


# ---- arm and load against what stands around


@dataclass(frozen=True)
class Contact:
    """A small box that something touches at q - turn, the end of a motion, with the number of that box."""

    q: Array
    turn: Array
    owner: int


def contacts(robot: RobotModel, held: HeldArrays, count: int, seed: int) -> tuple[list[Contact], list[OrientedBox]]:
    """Boxes of 6 mm in the way of a corner of the arm, or of an end of the load; nothing is near in mid-motion."""
    arm, rng = robot.arm, np.random.default_rng(seed)
    found: list[Contact] = []
    boxes: list[OrientedBox] = []
    while len(found) < count:
        end = random_configurations(robot, 1, rng)[0]
        turn = rng.normal(size=robot.joints)
        turn *= rng.uniform(0.02, 0.05) / np.abs(turn).sum()
        both = np.array([end, end + turn])
        poses = frames(arm, both)
        if rng.random() < 0.5:
            body = int(rng.integers(3, len(arm.body_frame)))
            points = corners(arm, poses, body)
            s = int(rng.integers(points.shape[1]))
            moved, touched, reach = points[0, s] - points[1, s], points[0, s], 0.0
        else:
            T, half = load_boxes(held, poses, int(held.group[1]))
            corner = np.array([rng.choice([-1, 1]) * half[0, 0], 0.0, 0.0])
            ends = T[:, 0, :3, :3] @ corner + T[:, 0, :3, 3]
            moved, touched, reach = ends[0] - ends[1], ends[0], 0.008
        size = float(np.linalg.norm(moved))
        if size < 0.008:
            continue
        box = OrientedBox(pose(touched + moved / size * (reach + 0.001)), np.full(3, 0.003))
        gaps = world_gap(robot.arm, held, [box], both)[:, 0]
        if gaps[0] < 1e-4 and gaps[1] > 0.004:
            found.append(Contact(both[1], turn, len(boxes)))
            boxes.append(box)
    return found, boxes


def field_world(robot: RobotModel, boxes: list[OrientedBox]) -> tuple[WorldArrays, Flags]:
    """Every box with an owner of its own, and the clearance fields of all."""
    world = build_world([(box, i) for i, box in enumerate(boxes)], robot.largest_ball + PADDING + LARGEST_MARGIN)
    return world, owner_fields(world, len(boxes) + 1)


def test_a_motion_that_ends_in_a_box_is_not_called_free(robot: RobotModel) -> None:
    """Also where the clearance field of the state says how far everything is."""
    held = bar_in_hand(robot, 0.5)
    cases, boxes = contacts(robot, held, 40, 64)
    everything, fields = field_world(robot, boxes)
    seen = 0
    for case in cases:
        present = np.zeros(len(boxes) + 1, dtype=np.uint8)
        present[case.owner] = 1
        world = with_field(everything, fields, present)
        scene = scene_of(robot, held, world, 1 << case.owner, len(boxes), PADDING, STEP)
        start, end = case.q + case.turn, case.q - case.turn
        assert not piece_free(scene, end, start)
        hits = np.zeros(len(boxes) + 1, dtype=np.uint8)
        assert not path_blockers(scene, np.array([start, end]), hits) or hits[case.owner]
        place(robot.arm, held, case.q, scene.work)
        if set_motion(robot.arm, held, start, end, 0.5, scene.work) > LARGEST_MARGIN:
            continue
        seen += 1
        assert placed(robot.arm, held, world, present, 0.0, scene.work) != FREE
        marked = np.zeros(len(boxes) + 1, dtype=np.uint8)
        collect_placed(robot.arm, held, world, present, 0.0, scene.work, marked)
        assert marked[case.owner] and not (marked & ~present).any()
    assert seen > 15


def test_how_far_fingers_move_counts_where_they_are_far_from_everything(robot: RobotModel) -> None:
    """The corner of a finger meets a box at the end of a motion of 4 cm: no ball around the fingers holds that."""
    rng, h, n = np.random.default_rng(71), 1e-6, robot.joints
    held, work = robot.held(0.04), robot.workspace(64)
    seen = 0
    while seen < 8:
        q = random_configurations(robot, 1, rng)[0]
        T = frames(robot.arm, np.vstack([q, q + h * np.eye(n)]))
        boxes, half = load_boxes(held, T[:1])
        fingers = range(int(held.group[1]))
        corners = np.concatenate([OrientedBox(boxes[0, f], half[f]).corners() for f in fingers])
        middle = T[0, -1, :3, :3] @ held.group_center[0] + T[0, -1, :3, 3]
        corner = corners[int(np.linalg.norm(corners - middle, axis=1).argmax())]
        away = (corner - middle) / np.linalg.norm(corner - middle)
        moves = ((T[1:, -1, :3] - T[0, -1, :3]) / h).reshape(n, 12).T
        goal = np.zeros((3, 4))
        goal[:, 3] = 0.042 * away  # no turning
        turn = np.linalg.lstsq(moves, goal.ravel(), rcond=1e-3)[0]
        rows = np.array([q, q + turn])
        if np.abs(turn).sum() > 0.4 or self_gap(robot.arm, held, rows[:1])[0] < 0.01:
            continue
        T_end = frames(robot.arm, rows[1:])[0, -1] @ np.linalg.inv(T[0, -1])
        box = OrientedBox(pose(T_end[:3, :3] @ corner + T_end[:3, 3]), np.full(3, 0.001))
        place(robot.arm, held, q, work)
        if set_motion(robot.arm, held, q - turn, q + turn, 0.5, work) > LARGEST_MARGIN:
            continue
        everything, fields = field_world(robot, [box])
        world = with_field(everything, fields, np.array([1, 0], np.uint8))
        seen += 1
        present, hits = np.array([1, 0], np.uint8), np.zeros(2, np.uint8)
        assert held_hits_world(robot.arm, held, world, present, 0.0, work, hits, False)
        assert held_hits_world(robot.arm, held, world, present, 0.0, work, hits, True) and hits[0]


def test_a_load_far_from_the_hand_may_move_far_while_the_hand_hardly_moves(robot: RobotModel) -> None:
    """A cube half a metre aside of the tool, which the last joint swings into a box 12 cm away."""
    T_tool_part = pose((0.5, 0.0, 0.0))
    held = robot.held(0.02, T_tool_part, Box((0.02, 0.02, 0.02)).boxes())
    turn = np.zeros(robot.joints)
    turn[6] = 0.24
    for q in READY + np.random.default_rng(72).normal(size=(20, robot.joints)) * 0.2:
        T, _ = load_boxes(held, frames(robot.arm, (q + turn)[None]), int(held.group[1]))
        box = OrientedBox(T[0, 0], np.full(3, 0.01))
        everything, fields = field_world(robot, [box])
        world = with_field(everything, fields, np.array([1, 0], np.uint8))
        scene = scene_of(robot, held, world, 1, 1, PADDING, STEP)
        assert is_free(scene, q)
        place(robot.arm, held, q, scene.work)
        set_motion(robot.arm, held, q - turn, q + turn, 0.5, scene.work)
        assert placed(robot.arm, held, world, scene.present, 0.0, scene.work) != FREE
        assert not piece_free(scene, q - turn, q + turn)
        hits = np.zeros(2, np.uint8)
        assert not path_blockers(scene, np.array([q - turn, q + turn]), hits) or hits[0]


def test_configurations_called_free_keep_their_distance_and_others_touch(robot: RobotModel) -> None:
    """With the clearance field of a state that leaves out half of the boxes."""
    rng = np.random.default_rng(65)
    boxes = boxes_around(robot, 12, rng)
    everything, fields = field_world(robot, boxes)
    outcomes = {True: 0, False: 0}
    for turned in range(3):
        held = bar_in_hand(robot, 0.3, random_rotation(rng) if turned else None)
        present = np.append(rng.random(12) < 0.5, False).astype(np.uint8)
        world, work = with_field(everything, fields, present), robot.workspace(64)
        rows = random_configurations(robot, 50, rng)
        gaps = world_gap(robot.arm, held, boxes, rows)[:, present[:-1].astype(bool)].min(axis=1, initial=np.inf)
        mine = self_gap(robot.arm, held, rows)
        for q, gap, own in zip(rows, gaps, mine, strict=True):
            free = check(robot.arm, held, world, present, PADDING, q, work) == FREE
            assert not free or min(gap, own) > PADDING - 1e-6
            outcomes[free] += 1
    assert min(outcomes.values()) > 20


def lath_in_hand(robot: RobotModel) -> HeldArrays:
    """1.4 m long, and 1 mm thick in the direction in which the last joint swings its ends."""
    return robot.held(0.02, np.eye(4), Box((1.4, 0.001, 0.02)).boxes())


def box_ahead(robot: RobotModel, held: HeldArrays, q: Array, turn: Array, gap: float, half: float) -> OrientedBox:
    """A cube in the way of an end of the lath, which moves as the joints turn, at a distance from it, m, at q."""
    T, size = load_boxes(held, frames(robot.arm, np.array([q, q + 1e-3 * turn])), int(held.group[1]))
    ends = T[:, 0, :3, :3] @ [size[0, 0] - half, 0.0, 0.0] + T[:, 0, :3, 3]
    cube = T[0, 0].copy()
    ahead = np.sign((ends[1] - ends[0]) @ cube[:3, 1]) * cube[:3, 1]
    cube[:3, 3] = ends[0] + (size[0, 1] + half + gap) * ahead
    return OrientedBox(cube, np.full(3, half))


def test_a_needle_in_the_way_of_the_end_of_a_long_lath_is_never_stepped_over(robot: RobotModel) -> None:
    """The hand hardly moves, the end of the lath does: how finely a motion is looked at depends on the lath."""
    rng, held = np.random.default_rng(66), lath_in_hand(robot)
    for _ in range(30):
        a = ASIDE + rng.normal(size=robot.joints) * 0.1
        b = a.copy()
        b[6] += rng.choice([-1, 1]) * rng.uniform(0.02, 0.06)
        middle = a + rng.uniform(0.2, 0.8) * (b - a)
        box = box_ahead(robot, held, middle, b - a, -0.0006, 1e-4)
        scene = scene_of(robot, held, world_of(robot, [(box, 0)]), 1, 1, PADDING, STEP)
        assert world_gap(robot.arm, held, [box], middle[None])[0, 0] < 1e-5
        gone = scene._replace(present=np.array([0, 1], dtype=np.uint8))
        assert piece_free(gone, a, b) and joint_edge_free(gone, a, b)
        assert not piece_free(scene, a, b)
        assert not joint_edge_free(scene, a, b)
        assert not tool_edge(scene, a, b, SPACING, np.empty((4096, robot.joints)))
        hits = np.zeros(2, dtype=np.uint8)
        assert not path_blockers(scene, np.array([a, b]), hits) or hits[0]


def test_a_motion_called_free_comes_no_nearer_than_the_padding_less_half_a_step(robot: RobotModel) -> None:
    """The end of a lath comes straight at a box: one that gets 0.1 mm nearer than that is refused."""
    rng, held = np.random.default_rng(73), lath_in_hand(robot)
    for motion in np.linspace(0.0008, 0.006, 40):
        b = ASIDE + rng.normal(size=robot.joints) * 0.1
        turn = np.zeros(robot.joints)
        turn[6] = rng.choice([-1, 1]) * motion / 0.7
        for gap, free in ((PADDING - STEP / 2 - 1e-4, False), (PADDING + 1e-4, True)):
            box = box_ahead(robot, held, b, turn, gap, 0.005)
            scene = scene_of(robot, held, world_of(robot, [(box, 0)]), 1, 1, PADDING, STEP)
            assert piece_free(scene, b - turn, b) == free, (motion, gap)
            hits = np.zeros(2, dtype=np.uint8)
            rows = np.array([b - turn, b])
            assert path_blockers(scene._replace(padding=PADDING - STEP / 2), rows, hits)
            assert bool(hits[0]) == (not free)


def test_what_a_motion_passes_by_is_not_marked(robot: RobotModel) -> None:
    """Boxes beyond the end of a lath that swings by: marked where they are too near, and not half a step further."""
    rng, held = np.random.default_rng(74), lath_in_hand(robot)
    for motion in np.linspace(0.001, 0.02, 15):
        q = ASIDE + rng.normal(size=robot.joints) * 0.1
        turn = np.zeros(robot.joints)
        turn[6] = motion / 0.7
        for gap, marked in ((PADDING - 1e-4, True), (PADDING + 0.8 * STEP, False)):
            T, size = load_boxes(held, frames(robot.arm, q[None]), int(held.group[1]))
            cube = T[0, 0].copy()
            cube[:3, 3] += (size[0, 0] + 0.005 + gap) * cube[:3, 0]
            scene = scene_of(robot, held, world_of(robot, [(OrientedBox(cube, np.full(3, 0.005)), 0)]), 1, 1, PADDING)
            hits = np.zeros(2, dtype=np.uint8)
            assert path_blockers(scene, np.array([q - turn, q, q + turn]), hits)
            assert bool(hits[0]) == marked, (motion, gap)
            alone_at = np.zeros(2, dtype=np.uint8)
            assert path_blockers(scene, q[None], alone_at) and bool(alone_at[0]) == marked


def test_an_elbow_that_swings_into_a_wall_while_the_tool_stands_still_is_seen(robot: RobotModel) -> None:
    """What moves most is not always what moves last: the hand says nothing about the elbow."""
    rng, h, n = np.random.default_rng(70), 1e-6, robot.joints
    held, seen = robot.held(0.02), 0
    while seen < 25:
        a = READY + rng.normal(size=n) * 0.3
        T = frames(robot.arm, np.vstack([a, a + h * np.eye(n)]))
        still = np.linalg.svd(((T[1:, -1, :3] - T[0, -1, :3]) / h).reshape(n, 12).T)[2][-1]  # moves the tool least
        elbow = corners(robot.arm, T, 4)
        velocity = (elbow[1:, 0] - elbow[0, 0]).T @ still / h
        speed = np.linalg.norm(velocity)
        along, b = velocity / speed, a + still * 0.006 / speed
        at_end = corners(robot.arm, frames(robot.arm, b[None]), 4)[0]
        s = int((at_end @ along).argmax())
        wall = np.eye(4)
        wall[:3, :3] = np.linalg.qr(np.column_stack([along, rng.normal(size=(3, 2))])).Q
        wall[:3, 3] = at_end[s] + 0.004 * along  # 1 mm of the elbow is in it at the end
        box = OrientedBox(wall, np.array([0.005, 0.01, 0.01]))
        gaps = world_gap(robot.arm, held, [box], np.array([(a + b) / 2, b]))[:, 0]
        scene = scene_of(robot, held, world_of(robot, [(box, 0)]), 1, 1, PADDING, STEP)
        if gaps[1] > 0.0 or gaps[0] < PADDING + 2e-4 or not is_free(scene, (a + b) / 2):
            continue
        seen += 1
        assert not piece_free(scene, a, b)
        assert not tool_edge(scene, a, b, SPACING, np.empty((4096, n)))


# ---- ends and rows


def test_an_edge_that_ends_a_hair_too_near_is_refused(robot: RobotModel) -> None:
    """The end itself counts, however little is wrong with it: half a step from it everything is fine."""
    rng = np.random.default_rng(67)
    boxes = boxes_around(robot, 14, rng)
    held = bar_in_hand(robot, 0.2)
    scene = scene_of(robot, held, world_of(robot, [(box, 0) for box in boxes]), 1, 1, PADDING, STEP)
    seen = 0
    for a in random_configurations(robot, 150, rng):
        b = np.clip(a + rng.normal(size=robot.joints) * 0.3, robot.arm.lower, robot.arm.upper)
        if not is_free(scene, a) or is_free(scene, b):
            continue
        low, high = 0.0, 1.0
        for _ in range(40):
            half = (low + high) / 2
            low, high = (half, high) if is_free(scene, a + half * (b - a)) else (low, half)
        length = 2e-4 / np.abs(b - a).sum()  # nothing moves more than 0.4 mm in this share
        start, end = a + (low - length) * (b - a), a + high * (b - a)
        if low < length or not is_free(scene, start):
            continue
        seen += 1
        assert not is_free(scene, end)
        assert not joint_edge_free(scene, start, end)
        assert joint_edge_free(scene, start, a + (low - length / 2) * (b - a))
    assert seen > 10


@pytest.mark.parametrize("straighten", [False, True])
def test_between_two_rows_no_corner_of_a_long_part_moves_more_than_the_spacing(
    robot: RobotModel, straighten: bool
) -> None:
    """Also where only the last joint turns, which moves the hand hardly at all."""
    rng = np.random.default_rng(68)
    held = bar_in_hand(robot, 1.0)
    scene = alone(robot, held)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    largest = 0.0
    for k in range(12):
        ends = READY + rng.normal(size=(3, robot.joints)) * (0.15 if k % 2 else [0, 0, 0, 0, 0, 0, 0.3])
        rows = resampled(scene, ends, 0.016, straighten)
        assert len(rows) > 3
        T, half = load_boxes(held, frames(robot.arm, rows), int(held.group[1]))
        at = (corners * half[0]) @ np.swapaxes(T[:, 0, :3, :3], 1, 2) + T[:, 0, None, :3, 3]
        moved = np.linalg.norm(np.diff(at, axis=0), axis=2).max(axis=1)
        # Rows on a straight line for the tool may be a little further apart.
        assert (np.median(moved) if straighten else moved.max()) <= 0.016
        largest = max(largest, float(moved.max()))
    assert largest > 0.008, "rows this near would be a waste"


def test_distances_of_boxes_by_projected_gradients_are_those_of_the_formula() -> None:
    rng = np.random.default_rng(69)
    half, other = np.array([0.03, 0.05, 0.02]), np.array([0.04, 0.01, 0.06])
    T = np.repeat(np.eye(4)[None], 200, 0)
    T[:, :3, 3] = rng.uniform(-0.2, 0.2, (200, 3))
    expected = np.linalg.norm(np.maximum(np.abs(T[:, :3, 3]) - half - other, 0.0), axis=1)
    turned = np.eye(4)
    turned[:3, :3] = random_rotation(rng)
    found = box_gaps(turned @ T, np.repeat(half[None], 200, 0), OrientedBox(turned, other))
    np.testing.assert_allclose(found, expected, atol=1e-6)
