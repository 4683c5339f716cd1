"""What a verification says: options, findings and the report. Data and its text form only."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Literal

from takeapart.formats.bound_texts import SEQUENCE
from takeapart.workcell import Workcell

CheckName = Literal[
    "schema",
    "hash",
    "robot",
    "order",
    "grasp",
    "width",
    "gripper",
    "finger_contact",
    "payload",
    "home",
    "start_pose",
    "lift",
    "joint_limit",
    "jump",
    "tool_path",
    "goal",
    "collision",
    "length",
    "total_length",
    "bound",
    "stability",
    "support",
    "physics",
]


NOT_CHECKED = (  # what a plan states, or needs, that no replay can confirm
    f"sequence bound ({SEQUENCE})",
    "counts of planner calls",
    "seconds",
    "seed",
    "search and its history",
    "versions",
    "names of its sources and other extra keys",
    "whether a part turns between the fingers (friction is compared with its weight, not with its moment)",
)


@dataclass(frozen=True)
class VerificationOptions:
    """Bounds of every check. Lengths in m, angles in rad; defaults are the project's definition of a trusted plan.

    Args:
        clearance: least distance between things that may not touch; 0 forbids contact only; None: that of the workcell.
            Neighbours that start closer than this must keep, during the lift, the distance at which they start.
        clearance_tolerance: of the clearance; rounding of files, and of distances between curved meshes.
        sight: distances below this are measured; the smallest clearance is reported up to here.
        tool_step: no point of tool or held part moves more than this between two checked configurations ...
        joint_step: ... and no joint turns more than this.
        position_tolerance: agreement of positions (start, tool path, goal, straightness of the lift).
        angle_tolerance: agreement of orientations at the rows of a path.
        lift_angle_tolerance: the tool turns at most this much during the lift, between rows too.
        penetration: depth up to which things that rest on each other at the start may overlap (rounding of drawings).
        touching: parts closer than this at the start are neighbours (connectors leave 0.5 mm play).
        overlap_limit: depth up to which meshes may overlap as drawn, and on their way out; pairs that the assembly
            allows to overlap may be in each other as deep as they are drawn, and by `penetration` more.
        pad_gap, pad_depth, pad_area: of what is gripped and is no box: each pad must be within this distance of so much
            of the surface, m^2, seen along the closing direction, and no deeper in it than this.
        width_tolerance: difference of the opening and the part's extent along the closing axis.
        square_tolerance: angle between the closing axis and the normals of the gripped faces.
        finger_gap: largest distance of the fingers of each side from the held part, and of their pads from where the
            gripper's description has them at the opening.
        pad_tilt: angle between the pads and the square to the closing direction.
        joint_jump, tool_jump: largest step between two rows of a path, in any joint and of the tool's position.
        length_tolerance: of lengths, total and bound.
        physics_seconds, physics_shift, physics_tilt: how long a state must stand under gravity; a part that moves or
            tips more than this is a finding.
    """

    clearance: float | None = None
    clearance_tolerance: float = 5e-5
    sight: float = 0.003
    tool_step: float = 0.001
    joint_step: float = math.radians(0.5)
    position_tolerance: float = 1e-4
    angle_tolerance: float = math.radians(0.01)
    lift_angle_tolerance: float = math.radians(0.05)
    penetration: float = 1e-4
    touching: float = 1e-3
    overlap_limit: float = 5e-4
    pad_gap: float = 5e-4
    pad_depth: float = 5e-4
    pad_area: float = 1e-5
    width_tolerance: float = 1e-5
    square_tolerance: float = math.radians(0.05)
    finger_gap: float = 1e-4
    pad_tilt: float = math.radians(0.5)
    joint_jump: float = 0.1
    tool_jump: float = 0.02
    length_tolerance: float = 1e-6
    physics_seconds: float = 2.0
    physics_shift: float = 0.005
    physics_tilt: float = math.radians(5.0)

    def demanded_clearance(self, workcell: Workcell) -> float:
        """Distance below which things that may not touch are reported, m."""
        clearance = workcell.clearance if self.clearance is None else self.clearance
        return max(clearance - self.clearance_tolerance, 0.0)


@dataclass(frozen=True)
class Finding:
    """One reason to refuse a plan.

    Args:
        step: number of the step, counted from 0 in the order of disassembly; None: the plan as a whole.
        part: name of the part that the step removes; empty for the plan as a whole.
        time: row of the step's path, fractional between rows; None where no moment can be named.
        check: name of the check that failed.
        message: what is wrong, with names.
        depth: by how much a bound is broken, in the bound's unit (m or rad); for collisions the depth of penetration,
            or by how much the demanded clearance is missed.
    """

    step: int | None
    part: str
    time: float | None
    check: CheckName
    message: str
    depth: float = 0.0


@dataclass(frozen=True)
class Clearance:
    """The smallest distance seen between two things that may not touch."""

    distance: float  # m
    step: int
    part: str
    time: float  # row of the step's path
    first: str
    second: str


@dataclass(frozen=True)
class Agreement:
    """Largest differences between what the plan states and what the verifier computed."""

    tool_position: float = 0.0  # m
    tool_angle: float = 0.0  # rad
    step_length: float = 0.0  # m
    total_length: float = 0.0  # m
    straight_line_bound: float = 0.0  # m
    total_length_recomputed: float = 0.0  # m, from the verifier's own kinematics at the rows
    bound_recomputed: float = 0.0  # m


@dataclass(frozen=True)
class VerificationReport:
    """Outcome of `verify_plan`; the plan is trusted if there are no findings.

    Args:
        plan: names of assembly and workcell.
        findings: in the order of the steps.
        steps: number of steps replayed.
        configurations: number of arm configurations checked for collisions.
        smallest_clearance: None if nothing came within the sight of the options.
        agreement: see `Agreement`.
        states: number of states that stood under gravity for the physics check.
        seconds: wall time.
        clearances: the smallest one of every step that was replayed, in the order of disassembly; None as above.
        motion: hash of what the plan has the arm do, see `takeapart.formats.serialization.motion_hash`.
        unjudged: what could not be judged of this product, one line each.
        remaining: names of the removable parts that the plan leaves where they are; empty if it takes all of them.
        removable: how many parts the product has that are not fixed.
        contacts: how deep, m, held parts were in what they slid out of, per pair, deepest first.
    """

    plan: str
    findings: tuple[Finding, ...]
    steps: int
    configurations: int
    smallest_clearance: Clearance | None
    agreement: Agreement
    states: int
    seconds: float
    options: VerificationOptions = field(default_factory=VerificationOptions)
    clearances: tuple[Clearance | None, ...] = ()
    motion: str = ""
    unjudged: tuple[str, ...] = ()
    contacts: tuple[tuple[str, str, float], ...] = ()
    remaining: tuple[str, ...] = ()
    removable: int = 0

    @property
    def not_checked(self) -> tuple[str, ...]:
        """What the plan states and this report says nothing about."""
        known = NOT_CHECKED if self.states else (*NOT_CHECKED, "whether the parts stand under gravity")
        return (*known, *self.unjudged)

    @property
    def passed(self) -> bool:
        """True if the plan has no findings."""
        return not self.findings


def format_finding(finding: Finding) -> str:
    """One line: step, part, time, what, how deep."""
    place = "plan" if finding.step is None else f"step {finding.step + 1} {finding.part}"
    moment = "" if finding.time is None else f" row {finding.time:.2f}"
    depth = ""
    if finding.depth:
        angular = finding.check == "joint_limit" or (finding.check == "jump" and "joint" in finding.message)
        depth = f" ({math.degrees(finding.depth):.3f} deg)" if angular else f" ({1e3 * finding.depth:.3f} mm)"
    return f"{place}{moment}: {finding.check}: {finding.message}{depth}"


def report_as_dict(report: VerificationReport) -> dict[str, object]:
    """The report as plain data for JSON."""
    return {"passed": report.passed, **asdict(report), "not_checked": list(report.not_checked)}
