"""What shapes an answer: a change of it ends a half-finished run, and a change of anything else does not."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import takeapart
from takeapart.planning.shaping import shaping_sources, sources_digest

PACKAGE = Path(takeapart.__file__).parent


APART = ("cli", "experiments", "generate", "page", "pictures", "report", "show", "verification", "viewer")


def digest(package: Path, *also: str) -> str:
    return sources_digest.__wrapped__(also, package)


@pytest.fixture(scope="module")
def before() -> str:
    return digest(PACKAGE)


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    return Path(
        shutil.copytree(PACKAGE, tmp_path / "takeapart", ignore=shutil.ignore_patterns("__pycache__", "assets"))
    )


def append(file: Path, text: str) -> None:
    file.write_text(file.read_text(encoding="utf-8") + text, encoding="utf-8")


def test_everything_that_the_planner_runs_counts() -> None:
    counted = shaping_sources((), PACKAGE)
    for package in ("motion", "problem", "removal", "robot", "search", "stability"):
        modules = {path.stem for path in (PACKAGE / package).glob("*.py")} - {"__init__"}
        assert modules and {f"{package}.{name}" for name in modules} <= set(counted)
    assert {"planning.plans", "guide.policy", "guide.forward", "model.assembly", "workcell"} <= set(counted)


def test_what_shows_judges_and_measures_does_not_count(copy: Path, before: str) -> None:
    for package in APART:
        files = list((copy / package).glob("*.py"))
        assert files
        for file in files:
            append(file, "\nANOTHER = 1\n")
    assert digest(copy) == before


def test_words_do_not_count(copy: Path, before: str) -> None:
    for file in copy.rglob("*.py"):
        text = file.read_text(encoding="utf-8")
        start = text.index('"""') + 3 if text.startswith('"""') else 0
        words = "Other words. " if start else "# A remark.\n"
        file.write_text(f"{text[:start]}{words}{text[start:]}\n# Another.\n", encoding="utf-8")
    assert digest(copy) == before


def test_code_that_shapes_counts(copy: Path, before: str) -> None:
    append(copy / "removal" / "planner.py", "\nANOTHER = 1\n")
    assert digest(copy) != before


def test_a_renamed_file_still_counts(copy: Path, before: str) -> None:
    """Whatever it is called: what is imported counts, and a change of the imports is a change."""
    importer = copy / "search" / "best_first.py"
    new = (copy / "search" / "orders.py").rename(copy / "search" / "render_report_viewer.py")
    text = importer.read_text(encoding="utf-8")
    importer.write_text(text.replace("takeapart.search.orders", "takeapart.search.render_report_viewer"))
    renamed = digest(copy)
    append(new, "\nANOTHER = 1\n")
    assert len({before, renamed, digest(copy)}) == 3


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
