"""Signed distance fields: how far a point is from the surface of a shape, negative inside.

A box is exact. A mesh has a grid of whole numbers around its surface, in which a query interpolates between eight
nodes. Beyond the grid's band distances are lower bounds, by the middles of blocks of nodes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from takeapart.collision.grids import BLOCK, UNIT, Coarse, Grid, distance_grid
from takeapart.collision.kept import keep_arrays, kept_arrays
from takeapart.compilation import compiled, compiled_lean
from takeapart.model.geometry import Array, Box, Shape, TriangleMesh
from takeapart.model.meshes import Mesh

MIDDLE = 0.5 * (BLOCK - 1)  # of a block, in nodes
FIELD_ERROR = 0.3  # cells; how far an interpolated distance is from the true one, but beside sharp edges: 0.45 there

FORMAT = 3  # of what is kept
DIMENSIONS = {
    "half": 1,
    "middle": 1,
    "axes": 2,
    "origin": 1,
    "step": 0,
    "band": 0,
    "values": 3,
    "coarse": 3,
}  # of the arrays of a field


class Field(NamedTuple):
    """What a query reads. A box has no grid."""

    half: Array  # (3,) m, of a box around the middle; of a mesh, of the grid's extent
    middle: Array  # (3,) m, of that box in the part's frame
    axes: Array  # (3, 3) rows are its axes in the part's frame; of a mesh the identity
    origin: Array  # (3,) m, first node
    step: float  # m, between nodes; 0 for a box
    band: float  # m; distances are known up to here
    values: Grid  # (X, Y, Z) in units of UNIT
    coarse: Coarse  # (X / 8, Y / 8, Z / 8) m, at the middles of blocks of nodes


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
            found["values"], found["coarse"],
        )  # fmt: skip
    field = mesh_field(shape.surface())
    keep_arrays(name, {key: np.asarray(getattr(field, key)) for key in Field._fields})
    return field


def box_field(T_frame_box: Array, half: Array) -> Field:
    """The field of a box at a pose in some frame."""
    nothing = np.zeros((1, 1, 1), np.int16)
    axes = np.ascontiguousarray(T_frame_box[:3, :3].T)
    middles = np.zeros((1, 1, 1), np.float32)
    return Field(half, T_frame_box[:3, 3].copy(), axes, np.zeros(3), 0.0, math.inf, nothing, middles)


def mesh_field(mesh: TriangleMesh) -> Field:
    """The field of a mesh in its own frame."""
    grid = distance_grid(mesh)
    half = (np.array(grid.values.shape) - 1) * grid.step / 2
    return Field(half, grid.origin + half, np.eye(3), grid.origin, grid.step, grid.band, grid.values, grid.coarse)


@compiled_lean
def signed_distance(field: Field, x: float, y: float, z: float) -> float:
    """Signed distance of a point in the field's frame, m; of a mesh a lower bound where it is further than the band."""
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
    value = UNIT * (low * (1 - u) + high * u)
    if abs(value) < 0.999 * field.band:
        return value
    a, b, c = i // BLOCK, j // BLOCK, k // BLOCK  # far from the surface: as far as the middle of the block, at least
    u, v, w = i + u - a * BLOCK - MIDDLE, j + v - b * BLOCK - MIDDLE, k + w - c * BLOCK - MIDDLE
    bound = field.coarse[a, b, c] - field.step * math.sqrt(u * u + v * v + w * w)
    return max(value, bound) if value > 0.0 else min(value, bound)


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
    _, first = np.unique(row_numbers(cells), return_index=True)
    if sharp <= MOST_CORNERS:
        first = np.union1d(first, np.arange(sharp))
    return np.ascontiguousarray(points[np.sort(first)])


def row_numbers(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """(N,) one number for each row (N, 3), in the same order."""
    x, y, z = (rows - rows.min(axis=0)).T
    if (float(x.max()) + 1) * (float(y.max()) + 1) * (float(z.max()) + 1) < 2**62:
        return np.asarray((x * (y.max() + 1) + y) * (z.max() + 1) + z)
    return np.unique(rows, axis=0, return_inverse=True)[1].ravel().astype(np.int64)


MOST_CORNERS = 3000  # of a mesh; those of a finer one are thinned out like the rest
