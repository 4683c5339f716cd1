"""The comparison of searches: equal cost, resumption, and its figures."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from synthetic import SyntheticProblem, random_problem
from takeapart.experiments import comparison
from takeapart.experiments.comparison import (
    COMPARED,
    Comparison,
    Outcome,
    comma_separated,
    compare,
    curve,
    search_by_name,
    summary,
    table,
)
from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.model.assembly import Assembly
from takeapart.model.errors import InputError
from takeapart.search.result import Progress


@pytest.mark.parametrize("name", COMPARED)
def test_no_search_asks_more_than_its_budget(name: str) -> None:
    for queries in (5, 30, 100):
        problem: SyntheticProblem = random_problem(8, 3)
        seen: list[Progress] = []
        result = search_by_name(name, problem, queries, 0, seen.append)  # type: ignore[arg-type]
        assert problem.counts.removal_queries <= queries
        assert all(each.queries <= queries for each in seen)
        assert result.length >= problem.optimum()[0] - 1e-9
    assert math.isfinite(result.length)
    assert result.length == pytest.approx(min(each.length for each in seen))


def outcome(search: str, assembly: str, seed: int, *improvements: tuple[int, float]) -> Outcome:
    length = improvements[-1][1] if improvements else math.inf
    return Outcome(search, assembly, seed, improvements, length, None, 10, 20, 1.0)


OUTCOMES = [
    outcome("a", "x", 0, (2, 12.0), (5, 10.0)),
    outcome("a", "y", 0, (4, 22.0)),
    outcome("b", "x", 0, (1, 11.0)),
    outcome("b", "y", 0, (3, 30.0), (8, 20.0)),
]


def test_figures_by_hand() -> None:
    first, second = summary(OUTCOMES)
    assert (first.search, first.length, first.shortest) == ("a", 16.0, 1)
    assert first.ratio == pytest.approx((1.0 + 1.1) / 2)
    assert first.half_width == pytest.approx(1.96 * math.sqrt(0.005) / math.sqrt(2))
    assert second.ratio == pytest.approx((1.1 + 1.0) / 2)
    assert second.shortest == 1
    mean, half = curve(OUTCOMES, "a", np.array([1.0, 3.0, 4.0, 5.0, 10.0]))
    np.testing.assert_allclose(mean, [math.nan, math.nan, (1.2 + 1.1) / 2, 1.05, 1.05])
    assert half[2] == pytest.approx(1.96 * math.sqrt(0.005) / math.sqrt(2))


def test_a_run_without_a_plan_is_counted() -> None:
    (line, *_) = summary([outcome("a", "x", 0), outcome("a", "x", 1, (3, 5.0))])
    assert (line.runs, line.solved, line.length) == (2, 1, 5.0)
    assert np.isnan(curve([outcome("a", "x", 0), outcome("a", "x", 1, (3, 5.0))], "a", np.array([9.0]))[0]).all()


def test_what_was_kept_is_not_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    product: Assembly = load_assembly(data_path("single/01.json"))
    ran: list[str] = []

    class Planner:
        def __init__(self, assembly: Assembly, workcell: object) -> None:
            self.assembly = assembly

    def run(planner: Planner, name: str, queries: int, seed: int) -> Outcome | None:
        if len(ran) == 3:
            return None  # Ctrl-C
        ran.append(f"{name} {seed}")
        return outcome(name, planner.assembly.name, seed, *([(3, 9.5)] if name != "greedy" else []))

    monkeypatch.setattr(comparison, "RemovalPlanner", Planner)
    monkeypatch.setattr(comparison, "_run", run)
    settings = Comparison(50, 2, ("greedy", "exact"))
    cell = load_workcell("panda")
    with pytest.raises(KeyboardInterrupt):
        list(compare([product], cell, settings, tmp_path))
    before = list(ran)
    ran.clear()
    found = list(compare([product], cell, settings, tmp_path))
    assert before + ran == ["greedy 0", "exact 0", "greedy 1", "exact 1"]
    assert [(each.search, each.seed, each.length) for each in found] == [
        ("greedy", 0, math.inf),
        ("exact", 0, 9.5),
        ("greedy", 1, math.inf),
        ("exact", 1, 9.5),
    ]
    assert json.loads((tmp_path / f"{product.name}-0-greedy.json").read_text())["length"] is None
    with pytest.raises(InputError, match="other queries"):
        list(compare([product], cell, Comparison(60, 2, ("greedy", "exact")), tmp_path))


def test_the_plot_is_drawn(tmp_path: Path) -> None:
    comparison.plot(OUTCOMES, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")


def test_one_run_has_no_interval_and_no_run_no_mean() -> None:
    (solved,) = summary([outcome("a", "x", 0, (3, 5.0))])
    text = table([solved, *summary([outcome("b", "x", 0)])])
    assert "nan" not in text and "±" not in text
    assert "| a | 1 of 1 | 5.000 | 1.0000 |" in text and "| b | 0 of 1 | - | - |" in text
    header, row = comma_separated([solved]).splitlines()
    assert dict(zip(header.split(","), row.split(","), strict=True))["half_width"] == ""
    assert " ± " in table(summary(OUTCOMES))
