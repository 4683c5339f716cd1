"""How far a part moves along a direction until it meets another, by the fields of both."""

from __future__ import annotations

import math

from takeapart.collision.fields import Field, signed_distance
from takeapart.compilation import compiled, compiled_lean
from takeapart.model.geometry import Array

LEAST_STEP = 2e-4  # m, in contact


@compiled
def first_hit(field: Field, points: Array, direction: Array, kept: float, travel: float) -> float:
    """How far points (N, 3) of the field's frame go along a direction (3,) until one of them is nearer than `kept`, m,
    to the surface; infinite where none is within `travel`, m.

    A point steps as far as it is away, at least `LEAST_STEP`. What is too near at the start may go on as long as it
    does not come nearer.

    Args:
        kept: negative where an overlap is tolerated.
    """
    nearest = math.inf
    dx, dy, dz = direction[0], direction[1], direction[2]
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        limit = min(travel, nearest)
        t = entry(field, x, y, z, direction, kept, limit)
        while t <= limit:
            away = signed_distance(field, x + t * dx, y + t * dy, z + t * dz) - kept
            if away < 0.0:
                nearest = t
                break
            t += max(away, LEAST_STEP)
    return nearest


@compiled_lean
def entry(field: Field, x: float, y: float, z: float, direction: Array, kept: float, travel: float) -> float:
    """How far a point goes until it enters the box around a field, grown by what is kept; infinite if it never does."""
    first, last = 0.0, travel
    grown = max(kept, 0.0) + 1e-6
    dx, dy, dz = x - field.middle[0], y - field.middle[1], z - field.middle[2]
    for a in range(3):
        at = field.axes[a, 0] * dx + field.axes[a, 1] * dy + field.axes[a, 2] * dz
        along = field.axes[a, 0] * direction[0] + field.axes[a, 1] * direction[1] + field.axes[a, 2] * direction[2]
        reach = field.half[a] + grown
        if abs(along) < 1e-12:
            if abs(at) > reach:
                return math.inf
            continue
        t0, t1 = (-reach - at) / along, (reach - at) / along
        first, last = max(first, min(t0, t1)), min(last, max(t0, t1))
    return first if first <= last else math.inf
