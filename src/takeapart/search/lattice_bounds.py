"""The bounds of `EdgeBounds` for all edges of a lattice at once, and what they say about sequences.

A new removal can only change edges of its part in states that share nothing with its blockers; a newly closed edge only
edges of its part in supersets of its state. Both are one compiled pass over the edges of one part. Only where a removal
undercuts a closed edge (the planner found in a larger state what it missed in a smaller one), the bounds of that part
are computed afresh.

Whether a state stands is kept apart from the bounds of edges: it says nothing about smaller or larger states. A state
that was not asked for counts as standing where the least is wanted that a sequence can cost, and as fallen where a
sequence is wanted that is known to work.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from takeapart.compilation import compiled
from takeapart.removal.bounds import ClosedEdge, EdgeBounds
from takeapart.search.lattice import Lattice, Values, cost_from_root, cost_to_go
from takeapart.search.lattice_standing import LatticeStanding
from takeapart.states import pack

TOLERANCE = 1e-9  # m; sums of the same lengths in another order differ by less

Step = tuple[int, int, int]
"""Row of a state, edge that leaves it, number of the part that leaves."""


Belief = Callable[[int, ClosedEdge], bool]
"""Whether a closed edge of a part counts."""


class EdgeCosts(Protocol):
    """What dynamic programming needs: (E,) bounds, m, of all edges of a lattice."""

    lower: Values
    upper: Values

    def update(self) -> tuple[bool, bool]:
        """Whether a bound may have changed since the last call, and whether a lower bound may have fallen."""
        ...


class LatticeBounds:
    """`lower` and `upper` of all edges of a lattice.

    Args:
        believe: closed edges that count for `lower`; by default all do.

    Attributes:
        lower: (E,) m, infinite where the part is known to be blocked; equal to `upper` where the edge is closed.
        upper: (E,) m, infinite where no removal is known.
    """

    def __init__(self, lattice: Lattice, bounds: EdgeBounds, believe: Belief | None = None) -> None:
        self._lattice, self._bounds, self._believe = lattice, bounds, believe
        static = np.array([bounds.static(part) for part in lattice.parts], dtype=np.float64)
        self.lower: Values = static[lattice.edge_part]
        self.upper: Values = np.full(len(lattice.child), math.inf)
        self._versions = [-1] * len(lattice.parts)
        self._removals: list[set[tuple[float, int]]] = [set() for _ in lattice.parts]
        self._costs: list[dict[int, float]] = [{} for _ in lattice.parts]  # closed state -> cost when last looked at

    def update(self) -> tuple[bool, bool]:
        """Take in what `EdgeBounds` learned since the last call.

        Returns:
            Whether a bound may have changed, and whether a lower bound may have fallen.
        """
        changed = fell = False
        for k, part in enumerate(self._lattice.parts):
            version = self._bounds.version(part)
            if version != self._versions[k]:
                changed = True
                fell |= self._update_part(k, part)
                self._versions[k] = version
        return changed, fell

    def look_again(self, part: int) -> None:
        """Let the next update ask anew which closed edges of a part count."""
        self._versions[self._lattice.parts.index(part)] = -1

    def _update_part(self, k: int, part: int) -> bool:
        lattice, bounds = self._lattice, self._bounds
        group = slice(lattice.first_of_part[k], lattice.first_of_part[k + 1])
        edges, sources = lattice.part_edge[group], lattice.part_source[group]
        fell = False
        for removal in bounds.removals(part):
            if (removal.length, removal.blockers) not in self._removals[k]:
                blockers = pack(removal.blockers, lattice.parts)
                fell |= _take_removal(lattice.states, sources, edges, blockers, removal.length, self.lower, self.upper)
                self._removals[k].add((removal.length, removal.blockers))
        counting = [each for each in bounds.closed_edges(part) if self._believe is None or self._believe(part, each)]
        costs = {each.state: bounds.upper(each.state, part) for each in counting}
        undercut = any(costs[state] < cost for state, cost in self._costs[k].items())
        if undercut:
            self.lower[edges] = np.minimum(bounds.static(part), self.upper[edges])
        root = lattice.state(0)
        for state, cost in costs.items():
            if (undercut or state not in self._costs[k]) and not state & ~root:
                _take_closed(lattice.states, sources, edges, pack(state, lattice.parts), cost, self.lower, self.upper)
        self._costs[k] = costs
        return fell or undercut


class SequenceBounds:
    """The shortest sequences over `lower` and over `upper`, by dynamic programming.

    States through which no sequence can be shorter than the best one known are left out of the sweeps. Their values
    stay what they were, which are still bounds, and they come back if a lower bound falls.

    Attributes:
        lower: no sequence is shorter, m, as far as the lower bounds go; or it is above `upper`, which then is best.
        upper: length of the shortest sequence of known removals through states that are known to stand, m.
        rows: of the states that still matter, ascending.
    """

    def __init__(self, lattice: Lattice, edges: EdgeCosts, standing: LatticeStanding) -> None:
        self._lattice, self._edges, self._standing = lattice, edges, standing
        self._answers = 0  # of `standing` that were taken in
        self._all_rows = np.arange(len(lattice.states) - (lattice.goal >= 0), dtype=np.int32)  # the goal is last
        self.rows: NDArray[np.int32] = self._all_rows
        self._to_go = np.zeros(len(lattice.states))  # over lower
        self._known = np.full(len(lattice.states), math.inf)  # over upper
        if lattice.goal >= 0:
            self._known[lattice.goal] = 0.0
        self.lower = self.upper = math.inf

    def update(self) -> None:
        """Take in what the bounds learned since the last call."""
        changed, fell = self._edges.update()
        if not changed and self._answers == self._standing.asked:
            return
        lattice = self._lattice
        self._take_in_what_falls()
        if fell:
            self.rows = self._all_rows
        cost_to_go(lattice.first_edge, lattice.child, self._edges.lower, self.rows, self._to_go)
        known = self.rows if self._standing.always else self.rows[self._standing.stands[self.rows]]
        cost_to_go(lattice.first_edge, lattice.child, self._edges.upper, known, self._known)
        self.lower, self.upper = float(self._to_go[0]), float(self._known[0])
        through = self._from_root(self.rows)[self.rows] + self._to_go[self.rows]
        self.rows = self.rows[through < self.upper - TOLERANCE]

    def _take_in_what_falls(self) -> None:
        if self._answers != self._standing.asked:
            self._answers = self._standing.asked
            fallen = self._standing.fallen
            self._to_go[fallen] = self._known[fallen] = math.inf
            self._all_rows = self._all_rows[~fallen[self._all_rows]]
            self.rows = self.rows[~fallen[self.rows]]

    def find_standing(self, below: float) -> None:
        """Ask for the states of the most promising sequence until all of one stand, or none is shorter than `below`, m.

        Where something falls, the walk turns aside and goes on, so that one sweep over all states serves many answers.

        Raises:
            BudgetSpentError: the time is over.
        """
        self.update()
        while not self._standing.always and self._walk(below):
            self.update()

    def _walk(self, below: float) -> bool:
        """Whether anything on the way fell."""
        lattice, standing, cost, to_go = self._lattice, self._standing, self._edges.lower, self._to_go
        row, length, fell = 0, 0.0, False
        while row != lattice.goal:
            promise = [(float(cost[e] + to_go[lattice.child[e]]), e) for e in lattice.edges(row)]
            through, edge = min(promise, default=(math.inf, -1))
            if not length + through < below:
                return fell
            child = int(lattice.child[edge])
            if standing.ask(child):
                row, length = child, length + float(cost[edge])
            else:
                to_go[child], fell = math.inf, True
        return fell

    def most_promising(self) -> list[Step]:
        """The shortest sequence over `lower`; finite `lower` only."""
        return self._sequence(self._edges.lower, self._to_go)

    def best_known(self) -> list[Step]:
        """The shortest sequence of known removals; finite `upper` only."""
        return self._sequence(self._edges.upper, self._known)

    def is_open(self, edge: int) -> bool:
        """Whether planning the edge can change anything."""
        return bool(self._edges.lower[edge] < self._edges.upper[edge])

    def uncertainty(self, edge: int) -> float:
        """By how much the cost of the edge may exceed its bound, m."""
        return float(self._edges.upper[edge] - self._edges.lower[edge]) if self.is_open(edge) else 0.0

    def bound_through(self, edge: int) -> float:
        """No sequence from the edge's state to the goal that begins with this edge is shorter, m."""
        return float(self._edges.lower[edge] + self._to_go[self._lattice.child[edge]])

    def dead_ends(self, limit: int | None, only_standing: bool = True) -> list[int]:
        """Rows of states that are not known to be out of reach, with all their edges known to be blocked.

        Args:
            limit: at most so many; those with fewest parts come first.
            only_standing: leave out those that were not asked for whether they stand, unless there are no others.
        """
        fallen = self._standing.fallen
        is_open = np.isfinite(self._edges.lower) & ~fallen[self._lattice.child]
        open_before = np.concatenate([[0], np.cumsum(is_open)])  # edges, of those before each
        open_edges = np.diff(open_before[self._lattice.first_edge])
        dead = np.isfinite(self._from_root(self._all_rows)) & (open_edges == 0) & ~fallen
        if only_standing and (dead & self._standing.stands).any():
            dead &= self._standing.stands
        if self._lattice.goal >= 0:
            dead[self._lattice.goal] = False
        found: list[int] = np.flatnonzero(dead)[::-1][:limit].tolist()
        return found

    def settled_edges(self) -> Iterator[tuple[int, int, int, float, float, float]]:
        """Known removals from all states, pruned ones too, of which the least cost to the goal is known.

        Yields:
            row, edge, part; cost of the edge; and the least and the greatest length that the shortest sequence
            beginning with it may have, m.
        """
        lattice = self._lattice
        through = []
        stands = self._standing.stands
        for cost, rows in (
            (self._edges.lower, self._all_rows),
            (self._edges.upper, self._all_rows[stands[self._all_rows]]),
        ):
            to_go = np.full(len(lattice.states), math.inf)
            to_go[lattice.goal] = 0.0 if lattice.goal >= 0 else math.inf
            cost_to_go(lattice.first_edge, lattice.child, cost, rows, to_go)
            through.append((cost + to_go[lattice.child], to_go))
        (least, least_to_go), (most, most_to_go) = through
        for row in np.nonzero(np.isfinite(most_to_go) & (most_to_go <= least_to_go + TOLERANCE))[0]:
            for edge in lattice.edges(int(row)):
                if math.isfinite(most[edge]):
                    length = float(self._edges.upper[edge])
                    yield int(row), edge, lattice.part(edge), length, float(least[edge]), float(most[edge])

    def _from_root(self, rows: NDArray[np.int32]) -> Values:
        value = np.full(len(self._lattice.states), math.inf)
        value[0] = 0.0
        cost_from_root(self._lattice.first_edge, self._lattice.child, self._edges.lower, rows, value)
        return value

    def _sequence(self, cost: Values, to_go: Values) -> list[Step]:
        row, steps = 0, []
        while row != self._lattice.goal:
            edge = min(self._lattice.edges(row), key=lambda e: float(cost[e] + to_go[self._lattice.child[e]]))
            steps.append((row, edge, self._lattice.part(edge)))
            row = int(self._lattice.child[edge])
        return steps


@compiled
def _take_removal(states, sources, edges, blockers, length, lower, upper):  # type: ignore[no-untyped-def]
    """Lower `upper` where the removal is valid; whether `lower` had to follow."""
    fell = False
    for j in range(edges.shape[0]):
        e = edges[j]
        if upper[e] <= length:
            continue
        valid = True
        for w in range(blockers.shape[0]):
            if states[sources[j], w] & blockers[w]:
                valid = False
        if valid:
            upper[e] = length
            if lower[e] > length:
                lower[e] = length
                fell = True
    return fell


@compiled
def _take_closed(states, sources, edges, closed, cost, lower, upper):  # type: ignore[no-untyped-def]
    for j in range(edges.shape[0]):
        e = edges[j]
        if lower[e] >= cost:
            continue
        superset = True
        for w in range(closed.shape[0]):
            if closed[w] & ~states[sources[j], w]:
                superset = False
        if superset:
            lower[e] = max(lower[e], min(cost, upper[e]))
