"""What a removal query is to a journal, which answers it without planning where it was answered before.

An answer depends on its query, the seed, the assembly, the workcell and the options of the planner alone. So a search
that was cut off comes to the same point again when the answers it had are repeated to it.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Protocol

from takeapart.removal.result import Blocked, Counts, Removal


@dataclass(frozen=True)
class RemovalQuery:
    """A question to the removal planner.

    Args:
        state: parts that are there.
        part: the one that shall leave.
        turn: how often this part was asked for in this state before.
        attempts: how often it is planned.
        shorter_than: only a removal shorter than this is of interest, m.
    """

    state: int
    part: int
    turn: int
    attempts: int
    shorter_than: float


@dataclass(frozen=True, eq=False)
class RecordedAnswer:
    """What the planner said, and the motion plans that it made for it."""

    answer: Removal | Blocked
    motion_plans: int


class QueryJournal(Protocol):
    """Keeps every answer of the removal planner. Is asked from several threads at once."""

    def recall(self, query: RemovalQuery) -> RecordedAnswer | None:
        """The answer of a query that was answered before."""
        ...

    def record(self, query: RemovalQuery, recorded: RecordedAnswer) -> None:
        """Keep an answer; when this returns, no end of the process can lose it."""
        ...


class ThreadCounts(Counts):
    """Counts that know how many motion plans each thread added: what one query cost, while others are planned.

    ``counts.motion_plans += n`` is right from several threads at once, whatever locks they hold.
    """

    def __init__(self, motion_plans: int = 0, removal_queries: int = 0) -> None:
        self._lock, self._local = threading.Lock(), threading.local()
        self._total = motion_plans
        self.removal_queries = removal_queries

    @property
    def motion_plans(self) -> int:
        """Of all threads."""
        self._local.read = self._total
        return self._total

    @motion_plans.setter
    def motion_plans(self, value: int) -> None:
        added = value - self._local.read  # what this thread adds to the number that it read
        with self._lock:
            self._total += added
        self._local.added = self.of_this_thread + added

    @property
    def of_this_thread(self) -> int:
        """Motion plans that the calling thread added."""
        added: int = getattr(self._local, "added", 0)
        return added
