"""Grids of signed distances around a surface: a fine one in a band, and a coarse one of the middles of its blocks.

A block of 8 x 8 x 8 nodes looks once which triangles can be the nearest of any of its nodes, each 4 x 4 x 4 nodes of it
once more among those, so that a node looks at few. Which side a node lies on is the majority of three rays along the
axes, so that a mesh with a hole in its surface keeps an inside.
"""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from takeapart.collision.triangles import (
    DEEPEST,
    IN_LEAF,
    Integers,
    TriangleTree,
    box_distance2,
    nearest2,
    triangle_distance2,
    triangle_tree,
)
from takeapart.compilation import compiled, compiled_lean
from takeapart.model.geometry import Array, TriangleMesh

FINEST, COARSEST, CELLS = 2.5e-4, 1e-3, 200  # m, m, and along the longest edge
MOST_NODES = 30_000_000  # of a grid, about; larger bodies have a coarser one
BAND, LEAST_BAND_CELLS = 1.5e-3, 3  # m to either side of the surface, and cells
WIDEST = 0.032  # m, of a band: what fits into the numbers
UNIT = 1e-6  # m, of the numbers in the grid
BLOCK, PIECE = 8, 4  # nodes along the edge of a block, and of a piece of it

Grid = NDArray[np.int16]
Coarse = NDArray[np.float32]
Crossings = NDArray[np.int8]


@dataclass(frozen=True, eq=False)
class DistanceGrid:
    """Signed distances at nodes.

    Args:
        origin: (3,) m, first node.
        step: m, between nodes.
        band: m; distances are known up to here.
        values: (X, Y, Z) in units of `UNIT`.
        coarse: (X / 8, Y / 8, Z / 8) m, at the middles of blocks of 8 nodes each way, known everywhere.
    """

    origin: Array
    step: float
    band: float
    values: Grid
    coarse: Coarse


def distance_grid(mesh: TriangleMesh) -> DistanceGrid:
    """The grid of a mesh in its own frame; the same however many threads work on it."""
    low, high = mesh.bounds
    step = float(np.clip((high - low).max() / CELLS, FINEST, COARSEST))
    margin = max(BAND, LEAST_BAND_CELLS * step)
    step = max(step, float(np.prod(high - low + 2 * margin) / MOST_NODES) ** (1 / 3))
    band = min(max(BAND, LEAST_BAND_CELLS * step), WIDEST)
    origin = low - band - step
    shape = tuple((np.ceil((high - low + 2 * (band + step)) / step).astype(int) + 1).tolist())
    tree = triangle_tree(mesh)
    inside: Crossings = np.zeros(shape, np.int8)
    for axis in range(3):
        _count_crossings(tree.corners, origin, step, axis, inside)
    values = np.empty(shape, np.int16)
    coarse = np.empty(tuple(-(-nodes // BLOCK) for nodes in shape), np.float32)
    slabs = range(coarse.shape[0])
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:  # kernels hold no lock of the interpreter
        list(pool.map(lambda slab: _fill(tree, origin, step, band, inside, values, coarse, slab), slabs))
    return DistanceGrid(origin, step, band, values, coarse)


@compiled
def _count_crossings(corners: Array, origin: Array, step: float, axis: int, inside: Crossings) -> None:
    """Adds 1 to every node from which a ray along an axis crosses the surface an odd number of times.

    Rays pass a little beside the nodes, so that they meet no edge of an even drawing.
    """
    u, v = (axis + 1) % 3, (axis + 2) % 3
    nodes_u, nodes_v, nodes = inside.shape[u], inside.shape[v], inside.shape[axis]
    off_u, off_v = step * 1.2345e-3, step * 2.7182e-3
    flips = np.zeros(inside.shape, np.uint8)  # where a crossing lies between a node and the next
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
                k = math.floor(height)  # this node and those before it see the crossing
                if k < 0:
                    continue
                k = min(nodes - 1, k)
                if axis == 0:
                    flips[k, i, j] ^= 1
                elif axis == 1:
                    flips[j, k, i] ^= 1
                else:
                    flips[i, j, k] ^= 1
    for x in range(inside.shape[0] - 1, -1, -1):  # odd numbers are carried from node to node
        for y in range(inside.shape[1] - 1, -1, -1):
            if axis == 0 and x < inside.shape[0] - 1:
                for z in range(inside.shape[2]):
                    flips[x, y, z] ^= flips[x + 1, y, z]
            elif axis == 1 and y < inside.shape[1] - 1:
                for z in range(inside.shape[2]):
                    flips[x, y, z] ^= flips[x, y + 1, z]
            elif axis == 2:
                odd = np.uint8(0)
                for z in range(inside.shape[2] - 1, -1, -1):
                    odd ^= flips[x, y, z]
                    flips[x, y, z] = odd
            for z in range(inside.shape[2]):
                inside[x, y, z] += flips[x, y, z]


@compiled
def _fill(
    tree: TriangleTree,
    origin: Array,
    step: float,
    band: float,
    inside: Crossings,
    values: Grid,
    coarse: Coarse,
    slab: int,
) -> None:
    """Signed distances of all nodes of the blocks of a slab across x."""
    count = len(tree.corners)
    waiting = np.empty(DEEPEST, np.int32)
    of_block, of_piece, apart = np.empty(count, np.int32), np.empty(count, np.int32), np.empty(count)
    around = 0.5 * math.sqrt(3.0) * step
    block_radius, piece_radius = (BLOCK - 1) * around, (PIECE - 1) * around  # of balls around their nodes
    middle, largest = 0.5 * (BLOCK - 1) * step, band / UNIT
    before = math.inf
    i0 = slab * BLOCK
    i1 = min(i0 + BLOCK, values.shape[0])
    for j0 in range(0, values.shape[1], BLOCK):
        j1 = min(j0 + BLOCK, values.shape[1])
        for k0 in range(0, values.shape[2], BLOCK):
            k1 = min(k0 + BLOCK, values.shape[2])
            x, y, z = origin[0] + i0 * step + middle, origin[1] + j0 * step + middle, origin[2] + k0 * step + middle
            bound = (before + 1.001 * BLOCK * step) ** 2 if k0 > 0 else math.inf
            before = math.sqrt(nearest2(x, y, z, tree, bound, waiting))
            near = min(i0 + BLOCK // 2, i1 - 1), min(j0 + BLOCK // 2, j1 - 1), min(k0 + BLOCK // 2, k1 - 1)
            coarse[slab, j0 // BLOCK, k0 // BLOCK] = -before if inside[near] >= 2 else before
            listed = 0
            if before < band + block_radius:
                reach = min(before + 2 * block_radius, band + block_radius) + 1e-9
                listed = _listed(x, y, z, tree, reach, waiting, of_block)
            for i in range(i0, i1, PIECE):
                for j in range(j0, j1, PIECE):
                    for k in range(k0, k1, PIECE):
                        _fill_piece(
                            tree, origin, step, band, largest, piece_radius, inside, values, i, j, k, of_block, listed,
                            of_piece, apart,
                        )  # fmt: skip


@compiled_lean
def _listed(x: float, y: float, z: float, tree: TriangleTree, reach: float, waiting: Integers, found: Integers) -> int:
    """Which triangles are within `reach`, m, of a point; returns how many."""
    listed, count = 0, 1
    waiting[0] = 1
    while count:
        count -= 1
        node = waiting[count]
        if box_distance2(x, y, z, tree.boxes, node) >= reach * reach:
            continue
        if node < tree.leaves:
            waiting[count], waiting[count + 1] = 2 * node + 1, 2 * node
            count += 2
            continue
        first = (node - tree.leaves) * IN_LEAF
        for t in range(first, min(first + IN_LEAF, len(tree.corners))):
            if triangle_distance2(x, y, z, tree.corners, t) < reach * reach:
                found[listed] = t
                listed += 1
    return listed


@compiled_lean
def _fill_piece(
    tree: TriangleTree,
    origin: Array,
    step: float,
    band: float,
    largest: float,
    radius: float,
    inside: Crossings,
    values: Grid,
    i0: int,
    j0: int,
    k0: int,
    of_block: Integers,
    listed: int,
    of_piece: Integers,
    apart: Array,
) -> None:
    """Signed distances of up to 4 x 4 x 4 nodes, by the triangles listed for their block.

    Args:
        radius: m, of a ball around the nodes.
        of_piece, apart: room for the triangles of the piece, and m of each from its middle.
    """
    i1, j1, k1 = (
        min(i0 + PIECE, values.shape[0]),
        min(j0 + PIECE, values.shape[1]),
        min(k0 + PIECE, values.shape[2]),
    )
    middle = 0.5 * (PIECE - 1) * step
    cx, cy, cz = origin[0] + i0 * step + middle, origin[1] + j0 * step + middle, origin[2] + k0 * step + middle
    count, least, furthest = 0, math.inf, band + radius
    for n in range(listed):
        t = of_block[n]
        bx, by, bz = cx - tree.balls[t, 0], cy - tree.balls[t, 1], cz - tree.balls[t, 2]
        to_ball = furthest + tree.balls[t, 3]
        if bx * bx + by * by + bz * bz >= to_ball * to_ball:
            continue
        distance = math.sqrt(triangle_distance2(cx, cy, cz, tree.corners, t))
        if distance >= furthest:
            continue
        of_piece[count], apart[count] = t, distance
        if distance < least:  # the nearest stands first
            of_piece[0], of_piece[count] = of_piece[count], of_piece[0]
            apart[0], apart[count] = apart[count], apart[0]
            least = distance
            furthest = min(furthest, least + 2 * radius + 1e-9)
        count += 1
    last = 0
    for i in range(i0, i1):
        for j in range(j0, j1):
            for k in range(k0, k1):
                value = largest
                if count:
                    x, y, z = origin[0] + i * step, origin[1] + j * step, origin[2] + k * step
                    off = math.sqrt((x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2) + 1e-12
                    best2 = min(band * band, triangle_distance2(x, y, z, tree.corners, of_piece[last]))
                    best = math.sqrt(best2)
                    for n in range(count):
                        if apart[n] - off >= best:
                            continue
                        t = of_piece[n]
                        bx, by, bz = x - tree.balls[t, 0], y - tree.balls[t, 1], z - tree.balls[t, 2]
                        to_ball = best + tree.balls[t, 3] + 1e-12
                        if bx * bx + by * by + bz * bz >= to_ball * to_ball:
                            continue
                        distance2 = triangle_distance2(x, y, z, tree.corners, t)
                        if distance2 < best2:
                            best2, last = distance2, n
                            best = math.sqrt(best2)
                    value = min(largest, best / UNIT)
                values[i, j, k] = -value if inside[i, j, k] >= 2 else value
