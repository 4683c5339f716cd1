"""The reader of URDF against MuJoCo's, and one clear line for whatever is wrong with a file."""

from __future__ import annotations

import builtins
import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import trimesh

from takeapart.formats.robot_files import load_robot_description
from takeapart.model.description import ArmDescription, RobotFiles
from takeapart.model.errors import InputError
from takeapart.robot.chain import arm_chain
from takeapart.robot.urdf import Urdf, collisions, read_urdf, reading, visuals

ROBOTS = ["panda", "ur5e", "xarm7"]


def files_of(name: str) -> list[RobotFiles]:
    description = load_robot_description(name)
    return list({part.files.urdf: part.files for part in (description.arm, description.gripper)}.values())


def mujoco_model(files: RobotFiles) -> mujoco.MjModel:
    """Links and joints alone, by MuJoCo's own reader; mimic joints are set by hand."""
    import re

    text = files.urdf.read_text(encoding="utf-8")
    text = re.sub(r"<(visual|collision|inertial|transmission|gazebo|ros2_control)\b.*?</\1>", "", text, flags=re.DOTALL)
    text = re.sub(r"<drake:.*?</drake:[a-z_]*>|\sdrake:\w+=\"[^\"]*\"", "", text, flags=re.DOTALL)
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    text = re.sub(r"<link\s+name=\"([^\"]+)\"\s*/>", r'<link name="\1"></link>', text)
    text = re.sub(r"</link>", f"{inertial}</link>", text)
    compiler = '<mujoco><compiler fusestatic="false" autolimits="true"/></mujoco></robot>'
    return mujoco.MjSpec.from_string(text.replace("</robot>", compiler)).compile()


@pytest.mark.parametrize("files", [pytest.param(f, id=f"{n}-{i}") for n in ROBOTS for i, f in enumerate(files_of(n))])
def test_every_link_stands_where_mujoco_has_it(files: RobotFiles) -> None:
    """1,000 configurations; joints that mimic others follow by multiplier and offset."""
    urdf, model = read_urdf(files), mujoco_model(files)
    data = mujoco.MjData(model)
    (root,) = urdf.roots
    free = [name for name, joint in urdf.joints.items() if joint.kind != "fixed" and joint.mimic is None]
    rng = np.random.default_rng(0)
    bodies = [model.body(i).name for i in range(1, model.nbody)]
    worst = 0.0
    for _ in range(1000):
        values = {name: float(rng.uniform(*urdf.limits(name))) for name in free}
        for name, joint in urdf.joints.items():
            if joint.kind != "fixed":
                mimic = joint.mimic
                value = values[name] if mimic is None else mimic.multiplier * values[mimic.joint] + mimic.offset
                data.qpos[model.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(model, data)
        poses = urdf.poses(root, values)
        for link in bodies:
            if link in poses:
                body = model.body(link).id
                worst = max(worst, float(np.abs(poses[link][:3, 3] - data.xpos[body]).max()))
                worst = max(worst, float(np.abs(poses[link][:3, :3].ravel() - data.xmat[body]).max()))
    assert worst < 1e-6
    assert len([link for link in bodies if link in poses]) >= len(urdf.links) - 2


def written(folder: Path, body: str) -> RobotFiles:
    file = folder / "robot.urdf"
    file.write_text(f'<?xml version="1.0"?>\n<robot name="test">\n{body}\n</robot>\n', encoding="utf-8")
    return RobotFiles(file)


BOX = '<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>'
TURNS = '<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>{}</joint>'
LIMIT = '<limit lower="-1" upper="2" effort="1" velocity="1"/>'


def two_links(joint: str = LIMIT, geometry: str = BOX) -> str:
    return f'<link name="a">{geometry}</link>\n<link name="b">{BOX}</link>\n{TURNS.format(joint)}'


def test_chains_of_mimics_and_their_offsets(tmp_path: Path) -> None:
    body = "".join(f'<link name="{name}"/>' for name in "abcd") + (
        f'<joint name="x" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="0 0 2"/>{LIMIT}</joint>'
        '<joint name="y" type="prismatic"><parent link="a"/><child link="c"/><axis xyz="0 0 1"/>'
        f'<mimic joint="x" multiplier="-2" offset="0.5"/>{LIMIT}</joint>'
        '<joint name="z" type="prismatic"><parent link="a"/><child link="d"/><axis xyz="0 0 1"/>'
        f'<mimic joint="y" multiplier="3"/>{LIMIT}</joint>'
    )
    urdf = read_urdf(written(tmp_path, body))
    heights = {link: urdf.pose("a", link, {"x": 0.1})[2, 3] for link in "bcd"}
    assert heights == pytest.approx({"b": 0.1, "c": 0.3, "d": 0.9})
    assert urdf.driver("z") == "x"


def test_what_has_the_name_of_a_joint_elsewhere_is_none(tmp_path: Path) -> None:
    other = (
        '<transmission name="t"><joint name="j"><hardwareInterface>x</hardwareInterface></joint></transmission>'
        '<gazebo reference="a"><joint name="j"/></gazebo><ros2_control name="r"><joint name="j"/></ros2_control>'
        '<drake:group name="g"><joint name="j"/></drake:group>'
    )
    body = two_links().replace("<limit", '<limit drake:acceleration="2"') + other
    urdf = read_urdf(written(tmp_path, body))
    assert list(urdf.joints) == ["j"]
    assert urdf.limits("j") == (-1.0, 2.0)


@pytest.mark.parametrize(("scale", "sign"), [("1 1 1", 1), ("0.5 2 1", 1), ("1 -1 1", -1), ("-1 -1 -2", -1), ("2", 1)])
def test_scaled_meshes_keep_their_outside(tmp_path: Path, scale: str, sign: int) -> None:
    trimesh.creation.box((0.1, 0.2, 0.3)).export(tmp_path / "box.stl")
    geometry = (
        f'<collision><origin xyz="0.5 0 0" rpy="0 0 1"/><geometry><mesh filename="box.stl" scale="{scale}"/>'
        "</geometry></collision>"
    )
    (mesh,) = collisions(read_urdf(written(tmp_path, two_links(geometry=geometry))), "a")
    factors = np.resize([float(word) for word in scale.split()], 3)
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).volume == pytest.approx(0.006 * abs(factors.prod()), rel=1e-6)
    assert np.ptp(mesh.vertices[:, 2]) == pytest.approx(0.3 * abs(factors[2]))


@pytest.mark.parametrize("uri", ["package://parts/box.stl", "box.stl", "file://{folder}/box.stl"])
def test_meshes_are_found_by_every_kind_of_name(tmp_path: Path, uri: str) -> None:
    trimesh.creation.box((0.1, 0.2, 0.3)).export(tmp_path / "box.stl")
    name = uri.format(folder=tmp_path)
    geometry = f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
    files = written(tmp_path, two_links(geometry=geometry))
    (mesh,) = visuals(read_urdf(RobotFiles(files.urdf, {"parts": tmp_path})), "a")
    assert len(mesh.faces) == 12


@pytest.mark.parametrize(
    ("geometry", "extents"),
    [
        ('<box size="0.1 0.2 0.3"/>', (0.1, 0.2, 0.3)),
        ('<cylinder radius="0.05" length="0.3"/>', (0.1, 0.1, 0.3)),
        ('<sphere radius="0.1"/>', (0.2, 0.2, 0.2)),
    ],
)
def test_shapes_with_a_formula_are_contained_and_little_larger(
    tmp_path: Path, geometry: str, extents: tuple[float, ...]
) -> None:
    files = written(tmp_path, two_links(geometry=f"<collision><geometry>{geometry}</geometry></collision>"))
    (mesh,) = collisions(read_urdf(files), "a")
    hull = trimesh.Trimesh(mesh.vertices, mesh.faces)
    assert (hull.extents >= np.array(extents) - 1e-9).all()
    assert (hull.extents <= np.array(extents) + 0.004).all()
    rng = np.random.default_rng(0)
    points = rng.normal(size=(2000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    if "sphere" in geometry:
        points *= 0.1
    elif "cylinder" in geometry:
        points = np.column_stack([0.05 * points[:, :2] / np.linalg.norm(points[:, :2], axis=1)[:, None], points[:, 2]])
        points[:, 2] *= 0.15
    else:
        points = points / np.abs(points).max(axis=1, keepdims=True) * np.array(extents) / 2
    offsets = np.einsum("ij,ij->i", hull.face_normals, hull.triangles[:, 0])
    assert (points @ hull.face_normals.T - offsets).max() < 1e-9


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("", "has no link; a robot needs one"),
        ("<link/>", "the <link> on line 3 has no name; every one needs it"),
        ('<link name="a"/><link name="a"/>', "two elements <link> have the name 'a'; names must differ"),
        ('<link name="a"/><joint type="fixed"/>', "the <joint> on line 3 has no name; every one needs it"),
        ('<link name="a"/><joint name="j" type="fixed"><child link="a"/></joint>', 'has no <parent link="...">'),
        (two_links().replace('link="b"/>', 'link="c"/>'), "joint 'j' names the link 'c', which is not there"),
        (two_links().replace('xyz="0 0 1"', 'xyz="0 0 0"'), "joint 'j': the axis is '0 0 0'; it must have a direction"),
        (two_links().replace('xyz="0 0 1"', 'xyz="0 0"'), "xyz of <axis> on line 5 is '0 0'; must be 3 finite numbers"),
        (two_links().replace('lower="-1"', 'lower="x"'), "lower of <limit> on line 5 is 'x'; must be a finite number"),
        (two_links('<mimic joint="k"/>'), "joint 'j' mimics 'k', which is not there"),
        (two_links('<mimic joint="j"/>'), "joint 'j' mimics itself through 'j'"),
        (two_links(geometry=BOX.replace("box size", "cone size")), "whose geometry is <cone>; must be one box, cyl"),
        (two_links(geometry=BOX.replace("0.1 0.1 0.1", "0.1 0.1 0")), "has a box with size '0.1 0.1 0'; must be abo"),
        ('<link name="a"/><link name="b"/>' + TURNS.format("") + TURNS.format("").replace('"j"', '"k"'), "on two joi"),
        ('<!DOCTYPE x [<!ENTITY e "e">]><link name="a"/>', "not XML"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(tmp_path: Path, body: str, message: str) -> None:
    files = written(tmp_path, body)
    with pytest.raises(InputError) as caught:
        read_urdf(files)
    assert message in str(caught.value)
    assert str(files.urdf) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not XML: no element found"),
        (b"\x00\xff\xfe", "not XML"),
        (b"<robot", "not XML"),
        (b"<sdf/>", "not a URDF: its outermost element is <sdf>; must be <robot>"),
        (b"<a>" * 200, "nested deeper"),
        (b'<!DOCTYPE r [<!ENTITY e "e">]><robot/>', "declares an entity"),
    ],
)
def test_what_is_no_urdf_is_told_in_one_line(tmp_path: Path, content: bytes, message: str) -> None:
    file = tmp_path / "robot.urdf"
    file.write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_urdf(RobotFiles(file))


def test_files_that_are_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such file"):
        read_urdf(RobotFiles(tmp_path / "none.urdf"))
    with pytest.raises(InputError, match="cannot be read"):
        read_urdf(RobotFiles(tmp_path))
    mesh = '<collision><geometry><mesh filename="{}"/></geometry></collision>'
    for name, message in (
        ("none.stl", "there is no file .*none.stl"),
        ("package://parts/a.stl", "package 'parts' of .* is not known; known: none; say where it is: --package parts="),
    ):
        urdf = read_urdf(written(tmp_path, two_links(geometry=mesh.format(name))))
        with pytest.raises(InputError, match=message):
            collisions(urdf, "a")
    (tmp_path / "broken.stl").write_bytes(b"solid but not really")
    with pytest.raises(InputError, match="broken"):
        collisions(read_urdf(written(tmp_path, two_links(geometry=mesh.format("broken.stl")))), "a")


def arm_of(urdf: Urdf) -> ArmDescription:
    return ArmDescription("test", urdf.files, "a", "b", ("j",), 1.0, (0.0,))


def test_a_joint_without_limits_and_one_that_slides_make_no_arm(tmp_path: Path) -> None:
    urdf = read_urdf(written(tmp_path, two_links("")))
    with pytest.raises(InputError, match="joint 'j' has no limits; a revolute joint needs"):
        arm_chain(urdf, arm_of(urdf))
    urdf = read_urdf(written(tmp_path, two_links().replace("revolute", "prismatic")))
    with pytest.raises(InputError, match="is of type 'prismatic'; an arm's joints must turn"):
        arm_chain(urdf, arm_of(urdf))
    urdf = read_urdf(written(tmp_path, two_links("").replace("revolute", "continuous")))
    chain = arm_chain(urdf, arm_of(urdf))
    assert chain.upper[0] - chain.lower[0] == pytest.approx(4 * np.pi)


def test_an_arm_without_geometry_is_not_planned_with(tmp_path: Path) -> None:
    from takeapart.robot.chain import arm_bodies

    urdf = read_urdf(written(tmp_path, two_links(geometry="")))
    arm = arm_of(urdf)
    with pytest.raises(InputError, match="link 'a' has no collision geometry, nor has what is fixed on it"):
        arm_bodies(arm, arm_chain(urdf, arm))


def test_xacro_needs_its_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "robot.urdf.xacro"
    file.write_text('<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro"><link name="a"/></robot>')
    real = builtins.__import__

    def absent(name: str, *arguments: Any, **named: Any) -> Any:
        if name == "xacro":
            raise ImportError(name)
        return real(name, *arguments, **named)

    monkeypatch.setattr(builtins, "__import__", absent)
    with pytest.raises(InputError, match="install it with: pip install xacro"):
        read_urdf(RobotFiles(file))


def test_xacro_is_expanded(tmp_path: Path) -> None:
    pytest.importorskip("xacro")
    file = tmp_path / "robot.urdf.xacro"
    file.write_text(
        '<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro"><xacro:property name="n" value="arm"/>'
        '<link name="${n}_base"/></robot>'
    )
    assert list(read_urdf(RobotFiles(file)).links) == ["arm_base"]
    file.write_text('<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro"><link name="${nothing}"/></robot>')
    with pytest.raises(InputError, match="xacro cannot expand it"):
        read_urdf(RobotFiles(file))


@pytest.mark.parametrize("name", ["panda", "ur5e", "xarm7"])
def test_what_is_kept_of_a_file_is_what_was_read(name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("takeapart.robot.kept.cache_folder", lambda: tmp_path)
    description = load_robot_description(name)
    for files in (description.arm.files, description.gripper.files):
        reading._read.cache_clear()
        first = read_urdf(files)
        reading._read.cache_clear()
        with monkeypatch.context() as without:
            without.setitem(sys.modules, "yourdfpy", None)  # importing it fails
            again = read_urdf(files)
        assert (again.name, list(again.links), list(again.joints)) == (
            first.name,
            list(first.links),
            list(first.joints),
        )
        for link, other in zip(first.links.values(), again.links.values(), strict=True):
            assert repr(link) == repr(other)
        for joint, twin in zip(first.joints.values(), again.joints.values(), strict=True):
            assert repr(joint) == repr(twin)
            np.testing.assert_array_equal(joint.T_parent, twin.T_parent)
    for file in tmp_path.glob("urdf-*"):
        file.write_bytes(b"damaged")
    reading._read.cache_clear()
    assert list(read_urdf(files).links) == list(first.links)


@pytest.mark.parametrize(("unit", "factor"), [('<unit name="millimeter" meter="0.001"/>', 1e-3), ("", 1.0)])
def test_the_unit_of_a_collada_mesh_counts(unit: str, factor: float, tmp_path: Path) -> None:
    written = trimesh.exchange.dae.export_collada(trimesh.creation.box((100.0, 200.0, 300.0))).decode()
    assert "<unit" not in written and "<up_axis>" in written
    (tmp_path / "box.dae").write_text(written.replace("<up_axis>", f"{unit}<up_axis>"), encoding="utf-8")
    mesh = '<geometry><mesh filename="box.dae"/></geometry>'
    file = tmp_path / "robot.urdf"
    file.write_text(f'<robot name="r"><link name="a"><collision>{mesh}</collision></link></robot>', encoding="utf-8")
    (found,) = collisions(read_urdf(RobotFiles(file)), "a")
    np.testing.assert_allclose(np.ptp(found.vertices, axis=0), factor * np.array([100.0, 200.0, 300.0]))
