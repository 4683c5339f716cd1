"""The examples of the documents run, and the API page is complete: all it lists is there, and is used in an example."""

from __future__ import annotations

import ast
import importlib
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from takeapart.formats.files import assembly_hash, data_path, load_assembly, load_workcell
from takeapart.model.plan import Plan
from takeapart.pictures.renderer import NoGraphicsError
from takeapart.planning import plan

ROOT = Path(__file__).resolve().parents[1]
FENCE = re.compile(r"^```python([^\n]*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


@dataclass(frozen=True)
class Example:
    """A fenced block: what it says behind the word python, its line in the document, its text."""

    mark: str
    line: int
    text: str


def examples(document: Path) -> list[Example]:
    text = document.read_text(encoding="utf-8")
    return [Example(m[1].strip(), text.count("\n", 0, m.start()) + 2, m[2]) for m in FENCE.finditer(text)]


def run(document: Path) -> dict[str, Any]:
    """All examples of a document, one after the other in one namespace."""
    names: dict[str, Any] = {"__name__": "example"}
    for example in examples(document):
        source = "\n" * (example.line - 1) + example.text  # so that a failure names the line of the document
        try:
            exec(compile(source, str(document), "exec"), names)
        except NoGraphicsError:
            if example.mark != "needs-graphics":
                raise
    return names


def test_tutorial_runs_and_makes_the_shipped_rack(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names = run(ROOT / "docs" / "tutorial.md")
    assert assembly_hash(names["rack"]) == assembly_hash(load_assembly(data_path("examples/rack.json")))
    assert (tmp_path / "rack.plan.json").exists()
    product = next(example for example in examples(ROOT / "docs" / "tutorial.md") if "def holder" in example.text)
    logical = [node for node in ast.walk(ast.parse(product.text)) if isinstance(node, ast.stmt)]
    assert len([node for node in logical if not isinstance(node, ast.ImportFrom | ast.Import)]) <= 22


def test_examples_of_the_api_page_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run(ROOT / "docs" / "api.md")
    assert (tmp_path / "plan.html").stat().st_size > 100_000 and (tmp_path / "report.html").exists()


@pytest.mark.slow
def test_example_of_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert examples(ROOT / "README.md")
    run(ROOT / "README.md")
    assert (tmp_path / "plan.json").exists()


def listed() -> list[str]:
    """Dotted names in the table of the API page."""
    text = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    return re.findall(r"`(takeapart\.[a-z_.]+)`", text[: text.index("## Files")].split("|---|---|")[1])


@pytest.mark.parametrize("name", listed())
def test_listed_function_is_there_documented_and_used_in_an_example(name: str) -> None:
    module, function = name.rsplit(".", 1)
    found = getattr(importlib.import_module(module), function)
    assert callable(found) and found.__doc__
    trees = [ast.parse(example.text) for example in examples(ROOT / "docs" / "api.md")]
    called = {
        node.func.id
        for tree in trees
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    }
    assert function in called


def test_public_functions_of_the_main_modules_are_listed() -> None:
    """What `takeapart.formats.files` exports, and the functions that the commands are made of."""
    exported = importlib.import_module("takeapart.formats.files").__all__
    assert {f"takeapart.formats.files.{name}" for name in exported} <= set(listed())
    for name in ("planning.plan", "verification.verify_plan", "generate.profiles.generate", "report.save_report"):
        assert f"takeapart.{name}" in listed()


def test_example_of_the_file_formats_can_be_planned_and_is_verified(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "file-formats.md").read_text(encoding="utf-8")
    for kind, name in (("json", "bench.json"), ("toml", "cell.toml")):  # the first of each is the whole example
        block = re.search(rf"^```{kind}\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
        assert block
        (tmp_path / name).write_text(block[1], encoding="utf-8")
    product, cell = load_assembly(tmp_path / "bench.json"), load_workcell(tmp_path / "cell.toml")
    made = plan(product, cell)
    assert isinstance(made, Plan) and [step.part for step in made.steps] == ["bar"]
    pytest.importorskip("mujoco")
    from takeapart.verification import verify_plan

    assert verify_plan(made, product, cell).passed


def test_documents_refer_to_files_that_exist() -> None:
    for document in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", document.read_text(encoding="utf-8")):
            assert (document.parent / target).exists(), f"{document.name}: {target}"


def test_options_of_the_commands_in_the_documents_exist() -> None:
    from takeapart.cli.commands import main

    shown = re.compile(r"takeapart (view|render|report|plan|show|explain|verify)\b([^`\n#]*)")
    for document in ("tutorial.md", "viewer.md"):
        for command, rest in shown.findall((ROOT / "docs" / document).read_text(encoding="utf-8")):
            known = {option for parameter in main.commands[command].params for option in parameter.opts}
            assert set(re.findall(r"(--[a-z-]+)", rest)) <= known, (document, command, rest)


def test_places_that_contributors_are_sent_to_are_there() -> None:
    text = (ROOT / "docs" / "contributing.md").read_text(encoding="utf-8")
    places = set(re.findall(r"`((?:src|tests|data|benchmarks)(?:/[\w.]+)*)`", text))
    assert len(places) > 15
    assert [place for place in sorted(places) if not (ROOT / place).exists()] == []
    table = text.split("## Rules")[0]
    assert sum(line.startswith("| ") for line in table.splitlines()) == 11, "ten changes below the head"
