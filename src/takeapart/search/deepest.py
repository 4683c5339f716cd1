"""How far a product without an order comes apart: the deepest state, and the shortest sequence that leads there.

Deepest is the state with the fewest parts left. Where all conditions are monotone (fewer parts never hinder), whatever
may leave can leave at once, and the state in which nothing more does is the only dead end. Where statics are asked
state by state that state is only a bound, and states are entered deepest first until none is left.
"""

from __future__ import annotations

import heapq
import math
import time
from collections.abc import Callable, Sequence

from takeapart.problem import Guide, Problem, Standing
from takeapart.removal.bounds import EdgeBounds
from takeapart.removal.result import Blocked, Counts, Effort, OutOfTimeError, Removal
from takeapart.search.result import Budget, Deepest, SearchResult
from takeapart.search.session import SECOND_LOOK, Clock
from takeapart.states import members

MOST_STATES = 20_000  # entered while the deepest one is looked for
MOST_GOALS = 10  # equally deep states to which the shortest sequence is looked for
TOLERANCE = 1e-9  # m
LEAST_SECONDS = 1e-3

Shorten = Callable[[Problem, Budget], SearchResult]
"""A search of the problem in which some parts stay; see `Kept`."""


class Kept:
    """A problem in which some parts never leave, seen as one whose goal is that they alone are left.

    Its states are those of the problem without these parts, so that every search takes it.

    Args:
        problem: all of it.
        kept: mask of the parts that stay; a state that stands.
        bounds: what is known of the problem's edges.
    """

    def __init__(self, problem: Problem, kept: int, bounds: EdgeBounds) -> None:
        self.problem, self.kept = problem, kept
        self.root, self.counts = problem.root & ~kept, problem.counts
        masks = problem.freedom
        self.freedom: Sequence[tuple[int, ...]] | None = None
        if masks is not None:
            self.freedom = [
                () if kept >> part & 1 else tuple(mask for mask in of_part if not mask & kept)
                for part, of_part in enumerate(masks)
            ]
        self.standing = Standing(None if problem.standing.always else self._fallen)
        parts = problem.root.bit_length()
        self.edge_bounds = EdgeBounds([bounds.static(part) for part in range(parts)])
        for part in members(self.root):
            for removal in bounds.removals(part):
                if not removal.blockers & kept:
                    self.edge_bounds.add_removal(removal)
            for edge in bounds.closed_edges(part):
                if edge.state & kept == kept:
                    self.edge_bounds.close(edge.state & ~kept, part, edge.refusal)

    def _fallen(self, state: int) -> int:
        return self.problem.standing.fallen(state | self.kept)

    def candidates(self, state: int) -> list[int]:
        """See `Problem.candidates`."""
        return [part for part in self.problem.candidates(state | self.kept) if not self.kept >> part & 1]

    def hindrance(self, state: int, part: int) -> Blocked | None:
        """See `Problem.hindrance`."""
        return self.problem.hindrance(state | self.kept, part)

    def upper(self, state: int, part: int) -> float:
        """See `Problem.upper`."""
        return self.edge_bounds.upper(state, part)

    def lower(self, state: int, part: int) -> float:
        """See `Problem.lower`."""
        return self.edge_bounds.lower(state, part)

    def remove(self, state: int, part: int, effort: Effort) -> Removal | Blocked:
        """See `Problem.remove`."""
        whole = state | self.kept
        answer = self.problem.remove(whole, part, effort)
        if not effort.fresh:
            if isinstance(answer, Removal):
                self.edge_bounds.add_removal(answer)
            known = self.problem.upper(whole, part)
            if self.problem.lower(whole, part) >= known and self.edge_bounds.upper(state, part) <= known:
                self.edge_bounds.close(state, part, answer if isinstance(answer, Blocked) else None)
        return answer


class _Descent:
    """Looks for the deepest states. Asks the planner while there is budget, and goes on with what is known then."""

    def __init__(self, problem: Problem, bounds: EdgeBounds, clock: Clock) -> None:
        self.problem, self.bounds, self.clock = problem, bounds, clock
        self.complete = True  # no question was left open

    def leave(self, state: int, part: int) -> Removal | None:
        """A removal of the part, however long."""
        known = self.bounds.best(state, part)
        if known is not None or math.isinf(self.bounds.lower(state, part)):
            return known
        first = self._ask(state, part, Effort(is_late=self.clock.late))
        if isinstance(first, Blocked) and first.stage == "path":
            first = self._ask(
                state, part, Effort(attempts=SECOND_LOOK.attempts, is_late=self.clock.late)
            )  # before it is believed
        return first if isinstance(first, Removal) else None

    def _ask(self, state: int, part: int, effort: Effort) -> Removal | Blocked | None:
        if self.clock.spent():
            self.complete = False
            return None
        try:
            answer = self.problem.remove(state, part, effort)
        except OutOfTimeError:
            self.complete = False
            return None
        except KeyboardInterrupt:  # what is known by now is told, as after a search that was stopped
            self.complete, self.clock.stop = False, True
            return None
        if isinstance(answer, Removal):
            self.bounds.add_removal(answer)
        return answer

    def stands(self, state: int) -> bool:
        if self.problem.standing.known(state) is None and self.clock.late():
            self.complete = False
            return False
        try:
            return not self.problem.standing.fallen(state)
        except KeyboardInterrupt:
            self.complete, self.clock.stop = False, True
            return False

    def closure(self) -> tuple[int, list[Removal]]:
        """The state in which nothing more leaves, if every state stood."""
        state, path = self.problem.root, list[Removal]()
        progress = True
        while progress:
            progress = False
            for part in self.problem.candidates(state):
                removal = self.leave(state, part)
                if removal is not None:
                    state, progress = state & ~(1 << part), True
                    path.append(removal)
                    break
        return state, path

    def entered(self, least: int) -> tuple[dict[int, tuple[int, Removal] | None], bool]:
        """States that can be entered, each with a state before it; and whether no deeper one was missed.

        Args:
            least: no state has fewer parts.
        """
        root = self.problem.root
        found: dict[int, tuple[int, Removal] | None] = {root: None}
        waiting = [(root.bit_count(), root)]
        while waiting:
            _, state = heapq.heappop(waiting)
            if state.bit_count() == least:
                return found, True
            for part in self.problem.candidates(state):
                following = state & ~(1 << part)
                if following in found:
                    continue
                removal = self.leave(state, part)
                if removal is None or not self.stands(following):
                    continue
                if len(found) >= MOST_STATES:
                    return found, False
                found[following] = (state, removal)
                heapq.heappush(waiting, (following.bit_count(), following))
        return found, self.complete


def deepest_of(
    problem: Problem, budget: Budget, shorten: Shorten | None = None, proves: bool = False, stopped: bool = False
) -> Deepest:
    """How far a problem comes apart, of which a search found no order.

    Args:
        budget: what is left for it; what is known already costs nothing.
        shorten: looks for the shortest sequence; by default the first one found is taken.
        proves: whether that proves its sequence the shortest.
        stopped: nothing may be asked any more.
    """
    bounds = problem.edge_bounds
    clock = Clock(budget, problem.counts)
    clock.stop = stopped
    descent = _Descent(problem, bounds, clock)
    monotone = problem.standing.always and problem.freedom is not None
    if monotone:
        state, path = descent.closure()
        ends, proved = {state: path}, descent.complete
    else:
        least = descent.closure()[0].bit_count() if problem.freedom is not None else 0
        descent.complete, bound_holds = True, descent.complete
        found, proved = descent.entered(least if bound_holds else 0)
        fewest = min(each.bit_count() for each in found)
        ends = {each: _path(found, each) for each in found if each.bit_count() == fewest}
    lengths = {state: math.fsum(removal.length for removal in path) for state, path in ends.items()}
    shortest = proved and proves and shorten is not None and len(ends) <= MOST_GOALS
    for state in sorted(ends, key=lambda each: (lengths[each], each))[:MOST_GOALS]:
        if shorten is None or clock.spent() or not ends[state]:
            shortest = shortest and not ends[state]
            continue
        left = Budget(
            budget.episodes, max(budget.seconds - clock.seconds, LEAST_SECONDS), max(budget.queries - clock.queries, 1)
        )
        made = shorten(Kept(problem, state, bounds), left)
        if made.removals and made.length < lengths[state] - TOLERANCE:
            ends[state], lengths[state] = list(made.removals), made.length
        bound = made.sequence_bound
        shortest = shortest and bound is not None and bound >= lengths[state] - 1e-6
        clock.stop = clock.stop or made.interrupted
    best = min(ends, key=lambda each: (lengths[each], each))
    return Deepest(best, tuple(ends[best]), lengths[best], proved, shortest)


def deepen(
    problem: Problem,
    result: SearchResult,
    budget: Budget,
    guide: Guide | None,
    run: Callable[[Problem, Budget, Guide | None], SearchResult],
    proves: bool,
    started: tuple[float, int],
) -> Deepest:
    """`deepest_of` with what a search left of its budget.

    Args:
        result: of the search.
        budget: of the search.
        guide: of the search, for the whole problem.
        run: the search.
        proves: whether it proves its sequence the shortest.
        started: monotonic time and queries when the search began.
    """
    seconds, queries = (
        budget.seconds - (time.monotonic() - started[0]),
        budget.queries - (_queries(problem) - started[1]),
    )
    stopped = result.interrupted or seconds <= 0 or queries <= 0
    left = Budget(budget.episodes, max(seconds, LEAST_SECONDS), max(queries, 1))

    def shorten(restricted: Problem, rest: Budget) -> SearchResult:
        assert isinstance(restricted, Kept)
        return run(restricted, rest, None if guide is None else _of_kept(guide, restricted.kept))

    return deepest_of(problem, left, shorten, proves, stopped)


def _queries(problem: Problem) -> int:
    counts: Counts = problem.counts
    return counts.removal_queries


def _of_kept(guide: Guide, kept: int) -> Guide:
    def restricted(states: Sequence[int]) -> list[dict[int, float]]:
        values = guide([state | kept for state in states])
        return [{part: value for part, value in each.items() if not kept >> part & 1} for each in values]

    return restricted


def _path(found: dict[int, tuple[int, Removal] | None], state: int) -> list[Removal]:
    path = list[Removal]()
    while (before := found[state]) is not None:
        state, removal = before
        path.append(removal)
    return path[::-1]
