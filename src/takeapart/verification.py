"""Independent verification of a plan: public interface.

`verify_plan` replays every step of a plan in MuJoCo, in the state in which the step happens, and checks everything
that the plan states. It shares no kinematics, collision or stability code with the planner.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace

from takeapart.assembly import Assembly
from takeapart.plan import Plan
from takeapart.serialization import assembly_hash, workcell_hash
from takeapart.verification_checks import (
    check_bound,
    check_grasp,
    check_hashes,
    check_length,
    check_order,
    check_schema,
    check_stability,
    check_total,
    straight_line_bound,
)
from takeapart.verification_physics import (
    StabilityComparison,
    StandingReport,
    compare_stability,
    stand_under_gravity,
)
from takeapart.verification_replay import Replay, StepResult
from takeapart.verification_report import (
    Agreement,
    Clearance,
    Finding,
    VerificationOptions,
    VerificationReport,
    format_finding,
    report_as_dict,
)
from takeapart.workcell import Workcell

__all__ = [
    "Agreement",
    "Clearance",
    "Finding",
    "StabilityComparison",
    "StandingReport",
    "VerificationOptions",
    "VerificationReport",
    "compare_stability",
    "format_finding",
    "report_as_dict",
    "stand_under_gravity",
    "states_of",
    "verify_plan",
]


def verify_plan(
    plan: Plan,
    assembly: Assembly,
    workcell: Workcell,
    options: VerificationOptions | None = None,
    *,
    hashes: Mapping[str, str] | None = None,
    physics: bool = False,
) -> VerificationReport:
    """Checks a plan from the first step to the last; a plan for assembly is inverted first.

    Args:
        hashes: of the "assembly" and the "workcell" to compare the plan's with; None: computed here.
        physics: also let every intermediate assembly stand under gravity.

    Raises:
        MissingExtraError: MuJoCo is not installed.
        InputError: the robot's files are missing.
    """
    started = time.perf_counter()
    options = options or VerificationOptions()
    if plan.direction == "assembly":
        plan = plan.inverted()
    if hashes is None:
        hashes = {"assembly": assembly_hash(assembly), "workcell": workcell_hash(workcell)}
    findings = [*check_hashes(plan, hashes), *check_order(plan, assembly)]
    replay = Replay(assembly, workcell, options)
    findings += replay.check_placement()
    results: list[StepResult] = []
    state = assembly.root
    for k, step in enumerate(plan.steps):
        broken = check_schema(step, k, len(workcell.home))
        findings += broken
        if not broken:
            findings += check_length(step, k, options)
        number = assembly.index.get(step.part)
        # Fixed, unknown or gone before: `check_order` says so, and there is nothing to replay.
        if number is not None and state >> number & 1:
            if not broken:
                opening = workcell.description.maximum_opening
                findings += check_grasp(step, k, assembly.parts[number], opening, options)
                results.append(replay.step(step, k, state))
                findings += results[-1].findings
            state &= ~(1 << number)
    if not any(finding.check == "schema" for finding in findings):
        findings += check_total(plan, options)
    findings += check_bound(plan, assembly, workcell, options)
    findings += check_stability(plan, assembly)
    states = states_of(plan, assembly) if physics else []
    for k, standing in enumerate(states):
        report = stand_under_gravity(assembly, standing, options.physics_seconds, options)
        before = plan.steps[k - 1].part if k else ""
        findings += [replace(finding, step=k - 1 if k else None, part=before) for finding in report.findings]
    findings.sort(key=lambda finding: -1 if finding.step is None else finding.step)
    clearances = [result.clearance for result in results if result.clearance is not None]
    return VerificationReport(
        plan=f"{plan.assembly} in {plan.workcell}",
        findings=tuple(findings),
        steps=len(results),
        configurations=sum(result.configurations for result in results),
        smallest_clearance=min(clearances, key=lambda clearance: clearance.distance, default=None),
        agreement=_agreement(plan, assembly, workcell, options, results),
        states=len(states),
        seconds=time.perf_counter() - started,
        options=options,
    )


def states_of(plan: Plan, assembly: Assembly) -> list[int]:
    """States of a plan for disassembly: before the first step and after every step; unknown parts are skipped."""
    states = [assembly.root]
    for step in plan.steps:
        states.append(states[-1] & ~(1 << assembly.index[step.part]) if step.part in assembly.index else states[-1])
    return states


def _agreement(
    plan: Plan, assembly: Assembly, workcell: Workcell, options: VerificationOptions, results: list[StepResult]
) -> Agreement:
    """Differences between stated and recomputed numbers, over the steps that could be replayed."""
    bound = straight_line_bound(assembly, workcell, options)
    total = sum(result.length for result in results)
    lengths = [result.length_error for result in results]
    return Agreement(
        tool_position=max((result.tool_position for result in results), default=0.0),
        tool_angle=max((result.tool_angle for result in results), default=0.0),
        step_length=max(lengths, default=0.0),
        total_length=abs(total - plan.total_length),
        straight_line_bound=abs(bound - plan.straight_line_bound),
        total_length_recomputed=total,
        bound_recomputed=bound,
    )
