"""Planning edges again, with other seeds, where that can still make the best sequence shorter.

A path planner that draws random numbers does not find the shortest removal at the first try. Which of its answers are
worth a second one? The same question as in `exact`, one level up, and answered in the same way: every edge has a
*hope*, a length that it may fall to, and the edges to plan again are those of the sequence that is shortest under all
hopes. When that sequence is hardly shorter than the best one in hand, a pass is over: one more try of whatever edge is
not worth it. The next pass gives everything that matters another try.

The hope of an edge lies between two bounds. One is its `lower`. The other is the same bound without the closed edges
that were not planned again in this pass; optimism says how far hope goes from the first to the second. What no further
try will change counts as planned again: refusals because no hand or arm gets at the part.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from takeapart.model.errors import InputError
from takeapart.removal.bounds import ClosedEdge, EdgeBounds
from takeapart.search.edge_queries import Edge
from takeapart.search.lattice import Lattice, Values
from takeapart.search.lattice_bounds import TOLERANCE, LatticeBounds, SequenceBounds
from takeapart.search.lattice_standing import LatticeStanding


@dataclass(frozen=True)
class RefinementOptions:
    """Options of the refinement.

    Args:
        passes: at most so many; each plans what matters once more. 0 does not refine.
        optimism: share, from 0 to 1, of the way from an edge's cost to the bound that is beyond doubt, by which
            planning it again is hoped to shorten it. 1 plans everything again that could matter at all.
        worth: gain in length, as a share of it, below which a pass, and after such a pass the refinement, ends. 0 goes
            on until all passes are made or the budget is spent.
    """

    passes: int = 8
    optimism: float = 0.5
    worth: float = 0.001

    def __post_init__(self) -> None:
        if self.passes < 0:
            raise InputError(f"{self.passes}; must be at least 0", "refinement.passes")
        for name in ("optimism", "worth"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"{getattr(self, name)}; must be from 0 to 1", f"refinement.{name}")


class Hopes:
    """(E,) what every edge may fall to, m, in place of `lower`; `upper` as it is."""

    def __init__(
        self, known: LatticeBounds, settled: LatticeBounds, optimism: float, look_at_clock: Callable[[], None]
    ) -> None:
        self._known, self._settled, self._optimism, self._look_at_clock = known, settled, optimism, look_at_clock
        self.lower: Values = np.zeros(0)
        self.upper: Values = known.upper

    def update(self) -> tuple[bool, bool]:
        """See `EdgeCosts`."""
        self._look_at_clock()
        self._settled.update()
        self._look_at_clock()
        known, settled = self._known.lower, np.minimum(self._settled.lower, self._known.upper)
        # Where the part is known to be blocked, but not beyond doubt, nothing speaks against the other bound.
        doubted = np.isfinite(known)
        hopes = settled.copy()
        hopes[doubted] += (1.0 - self._optimism) * (known[doubted] - settled[doubted])
        fell = len(self.lower) == 0 or bool((hopes < self.lower).any())
        self.lower = hopes
        return True, fell


class Refinement:
    """Says which edges to plan again, pass by pass.

    Args:
        known: the bounds of the search, up to date whenever this is asked.
        standing: what is known of the states.
        attempts: of the first query of every edge.
        look_at_clock: raises where the time is over; with millions of edges even a pass that asks nothing takes
            seconds.
    """

    def __init__(
        self,
        lattice: Lattice,
        bounds: EdgeBounds,
        known: LatticeBounds,
        standing: LatticeStanding,
        attempts: int,
        options: RefinementOptions,
        look_at_clock: Callable[[], None] = lambda: None,
    ) -> None:
        self._lattice, self._bounds, self._known, self._standing = lattice, bounds, known, standing
        self._attempts, self._options, self._look_at_clock = attempts, options, look_at_clock
        self._tries: dict[Edge, int] = {}  # of edges that this planned; all other closed ones had one
        self._planned: set[Edge] = set()  # in this pass
        self._asked: list[Edge] = []
        self._started_at, self._queries = math.inf, 0  # length, m, and queries when the pass began
        self._settled: LatticeBounds
        self._sequences: SequenceBounds | None = None
        self.passes = 0

    def attempts(self, edge: Edge) -> int:
        """Attempts that an edge has had when it is planned once more."""
        return self._attempts * (self._tries.get(edge, 1) + 1)

    def edges(self, length: float, count: int, queries: int) -> list[Edge]:
        """What to plan next, each edge with its `attempts`; nothing where the refinement has ended.

        Args:
            length: of the best sequence, m.
            count: at most so many, of different parts.
            queries: that the search has asked so far.
        """
        self._look_at_clock()
        self._take_in(self._asked)
        self._asked = []
        while not self._asked and (self._sequences is not None or self._begin(length, queries)):
            assert self._sequences is not None
            worthwhile = (1.0 - self._options.worth) * length - TOLERANCE
            self._sequences.find_standing(worthwhile)
            if self._sequences.lower < worthwhile:
                self._asked = self._most_hopeful(self._sequences, count)
            if not self._asked:
                self._sequences = None
        return self._asked

    def _take_in(self, edges: list[Edge]) -> None:
        """Edges that were planned again."""
        for edge in edges:
            self._tries[edge] = self._tries.get(edge, 1) + 1
            self._planned.add(edge)
            self._settled.look_again(edge[1])

    def _begin(self, length: float, queries: int) -> bool:
        """Start another pass, unless the last one did not gain enough."""
        gained = self._started_at - length
        if self.passes == self._options.passes or gained < self._options.worth * length:
            return False
        if self.passes and queries == self._queries:
            return False  # nothing is left that could matter and that the planner has not answered for good
        self.passes += 1
        self._started_at, self._queries = length, queries
        self._planned.clear()
        self._settled = LatticeBounds(self._lattice, self._bounds, self._is_settled)
        hopes = Hopes(self._known, self._settled, self._options.optimism, self._look_at_clock)
        self._sequences = SequenceBounds(self._lattice, hopes, self._standing)
        return True

    def _is_settled(self, part: int, closed: ClosedEdge) -> bool:
        if closed.refusal is not None and closed.refusal.stage != "path":
            return True
        return (closed.state, part) in self._planned

    def _most_hopeful(self, sequences: SequenceBounds, count: int) -> list[Edge]:
        """Edges of the shortest sequence by hopes that have most to gain."""
        steps = [(sequences.uncertainty(edge), row, part) for row, edge, part in sequences.most_promising()]
        steps = sorted((step for step in steps if step[0] > TOLERANCE), key=lambda step: -step[0])
        return [self._doubted(self._lattice.state(row), part) for _, row, part in steps[:count]]

    def _doubted(self, state: int, part: int) -> Edge:
        """The edge that the cost of an edge rests on: the dearest, and of equals the largest, closed and not settled in
        a subset of its state; without any the edge itself.
        """
        found = [
            (self._bounds.upper(closed.state, part), closed.state.bit_count(), closed.state)
            for closed in self._bounds.closed_edges(part)
            if not closed.state & ~state and not self._is_settled(part, closed)
        ]
        if found:
            return max(found)[2], part
        self._tries.setdefault((state, part), 0)
        return state, part
