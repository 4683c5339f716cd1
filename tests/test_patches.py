"""Points of contact against shapes whose points are known, and against geometry written out point by point."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from conftest import random_rotation
from takeapart.model.assembly import Assembly, Part
from takeapart.model.geometry import Array, Box, TriangleMesh
from takeapart.model.meshes import Mesh
from takeapart.stability.facets import facets_of
from takeapart.stability.patches import FLAT, _inset, contact_patches


def spikes(tips: Array) -> trimesh.Trimesh:
    """Steep cones of small triangles, 2 mm high, that point down; their rims at height 2 mm, with nothing between."""
    cones = []
    for tip in tips:
        cone = trimesh.creation.cone(0.0012, 0.002, sections=7).subdivide().subdivide()
        cone.apply_scale((1.0, 1.0, -1.0))
        cone.fix_normals()
        cone.apply_translation(tip - np.array([0.0, 0.0, -0.002]))
        cones.append(cone)
    joined = trimesh.util.concatenate(cones)
    assert isinstance(joined, trimesh.Trimesh)
    return joined


@pytest.mark.parametrize("plate_first", [True, False])
def test_spikes_touch_a_plate_at_their_tips_and_nowhere_else(plate_first: bool) -> None:
    """Points of the cones up to 1 mm above the plate are within the gap too, but each has a lower one beside it."""
    rng = np.random.default_rng(4)
    for _ in range(5):
        tips = np.column_stack([rng.uniform(-0.03, 0.03, (3, 2)), rng.uniform(0.0, 4e-4, 3)])
        mesh = spikes(tips)
        assert (np.abs(mesh.vertices[:, 2] - 5e-4) < 4e-4).sum() > 20, "points that are near and no tips"
        surface = TriangleMesh(np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int32))
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = random_rotation(rng), rng.uniform(-1, 1, 3)
        plate_T = T.copy()
        plate_T[:3, 3] -= 0.01 * T[:3, 2]
        plate = Part("plate", Box((0.1, 0.1, 0.02)), plate_T, 1.0, fixed=True)
        body = Part("spikes", Mesh(surface), T, 0.01)
        parts = (plate, body) if plate_first else (body, plate)
        patches = contact_patches(Assembly("scene", parts, contact_gap=1e-3))
        found = np.concatenate([patch.points for patch in patches])
        local = (found - T[:3, 3]) @ T[:3, :3]
        assert len(found) == 3
        for tip in tips:
            nearest = np.linalg.norm(local - tip * [1.0, 1.0, 0.5], axis=1).min()  # halfway between both
            assert nearest < 1e-6
        up = np.concatenate([patch.normals for patch in patches]) @ T[:3, 2] * (-1 if plate_first else 1)
        assert np.allclose(up, 1.0), "the plate pushes up"


def test_how_far_inside_of_its_facet_a_point_is_counts_edges_where_the_surface_bends() -> None:
    rng = np.random.default_rng(0)
    bodies = [trimesh.convex.convex_hull(rng.normal(size=(12, 3))) for _ in range(3)]
    bodies.append(trimesh.creation.box((1.0, 2.0, 3.0)))  # diagonals of its faces are no bends
    for body in bodies:
        facets = facets_of(np.array(body.triangles))
        rows = rng.integers(0, len(facets.triangles), 60)
        weights = rng.dirichlet(np.ones(3), 60)
        points = (facets.corners[rows] * weights[:, :, None]).sum(axis=1)
        found = _inset(facets, rows, points)
        for row, point, inset in zip(rows, points, found, strict=True):
            distances = [1.0]
            for k in range(3):
                p, q = facets.corners[row, k], facets.corners[row, (k + 1) % 3]
                (other,) = [
                    t
                    for t, triangle in enumerate(facets.triangles)
                    if t != row and {*facets.triangles[row, [k, (k + 1) % 3]]} <= {*triangle}
                ]
                if facets.normals[row] @ facets.normals[other] < np.cos(FLAT):
                    distances.append(float(np.linalg.norm(np.cross(q - p, point - p)) / np.linalg.norm(q - p)))
            assert inset == pytest.approx(min(distances), abs=1e-9)
