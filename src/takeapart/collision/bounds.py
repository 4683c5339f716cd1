"""Axis-aligned bounds that pass each other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from takeapart.compilation import compiled, compiled_lean
from takeapart.model.geometry import Array


class Covers(NamedTuple):
    """Bounds of the boxes that cover bodies."""

    boxes: Array  # (L, 2, 3) m, of one body after the other
    first: NDArray[np.int64]  # (B + 1,) where the boxes of each body begin
    bounds: Array  # (B, 2, 3) m, of all boxes of a body


def covers_of(boxes: Sequence[Array]) -> Covers:
    """The boxes (K, 2, 3), m, of each body; every body has some."""
    first = np.concatenate([[0], np.cumsum([len(each) for each in boxes])]).astype(np.int64)
    bounds = np.array([[each[:, 0].min(axis=0), each[:, 1].max(axis=0)] for each in boxes]).reshape(-1, 2, 3)
    return Covers(np.concatenate([np.empty((0, 2, 3)), *boxes]), first, bounds)


class Way(NamedTuple):
    """What straight ways have in common."""

    apart: float  # m, between covers at the end
    least: float  # m, of the length
    beyond: float  # m past the end of an overlap of covers
    most: float  # m, of the length


@compiled_lean
def _near_from(own: Array, k: int, others: Array, other: int, x: float, y: float, z: float, apart: float) -> float:
    """From where along a direction bounds k are nearer than `apart`, m, to other bounds; infinite where they are not
    so ahead."""
    enter, leave = -math.inf, math.inf
    for axis in range(3):
        along = x if axis == 0 else y if axis == 1 else z
        low = others[other, 0, axis] - own[k, 1, axis] - apart
        high = others[other, 1, axis] - own[k, 0, axis] + apart
        if abs(along) < 1e-9:
            if low >= 0.0 or high <= 0.0:
                return math.inf
            continue
        first, last = low / along, high / along
        enter, leave = max(enter, min(first, last)), min(leave, max(first, last))
    return enter if enter < leave and leave > 0.0 else math.inf


@compiled_lean
def _near_until(own: Array, k: int, others: Array, other: int, x: float, y: float, z: float, apart: float) -> float:
    """As `_near_from`: until where, of bounds for which that is finite."""
    leave = math.inf
    for axis in range(3):
        along = x if axis == 0 else y if axis == 1 else z
        if abs(along) < 1e-9:
            continue
        low = others[other, 0, axis] - own[k, 1, axis] - apart
        high = others[other, 1, axis] - own[k, 0, axis] + apart
        leave = min(leave, max(low / along, high / along))
    return leave


@compiled
def pass_near(own: Array, others: Array, directions: Array, apart: float, travel: Array) -> NDArray[np.bool_]:
    """(D, K, L) whether bounds (K, 2, 3) come nearer than `apart`, m, to others (L, 2, 3) along directions (D, 3)
    within `travel` (D,), m."""
    found = np.zeros((len(directions), len(own), len(others)), np.bool_)
    for d in range(len(directions)):
        x, y, z = directions[d, 0], directions[d, 1], directions[d, 2]
        for k in range(len(own)):
            for other in range(len(others)):
                found[d, k, other] = _near_from(own, k, others, other, x, y, z, apart) <= travel[d]
    return found


@compiled
def clear_after(
    own: Array, covers: Covers, counted: NDArray[np.bool_], directions: Array, hits: Array, way: Way
) -> Array:
    """(D,) m: the shortest ways along directions (D, 3) at whose end bounds are apart from all covers of the bodies
    that were not hit by then; infinite where there is none.

    Such a way ends at its least length, or where an overlap of two covers has just ended.

    Args:
        own: (K, 2, 3) m.
        counted: (B,) bodies whose covers count.
        hits: (D, B) m, after which each is hit.
    """
    found = np.full(len(directions), math.inf)
    whole = np.empty((1, 2, 3))
    for axis in range(3):
        whole[0, 0, axis], whole[0, 1, axis] = own[:, 0, axis].min(), own[:, 1, axis].max()
    starts, ends = np.empty(len(own) * len(covers.boxes)), np.empty(len(own) * len(covers.boxes))
    lengths = np.empty(len(own) * len(covers.boxes) + 1)
    for d in range(len(directions)):
        x, y, z = directions[d, 0], directions[d, 1], directions[d, 2]
        count = 0
        for body in range(len(covers.bounds)):
            if not counted[body] or _near_from(whole, 0, covers.bounds, body, x, y, z, way.apart) == math.inf:
                continue
            for k in range(len(own)):
                if _near_from(own, k, covers.bounds, body, x, y, z, way.apart) == math.inf:
                    continue
                for other in range(covers.first[body], covers.first[body + 1]):
                    enter = _near_from(own, k, covers.boxes, other, x, y, z, way.apart)
                    if enter < math.inf:
                        leave = _near_until(own, k, covers.boxes, other, x, y, z, way.apart)
                        starts[count], ends[count] = enter, min(leave, hits[d, body])
                        lengths[count] = leave + way.beyond
                        count += 1
        lengths[count] = way.least
        order, near, entered = np.argsort(starts[:count]), -math.inf, 0
        for length in np.sort(lengths[: count + 1]):
            if length < way.least:
                continue
            if length > way.most:
                break
            while entered < count and starts[order[entered]] < length:
                near = max(near, ends[order[entered]])
                entered += 1
            if near <= length:
                found[d] = length
                break
    return found


@compiled
def near_at(
    own: Array, covers: Covers, counted: NDArray[np.bool_], direction: Array, hits: Array, apart: float, length: float
) -> NDArray[np.bool_]:
    """(B,) the bodies that were not hit before a length, m, and to whose covers some of own bounds (K, 2, 3) are too
    near there, as of `clear_after`."""
    found = np.zeros(len(covers.bounds), np.bool_)
    x, y, z = direction[0], direction[1], direction[2]
    for body in range(len(found)):
        if not counted[body] or hits[body] <= length:
            continue
        for k in range(len(own)):
            for other in range(covers.first[body], covers.first[body + 1]):
                enter = _near_from(own, k, covers.boxes, other, x, y, z, apart)
                if enter < length and length < _near_until(own, k, covers.boxes, other, x, y, z, apart):
                    found[body] = True
    return found
