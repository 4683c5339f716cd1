"""Assemblies: states, bodies, and every error with its message."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from takeapart.model.assembly import MAXIMUM_PARTS, OVERLAP_TOLERANCE, Assembly, Connector, Part, members
from takeapart.model.errors import InputError, UnknownNameError
from takeapart.model.geometry import Box, OrientedBox, pose

SIZE = (0.1, 0.02, 0.02)


def part(name: str, x: float = 0.0, y: float = 0.0, z: float = 0.0, **changes: object) -> Part:
    return replace(Part(name, Box(SIZE), pose((x, y, z)), 0.05), **changes)  # type: ignore[arg-type]


def wall(x: float = 0.0, y: float = 0.0, z: float = 0.02, half: float = 0.001) -> OrientedBox:
    return OrientedBox(pose((x, y, z)), np.full(3, half))


def connector(**changes: object) -> Connector:
    return replace(Connector("holder", "U", "a", "b", (wall(),)), **changes)  # type: ignore[arg-type]


def assembly(*parts: Part, **changes: object) -> Assembly:
    return Assembly("demo", parts or (part("a", fixed=True), part("b", y=0.1), part("c", y=0.2)), **changes)  # type: ignore[arg-type]


def rotated(matrix: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = matrix
    return T


def test_states_number_the_removable_parts() -> None:
    demo = assembly()
    assert demo.index == {"a": 0, "b": 1, "c": 2}
    assert demo.root == 0b110
    assert demo.names(0b110) == ["b", "c"]
    assert demo.state_of(["c", "a"]) == 0b101
    assert demo.state_of(()) == 0


@given(st.sets(st.integers(0, 200)))
def test_members_are_the_bits(numbers: set[int]) -> None:
    assert members(sum(1 << i for i in numbers)) == sorted(numbers)


def test_body_is_the_shape_and_the_walls_that_the_part_hosts() -> None:
    walls = (wall(0.01), wall(0.02))
    demo = assembly(connectors=(connector(walls=walls), connector(name="other", host="c", walls=(wall(0.03),))))
    assert [box.T_frame_box[0, 3] for box in demo.body(0)] == [0.0, 0.01, 0.02]
    assert [box.T_frame_box[0, 3] for box in demo.body(1)] == [0.0]
    assert [box.T_frame_box[0, 3] for box in demo.body(2)] == [0.0, 0.03]


def test_unknown_name_in_a_state_lists_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match="demo: unknown part 'd'; valid: a, b, c"):
        assembly().state_of(["d"])


@pytest.mark.parametrize("name", ["", "ä", "a b", "-a", "../a", "a/b", "a\n", "x" * 65])
def test_bad_names(name: str) -> None:
    with pytest.raises(InputError, match=r"demo: parts\[1\]\.name: bad name .* use 1 to 64 letters, digits"):
        assembly(part("a"), part(name, y=0.1))
    with pytest.raises(InputError, match=r"demo: connectors\[0\]\.name: bad name"):
        assembly(connectors=(connector(name=name),))


@pytest.mark.parametrize("name", ["a", "9", "Left.bar_2-x", "x" * 64])
def test_good_names(name: str) -> None:
    assert assembly(part(name)).index == {name: 0}


def test_duplicate_names() -> None:
    with pytest.raises(InputError, match=r"demo: parts\[2\]\.name: name 'a' is used before, by parts\[0\]"):
        assembly(part("a"), part("b", y=0.1), part("a", y=0.2))
    with pytest.raises(InputError, match=r"demo: connectors\[1\]\.name: name 'holder' is used before"):
        assembly(connectors=(connector(), connector()))


def test_number_of_parts() -> None:
    with pytest.raises(InputError, match="demo: parts: the assembly has no parts; at least one is needed"):
        Assembly("demo", ())
    many = tuple(part(f"p{i}", y=0.03 * i) for i in range(MAXIMUM_PARTS + 1))
    with pytest.raises(InputError, match="1001 parts; at most 1000 are allowed"):
        Assembly("demo", many)
    with pytest.raises(InputError, match="demo: parts: every part is fixed; at least one must be removable"):
        assembly(part("a", fixed=True))


@pytest.mark.parametrize("mass", [0.0, -1.0, float("nan"), float("inf")])
def test_bad_mass(mass: float) -> None:
    with pytest.raises(InputError, match=r"demo: parts\[0\] \(a\)\.mass: mass .* kg; it must be a positive number"):
        assembly(part("a", mass=mass))


@pytest.mark.parametrize(
    "size", [(0.0, 1, 1), (9.9e-5, 1, 1), (-1.0, 1, 1), (1, float("nan"), 1), (1, 1, float("inf")), (101, 1, 1)]
)
def test_bad_size(size: tuple[float, float, float]) -> None:
    with pytest.raises(InputError, match=r"demo: parts\[0\] \(a\)\.shape: size .* 0\.0001 to 100 m"):
        assembly(part("a", shape=Box(size)))


@pytest.mark.parametrize(
    ("T", "message"),
    [
        (np.eye(3), r"the pose must be a finite \(4, 4\) matrix"),
        (pose((np.nan, 0, 0)), r"the pose must be a finite \(4, 4\) matrix"),
        (pose((np.inf, 0, 0)), r"the pose must be a finite \(4, 4\) matrix"),
        (rotated(np.diag([1, 1, -1])), "the rotation is not proper; use a unit quaternion"),
        (rotated(1.1 * np.eye(3)), "the rotation is not proper; use a unit quaternion"),
        (rotated(np.eye(3) + 0.01 * np.eye(3, k=1)), "the rotation is not proper; use a unit quaternion"),
        (pose((0, 0, -101.0)), r"position \[0.0, 0.0, -101.0\] m is beyond 100 m; are the units metres\?"),
    ],
)
def test_bad_pose(T: np.ndarray, message: str) -> None:
    with pytest.raises(InputError, match=r"demo: parts\[0\] \(a\)\.pose: " + message):
        assembly(part("a", T_world_part=T))
    with pytest.raises(InputError, match=r"demo: connectors\[0\] \(holder\)\.walls\[0\]: " + message):
        assembly(connectors=(connector(walls=(OrientedBox(T, np.full(3, 0.001)),)),))


def test_bad_wall_size() -> None:
    with pytest.raises(InputError, match=r"demo: connectors\[0\] \(holder\)\.walls\[1\]: size .* 0\.0001 to 100 m"):
        assembly(connectors=(connector(walls=(wall(), wall(half=0.0))),))


def test_bad_connectors() -> None:
    with pytest.raises(UnknownNameError, match=r"demo: connectors\[0\] \(holder\)\.kind: unknown .* 'V'; valid: O, U"):
        assembly(connectors=(connector(kind="V"),))
    with pytest.raises(InputError, match=r"demo: connectors\[0\] \(holder\)\.host: there is no part 'z'"):
        assembly(connectors=(connector(host="z"),))
    with pytest.raises(InputError, match=r"demo: connectors\[0\] \(holder\)\.guest: there is no part 'z'"):
        assembly(connectors=(connector(guest="z"),))
    with pytest.raises(InputError, match="host and guest are the same part 'a'"):
        assembly(connectors=(connector(guest="a"),))
    with pytest.raises(InputError, match=r"demo: connectors\[0\] \(holder\)\.walls: a connector needs at least one"):
        assembly(connectors=(connector(walls=()),))


@pytest.mark.parametrize("witness", [("b",), ("b", "b"), ("b", "c", "a"), ("b", "z")])
def test_bad_witness(witness: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match="demo: witness: must name every removable part exactly once"):
        assembly(witness=witness)


def test_good_witness() -> None:
    assert assembly(witness=("c", "b")).witness == ("c", "b")


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("turned", [False, True])
def test_overlap_is_refused_beyond_the_tolerance_only(axis: int, turned: bool) -> None:
    frame = np.eye(4)
    frame[:3, :3] = Rotation.from_euler("xyz", [0.3, -0.7, 1.1]).as_matrix() if turned else np.eye(3)

    def pair(overlap: float) -> Assembly:
        shift = np.eye(4)
        shift[axis, 3] = SIZE[axis] - overlap
        return assembly(part("a", T_world_part=frame), part("b", T_world_part=frame @ shift))

    for allowed in (-0.001, 0.0, 0.9 * OVERLAP_TOLERANCE):
        assert len(pair(allowed).parts) == 2
    with pytest.raises(InputError, match=r"demo: parts: parts 'a' and 'b' overlap by 0\.15 mm; at most 0\.1 mm"):
        pair(0.00015)


def test_turned_boxes_whose_bounds_overlap_are_fine() -> None:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("z", 45, degrees=True).as_matrix()
    beside = T.copy()
    beside[:3, 3] = T[:3, 1] * 0.021
    assert len(assembly(part("a", T_world_part=T), part("b", T_world_part=beside)).parts) == 2


def test_walls_overlap_other_parts_but_not_their_host_nor_walls_of_the_same_host() -> None:
    inside_host, inside_c = wall(z=0.0), wall(y=0.2, z=0.0)
    assert assembly(connectors=(connector(walls=(inside_host, inside_host)),)).connectors
    with pytest.raises(InputError, match="parts 'a' and 'c' overlap by"):
        assembly(connectors=(connector(walls=(inside_c,)),))
    # the same point, once as a wall of part a and once as one of part b, 0.1 m along y
    with pytest.raises(InputError, match="parts 'a' and 'b' overlap by"):
        assembly(connectors=(connector(), connector(name="other", host="b", guest="c", walls=(wall(y=-0.1),))))
