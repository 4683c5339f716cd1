"""Why a part falls: what gives way first, with numbers; worked out only when somebody asks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from takeapart.model.assembly import Assembly
from takeapart.stability.contact import beyond_hull
from takeapart.stability.contacts import ContactStability
from takeapart.stability.statics import Statics
from takeapart.states import members

Cause = Literal["floats", "joint", "slides", "tips", "drops", "edge", "rests"]
GREATEST_FRICTION = 2.0  # where more would be needed, friction is not what lacks
STRONGEST = 1e4  # times the strength of the joints; the same
HALVINGS = 20  # of what lies between too little and enough
LEAST_RISE = 0.1  # vertical component of a normal that carries


@dataclass(frozen=True)
class Failure:
    """What gives way first where a part falls.

    Args:
        part: number of the part.
        cause: it "floats": neither it nor what it touches reaches anything fixed; a "joint" lets go; it "slides"; it
            "tips" over what carries it; it "drops", since nothing that it touches is below it; it stands on an "edge",
            so that a centre of mass a little off lets it tip; it "rests" on parts that fall.
        other: number of the part that it leaves or rests on; None for none.
        joint: name of the joint.
        amount: joint: N that each of its points would have to hold; slides: friction that would hold it; tips: m from
            the centre of mass to what carries the part; edge: m off; floats: how many other parts float with it;
            else 0.
        limit: joint: N that each point holds; slides: the friction there is; else 0.
        missing: share of its weight that nothing carries.
    """

    part: int
    cause: Cause
    other: int | None = None
    joint: str = ""
    amount: float = 0.0
    limit: float = 0.0
    missing: float = 0.0

    def text(self, assembly: Assembly) -> str:
        """The same as a clause."""
        name = repr(assembly.parts[self.part].name)
        other = "" if self.other is None else repr(assembly.parts[self.other].name)
        if self.cause == "floats":
            more = f" with {self.amount:.0f} more that it touches" if self.amount else ""
            them = "them" if self.amount else "it"
            return f"{name} floats{more}: nothing carries {them} within {1e3 * assembly.contact_gap:g} mm"
        if self.cause == "joint":
            needed = f"it would have to hold {self.amount:.3g} N at each point and holds {self.limit:.3g} N"
            return f"{name} comes off {other}: {needed} (joint {self.joint!r})"
        if self.cause == "slides":
            return f"{name} slides off {other}: friction of {self.amount:.2f} would hold it, {self.limit:g} is there"
        if self.cause == "edge":
            off = f"with its centre of mass off by {1e3 * self.amount:.1f} mm it tips"
            return f"{name} stands on an edge of {other}: {off}"
        if self.cause == "drops":
            return f"{name} drops: nothing that it touches is below it"
        if self.cause == "rests":
            return f"{name} rests on {other}, which falls"
        away = f"its centre of mass lies {1e3 * self.amount:.1f} mm beyond it" if self.amount > 0 else "its load is off"
        return f"{name} tips over {other}: {away}"


def failures(stability: ContactStability, state: int, held: int | None = None) -> tuple[Failure, ...]:
    """Why each part that falls in a state falls, in part order; none where the state stands."""
    verdict = stability.stable(state, held)
    lack = dict(zip(verdict.falls, verdict.missing, strict=True))
    found: dict[int, Failure] = {}
    for group in stability.groups(state, held):
        fallen = [part for part in members(group) if part in lack]
        if fallen:
            found |= _of_group(stability, state, group, fallen, held, lack)
    return tuple(found[part] for part in sorted(found))


def _of_group(
    stability: ContactStability, state: int, group: int, fallen: list[int], held: int | None, lack: dict[int, float]
) -> dict[int, Failure]:
    standing = stability.standing(held)
    around = state | sum(1 << i for i, stands in enumerate(standing) if stands)
    touched = {part: members(stability.touching[part] & around) for part in fallen}
    anchored = any(standing[other] for part in members(group) for other in members(stability.touching[part] & around))
    if not anchored:
        return {part: Failure(part, "floats", amount=len(fallen) - 1, missing=1.0) for part in fallen}
    loose = members(group)
    balanced = stability.statics.balance(loose, standing, np.zeros(3)).holds
    by_joint = None if balanced else _weak_joint(stability, loose, standing)
    friction = None if balanced or by_joint else _lacking_friction(stability, loose, standing)
    found = {}
    for part in fallen:
        if not touched[part]:
            found[part] = Failure(part, "floats", missing=1.0)
        elif not lack[part]:
            below = [other for other in touched[part] if other in lack]
            found[part] = Failure(part, "rests", below[0] if below else touched[part][0])
        elif by_joint is not None:
            found[part] = _joint_of(stability, part, by_joint, lack[part])
        elif friction is not None:
            held_by = _carrier(stability, part, touched[part])[0]
            found[part] = Failure(part, "slides", held_by, "", friction, stability.assembly.friction, lack[part])
        else:
            other, away = _carrier(stability, part, touched[part])
            cause: Cause = "drops" if other is None else "edge" if balanced else "tips"
            amount = float(stability.statics.off_centre[part]) if balanced else max(away, 0.0)
            found[part] = Failure(part, cause, other, amount=amount, missing=lack[part])
    return found


def _weak_joint(
    stability: ContactStability, loose: list[int], standing: np.ndarray
) -> tuple[float, dict[int, float]] | None:
    """How many times as strong joints would have to be for all to stand, and what each then pulls, N."""
    statics, still = stability.statics, np.zeros(3)
    if (statics.joint < 0).all() or not statics.balance(loose, standing, still, STRONGEST).holds:
        return None
    low, high = 1.0, STRONGEST
    for _ in range(HALVINGS):
        middle = float(np.sqrt(low * high))
        if statics.balance(loose, standing, still, middle).holds:
            high = middle
        else:
            low = middle
    return high, statics.balance(loose, standing, still, high).tension


def _joint_of(stability: ContactStability, part: int, weak: tuple[float, dict[int, float]], lack: float) -> Failure:
    """The joint nearest to its limit, of the part if it has any."""
    assembly, (times, tension) = stability.assembly, weak
    strength = [joint.strength if stability.strength is None else stability.strength for joint in assembly.joints]
    own = [k for k in tension if assembly.parts[part].name in (assembly.joints[k].first, assembly.joints[k].second)]
    worst = max(own or tension, key=lambda k: tension[k] / max(strength[k], 1e-12))
    joint = assembly.joints[worst]
    other = joint.first if joint.second == assembly.parts[part].name else joint.second
    return Failure(part, "joint", assembly.index[other], joint.name, times * strength[worst], strength[worst], lack)


def _lacking_friction(stability: ContactStability, loose: list[int], standing: np.ndarray) -> float | None:
    """The least friction with which all would stand; None where none does."""
    low, high = stability.assembly.friction, GREATEST_FRICTION

    def stands(friction: float) -> bool:
        statics = Statics(stability.assembly, stability.patches, friction, stability.side_force, stability.strength)
        return statics.balance(loose, standing, np.zeros(3)).holds

    if not stands(high):
        return None
    for _ in range(8):
        middle = (low + high) / 2
        low, high = (low, middle) if stands(middle) else (middle, high)
    return high


def _carrier(stability: ContactStability, part: int, touched: list[int]) -> tuple[int | None, float]:
    """Which of the parts that carry a part is nearest to its centre of mass, and how far, m, the latter lies beyond all
    points that carry, seen from above."""
    points: dict[int, list[np.ndarray]] = {}
    for patch in stability.patches:
        if part in (patch.first, patch.second):
            other, sign = (patch.second, 1.0) if patch.first == part else (patch.first, -1.0)
            below = patch.points[sign * patch.normals[:, 2] > LEAST_RISE]
            if other in touched and len(below):
                points.setdefault(other, []).append(below)
    if not points:
        return None, 0.0
    middle = stability.statics.middles[part]
    near = {
        other: min(float(np.linalg.norm(p - middle, axis=1).min()) for p in found) for other, found in points.items()
    }
    corners = np.concatenate([p for found in points.values() for p in found])[:, :2]
    return min(near, key=near.__getitem__), beyond_hull(middle[:2], corners)
