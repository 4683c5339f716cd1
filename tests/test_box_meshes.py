"""The shipped assemblies of boxes, drawn as meshes: what is free stays free, and plans are as long.

Meshes leave in any direction and stand by contact, where boxes in connectors are lifted and stand in these. So both are
given the same rules here: lifts, and connectors.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from takeapart.formats.files import data_path, load_assembly
from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Array, TriangleMesh
from takeapart.model.meshes import Mesh
from takeapart.motion.blockers import configuration_blockers
from takeapart.motion.scene import new_scene
from takeapart.planning import PlanningOptions, search
from takeapart.problem import AssemblyProblem
from takeapart.removal.lifting import Lifts
from takeapart.removal.margins import padding, passing
from takeapart.removal.planner import DEFAULTS, RemovalPlanner
from takeapart.robot.arrays import Flags
from takeapart.robot.model import RobotModel
from takeapart.search.result import SearchResult
from takeapart.stability import ConnectorStability
from takeapart.states import flags_of
from takeapart.workcell import Workcell

ERROR = 1e-6  # m, of the cover of a mesh that is a box
NAMES = [f"{kind}/{file.stem}" for kind in ("single", "double") for file in sorted(data_path(kind).glob("*.json"))]


def as_meshes(assembly: Assembly) -> Assembly:
    """Every box as a mesh of 48 triangles; equal boxes share one."""
    shapes: dict[tuple[float, ...], Mesh] = {}
    parts = []
    for part in assembly.parts:
        surface = part.shape.surface()
        vertices, triangles = trimesh.remesh.subdivide(surface.vertices, surface.triangles)
        mesh = Mesh(TriangleMesh(np.asarray(vertices), np.asarray(triangles, dtype=np.int32)))
        size = tuple(np.ptp(surface.vertices, axis=0).tolist())
        parts.append(replace(part, shape=shapes.setdefault(size, mesh)))
    return replace(assembly, parts=tuple(parts))


def planner_of(assembly: Assembly, boxes: Assembly, cell: Workcell, robot: RobotModel) -> RemovalPlanner:
    obstacles = tuple(obstacle.box for obstacle in cell.environment)
    kept = padding(cell.clearance, DEFAULTS.check_step)
    lifts = Lifts(boxes, cell.lift_height, kept, obstacles, passing(cell.clearance))
    return RemovalPlanner(assembly, cell, robot=robot, exits=lifts)


def searched(planner: RemovalPlanner, boxes: Assembly, by: str) -> SearchResult:
    problem = AssemblyProblem(planner, ConnectorStability(boxes), seed=0)
    return search(problem, PlanningOptions(search=by))


def length(result: SearchResult) -> float:
    return sum(removal.length for removal in result.removals)


def touched(planner: RemovalPlanner, configurations: Array, kept: float) -> Flags:
    """(K, parts + 1) what the arm comes nearer to than a distance, m, in the full product."""
    robot, parts = planner.robot, len(planner.assembly.parts)
    everything = flags_of(planner.assembly.root, parts)
    scene = new_scene(robot.arm, robot.held(0.0), planner.world, everything, kept, 0.01, planner.workspace())
    hits = np.zeros((len(configurations), parts + 1), np.uint8)
    configuration_blockers(scene, configurations, hits)
    return hits


@pytest.mark.parametrize("name", ["single/05", "double/03"])
def test_what_is_free_among_boxes_is_free_among_their_meshes(name: str, robot: RobotModel, workcell: Workcell) -> None:
    boxes = load_assembly(data_path(f"{name}.json"))
    of_boxes = planner_of(boxes, boxes, workcell, robot)
    of_meshes = planner_of(as_meshes(boxes), boxes, workcell, robot)
    drawn = np.random.default_rng(2).uniform(robot.arm.lower, robot.arm.upper, (20_000, robot.joints))
    theirs, near = touched(of_meshes, drawn, 0.001), touched(of_boxes, drawn, 0.001 + ERROR)
    assert not (theirs & ~near).any(), "free for boxes by more than the error, and not for meshes"
    assert not (touched(of_boxes, drawn, 0.001 - ERROR) & ~theirs).any(), "hit by boxes, and free for meshes"
    assert near[:, :-1].any(axis=0).sum() > 10 and not near.all(axis=0).any()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "by"), [*((name, "greedy") for name in NAMES), ("single/05", "exact")])
def test_plans_of_boxes_and_of_their_meshes_are_as_long(
    name: str, by: str, robot: RobotModel, workcell: Workcell
) -> None:
    """The planner's random numbers are the same, and so is all that it is asked."""
    boxes = load_assembly(data_path(f"{name}.json"))
    first, second = (
        searched(planner_of(assembly, boxes, workcell, robot), boxes, by) for assembly in (boxes, as_meshes(boxes))
    )
    print(f"{name}: {length(first):.4f} m with boxes, {length(second):.4f} m with meshes")
    assert len(first.removals) == len(second.removals) == boxes.root.bit_count()
    assert length(second) == pytest.approx(length(first), rel=1e-3)
