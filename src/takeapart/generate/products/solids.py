"""Bodies drawn as solids, in mm, by what manifold3d joins and cuts.

Numbers in millimetres here and in the drawings of products, as on a drawing in a workshop; `mesh_of` turns a body into
a shape in metres. What it returns depends on the body alone: corners and triangles stand in an order of their own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from takeapart.model.errors import MissingExtraError
from takeapart.model.geometry import TriangleMesh
from takeapart.model.meshes import Mesh

try:
    from manifold3d import CrossSection, Manifold
except ImportError:  # told when a product is drawn
    CrossSection = Manifold = None

Solid = Any  # manifold3d.Manifold
Point = tuple[float, float, float]
Outline = Sequence[tuple[float, float]]  # corners, counterclockwise

DIGITS = 9  # after the point, m: corners are rounded to 1 nm
FLANK = 4  # points of a tooth's flank
PRESSURE_ANGLE = math.radians(20.0)


def require_manifold() -> None:
    """Raises:
    MissingExtraError: the library that joins and cuts solids is not installed.
    """
    if Manifold is None:
        raise MissingExtraError("takeapart generate products", "verify", "manifold3d")


def block(low: Point, high: Point) -> Solid:
    """A box from its least to its greatest corner."""
    return Manifold.cube([b - a for a, b in zip(low, high, strict=True)]).translate(list(low))


def rounded_block(low: Point, high: Point, radius: float, segments: int = 24) -> Solid:
    """A box whose four upright edges are round."""
    corners = [(x, y) for x in (low[0] + radius, high[0] - radius) for y in (low[1] + radius, high[1] - radius)]
    posts = [cylinder(radius, low[2], high[2], (x, y), segments) for x, y in corners]
    return Manifold.batch_hull(posts)


def cylinder(
    radius: float, bottom: float, top: float, at: tuple[float, float] = (0.0, 0.0), segments: int = 32
) -> Solid:
    """An upright cylinder; its corners lie on the radius."""
    return Manifold.cylinder(top - bottom, radius, radius, segments).translate([at[0], at[1], bottom])


def cone(lower: float, upper: float, bottom: float, top: float, segments: int = 32) -> Solid:
    """An upright cone on the z axis with its two radii."""
    return Manifold.cylinder(top - bottom, lower, upper, segments).translate([0.0, 0.0, bottom])


def tube(outer: float, inner: float, bottom: float, top: float, segments: int = 32) -> Solid:
    """An upright tube on the z axis."""
    return cylinder(outer, bottom, top, segments=segments) - cylinder(inner, bottom - 1, top + 1, segments=segments)


def extruded(outline: Outline, bottom: float, top: float) -> Solid:
    """An outline pulled upwards."""
    return Manifold.extrude(CrossSection([list(outline)]), top - bottom).translate([0.0, 0.0, bottom])


def along_x(solid: Solid) -> Solid:
    """A body that stands along z, laid along x."""
    return solid.rotate([0.0, 90.0, 0.0])


def along_y(solid: Solid) -> Solid:
    """A body that stands along z, laid along y."""
    return solid.rotate([-90.0, 0.0, 0.0])


def hull(*solids: Solid) -> Solid:
    """The convex hull of bodies."""
    return Manifold.batch_hull(list(solids))


def gear_outline(module: float, teeth: int, backlash: float, inner: bool = False) -> Outline:
    """Outline of a spur gear with involute flanks; a tooth's middle lies on the x axis.

    Args:
        backlash: by which each tooth is thinner at the pitch circle than half a pitch, mm.
        inner: the hole of a ring gear instead: its gaps are as wide as teeth would be, and `backlash` wider.
    """
    pitch = module * teeth / 2
    base = pitch * math.cos(PRESSURE_ANGLE)
    tip = pitch + (1.25 if inner else 1.0) * module
    root = pitch - (1.0 if inner else 1.25) * module
    half = math.pi / (2 * teeth) + (0.5 if inner else -0.5) * backlash / pitch  # rad, of a tooth at the pitch circle
    flank = []
    for radius in np.linspace(max(base, root), tip, FLANK):
        turned = half + _involute(pitch, base) - _involute(float(radius), base)
        flank.append((float(radius), turned))
    if root < base:
        flank.insert(0, (root, flank[0][1]))
    points = []
    for k in range(teeth):
        middle = 2 * math.pi * k / teeth
        tooth = [(radius, middle - angle) for radius, angle in flank]
        tooth += [(radius, middle + angle) for radius, angle in reversed(flank)]
        points += [(radius * math.cos(angle), radius * math.sin(angle)) for radius, angle in tooth]
    return points


def _involute(radius: float, base: float) -> float:
    """Angle of the involute of a circle of radius `base` at a radius, rad."""
    angle = math.acos(min(1.0, base / radius))
    return math.tan(angle) - angle


def cap_screw(shank: float, length: float, head: float, height: float) -> Solid:
    """A screw with a round head and a hexagon socket; its head's underside is at z = 0, its threads are not drawn."""
    body = cylinder(head, 0.0, height, segments=24) + cylinder(shank, -length, 0.0, segments=24)
    return body - cylinder(0.5 * head, 0.5 * height, height + 1, segments=6)


def hexagon_screw(shank: float, length: float, across: float, height: float) -> Solid:
    """A screw with a hexagon head, whose underside is at z = 0 and whose flats are `across` apart."""
    head = cylinder(across / math.sqrt(3.0), 0.0, height, segments=6)
    return head + cylinder(shank, -length, 0.0, segments=24)


def mesh_of(solid: Solid) -> Mesh:
    """The shape of a body, in metres; equal bodies have equal meshes, digit by digit."""
    found = solid.to_mesh64()
    corners = np.round(np.asarray(found.vert_properties)[:, :3] / 1000.0, DIGITS) + 0.0
    corners, number = np.unique(corners, axis=0, return_inverse=True)  # in ascending order
    triangles = number.reshape(-1)[np.asarray(found.tri_verts, dtype=np.int64)]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    first = np.argmin(triangles, axis=1)[:, None]
    triangles = np.take_along_axis(triangles, (first + np.arange(3)) % 3, axis=1)
    triangles = triangles[np.lexsort(triangles.T[::-1])]
    return Mesh(TriangleMesh(corners, triangles.astype(np.int32)))
