"""One run of a search: its budget, what it found, its second look at dead ends. Every search works with one."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

from takeapart.problem import Problem
from takeapart.removal.result import Blocked, Counts, Effort, OutOfTimeError, Removal
from takeapart.search.result import Budget, Progress, ProgressListener, SearchResult

MAXIMUM_REFUSALS = 10  # dead ends in a result; enough to explain a failure, few enough to read

SECOND_LOOK = Effort(attempts=8)
"""At parts that found no path in a dead end, before it is believed: the last attempts grow larger trees."""

TransitionObserver = Callable[[int, int, float, int, Sequence[int]], None]
"""Called with (state, part, reward in m, next state, its candidates) for every removal that a query returned."""


SettledObserver = Callable[[int, int, float, int, Sequence[int], float, float], None]
"""Called as a `TransitionObserver`, then with the least and the greatest length, m, that the shortest sequence may have
that begins with the removal; they are equal where it is known."""


class Clock:
    """Tells when a budget is spent. `stop` ends the search from outside, as Ctrl-C does.

    Attributes:
        reserve: of the seconds, those that are kept for what follows the search: bringing its bound up to date.
    """

    def __init__(self, budget: Budget, counts: Counts) -> None:
        self.budget, self.counts = budget, counts
        self.started, self.first_query, self.episodes = time.monotonic(), counts.removal_queries, 0
        self.stop = False
        self.reserve = 0.0

    @property
    def seconds(self) -> float:
        return time.monotonic() - self.started

    @property
    def queries(self) -> int:
        return self.counts.removal_queries - self.first_query

    def spent(self) -> bool:
        return self.late() or self.episodes >= self.budget.episodes or self.queries >= self.budget.queries

    def late(self) -> bool:
        """Whether the seconds but the reserve are over, or the search was stopped: ends queries, and work that asks
        nothing.
        """
        return self.stop or self.seconds >= self.budget.seconds - self.reserve

    def over(self) -> bool:
        """Whether all seconds are over, or the search was stopped."""
        return self.stop or self.seconds >= self.budget.seconds


class BudgetSpentError(Exception):
    """Leaves a search from any depth once its budget is spent; no search lets it out."""


class Session:
    """What every search keeps beside its own structure: budget, best sequence, dead ends; it also does the asking.

    Args:
        observe: is told every planned transition.

    Attributes:
        best: length, m, and removals of the shortest sequence so far; infinite and empty without one.
        bound: no order is shorter, m; minus infinity where nothing is known.
        dead_ends: states with parts left of which none can leave, with what blocks each of them.
        statistics: numbers for tables.
        infeasible: proved that no order exists, for the removals that the planner finds.
    """

    def __init__(
        self,
        problem: Problem,
        budget: Budget,
        listen: ProgressListener | None = None,
        observe: TransitionObserver | None = None,
    ) -> None:
        self.problem, self.listen, self.observe = problem, listen, observe
        self.clock = Clock(budget, problem.counts)
        self.best: tuple[float, tuple[Removal, ...]] = (math.inf, ())  # one value, so that no interrupt can tear it
        self.bound = -math.inf
        self.dead_ends: dict[int, tuple[Blocked, ...]] = {}
        self.statistics: dict[str, float] = {}
        self.infeasible = False
        self.standing = problem.standing
        self._first_question = problem.standing.questions

    def run(self, search: Callable[[], None]) -> bool:
        """Run a search to its end, the end of its budget, or Ctrl-C; whether it was that."""
        try:
            search()
        except BudgetSpentError:
            pass
        except KeyboardInterrupt:
            return True
        return False

    def ask(self, state: int, part: int, effort: Effort) -> Removal | Blocked:
        """The removal query, for a state behind it that stands; where it does not, the refusal names what would fall.

        Raises:
            BudgetSpentError: nothing was asked because the budget is spent, or the time was over before the answer.
        """
        if self.clock.spent():
            raise BudgetSpentError
        if not self.stands(state & ~(1 << part)):
            return self.unsupported(state, part)
        try:
            answer = self.problem.remove(state, part, replace(effort, is_late=self.clock.late))
        except OutOfTimeError:
            raise BudgetSpentError from None
        if self.observe is not None and isinstance(answer, Removal):
            following = state & ~(1 << part)
            self.observe(state, part, -answer.length, following, self.problem.candidates(following))
        return answer

    def stands(self, state: int) -> bool:
        """Whether a state may be entered; a question of statics where it was not asked before.

        Raises:
            BudgetSpentError: the time is over.
        """
        if self.standing.known(state) is None:
            self.look_at_clock()
        return not self.standing.fallen(state)

    def unsupported(self, state: int, part: int) -> Blocked:
        """The refusal of a part whose leaving lets others fall, as is known."""
        return Blocked(part, "stability", self.standing.fallen(state & ~(1 << part)))

    def is_proof(self, state: int) -> bool:
        """Whether a dead end would be one if every state stood. Then, conditions being monotone otherwise, no order
        leads on from any state that holds its parts.
        """
        return not any(self.standing.is_fallen(state & ~(1 << part)) for part in self.problem.candidates(state))

    def look_at_clock(self) -> None:
        """Raises BudgetSpentError if the time is over; for work that asks nothing."""
        if self.clock.late():
            raise BudgetSpentError

    def offer(self, removals: Sequence[Removal], **found_at: float) -> float:
        """Take note of a complete sequence; `found_at` goes to the statistics if it is the best. Returns its length."""
        length = sum(removal.length for removal in removals)
        self.statistics.setdefault("initial_length", length)
        if length < self.best[0]:
            self.best = (length, tuple(removals))
            self.statistics |= {"shortest_length": length, **found_at}
            self.report()
        return length

    def second_look(self, state: int, refusals: Iterable[Blocked]) -> Iterator[Removal]:
        """What may leave a dead end after all: before it is believed, parts without a path are planned anew, harder."""
        for refusal in refusals:
            if refusal.stage == "path":
                answer = self.ask(state, refusal.part, SECOND_LOOK)
                if isinstance(answer, Removal):
                    yield answer

    def dead_end(self, state: int, refusals: Iterable[Blocked]) -> None:
        """Take note of a state with parts left and none removable."""
        self.dead_ends.setdefault(state, tuple(refusals))

    def report(self) -> None:
        """Tell the listener."""
        if self.listen is not None:
            clock = self.clock
            length, removals = self.best
            self.listen(Progress(clock.episodes, length, self.bound, clock.queries, clock.seconds, removals))

    def result(self, interrupted: bool, sequence_bound: float | None = None) -> SearchResult:
        """Best sequence; without one, the deepest dead ends."""
        length, removals = self.best
        refusals: tuple[tuple[int, tuple[Blocked, ...]], ...] = ()
        if math.isinf(length):
            deepest_first = sorted(self.dead_ends.items(), key=lambda item: (item[0].bit_count(), item[0]))
            refusals = tuple(deepest_first[:MAXIMUM_REFUSALS])
        self.statistics["episodes"] = self.clock.episodes
        if not self.standing.always:
            self.statistics["stability_questions"] = self.standing.questions - self._first_question
        statistics = dict(self.statistics)
        return SearchResult(removals, length, sequence_bound, refusals, statistics, self.infeasible, interrupted)
