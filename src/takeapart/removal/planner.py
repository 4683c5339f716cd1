"""The removal planner (Sec. IV-B): lift, grasp, inverse kinematics, path; everything found goes to the removal
library.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, replace

import numpy as np

from takeapart.assembly import Assembly
from takeapart.geometry import Array, OrientedBox, quaternion_from_rotation
from takeapart.motion.edges import LARGEST_MARGIN, Scene, new_scene, path_blockers
from takeapart.motion.legs import bends, one_leg, two_legs
from takeapart.motion.rrt import rrt_connect
from takeapart.motion.smooth import dense, shorten
from takeapart.plan import Grasp
from takeapart.removal.goals import GoalConfigurations
from takeapart.removal.lifting import lift_blockers
from takeapart.removal.masks import flags_of, state_of
from takeapart.removal.reach import Hand, LiftBranch, Reach
from takeapart.removal.result import Blocked, Counts, Removal
from takeapart.robot.arrays import Workspace, WorldArrays
from takeapart.robot.ik import InverseKinematics
from takeapart.robot.kernels import tool_poses
from takeapart.robot.model import RobotModel, load_robot
from takeapart.robot.world import build_world, owner_fields, with_field
from takeapart.workcell import Workcell

KEPT_WORLDS = 64  # clearance fields of states that are kept
PLANNING_MARGIN = 1e-4  # m, kept while planning over what the final check asks for, so that it does not fail by a hair


@dataclass(frozen=True)
class RemovalOptions:
    """How removals are planned.

    Args:
        check_step: pieces of motion are proved free, or checked until nothing moves more than this in them, m; see
            `docs/concepts.md`.
        lift_check_step: the same for lifts, m; whatever a lift passes by nearer than half of it counts as hit.
        row_spacing: nothing moves more than about this between the rows of a path, m.
        tolerance: a grasp that cannot gain more than this over the best found is not planned, m.
        straight_attempts: pairs of lifted and goal configuration tried with a straight tool path, per grasp.
        bend_samples: points drawn at which a path of two straight legs may bend, per grasp position.
        bend_attempts: tries with the arm to bend there, per grasp.
        leg_grasps: grasps tried with two legs, per query.
        tree_iterations: random samples of one RRT-Connect call.
        tree_stride: length of its edges, rad.
        tree_paths: paths that trees find, per query.
        tree_failures: times that trees may fail, per query.
        quick_moves, shortening_moves: moves of the path shortening for every tree path, and for the best ones.
        finalists: paths that are shortened with all moves.
        shortening_patience: moves without gain that end it.
    """

    check_step: float = 0.001
    lift_check_step: float = 0.002
    row_spacing: float = 0.01
    tolerance: float = 0.002
    straight_attempts: int = 32
    bend_samples: int = 200
    bend_attempts: int = 80
    leg_grasps: int = 8
    tree_iterations: int = 600
    tree_stride: float = 0.4
    tree_paths: int = 4
    tree_failures: int = 24
    quick_moves: int = 24
    shortening_moves: int = 160
    finalists: int = 2
    shortening_patience: int = 48


@dataclass(frozen=True, eq=False)
class _Path:
    """A path found for one grasp: rows (M, n), rad, after the lift, and the length of their tool path, m."""

    hand: Hand
    branches: tuple[LiftBranch, ...]
    rows: Array
    length: float


class RemovalPlanner:
    """Best removal of one part in one state, over all its grasps.

    Thread-safe: queries may run at the same time on several threads.

    Args:
        assembly: the product.
        workcell: everything around it.
        options: see `RemovalOptions`.
        robot: the arm, if it is loaded already.

    Raises:
        InputError: robot files are missing or unusable.
    """

    def __init__(
        self,
        assembly: Assembly,
        workcell: Workcell,
        options: RemovalOptions = RemovalOptions(),
        robot: RobotModel | None = None,
    ) -> None:
        self.assembly, self.workcell, self.options = assembly, workcell, options
        self.robot = robot or load_robot(workcell)
        self.counts = Counts()
        self._parts = len(assembly.parts)
        # Whatever passes a check keeps the workcell's clearance between two checks too.
        self._padding = workcell.clearance + options.check_step / 2 + PLANNING_MARGIN
        obstacles = tuple(obstacle.box for obstacle in workcell.environment)
        self.lift_blockers = lift_blockers(assembly, workcell.lift_height, self._padding, obstacles)
        boxes: list[tuple[OrientedBox, int]] = []
        for i, part in enumerate(assembly.parts):
            owner = self._parts if part.fixed else i
            boxes += [(box.moved(part.T_world_part), owner) for box in assembly.body(i)]
        boxes += [(box, self._parts) for box in obstacles]
        self.world = build_world(boxes, self.robot.largest_ball + self._padding + LARGEST_MARGIN)
        self._fields = owner_fields(self.world, self._parts + 1)
        self._worlds: dict[int, WorldArrays] = {}
        self.world = self._world_of(assembly.root)
        self._ik = ik = InverseKinematics(self.robot)
        self.forget_grasps()
        self.goals = GoalConfigurations(workcell, self.robot, ik, self.world, self._padding)
        self._largest_load = max(len(assembly.body(i)) for i in range(self._parts))
        self._lock = threading.Lock()
        self._local = threading.local()

    def forget_grasps(self) -> None:
        """Starts anew with grasps and lifts, which are kept from the first time they are asked for."""
        padding, step = self._padding, self.options.lift_check_step
        self.reach = Reach(self.assembly, self.workcell, self.robot, self._ik, self.world, padding, step)

    def straight_line_bound(self, part: int) -> float:
        """No removal of the part is shorter in this workcell, whatever planner made it, m; infinite without any
        grasp.
        """
        bounds = self.reach.bounds(part)
        return bounds[0][0] if bounds else math.inf

    def plan(
        self, part: int, state: int, *, rng: np.random.Generator, shorter_than: float = math.inf, attempts: int = 1
    ) -> Removal | Blocked:
        """The shortest removal of a part in a state that this planner finds.

        Args:
            part: number of the part; it stands in the state.
            state: parts that are there.
            rng: for the random choices of this query.
            shorter_than: only something shorter is of interest, m.
            attempts: how often it is planned; the shortest is returned.

        Returns:
            The removal, or why there is none: stage and blamed parts. With a finite `shorter_than` a refusal at stage
            "path" may only mean that nothing shorter was found.
        """
        others = state & ~(1 << part)
        lift = self.lift_blockers[part]
        if lift is None or lift & others:
            return Blocked(part, "lift", (lift or 0) & others)
        best: Removal | Blocked | None = None
        limit = shorter_than
        for _ in range(attempts):
            found = self._attempt(part, others, rng, limit)
            if isinstance(found, Removal) and found.length >= limit:
                found = Blocked(part, "path", self._blame_path(part, others))  # shortening did not get it below
            if isinstance(found, Removal):
                best, limit = found, found.length
                if limit <= self.straight_line_bound(part) + self.options.tolerance:
                    break
            elif best is None or (isinstance(best, Blocked) and found.stage == "path"):
                best = found
        assert best is not None  # attempts >= 1
        return best

    def _attempt(self, part: int, others: int, rng: np.random.Generator, limit: float) -> Removal | Blocked:
        work, options = self._workspace(), self.options
        lift = self.workcell.lift_height
        nearest: int | None = None  # fewest parts in the way of any hand
        open_: list[int] = []
        for number, (bound, _) in enumerate(self.reach.bounds(part)):
            if bound >= limit - options.tolerance:
                break
            blockers = self.reach.hand(part, number, work).blockers
            if blockers is not None and not blockers & others:
                open_.append(number)
            elif blockers is not None:
                nearest = _fewer(nearest, blockers & others)
        paths: list[_Path] = []
        # Paths of one or two straight legs; grasps in the order of what a ball in place of the hand would need.
        tried = 0
        for estimate, number, points in self._estimates(part, others, open_, limit, rng, work):
            if estimate >= limit - options.tolerance or tried >= options.leg_grasps:
                break
            branches = self._valid(part, others, number, work)
            if not branches:
                continue
            tried += 1
            path = self._legs(others, self.reach.hand(part, number, work), branches, points, limit - lift, rng, work)
            if path is not None:
                paths.append(path)
                limit = path.length + lift
        # Then trees; where few grasps are left they are tried again, with other random numbers.
        successes = failures = turn = 0
        usable = self._spread(part, open_, limit, work)
        while usable and successes < options.tree_paths and failures < options.tree_failures:
            number = usable[turn % len(usable)]
            branches = self._valid(part, others, number, work)
            hand = self.reach.hand(part, number, work)
            if not branches or hand.bound >= limit - options.tolerance:
                usable.remove(number)
                continue
            turn += 1
            path = self._tree(others, hand, branches, limit - lift, rng, work)
            if path is None:
                failures += 1
                continue
            successes += 1
            paths.append(path)
            limit = min(limit, path.length + lift)
        removal = self._polish(part, others, paths, rng, work)
        return removal if removal is not None else self._refusal(part, others, open_, nearest, work)

    def _refusal(self, part: int, others: int, open_: list[int], nearest: int | None, work: Workspace) -> Blocked:
        """The furthest stage that any grasp reached, and the fewest parts whose absence would take one further.

        Args:
            open_: grasps that the hand can take.
            nearest: fewest parts in the way of a hand.
        """
        if not open_:
            return Blocked(part, "grasp", nearest or 0)
        if not len(self.goals.all(work)):
            return Blocked(part, "ik", 0)
        in_the_way: int | None = None
        for number in open_:
            for branch in self.reach.branches(part, number, work):
                if not branch.blockers & others:
                    return Blocked(part, "path", self._blame_path(part, others))
                in_the_way = _fewer(in_the_way, branch.blockers & others)
        return Blocked(part, "ik", in_the_way or 0)

    def _valid(self, part: int, others: int, number: int, work: Workspace) -> tuple[LiftBranch, ...]:
        return tuple(b for b in self.reach.branches(part, number, work) if not b.blockers & others)

    def _estimates(
        self, part: int, others: int, pending: list[int], limit: float, rng: np.random.Generator, work: Workspace
    ) -> list[tuple[float, int, Array]]:
        """Grasps with the least length of a path with at most one bend that a ball could follow, m; shortest first."""
        found = []
        present = flags_of(others, self._parts)
        known: dict[tuple[float, ...], Array] = {}
        for number in pending:
            hand = self.reach.hand(part, number, work)
            if hand.bound >= limit - self.options.tolerance:
                break
            key = tuple(np.round(hand.lifted, 6).tolist())
            if key not in known:
                longest = limit - self.workcell.lift_height
                seed = int(rng.integers(1 << 62))
                known[key] = bends(
                    self._world_of(others),
                    present,
                    hand.lifted,
                    self.workcell.goal,
                    hand.radius,
                    self.options.bend_samples,
                    longest,
                    seed,
                )
            points = known[key]
            if hand.line is not None and not hand.line & others:
                found.append((hand.bound, number, points))
            elif len(points):
                found.append((float(points[0, 3]) + self.workcell.lift_height, number, points))
        return sorted(found, key=lambda entry: (entry[0], self.reach.from_above(part, entry[1]), entry[1]))

    def _legs(
        self,
        others: int,
        hand: Hand,
        branches: tuple[LiftBranch, ...],
        points: Array,
        longest: float,
        rng: np.random.Generator,
        work: Workspace,
    ) -> _Path | None:
        """A path that is straight for the tool, or else one of two straight legs."""
        self._count()
        options = self.options
        scene = self._scene(hand, others, work)
        lifted = np.array([branch.rows[-1] for branch in branches])
        seed = int(rng.integers(1 << 62))
        if hand.line is not None and not hand.line & others:
            every = self.goals.all(work)
            rows = one_leg(scene, lifted, every, options.straight_attempts, options.row_spacing, options.check_step)
            if len(rows):
                return self._path(hand, branches, rows, work)
        goals = self.goals.free(scene, lifted, work)
        rows = two_legs(
            scene, lifted, goals, points, options.bend_attempts, longest, options.row_spacing, options.check_step, seed
        )
        return self._path(hand, branches, rows, work)

    def _spread(self, part: int, pending: list[int], limit: float, work: Workspace) -> list[int]:
        """Pending grasps that can still be shorter, those with another position or approach than all before them
        first.
        """
        first: list[int] = []
        later: list[int] = []
        seen: set[tuple[int, ...]] = set()
        for number in sorted(pending, key=lambda n: (self.reach.from_above(part, n), n)):
            hand = self.reach.hand(part, number, work)
            if hand.bound >= limit - self.options.tolerance:
                continue
            approach = tuple(np.round(hand.candidate.T_part_tool[:3, 2]).astype(int).tolist())
            position = int(hand.candidate.T_part_tool[:3, 3].sum() // 0.06)
            (later if (*approach, position) in seen else first).append(number)
            seen.add((*approach, position))
        return first + later

    def _tree(
        self,
        others: int,
        hand: Hand,
        branches: tuple[LiftBranch, ...],
        longest: float,
        rng: np.random.Generator,
        work: Workspace,
    ) -> _Path | None:
        """A path by RRT-Connect, shortened a little."""
        self._count()
        options = self.options
        scene = self._scene(hand, others, work)
        lifted = np.array([branch.rows[-1] for branch in branches])
        goals = self.goals.free(scene, lifted, work)
        if not len(goals):
            return None
        seeds = rng.integers(1 << 62, size=2)
        corners = rrt_connect(
            scene, lifted, goals, options.tree_iterations, options.tree_stride, options.check_step, int(seeds[0])
        )
        if not len(corners):
            return None
        rows = dense(scene, corners, options.row_spacing)
        if not len(rows):
            return None
        rows = self._shorten(scene, rows, options.quick_moves, longest, int(seeds[1]))
        return self._path(hand, branches, rows, work)

    def _shorten(self, scene: Scene, rows: Array, moves: int, longest: float, seed: int) -> Array:
        options = self.options
        patience = options.shortening_patience
        return shorten(scene, rows, moves, options.row_spacing, options.check_step, longest, patience, seed)

    def _polish(
        self, part: int, others: int, paths: list[_Path], rng: np.random.Generator, work: Workspace
    ) -> Removal | None:
        """The best removal after the shortest paths were shortened with all moves."""
        paths = sorted(paths, key=lambda path: path.length)
        best: Removal | None = None
        for place, path in enumerate(paths):
            if best is not None and (place >= self.options.finalists or path.hand.bound >= best.length):
                break
            scene = self._scene(path.hand, others, work)
            rows = path.rows
            seed = int(rng.integers(1 << 62))
            if path.length > path.hand.bound - self.workcell.lift_height + 1e-4:
                rows = self._shorten(scene, rows, self.options.shortening_moves, math.inf, seed)
            removal = self._finish(part, others, replace(path, rows=rows), work)
            if removal is not None and (best is None or removal.length < best.length):
                best = removal
        return best

    def _finish(self, part: int, others: int, path: _Path, work: Workspace) -> Removal | None:
        """Joins lift and path, and finds the blockers of the whole motion; None if the motion does not hold."""
        branch = next(b for b in path.branches if np.array_equal(b.rows[-1], path.rows[0]))
        scene = self._scene(path.hand, self.assembly.root & ~(1 << part), work)
        scene = scene._replace(padding=self.workcell.clearance)  # the check adds what moves between its samples
        hits = flags_of(branch.blockers | (self.lift_blockers[part] or 0), self._parts)
        hits[-1] = 0
        if not path_blockers(scene, path.rows, self.options.check_step, hits):
            return None
        blockers = state_of(hits)
        if blockers & others:
            return None
        joint_path = np.concatenate([branch.rows[:-1], path.rows])
        tool_path = self.tool_path(joint_path)
        held = Grasp(tool_path[0, :3].copy(), tool_path[0, 3:].copy(), path.hand.candidate.width)
        return Removal(part, held, joint_path, tool_path, tool_length(tool_path), blockers)

    def tool_path(self, joint_path: Array) -> Array:
        """Tool poses (M, 7): x, y, z, m, and quaternion w, x, y, z of every row of a joint path (M, n), rad."""
        positions, rotations = np.empty((len(joint_path), 3)), np.empty((len(joint_path), 3, 3))
        tool_poses(self.robot.arm, np.ascontiguousarray(joint_path), self._workspace(), positions, rotations)
        return np.column_stack([positions, [quaternion_from_rotation(R) for R in rotations]])

    def _path(self, hand: Hand, branches: tuple[LiftBranch, ...], rows: Array, work: Workspace) -> _Path | None:
        if not len(rows):
            return None
        positions, rotations = np.empty((len(rows), 3)), np.empty((len(rows), 3, 3))
        tool_poses(self.robot.arm, rows, work, positions, rotations)
        return _Path(hand, branches, rows, float(np.linalg.norm(np.diff(positions, axis=0), axis=1).sum()))

    def _count(self) -> None:
        with self._lock:
            self.counts.motion_plans += 1

    def _workspace(self) -> Workspace:
        if not hasattr(self._local, "work"):
            self._local.work = self.robot.workspace(self._largest_load)
        work: Workspace = self._local.work
        return work

    def _world_of(self, state: int) -> WorldArrays:
        """The world with the clearance field of a state."""
        world = self._worlds.get(state)
        if world is None:
            world = with_field(self.world, self._fields, flags_of(state, self._parts))
            if len(self._worlds) >= KEPT_WORLDS:
                self._worlds.clear()
            self._worlds[state] = world
        return world

    def _scene(self, hand: Hand, others: int, work: Workspace) -> Scene:
        present = flags_of(others, self._parts)
        world = self._world_of(others)
        return new_scene(self.robot.arm, hand.held, world, present, self._padding, work)

    def _blame_path(self, part: int, others: int) -> int:
        """Parts that the straight line of every grasp meets; all others if there is no such part."""
        lines = [
            self.reach.hand(part, number, self._workspace()).line for number in range(len(self.reach.bounds(part)))
        ]
        common = others
        for line in lines:
            if line is not None:
                common &= line
        return common or others


def _fewer(first: int | None, second: int) -> int:
    return second if first is None or second.bit_count() < first.bit_count() else first


def tool_length(tool_path: Array) -> float:
    """Length of a tool path (M, 7), m: sum of distances of consecutive positions (Eq. 2)."""
    return float(np.linalg.norm(np.diff(tool_path[:, :3], axis=0), axis=1).sum())
