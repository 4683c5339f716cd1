"""Ways out of products whose answer is known by construction."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import trimesh
from manifold3d import CrossSection, Manifold
from manifold3d import Mesh as ManifoldMesh

from mesh_cases import case
from takeapart.collision.contact import Contacts
from takeapart.collision.fields import FIELD_ERROR, field_of, mesh_field, signed_distances
from takeapart.collision.grids import MOST_NODES
from takeapart.collision.triangles import distances, triangle_tree
from takeapart.model.assembly import Assembly, Connector, Joint, Part
from takeapart.model.geometry import Array, Box, OrientedBox, TriangleMesh, pose
from takeapart.model.meshes import Mesh
from takeapart.removal.exits import Exits

SEGMENTS = 96


def cylinder(radius: float, height: float) -> Manifold:
    return Manifold.cylinder(height, radius, radius, SEGMENTS)


def block(low: tuple[float, float, float], high: tuple[float, float, float]) -> Manifold:
    return Manifold.cube(np.subtract(high, low)).translate(low)


def part(name: str, solid: Manifold, fixed: bool = False) -> Part:
    """A part in its place; a solid is given in mm."""
    mesh = solid.to_mesh()
    surface = TriangleMesh(np.asarray(mesh.vert_properties[:, :3], float) * 1e-3, np.asarray(mesh.tri_verts, np.int32))
    return Part(name, Mesh(surface), np.eye(4), 0.1, fixed)


def solid_at(which: Part, T: Array) -> Manifold:
    """A part at a pose, mm, for the oracle."""
    mesh = which.shape.surface().moved(T)
    return Manifold(ManifoldMesh((mesh.vertices * 1e3).astype(np.float32), mesh.triangles.astype(np.uint32)))


def ways(assembly: Assembly) -> Exits:
    return Exits(assembly, Contacts(assembly), (), 0.001)


def deepest(assembly: Assembly, number: int, poses: Array) -> float:
    """Thickness 2 V / A, mm, of the worst overlap of a part with the rest along poses, by exact meshes."""
    worst = 0.0
    rest = [solid_at(other, other.T_world_part) for k, other in enumerate(assembly.parts) if k != number]
    for first, last in pairwise(poses):
        steps = max(1, int(np.ceil(np.linalg.norm(last[:3, 3] - first[:3, 3]) / 1e-3)))
        for k in range(steps + 1):
            T = first.copy()
            T[:3, 3] += (last[:3, 3] - first[:3, 3]) * k / steps
            for other in rest:
                overlap = solid_at(assembly.parts[number], T) ^ other
                if overlap.volume() > 1e-3:
                    worst = max(worst, 2 * overlap.volume() / overlap.surface_area())
    return worst


@pytest.mark.parametrize("play", [0.05, 0.2, 0.5])
def test_a_peg_leaves_along_its_axis_only(play: float) -> None:
    plate = block((-20, -20, 0), (20, 20, 25)) - cylinder(5 + play, 30).translate((0, 0, 5))
    peg = cylinder(5, 40).translate((0, 0, 5))
    assembly = Assembly("peg", (part("plate", plate, fixed=True), part("peg", peg)))
    found = ways(assembly).exits(1)
    assert [way.blockers for way in found] == [0]
    assert found[0].kind == "straight" and found[0].direction is not None
    assert np.allclose(found[0].direction, [0, 0, 1])
    assert deepest(assembly, 1, found[0].poses) < 0.05


def test_a_tilted_peg_leaves_along_its_axis() -> None:
    plate = block((-20, -20, 0), (20, 20, 25)) - cylinder(5.1, 60).translate((0, 0, 5))
    peg = cylinder(5, 40).translate((0, 0, 5))
    turned = [solid.rotate((0, 50, 20)) for solid in (plate, peg)]
    assembly = Assembly("tilted", (part("plate", turned[0], fixed=True), part("peg", turned[1])))
    out = trimesh.transformations.euler_matrix(0, np.radians(50), np.radians(20))[:3, :3] @ [0, 0, 1]
    found = ways(assembly).exits(1)
    assert found[0].blockers == 0 and found[0].direction is not None
    assert float(found[0].direction @ out) > np.cos(np.radians(1))


@pytest.mark.slow
def test_two_linked_rings_stay_together() -> None:
    ring = Manifold.revolve(CrossSection.circle(3, 24).translate((12, 0)), 48)
    other = ring.rotate((90, 0, 0)).translate((12, 0, 0))
    assembly = Assembly("links", (part("fixed", ring, fixed=True), part("link", other)))
    assert all(way.blockers is None for way in ways(assembly).exits(1))


def slide() -> Assembly:
    """A cube in an L-shaped channel: first along x, then up."""
    channel = block((-0.3, -10.3, 10), (50, 10.3, 30.4)) + block((29, -10.3, 10), (50, 10.3, 60))
    base = block((-15, -20, 0), (65, 20, 45)) - channel
    return Assembly("slide", (part("base", base, fixed=True), part("cube", block((0, -10, 10.1), (20, 10, 30.1)))))


def bayonet() -> Assembly:
    """A plug with two lugs below a rim; a turn of 60 degrees brings them below the slots."""
    lug = block((-12, -2, 0), (12, 2, 4))
    plug = cylinder(8, 30) + lug
    opening = cylinder(8.3, 40)
    slot = block((-12.4, -2.4, 0), (12.4, 2.4, 40))
    pocket = slot ^ cylinder(20, 0.1)
    for angle in range(-60, 1, 3):
        pocket += block((-12.4, -2.4, -0.1), (12.4, 2.4, 4.4)).rotate((0, 0, angle))
    socket = block((-18, -18, -6), (18, 18, 16)) - (opening.translate((0, 0, -0.1)) + slot + pocket)
    return Assembly("bayonet", (part("socket", socket, fixed=True), part("plug", plug.rotate((0, 0, -58)))))


@pytest.mark.parametrize("product", [slide, bayonet])
def test_pushes_free_what_no_straight_way_does(product: object) -> None:
    assembly: Assembly = product()  # type: ignore[operator]
    (found,) = ways(assembly).exits(1)
    assert (found.kind, found.blockers) == ("pushes", 0)
    assert deepest(assembly, 1, found.poses) < 0.2


@pytest.mark.slow
def test_a_thread_with_a_known_pitch_is_unscrewed() -> None:
    """An eccentric circle, twisted while it is extruded, is a thread."""

    def thread(radius: float, height: float, pitch: float) -> Manifold:
        circle = CrossSection.circle(radius, 32).translate((1.5, 0))
        return Manifold.extrude(circle, height, int(height * 2), 360 * height / pitch)

    nut = block((-15, -15, 0), (15, 15, 16)) - thread(6.15, 16.0, 8.0)
    bolt = thread(6.0, 30.0, 8.0)
    parts = (part("nut", nut, fixed=True), part("bolt", bolt))
    joint = Joint("screw", "screw", "nut", "bolt", np.zeros((1, 3)), np.array([0.0, 0.0, 1.0]), 10.0, pitch=0.008)
    assembly = Assembly("thread", parts, joints=(joint,))
    (found,) = ways(assembly).exits(1)
    assert (found.kind, found.blockers) == ("screw", 0)
    assert deepest(assembly, 1, found.poses) < 0.2


def test_fields_are_as_near_the_truth_as_they_say() -> None:
    body = block((-20, -10, 0), (20, 10, 12)) - cylinder(4, 30).translate((5, 0, -5))
    shape = part("body", body).shape
    mesh = shape.surface()
    field, surface = field_of(shape), trimesh.Trimesh(mesh.vertices * 1e3, mesh.triangles, process=False)
    points, _ = trimesh.sample.sample_surface(surface, 2000, seed=3)
    points += np.random.default_rng(4).uniform(-1, 1, points.shape)
    truth = -trimesh.proximity.signed_distance(surface, points) / 1e3  # in mm, for it is wrong for small triangles
    off = np.abs(signed_distances(field, np.asarray(points) / 1e3) - truth) / field.step
    assert off.max() < FIELD_ERROR


def test_a_kept_field_is_the_one_that_was_built(monkeypatch: pytest.MonkeyPatch) -> None:
    shape = part("body", block((0, 0, 0), (21, 13, 8)) - cylinder(3, 20).translate((7, 6, -5))).shape
    built = mesh_field(shape.surface())
    field_of(shape)
    monkeypatch.setattr("takeapart.collision.fields.mesh_field", None)  # not built again
    read = field_of(shape)
    assert all(np.array_equal(getattr(read, key), getattr(built, key)) for key in built._fields)


@pytest.mark.parametrize("half", [(500, 500, 300), (4000, 4000, 2500)])
def test_the_field_of_a_large_body_stays_of_a_size_that_fits(half: tuple[int, int, int]) -> None:
    x, y, z = half
    field = mesh_field(part("hall", block((-x, -y, -z), half)).shape.surface())
    assert field.values.size < 1.25 * MOST_NODES
    points = np.array([[x, 0.0, 0.0], [x - 2.0, 5.0, 7.0], [x + 2.0, 5.0, 7.0], [0.0, 0.0, 0.0], [2.0 * x, 0.0, 0.0]])
    found = signed_distances(field, points * 1e-3)
    assert np.abs(found[:3] - [0.0, -0.002, 0.002]).max() < FIELD_ERROR * field.step
    assert found[3] < -0.01 and found[4] > 0.01


def test_triangles_without_area_are_as_far_as_their_edges() -> None:
    rng = np.random.default_rng(5)
    corners = rng.uniform(-0.05, 0.05, (300, 3, 3))
    corners[:100, 2] = corners[:100, 1]  # two corners are one
    share = rng.uniform(-0.5, 1.5, (100, 1))
    corners[100:200, 2] = corners[100:200, 0] * share + corners[100:200, 1] * (1 - share)  # all on a line
    points = rng.uniform(-0.05, 0.05, (20, 3))
    for triangle in corners:
        tree = triangle_tree(TriangleMesh(triangle, np.array([[0, 1, 2]], np.int32)))
        steps = np.linspace(0, 1, 41)
        a, b = (grid.ravel() for grid in np.meshgrid(steps, steps))
        inner = a + b <= 1 + 1e-9
        sides = np.column_stack([a[inner], b[inner]]) @ (triangle[1:] - triangle[0])
        dense = triangle[0] + sides
        truth = np.linalg.norm(points[:, None] - dense[None], axis=2).min(axis=1)
        found = distances(points, tree, 1.0)
        coarse = np.linalg.norm(triangle - np.roll(triangle, 1, axis=0), axis=1).max() / 40
        assert (found <= truth + 1e-12).all() and (found >= truth - coarse).all()


def names_up(name: str) -> set[str]:
    assembly = case(name)
    exits = ways(assembly)
    return {
        assembly.parts[k].name
        for k in range(len(assembly.parts))
        if any(way.blockers == 0 and way.direction is not None and way.direction[2] > 0.99 for way in exits.exits(k))
    }


@pytest.mark.slow
def test_the_plugs_of_the_manifold_leave_upwards() -> None:
    assembly = case("fabrica_cooling_manifold")
    assert names_up("fabrica_cooling_manifold") == {body.name for body in assembly.parts if not body.fixed}


@pytest.mark.slow
def test_the_wheels_of_the_car_leave_sideways() -> None:
    assembly = case("fabrica_car")
    exits = ways(assembly)
    for wheel in ("part0", "part3", "part4", "part5"):
        first = exits.exits(assembly.index[wheel])[0]
        assert first.blockers == 0 and first.direction is not None and abs(first.direction[2]) < 0.1


def test_what_stands_on_a_table_below_a_roof_goes_aside_and_then_up() -> None:
    """Neither up nor beyond the table's edge: it ends above the table, on a way that exact meshes find free."""
    roof = block((-30, -30, 21), (30, 30, 30)) + block((-30, 20, 0), (30, 30, 30))
    assembly = Assembly("roof", (part("roof", roof, fixed=True), part("cube", block((-10, -10, 0), (10, 10, 20)))))
    T = np.eye(4)
    T[2, 3] = -0.021  # its top 1 mm below
    table = OrientedBox(T, np.array([0.8, 0.7, 0.02]))
    found = Exits(assembly, Contacts(assembly), (table,), 0.0011).exits(1)
    assert found and found[0].blockers == 0
    end = found[0].poses[-1, :3, 3]
    assert end[2] > 0.005 and np.linalg.norm(end) < 0.1
    assert deepest(assembly, 1, found[0].poses) == 0.0
    assert (found[0].poses[:, 2, 3] >= 0.0).all()


def test_the_walls_of_connectors_are_in_the_way_of_meshes() -> None:
    """A wall over a cube keeps it from going up, and whoever carries the wall is told."""
    wall = OrientedBox(pose((0.0, 0.0, 0.03)), np.array([0.02, 0.02, 0.002]))
    base = Part("base", Box((0.06, 0.06, 0.01)), pose((0.0, 0.0, -0.005)), 1.0, fixed=True)
    cube = part("cube", block((-10, -10, 0), (10, 10, 20)))
    connector = Connector("bridge", "O", "base", "cube", (wall,))
    free = ways(Assembly("open", (base, cube))).exits(1)
    assert free[0].direction is not None and free[0].direction[2] > 0.99 and free[0].blockers == 0
    kept = ways(Assembly("mixed", (base, cube), (connector,))).exits(1)
    assert kept and all(way.direction is None or way.direction[2] < 0.9 for way in kept if way.blockers == 0)


def test_a_part_is_not_tilted_out_of_a_shallow_seat_through_its_rim() -> None:
    """A plate of 0.3 m has a coarse field; a disc stands 3 mm deep in it with 0.15 mm play, below a lid: leaning it
    would cut 0.2 mm into the rim."""
    plate = block((-150, -150, 0), (150, 150, 18)) - cylinder(16.15, 30).translate((0, 0, 15))
    disc = cylinder(16, 12).translate((0, 0, 15))
    lid = block((-40, -40, 27.2), (40, 40, 40))
    assembly = Assembly(
        "seat", (part("plate", plate, fixed=True), part("disc", disc), part("lid", lid)), contact_gap=5e-4
    )
    found = ways(assembly).exits(1)
    assert found[0].direction is not None and found[0].direction[2] == pytest.approx(1.0)
    for way in found:
        if way.blockers is not None:
            assert deepest(Assembly("seat", assembly.parts[:2]), 1, way.poses) < 0.1
