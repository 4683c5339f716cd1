"""How deep one part is drawn in another, to the micrometre: for words.

Planning goes by points 2 mm apart, which may all lie beside the deepest place.
"""

from __future__ import annotations

import numpy as np

from takeapart.collision.fields import FIELD_ERROR, Field, signed_distances
from takeapart.collision.triangles import TriangleTree, distances
from takeapart.model.deepest import greatest_depth
from takeapart.model.geometry import Array, TriangleMesh

FURTHEST = 1.0  # m; nothing is deeper in anything


def depth_in(field: Field, tree: TriangleTree, surface: TriangleMesh) -> float:
    """How far a surface reaches into a body, m; 0 where it does not.

    Args:
        field, tree: of the body.
        surface: in the body's frame.
    """
    error = 2 * FIELD_ERROR * field.step

    def depths(points: Array, least: Array) -> Array:
        points = np.ascontiguousarray(points)
        signed = signed_distances(field, points)
        if field.step == 0.0:  # of a box: exact
            return -signed
        # Beyond its band a field knows only the side.
        asked = np.nonzero((-signed + error > least) | (signed < -0.99 * field.band))[0]
        found = np.minimum(-signed, least)
        away = distances(np.ascontiguousarray(points[asked]), tree, FURTHEST)
        found[asked] = -np.sign(signed[asked]) * away
        return found

    return greatest_depth(surface.corners.astype(float), depths)
