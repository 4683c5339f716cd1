"""Paths from where the part is clear to the goal, over all grasps: straight legs first, then trees, then shortening.

One `PathSearch` is one attempt of a removal query. Grasps are visited in the order of what they could gain, and left as
soon as they cannot beat the best path found. Once the time is over, it ends with OutOfTimeError before its next step.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from takeapart.model.geometry import Array
from takeapart.motion.edges import waypoints
from takeapart.motion.legs import bends, two_legs
from takeapart.motion.rrt import rrt_connect
from takeapart.motion.smooth import shorten
from takeapart.removal.margins import CHECK_STEP
from takeapart.removal.reach import Hand
from takeapart.removal.situation import Situation


@dataclass(frozen=True)
class RemovalOptions:
    """How removals are planned.

    Args:
        check_step: pieces of motion are proved free, or checked until nothing moves more than this in them, m; see
            `docs/concepts.md`.
        lift_check_step: the same for lifts, m; whatever a lift passes by nearer than half of it counts as hit.
        waypoint_spacing: the tool moves about this from row to row of a path while it is planned, m.
        row_spacing: nothing moves more than this between the rows of a removal, m.
        tolerance: a grasp that cannot gain more than this over the best found is not planned, m.
        first_tolerance: the same while no removal is known from before: much of a query's time went into the last
            centimetre, which searches ask for again where it matters.
        straight_attempts: pairs of lifted and goal configuration tried with a straight tool path, per grasp.
        bend_samples: points drawn at which a path of two straight legs may bend, per grasp position.
        bend_attempts: tries with the arm to bend there, per grasp.
        leg_grasps: grasps tried with two legs, per query.
        tree_iterations: random samples of one RRT-Connect call.
        tree_stride: length of its edges, rad.
        tree_goals: goal configurations that trees grow from, the nearest ones.
        tree_paths: paths that trees find, per query.
        tree_failures: times that trees may fail, per query; a third of it once there is a path.
        quick_moves, shortening_moves: moves of the path shortening for every bent path, and for the best ones.
        finalists: paths that are shortened with all moves.
        shortening_patience: moves without gain that end it.
    """

    check_step: float = CHECK_STEP
    lift_check_step: float = 0.002
    waypoint_spacing: float = 0.05
    row_spacing: float = 0.016
    tolerance: float = 0.002
    first_tolerance: float = 0.015
    straight_attempts: int = 32
    bend_samples: int = 200
    bend_attempts: int = 80
    leg_grasps: int = 8
    tree_iterations: int = 600
    tree_stride: float = 0.4
    tree_goals: int = 24
    tree_paths: int = 6
    tree_failures: int = 15
    quick_moves: int = 24
    shortening_moves: int = 400
    finalists: int = 2
    shortening_patience: int = 100


@dataclass(frozen=True, eq=False)
class Path:
    """A path found for one grasp.

    Args:
        number: of the grasp, in the order of `Reach.hands`.
        rows: (M, n), rad, after the exit.
        length: of their tool path, m.
        polished: whether it was shortened with all moves, or is straight anyway.
    """

    number: int
    rows: Array
    length: float
    polished: bool = False


class Bends:
    """Where paths from one place may bend: drawn when that is first asked for, with random numbers of their own."""

    def __init__(self, situation: Situation, hand: Hand, goal: Array, samples: int, longest: float, seed: int) -> None:
        self._situation, self._hand, self._goal = situation, hand, goal
        self._samples, self._longest, self._seed = samples, longest, seed

    @cached_property
    def points(self) -> Array:
        """(K, 4) points and lengths of the paths, m, as of `bends`; shortest first."""
        world, present = self._situation.world, self._situation.present
        start, radius = self._hand.lifted, self._hand.radius
        return bends(world, present, start, self._goal, radius, self._samples, self._longest, self._seed)


class PathSearch:
    """The paths of one part in one state, planned once.

    Args:
        goal: (3,) m.
        shorter_than: length of the removal known from before, m; infinite if there is none.
    """

    def __init__(
        self,
        situation: Situation,
        options: RemovalOptions,
        goal: Array,
        shorter_than: float,
        rng: np.random.Generator,
    ) -> None:
        self.situation, self.options, self.goal, self.rng = situation, options, goal, rng
        self.hands, self.others = situation.hands, situation.others
        self._tolerance = options.first_tolerance if math.isinf(shorter_than) else options.tolerance

    def open_grasps(self, limit: float) -> list[int]:
        """Grasps that the hand can take and that can still be shorter than a removal of the limit's length, m."""
        most = limit - self._tolerance
        return [
            number
            for number, hand in enumerate(self.hands)
            if hand.bound < most and hand.way is not None and not hand.way & self.others
        ]

    def search(self, open_: list[int], limit: float) -> list[Path]:
        """Paths with these grasps, the shortest first; each found is shorter than what was known before it.

        Args:
            limit: only removals shorter than this are of interest, m, exit included.
        """
        paths: list[Path] = []
        for path in self._legs(open_, limit):
            paths.append(path)
            limit = min(limit, self.total(path))
        for path in self._trees(open_, limit):
            paths.append(path)
        return sorted(paths, key=lambda path: (self.total(path), path.length))

    def total(self, path: Path) -> float:
        """Length of a removal with a path, m: the exit before it included."""
        return path.length + self.hands[path.number].lead

    def polished(self, path: Path) -> Path:
        """The path after all moves of the shortening."""
        if path.polished:
            return path
        return self._shortened(path, self.options.shortening_moves, math.inf)

    def _legs(self, open_: list[int], limit: float) -> Iterator[Path]:
        """Paths of one or two straight legs, each shorter than the one before; limits in m, exit included."""
        options, tried = self.options, 0
        for estimate, number, via in self._estimates(open_, limit):
            if estimate >= limit - self._tolerance or tried >= options.leg_grasps:
                return
            if not self.situation.branches(number):
                continue
            tried += 1
            path = self._leg(number, via, limit - self.hands[number].lead)
            if path is not None and self.total(path) < limit:
                yield path
                limit = self.total(path)

    def _estimates(self, open_: list[int], limit: float) -> Iterator[tuple[float, int, Bends]]:
        """Grasps with the least length, m, of a path with at most one bend that a ball could follow, shortest first."""
        known: dict[int, Bends] = {}
        # An entry is a grasp's bound first; when it comes to the front its estimate is made, and it is put back.
        queue = [(self.hands[n].bound, self.hands[n].steepness, n, False) for n in open_]
        heapq.heapify(queue)
        while queue:
            estimate, steepness, number, estimated = heapq.heappop(queue)
            hand = self.hands[number]
            if estimated:
                yield estimate, number, known[hand.place]
                continue
            if hand.place not in known:
                self.situation.look_at_clock()
                samples, longest = self.options.bend_samples, limit - hand.lead
                known[hand.place] = Bends(self.situation, hand, self.goal, samples, longest, self._seed())
            if self.situation.is_line_open(number):
                heapq.heappush(queue, (estimate, steepness, number, True))
            elif len(points := known[hand.place].points):
                heapq.heappush(queue, (max(estimate, float(points[0, 3]) + hand.lead), steepness, number, True))

    def _leg(self, number: int, via: Bends, longest: float) -> Path | None:
        """A path that is straight for the tool, or else one of two straight legs, shortened a little."""
        self.situation.motion_plans += 1
        options, situation = self.options, self.situation
        if situation.is_line_open(number):
            rows = situation.straight_leg(number, options.straight_attempts, options.waypoint_spacing)
            if len(rows):
                return self._path(number, rows, polished=True)
        goals = situation.free_goals(number, options.tree_goals)
        if not len(goals):
            return None
        situation.look_at_clock()
        rows = two_legs(
            situation.scene(number),
            situation.lifted(number),
            goals,
            via.points,
            options.bend_attempts,
            longest,
            options.waypoint_spacing,
            self._seed(),
        )
        if not len(rows):
            return None
        return self._shortened(self._path(number, rows), options.quick_moves, longest)

    def _trees(self, open_: list[int], limit: float) -> Iterator[Path]:
        """Paths by RRT-Connect; where few grasps are left they are tried again, with other random numbers."""
        options = self.options
        successes = failures = turn = 0
        usable = self._spread(open_)
        while usable and successes < options.tree_paths:
            if failures >= options.tree_failures / (1 if math.isinf(limit) else 3):
                return
            number = usable[turn % len(usable)]
            if self.hands[number].bound >= limit - self._tolerance or not self.situation.branches(number):
                usable.remove(number)
                continue
            turn += 1
            path = self._tree(number, limit - self.hands[number].lead)
            if path is None:
                failures += 1
                continue
            successes += 1
            yield path
            limit = min(limit, self.total(path))

    def _spread(self, open_: list[int]) -> list[int]:
        """Grasps from above first, and those with another position or approach than all before them."""
        first: list[int] = []
        later: list[int] = []
        seen: set[tuple[int, ...]] = set()
        usable = set(open_)
        for number in self.situation.steepest_first:
            if number in usable:
                kind = self.hands[number].kind
                (later if kind in seen else first).append(number)
                seen.add(kind)
        return first + later

    def _tree(self, number: int, longest: float) -> Path | None:
        """A path by RRT-Connect, shortened a little."""
        self.situation.motion_plans += 1
        options, scene = self.options, self.situation.scene(number)
        goals = self.situation.free_goals(number, options.tree_goals)
        if not len(goals):
            return None
        lifted = self.situation.lifted(number)
        self.situation.look_at_clock()
        corners = rrt_connect(scene, lifted, goals, options.tree_iterations, options.tree_stride, self._seed())
        rows = waypoints(scene, corners, options.waypoint_spacing) if len(corners) else corners
        if not len(rows):
            return None
        return self._shortened(self._path(number, rows), options.quick_moves, longest)

    def _shortened(self, path: Path, moves: int, longest: float) -> Path:
        options = self.options
        self.situation.look_at_clock()
        rows = shorten(
            self.situation.scene(path.number),
            path.rows,
            self.hands[path.number].radius,
            moves,
            options.waypoint_spacing,
            longest,
            options.shortening_patience,
            self._seed(),
        )
        return self._path(path.number, rows, polished=moves >= options.shortening_moves)

    def _path(self, number: int, rows: Array, polished: bool = False) -> Path:
        return Path(number, rows, self.situation.tool_length(number, rows), polished)

    def _seed(self) -> int:
        return int(self.rng.integers(1 << 62))
