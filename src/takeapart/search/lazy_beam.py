"""A beam over the bounds of edges: plans for large assemblies at few queries.

The ordinary beam asks the planner for every edge it looks at. This one takes edges at their lower bound, as lazy exact
search does (Dellin and Srinivasa 2016): it asks only for open edges of the sequence that the beam likes best, and
starts again with what it learned, until that sequence is known from end to end. After every question a second beam
takes edges at what is known to work, which costs no question: with many parts the sequence that looks best is often
blocked somewhere, while what was learned on the way already makes a better plan. Neither proves anything.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from takeapart.search.edge_queries import Edge
from takeapart.search.lattice_bounds import TOLERANCE
from takeapart.search.orders import Orders

PATIENCE = 4  # at first a quarter of the open edges is asked at a time, in the end `batch` of them


def lazy_beam(orders: Orders, width: int) -> None:
    """Repeat the beam until its sequence is a plan, or cannot be shorter than the best plan known.

    Args:
        width: states kept per layer.

    Raises:
        BudgetSpentError: the budget is spent.
    """
    while True:
        length, edges = _standing_sequence(orders, width, orders.lower)
        open_edges = [edge for edge in edges if not orders.bounds.is_closed(*edge)]
        if length < orders.session.best[0] - TOLERANCE and not open_edges:
            orders.offer([part for _, part in edges])
        if length >= orders.session.best[0] - TOLERANCE or not open_edges:
            return
        count = max(orders.batch, len(open_edges) // PATIENCE)
        orders.edge_queries.ask(orders.telling(open_edges, count))
        if all(math.isfinite(orders.bounds.upper(*edge)) for edge in edges):
            orders.offer([part for _, part in edges])
        length, edges = _standing_sequence(orders, width, orders.upper)
        if length < orders.session.best[0] - TOLERANCE:
            orders.offer([part for _, part in edges])


def _standing_sequence(orders: Orders, width: int, cost: Callable[[int, int], float]) -> tuple[float, list[Edge]]:
    """The best sequence whose states all stand: the beam is repeated until it is one.

    Raises:
        BudgetSpentError: the seconds are over.
    """
    while True:
        length, edges = _best_sequence(orders, width, cost)
        if orders.stand(edges):
            return length, edges


def _best_sequence(orders: Orders, width: int, cost: Callable[[int, int], float]) -> tuple[float, list[Edge]]:
    """Length, m, and edges of the best sequence in the beam; infinite and empty if all ended dead.

    Raises:
        BudgetSpentError: the seconds are over.
    """
    problem = orders.session.problem
    least = orders.least_costs()
    layer: dict[int, float] = {problem.root: 0.0}  # length so far beyond the least costs of the parts gone, m
    came_by: dict[int, Edge] = {}
    while layer and 0 not in layer:
        orders.session.look_at_clock()
        kept = sorted(layer, key=lambda state: (layer[state], state))[:width]
        following: dict[int, float] = {}
        for state in kept:
            for part in problem.candidates(state):
                excess = layer[state] + cost(state, part) - least[part]
                rest = state & ~(1 << part)
                if excess < following.get(rest, math.inf):
                    following[rest], came_by[rest] = excess, (state, part)
        layer = following
    if not layer:
        return math.inf, []
    edges: list[Edge] = []
    state = 0
    while state != problem.root:
        edges.append(came_by[state])
        state = came_by[state][0]
    return layer[0] + sum(least.values()), edges[::-1]
