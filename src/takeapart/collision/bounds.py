"""Axis-aligned bounds that pass each other."""

from __future__ import annotations

import math

import numpy as np

from takeapart.compilation import compiled
from takeapart.model.geometry import Array


@compiled
def overlaps_along(own: Array, others: Array, direction: Array, apart: float) -> Array:
    """(P, 2) m: from where to where along a direction (3,) bounds (K, 2, 3) are nearer than `apart`, m, to others
    (L, 2, 3), of the pairs for which that is so ahead."""
    found, count = np.empty((len(own) * len(others), 2)), 0
    for k in range(len(own)):
        for other in range(len(others)):
            enter, leave = -math.inf, math.inf
            for axis in range(3):
                low = others[other, 0, axis] - own[k, 1, axis] - apart
                high = others[other, 1, axis] - own[k, 0, axis] + apart
                if abs(direction[axis]) < 1e-9:
                    if low >= 0.0 or high <= 0.0:
                        enter = math.inf
                    continue
                first, last = low / direction[axis], high / direction[axis]
                enter, leave = max(enter, min(first, last)), min(leave, max(first, last))
            if enter < leave and leave > 0.0:
                found[count, 0], found[count, 1] = enter, leave
                count += 1
    return found[:count].copy()
