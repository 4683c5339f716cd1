"""What gripper and arm can do with a grasp, whatever else stands around: solved once for an assembly, kept as masks.

Three questions of growing cost are asked about a grasp, each only when the one before leaves it open: what would the
hand hit, whatever the arm does; which inverse kinematics branches are there, and what would the arm hit while it lifts
the part along each. In any state, whatever has a mask that shares no part with it is valid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from takeapart.assembly import Assembly
from takeapart.geometry import Array, pose_inverse
from takeapart.motion.edges import lift_branches, new_scene
from takeapart.motion.legs import mark_line
from takeapart.removal.grasps import GraspCandidate, grasp_candidates, straight_line_bound
from takeapart.removal.masks import flags_of, state_of
from takeapart.robot.arrays import Flags, HeldArrays, Workspace, WorldArrays
from takeapart.robot.ik import Solver
from takeapart.robot.kernels import collect_hand, hand_hits_load
from takeapart.robot.model import RobotModel, moved_load
from takeapart.workcell import Workcell

LIFT_SPACINGS = (0.005, 0.00125)  # m, between the rows of a lift; the second where the first leaves no branch


@dataclass(frozen=True, eq=False)
class Hand:
    """A grasp as far as the hand alone decides it.

    Args:
        bound: straight up and straight to the goal, m; no removal with this grasp is shorter.
        lifted: (3,) m, the tool's position after the lift.
        radius: of a ball around the tool that is always inside the held part, m.
        blockers: parts that hand or lifted part would hit; None if it would hit the part itself or what never leaves.
        line: parts that the ball would hit on the straight line to the goal; None for what never leaves.
    """

    candidate: GraspCandidate
    bound: float
    lifted: Array
    radius: float
    held: HeldArrays
    blockers: int | None
    line: int | None


@dataclass(frozen=True, eq=False)
class LiftBranch:
    """One way to hold a part and lift it.

    Args:
        rows: (L, n) rad, from the grasp straight up to the lift height.
        blockers: parts that arm and hand would hit on the way, or with the lifted part at its end.
    """

    rows: Array
    blockers: int


class Reach:
    """Grasps and lifts of the parts of one assembly, computed when first asked for.

    Args:
        padding: distance kept, m.
        step: see `path_blockers`, m.
    """

    def __init__(
        self,
        assembly: Assembly,
        workcell: Workcell,
        robot: RobotModel,
        ik: Solver,
        world: WorldArrays,
        padding: float,
        step: float,
    ) -> None:
        self._assembly, self._workcell, self._robot, self._ik, self._world = assembly, workcell, robot, ik, world
        self._padding, self._step = padding, step
        self._bounds: dict[int, tuple[tuple[float, GraspCandidate], ...]] = {}
        self._loads: dict[tuple[int, float], HeldArrays] = {}
        self._hands: dict[tuple[int, int], Hand] = {}
        self._branches: dict[tuple[int, int], tuple[LiftBranch, ...]] = {}

    def replace_inverse_kinematics(self, ik: Solver) -> None:
        """Solves all further grasps with other inverse kinematics, for experiments."""
        self._ik = ik

    def bounds(self, part: int) -> tuple[tuple[float, GraspCandidate], ...]:
        """Grasps of a part with their straight-line bounds, m, shortest first."""
        if part not in self._bounds:
            body, cell = self._assembly.parts[part], self._workcell
            found = grasp_candidates(body, cell.description.maximum_opening)
            bounded = [(straight_line_bound(body, grasp, cell.lift_height, cell.goal), grasp) for grasp in found]
            self._bounds[part] = tuple(sorted(bounded, key=lambda pair: pair[0]))
        return self._bounds[part]

    def from_above(self, part: int, number: int) -> float:
        """Vertical part of a grasp's approach direction, -1 for one from above: those are the likeliest to be
        reached.
        """
        T = self._assembly.parts[part].T_world_part @ self.bounds(part)[number][1].T_part_tool
        return round(float(T[2, 2]), 6)

    def hand(self, part: int, number: int, work: Workspace) -> Hand:
        """Grasp `number` in the order of `bounds`, as far as the hand decides it."""
        key = (part, number)
        if key not in self._hands:
            self._hands[key] = self._solve_hand(part, *self.bounds(part)[number], work)
        return self._hands[key]

    def branches(self, part: int, number: int, work: Workspace) -> tuple[LiftBranch, ...]:
        """The arm's ways to hold and lift the part with grasp `number`."""
        key = (part, number)
        if key not in self._branches:
            self._branches[key] = self._solve_branches(part, self.hand(part, number, work), work)
        return self._branches[key]

    def _load(self, part: int, width: float) -> HeldArrays:
        """Fingers at an opening, and the part with its own frame for the tool's."""
        key = (part, width)
        if key not in self._loads:
            gripped = len(self._assembly.parts[part].shape.boxes())
            self._loads[key] = self._robot.held(width, np.eye(4), self._assembly.body(part), gripped)
        return self._loads[key]

    def _solve_hand(self, part: int, bound: float, candidate: GraspCandidate, work: Workspace) -> Hand:
        parts = len(self._assembly.parts)
        T_world_part = self._assembly.parts[part].T_world_part
        T_tool_part = pose_inverse(candidate.T_part_tool)
        held = moved_load(self._load(part, candidate.width), T_tool_part)
        start = np.ascontiguousarray(T_world_part @ candidate.T_part_tool)
        end = start.copy()
        end[2, 3] += self._workcell.lift_height
        extents = np.sort(self._assembly.parts[part].shape.bounding_box().half_extents)
        radius = float(extents[0])
        blockers: int | None = None
        line: int | None = None
        everything = flags_of(self._assembly.root & ~(1 << part), parts)
        hits = np.zeros(parts + 1, dtype=np.uint8)
        for pose, load in ((start, held._replace(meets_world=_fingers_only(held))), (end, held)):
            collect_hand(self._robot.arm, load, self._world, everything, self._padding, pose, work, hits)
        if not hits[parts] and not hand_hits_load(self._robot.arm, held, self._workcell.clearance, work):
            blockers = state_of(hits)
        hits[:] = 0
        mark_line(self._world, end[:3, 3].copy(), self._workcell.goal, radius, hits)
        hits[part] = 0
        line = None if hits[parts] else state_of(hits)
        return Hand(candidate, bound, end[:3, 3].copy(), radius, held, blockers, line)

    def _solve_branches(self, part: int, hand: Hand, work: Workspace) -> tuple[LiftBranch, ...]:
        solutions = self._ik.solve(self._assembly.parts[part].T_world_part @ hand.candidate.T_part_tool)
        count, joints, parts = len(solutions), self._robot.joints, len(self._assembly.parts)
        if not count:
            return ()
        everything = flags_of(self._assembly.root & ~(1 << part), parts)
        carrying = new_scene(self._robot.arm, hand.held, self._world, everything, self._padding, work)
        lifting = carrying._replace(held=hand.held._replace(meets_world=_fingers_only(hand.held)))
        for spacing in LIFT_SPACINGS:  # near a singularity the joints turn fast: only close rows keep the lift straight
            rows = np.empty((count, round(np.ceil(self._workcell.lift_height / spacing)) + 1, joints))
            hits = np.zeros((count, parts + 1), dtype=np.uint8)
            good = np.zeros(count, dtype=np.uint8)
            lift_branches(lifting, carrying, solutions, self._workcell.lift_height, self._step, rows, hits, good)
            if good.any():
                break
        return tuple(LiftBranch(rows[s].copy(), state_of(hits[s])) for s in np.nonzero(good)[0])


def _fingers_only(held: HeldArrays) -> Flags:
    """Flags for a load whose part is not checked against the world: it touches its neighbours while it is lifted."""
    flags = np.ones(len(held.half), dtype=np.uint8)
    flags[held.group[1] :] = 0
    return flags
