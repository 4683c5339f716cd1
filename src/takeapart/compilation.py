"""Compiled kernels and where their machine code is kept.

numba keeps the machine code of a function as long as the function's own file does not change. A kernel contains the
code of the kernels that it calls, also of those in other files, so that is not enough: here the folder of the machine
code is named after the content of all sources with kernels that can call each other, and after the compiler with its
settings; changing any of them compiles anew.
"""

from __future__ import annotations

import functools
import hashlib
import os
import pickle
import threading
from collections.abc import Callable, Sequence
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Generic, ParamSpec, TypeVar, cast

import llvmlite  # type: ignore[import-untyped]
import llvmlite.binding as llvm  # type: ignore[import-untyped]
import numba
from numba.core import types
from numba.core.caching import CompileResultCacheImpl, FunctionCache
from numba.core.registry import cpu_target
from numba.core.runtime import rtsys

from takeapart.caching import cache_folder, planted
from takeapart.model.errors import InputError

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

# What the environment can ask of numba that ends up in machine code, and that numba's own cache does not look at.
SETTINGS = ("OPT", "LOOP_VECTORIZE", "SLP_VECTORIZE", "BOUNDSCHECK", "DEBUGINFO_DEFAULT")
GROUPS = (("search",), ("collision",), ("robot", "motion"))  # packages whose kernels call each other
_folder_lock = threading.Lock()
CALLED = "called"  # folder for the machine code of kernels that are part of others, where Python calls them


def _digest(folders: Sequence[str]) -> str:
    """Digest of the sources in some folders of the package that hold kernels, or the types that kernels work on, of
    this file, and of the compiler with its settings.
    """
    package = Path(__file__).parent
    sources = [source for folder in folders for source in sorted((package / folder).glob("*.py"))]
    digest = hashlib.sha256()
    for source in (*sources, Path(__file__)):
        content = source.read_bytes()
        if b"@compiled" in content or source.name in ("arrays.py", Path(__file__).name):
            digest.update(f"{source.name} {len(content)}:".encode() + content)
    settings = [f"{name}={getattr(numba.config, name)}" for name in SETTINGS]
    digest.update(" ".join([llvmlite.__version__, *settings]).encode())
    return digest.hexdigest()[:16]


def _kernel_folder(module: str) -> Path:
    """Folder for the machine code of a module: arm, contact and searches call no kernels of one another."""
    for group in GROUPS:
        if any(module.startswith(f"takeapart.{package}.") for package in group):
            return _group_folder(group)
    return _group_folder(GROUPS[-1])


@cache
def _group_folder(group: tuple[str, ...]) -> Path:
    """Folder for the machine code of the modules in some folders of the package.

    Raises:
        InputError: somebody else can write what stands in it.
    """
    folder = cache_folder() / f"{group[0]}-kernels-{numba.__version__}-{_digest(group)}"
    folder.mkdir(mode=0o700, exist_ok=True)
    doubtful = planted(folder)
    if doubtful is not None:
        raise InputError(f"{doubtful} is, or can be, written by others, and would be run; remove {folder}")
    return folder


# What is below here knows numba from inside: the requirements name the release it belongs to.


class _MachineCode(CompileResultCacheImpl):
    """Reads the machine code of a kernel that Python calls without the code for the compiler that stands beside it: ten
    times as quick.
    """

    def reduce(self, result: Any) -> Any:
        *stored, environments = super().reduce(result)
        # Without constants they are never looked at, and reading them imports much of numba and of scipy.
        return (*stored, tuple(environment for environment in environments if environment.consts))

    def rebuild(self, context: Any, stored: Any) -> Any:
        (name, kind, (machine_code, bitcode)), described, *others = stored
        defined = {described.llvm_func_name, described.llvm_cpython_wrapper_name}
        context.codegen()._engine._defined_symbols |= defined  # what numba would look up in the other code
        found = super().rebuild(context, ((name, kind, (machine_code, _nothing())), described, *others))
        # What is compiled later may contain this kernel, and then asks for the other code.
        found.library._get_module_for_linking = cache(lambda: llvm.parse_bitcode(bitcode))
        return found


class _Cache(FunctionCache):
    """As numba's, but for machine code that was cut off, which is as none."""

    def _load_overload(self, signature: Any, context: Any) -> Any:
        try:
            return super()._load_overload(signature, context)
        except (EOFError, pickle.UnpicklingError):
            return None


class _KernelCache(_Cache):
    """Reads machine code without making the compiler ready, which takes as long as importing it; it gets itself ready
    before it compiles.
    """

    _impl_class = _MachineCode  # type: ignore[assignment]

    def load_overload(self, signature: Any, context: Any) -> Any:
        rtsys.initialize(context)  # the memory of arrays, which machine code uses
        return self._load_overload(signature, context)


@cache
def _nothing() -> bytes:
    return cast("bytes", llvm.parse_assembly("").as_bitcode())


def _dispatcher(function: Callable[..., Any], part: str = "", **options: Any) -> Any:
    # numba decides where a function's machine code goes when it is decorated. Without a folder that can be written, it
    # would put it among the sources. Nothing uses the wrapper for C, which contains the whole kernel once more.
    njit: Any = numba.njit  # numba's stubs do not know all of its options
    made = njit(nogil=True, no_cfunc_wrapper=True, **options)(function)
    folder = str(_kernel_folder(function.__module__) / part)
    with _folder_lock:
        before = numba.config.CACHE_DIR  # type: ignore[attr-defined]
        numba.config.CACHE_DIR = folder  # type: ignore[attr-defined]
        try:
            made._cache = _Cache(function) if "no_cpython_wrapper" in options else _KernelCache(function)
        finally:
            numba.config.CACHE_DIR = before  # type: ignore[attr-defined]
    return made


def compiled(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Compiles a kernel when it is first called, without the interpreter lock, and keeps the machine code on disk."""
    return cast("Callable[Parameters, Result]", _dispatcher(function))


class LeanKernel(Generic[Parameters, Result]):
    """A kernel that other kernels call; see `compiled_lean` and `compiled_apart`.

    It is compiled in two forms, each when it is needed: the one for other kernels has no wrapper that Python could
    call, since a wrapper would hold all of the kernel's code again, in every one of them. That halves the time to
    compile. Python calls another form, for itself.
    """

    def __init__(self, function: Callable[Parameters, Result], inline: bool) -> None:
        functools.update_wrapper(self, function)
        self.py_func = function
        self._inline = inline

    @cached_property
    def inner(self) -> Any:
        """The form for other kernels, numba's."""
        return _dispatcher(self.py_func, _nrt=False, forceinline=self._inline, no_cpython_wrapper=True)

    @cached_property
    def called(self) -> Any:
        """The form for Python, numba's."""
        return _dispatcher(self.py_func, CALLED, _nrt=False)

    @cached_property
    def _numba_type_(self) -> Any:
        """What numba takes the object for inside other kernels."""
        return types.Dispatcher(self.inner)

    def __call__(self, *arguments: Parameters.args, **named: Parameters.kwargs) -> Result:
        return cast("Result", self.called(*arguments, **named))


def compiled_lean(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """As `compiled`, for kernels that allocate nothing: their code becomes part of every caller's, and does not count
    references to arrays.

    Both are about the many arrays that a kernel is handed. Their counters cost more than the work on them, and so does
    handing them on: a call copies seven words for each. The caller holds the arrays as long as the kernel runs, so
    nothing is lost.
    """
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    return LeanKernel(function, inline=True)


def compiled_apart(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """As `compiled_lean`, for kernels so large that a call costs nothing beside their work: their code stands once in
    every caller, not as often as they are called there.
    """
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    return LeanKernel(function, inline=False)


def has_machine_code(dispatcher: Any, signature: tuple[Any, ...]) -> bool:
    """Whether the cache holds machine code of a kernel for types of arguments and for this processor.

    numba's own index is asked, as numba will ask it, so nothing is believed that it would compile again: code for
    another processor or other types, or an entry whose code is missing.

    Args:
        dispatcher: numba's, of the kernel.
        signature: types of the arguments, in numba's terms.
    """
    index = dispatcher._cache._cache_file
    key = dispatcher._cache._index_key(signature, dispatcher.targetctx.codegen())
    try:
        name = index._load_index().get(key)
    except Exception:  # whatever pickle makes of a damaged file
        Path(index._index_path).unlink(missing_ok=True)  # numba would raise the same
        return False
    return name is not None and Path(index._data_path(name)).is_file()


def machine_code_stamp() -> str:
    """Digest of all that decides whether machine code is found: which there is, of which sources, for which processor.
    What was found complete still is where nothing of it has changed.

    Raises:
        InputError: as `cache_folder`; somebody else can write what stands there.
    """
    package = Path(__file__).parent
    states = []
    for folder in (*(_group_folder(group) for group in GROUPS), package):
        for above, _, names in os.walk(folder):
            for name in names:
                if name.endswith((".nbi", ".nbc", ".py")):
                    state = os.stat(f"{above}/{name}")
                    states.append((above, name, state.st_mtime_ns, state.st_size))
    known = cpu_target.target_context.codegen().magic_tuple(), sorted(states)
    return hashlib.sha256(repr(known).encode()).hexdigest()
