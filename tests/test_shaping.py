"""What shapes an answer: a change of it ends a half-finished run, and a change of anything else does not."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

import takeapart
from takeapart.planning.shaping import shaping_sources, sources_digest

PACKAGE = Path(takeapart.__file__).parent


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("copy") / "takeapart"
    shutil.copytree(PACKAGE, folder, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


def digest(package: Path, *also: str) -> str:
    return sources_digest.__wrapped__(also, package)


def changed(file: Path, change: Callable[[str], str], package: Path) -> bool:
    """Whether the digest is another one while the file is changed."""
    before, text = digest(package), file.read_text(encoding="utf-8")
    assert change(text) != text
    file.write_text(change(text), encoding="utf-8")
    try:
        return digest(package) != before
    finally:
        file.write_text(text, encoding="utf-8")


def with_another_number(text: str) -> str:
    return text + "\nANOTHER = 1\n"


def with_other_words(text: str) -> str:
    start = text.index('"""') + 3
    return f"{text[:start]}Other words. {text[start:]}\n# and a remark\n"


def test_everything_that_the_planner_runs_counts() -> None:
    counted = shaping_sources((), PACKAGE)
    for package in ("motion", "problem", "removal", "robot", "search", "stability"):
        modules = {path.stem for path in (PACKAGE / package).glob("*.py")} - {"__init__"}
        assert modules and {f"{package}.{name}" for name in modules} <= set(counted)
    assert {"planning.plans", "guide.policy", "guide.forward", "model.assembly", "workcell"} <= set(counted)


def test_what_shows_judges_and_measures_does_not_count() -> None:
    apart = {"cli", "experiments", "generate", "page", "pictures", "report", "show", "verification", "viewer"}
    assert not apart & {name.split(".")[0] for name in shaping_sources((), PACKAGE)}
    assert all((PACKAGE / name).is_dir() for name in apart)


@pytest.mark.parametrize("module", ["search/exact.py", "removal/planner.py", "robot/kernels.py", "planning/plans.py"])
def test_code_that_shapes_counts_but_not_its_words(module: str, copy: Path) -> None:
    assert changed(copy / module, with_another_number, copy)
    assert not changed(copy / module, with_other_words, copy)


@pytest.mark.parametrize("module", ["viewer/browser.py", "cli/plan.py", "verification/checks.py", "report/document.py"])
def test_what_shapes_nothing_does_not_count(module: str, copy: Path) -> None:
    assert not changed(copy / module, with_another_number, copy)
    assert not changed(copy / module, with_other_words, copy)


def test_a_renamed_file_still_counts(copy: Path) -> None:
    """Whatever it is called: what is imported counts, and a change of the imports is a change."""
    old, importer = copy / "search" / "orders.py", copy / "search" / "best_first.py"
    before, text = digest(copy), importer.read_text(encoding="utf-8")
    new = old.rename(copy / "search" / "render_report_viewer.py")
    importer.write_text(text.replace("takeapart.search.orders", "takeapart.search.render_report_viewer"))
    try:
        assert digest(copy) != before
        assert changed(new, with_another_number, copy)
    finally:
        new.rename(old)
        importer.write_text(text, encoding="utf-8")
    assert digest(copy) == before


def test_imports_are_followed_however_they_are_written(tmp_path: Path) -> None:
    sources = {
        "__init__.py": "",
        "planning/__init__.py": "",
        "planning/plans.py": "from . import beside\nfrom ..other import thing\ndef f():\n    import takeapart.late",
        "planning/beside.py": "",
        "other/__init__.py": "from takeapart import third",
        "other/thing.py": "",
        "third.py": "",
        "late.py": "",
        "not_asked.py": "from takeapart.planning import plans",
        "asked.py": "",
    }
    for name, text in sources.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    expected = {"planning", "planning.plans", "planning.beside", "other", "other.thing", "third", "late"}
    assert set(shaping_sources((), tmp_path)) == expected
    assert set(shaping_sources(("asked",), tmp_path)) == expected | {"asked"}
    assert digest(tmp_path) != digest(tmp_path, "asked")
