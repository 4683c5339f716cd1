"""What the searches without a lattice share: bounds per part, plans in hand, dead ends."""

from __future__ import annotations

import math
from collections.abc import Sequence

from takeapart.search.edge_queries import Edge, refusals_in
from takeapart.search.lazy_edges import LazyEdges, telling
from takeapart.states import members


class DeadEndError(Exception):
    """A dead end that proves, conditions being monotone, that there is no order; no search lets it out. One from which
    parts could leave if others did not fall proves nothing."""


class Orders:
    """Orders of parts under the bounds known so far.

    Args:
        batch: edges asked at a time.
    """

    def __init__(self, lazy: LazyEdges, batch: int) -> None:
        self.lazy, self.batch, self.guide = lazy, batch, lazy.guide
        self.session, self.bounds, self.edge_queries = lazy.session, lazy.bounds, lazy.edge_queries
        self.freedom = self.session.problem.freedom
        self.smallest = smallest_states(self.session.problem.root, self.freedom)

    def lower(self, state: int, part: int) -> float:
        """Bound on the cost of an edge, m; infinite where it is blocked or leads where something falls, as is known."""
        return math.inf if self._leads_to_a_fall(state, part) else self.bounds.lower(state, part)

    def upper(self, state: int, part: int) -> float:
        """Cost of an edge by what is known, m; it may lead to a state that was not asked for."""
        return math.inf if self._leads_to_a_fall(state, part) else self.bounds.upper(state, part)

    def is_settled(self, state: int, part: int) -> bool:
        """Whether nothing is left to ask of an edge: neither the planner, nor whether the state behind it stands."""
        return self.bounds.is_closed(state, part) and self.session.standing.known(state & ~(1 << part)) is not None

    def _leads_to_a_fall(self, state: int, part: int) -> bool:
        return self.session.standing.is_fallen(state & ~(1 << part))

    def stand(self, edges: Sequence[Edge]) -> bool:
        """Whether all states behind these edges stand; asks for all of them.

        Raises:
            BudgetSpentError: the time is over.
        """
        return sum(not self.session.stands(state & ~(1 << part)) for state, part in edges) == 0

    def least_costs(self) -> dict[int, float]:
        """Per part what it costs at least wherever it leaves, m."""
        return {part: self.bounds.lower(state, part) for part, state in self.smallest.items()}

    def offer(self, order: Sequence[int]) -> None:
        """Take note of an order with the best removals known by now, if it is one."""
        state, removals = self.session.problem.root, []
        for part in order:
            removal = self.bounds.best(state, part)
            state &= ~(1 << part)
            if removal is None or not self.session.stands(state):
                return
            removals.append(removal)
        self.session.offer(removals, found_episode=self.session.clock.episodes)

    def dead_end(self, state: int) -> None:
        """Take note of a state with parts left and none removable, and of what blocks it."""
        self.session.dead_end(state, refusals_in(self.session.problem, self.bounds, state))

    def meet_dead_end(self, state: int) -> None:
        """Take note of a dead end; raises DeadEndError where it proves that there is no order."""
        if self.freedom is not None and self.session.is_proof(state):
            self.dead_end(state)
            raise DeadEndError

    def is_dead_end(self, state: int) -> bool:
        """Whether every part is known to be blocked, or to be what others would fall without."""
        return all(math.isinf(self.lower(state, part)) for part in self.session.problem.candidates(state))

    def telling(self, edges: Sequence[Edge], count: int) -> list[Edge]:
        """Of the edges of a sequence those that say most, see `takeapart.search.lazy_edges.telling`."""
        return telling(edges, count, lambda edge: (self.bounds.upper(*edge) - self.bounds.lower(*edge),))


def smallest_states(root: int, freedom: Sequence[tuple[int, ...]] | None) -> dict[int, int]:
    """Per part the parts that are present whenever it leaves: itself, and all that must wait for it.

    What is left when all others leave that can while the part stays: each time something leaves, more can, so that it
    does not matter in which order.
    """
    if freedom is None:
        return {part: 1 << part for part in members(root)}
    return {part: _without_all_that_may_leave_before(part, root, freedom) for part in members(root)}


def _without_all_that_may_leave_before(part: int, root: int, freedom: Sequence[tuple[int, ...]]) -> int:
    state, before = root, 0
    while state != before:
        before = state
        for other in members(state & ~(1 << part)):
            if any(not mask & state for mask in freedom[other]):
                state &= ~(1 << other)
    return state
