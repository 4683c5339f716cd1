"""What a grasp is before anybody asks whether the arm can reach it."""

from __future__ import annotations

from dataclasses import dataclass

from takeapart.model.geometry import Array


@dataclass(frozen=True, eq=False)
class GraspCandidate:
    """A grasp in the part's frame.

    Args:
        T_part_tool: (4, 4) pose of the tool: z is the approach direction, y the closing direction of the fingers.
        width: of the part between the fingers, m.
    """

    T_part_tool: Array
    width: float
