"""Best-first search for assemblies with too many reachable states to enumerate.

First a descent for a plan at once, then lazy beams, which improve it at few queries, then lazy weighted A* (Cohen,
Phillips and Likhachev 2014): states wait in the order of g + w h, where g is the length so far, h the sum of what every
remaining part costs at least, and w >= 1 the suboptimality factor. An edge is planned only when the state behind it
comes first by its lower bound. A guide's estimate of the rest takes the place of w h, cut to what lies between h and
w h: that keeps the factor w true. Sweeps with falling w (restarting weighted A*, Richter, Thayer and Ruml 2010)
improve the plan; what earlier sweeps asked for is free.

Which bounds are proofs: as in `exact`, `sequence_bound` is relative to what the planner finds (see there). It is the
greatest of four: h at the root; length / w after a sweep that came to its end; the least g + h of all states that wait
in the sweep with w = 1; and the same of a sweep with w = 1 that takes every edge at its lower bound and asks
nothing, which is run when the others are done or the budget is spent; of a limited time a tenth is kept for it. The
second and third hold only if no closed cost fell meanwhile, and are dropped otherwise. Lazy beams give plans, never
bounds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

from takeapart.model.errors import InputError
from takeapart.problem import Guide, Problem
from takeapart.search.edge_queries import EdgeQueries
from takeapart.search.lattice_bounds import TOLERANCE
from takeapart.search.lazy_beam import lazy_beam
from takeapart.search.lazy_edges import LazyEdges
from takeapart.search.orders import DeadEndError, Orders
from takeapart.search.result import Budget, ProgressListener, SearchResult
from takeapart.search.session import MAXIMUM_REFUSALS, SECOND_LOOK, BudgetSpentError, Session, TransitionObserver
from takeapart.search.weighted_astar import WeightedAStar

BOUND_SHARE = 0.1  # of a limited time, kept for the final sweep


@dataclass(frozen=True)
class BestFirstOptions:
    """Options of `best_first`.

    Args:
        beams: widths of the lazy beams.
        weights: suboptimality factors w of the sweeps, falling, at least 1. With 1 at the end, a search that is not cut
            short ends with the best order for the edge costs known.
        attempts: how often a removal is planned per query, with different random seeds.
        batch: edges asked at a time.
        workers: threads that ask; the result does not depend on it.
        second_look: attempts with which refused parts are planned again before no order is believed to exist.
        memory_limit: waiting and visited states of a sweep, about 300 bytes each; a sweep that exceeds it is given up.
        bound_states: states that the final sweep for the bound may expand.
    """

    beams: tuple[int, ...] = (4, 16, 64)
    weights: tuple[float, ...] = (1.5, 1.2, 1.1, 1.05, 1.02, 1.0)
    attempts: int = 1
    batch: int = 2
    workers: int = 1
    second_look: int = SECOND_LOOK.attempts
    memory_limit: int = 4_000_000
    bound_states: int = 5_000

    def __post_init__(self) -> None:
        for name, least in (
            ("attempts", 1),
            ("batch", 1),
            ("workers", 1),
            ("second_look", 0),
            ("memory_limit", 1),
            ("bound_states", 1),
        ):
            if getattr(self, name) < least:
                raise InputError(f"{getattr(self, name)}; must be at least {least}", f"best_first.{name}")
        if any(width < 1 for width in self.beams):
            raise InputError(f"{self.beams}; every width must be at least 1", "best_first.beams")
        falling = all(a > b for a, b in zip(self.weights, self.weights[1:], strict=False))
        if not self.weights or not falling or self.weights[-1] < 1 or math.isinf(self.weights[0]):
            raise InputError(f"{self.weights}; must be finite, falling, and at least 1", "best_first.weights")


def best_first(
    problem: Problem,
    options: BestFirstOptions,
    budget: Budget,
    listen: ProgressListener | None = None,
    guide: Guide | None = None,
    observe: TransitionObserver | None = None,
) -> SearchResult:
    """A good order of parts with a bound, without enumerating states.

    Args:
        problem: with `freedom` conditions are known to be monotone, and the first dead end proves that there is no
            order.
        budget: an episode is a beam or a sweep.
        guide: leads the first descent, and the sweeps as far as their factor allows.

    Returns:
        as `exact`; the statistic "weight" is the factor w of the last sweep that ended with a plan.
    """
    return continue_best_first(Session(problem, budget, listen, observe), options, guide)


def continue_best_first(session: Session, options: BestFirstOptions, guide: Guide | None = None) -> SearchResult:
    """The same in a session that was opened before: its clock goes on."""
    if math.isfinite(session.clock.budget.seconds):
        session.clock.reserve = BOUND_SHARE * session.clock.budget.seconds
    bounds = session.problem.edge_bounds
    with EdgeQueries(session, bounds, options.attempts, options.workers) as edge_queries:
        lazy = LazyEdges(session, bounds, edge_queries, guide, options.second_look)
        search = _BestFirst(Orders(lazy, options.batch), options)
        interrupted = session.run(search.run)
    search.settle()
    return session.result(interrupted, session.bound if 0 <= session.bound < math.inf else None)


class _BestFirst:
    """One run: descent, lazy beams, sweeps, bound."""

    def __init__(self, orders: Orders, options: BestFirstOptions) -> None:
        self.orders, self.options = orders, options
        self.lazy, self.session = orders.lazy, orders.session
        self.bounds, self.edge_queries = orders.bounds, orders.edge_queries
        self.falls = -1  # of the bounds, when session.bound was last raised
        self.sweep: WeightedAStar | None = None

    def run(self) -> None:
        """Until the order is proved best, no order is left, the weights are used up, or memory is."""
        self.lazy.ask_alone(self.orders.smallest)
        while not self.attempt():
            refused = self.lazy.doubtful_refusals(self.dead_ends())
            if not refused:
                self.session.infeasible = True
                return
            self.edge_queries.ask(refused, self.options.second_look)

    def dead_ends(self) -> Iterator[int]:
        """Dead ends of which a doubtful refusal may be the cause. If every state stands, those told are enough: each of
        them says that there is no order.
        """
        yield from sorted(self.session.dead_ends, key=int.bit_count)
        if self.sweep is not None and not self.session.standing.always:
            yield from (state for state in sorted(self.sweep.g) if self.orders.is_dead_end(state))

    def attempt(self) -> bool:
        """Descend, improve, and prove; False at dead ends that leave no order."""
        self.session.dead_ends.clear()
        for part, cost in self.orders.least_costs().items():
            if math.isinf(cost):
                self.orders.dead_end(self.orders.smallest[part])
        if self.session.dead_ends:
            return False
        self.refresh_bound()
        try:
            if math.isinf(self.session.best[0]):
                self.descend()
            for width in self.options.beams:
                lazy_beam(self.orders, width)
                self.session.clock.episodes += 1
                self.refresh_bound()
                self.session.report()
            return self.prove()
        except DeadEndError:
            return False

    def prove(self) -> bool:
        """Sweeps with falling weights; False if there is no order."""
        remaining = list(self.options.weights)
        while remaining:
            self.refresh_bound()
            weight = remaining.pop(0)
            if self.session.best[0] <= weight * self.session.bound + TOLERANCE:
                continue
            falls = self.bounds.falls
            self.sweep = WeightedAStar(self.orders, weight, lazy=True)
            ended = self.sweep.run(self.options.memory_limit, None)
            self.session.clock.episodes += 1
            if not ended:
                self.session.statistics["out_of_memory"] = 1.0
                return True
            if math.isinf(self.session.best[0]):
                self.find_dead_ends(self.sweep)
                return False
            self.session.statistics["weight"] = weight
            self.raise_bound(self.session.best[0] / weight, falls)
            if weight == 1.0 and falls != self.bounds.falls:
                remaining = [weight]  # what a falling cost may have hidden is looked for again
            self.session.report()
        return True

    def settle(self) -> None:
        """The bound that all that was learned allows, once the search has ended for whatever reason."""
        if self.sweep is not None and self.sweep.weight == 1.0:
            self.raise_bound(self.sweep.least(), self.sweep.falls)
        self.refresh_bound()
        if self.session.infeasible:
            self.session.bound = math.inf
        elif self.session.bound < self.session.best[0] - TOLERANCE:
            final = WeightedAStar(self.orders, 1.0, lazy=False)
            with suppress(DeadEndError):
                with suppress(BudgetSpentError):  # whenever it ends, what waits tells a bound
                    final.run(self.options.memory_limit, self.options.bound_states)
                self.raise_bound(final.least(), final.falls)
        self.session.report()

    def refresh_bound(self) -> None:
        """Drop the bound if a closed cost fell since it was found; h at the root always holds."""
        if self.falls != self.bounds.falls:
            self.falls, self.session.bound = self.bounds.falls, -math.inf
        self.raise_bound(sum(self.orders.least_costs().values()), self.falls)

    def raise_bound(self, bound: float, falls: int) -> None:
        """Take a bound that was found after so many falls; no bound is above the best length."""
        if falls == self.bounds.falls:
            before = self.session.bound if self.falls == falls else -math.inf
            self.falls, self.session.bound = falls, min(max(before, bound), self.session.best[0])

    def descend(self) -> None:
        """Follow the part that costs least more than it must (or that the guide prefers) until a plan is found."""
        least = self.orders.least_costs()

        def excess(state: int) -> dict[int, float]:
            candidates = self.session.problem.candidates(state)
            return {part: self.bounds.lower(state, part) - least[part] for part in candidates}

        order, left = self.lazy.descend(excess)
        if left:
            self.orders.meet_dead_end(left)
        else:
            self.orders.offer(order)

    def find_dead_ends(self, sweep: WeightedAStar) -> None:
        """Take note of the deepest dead ends that a sweep without a plan has visited."""
        for state in sorted(sweep.g, key=lambda state: (state.bit_count(), state)):
            if self.orders.is_dead_end(state):
                self.orders.dead_end(state)
                if len(self.session.dead_ends) == MAXIMUM_REFUSALS:
                    return
