"""Where an exit may end: the boxes that cover a part are apart from those of what it has passed."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from takeapart.collision.bounds import Covers, Way, clear_after, near_at
from takeapart.model.geometry import Array, OrientedBox

APART = 5e-3  # m, between the covers of a part and of what it passed, at the end of its exit
SHORTEST = 0.01  # m
BEYOND = 1e-4  # m past the end of an overlap of covers
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)


class Ending(NamedTuple):
    """Where a straight way ends."""

    length: float  # m
    hit: tuple[int, ...]  # bodies that are met by then
    near: tuple[int, ...]  # bodies whose cover is too near even at the end of all travel; then this is no end


def bounds_at(boxes: Sequence[OrientedBox], T: Array | None = None) -> Array:
    """(K, 2, 3) m: axis-aligned bounds of boxes, moved by T (4, 4)."""
    poses = np.array([box.T_frame_box for box in boxes])
    poses = poses if T is None else T @ poses
    ends = CORNERS * np.array([box.half_extents for box in boxes])[:, None]
    corners = ends @ np.swapaxes(poses[:, :3, :3], 1, 2) + poses[:, None, :3, 3]
    return np.stack([corners.min(axis=1), corners.max(axis=1)], axis=1)


def among(bodies: Collection[int], count: int) -> NDArray[np.bool_]:
    """(count,) flags of some bodies."""
    flags = np.zeros(count, bool)
    flags[list(bodies)] = True
    return flags


def ending(
    own: Array, covers: Covers, counted: NDArray[np.bool_], direction: Array, hits: Array, travel: float
) -> Ending:
    """The shortest way along a direction at whose end a part's cover is apart from those of all that it did not hit on
    the way.

    Args:
        own: (K, 2, 3) m, the part's bounds at the start.
        covers: of all bodies.
        counted: (B,) those that must be passed.
        direction: (3,) unit vector.
        hits: (B,) m, after which each body is hit; infinite where it is not.
        travel: m, at most.
    """
    length = float(lengths(own, covers, counted, direction[None], hits[None], travel)[0])
    near: tuple[int, ...] = ()
    if length == np.inf:
        length = travel
        near = tuple(np.flatnonzero(near_at(own, covers, counted, direction, hits, APART, length)).tolist())
    return Ending(length, tuple(np.flatnonzero(hits <= length).tolist()), near)


def lengths(
    own: Array, covers: Covers, counted: NDArray[np.bool_], directions: Array, hits: Array, travel: float
) -> Array:
    """(D,) m, of the ways along directions (D, 3); infinite where `ending` has none. Hits are (D, B)."""
    return clear_after(own, covers, counted, directions, hits, Way(APART, SHORTEST, BEYOND, travel + APART))


def raised(own: Array, height: float) -> Array:
    """Bounds (K, 2, 3), m, swept straight up."""
    return own + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, height]])
