"""A camera that lies on its back for repair: a lens in a bayonet, its mount with screws, hood, cap, battery, flash."""

from __future__ import annotations

import math

from takeapart.generate.products.drawing import ALUMINIUM, BRASS, PLASTIC, STEEL, Drawing, about_z
from takeapart.generate.products.solids import (
    Solid,
    along_y,
    block,
    cylinder,
    extruded,
    hexagon_screw,
    rounded_block,
    tube,
)
from takeapart.model.assembly import Assembly

FRONT, MOUNT = 40.0, 52.0  # mm, heights: of the body's front, of the mount's face
THROAT, PLUG, LUG = 21.0, 20.6, 24.5  # mm, radii: of the mount's opening, of what goes in, of the lens's lugs
LUG_HIGH, LIP = 4.0, 3.6  # mm, heights: of a lug, of the mount's lip above it
LUGS, LUG_WIDE, SLOT_WIDE, TURN = 3, 36.0, 42.0, 55.0  # number; degrees
SCREWS = [45.0, 135.0, 225.0, 315.0]  # degrees
DIAL, BUTTON = 58.0, -60.0  # x, mm
RIM = 33.0  # mm, from the axis to the screws


def sector(radius: float, start: float, end: float, bottom: float, top: float) -> Solid:
    """A piece of a disc between two angles, degrees."""
    steps = max(2, math.ceil((end - start) / 6))
    angles = [math.radians(start + (end - start) * k / steps) for k in range(steps + 1)]
    return extruded([(0.0, 0.0), *((radius * math.cos(a), radius * math.sin(a)) for a in angles)], bottom, top)


def mount() -> Solid:
    """A ring with three slots for the lens's lugs, a channel below its lip, and stops at the ends of the channel."""
    body = tube(38.5, THROAT, FRONT, MOUNT, 64)
    for k in range(LUGS):
        middle = 120.0 * k
        body -= sector(LUG + 0.3, middle - SLOT_WIDE / 2, middle + SLOT_WIDE / 2, FRONT - 1, MOUNT + 1)
        body -= sector(LUG + 0.3, middle - SLOT_WIDE / 2, middle + SLOT_WIDE / 2 + TURN, FRONT - 1, MOUNT - LIP)
    for angle in SCREWS:
        at = (RIM * math.cos(math.radians(angle)), RIM * math.sin(math.radians(angle)))
        body -= cylinder(2.2, FRONT - 1, MOUNT + 1, at, 24)
    return body


def lens() -> Solid:
    """A barrel and, below its flange at z = 0, a plug with three lugs, the first of which looks along x."""
    low = -LIP - 0.1 - LUG_HIGH
    body = (
        cylinder(PLUG, low, 1.0, segments=48)
        + cylinder(27.0, 0.0, 42.0, segments=48)
        + cylinder(25.0, 42.0, 60.0, segments=48)
    )
    for k in range(LUGS):
        body += sector(LUG, 120.0 * k - LUG_WIDE / 2, 120.0 * k + LUG_WIDE / 2, low, low + LUG_HIGH)
    return body - cylinder(15.0, low - 1, 50.0) - cylinder(20.0, 54.0, 61.0)


def camera() -> Assembly:
    """The product; the camera's top looks along y."""
    drawing = Drawing("camera", "camera on its back, with a bayonet lens", (0.15, 0.19, 0.0))
    body = rounded_block((-75, -52, 0), (75, 52, FRONT), 9)
    body += block((-20, 50, 4), (20, 64, FRONT))  # the prism
    body -= cylinder(26.0, 20.0, FRONT + 1)
    for angle in SCREWS:
        at = (RIM * math.cos(math.radians(angle)), RIM * math.sin(math.radians(angle)))
        body -= cylinder(2.15, FRONT - 14, FRONT + 1, at, 24)
    body -= block((40, -30.2, 8.0), (76, 4.2, 28.0))  # the battery's bay, open to the side
    body -= along_y(cylinder(8.2, 40.0, 53.0, segments=24)).translate([DIAL, 0, 20])
    body -= along_y(cylinder(6.2, 40.0, 53.0, segments=24)).translate([BUTTON, 0, 20])
    body += (
        block((-14, 62, 4), (14, 70, 22))
        - block((-9.2, 63.9, 8), (9.2, 67.1, 23))
        - block((-5.2, 66, 8), (5.2, 71, 23))
    )
    drawing.add("body", body, ALUMINIUM, fixed=True)
    drawing.add("mount", mount(), STEEL)
    for number, angle in enumerate(SCREWS, 1):
        x, y = RIM * math.cos(math.radians(angle)), RIM * math.sin(math.radians(angle))
        drawing.add(f"screw-{number}", hexagon_screw(2.0, 24.0, 8.0, 12.0), STEEL, (x, y, MOUNT))
    turn = TURN + (SLOT_WIDE - LUG_WIDE) / 2 - 0.5
    drawing.add("lens", lens(), BRASS, (0, 0, MOUNT), about_z(turn))
    drawing.add("hood", tube(30.0, 25.2, 0, 34.0, 48), PLASTIC, (0, 0, MOUNT + 42))
    drawing.add("battery", block((42, -30, 8.0), (70, 4, 27.8)) + block((69, -20, 11), (106, -6, 25)), 2000.0)
    dial = along_y(cylinder(8.0, 42.0, 52.0, segments=24) + cylinder(13.0, 52.2, 76.0)).translate([DIAL, 0, 19.8])
    button = along_y(cylinder(6.0, 42.0, 52.0, segments=24) + cylinder(9.0, 52.2, 76.0)).translate([BUTTON, 0, 19.8])
    drawing.add("dial", dial, PLASTIC)
    drawing.add("button", button, PLASTIC)
    flash = block((-9, 64, 8), (9, 67, 22)) + block((-5, 66, 8), (5, 74, 22)) + block((-25, 72, 8), (25, 92, 40))
    drawing.add("flash", flash, PLASTIC)
    return drawing.assembly()
