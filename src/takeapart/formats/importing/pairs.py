"""How near the parts of a product are to each other as drawn: gaps, contacts, overlaps.

Closed parts are met exactly by manifold3d; of open ones the distance of their corners to the other surface is known.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from takeapart.model.assembly import Part
from takeapart.model.deepest import greatest_depth
from takeapart.model.errors import MissingExtraError
from takeapart.model.geometry import Array
from takeapart.model.meshes import Mesh

NEAR = 5e-3  # m; pairs further apart than this are not looked at
SAMPLES = 5000  # places of a surface that are looked at
POINTS_APART = 5e-4  # m, on what two parts have in common
DEEPEST = 40  # triangles with the deepest of these points, which are looked at closely
FINE = 1e3  # millimetres in a metre: trimesh takes distances whose squares differ by 1e-8 for the same
SMALLEST_VOLUME = 1e-15  # m^3; less is rounding
SMALLEST_THICKNESS = 1e-6  # m, of an overlap: twice its volume over its area; less is contact


@dataclass(frozen=True)
class DrawnPair:
    """Two parts near each other.

    Args:
        first, second: numbers of the parts, first < second.
        gap: m; 0 where they touch or overlap.
        depth: m, how far the surface of one reaches into the other; nan where a part is open.
    """

    first: int
    second: int
    gap: float
    depth: float


class DrawnPairs:
    """Distances between the parts of a product, each body prepared once."""

    def __init__(self, parts: Sequence[Part]) -> None:
        try:
            import manifold3d
            import rtree  # noqa: F401  # trimesh finds what is near with it
        except ImportError as error:
            raise MissingExtraError("import", "cad", error.name or "manifold3d") from None
        self._manifold3d: Any = manifold3d
        self.surfaces = [part.shape.surface().moved(part.T_world_part) for part in parts]
        self.bounds = np.array([surface.bounds for surface in self.surfaces])  # (P, 2, 3) m
        self.closed = [not isinstance(part.shape, Mesh) or part.shape.is_closed for part in parts]
        self._bodies: dict[int, Any] = {}
        self._fine: dict[int, Any] = {}  # surfaces in mm

    def near(self, done: Callable[[float], None] = lambda share: None) -> tuple[DrawnPair, ...]:
        """All pairs nearer than `NEAR`."""
        count = len(self.surfaces)
        candidates = [(a, b) for a in range(count) for b in range(a + 1, count) if self._bounds_gap(a, b) <= NEAR]
        found = []
        for number, (a, b) in enumerate(candidates):
            done(number / len(candidates))
            gap, depth = self.measured(a, b, NEAR)
            if gap <= NEAR:
                found.append(DrawnPair(a, b, gap, depth))
        return tuple(found)

    def measured(self, a: int, b: int, furthest: float) -> tuple[float, float]:
        """Gap and depth of a pair, m; a gap above `furthest` is only known to be that."""
        if self._bounds_gap(a, b) > furthest:
            return np.inf, 0.0
        if not (self.closed[a] and self.closed[b]):
            return min(self._corner_gap(a, b, furthest), self._corner_gap(b, a, furthest)), float("nan")
        first, second = self._body(a), self._body(b)
        if self._bounds_gap(a, b) <= 0:
            common = _solid_surface(first ^ second)
            if len(common):
                return 0.0, max(self._depth(i, common) for i in (a, b))
        gap = float(first.min_gap(second, 1.05 * furthest + 1e-6))
        return (gap, 0.0) if gap <= furthest else (np.inf, 0.0)

    def _depth(self, i: int, common: Array) -> float:
        """How far triangles (N, 3, 3) around what a part has in common with another lie from the part's surface, m."""
        common = common[:: -(-len(common) // SAMPLES)]
        depths = self._distances(i, common.mean(axis=1))
        deepest = common[np.argsort(-depths, kind="stable")[:DEEPEST]]
        return greatest_depth(deepest, lambda points, least: self._distances(i, points), DEEPEST)

    def _distances(self, i: int, points: Array) -> Array:
        import trimesh

        if i not in self._fine:
            surface = self.surfaces[i]
            self._fine[i] = trimesh.Trimesh(FINE * surface.vertices, surface.triangles, process=False)
        return np.asarray(trimesh.proximity.closest_point(self._fine[i], FINE * points)[1]) / FINE

    def _bounds_gap(self, a: int, b: int) -> float:
        apart = np.maximum(self.bounds[a, 0] - self.bounds[b, 1], self.bounds[b, 0] - self.bounds[a, 1])
        return float(np.linalg.norm(np.maximum(apart, 0)))

    def _body(self, i: int) -> Any:
        if i not in self._bodies:
            surface, library = self.surfaces[i], self._manifold3d
            mesh = library.Mesh64(np.ascontiguousarray(surface.vertices), surface.triangles.astype(np.uint64))
            body = library.Manifold(mesh)
            if body.is_empty() or body.status() != library.Error.NoError:
                self.closed[i] = False
            self._bodies[i] = body
        return self._bodies[i]

    def _corner_gap(self, a: int, b: int, furthest: float) -> float:
        """Least distance of corners and middles of triangles of a to the surface of b."""
        surface = self.surfaces[a]
        points: Array = np.concatenate([surface.vertices, surface.corners.mean(axis=1)])
        low, high = self.bounds[b]
        points = points[((points > low - furthest) & (points < high + furthest)).all(axis=1)]
        points = points[:: max(1, -(-len(points) // SAMPLES))]
        gap = float(self._distances(b, points).min()) if len(points) else np.inf
        return gap if gap <= furthest else np.inf


def _solid_surface(common: Any) -> Array:
    """(N, 3, 3) m: small triangles all around what two bodies have in common, without the slivers that coinciding
    surfaces leave."""
    import trimesh

    found = [np.zeros((0, 3, 3))]
    for piece in common.decompose():
        volume = piece.volume()
        if volume > SMALLEST_VOLUME and 2 * volume > SMALLEST_THICKNESS * piece.surface_area():
            mesh = piece.to_mesh64()
            corners, triangles = np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts).astype(np.int64)
            between = max(POINTS_APART, float(np.ptp(corners, axis=0).max()) / 40)
            corners, triangles = trimesh.remesh.subdivide_to_size(corners, triangles, between, max_iter=20)
            found.append(corners[triangles])
    return np.concatenate(found)
