"""The straight-line bound, the planner's and the judge's: no grasp where a part may be gripped has a shorter way, and
the best has exactly this one."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from scipy.spatial import ConvexHull

from conftest import random_rotation
from takeapart.formats.bound_texts import SEQUENCE, STRAIGHT_LINE
from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.model.assembly import Assembly, Part
from takeapart.model.geometry import Array, Box, OrientedBox, TriangleMesh, pose
from takeapart.model.meshes import Mesh
from takeapart.model.plan import Plan
from takeapart.removal.grasps import grasp_candidates, straight_line_bounds, volume_bound
from takeapart.verification.checks import straight_line_bound
from takeapart.verification.report import NOT_CHECKED
from takeapart.workcell import Workcell
from verification_scene import scene_workcell


def random_shape(rng: np.random.Generator) -> Box | Mesh:
    """A box, or the hull of some points, which fills no box."""
    size = rng.uniform(0.005, 0.15, 3)
    if rng.random() < 0.5:
        return Box((float(size[0]), float(size[1]), float(size[2])))
    corners = rng.uniform(-0.5, 0.5, (6, 3)) * size
    triangles = ConvexHull(corners).simplices.astype(np.int32)
    out = np.cross(*np.moveaxis(corners[triangles[:, 1:]] - corners[triangles[:, :1]], 1, 0))
    inward = np.einsum("ni,ni->n", out, corners[triangles[:, 0]] - corners.mean(axis=0)) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return Mesh(TriangleMesh(corners, triangles))


def random_case(rng: np.random.Generator) -> tuple[Part, Workcell]:
    """A part, and a goal: near, far, or in the part itself as it is lifted."""
    T = pose(rng.uniform(-0.5, 0.5, 3))
    T[:3, :3] = random_rotation(rng)
    part = Part("part", random_shape(rng), T, 1.0)
    lift = float(rng.uniform(0.01, 0.2))
    goal = rng.uniform(-1.0, 1.0, 3)
    if rng.random() < 0.2:
        goal = points_inside(part, 1, rng)[0] + [0.0, 0.0, lift]
    return part, replace(scene_workcell(), lift_height=lift, goal=goal)


def lift_of(part: Part, workcell: Workcell) -> float:
    """By which its removal starts, m: a product with meshes leaves in any direction."""
    return workcell.lift_height if isinstance(part.shape, Box) else 0.0


def reachable(part: Part) -> OrientedBox:
    """Where the tool's point may be at the grasp, in the world: in a box, or so far around what is none."""
    box = part.shape.bounding_box()
    beyond = 0.0 if isinstance(part.shape, Box) else 0.012
    return OrientedBox(box.T_frame_box, box.half_extents + beyond).moved(part.T_world_part)


def judged(part: Part, workcell: Workcell) -> float:
    return straight_line_bound(Assembly("one", (part,)), workcell)


def points_inside(part: Part, count: int, rng: np.random.Generator) -> Array:
    """(count, 3) in the world, where it may be gripped; half of them on the surface."""
    box, found = reachable(part), []
    for _ in range(count):
        local = rng.uniform(-1.0, 1.0, 3)
        if rng.random() < 0.5:
            axes = rng.random(3) < 0.5
            local[axes] = np.sign(local[axes])
        found.append((box.T_frame_box @ np.append(local * box.half_extents, 1.0))[:3])
    return np.array(found)


def shortest_way(part: Part, workcell: Workcell) -> float:
    """By bounded least squares over the points where it may be gripped."""
    box, lift = reachable(part), lift_of(part, workcell)
    spans = box.T_frame_box[:3, :3] * box.half_extents
    left = workcell.goal - box.T_frame_box[:3, 3] - [0.0, 0.0, lift]
    point = lsq_linear(spans, left, bounds=(-1.0, 1.0), tol=1e-14).x
    return lift + float(np.linalg.norm(spans @ point - left))


def test_no_path_from_a_grasp_inside_the_part_is_shorter() -> None:
    rng = np.random.default_rng(0)
    for _ in range(100):
        part, cell = random_case(rng)
        lift = lift_of(part, cell)
        bound = volume_bound(part, lift, cell.goal)
        assert judged(part, cell) == pytest.approx(bound, abs=1e-12)
        for grasp in points_inside(part, 50, rng):
            lifted = grasp + [0.0, 0.0, lift]
            between = rng.uniform(-1.0, 1.0, (int(rng.integers(0, 3)), 3))
            length = sum(math.dist(a, b) for a, b in pairwise([grasp, lifted, *between, cell.goal]))
            assert length >= bound - 1e-12


def test_the_best_grasp_inside_the_part_has_exactly_this_way() -> None:
    rng = np.random.default_rng(1)
    for _ in range(100):
        part, cell = random_case(rng)
        expected = shortest_way(part, cell)
        assert volume_bound(part, lift_of(part, cell), cell.goal) == pytest.approx(expected, abs=1e-6)
        assert judged(part, cell) == pytest.approx(expected, abs=1e-6)


def test_documents_say_of_the_bounds_what_the_program_says() -> None:
    root = Path(__file__).resolve().parents[1]
    for name in ("concepts", "tutorial", "file-formats", "search"):
        text = " ".join((root / "docs" / f"{name}.md").read_text().split())
        assert STRAIGHT_LINE in text and SEQUENCE in text, name
    assert STRAIGHT_LINE in " ".join((root / "README.md").read_text().split())
    said = " ".join((Plan.__doc__ or "").split())
    assert STRAIGHT_LINE in said and SEQUENCE in said
    assert any(SEQUENCE in each for each in NOT_CHECKED)


@pytest.mark.parametrize(("kind", "mean"), [("single", 12.348), ("double", 17.520)])
def test_shipped_assemblies_grasps_between_the_candidates_reach_it(kind: str, mean: float) -> None:
    """The mean over the files, m; and the way of the best candidate, which grasps between candidates undercut."""
    cell, totals = load_workcell("panda"), []
    for file in sorted(data_path(kind).glob("*.json")):
        assembly = load_assembly(file)
        parts = [part for part in assembly.parts if not part.fixed]
        bounds = [volume_bound(part, cell.lift_height, cell.goal) for part in parts]
        of_candidates = [
            straight_line_bounds(
                part, grasp_candidates(part, cell.description.maximum_opening), cell.lift_height, cell.goal
            ).min()
            for part in parts
        ]
        totals.append(math.fsum(bounds))
        assert straight_line_bound(assembly, cell) == pytest.approx(totals[-1], abs=1e-9)
        assert all(low <= best + 1e-12 for low, best in zip(bounds, of_candidates, strict=True))
        assert totals[-1] < 0.975 * sum(of_candidates)
    assert np.mean(totals) == pytest.approx(mean, abs=5e-4)
