"""Distance fields and sweeps against exact distances, and ways out against what is known of pegs, plates and rings."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import trimesh

from mesh_cases import case
from takeapart.collision.bounds import Way, clear_after, covers_of, near_at, pass_near
from takeapart.collision.contact import Contacts, body_of
from takeapart.collision.fields import FIELD_ERROR, Field, field_of, mesh_field, signed_distances, surface_points
from takeapart.collision.meeting import cloud_distance, cloud_hit
from takeapart.collision.points import cloud_of
from takeapart.collision.sweep import LEAST_STEP
from takeapart.model.assembly import Assembly, Part
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, Box, TriangleMesh, pose
from takeapart.model.meshes import Mesh
from takeapart.removal.exits import Exit, Exits
from takeapart.removal.following import end_of, lead_lengths, motion_of

CLEARANCE = 0.0011


def shape_of(mesh: trimesh.Trimesh) -> Mesh:
    return Mesh(TriangleMesh(np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32)))


def ring(inner: float, outer: float, height: float) -> trimesh.Trimesh:
    return trimesh.creation.annulus(inner, outer, height, sections=64)


def first_hit(field: Field, points: Array, direction: Array, kept: float, travel: float) -> float:
    """By stepping every point as far as it is away: without a tree, without normals."""
    nearest, at = np.inf, np.zeros(len(points))
    while len(points):
        away = signed_distances(field, np.ascontiguousarray(points + at[:, None] * direction)) - kept
        nearest = min(nearest, at[away < 0.0].min(initial=np.inf))
        at = np.where(away < 0.0, np.inf, at + np.maximum(away, LEAST_STEP))
        going = at <= min(travel, nearest)
        points, at = points[going], at[going]
    return nearest


def product(*parts: Part) -> Assembly:
    return Assembly("product", parts)


def exits_of(assembly: Assembly, part: int) -> tuple[Exit, ...]:
    return Exits(assembly, Contacts(assembly), (), CLEARANCE).exits(part)


@pytest.mark.parametrize(
    "mesh",
    [
        trimesh.creation.icosphere(3, 0.03),
        ring(0.02, 0.04, 0.03),
        trimesh.creation.box((0.05, 0.02, 0.08)),
        trimesh.creation.capsule(0.05, 0.01),
    ],
    ids=["ball", "ring", "box", "capsule"],
)
def test_the_field_is_as_near_to_the_true_distance_as_it_says(mesh: trimesh.Trimesh) -> None:
    shape = shape_of(mesh)
    field = mesh_field(shape.surface())
    rng = np.random.default_rng(0)
    points = mesh.vertices[rng.integers(len(mesh.vertices), size=1500)] + rng.normal(0, 0.002, (1500, 3))
    scaled = trimesh.Trimesh(mesh.vertices * 1e3, mesh.faces, process=False)  # the oracle is wrong for small triangles
    exact = -trimesh.proximity.signed_distance(scaled, points * 1e3) / 1e3
    within = np.abs(exact) < field.band - field.step
    found = signed_distances(field, points)
    assert within.sum() > 400
    assert np.abs(found - exact)[within].max() <= FIELD_ERROR * field.step
    assert (np.sign(found) == np.sign(exact))[np.abs(exact) > FIELD_ERROR * field.step].all()


def test_the_field_of_a_box_is_exact() -> None:
    field = field_of(Box((0.04, 0.06, 0.1)))
    points = np.array([[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.02, 0.03, 0.05], [0.03, 0.04, 0.0], [0.0, 0.0, 0.07]])
    expected = [-0.02, 0.01, 0.0, np.hypot(0.01, 0.01), 0.02]
    np.testing.assert_allclose(signed_distances(field, points), expected, atol=1e-12)


def test_points_leave_no_place_of_a_surface_alone() -> None:
    mesh = trimesh.creation.box((0.1, 0.03, 0.02))
    points = surface_points(shape_of(mesh).surface(), 0.002)
    samples, _ = trimesh.sample.sample_surface(mesh, 3000, seed=1)
    gaps = np.linalg.norm(samples[:, None] - points[None], axis=2).min(axis=1)
    assert gaps.max() < 0.003
    assert np.abs(trimesh.proximity.signed_distance(mesh, points)).max() < 1e-9


@pytest.mark.parametrize("distance", [0.0007, 0.0123, 0.05])
def test_a_sweep_stops_where_a_ball_meets_a_plate(distance: float) -> None:
    plate = field_of(shape_of(trimesh.creation.box((0.1, 0.1, 0.01))))
    ball = trimesh.creation.icosphere(3, 0.02).vertices + [0.0, 0.0, -0.025 - distance]
    hit = first_hit(plate, np.ascontiguousarray(ball), np.array([0.0, 0.0, 1.0]), 0.0, 0.2)
    assert hit == pytest.approx(distance, abs=3e-4)
    assert first_hit(plate, np.ascontiguousarray(ball), np.array([0.0, 0.0, -1.0]), 0.0, 0.2) == np.inf


@pytest.mark.parametrize("play", [5e-5, 1e-4, 2.5e-4, 5e-4])
def test_a_peg_leaves_its_hole_along_its_axis_only(play: float) -> None:
    tilt = trimesh.transformations.rotation_matrix(0.6, (1, 0.3, 0))  # the axis is none of the world's
    block = shape_of(ring(0.01, 0.03, 0.04))
    peg = shape_of(trimesh.creation.cylinder(0.01 - play, 0.06, sections=64))
    assembly = product(Part("block", block, tilt, 1.0, fixed=True), Part("peg", peg, tilt, 0.1))
    ways = exits_of(assembly, 1)
    assert ways and all(way.blockers == 0 for way in ways)
    for way in ways:
        assert way.direction is not None
        assert abs(float(way.direction @ tilt[:3, 2])) > np.cos(np.radians(3))


def test_what_stands_on_a_part_is_in_its_way_up_and_nothing_else_is() -> None:
    base = Part("base", Box((0.2, 0.2, 0.02)), pose((0, 0, 0.01)), 1.0, fixed=True)
    lower = Part("lower", shape_of(trimesh.creation.box((0.05, 0.05, 0.05))), pose((0, 0, 0.045)), 0.2)
    upper = Part("upper", shape_of(trimesh.creation.cylinder(0.02, 0.05)), pose((0, 0, 0.095)), 0.2)
    beside = Part("beside", Box((0.02, 0.02, 0.1)), pose((0.05, 0, 0.07)), 0.2)
    assembly = product(base, lower, upper, beside)
    up = [way for way in exits_of(assembly, 1) if way.direction is not None and way.direction[2] > 0.99]
    assert [way.blockers for way in up] == [0b0100]
    assert dict(up[0].hits)[2] < 1e-3
    assert exits_of(assembly, 2)[0].blockers == 0


def test_linked_rings_have_no_way_out() -> None:
    first, second = ring(0.02, 0.03, 0.01), ring(0.02, 0.03, 0.01)
    T = trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0))
    T[0, 3] = 0.025
    assembly = product(
        Part("held", shape_of(first), np.eye(4), 0.1, fixed=True), Part("linked", shape_of(second), T, 0.1)
    )
    ways = exits_of(assembly, 1)
    assert ways and all(way.blockers is None for way in ways)
    assert all(way.hits and way.hits[0][0] == 0 and way.pushes > 0 for way in ways)


def test_overlaps_as_drawn_are_refused_by_name_unless_they_are_meant() -> None:
    low = Part("low", shape_of(trimesh.creation.box((0.05, 0.05, 0.02))), pose((0, 0, 0.01)), 1.0, fixed=True)
    high = Part("high", shape_of(trimesh.creation.cylinder(0.02, 0.03)), pose((0, 0, 0.034)), 0.2)
    with pytest.raises(InputError, match=r"'low' and 'high' overlap by 1\.00 mm as drawn; at most 0\.5 mm"):
        Contacts(product(low, high)).require()
    meant = Assembly("product", (low, high), allowed_overlaps=(("high", "low"),))
    Contacts(meant).require()
    assert [(each.first, each.second) for each in Contacts(meant).swallowed()] == [(0, 1)]


def test_an_exit_is_followed_in_even_steps() -> None:
    T = pose((0.1, 0.2, 0.3), (np.cos(0.2), 0, np.sin(0.2), 0))
    poses = np.repeat(T[None], 2, axis=0)
    poses[1, :3, 3] += [0.03, 0.0, 0.04]
    way = Exit("straight", poses, 0, np.array([0.6, 0.0, 0.8]))
    motion = motion_of(way, 0.005, 0.1)
    assert len(motion) == 11 and np.allclose(motion[:, :3, :3], np.eye(3))
    assert np.allclose(np.diff(motion[:, :, 3], axis=0), [0.003, 0, 0.004])
    np.testing.assert_allclose(end_of(way), motion[-1], atol=1e-12)
    assert lead_lengths(way, np.zeros((2, 3))) == pytest.approx([0.05, 0.05])


def test_the_motion_of_a_screw_keeps_what_it_started_from_and_where_it_ends() -> None:
    turns = np.linspace(0, 2 * np.pi, 200)
    poses = np.repeat(np.eye(4)[None], 200, axis=0)
    poses[:, 0, 0], poses[:, 0, 1], poses[:, 1, 0], poses[:, 1, 1] = (
        np.cos(turns),
        -np.sin(turns),
        np.sin(turns),
        np.cos(turns),
    )
    poses[:, 2, 3] = 0.002 * turns / (2 * np.pi)
    way = Exit("screw", poses, 0)
    motion = motion_of(way, 0.005, 0.01)
    np.testing.assert_allclose(motion[0], np.eye(4)[:3], atol=1e-12)
    np.testing.assert_allclose(motion[-1], end_of(way), atol=1e-12)
    for before, after in pairwise(motion):
        assert np.linalg.norm(after[:, 3] - before[:, 3]) < 0.005
    rim: Array = np.array([[0.01, 0.0, 0.0]])
    assert lead_lengths(way, rim) == pytest.approx([np.hypot(2 * np.pi * 0.01, 0.002)], rel=1e-3)


@pytest.mark.parametrize("name", ["asap_beam", "fabrica_cooling_manifold"])
def test_products_that_nobody_here_made_come_apart_upwards(name: str) -> None:
    assembly = case(name)
    contacts = Contacts(assembly)
    contacts.require()
    rule = Exits(assembly, contacts, (), CLEARANCE)
    for i, part in enumerate(assembly.parts):
        if not part.fixed:
            assert any(way.direction is not None and way.direction[2] > 0.99 for way in rule.exits(i)), part.name


def test_wheels_of_the_car_leave_sideways_and_before_the_body() -> None:
    assembly = case("fabrica_car")
    rule = Exits(assembly, Contacts(assembly), (), CLEARANCE)
    wheels = assembly.state_of([f"part{k}" for k in (0, 3, 4, 5)])
    for name in ("part0", "part3", "part4", "part5"):
        way = rule.exits(assembly.index[name])[0]
        assert way.blockers == 0 and way.direction is not None and abs(way.direction[2]) < 0.1
    assert rule.exits(assembly.index["part1"])[0].blockers == wheels


def test_containers_that_are_drawn_into_one_another_are_told_by_name() -> None:
    with pytest.raises(InputError, match=r"'drawer_\w+' and 'drawer_\w+' overlap by 3\.\d+ mm"):
        Contacts(case("furniture_drawer")).require()


def test_edges_are_dense_and_flat_places_nearly_empty() -> None:
    mesh = trimesh.creation.box((0.1, 0.03, 0.02)).subdivide().subdivide().subdivide().subdivide()  # flat all the same
    shape = shape_of(mesh)
    cloud = cloud_of(shape.surface(), field_of(shape), 0.002)
    half = np.array([0.05, 0.015, 0.01])
    on_edge = (np.abs(np.abs(cloud.points) - half) < 1e-9).sum(axis=1) >= 2
    assert (~on_edge).sum() < 400 < on_edge.sum()
    for axis in range(3):
        for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            others = [k for k in range(3) if k != axis]
            along = np.all(np.abs(cloud.points[:, others] - half[others] * signs) < 1e-9, axis=1)
            places = np.sort(cloud.points[along, axis])
            assert np.diff(places).max() < 0.0015 and places[-1] == -places[0] == half[axis]


@pytest.mark.parametrize("turned", [False, True], ids=["as drawn", "inside out"])
def test_a_sweep_by_the_points_that_matter_finds_what_one_by_all_points_finds(turned: bool) -> None:
    """Also where triangles are turned the wrong way round: the field tells the side."""
    rng = np.random.default_rng(2)
    solids = [
        trimesh.creation.box((0.03, 0.02, 0.05)),
        ring(0.012, 0.02, 0.02),
        trimesh.creation.icosphere(3, 0.015),
        trimesh.creation.cylinder(0.008, 0.06, sections=20),
    ]
    if turned:
        for solid in solids:
            solid.invert()
    bodies = [body_of(shape_of(solid)) for solid in solids]
    dense = [surface_points(body.surface, 0.0004) for body in bodies]
    met = 0
    for _ in range(60):
        i, j = rng.integers(4, size=2)
        T = trimesh.transformations.random_rotation_matrix(rng.random(3))
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        T[:3, 3] = -0.08 * direction + rng.normal(0, 0.012, 3)
        back = np.linalg.inv(T)
        here = -back[:3, :3] @ direction
        kept = float(rng.choice([-2e-4, 1e-3]))
        placed = [dense[j] @ T[:3, :3].T + T[:3, 3], dense[i] @ back[:3, :3].T + back[:3, 3]]
        truth = min(
            first_hit(bodies[i].field, placed[0], direction, kept, 0.2),
            first_hit(bodies[j].field, placed[1], here, kept, 0.2),
        )
        found = min(
            cloud_hit(bodies[i].field, bodies[j].cloud, T, direction, kept, 0.2),
            cloud_hit(bodies[j].field, bodies[i].cloud, back, here, kept, 0.2),
        )
        assert (truth < 0.2) == (found < 0.2) or abs(truth - found) < 1e-3
        if truth < 0.2:
            met += 1
            assert found == pytest.approx(truth, abs=8e-4)
    assert met > 20


def test_plates_that_slide_on_one_another_meet_nothing_and_are_found_to_touch() -> None:
    plate = shape_of(trimesh.creation.box((0.3, 0.3, 0.01)))
    body = body_of(plate)
    T = np.eye(4)
    T[2, 3] = 0.01
    assert abs(cloud_distance(body.field, body.cloud, T, 0.01)) < FIELD_ERROR * body.field.step
    for direction in ([1.0, 0.0, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]):
        assert cloud_hit(body.field, body.cloud, T, np.array(direction), -3e-4, 1.0) == np.inf
    assert cloud_hit(body.field, body.cloud, T, np.array([0.0, 0.6, -0.8]), -3e-4, 1.0) < 1e-3


def test_ways_end_where_stepping_finds_covers_apart() -> None:
    rng, apart, least, beyond = np.random.default_rng(9), 0.005, 0.01, 1e-5
    own, others = (np.sort(rng.uniform(-0.05, 0.05, (count, 2, 3)), axis=1) for count in (3, 8))
    covers, counted = covers_of(list(others.reshape(4, 2, 2, 3))), np.array([True, True, True, False])
    steps = np.linspace(0, 0.3, 30_001)
    directions = rng.normal(size=(20, 3))
    directions[:2] = [[0.0, 0.0, 1.0], [0.6, -0.8, 0.0]]
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    hits = np.where(rng.uniform(size=(20, 4)) < 0.6, rng.uniform(0, 0.05, (20, 4)), np.inf)
    hits[:10] = np.inf
    found = clear_after(own, covers, counted, directions, hits, Way(apart, least, beyond, 0.3))
    passed = pass_near(own, others, directions, apart, np.full(20, 0.3))
    shortened = 0
    for direction, hit, length, passing in zip(directions, hits, found.tolist(), passed, strict=True):
        moved = own[:, None, None] + steps[None, None, :, None, None] * direction
        near = (
            (others[None, :, None, 0] - moved[..., 1, :] < apart)
            & (moved[..., 0, :] - others[None, :, None, 1] < apart)
        ).all(axis=-1)  # (3, 8, steps)
        assert (passing == near.any(axis=-1)).all()
        body = near.any(axis=0).reshape(4, 2, -1).any(axis=1) & counted[:, None]
        clear = ~(body & (hit[:, None] > steps)).any(axis=0) & (steps >= least)
        assert clear[np.searchsorted(steps, length)] or clear[np.searchsorted(steps, length) - 1]
        assert near_at(own, covers, counted, direction, hit, apart, length).sum() == 0
        if (hit == np.inf).all():
            assert length == pytest.approx(steps[clear.argmax()], abs=3e-5)
        shortened += length < steps[(~body.any(axis=0) & (steps >= least)).argmax()] - 1e-4
    assert shortened > 2
