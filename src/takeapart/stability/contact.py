"""Where bodies made of boxes touch: exact distances, and the areas on which one lies on another."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product

import numpy as np

from takeapart.model.geometry import Array, OrientedBox, box_separation

TOUCHING = 1e-3 + 1e-6  # m; bodies further apart do not touch (and rounding)
SIGNS = np.array(list(product((-1.0, 1.0), repeat=3)))  # (8, 3) of the corners of a box
EDGES = [(k, k | bit) for bit in (1, 2, 4) for k in range(8) if not k & bit]  # numbers of their corners
STEEPEST_SEAT = math.cos(math.radians(45)) - 1e-9  # a face that is steeper carries nothing by contact alone


def distance(first: Sequence[OrientedBox], second: Sequence[OrientedBox]) -> float:
    """Least distance of the boxes of two bodies, m; not above 0 where they touch."""
    pairs = list(product(first, second))
    T_a, T_b = (np.array([pair[k].T_frame_box for pair in pairs]) for k in (0, 1))
    half_a, half_b = (np.array([pair[k].half_extents for pair in pairs]) for k in (0, 1))
    separation = box_separation(T_a, half_a, T_b, half_b)  # a lower bound of the distance
    likely = separation == separation.min()
    if (separation[likely] <= 0).any():
        return float(separation.min())
    least = float(_apart(T_a[likely], half_a[likely], T_b[likely], half_b[likely]).min())
    others = (separation < least) & ~likely
    return float(_apart(T_a[others], half_a[others], T_b[others], half_b[others]).min(initial=least))


def distances(T_a: Array, half_a: Array, T_b: Array, half_b: Array) -> Array:
    """Distances (N,), m, of pairs of boxes, given as in `box_separation`; not above 0 where they touch."""
    found = box_separation(T_a, half_a, T_b, half_b)
    apart = found > 0
    if apart.any():
        found[apart] = _apart(T_a[apart], half_a[apart], T_b[apart], half_b[apart])
    return found


def _apart(T_a: Array, half_a: Array, T_b: Array, half_b: Array) -> Array:
    """Distances (N,) of boxes that do not overlap: of a corner of one and the other, or of two edges."""
    a, b = _corners(T_a, half_a), _corners(T_b, half_b)
    corners = np.minimum(_from_points(T_a, half_a, b), _from_points(T_b, half_b, a))
    return np.minimum(corners, _of_edges(_edges(a), _edges(b)))


def _corners(T: Array, half: Array) -> Array:
    """(N, 8, 3), in the order of `OrientedBox.corners`."""
    return np.asarray((SIGNS * half[:, None]) @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3])


def _from_points(T: Array, half: Array, points: Array) -> Array:
    """Least distance (N,) of each box from points (N, K, 3) of its own."""
    local = (points - T[:, None, :3, 3]) @ T[:, :3, :3]
    return np.asarray(np.linalg.norm(np.maximum(np.abs(local) - half[:, None], 0.0), axis=2).min(axis=1))


def _edges(corners: Array) -> tuple[Array, Array]:
    """First ends (N, 12, 3) and ways to the other ends (N, 12, 3)."""
    first, last = (corners[:, [pair[k] for pair in EDGES]] for k in (0, 1))
    return first, last - first


def _of_edges(first: tuple[Array, Array], second: tuple[Array, Array]) -> Array:
    """Least distance (N,) of the inner points of edges, Ericson: Real-Time Collision Detection, 5.1.9; edges whose
    nearest points are ends are left to the corners."""
    p, u = (value[:, :, None] for value in first)
    q, v = (value[:, None, :] for value in second)
    w = p - q
    uu, uv, vv = (u * u).sum(-1), (u * v).sum(-1), (v * v).sum(-1)
    uw, vw = (u * w).sum(-1), (v * w).sum(-1)
    determinant = uu * vv - uv * uv
    crossing = determinant > 1e-12 * uu * vv
    scale = np.where(crossing, determinant, 1.0)
    s, t = (uv * vw - vv * uw) / scale, (uu * vw - uv * uw) / scale
    inner = crossing & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    gaps = np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=-1)
    return np.asarray(np.where(inner, gaps, np.inf).min(axis=(1, 2)))


def seats(above: Sequence[OrientedBox], below: Sequence[OrientedBox], touching: float = TOUCHING) -> Array:
    """Corners (N, 2), m, seen from above, of the areas on which one body lies on another: where a downward face of the
    upper one is within `touching` of an upward face of the lower one. (0, 2) where it does not lie on it."""
    found = [np.empty((0, 2))]
    for upper, lower in product(above, below):
        if not _meet(upper, lower, touching):
            continue
        for bottom, top in product(_faces(upper, -1), _faces(lower, 1)):
            area = _clipped(bottom, top[0][:, :2])
            for sign in (1.0, -1.0):  # neither further above it nor further within it
                area = _cut(area, touching - sign * (_heights(bottom, area) - _heights(top, area)))
            found.append(area)
    return np.concatenate(found)


def _meet(upper: OrientedBox, lower: OrientedBox, touching: float) -> bool:
    """Whether the extents of two boxes along the world's axes come so close that one may lie on the other."""
    reach = sum(np.abs(box.T_frame_box[:3, :3]) @ box.half_extents for box in (upper, lower))
    apart = np.abs(upper.T_frame_box[:3, 3] - lower.T_frame_box[:3, 3]) - reach
    return bool(apart[0] < 0 and apart[1] < 0 and apart[2] <= touching)


Face = tuple[Array, Array]
"""Corners (4, 3), counter-clockwise seen from above, and the unit normal (3,)."""


def _faces(box: OrientedBox, side: int) -> list[Face]:
    """Faces that look up (side = 1) or down (-1), but those that are steep."""
    R, found = box.T_frame_box[:3, :3], []
    for axis in range(3):
        up = float(R[2, axis])
        if abs(up) < STEEPEST_SEAT:
            continue
        normal = R[:, axis] * math.copysign(1.0, side * up)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        a, b = R[:, i] * box.half_extents[i], R[:, j] * box.half_extents[j]
        middle = box.T_frame_box[:3, 3] + normal * box.half_extents[axis]
        corners = np.array([middle + a + b, middle - a + b, middle - a - b, middle + a - b])
        found.append((corners if a[0] * b[1] > a[1] * b[0] else corners[::-1], normal))
    return found


def _heights(face: Face, points: Array) -> Array:
    """Heights (N,), m, of the plane of a face at points (N, 2)."""
    (corner, *_), normal = face
    return np.asarray(corner[2] - (points - corner[:2]) @ normal[:2] / normal[2])


def _clipped(face: Face, other: Array) -> Array:
    """What two convex areas have in common, seen from above; Sutherland and Hodgman, 1974."""
    area: Array = face[0][:, :2]
    for a, b in zip(other, np.roll(other, -1, axis=0), strict=True):
        inward = np.array([a[1] - b[1], b[0] - a[0]])
        area = _cut(area, (area - a) @ inward)
    return area


def _cut(area: Array, inside: Array) -> Array:
    """The part of a convex area (N, 2) where a linear function, given at its corners (N,), is not below 0."""
    points: list[Array] = []
    for k in range(len(area)):
        n = (k + 1) % len(area)
        if inside[k] >= 0:
            points.append(area[k])
        if (inside[k] >= 0) != (inside[n] >= 0):
            points.append(area[k] + inside[k] / (inside[k] - inside[n]) * (area[n] - area[k]))
    return np.array(points).reshape(-1, 2)


def beyond_hull(point: Array, corners: Array) -> float:
    """Distance, m, of a point (2,) from the convex hull of corners (N, 2); inside, minus the distance from its edge."""
    hull = _hull(corners)
    to = np.roll(hull, -1, axis=0) - hull
    square = np.maximum((to * to).sum(axis=1), 1e-300)
    share = np.clip(((point - hull) * to).sum(axis=1) / square, 0.0, 1.0)
    distances = np.linalg.norm(hull + share[:, None] * to - point, axis=1)
    outward = to[:, 1] * (point - hull)[:, 0] - to[:, 0] * (point - hull)[:, 1]
    inside = len(hull) > 2 and bool((outward < 0).all())
    return float(-distances.min() if inside else distances.min())


def _hull(corners: Array) -> Array:
    """Corners (M, 2) of the convex hull, counter-clockwise; Andrew: another efficient algorithm, 1979."""
    points = sorted({(float(x), float(y)) for x, y in corners})

    def chain(ordered: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
        line: list[tuple[float, float]] = []
        for x, y in ordered:
            while len(line) > 1:
                (ax, ay), (bx, by) = line[-2:]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0:
                    break
                line.pop()
            line.append((x, y))
        return line

    if len(points) < 3:
        return np.array(points)
    return np.array(chain(points)[:-1] + chain(points[::-1])[:-1])
