"""Groups of arrays that cost time to work out, kept in the cache folder under a name that stands for their content."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from takeapart.caching import cache_folder, read_arrays


def kept_arrays(name: str, dimensions: Mapping[str, int]) -> dict[str, NDArray[Any]] | None:
    """The arrays kept under a name, each with as many dimensions as said; None where any is missing or damaged."""
    try:
        kept = read_arrays(cache_folder() / f"{name}.npz")
        found = {key: kept[key] for key in dimensions}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        return None
    return found if all(found[key].ndim == count for key, count in dimensions.items()) else None


def keep_arrays(name: str, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Keeps arrays, all of them or nothing; without a place for them, they are made again next time."""
    file = cache_folder() / f"{name}.npz"
    temporary = file.with_suffix(f".{os.getpid()}.npz")
    try:
        np.savez(temporary, allow_pickle=False, **dict(arrays))
        temporary.replace(file)
    except OSError:
        temporary.unlink(missing_ok=True)
