"""Boxes around meshes hold every point of them, stay as near as they say, and follow the form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from takeapart.model.bounding import tight_box
from takeapart.model.covering import cover_of
from takeapart.model.geometry import Array, Box, OrientedBox, TriangleMesh, pose, rotation_from_quaternion
from takeapart.model.meshes import Mesh


def surface_of(body: trimesh.Trimesh, T: Array | None = None) -> TriangleMesh:
    body = body.copy()
    if T is not None:
        body.apply_transform(T)
    return TriangleMesh(np.array(body.vertices, dtype=float), np.array(body.faces, dtype=np.int32))


def is_held(boxes: tuple[OrientedBox, ...], points: Array) -> Array:
    """(N,) whether points (N, 3) are in one of the boxes."""
    held = np.zeros(len(points), dtype=bool)
    for box in boxes:
        local = (points - box.T_frame_box[:3, 3]) @ box.T_frame_box[:3, :3]
        held |= (np.abs(local) <= box.half_extents + 1e-9).all(axis=1)
    return held


def l_bracket() -> trimesh.Trimesh:
    return trimesh.creation.extrude_polygon(
        trimesh.path.polygons.Polygon([(0, 0), (0.08, 0), (0.08, 0.01), (0.01, 0.01), (0.01, 0.06), (0, 0.06)]), 0.03
    )


TURNED = pose((0.3, -0.1, 0.7), (0.8, 0.3, -0.4, 0.2))
BODIES = {
    "ring": trimesh.creation.annulus(0.02, 0.03, 0.02),
    "washer": trimesh.creation.annulus(0.0032, 0.006, 0.0016),
    "ball": trimesh.creation.icosphere(3, 0.03),
    "shaft": trimesh.creation.cylinder(0.008, 0.12, sections=48),
    "bracket": l_bracket(),
    "cone": trimesh.creation.cone(0.03, 0.06),
}


@pytest.mark.parametrize("name", BODIES)
def test_every_point_of_a_body_is_in_a_box_and_no_box_reaches_farther_than_said(name: str) -> None:
    body = BODIES[name].copy()
    body.apply_transform(TURNED)
    cover = cover_of(surface_of(body))
    points = np.vstack([body.sample(4000, seed=1), body.vertices, trimesh.sample.volume_mesh(body, 2000)])
    assert is_held(cover.boxes, points).all()
    ends = np.vstack([box.corners() for box in cover.boxes])
    outside = -trimesh.proximity.ProximityQuery(body).signed_distance(ends)
    assert outside.max() <= cover.error + 1e-6
    size = float(2 * tight_box(surface_of(body)).half_extents.max())
    if name in ("bracket", "shaft", "washer", "ring"):
        assert len(cover.boxes) <= 48
        assert outside.max() <= max(0.002, 0.015 * size)
    else:  # no box lies along what is round: many, and not as near
        assert len(cover.boxes) <= 96
        assert outside.max() <= 0.12 * size


def test_a_mesh_that_is_a_box_is_that_box() -> None:
    box = Box((0.3, 0.02, 0.05))
    (found,) = Mesh(box.surface()).boxes()
    assert np.array_equal(found.T_frame_box, np.eye(4))
    assert found.half_extents == pytest.approx([0.15, 0.01, 0.025], abs=1e-15)
    (turned,) = Mesh(box.surface().moved(TURNED)).boxes()
    assert sorted(turned.half_extents) == pytest.approx([0.01, 0.025, 0.15], abs=1e-12)
    cuts = trimesh.creation.box((0.3, 0.02, 0.05)).subdivide()
    assert len(Mesh(surface_of(cuts, TURNED)).boxes()) == 1


def test_what_is_made_of_boxes_is_told_by_them_exactly() -> None:
    cover = cover_of(surface_of(l_bracket(), TURNED))
    assert len(cover.boxes) == 2
    assert sum(8 * box.half_extents.prod() for box in cover.boxes) == pytest.approx(
        l_bracket().volume + 0.01 * 0.01 * 0.03, rel=0.2
    )


@pytest.mark.parametrize("sections", [24, 61, 200])
def test_a_shaft_of_six_tenths_of_a_bore_passes_a_ring(sections: int) -> None:
    ring = trimesh.creation.annulus(0.02, 0.032, 0.02, sections=sections)
    boxes = cover_of(surface_of(ring, TURNED)).boxes
    angles = np.linspace(0, 2 * np.pi, 200)
    for radius in np.linspace(0, 0.012, 5):
        shaft = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.zeros(200)])
        assert not is_held(boxes, shaft @ TURNED[:3, :3].T + TURNED[:3, 3]).any()


def test_a_hollow_and_what_is_open_keep_their_walls() -> None:
    outer, inner = trimesh.creation.box((0.1, 0.1, 0.1)), trimesh.creation.box((0.08, 0.08, 0.08))
    inner.invert()
    hollow = trimesh.Trimesh(
        np.vstack([outer.vertices, inner.vertices]), np.vstack([outer.faces, inner.faces + 8]), process=False
    )
    boxes = cover_of(surface_of(hollow)).boxes
    assert not is_held(boxes, np.zeros((1, 3))).any()
    assert is_held(boxes, hollow.sample(2000)).all()
    solid = trimesh.creation.icosphere(3, 0.03)
    opened = trimesh.Trimesh(solid.vertices, solid.faces[5:], process=False)
    held = is_held(cover_of(surface_of(opened)).boxes, trimesh.sample.volume_mesh(solid, 2000) * 0.98)
    assert held.mean() > 0.99


def test_boxes_do_not_depend_on_how_a_product_is_turned() -> None:
    for body in (BODIES["bracket"], BODIES["ring"]):
        plain, turned = cover_of(surface_of(body)), cover_of(surface_of(body, TURNED))
        assert len(turned.boxes) == pytest.approx(len(plain.boxes), abs=6)
        volumes = [sum(8 * box.half_extents.prod() for box in cover.boxes) for cover in (plain, turned)]
        assert volumes[1] == pytest.approx(volumes[0], rel=0.1)


@pytest.mark.parametrize("sections", [12, 32, 33, 100])
def test_a_tight_box_lies_along_a_cylinder(sections: int) -> None:
    T = pose((0.1, 0.2, 0.3), (0.3, -0.7, 0.2, 0.5))
    box = tight_box(surface_of(trimesh.creation.cylinder(0.02, 0.05, sections=sections), T))
    along = np.abs(T[:3, 2] @ box.T_frame_box[:3, :3])
    assert along.max() == pytest.approx(1, abs=1e-9)
    assert box.half_extents[int(along.argmax())] == pytest.approx(0.025, abs=1e-9)


def test_a_tight_box_is_near_the_smallest() -> None:
    rng = np.random.default_rng(4)
    for _ in range(5):
        points = rng.normal(size=(40, 3)) * [0.1, 0.05, 0.02]
        hull = trimesh.convex.convex_hull(points @ rotation_from_quaternion(rng.normal(size=4)).T)
        box = tight_box(surface_of(hull))
        assert is_held((box,), np.asarray(hull.vertices)).all()
        assert 8 * box.half_extents.prod() <= 1.1 * np.prod(trimesh.bounds.oriented_bounds(hull)[1])


CASES = Path(__file__).resolve().parents[2] / "shared" / "cases"


@pytest.mark.parametrize("case", ["fabrica_plumbers_block", "fabrica_duct"])
def test_parts_that_others_drew_are_in_their_boxes(case: str) -> None:
    files = sorted((CASES / case).glob("*.obj"))[:3]
    if not files:
        pytest.skip(f"{CASES / case} is not there")
    for file in files:
        body = trimesh.load_mesh(file)
        surface = surface_of(body)
        cover = cover_of(surface)
        assert (
            is_held(cover.boxes, body.sample(3000, seed=3)).all()
            and is_held(cover.boxes, np.asarray(body.vertices)).all()
        )
        assert len(cover.boxes) <= 96
        assert is_held((tight_box(surface),), np.vstack([box.corners() for box in cover.boxes])).all()  # none is round
