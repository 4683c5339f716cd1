"""Monte Carlo tree search over removal sequences (Sec. V-B), with guided simulation (Sec. V-E).

It follows the paper: a tree (not a graph) of states, maximum instead of mean returns, UCT on returns normalised over
siblings, k planning attempts in expansion and one in simulation. Three things the paper leaves open are settled here:
a *leaf* that ends an episode is a node below which nothing is left to explore (Table II lists step 16 of episode 2, so
it cannot be a node without children so far); a node through which no complete sequence is known counts as the worst
sibling; and what is explored to the end (complete, dead, or all children so) is closed and never entered again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from takeapart.model.errors import InputError, UnknownNameError
from takeapart.problem import Guide, Problem
from takeapart.removal.result import Blocked, Effort, Removal
from takeapart.search.result import Budget, ProgressListener, SearchResult
from takeapart.search.session import Session, TransitionObserver

StateGuide = Callable[[int], Mapping[int, float]]
"""A guide for one state: Q-value of every candidate part, m."""


@dataclass(frozen=True)
class MctsOptions:
    """Options of `mcts`.

    Args:
        exploration: c of the UCT formula, without unit; UCB1 (Auer et al. 2002) has 1 for returns in [0, 1], and
            Sec. V-B gives no value.
        search_budget: tree iterations per search step (Sec. VII: five).
        attempts: how often an expansion plans its removal, k of Sec. V-B (Sec. VII-A: four).
        memory: "library" asks for no removal twice (design, section 2); "paper" plans afresh in every simulation and
            expansion, and keeps removals in the tree only (Sec. V-B).
        epsilon: chance of a random part in guided simulation (Sec. VII: 0.2); without a guide every part is random.
        patience: episodes in a row that neither cost a query nor found anything shorter, after which the search ends:
            a budget in queries alone would never be spent once the library knows every answer.
    """

    exploration: float = 1.0
    search_budget: int = 5
    attempts: int = 4
    memory: Literal["library", "paper"] = "library"
    epsilon: float = 0.2
    patience: int = 100

    def __post_init__(self) -> None:
        if self.memory not in ("library", "paper"):
            raise UnknownNameError("memory", self.memory, ["library", "paper"], "mcts.memory")
        for name in ("search_budget", "attempts", "patience"):
            if getattr(self, name) < 1:
                raise InputError(f"{getattr(self, name)}; must be at least 1", f"mcts.{name}")
        if not 0.0 <= self.exploration < math.inf:
            raise InputError(f"{self.exploration}; must be at least 0 and finite", "mcts.exploration")
        if not 0.0 <= self.epsilon <= 1.0:
            raise InputError(f"{self.epsilon}; must be from 0 to 1", "mcts.epsilon")


@dataclass(eq=False)
class Node:
    """A state reached by one order of removals; the same state reached by another order is another node.

    Args:
        state: parts still there.
        parent: None at the root.
        removal: from the parent's state to this one, planned in expansion.
        untried: candidates that no expansion has asked for yet.
        children: removable parts that were expanded.
        refusals: candidates that an expansion found blocked.
        visits: N of Sec. V-B.
        best_return: Q of Sec. V-B, the greatest return, m, of a complete sequence from the root of the tree through
            this node (negative); minus infinity while none is known.
        closed: nothing is left to explore below.
    """

    state: int
    untried: list[int]
    parent: Node | None = None
    removal: Removal | None = None
    children: list[Node] = field(default_factory=list)
    refusals: list[Blocked] = field(default_factory=list)
    visits: int = 0
    best_return: float = -math.inf
    closed: bool = False

    def path(self) -> list[Removal]:
        """Removals from the root of the tree to this node."""
        removals: list[Removal] = []
        node: Node | None = self
        while node is not None and node.removal is not None:
            removals.append(node.removal)
            node = node.parent
        return removals[::-1]


def normalised_returns(children: Sequence[Node], extremes: tuple[float, float]) -> list[float]:
    """Q-hat of Sec. V-B: best returns scaled to [0, 1] by the least and greatest among siblings.

    Args:
        children: of one node.
        extremes: least and greatest return of the whole search, m; they stand in where siblings have no spread.

    Returns:
        one value per child; 0, the worst, where no complete sequence through the child is known, and where the whole
        search has no spread either (then all known returns are equal and the value cannot matter).
    """
    known = [child.best_return for child in children if child.best_return > -math.inf]
    least, greatest = (min(known), max(known)) if known else extremes
    if least == greatest:
        least, greatest = extremes
    if least >= greatest:
        return [0.0] * len(children)
    return [max(0.0, (child.best_return - least) / (greatest - least)) for child in children]


def uct_values(node: Node, extremes: tuple[float, float], exploration: float) -> list[float]:
    """UCT of every child (formula in Sec. V-B): Q-hat(n') + c * sqrt(2 ln N(n) / N(n'))."""
    return [
        value + exploration * math.sqrt(2.0 * math.log(node.visits) / child.visits)
        for value, child in zip(normalised_returns(node.children, extremes), node.children, strict=True)
    ]


class TreeSearch:
    """Tree and random decisions of one run of `mcts`."""

    def __init__(self, problem: Problem, options: MctsOptions, session: Session, rng: np.random.Generator) -> None:
        self.problem, self.options, self.session, self.rng = problem, options, session, rng
        fresh = options.memory == "paper"
        self.expansion = Effort(attempts=options.attempts, fresh=fresh)
        self.simulation = Effort(attempts=1, fresh=fresh)
        self.extremes = (math.inf, -math.inf)  # least and greatest return so far, m
        self.root = Node(problem.root, list(problem.candidates(problem.root)))
        self.steps = 0
        self.nodes = 1

    def episode(self, guide: StateGuide | None) -> None:
        """From the root down to a leaf, one node per search step."""
        current, step = self.root, 0
        while not current.closed:
            step += 1
            self.steps += 1
            found_at = {"found_episode": self.session.clock.episodes + 1, "found_step": step}
            for _ in range(self.options.search_budget):
                self.iterate(current, guide, found_at)
            if any(not child.closed for child in current.children):
                current = self.select(current)  # otherwise this node is closed, or has untried parts for another step

    def iterate(self, start: Node, guide: StateGuide | None, found_at: Mapping[str, float]) -> None:
        """Selection, expansion, simulation, backpropagation; nothing (more) once `start` is closed."""
        node = start
        while not start.closed:
            if node.closed:
                node = start
            elif not node.untried:
                node = self.select(node)
            elif (child := self.expand(node)) is not None:
                rollout = self.simulate(child.state, guide)
                length = self.session.offer([*child.path(), *rollout], **found_at) if rollout is not None else math.inf
                self.backpropagate(child, -length)
                self.close_if_explored(child)
                return

    def select(self, node: Node) -> Node:
        """The child with the greatest UCT value among those that are not closed."""
        values = uct_values(node, self.extremes, self.options.exploration)
        places = [place for place, child in enumerate(node.children) if not child.closed]
        return node.children[max(places, key=values.__getitem__)]

    def expand(self, node: Node) -> Node | None:
        """Plan the removal of a random untried part: the new child, or None (and perhaps a closed node) if blocked."""
        part = node.untried[int(self.rng.integers(len(node.untried)))]
        answer = self.session.ask(node.state, part, self.expansion)
        node.untried.remove(part)
        if isinstance(answer, Blocked):
            node.refusals.append(answer)
            self.close_if_explored(node)
            return None
        state = node.state & ~(1 << part)
        child = Node(state, list(self.problem.candidates(state)), node, answer)
        node.children.append(child)
        self.nodes += 1
        return child

    def simulate(self, state: int, guide: StateGuide | None) -> list[Removal] | None:
        """Remove part after part by the default policy, or by the guide; None where this runs into a dead end."""
        removals: list[Removal] = []
        while state:
            refusals: list[Blocked] = []
            for part in self.preferences(state, guide):
                answer = self.session.ask(state, part, self.simulation)
                if isinstance(answer, Removal):
                    removals.append(answer)
                    state &= ~(1 << part)
                    break
                refusals.append(answer)
            else:
                again = None if self.simulation.fresh else next(self.session.second_look(state, refusals), None)
                if again is None:
                    self.session.dead_end(state, refusals)
                    return None
                removals.append(again)
                state &= ~(1 << again.part)
        return removals

    def preferences(self, state: int, guide: StateGuide | None) -> list[int]:
        """Candidates in the order in which a simulation tries them (Sec. V-E: epsilon-greedy on Q)."""
        candidates = list(self.problem.candidates(state))
        if guide is not None and self.rng.random() > self.options.epsilon:
            value = guide(state)
            return sorted(candidates, key=lambda part: -value[part])
        return [candidates[int(place)] for place in self.rng.permutation(len(candidates))]

    def backpropagate(self, node: Node, value: float) -> None:
        """Update visits and greatest return, m, from a node up to the root of the tree."""
        if value > -math.inf:
            self.extremes = (min(self.extremes[0], value), max(self.extremes[1], value))
        above: Node | None = node
        while above is not None:
            above.visits += 1
            above.best_return = max(above.best_return, value)
            above = above.parent

    def close_if_explored(self, node: Node) -> None:
        """Close a node with nothing left below, and then every node above for which the same holds."""
        above: Node | None = node
        while above is not None and not above.untried and all(child.closed for child in above.children):
            above.closed = True
            if above.state and not above.children:
                self.session.dead_end(above.state, above.refusals)
            above = above.parent


def _remembered(guide: Guide) -> StateGuide:
    """The guide for one state at a time; no state is asked for twice."""
    known: dict[int, Mapping[int, float]] = {}

    def value(state: int) -> Mapping[int, float]:
        if state not in known:
            known[state] = guide([state])[0]
        return known[state]

    return value


def mcts(
    problem: Problem,
    options: MctsOptions,
    budget: Budget,
    rng: np.random.Generator,
    guide: Guide | None = None,
    listen: ProgressListener | None = None,
    observe: TransitionObserver | None = None,
) -> SearchResult:
    """Search for the shortest removal sequence (Sec. V-B; with a guide Sec. V-E).

    Args:
        rng: for the choice of parts; the same seed and answers give the same sequence.
        guide: Q-values for simulation.
        listen: is told every improvement and the end of every episode.
        observe: is told every transition planned.

    Returns:
        the best complete sequence seen in any simulation. Statistics as in Table I: initial_length, shortest_length,
        m, found_episode, found_step (from 1; all four missing if no sequence was found), episodes, steps; and nodes,
        explored (1 if the whole tree was searched: where nothing was found then, the result is infeasible).
    """
    session = Session(problem, budget, listen, observe)
    search = TreeSearch(problem, options, session, rng)
    value = _remembered(guide) if guide is not None else None
    if problem.root == 0:
        session.offer([])

    def episodes() -> None:
        idle = 0
        search.close_if_explored(search.root)
        while not search.root.closed and not session.clock.spent() and idle < options.patience:
            before = (session.clock.queries, session.best[0])
            search.episode(value)
            session.clock.episodes += 1
            idle = idle + 1 if before == (session.clock.queries, session.best[0]) else 0
            session.report()

    interrupted = session.run(episodes)
    session.statistics |= {"steps": search.steps, "nodes": search.nodes, "explored": float(search.root.closed)}
    session.infeasible = search.root.closed and math.isinf(session.best[0])
    return session.result(interrupted)
