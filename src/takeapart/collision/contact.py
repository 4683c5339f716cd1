"""Which parts of a product are near each other as drawn: how far apart, or how deep in one another.

The tolerance of a pair says how deep the two may overlap while one of them leaves: as deep as they are drawn, and what
the fields do not see. It is the same in all states.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from takeapart.collision.fields import FIELD_ERROR, Field, field_of, signed_distances, surface_points
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
        points: (N, 3) m, on its surface, in the part's frame.
        surface: its triangles.
    """

    field: Field
    points: Array
    surface: TriangleMesh

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
        least = NEAR
        for first, second in ((a, b), (b, a)):
            T = pose_inverse(self._assembly.parts[second].T_world_part) @ self._assembly.parts[first].T_world_part
            field, points = self.body(second).field, self.body(first).points @ T[:3, :3].T + T[:3, 3]
            near = (np.abs(points - field.middle) @ np.abs(field.axes.T) < field.half + NEAR).all(axis=1)
            if near.any():
                least = min(least, _least_distance(self.body(second), np.ascontiguousarray(points[near])))
        return least

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
                f"parts {first!r} and {second!r} overlap by {1e3 * worst[0].depth:.2f} mm as drawn{more}; at most "
                f"{1e3 * OVERLAP_LIMIT:g} mm is valid, unless the pair stands in allowed_overlaps",
                f"{self._assembly.name}: parts",
            )

    def swallowed(self) -> tuple[PairFinding, ...]:
        """Pairs that overlap by more than `SWALLOWED`, the deepest first."""
        deep = [each for each in self.findings if each.depth > SWALLOWED]
        return tuple(sorted(deep, key=lambda each: -each.depth))


def _least_distance(body: Body, points: Array) -> float:
    """Least signed distance of points (N, 3) from a body, m: the field tells the side, the triangles how far."""
    signed = signed_distances(body.field, points)
    chosen = signed < NEAR
    if body.field.step == 0.0 or not chosen.any():
        return float(signed.min())
    exact = distances(np.ascontiguousarray(points[chosen]), body.tree, NEAR)
    return float((np.sign(signed[chosen]) * exact).min())


def body_of(shape: Shape) -> Body:
    """Field and points of a shape."""
    surface = shape.surface()
    return Body(field_of(shape), surface_points(surface, SPACING), surface)
