"""Structures of boxes for statics, and what MuJoCo makes of them with the friction of the structure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from takeapart.model.assembly import Assembly, Part
from takeapart.model.geometry import Array, Box, pose

SECONDS = 2.0


def block(
    name: str,
    size: Sequence[float] | Array,
    position: Sequence[float] | Array,
    fixed: bool = False,
    turn: Sequence[float] = (0.0, 0.0, 0.0),
    mass: float | None = None,
) -> Part:
    """A box of wood; `turn` is about x, then y, then z, in degrees."""
    T = pose(position)
    T[:3, :3] = Rotation.from_euler("xyz", turn, degrees=True).as_matrix()
    x, y, z = (float(edge) for edge in size)
    return Part(name, Box((x, y, z)), T, 600.0 * x * y * z if mass is None else mass, fixed)


def ground() -> Part:
    """A fixed plate whose top is at height 0."""
    return block("ground", (2.0, 2.0, 0.02), (0.0, 0.0, -0.01), fixed=True)


@dataclass(frozen=True)
class _Placed:
    """A box along the axes: lower and upper corner, m."""

    low: Array
    high: Array


def random_structure(rng: np.random.Generator, count: int) -> Assembly:
    """Boxes along the axes, each let down on what is below, often overhanging or bridging. Only `ground` is fixed."""
    placed: list[_Placed] = []
    parts = [ground()]
    for k in range(count):
        steady = rng.random() < 0.95
        for _ in range(300):
            size = np.array(
                [*(rng.choice([0.03, 0.05, 0.1, 0.16], 2) * rng.uniform(0.8, 1.2, 2)), rng.choice([0.04, 0.08])]
            )
            middle = rng.uniform(-0.12, 0.12, 2)
            low, high = middle - size[:2] / 2, middle + size[:2] / 2
            under = [p for p in placed if (p.low[:2] < high - 1e-6).all() and (p.high[:2] > low + 1e-6).all()]
            height = max((p.high[2] for p in under), default=0.0)
            seats = [p for p in under if p.high[2] > height - 1e-9]
            if height > 0.5 or (not under and k > 2):
                continue
            left = (
                min((max(p.low[0], low[0]) for p in seats), default=low[0]),
                min((max(p.low[1], low[1]) for p in seats), default=low[1]),
            )
            right = (
                max((min(p.high[0], high[0]) for p in seats), default=high[0]),
                max((min(p.high[1], high[1]) for p in seats), default=high[1]),
            )
            if not steady or ((np.array(left) < middle) & (np.array(right) > middle)).all():
                break
        else:
            continue
        box = _Placed(np.array([*low, height]), np.array([*high, height + size[2]]))
        placed.append(box)
        parts.append(block(f"b{k:02d}", box.high - box.low, (box.low + box.high) / 2))
    return Assembly("structure", tuple(parts))


def tilted(assembly: Assembly, rng: np.random.Generator) -> Assembly:
    """The same with its ground on a slope of up to 8 degrees; friction of 0.1 holds up to 5.7."""
    angle, turn = np.radians(rng.uniform(0.5, 8.0)), rng.uniform(0, 2 * np.pi)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(angle * np.array([np.cos(turn), np.sin(turn), 0.0])).as_matrix()
    return replace(assembly, parts=tuple(replace(part, T_world_part=T @ part.T_world_part) for part in assembly.parts))


def deepest_fall(assembly: Assembly, state: int, seconds: float = SECONDS) -> float:
    """How far down, m, the centre of any part of a state comes in MuJoCo under gravity.

    Sideways motion does not count: where MuJoCo finds one point of contact between two faces, blocks creep.
    """
    specification = mujoco.MjSpec()
    specification.option.timestep = 0.0005
    specification.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    specification.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    specification.option.impratio = 20.0
    specification.option.noslip_iterations = 10
    for i, part in enumerate(assembly.parts):
        if not part.fixed and not state >> i & 1:
            continue
        body = specification.worldbody.add_body(name=part.name, pos=part.T_world_part[:3, 3])
        body.quat = Rotation.from_matrix(part.T_world_part[:3, :3]).as_quat(scalar_first=True)
        assert isinstance(part.shape, Box)
        geom = body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=np.array(part.shape.size) / 2)
        geom.mass = part.mass
        geom.friction = [assembly.friction, 0.0, 0.0]
        geom.solref = [0.002, 1.0]
        geom.solimp = [0.95, 0.99, 0.0005, 0.5, 2.0]
        if not part.fixed:
            body.add_freejoint()
    model = specification.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    start = data.xipos.copy()
    deepest = 0.0
    for _ in range(round(seconds / 0.05)):
        mujoco.mj_step(model, data, 100)
        deepest = max(deepest, float((start - data.xipos)[:, 2].max()))
        if deepest > 0.02:
            break
    return deepest


def random_states(rng: np.random.Generator, assembly: Assembly, count: int) -> list[int]:
    """Different states of a structure, the full one first."""
    states, movable = [assembly.root], [i for i, part in enumerate(assembly.parts) if not part.fixed]
    for _ in range(20 * count):
        gone = rng.choice(movable, min(int(rng.integers(1, 4)), len(movable) - 1), replace=False)
        state = assembly.root & ~sum(1 << int(i) for i in gone)
        if state and state not in states and len(states) < count:
            states.append(state)
    return states
