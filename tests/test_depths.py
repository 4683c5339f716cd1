"""How deep two parts overlap as drawn: the same number from import and from planning, the one that is worked out by
hand."""

from __future__ import annotations

import numpy as np
import pytest

from takeapart.collision.contact import Contacts
from takeapart.formats.importing.pairs import DrawnPairs
from takeapart.model.assembly import Assembly, Part
from takeapart.model.deepest import CLOSE_ENOUGH, greatest_depth
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, Box, TriangleMesh, pose
from takeapart.model.meshes import Mesh


def block(name: str, size: tuple[float, float, float], T: Array, fixed: bool = False) -> Part:
    return Part(name, Mesh(Box(size).surface()), T, 0.1, fixed)


def measured(assembly: Assembly) -> tuple[float, float]:
    """By planning's measure for words, and by that of import, m."""
    contacts = Contacts(assembly)
    (found,) = contacts.findings
    (pair,) = DrawnPairs(assembly.parts).near()
    return contacts.depth(found), pair.depth


@pytest.mark.parametrize("turn", [0.0, 0.3])
def test_a_plate_that_a_wide_peg_goes_through_is_half_the_peg_deep(turn: float) -> None:
    """A peg of 31 by 37 mm through a plate of 6.5 mm: the plate's faces lie in it, 15.5 mm deep along its middle, where
    neither of the two has a corner."""
    plate = block("plate", (0.08, 0.08, 0.0065), pose(), True)
    peg = block("peg", (0.031, 0.037, 0.05), pose([0.0, 0.0, 0.0], [np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2)]))
    assert measured(Assembly("through", (plate, peg))) == pytest.approx((0.0155, 0.0155), abs=5e-6)


def test_a_thin_blade_is_half_the_plate_deep() -> None:
    """A blade of 3 mm through a plate of 6.5 mm: the plate's faces lie at most 1.5 mm deep in it, but the blade's sides
    3.25 mm in the plate, in its middle; neither of the two has a corner there."""
    plate = block("plate", (0.08, 0.08, 0.0065), pose(), True)
    blade = block("blade", (0.003, 0.037, 0.05), pose())
    assert measured(Assembly("through", (plate, blade))) == pytest.approx((0.00325, 0.00325), abs=5e-6)


def test_the_edge_of_a_roof_lies_as_deep_as_it_is_drawn() -> None:
    """A square bar on its edge, which lies 1.234 mm below the top of a block."""
    middle = 0.02 * np.sqrt(0.5) - 0.001234  # of the bar, above the block's top
    base = block("base", (0.1, 0.1, 0.02), pose([0.0003, 0.0007, -0.01]), True)
    bar = block("bar", (0.02, 0.02, 0.02), pose([0.0, 0.0, middle], [np.cos(np.pi / 8), 0.0, np.sin(np.pi / 8), 0.0]))
    assert measured(Assembly("roof", (base, bar))) == pytest.approx((0.001234, 0.001234), abs=5e-6)


def test_the_deepest_place_of_a_triangle_below_a_plane() -> None:
    """Below z = 0 between two walls at x = 0 and x = 0.01: depth is the distance to the nearest of the three."""
    corners = np.array([[[0.0, 0.0, -0.1], [0.01, 0.0, -0.1], [0.003, 0.02, 0.0]]])
    calls = []

    def depths(points: Array, least: Array) -> Array:
        calls.append(len(points))
        return np.min([-points[:, 2], points[:, 0], 0.01 - points[:, 0]], axis=0)

    assert greatest_depth(corners, depths) == pytest.approx(0.005, abs=2 * CLOSE_ENOUGH)
    assert len(calls) > 3 and max(calls) <= 16_000


def test_nothing_outside_is_deep() -> None:
    surface = TriangleMesh(np.array([[0.0, 0, 1], [1, 0, 1], [0, 1, 1]]), np.array([[0, 1, 2]]))
    assert greatest_depth(surface.corners, lambda points, least: -points[:, 2]) == 0.0


def test_the_refusal_names_what_to_type() -> None:
    plate = block("plate", (0.08, 0.08, 0.0065), pose([0.0, 0.0, 0.0]), True)
    peg = block("peg", (0.031, 0.037, 0.05), pose([0.0, 0.0, 0.0]))
    with pytest.raises(InputError) as refused:
        Contacts(Assembly("through", (plate, peg))).require()
    assert str(refused.value) == (
        "through: parts: parts 'plate' and 'peg' overlap by 15.50 mm as drawn; at most 0.5 mm is valid, unless it "
        "is meant: import the product with --allow-overlap plate,peg (allowed_overlaps in the file)"
    )
