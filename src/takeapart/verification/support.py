"""The judge's own rule of what carries what: vertical forces between bodies that touch must hold every state.

The planner compares a centre of mass with the areas below it. Here nothing is drawn: a state stands if there are points
in which boxes lie on boxes, and upward forces there, that keep every removable part in balance (forces along z,
moments about x and y), with all that lies on it. Points and forces are found together by one linear program, with
y = force * point as the unknown: Boyd, Vandenberghe: Convex Optimization, 2004, Sec. 4.3 and 3.2.6 (perspective).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import linprog, lsq_linear
from scipy.sparse import coo_array

from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Array, OrientedBox
from takeapart.verification.report import Finding, VerificationOptions

TOUCHING = VerificationOptions.touching + 1e-5  # m; bodies further apart than this do not touch (and rounding)
SUNK = 1.5e-4  # m; how deep a part may be in what it lies on (bodies of an assembly may overlap by 0.1 mm)
BALANCED = 1e-4  # m; a weight that lies further outside its support than this tips
FLOATS = 1.0  # m; price of a missing weight beside that of a moment: a part floats only where nothing is below it
NEARBY = 1e-6  # m; extents that overlap by less do not lie above each other


@dataclass(frozen=True, eq=False)
class Contact:
    """A box of one part that lies on a box of another."""

    upper: int  # number of the part
    lower: int
    boxes: tuple[OrientedBox, OrientedBox]  # in the world: of the upper part, of the lower one


class Support:
    """What carries what in one assembly; states that were judged are kept."""

    def __init__(self, assembly: Assembly) -> None:
        self.assembly = assembly
        bodies = [[box.moved(part.T_world_part) for box in assembly.body(i)] for i, part in enumerate(assembly.parts)]
        owners = np.array([i for i, body in enumerate(bodies) for _ in body])
        boxes = [box for body in bodies for box in body]
        corners = np.array([box.corners() for box in boxes])
        low, high = corners.min(axis=1), corners.max(axis=1)
        self.contacts: list[Contact] = []
        for a, box in enumerate(boxes):
            if assembly.parts[owners[a]].fixed:
                continue
            beside = (high[:, :2] > low[a, :2] + NEARBY).all(axis=1) & (low[:, :2] < high[a, :2] - NEARBY).all(axis=1)
            near = (high[:, 2] >= low[a, 2] - TOUCHING) & (low[:, 2] < high[a, 2])
            for b in np.nonzero(beside & near & (owners != owners[a]))[0]:
                if _lies_on(box, boxes[b]):
                    self.contacts.append(Contact(int(owners[a]), int(owners[b]), (box, boxes[b])))
        self._judged: dict[int, dict[str, tuple[float, float]]] = {}

    @cached_property
    def broken_connectors(self) -> list[str]:
        """One line for every connector that does not touch its host or its guest, or is a U without a floor."""
        assembly, lines = self.assembly, []
        for connector in assembly.connectors:
            host, guest = (assembly.parts[assembly.index[name]] for name in (connector.host, connector.guest))
            walls = [wall.moved(host.T_world_part) for wall in connector.walls]
            for role, part in (("host", host), ("guest", guest)):
                solid = part.boxes_in_world()
                gap = min(_distance(wall, box) for wall in walls for box in solid)
                if gap > TOUCHING:
                    lines.append(f"connector {connector.name!r} is {1e3 * gap:.1f} mm from its {role} {part.name!r}")
            if connector.kind == "U" and not any(_lies_on(box, wall) for box in solid for wall in walls):
                lines.append(f"connector {connector.name!r} has no floor below {guest.name!r}, within 1 mm")
        return lines

    def unbalanced(self, state: int) -> dict[str, tuple[float, float]]:
        """Parts of a state that do not stand: the share of their weight that nothing carries, and by how much, m, the
        centre of mass would have to lie elsewhere."""
        if state not in self._judged:
            self._judged[state] = self._balance(state)
        return self._judged[state]

    def _balance(self, state: int) -> dict[str, tuple[float, float]]:
        parts = self.assembly.parts
        loose = [i for i, part in enumerate(parts) if not part.fixed and state >> i & 1]
        row = {part: k for k, part in enumerate(loose)}
        contacts = [c for c in self.contacts if c.upper in row and (c.lower in row or parts[c.lower].fixed)]
        if not loose:
            return {}
        # Unknowns: per contact y (4: x, y, z of the point on the upper box, z on the lower one; times the force) and
        # the force; then per part the missing weight and the moments missing about both axes, both ways. In weights.
        count, first = 5 * len(contacts), 3 * len(loose)
        balance: list[tuple[int, int, float]] = []
        inside: list[tuple[int, int, float]] = []
        rows = 0
        weights = np.array([parts[i].mass for i in loose])
        unit = weights.mean()
        middles = np.array([_centre_of_mass(self.assembly, i) for i in loose])
        for k, contact in enumerate(contacts):
            at = 5 * k
            for part, sign in ((contact.upper, 1.0), (contact.lower, -1.0)):
                if part in row:
                    r, origin = 3 * row[part], middles[row[part]]
                    balance.append((r, at + 4, sign))
                    for axis in (0, 1):
                        balance += [(r + 1 + axis, at + axis, sign), (r + 1 + axis, at + 4, -sign * origin[axis])]
            for box, height in zip(contact.boxes, (2, 3), strict=True):
                R, centre = box.T_frame_box[:3, :3], box.T_frame_box[:3, 3]
                for axis in range(3):
                    for sign in (1.0, -1.0):  # sign * R' (y - force * centre) <= force * half
                        inside += [(rows, at + column, sign * R[j, axis]) for j, column in enumerate((0, 1, height))]
                        inside.append((rows, at + 4, -sign * float(R[:, axis] @ centre) - box.half_extents[axis]))
                        rows += 1
            inside += [(rows, at + 2, 1.0), (rows, at + 3, -1.0), (rows, at + 4, -TOUCHING)]
            rows += 1
        cost = np.zeros(count + 5 * len(loose))
        for k, weight in enumerate(weights / unit):
            slack = count + 5 * k
            balance.append((3 * k, slack, 1.0))
            cost[slack] = FLOATS / weight
            for axis in (0, 1):
                balance += [
                    (3 * k + 1 + axis, slack + 1 + 2 * axis, 1.0),
                    (3 * k + 1 + axis, slack + 2 + 2 * axis, -1.0),
                ]
                cost[slack + 1 + 2 * axis : slack + 3 + 2 * axis] = 1.0 / weight
        wanted = np.zeros(first)
        wanted[::3] = weights / unit
        points = np.arange(len(cost))
        free = (points < count) & (points % 5 != 4)
        bounds = np.column_stack([np.where(free, -np.inf, 0.0), np.full(len(cost), np.inf)])
        found = linprog(  # type: ignore[call-overload]  # the stubs know no sparse matrices
            cost,
            A_ub=_sparse(inside, (rows, len(cost))) if rows else None,
            b_ub=np.zeros(rows) if rows else None,
            A_eq=_sparse(balance, (first, len(cost))),
            b_eq=wanted,
            bounds=bounds,
            method="highs",
        )
        if found.x is None:
            return {parts[i].name: (1.0, 0.0) for i in loose}  # nothing was shown
        slack = found.x[count:].reshape(-1, 5) / (weights / unit)[:, None]
        off = np.hypot(slack[:, 1] - slack[:, 2], slack[:, 3] - slack[:, 4])
        return {
            parts[i].name: (float(share), float(away))
            for i, share, away in zip(loose, slack[:, 0], off, strict=True)
            if share > 1e-6 or away > BALANCED
        }


def check_support(support: Support, states: Sequence[int], removed: Sequence[str]) -> list[Finding]:
    """Connectors touch what they join, and what carries the parts holds them, in every state of a plan.

    Args:
        states: before the first step, and after each.
        removed: name of the part that each step removes.
    """
    findings = [Finding(None, "", None, "support", line) for line in support.broken_connectors]
    reported: set[str] = set()
    for k, state in enumerate(states):
        step, part = (k - 1, removed[k - 1]) if k else (None, "")
        for name, (share, away) in support.unbalanced(state).items():
            if name not in reported:
                reported.add(name)
                wrong = f"nothing carries {100 * share:.0f} % of the weight of part {name!r}"
                if share <= 1e-6:
                    wrong = f"part {name!r} tips: its weight lies {1e3 * away:.1f} mm beyond what carries it"
                findings.append(Finding(step, part, None, "support", wrong, away))
    return findings


def _sparse(entries: list[tuple[int, int, float]], shape: tuple[int, int]) -> coo_array:
    rows, columns, values = zip(*entries, strict=True)
    return coo_array((np.array(values), (np.array(rows), np.array(columns))), shape=shape)


def _centre_of_mass(assembly: Assembly, i: int) -> Array:
    boxes = assembly.parts[i].boxes_in_world()
    return np.average(
        [box.T_frame_box[:3, 3] for box in boxes], axis=0, weights=[box.half_extents.prod() for box in boxes]
    )


def _lies_on(upper: OrientedBox, lower: OrientedBox) -> bool:
    """Whether somewhere, seen from above, one box is right above another: least height by a linear program over a
    point of each on one vertical line."""
    axes = np.zeros((2, 6))
    axes[:, :3], axes[:, 3:] = upper.T_frame_box[:2, :3], -lower.T_frame_box[:2, :3]
    height = np.concatenate([upper.T_frame_box[2, :3], -lower.T_frame_box[2, :3]])
    half = np.concatenate([upper.half_extents, lower.half_extents])
    between = upper.T_frame_box[:3, 3] - lower.T_frame_box[:3, 3]
    found = linprog(height, A_eq=axes, b_eq=-between[:2], bounds=list(zip(-half, half, strict=True)), method="highs")
    return bool(found.status == 0 and -SUNK <= found.fun + between[2] <= TOUCHING)


def _distance(a: OrientedBox, b: OrientedBox) -> float:
    """Distance of two boxes, m, by bounded least squares over a point of each."""
    half = np.concatenate([a.half_extents, b.half_extents])
    axes = np.hstack([a.T_frame_box[:3, :3], -b.T_frame_box[:3, :3]])
    found = lsq_linear(axes, b.T_frame_box[:3, 3] - a.T_frame_box[:3, 3], (-half, half), method="bvls", tol=1e-14)
    return float(np.sqrt(2 * found.cost))
