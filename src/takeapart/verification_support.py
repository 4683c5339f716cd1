"""What carries the parts, judged without the planner's rules: by linear programs over points of the boxes.

A box lies on another where a point of the first is right above a point of the second. All such places, seen from above,
are a convex set, whose points are the solutions of a few inequalities; the centre of mass must be a mixture of places
on what carries the part. The planner clips polygons of faces instead (`takeapart.contact`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linprog

from takeapart.assembly import Assembly, Part
from takeapart.geometry import Array, OrientedBox
from takeapart.verification_checks import carriers, underneath
from takeapart.verification_model import Scene
from takeapart.verification_report import Finding, VerificationOptions

INSIDE = 5e-5  # m, the centre of mass has to lie this far inside of what carries the part
DIRECTIONS = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
Pair = tuple[OrientedBox, OrientedBox]
"""A box, and one that it lies on, in the world."""


def check_support(assembly: Assembly, scene: Scene, options: VerificationOptions) -> list[Finding]:
    """Every connector touches its host and its guest; a U has a floor right below its guest; what carries a part holds
    its centre of mass. That what carries a part stays as long as the part does is another check (`check_stability`).

    Args:
        scene: its parts stand as in the assembly.
    """
    findings = [*_check_connectors(assembly, scene, options)]
    for number, part in enumerate(assembly.parts):
        if not part.fixed:
            findings += _check_balance(assembly, number, part, options)
    return findings


def _check_connectors(assembly: Assembly, scene: Scene, options: VerificationOptions) -> list[Finding]:
    findings = []
    taken = [len(part.shape.boxes()) for part in assembly.parts]  # walls follow the part's own boxes
    for connector in assembly.connectors:
        numbers = {role: assembly.index[getattr(connector, role)] for role in ("host", "guest")}
        first = taken[numbers["host"]]
        taken[numbers["host"]] += len(connector.walls)
        walls = scene.geoms(scene.static_bodies[numbers["host"]])[first : taken[numbers["host"]]]
        for role, number in numbers.items():
            body = scene.geoms(scene.static_bodies[number])[: len(assembly.parts[number].shape.boxes())]
            gap = min(scene.distance(a, b) for a in walls for b in body)
            if gap > options.touching + 1e-6:
                message = f"connector {connector.name!r} does not touch its {role} {assembly.parts[number].name!r}"
                findings.append(Finding(None, "", None, "stability", message, gap))
        guest = assembly.parts[numbers["guest"]]
        own = _placed(assembly.parts[numbers["host"]], connector.walls)
        if connector.kind == "U" and not _lying(_placed(guest, guest.shape.boxes()), own, options.touching):
            message = f"no wall of {connector.name!r}, a U, is right below {guest.name!r}"
            findings.append(Finding(None, "", None, "stability", message))
    return findings


def _check_balance(assembly: Assembly, number: int, part: Part, options: VerificationOptions) -> list[Finding]:
    pairs = _supports(assembly, number, part, options)
    name = part.name
    if not pairs:
        return [Finding(None, "", None, "stability", f"nothing that carries {name!r} is right below it")]
    boxes = part.shape.boxes()
    volumes = np.array([8 * float(np.prod(box.half_extents)) for box in boxes])
    middles = np.array([box.moved(part.T_world_part).T_frame_box[:2, 3] for box in boxes])
    centre = volumes @ middles / volumes.sum()
    if all(_reach(pairs, centre, direction, options.touching) >= INSIDE for direction in DIRECTIONS):
        return []
    message = f"the centre of mass of {name!r} does not lie above what carries it"
    return [Finding(None, "", None, "stability", message, _outside(pairs, centre, options.touching))]


def _supports(assembly: Assembly, number: int, part: Part, options: VerificationOptions) -> list[Pair]:
    """What a part lies on: walls and hosts of the connectors that carry it; without any, all that is below it."""
    hosts = carriers(assembly, part)
    if not hosts:
        below = [
            box
            for name in underneath(assembly, number, options.touching)
            for box in _placed(assembly.parts[assembly.index[name]], assembly.body(assembly.index[name]))
        ]
        return _lying(_placed(part, assembly.body(number)), below, options.touching)
    below = []
    for connector in assembly.connectors:
        if connector.guest == part.name and connector.host in hosts:
            host = assembly.parts[assembly.index[connector.host]]
            below += _placed(host, (*connector.walls, *host.shape.boxes()))
    return _lying(_placed(part, part.shape.boxes()), below, options.touching)


def _placed(part: Part, boxes: Sequence[OrientedBox]) -> list[OrientedBox]:
    return [box.moved(part.T_world_part) for box in boxes]


def _lying(above: Sequence[OrientedBox], below: Sequence[OrientedBox], touching: float) -> list[Pair]:
    """Pairs of which the first lies on the second: their least gap, measured upright, is within `touching`."""
    found = []
    for upper in above:
        for lower in below:
            (least, most), (low, high) = ((c.min(axis=0), c.max(axis=0)) for c in (upper.corners(), lower.corners()))
            if (least[:2] > high[:2]).any() or (low[:2] > most[:2]).any() or least[2] - high[2] > touching + 1e-6:
                continue
            A, b = _places(upper, lower)
            solved = linprog([0.0, 0.0, 1.0, -1.0], A, b, bounds=(None, None))
            if solved.fun is not None and abs(solved.fun) <= touching + 1e-6:
                found.append((upper, lower))
    return found


def _places(upper: OrientedBox, lower: OrientedBox) -> tuple[Array, Array]:
    """Inequalities A v <= b on v = (x, y, height in the upper box, height in the lower), m: the points are in them."""
    A, b = np.zeros((12, 4)), np.zeros(12)
    for k, box in enumerate((upper, lower)):
        R, p = box.T_frame_box[:3, :3], box.T_frame_box[:3, 3]
        normals = np.vstack([R.T, -R.T])  # (6, 3)
        A[6 * k : 6 * k + 6, :2], A[6 * k : 6 * k + 6, 2 + k] = normals[:, :2], normals[:, 2]
        b[6 * k : 6 * k + 6] = np.tile(box.half_extents, 2) + normals @ p
    return A, b


def _mixture(pairs: Sequence[Pair], touching: float, extra: int) -> tuple[Array, Array, Array]:
    """Mixtures of places on several pairs: inequalities A v <= 0, equations E v = e, and e. Of each pair v holds a
    share and the place times the share, then `extra` numbers; the last two equations give the mixture's x and y."""
    width = 5 * len(pairs) + extra
    A, E = np.zeros((14 * len(pairs), width)), np.zeros((3, width))
    for k, (upper, lower) in enumerate(pairs):
        rows, limits = _places(upper, lower)
        block, at = A[14 * k : 14 * k + 14], 5 * k
        block[:12, at], block[:12, at + 1 : at + 5] = -limits, rows
        block[12, at], block[12, at + 3 : at + 5] = -(touching + 1e-6), (1.0, -1.0)
        block[13, at] = -1.0
        E[0, at] = E[1, at + 1] = E[2, at + 2] = 1.0
    return A, E, np.array([1.0, 0.0, 0.0])


def _outside(pairs: Sequence[Pair], centre: Array, touching: float) -> float:
    """How far, m, a place (2,) must move along x and y together to lie above what carries; 0 where it does."""
    A, E, e = _mixture(pairs, touching, 4)
    E[1, -4:-2], E[2, -2:] = (1.0, -1.0), (1.0, -1.0)
    limits = [(None, None)] * (5 * len(pairs)) + [(0.0, None)] * 4
    cost = np.r_[np.zeros(5 * len(pairs)), np.ones(4)]
    found = linprog(cost, A, np.zeros(len(A)), E, np.r_[e[0], centre], bounds=limits)
    return np.inf if found.fun is None else float(found.fun)


def _reach(pairs: Sequence[Pair], centre: Array, direction: Array, touching: float) -> float:
    """How far, m, a place (2,) may move in a direction and still lie above what carries."""
    A, E, e = _mixture(pairs, touching, 1)
    E[1:, -1] = -direction
    cost = np.r_[np.zeros(5 * len(pairs)), -1.0]
    found = linprog(cost, A, np.zeros(len(A)), E, np.r_[e[0], centre], bounds=(None, None))
    return -np.inf if found.fun is None else -float(found.fun)
