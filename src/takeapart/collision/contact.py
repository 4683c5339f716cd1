"""Which parts of a product are near each other as drawn: how far apart, or how deep in one another.

The tolerance of a pair says how deep the two may overlap while one of them leaves: as deep as they are drawn, and what
the fields do not see. It is the same in all states.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from takeapart.collision.axes import drawn_axes
from takeapart.collision.depths import depth_in
from takeapart.collision.fields import FIELD_ERROR, Field, field_of, signed_distances, surface_points
from takeapart.collision.meeting import cloud_distance, points_below
from takeapart.collision.points import Cloud, cloud_of, facet_normals
from takeapart.collision.triangles import TriangleTree, distances, triangle_tree
from takeapart.model.assembly import Assembly
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, Box, Shape, TriangleMesh, pose_inverse
from takeapart.model.meshes import Mesh

NEAR = 5e-3  # m; pairs further apart than this are not told
SPACING = 2e-3  # m, between the points on a surface
MARGIN = 5e-5  # m, to what is drawn
SWALLOWED = 2.5e-4  # m; overlaps deeper than this are told
OVERLAP_LIMIT = 5e-4  # m; deeper ones are refused, unless they are meant


@dataclass(frozen=True, eq=False)
class Body:
    """A part for questions of contact.

    Args:
        field: of its shape, in the part's frame.
        surface: its triangles.
    """

    field: Field
    surface: TriangleMesh

    @cached_property
    def points(self) -> Array:
        """(N, 3) m, on all of its surface, in the part's frame: for bodies that have no points of their own."""
        return surface_points(self.surface, SPACING)

    @cached_property
    def cloud(self) -> Cloud:
        """Its surface points that matter where another body is asked with its own in turn."""
        return cloud_of(self.surface, self.field, SPACING)

    @cached_property
    def facets(self) -> tuple[Array, ...]:
        """Normals (3,) in the part's frame of groups of parallel facets, those of the largest areas first."""
        return facet_normals(self.surface)

    @cached_property
    def axes(self) -> tuple[Array, ...]:
        """Axes (3,) in the part's frame of what is drawn along a line: round, or a profile."""
        return drawn_axes(self.surface, self.facets)

    @cached_property
    def tree(self) -> TriangleTree:
        """For exact distances from the surface."""
        return triangle_tree(self.surface)


@dataclass(frozen=True)
class PairFinding:
    """Two parts that are near each other.

    Args:
        first, second: numbers of the parts.
        gap: m between them; 0 where they overlap.
        depth: m that they overlap; 0 where they do not.
    """

    first: int
    second: int
    gap: float
    depth: float


class Contacts:
    """Near pairs of a product, measured once.

    Args:
        assembly: the product, as drawn.
    """

    def __init__(self, assembly: Assembly) -> None:
        self._assembly = assembly
        self._shapes: dict[object, Body] = {}

    def body(self, part: int) -> Body:
        """Field and surface of a part; equal shapes share theirs."""
        shape = self._assembly.parts[part].shape
        key: object = (
            shape.hash if isinstance(shape, Mesh) else tuple(shape.size) if isinstance(shape, Box) else id(shape)
        )
        if key not in self._shapes:
            self._shapes[key] = body_of(shape)
        return self._shapes[key]

    @cached_property
    def bounds(self) -> tuple[Array, ...]:
        """Per part (2, 3) m: least and greatest coordinates in the world."""
        parts = self._assembly.parts
        return tuple(self.body(i).surface.moved(part.T_world_part).bounds for i, part in enumerate(parts))

    @cached_property
    def findings(self) -> tuple[PairFinding, ...]:
        """All pairs that are at most `NEAR` apart."""
        parts, bounds = self._assembly.parts, self.bounds
        found = []
        for a in range(len(parts)):
            for b in range(a + 1, len(parts)):
                if (bounds[a][1] + NEAR < bounds[b][0]).any() or (bounds[b][1] + NEAR < bounds[a][0]).any():
                    continue
                distance = self._distance(a, b)
                if distance < NEAR:
                    found.append(PairFinding(a, b, max(distance, 0.0), max(-distance, 0.0)))
        return tuple(found)

    def _distance(self, a: int, b: int) -> float:
        """Least signed distance between two parts, m: of the points of each in the field of the other."""
        parts = self._assembly.parts
        T = pose_inverse(parts[b].T_world_part) @ parts[a].T_world_part
        least = self.distance_at(a, b, parts[a].T_world_part)
        if least >= 0.0:
            return least
        there = _deepest(self.body(b), self.body(a).points, T)
        return min(least, there, _deepest(self.body(a), self.body(b).points, pose_inverse(T)))

    def distance_at(self, a: int, b: int, T_world_a: Array) -> float:
        """Least signed distance, m, of one part at a pose (4, 4) from another as drawn, by their triangles; `NEAR` at
        most."""
        T = pose_inverse(self._assembly.parts[b].T_world_part) @ T_world_a
        least = min(NEAR, _least_distance(self.body(b), self.body(a).cloud, T))
        return min(least, _least_distance(self.body(a), self.body(b).cloud, pose_inverse(T)))

    @cached_property
    def _by_pair(self) -> Mapping[tuple[int, int], PairFinding]:
        return {(each.first, each.second): each for each in self.findings}

    def finding(self, a: int, b: int) -> PairFinding | None:
        """What is known of two parts; None where they are not near."""
        return self._by_pair.get((min(a, b), max(a, b)))

    def tolerance(self, a: int, b: int) -> float:
        """How deep two parts may overlap on the way of one of them, m."""
        found = self.finding(a, b)
        error = FIELD_ERROR * max(self.body(a).field.step, self.body(b).field.step)
        return MARGIN + error + (found.depth if found is not None else 0.0)

    def require(self) -> None:
        """Refuses a drawing in which parts overlap deeper than `OVERLAP_LIMIT` that are not meant to.

        Raises:
            InputError: names the pair and the depth.
        """
        names = [part.name for part in self._assembly.parts]
        meant = {frozenset(pair) for pair in self._assembly.allowed_overlaps}
        worst = [
            each
            for each in sorted(self.findings, key=lambda each: -each.depth)
            if each.depth > OVERLAP_LIMIT
            and frozenset((names[each.first], names[each.second])) not in meant
            and not (self._assembly.parts[each.first].fixed and self._assembly.parts[each.second].fixed)
        ]
        if worst:
            more = f" (and {len(worst) - 1} more pairs)" if len(worst) > 1 else ""
            first, second = names[worst[0].first], names[worst[0].second]
            raise InputError(
                f"parts {first!r} and {second!r} overlap by {1e3 * self.depth(worst[0]):.2f} mm as drawn{more}; at "
                f"most {1e3 * OVERLAP_LIMIT:g} mm is valid, unless it is meant: import the product with "
                f"--allow-overlap {first},{second} (allowed_overlaps in the file)",
                f"{self._assembly.name}: parts",
            )

    def depth(self, found: PairFinding) -> float:
        """How deep two parts overlap, m, to the micrometre: for words; planning goes by the depth that was found."""
        parts = self._assembly.parts
        T = pose_inverse(parts[found.second].T_world_part) @ parts[found.first].T_world_part
        first, second = self.body(found.first), self.body(found.second)
        forth = depth_in(second.field, second.tree, first.surface.moved(T))
        return max(found.depth, forth, depth_in(first.field, first.tree, second.surface.moved(pose_inverse(T))))

    def swallowed(self) -> tuple[PairFinding, ...]:
        """Pairs that overlap by more than `SWALLOWED`, the deepest first."""
        deep = [each for each in self.findings if each.depth > SWALLOWED]
        return tuple(sorted(deep, key=lambda each: -each.depth))


def _least_distance(body: Body, cloud: Cloud, T: Array) -> float:
    """Least signed distance of points from a body, m, `NEAR` at most: the field tells the side, the triangles how far.

    Args:
        T: (4, 4) T_body_cloud.
    """
    field = body.field
    least = float(cloud_distance(field, cloud, T, NEAR))
    if field.step == 0.0 or least >= NEAR:
        return least
    limit = least + 2 * FIELD_ERROR * field.step  # the field may be wrong about which point is the nearest
    if least > 0.99 * field.band or limit < -0.99 * field.band:  # beyond the band it knows only bounds
        limit = NEAR if least > 0 else -0.99 * field.band
    points = points_below(field, cloud, T, min(NEAR, limit))
    return _least_exactly(body, points, signed_distances(field, points))


def _deepest(body: Body, points: Array, T: Array) -> float:
    """As `_least_distance` of points (N, 3) all over a surface, of which clouds have few where it is flat: they may all
    lie beside the place where another body reaches in deepest."""
    placed = np.ascontiguousarray(points @ T[:3, :3].T + T[:3, 3])
    signed = signed_distances(body.field, placed)
    inside = signed < 0.0
    if body.field.step == 0.0 or not inside.any():
        return float(signed.min())
    return _least_exactly(body, np.ascontiguousarray(placed[inside]), signed[inside])


def _least_exactly(body: Body, points: Array, signed: Array) -> float:
    """Least distance of points (N, 3) by a body's triangles, m, on the sides that its field tells."""
    return float((np.sign(signed) * distances(points, body.tree, NEAR)).min())


def body_of(shape: Shape) -> Body:
    """Field and points of a shape."""
    surface = shape.surface()
    return Body(field_of(shape), surface)
