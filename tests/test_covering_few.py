"""Hulls with few corners contain those with many."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from takeapart.robot.covering import MOST_CORNERS, around_with_fewer_corners


@pytest.mark.parametrize("shape", ["ball", "capsule", "noise", "plate"])
def test_a_hull_with_fewer_corners_contains_the_other_and_is_close_to_it(shape: str) -> None:
    rng = np.random.default_rng(1)
    corners = {
        "ball": lambda: np.asarray(trimesh.creation.icosphere(subdivisions=4, radius=0.06).vertices),
        "capsule": lambda: np.asarray(trimesh.creation.capsule(height=0.4, radius=0.06, count=[40, 40]).vertices),
        "noise": lambda: rng.normal(size=(4000, 3)) * [0.05, 0.1, 0.03],
        "plate": lambda: np.asarray(trimesh.creation.cylinder(radius=0.1, height=0.01, sections=400).vertices),
    }[shape]()
    hull = ConvexHull(corners)
    few = around_with_fewer_corners(corners[hull.vertices], MOST_CORNERS)
    assert len(few) <= MOST_CORNERS < len(hull.vertices) or shape == "noise"
    around = ConvexHull(few)
    outside = corners @ around.equations[:, :3].T + around.equations[:, 3]
    assert outside.max() <= 1e-9, "every corner is inside of every face"
    further = few @ hull.equations[:, :3].T + hull.equations[:, 3]
    assert further.max() < 0.06 * np.ptp(corners, axis=0).max()
    assert around.volume < 1.06 * hull.volume
