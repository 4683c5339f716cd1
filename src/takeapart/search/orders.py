"""What the searches without a lattice share: bounds per part, plans in hand, dead ends."""

from __future__ import annotations

import math
from collections.abc import Sequence

from takeapart.model.assembly import members
from takeapart.problem import Guide
from takeapart.removal.bounds import EdgeBounds
from takeapart.search.inquiry import Edge, Inquiry, refusals_in
from takeapart.search.lattice import hindrances
from takeapart.search.mcts import Logbook


class DeadEndError(Exception):
    """A dead end that proves, conditions being monotone, that there is no order; no search lets it out."""


class Orders:
    """Orders of parts under the bounds known so far.

    Args:
        batch: edges asked at a time.
    """

    def __init__(self, log: Logbook, bounds: EdgeBounds, inquiry: Inquiry, batch: int, guide: Guide | None) -> None:
        self.log, self.bounds, self.inquiry, self.batch, self.guide = log, bounds, inquiry, batch, guide
        self.masks = hindrances(log.problem)
        self.smallest = smallest_states(log.problem.root, self.masks)

    def least_costs(self) -> dict[int, float]:
        """Per part what it costs at least wherever it leaves, m."""
        return {part: self.bounds.lower(state, part) for part, state in self.smallest.items()}

    def offer(self, order: Sequence[int]) -> None:
        """Take note of an order with the best removals known by now."""
        state, removals = self.log.problem.root, []
        for part in order:
            removal = self.bounds.best(state, part)
            if removal is None:
                return
            removals.append(removal)
            state &= ~(1 << part)
        self.log.offer(removals, found_episode=self.log.clock.episodes)

    def doubt(self, state: int) -> dict[int, float]:
        """Per candidate, how much worse than the best one the guide takes it to be, m; empty without a guide."""
        if self.guide is None:
            return {}
        values = self.guide([state])[0]
        return {part: max(values.values()) - value for part, value in values.items()}

    def dead_end(self, state: int) -> None:
        """Take note of a state with parts left and none removable, and of what blocks it."""
        self.log.dead_end(state, refusals_in(self.log.problem, self.bounds, state))

    def meet_dead_end(self, state: int) -> None:
        """Take note of a dead end; raises DeadEndError where it proves that there is no order."""
        if self.masks is not None:
            self.dead_end(state)
            raise DeadEndError

    def is_dead_end(self, state: int) -> bool:
        """Whether every part is known to be blocked."""
        return all(math.isinf(self.bounds.lower(state, part)) for part in self.log.problem.candidates(state))

    def telling(self, edges: Sequence[Edge], count: int) -> list[Edge]:
        """Of the edges of a sequence, half the most uncertain ones and half those nearest the goal (see `exact`)."""
        last = count // 2
        near, others = (edges[-last:], edges[:-last]) if last else ([], edges)
        uncertain = sorted(others, key=lambda edge: self.bounds.lower(*edge) - self.bounds.upper(*edge))
        return [*uncertain[: count - last], *near]


def smallest_states(root: int, masks: Sequence[int] | None) -> dict[int, int]:
    """Per part the parts that are present whenever it leaves: itself, and all that must wait for it."""
    if masks is None:
        return {part: 1 << part for part in members(root)}
    waiting_for = {part: 1 << part for part in members(root)}
    changed = True
    while changed:
        changed = False
        for part in waiting_for:
            later = waiting_for[part]
            for other in members(root & ~later):
                if masks[other] & later & root:
                    later |= 1 << other
            if later != waiting_for[part]:
                waiting_for[part], changed = later, True
    return waiting_for
