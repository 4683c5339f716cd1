"""Spheres around the bodies of a robot: how close by which rule, found once per shape and kept."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from takeapart.model.errors import InputError
from takeapart.model.geometry import Array
from takeapart.robot.chain import Body, Chain
from takeapart.robot.cover import SphereCover, exact_cover, sphere_cover
from takeapart.robot.kept import keep, kept
from takeapart.robot.self_collision import ConvexBody
from takeapart.robot.urdf import Geometry, Urdf, convex_corners
from takeapart.robot.urdf.meshes import digest_of, hull_of

# How far spheres may reach beyond a body's hull, m: the fewer spheres, the faster, and what comes near the parts wants
# close ones.
BASE_INFLATION, ARM_INFLATION, WRIST_INFLATION, GRIPPER_INFLATION = 0.03, 0.025, 0.02, 0.015
WRIST_SHARE = 0.25  # of the length of the chain, before the flange: joints there move a wrist
LARGEST_SHARE = 0.25  # of a body's longest edge: small bodies have closer spheres
LEAST_INFLATION = 0.004  # m
MOST_CORNERS = 160  # of a body: every look at its hull goes through all of them
LEAST_CUT = 1e-4  # m; a hull around a body that stands out no further is close enough


def inflations(bodies: Sequence[Body], chain: Chain) -> list[float]:
    """How far the spheres of each body may reach beyond its hull, m."""
    steps = [float(np.linalg.norm(T[:3, 3])) for T in chain.T_joint[1:]]
    steps.append(float(np.linalg.norm(chain.T_last_flange[:3, 3])))
    to_flange = np.cumsum(steps[::-1])[::-1]  # from the origin of each joint's frame, along the chain
    found = []
    for body in bodies:
        if body.of_gripper:
            rule = GRIPPER_INFLATION
        elif body.frame == 0:
            rule = BASE_INFLATION
        elif to_flange[body.frame - 1] <= WRIST_SHARE * to_flange[0]:
            rule = WRIST_INFLATION
        else:
            rule = ARM_INFLATION
        edge = float(np.ptp(body_corners(body), axis=0).max())
        found.append(max(min(rule, LARGEST_SHARE * edge), LEAST_INFLATION))
    return found


def body_cover(body: Body, inflation: float) -> SphereCover:
    """Spheres around the collision geometry of a body, in the frame of its link.

    Raises:
        InputError: a mesh is missing, cannot be read, or is flat.
    """
    parts = [_shape_cover(body.urdf, shape, inflation) for shape in body.urdf.links[body.link].collisions]
    return SphereCover(
        np.concatenate([part.centers for part in parts]),
        np.concatenate([part.radii for part in parts]),
        max(part.inflation for part in parts),
    )


def body_corners(body: Body) -> Array:
    """Corners (V, 3), m, of the convex hull of all collision geometry of a body, in the frame of its link.

    Raises:
        InputError: a mesh is missing, cannot be read, or is flat.
    """
    corners = [convex_corners(body.urdf, shape) for shape in body.urdf.links[body.link].collisions]
    if len(corners) == 1:
        return corners[0]
    return _together(body.urdf.where, *(np.ascontiguousarray(found).tobytes() for found in corners))


def body_hulls(bodies: Sequence[Body]) -> list[ConvexBody]:
    """All bodies as convex hulls in the frames of their joints, with at most `MOST_CORNERS` corners each.

    Raises:
        InputError: a mesh is missing, cannot be read, or is flat.
    """
    return [
        ConvexBody(
            np.ascontiguousarray(_simple(body_corners(body)) @ body.T_frame_link[:3, :3].T + body.T_frame_link[:3, 3]),
            body.frame,
            body.in_line,
        )
        for body in bodies
    ]


def _simple(corners: Array) -> Array:
    """The same corners (V, 3), m, of a convex hull, or those of a hull around it where they are too many; kept in the
    cache folder.
    """
    if len(corners) <= MOST_CORNERS:
        return corners
    name = f"simple-1-{MOST_CORNERS}-{hashlib.sha256(np.ascontiguousarray(corners).tobytes()).hexdigest()[:24]}"
    known = kept(name)
    if known is None or known.ndim != 2 or known.shape[1] != 3 or len(known) < 4 or not np.isfinite(known).all():
        known = around_with_fewer_corners(corners, MOST_CORNERS)
        keep(name, known)
    return np.asarray(known, dtype=float)


def around_with_fewer_corners(corners: Array, most: int) -> Array:
    """At most so many corners (W, 3), m, whose convex hull contains that of others (V, 3).

    A box around the hull is cut along the planes of the hull's faces, each time where it stands out furthest: whatever
    is left contains the hull.
    """
    from scipy.spatial import ConvexHull, HalfspaceIntersection  # take long to import, and are rarely needed

    planes = np.unique(np.round(ConvexHull(corners).equations, 9), axis=0)  # (F, 4) normals and negative offsets
    planes[:, 3] = -(corners @ planes[:, :3].T).max(axis=0)
    sides = np.concatenate([np.eye(3), -np.eye(3)])
    cuts = np.column_stack([sides, -(corners @ sides.T).max(axis=0)])
    inside = ConvexHull(corners).points.mean(axis=0)
    found = _distinct(HalfspaceIntersection(cuts, inside).intersections)
    while True:
        beyond = found @ planes[:, :3].T + planes[:, 3]
        cuts = np.vstack([cuts, planes[int(beyond.max(axis=0).argmax())]])
        closer = _distinct(HalfspaceIntersection(cuts, inside).intersections)
        if len(closer) > most or beyond.max() < LEAST_CUT:
            return found + (found - inside) * 1e-7  # rounding takes nothing out of it
        found = closer


def _distinct(points: Array) -> Array:
    """Points (N, 3), m, without those that are others but for rounding."""
    return np.asarray(points[np.unique(np.round(points, 8), axis=0, return_index=True)[1]])


@lru_cache(maxsize=256)
def _together(where: str, *corners: bytes) -> Array:
    points = np.concatenate([np.frombuffer(data).reshape(-1, 3) for data in corners])
    name = f"hull-1-{hashlib.sha256(points.tobytes()).hexdigest()[:24]}"
    known = kept(name)
    if known is not None and known.ndim == 2 and known.shape[1] == 3 and len(known) > 3 and np.isfinite(known).all():
        return np.ascontiguousarray(known, dtype=float)
    found, _, _ = hull_of(points, where)
    keep(name, found)
    return found


def _shape_cover(urdf: Urdf, shape: Geometry, inflation: float) -> SphereCover:
    """In the frame of the shape's link."""
    if shape.kind == "sphere":
        return exact_cover(shape.T_link[:3, 3], shape.size[0])
    placed = Geometry(shape.kind, np.eye(4), shape.size, shape.uri)
    name = f"{shape.kind}-{shape.size}"
    if shape.kind == "mesh":
        path = urdf.files.resolve(shape.uri)
        name = digest_of(path)[:24]
        if shape.size != (1.0, 1.0, 1.0):
            name = f"{name}-{shape.size}"
    if len(name) > 24:
        name = hashlib.sha256(name.encode()).hexdigest()[:24]
    found = _kept_cover(f"cover-2-{name}-{inflation * 1e4:.0f}", convex_corners(urdf, placed).tobytes(), inflation)
    T = shape.T_link
    return SphereCover(found.centers @ T[:3, :3].T + T[:3, 3], found.radii, found.inflation)


@lru_cache(maxsize=256)
def _kept_cover(name: str, corners: bytes, inflation: float) -> SphereCover:
    """Cover of a convex polyhedron with corners (V, 3); kept in the cache folder."""
    rows = kept(name)
    if rows is not None and rows.ndim == 2 and rows.shape[1] == 4 and len(rows) > 1 and np.isfinite(rows).all():
        return SphereCover(rows[1:, :3], rows[1:, 3], float(rows[0, 3]))
    vertices, faces, normals = hull_of(np.frombuffer(corners).reshape(-1, 3), name)
    found = sphere_cover(vertices[faces], normals, inflation, np.random.default_rng(0))
    if not np.isfinite(found.centers).all():
        raise InputError("no spheres were found around it", name)
    keep(name, np.vstack([[0, 0, 0, found.inflation], np.column_stack([found.centers, found.radii])]))
    return found
