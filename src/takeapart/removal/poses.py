"""Poses between those that a motion is given by."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from takeapart.collision.screws import Screw
from takeapart.model.geometry import Array

STILL = 1e-9  # rad; less is no turn


def moved_at_most(T_a: Array, T_b: Array, radius: float) -> float:
    """How far any point within `radius`, m, of the frame's origin moves at most between two poses, m."""
    return float(np.linalg.norm(T_b[:3, 3] - T_a[:3, 3])) + radius * _angle(T_a[:3, :3].T @ T_b[:3, :3])


def close_poses(poses: Array, spacing: float, radius: float) -> list[Array]:
    """The poses (K, 4, 4) and others between them, so that no point within `radius`, m, of the frame's origin moves
    further than `spacing`, m, from one to the next: the origin goes straight, at an even turn."""
    found = [poses[0]]
    for first, last in pairwise(poses):
        count = max(1, math.ceil(moved_at_most(first, last, radius) / spacing - 1e-9))
        found += [_between(first, last, k / count) for k in range(1, count)]
        found.append(last)
    return found


def _between(T_a: Array, T_b: Array, share: float) -> Array:
    T = T_a.copy()
    T[:3, 3] += share * (T_b[:3, 3] - T_a[:3, 3])
    R = T_a[:3, :3].T @ T_b[:3, :3]
    angle = _angle(R)
    if angle > STILL:
        axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / (2 * math.sin(angle))
        T[:3, :3] = T_a[:3, :3] @ Screw(np.zeros(3), angle, axis, np.zeros(3)).pose(share)[:3, :3]
    return T


def _angle(R: Array) -> float:
    """Of a turn by less than half a circle, rad; exact where it is small too."""
    sine = math.sqrt((R[2, 1] - R[1, 2]) ** 2 + (R[0, 2] - R[2, 0]) ** 2 + (R[1, 0] - R[0, 1]) ** 2) / 2
    return math.atan2(sine, (float(np.trace(R)) - 1) / 2)
