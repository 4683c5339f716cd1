"""What stands around a part, and how near the part may come to it on its way out.

What is further away than the clearance as drawn stays so. What is nearer, or overlaps, may do so as deep as the
tolerance of the pair until the two have come apart once; from there on the clearance counts for them too.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from takeapart.collision.bounds import overlaps_along
from takeapart.collision.contact import MARGIN, Contacts, body_of
from takeapart.collision.fields import Field
from takeapart.collision.meeting import cloud_distance, cloud_hit
from takeapart.collision.parting import nearer_than, parted_after
from takeapart.collision.points import Cloud
from takeapart.collision.screws import Screw
from takeapart.collision.sweep import LEAST_STEP
from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Array, Box, OrientedBox, pose_inverse
from takeapart.removal.margins import PLANNING_MARGIN
from takeapart.removal.poses import close_poses

ON_OBSTACLE = 1e-4  # m, by which a part may come nearer to an obstacle on which it lies
SLACK = 5e-5  # m, less than the clearance: what stands as far off as that as drawn may stay there
STANDING = 1e-5  # m, by which what stands at about the clearance may come nearer
NOISE = 3e-5  # m, around the clearance: two bodies part above, and are too near again below
FIELD_SLACK = 1e-3  # m, by which fields may tell what is far as nearer
LOOK_STEP = 1e-3  # m; no point of a part moves further between two poses of its way that are looked at

BETWEEN_LOOKS = LEAST_STEP / 2  # m, by which overlaps exceed what is tolerated where motions are looked at in steps

Pair = tuple[int, int]  # numbers of two pieces


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


class Demand(NamedTuple):
    """How near two pieces may come, m; negative where they may overlap."""

    kept: float
    touching: bool  # only until they have parted


class Sweep(NamedTuple):
    """What a part meets along a direction."""

    hits: list[tuple[int, float]]  # body, and after how many m; each once
    parted: dict[Pair, float]  # pieces that touched, and after how many m they had come apart


class Surroundings:
    """All surfaces of a product and its cell.

    Args: as of `Exits`.

    Attributes:
        again: m, kept from what has been touched and left.
        apart: m; what touched counts as left from here on.
    """

    def __init__(
        self, assembly: Assembly, contacts: Contacts, obstacles: Sequence[OrientedBox], clearance: float
    ) -> None:
        self.assembly, self._contacts, self.clearance = assembly, contacts, clearance
        self.parts, self.bodies = len(assembly.parts), len(assembly.parts) + len(obstacles)
        self.again, self.apart = clearance - PLANNING_MARGIN - NOISE, clearance - PLANNING_MARGIN + NOISE
        self.pieces: list[Piece] = []
        for number, part in enumerate(assembly.parts):
            body, T = contacts.body(number), part.T_world_part
            self.pieces.append(Piece(number, body.field, body.cloud, np.eye(4), T, contacts.bounds[number]))
            for wall in assembly.body(number)[len(part.shape.boxes()) :]:
                body, T_wall = body_of(Box((2 * wall.half_extents).tolist())), T @ wall.T_frame_box
                bounds = body.surface.moved(T_wall).bounds
                self.pieces.append(Piece(number, body.field, body.cloud, wall.T_frame_box, T_wall, bounds))
        for k, box in enumerate(obstacles):
            corners, T = box.corners(), box.T_frame_box
            body = body_of(Box((2 * box.half_extents).tolist()))
            bounds = np.array([corners.min(axis=0), corners.max(axis=0)])
            self.pieces.append(Piece(self.parts + k, body.field, body.cloud, T, T, bounds))
        self.of: list[list[int]] = [[] for _ in range(self.bodies)]
        for number, piece in enumerate(self.pieces):
            self.of[piece.owner].append(number)
        self._demands: dict[Pair, Demand] = {}

    def never_leaves(self, body: int) -> bool:
        """Whether a body is a fixed part or an obstacle."""
        return body >= self.parts or self.assembly.parts[body].fixed

    def demand(self, mine: int, other: int) -> Demand:
        """How near two pieces may come on the way out of the first one's part."""
        if (mine, other) not in self._demands:
            self._demands[mine, other] = self._demand(mine, other)
        return self._demands[mine, other]

    def _demand(self, mine: int, other: int) -> Demand:
        first, second = self.pieces[mine], self.pieces[other]
        shapes = mine == self.of[first.owner][0] and other == self.of[second.owner][0] and second.owner < self.parts
        if shapes:
            found = self._contacts.finding(first.owner, second.owner)
            distance = math.inf if found is None else found.gap - found.depth
            deepest = -self._contacts.tolerance(first.owner, second.owner)
        else:
            distance = _Meeting(first, first.T_world_piece, second).distance
            deepest = min(0.0, distance) - MARGIN if second.owner < self.parts else distance - ON_OBSTACLE
        if distance > self.clearance:
            return Demand(self.clearance, False)
        least = self.clearance - PLANNING_MARGIN - SLACK
        if distance < least:
            return Demand(deepest, True)
        measured = _Meeting(first, first.T_world_piece, second).distance if shapes else distance
        return Demand(min(least, measured - STANDING), False)

    def stand(self, part: int, T_world_part: Array) -> Stand:
        """A part at a pose."""
        return Stand(self, part, T_world_part)

    def met(self, part: int, poses: Array) -> set[int]:
        """Bodies that a part comes too near to on its way through poses (K, 4, 4), looked at every `LOOK_STEP`."""
        points = np.concatenate([piece.T_owner_piece[:3] @ _homogeneous(piece.points) for piece in self.own(part)], 1)
        radius = float(np.linalg.norm(points, axis=0).max())
        met: set[int] = set()
        parted: set[Pair] = set()
        for T in close_poses(poses, LOOK_STEP, radius):
            low, high = _bounds_of(T, points)
            for other, piece in enumerate(self.pieces):
                if piece.owner == part or piece.owner in met:
                    continue
                near = self.apart + NOISE
                if (piece.bounds[0] > high + near).any() or (piece.bounds[1] < low - near).any():
                    parted.update((mine, other) for mine in self.of[part])
                    continue
                for mine in self.of[part]:
                    demand, pair = self.demand(mine, other), (mine, other)
                    meeting = _Meeting(self.pieces[mine], T @ self.pieces[mine].T_owner_piece, piece)
                    kept = self.again if demand.touching and pair in parted else demand.kept
                    if meeting.is_nearer(kept - (BETWEEN_LOOKS if demand.touching and kept <= 0.0 else 0.0)):
                        met.add(piece.owner)
                    elif demand.touching and pair not in parted and not meeting.is_nearer(self.apart):
                        parted.add(pair)
        return met

    def own(self, part: int) -> list[Piece]:
        """What moves with a part."""
        return [self.pieces[number] for number in self.of[part]]


class _Meeting:
    """Two pieces, one of them at a pose."""

    def __init__(self, mine: Piece, T_world_mine: Array, other: Piece) -> None:
        self.mine, self.other = mine, other
        self._T_other_mine = pose_inverse(other.T_world_piece) @ T_world_mine
        self._T_mine_other = pose_inverse(self._T_other_mine)
        self._R_other, self._R_mine = other.T_world_piece[:3, :3].T, T_world_mine[:3, :3].T
        self._T_world_mine = T_world_mine

    @cached_property
    def _points(self) -> Array:
        """(N, 3) m, mine in the other's frame."""
        return _placed(self.mine.points, self._T_other_mine)

    @cached_property
    def _theirs(self) -> Array:
        """(N, 3) m, the other's in mine."""
        return _placed(self.other.points, self._T_mine_other)

    @property
    def distance(self) -> float:
        """Least signed distance, m, as the fields have it."""
        found = cloud_distance(self.other.field, self.mine.cloud, self._T_other_mine, math.inf)
        return float(cloud_distance(self.mine.field, self.other.cloud, self._T_mine_other, found))

    def is_nearer(self, limit: float) -> bool:
        """Than a limit, m."""
        mine, other = self.mine, self.other
        return bool(
            nearer_than(other.field, mine.points, self._T_other_mine, limit)
            or nearer_than(mine.field, other.points, self._T_mine_other, limit)
        )

    def hit(self, direction: Array, kept: float, travel: float, start: float = 0.0) -> float:
        """How far mine goes along a direction, after `start`, until it is nearer than `kept`; all in m."""
        there, here = self._R_other @ direction, -(self._R_mine @ direction)
        T_there, T_here = self._T_other_mine.copy(), self._T_mine_other.copy()
        T_there[:3, 3] += start * there
        T_here[:3, 3] += start * here
        found = cloud_hit(self.other.field, self.mine.cloud, T_there, there, kept, travel - start)
        limit = min(travel - start, found)
        return start + min(found, cloud_hit(self.mine.field, self.other.cloud, T_here, here, kept, limit))

    def parts(self, direction: Array, apart: float, travel: float) -> float:
        """How far mine goes until nothing of it is nearer than `apart`; infinite if it never is within `travel`."""
        there, here, s = self._R_other @ direction, -(self._R_mine @ direction), 0.0
        while True:
            first = parted_after(self.other.field, self._points, there, s, apart, travel)
            if not len(self._theirs) or first == math.inf:
                return float(first)
            second = parted_after(self.mine.field, self._theirs, here, first, apart, travel)
            if second == first or second == math.inf:
                return float(second)
            s = second

    def stop(self, screw: Screw, kept: float, length: float) -> float:
        """How far, in the parameter of a motion, mine goes until it is nearer than `kept`, m."""
        found = screw.seen_from(pose_inverse(self.other.T_world_piece)).travel(
            self.other.field, self._points, length, kept
        )
        if len(self._theirs):
            came = screw.seen_from(pose_inverse(self._T_world_mine)).backwards()
            found = came.travel(self.mine.field, self._theirs, found, kept)
        return found


class Stand:
    """A part at a pose, and what it can meet from there.

    Args:
        surroundings: of the product.
        part: its number.
        T_world_part: (4, 4).
    """

    def __init__(self, surroundings: Surroundings, part: int, T_world_part: Array) -> None:
        self._around, self.part, self.T = surroundings, part, T_world_part
        self._meetings: dict[Pair, _Meeting] = {}

    @cached_property
    def bounds(self) -> Array:
        """(2, 3) m, of the part."""
        around = self._around
        points = np.concatenate(
            [_placed(piece.points, self.T @ piece.T_owner_piece) for piece in around.own(self.part)]
        )
        return np.array([points.min(axis=0), points.max(axis=0)])

    def _meeting(self, mine: int, other: int) -> _Meeting:
        if (mine, other) not in self._meetings:
            piece = self._around.pieces[mine]
            self._meetings[mine, other] = _Meeting(piece, self.T @ piece.T_owner_piece, self._around.pieces[other])
        return self._meetings[mine, other]

    def distance(self, body: int) -> float:
        """Least signed distance from a body, m; of what is far a lower bound."""
        around = self._around
        return min(self._meeting(mine, other).distance for mine in around.of[self.part] for other in around.of[body])

    def sweep(self, direction: Array, travel: float, parted: Collection[Pair] = ()) -> Sweep:
        """What the part meets along a direction (3,) within `travel`, m.

        Args:
            parted: pieces that touched as drawn, and have come apart before.
        """
        around, own = self._around, self.bounds[None]
        hits: dict[int, float] = {}
        apart: dict[Pair, float] = {}
        for other, piece in enumerate(around.pieces):
            if piece.owner == self.part:
                continue
            near = overlaps_along(own, piece.bounds[None], direction, around.clearance + FIELD_SLACK)
            if not len(near) or near[0, 0] > travel:
                continue
            for mine in around.of[self.part]:
                hit, separate = self._along((mine, other), direction, travel, parted)
                if separate < math.inf:
                    apart[mine, other] = separate
                if hit < hits.get(piece.owner, math.inf):
                    hits[piece.owner] = hit
        return Sweep(list(hits.items()), apart)

    def _along(self, pair: Pair, direction: Array, travel: float, parted: Collection[Pair]) -> tuple[float, float]:
        """After how many m two pieces are too near, and after how many they have come apart."""
        demand, meeting = self._around.demand(*pair), self._meeting(*pair)
        if not demand.touching:
            return meeting.hit(direction, demand.kept, travel), math.inf
        if pair in parted:
            return meeting.hit(direction, self._around.again, travel), math.inf
        hit = meeting.hit(direction, demand.kept, travel)
        separate = meeting.parts(direction, self._around.apart, min(travel, hit))
        if separate < hit:
            hit = min(hit, meeting.hit(direction, self._around.again, travel, separate))
        return hit, separate

    def stop(self, screw: Screw, length: float, others: Collection[int]) -> float:
        """How far, in the parameter of a motion, the part goes until it is too near to one of other bodies; it may
        touch what it touches as drawn."""
        around, nearest = self._around, length
        for body in others:
            for other in around.of[body]:
                for mine in around.of[self.part]:
                    nearest = self._meeting(mine, other).stop(screw, around.demand(mine, other).kept, nearest)
        return nearest


def _placed(points: Array, T: Array) -> Array:
    return np.ascontiguousarray(points @ T[:3, :3].T + T[:3, 3])


def _homogeneous(points: Array) -> Array:
    return np.vstack([points.T, np.ones(len(points))])


def _bounds_of(T: Array, points: Array) -> tuple[Array, Array]:
    placed = T[:3, :3] @ points + T[:3, 3:]
    return placed.min(axis=1), placed.max(axis=1)
