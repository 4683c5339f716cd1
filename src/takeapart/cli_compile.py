"""Compiles the kernels before the work starts, and says so: the first time takes a minute or two.

Otherwise the time limit of a first search would be spent on compiling. What was compiled is kept in numba's cache.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from takeapart.cli_output import note

if TYPE_CHECKING:
    from takeapart.removal.result import Blocked, Counts, Effort, Removal
    from takeapart.workcell import Workcell

NOTICE = "compiling the geometry kernels for the first time, which takes a minute or two"


def compile_first(workcell: Workcell) -> None:
    """Compiles all kernels unless they are in the cache already, with a notice on standard error.

    Raises:
        InputError: the robot's files are missing.
    """
    from takeapart.compilation import is_compiled
    from takeapart.motion import blockers, edges, legs, lifts, rrt, smooth
    from takeapart.robot import grid, hand, kernels, kinematics
    from takeapart.search import lattice, lattice_bounds

    geometry = (grid, kinematics, kernels, hand, edges, blockers, lifts, legs, rrt, smooth)
    if all(is_compiled(module) for module in (*geometry, lattice, lattice_bounds)):
        return
    note(NOTICE)
    _plan_one_removal(workcell)
    _order_two_parts()


def _plan_one_removal(workcell: Workcell) -> None:
    """Has the removal planner go through all its stages once, for a loose bar near the goal that stands in the way."""
    import numpy as np

    from takeapart.assembly import Assembly, Part
    from takeapart.geometry import Box, pose
    from takeapart.removal.planner import RemovalOptions, RemovalPlanner

    # Without tries for straight paths and bends, the trees have to find the path.
    options = RemovalOptions(straight_attempts=0, bend_attempts=0)
    base = workcell.T_world_base[:3, 3]
    towards = workcell.goal[:2] - base[:2]
    distance = max(float(np.linalg.norm(towards)), 1e-9)
    for turn in (0.6, -0.6, 1.2):  # rad, around the arm's base, until a place is reached
        rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        x, y = base[:2] + rotation @ (towards / distance) * 0.45
        bar = Part("bar", Box((0.02, 0.16, 0.02)), pose([x, y, base[2] + 0.2]), 0.1)
        planner = RemovalPlanner(Assembly("bar", (bar,)), workcell, options)
        planner.plan(0, 1, rng=np.random.default_rng(0))
        if planner.counts.motion_plans:
            return


class _TwoParts:
    """Two parts that leave in any order, at a fixed length; no geometry."""

    root = 0b11
    hindered_by = (0, 0)  # with it the enumeration of states is the compiled one

    def __init__(self, counts: Counts) -> None:
        self.counts = counts

    def candidates(self, state: int) -> Sequence[int]:
        return [part for part in range(2) if state >> part & 1]

    def upper(self, state: int, part: int) -> float:
        return math.inf

    def lower(self, state: int, part: int) -> float:
        return 0.0

    def remove(self, state: int, part: int, effort: Effort) -> Removal | Blocked:
        import numpy as np

        from takeapart.plan import Grasp
        from takeapart.removal.result import Removal

        grasp = Grasp(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), 0.02)
        return Removal(part, grasp, np.zeros((2, 1)), np.zeros((2, 7)), 1.0, 0)


def _order_two_parts() -> None:
    from takeapart.removal.result import Counts
    from takeapart.search.exact import ExactOptions, exact
    from takeapart.search.result import Budget

    exact(_TwoParts(Counts()), ExactOptions(), Budget())


if __name__ == "__main__":  # before tests that run side by side, so that they do not all compile the same
    from takeapart.files import load_workcell

    compile_first(load_workcell("panda"))
