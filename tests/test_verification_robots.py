"""The judge with other arms and grippers: its kinematics, its pads and its verdicts against a truth of the tests."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import trimesh

from other_robots import BETWEEN_PADS, Case, Kinematics, bar_case, link_poses, pad_way, robot, tool_rows
from takeapart.formats.robot_files import load_robot_description
from takeapart.model.description import ArmDescription, GripperDescription, RobotDescription, RobotFiles
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, OrientedBox, pose
from takeapart.model.plan import Plan
from takeapart.verification import verify_plan
from takeapart.verification.model import Scene
from takeapart.verification.report import Finding
from takeapart.verification.robot import Joints, compiled, mujoco, robot_specification, unchecked_pairs
from takeapart.verification.urdf import arm_branch, gripper_branch
from takeapart.workcell import Obstacle, Workcell
from verification_scene import scene_assembly, scene_workcell

ROBOTS = ["panda", "ur5e", "xarm7", *(pytest.param(name, marks=pytest.mark.slow) for name in ("gen3", "iiwa7"))]
ARMS = ["ur5e", "xarm7"]


def findings_of(case: Case, plan: Plan, workcell: Workcell | None = None) -> list[Finding]:
    cell = case.workcell if workcell is None else workcell
    return list(verify_plan(plan, case.assembly, cell, hashes={}, physics=False).findings)


def with_gripper(case: Case, **changes: object) -> Workcell:
    """The case's workcell with a gripper that is described in another way."""
    description = case.workcell.description
    gripper = replace(description.gripper, **changes)  # type: ignore[arg-type]
    return replace(case.workcell, description=replace(description, gripper=gripper))


# --- kinematics ---


@pytest.mark.parametrize("name", ROBOTS)
def test_every_link_stands_where_the_text_of_the_urdf_puts_it(name: str) -> None:
    description = robot(name)
    model = compiled(robot_specification(description), description)
    data, joints = mujoco.MjData(model), Joints(model, description)
    names = {model.body(b).name: b for b in range(1, model.nbody)}
    arm, gripper = arm_branch(description), gripper_branch(description)
    assert set(names) == {*arm.links, *gripper.links}  # no two of the same name among these
    rng = np.random.default_rng(0)
    low, high = np.where(np.isinf(joints.limits), [-10.0, 10.0], joints.limits).T
    opened = description.gripper.openings
    for _ in range(1000):
        q, opening = rng.uniform(low, high), rng.uniform(opened[0], opened[-1])
        joints.set_arm(data, q)
        joints.set_opening(data, opening)
        mujoco.mj_kinematics(model, data)
        truth = link_poses(description, q, opening)
        base = names[description.arm.base_link]
        R, p = data.xmat[base].reshape(3, 3), data.xpos[base]
        for link in [*arm.links, *gripper.links]:
            T = truth[f"gripper:{link}" if link in gripper.links else link]
            body = names[link]
            assert np.abs(R.T @ (data.xpos[body] - p) - T[:3, 3]).max() < 1e-6, link
            assert np.abs(R.T @ data.xmat[body].reshape(3, 3) - T[:3, :3]).max() < 1e-6, link


LINKAGE = """<robot name="g" xmlns:x="y">
  <link name="root"/>
  <link name="palm"><collision><geometry><box size="0.02 0.02 0.02"/></geometry></collision></link>
  <link name="a"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>
  <link name="b"><collision><geometry><cylinder radius="0.01" length="0.02"/></geometry></collision></link>
  <link name="c"><collision><geometry><box size="0.01 0.01 0.01"/></geometry></collision></link>
  <joint name="up" type="revolute"><parent link="root"/><child link="palm"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1"/></joint>
  <joint name="j1" type="prismatic"><parent link="palm"/><child link="a"/><axis xyz="0 1 0"/>
    <limit lower="-0.1" upper="0.1"/></joint>
  <joint name="j2" type="revolute"><parent link="palm"/><child link="b"/><axis xyz="0 0 1"/>
    <mimic joint="j1" multiplier="-2" offset="0.25"/><limit lower="0" upper="0.1"/></joint>
  <joint name="j3" type="continuous"><parent link="b"/><child link="c"/><axis xyz="1 0 0"/>
    <mimic joint="j2" multiplier="3" offset="-0.5"/></joint>
  <transmission name="t"><joint name="j9"/></transmission>
  <drake:thing/><gazebo><link name="palm"/></gazebo>
</robot>"""


def linkage(tmp_path: Path, text: str = LINKAGE, **changes: object) -> RobotDescription:
    (tmp_path / "g.urdf").write_text(text)
    gripper = GripperDescription(
        "g",
        RobotFiles(tmp_path / "g.urdf"),
        "palm",
        ("a", "b"),
        ("j1",),
        (0.0, 0.1),
        ((-0.05, 0.05),),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        (1.0, 0.0, 0.0, 0.0),
        10.0,
        0.5,
    )
    return RobotDescription(robot("panda").arm, replace(gripper, **changes))  # type: ignore[arg-type]


def test_joints_follow_others_over_several_steps_with_offsets(tmp_path: Path) -> None:
    """j2 = -2 j1 + 0.25 and j3 = 3 j2 - 0.5 = -6 j1 + 0.25; limits of joints that follow are not theirs to keep."""
    branch = gripper_branch(linkage(tmp_path))
    assert branch.links == ("palm", "a", "b", "c") and set(branch.limits) == {"j1"}
    assert {(m.joint, m.follows, m.multiplier, m.offset) for m in branch.mimics} == {
        ("j2", "j1", -2.0, 0.25),
        ("j3", "j1", -6.0, 0.25),
    }
    description = linkage(tmp_path)
    model = compiled(robot_specification(description), description)
    data, joints = mujoco.MjData(model), Joints(model, description)
    joints.set_opening(data, 0.08)
    at = {name: float(data.qpos[model.jnt_qposadr[model.joint(name).id]]) for name in ("j1", "j2", "j3")}
    assert at == pytest.approx({"j1": 0.03, "j2": 0.19, "j3": 0.07})
    assert not joints.beyond_limits(0.08)
    wide = replace(description, gripper=replace(description.gripper, positions=((-0.05, 0.15),)))
    assert [name for name, _, _ in Joints(model, wide).beyond_limits(0.1)] == ["j1"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('<mimic joint="j1" multiplier', '<mimic joint="j3" multiplier', "joint 'j2' mimics itself"),
        ('<mimic joint="j1" multiplier', '<mimic joint="j8" multiplier', "mimics 'j8', which is not there"),
        ('<mimic joint="j1" multiplier', '<mimic joint="up" multiplier', "mimics 'up', which is not below 'palm'"),
        ('name="j1" type="prismatic"', 'name="j1" type="planar"', "joint 'j1' is of type 'planar'"),
        ('<limit lower="-0.1" upper="0.1"/>', "", "joint 'j1' has no limits"),
        ('lower="-0.1" upper="0.1"', 'lower="0.1" upper="0.1"', "the lower limit must be less"),
        ('<sphere radius="0.01"/>', '<cone radius="0.01"/>', "a shape 'cone'"),
        ('<sphere radius="0.01"/>', '<mesh filename="none.stl"/>', "none.stl"),
        ('<child link="b"/>', '<child link="z"/>', "has no child link 'z'"),
        ("<robot", "<sdf", "is not XML"),
        ('multiplier="-2"', 'multiplier="two"', "multiplier is 'two'; must be a number"),
        ('<mimic joint="j1" multiplier="-2" offset="0.25"/>', "", "joint 'j2' of the gripper is neither set"),
    ],
)
def test_a_file_that_is_no_gripper_is_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in LINKAGE
    with pytest.raises(InputError) as caught:
        gripper_branch(linkage(tmp_path, LINKAGE.replace(old, new, 1)))
    assert message in str(caught.value) and "\n" not in str(caught.value)
    assert str(tmp_path) in str(caught.value)


def test_meshes_of_other_formats_scaled_and_mirrored(tmp_path: Path) -> None:
    """A pyramid that is no mirror image of itself, as OBJ in millimetres, as mirrored STL, as PLY and as Collada."""
    corners = np.array([[0, 0, 0], [0.05, 0, 0], [0, 0.03, 0], [0, 0, 0.02]])
    pyramid = trimesh.Trimesh(corners, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], process=False)
    big = pyramid.copy().apply_scale(1000)
    big.export(tmp_path / "a.obj")
    for name in ("b.stl", "c.ply", "d.dae"):
        pyramid.export(tmp_path / name)
    (tmp_path / "e.stl").write_text(trimesh.exchange.stl.export_stl_ascii(pyramid))
    text = (tmp_path / "d.dae").read_text()
    assert text.count("<unit") == 0 and text.count("</asset>") == 1
    (tmp_path / "f.dae").write_text(text.replace("</asset>", '<unit name="centimeter" meter="0.01"/></asset>'))
    cases = {
        "a.obj": ("0.001 0.001 0.001", corners),
        "b.stl": ("-1 1 1", corners * [-1, 1, 1]),
        "c.ply": ("1 -2 1", corners * [1, -2, 1]),
        "d.dae": ("1 1 1", corners),
        "e.stl": ("1 1 1", corners),
        "f.dae": ("1 1 1", corners / 100),
    }
    for name, (scale, expected) in cases.items():
        text = LINKAGE.replace('<sphere radius="0.01"/>', f'<mesh filename="{name}" scale="{scale}"/>')
        description = linkage(tmp_path, text, name=name)
        model = compiled(robot_specification(description), description)
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        body = model.body("a").id
        geom = int(model.body_geomadr[body])
        first, count = (int(table[model.geom_dataid[geom]]) for table in (model.mesh_vertadr, model.mesh_vertnum))
        world = model.mesh_vert[first : first + count] @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        found = (world - data.xpos[body]) @ data.xmat[body].reshape(3, 3)
        assert sorted(np.round(found, 7).tolist()) == sorted(np.round(expected, 7).tolist()), name


# --- pads ---


@pytest.mark.parametrize("angle", [0.0, 0.2, 0.5, 0.79])
def test_pads_are_measured_on_the_meshes_of_the_fingers(angle: float) -> None:
    case = bar_case("ur5e")
    scene = Scene(case.assembly, case.workcell, 0.003)
    opening = BETWEEN_PADS - 2 * pad_way(angle)[0]
    scene.open(opening)
    scene.place(case.workcell.home)
    for pad in scene.pads():
        assert pad.distance == pytest.approx(opening / 2, abs=3e-5)
        assert pad.tilt < 1e-3
    assert [len(side) for side in scene.sides] == [1, 1]


def test_pads_of_every_shape_are_measured(tmp_path: Path) -> None:
    """A ball of 1 cm at j1 = 0.03 along y, a cylinder of 1 cm about z at the middle: the tool point beside both."""
    between = '<parent link="palm"/><child link="b"/>'
    text = LINKAGE.replace(between, f'{between}<origin xyz="0 -0.02 0"/>')
    case = bar_case("panda")
    description = linkage(tmp_path, text, tool_points=((0.0, 0.005, 0.0), (0.0, 0.005, 0.0)))
    scene = Scene(case.assembly, replace(case.workcell, description=description), 0.003)
    scene.open(0.08)
    scene.place(case.workcell.home)
    minus, plus = scene.pads()
    assert (minus.distance, plus.distance) == pytest.approx((0.005 + 0.02 - 0.01, 0.03 - 0.005 - 0.01))
    assert minus.tilt == pytest.approx(0, abs=1e-6) and plus.tilt == pytest.approx(0, abs=1e-6)


def gripper_findings(case: Case, **changes: object) -> list[str]:
    cell = with_gripper(case, **changes)
    # The plan is made for what the description says: only the pads are elsewhere.
    step = case.plan.steps[0]
    rows = tool_rows(cell.description, cell.T_world_base, step.joint_path, step.grasp.width)
    plan = replace(case.plan, steps=(replace(step, tool_path=rows),))
    return [finding.message for finding in findings_of(case, plan, cell) if finding.check == "gripper"]


def test_a_description_that_is_not_the_gripper_is_refused() -> None:
    case = bar_case("ur5e")
    gripper = case.workcell.description.gripper
    assert gripper_findings(case) == []
    narrower = gripper_findings(case, openings=tuple(opening - 0.0004 for opening in gripper.openings))
    assert len(narrower) == 2 and "must be half of that" in narrower[0]
    beside = [(x + 0.0002, y, z) for x, y, z in gripper.tool_points]
    assert len(gripper_findings(case, tool_points=tuple(beside))) == 2  # nearer to one pad, further from the other
    beyond = [(x, y, z + 0.03) for x, y, z in gripper.tool_points]
    assert all("no pad beside the tool point" in text for text in gripper_findings(case, tool_points=tuple(beyond)))
    assert len(gripper_findings(case, tool_points=tuple(beyond))) == 2
    half = math.radians(1.0) / 2
    turned = (math.cos(math.pi / 4 + half), 0.0, 0.0, math.sin(math.pi / 4 + half))
    assert all("off the square" in text for text in gripper_findings(case, tool_orientation=turned))
    assert len(gripper_findings(case, tool_orientation=turned)) == 2
    outside = gripper_findings(case, positions=(tuple(angle - 0.7 for angle in gripper.positions[0]),))
    assert "robotiq_85_left_knuckle_joint of 2f85 stands at" in outside[0]


def test_fingers_on_one_side_are_no_gripper() -> None:
    case = bar_case("ur5e")
    (finger, _) = case.workcell.description.gripper.finger_links
    with pytest.raises(InputError, match="all its finger links stand on one side"):
        Scene(case.assembly, with_gripper(case, finger_links=(finger,)), 0.003)


# --- plans ---


@pytest.mark.parametrize("name", ROBOTS)
def test_a_plan_that_keeps_every_rule_holds(name: str) -> None:
    if name == "panda":
        pytest.skip("its plans are judged in test_verification.py")
    case = bar_case(name)
    report = verify_plan(case.plan, case.assembly, case.workcell)
    assert report.findings == ()
    assert report.agreement.tool_position < 1e-9 and report.agreement.tool_angle < 1e-9
    assert report.configurations > 1000 * case.plan.total_length
    assert verify_plan(case.plan.inverted(), case.assembly, case.workcell, physics=False).passed


def turned_joint(case: Case, joint: int, angle: float) -> Plan:
    (step,) = case.plan.steps
    path = step.joint_path + angle * np.eye(step.joint_path.shape[1])[joint]
    return replace(case.plan, steps=(replace(step, joint_path=path),))


def test_a_joint_may_stand_a_turn_further_where_its_limits_say_so() -> None:
    case = bar_case("ur5e")
    assert findings_of(case, turned_joint(case, 3, 2 * math.pi)) == []
    found = findings_of(case, turned_joint(case, 3, 4 * math.pi))
    assert [finding.check for finding in found] == ["joint_limit"]


@pytest.mark.slow
def test_a_continuous_joint_may_turn_as_often_as_it_likes() -> None:
    case = bar_case("gen3")
    assert findings_of(case, turned_joint(case, 6, 8 * math.pi)) == []
    assert "joint_limit" in {finding.check for finding in findings_of(case, turned_joint(case, 5, 8 * math.pi))}


@pytest.mark.parametrize("name", ARMS)
def test_a_wrong_opening_is_refused(name: str) -> None:
    case = bar_case(name)
    (step,) = case.plan.steps
    for width, checks in ((0.0204, {"width", "finger_contact"}), (0.019, {"width", "collision"})):
        rows = tool_rows(case.workcell.description, case.workcell.T_world_base, step.joint_path, width)
        changed = replace(step, grasp=replace(step.grasp, width=width), tool_path=rows)
        assert checks <= {finding.check for finding in findings_of(case, replace(case.plan, steps=(changed,)))}


def test_what_moves_with_the_fingers_and_is_none_must_not_touch_the_part() -> None:
    """A bar that reaches up between the knuckles, and one that reaches the palm."""
    assert findings_of(bar_case("ur5e"), bar_case("ur5e").plan) == []
    links = {"robotiq_85_left_inner_knuckle_link", "robotiq_85_right_inner_knuckle_link"}
    for height, expected in ((0.10, links), (0.14, {*links, "robotiq_85_base_link"})):
        case = bar_case("ur5e", height)
        messages = [finding.message for finding in findings_of(case, case.plan) if finding.check == "collision"]
        assert expected <= {message.split()[0] for message in messages if message.endswith("held/bar")}, height


def raw_meshes(description: RobotDescription) -> dict[str, list[trimesh.Trimesh]]:
    """Collision meshes of all links as they are, by the same names as `link_poses`, each in its link's frame."""
    import xml.etree.ElementTree as ElementTree

    found: dict[str, list[trimesh.Trimesh]] = {}
    for before, files in (("", description.arm.files), ("gripper:", description.gripper.files)):
        for link in ElementTree.parse(files.urdf).getroot().findall("link"):
            for collision in link.findall("collision"):
                mesh = collision.find("geometry/mesh")
                assert mesh is not None and mesh.get("scale") is None
                loaded = trimesh.load_mesh(files.resolve(mesh.get("filename", "")))
                origin, T = collision.find("origin"), np.eye(4)
                if origin is not None:
                    T = trimesh.transformations.euler_matrix(*map(float, origin.get("rpy", "0 0 0").split()))
                    T[:3, 3] = [float(number) for number in origin.get("xyz", "0 0 0").split()]
                found.setdefault(before + str(link.get("name")), []).append(loaded.apply_transform(T))
    return found


@pytest.mark.parametrize("name", ARMS)
def test_no_arm_passes_through_itself_unseen(name: str) -> None:
    """Random configurations: every pair of links whose exact meshes meet is seen, but for those that are left out."""
    case = bar_case(name)
    description = case.workcell.description
    scene = Scene(case.assembly, case.workcell, 0.003)
    scene.show(0, None)
    left_out = {frozenset(pair) for pair in unchecked_pairs(description)}
    meshes = raw_meshes(description)
    manager = {link: trimesh.collision.CollisionManager() for link in meshes}
    for link, pieces in meshes.items():
        for k, piece in enumerate(pieces):
            manager[link].add_object(str(k), piece)
    rng, hits = np.random.default_rng(4), 0
    for _ in range(60):
        q = rng.uniform(scene.joint_limits[:, 0], scene.joint_limits[:, 1])
        scene.open(0.04)
        scene.place(q)
        pairs, distances = scene.near()
        seen = {frozenset(map(scene.label, pair)) for pair, d in zip(pairs.tolist(), distances, strict=True) if d < 0}
        truth = link_poses(description, q, 0.04)
        for link in meshes:
            for k in range(len(meshes[link])):
                manager[link].set_transform(str(k), truth[link])
        for a, b in combinations(meshes, 2):
            names = frozenset((a.removeprefix("gripper:"), b.removeprefix("gripper:")))
            if names not in left_out and manager[a].in_collision_other(manager[b]):
                hits += 1
                assert names in seen, (a, b, q.tolist())
    assert hits > 10


@pytest.mark.parametrize("name", ARMS)
def test_an_arm_that_folds_into_itself_is_refused(name: str) -> None:
    case = bar_case(name)
    (step,) = case.plan.steps
    path: Array = step.joint_path.copy()
    elbow, far = (2, 3.1) if name == "ur5e" else (3, -0.19)
    folded = np.linspace(path[-1, elbow], far, 60)
    detour = np.repeat(path[-1:], 60, axis=0)
    detour[:, elbow] = folded
    path = np.vstack([path, detour, detour[::-1], path[-1:]])
    rows = tool_rows(case.workcell.description, case.workcell.T_world_base, path, step.grasp.width)
    length = float(np.linalg.norm(np.diff(rows[:, :3], axis=0), axis=1).sum())
    plan = replace(
        case.plan, steps=(replace(step, joint_path=path, tool_path=rows, length=length),), total_length=length
    )
    found = [f.message for f in findings_of(case, plan) if f.check == "collision"]
    links = set(arm_branch(case.workcell.description).links)
    assert any(len(set(message.split()) & links) == 2 for message in found), found


def test_a_base_stands_on_a_table_and_its_arm_may_not() -> None:
    """The base link of a UR has no geometry; the one fixed to it has, and never moves either."""
    case = bar_case("ur5e")
    scene = Scene(case.assembly, case.workcell, 0.003)
    assert scene.base_bodies == ["base_link_inertia"]
    T = case.workcell.T_world_base
    under = Obstacle("stand", OrientedBox(pose(T[:3, 3] + [0.0, 0.0, 0.01]), np.array([0.2, 0.2, 0.02])))
    assert findings_of(case, case.plan, replace(case.workcell, environment=(under,))) == []
    beside = Obstacle("shelf", OrientedBox(pose(T[:3, 3] + [0.0, 0.0, 0.16]), np.array([0.2, 0.2, 0.02])))
    found = findings_of(case, case.plan, replace(case.workcell, environment=(beside,)))
    assert {"home", "collision"} <= {finding.check for finding in found}


ARM_OF_PRIMITIVES = """<robot name="a">
  <link name="base"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
  <link name="one"><collision><origin xyz="0 0 0.2"/><geometry><box size="0.06 0.04 0.3"/></geometry></collision></link>
  <link name="two"><collision><origin xyz="0 0 0.15" rpy="0.1 0 0"/>
    <geometry><cylinder radius="0.03" length="0.24"/></geometry></collision></link>
  <link name="three"><collision><origin xyz="0 0 0.05"/><geometry><sphere radius="0.04"/></geometry></collision></link>
  <joint name="q1" type="revolute"><parent link="base"/><child link="one"/><origin xyz="0 0 0.1"/><axis xyz="1 0 0"/>
    <limit lower="-2" upper="2"/></joint>
  <joint name="q2" type="continuous"><parent link="one"/><child link="two"/><origin xyz="0 0 0.4"/><axis xyz="0 1 0"/>
  </joint>
  <joint name="q3" type="revolute"><parent link="two"/><child link="three"/><origin xyz="0 0 0.3"/><axis xyz="1 0 0"/>
    <limit lower="-2" upper="2"/></joint>
</robot>"""


def unit(quaternion: Array) -> Array:
    return np.asarray(quaternion / np.linalg.norm(quaternion))


def surface_points(link: str, rng: np.random.Generator) -> Array:
    """Points (400, 3), m, on the primitive of a link, in the link's frame."""
    points = rng.uniform(-1, 1, (400, 3))
    if link == "one":
        points[np.arange(400), rng.integers(3, size=400)] = rng.choice([-1, 1], 400)
        return np.asarray(points * [0.03, 0.02, 0.15] + [0, 0, 0.2])
    angle, c, s = 2 * math.pi * points[:, 0], math.cos(0.1), math.sin(0.1)
    x, y, z = 0.03 * np.cos(angle), 0.03 * np.sin(angle), 0.12 * points[:, 1]
    return np.column_stack([x, c * y - s * z, s * y + c * z + 0.15])


def test_no_primitive_of_an_arm_enters_a_box_unseen(tmp_path: Path) -> None:
    """A ball by its closed formula, boxes and cylinders by points on them, among random boxes."""
    (tmp_path / "a.urdf").write_text(ARM_OF_PRIMITIVES)
    joints, home = ("q1", "q2", "q3"), (0.0, 0.0, 0.0)
    arm = ArmDescription("a", RobotFiles(tmp_path / "a.urdf"), "base", "three", joints, 1.0, home)
    rng = np.random.default_rng(8)
    boxes, around = [], scene_workcell().T_world_base[:3, 3]
    for _ in range(40):
        T = pose(around + rng.uniform([-0.6, -0.6, 0.1], [0.6, 0.6, 0.9]), unit(rng.normal(size=4)))
        boxes.append(OrientedBox(T, rng.uniform(0.02, 0.1, 3)))
    cell = replace(
        scene_workcell(),
        description=replace(linkage(tmp_path), arm=arm),
        home=np.zeros(3),
        environment=tuple(Obstacle(str(i), box) for i, box in enumerate(boxes)),
    )
    scene = Scene(scene_assembly(), cell, 0.003)
    scene.show(0, None)
    hits = dict.fromkeys(("one", "two", "three"), 0)
    T_base = cell.T_world_base
    for _ in range(200):
        q = rng.uniform([-2, -9, -2], [2, 9, 2])
        scene.place(q)
        truth = Kinematics(tmp_path / "a.urdf").poses("base", dict(zip(joints, q, strict=True)))
        pairs, distances = scene.near()
        near = {frozenset(map(scene.label, pair)): d for pair, d in zip(pairs.tolist(), distances, strict=True)}
        for i, box in enumerate(boxes):
            T_box_base = np.linalg.inv(box.T_frame_box) @ T_base
            for link in ("one", "two"):
                T = T_box_base @ truth[link]
                inside = np.abs(surface_points(link, rng) @ T[:3, :3].T + T[:3, 3]) < box.half_extents - 1e-3
                if inside.all(axis=1).any():
                    hits[link] += 1
                    assert near[frozenset((link, f"environment/{i}"))] < 0
            centre = (T_box_base @ truth["three"] @ [0, 0, 0.05, 1])[:3]
            gap = float(np.linalg.norm(np.maximum(np.abs(centre) - box.half_extents, 0))) - 0.04
            if -0.03 < gap < 0.0029:
                hits["three"] += 1
                assert near[frozenset(("three", f"environment/{i}"))] == pytest.approx(gap, abs=1e-6)
            elif gap > 0.0031:
                assert frozenset(("three", f"environment/{i}")) not in near
    assert all(count > 20 for count in hits.values()), hits


@pytest.mark.parametrize("name", ["panda", "ur5e", "xarm7"])
def test_the_shipped_descriptions_are_those_of_their_grippers(name: str) -> None:
    """At 41 openings of the whole range, between the rows of the table too; their joints and their rest are allowed."""
    try:
        description = load_robot_description(name)
        unchecked_pairs(description)
    except InputError as error:
        pytest.skip(str(error))
    home = np.array(description.arm.home)
    scene = Scene(scene_assembly(), replace(scene_workcell(), description=description, home=home), 0.003)
    scene.show(0, None)
    assert ((scene.joint_limits[:, 0] <= home) & (home <= scene.joint_limits[:, 1])).all()
    pairs, distances = scene.near()
    assert [(scene.label(a), scene.label(b)) for (a, b), d in zip(pairs, distances, strict=True) if d < 0] == []
    openings = description.gripper.openings
    for opening in np.linspace(openings[0], openings[-1], 41):
        scene.open(float(opening))
        scene.place(home)
        assert not scene.joints.beyond_limits(float(opening))
        for pad in scene.pads():
            assert pad.distance == pytest.approx(opening / 2, abs=5e-5)
            assert pad.tilt < math.radians(0.1)
