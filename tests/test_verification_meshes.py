"""The judge on products of meshes: a bar on a block, as boxes and as triangles, with notches, holes and open sides. The
joint paths are straight lines by the inverse kinematics library; what is true is known from the drawing."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import manifold3d
import numpy as np
import pytest
from ssik.prebuilt import franka_panda_ik

from takeapart.formats.serialization import assembly_hash, workcell_hash
from takeapart.model.assembly import Assembly, Joint, Part
from takeapart.model.geometry import Array, Box, Shape, TriangleMesh, pose, quaternion_from_rotation
from takeapart.model.meshes import Mesh
from takeapart.model.plan import Grasp, Plan, PlanStep
from takeapart.removal.grasps import volume_bound
from takeapart.verification import VerificationReport, format_finding, stand_under_gravity, verify_plan
from takeapart.verification.checks import straight_line_bound
from takeapart.verification.physics import pieces_of, unjudged_parts
from takeapart.verification.solids import Solid, crossing_depth, solid_distance
from verification_scene import DOWNWARDS, flange_target, line_path, scene_workcell, tool_rows

CENTER = np.array([0.12, 0.40, 0.11])  # of the bar
BAR, BLOCK = (0.02, 0.16, 0.02), (0.1, 0.1, 0.1)
GRASP = CENTER + [0.0, 0.0, 0.005]


def cuboid(size: tuple[float, ...], at: tuple[float, ...] = (0.0, 0.0, 0.0)) -> manifold3d.Manifold:
    return manifold3d.Manifold.cube(size, True).translate(at)


def mesh_of(solid: manifold3d.Manifold) -> Mesh:
    found = solid.to_mesh64()
    return Mesh(TriangleMesh(np.asarray(found.vert_properties[:, :3]), np.asarray(found.tri_verts, dtype=np.int32)))


def as_mesh(shape: Box) -> Mesh:
    return Mesh(shape.surface())


NOTCHED = cuboid(BAR) - cuboid((0.004, 0.04, 0.03), (0.01, 0.0, 0.0)) - cuboid((0.004, 0.04, 0.03), (-0.01, 0.0, 0.0))
L_SHAPE = cuboid((0.1, 0.02, 0.02)) + cuboid((0.02, 0.02, 0.08), (0.04, 0.0, 0.03))


def product(bar: Shape, block: Shape, *further: Part, **options: object) -> Assembly:
    parts = (
        Part("block", block, pose([0.12, 0.40, 0.05]), 1.0, True),
        Part("bar", bar, pose(CENTER), 0.1),
        *further,
    )
    return Assembly("bar-on-block", parts, **options)  # type: ignore[arg-type]


@functools.cache
def motion(width: float, corners: tuple[tuple[float, ...], ...]) -> PlanStep:
    """The bar along straight lines through corners, relative to the grasp, then up and to the goal."""
    base, rotation, goal = scene_workcell().T_world_base, DOWNWARDS["y"], scene_workcell().goal
    above = [GRASP + [0.0, 0.0, 0.31], goal]
    points = [GRASP, *(GRASP + np.array(corner) for corner in corners), *above]
    branches = franka_panda_ik.solve(flange_target(GRASP, rotation, base), q_seed=scene_workcell().home)
    joints = line_path(points, rotation, base, np.asarray(branches[0].q, dtype=float))
    tools = tool_rows(joints, base)
    length = float(np.linalg.norm(np.diff(tools[:, :3], axis=0), axis=1).sum())
    return PlanStep("bar", Grasp(GRASP, quaternion_from_rotation(rotation), width), joints, tools, length)


def judged(
    assembly: Assembly, *corners: tuple[float, ...], width: float = 0.02, physics: bool = False
) -> VerificationReport:
    """The verdict on a plan that takes the bar off."""
    step = motion(width, corners)
    plan = Plan(
        steps=(step,),
        total_length=step.length,
        straight_line_bound=straight_line_bound(assembly, scene_workcell()),
        sequence_bound=None,
        counts={},
        seconds=0.0,
        seed=0,
        search={},
        hashes={"assembly": assembly_hash(assembly), "workcell": workcell_hash(scene_workcell())},
        versions={},
        assembly=assembly.name,
        workcell="scene",
        robot="panda",
        joints=tuple(f"panda_joint{i}" for i in range(1, 8)),
    )
    return verify_plan(plan, assembly, scene_workcell(), physics=physics)


def words(report: VerificationReport) -> list[str]:
    return [format_finding(finding) for finding in report.findings]


# --- plans ---


def test_boxes_and_their_meshes_have_the_same_verdict() -> None:
    boxes = judged(product(Box(BAR), Box(BLOCK)), physics=True)
    meshes = judged(product(as_mesh(Box(BAR)), as_mesh(Box(BLOCK))), physics=True)
    assert words(boxes) == words(meshes) == []
    assert meshes.states == boxes.states == 2
    assert boxes.configurations == meshes.configurations
    assert boxes.smallest_clearance is not None and meshes.smallest_clearance is not None
    assert meshes.smallest_clearance.distance == pytest.approx(boxes.smallest_clearance.distance, abs=2e-5)
    assert meshes.smallest_clearance.second == boxes.smallest_clearance.second


def test_boxes_and_their_meshes_hit_the_same_thing() -> None:
    shelf = (0.3, 0.3, 0.02)
    verdicts = []
    for kind in (Box, lambda size: as_mesh(Box(size))):
        further = Part("shelf", kind(shelf), pose([0.12, 0.40, 0.5]), 1.0, True)
        verdicts.append(judged(product(kind(BAR), kind(BLOCK), further)))
    boxes, meshes = (
        {frozenset(f.message.split(" hits ")) for f in verdict.findings if f.check == "collision"}
        for verdict in verdicts
    )
    assert frozenset(("panda_hand", "part/shelf")) in boxes
    assert boxes == meshes


@pytest.mark.parametrize(("dip", "holds"), [(0.00005, True), (0.0006, False)])
@pytest.mark.parametrize("is_open", [False, True])
def test_a_mesh_that_cuts_into_another_on_its_way_is_refused(dip: float, holds: bool, is_open: bool) -> None:
    block = Box(BLOCK).surface()
    if is_open:  # without its bottom
        bottom = (block.corners[:, :, 2] < 0).all(axis=1)
        block = TriangleMesh(block.vertices, block.triangles[~bottom])
    report = judged(product(as_mesh(Box(BAR)), Mesh(block)), (0.0, 0.0, -dip))
    assert report.passed is holds, words(report)
    if not holds:
        (finding,) = report.findings
        assert finding.message == "held/bar hits part/block"
        assert finding.depth == pytest.approx(dip, abs=2e-5)
    assert any("open surfaces" in line and "block" in line for line in report.not_checked) is is_open


def test_what_came_off_once_keeps_the_clearance() -> None:
    assembly = product(as_mesh(Box(BAR)), as_mesh(Box(BLOCK)))
    (finding,) = judged(assembly, (0.0, 0.0, 0.02), (0.0, 0.0, 0.0002), (0.0, 0.0, 0.02)).findings
    assert finding.message.startswith("held/bar comes within 0.2")
    assert judged(assembly, (0.0, 0.0, 0.0002), (0.0, 0.02, 0.0002)).passed


def test_hand_and_part_pass_through_a_frame_but_not_through_its_bars() -> None:
    frame = mesh_of(cuboid((0.6, 0.6, 0.02)) - cuboid((0.36, 0.36, 0.1)))

    def around(offset: float) -> VerificationReport:
        standing = Part("frame", frame, pose([0.12 + offset, 0.40, 0.22]), 1.0, True)
        return judged(product(as_mesh(Box(BAR)), as_mesh(Box(BLOCK)), standing), (0.0, 0.0, 0.31))

    assert around(0.0).passed, words(around(0.0))
    messages = [finding.message for finding in around(0.19).findings if finding.check == "collision"]
    assert any(message.startswith("panda_hand hits part/frame") for message in messages), messages


def test_pads_beside_the_part_are_refused() -> None:
    assembly = product(mesh_of(NOTCHED), as_mesh(Box(BLOCK)))
    findings = judged(assembly, width=0.02).findings  # the bar is 16 mm wide between the notches
    assert [finding.check for finding in findings] == ["finger_contact", "finger_contact"]
    assert findings[0].depth == pytest.approx(0.002, abs=1e-4)
    assert judged(assembly, width=0.016).passed, words(judged(assembly, width=0.016))
    deep = judged(assembly, width=0.0145)
    assert any(finding.message.startswith("panda_leftfinger cuts into held/bar") for finding in deep.findings)


def test_pads_on_an_edge_only_are_refused() -> None:
    thin = cuboid((0.0195, 0.16, 0.0195)) - cuboid((0.1, 0.156, 0.1)) + cuboid((0.02, 0.156, 0.0003))
    findings = judged(product(mesh_of(thin), Box(BLOCK))).findings
    assert any(f.check == "finger_contact" and "mm² only" in f.message for f in findings), findings


def test_what_is_drawn_too_deep_in_another_is_named_unless_it_is_meant() -> None:
    sunk = product(as_mesh(Box((0.02, 0.16, 0.0212))), as_mesh(Box(BLOCK)))
    (first, *_) = judged(sunk).findings
    assert first.message == "part/block is drawn in part/bar" and first.depth == pytest.approx(0.0006, abs=2e-5)
    meant = replace(sunk, allowed_overlaps=(("bar", "block"),))
    assert judged(meant).passed, words(judged(meant))


# --- bound ---


def test_the_bound_of_a_mesh_is_that_of_the_box_around_it_and_of_what_fingers_reach_over() -> None:
    goal = scene_workcell().goal
    low, high = CENTER - np.array(BAR) / 2, CENTER + np.array(BAR) / 2
    for bar, beyond in ((as_mesh(Box(BAR)), 0.0), (mesh_of(NOTCHED), 0.012)):
        assembly = product(bar, Box(BLOCK))
        nearest = np.clip(goal, low - beyond, high + beyond)
        bound = straight_line_bound(assembly, scene_workcell())
        assert bound == pytest.approx(math.dist(nearest, goal), abs=1e-9)
        assert bound == pytest.approx(volume_bound(assembly.parts[1], 0.0, goal), abs=1e-9)


# --- how deep ---


def at(x: float, y: float, z: float) -> Array:
    return pose([x, y, z])


def test_depth_of_a_slab_a_tip_and_of_what_is_inside() -> None:
    plate, small = Solid(Box((0.1, 0.1, 0.02)).surface()), Solid(Box((0.01, 0.01, 0.01)).surface())
    tip = Solid(mesh_of(manifold3d.Manifold.cylinder(0.02, 0.0, 0.004, 24)).surface())
    for depth in (0.0002, 0.0006, 0.002):
        assert solid_distance(plate, at(0, 0, 0), small, at(0.003, 0, 0.015 - depth)) == pytest.approx(-depth, rel=0.1)
        assert solid_distance(plate, at(0, 0, 0), tip, at(0, 0, 0.01 - depth)) == pytest.approx(-depth, rel=1e-3)
    assert solid_distance(plate, at(0, 0, 0), small, at(0, 0, 0.0155)) == pytest.approx(0.0005, abs=1e-9)
    assert solid_distance(plate, at(0, 0, 0), small, at(0, 0, 0)) < -0.003  # no surfaces meet


def test_depth_where_a_surface_is_open() -> None:
    closed, small = Box((0.1, 0.1, 0.02)).surface(), Solid(Box((0.01, 0.01, 0.01)).surface())
    bottom = (closed.corners[:, :, 2] < 0).all(axis=1)
    plate = Solid(TriangleMesh(closed.vertices, closed.triangles[~bottom]))
    assert not plate.is_closed
    for depth in (0.0002, 0.0006, 0.002):
        found = crossing_depth(plate, at(0, 0, 0), small, at(0.003, 0, 0.015 - depth))
        assert found == pytest.approx(depth, rel=1e-3)
        assert crossing_depth(small, at(0.003, 0, 0.015 - depth), plate, at(0, 0, 0)) == pytest.approx(found)


# --- gravity ---


@pytest.mark.parametrize("solid", [L_SHAPE, NOTCHED, cuboid((0.2, 0.2, 0.02)) - cuboid((0.1, 0.1, 0.1))])
def test_convex_pieces_make_up_the_part(solid: manifold3d.Manifold) -> None:
    pieces = pieces_of(mesh_of(solid))
    assert pieces is not None and len(pieces) > 1
    assert sum(volume for _, volume in pieces) == pytest.approx(solid.volume(), rel=1e-6)
    for corners, _ in pieces:
        assert (manifold3d.Manifold.hull_points(corners) - solid).volume() < 1e-9 * solid.volume() + 1e-15


def test_an_angle_that_tips_is_seen_and_one_that_stands_is_not() -> None:
    table = Part("table", as_mesh(Box((0.2, 0.2, 0.02))), pose([0.0, 0.0, -0.01]), 1.0, True)
    for x, stands in ((0.0, True), (0.13, False)):
        angle = Part("angle", mesh_of(L_SHAPE), pose([x, 0.0, 0.01]), 0.1)
        assembly = Assembly("angle", (table, angle))
        assert not unjudged_parts(assembly)
        assert stand_under_gravity(assembly, assembly.root).stands is stands
    glued = replace(
        assembly, joints=(Joint("glue", "glue", "table", "angle", np.zeros((1, 3)), np.array([0, 0, 1.0]), 5),)
    )
    assert stand_under_gravity(glued, glued.root).stands


def test_what_few_convex_pieces_do_not_make_up_is_said() -> None:
    ball = cuboid((0.04, 0.04, 0.04)) - manifold3d.Manifold.sphere(0.018, 60)
    assembly = product(mesh_of(ball), as_mesh(Box(BLOCK)))
    assert unjudged_parts(assembly) == (1,)
    report = judged(assembly, physics=True)
    assert report.states == 1
    assert any("gravity in states with bar" in line for line in report.not_checked)
