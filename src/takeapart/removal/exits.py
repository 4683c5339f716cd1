"""How a part gets clear of its neighbours, without the arm."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from takeapart.collision.bounds import overlaps_along
from takeapart.collision.contact import SPACING, Contacts
from takeapart.collision.fields import Field, box_field
from takeapart.collision.meeting import AT_ONCE, cloud_distance, cloud_hit
from takeapart.collision.points import Cloud, cloud_of
from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Array, Box, OrientedBox, pose_inverse
from takeapart.removal.directions import directions_of, sphere
from takeapart.removal.pushes import pushed_free, unscrewed

ExitKind = Literal["straight", "pushes", "screw"]


@dataclass(frozen=True, eq=False)
class Exit:
    """A motion of a part alone, from its place to where it is clear.

    Args:
        kind: along a direction, in a few pushes, or along a screw.
        poses: (K, 4, 4) T_world_part, the first as assembled.
        blockers: state of the parts that it would hit; None where it meets what never leaves.
        direction: (3,) unit vector of a straight exit, else None.
        hits: what it meets, and after how many metres; the number of parts stands for what never leaves.
    """

    kind: ExitKind
    poses: Array
    blockers: int | None
    direction: Array | None = None
    hits: tuple[tuple[int, float], ...] = ()


class ExitRule(Protocol):
    """Which exits a part has."""

    def exits(self, part: int) -> tuple[Exit, ...]:
        """All that are worth trying, those with the fewest blockers first."""
        ...


APART = 5e-3  # m, between the covers of a part and of what it passed, at the end of its exit
SHORTEST, MOST_TRAVEL = 0.01, 2.0  # m
MOST_EXITS = 8  # of a part
ALIKE = 2  # exits that are kept beside a better one that hits the same parts: the arm may follow them and not that one
SAME_LENGTH = 0.01  # m
AXES = 5  # of the directions of a part, the world's: along these it leaves after pushes
BEYOND = 1e-4  # m past the end of an overlap of covers


class Exits:
    """Ways out of a product: straight in any direction, by a thread or by pushes where no straight one is; found when
    first asked for.

    Args:
        assembly: the product.
        contacts: its near pairs.
        obstacles: boxes of the environment, world frame.
        clearance: kept from whatever is further away at the start, m; along the rest a part may slide.
    """

    def __init__(
        self, assembly: Assembly, contacts: Contacts, obstacles: Sequence[OrientedBox], clearance: float
    ) -> None:
        self._assembly, self._contacts, self._clearance = assembly, contacts, clearance
        self._parts = len(assembly.parts)
        self._obstacles: list[tuple[Field, Cloud]] = []
        for box in obstacles:
            field = box_field(box.T_frame_box, box.half_extents)
            surface = Box(tuple(2 * box.half_extents)).surface().moved(box.T_frame_box)
            self._obstacles.append((field, cloud_of(surface, field, SPACING)))
        self._covers = [_bounds([box.corners() for box in part.boxes_in_world()]) for part in assembly.parts]
        self._covers += [_bounds([box.corners()]) for box in obstacles]
        self._travel = min(MOST_TRAVEL, float(np.linalg.norm(np.ptp(_product(assembly), axis=0))) + 2 * APART)
        self._exits: dict[int, tuple[Exit, ...]] = {}

    def exits(self, part: int) -> tuple[Exit, ...]:
        """The exits worth trying, those with the fewest blockers first; where every one meets what never leaves, those,
        with what they hit."""
        if part not in self._exits:
            self._exits[part] = self._find(part)
        return self._exits[part]

    def _find(self, part: int) -> tuple[Exit, ...]:
        if self._assembly.parts[part].fixed:
            return ()
        first = directions_of(self._assembly, self._contacts, part)
        found = [self._along(part, direction) for direction in first]
        if not any(way.blockers == 0 for way in found):
            found += [self._along(part, direction) for direction in sphere() if _is_new(direction, first)]
        open_ = [way for way in found if way.blockers is not None]
        if not open_:
            winding = self._winding(part, first)
            return tuple(found[:MOST_EXITS]) if winding is None else (winding,)
        kept: list[Exit] = []
        for way in sorted(open_, key=_preference):
            better = [other for other in kept if _is_no_worse(other, way)]
            if not better or (len(better) <= ALIKE and better[0].blockers == way.blockers):
                kept.append(way)
        return tuple(kept[:MOST_EXITS])

    def _winding(self, part: int, directions: Sequence[Array]) -> Exit | None:
        """A way out along a thread or by pushes, with all others there; None where none is found."""
        others = [other for other in range(self._parts) if other != part]

        def is_free(T: Array, direction: Array) -> bool:
            return self._along(part, direction, T).blockers == 0

        kind: ExitKind = "screw"
        boxes = [field for field, _ in self._obstacles]
        way = unscrewed(self._assembly, self._contacts, part, others, boxes, is_free)
        if way is None:
            kind = "pushes"
            way = pushed_free(self._assembly, self._contacts, part, others, boxes, directions[:AXES], is_free)
        if way is None:
            return None
        out = self._along(part, way.direction, way.poses[-1])
        return Exit(kind, np.concatenate([way.poses, out.poses[1:]]), out.blockers, None, out.hits)

    def _along(self, part: int, direction: Array, T: Array | None = None) -> Exit:
        """Straight out from where the part stands, or from another pose."""
        start = self._assembly.parts[part].T_world_part if T is None else T
        hits = self._hits(part, direction, start)
        length, blockers = self._length(part, direction, dict(hits), start)
        poses = np.repeat(start[None], 2, axis=0)
        poses[1, :3, 3] += length * direction
        told: dict[int, float] = {}
        for owner, after in hits:
            number = owner if owner < self._parts and not self._assembly.parts[owner].fixed else self._parts
            if after <= length:
                told[number] = min(after, told.get(number, math.inf))
        return Exit("straight", poses, blockers, direction, tuple(sorted(told.items(), key=lambda hit: hit[1])))

    def _hits(self, part: int, direction: Array, T_world_part: Array) -> list[tuple[int, float]]:
        """What a part meets along a direction, and after how many m; obstacles are numbered after the parts."""
        body, mine = self._contacts.body(part), pose_inverse(T_world_part)
        low, high = self._contacts.bounds[part]
        if T_world_part is not self._assembly.parts[part].T_world_part:
            ball = body.cloud.balls[1]
            middle = T_world_part[:3, :3] @ ball[:3] + T_world_part[:3, 3]
            low, high = middle - ball[3], middle + ball[3]
        swept = np.minimum(low, low + self._travel * direction), np.maximum(high, high + self._travel * direction)
        found = []
        for other in range(self._parts):
            if other == part:
                continue
            theirs, T = self._contacts.body(other), self._assembly.parts[other].T_world_part
            near = self._contacts.bounds[other]
            if (near[0] > swept[1] + self._clearance).any() or (near[1] < swept[0] - self._clearance).any():
                continue
            kept = self._kept(part, other)
            back = pose_inverse(T)
            hit = cloud_hit(theirs.field, body.cloud, back @ T_world_part, back[:3, :3] @ direction, kept, self._travel)
            if hit > AT_ONCE:
                away, limit = -(mine[:3, :3] @ direction), min(self._travel, hit)
                hit = min(hit, cloud_hit(body.field, theirs.cloud, mine @ T, away, kept, limit))
            if hit < math.inf:
                found.append((other, hit))
        for number, (field, cloud) in enumerate(self._obstacles):
            apart = min(
                cloud_distance(field, body.cloud, T_world_part, self._clearance),
                cloud_distance(body.field, cloud, mine, self._clearance),
            )
            kept = min(self._clearance, apart - BEYOND)
            hit = cloud_hit(field, body.cloud, T_world_part, direction, kept, self._travel)
            away, limit = -(mine[:3, :3] @ direction), min(self._travel, hit)
            hit = min(hit, cloud_hit(body.field, cloud, mine, away, kept, limit))
            if hit < math.inf:
                found.append((self._parts + number, hit))
        return found

    def _kept(self, part: int, other: int) -> float:
        """How near two parts may come, m: negative where they may overlap."""
        found = self._contacts.finding(part, other)
        if found is not None and found.gap <= self._clearance:
            return -self._contacts.tolerance(part, other)
        return self._clearance

    def _length(self, part: int, direction: Array, hits: dict[int, float], T: Array) -> tuple[float, int | None]:
        """The shortest way along a direction at whose end the part's cover is apart from those of all that it did not
        hit on the way, m; and what it hit by then."""
        own = self._covers[part]
        if T is not self._assembly.parts[part].T_world_part:
            own = _bounds([box.moved(T).corners() for box in self._assembly.parts[part].shape.boxes()])
        overlaps = {
            other: overlaps_along(own, cover, direction, APART)
            for other, cover in enumerate(self._covers)
            if other != part
        }
        ends = [np.array([SHORTEST])] + [each[:, 1] + BEYOND for each in overlaps.values()]
        for length in np.unique(np.concatenate(ends)).tolist():
            if length < SHORTEST:
                continue
            if length > self._travel + APART:
                break
            if all(
                hits.get(other, math.inf) <= length or not ((each[:, 0] < length) & (length < each[:, 1])).any()
                for other, each in overlaps.items()
            ):
                blockers = 0
                for other, after in hits.items():
                    if after <= length:
                        if other >= self._parts or self._assembly.parts[other].fixed:
                            return length, None
                        blockers |= 1 << other
                return length, blockers
        return self._travel, None


def _bounds(boxes: Sequence[Array]) -> Array:
    """(K, 2, 3) m: axis-aligned bounds of boxes by their corners."""
    return np.array([[corners.min(axis=0), corners.max(axis=0)] for corners in boxes])


def _product(assembly: Assembly) -> Array:
    corners = [part.shape.bounding_box().moved(part.T_world_part).corners() for part in assembly.parts]
    return np.concatenate(corners)


def _preference(way: Exit) -> tuple[int, int, float, float]:
    """Few blockers first, then upwards, then short."""
    assert way.blockers is not None and way.direction is not None
    down = int(way.direction[2] < -0.05)
    return way.blockers.bit_count(), down, round(-float(way.direction[2]), 6), round(_length(way), 6)


def _is_no_worse(other: Exit, way: Exit) -> bool:
    """Whether an exit hits no part that another does not hit, and is no longer."""
    assert way.blockers is not None and other.blockers is not None
    return not other.blockers & ~way.blockers and _length(other) <= _length(way) + SAME_LENGTH


def _length(way: Exit) -> float:
    return float(np.linalg.norm(way.poses[-1, :3, 3] - way.poses[0, :3, 3]))


def _is_new(direction: Array, known: Sequence[Array]) -> bool:
    return all(float(direction @ other) < 0.999 for other in known)
