"""How far a part moves along a direction until it meets another, and how near it is: the tree of its surface points in
the field of the other. Asked both ways, for a cloud has few points on what is flat."""

from __future__ import annotations

import math

import numpy as np

from takeapart.collision.fields import Field, signed_distance
from takeapart.collision.points import IN_LEAF, Cloud
from takeapart.collision.sweep import LEAST_STEP, entry, placed_point
from takeapart.collision.triangles import DEEPEST
from takeapart.compilation import compiled, compiled_lean
from takeapart.model.geometry import Array

AT_ONCE = 1e-3  # m; what is hit as early as this is hit at once, and nothing earlier is looked for
LOOSE = 0.1  # of a ball's radius, from where on its points are looked at instead


@compiled
def cloud_hit(field: Field, cloud: Cloud, T: Array, direction: Array, kept: float, travel: float) -> float:
    """How far points go along a direction until one of them is nearer than `kept`, m, to the surface; infinite where
    none is within `travel`, m.

    A point steps as far as it is away, at least `LEAST_STEP`. Points whose surface faces backwards or slides along are
    left out: what they would meet, the body has met with a point further ahead before, or held already at the start.
    Of what is hit within `AT_ONCE` the first that is found counts, else the least to `LEAST_STEP`.

    Args:
        T: (4, 4) T_field_cloud.
        direction: (3,) unit vector in the field's frame.
        kept: negative where an overlap is tolerated.
    """
    nearest = math.inf
    waiting, starts = np.empty(DEEPEST, np.int32), np.empty(DEEPEST)
    x, y, z = direction[0], direction[1], direction[2]
    back = np.empty(3)  # the direction in the cloud's frame
    for k in range(3):
        back[k] = T[0, k] * x + T[1, k] * y + T[2, k] * z
    count = 1
    waiting[0], starts[0] = 1, _ball_entry(field, cloud, T, direction, back, kept, 1, 0.0, travel)
    while count:
        count -= 1
        node, start = waiting[count], starts[count]
        limit = min(travel, nearest - LEAST_STEP)
        if start > limit:
            continue
        if node < cloud.leaves:
            left = _ball_entry(field, cloud, T, direction, back, kept, 2 * node, start, limit)
            right = _ball_entry(field, cloud, T, direction, back, kept, 2 * node + 1, start, limit)
            nearer = 0 if left <= right else 1
            if max(left, right) <= limit:
                waiting[count], starts[count] = 2 * node + 1 - nearer, max(left, right)
                count += 1
            if min(left, right) <= limit:
                waiting[count], starts[count] = 2 * node + nearer, min(left, right)
                count += 1
            continue
        first = (node - cloud.leaves) * IN_LEAF
        for i in range(first, min(first + IN_LEAF, len(cloud.points))):
            one = cloud.facing[i, 0] * back[0] + cloud.facing[i, 1] * back[1] + cloud.facing[i, 2] * back[2]
            two = cloud.facing[i, 3] * back[0] + cloud.facing[i, 4] * back[1] + cloud.facing[i, 5] * back[2]
            if max(one, two) < -cloud.facing[i, 6]:
                continue
            qx, qy, qz = placed_point(T, cloud.points, i)
            limit = min(travel, nearest - LEAST_STEP)
            t = max(start, entry(field, qx, qy, qz, direction, kept, limit))
            while t <= limit:
                away = signed_distance(field, qx + t * x, qy + t * y, qz + t * z) - kept
                if away < 0.0:
                    nearest = t
                    break
                t += max(away, LEAST_STEP)
        if nearest <= AT_ONCE:
            break
    return nearest


@compiled_lean
def _ball_entry(
    field: Field,
    cloud: Cloud,
    T: Array,
    direction: Array,
    back: Array,
    kept: float,
    node: int,
    start: float,
    limit: float,
) -> float:
    """From where on along a direction a point of a node may be too near, m, not before `start`; infinite where none is
    within `limit`, m, or all of them face backwards."""
    facing = cloud.cones[node, 0] * back[0] + cloud.cones[node, 1] * back[1] + cloud.cones[node, 2] * back[2]
    if facing < -cloud.cones[node, 3]:
        return math.inf
    radius = cloud.balls[node, 3]
    x, y, z = placed_point(T, cloud.balls, node)
    t = max(start, entry(field, x, y, z, direction, kept + radius, limit))
    close = LOOSE * radius + LEAST_STEP
    while t <= limit:
        away = signed_distance(field, x + t * direction[0], y + t * direction[1], z + t * direction[2]) - kept - radius
        if away < close:
            return t
        t += away
    return math.inf


@compiled
def cloud_distance(field: Field, cloud: Cloud, T: Array, most: float) -> float:
    """Least signed distance of points from a surface, m; `most` if none is below that.

    Args:
        T: (4, 4) T_field_cloud.
    """
    least, count = most, 1
    waiting, bounds = np.empty(DEEPEST, np.int32), np.empty(DEEPEST)
    waiting[0], bounds[0] = 1, _ball_distance(field, cloud.balls, T, 1)
    while count:
        count -= 1
        node = waiting[count]
        if bounds[count] >= least:
            continue
        if node < cloud.leaves:
            left = _ball_distance(field, cloud.balls, T, 2 * node)
            right = _ball_distance(field, cloud.balls, T, 2 * node + 1)
            nearer = 0 if left <= right else 1
            if max(left, right) < least:
                waiting[count], bounds[count] = 2 * node + 1 - nearer, max(left, right)
                count += 1
            if min(left, right) < least:
                waiting[count], bounds[count] = 2 * node + nearer, min(left, right)
                count += 1
            continue
        first = (node - cloud.leaves) * IN_LEAF
        for i in range(first, min(first + IN_LEAF, len(cloud.points))):
            x, y, z = placed_point(T, cloud.points, i)
            least = min(least, signed_distance(field, x, y, z))
    return least


@compiled_lean
def _ball_distance(field: Field, balls: Array, T: Array, node: int) -> float:
    """No point of a node is nearer than this, m."""
    x, y, z = placed_point(T, balls, node)
    return signed_distance(field, x, y, z) - balls[node, 3]


@compiled
def points_below(field: Field, cloud: Cloud, T: Array, limit: float) -> Array:
    """(N, 3) m, in the field's frame: the points that are nearer to the surface than a limit, m.

    Args:
        T: (4, 4) T_field_cloud.
    """
    found, count, listed = np.empty((len(cloud.points), 3)), 1, 0
    waiting = np.empty(DEEPEST, np.int32)
    waiting[0] = 1
    while count:
        count -= 1
        node = waiting[count]
        if _ball_distance(field, cloud.balls, T, node) >= limit:
            continue
        if node < cloud.leaves:
            waiting[count], waiting[count + 1] = 2 * node + 1, 2 * node
            count += 2
            continue
        first = (node - cloud.leaves) * IN_LEAF
        for i in range(first, min(first + IN_LEAF, len(cloud.points))):
            x, y, z = placed_point(T, cloud.points, i)
            if signed_distance(field, x, y, z) < limit:
                found[listed, 0], found[listed, 1], found[listed, 2] = x, y, z
                listed += 1
    return found[:listed].copy()
