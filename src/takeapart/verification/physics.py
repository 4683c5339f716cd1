"""Does a partly built assembly stand? Parts as free bodies under gravity in MuJoCo, fixed ones welded to the world."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import ConvexHull

from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Array, Box, Shape, pose_inverse, rotation_from_quaternion
from takeapart.verification.bodies import add_box, place_body
from takeapart.verification.checks import unsupported
from takeapart.verification.pieces import convex_pieces
from takeapart.verification.report import Finding, VerificationOptions
from takeapart.verification.robot import mujoco
from takeapart.verification.solids import Solid

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
    """The parts of a state as free bodies with the connectors they host; fixed parts belong to the world, and so does
    the ground under a product that does not stand in connectors."""
    specification = mujoco.MjSpec()
    option = specification.option
    option.timestep = TIMESTEP
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = 10.0  # stiff friction: bars at rest must not creep
    friction = 0.4 if assembly.stands_in_connectors else assembly.friction
    for group in _fastened(assembly, state):
        first = assembly.parts[group[0]]
        body = specification.worldbody.add_body(name=first.name)
        place_body(body, first.T_world_part)
        for i in group:
            T_body_part = np.eye(4)
            if i != group[0]:
                T_body_part = pose_inverse(first.T_world_part) @ assembly.parts[i].T_world_part
            _add_part(specification, body, assembly, i, T_body_part)
        for geom in body.geoms:
            geom.solref = [0.004, 1.0]
            geom.solimp = [0.95, 0.99, 0.0005, 0.5, 2.0]
            geom.friction = [friction, 0.005, 0.0001]
        if not any(assembly.parts[i].fixed for i in group):
            body.add_freejoint()
    if not assembly.stands_in_connectors:
        heights = [part.shape.surface().moved(part.T_world_part).bounds[0, 2] for part in assembly.parts]
        for connector in assembly.connectors:
            T_world_host = assembly.parts[assembly.index[connector.host]].T_world_part
            heights += [wall.moved(T_world_host).corners()[:, 2].min() for wall in connector.walls]
        ground = specification.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1.0, 1.0, 0.1], pos=[0.0, 0.0, float(min(heights))]
        )
        ground.contype, ground.conaffinity = CONTACT_BITS
        ground.friction = [friction, 0.005, 0.0001]
    return specification.compile()


def _add_part(
    specification: mujoco.MjSpec, body: mujoco.MjsBody, assembly: Assembly, i: int, T_body_part: Array
) -> None:
    """Gives a body the convex pieces of a part and the connectors that it hosts."""
    part = assembly.parts[i]
    pieces = pieces_of(part.shape) or []
    volume = sum(each for _, each in pieces)
    for k, (corners, share) in enumerate(pieces):
        if isinstance(part.shape, Box):
            geom = add_box(body, part.shape.bounding_box().moved(T_body_part), CONTACT_BITS)
        else:
            moved = corners @ T_body_part[:3, :3].T + T_body_part[:3, 3]
            mesh = specification.add_mesh(name=f"{part.name}/{k}", uservert=moved.ravel())
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
            geom = body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name)
            geom.contype, geom.conaffinity = CONTACT_BITS
        geom.mass = part.mass * share / volume
    for connector in assembly.connectors:
        for wall in connector.walls if connector.host == part.name else ():
            add_box(body, wall.moved(T_body_part), CONTACT_BITS).mass = 0.0  # connectors are light against the bars


def _fastened(assembly: Assembly, state: int) -> list[list[int]]:
    """Numbers of the parts that are there, those together that joints fasten to each other: they move as one body."""
    groups = {part.name: [i] for i, part in enumerate(assembly.parts) if part.fixed or state >> i & 1}
    for joint in assembly.joints:
        first, second = groups.get(joint.first), groups.get(joint.second)
        if first is not None and second is not None and first is not second:
            first += second
            for i in second:
                groups[assembly.parts[i].name] = first
    return [group for name, group in groups.items() if assembly.parts[group[0]].name == name]


def unjudged_parts(assembly: Assembly) -> tuple[int, ...]:
    """Numbers of the parts that no few convex pieces make up: states with them are not judged under gravity."""
    return tuple(i for i, part in enumerate(assembly.parts) if pieces_of(part.shape) is None)


def judged_under_gravity(assembly: Assembly, state: int) -> bool:
    """Whether every part of a state is known in convex pieces."""
    return not any(assembly.parts[i].fixed or state >> i & 1 for i in unjudged_parts(assembly))


def pieces_of(shape: Shape) -> list[tuple[Array, float]] | None:
    """Corners (N, 3), m, and volumes, m^3, of the convex pieces of a shape; None where it has none, see
    `convex_pieces`."""
    if isinstance(shape, Box):
        return [(shape.bounding_box().corners(), shape.volume())]
    return _pieces_of(shape)  # type: ignore[arg-type]  # shapes are kept by identity


@lru_cache(maxsize=512)
def _pieces_of(shape: Shape) -> list[tuple[Array, float]] | None:
    pieces = convex_pieces(Solid(shape.surface()))
    return None if pieces is None else [(corners, float(ConvexHull(corners).volume)) for corners in pieces]


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
