"""Distances of boxes by a method that knows no corner, edge or axis."""

from __future__ import annotations

import numpy as np
from scipy.optimize import lsq_linear

from takeapart.model.geometry import OrientedBox


def box_distance(a: OrientedBox, b: OrientedBox, padding: float = 0.0) -> float:
    """Distance of two boxes, the first one grown on every side, m: least squares over the points of both; 0 where they
    overlap."""
    A = np.column_stack([a.T_frame_box[:3, :3], -b.T_frame_box[:3, :3]])
    offset = b.T_frame_box[:3, 3] - a.T_frame_box[:3, 3]
    bound = np.concatenate([a.half_extents + padding, b.half_extents])
    solution = lsq_linear(A, offset, (-bound, bound), method="bvls", tol=1e-14)
    return float(np.linalg.norm(A @ solution.x - offset))
