"""`takeapart reproduce` as a user meets it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from small_assemblies import WORKCELL, two_bars
from takeapart.cli.commands import main
from takeapart.cli.reproduce import duration, schedule_listener
from takeapart.experiments import paper_settings
from takeapart.experiments.schedule import ScheduleProgress
from takeapart.formats.files import save_assembly
from test_reproduce import small_settings


def run(*arguments: str) -> Result:
    result = CliRunner().invoke(main, ["reproduce", *arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["paper", "--workers", "many"], "workers: 'many'; must be a number from 1 to 256"),
        (["paper", "--quack"], "No such option '--quack'"),
        (["beyond", "--guide", "none.safetensors"], "Missing argument 'ASSEMBLIES...'"),
        (["beyond", "no.json", "--guide", "no.safetensors"], "no.json: there is no such file"),
        (["beyond", "two.json", "--guide", "no.safetensors"], "no.safetensors: there is no such file"),
        (["everything"], "No such command 'everything'"),
    ],
)
def test_misuse_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    save_assembly(two_bars(), tmp_path / "two.json")
    result = run(*arguments)
    assert result.exit_code == 2
    assert result.stderr.startswith("error: ") and message in result.stderr
    assert result.stderr.count("\n") == 1 and result.stdout == ""


@pytest.mark.slow
def test_the_whole_command_on_small_assemblies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = small_settings(tmp_path / "in")
    monkeypatch.setattr(paper_settings, "quick_settings", lambda seed: settings)
    result = run("paper", "--quick", "--workers", "1", "--out", str(tmp_path / "out"), "--json")
    assert result.exit_code == 0
    told = json.loads(result.stdout)
    assert all(Path(file).is_file() for file in told["files"])
    again = run("paper", "--quick", "--workers", "1", "--out", str(tmp_path / "out"))  # nothing is left to do
    assert Path(told["report"]).read_text() in again.stdout

    guide = tmp_path / "out/work/files/guide/single-all/guide.safetensors"
    save_assembly(two_bars(), tmp_path / "two.json")
    (tmp_path / "cell.toml").write_text(WORKCELL)
    cell = ("--workcell", str(tmp_path / "cell.toml"))
    budget = ("--queries", "10", "--out", str(tmp_path / "beyond"), "--workers", "1")
    result = run("beyond", str(tmp_path / "two.json"), "--guide", str(guide), *cell, *budget)
    assert result.exit_code == 0
    assert "| best-first, guide |" in result.stdout
    assert {path.name for path in (tmp_path / "beyond").iterdir()} == {"work", "beyond.csv", "beyond.md", "beyond.png"}


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.4, "0 s"), (89, "89 s"), (91, "2 min"), (5340, "89 min"), (5400, "1 h 30 min")]
)
def test_durations_are_for_people(seconds: float, text: str) -> None:
    assert duration(seconds) == text


def test_progress_is_told() -> None:
    shown: list[tuple[str, float | None]] = []
    listen = schedule_listener(lambda text, share: shown.append((text, share)))
    listen(ScheduleProgress(3, 95, ("vanilla/single-01", "vanilla/single-02", "x"), 0.1, None))
    listen(ScheduleProgress(4, 95, ("vanilla/single-03",), 0.2, 3720.0))
    assert shown == [
        ("3 of 95 jobs; vanilla/single-01, vanilla/single-02", 0.1),
        ("4 of 95 jobs, 62 min left; vanilla/single-03", 0.2),
    ]
