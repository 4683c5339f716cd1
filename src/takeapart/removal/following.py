"""An exit as a motion that a tool follows at constant grasp: how the world's frame moves for what is held."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from takeapart.model.geometry import Array, pose_inverse
from takeapart.removal.exits import Exit
from takeapart.removal.poses import close_poses, moved_at_most

TURN_STEP = 0.0087  # rad; between two rows that turn further the joints move the tool noticeably further than straight
ROUNDING = 12  # decimals, m, to which a straight way is known: the difference of two poses


def end_of(way: Exit) -> Array:
    """(3, 4) motion of the world that takes the part from its place to the end of an exit."""
    if way.kind == "straight":
        return _shifts(_straight(way)[None])[0]
    return np.ascontiguousarray((way.poses[-1] @ pose_inverse(way.poses[0]))[:3])


def motion_of(way: Exit, spacing: float, radius: float) -> Array:
    """(L, 3, 4) the same in even steps, the first of them the identity: no point of the part moves further than about
    `spacing`, m, from one to the next.

    Args:
        radius: no point of the part is further from its frame's origin, m.
    """
    if way.kind == "straight":
        shift = _straight(way)
        count = max(1, round(np.ceil(float(np.linalg.norm(shift)) / spacing)))
        return _shifts(np.array([shift * k / count for k in range(count + 1)]))
    kept, moved = [way.poses[0]], 0.0
    for before, after in pairwise(way.poses):
        if np.array_equal(before[:3, :3], after[:3, :3]):  # the ends of straight pieces stay corners
            kept += [before] if moved > 0.0 else []
            kept += close_poses(np.array([before, after]), spacing, radius)[1:]
            moved = 0.0
            continue
        step = moved_at_most(before, after, radius)
        if moved > 0.0 and moved + step > spacing:
            kept.append(before)
            moved = 0.0
        moved += step
    kept += [way.poses[-1]] if moved > 0.0 else []
    kept = close_poses(np.array(kept), TURN_STEP, 1.0)  # pieces are shorter than a point turns at 1 m
    return np.ascontiguousarray((np.array(kept) @ pose_inverse(way.poses[0]))[:, :3])


def lead_lengths(way: Exit, points: Array) -> Array:
    """Lengths (K,), m, of the ways of points (K, 3), m, that move with the part along an exit."""
    if way.kind == "straight":
        return np.full(len(points), np.linalg.norm(_straight(way)))
    motion = (way.poses @ pose_inverse(way.poses[0]))[:, :3]
    ways = np.einsum("lij,kj->lki", motion[:, :, :3], points) + motion[:, None, :, 3]
    return np.asarray(np.linalg.norm(np.diff(ways, axis=0), axis=2).sum(axis=0))


def _straight(way: Exit) -> Array:
    return np.round(way.poses[-1, :3, 3] - way.poses[0, :3, 3], ROUNDING)


def _shifts(shifts: Array) -> Array:
    motion = np.zeros((len(shifts), 3, 4))
    motion[:, :3, :3] = np.eye(3)
    motion[:, :, 3] = shifts
    return motion
