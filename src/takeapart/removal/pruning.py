"""Which directions need no look, because a part has better ways out than any that lead along them."""

from __future__ import annotations

from typing import NamedTuple

MARGIN = 1e-9  # m, for lengths that are rounded otherwise
ROUNDED = 2e-6  # of rises, which are compared after six digits


class _Known(NamedTuple):
    blockers: int
    length: float
    down: bool
    rise: float


class Best:
    """The ways out that a part is known to have, to tell others that would not be kept beside them.

    A way is not kept beside one that hits fewer of the same parts and is no longer, nor beside several, the steeper
    ones, that hit the same. What holds of a known way holds of whichever was kept in place of it, for that is no more
    than `SAME_LENGTH` longer.

    Args:
        alike: ways that are kept beside a better one that hits the same parts.
    """

    def __init__(self, alike: int) -> None:
        self._alike = alike
        self._known: list[_Known] = []

    def add(self, blockers: int, length: float, rise: float, down: bool) -> None:
        """A way out: state of the parts that it hits, its length, m, its rise per length, and if it leads down."""
        self._known.append(_Known(blockers, length, down, rise))

    def excels(self, met: int, length: float, rise: float | None, down: bool) -> bool:
        """Whether a way is not kept that hits some parts (a state) or more, and has at least a length, m.

        Args:
            rise: of the way; None where it is not known, then only those count that hit fewer parts.
        """
        alike = 0
        for known in self._known:
            if known.blockers & ~met or known.length > length - MARGIN:
                continue
            if known.blockers != met:
                return True
            if rise is not None and (known.down, -known.rise) < (down, -rise - ROUNDED):
                alike += 1
        return alike > self._alike
