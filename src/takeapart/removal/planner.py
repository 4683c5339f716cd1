"""The removal planner (Sec. IV-B): exit, grasp, inverse kinematics, path; everything found goes to the removal
library.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from takeapart.collision.contact import Contacts
from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Array, OrientedBox
from takeapart.model.plan import Grasp
from takeapart.motion.blockers import path_blockers
from takeapart.motion.edges import resampled
from takeapart.motion.scene import Scene
from takeapart.removal.exits import ExitRule, Exits
from takeapart.removal.goals import GoalConfigurations
from takeapart.removal.grasps import volume_bound
from takeapart.removal.lifting import Lifts
from takeapart.removal.margins import padding, passing
from takeapart.removal.paths import Path, PathSearch, RemovalOptions
from takeapart.removal.placement import require_placement, require_reached_goal
from takeapart.removal.reach import Reach
from takeapart.removal.result import Blocked, Counts, Removal, never
from takeapart.removal.situation import Situation
from takeapart.robot.arrays import Workspace, WorldArrays
from takeapart.robot.ik import InverseKinematics, Solver
from takeapart.robot.kernels import LARGEST_MARGIN
from takeapart.robot.kinematics import tool_poses
from takeapart.robot.loading import load_robot
from takeapart.robot.model import RobotModel
from takeapart.robot.world import build_world, owner_fields, with_field
from takeapart.states import flags_of, state_of
from takeapart.workcell import Workcell

KEPT_WORLDS = 64  # clearance fields of states that are kept

LARGEST_BEND = 5e-5  # m, by which the motion along a path may exceed the path from row to row
MAXIMUM_HALVINGS = 6  # of the spacing of rows; each leaves a quarter of the bend

DEFAULTS = RemovalOptions()

USUAL_ATTEMPTS = 4  # that find nothing, before trees are allowed to grow larger
LARGER_TREES = 5  # times as many random samples: a way that small trees miss again and again is narrow

__all__ = ["RemovalOptions", "RemovalPlanner"]


class RemovalPlanner:
    """Best removal of one part in one state, over all its grasps.

    Thread-safe: queries may run at the same time on several threads.

    Args:
        assembly: the product.
        workcell: everything around it.
        options: see `RemovalOptions`.
        robot: the arm, if it is loaded already.
        exits: how parts get clear without the arm; by default as the product wants it.
        ik: inverse kinematics for the grasps, by default those of the robot.
        is_placed: whether it is known that home, goal and obstacles stand where something can be planned.

    Raises:
        InputError: robot files are missing or unusable; home, goal or an obstacle stand where nothing can be planned.
    """

    def __init__(
        self,
        assembly: Assembly,
        workcell: Workcell,
        options: RemovalOptions = DEFAULTS,
        robot: RobotModel | None = None,
        is_placed: bool = False,
        exits: ExitRule | None = None,
        ik: Solver | None = None,
    ) -> None:
        self.assembly, self.workcell, self.options = assembly, workcell, options
        self._patient = replace(options, tree_iterations=LARGER_TREES * options.tree_iterations)
        self.robot = robot or load_robot(workcell)
        if not is_placed:
            require_placement(assembly, workcell, self.robot)
        self.counts = Counts()
        self._parts = len(assembly.parts)
        self._padding = padding(workcell.clearance, options.check_step)
        obstacles = tuple(obstacle.box for obstacle in workcell.environment)
        self.exits = exits or _exit_rule(assembly, workcell, obstacles, self._padding)
        boxes: list[tuple[OrientedBox, int]] = []
        for i, part in enumerate(assembly.parts):
            owner = self._parts if part.fixed else i
            boxes += [(box.moved(part.T_world_part), owner) for box in assembly.body(i)]
        boxes += [(box, self._parts) for box in obstacles]
        self.world = build_world(boxes, self.robot.largest_ball + self._padding + LARGEST_MARGIN)
        self._fields = owner_fields(self.world, self._parts + 1)
        self._worlds: dict[int, WorldArrays] = {}
        self.world = self._world_of(assembly.root)
        self._ik = solved = InverseKinematics(self.robot)
        step = options.lift_check_step
        self.reach = Reach(assembly, workcell, self.robot, ik or solved, self.world, self.exits, self._padding, step)
        self.goals = GoalConfigurations(workcell, self.robot, solved, self.world, self._padding, self._parts)
        self._largest_load = max(len(assembly.body(i)) for i in range(self._parts))
        self._lock = threading.Lock()
        self._local = threading.local()
        if not is_placed:
            require_reached_goal(assembly, workcell, self.robot, self.goals, self._padding, self.workspace())

    def forget_grasps(self) -> None:
        """Starts anew with grasps and lifts, which are kept from the first time they are asked for."""
        self.reach.forget()
        self.goals.forget()

    def candidate_bound(self, part: int) -> float:
        """No removal of the part with one of its grasp candidates is shorter, m; infinite without any. What this
        planner cannot undercut, but a grasp between two candidates can.
        """
        return self.reach.bound(part)

    def is_graspable(self, part: int) -> bool:
        """Whether the gripper can hold the part, whatever stands around it: it is neither too heavy nor too wide."""
        return bool(self.reach.candidates(part))

    def freedom(self, part: int) -> tuple[int, ...]:
        """States of the parts that the exits of a part would hit: it may leave where all of one of them are gone. Empty
        where no exit passes what never leaves, or no gripper of this cell holds the part."""
        if not self.is_graspable(part):
            return ()
        masks = (way.blockers for way in self.exits.exits(part))
        return tuple(dict.fromkeys(mask for mask in masks if mask is not None))

    def straight_line_total(self, removals: Sequence[Removal]) -> float:
        """The straight-line bound, m: no plan that removes these parts, each gripped somewhere in its volume, is
        shorter.
        """
        lift, goal = self.workcell.lift_height if self.assembly.is_lifted else 0.0, self.workcell.goal
        return math.fsum(volume_bound(self.assembly.parts[each.part], lift, goal) for each in removals)

    def plan(
        self,
        part: int,
        state: int,
        *,
        rng: np.random.Generator,
        shorter_than: float = math.inf,
        attempts: int = 1,
        is_late: Callable[[], bool] = never,
    ) -> Removal | Blocked:
        """The shortest removal of a part in a state that this planner finds.

        Args:
            part: number of the part; it stands in the state.
            state: parts that are there.
            rng: for the random choices of this query.
            shorter_than: only something shorter is of interest, m.
            attempts: how often it is planned; the shortest is returned. Where four found nothing, and nothing shorter
                is asked for, further ones grow trees five times as large.
            is_late: whether the time is over; looked at between the steps of planning.

        Returns:
            The removal, or why there is none: stage and blamed parts. With a finite `shorter_than` a refusal at stage
            "path" may only mean that nothing shorter was found.

        Raises:
            OutOfTimeError: the time was over first.
        """
        others = state & ~(1 << part)
        if not self.is_graspable(part):
            return Blocked(part, "grasp", 0)
        freedom = self.freedom(part)
        if all(mask & others for mask in freedom):
            return Blocked(part, "lift", _fewest([mask & others for mask in freedom]))
        situation = Situation(
            self.robot,
            self.reach,
            self.goals,
            part,
            others,
            flags_of(others, self._parts),
            self._world_of(others),
            self._padding,
            self.options.check_step,
            self.workspace(),
            is_late,
        )
        best: Removal | Blocked | None = None
        limit = shorter_than
        for turn in range(attempts):
            patient = turn >= USUAL_ATTEMPTS and math.isinf(limit)
            found = self._attempt(situation, rng, limit, self._patient if patient else self.options)
            if isinstance(found, Removal) and found.length >= limit:
                found = Blocked(part, "path", others)  # shortening did not get it below
            if isinstance(found, Removal):
                best, limit = found, found.length
                if limit <= self.candidate_bound(part) + self.options.tolerance:
                    break
            elif best is None or (isinstance(best, Blocked) and found.stage == "path"):
                best = found
        with self._lock:
            self.counts.motion_plans += situation.motion_plans
        assert best is not None  # attempts >= 1
        return best

    def _attempt(
        self, situation: Situation, rng: np.random.Generator, limit: float, options: RemovalOptions
    ) -> Removal | Blocked:
        search = PathSearch(situation, options, self.workcell.goal, limit, rng)
        open_ = search.open_grasps(limit)
        best: Removal | None = None
        for place, path in enumerate(search.search(open_, limit)):
            bound = situation.hands[path.number].bound
            if best is not None and (place >= self.options.finalists or bound >= best.length):
                break
            removal = self._finish(situation, search.polished(path))
            if removal is not None and (best is None or removal.length < best.length):
                best = removal
        return best if best is not None else self._refusal(situation, open_)

    def _refusal(self, situation: Situation, open_: list[int]) -> Blocked:
        """The furthest stage that any grasp reached, and the fewest parts whose absence would take one further.

        Args:
            open_: grasps that the hand can take.
        """
        part, others = situation.part, situation.others
        if not open_:
            known = [hand.way & others for hand in situation.hands if hand.way is not None]
            return Blocked(part, "grasp", _fewest(known))
        if any(situation.branches(number) for number in open_):
            return Blocked(part, "path", self._blame_path(situation))
        known = [mask for number in open_ for mask in self.reach.in_the_way(part, number, others, situation.work)]
        return Blocked(part, "ik", _fewest(known))

    def _finish(self, situation: Situation, path: Path) -> Removal | None:
        """Joins exit and path, and finds the blockers of the whole motion; None if the motion does not hold."""
        situation.look_at_clock()
        part, others = situation.part, situation.others
        place = int((situation.lifted(path.number) == path.rows[0]).all(axis=1).argmax())
        branch = situation.branches(path.number)[place]
        everything = flags_of(self.assembly.root & ~(1 << part), self._parts)
        if situation.tool_bend(path.number, branch.rows) > LARGEST_BEND:
            return None
        scene = situation.scene(path.number)._replace(
            world=self.world,
            present=everything,
            padding=self.workcell.clearance,  # the check adds what moves between its samples
        )
        lift_hits = flags_of(branch.blockers | (situation.hands[path.number].exit.blockers or 0), self._parts)
        lift_hits[-1] = 0
        for straighten in (True, False):  # as it was planned, if the straighter one hits something
            rows = self._close_rows(situation, scene, path.number, path.rows, straighten)
            hits = lift_hits.copy()
            if len(rows) and path_blockers(scene, rows, hits) and not state_of(hits) & others:
                break
        else:
            return None
        joint_path = np.concatenate([branch.rows[:-1], rows])
        opening = situation.opening(path.number)
        tool_path = self.tool_path(joint_path, opening)
        held = Grasp(tool_path[0, :3].copy(), tool_path[0, 3:].copy(), opening)
        length = situation.tool_length(path.number, joint_path)
        return Removal(part, held, joint_path, tool_path, length, state_of(hits))

    def _close_rows(self, situation: Situation, scene: Scene, number: int, rows: Array, straighten: bool) -> Array:
        """Rows (N, n) of a path so close that the joints move the tool no further between them than straight, but for
        `LARGEST_BEND` in all: what a plan states, from row to row, is what the arm does. (0, n) if they are too many.
        """
        spacing = self.options.row_spacing
        for _ in range(MAXIMUM_HALVINGS):
            found = resampled(scene, rows, spacing, straighten)
            if len(found) < 2 or situation.tool_bend(number, found) <= LARGEST_BEND:
                return found
            spacing /= 2
        return found[:0]

    def tool_path(self, joint_path: Array, opening: float = 0.0) -> Array:
        """Tool poses (M, 7): x, y, z, m, and quaternion w, x, y, z of every row of a joint path (M, n), rad, at an
        opening of the fingers, m.
        """
        poses = np.empty((len(joint_path), 7))
        tool_poses(self.robot.arm_at(opening), np.ascontiguousarray(joint_path), self.workspace(), poses)
        return poses

    def workspace(self) -> Workspace:
        """Scratch memory of the calling thread."""
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

    def _blame_path(self, situation: Situation) -> int:
        """Parts that the straight line of every grasp meets; all others if there is no such part."""
        common = situation.others
        for hand in situation.hands:
            if hand.line is not None:
                common &= hand.line
        return common or situation.others


def _exit_rule(assembly: Assembly, workcell: Workcell, obstacles: tuple[OrientedBox, ...], padding: float) -> ExitRule:
    """Lifts for a product of boxes; else ways out in all directions."""
    if assembly.is_lifted:
        return Lifts(assembly, workcell.lift_height, padding, obstacles, passing(workcell.clearance))
    contacts = Contacts(assembly)
    contacts.require()
    return Exits(assembly, contacts, obstacles, passing(workcell.clearance))


def _fewest(masks: Sequence[int]) -> int:
    """The first of the masks with the fewest parts."""
    return min(masks, key=int.bit_count, default=0)
