"""Meshes as they are drawn: the triangles of the mesh, sharp and smooth where they should be, in every picture."""

from __future__ import annotations

import base64
import colorsys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from browser import Opened, opened, wait_until
from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.model.assembly import Assembly, Part
from takeapart.model.geometry import Box, TriangleMesh, pose
from takeapart.model.meshes import Mesh
from takeapart.page.standalone import document, page
from takeapart.show.facts import PartFacts
from takeapart.show.scene import FIXED, PlanScene, colors_of, role_of
from takeapart.show.surfaces import MOST_DRAWN, MOST_TOGETHER, Surface, creased, drawn_surface, most_drawn
from takeapart.show.view import View, view_of

WIDTH, HEIGHT = 1200, 700


def mesh_of(made: Any) -> Mesh:
    return Mesh(TriangleMesh(np.asarray(made.vertices, dtype=float), np.asarray(made.faces, dtype=np.int32)))


def ring() -> Mesh:
    """Upright, its axis along x."""
    turn = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0])
    return mesh_of(trimesh.creation.annulus(0.03, 0.06, 0.03, sections=48, transform=turn))


def product() -> Assembly:
    plate = Part("plate", mesh_of(trimesh.creation.box((0.3, 0.3, 0.02))), pose((0.4, 0.0, 0.01)), 1.0, True)
    shared = ring()
    return Assembly(
        "rings",
        (
            plate,
            Part("part1", shared, pose((0.36, -0.05, 0.08)), 0.1),
            Part("part2", shared, pose((0.46, 0.07, 0.08)), 0.1),
            Part("part3", mesh_of(trimesh.creation.icosphere(2, 0.03)), pose((0.32, 0.08, 0.05)), 0.1),
            Part("part4", Box((0.04, 0.02, 0.06)), pose((0.45, -0.1, 0.05)), 0.1),
        ),
    )


def scene_of(assembly: Assembly) -> PlanScene:
    return PlanScene(assembly, load_workcell("panda"))


def facts_of(assembly: Assembly) -> list[PartFacts]:
    """Without what a planner would have to work out."""
    return [PartFacts(part.name, role_of(part), (0.1, 0.1, 0.1), part.mass) for part in assembly.parts]


def hash_of(part: Part) -> str:
    assert isinstance(part.shape, Mesh)
    return part.shape.hash


def triangles_of(vertices: np.ndarray, faces: np.ndarray) -> list[tuple[float, ...]]:
    """All triangles by their corners, whatever the corners are called and whichever comes first."""
    corners = np.asarray(vertices, dtype=np.float32)[np.asarray(faces)].reshape(-1, 9).tolist()
    return sorted(min((*c,), (*c[3:], *c[:3]), (*c[6:], *c[:6])) for c in corners)


# ---- surfaces


@pytest.mark.parametrize("made", [trimesh.creation.box((0.1, 0.2, 0.3)), trimesh.creation.icosphere(3, 0.05)])
def test_every_triangle_is_drawn_as_it_is(made: Any) -> None:
    surface = drawn_surface(np.asarray(made.vertices), np.asarray(made.faces))
    assert triangles_of(surface.vertices, surface.faces) == triangles_of(made.vertices, made.faces)
    assert (surface.triangles, surface.is_simplified) == (len(made.faces), False)


def test_edges_are_sharp_and_curved_surfaces_smooth() -> None:
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    vertices, normals, faces = creased(np.asarray(box.vertices), np.asarray(box.faces))
    assert len(vertices) == 24  # a corner for each of its three sides
    assert np.allclose(normals[faces[:, 0]], box.face_normals, atol=1e-6)
    ball = trimesh.creation.icosphere(3, 0.05)
    vertices, normals, faces = creased(np.asarray(ball.vertices), np.asarray(ball.faces))
    assert len(vertices) == len(ball.vertices)
    assert np.allclose(normals, vertices / 0.05, atol=0.02)
    rod = trimesh.creation.cylinder(0.01, 0.1, sections=32)
    vertices, normals, faces = creased(np.asarray(rod.vertices), np.asarray(rod.faces))
    level = np.abs(normals[:, 2]) < 0.5
    assert np.allclose(np.abs(normals[~level][:, 2]), 1)
    radial = vertices[level][:, :2] / np.linalg.norm(vertices[level][:, :2], axis=1, keepdims=True)
    assert np.allclose(normals[level][:, :2], radial, atol=0.02)
    # That of a rim is one of both sides, not a mean of them; so the rims are there twice.
    assert level.sum() == 64 and len(vertices) == 64 + 64 + 2


def test_triangles_that_share_no_vertices_are_as_smooth_as_those_that_do() -> None:
    ball = trimesh.creation.icosphere(2, 0.05)
    loose = np.asarray(ball.triangles).reshape(-1, 3)
    vertices, _, _ = creased(loose, np.arange(len(loose)).reshape(-1, 3))
    assert len(vertices) == len(ball.vertices)


def test_triangles_without_area_spoil_no_normal() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [1, 0, 0]]) * 0.1
    _, normals, faces = creased(vertices, np.array([[0, 1, 2], [0, 1, 3], [1, 4, 2]]))
    assert np.allclose(normals[faces[0]], [0, 0, 1])
    vertices[3] = (0.2, 0, 1e-9)  # as thin as rounding, and upright
    _, normals, faces = creased(vertices, np.array([[0, 1, 2], [0, 1, 3]]))
    assert np.allclose(normals[faces[0]], [0, 0, 1])
    assert np.allclose(normals[faces[1, :2]], [0, 0, 1])


def test_a_fan_of_thousands_of_triangles_is_drawn_flat_around_its_tip() -> None:
    cone = trimesh.creation.cone(0.05, 0.05, sections=3000)
    _, normals, faces = creased(np.asarray(cone.vertices), np.asarray(cone.faces))
    assert len(faces) == len(cone.faces)
    assert np.isfinite(normals).all()
    assert np.allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)


def test_a_shape_of_too_many_triangles_is_drawn_with_fewer_close_to_it() -> None:
    ball = trimesh.creation.icosphere(5, 0.05)  # 20,480 triangles
    surface = drawn_surface(np.asarray(ball.vertices), np.asarray(ball.faces), 5000)
    assert 2500 < len(surface.faces) <= 5000
    assert surface.is_simplified and surface.triangles == len(ball.faces)
    away = np.abs(np.linalg.norm(surface.vertices, axis=1) - 0.05)
    assert away.max() < 0.001
    outwards = surface.vertices / np.linalg.norm(surface.vertices, axis=1, keepdims=True)
    agreement = np.einsum("ij,ij->i", surface.normals, outwards)
    assert np.percentile(agreement, 2) > 0.97 and agreement.min() > -0.01  # folds between cells stand upright


@pytest.mark.parametrize(
    "counts", [[12], [200_000], [MOST_DRAWN], [50_000] * 20, [12] * 50, [200_000] * 40, [100, 55_000, 59_000] * 5]
)
def test_neither_a_shape_nor_all_together_have_too_many_triangles(counts: Sequence[int]) -> None:
    most = most_drawn({str(number): count for number, count in enumerate(counts)})
    drawn = [min(count, most) for count in counts]
    assert max(drawn) <= MOST_DRAWN and sum(drawn) <= MOST_TOGETHER
    # More would be too many, or all are drawn whole.
    assert drawn == list(counts) or most == MOST_DRAWN or sum(min(c, most + 1) for c in counts) > MOST_TOGETHER


# ---- colours


def test_parts_whose_names_tell_nothing_have_colours_by_their_shapes() -> None:
    plate, first, second, ball, box = colors_of(product())
    assert plate == FIXED
    assert first == second
    assert len({first, ball, box, plate}) == 4


def test_equal_parts_with_one_word_are_told_apart() -> None:
    shape = mesh_of(trimesh.creation.box((0.1, 0.05, 0.05)))
    parts = tuple(Part(f"brick{k}", shape, pose((0, 0, 0.05 * k)), 0.1, k == 0) for k in range(4))
    assert len(set(colors_of(Assembly("wall", parts)))) == 4


def test_parts_whose_names_tell_what_they_are_for_have_the_colour_of_the_word() -> None:
    pump = load_assembly(data_path("products/pump/assembly.json"))
    by_name = dict(zip((part.name for part in pump.parts), colors_of(pump), strict=True))
    assert len({by_name[f"screw-{k}"] for k in (1, 2, 3, 4)}) == 1
    assert len({by_name[name] for name in ("body", "screw-1", "cover", "coupling", "drive-gear", "outlet")}) == 6


# ---- the page


def unpacked(shape: dict[str, Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, normals and faces of a shape as the page's data hold it."""
    points = np.frombuffer(base64.b64decode(shape["positions"]), "<u2").reshape(-1, 3) / 65535
    normals = np.frombuffer(base64.b64decode(shape["normals"]), "i1").reshape(-1, 3) / 127
    faces = np.frombuffer(base64.b64decode(shape["faces"]), "<u4" if shape["wide"] else "<u2").reshape(-1, 3)
    return np.array(shape["low"]) + points * np.array(shape["size"]), normals, faces


def test_a_page_holds_equal_shapes_once_and_every_triangle() -> None:
    assembly = product()
    scene = scene_of(assembly)
    data = document(scene, facts_of(assembly))
    assert [part["shape"] for part in data["parts"]] == [0, 1, 1, 2, None]
    assert [len(part["boxes"]) for part in data["parts"]] == [0, 0, 0, 0, 1]
    for part, told in zip(assembly.parts, data["parts"], strict=True):
        if told["shape"] is None:
            continue
        vertices, normals, faces = unpacked(data["shapes"][told["shape"]])
        surface = part.shape.surface()
        drawn = trimesh.Trimesh(vertices, faces, process=False)
        assert len(faces) == len(surface.triangles)
        assert np.allclose([vertices.min(axis=0), vertices.max(axis=0)], surface.bounds, atol=2e-6)
        assert drawn.volume == pytest.approx(part.shape.volume(), rel=1e-3)
        assert (np.einsum("ij,ij->i", normals[faces[:, 0]], drawn.face_normals) > 0.7).all()


def test_a_large_shape_has_faces_of_four_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    vertices = rng.uniform(-0.05, 0.05, (70_000, 3))  # nobody's neighbour: as many vertices as there are
    faces = np.arange(69_999).reshape(-1, 3)
    surface = Surface(*creased(vertices, faces), len(faces))
    assembly = product()
    scene = scene_of(assembly)
    scene.surfaces[hash_of(assembly.parts[3])] = surface
    shape = document(scene, facts_of(assembly))["shapes"][2]
    assert shape["wide"] is True
    found, _, corners = unpacked(shape)
    assert np.allclose(found[corners], vertices[faces], atol=2e-6)


def test_a_page_says_how_much_simpler_a_shape_is_drawn(tmp_path: Path) -> None:
    assembly = product()
    scene = scene_of(assembly)
    ball = trimesh.creation.icosphere(4, 0.03)
    name = hash_of(assembly.parts[3])
    scene.surfaces[name] = drawn_surface(np.asarray(ball.vertices), np.asarray(ball.faces), 1000)
    out = tmp_path / "page.html"
    out.write_text(page(scene, facts_of(assembly)))
    with opened(out.as_uri(), 900, 640, offline=True) as found:
        wait_until(found.page, "window.takeapart && window.takeapart.firstPicture > 0")
        found.page.evaluate("takeapart.player.choose(3)")
        drawn = len(scene.surfaces[name].faces)
        assert f"{drawn} of 5120 triangles" in found.page.locator("#picked").inner_text()
        found.page.evaluate("takeapart.player.choose(1)")
        assert "triangles" not in found.page.locator("#picked").inner_text()
        assert found.errors == []


UPLOADED = """i => { const p = takeapart.player, gl = p.painter.gl, T = p.models[i];
  return p.parts[i].map(({ shape }) => {
    gl.bindVertexArray(shape.array);
    const corners = new (shape.kind === gl.UNSIGNED_INT ? Uint32Array : Uint16Array)(shape.count);
    gl.getBufferSubData(gl.ELEMENT_ARRAY_BUFFER, 0, corners);
    const kind = gl.getVertexAttrib(0, gl.VERTEX_ATTRIB_ARRAY_TYPE) === gl.UNSIGNED_SHORT ? Uint16Array : Float32Array;
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.getVertexAttrib(0, gl.VERTEX_ATTRIB_ARRAY_BUFFER_BINDING));
    const points = new kind(gl.getBufferParameter(gl.ARRAY_BUFFER, gl.BUFFER_SIZE) / kind.BYTES_PER_ELEMENT);
    gl.getBufferSubData(gl.ARRAY_BUFFER, 0, points);
    gl.bindVertexArray(null);
    const scale = kind === Uint16Array ? 65535 : 1, low = [1, 1, 1].map(() => Infinity), high = low.map(x => -x);
    for (const c of corners) for (let a = 0; a < 3; a++) {
      const v = [0, 1, 2].map(b => shape.low[b] + shape.size[b] * points[3 * c + b] / scale);
      const w = T[4 * a] * v[0] + T[4 * a + 1] * v[1] + T[4 * a + 2] * v[2] + T[4 * a + 3];
      low[a] = Math.min(low[a], w); high[a] = Math.max(high[a], w);
    }
    return { triangles: corners.length / 3, low, high };
  }); }"""


def colour_shares(image: np.ndarray, color: str) -> np.ndarray:
    """Which pixels (H, W) have the hue of a colour."""
    red, green, blue = (int(color[k : k + 2], 16) / 255 for k in (1, 3, 5))
    wanted = colorsys.rgb_to_hsv(red, green, blue)[0]
    values = image.astype(float) / 255
    high, low = values.max(axis=2), values.min(axis=2)
    spread = np.maximum(high - low, 1e-9)
    r, g, b = np.moveaxis(values, 2, 0)
    hue = np.where(high == r, (g - b) / spread % 6, np.where(high == g, (b - r) / spread + 2, (r - g) / spread + 4)) / 6
    apart = np.abs(hue - wanted)
    return (np.minimum(apart, 1 - apart) < 0.02) & (spread > 0.12)


def test_the_page_draws_the_triangles_of_the_mesh_where_pictures_do(tmp_path: Path) -> None:
    from takeapart.pictures.model import RenderOptions
    from takeapart.pictures.renderer import NoGraphicsError, Renderer

    assembly = product()
    scene = scene_of(assembly)
    out = tmp_path / "page.html"
    out.write_text(page(scene, facts_of(assembly)))
    seen = view_of(scene)
    near = View(np.array([0.4, 0.0, 0.06]), seen.direction, 0.7, seen.field)
    with opened(out.as_uri(), WIDTH, HEIGHT, offline=True) as found:
        wait_until(found.page, "window.takeapart && window.takeapart.firstPicture > 0")
        for i, part in enumerate(assembly.parts):
            (uploaded,) = found.page.evaluate(UPLOADED, i)
            surface = part.shape.surface().moved(part.T_world_part)
            assert uploaded["triangles"] == len(surface.triangles), part.name
            assert np.allclose([uploaded["low"], uploaded["high"]], surface.bounds, atol=5e-6), part.name
        _look(found, near)
        image = found.picture()
        found.keep("page-meshes.png")
        # A click through the hole of a ring meets what is behind it, one beside the hole the ring.
        picked = [_picked(found, point) for point in ([0.36, -0.05, 0.08], [0.36, -0.05, 0.125])]
        assert found.errors == []
    assert picked[1] == "part1" and picked[0] != "part1"
    options = RenderOptions(image.shape[1], image.shape[0])
    try:
        with Renderer(scene, options, near) as renderer:
            other = renderer.picture()
    except NoGraphicsError as missing:
        pytest.skip(str(missing))
    for i, part in enumerate(assembly.parts):
        if part.fixed:
            continue
        mine, its = (colour_shares(each, scene.colors[i]) for each in (image, other))
        assert its.sum() > 500, part.name
        assert (mine & its).sum() > 0.9 * (mine | its).sum(), part.name


def _look(found: Opened, view: View) -> None:
    """Puts the page's camera where a view is."""
    found.page.evaluate(
        "([t, d]) => { const p = takeapart.player; p.orbit.target = t; p.orbit.distance = d; p.draw(); }",
        [view.target.tolist(), view.distance],
    )
    found.page.wait_for_timeout(700)


def _picked(found: Opened, point: Sequence[float]) -> str:
    """Name of the part that a click on a point of the world, m, meets; empty for none."""
    x, y = found.page.evaluate(
        "p => { const o = takeapart.player.orbit, c = o.canvas, m = o.matrix, v = [...p, 1];"
        "const r = [0, 1, 2, 3].map(i => v.reduce((s, x, j) => s + m[4 * i + j] * x, 0));"
        "return [(r[0] / r[3] + 1) / 2 * c.clientWidth, (1 - r[1] / r[3]) / 2 * c.clientHeight]; }",
        list(point),
    )
    found.page.evaluate("([x, y]) => takeapart.player.pick(x, y)", [x, y])
    number = found.page.evaluate("takeapart.player.picked")
    return "" if number is None else str(found.page.evaluate(f"takeapart.player.data.parts[{number}].name"))
