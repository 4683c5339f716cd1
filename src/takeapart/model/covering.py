"""Boxes around meshes: one that holds the whole, and a few that together follow its form."""

from __future__ import annotations

import numpy as np

from takeapart.model.geometry import Array, OrientedBox, TriangleMesh


def tight_box(vertices: Array) -> OrientedBox:
    """A small oriented box that holds all points (V, 3), m."""
    import trimesh

    T_box_frame, size = trimesh.bounds.oriented_bounds(vertices)
    return OrientedBox(np.linalg.inv(T_box_frame), np.asarray(size) / 2)


def box_cover(mesh: TriangleMesh) -> tuple[OrientedBox, ...]:
    """Boxes whose union holds the body inside the mesh."""
    return (tight_box(mesh.vertices),)
