"""Which parts may go without another one falling: one replaceable predicate over masks.

Fixed parts stand in no state, and therefore in no mask here: what they carry is carried for ever.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from takeapart.assembly import Assembly, Connector, members
from takeapart.errors import InputError
from takeapart.geometry import Array, OrientedBox, box_separation

STEEPEST_IN_PLANE = np.cos(np.pi / 4)  # |cosine| to the vertical above which a bar counts as being along z
SAME_LENGTH = 1e-9  # m; edges closer than this are equally long
TOUCHING = 1e-3 + 1e-6  # m; a connector that is further from its host or guest does not hold it (and rounding)
DIRECTIONS = 720  # in which a centre of mass is compared with what it rests on


class Stability(Protocol):
    """What the planner asks about gravity."""

    def needs(self, part: int) -> int:
        """State of the removable parts that must be there as long as the part is."""
        ...

    def free(self, state: int) -> int:
        """State of the parts whose removal leaves every other part of `state` what it needs."""
        ...

    def dependents(self, part: int, state: int) -> int:
        """State of the parts of `state` that would fall if the part left."""
        ...


class ConnectorStability:
    """Stability of profile assemblies by their connectors.

    A bar in the plane needs the hosts of all connectors that carry it; a bar along z needs those at its bottom only,
    because the ones at its top leave upwards before it.
    """

    def __init__(self, assembly: Assembly) -> None:
        self._needs = [assembly.state_of(_carriers(assembly, i)) & assembly.root for i in range(len(assembly.parts))]
        self._dependents = [
            sum(1 << i for i in members(assembly.root) if self._needs[i] >> part & 1)
            for part in range(len(assembly.parts))
        ]

    def needs(self, part: int) -> int:
        """State of the removable parts that must be there as long as the part is."""
        return self._needs[part]

    def free(self, state: int) -> int:
        """State of the parts whose removal leaves every other part of `state` what it needs."""
        needed = 0
        for part in members(state):
            needed |= self._needs[part]
        return state & ~needed

    def dependents(self, part: int, state: int) -> int:
        """State of the parts of `state` that would fall if the part left."""
        return self._dependents[part] & state


def unsupported(assembly: Assembly) -> tuple[str, ...]:
    """Names of the parts that float in the full assembly, in part order.

    A fixed part is carried. A part with connectors as guest is carried if all hosts that it needs are; one without, if
    it hosts a connector above a bar along z that is carried (it lies on that bar). A bar along z needs a host at its
    bottom. Parts that carry only each other float.
    """
    carried = {part.name for part in assembly.parts if part.fixed}
    while True:
        more = {
            part.name
            for i, part in enumerate(assembly.parts)
            if part.name not in carried and _rests(assembly, i, carried)
        }
        if not more:
            return tuple(part.name for part in assembly.parts if part.name not in carried)
        carried |= more


def require_support(assembly: Assembly) -> None:
    """Refuses an assembly with connectors that hold nothing, and with parts that float or would tip over.

    Raises:
        InputError: names the first connector or part, what is wrong and by how much.
    """
    for i, connector in enumerate(assembly.connectors):
        _require_contact(assembly, connector, f"{assembly.name}: connectors[{i}] ({connector.name})")
    floating = unsupported(assembly)
    if floating:
        rest = f" (and {len(floating) - 1} more)" if len(floating) > 1 else ""
        raise InputError(
            f"part {floating[0]!r} floats: nothing carries it{rest}; it needs a connector as guest, "
            "or must lie on a bar along z that its own connector holds, or be fixed",
            f"{assembly.name}: parts",
        )
    for i in members(assembly.root):
        beyond = _beyond_support(assembly, i)
        if beyond > TOUCHING:
            raise InputError(
                f"part {assembly.parts[i].name!r} would tip: its centre of mass lies {1e3 * beyond:.1f} mm beyond what "
                "carries it; it must be carried on both sides of it",
                f"{assembly.name}: parts",
            )


def _require_contact(assembly: Assembly, connector: Connector, where: str) -> None:
    host, guest = (assembly.parts[assembly.index[name]] for name in (connector.host, connector.guest))
    walls = [wall.moved(host.T_world_part) for wall in connector.walls]
    for role, part in (("host", host), ("guest", guest)):
        gap = _gap(walls, [box.moved(part.T_world_part) for box in part.shape.boxes()])
        if gap > TOUCHING:
            raise InputError(
                f"is {1e3 * gap:.1f} mm from its {role} {part.name!r}; it must touch it, within 1 mm", where
            )
    if connector.kind == "U":
        low, high = _extents([box.moved(guest.T_world_part) for box in guest.shape.boxes()])
        floors = [_extents([wall]) for wall in walls]
        if not any(
            abs(top[2] - low[2]) <= TOUCHING and (bottom[:2] < high[:2]).all() and (top[:2] > low[:2]).all()
            for bottom, top in floors
        ):
            raise InputError(
                f"a U carries its guest on a floor, and no wall is right below {guest.name!r}, within 1 mm", where
            )


def _gap(first: Sequence[OrientedBox], second: Sequence[OrientedBox]) -> float:
    """Least separation of the boxes of two bodies, m; at most 0 where they touch."""
    pairs = [(a, b) for a in first for b in second]
    T_a, T_b = (np.array([pair[k].T_frame_box for pair in pairs]) for k in (0, 1))
    half_a, half_b = (np.array([pair[k].half_extents for pair in pairs]) for k in (0, 1))
    separation = box_separation(T_a, half_a, T_b, half_b)
    return float(separation.min())


def _extents(boxes: Sequence[OrientedBox]) -> tuple[Array, Array]:
    """Least and greatest coordinates (3,), m, of boxes."""
    corners = np.concatenate([box.corners() for box in boxes])
    return corners.min(axis=0), corners.max(axis=0)


def _beyond_support(assembly: Assembly, i: int) -> float:
    """How far, m, the centre of mass of part i lies outside the hull of the areas that carry it, seen from above.

    An area is where the extents of a connector, or of the bar along z that it holds, and those of the part overlap.
    Not more than 0 where it is inside.
    """
    part = assembly.parts[i]
    own = [box.moved(part.T_world_part) for box in part.shape.boxes()]
    low, high = _extents(own)
    carriers = _carriers(assembly, i)
    corners: list[Array] = []
    for connector in assembly.connectors:
        if connector.guest == part.name and connector.host in carriers:
            if _along_z(assembly, i) and _above_centre(assembly, connector):
                continue
        elif carriers or connector.host != part.name or not _above_centre(assembly, connector):
            continue
        T_world_host = assembly.parts[assembly.index[connector.host]].T_world_part
        least, most = _extents([wall.moved(T_world_host) for wall in connector.walls])
        least, most = np.maximum(least, low), np.minimum(most, high)
        if connector.host == part.name:  # the part lies on the bar that its own connector holds
            guest = assembly.parts[assembly.index[connector.guest]]
            least, most = _extents([box.moved(guest.T_world_part) for box in guest.shape.boxes()])
        corners += [np.array([x, y]) for x in (least[0], most[0]) for y in (least[1], most[1])]
    angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    middle = (part.T_world_part @ part.shape.bounding_box().T_frame_box)[:2, 3]
    return float((directions @ middle - (directions @ np.array(corners).T).max(axis=1)).max())


def _rests(assembly: Assembly, i: int, carried: set[str]) -> bool:
    name = assembly.parts[i].name
    needed = _carriers(assembly, i)
    if needed:
        return carried.issuperset(needed)
    if _along_z(assembly, i):
        return False
    return any(
        connector.guest in carried and _above_centre(assembly, connector)
        for connector in assembly.connectors
        if connector.host == name and connector.kind == "O" and _along_z(assembly, assembly.index[connector.guest])
    )


def _carriers(assembly: Assembly, i: int) -> list[str]:
    """Names of the hosts that part i needs, fixed ones included."""
    held = [connector for connector in assembly.connectors if connector.guest == assembly.parts[i].name]
    if _along_z(assembly, i):
        held = [connector for connector in held if not _above_centre(assembly, connector)]
    return [connector.host for connector in held]


def _along_z(assembly: Assembly, i: int) -> bool:
    """Whether the one longest axis of a part is closer to the vertical than to the plane; a part without one is not."""
    part = assembly.parts[i]
    box = part.shape.bounding_box().moved(part.T_world_part)
    longest = np.nonzero(box.half_extents >= box.half_extents.max() - SAME_LENGTH / 2)[0]
    return len(longest) == 1 and bool(abs(box.T_frame_box[2, longest[0]]) > STEEPEST_IN_PLANE)


def _above_centre(assembly: Assembly, connector: Connector) -> bool:
    """Whether a connector sits above the middle of its guest."""
    T_world_host = assembly.parts[assembly.index[connector.host]].T_world_part
    height = np.mean([(T_world_host @ wall.T_frame_box)[2, 3] for wall in connector.walls])
    guest = assembly.parts[assembly.index[connector.guest]]
    return bool(height > (guest.T_world_part @ guest.shape.bounding_box().T_frame_box)[2, 3])
