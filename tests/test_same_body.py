"""The same body in other words, by its frame, the order of its edges or the rounding of its numbers, has the same
grasps."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations, product

import numpy as np
import pytest

from conftest import random_rotation
from small_assemblies import three_bars
from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.model.assembly import Assembly, Connector, Part
from takeapart.model.geometry import Array, Box, OrientedBox, pose
from takeapart.model.plan import Plan
from takeapart.planning import PlanningOptions, plan
from takeapart.removal.grasps import grasp_candidates, shortest_first, straight_line_bounds, tied
from takeapart.search.result import Budget
from takeapart.verification import verify_plan
from takeapart.workcell import Workcell
from verification_scene import bar, scene_workcell

OPENING = 0.08  # m
SIZES = [
    (0.2, 0.2, 0.02),
    (0.05, 0.05, 0.05),
    (0.4, 0.04, 0.04),
    (0.2, 0.2001, 0.02),
    (0.07, 0.06, 0.05),
    (0.09, 0.2, 0.03),
]
ROTATIONS = [
    R
    for order in permutations(range(3))
    for signs in product((1, -1), repeat=3)
    if np.linalg.det(R := np.eye(3)[list(order)] * signs) > 0
]
each_size = pytest.mark.parametrize("size", SIZES)
Size = tuple[float, float, float]


def placed(size: Size, T_world_part: Array) -> Part:
    return Part("body", Box(size), T_world_part, 0.1)


def turned(size: Size, T_world_part: Array, R: Array) -> Part:
    """The same box with a frame turned by one of the 24 rotations."""
    T = T_world_part.copy()
    T[:3, :3] = T[:3, :3] @ R
    x, y, z = (np.abs(R.T) @ size).tolist()
    return placed((x, y, z), T)


def in_the_world(part: Part) -> Array:
    """Poses (K, 4, 4) of all grasps, in their order."""
    poses = [part.T_world_part @ grasp.T_part_tool for grasp in grasp_candidates(part, OPENING)]
    return np.array(poses).reshape(-1, 4, 4)


def some_poses() -> list[Array]:
    """One along the axes of the world, one turned by half a right angle and one at random."""
    found = []
    diagonal = np.array([[np.sqrt(0.5), -np.sqrt(0.5), 0], [np.sqrt(0.5), np.sqrt(0.5), 0], [0, 0, 1]])
    for R in (np.eye(3), diagonal, random_rotation(np.random.default_rng(3))):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R, [0.3, -0.123456, 0.2]
        found.append(T)
    return found


def by_hand(size: Size) -> int:
    """Number of grasps: four ways to stand per place and per side that the fingers can span."""
    count = 0
    long = [axis for axis in range(3) if size[axis] >= 0.06] or [0, 1, 2]
    for along in long:
        places = 1 + int((size[along] - 0.06 + 1e-9) / 0.02) if size[along] >= 0.06 else 1
        count += 4 * places * sum(size[side] <= OPENING for side in range(3) if side != along)
    return count


@each_size
def test_the_frame_of_a_part_changes_neither_its_grasps_nor_their_order(size: Size) -> None:
    assert len(ROTATIONS) == 24
    for T in some_poses():
        expected = in_the_world(placed(size, T))
        assert len(expected) == by_hand(size) > 0
        for R in ROTATIONS:
            np.testing.assert_allclose(in_the_world(turned(size, T, R)), expected, atol=1e-9)


@each_size
@pytest.mark.parametrize("edge", [0, 1, 2])
def test_a_tenth_of_a_micrometre_on_an_edge_moves_grasps_by_no_more(size: Size, edge: int) -> None:
    longer = np.array(size)
    longer[edge] += 1e-7
    x, y, z = longer.tolist()
    for T in some_poses():
        np.testing.assert_allclose(in_the_world(placed((x, y, z), T)), in_the_world(placed(size, T)), atol=1.01e-7)


@each_size
def test_numbers_that_went_through_32_bit_floats_give_as_many_grasps_in_the_same_order(size: Size) -> None:
    for T in some_poses():
        expected = in_the_world(placed(size, T))
        for R in ROTATIONS:
            part = turned(size, T, R)
            x, y, z = np.float32(part.shape.bounding_box().half_extents * 2).astype(float).tolist()
            rounded = placed((x, y, z), np.float32(part.T_world_part).astype(float))
            np.testing.assert_allclose(in_the_world(rounded), expected, atol=3e-7)


def test_positions_are_counted_from_the_end_with_the_smaller_world_coordinates() -> None:
    for R in ROTATIONS:
        found = in_the_world(turned((0.095, 0.02, 0.02), np.eye(4), R))
        np.testing.assert_allclose(np.unique(np.round(found[:, 0, 3], 9)), [-0.0175, 0.0025])


def test_a_plate_is_gripped_at_all_four_edges() -> None:
    """Standing upright it is reached from above and from the side, whichever edge is named first."""
    for R in ROTATIONS:
        approaches = np.unique(np.round(in_the_world(turned((0.2, 0.02, 0.2), np.eye(4), R))[:, :3, 2]), axis=0)
        assert {tuple(row) for row in approaches.tolist()} == {(1, 0, 0), (-1, 0, 0), (0, 0, 1), (0, 0, -1)}


def test_rounding_does_not_decide_between_grasps_that_tie() -> None:
    """Bars across the line to the goal have mirrored grasps, as far from it but for rounding."""
    workcell, ties = load_workcell(data_path("workcells/panda.toml")), 0
    for name in ("single/01", "single/02", "single/03"):
        for part in load_assembly(data_path(f"{name}.json")).parts:
            x, y, z = (2 * part.shape.bounding_box().half_extents).tolist()
            expected = part_grasps(part, workcell)
            bounds = straight_line_bounds(part, shortest_first(part, workcell), workcell.lift_height, workcell.goal)
            ties += bool((np.abs(np.diff(bounds)) < 1e-9).any())
            for R in ROTATIONS[1:]:
                other = turned((x, y, z), part.T_world_part, R)
                rounded = replace(other, T_world_part=in_32_bits(other.T_world_part))
                np.testing.assert_allclose(part_grasps(rounded, workcell), expected, atol=3e-7)
    assert ties > 30


def part_grasps(part: Part, workcell: Workcell) -> Array:
    poses = [part.T_world_part @ grasp.T_part_tool for grasp in shortest_first(part, workcell)]
    return np.array(poses).reshape(-1, 4, 4)


def test_lengths_that_tie_are_lowered_to_their_shortest_and_others_stay() -> None:
    lengths = np.array([0.5, 0.3 + 1e-16, 0.3, 0.3 + 4e-7, 0.3 - 4e-7, 0.7, 0.500002])
    expected = [0.5, 0.3 - 4e-7, 0.3 - 4e-7, 0.3 - 4e-7, 0.3 - 4e-7, 0.7, 0.500002]
    np.testing.assert_array_equal(tied(lengths), expected)
    assert tied(np.empty(0)).shape == (0,)


# ---- whole plans


def in_32_bits(values: Array) -> Array:
    return np.asarray(np.float32(values), dtype=float)


def in_other_words(assembly: Assembly, rng: np.random.Generator) -> Assembly:
    """The same product: frames turned, edges permuted, parts shuffled, numbers rounded to 32-bit floats."""
    turns = {part.name: ROTATIONS[rng.integers(24)] for part in assembly.parts}
    parts = []
    for number in rng.permutation(len(assembly.parts)):
        part = assembly.parts[number]
        x, y, z = (2 * part.shape.bounding_box().half_extents).tolist()
        other = turned((x, y, z), part.T_world_part, turns[part.name])
        x, y, z = in_32_bits(2 * other.shape.bounding_box().half_extents).tolist()
        parts.append(replace(part, shape=Box((x, y, z)), T_world_part=in_32_bits(other.T_world_part)))
    connectors = []
    for connector in assembly.connectors:
        T = np.eye(4)
        T[:3, :3] = turns[connector.host].T
        walls = [OrientedBox(T @ wall.T_frame_box, wall.half_extents) for wall in connector.walls]
        connectors.append(replace(connector, walls=tuple(walls)))
    return Assembly(assembly.name, tuple(parts), tuple(connectors))


def greedy_plan(assembly: Assembly) -> Plan:
    made = plan(assembly, scene_workcell(), PlanningOptions(search="greedy", budget=Budget()))
    assert isinstance(made, Plan), made
    report = verify_plan(made, assembly, scene_workcell(), physics=False)
    assert not report.findings, report.findings
    return made


def test_the_same_product_in_other_words_has_a_plan_of_the_same_length_that_the_judge_accepts() -> None:
    expected = greedy_plan(three_bars())
    made = greedy_plan(in_other_words(three_bars(), np.random.default_rng(5)))
    assert {step.part for step in made.steps} == {step.part for step in expected.steps} == {"beam", "stub", "rear"}
    assert made.total_length == pytest.approx(expected.total_length, abs=1e-4)


def test_a_square_plate_on_a_post_is_planned_alike_whichever_edge_is_named_first() -> None:
    post = bar("post", [0.15, 0.0, 0.05], [0.02, 0.02, 0.1], True)
    floor = OrientedBox(pose([0.0, 0.0, 0.051]), np.array([0.01, 0.01, 0.001]))
    seat = Connector("post-plate", "U", "post", "plate", (floor,))
    quarter = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # exchanges both long edges
    lengths = []
    for R in (np.eye(3), quarter):
        plate = replace(turned((0.02, 0.06, 0.06), pose([0.15, 0.0, 0.132]), R), name="plate")
        lengths.append(greedy_plan(Assembly("plate", (post, plate), (seat,))).total_length)
    assert lengths[0] == pytest.approx(lengths[1], abs=1e-4)
