"""One oriented box around a mesh: as small as its flat faces, its hull and its inertia suggest.

Of boxes that are equally small, that one is taken whose faces lie along most of the surface: a finer or coarser
tessellation of the same body gets the same box, and a cylinder one along its axis.
"""

from __future__ import annotations

import numpy as np

from takeapart.model.geometry import Array, OrientedBox, TriangleMesh, area_normals

MOST_DIRECTIONS = 24  # of normals that are tried as a box's axis
SAME_DIRECTION = 0.9999  # cosine; normals closer than 0.8 degrees are one
MOST_COMPARED = 64  # boxes whose faces are compared
AS_SMALL = 1.02  # boxes larger by less compete by the area along their faces
ALONG_FACE = 0.9998  # cosine of the angle between a normal and the face that it belongs to
SAME_SHARE = 0.03  # of the area; the part's own axes win unless others have more
EXACT_AXES = 1e-6  # axes as close as this to the part's own are the part's own


def tight_box(mesh: TriangleMesh) -> OrientedBox:
    """A small oriented box that holds all corners that a mesh's triangles use.

    Its axes are named so that each is as near as possible to the part's axis of the same name.
    """
    corners = mesh.corners
    normals = area_normals(corners)
    areas = np.linalg.norm(normals, axis=1)
    used = areas > 1e-9 * max(float(areas.max()), 1e-300)
    normals, areas = normals[used] / areas[used, None], areas[used]
    points = mesh.vertices[np.unique(mesh.triangles)]
    hull, hull_normals = _hull(points)
    inertia = _inertia_axes(corners[used], areas)
    normals, areas = _merged(
        np.concatenate([normals, hull_normals]), np.append(areas, 1e-15 * np.ones(len(hull_normals)))
    )
    frames = _frames(_directions(normals, areas), inertia)
    spans = np.ptp((_extreme(hull) @ frames.transpose(1, 0, 2).reshape(3, -1)), axis=0).reshape(-1, 3)  # (F, 3) m
    volumes = np.maximum(spans, 1e-6 * spans.max()).prod(axis=1)
    small = np.append(
        0, np.argsort(volumes[1:], kind="stable")[:MOST_COMPARED] + 1
    )  # the part's own axes are the first
    small = np.sort(small[volumes[small] <= AS_SMALL * volumes.min()])
    along = np.abs(normals @ frames[small]).max(axis=2) > ALONG_FACE  # (S, N)
    shares = along @ areas / areas.sum()
    tied = small[shares > shares.max() - SAME_SHARE]
    chosen = 0 if tied[0] == 0 else tied[int(np.argmin(volumes[tied]))]
    return _box(points, _named(frames[chosen]))


def flat_directions(mesh: TriangleMesh) -> tuple[Array, Array]:
    """Normals (D, 3) of the largest flat faces, either way, and their areas (D,), m^2, the largest first."""
    normals = area_normals(mesh.corners)
    doubled = np.linalg.norm(normals, axis=1)
    used = doubled > 0
    normals, areas = _merged(normals[used] / doubled[used, None], doubled[used] / 2)
    found = _directions(normals, areas)
    return found, (np.abs(found @ normals.T) > SAME_DIRECTION) @ areas


def _hull(points: Array) -> tuple[Array, Array]:
    """Corners (H, 3) of the convex hull and the normals (F, 3) of its facets; all points where they lie in a plane."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except QhullError:
        return points, np.empty((0, 3))
    corners = hull.points[hull.simplices]
    doubled = np.linalg.norm(area_normals(corners), axis=1)
    largest = np.argsort(-doubled, kind="stable")[: 4 * MOST_DIRECTIONS]
    return hull.points[hull.vertices], hull.equations[largest, :3]


def _extreme(points: Array) -> Array:
    """Those of the points (H, 3) of a hull that reach furthest in many directions: enough to compare boxes by."""
    if len(points) <= MOST_DIRECTIONS * 16:
        return points
    k = np.arange(16 * MOST_DIRECTIONS) + 0.5
    heights, turns = 1 - k / (8 * MOST_DIRECTIONS), np.pi * (1 + 5**0.5) * k  # a spiral of golden angles
    rings = np.sqrt(1 - heights**2)
    ways = np.vstack([rings * np.cos(turns), rings * np.sin(turns), heights])
    return np.asarray(points[np.unique(np.argmax(points @ ways, axis=0))])


def _merged(normals: Array, areas: Array) -> tuple[Array, Array]:
    """Mean normals (N, 3), either way, of equal ones, and their areas (N,)."""
    rounded = np.round(normals, 5) + 0.0
    first = np.argmax(np.abs(rounded) > 1e-4, axis=1)
    signs = np.where(np.take_along_axis(rounded, first[:, None], axis=1) < 0, -1.0, 1.0)
    keys = np.round((rounded * signs + 2) * 1e5).astype(np.int64) @ np.array([1 << 40, 1 << 20, 1])
    _, member = np.unique(keys, return_inverse=True)
    weights = np.bincount(member, areas)
    sums = np.column_stack([np.bincount(member, column * areas) for column in (normals * signs).T])
    means: Array = sums / np.linalg.norm(sums, axis=1, keepdims=True)
    return means, weights.astype(np.float64)


def _directions(normals: Array, areas: Array) -> Array:
    """Up to `MOST_DIRECTIONS` means (D, 3) of normals that are nearly the same, those of the largest area first."""
    left = np.argsort(-areas, kind="stable")
    found: list[Array] = []
    while len(left) and len(found) < MOST_DIRECTIONS:
        cosines = normals[left] @ normals[left[0]]
        near = np.abs(cosines) > SAME_DIRECTION
        mean = (np.sign(cosines[near]) * areas[left[near]]) @ normals[left[near]]
        found.append(mean / np.linalg.norm(mean))
        left = left[~near]
    return np.array(found)


def _inertia_axes(corners: Array, areas: Array) -> Array:
    """Principal axes (3, 3), columns, of the surface."""
    middles = corners.mean(axis=1)
    centred = corners - np.average(middles, axis=0, weights=areas)
    spread = np.einsum("t,tci,tcj->ij", areas, centred, centred) / (3 * areas.sum())
    return np.asarray(np.linalg.eigh(spread)[1])


def _frames(flats: Array, inertia: Array) -> Array:
    """Rotations (F, 3, 3) worth trying: the part's own axes, and every direction with each other one turned upright."""
    frames = [np.eye(3)]
    firsts = [*flats, *inertia.T]
    seconds = [*flats, *inertia.T, *np.eye(3)]
    for z in firsts:
        for near in seconds:
            x = near - (near @ z) * z
            length = float(np.linalg.norm(x))
            if length > 0.2:
                x /= length
                frames.append(np.column_stack([x, np.cross(z, x), z]))
    return np.array(frames)


def _named(R: Array) -> Array:
    """The same axes, right-handed, each with the name and the sign of the part's axis that it is nearest to."""
    columns = [0, 1, 2]
    chosen: list[int] = []
    for row in range(3):
        best = max(columns, key=lambda c: abs(R[row, c]))
        columns.remove(best)
        chosen.append(best)
    named = R[:, chosen]
    named = named * np.where(np.diag(named) < 0, -1.0, 1.0)
    if np.linalg.det(named) < 0:
        named[:, int(np.argmin(np.abs(np.diag(named))))] *= -1
    if np.abs(named - np.eye(3)).max() < EXACT_AXES:
        return np.eye(3)
    return np.asarray(named)


def _box(points: Array, R: Array) -> OrientedBox:
    local = points @ R
    low, high = local.min(axis=0), local.max(axis=0)
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = R @ ((low + high) / 2)
    return OrientedBox(T, (high - low) / 2)
