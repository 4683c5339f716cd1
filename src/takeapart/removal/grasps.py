"""Where a part can be gripped: every 2 cm along all four sides, from 3 cm off each end, both finger orders (Sec.
VI).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np

from takeapart.assembly import Part
from takeapart.geometry import Array
from takeapart.workcell import Workcell

SPACING = 0.02  # m, between grasps along the part
END_MARGIN = 0.03  # m, from the part's ends
SAME_EDGE = 1e-6  # m; a part shorter by less has as many grasps: lengths in 32-bit floats are off by up to 6e-8


@dataclass(frozen=True, eq=False)
class GraspCandidate:
    """A grasp in the part's frame.

    Args:
        T_part_tool: (4, 4) pose of the tool: z is the approach direction, y the closing direction of the fingers.
        width: of the part between the fingers, m.
    """

    T_part_tool: Array
    width: float


def grasp_positions(length: float) -> Array:
    """Distances (K,), m, of the grasps from one end of a part; its middle if it is too short for the margins."""
    usable = length - 2 * END_MARGIN
    if usable < 0:
        return np.array([length / 2])
    return END_MARGIN + SPACING * np.arange(int(np.floor((usable + SAME_EDGE) / SPACING)) + 1, dtype=float)


def grasp_candidates(part: Part, maximum_opening: float) -> list[GraspCandidate]:
    """All grasps of a part along the longest axis of its bounding box, as wide as the gripper allows."""
    box = part.shape.bounding_box()
    long_axis = int(np.argmax(box.half_extents))
    sides = [axis for axis in range(3) if axis != long_axis]
    distances = grasp_positions(2 * float(box.half_extents[long_axis])) - box.half_extents[long_axis]
    turns, widths = [], []
    for approach_axis, closing_axis in (sides, sides[::-1]):
        width = 2 * float(box.half_extents[closing_axis])
        if width <= maximum_opening:
            turns.append(_turns(approach_axis, closing_axis))
            widths += [width] * len(turns[-1])
    if not turns:
        return []
    T = np.zeros((len(distances), len(widths), 4, 4))
    T[..., :3, :3] = np.concatenate(turns)
    T[..., long_axis, 3] = distances[:, None]
    T[..., 3, 3] = 1.0
    poses = (box.T_frame_box @ T).reshape(-1, 4, 4)
    return [GraspCandidate(pose, width) for pose, width in zip(poses, widths * len(distances), strict=True)]


def ungraspable(part: Part, workcell: Workcell) -> str:
    """Why the gripper cannot hold a part, whatever stands around it; empty where it can."""
    if part.mass > workcell.payload:
        return f"weighs {part.mass:.4g} kg; the payload is {workcell.payload:.4g} kg"
    if part.mass > workcell.grip:
        return (
            f"weighs {part.mass:.4g} kg; fingers that press with {workcell.gripping_force:.4g} N hold "
            f"{workcell.grip:.3g} kg by friction"
        )
    opening = workcell.description.maximum_opening
    if not grasp_candidates(part, opening):
        widths = sorted(2e3 * part.shape.bounding_box().half_extents)[:2]
        return f"is {widths[0]:.4g} mm by {widths[1]:.4g} mm wide; the fingers open {1e3 * opening:.4g} mm"
    return ""


@cache
def _turns(approach_axis: int, closing_axis: int) -> Array:
    """The four orientations (4, 3, 3) of the tool that approach along one axis, either way, and close along another."""
    turns = np.zeros((4, 3, 3))
    for turn, (approach_sign, closing_sign) in zip(turns, product((1.0, -1.0), repeat=2), strict=True):
        turn[approach_axis, 2], turn[closing_axis, 1] = approach_sign, closing_sign
        turn[:, 0] = np.cross(turn[:, 1], turn[:, 2])
    return turns


def straight_line_bounds(part: Part, grasps: Sequence[GraspCandidate], lift_height: float, goal: Array) -> Array:
    """Least length (K,) of a removal with each grasp, m: straight up, then straight to the goal (Eq. 1)."""
    centers = np.array([grasp.T_part_tool[:, 3] for grasp in grasps]).reshape(-1, 4) @ part.T_world_part[:3].T
    bounds: Array = lift_height + np.linalg.norm(centers + [0.0, 0.0, lift_height] - goal, axis=1)
    return bounds


def volume_bound(part: Part, lift_height: float, goal: Array) -> float:
    """Least length of a removal with a grasp anywhere in the part's volume, m: straight up, then straight to the goal
    (Eq. 1). Attained where nothing is in the way.

    Args:
        goal: (3,) m, in the world.
    """
    nearest = math.inf
    for box in part.shape.boxes():
        raised = box.moved(part.T_world_part).T_frame_box.copy()
        raised[2, 3] += lift_height
        inside = np.clip((goal - raised[:3, 3]) @ raised[:3, :3], -box.half_extents, box.half_extents)
        nearest = min(nearest, float(np.linalg.norm(raised[:3, :3] @ inside + raised[:3, 3] - goal)))
    return lift_height + nearest
