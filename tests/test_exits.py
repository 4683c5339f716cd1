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
from takeapart.collision.fields import CORNER_ERROR, FIELD_ERROR, field_of, signed_distances
from takeapart.model.assembly import Assembly, Joint, Part
from takeapart.model.geometry import Array, TriangleMesh
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
    field, surface = field_of(shape), trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
    points, _ = trimesh.sample.sample_surface(surface, 2000, seed=3)
    points += np.random.default_rng(4).uniform(-1e-3, 1e-3, points.shape)
    truth = -trimesh.proximity.signed_distance(surface, points)
    off = np.abs(signed_distances(field, points) - truth) / field.step
    assert np.quantile(off, 0.99) < FIELD_ERROR
    assert off.max() < CORNER_ERROR


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
