"""Where bodies touch: for each pair of parts the points at which one may press on the other, with normals.

Facets that look at each other within the contact gap press on each other wherever one, seen along their common
normal, lies over the other: the polygon that both share is worked out exactly. Besides, corners press on facets and
edges on edges, where the body is locally nearest. Of every direction of a pair only the extreme points are kept: a
force at a point between them is the same as forces at them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Array
from takeapart.stability.facets import Facets, Integers, body_facets, near_pairs
from takeapart.stability.polygons import Polygons

DEPTH = 5e-4  # m; surfaces that are deeper in each other do not press on each other
ALLOWED_DEPTH = 2e-3  # m; the same where a pair is meant to overlap
FACING = np.cos(np.radians(20.0))  # facets whose normals are opposite within this angle press on each other as areas
PARALLEL = np.cos(np.radians(1.0))  # facets closer to parallel than this touch as one area
SLACK = 2e-5  # m; of a curved contact what is further away than this, beyond its nearest point, does not touch
RIM = 2e-5  # m; contacts end this far within a sharp edge: bodies that have only an edge line in common do not touch
SHARP = np.radians(30.0)  # bend of an edge at which a surface ends
FLAT = np.radians(0.5)  # bend of an edge below which a surface goes on
SAME_DIRECTION = np.cos(np.radians(11.0))  # normals of one patch
DIRECTIONS = np.arange(16) * (2 * np.pi / 16) + 0.1  # rad, in the plane of a patch, in which extreme points are kept
MOST_AT_ONCE = 100_000  # pairs of facets; bounds the memory


@dataclass(frozen=True, eq=False)
class ContactPatch:
    """Where two parts touch, of about one direction.

    Args:
        first, second: numbers of the parts.
        points: (K, 3) m, world frame.
        normals: (K, 3) unit: the direction in which the second part presses on the first.
        gap: m, the least distance of the surfaces here; negative where they overlap.
    """

    first: int
    second: int
    points: Array
    normals: Array
    gap: float


@dataclass(frozen=True, eq=False)
class _Points:
    """Points of contact: places (K, 3), normals (K, 3) towards the first body, gaps (K,) m."""

    places: Array
    normals: Array
    gaps: Array


def contact_patches(assembly: Assembly) -> tuple[ContactPatch, ...]:
    """All contacts of a product, pair by pair; two fixed parts need none."""
    bodies = [body_facets(assembly, i) for i in range(len(assembly.parts))]
    bounds = np.array([body.bounds for body in bodies])
    fixed = np.array([part.fixed for part in assembly.parts])
    meant = {frozenset(pair) for pair in assembly.allowed_overlaps}
    found: list[ContactPatch] = []
    for a, part in enumerate(assembly.parts):
        near = (bounds[:, 0] <= bounds[a, 1] + assembly.contact_gap) & (
            bounds[:, 1] >= bounds[a, 0] - assembly.contact_gap
        )
        for b in np.nonzero(near.all(axis=1) & ~(fixed & fixed[a]))[0]:
            if b <= a:
                continue
            depth = ALLOWED_DEPTH if frozenset((part.name, assembly.parts[b].name)) in meant else DEPTH
            points = _touching(bodies[a], bodies[b], assembly.contact_gap, depth)
            found += [
                ContactPatch(a, int(b), points.places[rows], points.normals[rows], float(points.gaps[rows].min()))
                for rows in _extremes(points)
            ]
    return tuple(found)


def _touching(first: Facets, second: Facets, gap: float, depth: float) -> _Points:
    """All points at which two bodies touch."""
    gap += 1e-7  # rounding
    a, b = near_pairs(first, second, max(gap, depth))
    facing = (first.normals[a] * second.normals[b]).sum(axis=1) < -FACING
    found = [
        _areas(first, second, a[facing], b[facing], (gap, depth)),
        _corners(first, second, a, b, facing, (gap, depth)),
        _reversed(_corners(second, first, b, a, facing, (gap, depth))),
        _edges(first, second, a, b, (gap, depth)),
    ]
    return _Points(
        np.concatenate([points.places for points in found]),
        np.concatenate([points.normals for points in found]),
        np.concatenate([points.gaps for points in found]),
    )


def _reversed(points: _Points) -> _Points:
    return _Points(points.places, -points.normals, points.gaps)


def _areas(first: Facets, second: Facets, a: Integers, b: Integers, window: tuple[float, float]) -> _Points:
    """Corners of the areas that facing facets share."""
    pieces = [
        _shared(first, second, a[k : k + MOST_AT_ONCE], b[k : k + MOST_AT_ONCE], window)
        for k in range(0, len(a), MOST_AT_ONCE)
    ]
    if not pieces or not sum(len(piece[0]) for piece in pieces):
        return _Points(np.empty((0, 3)), np.empty((0, 3)), np.empty(0))
    a, b = (np.concatenate([piece[k] for piece in pieces]) for k in (0, 1))
    width = max(piece[2].points.shape[1] for piece in pieces)
    shared = Polygons(
        np.concatenate([np.pad(p[2].points, ((0, 0), (0, width - p[2].points.shape[1]), (0, 0))) for p in pieces]),
        np.concatenate([piece[2].sizes for piece in pieces]),
    )
    normals = _common(first.normals[a], second.normals[b])
    gaps = _gaps(second, b, normals, shared)
    nearest = np.where(shared.present, gaps, np.inf).min(axis=1)
    curved = (first.normals[a] * second.normals[b]).sum(axis=1) > -PARALLEL
    label = _places(first, a, normals)
    least = np.full(label.max() + 1, np.inf)
    np.minimum.at(least, label, nearest)
    shared = shared.cut(np.where(curved[:, None], least[label][:, None] + SLACK - gaps, 1.0))
    row, column = np.nonzero(shared.present)
    places, normal = shared.points[row, column], normals[row]
    inner = _inset(first, a[row], places) - _inset(second, b[row], places)
    bent = curved[row]
    normal = np.where((bent & (inner < -1e-6))[:, None], second.normals[b[row]], normal)
    normal = np.where((bent & (inner > 1e-6))[:, None], -first.normals[a[row]], normal)
    found = _gaps(second, b, normals, shared)[row, column]
    return _Points(places - found[:, None] / 2 * normals[row], normal, found)


def _shared(
    first: Facets, second: Facets, a: Integers, b: Integers, window: tuple[float, float]
) -> tuple[Integers, Integers, Polygons]:
    """Pairs of facets that share an area, and that area on the first facet."""
    normals = _common(first.normals[a], second.normals[b])
    area = Polygons(first.corners[a], np.full(len(a), 3))
    for facets, sign in ((second, 1.0), (first, -1.0)):
        for k in range(3):
            rows = b if facets is second else a
            corner = facets.corners[rows, k]
            inward = np.cross(sign * normals, facets.corners[rows, (k + 1) % 3] - corner)
            inward /= np.maximum(np.linalg.norm(inward, axis=1, keepdims=True), 1e-300)
            within = ((area.points - corner[:, None]) * inward[:, None]).sum(axis=2)
            rim = np.where(facets.bend[rows, k] > SHARP, RIM, 0.0 if facets is second else -1.0)
            area = area.cut(within - rim[:, None])
            left = area.sizes > 2
            area, a, b, normals = area.of(left), a[left], b[left], normals[left]
    for side in (1.0, -1.0):
        gaps = _gaps(second, b, normals, area)
        area = area.cut(window[0] - gaps if side > 0 else gaps + window[1])
        left = area.sizes > 2
        area, a, b, normals = area.of(left), a[left], b[left], normals[left]
    return a, b, area


def _common(first: Array, second: Array) -> Array:
    """Unit normals (N, 3) between those of facets that look at each other: towards the first."""
    normals = second - first
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def _gaps(second: Facets, b: Integers, normals: Array, area: Polygons) -> Array:
    """(N, M) m: from the facets of the second body along the normals to the corners of areas on the first."""
    plane = second.normals[b]
    heights = ((area.points - second.corners[b, 0][:, None]) * plane[:, None]).sum(axis=2)
    return np.asarray(heights / (normals * plane).sum(axis=1)[:, None])


def _places(first: Facets, a: Integers, normals: Array) -> Integers:
    """(N,) numbers that tell apart places and directions: facets of the first body that hang together, and of these
    those with about one normal."""
    from scipy.sparse import coo_array  # takes a fifth of a second to import, and products of boxes need no patches
    from scipy.sparse.csgraph import connected_components

    count, rows = len(first.vertices), np.unique(a)
    ends = first.triangles[rows]
    links = coo_array((np.ones(2 * len(rows)), (np.tile(ends[:, 0], 2), ends[:, 1:].T.ravel())), shape=(count, count))
    piece = connected_components(links, directed=False)[1][first.triangles[a, 0]]
    direction = np.zeros(len(a), dtype=np.int64)
    for k, members in enumerate(_alike(normals, FACING)):
        direction[members] = k
    return np.asarray(np.unique(np.stack([piece, direction]), axis=1, return_inverse=True)[1].ravel())


def _inset(facets: Facets, rows: Integers, points: Array) -> Array:
    """(N,) m: how far inside of its facet, from the edges at which the surface bends, each point is."""
    corners = facets.corners[rows]
    edges = np.roll(corners, -1, axis=1) - corners
    inward = np.cross(facets.normals[rows][:, None], edges)
    inward /= np.maximum(np.linalg.norm(inward, axis=2, keepdims=True), 1e-300)
    within = ((points[:, None] - corners) * inward).sum(axis=2)
    return np.asarray(np.where(np.abs(facets.bend[rows]) > FLAT, within, 1.0).min(axis=1))


def _corners(
    first: Facets, second: Facets, a: Integers, b: Integers, facing: NDArray[np.bool_], window: tuple[float, float]
) -> _Points:
    """Corners of the first body that press on facets of the second: where it is locally nearest, and no area is."""
    vertex, facet = first.triangles[a].ravel(), np.repeat(b, 3)
    places, plane = first.vertices[vertex], second.normals[facet]
    gaps = ((places - second.corners[facet, 0]) * plane).sum(axis=1)
    pair = vertex * len(second.triangles) + facet
    near = (gaps <= window[0]) & (gaps >= -window[1]) & ~np.isin(pair, pair[np.repeat(facing, 3)])
    vertex, facet = np.divmod(np.unique(pair[near]), len(second.triangles))
    places, plane, corners = first.vertices[vertex], second.normals[facet], second.corners[facet]
    inward = np.cross(plane[:, None], np.roll(corners, -1, axis=1) - corners)
    inward /= np.maximum(np.linalg.norm(inward, axis=2, keepdims=True), 1e-300)
    within = ((places[:, None] - corners) * inward).sum(axis=2)
    over = (within >= np.where(second.bend[facet] > SHARP, RIM, 0.0)).all(axis=1)
    vertex, places, plane, facet = vertex[over], places[over], plane[over], facet[over]
    start, other = first.neighbours
    count = start[vertex + 1] - start[vertex]
    row = np.repeat(np.arange(len(vertex)), count)
    ahead = other[start[vertex][row] + np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)]
    to = first.vertices[ahead] - places[row]
    rises = (to * plane[row]).sum(axis=1) >= -1e-3 * np.linalg.norm(to, axis=1)
    nearest = np.ones(len(vertex), dtype=bool)
    np.logical_and.at(nearest, row, rises)
    gaps = ((places - second.corners[facet, 0]) * plane).sum(axis=1)
    return _Points((places - gaps[:, None] / 2 * plane)[nearest], plane[nearest], gaps[nearest])


def _edges(first: Facets, second: Facets, a: Integers, b: Integers, window: tuple[float, float]) -> _Points:
    """Sharp convex edges of both bodies that cross."""
    pairs = [np.stack([a, np.full(len(a), k), b, np.full(len(b), n)]) for k in range(3) for n in range(3)]
    found = np.concatenate(
        [pair[:, _is_ridge(first, pair[0], pair[1]) & _is_ridge(second, pair[2], pair[3])] for pair in pairs], axis=1
    )
    if not found.shape[1]:
        return _Points(np.empty((0, 3)), np.empty((0, 3)), np.empty(0))
    ra, ka, rb, kb = np.unique(found, axis=1)
    p, q = first.corners[ra, ka], second.corners[rb, kb]
    u, v = first.corners[ra, (ka + 1) % 3] - p, second.corners[rb, (kb + 1) % 3] - q
    lengths = np.linalg.norm(u, axis=1), np.linalg.norm(v, axis=1)
    u, v = u / lengths[0][:, None], v / lengths[1][:, None]
    normals = np.cross(u, v)
    sine = np.linalg.norm(normals, axis=1)
    normals /= np.maximum(sine, 1e-9)[:, None]
    normals *= np.where((normals * (second.normals[rb] - first.normals[ra])).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    w = q - p
    cosine = (u * v).sum(axis=1)
    scale = np.maximum(sine**2, 1e-9)
    s = ((w * u).sum(axis=1) - cosine * (w * v).sum(axis=1)) / scale
    t = (cosine * (w * u).sum(axis=1) - (w * v).sum(axis=1)) / scale
    gaps = -(w * normals).sum(axis=1)
    keep = (sine > 0.1) & (s > RIM) & (s < lengths[0] - RIM) & (t > RIM) & (t < lengths[1] - RIM)
    keep &= (gaps <= window[0]) & (gaps >= -window[1])
    for row in (ra, first.across[ra, ka]):  # not where faces face each other: there areas touch
        for column in (rb, second.across[rb, kb]):
            keep &= (first.normals[row] * second.normals[column]).sum(axis=1) > -FACING
    for facets, row, k, along, sign in ((first, ra, ka, u, 1.0), (second, rb, kb, v, -1.0)):
        other = facets.across[row, k]
        for inward in (np.cross(facets.normals[row], along), -np.cross(facets.normals[other], along)):
            keep &= sign * (inward * normals).sum(axis=1) > -1e-3
    places = (p + s[:, None] * u + q + t[:, None] * v) / 2
    return _Points(places[keep], normals[keep], gaps[keep])


def _is_ridge(facets: Facets, rows: Integers, k: Integers) -> NDArray[np.bool_]:
    """Whether edges k of facets are sharp and convex; of the two facets at an edge, one counts."""
    return np.asarray((facets.bend[rows, k] > SHARP) & (facets.across[rows, k] > rows))


def _alike(normals: Array, cosine: float) -> Iterator[Integers]:
    """Groups of normals (N, 3) that are closer than an angle to the group's first."""
    rounded, number = np.unique(np.round(normals, 3), axis=0, return_inverse=True)
    number = number.ravel()
    counts = np.bincount(number)
    left, lengths = np.ones(len(rounded), dtype=bool), np.linalg.norm(rounded, axis=1)
    for k in np.argsort(-counts, kind="stable"):
        if left[k]:
            group = left & (rounded @ rounded[k] >= cosine * lengths * lengths[k])
            left &= ~group
            yield np.nonzero(group[number])[0]


def _extremes(points: _Points) -> Iterator[Integers]:
    """For each patch the rows of its extreme points."""
    if not len(points.gaps):
        return
    for rows in _alike(points.normals, SAME_DIRECTION):
        normal = points.normals[rows].mean(axis=0)
        basis = np.linalg.svd(normal[None])[2][1:]  # (2, 3) across the normal
        flat = points.places[rows] @ basis.T
        ways = np.stack([np.cos(DIRECTIONS), np.sin(DIRECTIONS)])
        extreme = np.unique((flat @ ways).argmax(axis=0))
        kept: list[int] = []
        for k in extreme:
            if all(np.abs(flat[k] - flat[other]).max() > RIM for other in kept):
                kept.append(int(k))
        yield rows[kept]
