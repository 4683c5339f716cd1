"""That there is no plan, as a value and in words: what is left where the product comes apart no further, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from takeapart.model.plan import Plan
from takeapart.problem import AssemblyProblem
from takeapart.removal.reasons import Reason
from takeapart.removal.result import Blocked, Stage
from takeapart.removal.wording import listed
from takeapart.search.result import Deepest, SearchResult
from takeapart.states import members

TOLD = 6  # reasons in a sentence


@dataclass(frozen=True)
class Hindrance:
    """A part that cannot leave.

    Args:
        part: its name.
        reason: in words and numbers.
    """

    part: str
    reason: Reason

    @property
    def stage(self) -> Stage:
        """Where planning its removal ended."""
        return self.reason.stage

    def __str__(self) -> str:
        return f"{self.part}: {self.reason}"


@dataclass(frozen=True)
class Infeasible:
    """No order was found: the parts left where the search ended deepest, and why each cannot leave.

    Args:
        remaining: names of the parts left.
        hindrances: per part.
        proved: whether every sequence was excluded for the removals the planner finds (else the budget ran out first).
        deepest: the removals that lead there; None where none were asked for. It and `partial` are not compared.
        partial: the same as a plan, which ends with these parts left; None if no part leaves.
    """

    remaining: tuple[str, ...]
    hindrances: tuple[Hindrance, ...]
    proved: bool
    deepest: Deepest | None = field(default=None, compare=False)
    partial: Plan | None = field(default=None, compare=False)

    def __str__(self) -> str:
        first = "no feasible order" if self.proved else "no feasible order found within the budget"
        if not self.hindrances:
            return f"{first}{'' if self.proved else '; there may be one'}"
        told = _of_every_cause_first(sorted(self.hindrances, key=_is_consequence))
        others = [hindrance.part for hindrance in told[TOLD:]]
        more = f"; and {len(others)} more: {listed(others, TOLD)}" if others else ""
        reasons = "; ".join(str(hindrance) for hindrance in told[:TOLD])
        left = f"{len(self.remaining)} part{'s' if len(self.remaining) != 1 else ''} left"
        named = {hindrance.part for hindrance in self.hindrances}
        unasked = [name for name in self.remaining if name not in named]
        more += f"; not asked within the budget: {listed(unasked, TOLD)}" if unasked else ""
        maybe = "" if self.proved else "; there may be an order"
        return f"{first}; with {left}: {reasons}{more}{maybe}"


def infeasible_of(problem: AssemblyProblem, result: SearchResult) -> Infeasible:
    """What blocked a search that found no order, where the product comes apart no further."""
    if result.deepest is not None:
        deepest = result.deepest
        known = [problem.edge_bounds.refusal(deepest.state, part) for part in members(deepest.state)]
        told = explain(problem, deepest.state, [refusal for refusal in known if refusal is not None])
        return Infeasible(tuple(problem.assembly.names(deepest.state)), told, result.infeasible, deepest)
    if not result.refusals:
        return Infeasible((), (), result.infeasible)
    state, refusals = result.refusals[0]
    return Infeasible(tuple(problem.assembly.names(state)), explain(problem, state, refusals), result.infeasible)


def blocked_parts(problem: AssemblyProblem, state: int, refusals: Sequence[Blocked] = ()) -> list[Blocked]:
    """The parts of a state that cannot leave; of those that gravity and lifting let go, the ones that were refused."""
    answers = {refusal.part: refusal for refusal in refusals}
    found = [problem.hindrance(state, part) or answers.get(part) for part in members(state)]
    return [blocked for blocked in found if blocked is not None]


def explain(problem: AssemblyProblem, state: int, refusals: Sequence[Blocked] = ()) -> tuple[Hindrance, ...]:
    """Why each part of a state cannot leave, see `blocked_parts`. Takes about as long as the queries that were refused,
    and half a second the first time."""
    parts = problem.assembly.parts
    return tuple(
        Hindrance(parts[blocked.part].name, problem.reasons.of(blocked, state))
        for blocked in blocked_parts(problem, state, refusals)
    )


def _is_consequence(hindrance: Hindrance) -> bool:
    """Whether a part only waits for others, which have reasons of their own."""
    return hindrance.stage == "stability"


def _of_every_cause_first(hindrances: Sequence[Hindrance]) -> list[Hindrance]:
    """The first of each cause before the others: ten parts that are too heavy hide none that hits something."""
    first = {(each.stage, each.reason.cause): each for each in reversed(hindrances)}
    return sorted(hindrances, key=lambda each: first[each.stage, each.reason.cause] is not each)
