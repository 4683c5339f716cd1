"""Which states stand, where masks cannot say it: asked state by state, only where it matters, and once each.

A part may be held up by any of several others, and a part that leaves can take away the weight that kept another one
from tipping. So fewer parts may fall where more stand, and more where fewer do: nothing follows from one state for
another. What masks say about gravity is in `Problem.freedom`, and needs no question.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Protocol, runtime_checkable


class StaticsVerdict(Protocol):
    """What statics say of a state."""

    @property
    def stands(self) -> bool:
        """Whether nothing falls."""
        ...

    @property
    def falls(self) -> tuple[int, ...]:
        """Numbers of the parts that fall."""
        ...


@runtime_checkable
class Statics(Protocol):
    """Gravity asked state by state; a question takes tens of milliseconds."""

    def stable(self, state: int, held: int | None = None) -> StaticsVerdict:
        """Whether the parts of a state stand, with what never leaves; `held` is a part that something holds."""
        ...


class Standing:
    """Parts that fall in a state, beyond what masks say. Safe to ask from several threads.

    The goal, state 0, stands; the root is nobody's question, since no removal leads to it.

    Args:
        fallen_in: state -> mask of the parts that fall in it. None where every state stands.

    Attributes:
        questions: states that were asked for.
    """

    def __init__(self, fallen_in: Callable[[int], int] | None = None) -> None:
        self._fallen_in = fallen_in
        self._answers: dict[int, int] = {0: 0}
        self._lock = threading.Lock()
        self.questions = 0

    @property
    def always(self) -> bool:
        """Whether every state stands, so that conditions of removals are as monotone as masks are."""
        return self._fallen_in is None

    def fallen(self, state: int) -> int:
        """Mask of the parts that fall in a state, 0 if it stands; worked out the first time."""
        known = self.known(state)
        if known is not None:
            return known
        assert self._fallen_in is not None
        fallen = self._fallen_in(state)
        with self._lock:
            if state not in self._answers:
                self._answers[state] = fallen
                self.questions += 1
        return fallen

    def known(self, state: int) -> int | None:
        """The same where it costs nothing; None where it was not asked yet."""
        return 0 if self._fallen_in is None else self._answers.get(state)

    def is_fallen(self, state: int) -> bool:
        """Whether it is known that a state does not stand; others may be entered, as far as is known."""
        return bool(self.known(state))


def standing_by(statics: Statics) -> Standing:
    """States stand where statics say so; a verdict that names nobody blames all parts of the state."""

    def fallen_in(state: int) -> int:
        verdict = statics.stable(state)
        if verdict.stands:
            return 0
        return sum(1 << part for part in set(verdict.falls)) & state or state

    return Standing(fallen_in)
