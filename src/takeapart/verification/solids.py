"""Exact surfaces for the judge: distances by FCL on all triangles, overlaps by manifold3d.

What is not closed has no inside: for it depth is what FCL measures where surfaces cross.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.spatial import ConvexHull

from takeapart.model.errors import MissingExtraError
from takeapart.model.geometry import Array, TriangleMesh, pose_inverse

try:
    import fcl
    import manifold3d
except ImportError as missing:
    raise MissingExtraError("verification of meshes", "verify", "manifold3d and python-fcl") from missing

TOUCHING = 1e-8  # m; surfaces closer than this are asked how deep they overlap
MOST_CONTACTS = 2000  # of open surfaces that cross


class Solid:
    """One surface in the frame of its body.

    Args:
        surface: its triangles.
        is_mesh: whether it is the surface of a mesh part; pairs without one are not judged here.
    """

    def __init__(self, surface: TriangleMesh, is_mesh: bool = True) -> None:
        self.surface, self.is_mesh = surface, is_mesh
        model = fcl.BVHModel()
        model.beginModel(len(surface.vertices), len(surface.triangles))
        model.addSubModel(surface.vertices, surface.triangles)
        model.endModel()
        self.model = model
        low, high = surface.bounds
        self.middle, self.half = (low + high) / 2, (high - low) / 2  # (3,) m

    @cached_property
    def manifold(self) -> manifold3d.Manifold | None:
        """The body inside; None where the surface is not closed."""
        rounded, numbers = np.unique(np.round(self.surface.vertices, 9), axis=0, return_inverse=True)
        triangles = numbers.reshape(-1)[self.surface.triangles]
        a, b, c = triangles.T
        triangles = triangles[(a != b) & (b != c) & (c != a)]
        found = manifold3d.Manifold(manifold3d.Mesh64(rounded, triangles.astype(np.uint64)))
        closed = found.status() == manifold3d.Error.NoError and _is_closed(triangles)
        return found if closed and found.volume() > 0 else None

    def placed(self, T: Array) -> fcl.CollisionObject:
        """The surface at a pose (4, 4)."""
        return fcl.CollisionObject(self.model, fcl.Transform(np.ascontiguousarray(T[:3, :3]), T[:3, 3]))

    def corners(self) -> Array:
        """(8, 3) m, of the box around it along the axes of its frame."""
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
        return np.asarray(self.middle + signs * self.half)


def hull_solid(points: Array) -> Solid:
    """The convex hull of points (V, 3), m."""
    hull = ConvexHull(points)
    triangles = hull.simplices.astype(np.int32)
    a, b, c = points[triangles].swapaxes(0, 1)
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return Solid(TriangleMesh(np.asarray(points, dtype=float), triangles), is_mesh=False)


def separation(a: Solid, T_a: Array, b: Solid, T_b: Array) -> float:
    """Distance of two solids, m; where they overlap, minus the depth."""
    x, y = a.placed(T_a), b.placed(T_b)
    distance = float(fcl.distance(x, y, fcl.DistanceRequest(), fcl.DistanceResult()))
    if distance > TOUCHING and not _bounds_overlap(a, T_a, b, T_b):
        return distance
    if a.manifold is None or b.manifold is None:
        return distance if distance > TOUCHING else -_crossing(x, y)
    depth = _depth(a, b, pose_inverse(T_b) @ T_a)
    return -depth if depth > 0 else max(distance, 0.0)


def shared_volume(a: Solid, T_a: Array, b: Solid, T_b: Array) -> float:
    """Volume, m^3, that two closed solids have in common; 0 where one is open."""
    if a.manifold is None or b.manifold is None:
        return 0.0
    T = pose_inverse(T_b) @ T_a
    return max(float((a.manifold.transform(T[:3]) ^ b.manifold).volume()), 0.0)


def _depth(a: Solid, b: Solid, T_b_a: Array) -> float:
    """How deep a is in b, m: of every piece of the overlap its mean thickness 2 V / A or, if greater, the distance of a
    corner, or of a middle of an edge or a triangle, of its surface from the other body's. A point at depth d has a ball
    of that radius in the other body, so slivers of no volume, which exact arithmetic finds between flush faces, count
    for no more than their volume allows."""
    assert a.manifold is not None and b.manifold is not None
    overlap = a.manifold.transform(T_b_a[:3]) ^ b.manifold
    if overlap.is_empty() or overlap.volume() <= 0:
        return 0.0
    deepest = 0.0
    own, other = a.placed(T_b_a), b.placed(np.eye(4))
    for piece in overlap.decompose():
        volume, area = float(piece.volume()), float(piece.surface_area())
        if volume <= 0 or area <= 0:
            continue
        deepest = max(deepest, 2 * volume / area)
        cap = (30 * volume) ** (1 / 3)  # a sharp corner of 0.1 sr
        if cap <= deepest:
            continue
        mesh = piece.to_mesh64()
        corners = np.asarray(mesh.vert_properties)[:, :3]
        three = corners[np.asarray(mesh.tri_verts, dtype=np.intp)]  # (T, 3, 3) m
        middles = (three + np.roll(three, 1, axis=1)).reshape(-1, 3) / 2
        long = np.linalg.norm(three - np.roll(three, 1, axis=1), axis=2).ravel() > deepest
        for point in np.vstack([three.mean(axis=1), corners, middles[long]]):
            ball = fcl.CollisionObject(fcl.Sphere(1e-9), fcl.Transform(point))
            away = max(fcl.distance(ball, body, fcl.DistanceRequest(), fcl.DistanceResult()) for body in (own, other))
            deepest = max(deepest, min(float(away), cap))
    return deepest


def _crossing(x: fcl.CollisionObject, y: fcl.CollisionObject) -> float:
    """How deep two surfaces cross, m, by the triangles that cross."""
    result = fcl.CollisionResult()
    fcl.collide(x, y, fcl.CollisionRequest(num_max_contacts=MOST_CONTACTS, enable_contact=True), result)
    return max((abs(float(contact.penetration_depth)) for contact in result.contacts), default=0.0)


def _bounds_overlap(a: Solid, T_a: Array, b: Solid, T_b: Array) -> bool:
    """Whether the boxes around both, along the world's axes, overlap: then one may be inside the other."""
    apart = np.abs(T_a[:3, :3] @ a.middle + T_a[:3, 3] - T_b[:3, :3] @ b.middle - T_b[:3, 3])
    return bool((apart <= np.abs(T_a[:3, :3]) @ a.half + np.abs(T_b[:3, :3]) @ b.half).all())


def _is_closed(triangles: Array) -> bool:
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    _, counts = np.unique(edges, axis=0, return_counts=True)
    there = set(map(tuple, edges.tolist()))
    return bool((counts == 1).all()) and all((v, u) in there for u, v in there)
