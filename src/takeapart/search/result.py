"""What every search takes as its limits and gives back."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from takeapart.model.errors import InputError
from takeapart.removal.result import Blocked, Removal


@dataclass(frozen=True)
class Budget:
    """When to stop, whichever comes first; a search is anytime and keeps the best sequence so far.

    Args:
        episodes: of the search (MCTS episodes, random restarts, rounds of the exact search).
        seconds: wall time.
        queries: removal queries.
    """

    episodes: float = math.inf
    seconds: float = math.inf
    queries: float = math.inf

    def __post_init__(self) -> None:
        for name in ("episodes", "seconds", "queries"):
            if not getattr(self, name) > 0:
                raise InputError(f"{getattr(self, name)}; must be above 0", f"budget.{name}")


@dataclass(frozen=True)
class Progress:
    """A sign of life of a running search, for progress bars, logs and viewers. Lengths in m, infinite where not known.

    Args:
        removals: the best sequence so far; empty where none is known.
    """

    episode: int
    length: float
    bound: float
    queries: int
    seconds: float
    removals: tuple[Removal, ...] = ()


ProgressListener = Callable[[Progress], None]


@dataclass(frozen=True, eq=False)
class Deepest:
    """How far a product comes apart that has no order, or of which none was found.

    Args:
        state: the parts that are left.
        removals: that lead there, in the order of execution; empty if no part leaves.
        length: sum of their lengths, m.
        is_deepest: no state with fewer parts can be reached, for the removals that the planner finds.
        is_shortest: no sequence to a state with as few parts is shorter, likewise.
    """

    state: int
    removals: tuple[Removal, ...]
    length: float
    is_deepest: bool = False
    is_shortest: bool = False


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The best sequence that a search found.

    Args:
        removals: in the order of execution; empty if no sequence to the goal was found.
        length: sum of their lengths, m; infinite if none was found.
        sequence_bound: no order is shorter, relative to the paths the planner found, m; None where the search gives
            none.
        refusals: where the search found no sequence, what blocked it: per dead end its state and refusals.
        statistics: numbers for tables ("initial_length", "found_episode", "found_step", ...).
        infeasible: proved that no order exists, for the removals that the planner finds.
        interrupted: stopped by Ctrl-C.
        history: queries so far, shortest length and bound, m, wherever one of the lengths changed; infinite where not
            known.
        deepest: how far the product comes apart, where no sequence was found; see `takeapart.search.deepest`.
    """

    removals: tuple[Removal, ...]
    length: float
    sequence_bound: float | None = None
    refusals: tuple[tuple[int, tuple[Blocked, ...]], ...] = ()
    statistics: dict[str, float] = field(default_factory=dict)
    infeasible: bool = False
    interrupted: bool = False
    history: tuple[tuple[int, float, float], ...] = ()
    deepest: Deepest | None = None


class History:
    """A listener that keeps how length and bound came about, and hands everything on.

    Args:
        listen: hears what this hears.
    """

    def __init__(self, listen: ProgressListener | None = None) -> None:
        self.rows: list[tuple[int, float, float]] = []
        self._listen = listen

    def __call__(self, progress: Progress) -> None:
        row = (progress.queries, progress.length, progress.bound)
        if not self.rows or self.rows[-1][1:] != row[1:]:
            if self.rows and self.rows[-1][0] == progress.queries:
                self.rows.pop()  # the last word at one number of queries counts
            self.rows.append(row)
        if self._listen is not None:
            self._listen(progress)
