"""Hand-made assemblies of a few bars that are planned in a second or two, and their workcell as a file."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from takeapart.model.assembly import Assembly, Connector
from takeapart.model.geometry import OrientedBox, pose
from verification_scene import bar, scene_assembly, u_walls

WORKCELL = """
format = "takeapart/workcell"
version = 1
name = "scene"
goal = [-0.05, -0.30, 0.42]

[robot]
model = "panda"
home = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]

[robot.base]
position = [-0.45, 0.1, 0.0]

[[environment]]
name = "table"
size = [1.4, 1.4, 0.08]
position = [0.0, 0.0, -0.1]
"""


@functools.cache
def two_bars() -> Assembly:
    """Two fixed posts carry a beam, the beam and a third post carry a stub: the stub has to leave first."""
    full = scene_assembly()
    return Assembly("two-bars", tuple(p for p in full.parts if p.name not in ("loose", "block")), full.connectors)


@functools.cache
def three_bars() -> Assembly:
    """The same with another stub behind the beam: the stubs leave in any order, the beam last."""
    small = two_bars()
    rear, back = bar("rear", [0.175, 0.0, 0.19], [0.129, 0.02, 0.02]), bar("back", [0.25, 0.0, 0.1], [0.02, 0.02, 0.22])
    back = replace(back, fixed=True)
    at = {part.name: part.T_world_part[:3, 3] for part in (*small.parts, rear, back)}
    connectors = (
        *small.connectors,
        Connector("beam-rear", "U", "beam", "rear", u_walls(at["beam"], at["rear"], "x", 1)),
        Connector("back-rear", "U", "back", "rear", u_walls(at["back"], at["rear"], "x", -1)),
    )
    return Assembly("three-bars", (*small.parts, rear, back), connectors)


@functools.cache
def deadlock() -> Assembly:
    """No feasible order: the stub would fall without the beam, and the beam's connector has a roof over the stub."""
    small = two_bars()
    roof = OrientedBox(pose([-0.02, 0.0, 0.012]), np.array([0.009, 0.0125, 0.001]))  # over the stub's end, beam's frame
    connectors = tuple(
        replace(connector, walls=(*connector.walls, roof)) if connector.name == "beam-stub" else connector
        for connector in small.connectors
    )
    return Assembly("deadlock", small.parts, connectors)


@functools.cache
def floating() -> Assembly:
    """The stub without the connectors that carry it."""
    small = two_bars()
    return Assembly("floating", small.parts, tuple(c for c in small.connectors if c.guest != "stub"))
