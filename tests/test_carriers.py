"""Which hosts a part needs, by the planner's rule and by the judge's, written apart: both against cases by hand."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from takeapart.model.assembly import Assembly, Connector, Part
from takeapart.model.geometry import Array, Box, OrientedBox, pose
from takeapart.stability import ConnectorStability
from takeapart.verification.checks import carriers

Rule = Callable[[Assembly, str], set[str]]
MIDDLE = 0.5  # m, height of the guest's middle


def by_planner(assembly: Assembly, name: str) -> set[str]:
    return set(assembly.names(ConnectorStability(assembly).needs(assembly.index[name])))


def by_judge(assembly: Assembly, name: str) -> set[str]:
    return carriers(assembly, assembly.parts[assembly.index[name]])


both = pytest.mark.parametrize("rule", [by_planner, by_judge], ids=["planner", "judge"])


def held(size: tuple[float, float, float], R: Array, hosts: dict[str, list[float]]) -> Assembly:
    """A guest in connectors of some hosts, with the heights of their walls in the world, m."""
    T = pose([0.0, 0.0, MIDDLE])
    T[:3, :3] = R
    parts, connectors = [Part("guest", Box(size), T, 0.1)], []
    for k, (name, heights) in enumerate(hosts.items()):
        at = np.array([1.0 + k, 0.0, 0.1 * k])
        parts.append(Part(name, Box((0.02, 0.02, 0.02)), pose(at), 0.1))
        walls = tuple(OrientedBox(pose(np.array([0.5, 0.0, z]) - at), np.full(3, 0.001)) for z in heights)
        connectors.append(Connector(f"{name}-guest", "O", name, "guest", walls))
    return Assembly("held", tuple(parts), tuple(connectors))


def tilted(degrees: float) -> Array:
    return np.asarray(Rotation.from_euler("zx", [30.0, degrees], degrees=True).as_matrix())


HOSTS = {"under": [0.2, 0.25, 0.7], "over": [0.3, 0.8, 0.85]}  # by their means: one wall of each is on the other side


@both
@pytest.mark.parametrize("degrees", [0, 20, 43, 47, 90, 133, 137, 180, -43, -47, -137])
def test_what_stands_upright_needs_the_hosts_at_its_foot_only(rule: Rule, degrees: float) -> None:
    """Nearer to the vertical than to the plane, either way up."""
    upright = abs(np.cos(np.radians(degrees))) > np.cos(np.radians(45))
    for size, turn in (((0.02, 0.02, 0.2), np.eye(3)), ((0.2, 0.02, 0.02), tilted(0) @ np.eye(3)[[2, 1, 0]] * -1)):
        R = tilted(degrees) @ turn
        if np.linalg.det(R) < 0:
            R[:, 1] *= -1
        assert rule(held(size, R, HOSTS), "guest") == ({"under"} if upright else {"under", "over"})


@both
def test_what_has_no_longest_side_needs_all_its_hosts(rule: Rule) -> None:
    for size in ((0.2, 0.2, 0.2), (0.02, 0.2, 0.2), (0.2, 0.02, 0.2)):
        assert rule(held(size, np.eye(3), HOSTS), "guest") == {"under", "over"}
    assert rule(held((0.2, 0.2, 0.21), np.eye(3), HOSTS), "guest") == {"under"}


@both
@pytest.mark.parametrize(
    ("heights", "foot"), [([0.49], True), ([0.51], False), ([0.1, 0.8], True), ([0.3, 0.75], False)]
)
def test_where_a_connector_is_decides_the_mean_height_of_its_walls(
    rule: Rule, heights: list[float], foot: bool
) -> None:
    assert rule(held((0.02, 0.02, 0.2), np.eye(3), {"host": heights}), "guest") == ({"host"} if foot else set())


@both
def test_only_the_connectors_of_which_it_is_the_guest_carry_a_part(rule: Rule) -> None:
    assembly = held((0.2, 0.02, 0.02), np.eye(3), HOSTS)
    assert rule(assembly, "under") == rule(assembly, "over") == set()
