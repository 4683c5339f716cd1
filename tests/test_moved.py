"""Modules that have moved: old names of what documents named still work, all others fail with the new name."""

from __future__ import annotations

import importlib
import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

import takeapart
from takeapart._moved import INTERNAL, PUBLIC

PACKAGE = Path(takeapart.__file__).parent

# Modules that became packages of the same name, and what users took from them.
PACKAGES = {
    "cli": ("main",),
    "planning": ("Infeasible", "PlanningOptions", "build_problem", "explain", "plan"),
    "problem": ("AssemblyProblem", "Guide", "Problem"),
    "report": ("report", "save_report"),
    "stability": ("ConnectorStability", "require_support", "unsupported"),
    "verification": ("VerificationOptions", "Verifier", "format_finding", "report_as_dict", "verify_plan"),
    "viewer": ("Viewer",),
}


def there(module: str) -> bool:
    path = PACKAGE / module.replace(".", "/")
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


@pytest.mark.parametrize("old", sorted(PUBLIC))
def test_old_name_of_what_users_import_is_the_new_module(old: str, monkeypatch: pytest.MonkeyPatch) -> None:
    new = f"takeapart.{PUBLIC[old]}"
    if old.startswith("viewer_live"):
        pytest.importorskip("viser", reason="the viewer needs the extra takeapart[view]")
    if old.startswith(("render", "viewer_page")):
        pytest.importorskip("mujoco", reason="pictures need the extra takeapart[view]")
    assert not there(old)
    monkeypatch.delitem(sys.modules, f"takeapart.{old}", raising=False)
    module = importlib.import_module(new)
    with pytest.warns(DeprecationWarning, match=re.escape(f"takeapart.{old} is now {new}")):
        assert importlib.import_module(f"takeapart.{old}") is module
    assert module.__name__ == new and module.__spec__ is not None and module.__spec__.name == new


@pytest.mark.parametrize("old", sorted(INTERNAL))
def test_old_name_of_anything_else_fails_with_the_new_one(old: str) -> None:
    assert there(INTERNAL[old]) and not there(old)
    with pytest.raises(ModuleNotFoundError, match=f"^takeapart.{old} is now takeapart.{re.escape(INTERNAL[old])}$"):
        importlib.import_module(f"takeapart.{old}")


@pytest.mark.parametrize("package", sorted(PACKAGES))
def test_module_that_became_a_package_still_has_what_users_took(package: str) -> None:
    if package == "viewer":
        pytest.importorskip("viser", reason="the viewer needs the extra takeapart[view]")
    if package == "verification":
        pytest.importorskip("mujoco", reason="verification needs MuJoCo")
    module = importlib.import_module(f"takeapart.{package}")
    assert hasattr(module, "__path__") and all(hasattr(module, name) for name in PACKAGES[package])


def test_what_never_was_is_not_found_as_usual() -> None:
    with pytest.raises(ModuleNotFoundError, match=r"^No module named 'takeapart.nothing'$"):
        importlib.import_module("takeapart.nothing")
    assert importlib.util.find_spec("takeapart.model.nothing") is None


def test_the_package_alone_and_the_command_line_load_nothing_heavy() -> None:
    code = "import sys, takeapart.cli.commands, takeapart.cli.compile\nprint(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not set(done.stdout.split()) & {"numba", "scipy", "mujoco", "torch", "trimesh", "viser", "matplotlib"}
