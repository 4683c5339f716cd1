"""From an assembly and a workcell to a plan: the one call that most users need."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np

from takeapart.formats.serialization import assembly_hash, workcell_hash
from takeapart.model.assembly import Assembly
from takeapart.model.errors import InputError, UnknownNameError
from takeapart.model.plan import Plan, PlanStep
from takeapart.planning.runs import Identity, Run, RunBudget, finished_plan, open_run
from takeapart.planning.shaping import sources_digest, versions
from takeapart.problem import AssemblyProblem, Guide, Problem
from takeapart.removal.journal import QueryJournal
from takeapart.removal.planner import RemovalOptions, RemovalPlanner
from takeapart.removal.reasons import Reason
from takeapart.removal.result import Blocked, Removal, Stage
from takeapart.removal.wording import listed
from takeapart.search.deepest import deepen
from takeapart.search.registry import SEARCHES
from takeapart.search.result import Budget, Deepest, History, ProgressListener, SearchResult
from takeapart.search.session import SettledObserver, TransitionObserver
from takeapart.stability import require_standing
from takeapart.states import members
from takeapart.workcell import Workcell

MAXIMUM_HISTORY = 400  # rows of a plan's search history
TOLD = 6  # reasons in a sentence


@dataclass(frozen=True)
class PlanningOptions:
    """How a plan is made.

    Args:
        search: name of a search, see `takeapart.search.registry.SEARCHES`.
        seed: of all random choices.
        budget: when to stop searching.
        removal: options of the removal planner.
        search_options: an instance of the search's own options dataclass; None for those in the registry.
    """

    search: str = "exact"
    seed: int = 0
    budget: Budget = field(default_factory=Budget)
    removal: RemovalOptions = field(default_factory=RemovalOptions)
    search_options: Any = None

    def __post_init__(self) -> None:
        if self.search not in SEARCHES:
            raise UnknownNameError("search", self.search, list(SEARCHES))
        if self.search_options is not None:
            given, valid = type(self.search_options), type(SEARCHES[self.search].options())
            if given is not valid:
                raise InputError(
                    f"{given.__name__}; the search {self.search!r} takes {valid.__name__}", "search_options"
                )

    def of_search(self) -> Any:
        """The options of the search."""
        return self.search_options if self.search_options is not None else SEARCHES[self.search].options()


class Recorder(Protocol):
    """Takes what a search sees; `takeapart.guide.experience.ExperienceWriter` is one."""

    @property
    def observe(self) -> TransitionObserver:
        """For every removal that a query returned."""
        ...

    @property
    def observe_settled(self) -> SettledObserver:
        """For the removals of which exact search knows the cost to the goal."""
        ...


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
        told = sorted(self.hindrances, key=_is_consequence)
        more = f"; and {len(told) - TOLD} more" if len(told) > TOLD else ""
        reasons = "; ".join(str(hindrance) for hindrance in told[:TOLD])
        left = f"{len(self.remaining)} part{'s' if len(self.remaining) != 1 else ''} left"
        named = {hindrance.part for hindrance in self.hindrances}
        unasked = [name for name in self.remaining if name not in named]
        more += f"; not asked within the budget: {listed(unasked, TOLD)}" if unasked else ""
        maybe = "" if self.proved else "; there may be an order"
        return f"{first}; with {left}: {reasons}{more}{maybe}"


def _is_consequence(hindrance: Hindrance) -> bool:
    """Whether a part only waits for others, which have reasons of their own."""
    return hindrance.stage == "stability"


def plan(
    assembly: Assembly,
    workcell: Workcell,
    options: PlanningOptions | None = None,
    guide: Guide | None = None,
    listen: ProgressListener | None = None,
    run: Path | None = None,
    record: Recorder | None = None,
) -> Plan | Infeasible:
    """Plans the disassembly of an assembly in a workcell.

    Args:
        assembly: the product.
        workcell: arm, goal and obstacles.
        options: search, seed and budget; by default exact search until the best order is proved.
        guide: a learned ranking of parts, for the searches that take one.
        listen: is told about progress.
        run: a directory in which all that is planned is kept at once; with it, a call that was cut off, however that
            happened, is continued by the same call, and the plan is the same. See `takeapart.planning.runs`.
        record: is told what the search sees, for learning a guide, if the search tells (see the registry).

    Returns:
        The shortest plan found within the budget (also after Ctrl-C), or why there is none.

    Raises:
        InputError: a part floats, or the robot's files are missing; the run directory is that of another run, in use,
            damaged, or cannot be written.
    """
    options = options or PlanningOptions()
    if run is None:
        problem = build_problem(assembly, workcell, options)
        started = time.monotonic()
        result = search(problem, options, guide, listen, record)
        return plan_of(problem, result, options, time.monotonic() - started)
    require_standing(assembly)
    identity = run_identity(assembly, workcell, options, guide)
    known = finished_plan(run, identity)
    if known is not None:
        return known
    with open_run(run, identity) as opened:
        return plan_in_run(opened, assembly, workcell, options, guide, listen, record)[0]


def plan_in_run(
    run: Run,
    assembly: Assembly,
    workcell: Workcell,
    options: PlanningOptions,
    guide: Guide | None = None,
    listen: ProgressListener | None = None,
    record: Recorder | None = None,
) -> tuple[Plan | Infeasible, bool]:
    """Searches from where a run was cut off, and keeps the plan in it once the search has ended by itself.

    Returns:
        what `plan` returns, and whether Ctrl-C ended the search.

    Raises:
        InputError: as `plan`.
    """
    problem = build_problem(assembly, workcell, options, run.journal)
    run.journal.start()
    # `RunBudget` has the attributes of `Budget`; its seconds change while answers are recalled.
    budget = cast(Budget, RunBudget(options.budget, run.journal))
    result = search(problem, replace(options, budget=budget), guide, listen, record)
    made = plan_of(problem, result, options, run.journal.seconds)
    if isinstance(made, Plan) and not result.interrupted:
        run.finish(made)
    return made, result.interrupted


def run_identity(
    assembly: Assembly, workcell: Workcell, options: PlanningOptions, guide: Guide | None = None
) -> Identity:
    """All that shapes a plan, as the description of a run holds it. The number of threads shapes nothing.

    The sources are part of it: while they are worked on, the version stays the same, but the answers do not. Those are
    meant that shape an answer, see `takeapart.planning.shaping`.
    """
    described = asdict(options) | {"search_options": asdict(options.of_search())}
    del described["seed"]
    described["search_options"].pop("workers", None)
    return {
        "assembly": {"name": assembly.name, "hash": assembly_hash(assembly)},
        "workcell": {"name": workcell.name, "hash": workcell_hash(workcell)},
        "seed": options.seed,
        "options": described,
        "guide": guide is not None and getattr(guide, "hash", True),
        "versions": versions(),
        "sources": sources_digest(),
    }


def build_problem(
    assembly: Assembly,
    workcell: Workcell,
    options: PlanningOptions | None = None,
    journal: QueryJournal | None = None,
) -> AssemblyProblem:
    """The decision process that the searches work on.

    Args:
        journal: answers the queries that were answered before, and keeps the others.

    Raises:
        InputError: a part floats, or the robot's files are missing.
    """
    options = options or PlanningOptions()
    stability = require_standing(assembly)
    planner = RemovalPlanner(assembly, workcell, options.removal)
    return AssemblyProblem(planner, stability, options.seed, journal=journal)


def search(
    problem: AssemblyProblem,
    options: PlanningOptions,
    guide: Guide | None = None,
    listen: ProgressListener | None = None,
    record: Recorder | None = None,
) -> SearchResult:
    """Runs the search that the options name, and keeps how its length and bound came about.

    Where it finds no order, what is left of its budget goes into how far the product comes apart.
    """
    history = History(listen)
    started = time.monotonic(), problem.counts.removal_queries
    result = _search(problem, options, guide, history, record)
    result = replace(result, history=tuple(history.rows))
    if result.removals or not problem.root:
        return result
    entry = SEARCHES[options.search]

    def run(part_of_it: Problem, budget: Budget, advice: Guide | None) -> SearchResult:
        rng = np.random.default_rng([options.seed, 2])
        return entry.run(part_of_it, options.of_search(), budget, rng, guide=advice)

    advice = of_candidates(guide, problem) if guide is not None else None
    deepest = deepen(problem, result, options.budget, advice, run, entry.proves, started)
    if not deepest.state:  # a budget ended the search before what it had learned was put together
        return replace(result, removals=deepest.removals, length=deepest.length, refusals=(), infeasible=False)
    return replace(result, deepest=deepest)


def _search(
    problem: AssemblyProblem,
    options: PlanningOptions,
    guide: Guide | None,
    listen: ProgressListener,
    record: Recorder | None,
) -> SearchResult:
    rng = np.random.default_rng([options.seed, 1])
    observe = record.observe if record is not None else None
    guide = of_candidates(guide, problem) if guide is not None else None
    observe_settled = record.observe_settled if record is not None else None
    return SEARCHES[options.search].run(
        problem, options.of_search(), options.budget, rng, listen, guide, observe, observe_settled
    )


def of_candidates(guide: Guide, problem: Problem) -> Guide:
    """The guide without its values for parts that cannot leave: searches look at the best value of a state."""

    def restricted(states: Sequence[int]) -> list[dict[int, float]]:
        values = guide(states)
        return [
            {part: of_state[part] for part in problem.candidates(state)}
            for state, of_state in zip(states, values, strict=True)
        ]

    return restricted


def plan_of(
    problem: AssemblyProblem, result: SearchResult, options: PlanningOptions, seconds: float
) -> Plan | Infeasible:
    """The result of a search as a plan, or as the reason why there is none."""
    assembly, workcell = problem.assembly, problem.planner.workcell
    if not result.removals:
        made = infeasible_of(problem, result)
        if result.deepest is None or not result.deepest.removals:
            return made
        found = replace(result, removals=result.deepest.removals, length=result.deepest.length, deepest=None)
        partial = plan_of(problem, found, options, seconds)
        assert isinstance(partial, Plan)
        proofs = {"partial_deepest": result.deepest.is_deepest, "partial_shortest": result.deepest.is_shortest}
        told = partial.search | proofs
        return replace(made, partial=replace(partial, search=told, sequence_bound=None, remaining=made.remaining))
    steps = tuple(_step(assembly, removal) for removal in result.removals)
    statistics = {name: _number(value) for name, value in sorted(result.statistics.items())}
    return Plan(
        steps=steps,
        total_length=math.fsum(step.length for step in steps),
        straight_line_bound=problem.planner.straight_line_total(result.removals),
        sequence_bound=result.sequence_bound,
        counts=asdict(problem.counts),
        seconds=seconds,
        seed=options.seed,
        search={
            "name": options.search,
            "statistics": statistics,
            "interrupted": result.interrupted,
            "history": [_history_row(*row) for row in _thinned(result.history)],
        },
        hashes={"assembly": assembly_hash(assembly), "workcell": workcell_hash(workcell)},
        versions=versions(),
        assembly=assembly.name,
        workcell=workcell.name,
        robot=workcell.description.name,
        joints=workcell.description.arm.joints,
    )


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


def _step(assembly: Assembly, removal: Removal) -> PlanStep:
    return PlanStep(
        assembly.parts[removal.part].name, removal.grasp, removal.joint_path, removal.tool_path, removal.length
    )


def _history_row(queries: int, length: float, bound: float) -> list[float | None]:
    return [queries, *(round(value, 9) if 0 <= value < math.inf else None for value in (length, bound))]


def _thinned(history: Sequence[tuple[int, float, float]]) -> Sequence[tuple[int, float, float]]:
    """At most so many rows as a plan file keeps, first and last among them."""
    if len(history) <= MAXIMUM_HISTORY:
        return history
    return [history[i] for i in np.linspace(0, len(history) - 1, MAXIMUM_HISTORY).astype(int)]


def _number(value: float) -> float | int:
    return int(value) if math.isfinite(value) and value == int(value) else value
