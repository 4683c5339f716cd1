"""The pieces of which sentences about refusals are made: names, counts, lengths."""

from __future__ import annotations

from collections.abc import Sequence

from takeapart.model.geometry import Array
from takeapart.robot.extent import Extent

NAMED = 4  # names in a sentence; the others are counted


def listed(names: Sequence[str], most: int = NAMED) -> str:
    """Names for a sentence: "lid, rail and post", or the first ones and how many more."""
    if len(names) > most:
        return f"{', '.join(names[:most])} and {len(names) - most} more"
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def counted(counts: Sequence[tuple[str, int]], total: int, things: str) -> str:
    """What is hit how often: "table in all 14 grasps", or "lid in 9 of 14 grasps, table in 5 and 2 other bodies".

    Args:
        counts: names, the most frequent first.
        total: of how many.
        things: what is counted, in the plural.
    """
    always = [name for name, count in counts if count == total]
    if always:
        return f"{listed(always)} in {in_all(total, things)}"
    (first, most), *others = counts
    told = [f"{first} in {most} of {total} {things}", *(f"{name} in {count}" for name, count in others[: NAMED - 1])]
    left = len(counts) - len(told)
    return listed([*told, *([f"{left} other {'bodies' if left > 1 else 'body'}"] if left else [])], NAMED + 1)


def in_all(total: int, things: str) -> str:
    """All of so many things, in good grammar."""
    return f"all {total} {things}" if total != 1 else f"the only one of the {things}"


def millimetres(length: float) -> str:
    """A length given in m, to 0.01 mm, or two digits of less than 0.1 mm."""
    if length < 1e-4:
        return f"{1e3 * length:.2g} mm"
    return f"{round(1e3 * length, 2):.4g} mm" if length < 1 else f"{1e3 * length:.0f} mm"


def point(position: Array) -> str:
    """A position (3,) given in m."""
    return f"({', '.join(f'{value:.4g}' for value in position)}) m"


def away(distance: float, extent: Extent) -> str:
    """A distance from the shoulder, m, beside the arm's reach."""
    return f"{distance:.3f} m from the arm's shoulder, the tool reaches {extent.length:.3f} m"
