"""Bars and connectors of a profile assembly while it is being drawn: where they lie, and whether one more fits.

Everything here is parallel to the axes of the assembly frame (corner at the origin, x to the back, y to the left, z
up; m), so a body is a pair of corners. That is a matter of the generator alone: what leaves it is an `Assembly`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from takeapart.model.assembly import Assembly, Connector, ConnectorKind, Part
from takeapart.model.geometry import Array, Box, OrientedBox, pose

BAR = 0.02  # m, edge of the square cross-section (Sec. IV)
END_GAP = 0.003  # m, left free between the end of a bar in the plane and its host: play for lifting it out
WALL_GAP = 0.0005  # m, left free between a connector's walls and the host's face
SLACK = 0.0005  # m, between a guest and the walls beside it
WALL = 0.002  # m, thickness of a connector's walls
WALL_LENGTH = 0.02  # m, from the host's face to the end of a wall, along the guest
MASS_PER_METRE = 0.48  # kg/m of a 20 mm x 20 mm aluminium profile
ROUNDING = 1e-9  # m; below it two coordinates are the same

Point = tuple[float, float, float]
Extent = tuple[Point, Point]  # lower and upper corner of a box, m


@dataclass(frozen=True)
class Bar:
    """A profile along axis 0 (x), 1 (y) or 2 (z), between two corners, m."""

    name: str
    axis: int
    lower: Point
    upper: Point
    fixed: bool = False

    @cached_property
    def centre(self) -> Point:
        """Middle of the bar, m."""
        x, y, z = ((a + b) / 2 for a, b in zip(self.lower, self.upper, strict=True))
        return x, y, z

    @property
    def length(self) -> float:
        """Along its axis, m."""
        return self.upper[self.axis] - self.lower[self.axis]


@dataclass(frozen=True)
class Joint:
    """The connector that will hold the end of `guest` on `host`."""

    kind: ConnectorKind
    host: str
    guest: str
    walls: tuple[Extent, ...]


@dataclass(frozen=True)
class Segment:
    """A free stretch of a line between two hosts, and the names of the hosts at its lower and upper end."""

    lower: float  # m, face of the host
    upper: float  # m
    hosts: tuple[str, str]


@dataclass(frozen=True, eq=False)
class Layout:
    """The bars and joints placed so far; `placed` returns a new layout.

    Args:
        bars: by name, in the order of placing.
        joints: in the order of placing.
        extents: (N, 2, 3) m, lower and upper corners of all bars and walls.
        owners: for each of the N, the name of the bar that it moves with, and whether it is that bar itself.
    """

    bars: dict[str, Bar] = field(default_factory=dict)
    joints: tuple[Joint, ...] = ()
    extents: Array = field(default_factory=lambda: np.empty((0, 2, 3)))
    owners: tuple[tuple[str, bool], ...] = ()

    def placed(self, bar: Bar, joints: tuple[Joint, ...]) -> Layout:
        """This layout and one more bar with the joints that hold it."""
        walls = [(joint.host, wall) for joint in joints for wall in joint.walls]
        return Layout(
            self.bars | {bar.name: bar},
            self.joints + joints,
            np.concatenate([self.extents, np.array([(bar.lower, bar.upper), *(wall for _, wall in walls)])]),
            (*self.owners, (bar.name, True), *((host, False) for host, _ in walls)),
        )

    def spaced(self, axis: int, across: float, height: float, spacing: float) -> bool:
        """Whether a line along x or y keeps its distance from all bars of the same direction at its height.

        Lines are compared, not bars: the distance is the one across the direction, between centre lines (Sec. IV-A b).
        """
        return all(
            abs(bar.centre[1 - axis] - across) >= spacing
            for bar in self.bars.values()
            if bar.axis == axis and bar.lower[2] < height < bar.upper[2]
        )

    def segments(self, axis: int, across: float, height: float) -> list[Segment]:
        """Free stretches of a line along x (0) or y (1) between the bars that would intersect a bar on it.

        Args:
            across: coordinate of the line on the other axis of the plane, m.
            height: z of the line, m.
        """
        cuts = sorted(
            (bar.lower[axis], bar.upper[axis], bar.name)
            for bar in self.bars.values()
            if bar.lower[2] < height < bar.upper[2]
            and bar.lower[1 - axis] < across + BAR / 2 - ROUNDING
            and bar.upper[1 - axis] > across - BAR / 2 + ROUNDING
        )
        found = []
        reach, last = cuts[0][1:]  # how far the bars so far cover the line, and the bar that ends there
        for lower, upper, name in cuts[1:]:
            if lower > reach:
                found.append(Segment(reach, lower, (last, name)))
            if upper > reach:
                reach, last = upper, name
        return found

    def meets(self, bar: Bar, joints: tuple[Joint, ...]) -> bool:
        """Whether each end of a bar lies wholly on the side of its host."""
        others = [k for k in range(3) if k != bar.axis]
        hosts = [self.bars[joint.host] for joint in joints]
        return all(
            host.lower[k] <= bar.lower[k] + ROUNDING and bar.upper[k] <= host.upper[k] + ROUNDING
            for host in hosts
            for k in others
        )

    def clear(self, bar: Bar, joints: tuple[Joint, ...], clearance: float) -> bool:
        """Whether a bar and the walls of its joints stay away from all other bodies, along at least one axis.

        Inside one level that axis is x or y, so bars pass each other while they are lifted. A bar may be as close to
        its hosts as the joints say, but not to what else the hosts carry.
        """
        hosts = {joint.host for joint in joints}
        walls = [(joint.host, wall) for joint in joints for wall in joint.walls]
        new = np.array([(bar.lower, bar.upper), *(wall for _, wall in walls)])[:, None]  # (M, 1, 2, 3)
        near = (self.extents[:, 0] < new[:, :, 1] + clearance - ROUNDING) & (
            self.extents[:, 1] > new[:, :, 0] - clearance + ROUNDING
        )
        for k, i in zip(*np.nonzero(near.all(axis=2)), strict=True):
            owner, is_bar = self.owners[i]
            if not ((is_bar and owner in hosts) if k == 0 else owner == walls[k - 1][0]):
                return False
        return True

    def assembly(self, name: str) -> Assembly:
        """The assembly of these bars; each part's frame sits in the middle of its bar, parallel to the world."""
        parts = tuple(
            Part(bar.name, Box(_size(bar)), pose(bar.centre), MASS_PER_METRE * bar.length, bar.fixed)
            for bar in self.bars.values()
        )
        connectors = tuple(
            Connector(
                f"{joint.host}.{joint.guest}",
                joint.kind,
                joint.host,
                joint.guest,
                tuple(_wall_in_frame(wall, self.bars[joint.host].centre) for wall in joint.walls),
            )
            for joint in self.joints
        )
        return Assembly(name, parts, connectors)


def level_bar(name: str, axis: int, across: float, height: float, segment: Segment, fixed: bool = False) -> Bar:
    """The bar in the plane that fills a segment of the line along `axis`, up to the gaps at its ends."""
    lower, upper = segment.lower + END_GAP, segment.upper - END_GAP
    half = BAR / 2
    if axis == 0:
        return Bar(name, 0, (lower, across - half, height - half), (upper, across + half, height + half), fixed)
    return Bar(name, 1, (across - half, lower, height - half), (across + half, upper, height + half), fixed)


def upright_bar(name: str, x: float, y: float, lower: float, upper: float, fixed: bool = False) -> Bar:
    """The bar along z that stands on a face at height `lower` and ends at one at height `upper`."""
    half = BAR / 2
    return Bar(name, 2, (x - half, y - half, lower), (x + half, y + half, upper), fixed)


def joints_of(bar: Bar, hosts: tuple[str, str]) -> tuple[Joint, Joint]:
    """The connectors at the lower and upper end of a bar: U for a bar in the plane, O for one along z (Sec. IV)."""
    gap = 0.0 if bar.axis == 2 else END_GAP
    return (
        _joint(bar, hosts[0], bar.lower[bar.axis] - gap, 1),
        _joint(bar, hosts[1], bar.upper[bar.axis] + gap, -1),
    )


def _joint(bar: Bar, host: str, face: float, inwards: int) -> Joint:
    """The connector on a host's face at coordinate `face`; the guest lies on the side `inwards` (1 or -1) of it."""
    ends = sorted((face + inwards * WALL_GAP, face + inwards * WALL_LENGTH))
    inner = BAR / 2 + SLACK
    outer = inner + WALL
    centre = bar.centre

    def wall(offsets: dict[int, tuple[float, float]]) -> Extent:
        lower, upper = list(centre), list(centre)
        for axis, (low, high) in offsets.items():
            lower[axis] += low
            upper[axis] += high
        lower[bar.axis], upper[bar.axis] = ends
        return (lower[0], lower[1], lower[2]), (upper[0], upper[1], upper[2])

    if bar.axis == 2:  # two walls across x, two between them across y
        walls = [wall({0: side, 1: (-outer, outer)}) for side in ((-outer, -inner), (inner, outer))]
        walls += [wall({0: (-inner, inner), 1: side}) for side in ((-outer, -inner), (inner, outer))]
        return Joint("O", host, bar.name, tuple(walls))
    across = 1 - bar.axis
    floor = (-BAR / 2 - WALL, -BAR / 2)  # carries the guest: no slack
    walls = [wall({across: (-outer, outer), 2: floor})]
    walls += [wall({across: side, 2: (floor[0], BAR / 2)}) for side in ((-outer, -inner), (inner, outer))]
    return Joint("U", host, bar.name, tuple(walls))


def _size(bar: Bar) -> Point:
    x, y, z = (b - a for a, b in zip(bar.lower, bar.upper, strict=True))
    return x, y, z


def _wall_in_frame(wall: Extent, origin: Point) -> OrientedBox:
    lower, upper = np.array(wall)
    return OrientedBox(pose((lower + upper) / 2 - origin), (upper - lower) / 2)
