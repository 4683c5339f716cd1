"""A planetary gearset: a ring gear with a floor, a carrier, four planets on pins, a hollow sun, a top plate, caps."""

from __future__ import annotations

import math

from takeapart.generate.products.drawing import ALUMINIUM, BRONZE, STEEL, Drawing, about_z
from takeapart.generate.products.solids import Solid, cylinder, extruded, gear_outline, tube
from takeapart.model.assembly import Assembly

MODULE, SUN, PLANET, BACKLASH = 2.0, 24, 18, 0.4  # mm, teeth, mm
RING = SUN + 2 * PLANET  # teeth
ARM = MODULE * (SUN + PLANET) / 2  # mm, from the axis to a planet's
COUNT = 4  # of planets
PINS = 10.0  # mm, height of their lower ends, in the carrier
FLOOR, CARRIER, FACE, HUB, PLATE = 8.0, 14.0, 28.0, 42.0, 49.0  # mm, heights up to which these reach


def planet_turn(place: float) -> float:
    """By how much a planet at an angle is turned so that its teeth meet the sun's, degrees; the sun's first tooth and a
    gap of the ring look along x."""
    return place + 180.0 + place * SUN / PLANET - 180.0 / PLANET


def gear(teeth: int, hub: float, bore: float, height: float) -> Solid:
    """A gear with a hub on top and a bore."""
    rim = extruded(gear_outline(MODULE, teeth, BACKLASH), 0.0, FACE - CARRIER)
    return rim + cylinder(hub, 0.0, height) - cylinder(bore, -1.0, height + 1)


def planetary() -> Assembly:
    """The product."""
    drawing = Drawing("planetary", "planetary gearset", (0.16, 0.20, 0.0))
    teeth = extruded(gear_outline(MODULE, RING, BACKLASH, inner=True), FLOOR, FACE + 1).rotate([0, 0, 180.0 / RING])
    ring = cylinder(72.0, 0.0, FACE, segments=64) - teeth - cylinder(8.0, 1.0, FLOOR + 1)
    drawing.add("ring", ring, STEEL, fixed=True)
    places = [360.0 * k / COUNT for k in range(COUNT)]
    centres = [(ARM * math.cos(math.radians(place)), ARM * math.sin(math.radians(place))) for place in places]
    carrier = cylinder(53.0, FLOOR, CARRIER, segments=48) + cylinder(9.0, FLOOR, 68.0)
    carrier += cylinder(7.85, 3.0, FLOOR)
    top = cylinder(53.0, HUB, PLATE, segments=48) - cylinder(9.2, HUB - 1, PLATE + 1)
    top += tube(16.0, 9.2, PLATE, 60.0)
    for at in centres:
        carrier -= cylinder(6.1, PINS, CARRIER + 1, at, 24)
        top -= cylinder(6.15, HUB - 1, PLATE + 1, at, 24)
    drawing.add("carrier", carrier, ALUMINIUM)
    pin = cylinder(6.0, 0.0, 64.0 - PINS, segments=24)
    cap = cylinder(9.0, 0.0, 20.0, segments=24) - cylinder(6.15, -1.0, 64.0 - PLATE, segments=24)
    planet = gear(PLANET, 11.0, 6.15, HUB - CARRIER)
    drawing.add("sun", gear(SUN, 14.0, 9.2, 41.0 - CARRIER), STEEL, (0, 0, CARRIER))
    for number, (place, (x, y)) in enumerate(zip(places, centres, strict=True), 1):
        drawing.add(f"pin-{number}", pin, STEEL, (x, y, PINS))
        drawing.add(f"planet-{number}", planet, BRONZE, (x, y, CARRIER), about_z(planet_turn(place)))
        drawing.add(f"cap-{number}", cap, STEEL, (x, y, PLATE))
    drawing.add("top-plate", top, ALUMINIUM)
    return drawing.assembly()
