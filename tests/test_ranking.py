"""The ranking of ways out, asked lazily, against the same done with everything known."""

from __future__ import annotations

import numpy as np
import pytest

from takeapart.removal.ranking import Candidate, Ranking
from takeapart.removal.selection import Figures

ALIKE, SAME_LENGTH = 2, 0.01
UP = (0.0, 0.0, 1.0)


def kept_of(ways: list[Figures]) -> list[int]:
    """Numbers of the ways that are kept, by the rule in its plainest form."""

    def rank(number: int) -> tuple[int, bool, float, float, int]:
        way = ways[number]
        return way.blockers.bit_count(), way.down, round(-way.rise, 6), round(way.length, 6), number

    kept: list[int] = []
    for number in sorted(range(len(ways)), key=rank):
        way = ways[number]
        better = [
            ways[k] for k in kept if ways[k].blockers | way.blockers == way.blockers
            and ways[k].length <= way.length + SAME_LENGTH
        ]  # fmt: skip
        apart = all(
            np.degrees(np.arccos(np.clip(np.dot(way.towards or UP, other.towards or UP), -1, 1))) > 25
            for other in better
        )
        alike = bool(better) and len(better) <= ALIKE and better[0].blockers == way.blockers
        apart = apart or not way.leans
        spare = way.towards == UP and ways[kept[0]].blockers != 0 if kept else False
        if not better or (alike and apart) or spare:
            kept.append(number)
    return kept


def lazily(ways: list[Figures], best: list[Figures], glances: list[int], ranking: Ranking) -> set[int]:
    """The numbers that were looked at until the ranking wanted no more."""
    looked: set[int] = set()
    while wanted := ranking.wanted(5, 3):
        for each in wanted:
            if each.glanced:
                looked.add(each.number)
                each.way = ways[each.number]
            else:
                each.glanced = True
                each.at_best = each.at_best._replace(blockers=glances[each.number])
            ranking.known(each)
    return looked


@pytest.mark.parametrize("seed", range(60))
def test_what_is_kept_is_looked_at_and_much_else_is_not(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count, ways, best, glances = 80, [], [], []
    for _ in range(count):
        blockers = int(rng.integers(0, 16)) & int(rng.integers(0, 16))
        rise, length = float(np.round(rng.uniform(-1, 1), 2)), float(rng.uniform(0.01, 0.08))
        angle = float(rng.uniform(-np.pi, np.pi))
        level = float(np.sqrt(1 - rise * rise))
        ways.append(
            Figures(
                blockers,
                rise < -0.05,
                rise,
                length,
                (level * np.cos(angle), level * np.sin(angle), rise),
                bool(rng.uniform() < 0.5),
            )
        )
        if rng.uniform() < 0.2:  # it may turn upwards
            best.append(Figures(0, False, 1.0, 0.01, None))
        else:
            best.append(Figures(0, rise < -0.05, rise, length * float(rng.uniform(0.5, 1)), None))
        glances.append(blockers & int(rng.integers(0, 16)))
    ways[0] = Figures(ways[0].blockers, False, 1.0, ways[0].length, UP)  # known from the start, as the ways out ask it
    ranking = Ranking()
    ranking.add([Candidate(0, ways[0], way=ways[0])])
    ranking.add(Candidate(k, best[k]) for k in range(1, count // 2))
    looked = {0} | lazily(ways, best, glances, ranking)
    assert set(kept_of(ways[: count // 2])) <= looked
    ranking.add(Candidate(k, best[k]) for k in range(count // 2, count))
    looked |= lazily(ways, best, glances, ranking)
    kept = kept_of(ways)
    assert set(kept) <= looked
    seen = sorted(looked)
    assert [seen[k] for k in kept_of([ways[k] for k in seen])] == kept  # and the rest changes nothing
    assert len(looked) < 0.9 * count


def test_what_has_no_way_keeps_nothing_away() -> None:
    ranking = Ranking()
    ranking.add([Candidate(0, Figures(0, False, 1.0, 0.02, None)), Candidate(1, Figures(0, False, 0.5, 0.02, None))])
    for candidate in ranking.wanted(1, 1):
        assert candidate.number == 0
        ranking.drop(candidate)
    assert [each.number for each in ranking.wanted(1, 1)] == [1]
