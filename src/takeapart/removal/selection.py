"""Which of a part's ways out are worth trying: those that some order of the others leaves open, and few of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from takeapart.model.geometry import Array
from takeapart.states import members

MOST_EXITS = 8  # of a part
ALIKE = 2  # exits that are kept beside a better one that hits the same parts: the arm may follow them and not that one
SAME_LENGTH = 0.01  # m
STRAIGHT_UP = 1 - 1e-9  # of length
OTHER_WAY = math.cos(math.radians(25))  # what leans from a way by less, and hits the same, adds nothing to it


class _Way(Protocol):
    @property
    def poses(self) -> Array: ...
    @property
    def blockers(self) -> int | None: ...
    @property
    def leans(self) -> bool: ...


WayOut = TypeVar("WayOut", bound=_Way)


class Figures(NamedTuple):
    """What the rank of a way depends on, and whether it is kept.

    Args:
        blockers: state of the parts that it hits.
        down: whether it ends lower.
        rise: of the end over the start, per length of the way.
        length: m.
        towards: unit vector from start to end; None where it is not known yet.
        leans: whether it goes along a direction that nothing suggests.
    """

    blockers: int
    down: bool
    rise: float
    length: float
    towards: tuple[float, float, float] | None
    leans: bool = False


def figures_of(way: _Way) -> Figures | None:
    """The figures of an open way; None where it is none."""
    if way.blockers is None:
        return None
    shift = way.poses[-1, :3, 3] - way.poses[0, :3, 3]
    x, y, z = (shift / max(float(np.linalg.norm(shift)), 1e-12)).tolist()
    rise = _rise(way)
    return Figures(way.blockers, rise < -0.05, rise, _length(way), (x, y, z), way.leans)


def is_kept(way: Figures, kept: Sequence[Figures]) -> bool:
    """Whether a way is worth trying beside those that rank before it and are.

    Not worth it is what hits more than a shorter one, and what leans but little from a better one. The way straight up
    is worth it wherever none is open already.
    """
    better = [other for other in kept if _no_worse(other, way)]
    if not better or (kept[0].blockers != 0 and way.towards is not None and way.rise > STRAIGHT_UP):
        return True
    if len(better) > ALIKE or better[0].blockers != way.blockers:
        return False
    return (
        not way.leans or way.towards is None or all(_cosine(way.towards, other.towards) < OTHER_WAY for other in better)
    )


def without_worse(ways: Iterable[WayOut]) -> tuple[WayOut, ...]:
    """The open ones among the ways out of a part that are worth trying, the best first."""
    ranked = [(way, figures) for way in ways if (figures := figures_of(way)) is not None]
    kept: list[tuple[WayOut, Figures]] = []
    for way, figures in sorted(ranked, key=lambda each: preference(each[1])):
        if is_kept(figures, [other for _, other in kept]):
            kept.append((way, figures))
    return tuple(way for way, _ in kept)


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
    figures, others = figures_of(way), figures_of(other)
    assert figures is not None and others is not None
    return _no_worse(others, figures)


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


def preference(way: Figures) -> tuple[int, bool, float, float]:
    """By which ways are ranked: few blockers first, then upwards, then short."""
    return way.blockers.bit_count(), way.down, round(-way.rise, 6), round(way.length, 6)


def _no_worse(other: Figures, way: Figures) -> bool:
    return not other.blockers & ~way.blockers and other.length <= way.length + SAME_LENGTH


def _cosine(first: tuple[float, float, float], second: tuple[float, float, float] | None) -> float:
    return sum(a * b for a, b in zip(first, second, strict=True)) if second is not None else -1.0


def _rise(way: _Way) -> float:
    """Of the end over the start, per length of the way."""
    return float(way.poses[-1, 2, 3] - way.poses[0, 2, 3]) / _length(way)


def _length(way: _Way) -> float:
    return math.fsum(np.linalg.norm(np.diff(way.poses[:, :3, 3], axis=0), axis=1))
