"""Where a part can be gripped: every 2 cm along all four sides, from 3 cm off each end, both finger orders (Sec.
VI).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from takeapart.assembly import Part
from takeapart.geometry import Array

SPACING = 0.02  # m, between grasps along the part
END_MARGIN = 0.03  # m, from the part's ends


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
    return END_MARGIN + SPACING * np.arange(int(np.floor(usable / SPACING + 1e-6)) + 1, dtype=float)


def grasp_candidates(part: Part, maximum_opening: float) -> list[GraspCandidate]:
    """All grasps of a part along the longest axis of its bounding box, as wide as the gripper allows."""
    box = part.shape.bounding_box()
    long_axis = int(np.argmax(box.half_extents))
    sides = [axis for axis in range(3) if axis != long_axis]
    distances = grasp_positions(2 * float(box.half_extents[long_axis])) - box.half_extents[long_axis]
    turns, widths = [], []
    for approach_axis, closing_axis in (sides, sides[::-1]):
        width = 2 * float(box.half_extents[closing_axis])
        if width > maximum_opening:
            continue
        for approach_sign in (1.0, -1.0):
            for closing_sign in (1.0, -1.0):
                z, y = np.zeros(3), np.zeros(3)
                z[approach_axis], y[closing_axis] = approach_sign, closing_sign
                turns.append(np.column_stack([np.cross(y, z), y, z]))
                widths.append(width)
    T = np.zeros((len(distances), len(turns), 4, 4))
    T[..., :3, :3] = np.array(turns).reshape(-1, 3, 3)
    T[..., long_axis, 3] = distances[:, None]
    T[..., 3, 3] = 1.0
    poses = (box.T_frame_box @ T).reshape(-1, 4, 4)
    return [GraspCandidate(pose, width) for pose, width in zip(poses, widths * len(distances), strict=True)]


def straight_line_bounds(part: Part, grasps: Sequence[GraspCandidate], lift_height: float, goal: Array) -> Array:
    """Least length (K,) of a removal with each grasp, m: straight up, then straight to the goal (Eq. 1)."""
    centers = np.array([grasp.T_part_tool[:, 3] for grasp in grasps]).reshape(-1, 4) @ part.T_world_part[:3].T
    bounds: Array = lift_height + np.linalg.norm(centers + [0.0, 0.0, lift_height] - goal, axis=1)
    return bounds
