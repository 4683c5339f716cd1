"""Which of a part's ways out are worth trying: those that some order of the others leaves open, and few of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol, TypeVar

import numpy as np

from takeapart.model.geometry import Array
from takeapart.states import members

MOST_EXITS = 8  # of a part
ALIKE = 2  # exits that are kept beside a better one that hits the same parts: the arm may follow them and not that one
SAME_LENGTH = 0.01  # m
STRAIGHT_UP = 1 - 1e-9  # of length
OTHER_WAY = math.cos(
    math.radians(25)
)  # ways that hit the same and differ by less are one: the arm follows both or none


class _Way(Protocol):
    @property
    def poses(self) -> Array: ...
    @property
    def blockers(self) -> int | None: ...


WayOut = TypeVar("WayOut", bound=_Way)


def without_worse(ways: Iterable[WayOut]) -> tuple[WayOut, ...]:
    """The open ones among the ways out of a part, the best first, without those that hit more than a shorter one, and
    without those that go about where a better one goes. The way straight up is
    among them wherever none is open already."""
    kept: list[WayOut] = []
    for way in sorted((way for way in ways if way.blockers is not None), key=_preference):
        better = [other for other in kept if is_no_worse(other, way)]
        alike = len(better) <= ALIKE and bool(better) and better[0].blockers == way.blockers
        apart = all(float(_way_of(way) @ _way_of(other)) < OTHER_WAY for other in better)
        is_spare = bool(kept) and kept[0].blockers != 0 and _rise(way) > STRAIGHT_UP
        if not better or (alike and apart) or is_spare:
            kept.append(way)
    return tuple(kept)


def selected(ways: Sequence[WayOut], leaving: int) -> tuple[WayOut, ...]:
    """At most `MOST_EXITS` of the open ways out of a part, the best first.

    Those come before all others whose blockers can all leave while the part is still there; where there are any, no
    others are kept. The steepest of them is always among those kept: what is lifted is followed best.

    Args:
        ways: as of `without_worse`.
        leaving: state of the parts that can leave while this one stays, see `leaving_before`.
    """
    useful = [way for way in ways if way.blockers is not None and not way.blockers & ~leaving] or list(ways)
    if len(useful) <= MOST_EXITS:
        return tuple(useful)
    kept = useful[:MOST_EXITS]
    steepest = max(useful, key=_rise)  # the first of several
    return tuple(kept if steepest in kept else [*kept[:-1], steepest])


def leaving_before(part: int, ways: Mapping[int, Sequence[_Way]]) -> int:
    """State of the parts that can leave in some order while one stays, whatever keeps them but each other."""
    return _left(sum(1 << other for other in ways), ways, part)[1]


def stuck(ways: Mapping[int, Sequence[_Way]]) -> int:
    """State of the parts that cannot leave in any order, whatever else keeps them."""
    return _left(sum(1 << part for part in ways), ways, None)[0]


def is_no_worse(other: _Way, way: _Way) -> bool:
    """Whether an exit hits no part that another does not hit, and is no longer."""
    assert way.blockers is not None and other.blockers is not None
    return not other.blockers & ~way.blockers and _length(other) <= _length(way) + SAME_LENGTH


def _left(state: int, ways: Mapping[int, Sequence[_Way]], staying: int | None) -> tuple[int, int]:
    """What remains of a state in which every part leaves as soon as it can, but one; and what has left."""
    root = state
    while True:
        free = [
            part
            for part in members(state)
            if part != staying and any(way.blockers is not None and not way.blockers & state for way in ways[part])
        ]
        if not free:
            return state, root & ~state
        state &= ~sum(1 << part for part in free)


def _preference(way: _Way) -> tuple[int, int, float, float]:
    """Few blockers first, then upwards, then short."""
    assert way.blockers is not None
    rise = _rise(way)
    return way.blockers.bit_count(), int(rise < -0.05), round(-rise, 6), round(_length(way), 6)


def _way_of(way: _Way) -> Array:
    """Unit vector from start to end."""
    shift = way.poses[-1, :3, 3] - way.poses[0, :3, 3]
    return np.asarray(shift / max(float(np.linalg.norm(shift)), 1e-12))


def _rise(way: _Way) -> float:
    """Of the end over the start, per length of the way."""
    return float(way.poses[-1, 2, 3] - way.poses[0, 2, 3]) / _length(way)


def _length(way: _Way) -> float:
    return math.fsum(np.linalg.norm(np.diff(way.poses[:, :3, 3], axis=0), axis=1))
