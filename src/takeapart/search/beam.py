"""Beam search: layer by layer, of which only the most promising states are kept."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from takeapart.model.errors import InputError
from takeapart.problem import Guide, Problem
from takeapart.removal.result import Blocked, Effort, Removal
from takeapart.search.result import Budget, ProgressListener, SearchResult
from takeapart.search.session import Session


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
    interrupted = session.run(layers.widen_until_found)
    return session.result(interrupted, layers.settle())


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
