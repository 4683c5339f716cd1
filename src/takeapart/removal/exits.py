"""How a part gets clear of its neighbours, without the arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

from takeapart.model.geometry import Array

ExitKind = Literal["straight", "pushes", "screw"]


@dataclass(frozen=True, eq=False)
class Exit:
    """A motion of a part alone, from its place to where it is clear.

    Args:
        kind: along a direction, in a few pushes, or along a screw.
        poses: (K, 4, 4) T_world_part, the first as assembled.
        blockers: state of the parts that it would hit; None where it meets what never leaves.
        direction: (3,) unit vector of a straight exit, else None.
        hits: what it meets, and after how many metres; the number of parts stands for what never leaves.
    """

    kind: ExitKind
    poses: Array
    blockers: int | None
    direction: Array | None = None
    hits: tuple[tuple[int, float], ...] = ()


class ExitRule(Protocol):
    """Which exits a part has."""

    def exits(self, part: int) -> tuple[Exit, ...]:
        """All that are worth trying, those with the fewest blockers first."""
        ...
