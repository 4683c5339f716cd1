"""Experience as arrays to learn from: the recorded states of all assemblies, and what is known of every Q-value.

In-sample backup. The recorded removals of an assembly are the edges of a graph that leads from state to state down to
the empty one. Going up from there,

    Q(s, a) = r(s, a) + V(s - a),    V(s) = max over the recorded a of Q(s, a),    V(empty) = 0,

with the best reward recorded for an edge: the best continuation that was seen is the target. That is dynamic
programming, not an estimate; it needs no target network, and what it gives was really reached by recorded removals. A
dead end, parts left and none that gravity and lifting let go, is worth minus a fixed price per part left. A state from
which nothing was recorded has no value, and neither has an edge that leads there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl
from numpy.typing import NDArray

from takeapart.guide.experience import Experience
from takeapart.guide.graph import GraphBatch, Indices, Numbers, part_geometry
from takeapart.model.assembly import Assembly
from takeapart.states import members

GOAL = -1  # instead of the row of the empty state


@dataclass(frozen=True, eq=False)
class StateTable:
    """S states of several assemblies. A place stands for a part in a state; F places in all, T parts in all.

    States are sorted by assembly, then by the number of parts; the places of a state by part number.

    Args:
        names: of the assemblies.
        corners: (T, 24) m, of the parts of all assemblies; see `graph.PartGeometry`.
        middles: (T, 3) m.
        assembly: (S,) position in `names`.
        first: (S + 1,) the places of state i are first[i] .. first[i + 1] - 1.
        nodes: (F,) row of the part in `corners`.
        allowed: (F,) whether gravity and lifting let the part go; false in states that no removal leads to.
        reached: (F,) Q-value by in-sample backup, m; not a number where unknown.
        least: (F,) the greatest Q-value that exact search leaves possible, m; not a number where it says nothing.
        known: (F,) the Q-value that exact search knows, m; not a number where it does not.
        step_place: (R,) per recorded removal, its place.
        step_reward: (R,) m.
        step_next: (R,) row of the next state; GOAL where no part is left.
        mean_reward: mean over the assemblies of the mean over their different edges, m.
    """

    names: tuple[str, ...]
    corners: Numbers
    middles: Numbers
    assembly: Indices
    first: Indices
    nodes: Indices
    allowed: NDArray[np.bool_]
    reached: Numbers
    least: Numbers
    known: Numbers
    step_place: Indices
    step_reward: Numbers
    step_next: Indices
    mean_reward: float

    @property
    def counts(self) -> Indices:
        """(S,) parts per state."""
        return np.diff(self.first)

    @property
    def best_known(self) -> Numbers:
        """(F,) Q-value to judge a choice by, m: what exact search knows or else what was reached.

        Not the greater of both: removals that another search found for some actions only would decide the comparison.
        """
        return np.where(np.isnan(self.known), self.reached, self.known)

    def states_of_places(self) -> Indices:
        """(F,) row of the state of every place."""
        return np.repeat(np.arange(len(self.first) - 1), self.counts)

    def rows_of(self, names: Sequence[str]) -> Indices:
        """Rows of the states of some assemblies."""
        wanted = [i for i, name in enumerate(self.names) if name in names]
        return np.nonzero(np.isin(self.assembly, wanted))[0]

    def places(self, rows: Indices) -> tuple[Indices, NDArray[np.bool_]]:
        """(B, N) places of some states, padded with the first place of each, and (B, N) what is no padding."""
        counts = self.counts[rows]
        column = np.arange(max(int(counts.max(initial=0)), 1))
        present = column < counts[:, None]
        return np.where(present, self.first[rows][:, None] + column, self.first[rows][:, None]), present

    def batch(self, places: Indices, present: NDArray[np.bool_]) -> GraphBatch:
        """The graphs of some states, from what `places` gave."""
        nodes = self.nodes[places]
        middles = self.middles[nodes]
        edges = middles[:, None, :, :] - middles[:, :, None, :]
        return GraphBatch(self.corners[nodes], edges, present, np.where(present, nodes, -1))


def state_table(experience: Experience, dead_end: float) -> StateTable:
    """The recorded states of all assemblies.

    Args:
        dead_end: price of a dead end per part left, m.
    """
    pieces = [
        _of_assembly(experience.table.filter(pl.col("assembly_hash") == key), assembly, dead_end)
        for key, assembly in sorted(experience.assemblies.items(), key=lambda item: (item[1].name, item[0]))
    ]
    states = np.cumsum([0] + [len(piece.first) - 1 for piece in pieces])
    places = np.cumsum([0] + [len(piece.nodes) for piece in pieces])
    parts = np.cumsum([0] + [len(piece.corners) for piece in pieces])
    shifted_next = [
        np.where(piece.step_next == GOAL, GOAL, piece.step_next + shift)
        for piece, shift in zip(pieces, states, strict=False)
    ]
    return StateTable(
        names=tuple(piece.names[0] for piece in pieces),
        corners=np.concatenate([piece.corners for piece in pieces]),
        middles=np.concatenate([piece.middles for piece in pieces]),
        assembly=np.repeat(np.arange(len(pieces)), np.diff(states)),
        first=np.concatenate([[0], *(piece.first[1:] + s for piece, s in zip(pieces, places, strict=False))]),
        nodes=np.concatenate([piece.nodes + s for piece, s in zip(pieces, parts, strict=False)]),
        allowed=np.concatenate([piece.allowed for piece in pieces]),
        reached=np.concatenate([piece.reached for piece in pieces]),
        least=np.concatenate([piece.least for piece in pieces]),
        known=np.concatenate([piece.known for piece in pieces]),
        step_place=np.concatenate([piece.step_place + s for piece, s in zip(pieces, places, strict=False)]),
        step_reward=np.concatenate([piece.step_reward for piece in pieces]),
        step_next=np.concatenate(shifted_next),
        mean_reward=math.fsum(piece.mean_reward for piece in pieces) / len(pieces),
    )


def _of_assembly(table: pl.DataFrame, assembly: Assembly, dead_end: float) -> StateTable:
    masks = {text: int(text, 16) for text in {*table["state"].to_list(), *table["next_state"].to_list()}}
    states = sorted((mask for mask in masks.values() if mask), key=lambda mask: (mask.bit_count(), mask))
    row_of = {state: row for row, state in enumerate(states)}
    first = np.cumsum([0] + [state.bit_count() for state in states])
    size = int(first[-1])

    def place(state: int, part: int) -> int:
        return int(first[row_of[state]]) + (state & ((1 << part) - 1)).bit_count()

    allowed = np.zeros(size, np.bool_)
    followers = table.select("next_state", "next_actions").unique(subset=["next_state"], maintain_order=True)
    dead: set[int] = set()
    for text, actions in followers.iter_rows():
        state = masks[text]
        allowed[[place(state, action) for action in actions]] = True
        if state and not actions:
            dead.add(state)

    steps = [
        (place(masks[state], part), reward, row_of.get(masks[following], GOAL))
        for state, part, reward, following in table.select("state", "part", "reward", "next_state").iter_rows()
    ]
    step_place, step_reward, step_next = (np.array(column) for column in zip(*steps, strict=True))
    reward = np.full(size, -np.inf)
    np.maximum.at(reward, step_place, step_reward)
    following = np.full(size, GOAL)
    following[step_place] = step_next

    reached = np.full(size, np.nan)
    value = np.full(len(states), np.nan)
    for row, state in enumerate(states):  # those with fewest parts first: every edge leads to an earlier row
        here = np.arange(first[row], first[row + 1])
        here = here[np.isfinite(reward[here])]
        after = np.where(following[here] == GOAL, 0.0, value[following[here]])
        reached[here] = reward[here] + after
        if state in dead:
            value[row] = -dead_end * state.bit_count()
        elif np.isfinite(reached[here]).any():
            value[row] = np.nanmax(reached[here])

    known, least = np.full(size, np.nan), np.full(size, np.nan)
    for name, target in (("bound", known), ("least", least)):
        rows = table.filter(pl.col(name).is_not_null()).select("state", "part", name)
        if rows.height:
            found = np.array([place(masks[state], part) for state, part, _ in rows.iter_rows()])
            best = np.full(size, np.inf)
            np.minimum.at(best, found, rows[name].to_numpy())
            target[found] = -best[found]
    geometry = part_geometry(assembly)
    return StateTable(
        names=(assembly.name,),
        corners=geometry.corners,
        middles=geometry.middles,
        assembly=np.zeros(len(states), np.int64),
        first=first,
        nodes=np.array([part for state in states for part in members(state)], np.int64),
        allowed=allowed,
        reached=reached.astype(np.float32),
        least=least.astype(np.float32),
        known=known.astype(np.float32),
        step_place=step_place.astype(np.int64),
        step_reward=step_reward.astype(np.float32),
        step_next=step_next.astype(np.int64),
        mean_reward=float(reward[np.isfinite(reward)].mean()),
    )
