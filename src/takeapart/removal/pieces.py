"""The surfaces of a product and its cell, and two of them as one moves past the other."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from takeapart.collision.fields import Field
from takeapart.collision.meeting import cloud_distance
from takeapart.collision.parting import nearer_than
from takeapart.collision.passing import Keep, Side, passes
from takeapart.collision.points import Cloud
from takeapart.collision.screws import Screw
from takeapart.model.geometry import Array, pose_inverse

Pair = tuple[int, int]  # numbers of two pieces
NONE = np.empty((0, 3))


@dataclass(frozen=True, eq=False)
class Piece:
    """One surface: a part's shape, a wall of a connector that it carries, or an obstacle.

    Args:
        owner: number of the part, or of the obstacle after all parts.
        field: in the piece's frame.
        cloud: points on its surface in the piece's frame.
        T_owner_piece: (4, 4); of an obstacle its pose in the world.
        T_world_piece: (4, 4) as assembled.
        bounds: (2, 3) m, in the world as assembled.
    """

    owner: int
    field: Field
    cloud: Cloud
    T_owner_piece: Array
    T_world_piece: Array
    bounds: Array

    @property
    def points(self) -> Array:
        """(N, 3) m, of the cloud."""
        return self.cloud.points

    @cached_property
    def T_piece_world(self) -> Array:
        """(4, 4) as assembled."""
        return pose_inverse(self.T_world_piece)


class Demand(NamedTuple):
    """How near two pieces may come, m; negative where they may overlap."""

    kept: float
    touching: bool  # only until they have parted


class Meeting:
    """Two pieces, one of them at a pose.

    Args:
        mine: the one that moves.
        T_world_mine: (4, 4) its pose.
        other: the one that stays as assembled.
    """

    def __init__(self, mine: Piece, T_world_mine: Array, other: Piece) -> None:
        self.mine, self.other = mine, other
        self._T_other_mine = other.T_piece_world @ T_world_mine
        self._T_mine_other = pose_inverse(self._T_other_mine)
        self._T_world_mine = T_world_mine

    @cached_property
    def _points(self) -> Array:
        """(N, 3) m, mine in the other's frame."""
        return placed(self.mine.points, self._T_other_mine)

    @cached_property
    def _theirs(self) -> Array:
        """(N, 3) m, the other's in mine."""
        return placed(self.other.points, self._T_mine_other)

    @property
    def distance(self) -> float:
        """Least signed distance, m, as the fields have it."""
        found = cloud_distance(self.other.field, self.mine.cloud, self._T_other_mine, np.inf)
        return float(cloud_distance(self.mine.field, self.other.cloud, self._T_mine_other, found))

    def is_nearer(self, limit: float) -> bool:
        """Than a limit, m."""
        mine, other = self.mine, self.other
        return bool(
            nearer_than(other.field, mine.points, self._T_other_mine, limit)
            or nearer_than(mine.field, other.points, self._T_mine_other, limit)
        )

    def passes(self, directions: Array, keep: Keep, travel: Array) -> Array:
        """(D, 2) m: after how far along directions (D, 3) they are too near, and have parted; see `passes`."""
        there = directions @ self.other.T_world_piece[:3, :3]
        here = -(directions @ self._T_world_mine[:3, :3])
        points, theirs = (self._points, self._theirs) if keep.touching else (NONE, NONE)
        mine = Side(self.mine.field, self.mine.cloud, self._T_other_mine, points, there)
        other = Side(self.other.field, self.other.cloud, self._T_mine_other, theirs, here)
        return passes(mine, other, keep, travel)

    def stop(self, screw: Screw, kept: float, length: float) -> float:
        """How far, in the parameter of a motion, mine goes until it is nearer than `kept`, m."""
        found = screw.seen_from(self.other.T_piece_world).travel(self.other.field, self._points, length, kept)
        if len(self._theirs):
            came = screw.seen_from(pose_inverse(self._T_world_mine)).backwards()
            found = came.travel(self.mine.field, self._theirs, found, kept)
        return found


def placed(points: Array, T: Array) -> Array:
    """Points (N, 3), m, placed by T (4, 4)."""
    return np.ascontiguousarray(points @ T[:3, :3].T + T[:3, 3])
