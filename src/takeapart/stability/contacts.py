"""Which states stand by contact alone: parts that press on each other, rub, and are fastened, under gravity.

Nothing follows from one state for another: a part may rest on any of several others, and one that leaves may have been
the counterweight of another. So every state is a question of its own, answered by linear programs
(`stability.statics`), one for each group of parts that touch; the answers are kept.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from takeapart.model.assembly import Assembly, Part
from takeapart.model.geometry import Array, Box, pose
from takeapart.stability.connectors import unneeded
from takeapart.stability.patches import ContactPatch, contact_patches
from takeapart.stability.statics import UNCARRIED, Balance, Statics
from takeapart.states import members

GROUND_MARGIN, GROUND_DEPTH = 0.1, 0.02  # m, by which the ground is larger than the product, and its thickness
STEADY = 0.98  # share of the friction that is counted on


@dataclass(frozen=True)
class Verdict:
    """Whether a state stands.

    Args:
        stands: nothing falls.
        falls: numbers of the parts that fall, ascending: those that nothing carries, and those that rest on them.
        missing: for the same parts the share of the weight that nothing carries; 0 where it rests on what falls.
    """

    stands: bool
    falls: tuple[int, ...] = ()
    missing: tuple[float, ...] = ()

    @property
    def mask(self) -> int:
        """State of the parts that fall."""
        return sum(1 << part for part in self.falls)


STANDS = Verdict(True)


class ContactStability:
    """Static equilibrium of every state of a product, by contact. Safe to ask from several threads.

    Args:
        assembly: with its friction, contact gap and joints. It stands on level ground at its lowest point, which
            carries what touches it.
        side_force: share of a joint's strength with which each of its points also resists sideways.
        margin: how much of what is allowed for (`statics.OFF_CENTRE`) centres of mass may lie off, to three sides,
            without anything falling; 0 for plain equilibrium.
        strength: if given, N: that of every joint, instead of its own.
    """

    def __init__(
        self, assembly: Assembly, side_force: float = 0.0, margin: float = 1.0, strength: float | None = None
    ) -> None:
        self.assembly, self.side_force, self.margin, self.strength = on_ground(assembly), side_force, margin, strength
        self._verdicts: dict[tuple[int, int | None], Verdict] = {}
        self._groups: dict[tuple[int, int | None], Verdict] = {}
        self._lock = threading.Lock()

    @cached_property
    def patches(self) -> tuple[ContactPatch, ...]:
        """Where parts touch."""
        return contact_patches(self.assembly)

    @cached_property
    def statics(self) -> Statics:
        """Equilibrium with the product's own friction."""
        return Statics(self.assembly, self.patches, STEADY * self.assembly.friction, self.side_force, self.strength)

    @cached_property
    def touching(self) -> tuple[int, ...]:
        """Per part the mask of all parts, fixed ones too, that touch it or are fastened to it."""
        masks = [0] * len(self.assembly.parts)
        pairs = [(patch.first, patch.second) for patch in self.patches]
        number = self.assembly.index
        pairs += [(number[joint.first], number[joint.second]) for joint in self.assembly.joints]
        for a, b in pairs:
            masks[a] |= 1 << b
            masks[b] |= 1 << a
        return tuple(masks)

    @cached_property
    def _fixed(self) -> int:
        return sum(1 << i for i, part in enumerate(self.assembly.parts) if part.fixed)

    @cached_property
    def _needs(self) -> list[int]:
        carriers = [set[int]() for _ in self.assembly.parts]
        friction = self.assembly.friction
        for patch in self.patches:
            for part, other, sign in ((patch.first, patch.second, 1.0), (patch.second, patch.first, -1.0)):
                rise = sign * patch.normals[:, 2]
                if (rise + friction * np.sqrt(np.maximum(1 - rise**2, 0)) > 0).any():
                    carriers[part].add(other)
        for joint in self.assembly.joints:
            first, second = self.assembly.index[joint.first], self.assembly.index[joint.second]
            carriers[first].add(second)
            carriers[second].add(first)
        return [1 << min(found) & self.assembly.root if len(found) == 1 else 0 for found in carriers]

    def needs(self, part: int) -> int:
        """State of the removable parts that must be there as long as the part is: the only one that can carry any of
        its weight, if there is but one."""
        return self._needs[part]

    def free(self, state: int) -> int:
        """State of the parts that may leave as far as masks tell; `stable` says the rest."""
        return unneeded(state, self._needs)

    def dependents(self, part: int, state: int) -> int:
        """State of the parts of `state` that would fall for certain if the part left."""
        return sum(1 << i for i in members(state) if self._needs[i] >> part & 1)

    def stable(self, state: int, held: int | None = None) -> Verdict:
        """Whether the removable parts of a state stand, with what never leaves.

        Args:
            held: number of a part of the state that something holds in its place, with whatever rests on it.
        """
        key = (state, held)
        if key not in self._verdicts:
            verdicts = [self._group(group, held) for group in self.groups(state, held)]
            falls = sorted(pair for each in verdicts for pair in zip(each.falls, each.missing, strict=True))
            verdict = Verdict(False, tuple(p for p, _ in falls), tuple(s for _, s in falls)) if falls else STANDS
            with self._lock:
                self._verdicts[key] = verdict
        return self._verdicts[key]

    def floating(self) -> tuple[str, ...]:
        """Names of the parts that fall in the full product, in part order."""
        return tuple(self.assembly.parts[i].name for i in self.stable(self.assembly.root).falls)

    def groups(self, state: int, held: int | None = None) -> list[int]:
        """The loose parts of a state as masks of those that hang together without the help of fixed ones."""
        left = state & self.assembly.root & ~(0 if held is None else 1 << held)
        found = []
        while left:
            group = grown = left & -left
            while grown:
                near = 0
                for part in members(grown):
                    near |= self.touching[part]
                grown = near & left & ~group
                group |= grown
            found.append(group)
            left &= ~group
        return found

    def standing(self, held: int | None = None) -> NDArray[np.bool_]:
        """(parts,) which parts stay in their places whatever presses on them: fixed ones, and one that is held."""
        return np.array([part.fixed or i == held for i, part in enumerate(self.assembly.parts)])

    def _group(self, group: int, held: int | None) -> Verdict:
        near = 0
        for part in members(group):
            near |= self.touching[part]
        if held is not None and not near >> held & 1:
            held = None
        key = (group, held)
        if key not in self._groups:
            anchored = near & (self._fixed | (0 if held is None else 1 << held))
            loose = members(group)
            if anchored:
                verdict = self._judge(loose, held)
            else:
                verdict = Verdict(False, tuple(loose), (1.0,) * len(loose))
            with self._lock:
                self._groups[key] = verdict
        return self._groups[key]

    def _judge(self, loose: list[int], held: int | None) -> Verdict:
        standing = self.standing(held)
        failed = self._failed(loose, standing)
        if failed is None:
            return STANDS
        lacks = zip(loose, failed.missing, strict=True)
        share = {part: float(lack) for part, lack in lacks if lack > UNCARRIED}
        left = sum(1 << part for part in loose if part not in share)
        for group in self.groups(left, held):  # what rests on the fallen ones falls too
            verdict = self._group(group, held)
            share |= dict.fromkeys(verdict.falls, 0.0)
        falls = sorted(share)
        return Verdict(False, tuple(falls), tuple(share[part] for part in falls))

    def _failed(self, loose: list[int], standing: NDArray[np.bool_]) -> Balance | None:
        """The forces nearest to equilibrium where there is none."""
        if all(self.statics.balance(loose, standing, shift, smooth=True).holds for shift in shifts(self.margin)):
            return None
        for shift in shifts(self.margin):
            balance = self.statics.balance(loose, standing, shift)
            if not balance.holds:
                drawn = self.statics.balance(loose, standing, np.zeros(3))
                return balance if drawn.holds else drawn
        return None


def on_ground(assembly: Assembly) -> Assembly:
    """The product with the ground under its lowest point, as one more part that never leaves, after all others."""
    points = [part.shape.surface().moved(part.T_world_part).bounds for part in assembly.parts]
    for connector in assembly.connectors:
        T_world_host = assembly.parts[assembly.index[connector.host]].T_world_part
        points += [wall.moved(T_world_host).corners() for wall in connector.walls]
    low, high = np.concatenate(points).min(axis=0), np.concatenate(points).max(axis=0)
    size = high - low + 2 * GROUND_MARGIN
    T = pose([*((low + high) / 2)[:2], low[2] - GROUND_DEPTH / 2])
    name = next(name for k in range(len(assembly.parts) + 1) if (name := f"ground{k or ''}") not in assembly.index)
    ground = Part(name, Box((float(size[0]), float(size[1]), GROUND_DEPTH)), T, 1.0, fixed=True)
    return replace(assembly, parts=(*assembly.parts, ground))


def shifts(size: float) -> list[Array]:
    """To which sides centres of mass may lie off, (3,) each.

    What stands with all of these stands with all between them: the forces of two equilibria add up to those of a third.
    """
    if not size:
        return [np.zeros(3)]
    return [size * np.array([np.cos(turn), np.sin(turn), 0.0]) for turn in np.radians([90.0, 210.0, 330.0])]
