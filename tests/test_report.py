"""The report: self-contained, and its numbers are the plan's."""

from __future__ import annotations

import json
import math
import re
import xml.etree.ElementTree as ElementTree
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path

import pytest
from click.testing import CliRunner

from shown_plans import small_plan, small_scene, small_workcell, write_files
from small_assemblies import three_bars
from takeapart.cli.commands import main
from takeapart.formats.bound_texts import gap
from takeapart.formats.files import save_assembly, save_plan
from takeapart.formats.serialization import motion_hash
from takeapart.model.plan import Plan
from takeapart.planning import PlanningOptions, plan
from takeapart.report import page, report
from takeapart.report.charts import Bar, bars, graph, progress, progress_note
from takeapart.search.result import History, Progress
from takeapart.show.facts import part_facts
from takeapart.show.markup import element
from takeapart.verification.report import Agreement, Clearance, VerificationReport, report_as_dict


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("shown")


@pytest.fixture
def not_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the words of a report matter: its picture takes longest of all."""
    monkeypatch.setattr("takeapart.report.document.picture_of", lambda scene: element("p", scene.assembly.name))


class Page(HTMLParser):
    """Text and references of a page; fails on tags that are not closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.references: list[str] = []
        self.words: list[str] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "img", "link", "br", "rect", "line", "path"):
            self.open.append(tag)
        self.references += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_endtag(self, tag: str) -> None:
        if tag not in ("rect", "line", "path"):
            assert self.open.pop() == tag

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        return

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def test_report_of_a_plan_has_its_numbers_and_needs_no_other_file(tmp_path: Path, folder: Path) -> None:
    given = write_files(tmp_path, folder)
    out = tmp_path / "report.html"
    done = CliRunner().invoke(main, ["report", str(tmp_path / "plan.json"), "--out", str(out), *given])
    assert done.exit_code == 0, done.output
    text, made = out.read_text(), small_plan(folder)
    page = Page(text)
    assert all(reference.startswith("data:image/png;base64,") for reference in page.references)
    assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)", text) and "<script" not in text
    words = " ".join(page.words)
    for step in made.steps:
        assert step.part in words and f"{step.length:.3f}" in words
    assert f"{made.total_length:.3f} m" in words and f"{made.straight_line_bound:.3f} m" in words
    assert made.hashes["assembly"] in words and made.hashes["workcell"] in words
    assert 'name="viewport"' in text and "@media print" in text
    assert len(text) < 2_000_000


def test_gap_of_a_bound_that_is_met_is_zero_whatever_was_rounded() -> None:
    lengths = [0.1, 0.1, 0.1, 0.3]
    total, other = math.fsum(lengths), sum(lengths)
    assert total < other, "else this shows nothing"
    assert f"{gap(total, other):.1%}" == "0.0%" and gap(other, total) == 0
    assert gap(3.0, 2.0) == 0.5 and gap(2.0, 3.0) == pytest.approx(-1 / 3) and gap(2.0, 0.0) is gap(2.0, None) is None


def verification_of(plan: Plan, distances: list[float | None], **other: object) -> dict[str, object]:
    """What ``takeapart verify --report`` writes about a plan, with distances of its steps."""
    clearances = tuple(
        None if distance is None else Clearance(distance, k, plan.steps[k].part, 0.0, "a", "b")
        for k, distance in enumerate(distances)
    )
    made = VerificationReport("x", (), 3, 9, None, Agreement(), 0, 1.0, clearances=clearances, motion=motion_hash(plan))
    return report_as_dict(made) | other


@pytest.mark.usefixtures("not_drawn")
def test_clearance_of_every_step_is_that_of_the_verification(tmp_path: Path, folder: Path) -> None:
    given, made = write_files(tmp_path, folder), small_plan(folder)
    file = (tmp_path / "plan.json").rename(tmp_path / "x.plan.json")
    arguments = (file, tmp_path / "product.json", str(tmp_path / "cell.toml"))
    assert "clear, mm" not in report(*arguments)
    beside = tmp_path / "x.verification.json"
    beside.write_text(json.dumps(verification_of(made, [0.00051, None, 0.00278])))
    text = report(*arguments)
    assert "clear, mm" in text and "has found nothing against it" in text and "0.51 mm" in text
    cells = re.findall(r'<td class="n">([^<]*)</td>', text[text.index("clear, mm") : text.index("Settings")])
    assert cells[3::4] == ["0.51", "-", "2.78"] and cells[0::4] == ["1", "2", "3"]
    save_plan(made.inverted(), file)  # the same motions, told the other way round
    text = report(*arguments)
    cells = re.findall(r'<td class="n">([^<]*)</td>', text[text.index("clear, mm") : text.index("Settings")])
    assert cells[3::4] == ["2.78", "-", "0.51"]
    finding = {"step": 0, "part": "a", "time": None, "check": "width", "message": "m", "depth": 0.0}
    document = verification_of(made, [None] * 3, passed=False, findings=[finding])
    beside.write_text(json.dumps(document))
    assert "has 1 findings: it may not be trusted" in report(*arguments)
    for wrong, message in (
        (verification_of(made, [None] * 3, motion="0" * 64), "of another plan"),
        (verification_of(made, [None] * 3, passed=False), "holds no verification"),
        (verification_of(made, [None] * 3, clearances=[{"distance": "<b>"}] * 3), "holds no verification"),
        ([], "holds no verification"),
    ):
        beside.write_text(json.dumps(wrong))
        command = ["report", str(file), "--out", str(tmp_path / "x.html"), "--verification", str(beside), *given]
        done = CliRunner().invoke(main, command)
        assert done.exit_code == 2 and message in done.output and len(done.output.splitlines()) == 1
        assert not (tmp_path / "x.html").exists()


def test_what_is_said_of_every_part_is_said_once(folder: Path) -> None:
    scene = small_scene(folder)
    text = page(small_plan(folder), scene, part_facts(scene), (), element("p"))
    words = Page(text).words
    assert sum("would fall" in each for each in words) == 1
    assert "free from the start" in " ".join(words)
    assert not [word for word, count in Counter(words).items() if count > 1 and len(word) > 60]


@pytest.mark.usefixtures("not_drawn")
def test_report_of_a_run_tells_what_the_planner_answered(tmp_path: Path, folder: Path) -> None:
    made = plan(three_bars(), small_workcell(folder), PlanningOptions(), run=tmp_path / "run")
    assert isinstance(made, Plan)
    save_assembly(three_bars(), tmp_path / "product.json")
    text = report(tmp_path / "run", tmp_path / "product.json", str(folder / "cell.toml"))
    found = re.search(r"removal found</td><td class=\"n\">(\d+)", text)
    assert found and 0 < int(found[1]) <= made.counts["removal_queries"]


def test_plan_keeps_how_its_length_came_about(folder: Path) -> None:
    made = small_plan(folder)
    history = made.search["history"]
    assert isinstance(history, list) and history
    queries = [row[0] for row in history]
    lengths = [row[1] for row in history if row[1] is not None]
    assert queries == sorted(queries) and queries[-1] <= made.counts["removal_queries"]
    assert lengths == sorted(lengths, reverse=True) and lengths[-1] == pytest.approx(made.total_length)
    assert history[-1][2] == pytest.approx(made.sequence_bound)


def test_history_keeps_changes_only_and_passes_all_on() -> None:
    heard: list[Progress] = []
    history = History(heard.append)
    for queries, length, bound in ((1, 9.0, 3.0), (2, 9.0, 3.0), (3, 8.0, 3.0), (3, 8.0, 4.0), (5, 8.0, 8.0)):
        history(Progress(0, length, bound, queries, 0.0))
    assert len(heard) == 5
    assert history.rows == [(1, 9.0, 3.0), (3, 8.0, 4.0), (5, 8.0, 8.0)]


def test_bars_are_as_long_as_the_lengths() -> None:
    drawn = ElementTree.fromstring(bars([Bar("a", 1.0, 0.5, "#112233"), Bar("b & c", 0.25, 0.2, "#445566")]))
    widths = [float(rect.get("width", "")) for rect in drawn.iter("{http://www.w3.org/2000/svg}rect")]
    assert widths[0] == pytest.approx(4 * widths[1], abs=0.3)
    lines = [float(line.get("x1", "")) for line in drawn.iter("{http://www.w3.org/2000/svg}line")]
    left = float(next(drawn.iter("{http://www.w3.org/2000/svg}rect")).get("x", ""))
    assert lines[0] - left == pytest.approx(widths[0] / 2, abs=0.3)


def drawn_bands(text: str) -> list[tuple[float, float, float, float]]:
    """Left, right, top and bottom of the bands of a chart, pixels."""
    found = []
    for rect in ElementTree.fromstring(text).iter("{http://www.w3.org/2000/svg}rect"):
        x, width, y, height = (float(rect.get(name, "")) for name in ("x", "width", "y", "height"))
        found.append((x, x + width, y, y + height))
    return found


def test_progress_draws_what_is_true_at_every_moment() -> None:
    """A bound that was above the final length hangs below the best plan of its own moment, and nowhere else."""
    history: list[list[float | None]] = [
        [1, None, 2.0],
        [5, 4.0, 2.5],
        [7, 3.5, 3.5],
        [9, 3.5, 3.25],
        [11, 3.0, 3.0],
        [13, 3.0, 3.0],
    ]
    text = progress(history, 1.0, 7)
    paths = [e.get("d", "") for e in ElementTree.fromstring(text).iter("{http://www.w3.org/2000/svg}path")]
    assert len(paths) == 2
    start, *moves = re.findall(r"[MHV]([\d.]+)(?: ([\d.]+))?", paths[0])
    heights = [float(start[1]), *(float(value) for value, _ in moves[1::2])]  # of 4.0, 3.5, 3.5, 3.0, 3.0 m
    scale = (heights[1] - heights[0]) / 0.5  # pixels downwards per m
    assert heights == pytest.approx(
        [heights[0] + scale * (4.0 - length) for length in (4.0, 3.5, 3.5, 3.0, 3.0)], abs=0.2
    )
    floor = float(re.findall(r"M[\d.]+ ([\d.]+)H", paths[1])[0])
    assert floor == pytest.approx(heights[0] + scale * 3.0, abs=0.3)
    columns = [float(start[0]), *(float(value) for value, _ in moves[0::2])]
    assert [value for band in drawn_bands(text) for value in band] == pytest.approx(
        [
            *(columns[0], columns[1], heights[0], heights[0] + 1.5 * scale),
            *(columns[2], columns[3], heights[2], heights[2] + 0.25 * scale),
        ],
        abs=0.3,
    )
    assert "refinement" in text


def test_progress_survives_missing_numbers() -> None:
    alone = progress([[0, 3.0, None]])
    assert alone.count("<path") == 1 and not drawn_bands(alone) and "refinement" not in alone
    assert progress([[0, None, 2.0]]) == ""
    assert "Orange" not in progress_note([[0, 3.0, None]]) and "Bound" not in progress_note([[0, 3.0, None]])
    assert "at that moment" in progress_note([[0, 3.0, 2.0]], 1.0) and "volume" in progress_note([[0, 3.0, 2.0]], 1.0)


def test_graph_puts_a_part_below_those_it_waits_for() -> None:
    assembly = three_bars()
    index = assembly.index
    edges = [(index["beam"], index["stub"], "gravity"), (index["beam"], index["rear"], "lift")]
    drawn = ElementTree.fromstring(graph(assembly, edges, ["#abcdef"] * len(assembly.parts)))
    height = {str(text.text): float(text.get("y", "")) for text in drawn.iter("{http://www.w3.org/2000/svg}text")}
    assert set(height) == {"beam", "stub", "rear"} and height["stub"] == height["rear"] < height["beam"]


@pytest.mark.parametrize(("name", "message"), [("x.txt", "unknown ending"), ("plan.json/x.html", "not a directory")])
def test_misuse_is_told_in_one_line(name: str, message: str, tmp_path: Path, folder: Path) -> None:
    given = write_files(tmp_path, folder)
    done = CliRunner().invoke(main, ["report", str(tmp_path / "plan.json"), "--out", str(tmp_path / name), *given])
    assert done.exit_code == 2 and message in done.output and len(done.output.splitlines()) == 1


def test_an_assembly_has_no_report(tmp_path: Path, folder: Path) -> None:
    write_files(tmp_path, folder)
    done = CliRunner().invoke(main, ["report", str(tmp_path / "product.json"), "--out", str(tmp_path / "x.html")])
    assert done.exit_code == 2 and "holds no plan" in done.output
