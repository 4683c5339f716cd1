"""Exact search: lazy evaluation on the lattice of reachable states (LazySP, Dellin and Srinivasa 2016).

Every round solves the order of parts twice by dynamic programming: on the lower bounds of all edges, whose optimum no
order can undercut, and on what is known to work, whose optimum is a plan. Then it asks the removal planner for open
edges of the sequence that looks best, until both optima meet. Most edges are never asked for. Then it plans those
edges again, with other seeds, that may still make the sequence shorter (`refinement`), and closes the gap that a
shorter edge may open.

What the numbers are:

- `SearchResult.length` is the length of a sequence of removals in hand: always true.
- `SearchResult.sequence_bound` is relative to what the planner finds. No order of parts is shorter if every edge that
  was asked for costs what the planner made of it, every edge not asked for costs at least as much as the closed edges
  in its subsets, and nothing undercuts the static bounds. With exact edge costs it is the true optimum of the lattice.
  It does not say that a better path planner, or another seed, could not do better; only the straight-line bound of a
  plan holds for all of them.
- `SearchResult.infeasible` likewise: every sequence runs through a part that the planner could not remove, when it was
  asked a second time with more attempts too. Only what gravity and lifting forbid is beyond doubt.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

from takeapart.model.errors import InputError
from takeapart.problem import Guide, Problem
from takeapart.search.best_first import BestFirstOptions, continue_best_first
from takeapart.search.edge_queries import Edge, EdgeQueries, refusals_in
from takeapart.search.lattice import Lattice, TooLarge, enumerate_states
from takeapart.search.lattice_bounds import TOLERANCE, LatticeBounds, SequenceBounds
from takeapart.search.lattice_standing import LatticeStanding
from takeapart.search.lazy_edges import LazyEdges, telling
from takeapart.search.refinement import Refinement, RefinementOptions
from takeapart.search.result import Budget, ProgressListener, SearchResult
from takeapart.search.session import (
    MAXIMUM_REFUSALS,
    SECOND_LOOK,
    BudgetSpentError,
    Session,
    SettledObserver,
    TransitionObserver,
)

MANY_STATES = 500_000
SETTLED_SECONDS = 0.1  # at least, also beyond the limit, to tell what is settled


@dataclass(frozen=True)
class ExactOptions:
    """Options of `exact`.

    Args:
        attempts: how often a removal is planned per query, with different random seeds.
        gap: stop when length <= (1 + gap) * bound; 0 proves the best order for the edge costs known.
        batch: edges asked per round, all chosen before the first is asked; half of them are those with the most
            uncertain cost, half those nearest the goal, whose bounds serve the most states. 0 takes 2 of them, which
            asked the fewest queries on synthetic problems of 21 and 30 parts (the whole sequence took half as many
            again), and 8 from 500,000 states on, where a round costs as much as several queries.
        workers: threads that ask; the result does not depend on it. More than `batch` have nothing to do.
        second_look: attempts with which the parts that block a dead end are planned again before no order is believed
            to exist; 0 believes at once.
        refinement: once the gap is closed.
        state_limit: of the lattice; a state with 10 candidates takes about 350 bytes. Beyond, best-first search
            takes over.
        best_first: its options.
    """

    attempts: int = 1
    gap: float = 0.0
    batch: int = 0
    workers: int = 1
    second_look: int = SECOND_LOOK.attempts
    refinement: RefinementOptions = field(default_factory=RefinementOptions)
    state_limit: int = 2_000_000
    best_first: BestFirstOptions = field(default_factory=BestFirstOptions)

    def __post_init__(self) -> None:
        for name, least in (("attempts", 1), ("batch", 0), ("workers", 1), ("second_look", 0)):
            if getattr(self, name) < least:
                raise InputError(f"{getattr(self, name)}; must be at least {least}", f"exact.{name}")
        if not 0 <= self.gap < math.inf:
            raise InputError(f"{self.gap}; must be at least 0 and finite", "exact.gap")


def exact(
    problem: Problem,
    options: ExactOptions,
    budget: Budget,
    listen: ProgressListener | None = None,
    guide: Guide | None = None,
    observe: TransitionObserver | None = None,
    observe_settled: SettledObserver | None = None,
) -> SearchResult:
    """The best order of parts, and the proof of it, for the edge costs that the removal planner finds.

    Args:
        problem: with `freedom` states are enumerated by compiled code.
        budget: an episode is a round.
        guide: leads the first descent, and says which of several unknown edges is asked first.
        observe_settled: is told in the end the known removals in all states of which the cost to the goal is known; as
            many of them as the time allows, those of large states first.

    Returns:
        best sequence, its length and `sequence_bound`; where there is no order, `infeasible` and the deepest dead ends
        as refusals. The statistics "closed_length" and "closed_queries" are those of the moment in which the gap was
        closed for the first time, "passes" those of the refinement.
    """
    session = Session(problem, budget, listen, observe)
    search: _LazySearch | None = None
    interrupted = False
    try:
        lattice = enumerate_states(problem, options.state_limit, session.clock.late)
        if isinstance(lattice, TooLarge):
            return continue_best_first(session, options.best_first, guide)
        if lattice is None:
            raise BudgetSpentError
        bounds = problem.edge_bounds
        with EdgeQueries(session, bounds, options.attempts, options.workers) as edge_queries:
            lazy = LazyEdges(session, bounds, edge_queries, guide, options.second_look)
            search = _LazySearch(lazy, lattice, options)
            search.run()
    except BudgetSpentError:
        pass
    except KeyboardInterrupt:
        interrupted = True
    if search is None:
        return session.result(interrupted)
    search.settle()
    told_until = session.clock.seconds + SETTLED_SECONDS
    if observe_settled is not None:
        for row, edge, part, cost, least, most in search.sequences.settled_edges():
            state, following = search.lattice.state(row), search.lattice.state(int(search.lattice.child[edge]))
            observe_settled(state, part, -cost, following, problem.candidates(following), least, most)
            if session.clock.late() and session.clock.seconds > told_until:
                break
    return session.result(interrupted, session.bound if 0 <= session.bound < math.inf else None)


class _LazySearch:
    """One run on a lattice."""

    def __init__(self, lazy: LazyEdges, lattice: Lattice, options: ExactOptions) -> None:
        self.lazy, self.lattice, self.options = lazy, lattice, options
        self.session, self.bounds, self.edge_queries = lazy.session, lazy.bounds, lazy.edge_queries
        session, bounds = self.session, self.bounds
        session.look_at_clock()
        edges = LatticeBounds(lattice, bounds)
        self.standing = LatticeStanding(lattice, session)
        self.sequences = SequenceBounds(lattice, edges, self.standing)
        self.refinement = Refinement(
            lattice, bounds, edges, self.standing, options.attempts, options.refinement, session.look_at_clock
        )
        session.look_at_clock()

    def run(self) -> None:
        """Until the gap is closed and refinement is no longer worth it, or no order is left.

        Raises:
            BudgetSpentError: that takes too long.
        """
        session = self.session
        if self.lattice.goal >= 0:  # else gravity and lifting alone allow no order, whatever the planner says
            self.lazy.ask_alone(self.lattice.smallest_states())
        self.settle()
        if math.isinf(session.best[0]):
            self.descend()
        attempts: int | list[int]
        while True:
            self.settle()
            if not self.standing.always and self.session.bound < self.session.best[0]:
                self.sequences.find_standing(session.best[0] - TOLERANCE)
                self.settle()
            if math.isinf(self.sequences.lower):
                batch, attempts = self.lazy.doubtful_refusals(self.dead_ends()), self.options.second_look
            elif session.best[0] <= (1 + self.options.gap) * session.bound + TOLERANCE:
                session.statistics.setdefault("closed_length", session.best[0])
                session.statistics.setdefault("closed_queries", session.clock.queries)
                batch = self.refinement.edges(session.best[0], self.batch, session.clock.queries)
                attempts = [self.refinement.attempts(edge) for edge in batch]
            else:
                batch, attempts = self.most_telling(), self.options.attempts
            if not batch:
                return
            self.edge_queries.ask(batch, attempts)
            session.clock.episodes += 1

    @property
    def batch(self) -> int:
        """Edges asked per round."""
        return self.options.batch or (2 if len(self.lattice.states) < MANY_STATES else 8)

    def settle(self) -> None:
        """Bring bounds, best sequence and refusals up to date with all that was learned, and report."""
        session, sequences = self.session, self.sequences
        started = session.clock.seconds
        sequences.update()
        session.clock.reserve = max(
            session.clock.reserve, session.clock.seconds - started
        )  # the last one takes about as long
        if sequences.upper < session.best[0]:
            removals = [self.bounds.best(self.lattice.state(row), part) for row, _, part in sequences.best_known()]
            session.offer([each for each in removals if each is not None], found_episode=session.clock.episodes)
        session.bound = min(sequences.lower, session.best[0])
        session.dead_ends.clear()
        if math.isinf(session.bound):
            for row in sequences.dead_ends(MAXIMUM_REFUSALS):
                state = self.lattice.state(row)
                session.dead_end(state, refusals_in(session.problem, self.bounds, state))
        session.infeasible = math.isinf(session.bound)
        session.statistics |= {
            "states": len(self.lattice.states),
            "edges": len(self.lattice.child),
            "states_left": len(sequences.rows),
            "passes": self.refinement.passes,
        }
        session.report()

    def dead_ends(self) -> Iterator[int]:
        """Dead ends of which a doubtful refusal may be the cause. If every state stands, those told are enough: each of
        them says that there is no order.
        """
        if self.standing.always:
            yield from self.session.dead_ends
        else:
            yield from (self.lattice.state(row) for row in self.sequences.dead_ends(None, only_standing=False))

    def descend(self) -> None:
        """Follow the most promising part from state to state, so that there is a plan early; ends at a dead end."""
        rows = {self.session.problem.root: 0}

        def promise(state: int) -> dict[int, float]:
            edges = {self.lattice.part(edge): edge for edge in self.lattice.edges(rows[state])}
            rows.update({state & ~(1 << part): int(self.lattice.child[edge]) for part, edge in edges.items()})
            through = {part: self.sequences.bound_through(edge) for part, edge in edges.items()}
            return {part: bound for part, bound in through.items() if math.isfinite(bound)}

        self.lazy.descend(promise, lambda state: self.standing.ask(rows[state]))

    def most_telling(self) -> list[Edge]:
        """Open edges of the sequence that looks best."""
        sequences = self.sequences
        open_edges = [(row, edge, part) for row, edge, part in sequences.most_promising() if sequences.is_open(edge)]

        def uncertainty(step: tuple[int, int, int]) -> tuple[float, float]:
            row, edge, part = step
            return sequences.uncertainty(edge), self.lazy.doubt(self.lattice.state(row)).get(part, 0.0)

        chosen = telling(open_edges, self.batch, uncertainty)
        return [(self.lattice.state(row), part) for row, _, part in chosen]
