"""The table of products that others drew: what is kept, what is told, and the plans that it must have."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import pytest

import cases_table
from cases_table import Row, keep, kept_row, table
from drawn_products import Trial, trials
from mesh_cases import CASES


def test_a_row_is_read_as_it_was_kept_and_replaces_the_old_one(tmp_path: Path) -> None:
    row = Row("a", "--fix 'b'", 5, 4, 1.25, True, exits=("up", "by 2 pushes"), queries=7, clearance=1e-3, findings=0)
    keep(Row("a", "", 0, 0, refusal="none"), tmp_path)
    keep(row, tmp_path)
    assert kept_row(Trial("a"), tmp_path) == row
    assert kept_row(Trial("b"), tmp_path) is None


def test_the_table_tells_plans_refusals_and_what_was_not_judged() -> None:
    rows = [
        Row("a", "", 5, 4, 1.25, True, exits=("up", "sideways", "up", "by 2 pushes"), clearance=1e-3, findings=0),
        Row("b", "", 5, 4, 1.5, exits=("up",), findings=2, first_finding="goal: not reached", unjudged=("gravity",)),
        Row("c", "", 3, 2, refusal="nothing is free", deep=("x, y: 3.13 mm",)),
    ]
    text = table(rows, [Trial("a", "it stands so", fix=("plate*",)), Trial("b"), Trial("c")])
    assert "| a | 4 of 5 | 1.250 | 2 up, 1 sideways, 1 by 2 pushes |" in text
    assert "1.500 (not proved)" in text and "**no, 2 findings**; goal: not reached" in text
    assert "| c | 3 |  | x, y: 3.13 mm | nothing is free |" in text
    assert "- a: --fix 'plate*'; it stands so." in text and "- b: gravity." in text


def test_products_are_the_folders_with_something_drawn_in_them(tmp_path: Path) -> None:
    for name in ("drawn", "scene", "made", "licenses"):
        (tmp_path / name).mkdir()
    (tmp_path / "drawn" / "part.OBJ").touch()
    (tmp_path / "scene" / "whole.step").touch()
    (tmp_path / "made" / "assembly.json").touch()
    (tmp_path / "licenses" / "LICENSE").touch()
    (tmp_path / "README.md").touch()
    assert [trial.name for trial in trials(tmp_path)] == ["drawn", "made", "scene"]
    assert [trial.name for trial in trials(tmp_path, ["made"])] == ["made"]


def test_what_breaks_or_takes_too_long_is_a_row(tmp_path: Path) -> None:
    (tmp_path / "cases" / "broken").mkdir(parents=True)
    (tmp_path / "cases" / "broken" / "part.obj").write_text("f 1 2 3\n")
    folders = {"cases": tmp_path / "cases", "out": tmp_path}
    arguments = argparse.Namespace(**folders, unit="m", workcell="panda", quick=True, limit=0.01)
    cases_table.in_own_process(Trial("broken"), arguments)
    row = kept_row(Trial("broken"), tmp_path)
    assert row is not None and row.refusal == "stopped after 0.01 s of wall time"
    arguments.limit = 120.0
    cases_table.in_own_process(Trial("broken"), arguments)
    row = kept_row(Trial("broken"), tmp_path)
    assert row is not None and row.length is None and "part" in row.refusal and "Error" not in row.refusal


def test_without_the_folder_it_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["cases_table.py", "--cases", str(tmp_path / "none"), "--out", str(tmp_path)])
    cases_table.main()
    assert capsys.readouterr().out.startswith("no products at")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "parts", "ways"),
    [
        ("fabrica_plumbers_block", 4, {"up", "sideways", "at 82 degrees"}),
        ("factory_pegs", 8, {"up"}),
        ("fabrica_car", 5, {"sideways", "up"}),
    ],
)
def test_what_others_drew_is_planned_and_verified(name: str, parts: int, ways: set[str], tmp_path: Path) -> None:
    if not (CASES / name).is_dir():
        pytest.skip(f"no product {name}: it is no part of the project")
    (trial,) = trials(CASES, [name])
    row = cases_table.row_of(trial, CASES, tmp_path, "m", cases_table.Budget())
    assert not row.refusal and not row.first_finding
    assert row.findings == 0 and row.proved and row.length is not None
    assert len(row.exits) == row.removable == parts and set(row.exits) <= ways
    assert row.clearance is not None and row.clearance > 0.00095


@pytest.mark.slow
def test_two_drawers_that_overlap_are_refused_by_name_and_depth(tmp_path: Path) -> None:
    if not (CASES / "furniture_drawer").is_dir():
        pytest.skip("no product furniture_drawer: it is no part of the project")
    row = cases_table.row_of(Trial("furniture_drawer"), CASES, tmp_path, "m", cases_table.Budget())
    assert row.length is None and "'drawer_box' and 'drawer_container_bottom' overlap by 3.25 mm" in row.refusal
    assert row.deep == ("drawer_box, drawer_container_bottom: 3.25 mm",)
