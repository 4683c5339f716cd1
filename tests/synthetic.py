"""Synthetic problems with known optima, for the tests of the searches.

Every part has hidden removals (length, blockers). Its cost in a state is the shortest hidden removal whose blockers are
all gone; gravity masks say which parts must be gone before it may leave, and of its ways out any must be free. All are
monotone: with fewer parts present nothing gets longer or blocked. Hence a feasible problem of this kind has no dead
ends at all (any witness order, with the parts already gone left out, goes on from every state). Two things break that,
and so make dead ends in feasible problems: `needs` (a part may leave only while others are still there) breaks the
monotony of the candidates, never of the costs; states that do not stand may not be entered.
"""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from takeapart.model.plan import Grasp
from takeapart.problem import Guide, Standing
from takeapart.removal.bounds import EdgeBounds
from takeapart.removal.result import Blocked, Counts, Effort, Removal

STRAIGHT_LINE = 0.8  # the a-priori bound of a part, as a share of its shortest hidden removal


@dataclass(frozen=True)
class Hidden:
    """A removal that the planner can find: length, m, and the mask of the parts that it would hit."""

    length: float
    blockers: int


def members(state: int) -> list[int]:
    """Parts of a state, ascending."""
    return [part for part in range(state.bit_length()) if state >> part & 1]


def synthetic_removal(part: int, length: float, blockers: int) -> Removal:
    """A removal along x whose tool path has the given length, m (Eq. 2)."""
    tool_path = np.zeros((2, 7))
    tool_path[:, 3] = 1.0
    tool_path[1, 0] = length
    grasp = Grasp(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), 0.02)
    return Removal(part, grasp, np.zeros((2, 7)), tool_path, length, blockers)


class SyntheticProblem:
    """Implements `takeapart.problem.Problem`; thread-safe, and its answers do not depend on the order of questions.

    Args:
        hidden: removals per part.
        gravity: per part the mask of parts that must be gone before it may leave.
        needs: per part the mask of parts that must still be there; zero (monotone) by default.
        ways: per part masks of which one must be gone altogether before it may leave; by default one, with no part.
        falls: of the states that do not stand what falls in them; by default all stand.
        noise: a found removal is longer than the hidden one by a random share up to this (a sampling planner).
        seed: of the noise; the draws depend on seed, state, part and how often this edge was planned, nothing else.
    """

    def __init__(
        self,
        hidden: Sequence[Sequence[Hidden]],
        gravity: Sequence[int] | None = None,
        needs: Sequence[int] | None = None,
        noise: float = 0.0,
        seed: int = 0,
        ways: Sequence[Sequence[int]] | None = None,
        falls: Mapping[int, int] | None = None,
    ) -> None:
        self.hidden = [sorted(removals, key=lambda removal: removal.length) for removals in hidden]
        self.gravity = list(gravity) if gravity is not None else [0] * len(hidden)
        self.needs = list(needs) if needs is not None else [0] * len(hidden)
        self.ways = [list(masks) for masks in ways] if ways is not None else [[0] for _ in hidden]
        self.falls = dict(falls) if falls is not None else {}
        self.standing = Standing(self._fallen_in if self.falls else None)
        self.asked_states: list[int] = []  # whether they stand, in order
        self.noise, self.seed = noise, seed
        self.root = (1 << len(hidden)) - 1
        self.counts = Counts()
        self.asked: list[tuple[int, int, Effort]] = []  # counted queries, in order
        self.given_bounds: EdgeBounds | None = None
        self._library: list[list[Removal]] = [[] for _ in hidden]
        self._closed: list[set[int]] = [set() for _ in hidden]  # states whose edge was planned with full effort
        self._planned: dict[tuple[int, int], int] = {}
        self._lock = threading.RLock()

    # The truth, unknown to a search.

    def true_cost(self, state: int, part: int) -> float:
        """Length of the shortest hidden removal that is valid, m; infinite if none is. Gravity is not looked at."""
        return min((each.length for each in self.hidden[part] if not each.blockers & state), default=math.inf)

    def optimum(self, start: int | None = None) -> tuple[float, tuple[int, ...]]:
        """Shortest length, m, and order from a state (the root) on, by dynamic programming; infinite and empty if none.

        It is an optimum of the hidden removals: with noise, a search can only come close to it.
        """
        best: dict[int, tuple[float, tuple[int, ...]]] = {0: (0.0, ())}

        def solve(state: int) -> tuple[float, tuple[int, ...]]:
            if state not in best:
                found: tuple[float, tuple[int, ...]] = (math.inf, ())
                for part in self.candidates(state):
                    cost = self.true_cost(state, part)
                    if cost < math.inf and self.stands(state & ~(1 << part)):
                        rest, order = solve(state & ~(1 << part))
                        if cost + rest < found[0]:
                            found = (cost + rest, (part, *order))
                best[state] = found
            return best[state]

        return solve(self.root if start is None else start)

    def optimum_by_orders(self) -> float:
        """The same length by trying every order of the parts; only for few parts."""
        return min(self.order_length(order) for order in itertools.permutations(members(self.root)))

    def order_length(self, order: Sequence[int]) -> float:
        """True length of an order, m; infinite if it is not feasible."""
        state, length = self.root, 0.0
        for part in order:
            if part not in self.candidates(state):
                return math.inf
            length += self.true_cost(state, part)
            state &= ~(1 << part)
            if not self.stands(state):
                return math.inf
        return length if state == 0 else math.inf

    def reachable(self) -> dict[int, list[int]]:
        """Every state that can be reached from the root, with its removable parts."""
        found: dict[int, list[int]] = {}
        waiting = [self.root]
        while waiting:
            state = waiting.pop()
            if state not in found:
                found[state] = self.removable(state)
                waiting += [state & ~(1 << part) for part in found[state]]
        return found

    def removable(self, state: int) -> list[int]:
        """Parts that may leave a state in truth."""
        return [
            part
            for part in self.candidates(state)
            if self.true_cost(state, part) < math.inf and self.stands(state & ~(1 << part))
        ]

    def stands(self, state: int) -> bool:
        """Whether a state may be entered."""
        return not self.falls.get(state, 0)

    # What a search sees.

    def _fallen_in(self, state: int) -> int:
        assert state
        self.asked_states.append(state)
        return self.falls.get(state, 0)

    @property
    def freedom(self) -> Sequence[tuple[int, ...]] | None:
        """Not said here: `needs` is no condition that masks of what must be gone could express."""
        return None

    @property
    def edge_bounds(self) -> EdgeBounds:
        """Those given, or new ones for every search, which knows nothing of earlier ones then."""
        return self.given_bounds or EdgeBounds([self.static_lower(part) for part in range(len(self.hidden))])

    def static_lower(self, part: int) -> float:
        """The a-priori bound of a part in `edge_bounds`, m."""
        return 0.0

    def hindrance(self, state: int, part: int) -> Blocked | None:
        if part in self.candidates(state):
            return None
        masks = [mask & state for mask in self.freedom[part]] if self.freedom is not None else [state & ~(1 << part)]
        return Blocked(part, "stability", min(masks, key=int.bit_count, default=0))

    def candidates(self, state: int) -> list[int]:
        return [
            part
            for part in members(state)
            if not self.gravity[part] & state
            and self.needs[part] & state == self.needs[part]
            and any(not way & state for way in self.ways[part])
        ]

    def upper(self, state: int, part: int) -> float:
        with self._lock:
            return min((each.length for each in self._library[part] if each.valid_in(state)), default=math.inf)

    def lower(self, state: int, part: int) -> float:
        """Largest closed cost over closed subsets; the closed cost is the shortest library removal valid there."""
        with self._lock:
            bounds = [self.upper(closed, part) for closed in self._closed[part] if closed & ~state == 0]
            known = self.upper(state, part)
        straight = STRAIGHT_LINE * min((each.length for each in self.hidden[part]), default=math.inf)
        return max([min(straight, known), *bounds])

    def remove(self, state: int, part: int, effort: Effort) -> Removal | Blocked:
        """See `Problem.remove`. An edge that is closed, also for free, is answered from the library and not counted.

        With a finite `shorter_than`: a removal only if it is shorter, otherwise `Blocked("path", blamed=0)`, which then
        does not say that the part cannot leave (`lower` and `upper` do). The edge is closed by such a query
        unless the limit cut off something shorter than what the library offers.
        """
        if part not in self.candidates(state):
            return Blocked(part, "stability", self.gravity[part] & state)
        with self._lock:
            if not effort.fresh and (state in self._closed[part] or self.lower(state, part) >= self.upper(state, part)):
                return self._answer(state, part, effort.shorter_than)
            found = self._plan(state, part, effort)
            if effort.fresh:
                return found if found and found.length < effort.shorter_than else self._blocked(state, part)
            known = self.upper(state, part)
            if found and found.length < min(known, effort.shorter_than):
                self._library[part].append(found)
            if effort.shorter_than >= known or self.upper(state, part) < known or not found:
                self._closed[part].add(state)
            return self._answer(state, part, effort.shorter_than)

    def _plan(self, state: int, part: int, effort: Effort) -> Removal | None:
        self.counts.removal_queries += 1
        self.counts.motion_plans += effort.attempts
        self.asked.append((state, part, effort))
        times = self._planned[state, part] = self._planned.get((state, part), 0) + 1
        valid = [each for each in self.hidden[part] if not each.blockers & state]
        if not valid:
            return None
        draws = np.random.default_rng((self.seed, state, part, times)).random(effort.attempts)
        return synthetic_removal(part, valid[0].length * (1.0 + self.noise * float(draws.min())), valid[0].blockers)

    def _answer(self, state: int, part: int, shorter_than: float) -> Removal | Blocked:
        valid = [each for each in self._library[part] if each.valid_in(state) and each.length < shorter_than]
        return min(valid, key=lambda each: each.length) if valid else self._blocked(state, part)

    def _blocked(self, state: int, part: int) -> Blocked:
        if self.true_cost(state, part) < math.inf:
            return Blocked(part, "path", 0)
        blamed = 0
        for each in self.hidden[part]:
            blamed |= each.blockers & state
        return Blocked(part, "path", blamed)


class InterruptedProblem(SyntheticProblem):
    """The same problem with Ctrl-C while the n-th counted query runs."""

    def __init__(self, problem: SyntheticProblem, interrupt_at: int) -> None:
        super().__init__(
            problem.hidden,
            problem.gravity,
            problem.needs,
            problem.noise,
            problem.seed,
            problem.ways,
            problem.falls,
        )
        self.interrupt_at = interrupt_at

    def _plan(self, state: int, part: int, effort: Effort) -> Removal | None:
        if self.counts.removal_queries + 1 == self.interrupt_at:
            raise KeyboardInterrupt
        return super()._plan(state, part, effort)


def exact_guide(problem: SyntheticProblem) -> Guide:
    """The true Q-function, by dynamic programming."""

    def guide(states: Sequence[int]) -> Sequence[Mapping[int, float]]:
        return [
            {
                part: -(problem.true_cost(state, part) + problem.optimum(state & ~(1 << part))[0])
                for part in problem.candidates(state)
            }
            for state in states
        ]

    return guide


def random_problem(
    parts: int,
    seed: int,
    *,
    removals: int = 3,
    feasible: bool = True,
    density: float = 0.35,
    noise: float = 0.0,
) -> SyntheticProblem:
    """A random monotone problem.

    Args:
        parts: number of removable parts.
        seed: of the instance and of its noise.
        removals: hidden removals per part; the longer, the fewer blockers.
        feasible: a hidden witness order exists; otherwise the problem certainly has none (a pair of parts blocks each
            other for good).
        density: chance that a part blocks the shortest hidden removal of another.
        noise: see `SyntheticProblem`.
    """
    rng = np.random.default_rng((seed, parts))
    rank = rng.permutation(parts)  # rank[part]: its place in the witness order
    hidden, gravity = [], []
    for part in range(parts):
        others = [other for other in range(parts) if other != part]
        earlier = [other for other in others if rank[other] < rank[part]]
        found = []
        for number in range(removals):
            chance = density * (1.0 - number / removals)
            length = float(rng.uniform(0.4, 0.6) + 0.25 * number)
            pool = others if number < removals - 1 else earlier  # the longest one works in the witness order
            found.append(Hidden(length, sum(1 << other for other in pool if rng.random() < chance)))
        hidden.append(found)
        gravity.append(sum(1 << other for other in earlier if rng.random() < 0.15))
    if not feasible:
        first, second = (int(part) for part in rng.choice(parts, size=2, replace=False))
        hidden[first] = [Hidden(each.length, each.blockers | 1 << second) for each in hidden[first]]
        hidden[second] = [Hidden(each.length, each.blockers | 1 << first) for each in hidden[second]]
    return SyntheticProblem(hidden, gravity, noise=noise, seed=seed)


def problem_with_dead_ends(parts: int, seed: int) -> SyntheticProblem:
    """A feasible problem in which some states, reachable from the root, have parts left and none removable."""
    problem = random_problem(parts, seed)
    rng = np.random.default_rng((seed, parts, 1))
    _, witness = problem.optimum()
    last = list(witness)
    for _ in range(1000):
        needs = [0] * parts
        for position, part in enumerate(last[:-1]):
            if rng.random() < 0.5:
                needs[part] = 1 << int(rng.choice(last[position + 1 :]))
        trial = SyntheticProblem(problem.hidden, problem.gravity, needs, seed=seed)
        if any(state and not removable for state, removable in trial.reachable().items()):
            return trial
    raise AssertionError(f"no dead ends with parts={parts}, seed={seed}")


def problem_with_many_ways(parts: int, seed: int, feasible: bool = True) -> SyntheticProblem:
    """A random monotone problem in which a part has none to four ways out; about half have an order if `feasible`."""
    problem = random_problem(parts, seed, feasible=feasible)
    rng = np.random.default_rng((seed, parts, 2))
    problem.ways = [
        [_some(rng, parts, part, 1.5 / parts) for _ in range(int(rng.integers(0 if rng.random() < 0.05 else 1, 5)))]
        for part in range(parts)
    ]
    return problem


def problem_that_may_fall(parts: int, seed: int, share: float = 0.4) -> SyntheticProblem:
    """A random problem with several ways out a part, of whose states so many, drawn at random, do not stand."""
    problem = problem_with_many_ways(parts, seed)
    rng = np.random.default_rng((seed, parts, 3))
    falls = {}
    for state in range(1, 1 << parts):
        if rng.random() < share:
            falls[state] = 1 << int(rng.choice(members(state)))
    return SyntheticProblem(problem.hidden, problem.gravity, seed=seed, ways=problem.ways, falls=falls)


def _some(rng: np.random.Generator, parts: int, besides: int, chance: float) -> int:
    return sum(1 << other for other in range(parts) if other != besides and rng.random() < chance)
