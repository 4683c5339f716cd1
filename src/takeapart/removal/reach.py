"""What gripper and arm can do with a grasp, whatever else stands around: solved once for an assembly, kept as masks.

Three questions of growing cost are asked about a grasp, each only when the one before leaves it open: what would the
hand hit, whatever the arm does; which inverse kinematics branches are there, and what would the arm hit while it lifts
the part along each. In any state, whatever has a mask that shares no part with it is valid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from takeapart.model.assembly import Assembly, Part
from takeapart.model.geometry import Array
from takeapart.motion.lifts import complete_lifts, lift_ends
from takeapart.motion.scene import Scene, new_scene
from takeapart.removal.exits import Exit, ExitRule
from takeapart.removal.following import end_of, lead_lengths, motion_of
from takeapart.removal.grasps import GraspCandidate, is_box, shortest_first, tied
from takeapart.robot.arrays import Flags, HeldArrays, Workspace, WorldArrays
from takeapart.robot.hand import hand_masks
from takeapart.robot.ik import Solver
from takeapart.robot.model import RobotModel, copied_load, moved_load
from takeapart.states import flags_of, states_of
from takeapart.workcell import Workcell

TIED = 9  # decimals of a direction; noise of a part's frame is no steeper approach
SAME_PLACE = 1e-6  # m
THINNEST = 1e-3  # m, radius of a ball that stands for the part where its form is not known
LIFT_SPACINGS = (0.005, 0.00125)  # m, between the rows of a lift; the second where the first leaves no branch


@dataclass(frozen=True, eq=False)
class Hand:
    """A grasp as far as the hand alone decides it.

    Args:
        grasp: its number in the order of `Reach.candidates`.
        exit: how the part gets clear, before it goes to the goal.
        lead: length of the tool path on the exit, m.
        bound: along the exit and straight to the goal, m; no removal with this grasp and this exit is shorter.
        lifted: (3,) m, the tool's position at the end of the exit.
        place: the number of that position: grasps of one part that take the tool to the same place have the same.
        radius: of a ball around the tool that is always inside the held part, m; where the part is no box, of the
            thinnest thing between the pads.
        load: fingers, and the part with its own frame for the tool's.
        T_tool_part: (4, 4).
        steepness: vertical part of the approach direction, -1 from above: those grasps are the likeliest to be reached.
        kind: grasps of one kind have the same exit and approach direction and stand within 6 cm.
        partner: number of the grasp at the same place with the fingers exchanged.
        blockers: parts that the hand would hit at the start, or hand and part at the end of the exit; None if it would
            hit the part itself or what never leaves.
        line: parts that the ball would hit on the straight line to the goal; None for what never leaves. Nothing is
            known of it where the part is no box: the tool may stand in a hole of it.
    """

    candidate: GraspCandidate
    grasp: int
    exit: Exit
    lead: float
    bound: float
    lifted: Array
    place: int
    radius: float
    load: HeldArrays
    T_tool_part: Array
    steepness: float
    kind: tuple[int, ...]
    partner: int | None
    blockers: int | None
    line: int | None

    @cached_property
    def way(self) -> int | None:
        """Parts that hand or part would hit, those on the exit among them; None for what never leaves, or itself."""
        if self.blockers is None or self.exit.blockers is None:
            return None
        return self.blockers | self.exit.blockers

    @cached_property
    def held(self) -> HeldArrays:
        """What the gripper carries."""
        return moved_load(self.load, self.T_tool_part)


@dataclass(frozen=True, eq=False)
class LiftBranch:
    """One way to hold a part and to follow its exit.

    Args:
        rows: (L, n) rad, from the grasp to the end of the exit.
        blockers: parts that arm and hand would hit on the way, or with the lifted part at its end.
    """

    rows: Array
    blockers: int


@dataclass(frozen=True, eq=False)
class _Lifts:
    """Lifts with one grasp, of which at first only the ends are looked at.

    Args:
        rows: (S, L, n) rad.
        hits: (S, parts + 1) owners that the ends touch.
        ends: the same as states.
        branches: those looked at all along; None where a lift is not possible.
    """

    rows: Array
    hits: Flags
    ends: list[int]
    branches: dict[int, LiftBranch | None]


class Reach:
    """Grasps and lifts of the parts of one assembly, computed when first asked for.

    Args:
        exits: of the parts, without the arm.
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
        exits: ExitRule,
        padding: float,
        step: float,
    ) -> None:
        self._exits = exits
        self._assembly, self._workcell, self._robot, self._ik, self._world = assembly, workcell, robot, ik, world
        self._padding, self._step = padding, step
        self._loads: dict[tuple[int, float], HeldArrays] = {}
        self._candidates: dict[int, tuple[GraspCandidate, ...]] = {}
        self._bounds: dict[int, float] = {}  # m
        self._hands: dict[int, tuple[Hand, ...]] = {}
        self._steepest: dict[int, list[int]] = {}
        self._solutions: dict[tuple[int, int], Array] = {}  # (S, n) rad
        self._lifts: dict[tuple[int, int], _Lifts] = {}

    def candidates(self, part: int) -> tuple[GraspCandidate, ...]:
        """Grasps of a part, those with the shortest straight line first."""
        if part not in self._candidates:
            self._candidates[part] = shortest_first(self._assembly.parts[part], self._workcell)
        return self._candidates[part]

    def bound(self, part: int) -> float:
        """The shortest exit and straight line of any grasp candidate, m; infinite if the part cannot be gripped."""
        if part not in self._bounds:
            lengths = [self._lengths(part, way) for way in self._exits.exits(part)]
            self._bounds[part] = min(
                (float(leads_on.min(initial=math.inf)) for _, _, leads_on in lengths), default=math.inf
            )
        return self._bounds[part]

    def hands(self, part: int, work: Workspace) -> tuple[Hand, ...]:
        """All grasps in the order of `candidates`, once for every exit, as far as the hand decides them."""
        if part not in self._hands:
            self._hands[part] = self._solve_hands(part, work)
        return self._hands[part]

    def steepest_first(self, part: int, work: Workspace) -> list[int]:
        """Numbers of the grasps, those from above first."""
        if part not in self._steepest:
            hands = self.hands(part, work)
            self._steepest[part] = sorted(range(len(hands)), key=lambda number: hands[number].steepness)
        return self._steepest[part]

    def branches(self, part: int, number: int, others: int, work: Workspace) -> tuple[LiftBranch, ...]:
        """The arm's ways to hold and lift the part with a grasp, by its number in the order of `hands`, that are free
        where certain other parts stand around.
        """
        key = (part, number)
        if key not in self._lifts:
            self._lifts[key] = self._solve_lifts(part, number, self._solutions_of(part, number, work), work)
        lifts = self._lifts[key]
        chosen = [s for s, lift in enumerate(lifts.ends) if not lift & others]
        unknown = [s for s in chosen if s not in lifts.branches]
        if unknown:
            self._complete(part, number, lifts, unknown, work)
        found = [lifts.branches[s] for s in chosen]
        return tuple(branch for branch in found if branch is not None and not branch.blockers & others)

    def in_the_way(self, part: int, number: int, others: int, work: Workspace) -> list[int]:
        """Per way to hold and lift the part: those of the other parts that are in its way, at its ends if there are."""
        self.branches(part, number, others, work)
        lifts = self._lifts[part, number]
        masks = []
        for s, ends in enumerate(lifts.ends):
            branch = lifts.branches.get(s)
            if ends & others:  # whether the rest of such a lift is known depends on what was asked before
                masks.append(ends & others)
            elif branch is not None:
                masks.append(branch.blockers & others)
        return masks

    def _solutions_of(self, part: int, number: int, work: Workspace) -> Array:
        hands = self.hands(part, work)
        grasp, partner, candidate = hands[number].grasp, hands[number].partner, hands[number].candidate
        key = (part, grasp)
        if key not in self._solutions:
            T = self._assembly.parts[part].T_world_part @ candidate.T_part_tool
            exchanged = hands[partner].grasp if partner is not None else None
            if exchanged is None or all(hand.blockers is None for hand in hands if hand.grasp == exchanged):
                self._solutions[key] = self._ik.solve(T, candidate.width)
            else:  # the other finger order costs no inverse kinematics of its own
                if exchanged < grasp:  # always from the first of the two, whichever is asked for first
                    T[:3, :2] *= -1
                both = self._ik.solve_both(T, candidate.width)
                for k, found in zip(sorted((grasp, exchanged)), both, strict=True):
                    self._solutions[part, k] = found
        return self._solutions[key]

    def _lengths(self, part: int, way: Exit) -> tuple[Array, Array, Array]:
        """With an exit, for each grasp candidate: where it takes the tool (K, 3), m; the length of the tool path on it
        (K,), m; and that with the straight line from there to the goal (K,), m (Eq. 1)."""
        body = self._assembly.parts[part]
        poses = np.array([grasp.T_part_tool for grasp in self.candidates(part)]).reshape(-1, 4, 4)
        starts = poses[:, :, 3] @ body.T_world_part[:3].T
        end = end_of(way)
        lifted = starts @ end[:, :3].T + end[:, 3]
        leads = lead_lengths(way, starts)
        return lifted, leads, leads + np.linalg.norm(lifted - self._workcell.goal, axis=1)

    def _load(self, part: int, width: float) -> HeldArrays:
        """Fingers at an opening, and the part with its own frame for the tool's."""
        key = (part, width)
        if key not in self._loads:
            gripped = len(self._assembly.parts[part].shape.boxes())
            self._loads[key] = self._robot.held(width, np.eye(4), self._assembly.body(part), gripped)
        return self._loads[key]

    def forget(self) -> None:
        """Starts anew with grasps and lifts; the shapes of parts and fingers stay."""
        for known in (self._candidates, self._bounds, self._hands, self._steepest, self._solutions, self._lifts):
            known.clear()

    def _solve_hands(self, part: int, work: Workspace) -> tuple[Hand, ...]:
        if not self.candidates(part):
            return ()
        ways = self._exits.exits(part)
        lengths = [self._lengths(part, way) for way in ways]
        lifted = np.concatenate([each[0] for each in lengths]) if lengths else np.empty((0, 3))
        places: list[int] = np.unique(np.round(lifted, 6), axis=0, return_inverse=True)[1].ravel().tolist()
        found: list[Hand] = []
        for number, (way, measures) in enumerate(zip(ways, lengths, strict=True)):
            found += self._hands_of_exit(part, number, way, measures, places, len(found), work)
        return tuple(found)

    def _hands_of_exit(
        self,
        part: int,
        number: int,
        way: Exit,
        measures: tuple[Array, Array, Array],
        places: list[int],
        first: int,
        work: Workspace,
    ) -> list[Hand]:
        """The grasps with one exit, numbered from `first`; `measures` as of `_lengths`, `places` of all exits."""
        body, candidates = self._assembly.parts[part], self.candidates(part)
        poses = np.array([candidate.T_part_tool for candidate in candidates])
        starts = np.ascontiguousarray(body.T_world_part @ poses)
        inverses = np.ascontiguousarray(np.linalg.inv(poses))
        lifted, leads, lengths = measures
        bounds = tied(lengths)
        radius = _inner_radius(body)
        hits, lines = self._masks(part, way, starts, inverses, radius, work)
        same_place = np.abs(np.diff(poses[:, :3, 2:], axis=0)).max(axis=(1, 2)) < 1e-9
        exchanged = same_place & (np.abs(poses[1:, :3, 1] + poses[:-1, :3, 1]).max(axis=1) < 1e-9)
        partners: list[int | None] = [None] * len(candidates)
        for k in np.nonzero(exchanged)[0].tolist():
            partners[k], partners[k + 1] = first + k + 1, first + k
        middle = (body.T_world_part @ body.shape.bounding_box().T_frame_box)[:3, 3]
        cells = np.floor((starts[:, :3, 3] - middle + SAME_PLACE) / 0.06)  # in the world: a part's frame is no kind
        kinds = np.column_stack([np.round(1e3 * starts[:, :3, 2]), cells]).astype(int).tolist()
        states, line_states, parts = states_of(hits), states_of(lines), len(self._assembly.parts)
        steepness = np.round(starts[:, 2, 2], TIED).tolist()
        return [
            Hand(
                candidate=candidate,
                grasp=k,
                exit=way,
                lead=float(leads[k]),
                bound=float(bounds[k]),
                lifted=lifted[k],
                place=places[first + k],
                radius=radius,
                load=self._load(part, candidate.width),
                T_tool_part=inverses[k],
                steepness=steepness[k],
                kind=(number, *kinds[k]),
                partner=partners[k],
                blockers=None if hits[k, parts] else states[k],
                line=None if lines[k, parts] else line_states[k],
            )
            for k, candidate in enumerate(candidates)
        ]

    def _masks(
        self, part: int, way: Exit, starts: Array, inverses: Array, radius: float, work: Workspace
    ) -> tuple[Flags, Flags]:
        """What the hand touches in each grasp, and what a ball in the part on the way to the goal, see `hand_masks`."""
        candidates, parts = self.candidates(part), len(self._assembly.parts)
        everything = flags_of(self._assembly.root & ~(1 << part), parts)
        hits = np.zeros((len(candidates), parts + 1), dtype=np.uint8)
        lines = np.zeros_like(hits)
        widths = np.array([candidate.width for candidate in candidates])
        end = end_of(way)
        for width in np.unique(widths).tolist():
            load, chosen = self._load(part, width), widths == width
            some_hits, some_lines = hits[chosen], lines[chosen]
            hand_masks(
                self._robot.arm_at(width),
                load,
                self._world,
                everything,
                self._padding,
                self._workcell.clearance,
                end,
                starts[chosen],
                inverses[chosen],
                self._workcell.goal,
                radius,
                copied_load(load),
                work,
                some_hits,
                some_lines,
            )
            hits[chosen], lines[chosen] = some_hits, some_lines
        lines[:, part] = 0
        if not is_box(self._assembly.parts[part].shape):
            lines[:] = 0
        return hits, lines

    def _scene(self, part: int, number: int, work: Workspace) -> Scene:
        """The situation while the part is lifted; its load has flags of its own for what meets the world."""
        hand = self.hands(part, work)[number]
        arm, held = self._robot.arm_at(hand.candidate.width), hand.held
        everything = flags_of(self._assembly.root & ~(1 << part), len(self._assembly.parts))
        held = held._replace(meets_world=held.meets_world.copy())
        return new_scene(arm, held, self._world, everything, self._padding, self._step, work)

    def _solve_lifts(self, part: int, number: int, solutions: Array, work: Workspace) -> _Lifts:
        count, parts = len(solutions), len(self._assembly.parts)
        if not count:
            return _Lifts(np.empty((0, 0, 0)), np.empty((0, 0), dtype=np.uint8), [], {})
        scene, way = self._scene(part, number, work), self.hands(part, work)[number].exit
        for spacing in LIFT_SPACINGS:  # near a singularity the joints turn fast: only close rows keep the lift straight
            motion = motion_of(way, spacing, self._radius_of_motion(part))
            rows = np.empty((count, len(motion), self._robot.joints))
            hits = np.zeros((count, parts + 1), dtype=np.uint8)
            good = np.zeros(count, dtype=np.uint8)
            lift_ends(scene, solutions, motion, rows, hits, good)
            if good.any():
                break
        chosen = np.nonzero(good)[0]
        return _Lifts(rows[chosen], hits[chosen], states_of(hits[chosen]), {})

    def _radius_of_motion(self, part: int) -> float:
        """No point of the part is further from its frame's origin, m."""
        box = self._assembly.parts[part].shape.bounding_box()
        return float(np.linalg.norm(box.corners(), axis=1).max())

    def _complete(self, part: int, number: int, lifts: _Lifts, chosen: list[int], work: Workspace) -> None:
        """Looks at what is between the ends of some lifts."""
        scene = self._scene(part, number, work)
        rows, hits = np.ascontiguousarray(lifts.rows[chosen]), lifts.hits[chosen]
        good = np.zeros(len(chosen), dtype=np.uint8)
        complete_lifts(scene, rows, hits, good)
        for s, lifted, state, fine in zip(chosen, rows, states_of(hits), good, strict=True):
            lifts.branches[s] = LiftBranch(lifted, state) if fine else None


def _inner_radius(body: Part) -> float:
    """Of a ball around the tool that is inside the held part wherever the fingers hold it, m: known of a box; in a mesh
    there may be nothing but the line between the pads."""
    if is_box(body.shape):
        return float(body.shape.bounding_box().half_extents.min())
    return THINNEST
