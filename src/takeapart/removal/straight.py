"""Straight ways out in many directions, as far as it pays to look at them.

What decides most of them costs least: what never leaves is asked first, and a way along which it is hit before any
end can be reached is none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from takeapart.collision.bounds import Covers
from takeapart.collision.sweep import LEAST_STEP
from takeapart.model.geometry import Array
from takeapart.removal.endings import SHORTEST, among, lengths
from takeapart.removal.ranking import MARGIN, Candidate, Ranking
from takeapart.removal.selection import Figures
from takeapart.removal.stand import Stand, Sweeps

GLANCES, LOOKS = 8, 4  # at as many directions together
DOWN = -0.05  # rise per length; what falls more leads down


class Straight:
    """Ways in several directions from where a part stands.

    Args:
        stand: of the part.
        covers: of all bodies.
        directions: (3,) unit vectors by their numbers.
        travel: m, at most.
        turning: whether the ways may turn after `SHORTEST`; then all is swept along all of the travel.

    Attributes:
        numbers: of the directions.
        turning: as given.
        sweeps: what is met along them, of those that were looked at.
    """

    def __init__(
        self, stand: Stand, covers: Covers, directions: Mapping[int, Array], travel: float, turning: bool
    ) -> None:
        around, own = stand.around, stand.cover
        self.numbers, self.directions = list(directions), np.array(list(directions.values()))
        bodies = [body for body in range(around.bodies) if body != stand.part]
        gaps = np.maximum(own[:, 0].min(axis=0) - covers.bounds[:, 1], covers.bounds[:, 0] - own[:, 1].max(axis=0))
        bodies.sort(key=lambda body: float(gaps[body].max()))
        self._permanent = [body for body in bodies if around.never_leaves(body)]
        self._movable = [body for body in bodies if not around.never_leaves(body)]
        self.turning, self._least = turning, np.full(len(directions), SHORTEST)
        reach = np.full(len(directions), travel)
        if not turning:
            nothing = np.full((len(directions), around.bodies), np.inf)
            permanent, others = among(self._permanent, around.bodies), among(bodies, around.bodies)
            self._least = lengths(own, covers, permanent, self.directions, nothing, travel)
            reach = np.minimum(reach, lengths(own, covers, others, self.directions, nothing, travel) + LEAST_STEP)
        self.sweeps = Sweeps(stand, self.directions, reach)

    def candidates(self) -> list[Candidate]:
        """The directions, without those along which there is no end."""
        return [
            Candidate(number, Figures(0, self._down(k), self._rise(k), least - MARGIN, None))
            for k, (number, least) in enumerate(zip(self.numbers, self._least.tolist(), strict=True))
            if least < np.inf
        ]

    def glance(self, chosen: list[int]) -> dict[int, int]:
        """State of the parts that are met at once along some directions, without those along which what never leaves
        is."""
        for body in self._permanent:
            met = self.sweeps.at_once(among(chosen, len(self.directions)), body)
            chosen = [k for k in chosen if not met[k]]
        found = dict.fromkeys(chosen, 0)
        for body in self._movable:
            met = self.sweeps.at_once(among(chosen, len(self.directions)), body)
            found = {k: state | int(met[k]) << body for k, state in found.items()}
        return found

    def look(self, chosen: list[int]) -> list[int]:
        """Asks what is met along some directions, without those along which what never leaves is in the way."""
        for body in self._permanent:
            self.sweeps.ask(among(chosen, len(self.directions)), [body])
            chosen = [k for k in chosen if self.sweeps.hits[k, body] > self._least[k]]
        self.sweeps.ask(among(chosen, len(self.directions)), self._movable)
        return chosen

    def _rise(self, k: int) -> float:
        return 1.0 if self.turning else float(self.directions[k, 2])

    def _down(self, k: int) -> bool:
        return not self.turning and bool(self.directions[k, 2] < DOWN - 1e-9)


def look_along(groups: Sequence[Straight], ranking: Ranking, way: Callable[[Straight, int], Figures | None]) -> None:
    """Looks along the directions of some groups as far as their ranking wants it.

    Args:
        ranking: has the candidates of all groups.
        way: figures of the way along a direction of a group, of which all that it meets was asked; None where there is
            none.
    """
    places = {number: (ways, k) for ways in groups for k, number in enumerate(ways.numbers)}
    while wanted := ranking.wanted(GLANCES, LOOKS):
        for ways in groups:
            chosen = {places[each.number][1]: each for each in wanted if places[each.number][0] is ways}
            if not chosen:
                continue
            if not wanted[0].glanced:
                met = ways.glance(list(chosen))
                for k in met:
                    chosen[k].glanced = True
                    chosen[k].at_best = chosen[k].at_best._replace(blockers=met[k])
                left = set(met)
            else:
                left = set()
                for k in ways.look(list(chosen)):
                    chosen[k].way = way(ways, k)
                    if chosen[k].way is not None:
                        left.add(k)
            for k, candidate in chosen.items():
                if k in left:
                    ranking.known(candidate)
                else:
                    ranking.drop(candidate)
