"""Searches with and without a guide at equal removal queries."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from small_assemblies import WORKCELL, three_bars, two_bars
from takeapart.experiments.beyond_exact import BeyondSettings, beyond_jobs, compare_beyond
from takeapart.experiments.beyond_report import BeyondRun, draw, lengths_markdown, means_markdown, runs_csv
from takeapart.experiments.beyond_tasks import SEARCHED, BeyondTask
from takeapart.experiments.workers import LocalWorkers
from takeapart.formats.files import load_workcell, save_assembly
from takeapart.model.errors import InputError, UnknownNameError


def run_of(name: str, search: str, guided: bool, *trace: tuple[int, float]) -> BeyondRun:
    return BeyondRun(name, 40, search, guided, trace, None if guided else 20.0, 100, 900)


RUNS = [
    run_of("a", "greedy", False, (40, 30.0)),
    run_of("a", "greedy", True, (10, 27.0)),
    run_of("b", "greedy", False, (60, 32.0), (80, 30.0)),
    run_of("b", "greedy", True, (10, 28.0), (90, 27.0)),
]


def test_lengths_are_those_known_after_so_many_queries() -> None:
    run = RUNS[2]
    assert [run.length_at(queries) for queries in (59, 60, 79, 80, 10**6)] == [math.inf, 32.0, 32.0, 30.0, 30.0]


def test_the_table_compares_at_equal_queries() -> None:
    lines = means_markdown(RUNS, 100).splitlines()
    assert lines[0].split(" | ")[1:5] == [f"at {n} queries" for n in (10, 25, 50, 100)]
    assert lines[2] == "| greedy, no guide | - | - | 11.1% (1 of 2) | 11.1% | 100 | 900 |  |"
    assert lines[3].startswith("| greedy, guide | 1.9% | 1.9% | 1.9% | 0.0% | 100 | 900 | 10.0% [10.0%, 10.0%] |")


def test_the_table_of_every_assembly_has_the_best_in_bold() -> None:
    lines = lengths_markdown([*RUNS[:2], run_of("c", "greedy", False), run_of("c", "greedy", True)]).splitlines()
    assert lines[2] == "| a | 40 | 30.00 | **27.00** |"
    assert lines[3] == "| c | 40 | - | - |"


def test_the_table_as_csv() -> None:
    first, second = runs_csv(RUNS[:2], 100).splitlines()[1:]
    assert first == "a,40,greedy,no guide,,,30.0,30.0,20.0,100,900"
    assert second == "a,40,greedy,guide,27.0,27.0,27.0,27.0,,100,900"


def test_the_plot_has_a_panel_for_every_assembly_and_a_line_for_every_search_and_guide() -> None:
    panels = draw([*RUNS, run_of("c", "greedy", False)], 100).axes
    assert [axes.get_title() for axes in panels] == ["a, 40 parts", "b, 40 parts", "c, 40 parts"]
    assert [line.get_label() for line in panels[1].lines] == ["greedy, no guide", "greedy, guide"]
    found = [line.get_ydata() for line in panels[1].lines]
    assert [lengths[-1] for lengths in found] == [30.0, 27.0] and math.isnan(found[0][0])
    assert all(math.isnan(length) for length in panels[2].lines[0].get_ydata())


def test_settings_are_checked(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="at least one assembly"):
        BeyondSettings((), Path("guide"))
    with pytest.raises(InputError, match="guide: cannot be read: no such file"):
        beyond_jobs(BeyondSettings((Path("a.json"),), tmp_path / "guide"), [two_bars()])
    with pytest.raises(UnknownNameError, match="unknown search 'luck'; valid: beam, best-first, greedy, mcts"):
        BeyondTask(two_bars(), load_workcell("panda"), 0, "luck", 10)
    for name in ("one", "two"):
        save_assembly(two_bars(), tmp_path / f"{name}.json")
    (tmp_path / "guide").write_bytes(b"")
    settings = BeyondSettings((tmp_path / "one.json", tmp_path / "two.json"), tmp_path / "guide")
    with pytest.raises(InputError, match="two assemblies have the same name"):
        compare_beyond(settings, tmp_path, LocalWorkers(1))


@pytest.mark.parametrize("search", list(SEARCHED))
def test_every_search_stays_within_its_queries(search: str, tmp_path: Path) -> None:
    (tmp_path / "cell.toml").write_text(WORKCELL)
    cell = load_workcell(tmp_path / "cell.toml")
    outcome = BeyondTask(three_bars(), cell, 0, search, 20).run({}, tmp_path)
    assert outcome["parts"] == 3 and 3 <= outcome["removal_queries"] <= 20
    assert outcome["trace"] and outcome["trace"][-1][2] > 0
    lengths = [length for _, _, length in outcome["trace"]]
    assert lengths == sorted(lengths, reverse=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("takeapart.experiments.beyond_tasks.WIDEST_BEAM", 1)
        short = BeyondTask(three_bars(), cell, 0, search, 1).run({}, tmp_path)
    assert short["removal_queries"] == 1 and not short["trace"]
