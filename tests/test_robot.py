"""Kinematics against two other libraries; the sphere cover against the meshes; inverse kinematics."""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from ssik.prebuilt import franka_panda_ik

from conftest import random_box, random_configurations, world_of
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, Box, OrientedBox, pose_inverse
from takeapart.robot.cover import small_triangles, sphere_cover
from takeapart.robot.hand import collect_hand, hand_hits_load
from takeapart.robot.ik import InverseKinematics
from takeapart.robot.kinematics import forward
from takeapart.robot.model import RobotModel, moved_load
from takeapart.verification.bodies import place_body
from takeapart.verification.robot import robot_specification
from takeapart.workcell import Workcell

LINKS = [*(f"panda_link{i}" for i in range(8)), "panda_hand"]


def mujoco_arm(workcell: Workcell) -> tuple[mujoco.MjModel, mujoco.MjData]:
    specification = robot_specification(workcell.description)
    place_body(specification.body("panda_link0"), workcell.T_world_base)
    model = specification.compile()
    return model, mujoco.MjData(model)


def place(model: mujoco.MjModel, data: mujoco.MjData, q: Array, opening: float = 0.0) -> None:
    for i, angle in enumerate(q, start=1):
        data.qpos[model.jnt_qposadr[model.joint(f"panda_joint{i}").id]] = angle
    for name in ("panda_finger_joint1", "panda_finger_joint2"):
        data.qpos[model.jnt_qposadr[model.joint(name).id]] = opening / 2
    mujoco.mj_kinematics(model, data)


def body_pose(model: mujoco.MjModel, data: mujoco.MjData, name: str) -> Array:
    number = model.body(name).id
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = data.xmat[number].reshape(3, 3), data.xpos[number]
    return T


def test_forward_kinematics_agrees_with_mujoco(robot: RobotModel, workcell: Workcell) -> None:
    model, data = mujoco_arm(workcell)
    T_hand_tool = workcell.description.gripper.T_base_tool(0.0)
    work = robot.workspace()
    for q in random_configurations(robot, 1000, np.random.default_rng(1)):
        place(model, data, q)
        np.testing.assert_allclose(
            robot.tool_pose(q, work), body_pose(model, data, "panda_hand") @ T_hand_tool, atol=1e-6
        )
        for k in range(8):  # joint axes are z already: the joint frames are the link frames
            T = body_pose(model, data, f"panda_link{k}")
            np.testing.assert_allclose(work.R[k], T[:3, :3], atol=1e-6)
            np.testing.assert_allclose(work.p[k], T[:3, 3], atol=1e-6)


def test_forward_kinematics_agrees_with_ssik(robot: RobotModel) -> None:
    # The hand is mounted turned by -45 degrees about the flange; the tool is 103.4 mm beyond.
    T_flange_tool = np.eye(4)
    T_flange_tool[:3, :3] = Rotation.from_euler("z", -45, degrees=True).as_matrix()
    T_flange_tool[2, 3] = 0.1034
    for q in random_configurations(robot, 1000, np.random.default_rng(2)):
        expected = robot.T_world_base @ np.asarray(franka_panda_ik.fk(q)) @ T_flange_tool
        np.testing.assert_allclose(robot.tool_pose(q), expected, atol=1e-6)


def test_joint_limits_are_those_of_the_urdf(robot: RobotModel, workcell: Workcell) -> None:
    model, _ = mujoco_arm(workcell)
    ranges = np.array([model.joint(f"panda_joint{i}").range for i in range(1, 8)])
    np.testing.assert_allclose(np.column_stack([robot.arm.lower, robot.arm.upper]), ranges, atol=1e-9)


# ---- sphere cover


def link_mesh(workcell: Workcell, link: str) -> trimesh.Trimesh:
    """Collision mesh of a link in the link's frame, read from the URDF."""
    files = workcell.description.arm.files
    urdf = ElementTree.parse(files.urdf).getroot()
    (element,) = [e for e in urdf.iter("link") if e.get("name") == link]
    (collision,) = element.iter("collision")
    mesh = collision.find("geometry/mesh")
    assert mesh is not None
    assert collision.find("origin") is None, "the test does not place meshes"
    loaded = trimesh.load_mesh(files.resolve(mesh.get("filename", "")))
    assert isinstance(loaded, trimesh.Trimesh)
    return loaded


def spheres_in_link(robot: RobotModel, workcell: Workcell, link: str) -> tuple[Array, Array]:
    """Centres (S, 3) in the frame of the link, by MuJoCo's pose of the link and ours of the frame; radii (S,)."""
    model, data = mujoco_arm(workcell)
    q = np.array([0.3, -0.5, 0.7, -1.1, 0.2, 1.3, -0.4])
    place(model, data, q)
    work = robot.workspace()
    forward(robot.arm, q, work)
    body = LINKS.index(link)
    chosen = slice(int(robot.arm.body_start[body]), int(robot.arm.body_start[body + 1]))
    frame = int(robot.arm.body_frame[body])
    world = robot.arm.sphere_center[chosen] @ work.R[frame].T + work.p[frame]
    T = pose_inverse(body_pose(model, data, link))
    return world @ T[:3, :3].T + T[:3, 3], robot.arm.sphere_radius[chosen]


def deepest(points: Array, centers: Array, radii: Array) -> Array:
    """(P,) how far each point is inside of the sphere that holds it best, m; negative outside of all."""
    return np.asarray((radii - np.linalg.norm(points[:, None] - centers, axis=2)).max(axis=1))


@pytest.mark.parametrize("link", LINKS)
def test_cover_holds_vertices_and_ten_thousand_samples(robot: RobotModel, workcell: Workcell, link: str) -> None:
    mesh = link_mesh(workcell, link)
    centers, radii = spheres_in_link(robot, workcell, link)
    samples, _ = trimesh.sample.sample_surface(mesh, 10_000, seed=3)
    of_hull, _ = trimesh.sample.sample_surface(mesh.convex_hull, 10_000, seed=3)  # MuJoCo and others collide the hull
    for points in (mesh.vertices, samples, of_hull):
        assert deepest(np.asarray(points), centers, radii).min() >= 0.0


@pytest.mark.parametrize("link", LINKS)
def test_cover_reaches_no_farther_than_stated(robot: RobotModel, workcell: Workcell, link: str) -> None:
    hull = link_mesh(workcell, link).convex_hull
    centers, radii = spheres_in_link(robot, workcell, link)
    directions = np.random.default_rng(4).normal(size=(60, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    farthest = 0.0
    for center, radius in zip(centers, radii, strict=True):
        farthest = max(farthest, float(distance_to_hull(hull, center + radius * directions).max()))
    assert farthest <= robot.inflation[link] + 1e-6
    assert farthest >= 0.5 * robot.inflation[link], "the figure says more than the spheres use"
    assert robot.inflation[link] <= 0.031


def distance_to_hull(hull: trimesh.Trimesh, points: Array) -> Array:
    """(P,) distance of points to a convex mesh, m; 0 inside."""
    triangles = np.asarray(hull.triangles)
    offsets = np.einsum("ij,ij->i", hull.face_normals, triangles[:, 0])
    outside = (points @ np.asarray(hull.face_normals).T > offsets).any(axis=1)
    distance = np.zeros(len(points))
    for k in np.nonzero(outside)[0]:
        nearest = trimesh.triangles.closest_point(triangles, np.repeat(points[k : k + 1], len(triangles), 0))
        distance[k] = np.linalg.norm(nearest - points[k], axis=1).min()
    return distance


def test_cover_of_a_thin_plate_is_complete() -> None:
    plate = trimesh.creation.box(extents=(0.2, 0.1, 0.002))
    cover = sphere_cover(np.asarray(plate.triangles), np.asarray(plate.face_normals), 0.02, np.random.default_rng(0))
    samples, _ = trimesh.sample.sample_surface(plate, 10_000, seed=1)
    assert deepest(np.asarray(samples), cover.centers, cover.radii).min() >= 0.0
    assert deepest(np.asarray(plate.vertices), cover.centers, cover.radii).min() >= 0.0
    assert (cover.centers @ np.asarray(plate.face_normals).T + cover.radii[:, None]).max(axis=0).max() < 0.1 + 0.02


def test_small_triangles_are_the_same_surface() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=0.1)
    pieces = small_triangles(np.asarray(mesh.triangles), 0.013)
    assert np.linalg.norm(pieces - np.roll(pieces, -1, axis=1), axis=2).max() <= 0.013
    areas = np.linalg.norm(np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0]), axis=1) / 2
    assert areas.sum() == pytest.approx(mesh.area, rel=1e-9)
    # Every piece lies in a face of the sphere's polyhedron.
    offsets = np.einsum("ij,ij->i", mesh.face_normals, np.asarray(mesh.triangles)[:, 0])
    off_face = np.abs(pieces.reshape(-1, 3) @ np.asarray(mesh.face_normals).T - offsets).reshape(len(pieces), 3, -1)
    assert off_face.max(axis=1).min(axis=1).max() < 1e-12


@pytest.mark.parametrize("opening", [0.0, 0.02, 0.08])
def test_finger_boxes_are_those_of_the_urdf(robot: RobotModel, workcell: Workcell, opening: float) -> None:
    model, data = mujoco_arm(workcell)
    place(model, data, np.zeros(7), opening)
    T_tool_world = pose_inverse(robot.tool_pose(np.zeros(7)))
    expected = []
    for finger in ("panda_leftfinger", "panda_rightfinger"):
        body = model.body(finger)
        for geom in range(int(body.geomadr[0]), int(body.geomadr[0] + body.geomnum[0])):
            assert model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
            expected.append(OrientedBox(T_tool_world @ T, model.geom_size[geom].copy()))
    found = robot.finger_boxes(opening)
    assert len(found) == len(expected) == 8
    for box, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(box.corners(), other.corners(), atol=1e-6)
    # The inner faces of the fingertips stand the opening apart, on both sides of the tool.
    corners = np.concatenate([box.corners() for box in found])
    at_tool = corners[np.abs(corners[:, 2]) < 0.02]
    assert at_tool[at_tool[:, 1] > 0, 1].min() >= opening / 2 - 1e-3
    assert at_tool[at_tool[:, 1] < 0, 1].max() <= -opening / 2 + 1e-3


# ---- what the gripper holds


def test_probes_of_a_held_part_contain_its_boxes(robot: RobotModel) -> None:
    rng = np.random.default_rng(6)
    for size in [(0.38, 0.02, 0.02), (0.02, 0.02, 0.56), (0.1, 0.1, 0.1), (0.03, 0.2, 0.01)]:
        body = Box(size).boxes()
        held = robot.held(0.02, np.eye(4), body)
        points = rng.uniform(-1, 1, (3000, 3)) * body[0].half_extents
        points = np.concatenate([points, body[0].corners()])
        mine = held.probe_box == len(held.half) - 1
        assert deepest(points, held.probe_center[mine], held.probe_radius[mine]).min() >= 0.0
        for group in range(2):
            inside = slice(held.group[group], held.group[group + 1])
            for center, axes, half in zip(held.center[inside], held.axes[inside], held.half[inside], strict=True):
                for signs in itertools.product((-1, 1), repeat=3):
                    corner = center + (np.array(signs) * half) @ axes
                    assert np.linalg.norm(corner - held.group_center[group]) <= held.group_radius[group] + 1e-9


def palm_hits(robot: RobotModel, T_tool_part: Array, body: tuple[OrientedBox, ...]) -> bool:
    held = robot.held(0.02, T_tool_part, body)
    work = robot.workspace()
    far = world_of(robot, [(OrientedBox(np.diag([1.0, 1.0, 1.0, 1.0]), np.full(3, 0.01)), 0)])
    flags = np.zeros(2, dtype=np.uint8)
    collect_hand(robot.arm, held, far, flags, 0.0, robot.tool_pose(np.zeros(robot.joints)), work, flags.copy())
    return bool(hand_hits_load(robot.arm, held, 0.0, work))


def test_palm_hits_a_part_that_is_held_too_deep(robot: RobotModel, workcell: Workcell) -> None:
    bar = Box((0.3, 0.02, 0.02)).boxes()
    assert not palm_hits(robot, np.eye(4), bar)
    deep = np.eye(4)
    deep[2, 3] = -workcell.description.gripper.T_base_tool(0.0)[2, 3]  # the bar lies where the hand's own frame is
    assert palm_hits(robot, deep, bar)


def test_fingers_hit_the_connector_walls_of_the_part_they_hold(robot: RobotModel) -> None:
    """The first box of a body is what the fingers grip; what follows are walls of its connectors."""
    bar = Box((0.3, 0.02, 0.02)).boxes()
    finger = robot.finger_boxes(0.02)[3]
    at_finger, aside = finger.T_frame_box.copy(), finger.T_frame_box.copy()
    aside[0, 3] += 0.1
    assert palm_hits(robot, np.eye(4), (*bar, OrientedBox(at_finger, np.full(3, 0.002))))
    assert not palm_hits(robot, np.eye(4), (*bar, OrientedBox(aside, np.full(3, 0.002))))


def test_moved_load_is_the_load_held_there(robot: RobotModel) -> None:
    rng = np.random.default_rng(8)
    body = [random_box(rng, np.full(3, -0.1), np.full(3, 0.1), 0.01, 0.05) for _ in range(3)]
    first, second = (random_box(rng, np.full(3, -0.1), np.full(3, 0.1), 1, 2).T_frame_box for _ in range(2))
    moved = moved_load(robot.held(0.03, first, body), second)
    direct = robot.held(0.03, second @ first, body)
    for name in ("center", "axes", "half", "probe_center", "probe_radius", "probe_box", "group"):
        np.testing.assert_allclose(getattr(moved, name), getattr(direct, name), atol=1e-12)
    corners = np.concatenate([box.moved(second @ first).corners() for box in body])
    assert np.linalg.norm(corners - moved.group_center[1], axis=1).max() <= moved.group_radius[1] + 1e-9


# ---- inverse kinematics


def test_inverse_kinematics_hits_the_pose_within_the_limits(robot: RobotModel) -> None:
    ik = InverseKinematics(robot)
    found = missing = 0
    for q in random_configurations(robot, 200, np.random.default_rng(7)):
        target = robot.tool_pose(q)
        solutions = ik.solve(target)
        missing += not len(solutions)
        found += len(solutions)
        for solution in solutions:
            np.testing.assert_allclose(robot.tool_pose(solution), target, atol=1e-6)
            assert (solution >= robot.arm.lower - 1e-9).all()
            assert (solution <= robot.arm.upper + 1e-9).all()
    assert found > 200 * 8
    # A redundancy sampled too coarsely would lose poses that the arm can reach: only those at the very edge may go.
    assert missing <= 10


def test_inverse_kinematics_gives_what_the_library_gives_for_these_limits(robot: RobotModel) -> None:
    """Samples inside the limits are used as they are: the library, asked for solutions inside, has no others."""
    ik = InverseKinematics(robot)
    T_base_world = pose_inverse(robot.T_world_base)
    T_tool_flange = pose_inverse(robot.T_flange_tool(0.0))
    for q in random_configurations(robot, 60, np.random.default_rng(11)):
        target = robot.tool_pose(q)
        expected = franka_panda_ik.solve(T_base_world @ target @ T_tool_flange, allow_rescue=False)
        turned = target.copy()
        turned[:3, :2] *= -1
        both = franka_panda_ik.solve(T_base_world @ turned @ T_tool_flange, allow_rescue=False)
        for solutions, found in zip(
            (expected, expected, both), (ik.solve(target), *ik.solve_both(target)), strict=True
        ):
            assert len(found) == len(solutions)
            for solution in solutions:
                assert np.abs(found - solution.q).max(axis=1).min() < 1e-9


def test_inverse_kinematics_finds_nothing_out_of_reach(robot: RobotModel) -> None:
    target = np.eye(4)
    target[:3, 3] = robot.T_world_base[:3, 3] + [2.0, 0.0, 0.5]
    solutions = InverseKinematics(robot).solve(target)
    assert solutions.shape == (0, 7)


def test_missing_robot_file_is_named(workcell: Workcell) -> None:
    files = workcell.description.arm.files
    for uri in ("no_such_file.stl", "package://example-robot-data/no_such_file.stl"):
        with pytest.raises(InputError, match="no_such_file"):
            files.resolve(uri)
    with pytest.raises(InputError, match="'nowhere' .* known: example-robot-data"):
        files.resolve("package://nowhere/link0.stl")
