"""Searches with and without a guide on assemblies that exact search cannot close, at equal removal queries."""

from __future__ import annotations

import hashlib
import math
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from takeapart.experiments.jobs import Outcome
from takeapart.formats.serialization import assembly_hash, workcell_hash
from takeapart.model.assembly import Assembly
from takeapart.model.errors import UnknownNameError
from takeapart.planning import PlanningOptions, build_problem, of_candidates
from takeapart.problem import AssemblyProblem, Guide
from takeapart.search.beam import BeamOptions, beam
from takeapart.search.registry import SEARCHES, searches_that_take
from takeapart.search.result import Budget, Progress, ProgressListener, SearchResult
from takeapart.workcell import Workcell

WIDEST_BEAM = 64
PATIENCE = 5  # episodes of tree search without a query or a gain, after which it has nothing left to do

SEARCHED = tuple(name for name in reversed(searches_that_take("guide")) if name != "exact")
"""Searches that take a guide and do not list all states."""


def _search(
    name: str, problem: AssemblyProblem, queries: int, seed: int, guide: Guide | None, listen: ProgressListener
) -> SearchResult:
    """Runs one of `SEARCHED`."""
    if name == "beam":
        return _beams(problem, queries, seed, guide, listen)
    entry = SEARCHES[name]
    options = replace(entry.options(), patience=PATIENCE) if entry.anytime else entry.options()
    return entry.run(problem, options, Budget(queries=queries), np.random.default_rng([seed, 1]), listen, guide)


def _beams(
    problem: AssemblyProblem, queries: int, seed: int, guide: Guide | None, listen: ProgressListener
) -> SearchResult:
    """Beams of width 1, 2, 4, ... on one library until the budget is spent; the best result."""
    best: SearchResult | None = None
    width = 1
    while width <= WIDEST_BEAM and queries > problem.counts.removal_queries:
        budget = Budget(queries=queries - problem.counts.removal_queries)
        found = beam(problem, BeamOptions(width=width), budget, np.random.default_rng([seed, width]), listen, guide)
        if best is None or found.length < best.length:
            best = found
        width *= 2
    assert best is not None  # at least one query is allowed
    return best


@dataclass(frozen=True, eq=False)
class BeyondTask:
    """One search on one assembly.

    Args:
        assembly, workcell: what is planned.
        seed: of all random choices.
        search: one of `SEARCHED`.
        queries: budget.
        weights: content of the guide's file; None for a search without a guide.

    Raises:
        UnknownNameError: there is no such search.
    """

    assembly: Assembly
    workcell: Workcell
    seed: int
    search: str
    queries: int
    weights: bytes | None = None

    def __post_init__(self) -> None:
        if self.search not in SEARCHED:
            raise UnknownNameError("search", self.search, list(SEARCHED))

    @property
    def cost(self) -> float:
        """Removal queries."""
        return float(self.queries)

    def identity(self) -> Outcome:
        """Options and data."""
        return {
            "assembly": assembly_hash(self.assembly),
            "workcell": workcell_hash(self.workcell),
            "seed": self.seed,
            "search": self.search,
            "queries": self.queries,
            "guide": hashlib.sha256(self.weights).hexdigest() if self.weights is not None else None,
        }

    def run(self, needed: Mapping[str, Path], out: Path) -> Outcome:
        """Trace of the improvements: removal queries, motion plans, length, m; and what was spent in all."""
        problem = build_problem(self.assembly, self.workcell, PlanningOptions(seed=self.seed))
        guide = self._guide(problem)
        trace: list[list[float]] = []

        def listen(progress: Progress) -> None:
            counts = problem.counts
            if math.isfinite(progress.length) and (not trace or progress.length < trace[-1][2]):
                trace.append([counts.removal_queries, counts.motion_plans, progress.length])

        result = _search(self.search, problem, self.queries, self.seed, guide, listen)
        return {
            "parts": self.assembly.root.bit_count(),
            "trace": trace,
            "sequence_bound": result.sequence_bound,
            "removal_queries": problem.counts.removal_queries,
            "motion_plans": problem.counts.motion_plans,
        }

    def _guide(self, problem: AssemblyProblem) -> Guide | None:
        if self.weights is None:
            return None
        from takeapart.guide.policy import load_guide

        with tempfile.NamedTemporaryFile(suffix=".safetensors") as file:
            file.write(self.weights)
            file.flush()
            return of_candidates(load_guide(file.name, self.assembly), problem)
