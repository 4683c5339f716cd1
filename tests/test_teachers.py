"""The experiment that compares teachers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from small_assemblies import WORKCELL, three_bars, two_bars
from takeapart.experiments.teachers import (
    LESSONS,
    RANDOM,
    Judgement,
    Solved,
    compare_teachers,
    judge,
    judge_chance,
    solve,
    teachers_markdown,
)
from takeapart.formats.files import load_workcell
from takeapart.guide.experience import read_experience, together
from takeapart.robot.loading import load_robot


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("experience")


@pytest.fixture(scope="module")
def solved(folder: Path) -> dict[str, Solved]:
    (folder / "cell.toml").write_text(WORKCELL)
    workcell = load_workcell(folder / "cell.toml")
    robot = load_robot(workcell)
    assemblies = (two_bars(), three_bars())
    return {each.name: solve(each, workcell, robot, folder / each.name, 0) for each in assemblies}


def test_what_exact_search_knows_is_the_length_of_the_shortest_order(solved: dict[str, Solved]) -> None:
    found = solved["three-bars"]
    root = found.problem.root
    assert len(found.values[root]) == 2  # either stub may leave first
    assert -max(found.values[root].values()) == pytest.approx(found.length, abs=1e-6)
    assert not solved["two-bars"].values  # no choice anywhere


def test_a_guide_is_judged_by_what_its_choices_cost(solved: dict[str, Solved]) -> None:
    found = solved["three-bars"]
    best, worst = (sorted(found.values[found.problem.root].values(), reverse=True)[place] for place in (0, 1))

    def perfect(states: Sequence[int]) -> list[Mapping[int, float]]:
        everything = dict.fromkeys(range(found.problem.root.bit_length()), -math.inf)
        return [{**everything, **found.values.get(state, {})} for state in states]

    def mistaken(states: Sequence[int]) -> list[Mapping[int, float]]:
        return [{part: -value for part, value in values.items()} for values in perfect(states)]

    right, wrong = judge(perfect, found, 0), judge(mistaken, found, 0)
    assert right.regret == right.error == 0 and right.excess == pytest.approx(0, abs=1e-3)
    assert wrong.regret == pytest.approx(best - worst, abs=1e-6)
    assert wrong.excess == pytest.approx((best - worst) / found.length, abs=1e-3)
    assert judge_chance(found, 0).regret == pytest.approx((best - worst) / 2, abs=1e-6)


def test_every_lesson_is_judged_on_what_its_guides_never_saw(
    solved: dict[str, Solved], folder: Path, tmp_path: Path
) -> None:
    experience = read_experience([folder / name for name in solved])
    twice = {"three-bars": solved["three-bars"], "two-bars": solved["three-bars"]}  # the smaller one gives no choice
    training = {"steps": 4, "batch": 4, "evaluate_every": 2}
    judged = compare_teachers(twice, {"mcts": experience, "exact": experience}, LESSONS, 2, training, tmp_path)
    assert list(judged) == [*(lesson.name for lesson in LESSONS), RANDOM]
    assert all(len(found) == 2 for found in judged.values())
    assert len(list(tmp_path.glob("*.safetensors"))) == 2 * len(LESSONS)
    assert len(together([experience, experience]).table) == 2 * len(experience.table)


def test_the_table() -> None:
    judged = {"exact": [Judgement(0.1, 1.0, 0.02), Judgement(0.3, 2.0, 0.04)]}
    judged[RANDOM] = [Judgement(0.5, math.nan, 0.2), Judgement(0.5, math.nan, 0.2)]
    lines = teachers_markdown(judged).splitlines()
    assert lines[2] == "| exact | 200.0 ± 1270.6 | 1.50 | 3.0 ± 12.7 % |"
    assert lines[3] == "| random choice | 500.0 ± 0.0 | - | 20.0 ± 0.0 % |"
