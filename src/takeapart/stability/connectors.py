"""Which parts may go without another one falling: one replaceable predicate over masks.

Fixed parts stand in no state, and therefore in no mask here: what they carry is carried for ever.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from takeapart.model.assembly import Assembly, Connector
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, OrientedBox
from takeapart.stability.contact import TOUCHING, beyond_hull, distance, seats
from takeapart.states import members

STEEPEST_IN_PLANE = np.cos(np.pi / 4)  # |cosine| to the vertical above which a bar counts as being along z
SAME_LENGTH = 1e-3  # m; edges closer than this are equally long: what a file rounds off does not decide
BALANCED = 1e-4  # m; a centre of mass must lie at least this far inside of what carries the part


@runtime_checkable
class Stability(Protocol):
    """What the planner asks about gravity, where masks can say it."""

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
        return unneeded(state, self._needs)

    def dependents(self, part: int, state: int) -> int:
        """State of the parts of `state` that would fall if the part left."""
        return self._dependents[part] & state


def unneeded(state: int, needs: Sequence[int]) -> int:
    """Parts of a state that no part of it needs, by what each of all parts needs."""
    needed = 0
    for part in members(state):
        needed |= needs[part]
    return state & ~needed


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
        _require_balance(assembly, i)


def _require_contact(assembly: Assembly, connector: Connector, where: str) -> None:
    walls, guest = _walls(assembly, connector), _boxes(assembly, connector.guest)
    for role, name in (("host", connector.host), ("guest", connector.guest)):
        gap = distance(walls, _boxes(assembly, name))
        if gap > TOUCHING:
            raise InputError(f"is {1e3 * gap:.1f} mm from its {role} {name!r}; it must touch it, within 1 mm", where)
    if connector.kind == "U" and not len(seats(guest, walls)):
        raise InputError(
            f"a U carries its guest on a floor, and no wall is right below {connector.guest!r}, within 1 mm", where
        )


def _require_balance(assembly: Assembly, i: int) -> None:
    part = assembly.parts[i]
    corners = _seats(assembly, i)
    if not len(corners):
        hosts = ", ".join(repr(name) for name in _carriers(assembly, i)) or "the bar along z in its own connector"
        raise InputError(
            f"part {part.name!r} hangs: neither {hosts} nor a wall of a connector is right below it, within 1 mm",
            f"{assembly.name}: parts",
        )
    middle = (part.T_world_part @ part.shape.bounding_box().T_frame_box)[:2, 3]
    beyond = beyond_hull(middle, corners)
    if beyond > -BALANCED:
        place = f"{1e3 * beyond:.1f} mm beyond" if beyond > BALANCED else "on the edge of"
        raise InputError(
            f"part {part.name!r} would tip: its centre of mass lies {place} what carries it; "
            "it must be carried on both sides of it",
            f"{assembly.name}: parts",
        )


def _boxes(assembly: Assembly, name: str) -> list[OrientedBox]:
    """Boxes of a part in the world, without its connectors."""
    return assembly.parts[assembly.index[name]].boxes_in_world()


def _walls(assembly: Assembly, connector: Connector) -> list[OrientedBox]:
    """Walls of a connector in the world."""
    T_world_host = assembly.parts[assembly.index[connector.host]].T_world_part
    return [wall.moved(T_world_host) for wall in connector.walls]


def _seats(assembly: Assembly, i: int) -> Array:
    """Corners (N, 2), m, seen from above, of the areas on which a part lies: on the walls and the host of each
    connector that carries it; one that nothing carries so, on the bars along z that its own connectors hold."""
    name, carriers = assembly.parts[i].name, _carriers(assembly, i)
    found = [np.empty((0, 2))]
    for connector in assembly.connectors:
        if connector.guest == name and connector.host in carriers:
            below = _walls(assembly, connector) + _boxes(assembly, connector.host)
            found.append(seats(_boxes(assembly, name), below))
        elif not carriers and _lies_on_guest(assembly, connector, name):
            found.append(_seat_on_guest(assembly, connector))
    return np.concatenate(found)


def _lies_on_guest(assembly: Assembly, connector: Connector, name: str) -> bool:
    """Whether a part hosts the connector at the head of a bar along z."""
    return (
        connector.host == name
        and connector.kind == "O"
        and _along_z(assembly, assembly.index[connector.guest])
        and _above_centre(assembly, connector)
    )


def _seat_on_guest(assembly: Assembly, connector: Connector) -> Array:
    """Where the host of a connector, or the connector itself, lies on its guest; as `seats`."""
    above = _boxes(assembly, connector.host) + _walls(assembly, connector)
    return seats(above, _boxes(assembly, connector.guest))


def _rests(assembly: Assembly, i: int, carried: set[str]) -> bool:
    name = assembly.parts[i].name
    needed = _carriers(assembly, i)
    if needed:
        return carried.issuperset(needed)
    if _along_z(assembly, i):
        return False
    return any(
        connector.guest in carried and len(_seat_on_guest(assembly, connector))
        for connector in assembly.connectors
        if _lies_on_guest(assembly, connector, name)
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
