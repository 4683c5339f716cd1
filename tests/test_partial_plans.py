"""Plans that leave parts where they are: how they are made on the command line, and what every command says of them."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result

from browser import opened, wait_until
from command_line import enter, plan, run
from example_documents import snapshot
from small_assemblies import WORKCELL, deadlock, three_bars, two_bars
from takeapart.formats import documents
from takeapart.formats.files import load_assembly, load_plan, load_workcell, save_assembly
from takeapart.model.assembly import Assembly
from takeapart.removal.planner import RemovalPlanner
from takeapart.search.registry import SEARCHES
from takeapart.show.facts import part_facts, why_not_earlier
from takeapart.show.scene import PlanScene
from takeapart.verification.checks import straight_line_bound
from takeapart.viewer.explain import Explainer
from takeapart.viewer.texts import totals_text

HOLDS = "2 of 3 parts; this remains: beam"


def heavy() -> Assembly:
    """Three bars of which the beam is too heavy for the arm: two leave, one remains."""
    whole = three_bars()
    return Assembly(
        "heavy", tuple(replace(p, mass=50.0) if p.name == "beam" else p for p in whole.parts), whole.connectors
    )


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a product and its partial plan, which the command wrote."""
    folder = tmp_path_factory.mktemp("partial")
    save_assembly(heavy(), folder / "heavy.json")
    (folder / "cell.toml").write_text(WORKCELL)
    given = ["--workcell", str(folder / "cell.toml"), "--out", str(folder / "heavy.plan.json")]
    result = run("plan", str(folder / "heavy.json"), "--partial", *given)
    assert result.exit_code == 3, result.stderr
    return folder


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    enter(tmp_path, (heavy(), two_bars(), deadlock()), monkeypatch)
    return tmp_path


def words(result: Result) -> str:
    """What was printed, without its line breaks."""
    return " ".join(result.stdout.split())


def scene(folder: Path) -> PlanScene:
    assembly = load_assembly(folder / "heavy.json")
    return PlanScene(assembly, load_workcell(folder / "cell.toml"), load_plan(folder / "heavy.plan.json"))


# ---- made


@pytest.mark.parametrize("search", SEARCHES)
def test_the_deepest_plan_is_written_and_the_exit_code_says_that_it_is_none_of_the_whole(
    folder: Path, search: str
) -> None:
    result = plan("heavy.json", "--search", search, "--seconds", "60", "--partial", "--out", "old.json")
    assert result.exit_code == 3
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith("no feasible order; with 1 part left: beam: weighs 50 kg")
    assert result.stderr.endswith("; a partial plan that takes out 2 of 3 parts was written to old.json\n")
    assert "partial disassembly of heavy in workcell scene" in words(result)
    assert f"partial {HOLDS} (no more parts can leave" in words(result)
    assert "no plan that takes out the same parts" in result.stdout and "sequence bound" not in result.stdout
    written = load_plan("old.json")
    assert sorted(step.part for step in written.steps) == ["rear", "stub"]
    assert (written.remaining, written.sequence_bound) == (("beam",), None)
    assert written.total_length == pytest.approx(sum(step.length for step in written.steps))
    expected = straight_line_bound(heavy(), load_workcell("cell.toml"), ("beam",))
    assert written.straight_line_bound == pytest.approx(expected, abs=1e-6)


def test_without_the_option_nothing_is_written_and_it_is_named(folder: Path) -> None:
    before = snapshot(folder)
    result = plan("heavy.json", "--out", "old.json")
    assert result.exit_code == 3
    ending = "; nothing was written; 2 of 3 parts can leave before that: --partial writes this plan\n"
    assert result.stderr.endswith(ending)
    assert result.stdout == ""
    assert snapshot(folder) == before


def test_for_machines(folder: Path) -> None:
    result = plan("heavy.json", "--partial", "--json", "--out", "old.json")
    document = json.loads(result.stdout)
    assert result.exit_code == 3
    assert (document["feasible"], document["proved"], document["remaining"]) == (False, True, ["beam"])
    partial = document["partial"]
    assert (partial["file"], partial["deepest_proved"], partial["shortest_proved"]) == ("old.json", True, True)
    written = load_plan("old.json")
    assert [each["part"] for each in partial["order"]] == [step.part for step in written.steps]
    assert partial["total_length"] == pytest.approx(written.total_length)
    silent = json.loads(plan("heavy.json", "--json", "--out", "other.json").stdout)
    assert silent["partial"] == partial | {"file": None}
    assert not Path("other.json").exists()


def test_a_product_with_an_order_gives_the_whole_plan(folder: Path) -> None:
    result = plan("two-bars.json", "--partial", "--out", "old.json")
    assert result.exit_code == 0
    assert "partial" not in result.stdout + result.stderr
    assert load_plan("old.json").remaining == ()
    assert "remaining" not in json.loads(Path("old.json").read_text())


def test_where_no_part_can_leave_there_is_nothing_to_write(folder: Path) -> None:
    before = snapshot(folder)
    result = plan("deadlock.json", "--partial", "--out", "old.json")
    assert result.exit_code == 3
    assert result.stderr.endswith("; nothing was written; no part can leave\n")
    assert result.stdout == ""
    assert snapshot(folder) == before
    document = json.loads(plan("deadlock.json", "--partial", "--json", "--out", "old.json").stdout)
    assert (document["partial"]["file"], document["partial"]["order"]) == (None, [])
    assert snapshot(folder) == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--out", "heavy.json"], "heavy.json"),
        (["--out", "nowhere.json/plan.json"], "nowhere.json"),
        (["--search", "greedy", "--workers", "2"], "--workers goes with --search exact only"),
        (["--search", "exact", "--memory", "paper"], "--memory goes with --search mcts only"),
    ],
)
def test_misuse_is_refused_before_the_work(folder: Path, arguments: list[str], message: str) -> None:
    (folder / "nowhere.json").write_text("")
    before = snapshot(folder)
    result = plan("heavy.json", "--partial", *arguments)
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stdout == ""
    assert snapshot(folder) == before


def test_the_same_seed_gives_the_same_partial_plan(folder: Path) -> None:
    def kept(name: str) -> dict[str, Any]:
        assert plan("heavy.json", "--partial", "--seed", "3", "--out", name).exit_code == 3
        document: dict[str, Any] = json.loads(Path(name).read_text())
        del document["seconds"]
        return document

    assert kept("one.json") == kept("two.json")


def test_a_run_continues_to_the_same_partial_plan(folder: Path) -> None:
    given = ["--partial", "--run", "kept"]
    assert plan("heavy.json", *given, "--out", "one.json").exit_code == 3
    again = plan("heavy.json", *given, "--out", "two.json")
    assert again.exit_code == 3
    assert "continuing the run in kept" in again.stderr
    first, second = load_plan("one.json"), load_plan("two.json")
    assert [step.part for step in first.steps] == [step.part for step in second.steps]
    assert all(
        np.array_equal(one.joint_path, two.joint_path) for one, two in zip(first.steps, second.steps, strict=True)
    )


# ---- interrupted


def interrupted_at(call: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C at the given call of the removal planner."""
    original, calls = RemovalPlanner.plan, iter(range(1, 10**6))

    def interrupted(self: RemovalPlanner, *arguments: Any, **keywords: Any) -> Any:
        if next(calls) == call:
            raise KeyboardInterrupt
        return original(self, *arguments, **keywords)

    monkeypatch.setattr(RemovalPlanner, "plan", interrupted)


@pytest.mark.parametrize("as_json", [False, True])
def test_an_interrupt_keeps_what_is_known_of_how_far_the_product_comes_apart(
    folder: Path, monkeypatch: pytest.MonkeyPatch, as_json: bool
) -> None:
    interrupted_at(2, monkeypatch)
    given = ["--search", "greedy", "--partial", "--out", "old.json", *["--json"] * as_json]
    result = plan("heavy.json", *given)
    assert result.exit_code == 130
    assert result.stderr == (
        "interrupted before any plan was found; a partial plan that takes out 1 of 3 parts, perhaps more, was written "
        "to old.json\n"
    )
    written = load_plan("old.json")
    assert len(written.steps) == 1 and len(written.remaining) == 2
    assert written.search["partial_deepest"] is False
    if as_json:
        document = json.loads(result.stdout)
        assert (document["interrupted"], document["partial"]["deepest_proved"]) == (True, False)
        assert document["partial"]["file"] == "old.json"
    else:
        assert "(perhaps more parts can leave)" in result.stdout


def test_an_interrupt_before_the_first_removal_writes_nothing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    interrupted_at(1, monkeypatch)
    before = snapshot(folder)
    result = plan("heavy.json", "--search", "greedy", "--partial", "--out", "old.json")
    assert result.exit_code == 130
    assert result.stderr == "interrupted before any plan was found; nothing was written\n"
    assert snapshot(folder) == before


@pytest.mark.parametrize(("call", "taken"), [(1, 0), (2, 1)])
def test_an_interrupt_after_the_proof_keeps_the_proof_and_what_was_found(
    folder: Path, monkeypatch: pytest.MonkeyPatch, call: int, taken: int
) -> None:
    """Exact search knows from masks that there is no order; only how far the product comes apart is asked then."""
    interrupted_at(call, monkeypatch)
    before = snapshot(folder)
    result = plan("heavy.json", "--partial", "--out", "old.json")
    assert result.exit_code == 3
    assert result.stderr.startswith("no feasible order; with")
    if taken:
        assert result.stderr.endswith("takes out 1 of 3 parts, perhaps more, was written to old.json\n")
        assert len(load_plan("old.json").steps) == 1
    else:
        assert result.stderr.endswith("; nothing was written\n")
        assert snapshot(folder) == before


@pytest.mark.parametrize("failure", [KeyboardInterrupt(), OSError(28, "No space left on device")])
def test_nothing_is_half_written(folder: Path, monkeypatch: pytest.MonkeyPatch, failure: BaseException) -> None:
    before = snapshot(folder)

    def fails(*_: object) -> None:
        raise failure

    monkeypatch.setattr(documents.os, "replace", fails)
    result = plan("heavy.json", "--search", "greedy", "--partial", "--out", "old.json")
    assert result.exit_code == (130 if isinstance(failure, KeyboardInterrupt) else 2)
    assert "written to" not in result.stdout
    assert len(result.stderr.strip().splitlines()) == 1
    assert snapshot(folder) == before


# ---- told


def test_show_says_what_is_partial_and_what_its_bound_is_of(made: Path) -> None:
    shown = run("show", str(made / "heavy.plan.json"))
    assert shown.exit_code == 0
    assert "partial disassembly of heavy in workcell scene" in words(shown)
    assert f"partial {HOLDS} (no more parts can leave, for the removals that the planner finds, stated)" in words(shown)
    assert "no plan that takes out the same parts" in shown.stdout
    assert json.loads(run("show", str(made / "heavy.plan.json"), "--json").stdout)["remaining"] == ["beam"]


def test_verify_judges_what_the_plan_takes_out(made: Path) -> None:
    result = run("verify", str(made / "heavy.plan.json"))
    assert result.exit_code == 0, result.stdout
    assert "holds, as a partial plan: 2 of 3 parts" in result.stdout
    assert "remaining            beam" in result.stdout
    document = json.loads(run("verify", str(made / "heavy.plan.json"), "--no-physics", "--json").stdout)
    assert (document["passed"], document["remaining"], document["removable"]) == (True, ["beam"], 3)


def test_assemble_adds_to_what_remains(made: Path, tmp_path: Path) -> None:
    result = run("assemble", str(made / "heavy.plan.json"), "--out", str(tmp_path / "up.json"))
    assert result.exit_code == 0
    assert "partial assembly of heavy" in words(result) and HOLDS in words(result)
    assert result.stderr == "it starts from a subassembly, which no plan builds: beam\n"
    up = load_plan(tmp_path / "up.json")
    assert (up.direction, up.remaining) == ("assembly", ("beam",))
    assert run("verify", str(tmp_path / "up.json"), "--no-physics").exit_code == 0


def test_what_remains_is_explained(made: Path) -> None:
    given = ["--workcell", str(made / "cell.toml")]
    result = run("explain", str(made / "heavy.json"), *given, "--without", "rear", "--without", "stub")
    assert result.exit_code == 0
    assert "beam" in result.stdout and "50 kg" in result.stdout


def test_report_says_what_is_partial(made: Path, tmp_path: Path) -> None:
    assert run("report", str(made / "heavy.plan.json"), "--out", str(tmp_path / "x.html")).exit_code == 0
    text = (tmp_path / "x.html").read_text()
    assert "Partial disassembly of heavy" in text and f"Partial: {HOLDS}" in text
    assert "no plan that takes out the same parts" in text
    assert "Parts that remain" in text and "no more parts can leave" in text
    assert "no plan that grips each part somewhere" not in text


def test_viewer_and_page_tell_of_parts_that_remain_and_of_none_that_leaves(made: Path) -> None:
    shown = scene(made)
    facts = {each.name: each for each in part_facts(shown)}
    assert [name for name, each in facts.items() if each.remains] == ["beam"]
    assert (facts["beam"].carries, facts["beam"].step) == ((), 0)  # what it carried has left
    assert why_not_earlier(facts["beam"]) == (
        "It remains, the plan is partial; 'takeapart explain' tells what keeps it."
    )
    text = totals_text(shown, list(facts.values()))
    assert "Partial disassembly of heavy" in text and f"Partial: {HOLDS}." in text
    assert "no plan that takes out the same parts" in text
    plain = PlanScene(shown.assembly, shown.workcell)
    assert not any(each.remains for each in part_facts(plain))


def test_planner_is_asked_about_what_remains_once_the_others_are_gone(made: Path) -> None:
    shown = scene(made)
    beam = shown.assembly.index["beam"]
    answer = Explainer(shown).ask(beam, part_facts(shown)[beam])
    assert answer.startswith("It cannot leave what remains: weighs 50 kg")


@pytest.mark.parametrize("direction", ["disassembly", "assembly"])
def test_page_plays_a_partial_plan_and_leaves_the_rest_standing(made: Path, tmp_path: Path, direction: str) -> None:
    file = made / "heavy.plan.json"
    if direction == "assembly":
        file = made / "up.plan.json"
        assert run("assemble", str(made / "heavy.plan.json"), "--out", str(file)).exit_code == 0
    out = tmp_path / "x.html"
    assert run("view", str(file), "--html", str(out)).exit_code == 0
    shown = scene(made)
    beam = shown.assembly.index["beam"]
    with opened(out.as_uri(), 900, 640, offline=True) as found:
        page = found.page
        wait_until(page, "window.takeapart && window.takeapart.firstPicture > 0")
        assert page.locator("#title").inner_text() == f"Partial {direction} of heavy"
        text = page.locator("#totals").inner_text()
        assert f"Partial: {HOLDS}." in text and "no plan that takes out the same parts" in text
        assert "sequence" not in text
        for time in (0, 0.5, 1):
            page.evaluate(f"(() => {{ const p = takeapart.player; p.time = {time} * p.timeline.total; p.draw(); }})()")
            page.wait_for_timeout(300)
            pose = np.reshape(page.evaluate(f"takeapart.player.models[{beam}]"), (4, 4))
            assert np.allclose(pose, shown.assembly.parts[beam].T_world_part)
        page.evaluate(f"takeapart.player.choose({beam})")
        assert "It remains, the plan is partial" in page.locator("#picked").inner_text()
        assert found.errors == []


@pytest.mark.parametrize("options", [["--sheet"], ["--step", "2"], []])
def test_pictures_of_a_partial_plan_are_drawn(made: Path, tmp_path: Path, options: list[str]) -> None:
    out = tmp_path / "x.png"
    result = run("render", str(made / "heavy.plan.json"), *options, "--width", "200", "--out", str(out))
    if "no OpenGL" in result.stderr:
        pytest.skip(result.stderr)
    assert result.exit_code == 0, result.stderr
    assert os.path.getsize(out) > 1000
