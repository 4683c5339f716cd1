"""What the searches share that take edges at their bounds and ask the planner only where it matters."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TypeVar

from takeapart.problem import Guide
from takeapart.removal.bounds import EdgeBounds
from takeapart.search.edge_queries import Edge, EdgeQueries
from takeapart.search.session import Session

Step = TypeVar("Step")


class LazyEdges:
    """Edges under the bounds known so far, and the ways to learn more about them.

    Args:
        session: of the search.
        bounds: of all edges; answers are booked there.
        edge_queries: asks the planner.
        guide: leads descents, and says which of equally uncertain edges is asked first.
        second_look: attempts with which refused parts are planned again before no order is believed to exist; 0
            believes at once.
    """

    def __init__(
        self, session: Session, bounds: EdgeBounds, edge_queries: EdgeQueries, guide: Guide | None, second_look: int
    ) -> None:
        self.session, self.bounds, self.edge_queries, self.guide = session, bounds, edge_queries, guide
        self._second_look = second_look
        self._looked_twice: set[Edge] = set()

    def doubt(self, state: int) -> dict[int, float]:
        """Per candidate, how much worse than the best one the guide takes it to be, m; empty without a guide."""
        if self.guide is None:
            return {}
        values = self.guide([state])[0]
        return {part: max(values.values()) - value for part, value in values.items()}

    def ask_alone(self, smallest: Mapping[int, int]) -> None:
        """Plan every part in the smallest state that it can leave: a lower bound for all its edges.

        Args:
            smallest: per part that state. Where no masks say what may leave, a part may be unable to only because it is
                alone; then it is left out.
        """
        candidates, bounds = self.session.problem.candidates, self.bounds
        self.edge_queries.ask(
            [
                (state, part)
                for part, state in smallest.items()
                if part in candidates(state) and not bounds.is_closed(state, part)
            ]
        )

    def descend(
        self,
        promise: Callable[[int], Mapping[int, float]],
        stands: Callable[[int], bool] | None = None,
    ) -> tuple[list[int], int]:
        """Follow the most promising part from state to state, asking on the way, until none is left or none can leave.

        Parts that were refused come last while what stood in their way is still there, then the guide decides, then the
        promise.

        Args:
            promise: state -> parts that may leave, the least promise first.
            stands: asks whether a state may be entered; by default as the session does.

        Returns:
            the parts in their order, and the state in which the descent ended.
        """
        stands = stands or self.session.stands
        state, order = self.session.problem.root, list[int]()
        blamed: dict[int, int] = {}  # per part that was refused: what stood in its way
        while state:
            promised, doubt = promise(state), self.doubt(state)
            still = {part: not mask & ~state for part, mask in blamed.items()}
            for part in sorted(promised, key=lambda p: (still.get(p, False), doubt.get(p, 0.0), promised[p])):
                if not stands(state & ~(1 << part)):
                    continue
                if not self.bounds.is_closed(state, part):
                    self.edge_queries.ask([(state, part)])
                if math.isfinite(self.bounds.upper(state, part)):
                    break
                if refusal := self.bounds.refusal(state, part):
                    blamed[part] = refusal.blamed
            else:
                return order, state
            order.append(part)
            state &= ~(1 << part)
        return order, state

    def doubtful_refusals(self, dead_ends: Iterable[int]) -> list[Edge]:
        """Edges out of the first of these dead ends that has any that were refused, but not looked at twice."""
        for state in dead_ends if self._second_look else ():
            is_fallen = self.session.standing.is_fallen
            parts = self.session.problem.candidates(state)
            every = [(state, part) for part in parts if not is_fallen(state & ~(1 << part))]
            found = [edge for edge in every if edge not in self._looked_twice]
            if found:
                self._looked_twice.update(found)
                return found
        return []


def telling(steps: Sequence[Step], count: int, uncertainty: Callable[[Step], tuple[float, ...]]) -> list[Step]:
    """Of the steps of a sequence, half the most uncertain ones and half those nearest the goal (see `exact`).

    Args:
        steps: from the root to the goal.
        count: at most so many.
        uncertainty: of a step; what it costs at most less what it costs at least, m, comes first.
    """
    last = count // 2
    near, others = (steps[-last:], steps[:-last]) if last else ((), steps)
    return [*sorted(others, key=uncertainty, reverse=True)[: count - last], *near]
