"""Import of products from CAD: what is found agrees with what was drawn, and broken input ends in one line."""

from __future__ import annotations

import json
import os
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner, Result

from takeapart.cli.commands import main
from takeapart.formats.files import load_assembly
from takeapart.formats.importing import import_product
from takeapart.formats.importing.drawn import mended, valid_names
from takeapart.formats.importing.surfaces import split_map
from takeapart.formats.mesh_files import obj_text
from takeapart.model.errors import InputError
from takeapart.model.geometry import TriangleMesh
from takeapart.model.meshes import Mesh

CASES = Path(__file__).resolve().parents[2] / "shared" / "cases"
pytest.importorskip("manifold3d")


def written(folder: Path, name: str, mesh: trimesh.Trimesh, scale: float = 1.0) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    drawn = TriangleMesh(np.array(mesh.vertices) * scale, np.array(mesh.faces, np.int32))
    (folder / f"{name}.obj").write_text(obj_text(drawn))


def box(size: tuple[float, float, float], at: tuple[float, float, float]) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(at)
    return mesh


def bench(folder: Path, scale: float = 1.0) -> Path:
    """Plate; a post 0.2 mm deep in it; a ring 1 mm above it; a lid that lies on the post."""
    written(folder, "plate", box((0.1, 0.1, 0.01), (0.0, 0.0, 0.005)), scale)
    written(folder, "post", box((0.02, 0.02, 0.05), (0.0, 0.0, 0.0348)), scale)
    ring = trimesh.creation.annulus(0.02, 0.03, 0.005)
    ring.apply_translation((0.0, 0.0, 0.0135))
    written(folder, "ring", ring, scale)
    written(folder, "lid", box((0.03, 0.03, 0.004), (0.0, 0.0, 0.0618)), scale)
    return folder


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["import", *(str(each) for each in arguments)])


def refusal(result: Result) -> str:
    assert result.exit_code == 2, result.output
    assert result.stdout == "" and result.stderr.startswith("error: ") and result.stderr.count("\n") == 1
    return result.stderr


def test_what_is_near_floats_and_is_fixed(tmp_path: Path) -> None:
    found = import_product(bench(tmp_path / "in"), unit="m")
    names = [part.name for part in found.assembly.parts]
    pairs = {(names[p.first], names[p.second]): (p.gap, p.depth) for p in found.pairs}
    assert names == ["lid", "plate", "post", "ring"]
    assert [part.name for part in found.assembly.parts if part.fixed] == ["plate"]
    assert pairs["plate", "post"] == pytest.approx((0, 2e-4), abs=1e-9)
    assert pairs["plate", "ring"] == pytest.approx((1e-3, 0), abs=1e-9)
    assert pairs["lid", "post"] == pytest.approx((0, 0), abs=1e-9)
    assert set(pairs) == {("plate", "post"), ("plate", "ring"), ("lid", "post")}
    (floating,) = found.floating
    assert [names[i] for i in floating.parts] == ["ring"] and names[floating.carrier or 0] == "plate"
    assert floating.gap == pytest.approx(1e-3, abs=1e-9)
    assert found.assembly.parts[1].mass == pytest.approx(2700 * 1e-4)
    assert not import_product(tmp_path / "in", unit="m", contact_gap=1.1e-3).floating


@pytest.mark.parametrize(("unit", "scale"), [("mm", 1000.0), ("cm", 100.0), ("inch", 1 / 0.0254)])
def test_copies_in_other_units_are_the_same_product(tmp_path: Path, unit: str, scale: float) -> None:
    metres = import_product(bench(tmp_path / "m"), unit="m").assembly
    other = import_product(bench(tmp_path / unit, scale), unit=unit).assembly
    for a, b in zip(metres.parts, other.parts, strict=True):
        assert (a.name, a.fixed) == (b.name, b.fixed) and a.mass == pytest.approx(b.mass, rel=1e-6)
        assert np.abs(a.T_world_part - b.T_world_part).max() < 1e-9
        assert np.array_equal(a.shape.surface().triangles, b.shape.surface().triangles)
        assert np.abs(a.shape.surface().vertices - b.shape.surface().vertices).max() < 1.1e-9


@pytest.mark.parametrize(
    ("unit", "message"),
    [
        (None, "OBJ, STL and PLY files do not say their unit; give --unit mm, cm, m or inch"),
        ("foot", "--unit: unknown unit 'foot'; valid: m, cm, mm, inch"),
        ("m", "100 m long: wrong unit? At most 3 m is valid; see --unit"),
    ],
)
def test_units_are_asked_for(tmp_path: Path, unit: str | None, message: str) -> None:
    with pytest.raises(InputError, match=r".*") as error:
        import_product(bench(tmp_path / "in", 1000.0), unit=unit)
    assert str(error.value).endswith(message)
    with pytest.raises(InputError, match="mm long: wrong unit"):
        import_product(bench(tmp_path / "small", 0.01), unit="m")


def test_the_command_writes_a_product_that_can_be_moved(tmp_path: Path) -> None:
    source = bench(tmp_path / "in", 1000.0)
    out = tmp_path / "out"
    result = run(source, "--unit", "mm", "--fix", "pl*", "--fix", "post", "--allow-overlap", "post,plate", "--out", out)
    assert result.exit_code == 0, result.output
    assert "ring floats: ring is 1.000 mm off plate" in result.stderr
    out.rename(tmp_path / "elsewhere")
    product = load_assembly(tmp_path / "elsewhere" / "assembly.json")
    assert [part.name for part in product.parts if part.fixed] == ["plate", "post"]
    assert product.allowed_overlaps == (("post", "plate"),)
    data = json.loads(run(source, "--unit", "mm", "--out", tmp_path / "again", "--json").stdout)
    assert data["parts"][0]["size"] == [0.03, 0.03, 0.004] and data["floating"][0]["parts"] == ["ring"]
    assert {pair["finding"] for pair in data["pairs"]} == {"contact", "gap", "overlap"}


def test_what_stands_on_the_ground_beside_the_product_does_not_float(tmp_path: Path) -> None:
    written(bench(tmp_path / "in"), "lamp", box((0.02, 0.02, 0.1), (0.3, 0.0, 0.05)))
    result = run(tmp_path / "in", "--unit", "m", "--contact-gap", "2mm", "--out", tmp_path / "out")
    assert result.exit_code == 0 and result.stderr == ""


def test_the_example_of_the_document_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    bench(tmp_path / "parts", 1000.0)
    text = (Path(__file__).resolve().parents[1] / "docs" / "products.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    exec(compile(example, "products.md", "exec"), {})
    assert len(load_assembly(tmp_path / "product" / "assembly.json").parts) == 4


def test_no_part_of_a_name_is_said(tmp_path: Path) -> None:
    message = refusal(run(bench(tmp_path / "in"), "--unit", "m", "--fix", "bolt*", "--out", tmp_path / "out"))
    assert message == "error: --fix: no part is called 'bolt*'; there are: lid, plate, post, ring\n"
    assert not (tmp_path / "out").exists()


def test_open_and_wrongly_wound_surfaces_are_said(tmp_path: Path) -> None:
    bench(tmp_path)
    whole = box((0.02, 0.02, 0.02), (0.03, 0.03, 0.02))
    written(tmp_path, "turned", trimesh.Trimesh(whole.vertices, whole.faces[:, ::-1], process=False))
    whole.apply_translation((-0.06, 0, 0))
    written(tmp_path, "open", trimesh.Trimesh(whole.vertices, whole.faces[:-2], process=False))
    whole.apply_translation((0, -0.06, 0))
    mixed = np.array(whole.faces)
    mixed[3] = mixed[3, ::-1]
    written(tmp_path, "wound", trimesh.Trimesh(whole.vertices, mixed, process=False))
    soup = box((0.02, 0.02, 0.02), (0.03, -0.03, 0.02))
    corners = soup.vertices[soup.faces.ravel()]
    written(tmp_path, "soup", trimesh.Trimesh(corners, np.arange(36).reshape(-1, 3), process=False))
    found = import_product(tmp_path, unit="m")
    names = {part.name: i for i, part in enumerate(found.assembly.parts)}
    said = {name: found.remarks[i][0].split(":")[0] for name, i in names.items() if i in found.remarks}
    assert said == {
        "turned": "was inside out",
        "open": "open",
        "wound": "triangles were wound both ways",
    }
    for name in ("turned", "wound", "soup"):
        shape = found.assembly.parts[names[name]].shape
        assert isinstance(shape, Mesh) and shape.is_closed and len(shape.surface().vertices) == 8
        assert trimesh.Trimesh(shape.surface().vertices, shape.surface().triangles).volume == pytest.approx(8e-6)
    pair = next(
        p for p in found.pairs if names["open"] in (p.first, p.second) and names["plate"] in (p.first, p.second)
    )
    assert pair.gap == pytest.approx(0, abs=1e-9) and np.isnan(pair.depth)


def wedge() -> trimesh.Trimesh:
    """A body without any symmetry."""
    return trimesh.convex.convex_hull(
        np.array([[0, 0, 0], [0.05, 0, 0], [0, 0.03, 0], [0, 0, 0.02], [0.01, 0.02, 0.015]], dtype=float)
    )


def test_instances_share_a_shape_and_mirrored_ones_are_proper(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    body = wedge()
    turn = trimesh.transformations.rotation_matrix(0.7, (1, 2, 3), (0.01, 0.02, 0.03))
    mirror = trimesh.transformations.translation_matrix((0.1, 0.1, 0.0)) @ np.diag([1.0, -1.0, 1.0, 1.0])
    scene.add_geometry(body, node_name="Schraube ä", geom_name="a", transform=np.eye(4))
    for name, T in (("b", turn), ("c", mirror), ("d", turn @ mirror)):
        scene.graph.update(frame_to=name, matrix=T, geometry="a")
    (tmp_path / "a.glb").write_bytes(scene.export(file_type="glb"))
    product = import_product(tmp_path / "a.glb").assembly
    shapes = {part.name: part.shape for part in product.parts}
    assert shapes["Schraube-a"] is shapes["b"] and shapes["c"] is shapes["d"] and shapes["b"] is not shapes["c"]
    assert product.provenance["drawn_names"] == {"Schraube-a": "Schraube ä"}
    for part, T in zip(product.parts, (np.eye(4), turn, mirror, turn @ mirror), strict=True):
        assert np.linalg.det(part.T_world_part[:3, :3]) == pytest.approx(1)
        drawn = trimesh.transform_points(body.vertices, T)
        placed = part.shape.surface().moved(part.T_world_part).vertices
        gaps = np.linalg.norm(drawn[:, None] - placed[None], axis=2)
        assert max(gaps.min(axis=0).max(), gaps.min(axis=1).max()) < 1e-7
        assert trimesh.Trimesh(placed, part.shape.surface().triangles).volume == pytest.approx(body.volume, rel=1e-5)


def test_an_affine_place_is_a_proper_pose_after_a_map_of_the_shape() -> None:
    generator = np.random.default_rng(1)
    for _ in range(20):
        R = trimesh.transformations.random_rotation_matrix(generator.random(3))
        for linear in (np.eye(3), np.diag([1.0, 1, -1]), np.diag([2.0, 3, 4]), generator.normal(size=(3, 3))):
            T = R.copy()
            T[:3, :3] = R[:3, :3] @ linear
            placed, rest = split_map(T)
            assert np.abs(placed[:3, :3] @ rest - T[:3, :3]).max() < 1e-9
            assert np.linalg.det(placed[:3, :3]) == pytest.approx(1)


def test_names_are_mended_valid_and_unique() -> None:
    assert mended("Gehäuse".encode().decode("latin-1")) == "Gehäuse"
    assert mended("\\X2\\00C4\\X0\\rm") == "Ärm"
    assert mended("Gehäuse") == "Gehäuse"
    drawn = ["screw", "screw", "Screw", "screw-2", "", "螺丝", "Gehäuse Süd", "a" * 90, "a" * 90, "../../etc"]
    found = valid_names(drawn)
    assert found[:4] == ["screw", "screw-3", "Screw-4", "screw-2"]
    assert found[4:7] == ["part", "part-2", "Gehause-Sud"]
    assert len({name.lower() for name in found}) == len(found) and all(len(name) <= 64 for name in found)


@pytest.mark.skipif(not CASES.exists(), reason="the cases are not beside this checkout")
def test_a_step_file_gives_its_named_parts() -> None:
    pytest.importorskip("cascadio")
    found = import_product(CASES / "step_aero" / "AeroAssembly.step", deflection=2e-4)
    sides = ("BottomLeft", "TopLeft", "LandingGear")
    names = {f"{kind}_{side}" for kind in ("AeroFrame", "MirrorAeroFrame") for side in sides}
    assert {part.name for part in found.assembly.parts} == names | {"AeroFrame_Plate", "AeroFrame_Cap"}
    assert found.unit == "mm, as the file says"
    low, high = np.array([part.shape.surface().moved(part.T_world_part).bounds for part in found.assembly.parts]).T[0]
    assert 0.1 < high.max() - low.min() < 0.5


@pytest.mark.skipif(not CASES.exists(), reason="the cases are not beside this checkout")
@pytest.mark.parametrize("case", ["furniture_drawer", "asap_beam", "fabrica_plumbers_block"])
def test_pairs_are_as_far_apart_and_as_deep_as_others_measured(case: str) -> None:
    found = import_product(CASES / case, unit="m")
    names = [part.name for part in found.assembly.parts]
    pairs = {frozenset((names[p.first], names[p.second])): p for p in found.pairs}
    measured = [each for each in json.loads((CASES / case / "meta.json").read_text())["pairs"] if each["gap_mm"] < 5]
    assert measured
    for each in measured:
        pair = pairs[frozenset((each["a"], each["b"]))]
        assert 1e3 * pair.gap == pytest.approx(each["gap_mm"], abs=0.02)
        if each["overlap_mm3"] > 0 or not each["depth_mm"]:  # others call surfaces that coincide 0.2 mm deep
            assert -0.01 < 1e3 * pair.depth - each["depth_mm"] < 0.15  # they looked at corners, this between them too


TRIANGLE = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\n"


def damaged(folder: Path, kind: str) -> Path:
    """A broken input of a kind."""
    texts = {
        "nan.obj": "v 0 0 nan\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n",
        "range.obj": TRIANGLE + "f 1 2 9\n",
        "negative.obj": TRIANGLE + "f 1 2 -9\n",
        "nothing.obj": TRIANGLE,
        "words.obj": "v a b c\nf x y z\n",
        "broken.step": "ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\n#1 = CARTESIAN_POINT('',(0.,\n",
        "no.step": "solid of something else",
        "text.glb": "glTF is not this",
        "text.stl": "hello",
        "text.ply": "ply\nformat ascii 1.0\nelement vertex 99999999999\nend_header\n",
        "product.zip": "PK\x03\x04",
        "inside.obj": "PK\x03\x04 and so on",
        "flat.obj": TRIANGLE + "f 1 1 2\n",
    }
    path = folder / kind
    if kind in texts:
        path.write_text(texts[kind])
    elif kind == "huge.step" or kind == "huge.obj":
        with path.open("wb") as file:
            file.truncate(10 * 2**30)  # sparse
    elif kind == "million.stl":
        count = 1_000_000
        rows = np.zeros(count, dtype=[("n", "<f4", 3), ("t", "<f4", (3, 3)), ("a", "<u2")])
        rows["t"] = np.random.default_rng(0).random((count, 3, 3), dtype=np.float32)
        path.write_bytes(b"\0" * 80 + struct.pack("<I", count) + rows.tobytes())
    elif kind == "claims.stl":
        path.write_bytes(b"\0" * 80 + struct.pack("<I", 200_000_000) + b"\0" * 100)
    elif kind == "claims.glb":
        document = json.dumps(
            {
                "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
                "nodes": [{"mesh": 0}],
                "accessors": [{"bufferView": 0, "componentType": 5126, "count": 2**40, "type": "VEC3"}],
                "bufferViews": [{"buffer": 0, "byteLength": 2**45}],
                "buffers": [{"byteLength": 2**45}],
            }
        ).encode()
        document += b" " * (-len(document) % 4)
        chunk = struct.pack("<I4s", len(document), b"JSON") + document
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunk)) + chunk)
    elif kind == "circle.glb":
        document = json.dumps({"nodes": [{"children": [1]}, {"children": [0]}], "scenes": [{"nodes": [0]}]}).encode()
        document += b" " * (-len(document) % 4)
        chunk = struct.pack("<I4s", len(document), b"JSON") + document
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunk)) + chunk)
    elif kind == "empty":
        path.mkdir()
        (path / "notes.txt").write_text("no meshes")
    elif kind == "pipe.obj":
        os.mkfifo(path)
    return path


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("nan.obj", "nan: a corner is not a finite number"),
        ("range.obj", "range.obj"),
        ("negative.obj", "negative.obj"),
        ("nothing.obj", "nothing.obj: "),
        ("words.obj", "cannot be read as OBJ"),
        ("flat.obj", "flat: has no triangle with an area"),
        ("broken.step", "cannot be read as STEP: it is damaged, or holds no shapes"),
        ("no.step", "is not a STEP file: it does not start with ISO-10303-21"),
        ("text.glb", "cannot be read as GLB"),
        ("text.stl", "holds no triangles"),
        ("text.ply", "text.ply: "),
        ("product.zip", "ends in '.zip'; STEP, OBJ, STL, PLY or GLB is read"),
        ("inside.obj", "inside.obj: "),
        ("huge.step", "has 10240 MiB; at most 256 MiB are read"),
        ("huge.obj", "has 10240 MiB; at most 256 MiB are read"),
        ("million.stl", "million: 1000000 triangles; at most 200000 are allowed in one part"),
        ("claims.stl", "holds no triangles"),
        ("claims.glb", "cannot be read as GLB: its geometry ends early"),
        ("circle.glb", "cannot be read as GLB: its nodes go round in a circle, or are too many"),
        ("empty", "holds no file that ends in .step, .stp, .obj, .stl, .ply, .glb"),
        ("pipe.obj", "is not a regular file"),
        ("missing.step", "there is no such file"),
    ],
)
def test_broken_input_ends_in_one_line(tmp_path: Path, kind: str, message: str) -> None:
    if kind.endswith(".step"):
        pytest.importorskip("cascadio")
    path = damaged(tmp_path, kind)
    unit = [] if kind.endswith((".step", ".glb")) else ["--unit", "m"]
    assert message in refusal(run(path, *unit, "--out", tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_too_many_triangles_become_fewer_only_when_that_is_asked_for(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=7, radius=0.05)  # 327,680 triangles
    written(tmp_path / "in", "ball", ball)
    written(tmp_path / "in", "plate", box((0.1, 0.1, 0.01), (0.0, 0.0, -0.0552)))
    assert "--simplify" in refusal(run(tmp_path / "in", "--unit", "m", "--out", tmp_path / "out"))
    result = run(tmp_path / "in", "--unit", "m", "--simplify", "0.1mm", "--out", tmp_path / "out")
    assert result.exit_code == 0 and "ball: simplified from 327680 to" in result.stderr
    shape = load_assembly(tmp_path / "out" / "assembly.json").parts[0].shape
    assert isinstance(shape, Mesh) and shape.is_closed and len(shape.surface().triangles) < 20_000
    radii = np.linalg.norm(shape.surface().vertices, axis=1)
    assert np.abs(radii - 0.05).max() < 1.5e-4 and shape.volume() == pytest.approx(ball.volume, rel=0.01)


@pytest.mark.slow
@pytest.mark.skipif(not CASES.exists(), reason="the cases are not beside this checkout")
@pytest.mark.parametrize(("unit", "factor"), [("$,.METRE.", 0), (".CENTI.,.METRE.", 10.0)])
def test_the_unit_of_a_step_file_counts(tmp_path: Path, unit: str, factor: float) -> None:
    pytest.importorskip("cascadio")
    text = (CASES / "step_aero" / "AeroAssembly.step").read_text()
    (tmp_path / "a.step").write_text(text.replace(".MILLI.,.METRE.", unit))
    if not factor:
        with pytest.raises(InputError, match="m long: wrong unit"):
            import_product(tmp_path / "a.step", deflection=1e-2)
        return
    found = import_product(tmp_path / "a.step", deflection=2e-3)
    surfaces = [part.shape.surface().moved(part.T_world_part).bounds for part in found.assembly.parts]
    assert found.unit == "cm, as the file says" and np.ptp(np.array(surfaces), axis=(0, 1)).max() > 1.0
    replaced = import_product(tmp_path / "a.step", unit="mm", deflection=2e-3).assembly
    for a, b in zip(found.assembly.parts, replaced.parts, strict=True):
        assert np.abs(a.T_world_part[:3, 3] - 10 * b.T_world_part[:3, 3]).max() < 1e-6


def test_what_was_there_stays_when_an_import_fails(tmp_path: Path) -> None:
    assert run(bench(tmp_path / "in"), "--unit", "m", "--out", tmp_path / "out").exit_code == 0
    before: dict[Path, Any] = {file: file.read_bytes() for file in (tmp_path / "out").rglob("*") if file.is_file()}
    (tmp_path / "in" / "lid.obj").write_text("v 0 0 nan\nf 1 1 1\n")
    refusal(run(tmp_path / "in", "--unit", "m", "--out", tmp_path / "out"))
    assert {file: file.read_bytes() for file in (tmp_path / "out").rglob("*") if file.is_file()} == before


def test_a_tube_in_a_ring_is_as_deep_as_their_radii_say(tmp_path: Path) -> None:
    """All corners of what is in both lie on both surfaces; between them it is 1 mm thick."""
    written(tmp_path, "tube", trimesh.creation.annulus(0.003, 0.006, 0.02, sections=64))
    written(tmp_path, "ring", trimesh.creation.annulus(0.005, 0.010, 0.02, sections=64))
    (pair,) = import_product(tmp_path, unit="m").pairs
    assert pair.depth == pytest.approx(1e-3, abs=2e-5)


@pytest.mark.slow
@pytest.mark.skipif(not CASES.exists(), reason="the cases are not beside this checkout")
@pytest.mark.parametrize("case", ["furniture_drawer", "o2ac_wrs_assembly_2020"])
def test_pairs_are_as_the_fields_of_the_planner_have_them(case: str) -> None:
    """Two methods that share nothing: overlaps of solids by manifold3d, points in fields of signed distance."""
    from takeapart.collision.contact import Contacts

    found = import_product(CASES / case, unit="m")
    pairs = {(p.first, p.second): p for p in found.pairs}
    contacts = Contacts(found.assembly)
    findings = contacts.findings
    assert findings and {(f.first, f.second) for f in findings} == set(pairs)
    for each in findings:
        pair = pairs[each.first, each.second]
        assert pair.gap == pytest.approx(each.gap, abs=5e-5)
        if not np.isnan(pair.depth):
            assert -2e-5 < pair.depth - each.depth < 2e-4  # the planner's points stand 2 mm apart
            assert pair.depth == pytest.approx(contacts.depth(each), abs=2e-5)  # what it says


@pytest.mark.skipif(not CASES.exists(), reason="the cases are not beside this checkout")
def test_a_step_file_cut_anywhere_gives_a_product_or_one_line(tmp_path: Path) -> None:
    pytest.importorskip("cascadio")
    content = (CASES / "step_aero" / "AeroAssembly.step").read_bytes()
    for share in (0.001, 0.3, 0.9):
        (tmp_path / "cut.step").write_bytes(content[: int(share * len(content))])
        result = run(tmp_path / "cut.step", "--out", tmp_path / "out")
        assert result.exit_code == 0 or refusal(result)
