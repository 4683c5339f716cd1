"""Where the pads of a gripper really are: measured on the geometry of the finger links, along the closing direction.

A description says at which opening its joints stand where, and where the tool frame is. Neither is believed: from the
tool point, the nearest surface on either side along the closing direction must be half the opening away.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import ConvexHull

from takeapart.model.geometry import Array
from takeapart.verification.robot import mujoco


@dataclass(frozen=True)
class PadMeasure:
    """What is met first from the tool point in one direction.

    Args:
        distance: m; negative where the point is inside; infinite where nothing is met.
        tilt: rad, by which the surface there is off the square to the direction.
    """

    distance: float
    tilt: float


NOTHING = PadMeasure(math.inf, 0.0)


def pad_measure(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: Sequence[int], point: Array, direction: Array
) -> PadMeasure:
    """The nearest surface of geoms, meshes by their convex hulls, from a point (3,), m, along a unit vector (3,), both
    in the world."""
    found = [_first_surface(model, data, geom, point, direction) for geom in geoms]
    return min(found, key=lambda each: each.distance, default=NOTHING)


def _first_surface(model: mujoco.MjModel, data: mujoco.MjData, geom: int, point: Array, direction: Array) -> PadMeasure:
    R = data.geom_xmat[geom].reshape(3, 3)
    p, d = R.T @ (point - data.geom_xpos[geom]), R.T @ direction
    kind = int(model.geom_type[geom])
    if kind == int(mujoco.mjtGeom.mjGEOM_MESH):
        first, count = (int(table[model.geom_dataid[geom]]) for table in (model.mesh_vertadr, model.mesh_vertnum))
        planes = _planes(np.asarray(model.mesh_vert[first : first + count], dtype=float).tobytes())
    elif kind == int(mujoco.mjtGeom.mjGEOM_BOX):
        planes = np.column_stack([np.vstack([np.eye(3), -np.eye(3)]), -np.tile(model.geom_size[geom], 2)])
    else:  # spheres, cylinders, capsules: MuJoCo's own formulas
        normal = np.zeros(3)
        distance = mujoco.mju_rayGeom(np.zeros(3), np.eye(3).ravel(), model.geom_size[geom], p, d, kind, normal=normal)
        return NOTHING if distance < 0 else PadMeasure(float(distance), _tilt(float(-normal @ d)))
    slope, height = planes[:, :3] @ d, planes[:, :3] @ p + planes[:, 3]  # inside: height + t * slope <= 0 for all
    if (height[np.abs(slope) < 1e-12] > 0).any():
        return NOTHING
    entering, leaving = np.nonzero(slope <= -1e-12)[0], np.nonzero(slope >= 1e-12)[0]
    enters, leaves = -height[entering] / slope[entering], -height[leaving] / slope[leaving]
    if enters.max() > leaves.min() or leaves.min() < 0:
        return NOTHING
    return PadMeasure(float(enters.max()), _tilt(float(-slope[entering[np.argmax(enters)]])))


def _tilt(cosine: float) -> float:
    return math.acos(min(max(cosine, -1.0), 1.0))


@lru_cache(maxsize=64)
def _planes(vertices: bytes) -> Array:
    """Outward normals and offsets (F, 4) of the facets of the hull of vertices (V, 3), float64."""
    planes: Array = ConvexHull(np.frombuffer(vertices).reshape(-1, 3)).equations
    return planes
