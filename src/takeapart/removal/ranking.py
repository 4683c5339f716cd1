"""The order in which directions are looked at, so that few need more than a glance.

Ways out are ranked by what they hit, how steep and how long they are, and one that is no better than those before it
is not kept. What is known of a direction before it is looked at tells where its way can come in that order at best:
whatever is not kept even there needs no look.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable
from dataclasses import dataclass

from takeapart.removal.selection import Figures, is_kept, preference

ROUNDED = 2e-6  # of rises, which are ranked by six digits
MARGIN = 1e-9  # m, by which the length of a way that is not known yet may be rounded otherwise


@dataclass(eq=False)
class Candidate:
    """A direction whose way may be worth keeping.

    Args:
        number: of the direction.
        at_best: no figures of its way are better: fewer blockers, steeper, shorter.
        glanced: whether what is met at once is among these blockers already.
        way: the figures of its way; None until it was looked at.
    """

    number: int
    at_best: Figures
    glanced: bool = False
    way: Figures | None = None

    @property
    def rank(self) -> tuple[int, bool, float, float, int]:
        """Its place in the order, at best."""
        if self.way is None:
            count, rise = self.at_best.blockers.bit_count(), -round(self.at_best.rise + ROUNDED, 6)
            return count, self.at_best.down, rise, 0.0, self.number
        return *preference(self.way), self.number


class Ranking:
    """Candidates, and how far they have to be looked at."""

    def __init__(self) -> None:
        self._all: list[Candidate] = []
        self._restart()

    def _restart(self) -> None:
        self._waiting = [(each.rank, each) for each in self._all]
        heapq.heapify(self._waiting)
        self._kept: list[Figures] = []

    def add(self, candidates: Iterable[Candidate]) -> None:
        """More candidates; all are ranked anew."""
        self._all += candidates
        self._restart()

    def drop(self, candidate: Candidate) -> None:
        """One that `wanted` gave has no way."""
        self._all.remove(candidate)

    def known(self, candidate: Candidate) -> None:
        """More is known of one that `wanted` gave."""
        heapq.heappush(self._waiting, (candidate.rank, candidate))

    def wanted(self, glances: int, looks: int) -> list[Candidate]:
        """The next that must be looked at, or glanced at, and those alike right after them, so many at most; none once
        all that are kept are known."""
        found: list[Candidate] = []
        while self._waiting and len(found) < (looks if found and found[0].glanced else glances):
            candidate = self._waiting[0][1]
            if not is_kept(candidate.way or candidate.at_best, self._kept):
                heapq.heappop(self._waiting)
                continue
            if found and (candidate.way is not None or candidate.glanced != found[0].glanced):
                break
            heapq.heappop(self._waiting)
            if candidate.way is None:
                found.append(candidate)
            else:
                self._kept.append(candidate.way)
        return found
