"""All states that can be reached from the root by gravity and lifting alone, and dynamic programming over them.

States are stored as rows of 64-bit words, bit k of a row being the k-th *removable* part, so that up to 64 removable
parts need one word, however the parts are numbered. They are ordered by the number of parts, the root first: every edge
leads to a later row, and one sweep in either direction solves the dynamic programme. Everything that touches all states
is compiled.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from takeapart.compilation import compiled
from takeapart.model.errors import InputError
from takeapart.problem import Problem
from takeapart.removal.result import never
from takeapart.states import Words, members, pack, unpack, words_needed

Numbers = NDArray[np.int64]
Values = NDArray[np.float64]

LARGEST_LATTICE = 2**31 - 2  # edges are numbered with 32 bits


@dataclass(frozen=True)
class TooLarge:
    """The enumeration was given up: there are more states than the limit."""

    limit: int


@dataclass(frozen=True, eq=False)
class Lattice:
    """Reachable states and the edges between them; N states, E edges, P removable parts, W words per state.

    Args:
        parts: (P,) numbers of the removable parts, ascending; bit k of a packed state stands for parts[k].
        states: (N, W) packed states, those with most parts first; row 0 is the root.
        first_edge: (N + 1,) edges of state i are first_edge[i] .. first_edge[i + 1] - 1, by ascending part.
        edge_part: (E,) position of the leaving part in `parts`.
        child: (E,) row of the state without that part.
        goal: row of the empty state, or -1 if it cannot be reached.
        part_edge: (E,) edge numbers, grouped by part, ascending within each.
        part_source: (E,) rows of the states that those edges leave.
        first_of_part: (P + 1,) the group of part k is first_of_part[k] .. first_of_part[k + 1] - 1.
    """

    parts: tuple[int, ...]
    states: Words
    first_edge: Numbers
    edge_part: NDArray[np.int16]
    child: NDArray[np.int32]
    goal: int
    part_edge: NDArray[np.int32]
    part_source: NDArray[np.int32]
    first_of_part: Numbers

    def state(self, row: int) -> int:
        """The state of a row, as a mask over part numbers."""
        packed = int.from_bytes(self.states[row].astype("<u8").tobytes(), "little")
        return sum(1 << self.parts[k] for k in members(packed))

    def edges(self, row: int) -> range:
        """Numbers of the edges that leave a state."""
        return range(int(self.first_edge[row]), int(self.first_edge[row + 1]))

    def part(self, edge: int) -> int:
        """Number of the part that leaves by an edge."""
        return self.parts[int(self.edge_part[edge])]

    def smallest_states(self) -> dict[int, int]:
        """Per part that can ever leave, the parts that are present whenever it does; no state it leaves is smaller."""
        smallest = {}
        for k, part in enumerate(self.parts):
            group = slice(self.first_of_part[k], self.first_of_part[k + 1])
            if group.start < group.stop:
                common = _intersection(self.states, self.part_source[group])
                smallest[part] = unpack(common, self.parts)
        return smallest


def enumerate_states(problem: Problem, limit: int, is_late: Callable[[], bool] = never) -> Lattice | TooLarge | None:
    """All states reachable from the root by `candidates`.

    Where the problem has `freedom` (part p may leave state s if any mask of `freedom[p]` shares no part with it), the
    enumeration is compiled; otherwise `candidates` is asked once per state.

    Args:
        limit: of the number of states.
        is_late: whether the time is over; looked at between layers.

    Returns:
        None where the time was over first.

    Raises:
        InputError: a limit below 1 or too high for 32-bit edge numbers.
    """
    if not 1 <= limit <= LARGEST_LATTICE // 8:
        raise InputError(f"{limit} states; must be between 1 and {LARGEST_LATTICE // 8}", "state limit")
    parts = tuple(members(problem.root))
    freedom = problem.freedom
    expand: Callable[[Words, int], _Layer | None]
    if freedom is None:

        def expand(layer: Words, room: int) -> _Layer | None:
            return _expand_by_asking(problem, parts, layer, room)

    else:
        free = sum(any(not mask & problem.root for mask in freedom[part]) for part in parts)
        if 2**free > limit:  # parts that may leave at once leave in any order: each subset of them is a state
            return TooLarge(limit)
        first_mask = np.cumsum([0, *(len(freedom[part]) for part in parts)])
        packed = [pack(mask, parts) for part in parts for mask in freedom[part]]
        masks = np.array(packed, dtype=np.uint64).reshape(len(packed), words_needed(len(parts)))

        def expand(layer: Words, room: int) -> _Layer | None:
            return _expand_by_masks(masks, first_mask, layer, room)

    layers = [pack(problem.root, parts)[None, :]]
    edges: list[_Layer] = []
    total = 1
    while True:
        if is_late():
            return None
        found = expand(layers[-1], limit - total)
        if found is None:
            return TooLarge(limit)
        edges.append(found)
        if not len(found.states):
            break
        layers.append(found.states)
        total += len(found.states)
    return _assemble(parts, layers, edges)


@dataclass(frozen=True, eq=False)
class _Layer:
    """What a layer leads to: edges per state, then part and child (counted within the next layer) of every edge."""

    degree: Numbers
    part: NDArray[np.int16]
    child: NDArray[np.int32]
    states: Words


def _expand_by_masks(masks: Words, first_mask: Numbers, layer: Words, room: int) -> _Layer | None:
    degree = _count_candidates(layer, masks, first_mask)
    count = int(degree.sum())
    part, child = np.empty(count, np.int16), np.empty(count, np.int32)
    capacity = min(count, room + 1)
    states = np.empty((capacity, layer.shape[1]), np.uint64)
    slots = np.full(1 << max(4, (2 * capacity).bit_length()), -1, np.int32)
    found = _expand_layer(layer, masks, first_mask, part, child, states, slots)
    return None if found < 0 or found > room else _Layer(degree, part, child, states[:found].copy())


def _expand_by_asking(problem: Problem, parts: tuple[int, ...], layer: Words, room: int) -> _Layer | None:
    position = {part: k for k, part in enumerate(parts)}
    rows: dict[int, int] = {}
    degree, edge_part, edge_child = [], [], []
    for words in layer:
        state = unpack(words, parts)
        candidates = sorted(problem.candidates(state))
        degree.append(len(candidates))
        for part in candidates:
            edge_part.append(position[part])
            edge_child.append(rows.setdefault(state & ~(1 << part), len(rows)))
        if len(rows) > room:
            return None
    states = np.array([pack(state, parts) for state in rows], np.uint64).reshape(len(rows), layer.shape[1])
    return _Layer(np.array(degree, np.int64), np.array(edge_part, np.int16), np.array(edge_child, np.int32), states)


def _assemble(parts: tuple[int, ...], layers: list[Words], edges: list[_Layer]) -> Lattice:
    states = np.concatenate(layers)
    first_edge = np.zeros(len(states) + 1, np.int64)
    np.cumsum(np.concatenate([layer.degree for layer in edges]), out=first_edge[1:])
    edge_part = np.concatenate([layer.part for layer in edges])
    child = np.empty(len(edge_part), np.int32)
    row = edge = 0
    for states_here, layer in zip(layers, edges, strict=True):
        row += len(states_here)
        child[edge : edge + len(layer.child)] = layer.child + np.int32(row)
        edge += len(layer.child)
    goal = len(states) - 1 if not states[-1].any() else -1
    first_of_part = np.zeros(len(parts) + 1, np.int64)
    np.cumsum(np.bincount(edge_part, minlength=len(parts)), out=first_of_part[1:])
    part_edge, part_source = np.empty(len(edge_part), np.int32), np.empty(len(edge_part), np.int32)
    _group_by_part(first_edge, edge_part, first_of_part.copy(), part_edge, part_source)
    return Lattice(parts, states, first_edge, edge_part, child, goal, part_edge, part_source, first_of_part)


@compiled
def _may_leave(state, masks, first_mask, k):  # type: ignore[no-untyped-def]
    if not (state[k >> 6] >> np.uint64(k & 63)) & np.uint64(1):
        return False
    for m in range(first_mask[k], first_mask[k + 1]):
        free = True
        for w in range(state.shape[0]):
            if state[w] & masks[m, w]:
                free = False
        if free:
            return True
    return False


@compiled
def _count_candidates(layer, masks, first_mask):  # type: ignore[no-untyped-def]
    degree = np.zeros(layer.shape[0], np.int64)
    for i in range(layer.shape[0]):
        for k in range(first_mask.shape[0] - 1):
            if _may_leave(layer[i], masks, first_mask, k):
                degree[i] += 1
    return degree


@compiled
def _expand_layer(layer, masks, first_mask, part, child, states, slots):  # type: ignore[no-untyped-def]
    """Fill edges and next states, found by open addressing in `slots`; their number, or -1 if `states` is too small."""
    words, capacity = layer.shape[1], states.shape[0]
    last = np.uint64(slots.shape[0] - 1)
    leaving = np.empty(words, np.uint64)
    found = edge = 0
    for i in range(layer.shape[0]):
        for k in range(first_mask.shape[0] - 1):
            if not _may_leave(layer[i], masks, first_mask, k):
                continue
            key = np.uint64(0x9E3779B97F4A7C15)
            for w in range(words):
                leaving[w] = layer[i, w]
                if w == k >> 6:
                    leaving[w] ^= np.uint64(1) << np.uint64(k & 63)
                key = (key ^ leaving[w]) * np.uint64(0xBF58476D1CE4E5B9)  # splitmix64 (Steele et al. 2014)
                key ^= key >> np.uint64(29)
            key *= np.uint64(0x94D049BB133111EB)
            slot = (key ^ (key >> np.uint64(32))) & last
            while True:
                row = slots[slot]
                if row < 0:
                    if found == capacity:
                        return -1
                    slots[slot] = row = found
                    states[found] = leaving
                    found += 1
                    break
                same = True
                for w in range(words):
                    if states[row, w] != leaving[w]:
                        same = False
                if same:
                    break
                slot = (slot + np.uint64(1)) & last
            part[edge] = k
            child[edge] = row
            edge += 1
    return found


@compiled
def _group_by_part(first_edge, edge_part, position, part_edge, part_source):  # type: ignore[no-untyped-def]
    for i in range(first_edge.shape[0] - 1):
        for e in range(first_edge[i], first_edge[i + 1]):
            k = edge_part[e]
            part_edge[position[k]] = e
            part_source[position[k]] = i
            position[k] += 1


@compiled
def _intersection(states, rows):  # type: ignore[no-untyped-def]
    common = states[rows[0]].copy()
    for row in rows:
        for w in range(common.shape[0]):
            common[w] &= states[row, w]
    return common


@compiled
def cost_to_go(first_edge, child, cost, rows, value):  # type: ignore[no-untyped-def]
    """Cheapest sum of edge costs from every state to the goal, by one backward sweep.

    Args:
        cost: (E,) m, infinite allowed.
        rows: ascending rows of the states to bring up to date; the others keep their value.
        value: (N,) m, overwritten for `rows`; must be 0 at the goal, which is not in `rows`.
    """
    for position in range(rows.shape[0] - 1, -1, -1):
        i = rows[position]
        best = math.inf
        for e in range(first_edge[i], first_edge[i + 1]):
            best = min(best, cost[e] + value[child[e]])
        value[i] = best


@compiled
def cost_from_root(first_edge, child, cost, rows, value):  # type: ignore[no-untyped-def]
    """Cheapest sum of edge costs from the root to every state that `rows` lead to, by one forward sweep.

    Args: as for `cost_to_go`; `value` must be 0 at the root and infinite elsewhere in `rows` and their children.
    """
    for position in range(rows.shape[0]):
        i = rows[position]
        for e in range(first_edge[i], first_edge[i + 1]):
            value[child[e]] = min(value[child[e]], value[i] + cost[e])
