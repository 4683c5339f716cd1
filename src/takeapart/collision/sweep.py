"""Points on their way into a field."""

from __future__ import annotations

import math

from takeapart.collision.fields import Field
from takeapart.compilation import compiled_lean
from takeapart.model.geometry import Array

LEAST_STEP = 2e-4  # m, in contact


@compiled_lean
def placed_point(T: Array, points: Array, k: int) -> tuple[float, float, float]:
    """Point k, m, placed by T (4, 4); its row may hold more than coordinates."""
    x, y, z = points[k, 0], points[k, 1], points[k, 2]
    return (
        T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3],
        T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3],
        T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3],
    )


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
