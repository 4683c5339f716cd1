"""Stability against a brute-force rule read off the bars themselves, and against small built cases."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from takeapart.generate.profiles import ProfileOptions, Rejected, candidate_rng, generate_candidate
from takeapart.model.assembly import Assembly, Connector, Part, members
from takeapart.model.errors import InputError
from takeapart.model.geometry import Box, OrientedBox, pose, pose_inverse
from takeapart.stability import ConnectorStability, Stability, require_support, unsupported

OPTIONS = {"single": ProfileOptions(), "double": ProfileOptions(layers=2, back=3, front=3)}


@cache
def drawn(kind: str, count: int = 6) -> tuple[Assembly, ...]:
    candidates = (generate_candidate(OPTIONS[kind], candidate_rng(11, k), kind) for k in range(10 * count))
    found = tuple(candidate for candidate in candidates if not isinstance(candidate, Rejected))
    assert len(found) >= count
    return found[:count]


def span(part: Part) -> np.ndarray:
    """(2, 3) lower and upper corner of a bar that is parallel to the axes, m."""
    points = part.shape.bounding_box().moved(part.T_world_part).corners()
    return np.array([points.min(axis=0), points.max(axis=0)])


@cache
def rests_on(assembly: Assembly) -> dict[int, frozenset[int]]:
    """For each part the removable parts that carry it, by bars alone: where its short sides meet long sides.

    A bar in the plane is carried at all its ends; a bar along z by what lies under it.
    """
    spans = [span(part) for part in assembly.parts]
    axes = [int(np.argmax(s[1] - s[0])) for s in spans]
    carriers = {}
    for i, guest in enumerate(spans):
        found = set()
        for j, host in enumerate(spans):
            if i == j or axes[i] == axes[j] or assembly.parts[j].fixed:
                continue
            gap = np.maximum(host[0] - guest[1], guest[0] - host[1])
            across = [k for k in range(3) if k != axes[i]]
            if abs(gap[axes[i]]) > 3.1e-3 or (gap[across] > -1e-6).any():
                continue
            if axes[i] == 2 and host[0, 2] > guest[0, 2]:
                continue  # above a bar along z
            found.add(j)
        carriers[i] = frozenset(found)
    return carriers


def random_state(assembly: Assembly, rng: np.random.Generator) -> int:
    """Any subset of the removable parts, also one that could not stand."""
    share = rng.random()
    return sum(1 << i for i in members(assembly.root) if rng.random() < share)


@pytest.mark.parametrize("kind", OPTIONS)
def test_needs_are_the_bars_that_carry(kind: str) -> None:
    for assembly in drawn(kind):
        stability: Stability = ConnectorStability(assembly)
        carriers = rests_on(assembly)
        for i in range(len(assembly.parts)):
            assert set(members(stability.needs(i))) == carriers[i]


@pytest.mark.parametrize("kind", OPTIONS)
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_free_and_dependents_are_brute_force(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    assembly = drawn(kind)[int(rng.integers(6))]
    stability, carriers = ConnectorStability(assembly), rests_on(assembly)
    state = random_state(assembly, rng)
    present = set(members(state))
    expected_free = set()
    for part in members(assembly.root):
        falling = {other for other in present - {part} if part in carriers[other]}
        assert set(members(stability.dependents(part, state))) == falling
        if part in present and not falling:
            expected_free.add(part)
    assert set(members(stability.free(state))) == expected_free


@pytest.mark.parametrize("kind", OPTIONS)
def test_random_orders_by_the_predicate_end_with_everything_gone(kind: str) -> None:
    rng = np.random.default_rng(0)
    for assembly in drawn(kind):
        stability, carriers = ConnectorStability(assembly), rests_on(assembly)
        state = assembly.root
        while state:
            choices = members(stability.free(state))
            assert choices
            state &= ~(1 << choices[int(rng.integers(len(choices)))])
            present = set(members(state))
            assert all(carriers[part] <= present for part in present)


@pytest.mark.parametrize("kind", OPTIONS)
def test_known_parts_of_a_profile_assembly(kind: str) -> None:
    assembly = drawn(kind)[0]
    stability = ConnectorStability(assembly)

    def needs(name: str) -> set[str]:
        return set(assembly.names(stability.needs(assembly.index[name])))

    assert needs("column_front_left") == set()  # stands on a fixed bar; what lies on it does not carry it
    assert needs("support_0") == set()
    assert needs("frame_0_front") == {"column_front_left", "column_front_right"}
    assert needs("frame_0_back") == set()  # both columns at the back are fixed
    assert needs("top_left") == {"top_front", "top_back"}
    assert stability.dependents(assembly.index["bottom_front"], assembly.root) == 0  # fixed: never leaves
    assert not stability.free(assembly.root) >> assembly.index["top_front"] & 1
    without_carriers = assembly.root & ~assembly.state_of(("carrier_top_0", "carrier_top_1"))
    assert stability.free(without_carriers) >> assembly.index["top_left"] & 1
    assert stability.free(0) == 0


@pytest.mark.parametrize("kind", OPTIONS)
def test_part_frames_and_names_do_not_matter(kind: str) -> None:
    """The same product with every part frame turned, shape with it, and names that say nothing."""
    assembly = drawn(kind)[0]
    names = {part.name: f"p{i}" for i, part in enumerate(assembly.parts)}
    turn = {part.name: i % 3 for i, part in enumerate(assembly.parts)}
    cyclic = np.eye(4)
    cyclic[:3, :3] = Rotation.from_euler("xz", [90, 90], degrees=True).as_matrix().round()

    def turned(part: Part) -> Part:
        T = np.linalg.matrix_power(cyclic, turn[part.name])  # part frame -> new part frame
        size = np.abs(T[:3, :3]) @ np.array(part.shape.size)  # type: ignore[attr-defined]
        T_world_part = part.T_world_part @ pose_inverse(T)
        return Part(names[part.name], Box((size[0], size[1], size[2])), T_world_part, part.mass, part.fixed)

    connectors = tuple(
        Connector(
            connector.name,
            connector.kind,
            names[connector.host],
            names[connector.guest],
            tuple(wall.moved(np.linalg.matrix_power(cyclic, turn[connector.host])) for wall in connector.walls),
        )
        for connector in assembly.connectors
    )
    other = Assembly("turned", tuple(turned(part) for part in assembly.parts), connectors)
    before, after = ConnectorStability(assembly), ConnectorStability(other)
    assert [before.needs(i) for i in range(len(assembly.parts))] == [after.needs(i) for i in range(len(other.parts))]
    assert unsupported(other) == ()


@pytest.mark.parametrize("kind", OPTIONS)
def test_nothing_floats_in_a_generated_assembly(kind: str) -> None:
    for assembly in drawn(kind):
        assert unsupported(assembly) == ()
        require_support(assembly)


def bar(name: str, position: tuple[float, float, float], size: tuple[float, float, float], fixed: bool = False) -> Part:
    return Part(name, Box(size), pose(position), 0.1, fixed)


def holder(kind: str, host: Part, guest: Part, at: tuple[float, float, float]) -> Connector:
    """A connector with one thin wall about a world position, 2 cm high: it reaches its host."""
    wall = OrientedBox(pose_inverse(host.T_world_part) @ pose(at), np.array([1e-4, 1e-4, 0.0098]))
    return Connector(f"{host.name}.{guest.name}", kind, host.name, guest.name, (wall,))  # type: ignore[arg-type]


BASE = bar("base", (0, 0, 0), (0.4, 0.02, 0.02), fixed=True)
POST = bar("post", (0, 0, 0.11), (0.02, 0.02, 0.2))
LINTEL = bar("lintel", (0, 0, 0.22), (0.4, 0.02, 0.02))
FOOT = holder("O", BASE, POST, (0, 0.011, 0.02))
HEAD = holder("O", LINTEL, POST, (0, 0.011, 0.2))


def test_a_part_that_touches_nothing_floats() -> None:
    stray = bar("stray", (0, 0.3, 0.3), (0.2, 0.02, 0.02))
    assembly = Assembly("demo", (BASE, POST, stray), (FOOT,))
    assert unsupported(assembly) == ("stray",)
    with pytest.raises(
        InputError, match=r"^demo: parts: part 'stray' floats: nothing carries it; it needs a connector"
    ):
        require_support(assembly)


def test_a_bar_lies_on_a_bar_along_z_that_its_own_connector_holds() -> None:
    assert unsupported(Assembly("demo", (BASE, POST, LINTEL), (FOOT, HEAD))) == ()
    assert unsupported(Assembly("demo", (BASE, POST, LINTEL), (FOOT,))) == ("lintel",)


def test_a_bar_does_not_lie_on_a_post_that_hangs_in_its_u() -> None:
    """Only an O is a cap that sits on the post: a U is open at its top, so its host does not rest on what is in it."""
    hanging = holder("U", LINTEL, POST, (0, 0.011, 0.2))
    assert unsupported(Assembly("demo", (BASE, POST, LINTEL), (FOOT, hanging))) == ("lintel",)


def test_a_bar_that_hosts_the_foot_of_a_post_is_not_carried_by_the_post() -> None:
    loose = bar("loose", (0, 0, 0), (0.4, 0.02, 0.02))
    ground = bar("ground", (0, 0, -0.2), (0.4, 0.02, 0.02), fixed=True)
    assembly = Assembly("demo", (ground, loose, POST), (holder("O", loose, POST, (0, 0.011, 0.02)),))
    assert unsupported(assembly) == ("loose", "post")
    with pytest.raises(InputError, match=r"part 'loose' floats: nothing carries it \(and 1 more\)"):
        require_support(assembly)


def test_a_post_hanging_from_its_head_alone_floats_and_what_lies_on_it_too() -> None:
    assert unsupported(Assembly("demo", (BASE, POST, LINTEL), (HEAD,))) == ("post", "lintel")


def test_parts_that_carry_only_each_other_float() -> None:
    one, two = bar("one", (0, 0.1, 0.3), (0.2, 0.02, 0.02)), bar("two", (0, 0.2, 0.3), (0.2, 0.02, 0.02))
    pair = (holder("U", one, two, (0, 0.15, 0.3)), holder("U", two, one, (0, 0.16, 0.3)))
    assert unsupported(Assembly("demo", (BASE, one, two), pair)) == ("one", "two")


def test_a_part_needs_all_its_hosts_carried() -> None:
    stray = bar("stray", (0, 0.3, 0.1), (0.2, 0.02, 0.02))
    beam = bar("beam", (0.1, 0.15, 0.1), (0.02, 0.2, 0.02))
    held = (holder("U", POST, beam, (0, 0.03, 0.1)), holder("U", stray, beam, (0, 0.28, 0.1)))
    assert unsupported(Assembly("demo", (BASE, POST, stray, beam), (FOOT, *held))) == ("stray", "beam")


@pytest.mark.parametrize(("degrees", "upright"), [(0, True), (40, True), (50, False), (90, False), (140, True)])
def test_along_z_is_a_matter_of_the_longest_axis_in_the_world(degrees: float, upright: bool) -> None:
    """A bar along its local x; turned by `degrees` from the vertical. Along z, the host at its top is not needed."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("y", degrees - 90, degrees=True).as_matrix()
    leaning = Part("leaning", Box((0.2, 0.02, 0.02)), T, 0.1)
    low = bar("low", (0, 0.3, -0.3), (0.4, 0.02, 0.02))
    high = bar("high", (0, 0.3, 0.3), (0.4, 0.02, 0.02))
    held = (holder("O", low, leaning, (0, 0.1, -0.2)), holder("O", high, leaning, (0, 0.1, 0.2)))
    assembly = Assembly("demo", (low, high, leaning), held)
    needed = assembly.names(ConnectorStability(assembly).needs(2))
    assert needed == (["low"] if upright else ["low", "high"])


def test_a_cube_has_no_longest_axis_and_needs_all_hosts() -> None:
    cube = bar("cube", (0, 0, 0), (0.02, 0.02, 0.02))
    low, high = bar("low", (0, 0.3, -0.3), (0.4, 0.02, 0.02)), bar("high", (0, 0.3, 0.3), (0.4, 0.02, 0.02))
    held = (holder("O", low, cube, (0, 0.1, -0.2)), holder("O", high, cube, (0, 0.1, 0.2)))
    assembly = Assembly("demo", (low, high, cube), held)
    assert assembly.names(ConnectorStability(assembly).needs(2)) == ["low", "high"]
