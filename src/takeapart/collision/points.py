"""Points on the surface of a part, those that matter in contact: corners, edges, and few on what is flat.

Two surfaces meet first with a corner of one or with edges of both, so flat places need hardly any points as long as
each of two bodies is asked with the points of the other. Every point knows the directions in which its surface faces:
one that faces backwards cannot be the first to meet something. A tree of balls over the points skips what is far.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from takeapart.collision.fields import MOST_CORNERS, Field, row_numbers, signed_distances
from takeapart.collision.triangles import curve_order
from takeapart.model.geometry import Array, TriangleMesh, area_normals

IN_LEAF = 8
FLAT = math.radians(0.1)  # between facets that are one
SHARP = math.radians(30)  # along sharper edges points are twice as dense
SPARSE = 12.0  # times the spacing, on what is flat
ROUND = 1e-7  # m; corners closer than this are one
SLACK = math.radians(0.05)  # that a surface may face forwards, to be left out: it slides along
MOST_FACETS = 6  # groups of parallel facets that are told
ANY = 2.0  # a sine that no direction reaches: the point is always asked

Indices = NDArray[np.int64]


class Cloud(NamedTuple):
    """Points in the order of the leaves of a complete binary tree: node k has the children 2 k and 2 k + 1, every leaf
    holds `IN_LEAF` points."""

    points: Array  # (N, 3) m
    facing: Array  # (N, 7) two normals, and the sine by which both must point backwards for the point to be left out
    balls: Array  # (nodes, 4) m: centre and radius
    cones: Array  # (nodes, 4) the same of all points below, with one mean normal
    leaves: int  # first node that is a leaf


def cloud_of(mesh: TriangleMesh, field: Field, spacing: float) -> Cloud:
    """Points on a surface, along edges about `spacing`, m, apart.

    Args:
        field: of the surface: which side is outside. Where it disagrees with how triangles are turned, they are not
            believed.
    """
    points, normals, off = _points(mesh, spacing)
    h = 0.5 * field.step if field.step > 0 else 1e-5
    axes = normals.mean(axis=1)
    axes /= np.maximum(np.linalg.norm(axes, axis=1), 1e-9)[:, None]
    rise = signed_distances(field, points + h * axes) - signed_distances(field, points - h * axes)
    off[rise < 0.5 * h] = math.pi
    order = curve_order(points)
    return _tree(np.ascontiguousarray(points[order]), normals[order], off[order])


def _points(mesh: TriangleMesh, spacing: float) -> tuple[Array, Array, Array]:
    """Points (N, 3), m, two normals (N, 2, 3) there, and how far others are from the nearer of them (N,), rad."""
    vertices, triangles = _merged(mesh)
    corners = vertices[triangles]
    crosses = area_normals(corners)
    areas = np.linalg.norm(crosses, axis=1)
    real = areas > 1e-16
    triangles, corners, normals = triangles[real], corners[real], crosses[real] / areas[real, None]
    count, sides = len(vertices), np.tile(np.arange(len(triangles)), 3)
    ends = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    keys, edge = np.unique(ends[:, 0].astype(np.int64) * count + ends[:, 1], return_inverse=True)
    a, b = keys // count, keys % count
    of_edge, off_edge = _pairs(normals[sides], edge.ravel(), len(keys))
    open_ = np.bincount(edge.ravel(), minlength=len(keys)) < 2
    off_edge[open_] = math.pi
    bend = np.maximum(_angle(of_edge[:, 0], of_edge[:, 1]), off_edge)
    bent = bend > FLAT
    of_corner, off_corner = _pairs(normals[sides], triangles.T.ravel(), count)
    off_corner[np.concatenate([a[open_], b[open_]])] = math.pi
    on_edge = np.unique(np.concatenate([a[bent], b[bent]]))
    lengths = np.linalg.norm(vertices[b] - vertices[a], axis=1)
    parts = np.ceil(lengths / np.where(bend > SHARP, spacing / 2, spacing)).astype(int)
    chosen = np.flatnonzero(bent & (parts > 1))
    which = np.repeat(chosen, parts[chosen] - 1)
    number = np.arange(len(which)) - np.repeat(np.cumsum(parts[chosen] - 1) - (parts[chosen] - 1), parts[chosen] - 1)
    share = ((number + 1) / parts[which])[:, None]
    edges = _thinned(
        np.concatenate([vertices[on_edge], vertices[a[which]] * (1 - share) + vertices[b[which]] * share]),
        np.concatenate([of_corner[on_edge], of_edge[which]]),
        np.concatenate([off_corner[on_edge], off_edge[which]]),
        0.35 * spacing,
        len(on_edge) if len(on_edge) <= MOST_CORNERS else 0,
    )
    inner, face = _inner(corners, SPARSE * spacing)
    of_face = np.repeat(normals[face, None], 2, axis=1)
    flat = _thinned(inner, of_face, np.zeros(len(inner)), 0.7 * SPARSE * spacing, 0)
    return np.concatenate([edges[0], flat[0]]), np.concatenate([edges[1], flat[1]]), np.concatenate([edges[2], flat[2]])


def _angle(a: Array, b: Array) -> Array:
    """Between unit vectors (N, 3), rad; exact also where it is small."""
    return np.asarray(2 * np.arcsin(np.minimum(1.0, np.linalg.norm(a - b, axis=1) / 2)))


def _pairs(normals: Array, group: Indices, groups: int) -> tuple[Array, Array]:
    """Two normals (G, 2, 3) of each group, far from each other, and how far the others are from the nearer one (G,)."""
    found, off = np.zeros((groups, 2, 3)), np.zeros(groups)
    found[group, 0] = normals  # of several the last
    far = np.argsort(_angle(normals, found[group, 0]), kind="stable")
    found[group[far], 1] = normals[far]
    np.maximum.at(off, group, np.minimum(_angle(normals, found[group, 0]), _angle(normals, found[group, 1])))
    off[np.bincount(group, minlength=groups) == 0] = math.pi
    return found, off


def facet_normals(mesh: TriangleMesh) -> tuple[Array, ...]:
    """Normals (3,) of the `MOST_FACETS` largest groups of parallel facets, the largest first."""
    corners = mesh.corners
    crosses = area_normals(corners)
    areas = np.linalg.norm(crosses, axis=1)
    normals = crosses[areas > 1e-12] / areas[areas > 1e-12, None]
    areas = areas[areas > 1e-12]
    numbers = row_numbers(np.round(100 * normals).astype(np.int64))
    _, group = np.unique(numbers, return_inverse=True)
    sums = np.bincount(group.ravel(), weights=areas)
    found = []
    for k in np.argsort(-sums, kind="stable")[:MOST_FACETS]:
        members = group.ravel() == k
        mean = (normals[members] * areas[members, None]).sum(axis=0)
        found.append(np.asarray(mean / np.linalg.norm(mean)))
    return tuple(found)


def _merged(mesh: TriangleMesh) -> tuple[Array, Indices]:
    """Corners without those that are one, and triangles."""
    cells = np.round((mesh.vertices - mesh.vertices.min(axis=0)) / ROUND).astype(np.int64)
    _, first, number = np.unique(row_numbers(cells), return_index=True, return_inverse=True)
    return mesh.vertices[first], number.ravel()[mesh.triangles]


def _cones(axes: Array, halves: Array, group: Indices, groups: int) -> tuple[Array, Array]:
    """Cones around the cones of each group: axes (G, 3), half angles (G,), rad; the half turn where there is none."""
    sums = np.column_stack([np.bincount(group, axes[:, k], minlength=groups) for k in range(3)])
    lengths = np.linalg.norm(sums, axis=1)
    mean = sums / np.maximum(lengths, 1e-12)[:, None]
    wide = np.zeros(groups)
    np.maximum.at(wide, group, _angle(axes, mean[group]) + halves)
    wide[lengths < 1e-6] = math.pi
    return mean, np.minimum(wide, math.pi)


def _thinned(points: Array, normals: Array, off: Array, cell: float, fixed: int) -> tuple[Array, Array, Array]:
    """One point for each cell that holds any, which faces where all of them do; the first `fixed` all stay."""
    if not len(points):
        return points, normals, off
    numbers = row_numbers(np.floor(points / cell).astype(np.int64))
    _, first, group = np.unique(numbers, return_index=True, return_inverse=True)
    chosen = normals[first][group.ravel()]
    wide = np.zeros(len(first))
    for k in range(2):
        apart = np.minimum(_angle(normals[:, k], chosen[:, 0]), _angle(normals[:, k], chosen[:, 1]))
        np.maximum.at(wide, group.ravel(), apart + off)
    off = off.copy()
    off[first] = np.minimum(wide, math.pi)
    kept = np.union1d(first, np.arange(fixed))
    return points[kept], normals[kept], off[kept]


def _inner(corners: Array, spacing: float) -> tuple[Array, Indices]:
    """Points (N, 3) inside triangles that are cut until they are small, and the triangle of each."""
    points, faces = [], []
    face = np.arange(len(corners))
    while len(corners):
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        small = edges.max(axis=1) <= 1.5 * spacing
        points.append(corners[small].mean(axis=1))
        faces.append(face[small])
        corners, edges, face = corners[~small], edges[~small], face[~small]
        k, rows = edges.argmax(axis=1), np.arange(len(corners))
        a, b, c = corners[rows, k], corners[rows, (k + 1) % 3], corners[rows, (k + 2) % 3]
        middle = (a + b) / 2
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
        face = np.concatenate([face, face])
    return np.concatenate(points), np.concatenate(faces)


def _tree(points: Array, normals: Array, off: Array) -> Cloud:
    count = -(-len(points) // IN_LEAF)
    leaves = 1 << max(0, count - 1).bit_length()
    filled = np.minimum(np.arange(leaves * IN_LEAF), len(points) - 1)  # the last one fills up
    balls, cones = np.zeros((2 * leaves, 4)), np.zeros((2 * leaves, 4))
    axes, halves = normals[filled].reshape(-1, 3), np.repeat(off[filled], 2)
    level = leaves
    while level:
        groups = points[filled].reshape(level, -1, 3)
        middle = (groups.min(axis=1) + groups.max(axis=1)) / 2
        balls[level : 2 * level, :3] = middle
        balls[level : 2 * level, 3] = np.linalg.norm(groups - middle[:, None], axis=2).max(axis=1)
        axes, halves = _cones(axes, halves, np.repeat(np.arange(level), len(axes) // level), level)
        cones[level : 2 * level] = np.column_stack([axes, _sines(halves)])
        level //= 2
    return Cloud(points, np.column_stack([normals.reshape(-1, 6), _sines(off)]), balls, cones, leaves)


def _sines(off: Array) -> Array:
    """By how much normals must point backwards, so that all within angles of them do."""
    return np.where(off - SLACK < math.pi / 2, np.sin(np.minimum(off - SLACK, math.pi / 2)), ANY)
