"""A gear pump: a body with two gears in it, a cover with screws, pipe fittings from both sides, a coupling."""

from __future__ import annotations

from takeapart.generate.products.drawing import ALUMINIUM, BRASS, STEEL, Drawing, about_z
from takeapart.generate.products.solids import (
    Solid,
    along_y,
    block,
    cylinder,
    extruded,
    gear_outline,
    hexagon_screw,
    rounded_block,
    tube,
)
from takeapart.model.assembly import Assembly

MODULE, TEETH, BACKLASH = 2.0, 18, 0.3  # mm, teeth, mm
APART, TIP = MODULE * TEETH, MODULE * TEETH / 2 + MODULE  # mm, between the gears; their radius
AXES = (-APART / 2, APART / 2)  # x, mm
FLOOR, TOP, COVER = 12.0, 36.0, 46.0  # mm, heights: of the cavity's floor, of the body, of the cover
JOURNAL, HOLE = 6.0, 6.15  # mm, radii
SCREWS = [(x, y) for x in (-48.0, 48.0) for y in (-26.0, 26.0)]  # mm
PORT, PORT_HEIGHT = 9.15, 21.0  # mm, radius and height of the fittings' holes


def gear_shaft(top: float) -> Solid:
    """A gear with its journals, up to a height; where that is far above the cover, a step carries the coupling."""
    body = extruded(gear_outline(MODULE, TEETH, BACKLASH), FLOOR, TOP - 0.15) + cylinder(JOURNAL, 4.5, FLOOR)
    if top > 70:
        return body + cylinder(JOURNAL, TOP - 1, 66.0) + cylinder(4.5, 66.0, top)
    return body + cylinder(JOURNAL, TOP - 1, top)


def fitting() -> Solid:
    """A pipe fitting along z: a spigot below, a collar, a hose end."""
    body = cylinder(9.0, -16.0, 0.0) + cylinder(13.0, 0.0, 8.0, segments=6) + cylinder(7.0, 8.0, 26.0)
    return body - cylinder(4.0, -17.0, 27.0, segments=16)


def pump() -> Assembly:
    """The product."""
    drawing = Drawing("pump", "gear pump", (0.16, 0.20, 0.0))
    body = rounded_block((-60, -38, 0), (60, 38, TOP), 12)
    cover = rounded_block((-60, -38, TOP), (60, 38, COVER), 12)
    for x in AXES:
        body -= cylinder(TIP + 0.2, FLOOR, TOP + 1, (x, 0), 64) + cylinder(HOLE, 4.0, FLOOR + 1, (x, 0))
        cover += cylinder(12.0, COVER, 60.0, (x, 0))
        cover -= cylinder(HOLE, TOP - 1, 61.0 if x < 0 else 56.5, (x, 0))
    for at in SCREWS:
        body -= cylinder(3.15, 8.0, TOP + 1, at, 24)
        cover -= cylinder(3.3, TOP - 1, COVER + 1, at, 24)
    port = along_y(cylinder(PORT, -60.0, 60.0)).translate([0, 0, PORT_HEIGHT])
    channel = block((-5, -22, PORT_HEIGHT - 5), (5, 22, PORT_HEIGHT + 5))
    inside = block((-70, -21.5, 0), (70, 21.5, 60))
    body = body - (port - inside) - channel
    drawing.add("body", body, ALUMINIUM, fixed=True)
    drawing.add("drive-gear", gear_shaft(84.0), STEEL, (AXES[0], 0, 0))
    idler = gear_shaft(56.0).rotate([0, 0, 180.0 / TEETH])
    drawing.add("idler-gear", idler, STEEL, (AXES[1], 0, 0))
    drawing.add("cover", cover, ALUMINIUM)
    for number, (x, y) in enumerate(SCREWS, 1):
        drawing.add(f"screw-{number}", hexagon_screw(3.0, 26.0, 13.0, 12.0), STEEL, (x, y, COVER))
    drawing.add("coupling", tube(13.0, 4.65, 66.0, 92.0), STEEL, (AXES[0], 0, 0))
    out = fitting().rotate([-90, 0, 0])
    drawing.add("outlet", out, BRASS, (0, 38.0, PORT_HEIGHT))
    drawing.add("inlet", out, BRASS, (0, -38.0, PORT_HEIGHT), about_z(180.0))
    for name, side in (("outlet", 1.0), ("inlet", -1.0)):
        points = [(x, side * 38.0, PORT_HEIGHT + z) for x, z in ((-9.0, 0.0), (9.0, 0.0), (0.0, 9.0), (0.0, -9.0))]
        drawing.join(f"{name}-thread", "screw", "body", name, points, (0.0, side, 0.0), 50.0)
    return drawing.assembly()
