"""Fits so tight that only the exact axis leads out, and parts that wait for each other: their answers are known."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from manifold3d import Manifold
from scipy.spatial.transform import Rotation

from takeapart.collision.axes import drawn_axes
from takeapart.model.assembly import Assembly
from takeapart.states import members
from test_exits import bayonet, block, cylinder, deepest, part, slide, ways


def turned(solid: Manifold, rotation: Rotation) -> Manifold:
    R = rotation.as_matrix()
    return solid.transform(np.column_stack([R, np.zeros(3)]))


def peg(play: float, rotation: Rotation) -> Assembly:
    """A peg of 10 mm in a blind hole, 20 mm deep; play in mm on each side."""
    plate = block((-20, -20, 0), (20, 20, 25)) - cylinder(5 + play, 30).translate((0, 0, 5))
    solids = [turned(solid, rotation) for solid in (plate, cylinder(5, 40).translate((0, 0, 5)))]
    return Assembly("peg", (part("plate", solids[0], fixed=True), part("peg", solids[1])))


TILTS = {  # degrees about x, y; the first are so near the world's axes that they might be taken for them
    "barely": (0.5, 0.3), "slightly": (1.0, -0.6), "little": (1.7, 0.4), "skew": (34.0, 21.0), "steep": (-63.0, 40.0),
}  # fmt: skip


@pytest.mark.parametrize("play", [0.05, 0.1, 0.2, 0.5])
@pytest.mark.parametrize("tilt", TILTS)
def test_a_peg_leaves_along_the_exact_axis_of_its_hole(play: float, tilt: str) -> None:
    rotation = Rotation.from_euler("xy", TILTS[tilt], degrees=True)
    assembly, axis = peg(play, rotation), rotation.apply([0, 0, 1])
    found = [way for way in ways(assembly).exits(1) if way.blockers == 0]
    assert found
    off = [np.linalg.norm(np.cross(way.direction, axis)) for way in found if way.direction is not None]
    assert (
        min(off) < 1e-5 and max(off) < (play + 0.06) / 5
    )  # what the hole leaves at its mouth, over what is left in it
    assert len(off) == len(found)
    exact = found[int(np.argmin(off))]
    assert deepest(assembly, 1, exact.poses) < 1e-3


def test_the_axis_of_a_peg_without_flat_ends_is_exact() -> None:
    """A ball at each end: no facet faces along the axis."""
    rotation = Rotation.from_euler("xy", (34.0, 21.0), degrees=True)
    round_ends = cylinder(5, 40) + Manifold.sphere(5, 48) + Manifold.sphere(5, 48).translate((0, 0, 40))
    surface = part("round", turned(round_ends, rotation)).shape.surface()
    axes = drawn_axes(surface, [])
    assert min(np.linalg.norm(np.cross(axis, rotation.apply([0, 0, 1]))) for axis in axes) < 1e-5


def test_a_ball_and_a_plate_have_no_axis_but_those_of_their_walls() -> None:
    assert drawn_axes(part("ball", Manifold.sphere(5, 40)).shape.surface(), [np.array([0.6, 0.0, 0.8])]) == ()
    axes = drawn_axes(part("plate", block((0, 0, 0), (30, 20, 4))).shape.surface(), [])
    assert sorted(np.round(np.abs(axis)).tolist() for axis in axes) == [[0, 0, 1], [0, 1, 0], [1, 0, 0]]


@pytest.mark.slow
def test_a_closed_ring_around_a_post_with_heads_stays() -> None:
    ring = (cylinder(12, 8) - cylinder(6.2, 8)).translate((0, 0, 11))
    post = cylinder(6, 30) + cylinder(9, 4).translate((0, 0, -4)) + cylinder(9, 4).translate((0, 0, 30))
    assembly = Assembly("ring", (part("post", post, fixed=True), part("ring", ring)))
    found = ways(assembly).exits(1)
    assert found and all(way.blockers is None for way in found)


def comes_apart(assembly: Assembly) -> set[tuple[int, ...]]:
    """All whole orders in which parts leave by their exits."""
    rule, parts = ways(assembly), members(assembly.root)
    ways_of = {k: [way.blockers for way in rule.exits(k) if way.blockers is not None] for k in parts}
    orders = set()
    for order in permutations(parts):
        state, free = assembly.root, True
        for k in order:
            free = free and any(not blockers & state for blockers in ways_of[k])
            state &= ~(1 << k)
        if free:
            orders.add(order)
    return orders


def hooked() -> Assembly:
    """Two combs with their teeth between each other in a box: neither goes up before the other, and the box lets them
    go sideways just as far as the teeth reach. A lid lies over both."""
    box = block((-20, -6, -6), (50, 26, 40)) - block((-14, 0, 0), (44, 20, 60))
    one = block((0, 1, 0.2), (4, 19, 30)) + block((0, 1, 0.2), (20, 19, 4)) + block((0, 1, 14), (20, 19, 18))
    other = block((26, 1, 4.5), (30, 19, 30)) + block((8, 1, 7), (30, 19, 11)) + block((8, 1, 21), (30, 19, 25))
    lid = block((-19, -5, 42), (49, 25, 46))
    parts = (part("box", box, fixed=True), part("one", one), part("other", other), part("lid", lid))
    return Assembly("hooked", parts)


def test_two_parts_that_hold_each_other_come_apart_by_pushes_once_the_lid_is_off() -> None:
    assembly = hooked()
    orders = comes_apart(assembly)
    assert orders and orders <= {(3, 1, 2), (3, 2, 1)}
    pushed, open_ = 0, Assembly("open", assembly.parts[:3])
    for k in (1, 2):
        for way in ways(assembly).exits(k):
            if way.kind == "pushes" and way.blockers is not None and not way.blockers & 0b110:
                pushed += 1
                assert np.allclose(way.poses[:, :3, :3], np.eye(3), atol=1e-9)
                assert deepest(open_, k, way.poses) < 0.2
    assert pushed


def waiting_lens() -> Assembly:
    """A lens with a bayonet in its mount, and a lid over both that keeps to the mount."""
    lens = bayonet()
    lid = block((-17, -17, 34), (17, 17, 38))
    return Assembly("lens", (*lens.parts, part("lid", lid)))


def test_a_lens_with_a_bayonet_leaves_after_its_lid_and_not_before() -> None:
    assembly = waiting_lens()
    assert comes_apart(assembly) == {(2, 1)}
    found = [way for way in ways(assembly).exits(1) if way.blockers is not None]
    assert found and all(way.kind == "pushes" and way.blockers == 0b100 for way in found)
    alone = Assembly("open", assembly.parts[:2])
    assert all(deepest(alone, 1, way.poses) < 0.2 for way in found)


def test_a_cube_in_a_channel_leaves_around_the_corner_after_what_stops_it() -> None:
    base = slide().parts
    plug = block((32, -9, 30.5), (48, 9, 52))  # in the upright arm of the channel
    assembly = Assembly("plugged", (*base, part("plug", plug)))
    assert comes_apart(assembly) == {(2, 1)}
