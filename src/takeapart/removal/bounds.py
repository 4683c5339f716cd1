"""Bounds on the cost of an edge (state, part), from what was planned before (Sec. 2 of the design).

A removal stays valid when more parts are gone, so the best removal of a part in a state is no shorter than in any
subset of that state. Two numbers per edge follow:

- `upper`: length of the shortest removal known that is valid in the state. Always true: that removal can be executed.
- `lower`: the largest of the part's static bound and the costs of its *closed* edges in subsets of the state.

Which of them is a proof: the static bound (the straight line from a grasp candidate to the goal) holds for whatever
planner that takes the same candidates; it is higher than the straight-line bound of the whole plan, which holds for
every grasp in a part's volume (`removal.grasps.volume_bound`). An edge is closed once it was planned with the full
effort; its cost is then what `upper` says there. That is a statement about the planner, not about geometry: a better
planner may find a shorter removal, or one where ours found none. So `lower` and everything summed up from it is
relative to what the planner found. Where the planner contradicts itself (it finds something shorter in a larger state,
and a smaller state allows that too), the closed cost of the smaller state falls.

An edge whose `lower` equals its `upper` needs no planning: it is closed for free where the best removal of a closed
subset is still valid, and known to be blocked where a closed subset is.
"""

from __future__ import annotations

import math
import threading
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

from takeapart.model.errors import InputError
from takeapart.removal.result import Blocked, Removal


@dataclass(frozen=True, eq=False)
class ClosedEdge:
    """An edge that was planned with the full effort.

    Args:
        state: the state in which the part was planned.
        refusal: why it cannot leave, where the planner found nothing at all.
    """

    state: int
    refusal: Blocked | None = None


class EdgeBounds:
    """Removals and closed edges of every part, and the bounds that follow from them.

    Safe to read and write from several threads: a write replaces the tuple that readers hold. The bounds depend on the
    sets of removals and closed edges alone, not on the order in which they came; of two removals that are equal in
    length and blockers the first is kept.

    Args:
        static: per part number a length that no removal of it can fall below, m; 0 where none is known.
    """

    def __init__(self, static: Sequence[float]) -> None:
        for part, length in enumerate(static):
            if not 0 <= length < math.inf:
                raise InputError(f"{length} m; a static bound is finite and not negative", f"static[{part}]")
        self._static = tuple(static)
        self._removals: list[tuple[Removal, ...]] = [()] * len(self._static)
        self._closed: list[tuple[ClosedEdge, ...]] = [()] * len(self._static)
        self._ranked: list[tuple[tuple[float, int], ...]] = [()] * len(self._static)  # cost and state, dearest first
        self._versions = [0] * len(self._static)
        self._falls = 0
        self._lock = threading.Lock()

    def add_removal(self, removal: Removal) -> bool:
        """Remember a removal; False if a known one that is no longer and hits no other part makes it worthless."""
        with self._lock:
            known = self._removals[removal.part]
            if any(k.length <= removal.length and not k.blockers & ~removal.blockers for k in known):
                return False
            kept = [k for k in known if k.length < removal.length or removal.blockers & ~k.blockers]
            kept.insert(bisect_right([k.length for k in kept], removal.length), removal)
            self._removals[removal.part] = tuple(kept)
            self._rank(removal.part)
            return True

    def close(self, state: int, part: int, refusal: Blocked | None = None) -> None:
        """Remember that the part was planned in this state with the full effort; its cost is what `upper` says there.

        Args:
            refusal: the planner's answer, where it found nothing and nothing was known.
        """
        with self._lock:
            known = self._closed[part]
            if any(edge.state == state for edge in known):
                return
            self._closed[part] = (*known, ClosedEdge(state, refusal))
            self._rank(part)

    def _rank(self, part: int) -> None:
        before = {state: cost for cost, state in self._ranked[part]}
        costs = [(self.upper(edge.state, part), edge.state) for edge in self._closed[part]]
        self._falls += any(cost < before.get(state, 0.0) for cost, state in costs)
        self._ranked[part] = tuple(sorted(costs, reverse=True))
        self._versions[part] += 1

    def best(self, state: int, part: int) -> Removal | None:
        """The shortest removal known that is valid in this state."""
        for removal in self._removals[part]:
            if not removal.blockers & state:
                return removal
        return None

    def upper(self, state: int, part: int) -> float:
        """Length of the shortest removal known that is valid in this state, m; infinite if there is none."""
        for removal in self._removals[part]:
            if not removal.blockers & state:
                return removal.length
        return math.inf

    def lower(self, state: int, part: int) -> float:
        """Bound on the cost of the edge, m; infinite where a subset is closed and blocked. Never above `upper`."""
        bound = self._static[part]
        outside = ~state
        for cost, closed in self._ranked[part]:
            if cost <= bound:
                break
            if not closed & outside:
                bound = cost
                break
        return min(bound, self.upper(state, part))

    def static(self, part: int) -> float:
        """Length that no removal of the part with one of its grasp candidates falls below, m."""
        return self._static[part]

    def is_closed(self, state: int, part: int) -> bool:
        """Whether planning this edge cannot change anything: its bounds meet, or it is known to be blocked."""
        return self.lower(state, part) >= self.upper(state, part)

    def removals(self, part: int) -> tuple[Removal, ...]:
        """The removals worth keeping, shortest first."""
        return self._removals[part]

    def closed_edges(self, part: int) -> tuple[ClosedEdge, ...]:
        """The closed edges of a part, in the order in which they were closed."""
        return self._closed[part]

    def refusal(self, state: int, part: int) -> Blocked | None:
        """Why the part cannot leave: the refusal of the largest blocked subset, or None if no subset is blocked."""
        blocked = [
            edge
            for edge in self._closed[part]
            if not edge.state & ~state and edge.refusal is not None and math.isinf(self.upper(edge.state, part))
        ]
        return max(blocked, key=lambda edge: edge.state.bit_count()).refusal if blocked else None

    def version(self, part: int) -> int:
        """Grows whenever a removal or a closed edge of the part is added."""
        return self._versions[part]

    @property
    def falls(self) -> int:
        """How often a closed cost fell; between two equal readings no lower bound fell."""
        return self._falls
