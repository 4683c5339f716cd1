"""Our path planner beside plainmp, roboplan and OMPL: the same starts, goals, obstacles and robot, in one run.

    python benchmarks/peers.py --peers out/peers --document docs/benchmarks.md

Peers are optional; the table says which are missing. How to install them stands in docs/benchmarks.md.

The situations are those of removal queries: the arm has lifted a bar out of a random state of a profile assembly and
brings it to a goal configuration. plainmp gets the spheres of our robot model, and spheres of the bar's thickness along
fingers and bar, which lie inside the boxes that we check, so that nothing is harder for it than for us; roboplan gets
the same boxes for the bar, and the collision meshes of the URDF; OMPL asks our own check. Situations whose start or
goal one of them takes for a collision are left out for all.
"""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import os
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from speed import new_problem, random_edges
from takeapart.compilation import compiled
from takeapart.experiments.tables import markdown_table, replace_between_markers
from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.model.geometry import pose_inverse
from takeapart.motion.edges import waypoints
from takeapart.motion.rrt import rrt_connect
from takeapart.motion.scene import Scene, is_free, new_scene
from takeapart.motion.smooth import shorten
from takeapart.robot.kinematics import tool_steps
from takeapart.robot.loading import load_robot
from takeapart.robot.model import RobotModel
from takeapart.robot.world import owner_fields, with_field
from takeapart.states import flags_of

STEP = 0.001  # m, see `piece_free`; what peers are given in radians is below
SPACING = 0.05  # m, from row to row of our paths, as the removal planner has it
RADIANS = 0.02  # spacing of the peers' checks along an edge
CHECKED = ("spheres", "table")  # pairs of links that our checks look at
JOINTS = [f"panda_joint{j}" for j in range(1, 8)]

Array = Any


@dataclass(frozen=True, eq=False)
class Situation:
    """One path problem; coordinates of obstacles and held boxes in metres.

    Args:
        start, goal: (7,) rad.
        boxes: obstacles, pose (4, 4) in the robot's base frame and size (3,).
        held: fingers' load, pose (4, 4) in the frame of link 7 and size (3,).
        scene: the same for our planner.
    """

    start: Array
    goal: Array
    boxes: list[tuple[Array, Array]]
    held: list[tuple[Array, Array]]
    scene: Scene


def situations(robot: RobotModel, sources: Sequence[str], rng: np.random.Generator) -> Iterator[Situation]:
    """Endless; the only place, with `Ours`, that knows the planner's inner interface."""
    workcell = load_workcell("panda")
    problems = [new_problem(load_assembly(data_path(f"{source}.json")), workcell, robot) for source in sources]
    fields = [owner_fields(p.planner.world, len(p.assembly.parts) + 1) for p in problems]
    T_base_world = pose_inverse(workcell.T_world_base)
    T_link_tool = np.vstack([robot.arm.T_tool, [0, 0, 0, 1]])
    while True:
        number = int(rng.integers(len(problems)))
        problem = problems[number]
        planner, work = problem.planner, robot.workspace(32)
        ((state, part),) = random_edges(problem, 1, rng)
        others = state & ~(1 << part)
        hands = planner.reach.hands(part, work)
        for grasp in rng.permutation(len(hands))[:20]:
            hand = hands[int(grasp)]
            if hand.blockers is None or hand.blockers & others:
                continue
            branches = planner.reach.branches(part, int(grasp), others, work)
            if not branches:
                continue
            present = flags_of(others, len(problem.assembly.parts))
            world = with_field(planner.world, fields[number], present)
            scene = new_scene(robot.arm, hand.held, world, present, workcell.clearance, STEP, work)
            start = np.ascontiguousarray(branches[int(rng.integers(len(branches)))].rows[-1])
            near = planner.goals.neighbours(branches, work)
            goals = planner.goals.free(near, part, hand, others, 1, work)
            if not len(goals):
                continue
            boxes = []
            for c, axes, half, owner in zip(world.center, world.axes, world.half, world.owner, strict=True):
                if present[owner]:
                    boxes.append((T_base_world @ _pose(axes.T, c), 2 * half))
            first, last = hand.held.group[1], hand.held.group[2]
            held = [
                (T_link_tool @ _pose(hand.held.axes[i].T, hand.held.center[i]), 2 * hand.held.half[i])
                for i in range(first, last)
            ]
            yield Situation(start, np.ascontiguousarray(goals[0]), boxes, held, scene)
            break


def _pose(R: Array, p: Array) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return T


class Planner(Protocol):
    """A planner in one situation after the other."""

    name: str

    def enter(self, situation: Situation) -> None:
        """Prepare; not timed."""
        ...

    def valid(self, q: Array) -> bool:
        """Whether a configuration (7,) is free."""
        ...

    def check_seconds(self, qs: Array) -> float:
        """Of one check, on average over configurations (K, 7)."""
        ...

    def plan(self, situation: Situation, seed: int) -> Array | None:
        """(M, 7) first path, not shortened."""
        ...

    def shortcut(self, path: Array, seed: int) -> Array:
        """(M, 7) after the planner's own shortcutting."""
        ...


@compiled
def _count_free(scene: Scene, qs: Array) -> int:
    found = 0
    for k in range(len(qs)):
        if is_free(scene, qs[k]):
            found += 1
    return found


class Ours:
    name = "takeapart"

    def enter(self, situation: Situation) -> None:
        self.scene = situation.scene

    def valid(self, q: Array) -> bool:
        return bool(is_free(self.scene, q))

    def check_seconds(self, qs: Array) -> float:
        _count_free(self.scene, qs[:1])
        started = time.perf_counter()
        _count_free(self.scene, qs)
        return (time.perf_counter() - started) / len(qs)

    def plan(self, situation: Situation, seed: int) -> Array | None:
        corners = rrt_connect(self.scene, situation.start[None], situation.goal[None], 2000, 0.4, seed)
        return corners if len(corners) else None

    def shortcut(self, path: Array, seed: int) -> Array:
        rows = waypoints(self.scene, path, SPACING)
        return shorten(self.scene, rows, 1e-3, 160, SPACING, np.inf, 48, seed) if len(rows) else path


class CalledFromPython:
    """Peers whose check is a call from Python."""

    def valid(self, q: Array) -> bool:
        raise NotImplementedError

    def check_seconds(self, qs: Array) -> float:
        started = time.perf_counter()
        for q in qs:
            self.valid(q)
        return (time.perf_counter() - started) / len(qs)


class Plainmp(CalledFromPython):
    name = "plainmp"

    def __init__(self, robot: RobotModel) -> None:
        from plainmp.constraint import SphereAttachmentSpec
        from plainmp.ompl_solver import OMPLSolver, OMPLSolverConfig, RefineType, set_log_level_none, simplify_path
        from plainmp.problem import Problem
        from plainmp.robot_spec import PandaSpec

        set_log_level_none()
        arm = robot.arm
        urdf = robot_urdf()
        spheres: dict[int, list[tuple[Array, float]]] = {}
        for body, frame in enumerate(arm.body_frame):
            for s in range(arm.body_start[body], arm.body_start[body + 1]):
                spheres.setdefault(int(frame), []).append((arm.sphere_center[s], float(arm.sphere_radius[s])))
        frames = [sorted((int(arm.body_frame[pair.first]), int(arm.body_frame[pair.second]))) for pair in robot.pairs]
        pairs = sorted({(a, b) for (a, b), pair in zip(frames, robot.pairs, strict=True) if pair.treatment in CHECKED})

        class Spec(PandaSpec):
            def urdf_path_override(self) -> Path:
                return urdf

            def parse_sphere_specs(self) -> list[Any]:
                return [
                    SphereAttachmentSpec(
                        f"panda_link{frame}",
                        np.array([center for center, _ in found]).T,
                        np.array([radius for _, radius in found]),
                        frame == 0,
                    )
                    for frame, found in sorted(spheres.items())
                ]

            def get_self_collision_pairs(self) -> list[list[str]]:
                return [[f"panda_link{a}", f"panda_link{b}"] for a, b in pairs if b - a > 1]

        self.Spec, self.Attachment, self.Problem = Spec, SphereAttachmentSpec, Problem
        # A hundred thousand calls are far beyond what any of these queries takes; plainmp stops at them.
        self.solver = OMPLSolver(OMPLSolverConfig(n_max_call=1_000_000, timeout=5.0))
        self.simplify, self.refinements = simplify_path, [RefineType.SHORTCUT]

    def enter(self, situation: Situation) -> None:
        from plainmp.psdf import BoxSDF, Pose, UnionSDF

        spec = self.Spec()
        points = [_inside(T, size) for T, size in situation.held]
        centers = np.concatenate([found for found, _ in points])
        radii = np.concatenate([np.full(len(found), radius) for found, radius in points])
        attachment = self.Attachment("panda_link7", centers.T, radii, False)
        self.constraint = spec.create_collision_const(attachments=(attachment,))
        boxes = [BoxSDF(size, Pose(T[:3, 3], T[:3, :3])) for T, size in situation.boxes]
        self.constraint.set_sdf(UnionSDF(boxes))
        self.lower, self.upper = spec.angle_bounds()

    def valid(self, q: Array) -> bool:
        self.constraint.update_kintree(q, True)
        return bool(self.constraint.is_valid(q))

    def plan(self, situation: Situation, seed: int) -> Array | None:
        from plainmp.ompl_solver import set_random_seed

        set_random_seed(seed + 1)
        self.resolution = np.full(7, RADIANS)
        problem = self.Problem(
            situation.start, self.lower, self.upper, situation.goal, self.constraint, None, self.resolution
        )
        found = self.solver.solve(problem)
        return found.traj.numpy() if found.success else None

    def shortcut(self, path: Array, seed: int) -> Array:
        from plainmp.trajectory import Trajectory

        trajectory = Trajectory(list(path))
        return self.simplify(
            trajectory, self.lower, self.upper, self.constraint, self.resolution, refine_seq=self.refinements
        ).numpy()


class Roboplan(CalledFromPython):
    name = "roboplan"

    def __init__(self, robot: RobotModel) -> None:
        from roboplan import core, rrt

        self.core, self.rrt, self.count = core, rrt, 0
        hand, fingers = robot.bodies[-1], ["panda_leftfinger", "panda_rightfinger"]
        unchecked = [pair for pair in robot.pairs if pair.treatment not in CHECKED]
        self.unchecked = [(robot.bodies[pair.first], robot.bodies[pair.second]) for pair in unchecked]
        self.unchecked += [(hand, fingers[0]), (hand, fingers[1]), (fingers[0], fingers[1])]
        # Our fingers are checked against what they carry and against the links that it may touch, not their own.
        self.unchecked += [(f"panda_link{link}", finger) for link in (6, 7) for finger in fingers]

    def enter(self, situation: Situation) -> None:
        core, rrt = self.core, self.rrt
        self.count += 1
        urdf = robot_urdf()
        # As links of the robot: boxes that are added later are checked against each other, and cost seconds.
        links = _link("obstacles", "panda_link0", situation.boxes) + _link("load", "panda_link7", situation.held)
        model = urdf.read_text().replace("</robot>", f"{links}</robot>")
        description = core.loadUrdfSceneDescriptionFromXml(model, [str(urdf.parents[4])])
        self.scene = core.Scene(f"scene{self.count}", description)
        self.scene.addGroup("free_arm", JOINTS)
        for first, second in self.unchecked:
            self.scene.setCollisions(first, second, False)
        near = ["panda_link7", "panda_hand", "panda_leftfinger", "panda_rightfinger"]
        for first, second in [("obstacles", "panda_link0"), *(("load", name) for name in near)]:
            self.scene.setCollisions(first, second, False)
        self.context = core.SceneContext(self.scene)
        options = rrt.RRTOptions(
            group_name="free_arm",
            max_nodes=20_000,
            collision_check_step_size=RADIANS,
            max_planning_time=5.0,
            rrt_connect=True,
        )
        self.planner = rrt.RRT(self.scene, options)

    def valid(self, q: Array) -> bool:
        return not self.context.hasCollisions(self.scene.toFullJointPositions("free_arm", q))

    def plan(self, situation: Situation, seed: int) -> Array | None:
        self.planner.setRngSeed(seed)
        ends = [self.core.JointConfiguration(JOINTS, q) for q in (situation.start, situation.goal)]
        try:
            self.path = self.planner.plan(*ends)
        except RuntimeError:
            return None
        return np.array(self.path.positions)

    def shortcut(self, path: Array, seed: int) -> Array:
        options = self.core.PathShortcuttingOptions("free_arm", RADIANS, 160, seed)
        return np.array(self.core.PathShortcutter(self.scene, options).shortcut(self.path).positions)


class Ompl(CalledFromPython):
    name = "OMPL, our check"

    def __init__(self, robot: RobotModel) -> None:
        import ompl.base
        import ompl.geometric
        import ompl.util

        ompl.util.setLogLevel(ompl.util.LogLevel.LOG_ERROR)
        self.base, self.geometric = ompl.base, ompl.geometric
        self.space = ompl.base.RealVectorStateSpace(7)
        bounds = ompl.base.RealVectorBounds(7)
        for j in range(7):
            bounds.setLow(j, float(robot.arm.lower[j]))
            bounds.setHigh(j, float(robot.arm.upper[j]))
        self.space.setBounds(bounds)

    def enter(self, situation: Situation) -> None:
        self.scene = situation.scene

    def valid(self, q: Array) -> bool:
        return bool(is_free(self.scene, q))

    def _valid_state(self, state: Any) -> bool:
        return bool(is_free(self.scene, np.array([state[j] for j in range(7)])))

    def plan(self, situation: Situation, seed: int) -> Array | None:
        setup = self.geometric.SimpleSetup(self.space)
        setup.setStateValidityChecker(self._valid_state)
        self.information = setup.getSpaceInformation()
        self.information.setStateValidityCheckingResolution(RADIANS / self.space.getMaximumExtent())
        ends = []
        for q in (situation.start, situation.goal):
            state = self.space.allocState()
            for j in range(7):
                state[j] = float(q[j])
            ends.append(state)
        setup.setStartAndGoalStates(*ends)
        setup.setPlanner(self.geometric.RRTConnect(self.information))
        if not setup.solve(5.0) or not setup.haveExactSolutionPath():
            return None
        self.path = setup.getSolutionPath()
        return self._rows()

    def shortcut(self, path: Array, seed: int) -> Array:
        self.geometric.PathSimplifier(self.information).partialShortcutPath(self.path)
        return self._rows()

    def _rows(self) -> Array:
        states = [self.path.getState(i) for i in range(self.path.getStateCount())]
        return np.array([[state[j] for j in range(7)] for state in states])


def robot_urdf() -> Path:
    """Model file of the arm."""
    return load_workcell("panda").description.arm.files.urdf


def _link(name: str, parent: str, boxes: Sequence[tuple[Array, Array]]) -> str:
    """A link of boxes, fixed to another, in URDF."""
    shapes = []
    for T, size in boxes:
        roll, pitch, yaw = (
            np.arctan2(T[2, 1], T[2, 2]),
            np.arcsin(-np.clip(T[2, 0], -1, 1)),
            np.arctan2(T[1, 0], T[0, 0]),
        )
        origin = f'<origin xyz="{T[0, 3]} {T[1, 3]} {T[2, 3]}" rpy="{roll} {pitch} {yaw}"/>'
        box = f'<geometry><box size="{size[0]} {size[1]} {size[2]}"/></geometry>'
        shapes.append(f"<collision>{origin}{box}</collision>")
    joint = f'<joint name="{name}_joint" type="fixed"><parent link="{parent}"/><child link="{name}"/></joint>'
    return f'<link name="{name}">{"".join(shapes)}</link>{joint}'


def _inside(T: Array, size: Array) -> tuple[Array, float]:
    """Spheres in a box: centres (K, 3) along its longest axis, and their radius, half its least thickness."""
    axis, radius = int(np.argmax(size)), float(size.min()) / 2
    reach = max(size[axis] / 2 - radius, 0.0)
    offsets = np.zeros((max(1, int(np.ceil(reach / radius)) + 1), 3))
    offsets[:, axis] = np.linspace(-reach, reach, len(offsets))
    return offsets @ T[:3, :3].T + T[:3, 3], radius


def tool_length(robot: RobotModel, path: Array) -> float:
    """Length of the tool path of a joint path (M, 7), m: straight joint edges, 1 degree from row to row."""
    rows = [path[:1]]
    for a, b in itertools.pairwise(path):
        count = max(1, int(np.ceil(np.abs(b - a).max() / np.radians(1))))
        rows.append(a + (b - a) * np.linspace(0, 1, count + 1)[1:, None])
    dense_rows = np.ascontiguousarray(np.concatenate(rows))
    steps = np.empty(len(dense_rows) - 1)
    tool_steps(robot.arm, dense_rows, robot.workspace(), steps)
    return float(steps.sum())


@dataclass
class Record:
    """Measurements of one planner, one entry per situation."""

    checks: list[float]  # s
    first: list[float]  # s, until the first path
    first_lengths: list[float]  # m, of the first path after one shortcutting
    lengths: list[float]  # m, the best after equal time
    failures: int = 0


def measure(planner: Planner, situation: Situation, robot: RobotModel, seconds: float, qs: Array, to: Record) -> None:
    """All about one planner in one situation, `seconds` of planning in all."""
    to.checks.append(planner.check_seconds(qs))
    best, turn, started = np.inf, 0, time.perf_counter()
    while turn == 0 or time.perf_counter() - started < seconds:
        before = time.perf_counter()
        path = planner.plan(situation, turn)
        took = time.perf_counter() - before
        if path is not None:
            length = tool_length(robot, planner.shortcut(path, turn))
            best = min(best, length)
            if turn == 0:
                to.first_lengths.append(length)
        if turn == 0:
            to.first.append(took if path is not None else np.inf)
            to.failures += path is None
        turn += 1
    to.lengths.append(best)


def peers(robot: RobotModel) -> tuple[list[Planner], list[str]]:
    """Planners that are there, ours first, and names of those that are missing."""
    makers: dict[str, tuple[str, Callable[[], Planner]]] = {
        "plainmp": ("plainmp", lambda: Plainmp(robot)),
        "roboplan": ("roboplan", lambda: Roboplan(robot)),
        "ompl": ("OMPL", lambda: Ompl(robot)),
    }
    found: list[Planner] = [Ours()]
    missing = []
    for module, (name, make) in makers.items():
        if importlib.util.find_spec(module) is None:
            missing.append(name)
        else:
            found.append(make())
    return found, missing


def run(count: int, seconds: float, seed: int, sources: Sequence[str]) -> str:
    """The table, and what was left out."""
    rng = np.random.default_rng(seed)
    robot = load_robot(load_workcell("panda"))
    planners, missing = peers(robot)
    records = {planner.name: Record([], [], [], []) for planner in planners}
    left_out = 0
    done = 0
    for situation in situations(robot, sources, rng):
        for planner in planners:
            planner.enter(situation)
        if not all(planner.valid(q) for planner in planners for q in (situation.start, situation.goal)):
            left_out += 1
            if left_out > 20 * count:
                refusing = ", ".join(p.name for p in planners if not p.valid(situation.start))
                raise SystemExit(f"{left_out} situations were left out, the last one because of {refusing}")
            continue
        qs = rng.uniform(robot.arm.lower, robot.arm.upper, (500, 7))
        if done == 0:
            measure(planners[0], situation, robot, 0.0, qs, Record([], [], [], []))  # compile
        for planner in planners:
            measure(planner, situation, robot, seconds, qs, records[planner.name])
        done += 1
        print(f"situation {done} of {count}", end="\r", flush=True)
        if done == count:
            break
    ours = records[planners[0].name]
    rows = []
    for name, record in records.items():
        ratio = [a / b for a, b in zip(record.lengths, ours.lengths, strict=True) if np.isfinite(a) and np.isfinite(b)]
        finite = [each for each in record.first if np.isfinite(each)]
        rows.append(
            [
                name,
                f"{1e6 * statistics.median(record.checks):.1f}",
                f"{1e3 * statistics.median(finite):.2f}" if finite else "-",
                f"{1e3 * float(np.quantile(finite, 0.9)):.2f}" if finite else "-",
                f"{statistics.median(record.first_lengths):.3f}" if record.first_lengths else "-",
                f"{statistics.median(record.lengths):.3f}",
                f"{statistics.median(ratio):.3f}" if ratio else "-",
                f"{done - record.failures} of {done}",
            ]
        )
    header = ["planner", "a check, us", "first path, ms: median", "p90", "first path shortcut, m"]
    header += [f"best after {seconds:g} s, m", "ratio to ours", "success"]
    load = ", ".join(f"{x:.1f}" for x in os.getloadavg())
    note = f"{done} situations of {', '.join(sources)}, {left_out} left out; load {load}. "
    note += f"Missing: {', '.join(missing)}." if missing else "No peer is missing."
    return f"{note}\n\n{markdown_table(header, rows)}"


def main() -> None:
    """Prints the table; with --document it replaces the one there."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=30, help="situations")
    parser.add_argument("--seconds", type=float, default=0.2, help="planning time of each planner in each situation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sources", nargs="+", default=["single/01", "double/01"], help="shipped assemblies")
    parser.add_argument("--document", type=Path, help="document with the markers of `peers`")
    parser.add_argument("--peers", type=Path, help="folder into which pip installed the peers (--target)")
    arguments = parser.parse_args()
    if arguments.peers:
        version = f"python{sys.version_info.major}.{sys.version_info.minor}"
        sys.path += [str(arguments.peers), str(arguments.peers / "cmeel.prefix" / "lib" / version / "site-packages")]
    text = run(arguments.count, arguments.seconds, arguments.seed, arguments.sources)
    print(text)
    if arguments.document:
        replace_between_markers(arguments.document, "peers", text)


if __name__ == "__main__":
    main()
