"""Tables of the paper's experiments: columns, numbers, and comparisons at equal cost, from searches made up here."""

from __future__ import annotations

import csv
import io
import json
import math
from pathlib import Path
from typing import Any

import pytest

from small_assemblies import two_bars
from takeapart.experiments.paper_csv import equal_csv, figure_csv, savings_csv, table_csv
from takeapart.experiments.paper_figures import draw_all
from takeapart.experiments.paper_jobs import PHASES, Product
from takeapart.experiments.paper_report import BLOCK_TITLES, Findings, fill_document, report_blocks, write_results
from takeapart.experiments.paper_results import (
    Reference,
    Replanning,
    Row,
    SearchRun,
    comparisons,
    equal_costs,
    savings,
    search_run,
)
from takeapart.experiments.paper_settings import PaperSettings, quick_settings
from takeapart.experiments.paper_tables import (
    comparison_markdown,
    equal_markdown,
    figure_markdown,
    orders_markdown,
    savings_markdown,
    table_markdown,
)
from takeapart.experiments.paper_values import TABLE_1, TABLE_2
from takeapart.experiments.schedule import Kept

# Columns that the project promises, in this order; others may stand between them.
PROMISED = "id vanilla_initial vanilla_shortest vanilla_episode vanilla_step".split()
PROMISED_1 = [*PROMISED, *"guided_shortest guided_episode guided_step".split()]
PROMISED_2 = [
    *PROMISED,
    *(f"guided_{guide}_{name}" for guide in ("d1", "d2") for name in "shortest episode step".split()),
]


def outcome(trace: list[list[float]], episode: int, step: int, queries: int, plans: int) -> dict[str, Any]:
    statistics = {"found_episode": float(episode), "found_step": float(step)} if trace else {}
    return {
        "statistics": statistics,
        "trace": trace,
        "removal_queries": queries,
        "motion_plans": plans,
        "search_seconds": 10.0,
        "guide_seconds": 1.0,
    }


VANILLA = search_run(
    # Told at the end of an episode too, without being any shorter.
    outcome([[0, 21, 200, 16.0], [0, 60, 500, 15.0], [1, 90, 800, 15.0], [1, 100, 900, 14.5]], 2, 7, 400, 4000)
)
GUIDED = search_run(outcome([[0, 20, 180, 15.2], [0, 40, 360, 14.4]], 1, 2, 300, 2000))
FAILED = search_run(outcome([], 0, 0, 300, 2000))
REFERENCE = Reference(14.2, 14.1, 12.9, 176, 1500)


def rows(kind: str, *guided: SearchRun, count: int = 2) -> list[Row]:
    guides = dict(zip(("single", "double"), guided, strict=False))
    lengths = {"random": 15.0, "vanilla": 14.3, "exact": 14.0, **dict.fromkeys(guides, 14.14)}
    return [Row(Product(kind, k, two_bars()), VANILLA, guides, REFERENCE, lengths) for k in range(1, count + 1)]


def table(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def is_subsequence(wanted: list[str], found: list[str]) -> bool:
    rest = iter(found)
    return all(name in rest for name in wanted)


def test_a_trace_keeps_improvements_only() -> None:
    assert [point.length for point in VANILLA.trace] == [16.0, 15.0, 14.5]
    assert (VANILLA.initial.length, VANILLA.shortest.length) == (16.0, 14.5)
    assert (VANILLA.episode, VANILLA.step, VANILLA.guide_share) == (2, 7, 0.1)
    assert math.isinf(FAILED.initial.length) and math.isinf(FAILED.shortest.length)


@pytest.mark.parametrize(
    ("plans", "length"), [(199, math.inf), (200, 16.0), (499, 16.0), (899, 15.0), (900, 14.5), (10**6, 14.5)]
)
def test_a_search_is_cut_at_its_motion_plans(plans: int, length: float) -> None:
    assert VANILLA.length_at(plans) == length


@pytest.mark.parametrize(("length", "plans"), [(17.0, 200), (16.0, 200), (15.99, 500), (14.5, 900), (14.4, math.inf)])
def test_motion_plans_to_a_length(length: float, plans: float) -> None:
    assert VANILLA.plans_to(length) == plans


def test_equal_costs_are_paid_by_both() -> None:
    found = {cost.share: cost for cost in equal_costs(rows("single", GUIDED, count=1))}
    assert found[1.0].motion_plans == 2000  # the guided search made fewer
    assert (found[1.0].vanilla, found[1.0].guided) == (14.5, 14.4)
    assert (found[0.2].motion_plans, found[0.2].vanilla, found[0.2].guided) == (400, 16.0, 14.4)
    assert (found[0.1].vanilla, found[0.1].guided) == (16.0, 15.2)
    assert math.isinf(found[0.01].vanilla) and math.isinf(found[0.01].guided)


def test_savings_are_counted_to_vanillas_last_length() -> None:
    (found,) = savings(rows("single", GUIDED, count=1))
    assert (found.target, found.vanilla, found.guided) == (14.5, 900, 360)
    assert found.saved == pytest.approx(0.6)
    (never,) = savings(rows("single", FAILED, count=1))
    assert never.guided == math.inf and never.saved == -math.inf


def test_orders_are_told_from_paths() -> None:
    lines = [line.strip("| ").split(" | ") for line in orders_markdown(rows("single", GUIDED)).splitlines()[2:]]
    assert lines == [
        ["D1, random", "2", "-", "15.00", "-", "7.1 ± 0.0 %"],
        ["D1, vanilla", "2", "14.50", "14.30", "1.4%", "2.1 ± 0.0 %"],
        ["D1, exact", "2", "14.20", "14.00", "1.4%", "0.0 ± 0.0 %"],
        ["D1, guided, guide of D1", "2", "14.40", "14.14", "1.8%", "1.0 ± 0.0 %"],
    ]


def test_table_1_as_csv() -> None:
    text = table_csv("single", rows("single", GUIDED) + rows("double", GUIDED, GUIDED))
    lines = table(text)
    assert is_subsequence(PROMISED_1, list(lines[0]))
    assert len(lines) == 2
    row = lines[1]
    assert [row[name] for name in PROMISED_1] == ["2", "16.0", "14.5", "2", "7", "14.4", "1", "2"]
    assert (row["vanilla_initial_motion_plans"], row["vanilla_shortest_motion_plans"]) == ("200", "900")
    assert (row["guided_shortest_queries"], row["guided_queries"], row["guided_motion_plans"]) == ("40", "300", "2000")


def test_table_2_as_csv() -> None:
    lines = table(table_csv("double", rows("double", GUIDED, FAILED)))
    assert is_subsequence(PROMISED_2, list(lines[0]))
    assert [lines[0][name] for name in PROMISED_2][5:] == ["14.4", "1", "2", "", "", ""]


def test_tables_have_the_papers_columns() -> None:
    one = table_markdown("single", rows("single", GUIDED), shipped=True).splitlines()
    names = [name.strip() for name in one[0].strip("|").split("|")]
    assert names == [
        "id",
        "vanilla: initial, m",
        "shortest, m",
        "found after (#epi, #st)",
        "Q-function of D1: shortest, m",
        "found after (#epi, #st)",
    ]
    assert one[2] == "| 1 | 16.00 | 14.50 | (2, 7) | **14.40** | (1, 2) |"
    assert one[3] == "| *paper* | *16.95* | *16.53* | *(15, 1)* | *16.07* | *(2, 1)* |"
    two = table_markdown("double", rows("double", FAILED, GUIDED), shipped=True).splitlines()
    assert two[0].count("|") == two[2].count("|") == 9
    assert two[2] == "| 1 | 16.00 | 14.50 | (2, 7) | - | - | **14.40** | (1, 2) |"
    assert two[3] == "| *paper* | *29.12* | *24.12* | *(13, 20)* | *23.41* | *(6, 1)* | *24.33* | *(2, 1)* |"
    assert not any("paper" in line for line in table_markdown("single", rows("single", GUIDED), False).splitlines())


def test_the_papers_own_numbers() -> None:
    assert (len(TABLE_1), len(TABLE_2)) == (14, 7)
    for published, guide, gain in ((TABLE_1, "single", 0.8), (TABLE_2, "double", 1.4), (TABLE_2, "single", 1.6)):
        mean = sum(row.vanilla.shortest - row.guided[guide].shortest for row in published) / len(published)
        assert mean == pytest.approx(gain, abs=0.06)  # what Sec. I says about the tables


def replanning() -> Replanning:
    lengths = [[16.0, 15.0], [14.0, 13.0], [math.nan, 14.0]]
    seconds = [[0.01, 0.02], [0.03, 0.05], [0.02, 0.02]]
    return Replanning(Product("double", 1, two_bars()), lengths, seconds, [[4.0, 6.0], [4.0, 8.0], [4.0, 5.0]])


def test_figure_5_in_numbers() -> None:
    lines = table(figure_csv([replanning()]))
    assert [line["length"] for line in lines] == ["16.0", "14.0", "", "15.0", "13.0", "14.0"]
    assert [line["replans"] for line in lines] == list("111222") and [line["repeat"] for line in lines] == list(
        "123123"
    )
    first, second = figure_markdown([replanning()]).splitlines()[2:]
    assert first.startswith("| 1 | 1 | 15.00 ±") and first.endswith("| 20.0 | 4.0 | 1 |")
    assert second.startswith("| 1 | 2 | 14.00 ±") and second.endswith("| 30.0 | 6.3 | 0 |")


def test_comparisons_of_both_kinds() -> None:
    found = comparisons(rows("double", GUIDED, FAILED), seed=0)
    assert list(found) == [
        ("double", guide, name) for guide in ("single", "double") for name in ("all episodes", "equal motion plans")
    ]
    assert found["double", "single", "all episodes"].difference.mean == pytest.approx(-0.1)
    assert found["double", "double", "all episodes"].pairs == 0
    text = comparison_markdown(found)
    assert "| D2, guide of D1, all episodes | 2 | 14.50 | 14.40 | -0.100 " in text


def findings(settings: PaperSettings) -> Findings:
    found = rows("single", GUIDED) + rows("double", GUIDED, FAILED)
    kept = Kept({"motion_plans": 5, "removal_queries": 2}, Path(), 3.0, 2.0)
    results = {f"{phase}/x": kept for phase in PHASES}
    for number, regret in enumerate((0.1, 0.2), 1):
        learned = {"rows": 1000, "hash": "x", "weights": "y", "steps": 300, "best_step": 200, "error": 0.4}
        kept = Kept({**learned, "regret": regret, "random_regret": 0.5}, Path(), 3.0, 2.0)
        results[f"guide/single-without-{number:02d}"] = kept
    compared = comparisons(found, 0)
    return Findings(settings, results, found, [replanning()], equal_costs(found), savings(found), compared)


def test_all_files_are_written_and_the_same_each_time(tmp_path: Path) -> None:
    folders = [tmp_path / "first", tmp_path / "second"]
    for folder in folders:
        folder.mkdir()
        files = write_results(findings(quick_settings()), folder)
        assert all(file.stat().st_size > 50 for file in files)
    names = sorted(path.name for path in folders[0].iterdir())
    assert {"table1.csv", "table2.csv", "figure5.csv", "figure5.png", "table1.png", "table2.png"} < set(names)
    for name in names:
        assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes()


def test_plots_can_be_drawn_of_almost_nothing(tmp_path: Path) -> None:
    empty = rows("single", FAILED, count=1) + rows("double", FAILED, FAILED, count=1)
    files = draw_all(empty, [], [], tmp_path)
    assert {file.read_bytes()[:4] for file in files} == {b"\x89PNG"}


def test_a_document_is_filled_between_its_markers(tmp_path: Path) -> None:
    document = tmp_path / "results.md"
    markers = [f"<!-- {name}: begin -->\nold {name}\n<!-- {name}: end -->\nkept\n" for name in BLOCK_TITLES]
    document.write_text("# Results\n" + "".join(markers))
    fill_document(findings(quick_settings()), document)
    text = document.read_text()
    assert "old" not in text and text.count("kept") == len(BLOCK_TITLES)
    assert "| 1 | 16.00 | 14.50 | (2, 7) | **14.40** | (1, 2) |" in text
    assert "| D1 without one | 2 | 1,000 | 300 | 0.150 | 0.500 | 0.400 |" in text
    assert all(block in text for block in report_blocks(findings(quick_settings())).values())


def test_the_shipped_document_has_all_markers(tmp_path: Path) -> None:
    shipped = Path(__file__).resolve().parents[1] / "docs" / "results.md"
    document = tmp_path / "results.md"
    document.write_text(shipped.read_text())
    fill_document(findings(quick_settings()), document)
    assert "Q-function of D1" in document.read_text()


def test_settings_are_told(tmp_path: Path) -> None:
    text = report_blocks(findings(quick_settings()))["results-settings"]
    told = json.loads(text.split("```json\n")[1].removesuffix("\n```"))
    assert told["mcts"]["memory"] == "paper" and told["single"] == 2 and told["queries"] == 200


def test_lists_at_equal_cost() -> None:
    found = rows("single", GUIDED)
    (line, *_) = table(equal_csv(equal_costs(found)))
    assert (line["set"], line["guide"], line["share"], line["vanilla"]) == ("single", "D1", "0.01", "")
    assert "| D1, guide of D1 | 20% | 400 | 2 | 16.00 | 14.40 | 10.0% |" in equal_markdown(found)
    assert "| D1, guide of D1 | 2 of 2 | 900 | 360 | 60% |" in savings_markdown(savings(found))
    assert table(savings_csv(savings(found)))[0]["saved"] == "0.6"
