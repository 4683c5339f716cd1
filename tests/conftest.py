"""One arm, one assembly and one planner for all geometric tests: made once per session and worker."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import hypothesis
import numpy as np
import pytest

from takeapart.formats.files import data_path, load_workcell
from takeapart.generate.profiles import ProfileOptions, Rejected, candidate_rng, generate_candidate
from takeapart.model.assembly import Assembly, members
from takeapart.model.geometry import Array, OrientedBox
from takeapart.motion.scene import Scene, new_scene
from takeapart.problem import AssemblyProblem
from takeapart.removal.planner import RemovalPlanner
from takeapart.robot.arrays import HeldArrays, WorldArrays
from takeapart.robot.loading import load_robot
from takeapart.robot.model import RobotModel
from takeapart.robot.world import build_world
from takeapart.stability import ConnectorStability
from takeapart.states import flags_of
from takeapart.workcell import Workcell

# The same inputs in every run of the tests; `make fuzz` looks for new ones.
hypothesis.settings.register_profile("repeatable", derandomize=True)
hypothesis.settings.load_profile("repeatable")


def first_candidate(options: ProfileOptions, name: str) -> Assembly:
    """The first assembly that the generator does not reject, with seed 0."""
    for k in range(200):
        drawn = generate_candidate(options, candidate_rng(0, k), name)
        if not isinstance(drawn, Rejected):
            return drawn
    raise AssertionError("the generator rejected 200 candidates")


@pytest.fixture(scope="session")
def workcell() -> Workcell:
    return load_workcell(data_path("workcells/panda.toml"))


@pytest.fixture(scope="session")
def robot(workcell: Workcell) -> RobotModel:
    return load_robot(workcell)


@pytest.fixture(scope="session")
def assembly() -> Assembly:
    return first_candidate(ProfileOptions(), "single")


@pytest.fixture(scope="session")
def planner(assembly: Assembly, workcell: Workcell, robot: RobotModel) -> RemovalPlanner:
    return RemovalPlanner(assembly, workcell, robot=robot)


@pytest.fixture
def problem(planner: RemovalPlanner) -> AssemblyProblem:
    """A problem that knows nothing yet. Its planner, and so its counts, are shared: compare counts by difference."""
    return AssemblyProblem(planner, ConnectorStability(planner.assembly))


@dataclass(frozen=True, eq=False)
class Edge:
    """A part and a state in which gravity and lifting let it go."""

    state: int
    part: int


def random_states(assembly: Assembly, count: int, rng: np.random.Generator) -> list[int]:
    """States with few, with many and with half of the parts."""
    parts = members(assembly.root)
    found = []
    for _ in range(count):
        share = rng.choice([0.1, 0.3, 0.5, 0.8])
        found.append(sum(1 << part for part in parts if rng.random() < share))
    return found


@pytest.fixture(scope="session")
def edges(planner: RemovalPlanner) -> list[Edge]:
    """Forty edges of random reachable states: parts leave at random, as gravity and lifting allow."""
    rng = np.random.default_rng(5)
    problem = AssemblyProblem(planner, ConnectorStability(planner.assembly))
    found: list[Edge] = []
    state = problem.root
    while len(found) < 40:
        choice = problem.candidates(state)
        part = int(rng.choice(choice))
        if rng.random() < 0.5:
            found.append(Edge(state, part))
        state = state & ~(1 << part) or problem.root
    return found


def scene_of(
    robot: RobotModel,
    held: HeldArrays,
    world: WorldArrays,
    state: int,
    parts: int,
    padding: float,
    step: float = 0.001,
) -> Scene:
    """A planning situation with scratch memory of its own."""
    return new_scene(robot.arm, held, world, flags_of(state, parts), padding, step, robot.workspace(64))


def random_rotation(rng: np.random.Generator) -> Array:
    """Uniform rotation matrix (3, 3)."""
    Q, R = np.linalg.qr(rng.normal(size=(3, 3)))
    Q = Q * np.sign(np.diag(R))
    return Q if np.linalg.det(Q) > 0 else Q[:, [1, 0, 2]]


def random_box(rng: np.random.Generator, low: Array, high: Array, smallest: float, largest: float) -> OrientedBox:
    """A box at a random place between two corners, m, turned at random."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = random_rotation(rng), rng.uniform(low, high)
    return OrientedBox(T, rng.uniform(smallest, largest, 3))


def random_configurations(robot: RobotModel, count: int, rng: np.random.Generator) -> Array:
    """(count, n) rad, uniform within the joint limits."""
    return rng.uniform(robot.arm.lower, robot.arm.upper, (count, robot.joints))


def boxes_around(robot: RobotModel, count: int, rng: np.random.Generator) -> list[OrientedBox]:
    """Boxes within reach of the arm, none of them at its base."""
    base = robot.T_world_base[:3, 3]
    found: list[OrientedBox] = []
    while len(found) < count:
        box = random_box(rng, base + [-0.8, -0.8, -0.2], base + [0.8, 0.8, 1.0], 0.01, 0.12)
        if np.linalg.norm(box.T_frame_box[:2, 3] - base[:2]) > 0.25:
            found.append(box)
    return found


def world_of(robot: RobotModel, boxes: Sequence[tuple[OrientedBox, int]]) -> WorldArrays:
    """Boxes with their owners, for checks with at most 6 cm of padding."""
    return build_world(boxes, robot.largest_ball + 0.06)


def world_around(robot: RobotModel, count: int, rng: np.random.Generator) -> WorldArrays:
    """Boxes within reach of the arm, each with an owner of its own; nothing in it never leaves."""
    return world_of(robot, [(box, i) for i, box in enumerate(boxes_around(robot, count, rng))])
