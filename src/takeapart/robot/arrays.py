"""The flat arrays that the compiled kernels work on. Each is a named tuple, which compiled code can read by field.

Frames: arm link j (1..n) moves with joint j, link 0 is the base, "tool" is the frame between the fingertips. All world
coordinates are those of the assembly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int32]
Flags = NDArray[np.uint8]
Indices = NDArray[np.int64]
Counters = NDArray[np.uint64]  # without a sign, compiled loops need not look for negative indices and vectorise
Distances = NDArray[np.uint16]
RandomState = NDArray[np.uint64]  # (1,) state of a random generator


FIELD_STEP = 0.002  # m, unit of the clearance field
CLEARED = 8  # boxes that are remembered
TABLE_UNIT = 1e-5  # m, unit of the tables of distances between near bodies


class ArmArrays(NamedTuple):
    """A serial chain of n revolute joints; every joint turns about the z axis of its own frame."""

    T_world_base: Floats  # (3, 4)
    T_joint: Floats  # (n, 3, 4) pose of joint j's frame at angle zero in the frame of joint j - 1
    T_tool: Floats  # (3, 4) tool in the frame of the last joint
    lower: Floats  # (n,) rad
    upper: Floats  # (n,) rad
    turning: Integers  # (W,) joints that can turn further than once round: one pose of their link has several angles
    sphere_center: Floats  # (S, 3) m, in the frame of the link that carries it
    sphere_x: Floats  # (S,) m, the same by coordinates: loops over them vectorise
    sphere_y: Floats  # (S,)
    sphere_z: Floats  # (S,)
    sphere_radius: Floats  # (S,) m
    body_start: Counters  # (B + 1,) spheres of body b are body_start[b] .. body_start[b + 1]
    corner: Floats  # (V, 3) m, of the bodies' convex hulls, in the frame of the link that carries them
    corner_start: Indices  # (B + 1,) corners of body b are corner_start[b] .. corner_start[b + 1]
    body_frame: Counters  # (B,) joint frame that the body moves with; 0 is the base
    first_moving: int  # bodies before it stand still with the base, and may touch the world
    body_center: Floats  # (B, 3) m, a ball around the whole body
    body_radius: Floats  # (B,) m
    self_pairs: Integers  # (P, 2) bodies that may touch each other, looked at by their spheres
    near_joints: Integers  # (T, 2) joints between the two bodies of a near pair: a table over their angles tells all
    near_lower: Floats  # (T, 2) rad, first node of the table
    near_step: Floats  # (T, 2) rad, from node to node
    near_shape: Integers  # (T, 2) nodes
    near_reach: Floats  # (T, 2) m, no point of the pair moves further for every radian that the joint turns
    near_start: Indices  # (T,) where the table starts
    near_distance: Distances  # (N,) all tables, row after row, in units of TABLE_UNIT
    held_bodies: Integers  # (Q,) bodies that what the gripper carries may touch


class ChainArrays(NamedTuple):
    """What the kinematics need of `ArmArrays`: a kernel that Python calls often takes no more arrays than it reads."""

    T_world_base: Floats  # (3, 4)
    T_joint: Floats  # (n, 3, 4)
    T_tool: Floats  # (3, 4)


class ChainFrames(NamedTuple):
    """What the kinematics write of a `Workspace`."""

    R: Floats  # (n + 1, 3, 3)
    p: Floats  # (n + 1, 3)
    R_tool: Floats  # (3, 3)
    p_tool: Floats  # (3,)


class HeldArrays(NamedTuple):
    """Boxes that move with the tool: what moves of the gripper, and the part it holds. Exact, no cover.

    "Fingers" are all of the first: the pads, which may touch the part, and then the knuckles, which may not.
    """

    center: Floats  # (H, 3) m, tool frame
    axes: Floats  # (H, 3, 3) rows are the box's axes in the tool frame
    half: Floats  # (H, 3) m
    meets_world: Flags  # (H,) whether the box is checked against the world
    probe_center: Floats  # (C, 3) m, spheres along the boxes for the broad phase, tool frame
    probe_radius: Floats  # (C,) m
    probe_box: Integers  # (C,) box that the sphere belongs to
    group: Integers  # (3,) boxes group[0] .. group[1] are the fingers, group[1] .. group[2] the part
    first_knuckle: int  # of the fingers those from here on are knuckles
    first_wall: int  # boxes from here on are walls of connectors: the pads may not touch them
    group_center: Floats  # (2, 3) m, middle of a box around each group, tool frame
    group_axes: Floats  # (2, 3, 3) rows are its axes in the tool frame
    group_half: Floats  # (2, 3) m
    group_radius: Floats  # (2,) m, of a ball around it


class WorldArrays(NamedTuple):
    """Boxes that stand still, and a grid that tells which of them are near a point."""

    center: Floats  # (W, 3) m
    axes: Floats  # (W, 3, 3) rows are the box's axes
    half: Floats  # (W, 3) m
    owner: Integers  # (W,) part number; the number of parts stands for everything that never leaves
    origin: Floats  # (3,) m, corner of the grid
    cell: float  # m
    per_cell: float  # 1 / cell, 1/m
    shape: Integers  # (3,) cells along x, y, z
    row_radius: Floats  # (K,) m, ascending; row k of the grid serves balls of at most this radius
    start: Integers  # (K, cells + 1) per row: where the entries of a cell start
    entry: Integers  # (E,) boxes near the cells, row after row
    field: Flags  # (cells,) no box that counts is nearer to any point of the cell than this many FIELD_STEP


class Workspace(NamedTuple):
    """Scratch memory of one thread."""

    q: Floats  # (n,) rad, configuration placed last; what turns further than once round within one turn
    turn: Floats  # (n,) rad, how far each joint turns in the motion that is looked at
    R: Floats  # (n + 1, 3, 3) link frames
    p: Floats  # (n + 1, 3)
    R_tool: Floats  # (3, 3)
    p_tool: Floats  # (3,)
    body: Floats  # (B, 3) centres of the balls around the bodies in the world
    placed: Flags  # (B,) whether the spheres of a body were placed: few bodies come near anything
    x: Floats  # (S,) centres of the arm's spheres in the world, where their body was placed
    y: Floats  # (S,)
    z: Floats  # (S,)
    margin: Floats  # (B,) m, how far the bodies move in the motion that is looked at
    rho: Floats  # (n,) m, greatest distance of anything from each axis during it
    omega: Floats  # (n + 1, 3) rad, turn of every frame, to first order
    velocity: Floats  # (n + 1, 3) m, motion of every frame's origin, to first order
    second: Floats  # (n + 1,) m, what the motion of anything in a frame can differ from first order
    group_margin: Floats  # (2,) m, as `margin`, for fingers and part
    group: Floats  # (2, 3) middles of the boxes around fingers and part in the world
    group_axes: Floats  # (2, 3, 3) their axes, where something came near them
    box_center: Floats  # (H, 3) held boxes in the world, where something came near them
    box_axes: Floats  # (H, 3, 3)
    box: Floats  # (4, 3) a box, or a pose, in the frame of a body
    simplex: Floats  # (5, 3) see `separation`
    cleared: Integers  # (CLEARED,) boxes of the world that a body does not meet though one of its spheres does


def workspace(arm: ArmArrays, boxes: int) -> Workspace:
    """Scratch memory for an arm that carries at most `boxes` boxes."""
    n = len(arm.lower)
    return Workspace(
        np.zeros(n),
        np.zeros(n),
        np.zeros((n + 1, 3, 3)),
        np.zeros((n + 1, 3)),
        np.zeros((3, 3)),
        np.zeros(3),
        np.zeros((len(arm.body_frame), 3)),
        np.zeros(len(arm.body_frame), np.uint8),
        np.zeros(len(arm.sphere_radius)),
        np.zeros(len(arm.sphere_radius)),
        np.zeros(len(arm.sphere_radius)),
        np.zeros(len(arm.body_frame)),
        np.zeros(n),
        np.zeros((n + 1, 3)),
        np.zeros((n + 1, 3)),
        np.zeros(n + 1),
        np.zeros(2),
        np.zeros((2, 3)),
        np.zeros((2, 3, 3)),
        np.zeros((boxes, 3)),
        np.zeros((boxes, 3, 3)),
        np.zeros((4, 3)),
        np.zeros((5, 3)),
        np.zeros(CLEARED, np.int32),
    )
