"""A gearbox of two stages: a base plate, three upright shafts in bearings, spur gears, a bell-shaped cover, screws."""

from __future__ import annotations

from takeapart.generate.products.drawing import ALUMINIUM, BRASS, STEEL, Drawing, about_z
from takeapart.generate.products.solids import (
    Solid,
    block,
    cap_screw,
    cylinder,
    extruded,
    gear_outline,
    hexagon_screw,
    rounded_block,
    tube,
)
from takeapart.model.assembly import Assembly

MODULE, SMALL, LARGE, BACKLASH = 2.0, 18, 32, 0.3  # mm, teeth of pinions and wheels, mm
APART = MODULE * (SMALL + LARGE) / 2  # mm, between shafts
SHAFTS = {"input": -APART, "middle": 0.0, "output": APART}  # x, mm
BORE, JOURNAL, RACE, SEAT = 6.0, 5.9, 16.0, 16.15  # mm, radii of bearings and of what they fit
FLOOR, PLATE, BOSS = 15.0, 14.0, 18.0  # mm, heights: under the bearings, of the plate, of the seats' rims
COLLAR, GEARS, SHOULDER = (
    27.0,
    31.0,
    67.0,
)  # mm, heights: on the lower bearings, under the gears, under the upper bearings
SCREWS = [(x, y) for x in (-76.0, 4.0, 84.0) for y in (-64.0, 64.0)]  # mm
FLANGE, COLUMNS = 22.0, 70.0  # mm, heights of their tops: the flange's, and of the columns through which screws go


def bearing() -> Solid:
    """A ball bearing with covers, 12 mm high."""
    groove = tube(13.0, 9.5, 0.0, 2.0, 48)
    return tube(RACE, BORE, 0.0, 12.0, 48) - groove.translate([0, 0, -0.5]) - groove.translate([0, 0, 10.5])


def shaft(end: float) -> Solid:
    """A shaft with a flat for its gears, from the lower bearing to a height."""
    seat = cylinder(8.0, GEARS, SHOULDER) - block((6.5, -9.0, GEARS), (9.0, 9.0, SHOULDER))
    return (
        cylinder(JOURNAL, FLOOR + 0.5, COLLAR) + cylinder(10.0, COLLAR, GEARS) + seat + cylinder(JOURNAL, SHOULDER, end)
    )


def bore(bottom: float, top: float) -> Solid:
    """What fits over the shaft's seat."""
    return cylinder(8.15, bottom, top) - block((6.65, -9.0, bottom), (9.0, 9.0, top))


def gear(teeth: int, face: float, hub: float, height: float, turn: float = 0.0) -> Solid:
    """A gear with a hub on top of it, its teeth turned by some degrees."""
    rim = extruded(gear_outline(MODULE, teeth, BACKLASH), 0.0, face).rotate([0, 0, turn])
    return rim + cylinder(hub, 0.0, height) - bore(-1, height + 1)


def cover() -> Solid:
    """A bell with a flange, seats for the upper bearings, and a rib to hold it by."""
    wall = rounded_block((-81, -45, PLATE), (95, 45, 88), 14)
    flange = rounded_block((-90, -78, PLATE), (98, 78, FLANGE), 14)
    inside = rounded_block((-76, -40, PLATE - 1), (90, 40, 72), 9)
    body = wall + flange - inside
    for name, x in SHAFTS.items():
        body -= cylinder(SEAT, 71, SHOULDER + 12.3, (x, 0), 48)
        if name != "middle":
            body -= cylinder(7.5, 70, 90, (x, 0))
    body += block((-32, -7, 88), (32, 7, 112))
    body -= cylinder(8.15, 70, 90, (0, 30), 24)
    for x, y in SCREWS:
        web = block((x - 4, min(y, 0.66 * y), FLANGE - 1), (x + 4, max(y, 0.66 * y), COLUMNS - 14))
        body += cylinder(9.0, FLANGE - 1, COLUMNS, (x, y)) + web
        body -= cylinder(4.3, PLATE - 1, COLUMNS + 1, (x, y), 24)
    return body


def gearbox() -> Assembly:
    """The product."""
    drawing = Drawing("gearbox", "two-stage spur gearbox", (0.16, 0.19, 0.0), turn=90.0)
    plate = rounded_block((-96, -80, 0), (104, 80, PLATE), 16)
    for x in SHAFTS.values():
        plate += cylinder(21.0, PLATE - 1, BOSS, (x, 0), 48)
    for x in SHAFTS.values():
        plate -= cylinder(SEAT, FLOOR, BOSS + 1, (x, 0), 48)
    for at in SCREWS:
        plate -= cylinder(4.15, 2, PLATE + 1, at, 24)
    drawing.add("base", plate, ALUMINIUM, fixed=True)
    for name, x in SHAFTS.items():
        drawing.add(f"{name}-bearing-lower", bearing(), STEEL, (x, 0, FLOOR))
        drawing.add(f"{name}-shaft", shaft(78.5 if name == "middle" else 118.0), STEEL, (x, 0, 0))
    drawing.add("input-pinion", gear(SMALL, 20, 12, 20), STEEL, (SHAFTS["input"], 0, GEARS))
    drawing.add("input-spacer", tube(11, 8.15, 0, 15.9), BRASS, (SHAFTS["input"], 0, GEARS + 20))
    wheel = gear(LARGE, 12, 14, 18, turn=180.0 / LARGE)
    drawing.add("middle-wheel", wheel, STEEL, (0, 0, GEARS))
    drawing.add("middle-pinion", gear(SMALL, 17.9, 12, 17.9), STEEL, (0, 0, GEARS + 18))
    drawing.add("output-spacer", tube(11, 8.15, 0, 18), BRASS, (SHAFTS["output"], 0, GEARS))
    drawing.add("output-wheel", wheel, STEEL, (SHAFTS["output"], 0, GEARS + 18))
    for name, x in SHAFTS.items():
        drawing.add(f"{name}-bearing-upper", bearing(), STEEL, (x, 0, SHOULDER))
    drawing.add("cover", cover(), ALUMINIUM)
    drawing.add("oil-plug", cap_screw(8.0, 9.0, 11.0, 12.0), BRASS, (0, 30, 88))
    for number, (x, y) in enumerate(SCREWS, 1):
        screw = hexagon_screw(4.0, COLUMNS - 4.0, 13.0, 12.0)
        drawing.add(f"screw-{number}", screw, STEEL, (x, y, COLUMNS), about_z(30.0))
    return drawing.assembly()
