"""Does a partly built assembly stand? Parts as free bodies under gravity in MuJoCo, fixed ones welded to the world."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Array, rotation_from_quaternion
from takeapart.verification.checks import unsupported
from takeapart.verification.model import add_box, place_body
from takeapart.verification.report import Finding, VerificationOptions
from takeapart.verification.robot import mujoco

TIMESTEP = 0.002  # s
CONTACT_BITS = (1, 1)
BREAKDOWNS = (  # MuJoCo's warnings after which a state means nothing: it starts anew, or leaves contacts out
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
    mujoco.mjtWarning.mjWARN_CONTACTFULL,
    mujoco.mjtWarning.mjWARN_CNSTRFULL,
)


@dataclass(frozen=True)
class StandingReport:
    """What happened to one state under gravity.

    Args:
        state: mask of the parts present.
        findings: one per part that moved or tipped too far.
        largest_shift: m, of any part's centre.
        largest_tilt: rad, of any part.
    """

    state: int
    findings: tuple[Finding, ...]
    largest_shift: float
    largest_tilt: float

    @property
    def stands(self) -> bool:
        """True if no part moved or tipped too far."""
        return not self.findings


@dataclass(frozen=True)
class StabilityComparison:
    """The connector rule against physics, as numbers of states; the last two list the states that disagree."""

    both_stand: int
    both_fall: int
    only_rule_stands: tuple[int, ...]
    only_physics_stands: tuple[int, ...]

    @property
    def agreement(self) -> float:
        """Fraction of states on which rule and physics agree; 1 for no states."""
        disagree = len(self.only_rule_stands) + len(self.only_physics_stands)
        agree = self.both_stand + self.both_fall
        return agree / (agree + disagree) if agree + disagree else 1.0


def gravity_model(assembly: Assembly, state: int) -> mujoco.MjModel:
    """The parts of a state as free bodies with the connectors they host; fixed parts belong to the world."""
    specification = mujoco.MjSpec()
    option = specification.option
    option.timestep = TIMESTEP
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 10.0  # stiff friction: bars at rest must not creep
    for i, part in enumerate(assembly.parts):
        if not part.fixed and not state >> i & 1:
            continue
        body = specification.worldbody.add_body(name=part.name)
        place_body(body, part.T_world_part)
        solid = part.shape.boxes()
        for k, box in enumerate(assembly.body(i)):
            geom = add_box(body, box, CONTACT_BITS)
            share = float(np.prod(box.half_extents) / sum(np.prod(piece.half_extents) for piece in solid))
            geom.mass = part.mass * share if k < len(solid) else 0.0  # connectors are light against the bars
            geom.solref = [0.004, 1.0]
            geom.solimp = [0.95, 0.99, 0.0005, 0.5, 2.0]
            geom.friction = [0.4, 0.005, 0.0001]
        if not part.fixed:
            body.add_freejoint()
    return specification.compile()


def stand_under_gravity(
    assembly: Assembly, state: int, seconds: float = 2.0, options: VerificationOptions | None = None
) -> StandingReport:
    """Lets a state stand under gravity and reports every part that moves or tips too far at any moment."""
    options = options or VerificationOptions()
    model = gravity_model(assembly, state)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    free = np.array([b for b in range(1, model.nbody) if model.body_jntnum[b]], dtype=int)
    if not len(free):
        return StandingReport(state, (), 0.0, 0.0)
    start, start_R = data.xipos[free].copy(), data.xmat[free].reshape(-1, 3, 3).copy()
    shift, tilt = np.zeros(len(free)), np.zeros(len(free))
    for _ in range(round(seconds / 0.02)):
        mujoco.mj_step(model, data, round(0.02 / TIMESTEP))
        shift = np.maximum(shift, np.linalg.norm(data.xipos[free] - start, axis=1))
        tilt = np.maximum(tilt, _tilts(start_R, data.xquat[free]))
        if shift.max() > 2 * options.physics_shift:
            break  # it falls; how far does not matter
        if any(data.warning[warning].number for warning in BREAKDOWNS):
            break
    findings = [
        Finding(None, "", None, "physics", f"the simulation broke down: {_name(warning)}")
        for warning in BREAKDOWNS
        if data.warning[warning].number
    ]
    for body, moved, turned in zip(free, shift, tilt, strict=True):
        if moved > options.physics_shift or turned > options.physics_tilt:
            name = str(model.body(body).name)
            message = f"part {name!r} does not stand: it tips {math.degrees(turned):.2f} deg and moves"
            findings.append(Finding(None, name, None, "physics", message, float(moved)))
    return StandingReport(state, tuple(findings), float(shift.max()), float(tilt.max()))


def compare_stability(
    assembly: Assembly, states: Iterable[int], options: VerificationOptions | None = None
) -> StabilityComparison:
    """Compares the connector rule with physics on states."""
    options = options or VerificationOptions()
    both_stand = both_fall = 0
    only_rule: list[int] = []
    only_physics: list[int] = []
    for state in states:
        rule = not unsupported(assembly, state)
        physics = stand_under_gravity(assembly, state, options.physics_seconds, options).stands
        both_stand += rule and physics
        both_fall += not rule and not physics
        if rule and not physics:
            only_rule.append(state)
        if physics and not rule:
            only_physics.append(state)
    return StabilityComparison(both_stand, both_fall, tuple(only_rule), tuple(only_physics))


def _name(warning: mujoco.mjtWarning) -> str:
    return str(warning.name).removeprefix("mjWARN_")


def _tilts(start: Array, quaternions: Array) -> Array:
    """Angles (B,), rad, between rotations (B, 3, 3) and quaternions (B, 4)."""
    now = np.array([rotation_from_quaternion(q) for q in quaternions])
    cosine = (np.einsum("bij,bij->b", start, now) - 1) / 2
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))
