"""The command line as a user meets it: exit codes, one line for every error, and nothing half written."""

from __future__ import annotations

import importlib.util
import io
import itertools
import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import Result
from rich.console import Console

import takeapart
from command_line import enter, plan, run
from example_documents import snapshot
from small_assemblies import deadlock, floating, three_bars, two_bars
from takeapart.cli import compile as cli_compile
from takeapart.cli import generate as cli_generate
from takeapart.cli.commands import main
from takeapart.cli.output import progress_of
from takeapart.formats import files
from takeapart.formats.files import load_assembly, load_plan, save_plan
from takeapart.generate import profiles
from takeapart.model.assembly import Assembly
from takeapart.removal.planner import RemovalPlanner
from takeapart.search.registry import SEARCHES
from verification_scene import scene_plan

SOURCE = Path(takeapart.__file__).resolve().parents[1]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    enter(tmp_path, (two_bars(), three_bars(), deadlock(), floating()), monkeypatch)
    return tmp_path


def edited(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def empty(folder: Path) -> None:
    (folder / "two-bars.json").write_text("")


def truncated(folder: Path) -> None:
    text = (folder / "two-bars.json").read_text()
    (folder / "two-bars.json").write_text(text[: len(text) // 2])


def wrong_version(folder: Path) -> None:
    edited(folder / "two-bars.json", '"version": 1', '"version": 3')


def floating_part(folder: Path) -> None:
    (folder / "floating.json").rename(folder / "two-bars.json")


def overlapping_parts(folder: Path) -> None:
    document = json.loads((folder / "two-bars.json").read_text())
    document["parts"][-1]["pose"]["position"][0] += 0.005
    (folder / "two-bars.json").write_text(json.dumps(document))


def no_file(folder: Path) -> None:
    (folder / "two-bars.json").unlink()


def another_format(folder: Path) -> None:
    save_plan(scene_plan(), folder / "two-bars.json")


def unknown_robot(folder: Path) -> None:
    edited(folder / "cell.toml", 'model = "panda"', 'model = "pandora"')


def bad_goal(folder: Path) -> None:
    edited(folder / "cell.toml", "goal = [-0.05, -0.30, 0.42]", "goal = [-0.05, nan, 0.42]")


def no_workcell(folder: Path) -> None:
    (folder / "cell.toml").unlink()


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (empty, "two-bars.json: the file is empty"),
        (truncated, "two-bars.json: not valid JSON: it ends too early"),
        (wrong_version, "two-bars.json: version: version 3; this release reads version 1 and 2"),
        (floating_part, "floating: parts: part 'stub' drops: nothing that it touches is below it"),
        (overlapping_parts, "two-bars.json: parts: parts 'beam' and 'stub' overlap by 4.50 mm"),
        (no_file, "two-bars.json: there is no such file"),
        (another_format, "two-bars.json: format: format 'takeapart/plan'; must be 'takeapart/assembly'"),
        (
            unknown_robot,
            "cell.toml: robot.model: unknown robot 'pandora'; valid: a path that ends in "
            ".toml, panda, robotiq-2f-85, ur5e, xarm7",
        ),
        (bad_goal, "cell.toml: goal[1]: nan; must be a finite number"),
        (no_workcell, "cell.toml: there is no such file"),
    ],
)
@pytest.mark.parametrize("command", ["plan", "explain"])
def test_broken_input_is_one_line_and_touches_nothing(folder: Path, command: str, damage: Any, message: str) -> None:
    damage(folder)
    before = snapshot(folder)
    output = ["--out", "old.json"] if command == "plan" else []
    result = run(command, "two-bars.json", "--workcell", "cell.toml", *output)
    assert result.exit_code == 2
    assert result.stderr.startswith("error: ")
    assert message in result.stderr
    assert result.stderr.count("\n") == 1
    assert result.stdout == ""
    assert snapshot(folder) == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["plan"], "Missing argument 'ASSEMBLY' (see: takeapart plan --help)"),
        (["plan", "two-bars.json", "--search", "best"], "Invalid value for '--search': 'best' is not one of"),
        *(
            (["plan", "two-bars.json", "--seconds", seconds], f"--seconds: {seconds}; must be a number of seconds")
            for seconds in ("0", "-1", "nan", "-inf", "1e400", "soon")
        ),
        (["plan", "two-bars.json", "--memory", "paper"], "--memory goes with --search mcts only, not with exact"),
        (["plan", "two-bars.json", "--search", "mcts", "--workers", "2"], "--workers goes with --search exact only"),
        (["plan", "two-bars.json", "--search", "beam", "--states", "9"], "--states goes with --search exact only"),
        (
            ["plan", "two-bars.json", "--workcell", "ur5"],
            "unknown workcell 'ur5'; valid: a path that ends in .toml, panda",
        ),
        (["plan", "two-bars.json", "--out", "two-bars.json"], "two-bars.json: is an input of this command"),
        (
            ["plan", "two-bars.json", "--out", "old.json/plan.json"],
            "old.json/plan.json: cannot be written: ",
        ),
        (["plan", "two-bars.json", "--out", "."], "cannot be written: it is a folder"),
        (
            ["explain", "two-bars.json", "--without", "bean"],
            "unknown part 'bean'; valid: beam, front, left, right, stub",
        ),
        (["explain", "two-bars.json", "--without", "left"], "--without: part 'left' is fixed"),
        (["show", "nothing"], "nothing: there is no such file, and no shipped workcell of this name"),
        (["show", "old.json"], "old.json: not valid JSON"),
        (["assemble", "two-bars.json", "--out", "x.json"], "two-bars.json: format: format 'takeapart/assembly'"),
        (["verify", "two-bars.json"], "two-bars.json: format: format 'takeapart/assembly'"),
        (["generate", "--spacing", "0.01"], "options.spacing: 0.01 m; must be from"),
        (["generate", "--layers", "9"], "options.height"),
        (["generate", "--out", "old.json"], "old.json: the folder cannot be made"),
        (["frobnicate"], "No such command 'frobnicate' (see: takeapart --help)"),
    ],
)
def test_misuse_is_one_line_and_touches_nothing(folder: Path, arguments: list[str], message: str) -> None:
    before = snapshot(folder)
    result = run(*arguments)
    assert result.exit_code == 2
    assert result.stderr.startswith("error: ")
    assert message in result.stderr
    assert result.stderr.count("\n") == 1
    assert snapshot(folder) == before


def test_a_real_process_fails_without_a_traceback(folder: Path) -> None:
    (folder / "empty.json").write_text("")
    done = subprocess.run(
        [sys.executable, "-m", "takeapart", "plan", "empty.json"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(SOURCE)},
    )
    assert (done.returncode, done.stdout, done.stderr) == (2, "", "error: empty.json: the file is empty\n")


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys\nfrom takeapart.cli.commands import main\n"
        "try:\n    main(['plan', '--help'])\nexcept SystemExit:\n    pass\n"
        "print(sorted({'numpy', 'numba', 'mujoco', 'ssik', 'pydantic', 'rich', 'torch'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": str(SOURCE)},
    )
    assert done.stdout.endswith("[]\n")


def test_every_option_is_explained() -> None:
    context = click.Context(main)
    for name in main.list_commands(context):
        command = main.get_command(context, name)
        assert command is not None
        text = run(name, "--help").stdout
        assert command.short_help and command.help
        for parameter in command.params:
            if isinstance(parameter, click.Option):
                assert parameter.help, f"{name} {parameter.name}"
                assert all(option in text for option in parameter.opts)
            else:
                assert parameter.name is not None
                assert (parameter.metavar or parameter.name.upper()) in text
    assert all(name in run("--help").stdout for name in main.list_commands(context))


def test_help_pages_keep_their_lines_and_end_with_an_example() -> None:
    for name in (
        *(each for each in main.commands if each != "reproduce"),
        "reproduce paper",
        "reproduce beyond",
        "generate products",
    ):
        text = run(*name.split(), "--help").stdout
        assert "\\b" not in text and "\b" not in text and "``" not in text
        shown = text[text.index("  Example") :].splitlines()[1:]
        assert shown and all(line.startswith("    takeapart ") for line in shown), name
    text = run("--help").stdout
    assert "\\b" not in text and "\b" not in text
    assert "\n    takeapart demo\n" in text and "\n    3    no feasible order\n" in text


def test_help_pages_fit_in_80_columns() -> None:
    for name in ("", *main.commands, "reproduce paper", "reproduce beyond", "generate products"):
        assert all(len(line) <= 80 for line in run(*name.split(), "--help").stdout.splitlines()), name


def test_a_page_of_an_assembly_holds_its_parts(folder: Path) -> None:
    assert run("view", "three-bars.json", "--html", "page.html").exit_code == 0
    text = Path("page.html").read_text()
    found = re.search(r'id="data"[^>]*>(.*)</script>', text, re.DOTALL)
    assert found is not None
    data = json.loads(found.group(1))
    assert [part["name"] for part in data["parts"]] == [part.name for part in load_assembly("three-bars.json").parts]
    assert data["steps"] == [] and data["title"] == "three-bars"


def test_no_command_prints_the_help() -> None:
    assert run().stdout == run("--help").stdout


def test_the_version() -> None:
    assert takeapart.__version__ in run("--version").stdout


def test_the_searches_offered_are_those_of_the_library() -> None:
    shown = " ".join(run("plan", "--help").stdout.split())
    assert f"[{'|'.join(SEARCHES)}]" in shown.replace("| ", "|")
    assert all(entry.description in shown for entry in SEARCHES.values())


def test_plan_writes_and_prints(folder: Path) -> None:
    result = plan("three-bars.json")
    assert (result.exit_code, result.stderr) == (0, "")
    made = load_plan("three-bars.plan.json")
    assert sorted(step.part for step in made.steps) == ["beam", "rear", "stub"]
    for step in made.steps:
        assert re.search(rf"{step.part} +{step.length:.3f} m", result.stdout)
    assert f"{made.total_length:.3f} m" in result.stdout
    assert "proved gap" in result.stdout
    assert "sequence gap 0.0%" in result.stdout
    assert "\x1b" not in result.stdout


def test_no_time_limit_says_so(folder: Path) -> None:
    done = plan("two-bars.json", "--seconds", "inf", "--search", "greedy")
    assert done.exit_code == 0
    assert done.stderr == "--seconds inf: no time limit; Ctrl-C ends the search and keeps the best plan so far\n"


def test_commands_find_what_a_plan_was_made_from_also_after_a_move(folder: Path) -> None:
    assert plan("two-bars.json", "--search", "greedy", "--out", "made/plan.json").exit_code == 0
    there = folder.with_name(f"{folder.name}-moved")
    folder.rename(there)
    for file in (there / "two-bars.json", there / "cell.toml"):
        file.rename(there / "made" / f"renamed{file.suffix}")  # now beside the plan, not where the plan names them
    (there / "elsewhere").mkdir()
    os.chdir(there / "elsewhere")
    assert "129 x 20 x 20" in run("show", "../made/plan.json").stdout
    assert run("report", "../made/plan.json", "--out", "report.html").exit_code == 0
    assert run("assemble", "../made/plan.json", "--out", "back.json").exit_code == 0
    assert "129 x 20 x 20" not in run("show", "back.json").stdout
    if importlib.util.find_spec("mujoco"):
        assert run("verify", "../made/plan.json", "--no-physics").exit_code == 0


def test_what_a_file_states_is_not_shown_as_a_fact(folder: Path) -> None:
    made = plan("three-bars.json").stdout
    phrases = (
        "no plan that grips each part somewhere in its volume is shorter",
        "relative to the paths the planner found",
    )
    assert all(phrase in made for phrase in phrases)
    assert "which gap to believe the proved gap" in made and "stated" not in made
    save_plan(replace(load_plan("three-bars.plan.json"), sequence_bound=0.5, seed=77), "three-bars.plan.json")
    shown = run("show", "three-bars.plan.json").stdout
    (forged,) = (line for line in shown.splitlines() if line.startswith("sequence bound"))
    assert forged.startswith("sequence bound       0.500 m, stated  (sequence gap ") and phrases[1] in forged
    (search,) = (line for line in shown.splitlines() if "seed 77" in line)
    assert search.endswith(", stated") and "stated by the file, not checked" in shown.splitlines()[-1]
    assert (
        "stated by the file, not checked" in json.loads(run("show", "three-bars.plan.json", "--json").stdout)["stated"]
    )


def test_progress_fits_in_80_columns() -> None:
    console = Console(width=80, file=io.StringIO(), force_terminal=True)
    progress = progress_of(console)
    text = "best 14.123 m, 12345 queries, bound 13.900 m"
    progress.add_task(f"planning {'profiles-' * 9}, exact", total=2, text=text, completed=1)
    with console.capture() as capture:
        console.print(*progress.get_renderables())
    lines = capture.get().splitlines()
    plain = [re.sub(r"\x1b\[[0-9;]*m", "", line) for line in lines]
    assert all(len(line) <= 80 for line in plain)
    assert any(text in line for line in plain) and any("0:00:00" in line and "…" in line for line in plain)


def test_the_same_seed_gives_the_same_file(folder: Path) -> None:
    texts = []
    for out in ("first.json", "old.json"):  # the second replaces what was there
        assert (
            plan("three-bars.json", "--search", "mcts", "--episodes", "3", "--seed", "5", "--out", out).exit_code == 0
        )
        texts.append(re.sub(r'"seconds": [^,]*,', "", Path(out).read_text()))
    assert texts[0] == texts[1]
    assert len(texts[0]) > 1000


def test_plan_for_machines(folder: Path) -> None:
    result = plan("two-bars.json", "--json", "--search", "greedy")
    document = json.loads(result.stdout)
    assert document["feasible"] is True
    assert [entry["part"] for entry in document["order"]] == ["stub", "beam"]
    assert document["total_length"] == pytest.approx(load_plan(document["file"]).total_length)
    bound = document["straight_line_bound"]
    assert document["proved_gap"] == pytest.approx((document["total_length"] - bound) / bound)
    assert document["sequence_gap"] is None


def test_no_feasible_order(folder: Path) -> None:
    before = snapshot(folder)
    result = plan("deadlock.json", "--out", "old.json")
    assert result.exit_code == 3
    assert result.stderr.count("\n") == 1
    assert "stub: only straight up is tried: lifted by 50 mm it hits beam after 1 mm (stage lift)" in result.stderr
    assert "beam: without it stub would fall (stage stability)" in result.stderr
    assert result.stdout == ""
    assert snapshot(folder) == before


def test_no_feasible_order_for_machines(folder: Path) -> None:
    result = plan("deadlock.json", "--json")
    document = json.loads(result.stdout)
    assert result.exit_code == 3
    assert (document["feasible"], document["proved"]) == (False, True)
    stub = {each["part"]: each for each in document["hindrances"]}["stub"]
    assert (stub["stage"], stub["cause"], stub["blamed"]) == ("lift", "lift", ["beam"])
    assert stub["numbers"] == {"lift_height": 0.05}
    assert stub["hits"] == {"beam": pytest.approx(0.001, abs=1e-6)}


def test_a_goal_out_of_reach(folder: Path) -> None:
    edited(folder / "cell.toml", "goal = [-0.05, -0.30, 0.42]", "goal = [3.0, 0.0, 0.42]")
    before = snapshot(folder)
    result = plan("two-bars.json", "--out", "old.json")
    assert result.exit_code == 2
    assert re.search(r"goal: \(3, 0, 0.42\) m is out of reach: 3.45\d m from .* reaches 0.94\d m$", result.stderr)
    assert result.stderr.count("\n") == 1
    assert snapshot(folder) == before


def interrupt_at(call: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C at the given call of the removal planner."""
    original, calls = RemovalPlanner.plan, itertools.count(1)

    def interrupted(self: RemovalPlanner, *arguments: Any, **keywords: Any) -> Any:
        if next(calls) == call:
            raise KeyboardInterrupt
        return original(self, *arguments, **keywords)

    monkeypatch.setattr(RemovalPlanner, "plan", interrupted)


@pytest.mark.parametrize("as_json", [False, True])
def test_an_interrupt_keeps_the_best_plan_so_far(folder: Path, monkeypatch: pytest.MonkeyPatch, as_json: bool) -> None:
    interrupt_at(3, monkeypatch)  # expansion and simulation of the first iteration gave a whole sequence
    result = plan("two-bars.json", "--search", "mcts", "--memory", "paper", "--out", "old.json", *["--json"] * as_json)
    assert result.exit_code == 0
    assert result.stderr == "interrupted; the best plan so far was written to old.json\n"
    assert [step.part for step in load_plan("old.json").steps] == ["stub", "beam"]
    if as_json:
        assert json.loads(result.stdout)["interrupted"] is True


@pytest.mark.parametrize("search", SEARCHES)
def test_an_interrupt_before_any_plan_leaves_nothing(
    folder: Path, monkeypatch: pytest.MonkeyPatch, search: str
) -> None:
    interrupt_at(2, monkeypatch)
    before = snapshot(folder)
    result = plan("three-bars.json", "--search", search, "--out", "old.json")
    assert result.exit_code == 130
    assert result.stderr == "interrupted before any plan was found; nothing was written\n"
    assert snapshot(folder) == before


def test_an_interrupt_outside_of_the_search(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(path: object) -> Assembly:
        raise KeyboardInterrupt

    monkeypatch.setattr(files, "load_assembly", interrupted)
    result = plan("two-bars.json")
    assert result.exit_code == 130
    assert result.stderr.strip().startswith("error: interrupted")


def test_assembling_twice_gives_the_original(folder: Path) -> None:
    save_plan(scene_plan(), "plan.json")
    assert run("assemble", "plan.json", "--out", "up.json").exit_code == 0
    assert run("assemble", "up.json", "--out", "down.json", "--json").exit_code == 0
    up, down = load_plan("up.json"), load_plan("down.json")
    assert (up.direction, down.direction) == ("assembly", "disassembly")
    assert [step.part for step in up.steps] == [step.part for step in scene_plan().steps][::-1]
    assert (up.steps[0].joint_path == load_plan("plan.json").steps[-1].joint_path[::-1]).all()
    assert Path("down.json").read_bytes() == Path("plan.json").read_bytes()


def test_show_tells_files_apart(folder: Path) -> None:
    save_plan(scene_plan(), "plan.json")
    shown = {name: run("show", name) for name in ("plan.json", "three-bars.json", "cell.toml", "panda")}
    assert all(result.exit_code == 0 for result in shown.values())
    assert "disassembly of scene" in shown["plan.json"].stdout
    assert re.search(r"rear +129 x 20 x 20 +0\.175 0\.000 0\.190 .*beam, back", shown["three-bars.json"].stdout)
    assert "7 parts, 3 removable, 6 connectors" in shown["three-bars.json"].stdout
    assert "workcell scene" in shown["cell.toml"].stdout
    assert "pedestal" in shown["panda"].stdout


def test_show_for_machines(folder: Path) -> None:
    save_plan(scene_plan(), "plan.json")
    for name, form in (("plan.json", "plan"), ("two-bars.json", "assembly"), ("panda", "workcell")):
        assert json.loads(run("show", name, "--json").stdout)["format"] == f"takeapart/{form}"
    document = json.loads(run("show", "plan.json", "--json").stdout)
    assert [entry["part"] for entry in document["order"]] == ["stub", "beam", "loose"]


def test_show_names_floating_parts(folder: Path) -> None:
    assert "floating: stub" in run("show", "floating.json").stdout


def test_show_a_plan_with_the_sizes_of_its_parts(folder: Path) -> None:
    assert plan("two-bars.json").exit_code == 0
    assert "129 x 20 x 20" in run("show", "two-bars.plan.json", "--assembly", "two-bars.json").stdout
    assert "129 x 20 x 20" in run("show", "two-bars.plan.json").stdout  # found beside it
    (folder / "two-bars.json").unlink()
    assert "129 x 20 x 20" not in run("show", "two-bars.plan.json").stdout


def explained(*arguments: str) -> dict[str, dict[str, Any]]:
    result = run("explain", "three-bars.json", "--workcell", "cell.toml", "--json", *arguments)
    assert result.exit_code == 0
    return {entry["part"]: entry for entry in json.loads(result.stdout)["parts"]}


def test_explain_names_what_blocks(folder: Path) -> None:
    now = explained()
    assert now["stub"]["removable"] and now["rear"]["removable"]
    assert now["beam"] == {
        "part": "beam",
        "removable": False,
        "stage": "stability",
        "cause": "gravity",
        "text": "without it stub and rear would fall",
        "numbers": {},
        "hits": {},
        "blamed": ["stub", "rear"],
    }
    later = explained("--without", "stub", "--without", "rear")
    assert list(later) == ["beam"]
    assert later["beam"]["removable"]
    assert later["beam"]["length"] > 0.05  # the lift alone


def test_explain_for_people(folder: Path) -> None:
    result = run("explain", "deadlock.json", "--workcell", "cell.toml")
    assert result.exit_code == 0
    assert re.search(r"stub +no +lift +only straight up is tried: lifted by 50 mm it", result.stdout)
    assert "0 of 2 parts can leave now" in result.stdout


def verified(*arguments: str) -> Result:
    pytest.importorskip("mujoco")
    return run("verify", "two-bars.plan.json", "--assembly", "two-bars.json", "--workcell", "cell.toml", *arguments)


def test_verify_a_good_and_a_bad_plan(folder: Path) -> None:
    assert plan("two-bars.json").exit_code == 0
    good = verified("--report", "report.json")
    assert (good.exit_code, good.stdout.split(":")[0]) == (0, "verified")
    assert json.loads(Path("report.json").read_text())["passed"] is True
    ending = "not checked          sequence bound (relative to the paths the planner found), counts of planner calls, "
    ending += (
        "seconds, seed, search and its history, versions, names of its sources and other extra keys, whether a part "
    )
    ending += "turns between the fingers (friction is compared with its weight, not with its moment)"
    assert good.stdout.splitlines()[-1] == ending
    edited(folder / "two-bars.plan.json", '"width": 0.02', '"width": 0.03')
    bad = verified("--report", "report.json", "--json")
    assert bad.exit_code == 4
    assert json.loads(bad.stdout) | {"seconds": 0} == json.loads(Path("report.json").read_text()) | {"seconds": 0}
    assert {finding["check"] for finding in json.loads(bad.stdout)["findings"]} >= {"width"}
    for extra, rest in (((), ""), (("--no-physics",), ", whether the parts stand under gravity")):
        text = verified(*extra).stdout
        assert text.startswith("not verified") and text.splitlines()[-1] == ending + rest


def test_verify_needs_the_assembly_and_the_workcell_of_the_plan(folder: Path) -> None:
    pytest.importorskip("mujoco")
    save_plan(scene_plan(), "plan.json")
    lost = run("verify", "plan.json")
    assert lost.exit_code == 2
    assert "give it with --assembly FILE" in lost.stderr
    lost = run("verify", "plan.json", "--assembly", "two-bars.json")
    assert lost.exit_code == 2
    assert "workcell 'scene' is neither beside it nor shipped" in lost.stderr
    assert "cell.toml holds one of this name that is not the same" in lost.stderr
    other = run("verify", "plan.json", "--assembly", "two-bars.json", "--workcell", "cell.toml")
    assert other.exit_code == 4
    assert "hash" in other.stdout


def test_verify_without_mujoco_says_how_to_install_it(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_plan(scene_plan(), "plan.json")
    for name in [name for name in sys.modules if name.startswith("takeapart.verification") or name == "mujoco"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delattr(takeapart, "verification", raising=False)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    result = run("verify", "plan.json")
    assert result.exit_code == 2
    assert "pip install 'takeapart[verify]'" in result.stderr
    assert result.stderr.count("\n") == 1


def test_demo_plans_and_verifies_the_shipped_assembly(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mujoco")
    shipped = files.data_path
    stand_in = {"single/01.json": folder / "two-bars.json", "workcells": folder}
    monkeypatch.setattr(files, "data_path", lambda name: stand_in.get(name) or shipped(name))
    (folder / "cell.toml").rename(folder / "panda.toml")
    result = run("demo", "--out", "new/demo", "--json")
    assert result.exit_code == 0, result.stderr
    document = json.loads(result.stdout)
    assert document["verified"] is True
    assert [step.part for step in load_plan("new/demo/plan.json").steps] == ["stub", "beam"]
    assert "verified: two-bars in scene" in run("demo", "--out", "new/demo").stdout


@pytest.mark.slow
def test_demo_as_shipped(tmp_path: Path) -> None:
    result = run("demo", "--out", str(tmp_path / "demo"), "--json")
    assert result.exit_code == 0, result.stderr
    made = load_plan(tmp_path / "demo" / "plan.json")
    assert len({step.part for step in made.steps}) == len(made.steps) == 21
    assert made.straight_line_bound <= made.total_length <= 16.5
    assert json.loads(result.stdout)["verified"] is not False


@pytest.mark.slow
def test_the_example_of_the_readme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (Path(__file__).resolve().parents[1] / "README.md").read_text()
    (example,) = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    assert len([line for line in example.splitlines() if line.strip()]) == 5
    monkeypatch.chdir(tmp_path)
    exec(example, {})
    assert len(load_plan("plan.json").steps) == 21


@pytest.fixture
def finder(monkeypatch: pytest.MonkeyPatch) -> None:
    """An order finder that refuses every other candidate without any planning."""

    def order_finder(workcell: object, robot: object, seed: int, started: Any) -> profiles.OrderFinder:
        asked = itertools.count(1)

        def find(assembly: Assembly) -> tuple[str, ...] | str:
            started()
            return tuple(assembly.names(assembly.root)) if next(asked) % 2 == 0 else "no feasible order, stage path"

        return find

    monkeypatch.setattr(cli_generate, "_order_finder", order_finder)


@pytest.mark.usefixtures("finder")
def test_generate_numbers_its_files_and_counts_what_it_rejects(folder: Path) -> None:
    result = run("generate", "--seed", "7", "--count", "2", "--out", "made/here", "--name", "single")
    assert result.exit_code == 0
    lines = result.stdout.splitlines()
    assert [line.split(":")[0] for line in lines] == ["made/here/01.json", "made/here/02.json"]
    assert all("21 removable parts" in line and "no feasible order, stage path: 1" in line for line in lines)
    second = load_assembly("made/here/02.json")
    assert (second.name, second.provenance["seed"]) == ("single-02", 8)
    again = run("generate", "--seed", "8", "--out", "again", "--name", "single", "--json")
    document = json.loads(again.stdout)["files"][0]
    assert sum(document["rejections"].values()) == document["candidate"]
    first = (folder / "again/01.json").read_text().replace("single-01", "single-02")
    assert first == (folder / "made/here/02.json").read_text()


@pytest.mark.usefixtures("finder")
def test_generate_gives_up_and_leaves_what_was_there(folder: Path) -> None:
    (folder / "made").mkdir()
    (folder / "made/01.json").write_text("an earlier assembly")
    result = run("generate", "--candidates", "1", "--out", "made")
    assert result.exit_code == 2
    assert "no feasible assembly among 1 candidates" in result.stderr
    assert (folder / "made/01.json").read_text() == "an earlier assembly"


def generate_two_cells(monkeypatch: pytest.MonkeyPatch, find: profiles.OrderFinder) -> Result:
    """Cells are made one by one, then an order of all of them is sought."""
    monkeypatch.setattr(cli_generate, "_order_finder", lambda workcell, robot, seed, started: find)
    cells = ("--workcell", "panda-cells", "--cells", "2")
    return run("generate", *cells, "--seed", "7", "--out", "made", "--name", "cells")


def test_generate_puts_cells_around_the_robot(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = generate_two_cells(monkeypatch, lambda assembly: tuple(assembly.names(assembly.root)))
    assert result.exit_code == 0, result.stderr
    assert "42 removable parts" in result.stdout
    made = load_assembly("made/01.json")
    assert made.name == "cells-01"
    assert made.witness == tuple(made.names(made.root))  # the order of all, not that of the cells
    provenance = json.loads((folder / "made/01.json").read_text())["provenance"]
    assert [each["seed"] for each in provenance["cells"]] == [7, 1007]
    assert [sum(part.name.startswith(f"{k}-") for part in made.parts) for k in range(2)] == [len(made.parts) // 2] * 2


def test_generate_says_when_only_single_cells_have_an_order(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def find(assembly: Assembly) -> tuple[str, ...] | str:
        names = tuple(assembly.names(assembly.root))
        return names if len(names) == 21 else "no feasible order, stage ik"

    result = generate_two_cells(monkeypatch, find)
    assert result.exit_code == 2
    assert "cells-01: no feasible order, stage ik, though each cell has one; try another seed" in result.stderr
    assert not list((folder / "made").iterdir())


@pytest.mark.slow
def test_generate_with_the_removal_planner(folder: Path) -> None:
    result = run("generate", "--back", "1", "--front", "1", "--seed", "3", "--out", "made")
    assert result.exit_code == 0, result.stderr
    made = load_assembly("made/01.json")
    assert sorted(made.witness) == sorted(part.name for part in made.parts if not part.fixed)
    assert len(made.witness) == 16
    check = run("explain", "made/01.json", "--json")  # the first part of the witness can leave now
    assert {e["part"]: e["removable"] for e in json.loads(check.stdout)["parts"]}[made.witness[0]]


def test_the_notice_of_compiling(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compiled: list[str] = []
    monkeypatch.setattr(cli_compile, "_is_noted", lambda orders: False)
    monkeypatch.setattr(cli_compile, "missing", lambda orders: {"kernel": None})
    monkeypatch.setattr(cli_compile, "_compile", lambda units, workcell, update: compiled.extend(units))
    result = plan("two-bars.json")
    assert result.exit_code == 0
    assert result.stderr == f"{cli_compile.NOTICE}\n"
    assert compiled == ["kernel"]
