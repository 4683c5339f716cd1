"""Shortening of the tool path (Eq. 2): straight shortcuts for the tool, then local descent of its corners."""

from __future__ import annotations

import math

import numpy as np

from takeapart.compilation import compiled, compiled_lean
from takeapart.motion.edges import MAXIMUM_ROWS, project_to_point, tool_edge, tool_positions
from takeapart.motion.rrt import next_random
from takeapart.motion.scene import Scene, is_free
from takeapart.robot.arrays import Floats
from takeapart.robot.grid import line_free


@compiled
def shorten(
    scene: Scene,
    path: Floats,
    radius: float,
    iterations: int,
    spacing: float,
    shorter_than: float,
    patience: int,
    seed: int,
) -> Floats:
    """A joint path with a shorter tool path and the same ends.

    Two moves, drawn at random: a *shortcut* replaces the rows between two others by a tool-straight edge; a *pull*
    moves the row between them towards the chord and joins it to both by tool-straight edges, so that a corner that no
    shortcut can cut is pulled tight against what it bends around.

    Args:
        path: (M, n) rows, rad; the motion from row to row is free.
        radius: of a ball around the tool that is always inside the held part, m: where it cannot pass, no edge can.
        iterations: moves to try at most.
        spacing: of the rows of the new edges, see `tool_edge`.
        shorter_than: give up early when the path seems unable to become shorter than this, m.
        patience: stop after this many moves without a gain.
        seed: of this call's own random numbers.

    Returns:
        (M, n) rows.
    """
    n = path.shape[1]
    state = np.array([seed], dtype=np.uint64)
    rows, points, along = np.empty((MAXIMUM_ROWS, n)), np.empty((MAXIMUM_ROWS, 3)), np.empty(MAXIMUM_ROWS)
    new, new_points = np.empty((MAXIMUM_ROWS, n)), np.empty((MAXIMUM_ROWS, 3))
    total = len(path)
    rows[:total] = path
    via, target = np.empty(n), np.empty(3)
    tool_positions(scene, rows, total, points)
    length = _measure(points, total, along)
    straight = math.sqrt(np.sum((points[total - 1] - points[0]) ** 2))
    failures = 0
    for move in range(iterations):
        if failures >= patience or length - straight < 1e-4:
            break
        if move % 32 == 31 and length - straight > 3.0 * max(shorter_than - straight, 0.0):
            break  # hopeless: still three times as far above the straight line as the best known is
        u, v = next_random(state) * length, next_random(state) * length
        if move < 3:  # the longest shortcuts first
            u, v = 0.0, length * (1.0, 0.75, 0.5)[move]
        i = int(np.searchsorted(along[:total], min(u, v), side="right")) - 1
        k = min(int(np.searchsorted(along[:total], max(u, v))), total - 1)
        failures += 1
        if k - i < 2:
            continue
        chord = math.sqrt(np.sum((points[k] - points[i]) ** 2))
        now = along[k] - along[i]
        if now - chord < 1e-5:
            continue
        if move % 2 == 0 or move < 3:
            count = 0
            if line_free(scene.world, scene.present, points[i], points[k], radius):
                count = tool_edge(scene, rows[i], rows[k], spacing, new)
        else:
            count = 0
            m = i + 1 + int(next_random(state) * (k - i - 1))
            # Towards the foot of the perpendicular on the chord.
            share = 0.0
            for c in range(3):
                share += (points[m, c] - points[i, c]) * (points[k, c] - points[i, c])
            share = min(max(share / max(chord * chord, 1e-12), 0.0), 1.0)
            pull = 0.15 + 0.85 * next_random(state)
            first, second = 0.0, 0.0
            for c in range(3):
                foot = points[i, c] + share * (points[k, c] - points[i, c])
                target[c] = points[m, c] + pull * (foot - points[m, c])
                first += (target[c] - points[i, c]) ** 2
                second += (target[c] - points[k, c]) ** 2
            if math.sqrt(first) + math.sqrt(second) >= now - 1e-5:
                continue
            if not line_free(scene.world, scene.present, points[i], target, radius):
                continue
            if not line_free(scene.world, scene.present, target, points[k], radius):
                continue
            via[:] = rows[m]
            if project_to_point(scene, via, target[0], target[1], target[2]) and is_free(scene, via):
                count = tool_edge(scene, rows[i], via, spacing, new)
                more = tool_edge(scene, via, rows[k], spacing, new[count:]) if count else 0
                count = count + more if more else 0
        if count == 0 or total - (k - i) + count > MAXIMUM_ROWS:
            continue
        tool_positions(scene, new, count, new_points)
        _splice(points, total, i, k, new_points, count)
        total = _splice(rows, total, i, k, new, count)
        before = length
        length = _measure(points, total, along)
        if before - length > 2e-4:
            failures = 0
    return rows[:total].copy()


@compiled_lean
def _splice(rows: Floats, total: int, i: int, k: int, new: Floats, count: int) -> int:
    """Puts `count` new rows in the place of rows i + 1 to k of the first `total`; returns how many there are then."""
    shift = count - (k - i)
    rest = total - k - 1
    for r in range(rest):  # from the end where they come towards it, so that none is lost
        source = total - 1 - r if shift > 0 else k + 1 + r
        for j in range(rows.shape[1]):
            rows[source + shift, j] = rows[source, j]
    for r in range(count):
        for j in range(rows.shape[1]):
            rows[i + 1 + r, j] = new[r, j]
    return total + shift


@compiled_lean
def _measure(points: Floats, total: int, along: Floats) -> float:
    """Length of the way through points (M, 3) up to each, m."""
    along[0] = 0.0
    for k in range(1, total):
        squared = 0.0
        for c in range(3):
            squared += (points[k, c] - points[k - 1, c]) ** 2
        along[k] = along[k - 1] + math.sqrt(squared)
    return float(along[total - 1])
