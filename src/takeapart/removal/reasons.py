"""Why a part cannot leave, with numbers and names; worked out only when somebody asks.

A refusal (`Blocked`) is cheap: a stage and the removable parts to blame. What never leaves is one nameless body to the
planner. Here the question is put again to a planner for which every body has a number of its own: fixed parts and
obstacles too are then named by the same masks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Literal

import numpy as np

from takeapart.model.assembly import Assembly, Part
from takeapart.model.geometry import Array, Box, OrientedBox
from takeapart.removal.exits import Exit, ExitRule
from takeapart.removal.grasps import LEAST_CONTACT, MeshGrasps, Unholdable, found_on_mesh, is_box, ungraspable
from takeapart.removal.lifting import contact_height, lift_distance
from takeapart.removal.margins import PLANNING_MARGIN, padding, passing
from takeapart.removal.planner import RemovalPlanner
from takeapart.removal.result import Blocked, Stage
from takeapart.removal.wording import away, counted, in_all, listed, millimetres
from takeapart.robot.extent import Extent, arm_extent
from takeapart.states import members
from takeapart.workcell import GRAVITY

Cause = Literal["gravity", "lift", "weight", "slip", "width", "contact", "fingers", "hand", "reach", "arm", "path"]
ITSELF = "the part itself"
MOST_DIRECTIONS = 6  # told of a part that cannot get out
AT_ONCE = 1e-5  # m; what is hit sooner lies on the part
Numbers = tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class Reason:
    """A refusal in words for people and numbers for machines.

    Args:
        stage: where planning the removal ends.
        cause: what ends it there.
        text: one clause without the part's name.
        numbers: names and values of what the clause was made of, in m, kg and N, or counts.
        hits: bodies in the way by name, fixed parts and obstacles among them. At cause "lift": after how many m they
            are hit, the whole height where it only comes too close to them; at "hand" and "arm": in how many grasps, or
            ways to hold and lift the part.
        blamed: names of the removable parts that have to leave before; where no leaving helps, of what never leaves and
            is in the way; empty where nothing is.
    """

    stage: Stage
    cause: Cause
    text: str
    numbers: Numbers = ()
    hits: Numbers = ()
    blamed: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.text} (stage {self.stage})"


class _Bodies(Assembly):
    """Parts, fixed ones and obstacles alike, each with a number. All are known to be valid, and obstacles may overlap
    one another."""

    def __post_init__(self) -> None:
        pass


class _NamedExits:
    """The ways out that are known, for a planner to which what never leaves is as any other body: what a way hits of it
    is a blocker too. Nothing is measured again: a table of metres would want a field as fine as that of a screw.

    Args:
        exits: whose hits number parts, then obstacles.
    """

    def __init__(self, exits: ExitRule) -> None:
        self._exits = exits

    def exits(self, part: int) -> tuple[Exit, ...]:
        """As of the rule; what stays too near has no blockers still."""
        return tuple(
            way
            if way.near or way.blockers is not None
            else replace(way, blockers=sum(1 << body for body, _ in way.hits))
            for way in self._exits.exits(part)
        )


class Reasons:
    """Explains the refusals of one planner.

    Args:
        planner: that refused.
    """

    def __init__(self, planner: RemovalPlanner) -> None:
        self._planner, self._assembly, self._workcell = planner, planner.assembly, planner.workcell
        parts, obstacles = self._assembly.parts, self._workcell.environment
        known = {part.name for part in parts}
        self._bodies = [part.name for part in parts]  # and obstacles, of which several may have one name
        self._bodies += [f"obstacle {o.name}" if o.name in known else o.name for o in obstacles]
        self._permanent = (1 << len(self._bodies)) - 1 & ~self._assembly.root

    def of(self, blocked: Blocked, state: int) -> Reason:
        """The reason of a refusal.

        The stage is that of this state: where a refusal is known from a smaller one, it can be an earlier one.

        Args:
            blocked: what the planner, or gravity, answered.
            state: in which the part was to leave.
        """
        part, others = blocked.part, state & ~(1 << blocked.part)
        present = others | self._permanent
        if not self._planner.is_graspable(part):
            return self._ungraspable(part)
        if blocked.stage == "stability":
            names = self._names(blocked.blamed & others)
            return Reason("stability", "gravity", f"without it {listed(names)} would fall", blamed=names)
        if blocked.stage == "lift":
            return self._lift(blocked, present)
        work, reach = self._planner.workspace(), self._planner.reach
        hands = reach.hands(part, work)
        free = [k for k, hand in enumerate(hands) if hand.way is not None and not hand.way & others]
        if not free:
            return self._hand(blocked, present)
        reached = [k for k in free if reach.branches(part, k, others, work)]
        return self._path(blocked, present, reached) if reached else self._arm(blocked, present, free)

    @cached_property
    def extent(self) -> Extent:
        """Of the arm."""
        return arm_extent(self._planner.robot)

    @cached_property
    def named(self) -> RemovalPlanner:
        """The planner for which every body has a number of its own: parts as in the assembly, then obstacles."""
        parts = [replace(part, fixed=False) for part in self._assembly.parts]
        for obstacle in self._workcell.environment:
            shape = Box((2 * obstacle.box.half_extents).tolist())
            # A space, which no part's name has: it hosts no connector, whatever it is called.
            parts.append(Part(f"obstacle {obstacle.name}", shape, obstacle.box.T_frame_box, 1.0))
        permanent = [body.name for i, body in enumerate(parts) if self._permanent >> i & 1]
        bodies = _Bodies(
            self._assembly.name,
            tuple(parts),
            self._assembly.connectors,
            joints=self._assembly.joints,
            contact_gap=self._assembly.contact_gap,
            allowed_overlaps=(*self._assembly.allowed_overlaps, *combinations(permanent, 2)),
        )
        workcell = replace(self._workcell, environment=())
        exits = None if self._assembly.is_lifted else _NamedExits(self._planner.exits)
        return RemovalPlanner(bodies, workcell, self._planner.options, self._planner.robot, is_placed=True, exits=exits)

    def _names(self, mask: int) -> tuple[str, ...]:
        return tuple(dict.fromkeys(self._bodies[i] for i in members(mask)))

    def _blamed(self, blocked: Blocked, masks: Sequence[int]) -> tuple[str, ...]:
        return self._names(blocked.blamed or min(masks, key=int.bit_count, default=0))

    def _ungraspable(self, number: int) -> Reason:
        part, cell = self._assembly.parts[number], self._workcell
        cause = ungraspable(part, cell)
        if cause == "weight":
            excess = f"{part.mass - cell.payload:.3g} kg more than the payload of {cell.payload:.4g} kg"
            text = f"weighs {part.mass:.4g} kg, {excess}"
            return Reason("grasp", cause, text, (("mass", part.mass), ("payload", cell.payload)))
        if cause == "slip":
            text = (
                f"weighs {part.mass:.4g} kg and slips: two fingers that press with {cell.gripping_force:.4g} N at "
                f"friction {cell.friction:.3g} hold {cell.grip:.3g} kg"
            )
            numbers = (
                ("mass", part.mass),
                ("grip", cell.grip),
                ("weight", part.mass * GRAVITY),
                ("gripping_force", cell.gripping_force),
                ("friction", cell.friction),
            )
            return Reason("grasp", cause, text, numbers)
        opening = cell.description.maximum_opening
        if cause in ("contact", "fingers") or not is_box(part.shape):
            return _no_pinch(cause, found_on_mesh(part, cell), opening)
        width, other, _ = sorted((2 * part.shape.bounding_box().half_extents).tolist())
        text = (
            f"its narrowest side of {millimetres(width)} is {millimetres(width - opening)} wider than the fingers' "
            f"opening of {millimetres(opening)}"
        )
        return Reason("grasp", "width", text, (("width", width), ("other_width", other), ("opening", opening)))

    def _lift(self, blocked: Blocked, present: int) -> Reason:
        if not self._assembly.is_lifted:
            return self._exits(blocked, present)
        part, height = blocked.part, self._workcell.lift_height
        mask = (self.named.exits.exits(part)[0].blockers or 0) & present
        own = self._boxes(part)
        after: dict[str, float] = {}
        for i in members(mask):
            met = min(contact_height(box, height, other) for box in own for other in self._boxes(i))
            after[self._bodies[i]] = min(met, after.get(self._bodies[i], height))
        hits = sorted(after.items(), key=lambda hit: hit[1])
        least = {self._bodies[i]: lift_distance(own, height, self._boxes(i)) for i in members(mask)}
        kept = passing(self._workcell.clearance)
        told = [_meeting(name, met, height, least[name], kept) for name, met in hits]
        text = f"only straight up is tried: lifted by {millimetres(height)} it {listed(told)}"
        blamed = self._blamed(blocked, [mask & self._permanent])
        return Reason("lift", "lift", text, (("lift_height", height),), tuple(hits), blamed)

    def _exits(self, blocked: Blocked, present: int) -> Reason:
        """Every way out meets something: which, and after how far."""
        ways, told, first = self.named.exits.exits(blocked.part), [], dict[str, float]()
        for way in ways:
            hits = [(self._bodies[i], after) for i, after in way.hits if present >> i & 1]
            if hits and way.direction is not None:
                name, after = hits[0]
                told.append(f"{_direction(way.direction)} it hits {name} after {millimetres(after)}")
                for name, after in hits:
                    first[name] = min(after, first.get(name, after))
        hits = sorted(first.items(), key=lambda hit: hit[1])
        found = self._planner.exits.exits(blocked.part)
        for way in found:
            if way.near and not way.hits and way.direction is not None:
                name, distance = self._bodies[way.near[0][0]], way.near[0][1]
                kept = f"closer than the clearance of {millimetres(self._workcell.clearance)}"
                stays = f"stays within {millimetres(distance)} of {name}, {kept}"
                told.append(f"{_direction(way.direction)} it {stays}")
        kept = f"nearer than the clearance of {millimetres(self._workcell.clearance)} counts"
        ways_told = f"{'; '.join(told[:MOST_DIRECTIONS])} ({kept}; what touches as drawn may touch)"
        text = f"no straight way out is free: {ways_told}" if told else "no way out is free"
        pushes = max((way.pushes for way in found), default=0)
        text += f"; none found in {pushes} pushes" if pushes else ""
        blamed = self._blamed(blocked, [(way.blockers or 0) & self._permanent & present for way in ways])
        return Reason("lift", "lift", text, (("directions", len(ways)),), tuple(hits), blamed)

    def _boxes(self, body: int) -> list[OrientedBox]:
        """Of a body, in the world frame."""
        named = self.named.assembly
        return [box.moved(named.parts[body].T_world_part) for box in named.body(body)]

    def _hand(self, blocked: Blocked, present: int) -> Reason:
        """Every grasp has something in its way: other bodies, or the part that is gripped."""
        hands = self.named.reach.hands(blocked.part, self.named.workspace())
        masks = [hand.way & present for hand in hands if hand.way is not None]
        own = len(hands) - len(masks)
        counts, blamed = self._counts(masks), self._blamed(blocked, masks)
        text = f"the hand hits {counted(counts, len(masks), 'grasps')}" if masks else ""
        text += _least(blamed, counts, len(masks)) + (self._counted_as_hits if masks else "")
        if own:
            text += (
                f"; in {own} more it hits {ITSELF}" if masks else f"the hand hits {ITSELF} in {in_all(own, 'grasps')}"
            )
            counts.append((ITSELF, own))
        return Reason("grasp", "hand", text, (("grasps", len(hands)),), tuple(counts), blamed)

    def _arm(self, blocked: Blocked, present: int, free: Sequence[int]) -> Reason:
        """No free grasp can be held and lifted: the arm hits something each time, or does not get there."""
        part, named, work = blocked.part, self.named, self.named.workspace()
        hands = self._planner.reach.hands(part, self._planner.workspace())
        T_world_part = self._assembly.parts[part].T_world_part
        centers = np.array([(T_world_part @ hands[k].candidate.T_part_tool)[:3, 3] for k in free])
        distance = float(self.extent.distances(centers).min())
        moved = "lift" if self._assembly.is_lifted else "move"
        numbers: Numbers = (("grasps", len(free)), ("distance", distance), ("reach", self.extent.length))
        # The inverse kinematics gives other samples where fewer grasps are hindered for good; one of them may be free.
        masks = [mask for k in free for mask in named.reach.in_the_way(part, k, present, work) if mask]
        if masks:
            counts, blamed = self._counts(masks), self._blamed(blocked, masks)
            text = f"the arm hits {counted(counts, len(masks), f'ways to hold and {moved} it')}"
            text += _least(blamed, counts, len(masks)) + self._counted_as_hits
            return Reason("ik", "arm", text, (*numbers, ("ways", len(masks))), tuple(counts), blamed)
        if distance > self.extent.length:
            return Reason("ik", "reach", f"is out of reach: {away(distance, self.extent)}", numbers)
        way = "lifts it straight up" if self._assembly.is_lifted else "holds it all along a free way out"
        text = (
            f"no configuration within the joint limits {way}, in {in_all(len(free), 'free grasps')}; the nearest is "
            f"{away(distance, self.extent)}"
        )
        return Reason("ik", "reach", text, numbers)

    def _path(self, blocked: Blocked, present: int, reached: Sequence[int]) -> Reason:
        hands = self.named.reach.hands(blocked.part, self.named.workspace())
        common = present
        for k in reached:
            common &= hands[k].line or 0
        line = min(hands[k].bound for k in reached)
        text = f"no path to the goal was found, with {in_all(len(reached), 'grasps')} that hand and arm can take"
        if common:
            text += f"; every straight line to it meets {listed(self._names(common))}"
        blamed = self._names(blocked.blamed or common)
        return Reason("path", "path", text, (("grasps", len(reached)), ("straight_line", line)), blamed=blamed)

    @property
    def _counted_as_hits(self) -> str:
        """What is said where hand or arm hit something: masks know no distance, and planning keeps one."""
        clearance = self._workcell.clearance
        kept = padding(clearance)
        parts = f"the clearance of {millimetres(clearance)} and {millimetres(kept - clearance)} that planning adds"
        return f" (nearer than {millimetres(kept)} counts: {parts})"

    def _counts(self, masks: Sequence[int]) -> list[tuple[str, int]]:
        """Bodies by how often they are in the way, the most frequent first."""
        counts: dict[str, int] = dict.fromkeys(self._bodies, 0)
        for mask in masks:
            for name in self._names(mask):
                counts[name] += 1
        return sorted([each for each in counts.items() if each[1]], key=lambda each: -each[1])


def _direction(direction: Array) -> str:
    """In words where there are some."""
    for name, axis in (("up", (0, 0, 1)), ("down", (0, 0, -1))):
        if float(direction @ np.array(axis)) > 1 - 1e-9:
            return name
    x, y, z = np.round(direction, 2) + 0.0
    return f"along ({x:g}, {y:g}, {z:g})"


def _least(blamed: Sequence[str], counts: Sequence[tuple[str, int]], total: int) -> str:
    """What is hit where the least is hit, if that was not told yet."""
    always = {name for name, count in counts if count == total}
    return f"; in one of them only {listed(blamed)}" if set(blamed) - always else ""


def _no_pinch(cause: Unholdable | None, found: MeshGrasps, opening: float) -> Reason:
    """Why two pads find no place on a part of any form."""
    numbers: Numbers = (("opening", opening), ("contact", found.contact), ("least_contact", LEAST_CONTACT))
    if cause == "width" and math.isinf(found.narrowest):
        return Reason("grasp", "width", "it has no two opposite surfaces that fingers could close on", numbers[:1])
    if cause == "width":
        text = (
            f"its narrowest place between opposite surfaces is {millimetres(found.narrowest)} wide, and the fingers "
            f"open {millimetres(opening)}"
        )
        return Reason("grasp", "width", text, (("width", found.narrowest), *numbers[:1]))
    if cause == "contact":
        text = (
            f"no two opposite surfaces touch enough of the fingers' pads: each touches {1e6 * found.contact:.3g} mm² "
            f"of at least {1e6 * LEAST_CONTACT:.3g} mm²"
        )
        return Reason("grasp", "contact", text, numbers)
    text = f"wherever the pads touch it enough (up to {1e6 * found.contact:.3g} mm² each), a finger would reach into it"
    return Reason("grasp", "fingers", text, numbers)


def _meeting(name: str, after: float, height: float, least: float, kept: float) -> str:
    """What a part that is lifted does to a body that it meets after so many m, or comes so near to, m, if it never
    does; `kept` is the distance, m, that planning keeps."""
    if after >= height:
        # At its end the lift keeps more, see `padding`.
        than = kept if least < kept else padding(kept - PLANNING_MARGIN)
        near = f"comes within {millimetres(least)} of {name}, closer than the {millimetres(than)} that planning keeps"
        return near if least > AT_ONCE else f"touches {name} on its way"
    return f"hits {name} after {millimetres(after)}" if after > AT_ONCE else f"hits {name} at once"
