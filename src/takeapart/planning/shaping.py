"""What shapes a plan beside its inputs: versions of libraries, and the package's own sources."""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.metadata
from collections.abc import Sequence
from pathlib import Path

import takeapart

SHAPING_PACKAGES = ("numpy", "numba", "ssik", "example-robot-data")

ANSWERING = ("planning.plans", "search", "guide.policy")
"""Modules, and packages with all that is in them, that make an answer; what they import shapes it too."""


def versions() -> dict[str, str]:
    """Versions of the package and of the libraries that shape a plan."""
    return {"takeapart": takeapart.__version__} | {name: importlib.metadata.version(name) for name in SHAPING_PACKAGES}


@functools.cache
def sources_digest(also: Sequence[str] = (), package: Path = Path(takeapart.__file__).parent) -> str:
    """Digest of the sources that shape an answer, as this process found them first.

    These are the modules of `ANSWERING` and all modules of the package that they import, directly or not, wherever in
    the source the import stands. Comments, docstrings and layout are not in it; names of files are.

    Args:
        also: further modules that make the answer, dotted names below the package's.
        package: folder of the package.
    """
    digest = hashlib.sha256()
    for module, content in sorted(shaping_sources(also, package).items()):
        digest.update(f"{module}\n{content}\n".encode())
    return digest.hexdigest()


def shaping_sources(also: Sequence[str], package: Path) -> dict[str, str]:
    """Digests of the sources of which `sources_digest` is made, without docstrings, by the names of their modules."""
    files = {_module(path, package): path for path in package.rglob("*.py")}
    roots = (*ANSWERING, *also)
    waiting = [name for name in files if any(name == root or name.startswith(f"{root}.") for root in roots)]
    found: dict[str, str] = {}
    while waiting:
        name = waiting.pop()
        if name in files and name not in found:
            is_package = files[name].name == "__init__.py"
            found[name], imported = _read(files[name].read_text(encoding="utf-8"), name, is_package)
            waiting += imported
    return found


def _module(path: Path, package: Path) -> str:
    parts = path.relative_to(package).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@functools.cache
def _read(text: str, module: str, is_package: bool) -> tuple[str, tuple[str, ...]]:
    """Digest of a source without its docstrings, and the modules of the package that its imports may mean, with the
    packages around them."""
    tree = ast.parse(text)
    here = ["takeapart", *module.split(".")]
    above = here if is_package else here[:-1]
    names: list[str] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            kept = above[: len(above) + 1 - node.level] if node.level else []
            start = ".".join([*kept, *([node.module] if node.module else [])])
            names += [start, *(f"{start}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body else None
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and type(first.value.value) is str:
                del node.body[0]
    own = [name.split(".")[1:] for name in names if name.startswith("takeapart.")]
    around = tuple(".".join(parts[:k]) for parts in own for k in range(1, len(parts) + 1))
    return hashlib.sha256(ast.dump(tree).encode()).hexdigest(), around
