"""Asks the removal planner for several edges at once and books the answers.

The edges are chosen before the first is asked, hold every part at most once, and are booked in their order: what one
query finds cannot change another of the same batch, and the outcome does not depend on the number of threads.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType

from takeapart.problem import Problem
from takeapart.removal.bounds import EdgeBounds
from takeapart.removal.result import Blocked, Effort, OutOfTimeError, Removal
from takeapart.search.session import BudgetSpentError, Session
from takeapart.states import members

Edge = tuple[int, int]
"""State and part."""


class EdgeQueries:
    """The asking side of the searches that work with bounds; a context manager that ends its threads.

    Args:
        session: its problem is asked, its budget is kept.
        bounds: where the answers are booked.
        attempts: of every query, unless told otherwise.
        workers: threads that ask; one asks in the calling thread.
    """

    def __init__(self, session: Session, bounds: EdgeBounds, attempts: int, workers: int) -> None:
        self._session, self._bounds, self._attempts = session, bounds, attempts
        self._pool = ThreadPoolExecutor(workers, "removal-query") if workers > 1 else None
        self._cancelled = False

    def __enter__(self) -> EdgeQueries:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)

    def ask(self, edges: Sequence[Edge], attempts: int | Sequence[int] | None = None) -> None:
        """Plan edges with the full effort, each only for something shorter than what is known, and close them.

        Args:
            edges: of different parts. Those beyond the budget in queries are left out.
            attempts: of all or of each, instead of the usual ones.

        Raises:
            BudgetSpentError: before anything is asked, or because the time ran out within the batch.
        """
        clock = self._session.clock
        if clock.spent():
            raise BudgetSpentError
        room = clock.budget.queries - clock.queries
        asked = [edge for i, edge in enumerate(edges) if i < room]
        each = [attempts or self._attempts] * len(edges) if isinstance(attempts, int | None) else attempts
        efforts = [
            Effort(number, self._bounds.upper(*edge), is_late=clock.late)
            for edge, number in zip(asked, each, strict=False)
        ]
        if self._pool is None:
            for edge, effort in zip(asked, efforts, strict=True):
                answer = self._query(edge, effort)
                if answer is None:
                    raise BudgetSpentError
                self._book(edge, answer)
            return
        futures = [self._pool.submit(self._query, edge, effort) for edge, effort in zip(asked, efforts, strict=True)]
        try:
            answers = [future.result() for future in futures]
        except BaseException:
            self._salvage(asked, futures)
            raise
        for edge, answer in zip(asked, answers, strict=True):
            if answer is not None:
                self._book(edge, answer)
        if None in answers:
            raise BudgetSpentError

    def _query(self, edge: Edge, effort: Effort) -> Removal | Blocked | None:
        """The planner's answer; None where the time was over before there was one."""
        # Not clock.spent(): while threads are asking, the count of queries depends on their timing.
        clock = self._session.clock
        if self._cancelled or clock.late():
            return None
        try:
            return self._session.problem.remove(*edge, effort)
        except OutOfTimeError:
            return None

    def _salvage(self, edges: Sequence[Edge], futures: Sequence[Future[Removal | Blocked | None]]) -> None:
        """After Ctrl-C or an error: let running queries end, drop the waiting ones, book what was answered."""
        self._cancelled = True
        for edge, future in zip(edges, futures, strict=True):
            if not future.cancel() and future.exception() is None and (answer := future.result()) is not None:
                self._book(edge, answer)

    def _book(self, edge: Edge, answer: Removal | Blocked) -> None:
        state, part = edge
        if isinstance(answer, Removal):
            self._bounds.add_removal(answer)
            if self._session.observe is not None:
                following = state & ~(1 << part)
                self._session.observe(
                    state, part, -answer.length, following, self._session.problem.candidates(following)
                )
        known = math.isfinite(self._bounds.upper(state, part))
        self._bounds.close(state, part, None if known or isinstance(answer, Removal) else answer)


def _refusal(problem: Problem, bounds: EdgeBounds, state: int, part: int) -> Blocked:
    fallen = problem.standing.known(state & ~(1 << part))
    if fallen:
        return Blocked(part, "stability", fallen)
    return bounds.refusal(state, part) or Blocked(part, "path", state & ~(1 << part))


def refusals_in(problem: Problem, bounds: EdgeBounds, state: int) -> list[Blocked]:
    """Why each part of a dead end cannot leave: what the planner said or, where nothing may be lifted, what hinders."""
    parts = problem.candidates(state)
    if parts:
        return [_refusal(problem, bounds, state, part) for part in parts]
    return [refusal for part in members(state) if (refusal := problem.hindrance(state, part)) is not None]
