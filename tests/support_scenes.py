"""Assemblies that a planner which looks at names and extents accepts although something falls, and one that stands."""

from __future__ import annotations

import numpy as np

from takeapart.model.assembly import Assembly, Connector, Part
from takeapart.model.geometry import Box, OrientedBox, pose, pose_inverse

BASE = Part("base", Box((0.4, 0.06, 0.02)), pose(), 1.0, fixed=True)  # its top is at 10 mm


def box(x: float, y: float, z: float, size: tuple[float, float, float]) -> OrientedBox:
    return OrientedBox(pose((x, y, z)), np.array(size) / 2)


def collar(x: float, low: float, high: float) -> tuple[OrientedBox, ...]:
    """Four walls 2 mm thick about a bar along z of 2 cm, with 0.5 mm of play."""
    z, height = (low + high) / 2, high - low
    sides = tuple(box(x + side * 0.0115, 0, z, (0.002, 0.025, height)) for side in (-1, 1))
    return (*sides, *(box(x, side * 0.0115, z, (0.021, 0.002, height)) for side in (-1, 1)))


def cantilever() -> Assembly:
    """A bar of 0.4 m on a floor of 2 cm at one end, with cheeks along all of it."""
    bar = Part("bar", Box((0.4, 0.02, 0.02)), pose((0, 0, 0.022)), 0.1)
    cheeks = tuple(box(0, side * 0.0115, 0.02, (0.4, 0.002, 0.02)) for side in (-1, 1))
    return _on_base(bar, "U", (box(-0.19, 0, 0.011, (0.02, 0.025, 0.002)), *cheeks))


def floorless() -> Assembly:
    """A bar between the cheeks of a U, nothing below it."""
    found = cantilever()
    return _on_base(found.parts[1], "U", found.connectors[0].walls[1:])


def post(foot: float = 0.0, walls_from: float = 0.0105) -> Assembly:
    """A post in an O, its foot so many m above the base."""
    part = Part("post", Box((0.02, 0.02, 0.2)), pose((0, 0, 0.11 + foot)), 0.1)
    return _on_base(part, "O", collar(0.0, walls_from, 0.03))


def bar_between_cheeks() -> Assembly:
    """A level bar between two upright walls that are called an O, 5 mm above the base."""
    bar = Part("bar", Box((0.2, 0.02, 0.02)), pose((0, 0, 0.025)), 0.1)
    return _on_base(bar, "O", tuple(box(0, side * 0.0115, 0.0225, (0.1, 0.002, 0.025)) for side in (-1, 1)))


def lintel(height: float = 0.0, kind: str = "O", x: float = 0.0, weight: float = 0.1) -> Assembly:
    """A lintel of 0.4 m, its middle at x, so many m above the post that its own connector holds."""
    standing = post()
    top = Part("lintel", Box((0.4, 0.02, 0.02)), pose((x, 0, 0.22 + height)), weight)
    walls = tuple(wall.moved(pose_inverse(top.T_world_part)) for wall in collar(0.0, 0.19, 0.2095 + height))
    head = Connector("head", kind, "lintel", "post", walls)  # type: ignore[arg-type]
    return Assembly("lintel", (*standing.parts, top), (*standing.connectors, head))


def seesaw(offset: float) -> Assembly:
    """A bar of 0.2 m on one floor of 2 cm, its middle `offset`, m, beyond the floor's edge."""
    bar = Part("bar", Box((0.2, 0.02, 0.02)), pose((0.01 + offset, 0, 0.022)), 0.1)
    return _on_base(bar, "U", (box(0, 0, 0.011, (0.02, 0.025, 0.002)),))


def far_holder() -> Assembly:
    """A bar 28 cm above the base, with a cube of 1 cm for a holder, 20 cm away."""
    bar = Part("bar", Box((0.4, 0.02, 0.02)), pose((0, 0, 0.3)), 0.1)
    return _on_base(bar, "U", (box(0.0, 0.2, 0.0, (0.01, 0.01, 0.01)),))


def corner_holder() -> Assembly:
    """A U with one wall, 0.98 mm from its host along each of x, y and z, so that their corners are 1.7 mm apart."""
    gap = 0.00098
    bar = seesaw(-0.01).parts[1]
    host = Part("host", Box((0.02, 0.02, 0.02)), pose((-0.0212, -0.01, -gap)), 1.0, fixed=True)
    wall = box(-0.0112 + gap + 0.012, gap + 0.012, 0.011, (0.024, 0.024, 0.002))
    walls = (wall.moved(pose_inverse(host.T_world_part)),)
    return Assembly("corner", (host, bar), (Connector("holder", "U", "host", "bar", walls),))


def _on_base(part: Part, kind: str, walls: tuple[OrientedBox, ...]) -> Assembly:
    return Assembly("demo", (BASE, part), (Connector("holder", kind, "base", part.name, walls),))  # type: ignore[arg-type]
