"""Simple searches to compare with: a random order, greedy, random restarts, beam.

All of them share the removal library of the problem, so that they are compared with MCTS and exact search by what they
choose to ask. Where every condition is monotone (fewer parts never hinder: gravity by connectors, lifting, collision),
a feasible problem has no dead ends: a feasible order without the parts that are gone goes on from every state. The
first dead end then proves that no order exists, which `monotone` makes use of.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from takeapart.model.errors import InputError
from takeapart.problem import Guide, Problem
from takeapart.removal.result import Blocked, Effort, Removal
from takeapart.search.result import Budget, ProgressListener, SearchResult
from takeapart.search.session import BudgetSpentError, Session

Successors = Callable[[int], Iterator[Removal]]
"""State -> its removals in the order in which a depth-first search tries them."""


@dataclass(frozen=True)
class OrderOptions:
    """Options of `random_order` and `greedy`.

    Args:
        attempts: how often a removal is planned, with different random seeds.
        monotone: take the first dead end as proof that no order exists (see the module's text); otherwise that takes
            all states that can be reached.
    """

    attempts: int = 1
    monotone: bool = False

    def __post_init__(self) -> None:
        if self.attempts < 1:
            raise InputError(f"{self.attempts}; must be at least 1", "order.attempts")


@dataclass(frozen=True)
class RestartOptions:
    """Options of `random_restarts`.

    Args:
        order: of every single random order.
        patience: orders in a row that neither cost a query nor were shorter, after which the search ends; a budget in
            queries alone would never be spent once the library knows every answer.
    """

    order: OrderOptions = field(default_factory=OrderOptions)
    patience: int = 1000

    def __post_init__(self) -> None:
        if self.patience < 1:
            raise InputError(f"{self.patience}; must be at least 1", "restarts.patience")


@dataclass(frozen=True)
class BeamOptions:
    """Options of `beam`.

    Args:
        width: states kept per layer. Where all of them are dead ends, the beam starts again twice as wide.
        attempts: how often a removal is planned, with different random seeds.
    """

    width: int = 10
    attempts: int = 1

    def __post_init__(self) -> None:
        for name in ("width", "attempts"):
            if getattr(self, name) < 1:
                raise InputError(f"{getattr(self, name)}; must be at least 1", f"beam.{name}")


def random_order(
    problem: Problem,
    options: OrderOptions,
    budget: Budget,
    rng: np.random.Generator,
    listen: ProgressListener | None = None,
) -> SearchResult:
    """A feasible order drawn at random, stepping back from dead ends; finds one whenever there is one.

    Returns:
        no removals, the deepest dead ends as refusals and `infeasible` if there is none.
    """
    session = Session(problem, budget, listen)
    return _run(session, lambda: _depth_first(session, _random_successors(session, options, rng), options.monotone))


def greedy(
    problem: Problem,
    options: OrderOptions,
    budget: Budget,
    rng: np.random.Generator,
    listen: ProgressListener | None = None,
    guide: Guide | None = None,
) -> SearchResult:
    """In every state the part with the shortest removal goes first; asks for all candidates; ties at random.

    With a guide the part with the greatest Q-value goes first, and candidates are asked one by one until one can leave.
    Steps back from dead ends; infeasibility is told as by `random_order`.
    """
    session = Session(problem, budget, listen)
    drawn = _random_successors(session, options, rng)

    def shortest_first(state: int) -> Iterator[Removal]:
        # Random successors before a stable sort: equal lengths in random order.
        return iter(sorted(drawn(state), key=lambda removal: removal.length))

    successors = shortest_first if guide is None else _random_successors(session, options, rng, guide)
    return _run(session, lambda: _depth_first(session, successors, options.monotone))


def random_restarts(
    problem: Problem,
    options: RestartOptions,
    budget: Budget,
    rng: np.random.Generator,
    listen: ProgressListener | None = None,
) -> SearchResult:
    """The best of many random orders; one order is one episode of the budget."""
    session = Session(problem, budget, listen)
    successors = _random_successors(session, options.order, rng)

    def restart() -> None:
        idle = 0
        while not session.clock.spent() and idle < options.patience:
            before = (session.clock.queries, session.best[0])
            _depth_first(session, successors, options.order.monotone)
            if session.infeasible:
                return
            idle = idle + 1 if before == (session.clock.queries, session.best[0]) else 0

    return _run(session, restart)


def beam(
    problem: Problem,
    options: BeamOptions,
    budget: Budget,
    rng: np.random.Generator,
    listen: ProgressListener | None = None,
    guide: Guide | None = None,
) -> SearchResult:
    """Layer by layer (one part less each), every removal of the best `width` states.

    States are ranked by the cost so far plus what the rest costs at least: each part as if it were alone
    (`Problem.lower` in the state of that part only, a bound in every state; `lower` in the state itself would be none,
    since parts that are blocked now may leave later). A guide takes the place of that bound in the ranking: minus
    its greatest Q-value. Ties are decided at random.

    Returns:
        a sequence, and as sequence_bound the least that a sequence can cost that leaves the beam (or runs through what
        the budget left out); it equals the length where the beam was wide enough.
    """
    session = Session(problem, budget, listen)
    layers = _Layers(session, options, rng, guide)
    return _run(session, layers.widen_until_found, layers.settle)


def _run(
    session: Session, search: Callable[[], None], settle: Callable[[], float | None] | None = None
) -> SearchResult:
    """Run a search to its end, the end of its budget, or Ctrl-C; `settle` then gives the sequence bound."""
    interrupted = False
    try:
        search()
    except BudgetSpentError:
        pass
    except KeyboardInterrupt:
        interrupted = True
    bound = settle() if settle is not None else None
    return session.result(interrupted, bound)


def _random_successors(
    session: Session, options: OrderOptions, rng: np.random.Generator, guide: Guide | None = None
) -> Successors:
    """In random order; with a guide, those with the greatest Q-value first, and ties at random."""
    effort = Effort(attempts=options.attempts)

    def successors(state: int) -> Iterator[Removal]:
        found = session.problem.candidates(state)
        candidates = [found[int(place)] for place in rng.permutation(len(found))]
        if guide is not None:
            values = guide([state])[0]
            candidates.sort(key=lambda part: -values[part])
        refusals = []
        for part in candidates:
            answer = session.ask(state, part, effort)
            if isinstance(answer, Removal):
                yield answer
            else:
                refusals.append(answer)
        if len(refusals) == len(candidates):
            stuck = True
            for removal in session.second_look(state, refusals):
                stuck = False
                yield removal
            if stuck:
                session.dead_end(state, refusals)

    return successors


def _depth_first(session: Session, successors: Successors, monotone: bool) -> None:
    """Offer the first sequence found without entering a state twice; count an episode, or state infeasibility."""
    root = session.problem.root
    path: list[Removal] = []
    entered = {root}
    stack = [(root, successors(root))]
    while stack:
        state, removals = stack[-1]
        if state == 0:
            session.offer(path, found_episode=session.clock.episodes + 1)
            break
        for removal in removals:
            following = state & ~(1 << removal.part)
            if following not in entered:
                entered.add(following)
                path.append(removal)
                stack.append((following, successors(following)))
                break
        else:
            if monotone and session.dead_ends:
                stack.clear()
            else:
                stack.pop()
                del path[-1:]
    else:
        session.infeasible = True
    session.statistics["states"] = len(entered)
    session.clock.episodes += 1
    session.report()


class _Layers:
    """The states and edges of one beam.

    `edges` holds, layer by layer, the removals found in each state that was kept; `expanded` the states whose
    candidates were all asked for. States that were reached but not expanded were pruned, or left over by the budget.
    """

    def __init__(self, session: Session, options: BeamOptions, rng: np.random.Generator, guide: Guide | None) -> None:
        self.session, self.options, self.rng, self.guide = session, options, rng, guide
        self.width = options.width
        self.edges: dict[int, list[Removal]] = {}
        self.expanded: set[int] = set()

    def widen_until_found(self) -> None:
        """WeightedAStar with doubled width until a sequence is found, nothing was pruned, or the budget is spent."""
        while True:
            pruned = self.sweep()
            self.session.clock.episodes += 1
            self.settle()
            self.session.report()
            if self.session.best[1] or not self.session.problem.root:
                return
            if not pruned:
                self.session.infeasible = True
                return
            if self.session.clock.spent():
                return
            self.width *= 2

    def sweep(self) -> bool:
        """One pass over all layers; whether any state was pruned."""
        problem, effort = self.session.problem, Effort(attempts=self.options.attempts)
        self.edges, self.expanded = {}, set()
        cost = {problem.root: 0.0}  # of the layer's states, m
        pruned = False
        while cost and 0 not in cost:
            kept = self.ranked(cost)[: self.width]
            pruned |= len(kept) < len(cost)
            following: dict[int, float] = {}
            for state in kept:
                refusals: list[Blocked] = []
                self.edges[state] = []
                for part in problem.candidates(state):
                    answer = self.session.ask(state, part, effort)
                    if isinstance(answer, Removal):
                        self.edges[state].append(answer)
                    else:
                        refusals.append(answer)
                if not self.edges[state]:
                    self.edges[state] += self.session.second_look(state, refusals)
                if not self.edges[state]:
                    self.session.dead_end(state, refusals)
                self.expanded.add(state)
                for removal in self.edges[state]:
                    rest = state & ~(1 << removal.part)
                    following[rest] = min(following.get(rest, math.inf), cost[state] + removal.length)
            cost = following
        return pruned

    def ranked(self, cost: dict[int, float]) -> list[int]:
        """States of a layer, most promising first."""
        states = [list(cost)[int(place)] for place in self.rng.permutation(len(cost))]
        bound = self.bounds(cost)
        if self.guide is None:
            return sorted(states, key=bound.__getitem__)
        values = dict(zip(states, self.guide(states), strict=True))
        remaining = {state: -max(values[state].values(), default=-math.inf) for state in states}
        return sorted(states, key=lambda state: (cost[state] + remaining[state], bound[state]))

    def bounds(self, cost: dict[int, float]) -> dict[int, float]:
        """Per state a bound on all sequences through it, m: its cost plus that of each of its parts as if alone."""
        root, lower = self.session.problem.root, self.session.problem.lower
        alone = {part: lower(1 << part, part) for part in range(root.bit_length()) if root >> part & 1}
        return {
            state: value + sum(least for part, least in alone.items() if state >> part & 1)
            for state, value in cost.items()
        }

    def settle(self) -> float | None:
        """Best sequence over all edges asked for, by dynamic programming, and the bound on all sequences, m.

        Costs are those of the end, not those of the ranking: the library may have learned a shorter removal that is
        valid in an earlier state too, and sequence and bound must rest on the same costs.
        """
        problem = self.session.problem
        cost: dict[int, float] = {problem.root: 0.0}
        best_edge: dict[int, tuple[int, Removal]] = {}
        for state, removals in self.edges.items():  # in the order of expansion: layer by layer
            for removal in removals:
                following = state & ~(1 << removal.part)
                through = cost[state] + min(removal.length, problem.upper(state, removal.part))
                if through < cost.get(following, math.inf):
                    cost[following], best_edge[following] = through, (state, removal)
        if 0 in cost:
            self.session.offer(self.sequence(best_edge))
        length = self.session.best[0]
        left = {state: value for state, value in cost.items() if state and state not in self.expanded}
        self.session.bound = min([length, *self.bounds(left).values()])
        self.session.statistics |= {"width": self.width, "states": len(cost)}
        return self.session.bound if math.isfinite(self.session.bound) else None

    def sequence(self, best_edge: dict[int, tuple[int, Removal]]) -> list[Removal]:
        """Removals from the root to the goal; where the library has a shorter one by now, that one."""
        removals: list[Removal] = []
        state = 0
        while state != self.session.problem.root:
            state, removal = best_edge[state]
            if self.session.problem.upper(state, removal.part) < removal.length:
                answer = self.session.problem.remove(state, removal.part, Effort())  # known, so it costs nothing
                if isinstance(answer, Removal) and answer.length < removal.length:
                    removal = answer
            removals.append(removal)
        return removals[::-1]
