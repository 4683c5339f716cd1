"""The arms that are shipped, each against other libraries: kinematics, inverse kinematics, gripper, self-collision.

What the arm is does not matter here; all but the Panda are slow, since tables of distances are worked out first.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from conftest import random_configurations
from mesh_oracle import MeshOracle
from takeapart.formats.files import load_workcell
from takeapart.formats.robot_files import load_robot_description
from takeapart.model.errors import InputError
from takeapart.robot.ik import InverseKinematics
from takeapart.robot.ik_solver import made_solver
from takeapart.robot.loading import load_robot
from takeapart.robot.model import RobotModel
from test_any_arm import Case, found_by_newton, same_pose
from test_self_collision import free_means_apart

ARMS = ["panda", pytest.param("ur5e", marks=pytest.mark.slow), pytest.param("xarm7", marks=pytest.mark.slow)]


@pytest.fixture(scope="module", params=ARMS)
def arm(request: pytest.FixtureRequest) -> Case:
    """A shipped arm in the usual workcell."""
    try:
        description = load_robot_description(request.param)
    except InputError as error:
        pytest.skip(str(error))
    cell = replace(
        load_workcell("panda"),
        description=description,
        home=np.array(description.arm.home),
        payload=math.nan,
        gripping_force=math.nan,
        friction=math.nan,
    )
    return Case(cell, load_robot(cell))


def openings_of(robot: RobotModel, count: int, rng: np.random.Generator) -> list[float]:
    return rng.uniform(0.0, robot.description.maximum_opening, count).tolist()


def test_the_tool_stands_where_another_library_places_it(arm: Case) -> None:
    oracle, robot, rng = MeshOracle(arm.workcell.description), arm.robot, np.random.default_rng(20)
    gripper = robot.description.gripper
    for q, opening in zip(random_configurations(robot, 1000, rng), openings_of(robot, 1000, rng), strict=True):
        oracle.urdf.update_cfg(dict(zip(robot.description.arm.joints, q, strict=True)))
        T = oracle.urdf.get_transform(robot.description.arm.flange_link, robot.description.arm.base_link)
        expected = robot.T_world_base @ T @ robot.description.T_flange_gripper @ gripper.T_base_tool(opening)
        np.testing.assert_allclose(robot.tool_pose(q, opening=opening), expected, atol=1e-6)


def test_the_fingers_stand_at_the_opening_on_both_sides_of_the_tool(arm: Case) -> None:
    """By the corners of the meshes of the links with the pads, of which no point is nearer to the middle."""
    oracle, robot, rng = MeshOracle(arm.workcell.description), arm.robot, np.random.default_rng(21)
    gripper, home = robot.description.gripper, np.array(arm.workcell.description.arm.home)
    for opening in np.clip(
        [0.0, *openings_of(robot, 12, rng), 1.0], gripper.openings[0], gripper.openings[-1]
    ).tolist():
        T_tool_base = np.linalg.inv(robot.tool_pose(home, opening=opening)) @ robot.T_world_base
        pads, _ = robot.gripper_boxes(opening)
        poses, inner = oracle.poses(home, opening), []
        for link in gripper.finger_links:
            corners = oracle.vertices.get(link)
            if corners is None:  # a box: the planner has the same
                continue
            T = T_tool_base @ poses[link]
            points = corners @ T[:3, :3].T + T[:3, 3]
            inner.append(float(points[:, 1].min() if points[:, 1].mean() > 0 else -points[:, 1].max()))
            local = [(points - box.T_frame_box[:3, 3]) @ box.T_frame_box[:3, :3] for box in pads]
            inside = [
                (np.abs(own) <= box.half_extents + 1e-6).all(axis=1) for own, box in zip(local, pads, strict=True)
            ]
            assert np.any(inside, axis=0).all(), "the boxes contain the mesh"
        assert all(gap > opening / 2 - 1e-3 for gap in inner)
        for side in (1, -1):
            own = [box.corners()[:, 1] for box in pads if side * box.T_frame_box[1, 3] > 0]
            boxes = float((side * np.concatenate(own)).min())
            assert opening / 2 - 0.006 < boxes < opening / 2 + 1e-3


def test_solutions_hit_the_pose_inside_the_limits_each_once(arm: Case) -> None:
    robot, rng, none = arm.robot, np.random.default_rng(22), 0
    ik = InverseKinematics(robot)
    for q, opening in zip(random_configurations(robot, 100, rng), openings_of(robot, 100, rng), strict=True):
        target = robot.tool_pose(q, opening=opening)
        solutions = ik.solve(target, opening)
        none += not len(solutions)
        if robot.joints == 6:
            assert same_pose(solutions, q).min() < 1e-5, "of six joints every solution is there"
        for k, solution in enumerate(solutions):
            np.testing.assert_allclose(robot.tool_pose(solution, opening=opening), target, atol=1e-6)
            assert (same_pose(solutions[:k], solution) > 1e-6).all()
        assert ((solutions >= robot.arm.lower) & (solutions <= robot.arm.upper)).all()
    assert none <= 5


def test_what_newton_finds_is_among_the_solutions_or_near_one(arm: Case) -> None:
    """Of a redundant arm the library samples a continuum: half of what Newton finds is near a sample."""
    robot, rng, apart = arm.robot, np.random.default_rng(23), []
    ik = InverseKinematics(robot)
    for q in random_configurations(robot, 8, rng):
        target = robot.tool_pose(q, opening=0.02)
        solutions = ik.solve(target, 0.02)
        found = found_by_newton(robot, target, 0.02, 20, rng)
        apart += [float(same_pose(solutions, other).min()) for other in found if len(solutions)]
    assert len(apart) >= 8
    assert max(apart) < 1e-5 if robot.joints == 6 else float(np.median(apart)) < 0.7


def test_what_the_planner_calls_free_is_free_between_exact_meshes(arm: Case) -> None:
    assert free_means_apart(arm.robot, MeshOracle(arm.workcell.description), 400, 24) > 60


@pytest.mark.slow
def test_a_solver_made_from_the_urdf_finds_what_the_brought_one_finds(arm: Case) -> None:
    robot, rng = arm.robot, np.random.default_rng(25)
    made = made_solver(robot.arm.T_joint, robot.T_last_flange, robot.arm.lower, robot.arm.upper, "made")
    ik = InverseKinematics(robot)
    for q in random_configurations(robot, 30, rng):
        target = robot.tool_pose(q)
        flange = np.linalg.inv(robot.T_world_base) @ target @ np.linalg.inv(robot.T_flange_tool(0.0))
        other = np.array(made.solve(flange, False)).reshape(-1, robot.joints)
        for solution in other:
            np.testing.assert_allclose(robot.tool_pose(solution), target, atol=1e-6)
        if robot.joints == 6:
            for solution in ik.solve(target):
                assert same_pose(other, solution).min() < 1e-5
