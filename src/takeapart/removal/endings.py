"""Where an exit may end: the boxes that cover a part are apart from those of what it has passed."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from takeapart.collision.bounds import overlaps_along
from takeapart.model.geometry import Array

APART = 5e-3  # m, between the covers of a part and of what it passed, at the end of its exit
SHORTEST = 0.01  # m
BEYOND = 1e-4  # m past the end of an overlap of covers


class Ending(NamedTuple):
    """Where a straight way ends."""

    length: float  # m
    hit: tuple[int, ...]  # bodies that are met by then
    near: tuple[int, ...]  # bodies whose cover is too near even at the end of all travel; then this is no end


def bounds_of(boxes: Sequence[Array]) -> Array:
    """(K, 2, 3) m: axis-aligned bounds of boxes by their corners."""
    return np.array([[corners.min(axis=0), corners.max(axis=0)] for corners in boxes])


def ending(
    own: Array, covers: Mapping[int, Array], direction: Array, hits: Mapping[int, float], travel: float
) -> Ending:
    """The shortest way along a direction at whose end a part's cover is apart from those of all that it did not hit on
    the way.

    Args:
        own: (K, 2, 3) m, the part's bounds at the start.
        covers: of other bodies, the same.
        direction: (3,) unit vector.
        hits: bodies that are hit, after so many m.
        travel: m, at most.
    """
    near = {body: overlaps_along(own, cover, direction, APART) for body, cover in covers.items()}
    ends = [np.array([SHORTEST])] + [each[:, 1] + BEYOND for each in near.values()]
    for length in np.unique(np.concatenate(ends)).tolist():
        if SHORTEST <= length <= travel + APART and not _near(near, hits, length):
            return Ending(length, _until(hits, length), ())
    return Ending(travel, _until(hits, travel), _near(near, hits, travel))


def raised(own: Array, height: float) -> Array:
    """Bounds (K, 2, 3), m, swept straight up."""
    return own + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, height]])


def only(covers: Sequence[Array], bodies: Collection[int]) -> dict[int, Array]:
    """The covers of some bodies."""
    return {body: covers[body] for body in bodies}


def _near(near: Mapping[int, Array], hits: Mapping[int, float], length: float) -> tuple[int, ...]:
    return tuple(
        body
        for body, each in near.items()
        if hits.get(body, math.inf) > length and ((each[:, 0] < length) & (length < each[:, 1])).any()
    )


def _until(hits: Mapping[int, float], length: float) -> tuple[int, ...]:
    return tuple(body for body, after in hits.items() if after <= length)
