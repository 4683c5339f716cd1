"""The Markov decision process of Sec. V-A.

A state is a mask of parts, an action removes one of them, the reward is minus the length of the removal path.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Protocol

import numpy as np

from takeapart.model.assembly import Assembly
from takeapart.problem.standing import Standing, Statics, standing_by
from takeapart.removal.bounds import EdgeBounds
from takeapart.removal.journal import QueryJournal, RecordedAnswer, RemovalQuery, ThreadCounts
from takeapart.removal.planner import RemovalPlanner
from takeapart.removal.reasons import Reasons
from takeapart.removal.result import Blocked, Counts, Effort, OutOfTimeError, Removal
from takeapart.stability import Stability
from takeapart.states import members, seed_words

Guide = Callable[[Sequence[int]], Sequence[Mapping[int, float]]]
"""States -> for each the Q-value (expected sum of rewards, m, negative) of every candidate part."""


class Problem(Protocol):
    """All that a search ever sees. Parts are numbers, states are masks (`int`); the goal is state 0."""

    @property
    def root(self) -> int:
        """State with all removable parts."""
        ...

    @property
    def counts(self) -> Counts:
        """Planner calls spent so far."""
        ...

    @property
    def freedom(self) -> Sequence[tuple[int, ...]] | None:
        """Per part number masks of parts that its ways out would hit or that would fall: it is a candidate of a state
        if any of them shares no part with the state; without any, it never is. None where candidates follow from no
        such masks; then conditions may be other than monotone.
        """
        ...

    @property
    def standing(self) -> Standing:
        """Which states may be entered: no removal may lead to one that does not stand. `candidates`, `lower`, `upper`
        and `remove` take every state as standing: searches ask for the states on the way that they propose.
        """
        ...

    @property
    def edge_bounds(self) -> EdgeBounds:
        """Bounds on the cost of all edges, into which searches write what they learn; searches on one problem may share
        them. A search asks for them once.
        """
        ...

    def candidates(self, state: int) -> Sequence[int]:
        """Parts that masks of gravity and exits let go in this state, ascending; costs nothing."""
        ...

    def hindrance(self, state: int, part: int) -> Blocked | None:
        """Why a part may not leave, whatever the arm can do: it is no candidate, or others would fall without it. None
        if it may.
        """
        ...

    def upper(self, state: int, part: int) -> float:
        """Length of the shortest known removal that is valid here, m; infinite if none is known."""
        ...

    def lower(self, state: int, part: int) -> float:
        """Bound on the cost of this edge, m; infinite where the part is known to be blocked."""
        ...

    def remove(self, state: int, part: int, effort: Effort) -> Removal | Blocked:
        """The removal query: the only expensive call; counted.

        Raises:
            OutOfTimeError: `effort.is_late` said so before there was an answer; nothing was counted or learned.
        """
        ...


class AssemblyProblem:
    """The decision process of an assembly in a workcell: gravity, lifting, and the removal planner with its library.

    Answers do not depend on the threads that ask: the random numbers of a query follow from the seed, the edge, and how
    often it was asked before.

    Args:
        planner: of the assembly's removals.
        stability: what gravity lets go, by masks, by statics asked state by state, or by both.
        seed: of all random choices of the planner.
        library: removals and closed edges known before; by default none.
        journal: answers queries that were answered before, and keeps the others. A recalled answer counts as it did
            when it was planned.
    """

    def __init__(
        self,
        planner: RemovalPlanner,
        stability: Stability | Statics,
        seed: int = 0,
        library: EdgeBounds | None = None,
        journal: QueryJournal | None = None,
    ) -> None:
        assembly = planner.assembly
        self.planner, self.stability, self.seed, self.journal = planner, stability, seed, journal
        if journal is not None:
            planner.counts = ThreadCounts(planner.counts.motion_plans, planner.counts.removal_queries)
        self.root = assembly.root
        self.counts: Counts = planner.counts
        movable = members(self.root)
        self.freedom: list[tuple[int, ...]] = [()] * len(assembly.parts)
        for part in movable:
            if planner.is_graspable(part):
                dependents = self._dependents(part, self.root)
                self.freedom[part] = tuple(mask | dependents for mask in planner.freedom(part))
        self.standing = standing_by(stability) if isinstance(stability, Statics) else Standing()
        bounds = [planner.candidate_bound(part) if part in movable else 0.0 for part in range(len(assembly.parts))]
        self.edge_bounds = library or EdgeBounds([bound if math.isfinite(bound) else 0.0 for bound in bounds])
        self._asked: dict[tuple[int, int], int] = {}
        self._effort: dict[tuple[int, int], int] = {}
        self._lock = threading.Lock()

    @cached_property
    def reasons(self) -> Reasons:
        """Explains refusals; what it needs is made at the first question."""
        return Reasons(self.planner)

    @property
    def assembly(self) -> Assembly:
        """The product."""
        return self.planner.assembly

    def candidates(self, state: int) -> list[int]:
        """Parts that gravity, their exits and the gripper's limits let go in this state, ascending."""
        return [part for part in members(state) if any(not mask & state for mask in self.freedom[part])]

    def upper(self, state: int, part: int) -> float:
        """Length of the shortest known removal that is valid here, m; infinite if none is known."""
        return self.edge_bounds.upper(state, part)

    def lower(self, state: int, part: int) -> float:
        """Bound on the cost of this edge, m; infinite where the part is known to be blocked."""
        return self.edge_bounds.lower(state, part)

    def hindrance(self, state: int, part: int) -> Blocked | None:
        """Why gravity or its exits keep a part in a state, or no gripper of this cell ever takes it; None if none
        does.
        """
        by_masks = self._hindrance_by_masks(state, part)
        if by_masks is not None:
            return by_masks
        fallen = self.standing.fallen(state & ~(1 << part))
        return Blocked(part, "stability", fallen) if fallen else None

    def _hindrance_by_masks(self, state: int, part: int) -> Blocked | None:
        if not self.planner.is_graspable(part):
            return Blocked(part, "grasp", 0)
        fallen = self._dependents(part, state)
        if fallen:
            return Blocked(part, "stability", fallen)
        hit = [mask & state for mask in self.planner.freedom(part)]
        return Blocked(part, "lift", min(hit, key=int.bit_count, default=0)) if all(hit) else None

    def _dependents(self, part: int, state: int) -> int:
        return self.stability.dependents(part, state) if isinstance(self.stability, Stability) else 0

    def remove(self, state: int, part: int, effort: Effort) -> Removal | Blocked:
        """The removal query. What the library answers for certain costs nothing and is not counted.

        An edge that was planned already is planned again if `effort.attempts` says more than it had so far, by as many
        attempts as are lacking.

        Returns:
            The shortest removal known after asking, if it is shorter than `effort.shorter_than`, else why there is
            none.

        Raises:
            OutOfTimeError: the time was over first; everything but the time is as if this had not been asked.
        """
        hindrance = self._hindrance_by_masks(state, part)
        if hindrance is not None:
            return hindrance
        if effort.fresh:
            return self._query(state, part, effort.shorter_than, effort.attempts, effort.is_late)
        known = self.edge_bounds.best(state, part)
        edge = (state, part)
        made = self._effort.get(edge, 0)
        if self.edge_bounds.is_closed(state, part) and effort.attempts <= max(made, 1):
            refusal = self.edge_bounds.refusal(state, part)
        else:
            # A planner that looks only for less than it found is less likely to find it: no limit the second time.
            limit = math.inf if made else min(effort.shorter_than, known.length if known else math.inf)
            found = self._query(state, part, limit, max(effort.attempts - made, 1), effort.is_late)
            refusal = None
            if isinstance(found, Removal):
                self.edge_bounds.add_removal(found)
                known = self.edge_bounds.best(state, part)
            else:
                refusal = found
            if known is None or effort.shorter_than >= known.length:
                self.edge_bounds.close(state, part, refusal if known is None else None)
                with self._lock:
                    self._effort[edge] = max(effort.attempts, self._effort.get(edge, 0))
        if known is not None and known.length < effort.shorter_than:
            return known
        return refusal or Blocked(part, "path", 0)

    def _query(
        self, state: int, part: int, limit: float, attempts: int, is_late: Callable[[], bool]
    ) -> Removal | Blocked:
        with self._lock:
            self.counts.removal_queries += 1
            turn = self._asked.get((state, part), 0)
            self._asked[state, part] = turn + 1
        query = RemovalQuery(state, part, turn, attempts, limit)
        try:
            return self._answer(query, is_late)
        except OutOfTimeError:
            with self._lock:
                self.counts.removal_queries -= 1
                if self._asked[state, part] == turn + 1:
                    self._asked[state, part] = turn  # asked again, it draws the same random numbers
            raise

    def _answer(self, query: RemovalQuery, is_late: Callable[[], bool]) -> Removal | Blocked:
        if self.journal is None:
            return self._plan(query, is_late)
        recorded = self.journal.recall(query)
        if recorded is not None:
            self.counts.motion_plans += recorded.motion_plans
            return recorded.answer
        assert isinstance(self.counts, ThreadCounts)
        before = self.counts.of_this_thread
        answer = self._plan(query, is_late)
        self.journal.record(query, RecordedAnswer(answer, self.counts.of_this_thread - before))
        return answer

    def _plan(self, query: RemovalQuery, is_late: Callable[[], bool]) -> Removal | Blocked:
        state, part = query.state, query.part
        rng = np.random.default_rng([self.seed, part, query.turn, *seed_words(state)])
        return self.planner.plan(
            part, state, rng=rng, shorter_than=query.shorter_than, attempts=query.attempts, is_late=is_late
        )
