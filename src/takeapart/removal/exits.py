"""How a part gets clear of its neighbours, without the arm."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, Protocol

import numpy as np

from takeapart.collision.bounds import covers_of
from takeapart.collision.contact import Contacts
from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Array, OrientedBox
from takeapart.removal.directions import directions_of, sphere
from takeapart.removal.endings import APART, among, bounds_at, ending, raised
from takeapart.removal.pieces import Pair
from takeapart.removal.pushes import Pushes, Way, unscrewed
from takeapart.removal.ranking import Candidate, Ranking
from takeapart.removal.selection import (
    MOST_EXITS,
    Figures,
    figures_of,
    is_no_worse,
    leaving_before,
    selected,
    stuck,
    without_worse,
)
from takeapart.removal.stand import Stand, Sweeps
from takeapart.removal.straight import Straight, look_along
from takeapart.removal.surroundings import Surroundings
from takeapart.states import members

ExitKind = Literal["straight", "pushes", "screw"]


@dataclass(frozen=True, eq=False)
class Exit:
    """A motion of a part alone, from its place to where it is clear.

    Bodies are numbered: the parts as in the assembly, then the obstacles of the environment.

    Args:
        kind: along a direction, in a few pushes, or along a screw.
        poses: (K, 4, 4) T_world_part, the first as assembled.
        blockers: state of the parts that it would hit; None where it meets what never leaves, or has no end.
        direction: (3,) unit vector of a straight exit, else None.
        hits: bodies that it meets, and after how many metres, the first of them first.
        near: bodies from which the part does not get away along the direction, and how near it still is after its
            whole length, m.
        pushes: how many pushes were tried to find another way, where none of them led to one.
    """

    kind: ExitKind
    poses: Array
    blockers: int | None
    direction: Array | None = None
    hits: tuple[tuple[int, float], ...] = ()
    near: tuple[tuple[int, float], ...] = ()
    pushes: int = 0

    @property
    def leans(self) -> bool:
        """Whether it goes along one of the directions that are tried for want of better ones."""
        return self.direction is not None and any(float(self.direction @ each) > 1 - 1e-9 for each in sphere())


class ExitRule(Protocol):
    """Which exits a part has."""

    def exits(self, part: int) -> tuple[Exit, ...]:
        """All that are worth trying, those with the fewest blockers first."""
        ...


MOST_TRAVEL = 2.0  # m
NEW = 0.999  # cosine; of directions all around those that differ by less from others are left out
AXES = 5  # of the directions of a part, the world's: along these it leaves after pushes
UP = np.array([0.0, 0.0, 1.0])
LEVEL = 0.05  # sine; a way sideways is less steep
TURNINGS = 3  # places on a way sideways from which a part is tried to go up
FIRST_LOOK, FURTHER_LOOK = 2.5e-4, 1.4  # m, and how many times further each next look at a way is
CUTS = 8e-5  # m; deeper than that, and than as drawn, nothing may be in another
MOST_WAITING = 12  # parts that wait for each other, of which pushes are tried


class Exits:
    """Ways out of a product: straight in any direction, sideways and then up from what carries the part, by a thread or
    by pushes where none of these is; found when first asked for.

    Each is free of all parts but its blockers, and keeps to what `Surroundings` demands along its whole length.

    Args:
        assembly: the product.
        contacts: its near pairs.
        obstacles: boxes of the environment, world frame.
        clearance: kept from whatever is further away at the start, m; along the rest a part may slide.
    """

    def __init__(
        self, assembly: Assembly, contacts: Contacts, obstacles: Sequence[OrientedBox], clearance: float
    ) -> None:
        self._assembly, self._contacts = assembly, contacts
        self._around = Surroundings(assembly, contacts, obstacles, clearance)
        covers = [bounds_at(assembly.body(number), part.T_world_part) for number, part in enumerate(assembly.parts)]
        self._covers = covers_of([*covers, *(bounds_at([box]) for box in obstacles)])
        self._travel = min(MOST_TRAVEL, float(np.linalg.norm(np.ptp(_product(assembly), axis=0))) + 2 * APART)
        self._alone: dict[int, tuple[Exit, ...]] = {}
        self._exits: dict[int, tuple[Exit, ...]] = {}

    def exits(self, part: int) -> tuple[Exit, ...]:
        """The exits worth trying, those with the fewest blockers first; where every one meets what never leaves, those,
        with what they hit."""
        if part not in self._exits:
            ways = self._of(part)
            leaving = self._assembly.root
            if ways and not any(way.blockers == 0 for way in ways):
                ways = self._untangled.get(part, ways)
                leaving = leaving_before(part, self._untangled)
            self._exits[part] = self._chosen(part, ways, leaving)
        return self._exits[part]

    def _chosen(self, part: int, ways: Sequence[Exit], leaving: int) -> tuple[Exit, ...]:
        """Those that are kept, see `selected`; the ones among them that lean any way are looked at exactly first."""
        looked_at: list[Exit] = []
        while True:
            chosen = selected(ways, leaving)
            new = next((way for way in chosen if way.leans and all(way is not other for other in looked_at)), None)
            if new is None:
                return chosen
            exact = self._exactly(part, new)
            looked_at.append(exact)
            ways = [exact if way is new else way for way in ways]
            if any(way.blockers is not None for way in ways):
                ways = [way for way in ways if way.blockers is not None]

    def _exactly(self, part: int, way: Exit) -> Exit:
        """A straight way with all that it cuts into of what it touches as drawn, by triangles: fields allow as much as
        they err by, and what stands in a shallow seat would be tilted out of it through the rim."""
        assert way.direction is not None
        met: list[tuple[int, float]] = []
        length = float(np.linalg.norm(way.poses[-1, :3, 3] - way.poses[0, :3, 3]))
        for other in range(len(self._assembly.parts)):
            found = None if other == part else self._contacts.finding(part, other)
            if found is None or found.gap > self._around.clearance or (way.blockers or 0) >> other & 1:
                continue
            after = FIRST_LOOK
            while after < length:
                T = way.poses[0].copy()
                T[:3, 3] += after * way.direction
                distance = self._contacts.distance_at(part, other, T)
                if distance < -found.depth - CUTS:
                    met.append((other, after))
                if distance < -found.depth - CUTS or distance >= self._around.clearance:
                    break
                after *= FURTHER_LOOK
        if not met:
            return way
        hits = tuple(sorted([*way.hits, *met], key=lambda hit: hit[1]))
        return replace(way, blockers=self._blockers([body for body, _ in hits], []), hits=hits)

    def _of(self, part: int) -> tuple[Exit, ...]:
        """The exits of a part that need no other's."""
        if part not in self._alone:
            self._alone[part] = () if self._assembly.parts[part].fixed else self._find(part)
        return self._alone[part]

    def _find(self, part: int) -> tuple[Exit, ...]:
        stand = self._stand(part)
        first = directions_of(self._assembly, self._contacts, part)
        rising = self._sweep(stand, UP)
        up, ranking = self._along(stand, UP, rising), Ranking()
        found = {0: up}

        def looked_at(ways: Straight, k: int) -> Figures | None:
            on = self._along(stand, ways.directions[k], ways.sweeps, k)
            aside = self._aside(stand, on, ways.sweeps, k, rising) if ways.turning else None
            found[ways.numbers[k]] = aside or on
            return figures_of(aside or on)

        if (figures := figures_of(up)) is not None:
            ranking.add([Candidate(0, figures, way=figures)])
        groups = []
        level = {k: abs(float(direction[2])) <= LEVEL and up.blockers != 0 for k, direction in enumerate(first)}
        for turning in (False, True):
            directions = {k: first[k] for k in range(1, len(first)) if level[k] == turning}
            if directions:
                groups.append(Straight(stand, self._covers, directions, self._travel, turning))
                ranking.add(groups[-1].candidates())
        look_along(groups, ranking, looked_at)
        if not any(each.blockers == 0 for each in found.values()):
            new = np.flatnonzero((np.array(sphere()) @ np.array(first).T).max(axis=1) < NEW).tolist()
            directions = {len(first) + k: sphere()[k] for k in new}
            groups.append(Straight(stand, self._covers, directions, self._travel, False))
            ranking.add(groups[-1].candidates())
            look_along(groups, ranking, looked_at)
        open_ = [found[k] for k in sorted(found) if found[k].blockers is not None]
        if not open_:
            winding, pushes = self._winding(part, range(self._around.bodies))
            if winding:
                return (winding,)
            told = [found[k] if k in found else self._along(stand, way) for k, way in enumerate(first[:MOST_EXITS])]
            return tuple(replace(way, pushes=pushes) for way in told)
        return without_worse(open_)

    @cached_property
    def _untangled(self) -> dict[int, tuple[Exit, ...]]:
        """The exits of parts that wait for each other: of these pushes are tried among those alone that no order
        frees."""
        parts = [part for part, body in enumerate(self._assembly.parts) if not body.fixed]
        ways = {part: self._of(part) for part in parts}
        while True:
            waiting = stuck(ways)
            if waiting.bit_count() > MOST_WAITING:
                return ways
            permanent = [body for body in range(self._around.bodies) if self._around.never_leaves(body)]
            freed = False
            for part in members(waiting):
                if waiting == self._assembly.root and all(way.blockers is None for way in ways[part]):
                    continue  # tried among the same parts before
                way, pushes = self._winding(part, [*members(waiting), *permanent])
                if way is not None:
                    ways[part] = (*(each for each in ways[part] if each.blockers is not None), way)
                    freed = True
                    break
                ways[part] = tuple(replace(each, pushes=max(each.pushes, pushes)) for each in ways[part])
            if not freed:
                return ways

    def _winding(self, part: int, bodies: Collection[int]) -> tuple[Exit | None, int]:
        """A way out along a thread or by pushes, with some bodies there; None where none is found. And after how many
        pushes."""
        there = [body for body in bodies if body != part]
        ends: list[Stand] = []

        def out(way: Way) -> Exit | None:
            """The whole way, if its end is free and all of it keeps to what is demanded."""
            if not ends or ends[-1].T is not way.end:
                ends.append(self._stand(part, way.end))
            last = self._along(ends[-1], way.direction)
            if last.blockers is None or any(last.blockers >> body & 1 for body in there):
                return None
            poses = np.concatenate([way.poses, last.poses])
            met = self._around.met(part, poses)
            if any(body in there or self._around.never_leaves(body) for body in met):
                return None
            kind: ExitKind = "screw" if way.turns else "pushes"
            return Exit(kind, poses, last.blockers | sum(1 << body for body in met), None, last.hits)

        found = unscrewed(self._assembly, self._stand(part), there, out)
        if found is not None:
            return found, 0
        axes = directions_of(self._assembly, self._contacts, part)[:AXES]
        pushes = Pushes(self._around, part, there, axes)
        return pushes.free(out), pushes.count

    def _stand(self, part: int, T: Array | None = None) -> Stand:
        return Stand(self._around, part, self._assembly.parts[part].T_world_part if T is None else T)

    def _sweep(self, stand: Stand, direction: Array, parted: Collection[Pair] = ()) -> Sweeps:
        """What is met along one direction, of pieces that have parted before or not."""
        sweeps = Sweeps(stand, direction[None], np.array([self._travel]), parted)
        sweeps.ask(np.ones(1, bool), range(self._around.bodies))
        return sweeps

    def _along(self, stand: Stand, direction: Array, sweeps: Sweeps | None = None, k: int = 0) -> Exit:
        """Straight out from where a part stands, along the direction k of what was swept."""
        hits = (sweeps or self._sweep(stand, direction)).hits[k]
        others = np.ones(self._around.bodies, bool)
        others[stand.part] = False
        end = ending(stand.cover, self._covers, others, direction, hits, self._travel)
        poses = np.repeat(stand.T[None], 2, axis=0)
        poses[1, :3, 3] += end.length * direction
        told = sorted(((body, float(hits[body])) for body in end.hit), key=lambda hit: hit[1])
        near: list[tuple[int, float]] = []
        if end.near:
            there = self._stand(stand.part, poses[1])
            near = sorted(((body, there.distance(body)) for body in end.near), key=lambda each: each[1])
        return Exit("straight", poses, self._blockers(end.hit, end.near), direction, tuple(told), tuple(near))

    def _blockers(self, hit: Collection[int], near: Collection[int] = ()) -> int | None:
        if near or any(self._around.never_leaves(body) for body in hit):
            return None
        return sum(1 << body for body in hit)

    def _aside(self, stand: Stand, way: Exit, sweeps: Sweeps, k: int, rising: Sweeps) -> Exit | None:
        """Sideways until nothing is above the part any more, then up from what carries it; None where that is not
        possible, or no shorter than to go on sideways.

        Args:
            way: straight on.
            sweeps: what is met on it, along the direction k.
            rising: what is met straight up.
        """
        assert way.direction is not None
        above = set(np.flatnonzero(rising.hits[0] < np.inf).tolist())
        if not above:
            return None
        hits, own = sweeps.hits[k], raised(stand.cover, self._travel)
        for _ in range(TURNINGS):
            turn = ending(own, self._covers, among(above, self._around.bodies), way.direction, hits, self._travel)
            if turn.near or self._blockers(turn.hit) is None:
                return None
            T = stand.T.copy()
            T[:3, 3] += turn.length * way.direction
            parted = [pair for pair, after in sweeps.parted[k].items() if after <= turn.length]
            there = self._stand(stand.part, T)
            last = self._along(there, UP, self._sweep(there, UP, parted))
            if last.blockers is not None and all(body in above for body, _ in last.hits):
                break
            above |= {body for body, _ in last.hits}
        if last.blockers is None:
            return None
        poses = np.concatenate([stand.T[None], last.poses])
        told = [(body, float(hits[body])) for body in turn.hit]
        told += [(body, turn.length + after) for body, after in last.hits if body not in turn.hit]
        met = {body for body, _ in told}
        found = Exit("pushes", poses, self._blockers(met), None, tuple(told))
        worse = way.blockers is not None and is_no_worse(way, found)
        return None if worse else found


def _product(assembly: Assembly) -> Array:
    corners = [part.shape.bounding_box().moved(part.T_world_part).corners() for part in assembly.parts]
    return np.concatenate(corners)
