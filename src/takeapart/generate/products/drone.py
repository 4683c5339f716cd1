"""A quadcopter on its building stand: two plates, four slotted profiles as arms, motors, propellers, a battery."""

from __future__ import annotations

import numpy as np

from takeapart.generate.products.drawing import ALUMINIUM, CARBON, PLASTIC, STEEL, Drawing, about_z
from takeapart.generate.products.solids import Solid, block, cylinder, hexagon_screw, rounded_block
from takeapart.model.assembly import Assembly

ARMS = (0.0, 90.0, 180.0, 270.0)  # degrees
START, MOTOR, END = 20.0, 118.0, 134.0  # mm from the axis, along an arm
WIDE, HIGH, SLOT = 16.0, 14.0, 5.0  # mm, profile
STAND, BOTTOM, TOP = 40.0, 46.0, 60.0  # mm, heights: under the bottom plate, under and on the arms
UPPER = 66.0  # mm, height of the top plate's upper side
SCREWS = ((24.0, 24.0), (-24.0, 24.0), (-24.0, -24.0), (24.0, -24.0))  # mm


def arm() -> Solid:
    """A profile along x with a slot in each side and a hole for the motor's peg."""
    body = block((START, -WIDE / 2, 0), (END, WIDE / 2, HIGH))
    for side in (-1, 1):
        slot = block((START - 1, -2.0, HIGH / 2 - SLOT / 2), (MOTOR - 14, 2.0, HIGH / 2 + SLOT / 2))
        body -= slot.translate([0, side * WIDE / 2, 0])
    return body - cylinder(4.15, 5.0, HIGH + 1, (MOTOR, 0), 24)


def stand() -> Solid:
    """Crossed feet, a column below the middle, a cradle for each arm."""
    body = cylinder(18.0, 0.0, STAND)
    for angle in ARMS:
        leg = block((0, -7, 0), (MOTOR + 4, 7, 8)) + block((MOTOR - 22, -13, 0), (MOTOR - 10, 13, BOTTOM + 4))
        leg += block((58, -6, 8), (MOTOR - 15, 6, 30))  # hands reach around arms and plates above it
        leg -= block((MOTOR - 30, -WIDE / 2 - 0.15, BOTTOM), (MOTOR, WIDE / 2 + 0.15, BOTTOM + 9))
        body += leg.rotate([0, 0, angle])
    return body


def propeller() -> Solid:
    """A hub with two blades."""
    blade = block((0, -6, 3), (58, 6, 5.5)) ^ cylinder(58.0, 0.0, 10.0, segments=48)
    return cylinder(8.0, 0.0, 12.0) + blade + blade.rotate([0, 0, 180]) - cylinder(2.65, -1.0, 13.0, segments=24)


def drone() -> Assembly:
    """The product."""
    drawing = Drawing("drone", "quadcopter on its building stand", (0.06, 0.20, 0.0), turn=45.0)
    drawing.add("stand", stand(), PLASTIC, fixed=True)
    bottom = rounded_block((-38, -38, STAND), (38, 38, BOTTOM), 10)
    top = rounded_block((-38, -38, TOP), (38, 38, UPPER), 10)
    tray = rounded_block((-21, -16, UPPER), (21, 16, UPPER + 5), 3) - block(
        (-18.2, -13.2, UPPER), (18.2, 13.2, UPPER + 6)
    )
    top += tray
    for at in SCREWS:
        bottom -= cylinder(2.65, STAND - 1, BOTTOM + 1, at, 24)
        top -= cylinder(2.8, TOP - 1, UPPER + 1, at, 24)
    drawing.add("bottom-plate", bottom, CARBON)
    motor = cylinder(14.0, 0.0, 20.0) + cylinder(4.0, -8.0, 0.0, segments=24)
    motor += cylinder(5.0, 20.0, 22.0, segments=24) + cylinder(2.5, 22.0, 37.0, segments=24)
    for number, angle in enumerate(ARMS, 1):
        R = about_z(angle)
        x, y, _ = (R @ np.array([MOTOR, 0.0, 0.0])).tolist()
        drawing.add(f"arm-{number}", arm(), ALUMINIUM, (0, 0, BOTTOM), R)
        drawing.add(f"motor-{number}", motor, STEEL, (x, y, TOP))
        drawing.add(f"propeller-{number}", propeller(), PLASTIC, (x, y, TOP + 22), about_z(angle + 90))
    drawing.add("top-plate", top, CARBON)
    for number, (x, y) in enumerate(SCREWS, 1):
        drawing.add(f"screw-{number}", hexagon_screw(2.5, 24.0, 11.0, 12.0), STEEL, (x, y, UPPER))
    battery = rounded_block((-18, -13, 0), (18, 13, 30), 3)
    drawing.add("battery", battery, 2000.0, (0, 0, UPPER))
    return drawing.assembly()
