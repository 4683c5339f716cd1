"""Charts of the report as inline SVG: no script, sharp in print, as wide as the page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from takeapart.formats.bound_texts import STRAIGHT_LINE
from takeapart.model.assembly import Assembly
from takeapart.show.markup import Markup, element
from takeapart.states import members

WIDTH, GRAPH_WIDTH = 400, 348  # units of the drawings: text of 14 (12) of them has 11 pixels on a telephone too
LENGTH, BAND, INK, GRID = "#2f6fb0", "#f2d0ab", "#39424e", "#e3e7ec"
BEST_PLAN = "Blue: length of the best plan so far, m."
BAND_NOTE = (
    "Orange: what another order could still save with the paths known at that moment. Refinement plans removals again "
    "with other random numbers; each shorter path may open the band anew."
)


@dataclass(frozen=True)
class Bar:
    """One row of a bar chart: a label, a length and its bound, m, and a colour."""

    label: str
    value: float
    bound: float
    color: str


def bars(rows: Sequence[Bar]) -> Markup:
    """Lengths as horizontal bars; a line across each marks the bound below which it cannot be."""
    height, top, width = 26, 8, WIDTH
    left = min(210.0, 7.8 * max((len(row.label) for row in rows), default=0) + 16)  # room for the longest label
    largest = max((max(row.value, row.bound) for row in rows), default=1.0) * 1.02
    scale = (width - left - 52) / largest
    parts = []
    for i, row in enumerate(rows):
        y = top + i * height
        end = left + max(row.value, row.bound) * scale
        parts += [
            _text(left - 10, y + 16, row.label, "end"),
            _box(left, y + 4, row.value * scale, 16, row.color, rx=3),
            _line(left + row.bound * scale, y + 1, left + row.bound * scale, y + 23, INK, stroke_width=2),
            _text(end + 8, y + 16, f"{row.value:.3f}"),
        ]
    return _svg(width, top + len(rows) * height + 6, parts, "Length of every step, with its bound")


def progress(
    history: Sequence[Sequence[float | None]], floor: float = 0.0, proved_after: float | None = None
) -> Markup:
    """How the best plan came about: its length, m, against removal queries, above what no plan can be shorter than.

    The sequence bound moves with the paths that are known: a shorter one found later lowers it, so that it is no bound
    of what the search ends with. What it says at its moment is how much another order could have saved then; that is
    drawn, as a band below the best plan of the same moment.

    Args:
        history: rows of queries, length of the best plan and sequence bound, m; None where not known.
        floor: straight-line bound of the plan, m; 0 where there is none.
        proved_after: queries after which the order was proved for the first time; what follows is refinement.
    """
    width, height, left, right, top, bottom = WIDTH, 260, 52, 88, 30, 44
    rows = [(float(row[0] or 0), float(row[1]), row[2]) for row in history if row[1] is not None]
    if not rows:
        return Markup()
    bands = [min(length, length if bound is None else float(bound)) for _, length, bound in rows]
    values = [length for _, length, _ in rows] + bands + ([floor] if floor else [])
    low, high = min(values), max(values)
    margin = max(0.08 * (high - low), 0.01)
    low, high = low - margin, high + margin
    end = max(float(history[-1][0] or 0), 1.0)

    def x(queries: float) -> float:
        return left + queries / end * (width - left - right)

    def y(value: float) -> float:
        return top + (high - value) / (high - low) * (height - top - bottom)

    parts = []
    for value in _ticks(low, high):
        parts.append(_line(left, y(value), width - right, y(value), GRID))
        parts.append(_text(left - 8, y(value) + 5, f"{value:g}", "end"))
    for value in _ticks(0, end):
        parts.append(_text(x(value), height - bottom + 20, f"{value:g}", "middle"))
    parts.append(_text((left + width - right) / 2, height - 6, "removal queries", "middle"))
    parts.append(_text(left - 8, top - 12, "m", "end"))
    if proved_after is not None and 0 <= proved_after < end:
        at = x(proved_after)
        parts.append(_line(at, top, at, height - bottom, INK, stroke_dasharray="3 4"))
        parts.append(_text(at + 6, top - 12, "refinement"))
    for (queries, length, _), band, following in zip(rows, bands, [*(row[0] for row in rows[1:]), end], strict=True):
        if band < length and following > queries:
            across, down = x(following) - x(queries), y(band) - y(length)
            parts.append(_box(x(queries), y(length), across, down, BAND, shape_rendering="crispEdges"))
    line = f"M{x(rows[0][0]):.2f} {y(rows[0][1]):.2f}"
    for queries, length, _ in rows[1:]:
        line += f"H{x(queries):.2f}V{y(length):.2f}"
    named = [(f"{line}H{x(end):.1f}", rows[-1][1], LENGTH, "best plan")]
    if floor:
        named.append((f"M{left} {y(floor):.2f}H{x(end):.2f}", floor, INK, "bound"))
    for path, value, color, name in named:
        parts.append(element("path", d=path, fill="none", stroke=color, stroke_width=2.5, stroke_linejoin="round"))
        parts.append(_text(width - right + 6, y(value) + 5, name, fill=color, class_="name"))
    return _svg(width, height, parts, "Length of the best plan against removal queries, above its bound")


def progress_note(history: Sequence[Sequence[float | None]], floor: float = 0.0) -> str:
    """What stands below the chart of `progress`."""
    words = [BEST_PLAN]
    if floor:
        words.append(f"Bound: {STRAIGHT_LINE}.")
    if any(row[1] is not None and row[2] is not None for row in history):
        words.append(BAND_NOTE)
    return " ".join(words)


def graph(assembly: Assembly, edges: Sequence[tuple[int, int, str]], colors: Sequence[str]) -> Markup:
    """Which part must wait for which: parts that can leave first stand on top, lines lead down to those that wait."""
    parts = members(assembly.root)
    before = {part: [other for waiting, other, _ in edges if waiting == part] for part in parts}
    level: dict[int, int] = {}

    def level_of(part: int, path: frozenset[int] = frozenset()) -> int:
        if part not in level:
            others = [other for other in before[part] if other not in path]
            level[part] = 1 + max((level_of(other, path | {part}) for other in others), default=-1)
        return level[part]

    for part in parts:
        level_of(part)
    width, row_height, chip, gap = GRAPH_WIDTH, 60, 22, 6
    rows: list[list[int]] = []
    for depth in range(max(level.values(), default=0) + 1):
        row: list[int] = []
        used = 0.0
        wanted = [part for part in parts if level[part] == depth]
        place = {part: n for row_above in rows for n, part in enumerate(row_above)}
        wanted.sort(key=lambda p: sum(place.get(o, 0) for o in before[p]) / max(len(before[p]), 1))
        for part in wanted:
            size = _chip_width(assembly.parts[part].name)
            if row and used + size > width - 20:
                rows.append(row)
                row, used = [], 0.0
            row.append(part)
            used += size + gap
        rows.append(row)
    center: dict[int, tuple[float, float]] = {}
    for number, row in enumerate(rows):
        total = sum(_chip_width(assembly.parts[part].name) for part in row) + gap * (len(row) - 1)
        at = (width - total) / 2
        for part in row:
            size = _chip_width(assembly.parts[part].name)
            center[part] = (at + size / 2, 18 + number * row_height)
            at += size + gap
    drawn = []
    for waiting, other, why in edges:
        (x1, y1), (x2, y2) = center[other], center[waiting]
        y1, y2 = y1 + chip / 2, y2 - chip / 2
        bend = (y2 - y1) / 2
        curve = f"M{x1:.0f} {y1:.0f}C{x1:.0f} {y1 + bend:.0f} {x2:.0f} {y2 - bend:.0f} {x2:.0f} {y2:.0f}"
        dash = "4 3" if why == "lift" else None
        drawn.append(element("path", d=curve, fill="none", stroke="#9aa5b1", stroke_width=1.4, stroke_dasharray=dash))
    for part, (x, y) in center.items():
        name, size = assembly.parts[part].name, _chip_width(assembly.parts[part].name)
        drawn.append(_box(x - size / 2, y - chip / 2, size, chip, colors[part], rx=11))
        drawn.append(_text(x, y + 4, name, "middle", class_="chip"))
    widest = max((sum(_chip_width(assembly.parts[p].name) + gap for p in row) for row in rows), default=0.0)
    room = max(width, widest)  # a single name may be wider than a row
    view = f"{(width - room) / 2:g} 0 {room:g} {18 + (len(rows) - 1) * row_height + chip:g}"
    return _picture(view, drawn, "Which part waits for which")


def _chip_width(name: str) -> float:
    return 6.6 * len(name) + 16


def _ticks(low: float, high: float) -> list[float]:
    """About five round numbers between two."""
    step = 10 ** math.floor(math.log10((high - low) / 4))
    step *= next(factor for factor in (1, 2, 5, 10) if (high - low) / (step * factor) <= 6)
    first = math.ceil(low / step)
    return [round(step * k, 10) for k in range(first, math.floor(high / step) + 1)]


def _text(x: float, y: float, text: object, anchor: str | None = None, **attributes: object) -> Markup:
    return element("text", text, x=_pixels(x), y=_pixels(y), text_anchor=anchor, **attributes)


def _line(x1: float, y1: float, x2: float, y2: float, color: str, **attributes: object) -> Markup:
    ends = {"x1": _pixels(x1), "x2": _pixels(x2), "y1": _pixels(y1), "y2": _pixels(y2)}
    return element("line", stroke=color, **ends, **attributes)


def _box(x: float, y: float, width: float, height: float, color: str, **attributes: object) -> Markup:
    edges = {"x": _pixels(x), "y": _pixels(y), "width": _pixels(width), "height": _pixels(height)}
    return element("rect", fill=color, **edges, **attributes)


def _pixels(value: float) -> str:
    return f"{round(value, 1):g}"


def _svg(width: float, height: float, content: Sequence[Markup], title: str) -> Markup:
    return _picture(f"0 0 {width:g} {height:g}", content, title)


def _picture(view: str, content: Sequence[Markup], title: str) -> Markup:
    return element("svg", *content, viewBox=view, role="img", aria_label=title, xmlns="http://www.w3.org/2000/svg")
