"""Corrupted plans of shipped assemblies, and what the verifier says to them: ``python tests/mutation_table.py``.

Random plans are made for a few shipped assemblies; each is corrupted in one way at a time (`plan_mutations`), and every
corrupted plan must be refused by the check that the corruption is meant for. Half as many again come from the small
scene that no planner touched.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from plan_mutations import MUTATIONS, Corrupted, Target, corrupted_plans
from takeapart.experiments.tables import markdown_table, replace_between_markers
from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.model.plan import Plan
from takeapart.planning import PlanningOptions, plan
from takeapart.verification import Verifier, format_finding
from verification_scene import scene_assembly, scene_plan, scene_workcell

ASSEMBLIES = ("single/03", "single/08", "double/01")
MARKER = "mutations"


@dataclass(frozen=True)
class Judged:
    """One corrupted plan and its fate."""

    corrupted: Corrupted
    target: str
    refused: bool
    right_reason: bool
    findings: tuple[str, ...]


def scene_target() -> Target:
    """The hand-made plan of the small scene."""
    return Target(scene_plan(), scene_assembly(), scene_workcell())


def shipped_target(name: str) -> Target:
    """A random plan of a shipped assembly, by the planner."""
    assembly, workcell = load_assembly(data_path(f"{name}.json")), load_workcell("panda")
    made = plan(assembly, workcell, PlanningOptions(search="random"))
    assert isinstance(made, Plan), f"{name}: {made}"
    return Target(made, assembly, workcell)


def judged(name: str, target: Target, count: int, rng: np.random.Generator) -> list[Judged]:
    """Corrupts a plan `count` times and has every result verified; the plan itself must pass."""
    verifier = Verifier(target.assembly, target.workcell)
    untouched = verifier.verify(target.plan)
    assert untouched.passed, [format_finding(finding) for finding in untouched.findings]
    results = []
    for corrupted in corrupted_plans(target, count, rng):
        findings = verifier.verify(corrupted.plan).findings
        right = any(f.check == corrupted.check and corrupted.step in (None, f.step) for f in findings)
        lines = tuple(format_finding(finding) for finding in findings)
        results.append(Judged(corrupted, name, bool(findings), right, lines))
    return results


def judged_target(name: str, count: int, seed: int) -> list[Judged]:
    """As `judged`, for the scene or a shipped assembly by its name."""
    rng = np.random.default_rng([seed, *name.encode()])
    return judged(name, scene_target() if name == "scene" else shipped_target(name), count, rng)


def table(results: Sequence[Judged]) -> str:
    """One row per mutation, and the sum."""
    count = Counter(result.corrupted.name for result in results)
    refused = Counter(result.corrupted.name for result in results if result.refused)
    right = Counter(result.corrupted.name for result in results if result.right_reason)
    checks = {name: {r.corrupted.check for r in results if r.corrupted.name == name} for name in MUTATIONS}
    rows: list[list[object]] = [
        [name, " ".join(sorted(checks[name])), count[name], refused[name], right[name]] for name in MUTATIONS
    ]
    rows.append(["**all**", "", len(results), sum(refused.values()), sum(right.values())])
    return markdown_table(["corruption", "check that must refuse it", "plans", "refused", "for the right reason"], rows)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns 1 if a corrupted plan was accepted or refused for another reason only."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=500, help="of corrupted plans of shipped assemblies")
    parser.add_argument("--scene", type=int, default=250, help="of corrupted plans of the hand-made scene")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--document", type=Path, help="document whose table is replaced")
    given = parser.parse_args(arguments)
    counts = {name: len(range(i, given.count, len(ASSEMBLIES))) for i, name in enumerate(ASSEMBLIES)}
    counts["scene"] = given.scene
    results: list[Judged] = []
    with ProcessPoolExecutor(given.processes, get_context("spawn")) as pool:
        waiting = {name: pool.submit(judged_target, name, count, given.seed) for name, count in counts.items()}
        for name, future in waiting.items():
            results += future.result()
            print(f"{name}: {counts[name]} corrupted plans judged", flush=True)
    wrong = [result for result in results if not result.right_reason]
    for result in wrong:
        what = f"{result.corrupted.name} (step {result.corrupted.step}): expected {result.corrupted.check}"
        print(f"{result.target}: {what}; found {list(result.findings) or 'nothing'}")
    shipped_results = [result for result in results if result.target != "scene"]
    print(f"{sum(r.right_reason for r in shipped_results)} of {len(shipped_results)} of shipped assemblies, ", end="")
    print(f"{sum(r.right_reason for r in results)} of {len(results)} in all, are refused for the right reason")
    if given.document is not None:
        replace_between_markers(given.document, MARKER, table(results))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
