"""Arrays that cost time to work out, kept in the cache folder: once found, they are read."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from takeapart.caching import cache_folder, read_array


def kept(name: str) -> NDArray[Any] | None:
    """The array kept under a name; None where there is none, or where its file is damaged. The caller checks shape and
    type: whatever does not fit is made again.
    """
    try:
        return read_array(cache_folder() / f"{name}.npy")
    except (OSError, ValueError, EOFError):
        return None


def is_kept(name: str) -> bool:
    """Whether there is a file for an array of this name, damaged or not."""
    return (cache_folder() / f"{name}.npy").is_file()


def keep(name: str, array: NDArray[Any]) -> None:
    """Keeps an array, all of it or nothing; without a place for it, it is made again next time."""
    file = cache_folder() / f"{name}.npy"
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        temporary = file.with_suffix(f".{os.getpid()}.npy")
        np.save(temporary, array, allow_pickle=False)
        temporary.replace(file)
    except OSError:
        pass
