"""The judge on a scene with connectors whose boxes become meshes: its plan holds, and what cuts into triangles is
refused."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from takeapart.formats.serialization import workcell_hash
from takeapart.model.assembly import Assembly, Part
from takeapart.model.geometry import Box, TriangleMesh, pose
from takeapart.model.meshes import Mesh
from takeapart.model.plan import Plan
from takeapart.verification import VerificationReport, verify_plan
from takeapart.verification.checks import straight_line_bound
from takeapart.verification.solids import Solid, solid_distance
from verification_scene import scene_assembly, scene_plan, scene_workcell

HASHES = {"workcell": workcell_hash(scene_workcell())}


def as_mesh(part: Part) -> Part:
    return replace(part, shape=Mesh(part.shape.surface()))


@functools.cache
def mesh_scene() -> Assembly:
    boxes = scene_assembly()
    return replace(boxes, parts=tuple(map(as_mesh, boxes.parts)))


def mesh_plan(assembly: Assembly) -> Plan:
    return replace(scene_plan(), straight_line_bound=straight_line_bound(assembly, scene_workcell()))


def judged(assembly: Assembly, plan: Plan | None = None) -> VerificationReport:
    return verify_plan(plan or mesh_plan(assembly), assembly, scene_workcell(), hashes=HASHES)


def with_part(assembly: Assembly, name: str, **changes: object) -> Assembly:
    parts = tuple(replace(p, **changes) if p.name == name else p for p in assembly.parts)  # type: ignore[arg-type]
    return replace(assembly, parts=parts)


def solid(size: float) -> Solid:
    return Solid(Box((size, size, size)).surface())


@pytest.mark.parametrize("gap", [-6e-4, -1e-4, 2e-4, 0.01])
def test_separation_of_cubes(gap: float) -> None:
    found = solid_distance(solid(0.02), pose([0.02 + gap, 0.0, 0.0]), solid(0.02), pose())
    assert found == pytest.approx(gap, rel=0.05)


def test_a_body_inside_another_is_deep() -> None:
    assert solid_distance(solid(0.002), pose(), solid(0.02), pose()) < -6e-4


def test_a_plan_of_boxes_holds_for_meshes() -> None:
    boxes, meshes = verify_plan(scene_plan(), scene_assembly(), scene_workcell()), judged(mesh_scene())
    assert boxes.passed
    assert meshes.findings == ()
    assert meshes.configurations == boxes.configurations
    assert meshes.smallest_clearance is not None and boxes.smallest_clearance is not None
    assert meshes.smallest_clearance.distance == pytest.approx(boxes.smallest_clearance.distance, abs=5e-5)
    assert meshes.states == boxes.states


def test_what_stands_in_the_way_is_hit() -> None:
    """A mesh in the way of the held beam, and of the hand."""
    lid = Part("lid", Mesh(Box((0.02, 0.02, 0.02)).surface()), pose([0.10, 0.10, 0.25]), 0.1, True)
    found = judged(replace(mesh_scene(), parts=(*mesh_scene().parts, lid)))
    hits = [f.message for f in found.findings if f.check == "collision"]
    assert any("held/beam hits part/lid" in message for message in hits)
    hood = replace(lid, name="hood", T_world_part=pose([0.025, 0.0, 0.30]))
    found = judged(replace(mesh_scene(), parts=(*mesh_scene().parts, hood)))
    assert any("panda_hand" in f.message and "part/hood" in f.message for f in found.findings)


def test_pads_must_lie_on_the_mesh() -> None:
    slim = Mesh(Box((0.018, 0.299, 0.02)).surface())
    found = judged(with_part(mesh_scene(), "beam", shape=slim))
    assert {f.check for f in found.findings if f.part == "beam"} >= {"finger_contact"}
    wide = Mesh(Box((0.0214, 0.299, 0.02)).surface())
    found = judged(with_part(mesh_scene(), "beam", shape=wide))
    assert any("cuts into" in f.message for f in found.findings if f.part == "beam")


def test_overlap_as_drawn_beyond_the_limit_is_named() -> None:
    sunk = Part("sunk", Mesh(Box((0.05, 0.02, 0.02)).surface()), pose([0.12, 0.44, 0.1094]), 0.1, True)
    crowded = replace(mesh_scene(), parts=(*mesh_scene().parts, sunk))
    crowded = replace(
        crowded,
        parts=tuple(p for p in crowded.parts if p.name != "loose")
        + (replace(crowded.parts[crowded.index["loose"]], T_world_part=pose([0.12, 0.40, 0.13])),),
    )
    found = judged(crowded)
    assert any("is drawn in" in f.message and "block" in f.message for f in found.findings)
    meant = replace(crowded, allowed_overlaps=(("block", "sunk"),))
    assert not any("is drawn in" in f.message for f in judged(meant).findings)


def test_open_meshes_are_judged_by_where_they_cross() -> None:
    surface = Box((0.02, 0.02, 0.22)).surface()
    opened = Mesh(TriangleMesh(surface.vertices, surface.triangles[2:]))
    found = judged(with_part(mesh_scene(), "left", shape=opened))
    assert "left" in " ".join(found.not_checked)
    lid = Part("lid", opened, pose([0.10, 0.10, 0.25]), 0.1, True)
    found = judged(replace(mesh_scene(), parts=(*mesh_scene().parts, lid)))
    assert any("part/lid" in f.message for f in found.findings)
    assert np.isfinite([f.depth for f in found.findings]).all()


def test_a_plan_whose_hashes_are_of_other_meshes_is_refused() -> None:
    found = verify_plan(
        mesh_plan(mesh_scene()), mesh_scene(), scene_workcell(), hashes={**HASHES, "assembly": "0" * 64}
    )
    assert "hash" in {f.check for f in found.findings}
