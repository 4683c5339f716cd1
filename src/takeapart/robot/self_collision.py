"""Which pairs of bodies of an arm can meet, and how far apart the near ones are: worked out here, from no file.

A file of allowed collisions (SRDF) says which pairs somebody thought need no check. Here only neighbours in the chain
are left out, and pairs that touch in every configuration. For all others there are three cases:

- Two bodies with at most two joints between them: their pose relative to each other depends on those angles alone, so
  a table over them tells how far apart they are at least. Between its nodes the proof is Lipschitz's: while a joint
  turns by an angle, no point of either body moves relative to the other by more than the angle times its distance from
  the joint's axis.
- Where that table proves that two bodies never come near each other inside the joint limits, no check is needed.
- All other pairs are checked by their spheres and, where these meet, by the hulls.
"""

from __future__ import annotations

import hashlib
import logging
import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Literal

import numpy as np

from takeapart.compilation import compiled
from takeapart.model.geometry import Array
from takeapart.robot.arrays import TABLE_UNIT, Distances, Floats
from takeapart.robot.kept import is_kept, keep, kept
from takeapart.robot.kinematics import FULL_TURN
from takeapart.robot.separation import separation

NODE = 0.005  # rad, between the nodes of a table
COARSE = 8  # nodes between those that are looked at first
NEAR = 0.05  # m; where two bodies are further apart than this, the coarse nodes tell enough
FAR = 0.3  # m; the tables tell no greater distances
NEVER = 0.03  # m; pairs that never come nearer than this need no check: no workcell asks for more than 20 mm
LEAST_WINDING = 1e-6  # rad; a joint that turns less than this further than once round does not count as doing so
ANNOUNCED = 7_000_000  # nodes of new tables; so many take minutes, and it is said
SAMPLES = 200  # configurations in which a pair must touch to count as one that always does

LOGGER = logging.getLogger(__name__)

Treatment = Literal["neighbours", "always touch", "never meet", "table", "hulls"]


@dataclass(frozen=True)
class BodyPair:
    """How a pair of bodies of the arm is treated.

    Args:
        first, second: numbers of the bodies.
        treatment: how.
        least: distance that is proved for all configurations inside the limits, m; 0 where none is.
    """

    first: int
    second: int
    treatment: Treatment
    least: float = 0.0


@dataclass(frozen=True, eq=False)
class DistanceTable:
    """Least distances of two bodies over the angles of the joints between them.

    Args:
        joints: numbers of the two joints; the same twice where there is only one between the bodies.
        lower: (2,) rad, angles of the first node.
        step: (2,) rad, from node to node.
        distances: (A, B) in units of TABLE_UNIT, rounded down.
        reach: (2,) m; by turning a joint no point moves further than this for every radian.
    """

    joints: tuple[int, int]
    lower: Array
    step: Array
    distances: Distances
    reach: Array


@dataclass(frozen=True, eq=False)
class ConvexBody:
    """A body of the arm as the convex hull of its collision mesh.

    Args:
        corners: (V, 3) m, in the frame of the joint that moves it.
        frame: number of that joint, 0 for the base.
        rigid: whether it is the link of the joint itself; False for what is fastened to it.
    """

    corners: Array
    frame: int
    rigid: bool = True


def body_pairs(
    bodies: Sequence[ConvexBody], T_joint: Floats, lower: Floats, upper: Floats
) -> tuple[tuple[BodyPair, ...], tuple[DistanceTable, ...]]:
    """All pairs of bodies with the treatment of each, and the tables of those that have one.

    Args:
        T_joint: (n, 3, 4) pose of each joint's frame, at angle zero, in that of the joint before.
        lower, upper: (n,) joint limits, rad.
    """
    pairs: list[BodyPair] = []
    tables: list[DistanceTable] = []
    lower, upper = within_one_turn(lower, upper)
    always = always_touching(bodies, T_joint, lower, upper)
    near = [
        (a, b)
        for b in range(len(bodies))
        for a in range(b)
        if 0 < bodies[b].frame - bodies[a].frame <= 2 and not always[a, b] and not _are_neighbours(bodies[a], bodies[b])
    ]
    sides = [(bodies[a], bodies[b]) for a, b in near]
    unknown = [size for size, name in (_nodes(*side, T_joint, lower, upper) for side in sides) if not is_kept(name)]
    if sum(unknown) > ANNOUNCED:
        LOGGER.warning("working out how far the links of the arm are from each other, once: it takes a minute or two")
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        made = pool.map(lambda side: distance_table(side[0], side[1], T_joint, lower, upper), sides)
        found = dict(zip(near, made, strict=True))
    for a in range(len(bodies)):
        for b in range(a + 1, len(bodies)):
            first, second = bodies[a], bodies[b]
            between = second.frame - first.frame
            if _are_neighbours(first, second):
                pairs.append(BodyPair(a, b, "neighbours"))
            elif always[a, b]:
                pairs.append(BodyPair(a, b, "always touch"))
            elif between <= 2:
                table = found[a, b]
                least = float(table.distances.min()) * TABLE_UNIT - float(table.reach @ table.step) / 2
                if least > NEVER:
                    pairs.append(BodyPair(a, b, "never meet", least))
                else:
                    pairs.append(BodyPair(a, b, "table", max(least, 0.0)))
                    tables.append(table)
            else:
                pairs.append(BodyPair(a, b, "hulls"))
    return tuple(pairs), tuple(tables)


def _are_neighbours(first: ConvexBody, second: ConvexBody) -> bool:
    between = second.frame - first.frame
    return between == 0 or (between == 1 and first.rigid and second.rigid)


def turning_joints(lower: Floats, upper: Floats) -> list[int]:
    """Joints with limits (n,), rad, between which they turn further than once round."""
    return [k for k, span in enumerate(upper - lower) if span > FULL_TURN + LEAST_WINDING]


def within_one_turn(lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
    """Limits (n,), rad, of one turn about the middle for the joints that turn further: no pose of their links is left
    out. `kinematics.place` brings angles there.
    """
    lower, upper = lower.copy(), upper.copy()
    for k in turning_joints(lower, upper):
        middle = 0.5 * (lower[k] + upper[k])
        lower[k], upper[k] = middle - 0.5 * FULL_TURN, middle + 0.5 * FULL_TURN
    return lower, upper


def relative_pose(T_joint: Floats, first: int, second: int, angles: Array) -> Array:
    """Pose (4, 4) of joint frame `second` in joint frame `first`, with the joints between them at angles (k,), rad."""
    T = np.eye(4)
    for k, angle in zip(range(first, second), angles, strict=True):
        turn = np.eye(4)
        c, s = math.cos(angle), math.sin(angle)
        turn[:2, :2] = [[c, -s], [s, c]]
        T = T @ np.vstack([T_joint[k], [0, 0, 0, 1]]) @ turn
    return T


def always_touching(bodies: Sequence[ConvexBody], T_joint: Floats, lower: Floats, upper: Floats) -> Array:
    """Which pairs (B, B) of bodies, the smaller number first, touch in every one of some configurations; kept in the
    cache folder.
    """
    frames = np.array([body.frame for body in bodies])
    name = _name("touching-1", *[body.corners for body in bodies], frames, T_joint, lower, upper)
    known = kept(name)
    if known is not None and known.shape == (len(bodies), len(bodies)) and known.dtype == np.bool_:
        return known
    found = np.zeros((len(bodies), len(bodies)), dtype=bool)
    for a, first in enumerate(bodies):
        for b in range(a + 1, len(bodies)):
            rng = np.random.default_rng((a, b))
            found[a, b] = _always_touch(first, bodies[b], T_joint, lower, upper, rng)
    keep(name, found)
    return found


def _name(kind: str, *arrays: Array) -> str:
    """Of what is kept for certain arrays."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(str(array.shape).encode() + np.ascontiguousarray(array).tobytes())
    return f"{kind}-{digest.hexdigest()[:24]}"


def _always_touch(
    first: ConvexBody, second: ConvexBody, T_joint: Floats, lower: Floats, upper: Floats, rng: np.random.Generator
) -> bool:
    scratch = np.zeros((5, 3))
    joints = slice(first.frame, second.frame)
    for _ in range(SAMPLES):
        T = relative_pose(T_joint, first.frame, second.frame, rng.uniform(lower[joints], upper[joints]))
        R, p = np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3])
        if separation(first.corners, second.corners, R, p, 0.0, 0.0, scratch) > 0.0:
            return False
    return True


def distance_table(
    first: ConvexBody, second: ConvexBody, T_joint: Floats, lower: Floats, upper: Floats
) -> DistanceTable:
    """The table of two bodies with one or two joints between them; kept in the cache folder.

    Nodes are `NODE` apart where the bodies are near each other. Elsewhere they say what follows from nodes eight times
    as far apart: less than the distance, never more.
    """
    i, j = first.frame, second.frame - 1
    chain, starts, shape = _layout(first, second, T_joint, lower, upper)
    steps = np.array([NODE, NODE])
    reach = _kept_reach(first, second, chain)
    _, name = _nodes(first, second, T_joint, lower, upper)
    known = kept(name)
    if known is not None and known.shape == shape and known.dtype == np.uint16:
        return DistanceTable((i, j), starts, steps, known.astype(np.uint16, copy=False), reach)
    distances = np.zeros(shape, np.uint16)
    _fill(first.corners, second.corners, chain, starts, reach, distances)
    keep(name, distances)
    return DistanceTable((i, j), starts, steps, distances, reach)


def _layout(
    first: ConvexBody, second: ConvexBody, T_joint: Floats, lower: Floats, upper: Floats
) -> tuple[Floats, Array, tuple[int, int]]:
    """Of the table of two bodies: the joints between them, angles of the first node, and numbers of nodes."""
    i, j = first.frame, second.frame - 1
    counts = [max(1, math.ceil((upper[k] - lower[k]) / NODE / COARSE)) * COARSE + 1 for k in (i, j)]
    shape = (1 if i == j else counts[0], counts[1])
    return np.ascontiguousarray(T_joint[i : j + 1]), np.array([lower[i], lower[j]]), shape


def _nodes(first: ConvexBody, second: ConvexBody, T_joint: Floats, lower: Floats, upper: Floats) -> tuple[int, str]:
    """How many nodes the table of two bodies has, and the name under which it is kept."""
    chain, starts, shape = _layout(first, second, T_joint, lower, upper)
    measures = np.array([NODE, COARSE, NEAR, TABLE_UNIT, *shape])
    return shape[0] * shape[1], _name("distances-2", measures, first.corners, second.corners, chain, starts)


def _kept_reach(first: ConvexBody, second: ConvexBody, chain: Floats) -> Array:
    """(2,) see `_reach`; kept in the cache folder."""
    name = _name("reach-1", first.corners, second.corners, chain)
    known = kept(name)
    if known is not None and known.shape == (2,) and known.dtype == np.float64:
        return known
    found = np.array(_reach(first, second, chain))
    keep(name, found)
    return found


def _reach(first: ConvexBody, second: ConvexBody, chain: Floats) -> tuple[float, float]:
    """For each joint between two bodies the greatest distance, m, of the points of one of them from its axis: of the
    body for which that is less, since the motion of either relative to the other is the same.

    A body beyond the other of two joints goes round that joint's axis: its points are followed all round, at angles
    inside the limits and beyond them.
    """

    def from_axis(points: Array, T: Array) -> float:
        local = (points - T[:3, 3]) @ T[:3, :3]
        return float(np.linalg.norm(local[:, :2], axis=1).max())

    to_full = [np.vstack([T, [0, 0, 0, 1]]) for T in chain]
    own = from_axis(second.corners, np.eye(4))  # of the second body from the last joint's axis
    if len(chain) == 1:
        return 0.0, min(own, from_axis(first.corners, to_full[0]))
    # The second body from the first joint's axis: circles about the second joint's axis, their distance by samples of
    # the circle, with what can lie between two samples added.
    turns = np.linspace(-math.pi, math.pi, 721)
    c, s = np.cos(turns), np.sin(turns)
    x, y, z = second.corners.T
    circles = np.stack([np.outer(c, x) - np.outer(s, y), np.outer(s, x) + np.outer(c, y), np.outer(0 * c + 1, z)], -1)
    R, p = to_full[1][:3, :3], to_full[1][:3, 3]
    around = circles.reshape(-1, 3) @ R.T + p
    beyond = float(np.linalg.norm(around[:, :2], axis=1).max()) + own * math.pi / 720
    # The first body from the second joint's axis, which the first joint takes round: the same with exchanged roles.
    fixed = (first.corners - to_full[0][:3, 3]) @ to_full[0][:3, :3]
    x, y, z = fixed.T
    circles = np.stack([np.outer(c, x) + np.outer(s, y), -np.outer(s, x) + np.outer(c, y), np.outer(0 * c + 1, z)], -1)
    local = (circles.reshape(-1, 3) - p) @ R
    near = float(np.linalg.norm(fixed[:, :2], axis=1).max())
    before = float(np.linalg.norm(local[:, :2], axis=1).max()) + near * math.pi / 720
    return min(beyond, near), min(own, before)


@compiled
def _fill(first: Floats, second: Floats, chain: Floats, lower: Floats, reach: Floats, distances: Distances) -> None:
    """Writes the table (A, B): coarse nodes first, the others where these leave doubt."""
    scratch = np.zeros((5, 3))
    R, p = np.zeros((3, 3)), np.zeros(3)
    rows, columns = distances.shape
    every = 1 if rows == 1 else COARSE
    for pass_ in range(2):
        for a in range(rows):
            for b in range(columns):
                coarse = a % every == 0 and b % COARSE == 0
                if coarse != (pass_ == 0):
                    continue
                if pass_ == 1:
                    # What the nearest coarse node proves here.
                    a0 = min((a + every // 2) // every * every, rows - 1)
                    b0 = min((b + COARSE // 2) // COARSE * COARSE, columns - 1)
                    lost = reach[0] * abs(a - a0) * NODE + reach[1] * abs(b - b0) * NODE
                    proved = distances[a0, b0] * TABLE_UNIT - lost
                    touching = True
                    for da in (-every, 0, every):
                        for db in (-COARSE, 0, COARSE):
                            u, w = a0 + da, b0 + db
                            if 0 <= u < rows and 0 <= w < columns and distances[u, w] > 0:
                                touching = False
                    if touching:
                        continue  # all around they touch: nothing is claimed
                    if proved > NEAR:
                        distances[a, b] = np.uint16(min(proved / TABLE_UNIT, 65535.0))
                        continue
                _relative(chain, lower, a * NODE, b * NODE, R, p)
                found = separation(first, second, R, p, 0.0, FAR, scratch)
                distances[a, b] = np.uint16(max(0.0, min(found / TABLE_UNIT, 65535.0)))


@compiled
def _relative(chain: Floats, lower: Floats, first: float, second: float, R: Floats, p: Floats) -> None:
    """Pose of the second body's frame in the first one's, one or two joints turned so far beyond their lower limits."""
    for i in range(3):
        p[i] = 0.0
        for j in range(3):
            R[i, j] = 1.0 if i == j else 0.0
    for k in range(len(chain)):
        angle = lower[1] + second if k == len(chain) - 1 else lower[0] + first
        c, s = math.cos(angle), math.sin(angle)
        T = chain[k]
        for i in range(3):
            x, y, z = R[i, 0], R[i, 1], R[i, 2]
            p[i] += x * T[0, 3] + y * T[1, 3] + z * T[2, 3]
            u = x * T[0, 0] + y * T[1, 0] + z * T[2, 0]
            v = x * T[0, 1] + y * T[1, 1] + z * T[2, 1]
            R[i, 0], R[i, 1], R[i, 2] = c * u + s * v, c * v - s * u, x * T[0, 2] + y * T[1, 2] + z * T[2, 2]
