"""Bodies by their exact triangles: distances of surfaces with FCL, what two solids have in common with manifold3d.

Nothing here knows the boxes or fields that the planner works with. Distances of surfaces are those of FCL's bounding
volume hierarchies (Pan, Chitta, Manocha: FCL, ICRA 2012); how deep bodies are in each other is measured on their
common volume by manifold3d's exact booleans.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from takeapart.model.errors import MissingExtraError
from takeapart.model.geometry import Array, TriangleMesh

NOTHING_IN_COMMON = 1e-15  # m^3; common volumes below are rounding
POINT = 1e-7  # m, radius of the ball that stands for a point
MOST_CROSSINGS = 300  # pairs of triangles of open surfaces that are looked at
ON_TRIANGLE = np.array([[i, j, 4 - i - j] for i in range(5) for j in range(5 - i)]) / 4  # (15, 3) barycentric
TOUCHES = 1e-9  # m; surfaces nearer than this are taken to meet


@dataclass(frozen=True, eq=False)
class Solid:
    """A body by its surface.

    Args:
        surface: closed, or not: then `is_closed` is False, and depth is known less well, see `crossing_depth`.
    """

    surface: TriangleMesh

    @cached_property
    def tree(self) -> Any:
        """FCL's hierarchy of the triangles."""
        fcl = _fcl()
        model = fcl.BVHModel()
        triangles = self.surface.triangles
        model.beginModel(len(self.surface.vertices), len(triangles))
        model.addSubModel(np.asarray(self.surface.vertices, dtype=float), np.asarray(triangles, dtype=np.int64))
        model.endModel()
        return model

    @cached_property
    def volume(self) -> Any:
        """Manifold of the inside, in the body's frame; empty where the surface is open."""
        manifold3d = _manifold()
        surface = self.surface
        vertices, number = np.unique(surface.vertices, axis=0, return_inverse=True)
        triangles = number.reshape(-1)[surface.triangles]
        found = manifold3d.Manifold(
            manifold3d.Mesh64(np.ascontiguousarray(vertices), np.ascontiguousarray(triangles, dtype=np.uint64))
        )
        if found.status() != manifold3d.Error.NoError:  # corners that coincide, but are not one
            found = manifold3d.Manifold(
                manifold3d.Mesh64(
                    np.ascontiguousarray(surface.vertices), np.ascontiguousarray(surface.triangles, dtype=np.uint64)
                )
            )
        return found if found.status() == manifold3d.Error.NoError else manifold3d.Manifold()

    @cached_property
    def is_closed(self) -> bool:
        """Whether the surface encloses a volume, so that what is inside can be told."""
        return not self.volume.is_empty() and bool(self.volume.volume() > 0)

    @cached_property
    def bounds(self) -> Array:
        """(2, 3) m, in the body's frame: least and greatest coordinates."""
        corners = self.surface.vertices[np.unique(self.surface.triangles)]
        return np.array([corners.min(axis=0), corners.max(axis=0)])


def hull_solid(points: Array) -> Solid:
    """The convex hull of points (N, 3), m."""
    hull = ConvexHull(points)
    triangles = hull.simplices.copy()
    a, b, c = np.moveaxis(hull.points[triangles], 1, 0)
    inward = np.einsum("ti,ti->t", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return Solid(TriangleMesh(hull.points, triangles.astype(np.int32)))


def solid_distance(first: Solid, T_first: Array, second: Solid, T_second: Array) -> float:
    """Distance of two bodies at poses (4, 4), m; negative by how deep they are in each other, see `overlap_depth`."""
    fcl = _fcl()
    trees = _placed_tree(first, T_first), _placed_tree(second, T_second)
    gap = float(fcl.distance(*trees, fcl.DistanceRequest(), fcl.DistanceResult()))
    if gap > TOUCHES and not _one_may_hold_the_other(first, T_first, second, T_second):
        return gap
    if not (first.is_closed and second.is_closed):
        return gap if gap > TOUCHES else -crossing_depth(first, T_first, second, T_second)
    depth = overlap_depth(first, T_first, second, T_second)
    return -depth if depth > 0 else max(gap, 0.0)


def overlap_depth(first: Solid, T_first: Array, second: Solid, T_second: Array) -> float:
    """How deep two closed bodies are in each other, m; 0 where they share nothing.

    The greater of two measures of what they have in common. Of each of its pieces twice the volume over the surface:
    the thickness of a thin layer, piece by piece, so that a wide and shallow overlap does not hide a narrow and deep
    one. And how far the corners and the middles of its triangles are from the surface of either body, which tells how
    deep a tip or an edge is in the other.
    """
    common = placed(first, T_first) ^ placed(second, T_second)
    if common.is_empty() or common.volume() <= NOTHING_IN_COMMON:
        return 0.0
    pieces = [piece for piece in common.decompose() if piece.volume() > NOTHING_IN_COMMON and piece.surface_area() > 0]
    if not pieces:
        return 0.0
    thickness = max(2 * piece.volume() / piece.surface_area() for piece in pieces)
    found = [piece.to_mesh64() for piece in pieces]
    corners = [np.asarray(mesh.vert_properties[:, :3]) for mesh in found]
    middles = [at[np.asarray(mesh.tri_verts)].mean(axis=1) for at, mesh in zip(corners, found, strict=True)]
    points = np.vstack(corners + middles)
    return max(thickness, _farthest_from(first, T_first, points), _farthest_from(second, T_second, points))


def _farthest_from(solid: Solid, T: Array, points: Array) -> float:
    """Greatest distance, m, of points (N, 3) from the surface of a body at a pose."""
    fcl = _fcl()
    body, point = _placed_tree(solid, T), fcl.CollisionObject(fcl.Sphere(POINT))
    request, farthest = fcl.DistanceRequest(), 0.0
    for position in points:
        point.setTranslation(position)
        farthest = max(farthest, float(fcl.distance(point, body, request, fcl.DistanceResult())) + POINT)
    return farthest


def _placed_tree(solid: Solid, T: Array) -> Any:
    fcl = _fcl()
    pose = fcl.Transform(np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3]))
    return fcl.CollisionObject(solid.tree, pose)


def placed(solid: Solid, T: Array) -> Any:
    """The manifold of a body at a pose (4, 4)."""
    return solid.volume.transform(np.ascontiguousarray(T[:3, :4]))


def crossing_depth(first: Solid, T_first: Array, second: Solid, T_second: Array) -> float:
    """How deep two bodies are in each other, m, where a surface is open: of points on the triangles that cross, the
    farthest from the other surface of those that are inside of it.

    Inside is where the winding number is above a half, which also tells where a surface has holes (Jacobson, Kavan,
    Sorkine-Hornung: Robust inside-outside segmentation using generalized winding numbers, 2013). A lower bound: 0
    where no triangles cross.
    """
    fcl = _fcl()
    result = fcl.CollisionResult()
    request = fcl.CollisionRequest(num_max_contacts=MOST_CROSSINGS, enable_contact=True)
    fcl.collide(_placed_tree(first, T_first), _placed_tree(second, T_second), request, result)
    depth = 0.0
    for solid, T, other, T_other, numbers in (
        (first, T_first, second, T_second, {contact.b1 for contact in result.contacts}),
        (second, T_second, first, T_first, {contact.b2 for contact in result.contacts}),
    ):
        crossing = solid.surface.corners[sorted(numbers)]  # (K, 3, 3) m
        points = np.einsum("pc,kci->kpi", ON_TRIANGLE, crossing).reshape(-1, 3) @ T[:3, :3].T + T[:3, 3]
        points = points[_inside(other.surface.moved(T_other), points)]
        depth = max(depth, _farthest_from(other, T_other, points))
    return depth


def _inside(surface: TriangleMesh, points: Array) -> NDArray[np.bool_]:
    """Which of points (N, 3) have a winding number above a half, by the solid angles of the triangles (Van Oosterom,
    Strackee 1983)."""
    found = np.zeros(len(points), dtype=bool)
    within = np.nonzero(((points > surface.bounds[0]) & (points < surface.bounds[1])).all(axis=1))[0]
    for n in within:
        a, b, c = np.moveaxis(surface.corners - points[n], 1, 0)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        dot = np.einsum("ti,ti->t", a, b) * lc + np.einsum("ti,ti->t", b, c) * la + np.einsum("ti,ti->t", c, a) * lb
        turned = 2 * np.arctan2(np.einsum("ti,ti->t", a, np.cross(b, c)), la * lb * lc + dot).sum()
        found[n] = turned > 2 * np.pi
    return found


def _one_may_hold_the_other(first: Solid, T_first: Array, second: Solid, T_second: Array) -> bool:
    """Whether the extents of one lie inside those of the other: surfaces apart do not tell that bodies are."""
    (low_a, high_a), (low_b, high_b) = _extents(first, T_first), _extents(second, T_second)
    return bool(
        ((low_a >= low_b).all() and (high_a <= high_b).all()) or ((low_b >= low_a).all() and (high_b <= high_a).all())
    )


def _extents(solid: Solid, T: Array) -> tuple[Array, Array]:
    moved = solid.surface.vertices @ T[:3, :3].T + T[:3, 3]
    return moved.min(axis=0), moved.max(axis=0)


def _fcl() -> Any:
    try:
        import fcl
    except ImportError as missing:
        raise MissingExtraError("verification of meshes", "verify", "python-fcl") from missing
    return fcl


def _manifold() -> Any:
    try:
        import manifold3d
    except ImportError as missing:
        raise MissingExtraError("verification of meshes", "verify", "manifold3d") from missing
    return manifold3d
