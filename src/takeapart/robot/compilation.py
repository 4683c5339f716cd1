"""Whether compiled kernels lie in numba's cache on disk: compiling them takes a minute, which wants a notice."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType


def is_compiled(module: ModuleType) -> bool:
    """Whether the cache holds an index of a kernel of the module that is at least as new as the module's source.

    A guess that costs no compilation: numba itself compares versions and processor too, and compiles again where they
    differ. True for a module without cached kernels.
    """
    name = module.__name__.rpartition(".")[2]
    source = Path(str(module.__file__))
    # The attributes are numba's: `_cache` of a compiled function, `cache_path` of its cache.
    caches = [getattr(member, "_cache", None) for member in vars(module).values()]
    paths = [getattr(cache, "cache_path", None) for cache in caches]
    folders = {Path(path) for path in paths if path}
    if not folders:
        return True
    indices = [index for folder in folders for index in folder.glob(f"{name}.*.nbi")]
    return any(index.stat().st_mtime >= source.stat().st_mtime for index in indices)
