"""Orders drawn one by one: a random order, greedy, random restarts.

All of them share the removal library of the problem, so that they are compared with MCTS and exact search by what they
choose to ask. Where every condition is monotone (fewer parts never hinder: gravity by connectors, lifting, collision),
a feasible problem has no dead ends: a feasible order without the parts that are gone goes on from every state. The
first dead end then proves that no order exists, which `monotone` makes use of. A dead end from which parts could leave
if others did not fall proves nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from takeapart.model.errors import InputError
from takeapart.problem import Guide, Problem
from takeapart.removal.result import Effort, Removal
from takeapart.search.result import Budget, ProgressListener, SearchResult
from takeapart.search.session import Session

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
    return session.result(
        session.run(lambda: _depth_first(session, _random_successors(session, options, rng), options.monotone))
    )


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
    return session.result(session.run(lambda: _depth_first(session, successors, options.monotone)))


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

    return session.result(session.run(restart))


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
            if monotone and state in session.dead_ends and session.is_proof(state):
                stack.clear()
            else:
                stack.pop()
                del path[-1:]
    else:
        session.infeasible = True
    session.statistics["states"] = len(entered)
    session.clock.episodes += 1
    session.report()
