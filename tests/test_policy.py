"""Guides in the searches, and on the command line."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from guide_cases import blocks
from small_assemblies import WORKCELL, three_bars
from takeapart.cli.commands import main
from takeapart.formats.files import data_path, load_assembly, load_plan, save_assembly
from takeapart.guide.experience import read_experience
from takeapart.guide.policy import LearnedGuide, guide_path, load_guide
from takeapart.guide.weights import load_weights, save_weights
from takeapart.model.assembly import members
from takeapart.model.errors import InputError
from takeapart.planning import PlanningOptions, build_problem, run_identity, search
from takeapart.search.result import Budget
from test_weights import drawn_weights
from verification_scene import scene_workcell


def test_values_of_all_parts_and_no_state_is_computed_twice(tmp_path: Path) -> None:
    save_weights(drawn_weights(), tmp_path / "guide.safetensors")
    assembly = blocks(6)
    guide = load_guide(tmp_path / "guide.safetensors", assembly)
    states = [assembly.root, 0b101, 0b1, 0, 0b101]
    first = guide(states)
    assert [sorted(values) for values in first] == [members(state) for state in states]
    assert guide.computed == 4
    assert guide([0b101]) == [first[1]] and guide.computed == 4
    assert first[1] == pytest.approx(LearnedGuide(drawn_weights(), assembly)([0b101])[0])


def test_searches_see_valuesof_candidates_only() -> None:
    problem = build_problem(three_bars(), scene_workcell())
    seen: list[Mapping[int, float]] = []

    def all_parts(states: Sequence[int]) -> list[Mapping[int, float]]:
        return [{part: -float(part) for part in members(state)} for state in states]

    from takeapart import planning

    restricted = planning.of_candidates(all_parts, problem)
    state = problem.root
    seen += restricted([state])
    assert sorted(seen[0]) == sorted(problem.candidates(state)) != members(state)
    assert all(value == -part for part, value in seen[0].items())


@pytest.mark.parametrize("name", ["mcts", "beam"])  # exact needs no advice here: the smallest states are the states
def test_every_guided_search_asks_the_guide_and_plans(name: str) -> None:
    asked: list[int] = []

    def guide(states: Sequence[int]) -> list[Mapping[int, float]]:
        asked.extend(states)
        return [dict.fromkeys(members(state), -1.0) for state in states]

    options = PlanningOptions(search=name, budget=Budget(episodes=5))
    problem = build_problem(three_bars(), scene_workcell(), options)
    assert len(search(problem, options, guide).removals) == 3
    assert asked


def test_a_run_is_bound_to_the_weights_of_its_guide() -> None:
    assembly, cell, options = three_bars(), scene_workcell(), PlanningOptions()
    guides = [None, LearnedGuide(drawn_weights(0), assembly), LearnedGuide(drawn_weights(1), assembly)]
    identities = [run_identity(assembly, cell, options, guide) for guide in guides]
    assert len({json.dumps(identity["guide"]) for identity in identities}) == 3
    assert identities[1] == run_identity(assembly, cell, options, LearnedGuide(drawn_weights(0), assembly))


def test_no_guide_of_an_unknown_name(monkeypatch: pytest.MonkeyPatch) -> None:
    assert guide_path("a.safetensors") == Path("a.safetensors")
    monkeypatch.setattr("takeapart.guide.policy.SHIPPED", "guide/none.safetensors")
    with pytest.raises(InputError, match="no guide comes with this installation"):
        guide_path("default")


def test_the_shipped_guide_knows_what_is_left() -> None:
    """Its values against the lengths of plans, on assemblies that it did not learn from."""
    path = guide_path("default")
    assert path.stat().st_size < 2_000_000
    weights = load_weights(path)
    assert weights.training["options"]["teacher"] in {"backup", "exact", "dqn"}
    # Held out of its training; the lengths, m, are those of the plans of exact search.
    for name, length in (("single/07", 13.4), ("double/02", 20.0)):
        assembly = load_assembly(data_path(f"{name}.json"))
        values = LearnedGuide(weights, assembly)([assembly.root])[0]
        assert sorted(values) == members(assembly.root)
        assert all(0.95 * length < -value < 1.05 * length for value in values.values())
        # A state of half as many parts has about half as much left.
        half = sum(1 << part for part in members(assembly.root)[::2])
        fewer = LearnedGuide(weights, assembly)([half])[0]
        assert 0.35 < np.mean(list(fewer.values())) / np.mean(list(values.values())) < 0.65


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save_assembly(three_bars(), tmp_path / "product.json")
    (tmp_path / "cell.toml").write_text(WORKCELL)
    return tmp_path


def run(folder: Path, *arguments: str) -> str:
    cell = ["--workcell", str(folder / "cell.toml"), "--out", str(folder / "p.json")] if arguments[0] == "plan" else []
    result = CliRunner().invoke(main, [*arguments, *cell])
    assert result.exit_code == 0, result.output
    return result.output


def test_from_recording_to_a_guided_plan_on_the_command_line(folder: Path) -> None:
    product, seen, guide = (str(folder / name) for name in ("product.json", "seen", "guide.safetensors"))
    run(folder, "plan", product, "--search", "mcts", "--episodes", "3", "--experience", seen)
    rows = read_experience(folder / "seen").table.height
    run(folder, "plan", product, "--experience", seen)
    table = read_experience(folder / "seen").table
    assert set(table["search"].to_list()) == {"exact", "mcts"} and table.height > rows > 5
    assert table["bound"].is_not_null().sum() >= 3
    output = run(folder, "train", seen, "--out", guide, "--steps", "20", "--layers", "1", "--width", "8", "--json")
    trained = json.loads(output)
    assert trained["steps"] == 20 and trained["held_out"] == [] and Path(trained["log"]).is_file()
    assert "written to" in run(folder, "train", seen, "--out", guide, "--steps", "20", "--layers", "1", "--width", "8")
    run(folder, "plan", product, "--search", "mcts", "--episodes", "3", "--guide", guide)
    assert len(load_plan(folder / "p.json").steps) == 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--guide", "none.safetensors"], "none.safetensors: there is no such file"),
        (
            ["--search", "restarts", "--guide", "none"],
            "--guide goes with --search exact, best-first, mcts, beam, greedy only, not with restarts",
        ),
        (
            ["--search", "beam", "--experience", "x"],
            "--experience goes with --search exact, best-first, mcts only, not with beam",
        ),
        (["--experience", "product.json"], "no folder for experience can be made there"),
    ],
)
def test_misuse_is_told_in_one_line(folder: Path, arguments: list[str], message: str) -> None:
    given = [str(folder / argument) if argument == "product.json" else argument for argument in arguments]
    result = CliRunner().invoke(main, ["plan", str(folder / "product.json"), *given])
    assert result.exit_code == 2
    assert message in result.stderr and result.stderr.count("\n") == 1


@pytest.mark.parametrize("guided", [False, True])
def test_planning_imports_no_torch(folder: Path, guided: bool) -> None:
    save_weights(drawn_weights(), folder / "guide.safetensors")
    script = (
        "import sys\nfrom takeapart.cli.commands import main\n"
        "try:\n    main(sys.argv[1:])\nfinally:\n"
        "    print(sorted({'torch', 'polars', 'safetensors'} & set(sys.modules)), file=sys.stderr)\n"
    )
    command = [sys.executable, "-c", script, "plan", "product.json", "--workcell", "cell.toml", "--episodes", "2"]
    command += ["--guide", "guide.safetensors"] if guided else []
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stderr.strip().splitlines()[-1] == "[]"
