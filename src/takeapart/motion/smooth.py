"""Shortening of the tool path (Eq. 2): straight shortcuts for the tool, then local descent of its corners."""

from __future__ import annotations

import math

import numpy as np

from takeapart.compilation import compiled
from takeapart.motion.edges import (
    MAXIMUM_ROWS,
    Scene,
    motion_bound,
    project_to_point,
    tool_edge,
    tool_positions,
)
from takeapart.motion.rrt import next_random
from takeapart.robot.arrays import Floats


@compiled
def dense(scene: Scene, path: Floats, step: float) -> Floats:
    """Rows of a joint path (M, n) spaced so that nothing moves more than `step`, m, from row to row."""
    rows = np.empty((MAXIMUM_ROWS, path.shape[1]))
    rows[0] = path[0]
    total = 1
    for k in range(1, len(path)):
        count = max(1, math.ceil(motion_bound(scene, path[k - 1], path[k]) / step))
        for i in range(1, count + 1):
            if total == MAXIMUM_ROWS:
                return np.empty((0, path.shape[1]))
            for j in range(path.shape[1]):
                rows[total, j] = path[k - 1, j] + (path[k, j] - path[k - 1, j]) * i / count
            total += 1
    return rows[:total].copy()


@compiled
def shorten(
    scene: Scene,
    path: Floats,
    iterations: int,
    spacing: float,
    step: float,
    shorter_than: float,
    patience: int,
    seed: int,
) -> Floats:
    """A joint path with a shorter tool path and the same ends.

    Two moves, drawn at random: a *shortcut* replaces the rows between two others by a tool-straight edge; a *pull*
    moves the row between them towards the chord and joins it to both by tool-straight edges, so that a corner that no
    shortcut can cut is pulled tight against what it bends around.

    Args:
        path: (M, n) dense rows, rad.
        iterations: moves to try at most.
        spacing, step: of the new edges, see `tool_edge`.
        shorter_than: give up early when the path seems unable to become shorter than this, m.
        patience: stop after this many moves without a gain.
        seed: of this call's own random numbers.

    Returns:
        (M, n) rows.
    """
    n = path.shape[1]
    state = np.array([seed], dtype=np.uint64)
    rows = path.copy()
    points = np.empty((MAXIMUM_ROWS, 3))
    along = np.empty(MAXIMUM_ROWS)
    first, second = np.empty((MAXIMUM_ROWS, n)), np.empty((MAXIMUM_ROWS, n))
    via = np.empty(n)
    length = tool_positions(scene, rows, len(rows), points)
    straight = math.sqrt(np.sum((points[len(rows) - 1] - points[0]) ** 2))
    failures = 0
    for move in range(iterations):
        if failures >= patience or length - straight < 1e-4:
            break
        if move % 32 == 31 and length - straight > 3.0 * max(shorter_than - straight, 0.0):
            break  # hopeless: still three times as far above the straight line as the best known is
        total = len(rows)
        along[0] = 0.0
        for k in range(1, total):
            along[k] = along[k - 1] + math.sqrt(np.sum((points[k] - points[k - 1]) ** 2))
        u, v = next_random(state) * length, next_random(state) * length
        if move < 3:  # the longest shortcuts first
            u, v = 0.0, length * (1.0, 0.75, 0.5)[move]
        i = int(np.searchsorted(along[:total], min(u, v), side="right")) - 1
        k = min(int(np.searchsorted(along[:total], max(u, v))), total - 1)
        if k - i < 2:
            failures += 1
            continue
        chord = math.sqrt(np.sum((points[k] - points[i]) ** 2))
        now = along[k] - along[i]
        if now - chord < 1e-5:
            failures += 1
            continue
        done = False
        if move % 2 == 0 or move < 3:
            count = tool_edge(scene, rows[i], rows[k], spacing, step, first)
            if count > 0 and total - (k - i) + count < MAXIMUM_ROWS:
                rows = _spliced(rows, i, k, first, count, first, 0)
                done = True
        else:
            m = i + 1 + int(next_random(state) * (k - i - 1))
            # Towards the foot of the perpendicular on the chord.
            share = 0.0
            for c in range(3):
                share += (points[m, c] - points[i, c]) * (points[k, c] - points[i, c])
            share = min(max(share / max(chord * chord, 1e-12), 0.0), 1.0)
            pull = 0.15 + 0.85 * next_random(state)
            target = points[m] + pull * (points[i] + share * (points[k] - points[i]) - points[m])
            expected = math.sqrt(np.sum((target - points[i]) ** 2)) + math.sqrt(np.sum((points[k] - target) ** 2))
            if expected < now - 1e-5:
                via[:] = rows[m]
                if project_to_point(scene, via, target[0], target[1], target[2]):
                    count = tool_edge(scene, rows[i], via, spacing, step, first)
                    if count > 0:
                        more = tool_edge(scene, via, rows[k], spacing, step, second)
                        if more > 0 and total - (k - i) + count + more < MAXIMUM_ROWS:
                            rows = _spliced(rows, i, k, first, count, second, more)
                            done = True
        if done:
            before = length
            length = tool_positions(scene, rows, len(rows), points)
            failures = 0 if before - length > 2e-4 else failures + 1
        else:
            failures += 1
    return rows


@compiled
def _spliced(rows: Floats, i: int, k: int, first: Floats, count: int, second: Floats, more: int) -> Floats:
    """Rows up to i, then the new ones (they end at row k), then what follows k."""
    total = i + 1 + count + more + len(rows) - k - 1
    joined = np.empty((total, rows.shape[1]))
    joined[: i + 1] = rows[: i + 1]
    joined[i + 1 : i + 1 + count] = first[:count]
    joined[i + 1 + count : i + 1 + count + more] = second[:more]
    joined[i + 1 + count + more :] = rows[k + 1 :]
    return joined
