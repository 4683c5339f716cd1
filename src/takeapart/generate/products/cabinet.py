"""An instrument cabinet: drawers behind a locking rod, cartridges that lean to both sides, fans in its back."""

from __future__ import annotations

import math

from takeapart.generate.products.drawing import ALUMINIUM, PLASTIC, STEEL, Drawing, about_y
from takeapart.generate.products.solids import Solid, along_y, block, cylinder, rounded_block
from takeapart.model.assembly import Assembly

WIDE, DEEP, HIGH = 190.0, 120.0, 212.0  # mm, of the housing; its front looks along -y
DRAWERS = (70.0, 114.0)  # mm, heights of the drawers' floors
EDGE = 162.0  # mm, height of the step in front of the cartridges
FANS = (-50.0, 50.0)  # x, mm
FAN_HEIGHT = 112.0  # mm
DRAWER = (150.0, 100.0, 38.0)  # mm
PLAY = 0.15  # mm, on each side
LEAN = 30.0  # degrees from upright, of the cartridges
CARTRIDGE = (30.0, 50.0, 70.0)  # mm
SUNK = 34.0  # mm, that a cartridge is in its slot
SLOTS = ((-50.0, -LEAN), (50.0, LEAN))  # x of a slot's mouth, mm, and its lean
ROD = (-81.0, -DEEP / 2 - 12.0)  # x and y, mm


def drawer() -> Solid:
    """A closed cassette with a front plate, a handle and an eye for the rod; y = 0 is behind its front plate."""
    x, y, z = DRAWER
    body = block((-x / 2, 0, 0), (x / 2, y, z)) + block((-92, -5, 0), (80, 0, z))
    body += block((-30, -64, 8), (30, -42, 30))
    body += block((-28, -43, 14), (-18, -4, 26)) + block((18, -43, 14), (28, -4, 26))
    eye = block((ROD[0] - 9, ROD[1] + DEEP / 2 - 9, 10), (ROD[0] + 9, -4, 22))
    return body + eye - cylinder(5.2, 9, 23, (ROD[0], ROD[1] + DEEP / 2), 24)


def cartridge() -> Solid:
    """A block with a handle; it stands on z = 0."""
    x, y, z = CARTRIDGE
    return rounded_block((-x / 2, -y / 2, 0), (x / 2, y / 2, z), 4) + block((-6, -20, z), (6, 20, z + 16))


def fan() -> Solid:
    """A round insert along z: a spigot below a rim, with a grip on top."""
    return (
        cylinder(17.8, -14.0, 0.0, segments=48)
        + cylinder(23.0, 0.0, 5.0, segments=48)
        + block((-7, -14, 5), (7, 14, 22))
    )


def cabinet() -> Assembly:
    """The product."""
    drawing = Drawing("cabinet", "instrument cabinet with drawers", (0.19, 0.22, 0.0))
    x, y, z = DRAWER
    front = -DEEP / 2
    housing = rounded_block((-WIDE / 2, front, 0), (WIDE / 2, DEEP / 2, EDGE), 4)
    shoulder = block((-WIDE / 2 + 10, front + 20, EDGE), (WIDE / 2 - 10, DEEP / 2 - 10, HIGH))
    housing += shoulder
    for floor in DRAWERS:
        housing -= block((-x / 2 - PLAY, front - 1, floor), (x / 2 + PLAY, front + y + 1, floor + z + 2 * PLAY))
    housing += block((ROD[0] - 9, front - 21, 0), (ROD[0] + 9, front + 2, 68.0))
    housing -= cylinder(5.2, 64.0, 69.0, ROD, 24)
    for place, lean in SLOTS:
        slot = block(
            (-CARTRIDGE[0] / 2 - PLAY, -CARTRIDGE[1] / 2 - PLAY, -SUNK),
            (CARTRIDGE[0] / 2 + PLAY, CARTRIDGE[1] / 2 + PLAY, 80),
        )
        housing -= slot.rotate([0, lean, 0]).translate([place, 5, HIGH])
    for place in FANS:
        housing -= along_y(cylinder(18.0, 0.0, 15.0, segments=48)).translate([place, DEEP / 2 - 14.2, FAN_HEIGHT])
    drawing.add("housing", housing, ALUMINIUM, fixed=True)
    for number, floor in enumerate(DRAWERS, 1):
        drawing.add(f"drawer-{number}", drawer(), PLASTIC, (0, front - 0.1, floor))
    drawing.add("rod", cylinder(5.0, 64.0, 172.0, ROD, 24) + cylinder(9.0, 172.0, 186.0, ROD, 24), STEEL)
    for number, (place, lean) in enumerate(SLOTS, 1):
        down = math.radians(lean)
        at = (place - SUNK * math.sin(down), 5.0, HIGH - SUNK * math.cos(down))
        drawing.add(f"cartridge-{number}", cartridge(), PLASTIC, at, about_y(lean))
    for number, place in enumerate(FANS, 1):
        drawing.add(f"fan-{number}", along_y(fan()), PLASTIC, (place, DEEP / 2, FAN_HEIGHT - 0.2))
    return drawing.assembly()
