"""Independent verification of a plan: public interface.

`verify_plan` replays every step of a plan in MuJoCo, in the state in which the step happens, and checks everything
that the plan states. It shares no kinematics, collision or stability code with the planner.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from takeapart.formats.serialization import assembly_hash, motion_hash, workcell_hash, workcell_hash_by_name
from takeapart.model.assembly import Assembly
from takeapart.model.plan import Plan, PlanStep
from takeapart.verification.checks import (
    check_bound,
    check_grasp,
    check_hashes,
    check_heading,
    check_length,
    check_order,
    check_payload,
    check_robot,
    check_schema,
    check_stability,
    check_total,
    straight_line_bound,
)
from takeapart.verification.physics import (
    StandingReport,
    judged_under_gravity,
    stand_under_gravity,
    unjudged_parts,
)
from takeapart.verification.replay import Replay, StepResult
from takeapart.verification.report import (
    Agreement,
    VerificationOptions,
    VerificationReport,
)
from takeapart.verification.support import Support, check_support
from takeapart.workcell import Workcell


def verify_plan(
    plan: Plan,
    assembly: Assembly,
    workcell: Workcell,
    options: VerificationOptions | None = None,
    *,
    hashes: Mapping[str, str] | None = None,
    physics: bool = True,
) -> VerificationReport:
    """Checks one plan; see `Verifier`, which also raises what this raises."""
    return Verifier(assembly, workcell, options, hashes=hashes).verify(plan, physics=physics)


class Verifier:
    """Checks plans of one assembly in one workcell.

    What was found about a step is kept: a later plan with the very same step in the very same state is not replayed
    there again.

    Args:
        options: see `VerificationOptions`.
        hashes: of the "assembly" and the "workcell" to compare the plans' with; None: computed here.

    Raises:
        MissingExtraError: MuJoCo is not installed.
        InputError: the robot's files are missing.
    """

    def __init__(
        self,
        assembly: Assembly,
        workcell: Workcell,
        options: VerificationOptions | None = None,
        *,
        hashes: Mapping[str, str] | None = None,
    ) -> None:
        self.assembly, self.workcell = assembly, workcell
        self.options = options or VerificationOptions()
        computed = {"assembly": assembly_hash(assembly), "workcell": workcell_hash(workcell)}
        self.hashes = computed if hashes is None else hashes
        self._hash_by_name = workcell_hash_by_name(workcell)
        self.replay = Replay(assembly, workcell, self.options)
        self.support = (
            Support(assembly) if assembly.stands_in_connectors else None
        )  # elsewhere friction and joints hold too
        self._steps: dict[bytes, StepResult] = {}
        self._standing: dict[int, StandingReport] = {}

    @property
    def distinct_steps(self) -> int:
        """Number of steps replayed so far, each counted once per state."""
        return len(self._steps)

    @property
    def standing(self) -> Mapping[int, StandingReport]:
        """State -> what happened to it under gravity, for the states that were tried."""
        return self._standing

    def verify(self, plan: Plan, physics: bool = True) -> VerificationReport:
        """Checks a plan from the first step to the last; a plan for assembly is inverted first.

        Args:
            physics: let every intermediate assembly stand under gravity too.
        """
        started = time.perf_counter()
        assembly, workcell, options = self.assembly, self.workcell, self.options
        if plan.direction == "assembly":
            plan = plan.inverted()
        names = {"assembly": assembly.name, "workcell": workcell.name}
        findings = [
            *check_heading(plan),
            *check_hashes(plan, self._hashes_for(plan), names),
            *check_order(plan, assembly),
        ]
        findings += [*check_robot(plan, workcell), *self.replay.check_placement()]
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
                    findings += check_payload(step, k, assembly.parts[number], workcell)
                    results.append(self._step(step, k, state))
                    findings += results[-1].findings
                state &= ~(1 << number)
        if not any(finding.check == "schema" and finding.step is not None for finding in findings):
            findings += check_total(plan, options)
        findings += check_bound(plan, assembly, workcell, options)
        states = states_of(plan, assembly)
        if self.support is not None:
            findings += check_stability(plan, assembly)
            findings += check_support(self.support, states, [step.part for step in plan.steps])
        judged = [k for k, each in enumerate(states) if physics and judged_under_gravity(assembly, each)]
        for k in judged:
            before = plan.steps[k - 1].part if k else ""
            findings += [
                replace(finding, step=k - 1 if k else None, part=before) for finding in self.stand(states[k]).findings
            ]
        findings.sort(key=lambda finding: -1 if finding.step is None else finding.step)
        clearances = [result.clearance for result in results if result.clearance is not None]
        return VerificationReport(
            plan=f"{plan.assembly} in {plan.workcell}",
            findings=tuple(findings),
            steps=len(results),
            configurations=sum(result.configurations for result in results),
            smallest_clearance=min(clearances, key=lambda clearance: clearance.distance, default=None),
            agreement=_agreement(plan, assembly, workcell, results),
            states=len(judged),
            seconds=time.perf_counter() - started,
            options=options,
            clearances=tuple(result.clearance for result in results),
            motion=motion_hash(plan),
            remaining=plan.remaining,
            removable=assembly.root.bit_count(),
            unjudged=self._unjudged(physics),
            contacts=tuple((*pair, depth) for pair, depth in sorted(self.replay.deepest.items(), key=lambda c: -c[1])),
        )

    def _hashes_for(self, plan: Plan) -> Mapping[str, str]:
        """The hashes that a plan must have; of a file of version 1 also the workcell's by the name of its robot."""
        if not plan.joints and "workcell" in self.hashes and plan.hashes.get("workcell") == self._hash_by_name:
            return {**self.hashes, "workcell": self._hash_by_name}
        return self.hashes

    def _unjudged(self, physics: bool) -> tuple[str, ...]:
        """What cannot be judged of this product."""
        assembly, lines = self.assembly, []
        outlines = self.replay.scene.outlines
        opened = [
            part.name for part, solid in zip(assembly.parts, outlines, strict=True) if solid and not solid.is_closed
        ]
        if opened:
            lines.append(f"what is inside of {', '.join(opened)} (open surfaces; crossing triangles are seen)")
        if physics:
            rough = [assembly.parts[i].name for i in unjudged_parts(assembly)]
            if rough:
                lines.append(f"gravity in states with {', '.join(rough)} (not convex, and no few convex pieces)")
            if assembly.joints:
                names = ", ".join(joint.name for joint in assembly.joints)
                lines.append(f"strength of joints (taken as rigid under gravity: {names})")
        return tuple(lines)

    def stand(self, state: int) -> StandingReport:
        """What happens to a state under gravity."""
        if state not in self._standing:
            seconds = self.options.physics_seconds
            self._standing[state] = stand_under_gravity(self.assembly, state, seconds, self.options)
        return self._standing[state]

    def _step(self, step: PlanStep, k: int, state: int) -> StepResult:
        """The replay of a step, under the number that it has in this plan."""
        grasp = step.grasp
        arrays = (grasp.center, grasp.orientation, step.joint_path, step.tool_path)
        digest = hashlib.sha256(f"{step.part} {state} {grasp.width!r} {step.length!r}".encode())
        for array in arrays:
            digest.update(f"{array.shape}".encode() + np.ascontiguousarray(array, dtype=float).tobytes())
        key = digest.digest()
        if key not in self._steps:
            self._steps[key] = self.replay.step(step, k, state)
        result = self._steps[key]
        return replace(
            result,
            findings=tuple(replace(finding, step=k) for finding in result.findings),
            clearance=result.clearance and replace(result.clearance, step=k),
        )


def states_of(plan: Plan, assembly: Assembly) -> list[int]:
    """States of a plan for disassembly: before the first step and after every step; unknown parts are skipped."""
    states = [assembly.root]
    for step in plan.steps:
        states.append(states[-1] & ~(1 << assembly.index[step.part]) if step.part in assembly.index else states[-1])
    return states


def _agreement(plan: Plan, assembly: Assembly, workcell: Workcell, results: list[StepResult]) -> Agreement:
    """Differences between stated and recomputed numbers, over the steps that could be replayed."""
    bound = straight_line_bound(assembly, workcell, plan.remaining)
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
