"""Axes along which a surface is drawn: those of its cylinders and profiles, as exact as its triangles are.

All walls along such an axis are at right angles to it, so it is the direction in which their normals reach least.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from takeapart.model.geometry import Array, TriangleMesh, area_normals

WINDOWS = np.sin(np.radians([3.0, 0.5, 0.1]))  # about an axis as guessed, then as found: what counts as its walls
LEAST_SHARE = 0.05  # of a surface, of the walls along an axis
TWO_WAYS = 0.02  # least share of the walls' normals across those that most of them have
NEARLY = np.cos(np.radians(3.0))  # of axes that are one


def drawn_axes(mesh: TriangleMesh, guesses: Sequence[Array]) -> tuple[Array, ...]:
    """Unit vectors (3,) along which a notable part of a surface is drawn, near guesses and the main axes of all its
    normals."""
    corners = mesh.corners
    crosses = area_normals(corners)
    areas = np.linalg.norm(crosses, axis=1)
    real = areas > 1e-16
    normals, areas = crosses[real] / areas[real, None], areas[real]
    found: list[Array] = []
    _, main = np.linalg.eigh((normals * areas[:, None]).T @ normals)
    for guess in (*guesses, *main.T):
        if any(abs(float(guess @ other)) > NEARLY for other in found):
            continue
        axis, walls, weights = guess, normals, areas
        for window in WINDOWS:
            near = np.abs(walls @ axis) < window
            walls, weights = walls[near], weights[near]
            better = _at_right_angles(walls, weights) if weights.sum() > LEAST_SHARE * areas.sum() else None
            if better is None:
                break
            axis = better
        else:
            found.append(axis)
    return tuple(found)


def _at_right_angles(walls: Array, areas: Array) -> Array | None:
    """The axis at right angles to walls with normals (N, 3); None where all of them face the same two ways."""
    values, vectors = np.linalg.eigh((walls * areas[:, None]).T @ walls)
    return None if values[1] < TWO_WAYS * values[2] else np.asarray(vectors[:, 0])
