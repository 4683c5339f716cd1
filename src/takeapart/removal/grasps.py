"""Where a part can be gripped.

A box: every 2 cm along all four sides of each long edge, from 3 cm off each end, both finger orders (Sec. VI). Any
other form: where two pads find opposite surfaces (`removal.mesh_grasps`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache, cmp_to_key
from itertools import product
from typing import Literal

import numpy as np

from takeapart.model.assembly import Part
from takeapart.model.geometry import Array, OrientedBox, Shape
from takeapart.model.meshes import Mesh
from takeapart.removal.candidates import GraspCandidate as GraspCandidate
from takeapart.removal.mesh_grasps import LEAST_CONTACT, MOST_OVERHANG, MeshGrasps, mesh_grasps
from takeapart.workcell import Workcell

SPACING = 0.02  # m, between grasps along the part
END_MARGIN = 0.03  # m, from the part's ends
SAME_EDGE = 1e-6  # m; a part shorter by less has as many grasps: lengths in 32-bit floats are off by up to 6e-8

BOX_VOLUME = 1e-6  # relative; a mesh that fills its box as well is a box

Unholdable = Literal["weight", "slip", "width", "contact", "fingers"]
_SignedAxis = tuple[int, int]  # number of a box's axis, and 1 or -1: the way along it


def grasp_positions(length: float) -> Array:
    """Distances (K,), m, of the grasps from one end of a part; its middle if it is too short for the margins."""
    usable = length - 2 * END_MARGIN
    if usable < 0:
        return np.array([length / 2])
    return END_MARGIN + SPACING * np.arange(int(np.floor((usable + SAME_EDGE) / SPACING)) + 1, dtype=float)


def grasp_candidates(part: Part, maximum_opening: float) -> list[GraspCandidate]:
    """All grasps of a part as wide as the gripper allows: along every axis of its bounding box that has room for both
    margins or, if none has, in the middle along all three.

    Which grasps, from which end they are counted and their order depend on the body in the world only: not on how its
    frame is turned, nor on which edge is named first.
    """
    box = part.shape.bounding_box()
    axes = _axes_in_the_world(box.moved(part.T_world_part))
    edges = 2 * box.half_extents
    long = [axis for axis in axes if edges[axis[0]] >= 2 * END_MARGIN - SAME_EDGE] or axes
    poses: list[Array] = []
    widths: list[float] = []
    for along in long:
        sides = [axis for axis in axes if axis != along]
        pairs = [pair for pair in (sides, sides[::-1]) if edges[pair[1][0]] <= maximum_opening]
        if not pairs:
            continue
        turns = np.concatenate([_turns(approach, closing) for approach, closing in pairs])
        number, sign = along
        distances = grasp_positions(float(edges[number])) - box.half_extents[number]
        T = np.zeros((len(distances), len(turns), 4, 4))
        T[..., :3, :3] = turns
        T[..., number, 3] = sign * distances[:, None]
        T[..., 3, 3] = 1.0
        poses.extend((box.T_frame_box @ T).reshape(-1, 4, 4))
        widths += [float(edges[closing]) for _, (closing, _) in pairs for _ in range(4)] * len(distances)
    return [GraspCandidate(pose, width) for pose, width in zip(poses, widths, strict=True)]


def _axes_in_the_world(box: OrientedBox) -> list[_SignedAxis]:
    """The three axes of a box in the world, each away from its end with the smaller world coordinates (x, then y, then
    z), those that go furthest along x, then y, then z first. Coordinates closer than `SAME_EDGE` are the same."""
    ends = box.T_frame_box[:3, :3] * (2 * box.half_extents)  # (3, 3) m, columns from one end of an axis to the other
    signs = [_first_difference(end) for end in ends.T]
    directions = box.T_frame_box[:3, :3].T * np.array(signs)[:, None]
    order = sorted(range(3), key=cmp_to_key(lambda a, b: _first_difference(directions[b] - directions[a])))
    return [(axis, signs[axis]) for axis in order]


def _first_difference(difference: Array) -> int:
    """Sign of the first of three coordinates (3,) that is not zero within `SAME_EDGE`; 1 if all are."""
    return next((1 if value > 0 else -1 for value in difference if abs(value) > SAME_EDGE), 1)


def is_box(shape: Shape) -> bool:
    """Whether a shape is gripped as a box: all but meshes, and meshes that fill their box."""
    if not isinstance(shape, Mesh):
        return True
    volume = 8 * float(shape.bounding_box().half_extents.prod())
    return len(shape.boxes()) == 1 and abs(volume - shape.volume()) <= BOX_VOLUME * volume


def candidates_of(part: Part, workcell: Workcell) -> Sequence[GraspCandidate]:
    """All grasps of a part of any shape with the fingers of a workcell, whatever it weighs."""
    if is_box(part.shape):
        return grasp_candidates(part, workcell.description.maximum_opening)
    return found_on_mesh(part, workcell).candidates


def found_on_mesh(part: Part, workcell: Workcell) -> MeshGrasps:
    """Grasps of a part that is no box, and what is in the way of more."""
    return mesh_grasps(part, workcell.description, workcell.friction)


def ungraspable(part: Part, workcell: Workcell) -> Unholdable | None:
    """What keeps the gripper from holding a part, whatever stands around it: more weight than the payload, or than
    friction holds, more width than the fingers open, too little surface for the pads, or fingers that reach into the
    part wherever there is enough; None if nothing does."""
    if part.mass > workcell.payload:
        return "weight"
    if part.mass > workcell.grip:
        return "slip"
    if candidates_of(part, workcell):
        return None
    if is_box(part.shape):
        return "width"
    found = found_on_mesh(part, workcell)
    if found.narrowest > workcell.description.maximum_opening:
        return "width"
    return "contact" if found.contact < LEAST_CONTACT else "fingers"


@cache
def _turns(approach_axis: _SignedAxis, closing_axis: _SignedAxis) -> Array:
    """The four orientations (4, 3, 3) of the tool that approach along one axis, either way, and close along another."""
    turns = np.zeros((4, 3, 3))
    for turn, (approach_sign, closing_sign) in zip(turns, product((1.0, -1.0), repeat=2), strict=True):
        turn[approach_axis[0], 2] = approach_axis[1] * approach_sign
        turn[closing_axis[0], 1] = closing_axis[1] * closing_sign
        turn[:, 0] = np.cross(turn[:, 1], turn[:, 2])
    return turns


def straight_line_bounds(part: Part, grasps: Sequence[GraspCandidate], lift_height: float, goal: Array) -> Array:
    """Least length (K,) of a removal with each grasp, m: straight up, then straight to the goal (Eq. 1)."""
    centers = np.array([grasp.T_part_tool[:, 3] for grasp in grasps]).reshape(-1, 4) @ part.T_world_part[:3].T
    bounds: Array = lift_height + np.linalg.norm(centers + [0.0, 0.0, lift_height] - goal, axis=1)
    return bounds


def shortest_first(part: Part, workcell: Workcell) -> tuple[GraspCandidate, ...]:
    """All grasps with which the gripper can hold a part, those with the shortest straight line first."""
    found = [] if ungraspable(part, workcell) else candidates_of(part, workcell)
    lengths = tied(straight_line_bounds(part, found, workcell.lift_height, workcell.goal))
    return tuple(found[k] for k in np.argsort(lengths, kind="stable"))


def tied(lengths: Array) -> Array:
    """The same lengths (K,), m, each lowered to the shortest of those with which it ties: the next shorter one is
    closer than `SAME_EDGE`. The last digit of a sum does not decide which of two mirrored grasps comes first."""
    ascending = np.argsort(lengths, kind="stable")
    apart = np.diff(lengths[ascending], prepend=-math.inf) > SAME_EDGE
    lowered = np.empty_like(lengths)
    lowered[ascending] = lengths[ascending][apart][np.cumsum(apart) - 1]
    return lowered


def volume_bound(part: Part, lift_height: float, goal: Array) -> float:
    """Least length of a removal with a grasp anywhere in the part's volume, m: straight up, then straight to the goal
    (Eq. 1). Attained where nothing is in the way.

    What is no box is gripped between its surfaces, and over its edges: there the volume is that of its bounding box,
    larger by `MOST_OVERHANG` on all sides.

    Args:
        goal: (3,) m, in the world.
    """
    boxes = part.boxes_in_world()
    if not is_box(part.shape):
        around = part.shape.bounding_box()
        grown = OrientedBox(around.T_frame_box, around.half_extents + MOST_OVERHANG)
        boxes = [grown.moved(part.T_world_part)]
    nearest = math.inf
    for box in boxes:
        raised = box.T_frame_box.copy()
        raised[2, 3] += lift_height
        inside = np.clip((goal - raised[:3, 3]) @ raised[:3, :3], -box.half_extents, box.half_extents)
        nearest = min(nearest, float(np.linalg.norm(raised[:3, :3] @ inside + raised[:3, 3] - goal)))
    return lift_height + nearest
