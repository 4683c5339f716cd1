"""A configuration at rest: free of self-collision, far from singular, in the middle of the joints, the tool in front of
the arm and pointing down.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from takeapart.model.description import ArmDescription
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array
from takeapart.robot.chain import Body, Chain, arm_chain
from takeapart.robot.covering import body_hulls
from takeapart.robot.self_collision import always_touching, relative_pose
from takeapart.robot.separation import separation
from takeapart.robot.urdf import read_urdf

SAMPLES, KEPT, ROUNDS = 4000, 64, 120
FIRST_STEP, SHRINKING = 0.25, 0.96  # of a joint's range, standard deviation in the first round; from round to round
LEAST_GAP = 0.01  # m between bodies that may meet
OUT, UP = 0.33, 0.5  # of the reach, where the tool should be in front of the shoulder and above the base
LEAST_MANIPULABILITY = 0.05  # of the best that was sampled: below, a configuration counts as singular


def find_home(arm: ArmDescription, bodies: Sequence[Body], T_flange_tool: Array) -> tuple[float, ...]:
    """A configuration at rest, rad, found by search; the same for every call.

    Args:
        bodies: of the arm and what is on its flange.
        T_flange_tool: (4, 4) pose of the tool in the flange.

    Raises:
        InputError: none was found that is free of self-collision.
    """
    chain = arm_chain(read_urdf(arm.files), arm)
    T_tool = chain.T_last_flange @ T_flange_tool
    rng = np.random.default_rng(0)
    middle, span = 0.5 * (chain.lower + chain.upper), np.minimum(chain.upper - chain.lower, 2 * np.pi)
    lower, upper = middle - 0.5 * span, middle + 0.5 * span
    rows = rng.uniform(lower, upper, (SAMPLES, len(lower)))
    reach, best = _scale(chain, T_tool, rows)

    def costs(rows: Array) -> Array:
        return _costs(chain, T_tool, rows, reach, best)

    rows = rows[np.argsort(costs(rows))[:KEPT]]
    known = costs(rows)
    for turn in range(ROUNDS):
        tried = np.clip(rows + rng.normal(size=rows.shape) * span * FIRST_STEP * SHRINKING**turn, lower, upper)
        found = costs(tried)
        better = found < known
        rows[better], known[better] = tried[better], found[better]
    for q in rows[np.argsort(known)]:
        if least_gap(bodies, chain, q) >= LEAST_GAP:
            return tuple(round(float(angle), 4) for angle in q)
    raise InputError("no configuration at rest was found that is free of self-collision; state one", arm.name)


def _frames(chain: Chain, rows: Array) -> list[Array]:
    """Pose (K, 4, 4) of each joint's frame in the base at configurations (K, n), rad."""
    T = np.broadcast_to(np.eye(4), (len(rows), 4, 4))
    found = []
    for k, step in enumerate(chain.T_joint):
        turn = np.broadcast_to(np.eye(4), (len(rows), 4, 4)).copy()
        c, s = np.cos(rows[:, k]), np.sin(rows[:, k])
        turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1] = c, -s, s, c
        T = T @ np.vstack([step, [0, 0, 0, 1]]) @ turn
        found.append(T)
    return found


def _manipulability(frames: list[Array], tool: Array) -> Array:
    """(K,) product of the singular values of the Jacobian of the tool, turns in metres per reach: Yoshikawa 1985."""
    columns = []
    for T in frames:
        axis = T[:, :3, 2]
        columns.append(np.concatenate([np.cross(axis, tool[:, :3, 3] - T[:, :3, 3]), 0.3 * axis], axis=1))
    J = np.stack(columns, axis=2)
    return np.asarray(np.linalg.svd(J, compute_uv=False).prod(axis=1))


def _scale(chain: Chain, T_tool: Array, rows: Array) -> tuple[float, float]:
    """Greatest distance of the tool from the shoulder, m, and greatest manipulability, of what was sampled."""
    frames = _frames(chain, rows)
    tool = frames[-1] @ T_tool
    distances = np.linalg.norm(tool[:, :3, 3] - frames[0][:, :3, 3], axis=1)
    return float(distances.max()), float(_manipulability(frames, tool).max())


def _costs(chain: Chain, T_tool: Array, rows: Array, reach: float, best: float) -> Array:
    frames = _frames(chain, rows)
    tool = frames[-1] @ T_tool
    wanted = np.array([OUT * reach, 0.0, UP * reach])
    away = np.linalg.norm(tool[:, :3, 3] - wanted, axis=1) / reach
    tilt = 1.0 + tool[:, 2, 2]  # 0 where the approach direction is straight down
    middle = 0.5 * (chain.lower + chain.upper)
    half = np.minimum(0.5 * (chain.upper - chain.lower), np.pi)
    off = (np.abs(rows - middle) / half) ** 4
    share = np.maximum(_manipulability(frames, tool) / best, 1e-9)
    below = np.minimum(*[T[:, 2, 3] for T in (tool, frames[-1])]) < 0.05 * reach  # nothing dives under the base
    return np.asarray(
        2 * away
        + 4 * tilt
        + 0.3 * off.sum(axis=1)
        - 0.3 * np.log(share)
        + 10 * (share < LEAST_MANIPULABILITY)
        + 10 * below
    )


def least_gap(bodies: Sequence[Body], chain: Chain, q: Array) -> float:
    """Least distance of the convex hulls, m, of bodies with a joint between them that are no neighbours in a row."""
    hulls = body_hulls(bodies)
    always = always_touching(hulls, chain.T_joint, chain.lower, chain.upper)
    scratch, least = np.zeros((5, 3)), np.inf
    for i, first in enumerate(bodies):
        for j in range(i + 1, len(bodies)):
            second = bodies[j]
            between = second.frame - first.frame
            if between == 0 or (between == 1 and first.in_line and second.in_line) or always[i, j]:
                continue
            T = relative_pose(chain.T_joint, first.frame, second.frame, q[first.frame : second.frame])
            R, p = np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3])
            least = min(least, separation(hulls[i].corners, hulls[j].corners, R, p, LEAST_GAP, LEAST_GAP, scratch))
    return float(least)
