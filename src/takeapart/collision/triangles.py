"""Exact distances from triangles, found fast by a tree of boxes around them.

The tree is complete and binary: node k has the children 2 k and 2 k + 1, the root is node 1, and every leaf holds
`IN_LEAF` triangles that stand next to each other on a curve through space.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from takeapart.compilation import compiled, compiled_lean
from takeapart.model.geometry import Array, TriangleMesh

IN_LEAF = 4
FLAT = 1e-10  # squared sine of the angle of a triangle that counts as a line
DEEPEST = 64  # nodes that wait at once; far more than the levels of any tree

Integers = NDArray[np.int32]


class TriangleTree(NamedTuple):
    """Triangles of a surface and boxes around groups of them."""

    corners: Array  # (T, 3, 3) m, in the order of the leaves
    balls: Array  # (T, 4) m: a ball that holds each triangle, centre and radius
    boxes: Array  # (nodes, 6) m: least and greatest coordinates; of nodes without triangles the least are infinite
    leaves: int  # first node that is a leaf


def triangle_tree(mesh: TriangleMesh) -> TriangleTree:
    """The tree over all triangles of a surface."""
    corners = mesh.corners.astype(float)
    corners = np.ascontiguousarray(corners[curve_order(corners.mean(axis=1))])
    count = -(-len(corners) // IN_LEAF)
    leaves = 1 << max(0, count - 1).bit_length()
    boxes = np.empty((2 * leaves, 6))
    boxes[:, :3], boxes[:, 3:] = np.inf, -np.inf
    starts = np.arange(0, len(corners), IN_LEAF)
    boxes[leaves : leaves + count, :3] = np.minimum.reduceat(corners.min(axis=1), starts)
    boxes[leaves : leaves + count, 3:] = np.maximum.reduceat(corners.max(axis=1), starts)
    level = leaves
    while level > 1:
        level //= 2
        below = boxes[2 * level : 4 * level].reshape(level, 2, 6)
        boxes[level : 2 * level, :3] = below[:, :, :3].min(axis=1)
        boxes[level : 2 * level, 3:] = below[:, :, 3:].max(axis=1)
    middle = (corners.min(axis=1) + corners.max(axis=1)) / 2
    radius = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    return TriangleTree(corners, np.column_stack([middle, radius]), boxes, leaves)


def curve_order(points: Array) -> NDArray[np.int64]:
    """An order of points (N, 3) in which neighbours are near each other: Morton's curve."""
    low, span = points.min(axis=0), max(float(np.ptp(points, axis=0).max()), 1e-12)
    cells = ((points - low) / span * 1023.999).astype(np.uint64)
    code = np.zeros(len(points), np.uint64)
    for bit in range(10):
        for axis in range(3):
            code |= (cells[:, axis] >> np.uint64(bit) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return np.argsort(code, kind="stable")


@compiled_lean
def _segment_distance2(x: float, y: float, z: float, ux: float, uy: float, uz: float) -> float:
    """Squared distance of a point from the segment between the origin and another point."""
    uu = ux * ux + uy * uy + uz * uz
    s = min(1.0, max(0.0, (x * ux + y * uy + z * uz) / uu)) if uu > 0.0 else 0.0
    x, y, z = x - s * ux, y - s * uy, z - s * uz
    return x * x + y * y + z * z


@compiled_lean
def triangle_distance2(x: float, y: float, z: float, corners: Array, t: int) -> float:
    """Squared distance of a point from a triangle; Ericson: Real-Time Collision Detection, 5.1.5. Of a triangle that is
    flat, rounding would choose a point beside it: it is as far as its edges."""
    ax, ay, az = corners[t, 0, 0], corners[t, 0, 1], corners[t, 0, 2]
    ux, uy, uz = corners[t, 1, 0] - ax, corners[t, 1, 1] - ay, corners[t, 1, 2] - az
    vx, vy, vz = corners[t, 2, 0] - ax, corners[t, 2, 1] - ay, corners[t, 2, 2] - az
    px, py, pz = x - ax, y - ay, z - az
    uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
    up, vp = ux * px + uy * py + uz * pz, vx * px + vy * py + vz * pz
    if uu * vv - uv * uv <= FLAT * uu * vv:
        wx, wy, wz = vx - ux, vy - uy, vz - uz
        edges = min(_segment_distance2(px, py, pz, ux, uy, uz), _segment_distance2(px, py, pz, vx, vy, vz))
        return min(edges, _segment_distance2(px - ux, py - uy, pz - uz, wx, wy, wz))
    s, r = 0.0, 0.0  # the nearest point is a + s u + r v
    d3, d4, d5, d6 = up - uu, vp - uv, up - uv, vp - vv
    vc, vb, va = up * d4 - d3 * vp, d5 * vp - up * d6, d3 * d6 - d5 * d4
    if up <= 0 and vp <= 0:
        pass
    elif d3 >= 0 and d4 <= d3:
        s = 1.0
    elif d6 >= 0 and d5 <= d6:
        r = 1.0
    elif vc <= 0 and up >= 0 and d3 <= 0:
        s = up / uu if uu > 0 else 0.0
    elif vb <= 0 and vp >= 0 and d6 <= 0:
        r = vp / vv if vv > 0 else 0.0
    elif va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        whole = (d4 - d3) + (d5 - d6)
        r = (d4 - d3) / whole if whole > 0 else 0.0
        s = 1.0 - r
    else:
        whole = va + vb + vc
        if whole > 0:
            s, r = vb / whole, vc / whole
    ex, ey, ez = px - s * ux - r * vx, py - s * uy - r * vy, pz - s * uz - r * vz
    return ex * ex + ey * ey + ez * ez


@compiled_lean
def box_distance2(x: float, y: float, z: float, boxes: Array, k: int) -> float:
    """Squared distance of a point from box k."""
    ex = max(boxes[k, 0] - x, x - boxes[k, 3], 0.0)
    ey = max(boxes[k, 1] - y, y - boxes[k, 4], 0.0)
    ez = max(boxes[k, 2] - z, z - boxes[k, 5], 0.0)
    return ex * ex + ey * ey + ez * ez


@compiled_lean
def nearest2(x: float, y: float, z: float, tree: TriangleTree, bound2: float, waiting: Integers) -> float:
    """Squared distance of a point from a surface, or `bound2` if it is not below that."""
    best, count = bound2, 1
    waiting[0] = 1
    while count:
        count -= 1
        node = waiting[count]
        if box_distance2(x, y, z, tree.boxes, node) >= best:
            continue
        if node >= tree.leaves:
            first = (node - tree.leaves) * IN_LEAF
            for t in range(first, min(first + IN_LEAF, len(tree.corners))):
                best = min(best, triangle_distance2(x, y, z, tree.corners, t))
        else:
            left = box_distance2(x, y, z, tree.boxes, 2 * node)
            right = box_distance2(x, y, z, tree.boxes, 2 * node + 1)
            nearer = 0 if left <= right else 1
            if max(left, right) < best:
                waiting[count] = 2 * node + 1 - nearer
                count += 1
            if min(left, right) < best:
                waiting[count] = 2 * node + nearer
                count += 1
    return best


@compiled
def distances(points: Array, tree: TriangleTree, bound: float) -> Array:
    """Distances (N,), m, of points (N, 3) from a surface; `bound` where they are not below that."""
    found, waiting = np.empty(len(points)), np.empty(DEEPEST, np.int32)
    for i in range(len(points)):
        found[i] = np.sqrt(nearest2(points[i, 0], points[i, 1], points[i, 2], tree, bound * bound, waiting))
    return found
