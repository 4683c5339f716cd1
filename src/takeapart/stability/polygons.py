"""Many convex polygons in space at once, cut by planes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from takeapart.model.geometry import Array


@dataclass(frozen=True, eq=False)
class Polygons:
    """Args:
    points: (N, M, 3) m, the corners in order; of the last ones, only as many count as `sizes` says.
    sizes: (N,) numbers of corners; 0: nothing is left.
    """

    points: Array
    sizes: NDArray[np.int64]

    @property
    def present(self) -> NDArray[np.bool_]:
        """(N, M): which corners count."""
        return np.asarray(np.arange(self.points.shape[1]) < self.sizes[:, None])

    def of(self, rows: NDArray[np.bool_]) -> Polygons:
        """Those of some rows (N,)."""
        return Polygons(self.points[rows], self.sizes[rows])

    def cut(self, inside: Array) -> Polygons:
        """What is left where a linear function, given at the corners (N, M), is not below 0.

        Sutherland and Hodgman: Reentrant polygon clipping, 1974.
        """
        N, M, _ = self.points.shape
        present = self.present
        following = np.where(np.arange(M) + 1 < self.sizes[:, None], np.arange(M) + 1, 0)
        rows = np.arange(N)[:, None]
        after, points_after = inside[rows, following], self.points[rows, following]
        kept = present & (inside >= 0)
        crossing = present & ((inside >= 0) != (after >= 0))
        share = np.where(crossing, inside / np.where(crossing, inside - after, 1.0), 0.0)
        between = self.points + share[..., None] * (points_after - self.points)
        points = np.stack([self.points, between], axis=2).reshape(N, 2 * M, 3)
        valid = np.stack([kept, crossing], axis=2).reshape(N, 2 * M)
        order = np.argsort(~valid, axis=1, kind="stable")[:, : M + 1]
        return Polygons(points[rows, order], np.minimum(valid.sum(axis=1), M + 1))
