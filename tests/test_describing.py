"""Descriptions of arms and grippers: found from URDFs, measured against the meshes, written and read again."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner

from takeapart.cli.robot import robot as command
from takeapart.formats.files import load_workcell, workcell_hash
from takeapart.formats.robot_files import load_robot_description, load_robot_file, shipped_robots
from takeapart.formats.robot_writing import robot_toml
from takeapart.model.description import RobotDescription, RobotFiles
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array
from takeapart.robot.chain import Body, arm_chain, robot_bodies
from takeapart.robot.covering import body_cover, inflations
from takeapart.robot.describe import find_arm, find_gripper, find_home, prebuilt_solver
from takeapart.robot.describe.home import least_gap
from takeapart.robot.gripper import box_links, gripper_boxes
from takeapart.robot.loading import load_robot
from takeapart.robot.urdf import collisions, read_urdf
from takeapart.workcell import Workcell

ROBOTS = ["panda", "ur5e", "xarm7"]
SHARED = Path(__file__).resolve().parents[2] / "shared" / "robots"


def description_of(name: str) -> RobotDescription:
    return load_robot_description(name)


# ---- grippers


@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_the_pads_stand_the_opening_apart_around_the_tool(name: str) -> None:
    """A ray from the tool's origin along the closing direction meets the pads at half the opening, on both sides."""
    gripper = description_of(name).gripper
    urdf = read_urdf(gripper.files)
    for opening in np.linspace(gripper.openings[0] + 0.002, gripper.maximum_opening, 9).tolist():
        poses = urdf.poses(gripper.base_link, gripper.joint_positions(opening))
        T = gripper.T_base_tool(opening)
        for side in (1.0, -1.0):
            reached = np.inf
            for link in gripper.finger_links:
                for mesh in collisions(urdf, link):
                    placed = mesh.moved(poses[link])
                    solid = trimesh.Trimesh(placed.vertices, placed.faces, process=False)
                    hits, _, _ = solid.ray.intersects_location([T[:3, 3]], [side * T[:3, 1]], multiple_hits=True)
                    if len(hits):
                        reached = min(reached, float(np.linalg.norm(hits - T[:3, 3], axis=1).min()))
            assert reached == pytest.approx(opening / 2, abs=2e-4)
        ahead = np.array([poses[link][:3, 3] for link in gripper.finger_links]).mean(axis=0)
        assert T[:3, 2] @ ahead > 0, "the approach direction leads from the base to the fingers"


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_boxes_hold_all_that_moves_of_the_gripper(name: str, share: float) -> None:
    gripper = description_of(name).gripper
    urdf, opening = read_urdf(gripper.files), share * gripper.maximum_opening
    poses = urdf.poses(gripper.base_link, gripper.joint_positions(opening))
    pads, knuckles = gripper_boxes(gripper, opening)
    fixed = urdf.fixed_on(gripper.base_link)
    links = box_links(gripper)
    assert set(links[: len(pads)]) == {link for link in gripper.finger_links if urdf.links[link].collisions}
    moving = {link for link in poses if link not in fixed and urdf.links[link].collisions}
    assert set(links) == moving
    for link in moving:
        boxes = [box for box, owner in zip([*pads, *knuckles], links, strict=True) if owner == link]
        for mesh in collisions(urdf, link):
            placed = mesh.moved(poses[link])
            hull = trimesh.PointCloud(placed.vertices).convex_hull
            samples, _ = trimesh.sample.sample_surface(hull, 2000, seed=1)
            depth = np.full(len(samples), np.inf)
            for box in boxes:
                local = (samples - box.T_frame_box[:3, 3]) @ box.T_frame_box[:3, :3]
                depth = np.minimum(depth, (np.abs(local) - box.half_extents).max(axis=1))
            assert depth.max() < 1e-6


def test_a_gripper_of_several_links_is_the_one_of_its_data_sheet() -> None:
    gripper = description_of("ur5e").gripper
    assert gripper.maximum_opening == pytest.approx(0.085, abs=0.0015)
    assert gripper.joints == ("finger_joint",)
    travel = gripper.tool_points[0][2] - gripper.tool_points[-1][2]
    assert travel == pytest.approx(0.0139, abs=0.001), "the pads move forward while they close"


def test_the_hand_of_the_panda_is_found_as_it_is_shipped() -> None:
    known = description_of("panda")
    urdf = read_urdf(known.arm.files)
    arm = find_arm(urdf)
    assert (arm.arm.base_link, arm.arm.flange_link, arm.gripper_base) == ("panda_link0", "panda_link8", "panda_hand")
    assert arm.arm.joints == known.arm.joints
    found = find_gripper(urdf, "panda_hand").gripper
    assert found.finger_links in (known.gripper.finger_links, known.gripper.finger_links[::-1])
    assert found.maximum_opening == pytest.approx(0.08, abs=1e-4)
    np.testing.assert_allclose(found.tool_points[-1], known.gripper.tool_points[-1], atol=1e-3)
    assert abs(found.T_base_tool(0.0)[:3, 2] @ known.gripper.T_base_tool(0.0)[:3, 2]) == pytest.approx(1.0)


# ---- arms


def bodies_of(name: str) -> tuple[tuple[Body, ...], list[float]]:
    description = description_of(name)
    chain = arm_chain(read_urdf(description.arm.files), description.arm)
    bodies = robot_bodies(description, chain)
    return bodies, inflations(bodies, chain)


@pytest.mark.parametrize("name", ["ur5e", "xarm7"])
def test_spheres_hold_the_meshes_and_reach_no_further_than_stated(name: str) -> None:
    bodies, allowed = bodies_of(name)
    assert {body.frame for body in bodies} == set(range(len(description_of(name).arm.joints) + 1))
    for body, inflation in zip(bodies, allowed, strict=True):
        cover = body_cover(body, inflation)
        assert cover.inflation <= inflation + 1e-6
        for mesh in collisions(body.urdf, body.link):
            hull = trimesh.PointCloud(mesh.vertices).convex_hull
            samples, _ = trimesh.sample.sample_surface(hull, 3000, seed=2)
            points = np.concatenate([mesh.vertices, samples])
            outside = np.linalg.norm(points[:, None] - cover.centers, axis=2) - cover.radii
            is_ball = body.urdf.links[body.link].collisions[0].kind == "sphere"  # drawn as a polyhedron around it
            assert outside.min(axis=1).max() <= (2e-3 if is_ball else 1e-9)


def test_spheres_are_closer_near_the_flange_and_around_small_links() -> None:
    for name in ROBOTS:
        bodies, allowed = bodies_of(name)
        by_frame = {body.frame: inflation for body, inflation in zip(bodies, allowed, strict=True)}
        assert by_frame[max(by_frame)] <= by_frame[1] <= 0.025
    _, allowed = bodies_of("panda")
    assert allowed == [0.03, 0.025, 0.025, 0.025, 0.025, 0.02, 0.02, 0.02, 0.015]


def test_the_solver_is_told_by_kinematics_and_not_by_name(tmp_path: Path) -> None:
    arm = description_of("ur5e").arm
    text = arm.files.urdf.read_text(encoding="utf-8")
    renamed = tmp_path / "renamed.urdf"
    renamed.write_text(re.sub(r'robot name="[^"]*"', 'robot name="nobody"', text), encoding="utf-8")
    found = find_arm(read_urdf(RobotFiles(renamed))).arm
    assert prebuilt_solver(found) == "ssik.prebuilt.universal_robots.ur5e_ik"
    longer = tmp_path / "longer.urdf"
    longer.write_text(text.replace('xyz="-0.425 0 0"', 'xyz="-0.430 0 0"'), encoding="utf-8")
    found = find_arm(read_urdf(RobotFiles(longer))).arm
    assert found.name == "ur5e"
    assert prebuilt_solver(found) == ""


@pytest.mark.parametrize("name", ["ur5e", "xarm7"])
def test_home_is_inside_the_limits_free_and_not_singular(name: str) -> None:
    description = description_of(name)
    chain = arm_chain(read_urdf(description.arm.files), description.arm)
    home = np.array(description.arm.home)
    assert ((home > chain.lower) & (home < chain.upper)).all()
    assert least_gap(robot_bodies(description, chain), chain, home) >= 0.01
    assert np.linalg.svd(jacobian(description, home), compute_uv=False)[-1] > 0.05


def jacobian(description: RobotDescription, q: Array) -> Array:
    """(6, n) of the flange by finite differences."""
    arm, urdf = description.arm, read_urdf(description.arm.files)

    def flange(q: Array) -> Array:
        return urdf.pose(arm.base_link, arm.flange_link, dict(zip(arm.joints, q.tolist(), strict=True)))

    columns = []
    for k in range(len(q)):
        step = np.zeros(len(q))
        step[k] = 1e-6
        moved = (flange(q + step) - flange(q - step)) / 2e-6
        turn = moved[:3, :3] @ flange(q)[:3, :3].T
        columns.append([*moved[:3, 3], turn[2, 1], turn[0, 2], turn[1, 0]])
    return np.array(columns).T


def test_home_is_found_again() -> None:
    description = description_of("xarm7")
    chain = arm_chain(read_urdf(description.arm.files), description.arm)
    T = description.T_flange_tool(description.maximum_opening)
    assert find_home(description.arm, robot_bodies(description, chain), T) == description.arm.home


# ---- files


@pytest.mark.parametrize("name", ROBOTS)
def test_what_is_written_is_read_again(name: str, tmp_path: Path) -> None:
    known = description_of(name)
    file = tmp_path / "robot.toml"
    file.write_text(robot_toml(known.arm, known.gripper, known.flange_gripper, tmp_path), encoding="utf-8")
    assert load_robot_description(file) == known


def test_bodies_of_one_name_in_both_files_are_told_apart() -> None:
    robot = load_robot(load_workcell("ur5e"))
    assert "base_link_inertia" in robot.bodies and "gripper/base_link_inertia" in robot.bodies
    assert len(robot.inflation) == len(robot.bodies)


def test_arms_and_grippers_combine_freely() -> None:
    other = load_robot_description("panda", "robotiq-2f-85")
    assert other.name == "panda + robotiq-2f-85"
    chain = arm_chain(read_urdf(other.arm.files), other.arm)
    names = [body.link for body in robot_bodies(other, chain)]
    assert "panda_hand" not in names
    assert names[-1] == "base_link_inertia"  # it has the geometry of the base link of the 2F-85


def test_a_workcell_names_a_description_relative_to_itself(tmp_path: Path) -> None:
    known = description_of("ur5e")
    (tmp_path / "robots").mkdir()
    text = robot_toml(known.arm, known.gripper, known.flange_gripper, tmp_path / "robots")
    (tmp_path / "robots" / "mine.toml").write_text(text, encoding="utf-8")
    cell = (
        'format = "takeapart/workcell"\nversion = 1\nname = "cell"\ngoal = [0.3, 0.0, 0.3]\n[robot]\n{}\n'
        "[robot.base]\nposition = [0.0, 0.0, 0.0]\n"
    )
    file = tmp_path / "cell.toml"
    file.write_text(cell.format('description = "robots/mine.toml"'), encoding="utf-8")
    found = load_workcell(file)
    assert found.description == known
    assert tuple(found.home) == known.arm.home
    before = workcell_hash(found)
    (tmp_path / "robots" / "mine.toml").write_text(text.replace("friction = 0.5", "friction = 0.6"), encoding="utf-8")
    assert workcell_hash(load_workcell(file)) != before
    for robot, message in (
        ("", "must have either model"),
        ('model = "ur5e"\ndescription = "robots/mine.toml"', "must have either model"),
        ('model = "ur6"', "unknown robot 'ur6'; valid: a path that ends in .toml, panda, robotiq-2f-85, ur5e, xarm7"),
        ('model = "robotiq-2f-85"', "describes no arm"),
        ('model = "ur5e"\ngripper = "xarm8"', "unknown robot 'xarm8'"),
        ('description = "none.toml"', "there is no such file"),
    ):
        file.write_text(cell.format(robot), encoding="utf-8")
        with pytest.raises(InputError, match=re.escape(message)):
            load_workcell(file)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("home = [0.0, ", "home = [", "home has 6 angles; must have 7"),
        ("openings = [0.0, 0.08]", "openings = [0.08, 0.0]", "openings must ascend"),
        ("positions = [[0.0, 0.04]]", "positions = [[0.0]]", "positions"),
        ("ssik.prebuilt.franka_panda_ik", "os", "must be 'urdf', or a module of ssik.prebuilt"),
        ('distribution = "example-robot-data"', 'distribution = "no-such-thing"', "pip install no-such-thing"),
        ("payload = 3.0", "payload = 0.0", "payload"),
        ("[arm]", "[legs]", "unknown key 'legs'"),
    ],
)
def test_faults_of_a_description_are_told_in_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = shipped_robots()["panda"].read_text(encoding="utf-8")
    assert old in text
    file = tmp_path / "robot.toml"
    file.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        load_robot_file(file)
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


# ---- the command


def test_the_command_describes_a_gripper(tmp_path: Path) -> None:
    source = description_of("ur5e").gripper.files.urdf
    out = tmp_path / "gripper.toml"
    result = CliRunner().invoke(command, [str(source), "--out", str(out), "--force", "60"], catch_exceptions=False)
    assert result.exit_code == 0
    assert "the tool moves 13.9 mm meanwhile" in result.output
    assert "not known: friction: 0.5 is assumed; state it by --friction" in result.output
    found, known = load_robot_file(out).gripper, description_of("ur5e").gripper
    assert found is not None
    assert replace(found, name=known.name) == known, "the shipped file is what the command makes"


def test_the_command_lists_what_is_shipped() -> None:
    result = CliRunner().invoke(command, [], catch_exceptions=False)
    assert result.exit_code == 0
    for name in ROBOTS:
        assert name in result.output


@pytest.mark.skipif(not SHARED.is_dir(), reason="these robots are not part of the project")
@pytest.mark.parametrize(
    ("name", "joints", "flange", "solver"),
    [
        ("ur5e", 6, "tool0", "ssik.prebuilt.universal_robots.ur5e_ik"),
        ("xarm7", 7, "link_eef", "ssik.prebuilt.ufactory.xarm7_ik"),
        ("gen3_2f85", 7, "end_effector_link", "ssik.prebuilt.kinova.gen3_ik"),
        ("iiwa7", 7, "lbr_link_ee", "ssik.prebuilt.kuka.iiwa7_ik"),
    ],
)
def test_fresh_files_of_makers_are_read(name: str, joints: int, flange: str, solver: str) -> None:
    packages = {folder.name: folder for folder in SHARED.iterdir() if folder.is_dir()}
    urdf = read_urdf(RobotFiles(SHARED / f"{name}.urdf", packages))
    found = find_arm(urdf)
    assert (len(found.arm.joints), found.arm.flange_link) == (joints, flange)
    assert prebuilt_solver(found.arm) == solver
    hand = RobotFiles(SHARED / "robotiq_2f_85.urdf", packages)
    gripper = (
        find_gripper(read_urdf(hand)) if found.gripper_base is None else find_gripper(urdf, found.gripper_base)
    ).gripper
    assert gripper.maximum_opening == pytest.approx(0.085, abs=1e-4)
    description = RobotDescription(found.arm, gripper)
    cell = Workcell("cell", description, np.eye(4), np.array(found.arm.home), np.array([0.3, 0.0, 0.3]))
    assert cell.description.arm.name == urdf.name
