"""One sweep of lazy weighted A* over the orders of parts; `best_first` says what it is for."""

from __future__ import annotations

import math
from heapq import heappop, heappush
from typing import NamedTuple

from takeapart.search.lattice_bounds import TOLERANCE
from takeapart.search.orders import Orders
from takeapart.search.session import BudgetSpentError


class _Waiting(NamedTuple):
    """An entry of the priority queue: the state that is reached by one edge.

    `settled`: g holds the cost of that edge, not a bound of it. `estimate`: of the rest, from h to w h. `number` keeps
    the order of equals, and the rest from being compared.
    """

    rank: float
    left: int
    number: int
    state: int
    g: float
    h: float
    estimate: float
    before: int
    part: int
    settled: bool


class WeightedAStar:
    """Weighted A* from the root to the goal.

    Args:
        lazy: plan an edge when it comes first; otherwise take every edge at its lower bound and ask nothing.
    """

    def __init__(self, orders: Orders, weight: float, lazy: bool) -> None:
        self.orders, self.weight, self.lazy = orders, weight, lazy
        self.falls = orders.bounds.falls
        self.least_costs = orders.least_costs()
        self.waiting: list[_Waiting] = []
        self.in_hand: list[_Waiting] = []  # taken from `waiting`, not yet dealt with: they count for `least`
        self.g: dict[int, float] = {}
        self.came_by: dict[int, tuple[int, int]] = {}
        self.number = 0
        h = sum(self.least_costs.values())
        self.push(orders.session.problem.root, 0.0, h, weight * h, 0, -1, settled=True)

    def least(self) -> float:
        """No sequence is shorter, m; only for weight 1. What was pruned is no shorter than the best length."""
        ranks = [entry.rank for entry in self.in_hand] + [entry.rank for entry in self.waiting[:1]]
        return min([*ranks, self.orders.session.best[0]])

    def run(self, memory_limit: int, expansions: int | None) -> bool:
        """Until the goal comes first or nothing waits; False if a limit came first.

        Raises:
            BudgetSpentError: the seconds are over; what waits is still there for `least`.
        """
        session = self.orders.session
        expanded = 0
        while self.waiting:
            if (
                session.clock.late() if self.lazy else session.clock.over()
            ):  # a sweep may go on for long without a query
                raise BudgetSpentError
            self.in_hand = [heappop(self.waiting)]
            entry = self.in_hand[0]
            if entry.rank >= session.best[0] - TOLERANCE:
                return True  # nothing that waits leads to a plan shorter than the best by more than the factor w
            best_arrival = self.g.get(entry.state, math.inf)
            if entry.g + entry.h < session.best[0] - TOLERANCE and (
                entry.g <= best_arrival if entry.settled else entry.g < best_arrival
            ):
                if not entry.settled:
                    self.evaluate(entry)
                elif entry.state == 0:
                    if self.lazy:
                        self.orders.offer(self.order())
                    return True
                else:
                    self.expand(entry)
                    expanded += 1
            if len(self.waiting) + len(self.g) > memory_limit or expanded == expansions:
                return False  # what is in hand has been dealt with, but counts all the same
        self.in_hand = []
        return True

    def expand(self, entry: _Waiting) -> None:
        """Let all states wait that can be reached by one edge."""
        orders, state = self.orders, entry.state
        guided = orders.guide is not None and self.lazy and self.weight > 1
        values = orders.guide([state])[0] if orders.guide is not None and guided else {}
        dead_end = True
        for part in orders.session.problem.candidates(state):
            lower = orders.lower(state, part)
            if math.isfinite(lower):
                dead_end = False
                settled = not self.lazy or orders.is_settled(state, part)
                h = entry.h - self.least_costs[part]
                estimate = self.weight * h
                if part in values:
                    estimate = min(estimate, max(h, -values[part] - lower))
                self.push(state & ~(1 << part), entry.g + lower, h, estimate, state, part, settled)
        if dead_end:
            orders.meet_dead_end(state)

    def push(self, state: int, g: float, h: float, estimate: float, before: int, part: int, settled: bool) -> None:
        """Let a state wait, unless it was reached as cheaply before or cannot beat the best plan."""
        if g >= self.g.get(state, math.inf) or g + h >= self.orders.session.best[0] - TOLERANCE:
            return
        if settled:
            self.g[state], self.came_by[state] = g, (before, part)
        self.number += 1
        left = state.bit_count()
        heappush(self.waiting, _Waiting(g + estimate, left, self.number, state, g, h, estimate, before, part, settled))

    def evaluate(self, entry: _Waiting) -> None:
        """Replace the bound of an edge by a better one or by its cost; plan it where there is none. What leads to a
        state in which something falls is left out.
        """
        orders, bounds = self.orders, self.orders.bounds
        stands = orders.session.stands(entry.state)
        is_open = stands and not bounds.is_closed(entry.before, entry.part)
        if is_open and self.edge_cost(entry) <= self.assumed_cost(entry):
            while self.waiting and len(self.in_hand) < orders.batch:
                following = self.waiting[0]
                asked = [each.part for each in self.in_hand]
                if following.settled or following.part in asked or bounds.is_closed(following.before, following.part):
                    break
                self.in_hand.append(heappop(self.waiting))
            standing = [each for each in self.in_hand if orders.session.stands(each.state)]
            orders.edge_queries.ask([(each.before, each.part) for each in standing])
        for each in self.in_hand:
            cost = self.edge_cost(each)
            if math.isfinite(cost):
                settled = orders.is_settled(each.before, each.part)
                g = self.g[each.before] + cost
                self.push(each.state, g, each.h, each.estimate, each.before, each.part, settled)
            elif orders.is_dead_end(each.before):
                orders.meet_dead_end(each.before)

    def edge_cost(self, entry: _Waiting) -> float:
        return self.orders.lower(entry.before, entry.part)

    def assumed_cost(self, entry: _Waiting) -> float:
        return entry.g - self.g[entry.before] + TOLERANCE

    def order(self) -> list[int]:
        """Parts in the order in which they leave on the way to the goal."""
        parts, state = [], 0
        while state != self.orders.session.problem.root:
            state, part = self.came_by[state]
            parts.append(part)
        return parts[::-1]
