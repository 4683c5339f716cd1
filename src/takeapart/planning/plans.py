"""From an assembly and a workcell to a plan: the one call that most users need."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import cast

import numpy as np

from takeapart.formats.serialization import assembly_hash, workcell_hash
from takeapart.model.assembly import Assembly
from takeapart.model.plan import Plan, PlanStep
from takeapart.planning.infeasible import Infeasible, infeasible_of
from takeapart.planning.options import PlanningOptions, Recorder
from takeapart.planning.runs import Identity, Run, RunBudget, finished_plan, open_run
from takeapart.planning.shaping import sources_digest, versions
from takeapart.problem import AssemblyProblem, Guide, Problem
from takeapart.removal.journal import QueryJournal
from takeapart.removal.planner import RemovalPlanner
from takeapart.removal.result import Removal
from takeapart.search.deepest import deepen
from takeapart.search.registry import SEARCHES
from takeapart.search.result import Budget, History, ProgressListener, SearchResult
from takeapart.stability import require_standing
from takeapart.workcell import Workcell

MAXIMUM_HISTORY = 400  # rows of a plan's search history


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
