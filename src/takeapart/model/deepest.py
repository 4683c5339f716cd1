"""How deep a surface reaches into a body, to the micrometre, for whatever tells depths of points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from takeapart.model.geometry import Array

CLOSE_ENOUGH = 2e-6  # m
MOST_PIECES = 4_000  # that are looked at in one round; where more may be the deepest, they are as deep as one another


def greatest_depth(corners: Array, depths: Callable[[Array, Array], Array], most: int = MOST_PIECES) -> float:
    """Depth of the deepest place of some triangles, m; 0 where none is inside.

    No place is deeper than another one by more than the way between them: triangles that cannot hold a deeper place
    than the deepest one known are left out, the others are cut in four.

    Args:
        corners: (N, 3, 3) m, of the triangles.
        depths: of points (N, 3), m, negative outside; of a point that is no deeper than its value in the second
            argument (N,), m, anything up to that will do.
        most: triangles that are cut in one round.
    """
    points = np.unique(corners.reshape(-1, 3), axis=0)
    best = float(depths(points, np.zeros(len(points))).max(initial=0.0))
    while len(corners):
        middle = corners.mean(axis=1)
        radius = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
        found = depths(middle, best - radius)
        best = max(best, float(found.max()))
        open_ = np.nonzero(found + radius > best + CLOSE_ENOUGH)[0]
        deepest = open_[np.argsort(-(found + radius)[open_], kind="stable")[:most]]
        corners = _in_four(corners[deepest])
    return best


def _in_four(corners: Array) -> Array:
    """Triangles (4 N, 3, 3) between the corners of triangles (N, 3, 3) and the middles of their edges."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    d, e, f = (a + b) / 2, (b + c) / 2, (c + a) / 2
    return np.concatenate([np.stack(each, axis=1) for each in ((a, d, f), (d, b, e), (f, e, c), (d, e, f))])
