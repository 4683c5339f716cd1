"""Kernels of contact against formulas for single points, on bodies so small that they are quick uncompiled too."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial.transform import Rotation

from takeapart.collision import grids
from takeapart.collision.bounds import _near_from, _near_until
from takeapart.collision.contact import NEAR, Body, _least_distance
from takeapart.collision.fields import Field, mesh_field, signed_distances, surface_points
from takeapart.collision.meeting import cloud_distance, cloud_hit, points_below
from takeapart.collision.parting import nearer_than, parted_after
from takeapart.collision.points import IN_LEAF, Cloud, cloud_of
from takeapart.collision.screws import Screw
from takeapart.collision.sweep import LEAST_STEP
from takeapart.collision.triangles import distances, triangle_tree
from takeapart.model.geometry import Array, TriangleMesh, pose

STEP = 1e-3  # m


@pytest.fixture(autouse=True)
def coarse_grids(monkeypatch: pytest.MonkeyPatch) -> None:
    """A few thousand nodes are enough."""
    monkeypatch.setattr(grids, "FINEST", STEP)
    monkeypatch.setattr(grids, "BAND", 2 * STEP)


def surface(mesh: trimesh.Trimesh) -> TriangleMesh:
    return TriangleMesh(np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int32))


def bodies() -> Iterator[trimesh.Trimesh]:
    rng = np.random.default_rng(3)
    yield trimesh.convex.convex_hull(rng.uniform(-0.004, 0.004, (9, 3)))
    yield trimesh.creation.annulus(0.0015, 0.004, 0.003, sections=6)
    turned = trimesh.creation.box((0.009, 0.004, 0.002))
    turned.apply_transform(trimesh.transformations.random_rotation_matrix(rng.uniform(size=3)))
    yield turned


def from_segments(points: Array, a: Array, b: Array) -> Array:
    """(N, T) m, of points (N, 3) from segments (T, 3), (T, 3)."""
    along = b - a
    share = ((points[:, None] - a) * along).sum(axis=2) / np.maximum((along * along).sum(axis=1), 1e-300)
    return np.linalg.norm(points[:, None] - a - np.clip(share, 0, 1)[:, :, None] * along, axis=2)


def exact_distances(points: Array, corners: Array) -> Array:
    """(N,) m, of points (N, 3) from triangles (T, 3, 3): the plane's where the foot is inside, else the edges'."""
    edges = np.min([from_segments(points, corners[:, k], corners[:, (k + 1) % 3]) for k in range(3)], axis=0)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal, axis=1)
    normal = normal / np.maximum(size, 1e-300)[:, None]
    inside = np.broadcast_to(size > 1e-14, (len(points), len(corners))).copy()
    for k in range(3):
        inward = np.cross(normal, corners[:, (k + 1) % 3] - corners[:, k])
        inside &= ((points[:, None] - corners[:, k]) * inward).sum(axis=2) >= 0
    height = np.abs(((points[:, None] - corners[:, 0]) * normal).sum(axis=2))
    return np.asarray(np.where(inside, height, edges).min(axis=1))


def windings(points: Array, corners: Array) -> Array:
    """(N,) how often the surface goes around each point: 1 inside, 0 outside (Van Oosterom and Strackee 1983)."""
    a, b, c = (corners[None, :, k] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    volume = (a * np.cross(b, c)).sum(axis=2)
    whole = la * lb * lc + (a * b).sum(axis=2) * lc + (b * c).sum(axis=2) * la + (c * a).sum(axis=2) * lb
    return np.asarray(np.arctan2(volume, whole).sum(axis=1) / (2 * np.pi))


def exact_signed(points: Array, mesh: trimesh.Trimesh) -> Array:
    corners = np.array(mesh.triangles)
    return np.where(windings(points, corners) > 0.5, -1.0, 1.0) * exact_distances(points, corners)


@pytest.mark.parametrize("mesh", list(bodies()), ids=["hull", "ring", "box"])
def test_every_node_of_a_grid_knows_its_distance_and_side(mesh: trimesh.Trimesh) -> None:
    grid = grids.distance_grid(surface(mesh))
    assert grid.step == STEP and grid.band == 3 * STEP
    numbers = np.indices(grid.values.shape).reshape(3, -1).T
    exact = exact_signed(grid.origin + numbers * grid.step, mesh)
    expected = np.clip(exact, -grid.band, grid.band) / grids.UNIT
    off = np.abs(grid.values.ravel() - expected)
    assert off.max() <= 1.0 + 1e-6, "but for what whole numbers leave over"
    assert (np.sign(grid.values.ravel()) == np.sign(exact))[np.abs(exact) > 2e-6].all()
    assert (np.abs(exact) < grid.band).sum() > 500 and (exact < 0).sum() > 30
    assert (exact.reshape(grid.values.shape)[[0, -1]] > grid.band).all(), "the band lies within the grid"
    blocks = np.indices(grid.coarse.shape).reshape(3, -1).T
    middles = exact_distances(grid.origin + (blocks * 8 + 3.5) * grid.step, np.array(mesh.triangles))
    assert np.abs(np.abs(grid.coarse.ravel()) - middles).max() < 1e-7


@pytest.mark.parametrize("mesh", list(bodies()), ids=["hull", "ring", "box"])
def test_a_field_interpolates_between_nodes_and_is_a_bound_beyond_its_band(mesh: trimesh.Trimesh) -> None:
    grid, field = grids.distance_grid(surface(mesh)), mesh_field(surface(mesh))
    axes = [grid.origin[k] + grid.step * np.arange(grid.values.shape[k]) for k in range(3)]
    between = RegularGridInterpolator(axes, grid.values * grids.UNIT)
    points = np.random.default_rng(1).uniform([each[0] for each in axes], [each[-1] for each in axes], (600, 3))
    found, expected = signed_distances(field, points), between(points)
    near = np.abs(expected) < 0.99 * field.band
    assert near.sum() > 100
    np.testing.assert_allclose(found[near], expected[near], atol=1e-12)
    points = np.concatenate([points, np.random.default_rng(2).uniform(-0.04, 0.04, (200, 3))])
    exact, found = exact_signed(points, mesh), signed_distances(field, points)
    beyond = exact > field.band + field.step
    assert beyond.sum() > 150
    assert (found[beyond] <= exact[beyond] + 1e-9).all(), "never further than it is"
    assert (found[beyond] >= 0.99 * field.band).all()
    outside = np.maximum(np.abs(points - field.middle) - field.half, 0.0)
    assert (found[beyond] >= np.linalg.norm(outside, axis=1)[beyond]).all(), "at least as far as from the grid"


def test_distances_from_triangles_are_those_of_planes_and_edges() -> None:
    rng = np.random.default_rng(2)
    for count in (1, 5, 23):
        corners = rng.uniform(-1, 1, (count, 3, 3))
        corners[1::4, 2] = (corners[1::4, 0] + corners[1::4, 1]) / 2  # a line
        mesh = TriangleMesh(corners.reshape(-1, 3), np.arange(3 * count, dtype=np.int32).reshape(-1, 3))
        points = np.concatenate([rng.uniform(-2, 2, (80, 3)), corners.mean(axis=1), corners[:, 0]])
        expected = exact_distances(points, corners)
        tree = triangle_tree(mesh)
        np.testing.assert_allclose(distances(points, tree, 10.0), expected, atol=1e-7)
        np.testing.assert_allclose(distances(points, tree, 0.5), np.minimum(expected, 0.5), atol=1e-7)


def test_bounds_pass_each_other_from_where_to_where_single_steps_say() -> None:
    rng = np.random.default_rng(9)
    own, others = (np.sort(rng.uniform(-0.05, 0.05, (3, 2, 3)), axis=1) for _ in range(2))
    steps = np.linspace(0, 0.2, 4001)
    pairs = 0
    for direction in (np.array([0.0, 0.0, -1.0]), np.array([0.6, -0.8, 0.0]), np.array([-0.48, 0.6, 0.64])):
        expected = []
        for a in own:
            for b in others:
                moved = a[None] + steps[:, None, None] * direction
                near = ((b[0] - moved[:, 1] < 0.005) & (moved[:, 0] - b[1] < 0.005)).all(axis=1)
                expected += [steps[near]] if near.any() else []
        x, y, z = direction
        found = [
            (enter, _near_until(own, k, others, other, x, y, z, 0.005))
            for k in range(len(own))
            for other in range(len(others))
            if (enter := _near_from(own, k, others, other, x, y, z, 0.005)) < np.inf
        ]
        assert len(found) == len(expected)
        pairs += len(found)
        for (enter, leave), seen in zip(found, expected, strict=True):
            assert seen[0] == pytest.approx(max(enter, 0.0), abs=1e-4)
            assert seen[-1] == pytest.approx(min(leave, 0.2), abs=1e-4)
    assert pairs > 8


def test_points_all_over_a_surface_hold_every_corner_and_leave_no_place_alone() -> None:
    rod = trimesh.creation.cylinder(0.001, 0.004, sections=40)  # corners nearer to each other than points need be
    for mesh in (*bodies(), rod):
        corners = np.array(mesh.triangles)
        for spacing in (0.0004, 0.01):
            points = surface_points(surface(mesh), spacing)
            assert exact_distances(points, corners).max() < 1e-12
            for vertex in mesh.vertices:
                assert np.linalg.norm(points - vertex, axis=1).min() < 1e-12
        rng = np.random.default_rng(0)
        places = (corners * rng.dirichlet(np.ones(3), len(corners))[:, :, None]).sum(axis=1)
        points = surface_points(surface(mesh), 0.0004)
        assert max(np.linalg.norm(points - place, axis=1).min() for place in places) < 0.0006


@pytest.mark.parametrize("mesh", list(bodies()), ids=["hull", "ring", "box"])
def test_a_cloud_follows_all_edges_and_leaves_out_only_what_faces_backwards(mesh: trimesh.Trimesh) -> None:
    spacing = 0.0006
    cloud = cloud_of(surface(mesh), mesh_field(surface(mesh)), spacing)
    corners = np.array(mesh.triangles)
    assert exact_distances(cloud.points, corners).max() < 1e-12
    for vertex in mesh.vertices:
        assert np.linalg.norm(cloud.points - vertex, axis=1).min() < 1e-12
    for (a, b), angle in zip(mesh.face_adjacency_edges, mesh.face_adjacency_angles, strict=True):
        if angle > 0.01:
            along = mesh.vertices[a] + np.linspace(0, 1, 17)[:, None] * (mesh.vertices[b] - mesh.vertices[a])
            gaps = np.linalg.norm(along[:, None] - cloud.points[None], axis=2).min(axis=1)
            assert gaps.max() < 0.8 * spacing
    touching = np.stack([exact_distances(cloud.points, corner[None]) < 1e-9 for corner in corners], axis=1)
    left_out = 0
    for direction in np.random.default_rng(0).normal(size=(40, 3)):
        direction /= np.linalg.norm(direction)
        backwards = np.maximum(cloud.facing[:, :3] @ direction, cloud.facing[:, 3:6] @ direction) < -cloud.facing[:, 6]
        forwards = touching & (mesh.face_normals @ direction > 1e-3)
        assert not forwards[backwards].any()
        left_out += backwards.sum()
    assert left_out > 4 * len(cloud.points), "of 40 times"


@pytest.mark.parametrize("mesh", list(bodies()), ids=["hull", "ring", "box"])
def test_the_tree_of_a_cloud_holds_what_is_below_each_node(mesh: trimesh.Trimesh) -> None:
    cloud = cloud_of(surface(mesh), mesh_field(surface(mesh)), 0.0006)
    count = -(-len(cloud.points) // IN_LEAF)
    assert count <= cloud.leaves < 2 * count, "no more levels than needed"
    directions = np.random.default_rng(0).normal(size=(60, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    for node in range(1, 2 * cloud.leaves):
        below = below_node(cloud, node)
        apart = np.linalg.norm(cloud.points[below] - cloud.balls[node, :3], axis=1)
        if len(below):
            assert apart.max() <= cloud.balls[node, 3] + 1e-12
            assert apart.max() >= 0.5 * cloud.balls[node, 3] - 1e-12
            backwards = directions[directions @ cloud.cones[node, :3] < -cloud.cones[node, 3]]
            facing = cloud.facing[below]
            sides = np.maximum(facing[:, :3] @ backwards.T, facing[:, 3:6] @ backwards.T)
            assert (sides < -facing[:, 6:7] + 1e-9).all()


def below_node(cloud: Cloud, node: int) -> NDArray[np.int64]:
    """Numbers of the points in the leaves below a node."""
    first, last = node, node
    while first < cloud.leaves:
        first, last = 2 * first, 2 * last + 1
    start, end = (first - cloud.leaves) * IN_LEAF, (last - cloud.leaves + 1) * IN_LEAF
    return np.arange(start, min(end, len(cloud.points)))


def stepped(field: Field, cloud: Cloud, T: Array, direction: Array, kept: float, travel: float) -> float:
    """When a point that does not face backwards is nearer than `kept`, by equal small steps."""
    forward = cloud.facing[:, :6].reshape(-1, 2, 3) @ (T[:3, :3].T @ direction)
    points = cloud.points[forward.max(axis=1) >= -cloud.facing[:, 6]] @ T[:3, :3].T + T[:3, 3]
    for t in np.arange(0.0, travel, 5e-5):
        if (signed_distances(field, np.ascontiguousarray(points + t * direction)) < kept).any():
            return float(t)
    return math.inf


def test_what_a_cloud_meets_and_how_near_it_is_are_those_of_single_points() -> None:
    first, second, _ = bodies()
    field = mesh_field(surface(first))
    cloud = cloud_of(surface(second), mesh_field(surface(second)), 0.002)
    rng = np.random.default_rng(5)
    hits = misses = near = 0
    for k in range(8):
        T = pose(rng.normal(size=3))
        T[:3, 3] *= 0.009 / np.linalg.norm(T[:3, 3])
        T[:3, :3] = trimesh.transformations.random_rotation_matrix(rng.uniform(size=3))[:3, :3]
        direction = -T[:3, 3] / np.linalg.norm(T[:3, 3]) if k % 3 else rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        kept = (-2e-4, 0.0, 3e-4)[k % 3]
        found = cloud_hit(field, cloud, T, direction, kept, 0.012)
        expected = stepped(field, cloud, T, direction, kept, 0.012)
        assert math.isinf(found) == math.isinf(expected)
        hits, misses = hits + math.isfinite(found), misses + math.isinf(found)
        if math.isfinite(found):
            assert abs(found - expected) < 2e-4 + LEAST_STEP
            T[:3, 3] += (found - 2e-4) * direction
        placed = np.ascontiguousarray(cloud.points @ T[:3, :3].T + T[:3, 3])
        signed = signed_distances(field, placed)
        assert cloud_distance(field, cloud, T, NEAR) == pytest.approx(min(signed.min(), NEAR), abs=1e-12)
        below = points_below(field, cloud, T, 1e-3)
        assert len(below) == (signed < 1e-3).sum()
        near += len(below)
        if len(below):
            assert np.allclose(np.sort(signed_distances(field, below)), np.sort(signed[signed < 1e-3]), atol=1e-12)
    assert hits > 3 and misses > 1 and near > 5


@pytest.mark.parametrize("gap", [-4e-4, 1e-4, 2.5e-3, 4.5e-3, 8e-3])
def test_the_least_distance_of_two_bodies_is_exact_or_that_of_pairs_no_longer_told(gap: float) -> None:
    block, spike = trimesh.creation.box((0.008, 0.008, 0.004)), trimesh.creation.cone(0.002, 0.004, sections=5)
    spike.apply_transform(trimesh.transformations.rotation_matrix(np.pi, (1, 0, 0)))  # its tip points down
    tip = spike.vertices[:, 2].min()
    body = Body(mesh_field(surface(block)), surface(block))
    cloud = cloud_of(surface(spike), mesh_field(surface(spike)), 0.001)
    T = pose((3e-4, -2e-4, 0.002 + gap - tip))
    assert _least_distance(body, cloud, T) == pytest.approx(min(gap, NEAR), abs=1e-9)


def test_bodies_have_parted_where_single_steps_say() -> None:
    first, second, _ = bodies()
    field = mesh_field(surface(first))
    points = surface_points(surface(second), 0.002)
    rng = np.random.default_rng(7)
    for k in range(6):
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        start, apart = (0.0, 0.002)[k % 2], (5e-4, 1.2e-3, 0.0)[k % 3]
        moved = np.ascontiguousarray(points + rng.uniform(-0.001, 0.001, 3))
        steps = np.arange(start, 0.03, 1e-4)
        least = np.array([signed_distances(field, moved + s * direction).min() for s in steps])
        expected = steps[least >= apart][0]
        found = parted_after(field, moved, direction, start, apart, 0.03)
        assert expected - 1e-4 <= found <= expected + 1e-4 + LEAST_STEP
        assert math.isinf(parted_after(field, moved, direction, start, apart, expected - 1e-3))
        T = pose((expected + 1e-3) * direction)
        nearest = signed_distances(field, np.ascontiguousarray(moved + T[:3, 3])).min()
        assert nearer_than(field, moved, T, nearest + 1e-9) and not nearer_than(field, moved, T, nearest - 1e-9)


def test_a_screw_meets_what_single_poses_of_it_meet() -> None:
    first, second, _ = bodies()
    field = mesh_field(surface(first))
    points = surface_points(surface(second), 0.002)
    rng = np.random.default_rng(8)
    met = 0
    for k in range(9):
        axis, center = rng.normal(size=3), rng.uniform(-0.01, 0.01, 3)
        axis /= np.linalg.norm(axis)
        screw = Screw((0.002 * axis, np.zeros(3), -0.02 * axis)[k % 3], (2.0, -1.5, 0.0)[k % 3], axis, center)
        shift = rng.normal(size=3)
        shift *= 0.009 / np.linalg.norm(shift)
        if k % 3 == 2:
            shift = 0.01 * axis + rng.uniform(-0.002, 0.002, 3)
        moved = np.ascontiguousarray(points + shift)
        expected = 1.0
        for s in np.arange(0.0, 1.0, 0.004):
            T = screw.pose(s)
            if (signed_distances(field, np.ascontiguousarray(moved @ T[:3, :3].T + T[:3, 3])) < -1e-4).any():
                expected = s
                break
        found = screw.travel(field, moved, 1.0, -1e-4)
        assert found == pytest.approx(expected, abs=0.03)
        assert (found < 1.0) == (expected < 1.0)
        met += found < 1.0
        T, back = screw.pose(0.7), screw.backwards().pose(0.7)
        assert np.allclose(T @ back, np.eye(4), atol=1e-12)
        assert np.allclose(T[:3, :3] @ axis, axis), "its axis stays"
        turned = Rotation.from_rotvec(0.7 * screw.turn * axis).as_matrix()
        assert np.allclose(T[:3, :3], turned)
        assert np.allclose(T[:3, :3] @ center + T[:3, 3], center + 0.7 * screw.along)
    assert 2 < met < 9
