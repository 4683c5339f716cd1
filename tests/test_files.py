"""Round trips, hashes, the shipped workcell, and writing that leaves all or nothing."""

from __future__ import annotations

import hashlib
import json
import os
import resource
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import example_documents
from takeapart.formats.documents import require_writable, write_atomically
from takeapart.formats.files import (
    assembly_hash,
    data_path,
    load_assembly,
    load_plan,
    load_workcell,
    save_assembly,
    save_plan,
    workcell_hash,
)
from takeapart.formats.serialization import workcell_hash_by_name
from takeapart.formats.sources import source_workcell, workcell_of_hash
from takeapart.model.assembly import Assembly, Connector, Part
from takeapart.model.errors import InputError, UnknownNameError
from takeapart.model.geometry import Box, OrientedBox, pose
from takeapart.model.plan import Grasp, Plan, PlanStep

angles = st.floats(-3.2, 3.2)
JOINTS = tuple(f"panda_joint{i}" for i in range(1, 8))


def make_assembly(rotation: np.ndarray | None = None, mass: float = 0.3) -> Assembly:
    T = pose((0.1 + 1e-12, 1 / 3, 0.05))
    if rotation is not None:
        T[:3, :3] = rotation
    wall = OrientedBox(T.copy(), np.array([0.001, 0.002, 1 / 300]))
    parts = (
        Part("low", Box((0.1, 0.1, 0.02)), pose((5.0, 0.0, 0.0)), 1.0, fixed=True),
        Part("a", Box((0.1, 0.2, 1 / 30)), T, mass),
    )
    return Assembly(
        "two", parts, (Connector("c", "O", "low", "a", (wall,)),), ("a",), {"seed": np.int64(3), "options": (1, 2.5)}
    )


def make_plan(rows: int = 5) -> Plan:
    rng = np.random.default_rng(1)
    quaternions = Rotation.random(rows, random_state=2).as_quat()[:, [3, 0, 1, 2]]
    tool = np.hstack([rng.uniform(-1, 1, (rows, 3)), quaternions])
    grasp = Grasp(tool[0, :3], quaternions[0], 0.02)
    step = PlanStep("a", grasp, rng.uniform(-3, 3, (rows, 7)), tool, 1.2345678901234)
    return Plan(
        steps=(step,),
        total_length=1.2345678901234,
        straight_line_bound=1.0,
        sequence_bound=None,
        counts={"motion_plans": 3, "removal_queries": 1},
        seconds=0.5,
        seed=4,
        search={
            "name": "exact",
            "budget": {"episodes": float("inf"), "seconds": np.float64(2.5)},
            "table": np.arange(2),
        },
        hashes={"assembly": "a" * 64, "workcell": "b" * 64},
        versions={"takeapart": "0.1.0"},
        assembly="two",
        workcell="panda",
        robot="panda",
        joints=JOINTS,
    )


def test_assembly_comes_back_to_nanometres(tmp_path: Path) -> None:
    rotation = Rotation.from_euler("xyz", [0.3, -1.2, 2.0]).as_matrix()
    saved = make_assembly(rotation)
    save_assembly(saved, tmp_path / "a.json")
    loaded = load_assembly(tmp_path / "a.json")
    assert (loaded.name, loaded.witness, loaded.provenance) == ("two", ("a",), {"seed": 3, "options": [1, 2.5]})
    for before, after in zip(saved.parts, loaded.parts, strict=True):
        assert (before.name, before.fixed, before.mass) == (after.name, after.fixed, after.mass)
        np.testing.assert_allclose(after.T_world_part, before.T_world_part, atol=3e-9)
        np.testing.assert_allclose(after.shape.boxes()[0].half_extents, before.shape.boxes()[0].half_extents, atol=1e-9)
    (before_connector,), (connector,) = saved.connectors, loaded.connectors
    assert (connector.name, connector.kind, connector.host, connector.guest) == ("c", "O", "low", "a")
    np.testing.assert_allclose(connector.walls[0].T_frame_box, before_connector.walls[0].T_frame_box, atol=3e-9)
    np.testing.assert_allclose(connector.walls[0].half_extents, before_connector.walls[0].half_extents, atol=1e-9)


@settings(deadline=None, max_examples=300)
@given(roll=angles, pitch=angles, yaw=angles)
def test_what_was_loaded_is_saved_with_the_same_bytes_and_hash(
    tmp_path_factory: pytest.TempPathFactory, roll: float, pitch: float, yaw: float
) -> None:
    folder = tmp_path_factory.mktemp("bytes")
    saved = make_assembly(Rotation.from_euler("xyz", [roll, pitch, yaw]).as_matrix())
    save_assembly(saved, folder / "1.json")
    loaded = load_assembly(folder / "1.json")
    save_assembly(loaded, folder / "2.json")
    assert (folder / "1.json").read_bytes() == (folder / "2.json").read_bytes()
    assert assembly_hash(saved) == assembly_hash(loaded)


def test_assembly_hash_is_the_documented_one(tmp_path: Path) -> None:
    document = example_documents.assembly()
    document["parts"][2]["pose"]["orientation"] = [1, 0, 0, 0]  # integers and floats of the same value are the same
    (tmp_path / "a.json").write_text(json.dumps(document))
    document["parts"][2]["pose"]["orientation"] = [1.0, 0.0, 0.0, 0.0]
    for key in ("format", "witness", "provenance"):
        del document[key]
    canonical = json.dumps(document, sort_keys=True, separators=(",", ":"))
    assert assembly_hash(load_assembly(tmp_path / "a.json")) == hashlib.sha256(canonical.encode()).hexdigest()


def test_assembly_hash_tells_assemblies_apart() -> None:
    base = make_assembly()
    same = Assembly(base.name, base.parts, base.connectors, (), {"seed": 99})
    assert assembly_hash(base) == assembly_hash(same)
    different = [
        Assembly("other", base.parts, base.connectors),
        make_assembly(mass=0.300001),
        Assembly(base.name, base.parts, ()),
        Assembly(base.name, base.parts[::-1], base.connectors),
    ]
    assert len({assembly_hash(assembly) for assembly in [base, *different]}) == 5


def test_plan_comes_back(tmp_path: Path) -> None:
    plan = make_plan()
    save_plan(plan, tmp_path / "1.json")
    loaded = load_plan(tmp_path / "1.json")
    save_plan(loaded, tmp_path / "2.json")
    assert (tmp_path / "1.json").read_bytes() == (tmp_path / "2.json").read_bytes()
    step, before = loaded.steps[0], plan.steps[0]
    np.testing.assert_allclose(step.joint_path, before.joint_path, atol=6e-10)
    np.testing.assert_allclose(step.tool_path, before.tool_path, atol=6e-10)
    np.testing.assert_allclose(step.grasp.orientation, before.grasp.orientation, atol=6e-10)
    assert (step.length, loaded.total_length) == (1.23456789, 1.23456789)
    assert loaded.sequence_bound is None
    assert loaded.search == {"name": "exact", "budget": {"episodes": None, "seconds": 2.5}, "table": [0, 1]}
    assert (loaded.seed, loaded.counts, loaded.hashes) == (plan.seed, plan.counts, plan.hashes)


def test_plan_file_has_exactly_the_documented_keys(tmp_path: Path) -> None:
    save_plan(make_plan(rows=3), tmp_path / "plan.json")
    text = (tmp_path / "plan.json").read_text()
    document = json.loads(text)
    assert set(document) == set(
        "format version total_length straight_line_bound sequence_bound steps counts seconds seed search hashes "
        "versions assembly workcell direction robot joints".split()
    )
    assert set(document["steps"][0]) == {"part", "grasp", "joint_path", "tool_path", "length"}
    assert set(document["steps"][0]["grasp"]) == {"center", "orientation", "width"}
    rows = [line.strip().rstrip(",") for line in text.splitlines()]
    assert all(json.dumps(row) in rows for row in document["steps"][0]["joint_path"])  # one row per line


def test_a_plan_says_whose_joints_it_moves(tmp_path: Path) -> None:
    save_plan(make_plan(), tmp_path / "plan.json")
    document = json.loads((tmp_path / "plan.json").read_text())
    assert (document["version"], document["robot"], document["joints"]) == (2, "panda", list(JOINTS))
    loaded = load_plan(tmp_path / "plan.json")
    assert (loaded.robot, loaded.joints) == ("panda", JOINTS)
    save_plan(loaded.inverted().inverted(), tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "plan.json").read_bytes()


def test_a_file_of_version_1_is_read_and_written_as_one(tmp_path: Path) -> None:
    """It does not say whose joints it moves, so what is made of it cannot say so either."""
    save_plan(make_plan(), tmp_path / "2.json")
    document = json.loads((tmp_path / "2.json").read_text())
    del document["robot"], document["joints"]
    (tmp_path / "1.json").write_text(json.dumps({**document, "version": 1}))
    loaded = load_plan(tmp_path / "1.json")
    assert (loaded.robot, loaded.joints) == ("", ())
    np.testing.assert_allclose(loaded.steps[0].joint_path, make_plan().steps[0].joint_path, atol=6e-10)
    save_plan(loaded.inverted().inverted(), tmp_path / "again.json")
    assert json.loads((tmp_path / "again.json").read_text()) == {**document, "version": 1}


def test_a_workcell_has_the_hash_that_files_of_version_1_name() -> None:
    """Written down when robots were known by their names."""
    names = {
        "panda": "f9ee09ff9e72aac0599bed09ddf87ff1391119e1f98ae3634dc4092148fb9317",
        "panda-tall": "df7bc7ca8a744679ad00f17233538e5a6d8f78ddb691dc7ef3cafb69390117d1",
    }
    assert {name: workcell_hash_by_name(load_workcell(name)) for name in names} == names
    plan = replace(make_plan(), robot="", joints=(), hashes={"assembly": "a" * 64, "workcell": names["panda-tall"]})
    found = workcell_of_hash("another", names["panda-tall"], [data_path("workcells")], "plan", by_name=True)
    assert found.name == "panda-tall"
    assert source_workcell(replace(plan, workcell="panda-tall"), [], "plan").name == "panda-tall"
    with pytest.raises(InputError):
        workcell_of_hash("another", names["panda-tall"], [data_path("workcells")], "plan")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"version": 3}, "version: version 3; this release reads version 1 and 2"),
        ({"version": 1}, "there is a key 'robot'; version 1 has none, version 2 has one"),
        ({"joints": None}, "there is no key 'joints'; version 1 has none, version 2 has one"),
        ({"joints": JOINTS[:6]}, "steps[0].joint_path has 7 angles in a row, but 6 joints are named"),
        ({"joints": [*JOINTS[:6], "panda_joint1"]}, "'panda_joint1' stands twice; every joint has a name of its own"),
        ({"joints": []}, "joints"),
    ],
)
def test_joints_of_a_plan_that_are_wrong_are_one_line(tmp_path: Path, changes: dict[str, object], message: str) -> None:
    save_plan(make_plan(), tmp_path / "plan.json")
    document = {**json.loads((tmp_path / "plan.json").read_text()), **changes}
    (tmp_path / "plan.json").write_text(json.dumps(document))
    with pytest.raises(InputError) as caught:
        load_plan(tmp_path / "plan.json")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_inverted_plan_comes_back(tmp_path: Path) -> None:
    plan = make_plan().inverted()
    save_plan(plan, tmp_path / "assembly.json")
    loaded = load_plan(tmp_path / "assembly.json")
    assert loaded.direction == "assembly"
    np.testing.assert_allclose(loaded.steps[0].joint_path, plan.steps[0].joint_path, atol=6e-10)


def test_shipped_workcell() -> None:
    panda = load_workcell("panda")
    np.testing.assert_array_equal(panda.T_world_base, pose((-0.30, 0.20, 0.20)))
    np.testing.assert_array_equal(panda.goal, [-0.25, -0.20, 0.35])
    assert (panda.lift_height, panda.clearance, panda.home.shape) == (0.05, 0.001, (7,))
    corners = {obstacle.name: obstacle.box.corners() for obstacle in panda.environment}
    assert corners["table"][:, 2].max() == pytest.approx(-0.002, abs=1e-12)
    assert corners["pedestal"][:, 2].min() == pytest.approx(-0.002, abs=1e-12)
    assert corners["pedestal"][:, 2].max() == pytest.approx(panda.T_world_base[2, 3])
    for point in [panda.T_world_base[:3, 3], panda.goal, np.zeros(3), np.array([0.4, 0.4, 0.6]), *corners["pedestal"]]:
        assert (corners["table"][:, :2].min(axis=0) <= point[:2]).all() and (
            point[:2] <= corners["table"][:, :2].max(axis=0)
        ).all()


@pytest.mark.parametrize(
    ("key", "stated", "default"), [("payload", 1.5, 3.0), ("gripping_force", 30.0, 70.0), ("friction", 0.2, 0.5)]
)
def test_what_the_gripper_carries(tmp_path: Path, key: str, stated: float, default: float) -> None:
    """A file may say it; otherwise the robot's description does, and saying the same is the same workcell."""
    cells = {}
    for name, line in {"silent": "", "stated": f"{key} = {stated}", "same": f"{key} = {default}"}.items():
        (tmp_path / f"{name}.toml").write_text(
            example_documents.WORKCELL.replace("[robot]", f"[robot]\n{line}"), encoding="utf-8"
        )
        cells[name] = load_workcell(tmp_path / f"{name}.toml")
    assert [getattr(cells[name], key) for name in ("silent", "stated", "same")] == [default, stated, default]
    assert workcell_hash(cells["silent"]) == workcell_hash(cells["same"]) != workcell_hash(cells["stated"])


def test_grip_is_the_mass_that_friction_holds() -> None:
    """Two fingers, each with 70 N and a coefficient of 0.5: 70 N of friction."""
    assert load_workcell("panda").grip == pytest.approx(70 / 9.81)


def test_workcell_by_path_equals_workcell_by_name() -> None:
    by_path = load_workcell(data_path("workcells/panda.toml"))
    assert workcell_hash(by_path) == workcell_hash(load_workcell("panda"))


def test_workcell_hash_sees_every_number(tmp_path: Path) -> None:
    changes = ["-0.25", "0.05", "0.001", "-2.356194", "-0.30", "1.6", "-0.02", "table", "bench"]
    hashes = set()
    for i, old in enumerate(["no change", *changes]):
        new = old + "1" if old[-1].isdigit() else old + "x"
        (tmp_path / f"{i}.toml").write_text(example_documents.WORKCELL.replace(old, new, 1))
        hashes.add(workcell_hash(load_workcell(tmp_path / f"{i}.toml")))
    assert len(hashes) == len(changes) + 1


@pytest.mark.parametrize("name", ["pandas", "../panda", "", "workcells/panda", "\x00", "x" * 10_000])
def test_unknown_workcell_lists_the_shipped_ones(name: str) -> None:
    with pytest.raises(UnknownNameError, match="panda") as caught:
        load_workcell(name)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize("relative", ["nothing.json", "../pyproject.toml", "/etc/passwd", "../src"])
def test_shipped_data_stay_in_their_folder(relative: str) -> None:
    with pytest.raises(InputError, match="comes with takeapart"):
        data_path(relative)


def test_writing_replaces_the_whole_file_and_keeps_its_mode(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old and longer")
    target.chmod(0o640)
    write_atomically(target, "new")
    assert target.read_text() == "new"
    assert target.stat().st_mode & 0o777 == 0o640
    assert os.listdir(tmp_path) == ["a.txt"]


def test_writing_through_a_link_keeps_the_link(tmp_path: Path) -> None:
    (tmp_path / "real.txt").write_text("old")
    (tmp_path / "link.txt").symlink_to("real.txt")
    write_atomically(tmp_path / "link.txt", b"new")
    assert (tmp_path / "link.txt").is_symlink()
    assert (tmp_path / "real.txt").read_text() == "new"


def test_disk_that_fills_in_the_middle_leaves_the_old_file(tmp_path: Path) -> None:
    """The limit on file size makes the system itself refuse in the middle of the writing."""
    target = tmp_path / "plan.json"
    save_plan(make_plan(), target)
    before = example_documents.snapshot(tmp_path)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, hard))
    try:
        with pytest.raises(InputError, match="no space is left") as caught:
            save_plan(make_plan(rows=500), target)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert caught.value.where == str(target)
    assert example_documents.snapshot(tmp_path) == before


@pytest.mark.parametrize("function", ["replace", "fsync"])
@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_failure_at_any_stage_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, function: str, error: BaseException
) -> None:
    target = tmp_path / "plan.json"
    target.write_text("old")

    def refuse(*_: object) -> None:
        raise error

    monkeypatch.setattr(os, function, refuse)
    with pytest.raises(KeyboardInterrupt if isinstance(error, KeyboardInterrupt) else InputError):
        write_atomically(target, "new")
    assert example_documents.snapshot(tmp_path) == {"plan.json": b"old"}


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("folder", "it is a folder"),
        ("a\x00b", "null"),
        ("x" * 300, "name too long"),
        ("pipe", "not a regular file"),
        ("folder/", "ends in '/'"),
        ("loop", "too many levels of symbolic links"),
    ],
)
def test_names_that_cannot_be_written(tmp_path: Path, name: str, message: str) -> None:
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(InputError, match=f"cannot be written: .*{message}"):
        write_atomically(f"{tmp_path}/{name}", "new")
    with pytest.raises(InputError, match=f"cannot be written: .*{message}"):  # and it is known before the work starts
        require_writable(f"{tmp_path}/{name}")
    assert sorted(os.listdir(tmp_path)) == ["folder", "loop", "pipe"]


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write everywhere")
def test_read_only_folder(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(InputError, match="cannot be written: permission denied"):
            write_atomically(tmp_path / "a.json", "new")
    finally:
        tmp_path.chmod(0o700)


def test_system_that_refuses_is_told_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> int:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(InputError, match=r"a\.json: cannot be written: read-only file system$"):
        write_atomically(tmp_path / "a.json", "new")


def test_what_breaks_the_format_is_not_written(tmp_path: Path) -> None:
    bad = make_assembly()
    bad = Assembly("../evil", bad.parts, bad.connectors)
    with pytest.raises(InputError, match="evil"):
        save_assembly(bad, tmp_path / "a.json")
    plan = make_plan()
    plan.steps[0].joint_path[1, 2] = np.nan
    with pytest.raises(InputError, match=r"steps\[0\]\.joint_path\[1\]\[2\]: nan; must be a finite number"):
        save_plan(plan, tmp_path / "a.json")
    assert os.listdir(tmp_path) == []
