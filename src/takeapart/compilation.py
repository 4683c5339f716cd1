"""Compiled kernels and where their machine code is kept.

numba keeps the machine code of a function as long as the function's own file does not change. A kernel contains the
code of the kernels that it calls, also of those in other files, so that is not enough: here the folder of the machine
code is named after the content of all sources with kernels that can call each other, and changing any of them compiles
anew.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Sequence
from functools import cache
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


def _sources_digest(folders: Sequence[str]) -> str:
    """Digest of the sources in some folders of the package that hold kernels, or the types that kernels work on."""
    package = Path(__file__).parent
    digest = hashlib.sha256()
    for folder in folders:
        for source in sorted((package / folder).glob("*.py")):
            text = source.read_bytes()
            if b"@compiled" in text or source.name == "arrays.py":
                digest.update(source.name.encode() + text)
    return digest.hexdigest()[:16]


@cache
def _kernel_folder(module: str) -> str:
    """Folder for the machine code of a module: geometry calls no kernels of the searches, nor they any of it."""
    group = ("search",) if module.startswith("takeapart.search") else ("robot", "motion")
    return str(cache_folder() / f"{group[0]}-kernels-{numba.__version__}-{_sources_digest(group)}")


def _options(function: Callable[..., Any], **more: Any) -> dict[str, Any]:
    # numba decides where a function's machine code goes when it is decorated.
    numba.config.CACHE_DIR = _kernel_folder(function.__module__)  # type: ignore[attr-defined]
    return {"cache": True, "nogil": True, **more}


def compiled(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Compiles a kernel when it is first called, without the interpreter lock, and keeps the machine code on disk."""
    kernel: Callable[Parameters, Result] = numba.njit(**_options(function))(function)
    return kernel


def compiled_lean(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """As `compiled`, for kernels that allocate nothing: their code becomes part of every caller's, and does not count
    references to arrays.

    Both are about the many arrays that a kernel is handed. Their counters cost more than the work on them, and so does
    handing them on: a call copies seven words for each. The caller holds the arrays as long as the kernel runs, so
    nothing is lost.
    """
    # numba's stubs do not know `_nrt`.
    kernel: Callable[Parameters, Result] = numba.njit(**_options(function, _nrt=False, forceinline=True))(function)
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
