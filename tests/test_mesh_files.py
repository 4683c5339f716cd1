"""Assembly files of version 2: meshes beside the file, joints, contacts; and version 1, which stays as it was."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from takeapart.formats.files import assembly_hash, data_path, load_assembly, save_assembly
from takeapart.formats.mesh_files import obj_text, read_obj
from takeapart.model.assembly import Assembly, Joint, Part
from takeapart.model.errors import InputError
from takeapart.model.geometry import Box, TriangleMesh, pose
from takeapart.model.meshes import Mesh


def box_mesh(x: float, y: float, z: float) -> Mesh:
    return Mesh(Box((x, y, z)).surface())


def product() -> Assembly:
    screw = box_mesh(0.01, 0.01, 0.1 / 3)
    return Assembly(
        name="bench",
        parts=(
            Part("plate", box_mesh(0.2, 0.2, 0.01), pose(), 0.3, fixed=True),
            Part("screw", screw, pose((0.05, 0.0, 0.1)), 0.01),
            Part("screw-2", Mesh(screw.surface()), pose((-0.05, 0.0, 0.1), (0.8, 0.0, 0.6, 0.0)), 0.01),
            Part("cube", Box((0.02, 0.02, 0.02)), pose((0.0, 0.05, 0.015)), 0.02),
        ),
        joints=(
            Joint(
                "thread",
                "screw",
                "plate",
                "screw",
                np.array([[0.05, 0, 0.005]]),
                np.array([0, 0, 1.0]),
                50.0,
                2.0,
                0.001,
            ),
        ),
        friction=0.2,
        contact_gap=0.001,
        allowed_overlaps=(("plate", "screw"),),
        provenance={"made": "here"},
    )


def test_a_product_of_meshes_comes_back(tmp_path: Path) -> None:
    made = product()
    save_assembly(made, tmp_path / "a" / "bench.json")
    found = load_assembly(tmp_path / "a" / "bench.json")
    assert len(list((tmp_path / "a" / "meshes").iterdir())) == 2
    assert found.parts[1].shape is found.parts[2].shape  # equal shapes are one object
    for before, after in zip(made.parts, found.parts, strict=True):
        assert (before.name, before.mass, before.fixed) == (after.name, after.mass, after.fixed)
        assert np.abs(before.T_world_part - after.T_world_part).max() < 1e-9
        assert np.array_equal(before.shape.surface().vertices, after.shape.surface().vertices)
        assert np.array_equal(before.shape.surface().triangles, after.shape.surface().triangles)
    assert found.joints[0].pitch == 0.001 and np.array_equal(found.joints[0].points, made.joints[0].points)
    assert (found.friction, found.contact_gap, found.allowed_overlaps) == (0.2, 0.001, (("plate", "screw"),))
    assert assembly_hash(found) == assembly_hash(made)
    save_assembly(found, tmp_path / "b" / "bench.json")
    for file in ("bench.json", *(f"meshes/{each.name}" for each in (tmp_path / "a" / "meshes").iterdir())):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_the_hash_is_of_the_content_not_of_the_files(tmp_path: Path) -> None:
    save_assembly(product(), tmp_path / "bench.json")
    document = json.loads((tmp_path / "bench.json").read_text())
    (tmp_path / document["parts"][0]["shape"]["file"]).rename(tmp_path / "other.obj")
    document["parts"][0]["shape"]["file"] = "other.obj"
    (tmp_path / "moved.json").write_text(json.dumps(document))
    assert assembly_hash(load_assembly(tmp_path / "moved.json")) == assembly_hash(product())
    longer = replace(product().parts[0], shape=box_mesh(0.2, 0.2, 0.010001))
    assert assembly_hash(replace(product(), parts=(longer, *product().parts[1:]))) != assembly_hash(product())


@pytest.mark.parametrize("name", ["single/01.json", "double/03.json", "examples/rack.json"])
def test_a_product_of_boxes_is_written_as_it_always_was(tmp_path: Path, name: str) -> None:
    save_assembly(load_assembly(data_path(name)), tmp_path / "a.json")
    assert (tmp_path / "a.json").read_bytes() == data_path(name).read_bytes()


def test_two_products_in_one_folder_keep_their_meshes(tmp_path: Path) -> None:
    first = product()
    second = replace(first, parts=(replace(first.parts[0], shape=box_mesh(0.3, 0.2, 0.01)), *first.parts[1:]))
    save_assembly(first, tmp_path / "first.json")
    save_assembly(second, tmp_path / "second.json")
    assert assembly_hash(load_assembly(tmp_path / "first.json")) == assembly_hash(first)
    assert assembly_hash(load_assembly(tmp_path / "second.json")) == assembly_hash(second)
    assert len(list((tmp_path / "meshes").iterdir())) == 3


def test_numbers_of_a_mesh_are_kept_to_the_last_digit(tmp_path: Path) -> None:
    vertices = np.random.default_rng(0).normal(size=(50, 3)) * 10.0 ** np.linspace(-9, 2, 50)[:, None]
    vertices[0] = (-0.0, 1 / 3, 1e-300)
    mesh = TriangleMesh(vertices, np.arange(48, dtype=np.int32).reshape(-1, 3))
    (tmp_path / "a.obj").write_text(obj_text(mesh))
    assert read_obj(tmp_path / "a.obj").vertices.tobytes() == vertices.tobytes()


def saved(folder: Path) -> tuple[dict[str, Any], Path]:
    save_assembly(product(), folder / "bench.json")
    document = json.loads((folder / "bench.json").read_text())
    return document, folder / document["parts"][0]["shape"]["file"]


@pytest.mark.parametrize(
    ("file", "message"),
    [
        ("../plate.obj", "'../plate.obj'; must be a path inside the folder of the assembly file"),
        ("/etc/passwd", "'/etc/passwd'; must be a path inside the folder of the assembly file"),
        ("meshes/../../x.obj", "'meshes/../../x.obj'; must be a path inside the folder of the assembly file"),
        ("a\x00b", r"'a\x00b'; must be a path inside the folder of the assembly file"),
        ("meshes/none.obj", "'meshes/none.obj': there is no such file"),
        ("meshes", "'meshes': is a folder, not a file"),
        ("link.obj", "'link.obj' is a link that leads out of the folder of the assembly file"),
    ],
)
def test_files_that_are_not_there_or_not_inside_are_refused(tmp_path: Path, file: str, message: str) -> None:
    document, _ = saved(tmp_path / "in")
    (tmp_path / "plate.obj").write_text("v 0 0 0\n")
    os.symlink(tmp_path / "plate.obj", tmp_path / "in" / "link.obj")
    document["parts"][0]["shape"]["file"] = file
    (tmp_path / "in" / "bench.json").write_text(json.dumps(document))
    with pytest.raises(InputError) as error:
        load_assembly(tmp_path / "in" / "bench.json")
    assert str(error.value) == f"{tmp_path}/in/bench.json: parts[0].shape.file: {message}"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "the file is empty"),
        ("v 0 0 0\nv 1 0\n", "line 2: 'v 1 0'; must be 'v x y z' or 'f i j k'"),
        ("v 0 0 nan\nv 0 1 0\nv 1 0 0\nf 1 2 3\n", "the mesh has a corner that is not finite"),
        ("v 0 0 x\nv 0 1 0\nv 1 0 0\nf 1 2 3\n", "holds a text where a number must stand"),
        ("v 0 0 0\nv 0 1 0\nv 1 0 0\nf 1 2 4\n", "a triangle names corner 4; 1 to 3 are there"),
        ("v 0 0 0\nv 0 1 0\nv 1 0 0\nf 1 2 0\n", "a triangle names corner 0; 1 to 3 are there"),
        ("v 0 0 0\nv 0 1 0\nv 1 0 0\nf 1 2 99999999999999999999999\n", "holds a text where a number must stand"),
        ("v 0 0 0\nv 0 1 0\nv 1 0 0\n", "the mesh has no triangles; at least four are needed"),
        ("PK\x03\x04 zip\n", r"line 1: 'PK\x03\x04 zip'; must be 'v x y z' or 'f i j k'"),
        ("v 0 0 0\nv 0 1 0\nv 1 0 0\nf 1 2 3\n", "has the hash "),
    ],
)
def test_broken_meshes_are_refused_in_one_line(tmp_path: Path, content: str, message: str) -> None:
    _, mesh = saved(tmp_path)
    mesh.write_text(content)
    with pytest.raises(InputError) as error:
        load_assembly(tmp_path / "bench.json")
    assert f"bench.json: parts[0].shape.file: 'meshes/{mesh.name}'" in str(error.value)
    assert message in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 1}, "there is a key 'joints'; version 1 has none, version 2 has"),
        (
            {"version": 1, "joints": None, "friction": None, "contact_gap": None, "allowed_overlaps": None},
            "there is a mesh, of part 'plate'; version 1 has none, version 2 has",
        ),
        ({"allowed_overlaps": [["plate", "nobody"]]}, "allowed_overlaps[0]: there is no part 'nobody'"),
        ({"friction": -1}, "friction: -1; must be at least 0"),
    ],
)
def test_what_the_product_says_is_checked(tmp_path: Path, change: dict[str, object], message: str) -> None:
    document, _ = saved(tmp_path)
    document.update(change)
    (tmp_path / "bench.json").write_text(json.dumps(document))
    with pytest.raises(InputError) as error:
        load_assembly(tmp_path / "bench.json")
    assert str(error.value).endswith(message)
