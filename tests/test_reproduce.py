"""The paper's experiments from end to end, on assemblies of two and three bars; also after a kill."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from small_assemblies import WORKCELL, three_bars, two_bars
from takeapart.experiments.paper import reproduce
from takeapart.experiments.paper_jobs import PHASES, load_products, paper_jobs
from takeapart.experiments.paper_settings import DOUBLE, ONE_PATH, SINGLE, PaperSettings, full_settings, quick_settings
from takeapart.experiments.paper_tasks import ReplanningTask, SearchTask, TrainingTask
from takeapart.experiments.workers import LocalWorkers
from takeapart.formats.files import data_path, load_workcell, save_assembly
from takeapart.model.assembly import Assembly
from takeapart.model.errors import InputError
from takeapart.search.mcts import MctsOptions


def named(assembly: Assembly, name: str) -> Assembly:
    return Assembly(name, assembly.parts, assembly.connectors)


def small_settings(folder: Path) -> PaperSettings:
    """Two assemblies in each set, of three parts that leave in either of two orders, and of two."""
    folder.mkdir(exist_ok=True)
    files = {"one": three_bars(), "two": two_bars(), "three": three_bars(), "four": two_bars()}
    for name, assembly in files.items():
        save_assembly(named(assembly, name), folder / f"{name}.json")
    (folder / "cell.toml").write_text(WORKCELL)
    return PaperSettings(
        single=(str(folder / "one.json"), str(folder / "two.json")),
        double=(str(folder / "three.json"), str(folder / "four.json")),
        workcell=str(folder / "cell.toml"),
        figure_assemblies=2,
        replans=2,
        repeats=2,
        mcts=MctsOptions(memory="paper", search_budget=2, attempts=2),
        episodes=2,
        training={"steps": 4, "batch": 4, "evaluate_every": 2},
        reference_queries=20,
        order_attempts=2,
    )


def without_times(text: str) -> list[dict[str, str]]:
    return [
        {name: value for name, value in row.items() if not name.startswith("seconds")}
        for row in csv.DictReader(text.splitlines())
    ]


TABLES = (
    "table1.csv",
    "table2.csv",
    "figure5.csv",
    "equal_plans.csv",
    "savings.csv",
    "traces.csv",
    "reference.csv",
    "orders.csv",
)

MAIN = """
import sys
from pathlib import Path
from test_reproduce import small_settings
from takeapart.experiments.paper import reproduce
from takeapart.experiments.workers import LocalWorkers

if __name__ == "__main__":
    folder = Path(sys.argv[1])
    reproduce(small_settings(folder / "in"), folder, LocalWorkers(1))
"""


@pytest.mark.slow
def test_a_killed_run_goes_on_to_the_same_tables(tmp_path: Path) -> None:
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    for folder in (whole, killed):
        folder.mkdir()
    done = reproduce(small_settings(whole / "in"), whole, LocalWorkers(2))
    assert all(file.stat().st_size > 50 for file in done.files)
    assert {file.name for file in done.files} >= {*TABLES, "report.md", "figure5.png", "table1.png", "table2.png"}

    script = tmp_path / "main.py"
    script.write_text(MAIN)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    process = subprocess.Popen([sys.executable, str(script), str(killed)], env=environment)
    while len(list((killed / "work" / "jobs").rglob("*.json"))) < 6:  # of 25: some searches and a guide
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait(60)
    assert not (killed / "table1.csv").exists()
    reproduce(small_settings(killed / "in"), killed, LocalWorkers(2))
    for name in TABLES:
        first, second = ((folder / name).read_text() for folder in (whole, killed))
        assert without_times(first) == without_times(second) != []

    rows = without_times((whole / "table2.csv").read_text())
    assert [row["id"] for row in rows] == ["1", "2"]
    best = {
        row["set"] + row["id"]: float(row["length"]) for row in without_times((whole / "reference.csv").read_text())
    }
    orders = {
        row["set"] + row["id"] + row["order"]: float(row["length"])
        for row in without_times((whole / "orders.csv").read_text())
    }
    assert set(orders) == {
        f"{place}{order}"
        for place, searches in {
            "single1": ["D1"],
            "single2": ["D1"],
            "double1": ["D1", "D2"],
            "double2": ["D1", "D2"],
        }.items()
        for order in ["random", "vanilla", "exact", *searches]
    }
    for row in rows:
        assert orders[f"double{row['id']}vanilla"] <= float(row["vanilla_shortest"]) + 0.01
        assert float(row["vanilla_initial"]) >= float(row["vanilla_shortest"]) >= best[f"double{row['id']}"] - 0.01
        assert 1 <= int(row["guided_d1_episode"]) <= 2
        assert int(row["vanilla_shortest_motion_plans"]) <= int(row["vanilla_motion_plans"])
    report = (whole / "report.md").read_text()
    assert "paper*" not in report  # its rows belong to the shipped assemblies only
    assert all(title in report for title in PHASES.values())


def test_replanning_is_what_a_query_with_as_many_attempts_does(tmp_path: Path) -> None:
    (tmp_path / "cell.toml").write_text(WORKCELL)
    cell = load_workcell(tmp_path / "cell.toml")
    from takeapart.experiments.paper_tasks import feasible_order, replanned
    from takeapart.planning import build_problem

    problem = build_problem(three_bars(), cell)
    edges = feasible_order(problem, 0)
    assert sorted(part for _, part in edges) == [i for i in range(8) if three_bars().root >> i & 1]
    for state, part in edges:
        steps = list(replanned(problem, state, part, 3, np.random.default_rng(4)))
        for attempts, (length, seconds, calls) in enumerate(steps, 1):
            before = problem.planner.counts.motion_plans
            found = problem.planner.plan(part, state, rng=np.random.default_rng(4), attempts=attempts)
            assert getattr(found, "length", None) == length
            assert problem.planner.counts.motion_plans - before == calls
            assert seconds > 0
    outcome = ReplanningTask(three_bars(), cell, 0, ONE_PATH, 3, 2).run({}, tmp_path)
    lengths = np.array(outcome["lengths"])
    assert lengths.shape == (2, 3) and (np.diff(lengths, axis=1) <= 0).all()
    assert (np.diff(outcome["motion_plans_per_part"], axis=1) >= 0).all()


def test_the_full_run_has_all_rows_of_the_paper() -> None:
    settings = full_settings()
    jobs = {job.name: job for job in paper_jobs(settings, load_products(settings))}
    count = {phase: sum(job.phase == phase for job in jobs.values()) for phase in PHASES}
    assert count == {"figure5": 3, "vanilla": 21, "guide": 22, "guided": 28, "reference": 21, "orders": 21}
    # Leave one out: a guide never sees the assembly on which it is tried.
    assert len(jobs["guide/single-without-03"].needs) == 13
    assert "vanilla/single-03" not in jobs["guide/single-without-03"].needs
    assert jobs["guided/single-03/single"].needs == ("guide/single-without-03",)
    assert jobs["guided/double-05/double"].needs == ("guide/double-without-05",)
    assert "vanilla/double-05" not in jobs["guide/double-without-05"].needs
    assert jobs["guided/double-05/single"].needs == ("guide/single-all",)
    assert len(jobs["guide/single-all"].needs) == 14
    search = jobs["guided/double-05/single"].task
    assert isinstance(search, SearchTask)
    assert (search.options.search_budget, search.options.attempts, search.options.epsilon) == (5, 4, 0.2)
    assert (search.options.memory, search.episodes, search.record) == ("paper", 20, False)
    vanilla = jobs["vanilla/double-05"].task
    assert isinstance(vanilla, SearchTask) and vanilla.record and vanilla.guide is None
    replanning = jobs["figure5/double-03"].task
    assert isinstance(replanning, ReplanningTask) and (replanning.replans, replanning.repeats) == (6, 50)


def test_the_options_of_training_exist() -> None:
    from takeapart.guide.training import TrainingOptions

    for settings in (full_settings(), quick_settings()):
        for job in paper_jobs(settings, load_products(settings)):
            if isinstance(job.task, TrainingTask):
                TrainingOptions(**job.task.options)


def test_shipped_assemblies_are_named() -> None:
    assert all(data_path(f"{name}.json").is_file() for name in (*SINGLE, *DOUBLE))


def test_settings_are_checked() -> None:
    with pytest.raises(InputError, match=r"settings\.single: at least two assemblies"):
        replace(full_settings(), single=("single/01",))
    with pytest.raises(InputError, match=r"settings\.repeats: 0; must be at least 1"):
        replace(full_settings(), repeats=0)


def test_a_search_writes_its_experience_and_trace(tmp_path: Path) -> None:
    (tmp_path / "cell.toml").write_text(WORKCELL)
    cell, out = load_workcell(tmp_path / "cell.toml"), tmp_path / "out"
    options = MctsOptions(memory="paper", search_budget=2, attempts=2)
    outcome = SearchTask(three_bars(), cell, 0, ONE_PATH, options, 2, 1e9, record=True).run({}, out)
    json.dumps(outcome, allow_nan=False)
    from takeapart.guide.experience import read_experience

    rows = read_experience(out).table
    assert 3 <= len(rows) <= outcome["removal_queries"]
    assert outcome["trace"][-1][3] == outcome["statistics"]["shortest_length"]
    assert [row[2] for row in outcome["trace"]] == sorted(row[2] for row in outcome["trace"])
    assert outcome["trace"][0][3] == outcome["statistics"]["initial_length"]
