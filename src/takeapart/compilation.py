"""Compiled kernels and where their machine code is kept.

numba keeps the machine code of a function as long as the function's own file does not change. A kernel contains the
code
of the kernels that it calls, also of those in other files, so that is not enough: here the folder of the machine
code is
named after the content of all of the package's sources, and changing any of them compiles anew.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, ParamSpec, TypeVar

import numba

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


def cache_folder() -> Path:
    """Where results that only cost time are kept: TAKEAPART_CACHE, or takeapart/ in the user's cache folder."""
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(os.environ.get("TAKEAPART_CACHE") or str(Path(base) / "takeapart"))


def _sources_digest() -> str:
    """Digest of all sources that hold kernels or the types they work on."""
    package = Path(__file__).parent
    digest = hashlib.sha256()
    for folder in ("robot", "motion", "search"):
        for source in sorted((package / folder).glob("*.py")):
            digest.update(source.name.encode() + source.read_bytes())
    return digest.hexdigest()[:16]


# Before any kernel is defined: numba decides where a function's machine code goes when it is decorated.
numba.config.CACHE_DIR = str(cache_folder() / f"kernels-{numba.__version__}-{_sources_digest()}")  # type: ignore[attr-defined]


def compiled(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Compiles a kernel when it is first called, without the interpreter lock, and keeps the machine code on disk."""
    kernel: Callable[Parameters, Result] = numba.njit(cache=True, nogil=True)(function)
    return kernel


def compiled_lean(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """As `compiled`, for kernels that allocate nothing: their code does not count references to arrays.

    The counters of the many arrays that a kernel is handed cost more than the work on them (half of the time of a
    configuration check). The caller holds the arrays as long as the kernel runs, so nothing is lost.
    """
    options: dict[str, Any] = {"cache": True, "nogil": True, "_nrt": False}  # numba's stubs do not know `_nrt`
    kernel: Callable[Parameters, Result] = numba.njit(**options)(function)
    return kernel


def is_compiled(module: ModuleType) -> bool:
    """Whether the cache holds machine code of a kernel of the module; True for a module without kernels.

    A guess that costs no compilation: numba itself compares versions and processor too.
    """
    name = module.__name__.rpartition(".")[2]
    # The attributes are numba's: `_cache` of a compiled function, `cache_path` of its cache.
    caches = [getattr(member, "_cache", None) for member in vars(module).values()]
    paths = [getattr(cache, "cache_path", None) for cache in caches]
    folders = {Path(path) for path in paths if path}
    return not folders or any(next(folder.glob(f"{name}.*.nbi"), None) for folder in folders)
