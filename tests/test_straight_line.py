"""The straight-line bound, the planner's and the judge's: no grasp inside a part has a shorter way, and the best has
exactly this one."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from conftest import random_box, random_rotation
from takeapart.formats.bound_texts import SEQUENCE, STRAIGHT_LINE
from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.model.assembly import Assembly, Part
from takeapart.model.geometry import BOX_TRIANGLES, Array, OrientedBox, TriangleMesh, pose
from takeapart.model.plan import Plan
from takeapart.removal.grasps import grasp_candidates, straight_line_bounds, volume_bound
from takeapart.verification.checks import straight_line_bound
from takeapart.verification.report import NOT_CHECKED
from takeapart.workcell import Workcell
from verification_scene import scene_workcell


@dataclass(frozen=True, eq=False)
class Pieces:
    """A shape of several boxes, turned against each other."""

    pieces: tuple[OrientedBox, ...]

    def boxes(self) -> tuple[OrientedBox, ...]:
        return self.pieces

    def bounding_box(self) -> OrientedBox:
        corners = np.vstack([box.corners() for box in self.pieces])
        low, high = corners.min(axis=0), corners.max(axis=0)
        return OrientedBox(pose((low + high) / 2), (high - low) / 2)

    def surface(self) -> TriangleMesh:
        surfaces = [TriangleMesh(box.corners(), BOX_TRIANGLES + np.int32(8 * i)) for i, box in enumerate(self.pieces)]
        return TriangleMesh(
            np.vstack([each.vertices for each in surfaces]), np.vstack([each.triangles for each in surfaces])
        )

    def center_of_mass(self) -> Array:
        weights = np.array([np.prod(box.half_extents) for box in self.pieces])
        return np.asarray(weights @ [box.T_frame_box[:3, 3] for box in self.pieces] / weights.sum())

    def volume(self) -> float:
        return float(sum(8 * np.prod(box.half_extents) for box in self.pieces))


def random_case(rng: np.random.Generator) -> tuple[Part, Workcell]:
    """A part of one to three boxes, and a goal: near, far, or in the lifted part itself."""
    T = pose(rng.uniform(-0.5, 0.5, 3))
    T[:3, :3] = random_rotation(rng)
    corner = np.full(3, 0.2)
    boxes = [random_box(rng, -corner, corner, 0.005, 0.15) for _ in range(int(rng.integers(1, 4)))]
    part = Part("part", Pieces(tuple(boxes)), T, 1.0)
    lift = float(rng.uniform(0.01, 0.2))
    goal = rng.uniform(-1.0, 1.0, 3)
    if rng.random() < 0.2:
        goal = points_inside(part, 1, rng)[0] + [0.0, 0.0, lift]
    return part, replace(scene_workcell(), lift_height=lift, goal=goal)


def judged(part: Part, workcell: Workcell) -> float:
    return straight_line_bound(Assembly("one", (part,)), workcell)


def points_inside(part: Part, count: int, rng: np.random.Generator) -> Array:
    """(count, 3) in the world; half of them on the surface of a box."""
    boxes = part.shape.boxes()
    found = []
    for _ in range(count):
        box = boxes[int(rng.integers(len(boxes)))]
        local = rng.uniform(-1.0, 1.0, 3)
        if rng.random() < 0.5:
            axes = rng.random(3) < 0.5
            local[axes] = np.sign(local[axes])
        inside = box.T_frame_box @ np.append(local * box.half_extents, 1.0)
        found.append((part.T_world_part @ inside)[:3])
    return np.array(found)


def shortest_way(part: Part, workcell: Workcell) -> float:
    """By bounded least squares over the points of every box."""
    lengths = []
    for box in part.shape.boxes():
        T = part.T_world_part @ box.T_frame_box
        spans = T[:3, :3] * box.half_extents
        left = workcell.goal - T[:3, 3] - [0.0, 0.0, workcell.lift_height]
        point = lsq_linear(spans, left, bounds=(-1.0, 1.0), tol=1e-14).x
        lengths.append(workcell.lift_height + float(np.linalg.norm(spans @ point - left)))
    return min(lengths)


def test_no_path_from_a_grasp_inside_the_part_is_shorter() -> None:
    rng = np.random.default_rng(0)
    for _ in range(100):
        part, cell = random_case(rng)
        bound = volume_bound(part, cell.lift_height, cell.goal)
        assert judged(part, cell) == pytest.approx(bound, abs=1e-12)
        for grasp in points_inside(part, 50, rng):
            lifted = grasp + [0.0, 0.0, cell.lift_height]
            between = rng.uniform(-1.0, 1.0, (int(rng.integers(0, 3)), 3))
            length = sum(math.dist(a, b) for a, b in pairwise([grasp, lifted, *between, cell.goal]))
            assert length >= bound - 1e-12


def test_the_best_grasp_inside_the_part_has_exactly_this_way() -> None:
    rng = np.random.default_rng(1)
    for _ in range(100):
        part, cell = random_case(rng)
        expected = shortest_way(part, cell)
        assert volume_bound(part, cell.lift_height, cell.goal) == pytest.approx(expected, abs=1e-6)
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
