"""When two bodies have come apart, and whether they are nearer than some distance, by their fields."""

from __future__ import annotations

import math

from takeapart.collision.fields import Field, signed_distance
from takeapart.collision.sweep import LEAST_STEP, placed_point
from takeapart.compilation import compiled
from takeapart.model.geometry import Array


@compiled
def parted_after(field: Field, points: Array, direction: Array, start: float, apart: float, travel: float) -> float:
    """How far points (N, 3) of the field's frame have to go along a direction (3,), from `start` on, until none of them
    is nearer than `apart`, m, to the surface; infinite where that is not so within `travel`, m.

    Nothing is apart before the point that was seen last is: it tells how far to go on before all are looked at again.
    """
    dx, dy, dz = direction[0], direction[1], direction[2]
    s, last = start, 0
    while s <= travel:
        near = -1
        for k in range(len(points)):
            i = (last + k) % len(points)
            distance = signed_distance(field, points[i, 0] + s * dx, points[i, 1] + s * dy, points[i, 2] + s * dz)
            if distance < apart:
                near = i
                s += max(apart - distance, LEAST_STEP)
                break
        if near < 0:
            return s
        last = near
    return math.inf


@compiled
def nearer_than(field: Field, points: Array, T_field_points: Array, limit: float) -> bool:
    """Whether any of points (N, 3), placed by T (4, 4), is nearer to the surface than a limit, m."""
    T = T_field_points
    for i in range(len(points)):
        x, y, z = placed_point(T, points, i)
        if signed_distance(field, x, y, z) < limit:
            return True
    return False
