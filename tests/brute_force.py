"""Distances around an arm, of everything from everything: no grid, no kernels, no bounds on motions.

The same hulls and boxes as the planner's, placed by kinematics of their own. Where the spheres around a hull are far
from something, theirs stand for it: the spheres contain the hull, so that is never more than the distance.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import nnls

from takeapart.model.geometry import Array, OrientedBox
from takeapart.robot.arrays import ArmArrays, HeldArrays


def _square(pose: Array) -> Array:
    return np.vstack([pose, [0.0, 0.0, 0.0, 1.0]])


def frames(arm: ArmArrays, rows: Array) -> Array:
    """Poses (Q, n + 2, 4, 4) of base, links and tool at configurations (Q, n), rad."""
    poses = [np.repeat(_square(arm.T_world_base)[None], len(rows), axis=0)]
    for k in range(rows.shape[1]):
        turn = np.zeros((len(rows), 4, 4))
        c, s = np.cos(rows[:, k]), np.sin(rows[:, k])
        turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1] = c, -s, s, c
        turn[:, 2, 2] = turn[:, 3, 3] = 1.0
        poses.append(poses[-1] @ _square(arm.T_joint[k]) @ turn)
    poses.append(poses[-1] @ _square(arm.T_tool))
    return np.stack(poses, axis=1)


def spheres(arm: ArmArrays, poses: Array, body: int) -> tuple[Array, Array]:
    """Centres (Q, S, 3) and radii (S,), m, of the spheres of a body."""
    some = slice(int(arm.body_start[body]), int(arm.body_start[body + 1]))
    T = poses[:, int(arm.body_frame[body])]
    return arm.sphere_center[some] @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3], arm.sphere_radius[some]


SUM_WEIGHT = 1e3
NEAR = 0.01  # m; hulls whose spheres are farther apart need no distance of their own


def corners(arm: ArmArrays, poses: Array, body: int) -> Array:
    """Corners (Q, V, 3), m, of the hull of a body."""
    some = slice(int(arm.corner_start[body]), int(arm.corner_start[body + 1]))
    T = poses[:, int(arm.body_frame[body])]
    return np.asarray(arm.corner[some] @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3])


def hull_distance(first: Array, second: Array) -> float:
    """Distance of the hulls of corners (V, 3) and (W, 3), m; 0 where they touch.

    Their nearest points as weighted means of the corners: least squares with weights that are not negative (Lawson and
    Hanson 1974) and add up to one for each hull.
    """
    sums = np.zeros((2, len(first) + len(second)))
    sums[0, : len(first)] = sums[1, len(first) :] = SUM_WEIGHT
    middle = (first.mean(axis=0) + second.mean(axis=0)) / 2
    A = np.vstack([np.hstack([(first - middle).T, (middle - second).T]), sums])
    weights, _ = nnls(A, np.array([0.0, 0.0, 0.0, SUM_WEIGHT, SUM_WEIGHT]), maxiter=10_000)
    a, b = weights[: len(first)], weights[len(first) :]
    distance = float(np.linalg.norm(a @ first / a.sum() - b @ second / b.sum()))
    return distance if distance > 1e-9 else 0.0


def _nearer(gaps: Array, near: float, exact: Callable[[int], float]) -> Array:
    """(Q,) m, gaps of spheres, of which those that are near are replaced by what is exact."""
    return np.array([exact(q) if gap < near else gap for q, gap in enumerate(gaps.tolist())])


def load_boxes(held: HeldArrays, poses: Array, first: int = 0) -> tuple[Array, Array]:
    """Poses (Q, H, 4, 4) and half sizes (H, 3), m, of what the gripper carries, from box `first` on."""
    local = np.repeat(np.eye(4)[None], len(held.half) - first, axis=0)
    local[:, :3, :3] = np.swapaxes(held.axes[first:], 1, 2)
    local[:, :3, 3] = held.center[first:]
    return poses[:, -1, None] @ local[None], held.half[first:]


def gap_between_bodies(arm: ArmArrays, poses: Array, a: int, b: int, near: float = NEAR) -> Array:
    """(Q,) m, distance of two bodies, 0 where they touch."""
    (ca, ra), (cb, rb) = spheres(arm, poses, a), spheres(arm, poses, b)
    apart = np.linalg.norm(ca[:, :, None] - cb[:, None], axis=3)
    first, second = corners(arm, poses, a), corners(arm, poses, b)
    return _nearer(
        (apart - ra[:, None] - rb).min(axis=(1, 2)),
        near,
        lambda q: hull_distance(first[q], second[q]),
    )


def gap_of_points(points: Array, radii: Array, T: Array, half: Array) -> Array:
    """Distance (..., S), m, of balls (..., S, 3) with radii (S,) from a box at poses (..., 4, 4); negative inside."""
    local = np.einsum("...ij,...si->...sj", T[..., :3, :3], points - T[..., None, :3, 3])
    outside = np.abs(local) - half
    away = np.linalg.norm(np.maximum(outside, 0.0), axis=-1)
    return np.asarray(away + np.minimum(outside.max(axis=-1), 0.0) - radii)


def gap_to_box(arm: ArmArrays, poses: Array, body: int, T: Array, half: Array, near: float = NEAR) -> Array:
    """(Q,) m, distance of a body from a box at poses (Q, 4, 4), 0 where they touch."""
    own = corners(arm, poses, body)
    return _nearer(
        gap_of_points(*spheres(arm, poses, body), T, half).min(axis=1),
        near,
        lambda q: hull_distance(own[q], OrientedBox(T[q], half).corners()),
    )


def gap_to_load(arm: ArmArrays, held: HeldArrays, poses: Array, body: int, first: int = 0) -> Array:
    """(Q,) m, distance of a body from the boxes of the load, from box `first` on."""
    T, half = load_boxes(held, poses, first)
    return np.asarray(np.min([gap_to_box(arm, poses, body, T[:, h], half[h]) for h in range(len(half))], axis=0))


def box_gaps(T: Array, half: Array, other: OrientedBox, turns: int = 120) -> Array:
    """Distances (K,), m, of boxes at poses (K, 4, 4) with half sizes (K, 3) from another box.

    The nearest points by accelerated projected gradients over the points of both (Beck and Teboulle 2009): never less
    than the distance.
    """
    R, center = other.T_frame_box[:3, :3], other.T_frame_box[:3, 3]
    A = np.concatenate([T[:, :3, :3], np.repeat(-R[None], len(T), 0)], axis=2)
    offset = center - T[:, :3, 3]
    bound = np.concatenate([half, np.repeat(other.half_extents[None], len(T), 0)], axis=1)
    x = np.zeros((len(T), 6))
    y, t = x.copy(), 1.0
    for _ in range(turns):  # the gradient's Lipschitz constant is 2: both halves of A are rotations
        step = y - 0.5 * np.einsum("kij,ki->kj", A, np.einsum("kij,kj->ki", A, y) - offset)
        new = np.clip(step, -bound, bound)
        faster = (1.0 + (1.0 + 4.0 * t * t) ** 0.5) / 2.0
        y, x, t = new + (t - 1.0) / faster * (new - x), new, faster
    return np.asarray(np.linalg.norm(np.einsum("kij,kj->ki", A, x) - offset, axis=1))


def self_gap(arm: ArmArrays, held: HeldArrays, rows: Array) -> Array:
    """(Q,) m, least distance of all bodies, fingers and part of those that may meet and have no table."""
    poses = frames(arm, rows)
    gaps = [gap_between_bodies(arm, poses, int(a), int(b)) for a, b in arm.self_pairs]
    gaps += [gap_to_load(arm, held, poses, int(b)) for b in arm.held_bodies]
    return np.asarray(np.min(gaps, axis=0))


def world_gap(arm: ArmArrays, held: HeldArrays, boxes: list[OrientedBox], rows: Array) -> Array:
    """(Q, W) m, distance of everything that moves from boxes that stand still; the base may touch them."""
    poses = frames(arm, rows)
    T, half = load_boxes(held, poses)
    found = np.empty((len(rows), len(boxes)))
    for w, box in enumerate(boxes):
        standing = np.repeat(box.T_frame_box[None], len(rows), 0)
        gaps = [gap_to_box(arm, poses, b, standing, box.half_extents) for b in range(1, len(arm.body_frame))]
        loads = box_gaps(T.reshape(-1, 4, 4), np.tile(half, (len(rows), 1)), box)
        gaps.append(loads.reshape(len(rows), -1).min(axis=1))
        found[:, w] = np.min(gaps, axis=0)
    return found
