"""A part at a pose, and what it meets from there."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from takeapart.collision.bounds import pass_near
from takeapart.collision.meeting import AT_ONCE
from takeapart.collision.passing import Keep
from takeapart.collision.screws import Screw
from takeapart.model.geometry import Array
from takeapart.removal.endings import bounds_at
from takeapart.removal.pieces import Meeting, Pair, placed
from takeapart.removal.surroundings import FIELD_SLACK, Surroundings


class Stand:
    """A part at a pose, and what it can meet from there.

    Args:
        surroundings: of the product.
        part: its number.
        T_world_part: (4, 4).
    """

    def __init__(self, surroundings: Surroundings, part: int, T_world_part: Array) -> None:
        self.around, self.part, self.T = surroundings, part, T_world_part
        self._meetings: dict[Pair, Meeting] = {}

    @cached_property
    def bounds(self) -> Array:
        """(K, 2, 3) m, of what moves with the part."""
        drawn = self.around.assembly.parts[self.part].T_world_part
        if np.array_equal(self.T[:3, :3], drawn[:3, :3]):
            return self.around.bounds[self.around.of[self.part]] + (self.T[:3, 3] - drawn[:3, 3])
        bounds = []
        for piece in self.around.own(self.part):
            points = placed(piece.points, self.T @ piece.T_owner_piece)
            bounds.append([points.min(axis=0), points.max(axis=0)])
        return np.array(bounds)

    @cached_property
    def cover(self) -> Array:
        """(K, 2, 3) m, bounds of the boxes that cover the part."""
        return bounds_at(self.around.assembly.body(self.part), self.T)

    def meeting(self, mine: int, other: int) -> Meeting:
        """Of two pieces, the first one moves."""
        if (mine, other) not in self._meetings:
            piece = self.around.pieces[mine]
            self._meetings[mine, other] = Meeting(piece, self.T @ piece.T_owner_piece, self.around.pieces[other])
        return self._meetings[mine, other]

    def distance(self, body: int) -> float:
        """Least signed distance from a body, m; of what is far a lower bound."""
        around = self.around
        return min(self.meeting(mine, other).distance for mine in around.of[self.part] for other in around.of[body])

    def stop(self, screw: Screw, length: float, others: Collection[int]) -> float:
        """How far, in the parameter of a motion, the part goes until it is too near to one of other bodies; it may
        touch what it touches as drawn."""
        around, nearest = self.around, length
        for body in others:
            for other in around.of[body]:
                for mine in around.of[self.part]:
                    nearest = self.meeting(mine, other).stop(screw, around.demand(mine, other).kept, nearest)
        return nearest


class Sweeps:
    """What a part meets straight on in several directions, as far as it was asked.

    Args:
        stand: where it starts.
        directions: (D, 3) unit vectors.
        travel: (D,) m, how far it goes at most.
        parted: pieces that touched as drawn, and have come apart before.

    Attributes:
        hits: (D, B) m, after which a body is met; infinite where it is not, or was not asked.
        parted: of each direction the pieces that touched, and after how many m they had come apart.
    """

    def __init__(self, stand: Stand, directions: Array, travel: Array, parted: Collection[Pair] = ()) -> None:
        around = stand.around
        self._stand, self._before, self._travel = stand, frozenset(parted), travel
        self.directions = directions
        self.hits = np.full((len(directions), around.bodies), np.inf)
        self.parted: list[dict[Pair, float]] = [{} for _ in range(len(directions))]
        self._asked = np.zeros((len(directions), around.bodies), bool)
        self._asked[:, stand.part] = True
        self._near = pass_near(stand.bounds, around.bounds, directions, around.clearance + FIELD_SLACK, travel)
        self._met = np.asarray(self._near.any(axis=(0, 1)))  # (P,) whether a piece is near along any

    def ask(self, chosen: NDArray[np.bool_], bodies: Iterable[int]) -> None:
        """What is met of some bodies in the chosen ones of all directions."""
        for body in bodies:
            new = chosen & ~self._asked[:, body]
            self._asked[:, body] |= new
            for pair, asked in self._pairs(new, body):
                self._pass(pair, asked)

    def at_once(self, chosen: NDArray[np.bool_], body: int) -> NDArray[np.bool_]:
        """(D,) whether a body that the part touches is met within `AT_ONCE` in the chosen ones of all directions: this
        costs little, and is no answer to how far."""
        found, travel = np.zeros(len(chosen), bool), min(AT_ONCE, float(self._travel.min(initial=np.inf)))
        for pair, asked in self._pairs(chosen, body):
            kept, touching = self._stand.around.demand(*pair)
            if touching and pair not in self._before:
                meeting = self._stand.meeting(*pair)
                met = meeting.passes(self.directions, Keep(kept, False, 0.0, 0.0), np.where(asked, travel, -1.0))
                found |= met[:, 0] < np.inf
        return found

    def _pairs(self, chosen: NDArray[np.bool_], body: int) -> Iterator[tuple[Pair, NDArray[np.bool_]]]:
        """Pieces of the part and of a body that come near each other, and in which of the chosen directions (D,)."""
        if not chosen.any():
            return
        for other in self._stand.around.of[body]:
            if self._met[other]:
                for k, mine in enumerate(self._stand.around.of[self._stand.part]):
                    near = chosen & self._near[:, k, other]
                    if near.any():
                        yield (mine, other), near

    def _pass(self, pair: Pair, asked: NDArray[np.bool_]) -> None:
        around, (mine, other) = self._stand.around, pair
        demand = around.demand(mine, other)
        kept = around.again if demand.touching and pair in self._before else demand.kept
        keep = Keep(kept, demand.touching and pair not in self._before, around.apart, around.again)
        found = self._stand.meeting(mine, other).passes(self.directions, keep, np.where(asked, self._travel, -1.0))
        body = around.pieces[other].owner
        np.minimum(self.hits[:, body], found[:, 0], out=self.hits[:, body])
        if keep.touching:
            for d in np.flatnonzero(found[:, 1] < np.inf).tolist():
                self.parted[d][pair] = float(found[d, 1])
