"""States of an assembly, and the forms in which they are handed around.

A state is an integer whose bit i says that part i is still there; so is every mask of parts. Kernels take flags, one
byte per part and one more for all that never leaves; what holds many states packs each into 64-bit words.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Flags = NDArray[np.uint8]
Words = NDArray[np.uint64]


def members(state: int) -> list[int]:
    """Numbers of the parts in a state, ascending."""
    found = []
    while state:
        low = state & -state
        found.append(low.bit_length() - 1)
        state ^= low
    return found


def flags_of(state: int, parts: int) -> Flags:
    """Flags (parts + 1,) of a state; the last one, for everything that never leaves, is set."""
    raw = np.frombuffer(state.to_bytes(parts // 8 + 1, "little"), dtype=np.uint8)
    flags = np.unpackbits(raw, bitorder="little")[: parts + 1].copy()
    flags[parts] = 1
    return flags


def state_of(flags: Flags) -> int:
    """State of the parts flagged; the last flag, for what never leaves, is not part of it."""
    return int.from_bytes(np.packbits(flags[:-1], bitorder="little").tobytes(), "little")


def states_of(flags: Flags) -> list[int]:
    """As `state_of`, for every row of flags (K, parts + 1)."""
    return owners_of(flags[:, :-1])


def owners_of(flags: Flags) -> list[int]:
    """Masks of the owners flagged in every row (K, parts + 1), among them number `parts`: what never leaves."""
    return [int.from_bytes(row.tobytes(), "little") for row in np.packbits(flags, axis=1, bitorder="little")]


def pack(state: int, parts: Sequence[int]) -> Words:
    """(W,) words of a state; parts that are not removable are left out."""
    packed = sum(1 << k for k, part in enumerate(parts) if state >> part & 1)
    return np.frombuffer(packed.to_bytes(8 * words_needed(len(parts)), "little"), dtype="<u8").astype(np.uint64)


def unpack(words: Words, parts: Sequence[int]) -> int:
    """The state of packed words, as a mask over part numbers."""
    return sum(1 << parts[k] for k in members(int.from_bytes(words.astype("<u8").tobytes(), "little")))


def words_needed(parts: int) -> int:
    """64-bit words that a packed state of this many removable parts takes."""
    return max(1, -(-parts // 64))


def seed_words(state: int) -> list[int]:
    """A state in 32-bit words, the lowest first and at least one, as random generators take it."""
    return [state >> shift & 0xFFFFFFFF for shift in range(0, max(state.bit_length(), 1), 32)]
