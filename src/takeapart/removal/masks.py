"""Translation between states (masks of parts) and the flag arrays of the kernels."""

from __future__ import annotations

import numpy as np

from takeapart.robot.arrays import Flags


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
