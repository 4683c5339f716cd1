"""Signed distance fields: how far a point is from the surface of a shape, negative inside.

A box is exact. A mesh has a grid of whole numbers around its surface, in which a query interpolates between eight
nodes; beyond its band it only knows that. Which side a node lies on is the majority of three rays along the axes, so
that a mesh with a hole in its surface keeps an inside.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from takeapart.collision.kept import keep_arrays, kept_arrays
from takeapart.collision.triangles import DEEPEST, TriangleTree, nearest2, triangle_tree
from takeapart.compilation import compiled, compiled_lean
from takeapart.model.geometry import Array, Box, Shape, TriangleMesh
from takeapart.model.meshes import Mesh

FINEST, COARSEST, CELLS = 2.5e-4, 1e-3, 200  # m, m, and along the longest edge
MOST_NODES = 30_000_000  # of a field, about; larger bodies have a coarser one
WIDEST = 0.032  # m, of a band: what fits into the numbers
UNIT = 1e-6  # m, of the numbers in the grid
FIELD_ERROR = 0.3  # cells; no interpolated distance is further from the true one
BAND_CELLS = 6  # to either side of the surface

FORMAT = 2  # of what is kept
DIMENSIONS = {
    "half": 1,
    "middle": 1,
    "axes": 2,
    "origin": 1,
    "step": 0,
    "band": 0,
    "values": 3,
}  # of the arrays of a field

Grid = NDArray[np.int16]
Crossings = NDArray[np.int8]


class Field(NamedTuple):
    """What a query reads. A box has no grid."""

    half: Array  # (3,) m, of a box around the middle; of a mesh, of the grid's extent
    middle: Array  # (3,) m, of that box in the part's frame
    axes: Array  # (3, 3) rows are its axes in the part's frame; of a mesh the identity
    origin: Array  # (3,) m, first node
    step: float  # m, between nodes; 0 for a box
    band: float  # m; distances are known up to here
    values: Grid  # (X, Y, Z) in units of UNIT


def field_of(shape: Shape) -> Field:
    """The field of a shape in its part's frame."""
    if isinstance(shape, Box):
        box = shape.bounding_box()
        return box_field(box.T_frame_box, box.half_extents)
    return kept_field(shape) if isinstance(shape, Mesh) else mesh_field(shape.surface())


def kept_field(shape: Mesh) -> Field:
    """The field of a mesh: built once, then read from the cache folder, where its content names it."""
    name = f"field-{FORMAT}-{shape.hash[:32]}"
    found = kept_arrays(name, DIMENSIONS)
    if found is not None:
        return Field(
            found["half"], found["middle"], found["axes"], found["origin"], float(found["step"]), float(found["band"]),
            found["values"],
        )  # fmt: skip
    field = mesh_field(shape.surface())
    keep_arrays(name, {key: np.asarray(getattr(field, key)) for key in Field._fields})
    return field


def box_field(T_frame_box: Array, half: Array) -> Field:
    """The field of a box at a pose in some frame."""
    nothing = np.zeros((1, 1, 1), np.int16)
    axes = np.ascontiguousarray(T_frame_box[:3, :3].T)
    return Field(half, T_frame_box[:3, 3].copy(), axes, np.zeros(3), 0.0, math.inf, nothing)


def mesh_field(mesh: TriangleMesh) -> Field:
    """The field of a mesh in its own frame."""
    low, high = mesh.bounds
    step = float(np.clip((high - low).max() / CELLS, FINEST, COARSEST))
    step = max(step, float(np.prod(high - low + 2 * BAND_CELLS * step) / MOST_NODES) ** (1 / 3))
    band = min(BAND_CELLS * step, WIDEST)
    origin = low - band - step
    shape = np.ceil((high - low + 2 * (band + step)) / step).astype(int) + 1
    values = np.empty(tuple(shape), np.int16)
    tree = triangle_tree(mesh)
    inside: Crossings = np.zeros(tuple(shape), np.int8)
    for axis in range(3):
        _count_crossings(tree.corners, origin, step, axis, inside)
    _fill(tree, origin, step, band, inside, values)
    half = (shape - 1) * step / 2
    return Field(half, origin + half, np.eye(3), origin, step, band, values)


@compiled
def _count_crossings(corners: Array, origin: Array, step: float, axis: int, inside: Crossings) -> None:
    """Adds 1 to every node from which a ray along an axis crosses the surface an odd number of times.

    Rays pass a little beside the nodes, so that they meet no edge of an even drawing.
    """
    u, v = (axis + 1) % 3, (axis + 2) % 3
    nodes_u, nodes_v, nodes = inside.shape[u], inside.shape[v], inside.shape[axis]
    off_u, off_v = step * 1.2345e-3, step * 2.7182e-3
    flips = np.zeros((nodes_u, nodes_v, nodes + 1), np.uint8)
    for t in range(len(corners)):
        au, av = corners[t, 0, u] - origin[u] - off_u, corners[t, 0, v] - origin[v] - off_v
        bu, bv = corners[t, 1, u] - origin[u] - off_u, corners[t, 1, v] - origin[v] - off_v
        cu, cv = corners[t, 2, u] - origin[u] - off_u, corners[t, 2, v] - origin[v] - off_v
        whole = (bu - au) * (cv - av) - (bv - av) * (cu - au)
        if whole == 0.0:
            continue
        first_u = max(0, math.ceil(min(au, bu, cu) / step))
        last_u = min(nodes_u - 1, math.floor(max(au, bu, cu) / step))
        first_v = max(0, math.ceil(min(av, bv, cv) / step))
        last_v = min(nodes_v - 1, math.floor(max(av, bv, cv) / step))
        for i in range(first_u, last_u + 1):
            for j in range(first_v, last_v + 1):
                x, y = i * step, j * step
                wb = ((x - au) * (cv - av) - (y - av) * (cu - au)) / whole
                wc = ((bu - au) * (y - av) - (bv - av) * (x - au)) / whole
                if wb < 0.0 or wc < 0.0 or wb + wc >= 1.0:
                    continue
                a, b, c = corners[t, 0, axis], corners[t, 1, axis], corners[t, 2, axis]
                height = (a + wb * (b - a) + wc * (c - a) - origin[axis]) / step
                k = min(nodes, max(0, math.floor(height) + 1))  # nodes before it see the crossing
                flips[i, j, k] ^= 1
    for i in range(nodes_u):
        for j in range(nodes_v):
            odd = 0
            for k in range(nodes - 1, -1, -1):
                odd ^= flips[i, j, k + 1]
                if odd:
                    if axis == 0:
                        inside[k, i, j] += 1
                    elif axis == 1:
                        inside[j, k, i] += 1
                    else:
                        inside[i, j, k] += 1


@compiled
def _fill(tree: TriangleTree, origin: Array, step: float, band: float, inside: Crossings, values: Grid) -> None:
    """Signed distances of all nodes: blocks that are far from the surface are filled at once."""
    block = 8
    waiting = np.empty(DEEPEST, np.int32)
    largest = band / UNIT
    for i0 in range(0, values.shape[0], block):
        for j0 in range(0, values.shape[1], block):
            for k0 in range(0, values.shape[2], block):
                i1, j1, k1 = (
                    min(i0 + block, values.shape[0]),
                    min(j0 + block, values.shape[1]),
                    min(k0 + block, values.shape[2]),
                )
                x = origin[0] + 0.5 * (i0 + i1 - 1) * step
                y = origin[1] + 0.5 * (j0 + j1 - 1) * step
                z = origin[2] + 0.5 * (k0 + k1 - 1) * step
                reach = band + 0.5 * math.sqrt(3.0) * block * step
                far = nearest2(x, y, z, tree, reach * reach, waiting) >= reach * reach
                for i in range(i0, i1):
                    for j in range(j0, j1):
                        before = -1.0
                        for k in range(k0, k1):
                            distance = band
                            if not far:
                                bound = band if before < 0.0 else min(band, before + step * 1.0001)
                                x, y, z = origin[0] + i * step, origin[1] + j * step, origin[2] + k * step
                                distance = math.sqrt(nearest2(x, y, z, tree, bound * bound, waiting))
                                before = distance
                            value = min(largest, distance / UNIT)
                            values[i, j, k] = -value if inside[i, j, k] >= 2 else value


@compiled_lean
def signed_distance(field: Field, x: float, y: float, z: float) -> float:
    """Signed distance of a point in the field's frame, m; of a mesh no more than the band, and a lower bound outside of
    the grid."""
    dx, dy, dz = x - field.middle[0], y - field.middle[1], z - field.middle[2]
    if field.step == 0.0:
        ex = abs(field.axes[0, 0] * dx + field.axes[0, 1] * dy + field.axes[0, 2] * dz) - field.half[0]
        ey = abs(field.axes[1, 0] * dx + field.axes[1, 1] * dy + field.axes[1, 2] * dz) - field.half[1]
        ez = abs(field.axes[2, 0] * dx + field.axes[2, 1] * dy + field.axes[2, 2] * dz) - field.half[2]
        if ex <= 0.0 and ey <= 0.0 and ez <= 0.0:
            return max(ex, ey, ez)
        ex, ey, ez = max(ex, 0.0), max(ey, 0.0), max(ez, 0.0)
        return math.sqrt(ex * ex + ey * ey + ez * ez)
    ex = max(abs(dx) - field.half[0], 0.0)
    ey = max(abs(dy) - field.half[1], 0.0)
    ez = max(abs(dz) - field.half[2], 0.0)
    if ex > 0.0 or ey > 0.0 or ez > 0.0:
        return field.band + math.sqrt(ex * ex + ey * ey + ez * ez)
    s = 1.0 / field.step
    u, v, w = (x - field.origin[0]) * s, (y - field.origin[1]) * s, (z - field.origin[2]) * s
    values = field.values
    i = min(max(int(u), 0), values.shape[0] - 2)
    j = min(max(int(v), 0), values.shape[1] - 2)
    k = min(max(int(w), 0), values.shape[2] - 2)
    u, v, w = u - i, v - j, w - k
    low = (values[i, j, k] * (1 - w) + values[i, j, k + 1] * w) * (1 - v) + (
        values[i, j + 1, k] * (1 - w) + values[i, j + 1, k + 1] * w
    ) * v
    high = (values[i + 1, j, k] * (1 - w) + values[i + 1, j, k + 1] * w) * (1 - v) + (
        values[i + 1, j + 1, k] * (1 - w) + values[i + 1, j + 1, k + 1] * w
    ) * v
    return UNIT * (low * (1 - u) + high * u)


@compiled
def signed_distances(field: Field, points: Array) -> Array:
    """(N,) m, of points (N, 3) in the field's frame."""
    found = np.empty(len(points))
    for i in range(len(points)):
        found[i] = signed_distance(field, points[i, 0], points[i, 1], points[i, 2])
    return found


def least_distance(field: Field, points: Array) -> float:
    """Least signed distance of points (N, 3) in the field's frame, m."""
    return float(signed_distances(field, points).min())


def surface_points(mesh: TriangleMesh, spacing: float) -> Array:
    """Points (N, 3), m, on a surface, no place of it further than about `spacing` from one, all sharp corners among
    them: centres and corners of triangles that are cut until they are small."""
    corners = mesh.corners.astype(float)
    found = [mesh.vertices[np.unique(mesh.triangles)]]
    while len(corners):
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        small = edges.max(axis=1) <= 1.5 * spacing
        found.append(corners[small].mean(axis=1))
        corners, edges = corners[~small], edges[~small]
        if not len(corners):
            break
        k = edges.argmax(axis=1)
        rows = np.arange(len(corners))
        a, b, c = corners[rows, k], corners[rows, (k + 1) % 3], corners[rows, (k + 2) % 3]
        middle = (a + b) / 2
        found.append(middle)
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    points = np.concatenate(found)
    cells = np.round(points / (0.7 * spacing)).astype(np.int64)  # of points that stand close together the first is kept
    sharp = len(found[0])
    _, first = np.unique(cells, axis=0, return_index=True)
    if sharp <= MOST_CORNERS:
        first = np.union1d(first, np.arange(sharp))
    return np.ascontiguousarray(points[np.sort(first)])


MOST_CORNERS = 3000  # of a mesh; those of a finer one are thinned out like the rest
