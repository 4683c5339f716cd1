"""What stands around a part, and how near the part may come to it on its way out.

What is further away than the clearance as drawn stays so. What is nearer, or overlaps, may do so as deep as the
tolerance of the pair until the two have come apart once; from there on the clearance counts for them too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from takeapart.collision.contact import MARGIN, Contacts, body_of
from takeapart.collision.sweep import LEAST_STEP
from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Array, Box, OrientedBox
from takeapart.removal.margins import PLANNING_MARGIN
from takeapart.removal.pieces import Demand, Meeting, Pair, Piece
from takeapart.removal.poses import close_poses

ON_OBSTACLE = 1e-4  # m, by which a part may come nearer to an obstacle on which it lies
SLACK = 5e-5  # m, less than the clearance: what stands as far off as that as drawn may stay there
STANDING = 1e-5  # m, by which what stands at about the clearance may come nearer
NOISE = 3e-5  # m, around the clearance: two bodies part above, and are too near again below
FIELD_SLACK = 1e-3  # m, by which fields may tell what is far as nearer
LOOK_STEP = 1e-3  # m; no point of a part moves further between two poses of its way that are looked at

BETWEEN_LOOKS = LEAST_STEP / 2  # m, by which overlaps exceed what is tolerated where motions are looked at in steps


class Surroundings:
    """All surfaces of a product and its cell.

    Args: as of `Exits`.

    Attributes:
        again: m, kept from what has been touched and left.
        apart: m; what touched counts as left from here on.
        bounds: (P, 2, 3) m, of all pieces.
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
        self.bounds = np.array([piece.bounds for piece in self.pieces]).reshape(-1, 2, 3)
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
        elif self._far_apart(first, second):
            return Demand(self.clearance, False)
        else:
            distance = Meeting(first, first.T_world_piece, second).distance
            deepest = min(0.0, distance) - MARGIN if second.owner < self.parts else distance - ON_OBSTACLE
        if distance > self.clearance:
            return Demand(self.clearance, False)
        least = self.clearance - PLANNING_MARGIN - SLACK
        if distance < least:
            return Demand(deepest, True)
        measured = Meeting(first, first.T_world_piece, second).distance if shapes else distance
        return Demand(min(least, measured - STANDING), False)

    def _far_apart(self, first: Piece, second: Piece) -> bool:
        far = self.clearance + FIELD_SLACK
        return bool(
            (first.bounds[1] + far < second.bounds[0]).any() or (second.bounds[1] + far < first.bounds[0]).any()
        )

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
                    meeting = Meeting(self.pieces[mine], T @ self.pieces[mine].T_owner_piece, piece)
                    kept = self.again if demand.touching and pair in parted else demand.kept
                    if meeting.is_nearer(kept - (BETWEEN_LOOKS if demand.touching and kept <= 0.0 else 0.0)):
                        met.add(piece.owner)
                    elif demand.touching and pair not in parted and not meeting.is_nearer(self.apart):
                        parted.add(pair)
        return met

    def own(self, part: int) -> list[Piece]:
        """What moves with a part."""
        return [self.pieces[number] for number in self.of[part]]


def _homogeneous(points: Array) -> Array:
    return np.vstack([points.T, np.ones(len(points))])


def _bounds_of(T: Array, points: Array) -> tuple[Array, Array]:
    placed = T[:3, :3] @ points + T[:3, 3:]
    return placed.min(axis=1), placed.max(axis=1)
