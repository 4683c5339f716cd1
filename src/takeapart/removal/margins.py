"""What the planner keeps beyond a workcell's clearance. Loads nothing, so that pictures can use it too."""

from __future__ import annotations

CHECK_STEP = 0.001  # m; pieces of motion are checked until nothing moves more than this in them
PLANNING_MARGIN = 1e-4  # m, kept while planning over what the final check asks for, so that it does not fail by a hair


def padding(clearance: float, check_step: float = CHECK_STEP) -> float:
    """By how much, m, bodies are larger in checks: what passes a check keeps the clearance between two checks too."""
    return clearance + check_step / 2 + PLANNING_MARGIN


def passing(clearance: float) -> float:
    """Distance, m, in which a lift passes other bodies: it is straight, so nothing is added for what bends."""
    return clearance + PLANNING_MARGIN
