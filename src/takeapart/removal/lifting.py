"""Straight up: which parts are in the way of a part that is lifted (the first stage of Sec. IV-B)."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Array, OrientedBox, box_separation
from takeapart.removal.exits import Exit
from takeapart.stability.contact import distances

CONTACT_TOLERANCE = 1e-4  # m; what touches at the start may overlap by this much, as in `Assembly`
ROUNDING = 1e-9  # m
HEIGHT_STEP = 1e-9  # m, to which the height of a contact is found
KEPT = 2000  # boxes of which it is kept what they meet

# What a box meets, by all that decides it: a product is asked about again where a refusal is explained.
_met: dict[tuple[object, ...], tuple[int, ...]] = {}


def swept_up_separation(box: OrientedBox, height: float, T: Array, half: Array) -> Array:
    """Signed separation (W,), m, between a box swept straight up by `height` and boxes at poses T (W, 4, 4).

    The swept box is convex: the Minkowski sum of the box and a vertical segment. The separating axis test is complete
    with the face normals of both, and the cross products of their edges; the segment adds the vertical edge.
    """
    R = box.T_frame_box[:3, :3]
    up = np.array([0.0, 0.0, 1.0])
    edges = np.column_stack([R, up]).T  # (4, 3) edge directions of the swept box
    normals = np.concatenate([R.T, np.cross(up, R.T)])  # its face normals
    others = np.swapaxes(T[:, :3, :3], 1, 2)  # (W, 3, 3), rows are axes
    crosses = np.cross(edges[None, :, None, :], others[:, None, :, :]).reshape(len(T), 12, 3)
    axes = np.concatenate([np.repeat(normals[None], len(T), 0), others, crosses], axis=1)
    norms = np.linalg.norm(axes, axis=2, keepdims=True)
    axes = np.where(norms < 1e-6, R[:, 0], axes / np.where(norms < 1e-6, 1.0, norms))
    center = box.T_frame_box[:3, 3] + up * height / 2
    gap = np.abs(np.einsum("wij,wj->wi", axes, T[:, :3, 3] - center))
    reach = np.abs(axes @ R) @ box.half_extents + np.abs(axes[:, :, 2]) * height / 2
    reach_other = np.einsum("wik,wk->wi", np.abs(axes @ T[:, :3, :3]), half)
    return np.asarray((gap - reach - reach_other).max(axis=1))


def contact_height(box: OrientedBox, height: float, other: OrientedBox) -> float:
    """By how much, m, a box can be lifted until it cuts into another that is in the way of the lift; the full height if
    the other is not: what only slides along it. What is swept only grows, so halving finds it."""
    T, half = other.T_frame_box[None], other.half_extents[None]

    def separation(lifted: float) -> float:
        return float(swept_up_separation(box, lifted, T, half)[0])

    if separation(height) >= -CONTACT_TOLERANCE:
        return height
    low, high = 0.0, height
    while high - low > HEIGHT_STEP:
        middle = (low + high) / 2
        low, high = (low, middle) if separation(middle) < -ROUNDING else (middle, high)
    return (low + high) / 2


def lift_distance(body: Sequence[OrientedBox], height: float, others: Sequence[OrientedBox]) -> float:
    """How near a body that is lifted comes to another, m: a lower bound, 0 where they meet."""
    T = np.array([other.T_frame_box for other in others])
    half = np.array([other.half_extents for other in others])
    return max(0.0, min(float(swept_up_separation(box, height, T, half).min()) for box in body))


def passes_too_close(box: OrientedBox, height: float, passing: float, T: Array, half: Array) -> NDArray[np.bool_]:
    """Which of W boxes (W,) at poses T (W, 4, 4) a box that is swept straight up comes too close to: nearer than
    `passing`, m, to those that are further away at the start; those it may slide along it must not cut into.
    """
    separation = swept_up_separation(box, height, T, half)
    near = separation < passing - ROUNDING
    doubtful = np.flatnonzero(near & (separation >= -CONTACT_TOLERANCE))
    if len(doubtful):
        T_box = np.repeat(box.T_frame_box[None], len(doubtful), axis=0)
        sizes = np.repeat(box.half_extents[None], len(doubtful), axis=0)
        near[doubtful] = distances(T_box, sizes, T[doubtful], half[doubtful]) > passing
    return near


def _meets(box: OrientedBox, height: float, clearance: float, passing: float, T: Array, half: Array) -> NDArray[Any]:
    """Which of W boxes (W,) a lifted box meets on its way, or at the end."""
    T_lifted = np.repeat(box.T_frame_box[None], len(T), axis=0)
    T_lifted[:, 2, 3] += height
    ends = box_separation(T_lifted, np.repeat(box.half_extents[None], len(T), axis=0), T, half) < clearance
    return np.asarray(ends | passes_too_close(box, height, passing, T, half))


def lift_blockers(
    assembly: Assembly,
    height: float,
    clearance: float,
    obstacles: tuple[OrientedBox, ...],
    passing: float = -CONTACT_TOLERANCE,
) -> list[int | None]:
    """Per part the state of the parts it would hit when lifted; None if it would hit something that never leaves.

    Args:
        height: m.
        clearance: kept at the end of the lift, m.
        obstacles: boxes of the environment, world frame.
        passing: kept on the way from all boxes that are further away at the start, m; the part may slide along others.
            By default it may slide along all, and cut into none.
    """
    owners, boxes = [], []
    for i, part in enumerate(assembly.parts):
        for box in assembly.body(i):
            owners.append(i)
            boxes.append(box.moved(part.T_world_part))
    bodies = list(boxes)
    boxes += obstacles
    owners += [-1] * len(obstacles)
    owner = np.array(owners)
    T = np.array([box.T_frame_box for box in boxes])
    half = np.array([box.half_extents for box in boxes])
    stamp = hashlib.sha256(T.tobytes() + half.tobytes()).digest()
    found: list[int | None] = []
    for i, part in enumerate(assembly.parts):
        hit: set[int] = set()
        others = np.nonzero(owner != i)[0]
        for number in range(len(bodies)):
            if owner[number] == i:
                key = (stamp, number, others.tobytes(), height, clearance, passing)
                if key not in _met:
                    if len(_met) >= KEPT:
                        _met.clear()
                    rows = _meets(boxes[number], height, clearance, passing, T[others], half[others])
                    _met[key] = tuple(others[rows].tolist())
                hit.update(owner[list(_met[key])].tolist())
        permanent = part.fixed or any(k < 0 or assembly.parts[k].fixed for k in hit)
        found.append(None if permanent else sum(1 << k for k in hit))
    return found


class Lifts:
    """The one exit of the paper (Sec. IV-B): straight up, by a given height.

    Args: as of `lift_blockers`.
    """

    def __init__(
        self,
        assembly: Assembly,
        height: float,
        clearance: float,
        obstacles: tuple[OrientedBox, ...],
        passing: float = -CONTACT_TOLERANCE,
    ) -> None:
        masks = lift_blockers(assembly, height, clearance, obstacles, passing)
        self._exits = [_lift(part.T_world_part, height, mask) for part, mask in zip(assembly.parts, masks, strict=True)]

    def exits(self, part: int) -> tuple[Exit, ...]:
        """The lift; with or without anything in its way."""
        return (self._exits[part],)


def _lift(T_world_part: Array, height: float, blockers: int | None) -> Exit:
    up = np.array([0.0, 0.0, 1.0])
    poses = np.repeat(T_world_part[None], 2, axis=0)
    poses[1, 2, 3] += height
    return Exit("straight", poses, blockers, up)
