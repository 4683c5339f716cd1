"""Which of many grasps of a part are tried: good ones, from all sides."""

from __future__ import annotations

import math

import numpy as np

from takeapart.model.geometry import Array
from takeapart.removal.candidates import GraspCandidate

MOST_POSES = 240  # of a part; each in both finger orders
# From which steepness downwards: how many poses of a kind are taken at a time, and of all kinds while others are left.
TURNS = ((0.7, 4, 120), (-0.3, 2, 88), (-math.inf, 1, 32))
SAME_PLACE, SAME_TURN = 0.006, math.cos(math.radians(20))


def spread_out(poses: Array, widths: Array, costs: Array, steep: Array) -> tuple[GraspCandidate, ...]:
    """The best of poses (K, 4, 4), none much like a better one, and both finger orders of each.

    Poses with about the same approach and closing directions are one kind. Kinds take turns, so that whatever stands
    around the part leaves some; those from above give more each turn.
    """
    order = np.lexsort((*np.round(poses[:, :3, 3], 5).T, np.round(costs, 6)))
    poses, widths, steep = poses[order], widths[order], steep[order]
    kinds: list[list[int]] = []
    left = np.ones(len(poses), dtype=np.bool_)
    while left.any():
        k = int(np.argmax(left))
        same = left & (poses[:, :3, 2] @ poses[k, :3, 2] > SAME_TURN)
        same &= np.abs(poses[:, :3, 1] @ poses[k, :3, 1]) > SAME_TURN
        left &= ~same
        members = np.nonzero(same)[0]
        apart: list[int] = []
        while len(members) and len(apart) < MOST_POSES:
            apart.append(int(members[0]))
            away = np.linalg.norm(poses[members, :3, 3] - poses[members[0], :3, 3], axis=1)
            members = members[away >= SAME_PLACE]
        kinds.append(apart)
    taken = _in_turns(kinds, [next(k for k, turn in enumerate(TURNS) if steep[kind[0]] >= turn[0]) for kind in kinds])
    candidates = []
    for T, width in zip(poses[taken], widths[taken].tolist(), strict=True):
        exchanged = T.copy()
        exchanged[:3, :2] *= -1
        candidates += [GraspCandidate(T.copy(), width), GraspCandidate(exchanged, width)]
    return tuple(candidates)


def _in_turns(kinds: list[list[int]], steepness: list[int]) -> list[int]:
    """Up to `MOST_POSES` members of kinds, ascending; from each kind as many at a time as its row of `TURNS` says."""
    taken: list[int] = []
    room = [most for _, _, most in TURNS]
    while any(kinds) and len(taken) < MOST_POSES:
        if not any(kind and room[row] for kind, row in zip(kinds, steepness, strict=True)):
            room = [MOST_POSES] * len(TURNS)
        for kind, row in zip(kinds, steepness, strict=True):
            count = min(TURNS[row][1], room[row], len(kind), MOST_POSES - len(taken))
            taken += kind[:count]
            del kind[:count]
            room[row] -= count
    return sorted(taken)
