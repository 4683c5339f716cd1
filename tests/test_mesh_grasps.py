"""Grasps on meshes against rays and booleans of other libraries, and counts that anybody can check by thought."""

from __future__ import annotations

import math
from functools import cache

import manifold3d  # type: ignore[import-not-found, unused-ignore]
import numpy as np
import pytest
import trimesh
from shapely.geometry import Point
from trimesh.path.polygons import Polygon

from takeapart.formats.files import data_path, load_workcell
from takeapart.generate.products.solids import gear_outline
from takeapart.model.assembly import Assembly, Part
from takeapart.model.geometry import Array, Box, OrientedBox, TriangleMesh, pose, pose_inverse
from takeapart.model.meshes import Mesh
from takeapart.removal.grasps import (
    GraspCandidate,
    found_on_mesh,
    grasp_candidates,
    shortest_first,
    straight_line_bounds,
    ungraspable,
    volume_bound,
)
from takeapart.removal.mesh_grasps import GIVES_WAY, LEAST_CONTACT
from takeapart.removal.planner import RemovalOptions, RemovalPlanner
from takeapart.removal.reasons import Reason, Reasons
from takeapart.removal.result import Blocked
from takeapart.robot.gripper import gripper_boxes
from takeapart.robot.model import RobotModel
from takeapart.workcell import Workcell

PAD = (0.0088, 0.009)  # m, half of the Panda's pads along x and z, as its own mesh has them


@cache
def cell() -> Workcell:
    return load_workcell(data_path("workcells/panda.toml"))


def part_of(body: trimesh.Trimesh, T: Array | None = None, mass: float = 0.1) -> Part:
    surface = TriangleMesh(np.array(body.vertices, dtype=float), np.array(body.faces, dtype=np.int32))
    return Part("part", Mesh(surface), np.eye(4) if T is None else T, mass)


def profile(*corners: tuple[float, float], height: float) -> trimesh.Trimesh:
    return trimesh.creation.extrude_polygon(Polygon(corners), height)


def cylinder(sections: int = 48) -> trimesh.Trimesh:
    return trimesh.creation.cylinder(0.02, 0.1, sections=sections)


def gear(teeth: int, module: float = 0.002, height: float = 0.012) -> trimesh.Trimesh:
    """A spur gear along z with a bore, a tooth on the x axis."""
    rim = Polygon(np.array(gear_outline(1e3 * module, teeth, 0.3)) / 1e3)
    return trimesh.creation.extrude_polygon(rim.difference(Point(0, 0).buffer(0.008)), height)


BODIES = {
    "cylinder": cylinder(),
    "plate": profile((0, 0), (0.2, 0), (0.2, 0.12), (0.1, 0.12), (0.1, 0.15), (0, 0.15), height=0.005),
    "washer": trimesh.creation.annulus(0.0042, 0.008, 0.0016),
    "ball": trimesh.creation.icosphere(4, 0.03),
    "ring": trimesh.creation.annulus(0.02, 0.03, 0.02),
    "bracket": profile((0, 0), (0.08, 0), (0.08, 0.01), (0.01, 0.01), (0.01, 0.06), (0, 0.06), height=0.03),
    "shaft": trimesh.creation.cylinder(0.004, 0.1, sections=32),
    "gear": gear(32),
}


def solid(mesh: trimesh.Trimesh) -> manifold3d.Manifold:
    return manifold3d.Manifold(
        manifold3d.Mesh(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32))
    )


def fingers(width: float) -> list[OrientedBox]:
    """Of the Panda, in the tool frame; what each stands out before the pad's face is cut off."""
    gripper = cell().description.gripper
    boxes, _ = gripper_boxes(gripper, width)
    T = pose_inverse(gripper.T_base_tool(width))
    return [box.moved(T) for box in boxes]


def pad_hits(body: trimesh.Trimesh, grasp: GraspCandidate) -> Array:
    """(2,) share of each pad's area that has the surface within what pads give way to."""
    x, z = np.meshgrid(np.linspace(-0.97, 0.97, 17) * PAD[0], np.linspace(-0.97, 0.97, 17) * PAD[1])
    shares = []
    for side in (-1.0, 1.0):
        start = side * (grasp.width / 2 + GIVES_WAY)
        origins = np.column_stack([x.ravel(), np.full(x.size, start), z.ravel()])
        ways = np.tile([0.0, -side, 0.0], (x.size, 1))
        T = grasp.T_part_tool
        places, rays, _ = body.ray.intersects_location(
            origins @ T[:3, :3].T + T[:3, 3], ways @ T[:3, :3].T, multiple_hits=False
        )
        depths = np.abs((places - T[:3, 3]) @ T[:3, 1] - start)
        shares.append(float(np.count_nonzero(depths <= 2 * GIVES_WAY + 2e-4)) / x.size)
        assert len(rays) <= x.size
    return np.array(shares)


@pytest.mark.parametrize("name", BODIES)
def test_pads_lie_on_the_part_and_fingers_beside_it(name: str) -> None:
    body = BODIES[name]
    part = part_of(body, pose((0.4, 0.1, 0.2), (0.9, 0.1, 0.3, -0.2)))
    found = shortest_first(part, cell())
    assert 0 < len(found) <= 480 and len(found) % 2 == 0
    for grasp in found[::6]:
        assert grasp.width <= cell().description.maximum_opening
        assert (pad_hits(body, grasp) * 4 * PAD[0] * PAD[1] >= 0.8 * LEAST_CONTACT).all()
        moved = body.copy()
        moved.apply_transform(np.linalg.inv(grasp.T_part_tool))
        for box in fingers(grasp.width):
            side = math.copysign(1.0, box.T_frame_box[1, 3])
            finger = trimesh.creation.box(2 * box.half_extents, box.T_frame_box)
            face = side * (grasp.width / 2)
            beside = trimesh.creation.box((1, 1, 1), pose((0, face + side * 0.5, 0)))
            common = solid(finger) ^ solid(beside) ^ solid(moved)
            if common.volume() > 1e-12:
                assert 2 * common.volume() / common.surface_area() < GIVES_WAY + 1e-4


def test_both_finger_orders_stand_next_to_each_other() -> None:
    found = shortest_first(part_of(BODIES["bracket"]), cell())
    for first, second in zip(found[::2], found[1::2], strict=True):
        assert first.T_part_tool[:3, 3] == pytest.approx(second.T_part_tool[:3, 3], abs=1e-12)
        assert first.T_part_tool[:3, 2] == pytest.approx(second.T_part_tool[:3, 2], abs=1e-12)
        assert first.T_part_tool[:3, 1] == pytest.approx(-second.T_part_tool[:3, 1], abs=1e-12)


def test_what_closes_where() -> None:
    def closings(name: str) -> Array:
        return np.array([grasp.T_part_tool[:3, 1] for grasp in shortest_first(part_of(BODIES[name]), cell())])

    assert np.abs(closings("cylinder")[:, 2]).max() < 1e-9  # across its axis, for its ends stand too far apart
    assert np.abs(closings("plate")[:, 2]).min() > 1 - 1e-9  # across its thickness
    assert np.abs(closings("washer")[:, 2]).min() > 1 - 1e-9
    widths = {round(grasp.width, 4) for grasp in shortest_first(part_of(BODIES["bracket"]), cell())}
    assert {0.03, 0.01} <= widths <= {0.01, 0.03, 0.06, 0.08}


@pytest.mark.parametrize("teeth", [18, 19, 32])
def test_a_gear_is_gripped_by_its_teeth_too(teeth: int) -> None:
    """A tooth's tip alone is too narrow for a pad, which rests on two of them, or on two and on one opposite."""
    body = gear(teeth)
    found = shortest_first(part_of(body), cell())
    tips = 0.002 * (teeth + 2)  # m
    across = [grasp for grasp in found if abs(grasp.T_part_tool[2, 1]) < 1e-9 and grasp.width > 0.9 * tips]
    assert across and len(across) < len(found)  # others close on its faces, or through the bore
    for grasp in across:
        assert tips * math.cos(math.pi / teeth) - 0.001 < grasp.width < tips + 0.001
        assert (pad_hits(body, grasp) * 4 * PAD[0] * PAD[1] >= 0.8 * LEAST_CONTACT).all()


def test_a_bar_is_gripped_across_slots_that_are_narrower_than_pads() -> None:
    """As an aluminium profile: on either side a slot of 5 mm, 2 mm deep, all along; the hand comes from above."""
    corners = [
        (-8, 0),
        (8, 0),
        (8, 4.5),
        (6, 4.5),
        (6, 9.5),
        (8, 9.5),
        (8, 14),
        (-8, 14),
        (-8, 9.5),
        (-6, 9.5),
        (-6, 4.5),
    ]
    body = profile(*((x / 1e3, y / 1e3) for x, y in [*corners, (-8, 4.5)]), height=0.12)
    T = pose((0, 0, 0), (math.sqrt(0.5), math.sqrt(0.5), 0, 0))  # it lies, its sides upright
    found = found_on_mesh(part_of(body, T), cell()).candidates
    across = [each for each in found if abs(each.T_part_tool[0, 1]) > 0.999 and (T @ each.T_part_tool)[2, 2] < -0.99]
    assert across and all(each.width == pytest.approx(0.016, abs=2e-4) for each in across)
    assert all((pad_hits(body, each) * 4 * PAD[0] * PAD[1] >= 0.8 * LEAST_CONTACT).all() for each in across)


def test_handles_far_from_the_centre_of_mass_are_gripped() -> None:
    """A block with a bar of another width in front, and a shaft of 0.2 m that is gripped near its ends too."""
    block = trimesh.creation.box((0.07, 0.06, 0.05), pose((0, 0, 0)))
    bar = trimesh.creation.box((0.014, 0.045, 0.014), pose((0, -0.05, 0)))
    drawer = solid(block) + solid(bar)
    mesh = drawer.to_mesh()
    found = shortest_first(part_of(trimesh.Trimesh(mesh.vert_properties[:, :3], mesh.tri_verts)), cell())
    assert any(grasp.T_part_tool[1, 3] < -0.045 and grasp.width < 0.015 for grasp in found)
    shaft = trimesh.creation.cylinder(0.004, 0.2, sections=32)
    heights = [grasp.T_part_tool[2, 3] for grasp in shortest_first(part_of(shaft), cell())]
    assert min(heights) < -0.06 and max(heights) > 0.06


def test_the_hand_comes_from_above_where_it_can() -> None:
    T = pose((0, 0, 0.1), (math.sqrt(0.5), math.sqrt(0.5), 0, 0))  # a lying cylinder
    part = part_of(cylinder(), T)
    found = found_on_mesh(part, cell()).candidates
    steep = np.array([(T @ grasp.T_part_tool)[2, 2] for grasp in found])
    assert steep[0] < -0.99 and np.count_nonzero(steep < -0.8) >= 10


def test_fingertips_reach_no_deeper_than_needed() -> None:
    part = part_of(profile((0, 0), (0.06, 0), (0.06, 0.02), (0.03, 0.02), (0.03, 0.03), (0, 0.03), height=0.006))
    steep = [grasp for grasp in shortest_first(part, cell()) if grasp.T_part_tool[2, 2] < -0.99]
    tips = [grasp.T_part_tool[2, 3] - 0.0095 for grasp in steep]
    assert tips and min(tips) > 0.001  # above the floor that it lies on


def test_a_mesh_that_is_a_box_is_gripped_as_that_box() -> None:
    box = Box((0.2, 0.03, 0.05))
    T = pose((0.5, 0.2, 0.3), (0.8, 0.1, 0.2, -0.5))
    expected = grasp_candidates(Part("box", box, T, 0.1), cell().description.maximum_opening)
    plain = shortest_first(Part("box", box, T, 0.1), cell())
    found = shortest_first(Part("mesh", Mesh(box.surface()), T, 0.1), cell())
    assert len(found) == len(expected) == len(plain)
    for one, other in zip(plain, found, strict=True):
        assert one.width == pytest.approx(other.width, abs=1e-12)
        assert one.T_part_tool == pytest.approx(other.T_part_tool, abs=1e-12)


@pytest.mark.parametrize("name", BODIES)
def test_no_grasp_is_shorter_than_the_bound_of_the_volume(name: str) -> None:
    T = pose((0.4, 0.1, 0.2), (0.9, 0.1, 0.3, -0.2))
    part = part_of(BODIES[name], T)
    for goal in ((0.4, 0.1, 0.2), (0.45, 0.1, 0.25), (1.0, -0.3, 0.4)):
        bounds = straight_line_bounds(part, shortest_first(part, cell()), 0.05, np.array(goal))
        assert bounds.min() >= volume_bound(part, 0.05, np.array(goal)) - 1e-12


def test_why_a_part_cannot_be_gripped() -> None:
    big = part_of(trimesh.creation.icosphere(3, 0.06))
    assert ungraspable(big, cell()) == "width" and not shortest_first(big, cell())
    assert found_on_mesh(big, cell()).narrowest > 0.08
    bead = part_of(trimesh.creation.icosphere(3, 0.0015))
    assert ungraspable(bead, cell()) == "contact"
    assert 0 < found_on_mesh(bead, cell()).contact < LEAST_CONTACT
    heavy = part_of(cylinder(), mass=50)
    assert ungraspable(heavy, cell()) == "weight"


def test_the_reason_says_how_much_is_missing(robot: RobotModel) -> None:
    def reason(body: trimesh.Trimesh) -> Reason:
        part = part_of(body, pose((0.0, 0.0, 0.3)))
        planner = RemovalPlanner(Assembly("one", (part,)), cell(), RemovalOptions(), robot)
        answer = planner.plan(0, 1, rng=np.random.default_rng(0))
        assert isinstance(answer, Blocked) and answer.stage == "grasp"
        return Reasons(planner).of(answer, 1)

    wide = reason(profile((0, 0), (0.2, 0), (0.2, 0.1), (0.1, 0.1), (0.1, 0.194), (0, 0.194), height=0.15))
    assert wide.cause == "width" and dict(wide.numbers)["width"] == pytest.approx(0.1, abs=1e-9)
    assert "100 mm" in wide.text and "80 mm" in wide.text
    small = reason(trimesh.creation.icosphere(3, 0.0015))
    assert small.cause == "contact" and 0 < dict(small.numbers)["contact"] < dict(small.numbers)["least_contact"]
    assert "mm² of at least 20 mm²" in small.text
    thick = trimesh.creation.box((0.3, 0.3, 0.3)).difference(trimesh.creation.box((0.2, 0.2, 0.2)))
    shell = reason(thick)  # 50 mm thick: one finger would have to be in the hollow, which is closed
    assert shell.cause == "fingers" and "reach into it" in shell.text


@pytest.mark.parametrize("sections", [24, 100])
def test_grasps_hardly_depend_on_the_tessellation(sections: int) -> None:
    plain, other = (found_on_mesh(part_of(cylinder(n)), cell()) for n in (48, sections))
    assert len(other.candidates) == pytest.approx(len(plain.candidates), rel=0.1)
    best, again = plain.candidates[0].T_part_tool, other.candidates[0].T_part_tool
    assert again[2, 2] == pytest.approx(best[2, 2], abs=0.01)  # its turn about the cylinder's axis does not matter
    assert again[2, 3] == pytest.approx(best[2, 3], abs=0.012)
    assert other.contact == pytest.approx(plain.contact, rel=0.35)


@pytest.mark.parametrize("name", ["bracket", "plate", "ring"])
def test_a_drawing_turned_about_the_vertical_has_the_same_grasps(name: str) -> None:
    T = pose((0.1, -0.2, 0.0), (math.cos(math.radians(18.5)), 0, 0, math.sin(math.radians(18.5))))
    turned = BODIES[name].copy()
    turned.apply_transform(T)
    plain, other = (found_on_mesh(part_of(body), cell()).candidates for body in (BODIES[name], turned))
    assert len(other) == pytest.approx(len(plain), rel=0.15)
    back = pose_inverse(T)
    for grasp in other[:4]:
        moved = back @ grasp.T_part_tool
        assert any(
            np.linalg.norm(moved[:3, 3] - one.T_part_tool[:3, 3]) < 0.02
            and abs(moved[2, 2] - one.T_part_tool[2, 2]) < 0.05
            for one in plain
        )


def test_an_open_mesh_is_gripped_like_a_closed_one() -> None:
    body = BODIES["bracket"].subdivide().subdivide()
    holes = trimesh.Trimesh(body.vertices, np.delete(body.faces, [7, 90], axis=0), process=False)
    assert len(shortest_first(part_of(holes), cell())) >= 0.7 * len(shortest_first(part_of(body), cell()))


def test_the_same_mesh_gives_the_same_grasps() -> None:
    one, other = (shortest_first(part_of(BODIES["ring"].copy()), cell()) for _ in range(2))
    for first, second in zip(one, other, strict=True):
        assert np.array_equal(first.T_part_tool, second.T_part_tool) and first.width == second.width
