"""What exact and best-first search are both tested with: problems with awkward planners, and checks of results."""

from __future__ import annotations

import math
from collections.abc import Callable

from synthetic import SyntheticProblem, members, random_problem, synthetic_removal
from takeapart.removal.result import Blocked, Effort, Removal
from takeapart.search.result import Progress, ProgressListener, SearchResult

TOLERANCE = 1e-9  # m

Search = Callable[[SyntheticProblem, ProgressListener], SearchResult]


class MaskedProblem(SyntheticProblem):
    """The same problem, with its gravity and ways out as `freedom` and a static bound per part."""

    def __init__(self, problem: SyntheticProblem, static_share: float = 0.8) -> None:
        super().__init__(
            problem.hidden, problem.gravity, None, problem.noise, problem.seed, problem.ways, problem.falls
        )
        self.static_share = static_share

    @property
    def freedom(self) -> list[tuple[int, ...]]:
        return [tuple(way | mask for way in ways) for mask, ways in zip(self.gravity, self.ways, strict=True)]

    def static_lower(self, part: int) -> float:
        return self.static_share * min((each.length for each in self.hidden[part]), default=0.0)


class ForgetfulProblem(SyntheticProblem):
    """A planner without memory: what it finds depends on the attempts.

    Args:
        excess: a removal planned with k attempts is longer than the hidden one by the share excess / k.
        blind: parts that it cannot remove with fewer than `sight` attempts.
    """

    def __init__(self, problem: SyntheticProblem, excess: float = 0.0, blind: int = 0, sight: int = 1) -> None:
        super().__init__(problem.hidden, problem.gravity)
        self.excess, self.blind, self.sight = excess, blind, sight

    def remove(self, state: int, part: int, effort: Effort) -> Removal | Blocked:
        self.counts.removal_queries += 1
        self.asked.append((state, part, effort))
        valid = [each for each in self.hidden[part] if not each.blockers & state]
        if not valid or (self.blind >> part & 1 and effort.attempts < self.sight):
            return Blocked(part, "path", state & ~(1 << part))
        length = valid[0].length * (1 + self.excess / effort.attempts)
        if length >= effort.shorter_than:
            return Blocked(part, "path", 0)
        return synthetic_removal(part, length, valid[0].blockers)


def mutually_blocked(parts: int, seed: int) -> SyntheticProblem:
    """Infeasible although every part can leave alone: two parts block each other for good."""
    return random_problem(parts, seed, feasible=False)


def never_leaving(parts: int, seed: int) -> SyntheticProblem:
    """Infeasible since one part has no removal at all."""
    problem = random_problem(parts, seed)
    problem.hidden[seed % parts] = []
    return problem


def check_sequence(problem: SyntheticProblem, result: SearchResult) -> None:
    """Every part leaves exactly once, when it may, by a removal that is valid then; the length is the sum."""
    state = problem.root
    for removal in result.removals:
        assert removal.part in problem.candidates(state)
        assert removal.valid_in(state)
        state &= ~(1 << removal.part)
    assert state == 0
    assert math.isclose(result.length, sum(removal.length for removal in result.removals))


def check_refusals(problem: SyntheticProblem, result: SearchResult) -> None:
    """No sequence, but dead ends in which indeed no part can leave."""
    assert not result.removals
    assert math.isinf(result.length)
    assert result.sequence_bound is None
    assert result.infeasible
    assert result.refusals
    for state, refusals in result.refusals:
        assert state
        assert all(math.isinf(problem.true_cost(state, part)) for part in problem.candidates(state))
        blamed = {refusal.part for refusal in refusals}
        assert blamed == set(problem.candidates(state) or members(state))


def false_bounds(problem: SyntheticProblem, search: Search) -> int:
    """How often a search without noise claims a bound above the optimum, or a length below it."""
    optimum, _ = problem.optimum()
    seen: list[Progress] = []
    result = search(problem, seen.append)
    bounds = [progress.bound for progress in seen] + [
        -math.inf if result.sequence_bound is None else result.sequence_bound
    ]
    lengths = [progress.length for progress in seen] + [result.length]
    return sum(bound > optimum + TOLERANCE for bound in bounds) + sum(
        length < optimum - TOLERANCE for length in lengths
    )
