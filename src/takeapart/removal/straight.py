"""Straight ways out in many directions, as far as it pays to look at them.

What decides most of them costs least: what never leaves is asked first, and a way along which it is hit before any
end can be reached is none. What is left is looked at from the steepest down, as long as it can be better than what is
known by then.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from takeapart.collision.bounds import Covers
from takeapart.collision.sweep import LEAST_STEP
from takeapart.model.geometry import Array
from takeapart.removal.endings import SHORTEST, among, lengths
from takeapart.removal.pruning import Best
from takeapart.removal.stand import Stand, Sweeps

TOGETHER = 8  # directions that are looked at together
DOWN = -0.05  # rise per length; what falls more leads down


class Straight:
    """Ways in several directions from where a part stands.

    Args:
        stand: of the part.
        own: (K, 2, 3) m, bounds of its cover there.
        covers: of all bodies.
        directions: (3,) unit vectors.
        travel: m, at most.
        turning: whether the ways may turn after `SHORTEST`; then all is swept along all of the travel.

    Attributes:
        sweeps: what is met along them, of those that were looked at.
    """

    def __init__(
        self, stand: Stand, own: Array, covers: Covers, directions: Sequence[Array], travel: float, turning: bool
    ) -> None:
        around = stand.around
        self.directions = np.array(directions)
        self._rise, self._down = self.directions[:, 2], self.directions[:, 2] < DOWN - 1e-9
        bodies = [body for body in range(around.bodies) if body != stand.part]
        gaps = np.maximum(own[:, 0].min(axis=0) - covers.bounds[:, 1], covers.bounds[:, 0] - own[:, 1].max(axis=0))
        bodies.sort(key=lambda body: float(gaps[body].max()))
        self._permanent = [body for body in bodies if around.never_leaves(body)]
        self._movable = [body for body in bodies if not around.never_leaves(body)]
        self._turning, self._least = turning, np.full(len(directions), SHORTEST)
        reach = np.full(len(directions), travel)
        if not turning:
            nothing = np.full((len(directions), around.bodies), np.inf)
            permanent, others = among(self._permanent, around.bodies), among(bodies, around.bodies)
            self._least = lengths(own, covers, permanent, self.directions, nothing, travel)
            reach = np.minimum(reach, lengths(own, covers, others, self.directions, nothing, travel) + LEAST_STEP)
        self.sweeps = Sweeps(stand, self.directions, reach)

    def better(self, best: Best) -> Iterator[int]:
        """The directions whose ways may be kept beside the best, the steepest first; all bodies are asked along them.

        Whoever takes them adds their ways to the best, which tells how many more are worth a look.
        """
        order = np.lexsort((-self._rise, self._down))
        for first in range(0, len(order), TOGETHER):
            chosen = [k for k in order[first : first + TOGETHER].tolist() if self._least[k] < np.inf]
            chosen = [k for k in chosen if not self._excelled(k, best, 0)]
            chosen = self._not_at_once(chosen, best)
            for body in self._permanent:
                self._ask(chosen, [body])
                chosen = [k for k in chosen if self.sweeps.hits[k, body] > self._least[k]]
            self._ask(chosen, self._movable)
            yield from chosen

    def _not_at_once(self, chosen: list[int], best: Best) -> list[int]:
        """Without those in which what never leaves is met at once, or parts for which there are better ways."""
        for body in self._permanent:
            met = self.sweeps.at_once(among(chosen, len(self.directions)), body)
            chosen = [k for k in chosen if not met[k]]
        blockers = dict.fromkeys(chosen, 0)
        for body in self._movable:
            met = self.sweeps.at_once(among(chosen, len(self.directions)), body)
            blockers = {k: state | int(met[k]) << body for k, state in blockers.items()}
        return [k for k in chosen if not self._excelled(k, best, blockers[k])]

    def _ask(self, chosen: Sequence[int], bodies: Sequence[int]) -> None:
        self.sweeps.ask(among(chosen, len(self.directions)), bodies)

    def _excelled(self, k: int, best: Best, met: int) -> bool:
        rise = None if self._turning else float(self._rise[k])
        return best.excels(met, float(self._least[k]), rise, bool(self._down[k]))
