"""How far a body goes along each of several directions until it is too near to another, by their fields."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from takeapart.collision.fields import Field
from takeapart.collision.meeting import cloud_hit
from takeapart.collision.parting import parted_after
from takeapart.collision.points import Cloud
from takeapart.compilation import compiled
from takeapart.model.geometry import Array


class Side(NamedTuple):
    """One of two bodies, and its place and ways as seen by the other."""

    field: Field
    cloud: Cloud
    T: Array  # (4, 4) T_other_cloud
    points: Array  # (N, 3) m, the cloud's in the other's frame; none need be there for what never touches
    along: Array  # (D, 3) unit vectors, in the other's frame


class Keep(NamedTuple):
    """How near two bodies may come, m; negative where they may overlap."""

    kept: float
    touching: bool  # `kept` only until they have parted
    apart: float  # where they count as parted
    again: float  # how near they may come from there on


@compiled
def passes(mine: Side, other: Side, keep: Keep, travel: Array) -> Array:
    """(D, 2) m: how far mine goes along directions until it is too near to the other, and how far until the two, that
    touched, have parted; infinite where it is not so.

    Args:
        travel: (D,) m, at most; below zero where that direction is not asked.
    """
    found = np.full((len(travel), 2), math.inf)
    for d in range(len(travel)):
        if travel[d] < 0.0:
            continue
        hit = _hit(mine, other, d, keep.kept, travel[d], 0.0)
        if keep.touching:
            separate = _parted(mine, other, d, keep.apart, min(travel[d], hit))
            if separate < hit:
                hit = min(hit, _hit(mine, other, d, keep.again, travel[d], separate))
            found[d, 1] = separate
        found[d, 0] = hit
    return found


@compiled
def _hit(mine: Side, other: Side, d: int, kept: float, travel: float, start: float) -> float:
    """How far mine goes along direction d, after `start`, until it is nearer than `kept`; all in m."""
    there, here = mine.along[d], other.along[d]
    T_there, T_here = mine.T.copy(), other.T.copy()
    for axis in range(3):
        T_there[axis, 3] += start * there[axis]
        T_here[axis, 3] += start * here[axis]
    found = cloud_hit(other.field, mine.cloud, T_there, there, kept, travel - start)
    limit = min(travel - start, found)
    return start + min(found, cloud_hit(mine.field, other.cloud, T_here, here, kept, limit))


@compiled
def _parted(mine: Side, other: Side, d: int, apart: float, travel: float) -> float:
    """How far mine goes along direction d until nothing of it is nearer than `apart`; infinite if it never is within
    `travel`, m."""
    s = 0.0
    while True:
        first = parted_after(other.field, mine.points, mine.along[d], s, apart, travel)
        if not len(other.points) or first == math.inf:
            return first
        second = parted_after(mine.field, other.points, other.along[d], first, apart, travel)
        if second == first or second == math.inf:
            return second
        s = second
