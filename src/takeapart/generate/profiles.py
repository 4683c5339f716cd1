"""The paper's generator of aluminium-profile assemblies (Sec. IV-A).

A base of twelve bars, two supports along z, and layers of bars in the plane: a frame, bars at the back, bars at the
front. Everything random comes from the generator that is handed in; candidate k of a seed has its own
(`candidate_rng`), so any candidate can be made again without those before it.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from typing import Literal

import numpy as np

from takeapart.generate.profile_layout import (
    BAR,
    END_GAP,
    WALL_LENGTH,
    Bar,
    Layout,
    Segment,
    joints_of,
    level_bar,
    upright_bar,
)
from takeapart.model.assembly import MAXIMUM_PARTS, Assembly
from takeapart.model.errors import InputError

LEVEL_DISTANCE = 0.10  # m, least height from one level of bars to the next: bar, connectors, and a lift of 5 cm
BASE_PARTS = 18  # base structure, two supports, four carriers
FRAME_PARTS = 4
SUPPORTS = ("support_0", "support_1")

Region = Literal["back", "front"]
OrderFinder = Callable[[Assembly], tuple[str, ...] | str]
"""Finds a feasible order of the removable parts, or says in a few words why there is none."""


@dataclass(frozen=True)
class ProfileOptions:
    """What to generate; defaults give the paper's single-layer assemblies (Sec. VI).

    Args:
        layers: levels of bars between bottom and top; they share the height evenly.
        back, front: bars added behind the support in the front, and ahead of the support in the back, in each layer.
        length, width, height: of the base structure along x, y, z, m. The paper's: 0.40, 0.40, 0.60.
        minimum_length: eps_p, least length of a bar between two others, m. The paper gives no value.
        spacing: eps_g, least distance between the centre lines of parallel bars at one height, m. The paper gives no
            value; 0.08 never fits seven bars into a layer.
        clearance: least distance of supports, carriers, back and front bars to bodies that no connector joins them to,
            m, so that a part can be lifted past another.
        attempts: draws for one bar before the candidate is given up.

    Raises:
        InputError: a value out of range; the message says what is valid.
    """

    layers: int = 1
    back: int = 4
    front: int = 3
    length: float = 0.40
    width: float = 0.40
    height: float = 0.60
    minimum_length: float = 0.10
    spacing: float = 0.055
    clearance: float = 0.002
    attempts: int = 200

    def __post_init__(self) -> None:
        for name, least in (("layers", 1), ("back", 0), ("front", 0), ("attempts", 1)):
            value = getattr(self, name)
            if type(value) is not int or value < least:
                raise InputError(f"{value!r}; must be an integer of at least {least}", f"options.{name}")
        for entry in fields(self):
            value = getattr(self, entry.name)
            if entry.type == "float" and (type(value) not in (float, int) or not math.isfinite(value)):
                raise InputError(f"{value!r}; must be a finite number, m", f"options.{entry.name}")
        self._check_lengths()
        parts = BASE_PARTS + self.layers * (FRAME_PARTS + self.back + self.front)
        if parts > MAXIMUM_PARTS:
            raise InputError(f"{parts} bars; at most {MAXIMUM_PARTS} are allowed", "options.layers")

    def _check_lengths(self) -> None:
        # A bar must leave room between its connectors for a gripper; neighbours must leave room for both connectors.
        limits = {
            "minimum_length": (2 * WALL_LENGTH + BAR, 10.0),
            "spacing": (2 * BAR, 10.0),
            "clearance": (0.0, 0.01),
            "length": (2 * self.minimum_length + BAR, 20.0),
            "width": (2 * self.minimum_length + BAR, 20.0),
            "height": (LEVEL_DISTANCE * (self.layers + 1), 20.0),
        }
        for name, (least, most) in limits.items():
            value = getattr(self, name)
            if not least - 1e-9 <= value <= most:
                raise InputError(f"{value} m; must be from {least:g} to {most:g} m here", f"options.{name}")

    def level(self, layer: int) -> float:
        """Height of the centre lines of a layer, m."""
        return self.height * (layer + 1) / (self.layers + 1)


@dataclass(frozen=True)
class Rejected:
    """A candidate that came to nothing, and why."""

    reason: str


@dataclass(frozen=True)
class Generated:
    """A feasible assembly, and what it took to find it.

    Args:
        assembly: with witness and provenance.
        candidate: number of the candidate that it came from.
        rejections: how many candidates before it were rejected, by reason.
    """

    assembly: Assembly
    candidate: int
    rejections: dict[str, int]


def candidate_rng(seed: int, candidate: int) -> np.random.Generator:
    """The generator that candidate number `candidate` of a seed is drawn from."""
    return np.random.default_rng([seed, candidate])


def generate(
    options: ProfileOptions, seed: int, order_finder: OrderFinder, name: str, maximum_candidates: int = 1000
) -> Generated:
    """Draws candidates until one has a feasible order; that order becomes the assembly's witness.

    Raises:
        InputError: no candidate out of `maximum_candidates` was feasible; the message counts the reasons.
    """
    if type(seed) is not int or seed < 0:
        raise InputError(f"{seed!r}; must be an integer of at least 0", "seed")
    rejections: Counter[str] = Counter()
    for candidate in range(maximum_candidates):
        drawn = generate_candidate(options, candidate_rng(seed, candidate), name)
        if isinstance(drawn, Rejected):
            rejections[drawn.reason] += 1
            continue
        order = order_finder(drawn)
        if isinstance(order, str):
            rejections[order] += 1
            continue
        provenance: dict[str, object] = {
            "generator": "takeapart.profiles",
            "options": asdict(options),
            "seed": seed,
            "candidate": candidate,
            "rejections": dict(rejections),
        }
        return Generated(replace(drawn, witness=order, provenance=provenance), candidate, dict(rejections))
    counts = ", ".join(f"{reason}: {count}" for reason, count in rejections.most_common()) or "none was drawn"
    raise InputError(f"no feasible assembly among {maximum_candidates} candidates ({counts})", name)


def generate_candidate(options: ProfileOptions, rng: np.random.Generator, name: str) -> Assembly | Rejected:
    """One assembly as Sec. IV-A draws it, whether a robot can take it apart or not; without a witness."""
    layout = _with_supports(options, _base(options), rng)
    if layout is None:
        return Rejected("no room for the supports")
    order: list[tuple[Region, int]] = [("back", i) for i in range(options.back)]
    order += [("front", i) for i in range(options.front)]
    for layer in range(options.layers):
        layout = _with_frame(options, layout, layer)
        for region, number in order:
            extended = _with_bar(options, layout, layer, region, number, rng)
            if extended is None:
                return Rejected(f"no room for a {region} bar")
            layout = extended
    return layout.assembly(name)


def _joined(layout: Layout, bar: Bar, hosts: tuple[str, str]) -> Layout:
    return layout.placed(bar, joints_of(bar, hosts))


def _base(options: ProfileOptions) -> Layout:
    """Bottom and top square and the four columns: twelve bars (Fig. 4a)."""
    layout = Layout()
    half = BAR / 2
    squares = (("bottom", half, True), ("top", options.height - half, False))
    for square, height, fixed in squares:
        whole = Segment(-END_GAP, options.width + END_GAP, ("", ""))
        for side, x in (("front", half), ("back", options.length - half)):
            layout = layout.placed(level_bar(f"{square}_{side}", 1, x, height, whole, fixed), ())
        between = Segment(BAR, options.length - BAR, (f"{square}_front", f"{square}_back"))
        for side, y in (("left", options.width - half), ("right", half)):
            layout = _joined(layout, level_bar(f"{square}_{side}", 0, y, height, between, fixed), between.hosts)
    for end, x in (("front", half), ("back", options.length - half)):
        for side, y in (("left", options.width - half), ("right", half)):
            column = upright_bar(f"column_{end}_{side}", x, y, BAR, options.height - BAR, fixed=end == "back")
            layout = _joined(layout, column, (f"bottom_{end}", f"top_{end}"))
    return layout


def _with_supports(options: ProfileOptions, layout: Layout, rng: np.random.Generator) -> Layout | None:
    """Two bars along z, one in each half of y, each carried at bottom and top by a bar in the plane (Fig. 4b, 4c)."""
    least, middle = options.minimum_length, options.width / 2
    for _ in range(options.attempts):
        places = [
            (float(rng.uniform(least, options.length - least)), float(rng.uniform(low, high)))
            for low, high in ((least, middle), (middle, options.width - least))
        ]
        axes = rng.integers(2, size=4).tolist()  # of the carriers: 0 along x, 1 along y
        if math.dist(*places) >= options.spacing:
            extended = _carried(options, layout, places, axes)
            if extended is not None:
                return extended
    return None


def _carried(
    options: ProfileOptions, layout: Layout, places: list[tuple[float, float]], axes: list[int]
) -> Layout | None:
    """The supports at the given places on carriers of the given directions, or None where something is in the way."""
    names = [(square, i) for square in ("bottom", "top") for i in range(2)]
    for (square, i), axis in zip(names, axes, strict=True):
        height = BAR / 2 if square == "bottom" else options.height - BAR / 2
        along, across = places[i][axis], places[i][1 - axis]
        for segment in layout.segments(axis, across, height):
            if segment.lower < along < segment.upper:  # cut where it meets another carrier: the stretch at the support
                break
        else:
            return None
        carrier = level_bar(f"carrier_{square}_{i}", axis, across, height, segment, fixed=square == "bottom")
        if not layout.spaced(axis, across, height, options.spacing) or not _fits(
            options, layout, carrier, segment.hosts
        ):
            return None
        layout = _joined(layout, carrier, segment.hosts)
    for i, (x, y) in enumerate(places):
        support = upright_bar(f"support_{i}", x, y, BAR, options.height - BAR)
        hosts = (f"carrier_bottom_{i}", f"carrier_top_{i}")
        if not _fits(options, layout, support, hosts):
            return None
        layout = _joined(layout, support, hosts)
    return layout


def _fits(options: ProfileOptions, layout: Layout, bar: Bar, hosts: tuple[str, str]) -> bool:
    joints = joints_of(bar, hosts)
    return (
        bar.length >= options.minimum_length
        and layout.meets(bar, joints)
        and layout.clear(bar, joints, options.clearance)
    )


def _with_frame(options: ProfileOptions, layout: Layout, layer: int) -> Layout:
    """Four bars between the columns (Sec. IV-A a)."""
    height, half = options.level(layer), BAR / 2
    for side, x in (("front", half), ("back", options.length - half)):
        between = Segment(BAR, options.width - BAR, (f"column_{side}_right", f"column_{side}_left"))
        layout = _joined(layout, level_bar(f"frame_{layer}_{side}", 1, x, height, between), between.hosts)
    for side, y in (("left", options.width - half), ("right", half)):
        between = Segment(BAR, options.length - BAR, (f"column_front_{side}", f"column_back_{side}"))
        layout = _joined(layout, level_bar(f"frame_{layer}_{side}", 0, y, height, between), between.hosts)
    return layout


def _with_bar(
    options: ProfileOptions, layout: Layout, layer: int, region: Region, number: int, rng: np.random.Generator
) -> Layout | None:
    """One more bar at the back or in the front of a layer (Sec. IV-A b, c), or None after too many draws."""
    height = options.level(layer)
    lonely = _lonely_supports(layout, height)
    for _ in range(options.attempts):
        axis = int(rng.integers(2))
        across = _line(options, layout, lonely, region, axis, rng)
        if not layout.spaced(axis, across, height, options.spacing):
            continue
        segments = layout.segments(axis, across, height)
        if len(segments) > 1:  # an uncut bar is added as it is, even if it reaches beyond the support
            segments = [segment for segment in segments if _allowed(options, layout, region, axis, segment)]
        if not segments:
            continue
        segment = segments[int(rng.integers(len(segments)))]
        bar = level_bar(f"{region}_{layer}_{number}", axis, across, height, segment)
        if _fits(options, layout, bar, segment.hosts):
            return _joined(layout, bar, segment.hosts)
    return None


def _lonely_supports(layout: Layout, height: float) -> list[Bar]:
    """The supports that no bar at this height is joined to yet."""
    joined = {
        joint.host
        for joint in layout.joints
        if layout.bars[joint.guest].axis != 2 and abs(layout.bars[joint.guest].centre[2] - height) < BAR
    }
    return [layout.bars[name] for name in SUPPORTS if name not in joined]


def _line(
    options: ProfileOptions, layout: Layout, lonely: list[Bar], region: Region, axis: int, rng: np.random.Generator
) -> float:
    """Coordinate across a new bar's direction, m: that of a support that nothing is joined to yet, or a free one."""
    if lonely and rng.random() < 0.5:
        return lonely[int(rng.integers(len(lonely)))].centre[1 - axis]
    if axis == 0:
        return float(rng.uniform(options.spacing, options.width - options.spacing))
    reference = _reference(layout, region)
    if region == "back":
        return float(rng.uniform(reference, options.length - options.spacing))
    return float(rng.uniform(options.spacing, reference))


def _allowed(options: ProfileOptions, layout: Layout, region: Region, axis: int, segment: Segment) -> bool:
    """Whether a stretch is long enough and lies wholly on the right side of the reference support."""
    if segment.upper - segment.lower - 2 * END_GAP < options.minimum_length:
        return False
    if axis == 1:
        return True  # its x was drawn on the right side
    reference = _reference(layout, region)
    return segment.lower >= reference if region == "back" else segment.upper <= reference


def _reference(layout: Layout, region: Region) -> float:
    """x of the support that bounds a region: for the back the one in the front, for the front the one in the back."""
    x = [layout.bars[name].centre[0] for name in SUPPORTS]
    return min(x) if region == "back" else max(x)
