"""Faults during planning: killed processes, full disks, read-only directories, damaged files, two processes at once."""

from __future__ import annotations

import functools
import json
import math
import os
import resource
import signal
import sqlite3
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import takeapart
from kill_harness import CASES, Case, disturb
from small_assemblies import WORKCELL, three_bars, two_bars
from takeapart.cli.commands import main
from takeapart.cli.search_options import options_of
from takeapart.formats.files import load_assembly, load_plan, load_workcell, save_assembly
from takeapart.formats.serialization import plan_document
from takeapart.model.assembly import Assembly
from takeapart.model.errors import InputError
from takeapart.model.geometry import pose
from takeapart.model.plan import Grasp, Plan
from takeapart.planning import SEARCHES, PlanningOptions, plan, run_identity
from takeapart.planning.run_journal import Journal, _digest, create_journal, recorded_answers
from takeapart.planning.runs import Identity, RunBudget, open_run
from takeapart.removal.journal import RecordedAnswer, RemovalQuery, ThreadCounts
from takeapart.removal.planner import RemovalPlanner
from takeapart.removal.result import Blocked, Removal
from takeapart.search.exact import ExactOptions
from takeapart.search.mcts import MctsOptions
from takeapart.search.result import Budget
from verification_scene import scene_workcell

OPTIONS = PlanningOptions(budget=Budget(episodes=10))
IDENTITY: Identity = {"seed": 0, "options": {"search": "exact"}}
SEAL = "a" * 64


class CutOffError(Exception):
    """Ends a planning call from within, as a kill would; no search handles it."""


def document(made: object) -> dict[str, object]:
    assert isinstance(made, Plan), made
    return plan_document(replace(made, seconds=0.0))


@functools.cache
def undisturbed(search: str) -> dict[str, object]:
    return document(plan(three_bars(), scene_workcell(), options_for(search)))


def options_for(search: str, workers: int = 1) -> PlanningOptions:
    options = replace(OPTIONS, search=search)
    if search == "mcts":
        return replace(options, search_options=MctsOptions(memory="paper", attempts=2))
    return replace(options, search_options=ExactOptions(workers=workers)) if search == "exact" else options


@contextmanager
def counted(limit: float = math.inf) -> Iterator[list[tuple[int, int]]]:
    """The states and parts that the planner itself is asked for; the call after `limit` of them is cut off."""
    calls: list[tuple[int, int]] = []
    planned = RemovalPlanner.plan

    def counting(self: RemovalPlanner, part: int, state: int, **arguments: object) -> Removal | Blocked:
        if len(calls) >= limit:
            raise CutOffError
        calls.append((state, part))
        return planned(self, part, state, **arguments)  # type: ignore[arg-type]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RemovalPlanner, "plan", counting)
        yield calls


@pytest.mark.parametrize("search", SEARCHES)
def test_a_run_cut_off_after_every_query_ends_with_the_same_plan(search: str, tmp_path: Path) -> None:
    options = options_for(search)
    asked = []
    for session in range(100):
        with counted(1) as calls:
            try:
                made = plan(three_bars(), scene_workcell(), options, run=tmp_path / "run")
                break
            except CutOffError:
                assert not (tmp_path / "run" / "plan.json").exists()
        asked += calls
        assert session < 99
    asked += calls
    assert document(made) == undisturbed(search)
    counts = undisturbed(search)["counts"]
    assert isinstance(counts, dict)
    assert len(asked) == counts["removal_queries"], "what was answered once is not planned again"


def test_threads_share_a_journal(tmp_path: Path) -> None:
    asked = []
    with counted(2) as calls, pytest.raises(CutOffError):
        plan(three_bars(), scene_workcell(), options_for("exact", workers=2), run=tmp_path)
    asked += calls
    with counted() as calls:  # and the number of threads may change in between
        made = plan(three_bars(), scene_workcell(), options_for("exact", workers=3), run=tmp_path)
    asked += calls
    assert document(made) == undisturbed("exact")
    counts = undisturbed("exact")["counts"]
    assert isinstance(counts, dict)
    assert len(asked) == counts["removal_queries"] > 2


def test_a_run_that_has_ended_is_not_searched_again(tmp_path: Path) -> None:
    made = plan(three_bars(), scene_workcell(), OPTIONS, run=tmp_path)
    with counted(0):
        again = plan(three_bars(), scene_workcell(), OPTIONS, run=tmp_path)
    assert document(again) == document(made) == document(load_plan(tmp_path / "plan.json"))


def test_a_run_without_any_order_is_recalled(tmp_path: Path) -> None:
    away = pose((2.0, 0.0, 0.0))
    near = two_bars()
    far = replace(near, parts=tuple(replace(part, T_world_part=away @ part.T_world_part) for part in near.parts))
    first = plan(far, scene_workcell(), OPTIONS, run=tmp_path)
    assert not isinstance(first, Plan)
    with counted(0):
        again = plan(far, scene_workcell(), OPTIONS, run=tmp_path)
    assert not isinstance(again, Plan) and again == first
    assert first.deepest is not None and again.deepest is not None
    assert again.deepest.state == first.deepest.state == 0b11000 and not again.deepest.removals
    assert not (tmp_path / "plan.json").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": 1}, "seed was 0, now 1"),
        ({"search": "mcts"}, "options.search was 'exact', now 'mcts'; .*and [0-9]+ more"),
        ({"budget": Budget()}, "options.budget.episodes was 10, now no limit"),
    ],
)
def test_another_command_is_refused(change: dict[str, object], message: str, tmp_path: Path) -> None:
    plan(two_bars(), scene_workcell(), OPTIONS, run=tmp_path)
    before = contents(tmp_path)
    with pytest.raises(InputError, match=f"this run was started otherwise: {message}; take another folder"):
        plan(two_bars(), scene_workcell(), replace(OPTIONS, **change), run=tmp_path)  # type: ignore[arg-type]
    assert contents(tmp_path) == before


def test_many_long_differences_are_one_short_message(tmp_path: Path) -> None:
    with open_run(tmp_path / "run", {f"\U0003549c{k}" * 9: "a" * 35 for k in range(9)}):
        pass
    other: Identity = {f"\U0003549c{k}" * 9: "b" * 35 for k in range(9)}
    with (
        pytest.raises(InputError, match=r"; and 8 more; take another folder$") as caught,
        open_run(tmp_path / "run", other),
    ):
        pass
    assert len(str(caught.value)) < 300 + len(str(tmp_path))


def test_another_assembly_or_workcell_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CutOffError), counted(1):
        plan(two_bars(), scene_workcell(), OPTIONS, run=tmp_path)
    with pytest.raises(InputError, match=r"assembly\.name was 'two-bars', now 'three-bars'; assembly\.hash was"):
        plan(three_bars(), scene_workcell(), OPTIONS, run=tmp_path)
    moved = replace(scene_workcell(), goal=np.array([-0.05, -0.30, 0.40]))
    with pytest.raises(InputError, match=r"workcell\.hash was"):
        plan(two_bars(), moved, OPTIONS, run=tmp_path)


def test_a_run_of_other_sources_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(CutOffError), counted(1):
        plan(two_bars(), scene_workcell(), OPTIONS, run=tmp_path)
    monkeypatch.setattr("takeapart.planning.plans.sources_digest", lambda: "0" * 64)
    with pytest.raises(InputError, match=r"sources was '\w{12}\.\.\.'?, now '?0{12}\.\.\.'?; take another folder"):
        plan(two_bars(), scene_workcell(), OPTIONS, run=tmp_path)


def contents(folder: Path) -> dict[str, bytes]:
    """All files that hold data: not the lock, an empty log, and SQLite's index of its log."""
    files = {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if not path.name.endswith("-shm")}
    return {name: data for name, data in files.items() if data}


def some_answers(count: int, rng: np.random.Generator) -> list[tuple[RemovalQuery, RecordedAnswer]]:
    """Queries with random answers, every third a refusal; odd numbers and masks of hundreds of parts among them."""
    found = []
    for i in range(count):
        state = int.from_bytes(rng.bytes(40), "little")
        limit = math.inf if i % 2 else float(rng.uniform(0, 2))
        answer: Removal | Blocked = Blocked(i, "ik", state >> 3)
        if i % 3:
            rows = int(rng.integers(2, 60))
            tools = rng.normal(size=(rows, 7)) * 10.0 ** rng.integers(-300, 300, (rows, 7))
            tools[0, 0] = -0.0
            grasp = Grasp(rng.normal(size=3), rng.normal(size=4), float(rng.uniform(0, 0.08)))
            answer = Removal(i, grasp, rng.normal(size=(rows, 6)), tools, float(rng.uniform(0, 2)), state << 2)
        found.append((RemovalQuery(state, i, i % 4, 1 + i % 2, limit), RecordedAnswer(answer, i)))
    return found


def same(a: RecordedAnswer | None, b: RecordedAnswer) -> bool:
    assert a is not None
    if isinstance(a.answer, Blocked) or isinstance(b.answer, Blocked):
        return a.answer == b.answer and a.motion_plans == b.motion_plans
    pairs = [(a.answer.joint_path, b.answer.joint_path), (a.answer.tool_path, b.answer.tool_path)]
    pairs += [(a.answer.grasp.center, b.answer.grasp.center), (a.answer.grasp.orientation, b.answer.grasp.orientation)]
    numbers = [(r.part, r.length, r.blockers, r.grasp.width) for r in (a.answer, b.answer)]
    return (
        all(x.shape == y.shape and x.dtype == y.dtype and x.tobytes() == y.tobytes() for x, y in pairs)
        and numbers[0] == numbers[1]
        and a.motion_plans == b.motion_plans
    )


def filled(path: Path, count: int = 30) -> list[tuple[RemovalQuery, RecordedAnswer]]:
    answers = some_answers(count, np.random.default_rng(3))
    create_journal(path, SEAL)
    journal = Journal(path, SEAL)
    for query, recorded in answers:
        journal.record(query, recorded)
    journal.close()
    return answers


def test_answers_come_back_bit_for_bit(tmp_path: Path) -> None:
    answers = filled(tmp_path / "journal.sqlite")
    journal = Journal(tmp_path / "journal.sqlite", SEAL)
    assert journal.answers == len(answers)
    for query, recorded in answers:
        assert same(journal.recall(query), recorded)
        for other in (
            replace(query, turn=query.turn + 4),
            replace(query, attempts=query.attempts + 1),
            replace(query, shorter_than=math.nextafter(query.shorter_than, 0)),
            replace(query, state=query.state ^ 1),
        ):
            assert journal.recall(other) is None
    journal.close()


def test_all_answers_are_read_in_their_order_and_none_that_was_changed(tmp_path: Path) -> None:
    answers = filled(tmp_path / "journal.sqlite")
    read = recorded_answers(tmp_path / "journal.sqlite")
    assert [query for query, _ in read] == [query for query, _ in answers]
    assert all(same(found, recorded) for (_, found), (_, recorded) in zip(read, answers, strict=True))
    with closing(sqlite3.connect(tmp_path / "journal.sqlite")) as connection, connection:
        connection.execute("UPDATE answers SET part = part + 1 WHERE rowid = 7")
    with pytest.raises(InputError, match="damaged"):
        recorded_answers(tmp_path / "journal.sqlite")


def test_what_was_recorded_survives_a_kill(tmp_path: Path) -> None:
    create_journal(tmp_path / "journal.sqlite", SEAL)
    answers = some_answers(40, np.random.default_rng(4))
    for session in range(4):
        child = os.fork()
        if child == 0:  # no clean-up of any kind
            journal = Journal(tmp_path / "journal.sqlite", SEAL)
            for query, recorded in answers[10 * session : 10 * session + 10]:
                journal.record(query, recorded)
            os.kill(os.getpid(), signal.SIGKILL)
        os.waitpid(child, 0)
    journal = Journal(tmp_path / "journal.sqlite", SEAL)
    assert journal.answers == 40
    assert all(same(journal.recall(query), recorded) for query, recorded in answers)
    journal.close()


def test_several_threads_record_and_recall(tmp_path: Path) -> None:
    create_journal(tmp_path / "journal.sqlite", SEAL)
    answers = some_answers(200, np.random.default_rng(5))
    journal = Journal(tmp_path / "journal.sqlite", SEAL)

    def work(number: int) -> bool:
        query, recorded = answers[number]
        journal.record(query, recorded)
        return same(journal.recall(query), recorded)

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(work, range(200)))
    journal.close()
    assert Journal(tmp_path / "journal.sqlite", SEAL).answers == 200


@pytest.mark.parametrize("kept", [0, 1, 50, 100, 4096, 5000, 0.3, 0.7, 0.999])
def test_a_truncated_journal_is_refused_and_left_alone(kept: float, tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    filled(path)
    data = path.read_bytes()
    path.write_bytes(data[: int(kept if isinstance(kept, int) else kept * len(data))])
    refused(path)


def test_garbage_is_refused_and_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    path.write_bytes(np.random.default_rng(0).bytes(20_000))
    refused(path)
    path.unlink()
    with sqlite3.connect(path) as other:  # a database of something else
        other.execute("CREATE TABLE answers (a)")
    other.close()
    refused(path)


def refused(path: Path) -> None:
    before = path.read_bytes()
    with pytest.raises(InputError) as caught:
        Journal(path, SEAL)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)
    assert path.read_bytes() == before


def test_text_that_is_no_text_is_refused(tmp_path: Path) -> None:
    """SQLite keeps any bytes in a column of text, and its check of the file does not mind them."""
    path = tmp_path / "journal.sqlite"
    filled(path)
    with sqlite3.connect(path) as connection:
        connection.execute("UPDATE answers SET state = CAST(x'e0ff' AS TEXT) WHERE rowid = 3")
    connection.close()
    refused(path)
    assert [file.name for file in tmp_path.iterdir()] == ["journal.sqlite"], "nothing is left beside it"


def test_flipped_bits_never_change_an_answer(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    answers = filled(path, 12)
    data = path.read_bytes()
    rng = np.random.default_rng(6)
    found = 0
    for place in rng.choice(len(data), 150, replace=False):
        damaged = bytearray(data)
        damaged[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        try:
            journal = Journal(path, SEAL)
        except InputError:
            found += 1
            assert path.read_bytes() == damaged
            continue
        assert all(same(journal.recall(query), recorded) for query, recorded in answers)
        journal.close()
        path.with_name("journal.sqlite-wal").unlink(missing_ok=True)
    assert found >= 75  # the others are in space that is not used


def test_a_damaged_log_loses_nothing_but_its_last_answers(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    create_journal(path, SEAL)
    answers = some_answers(6, np.random.default_rng(7))
    child = os.fork()
    if child == 0:
        journal = Journal(path, SEAL)
        for query, recorded in answers:
            journal.record(query, recorded)
        os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(child, 0)
    log = path.with_name("journal.sqlite-wal")
    log.write_bytes(log.read_bytes()[:-100])
    journal = Journal(path, SEAL)
    assert journal.answers == 5
    assert all(same(journal.recall(query), recorded) for query, recorded in answers[:5])
    journal.close()


def test_the_journal_of_another_run_is_refused(tmp_path: Path) -> None:
    filled(tmp_path / "journal.sqlite")
    with pytest.raises(InputError, match="is the journal of another run"):
        Journal(tmp_path / "journal.sqlite", "b" * 64)


@pytest.mark.parametrize(
    ("lost", "message"), [("journal.sqlite", "is missing"), ("run.json", "is missing, but the journal has answers")]
)
def test_a_lost_file_is_told(lost: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(CutOffError), counted(1):
        plan(two_bars(), scene_workcell(), OPTIONS, run=tmp_path)
    (tmp_path / lost).unlink()
    before = contents(tmp_path)
    with pytest.raises(InputError, match=message):
        plan(two_bars(), scene_workcell(), OPTIONS, run=tmp_path)
    assert contents(tmp_path) == before


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": "takeapart/plan", "version": 1}', '"x"'])
def test_a_damaged_description_is_told(text: str, tmp_path: Path) -> None:
    with open_run(tmp_path, IDENTITY):
        pass
    (tmp_path / "run.json").write_text(text)
    with pytest.raises(InputError, match=r"run\.json"), open_run(tmp_path, IDENTITY):
        pass


def test_strange_keys_of_a_description_are_shown_in_one_line(tmp_path: Path) -> None:
    with open_run(tmp_path, IDENTITY):
        pass
    document = json.loads((tmp_path / "run.json").read_text())
    document["options"] |= {"\n\ud800": 1, "a" * 200: 2}
    (tmp_path / "run.json").write_text(json.dumps(document))
    with pytest.raises(InputError) as caught, open_run(tmp_path, IDENTITY):
        pass
    assert str(caught.value).isprintable() and len(str(caught.value)) < 350 + len(str(tmp_path))


def test_a_folder_of_something_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("dear")
    with pytest.raises(InputError, match=r"holds 'thesis.tex' and no run.json"), open_run(tmp_path, IDENTITY):
        pass
    assert os.listdir(tmp_path) == ["thesis.tex"]
    with pytest.raises(InputError, match="no run directory can be made"), open_run(tmp_path / "thesis.tex", IDENTITY):
        pass


def test_halves_of_files_that_a_kill_left_are_removed_and_nothing_else(tmp_path: Path) -> None:
    with open_run(tmp_path, IDENTITY):
        pass
    others = {"notes.tmp", ".run.json.old", "run.json.tmp", ".thesis.tmp"}
    for name in (".run.json.x1.tmp", ".journal.sqlite.tmp", ".plan.json.tmp7", *others):
        (tmp_path / name).write_text("half")
    with open_run(tmp_path, IDENTITY):
        hidden = {name for name in os.listdir(tmp_path) if ".tmp" in name or name.startswith(".run")}
    assert others <= hidden and not {".run.json.x1.tmp", ".journal.sqlite.tmp", ".plan.json.tmp7"} & hidden
    (tmp_path / ".run.json.tmp").mkdir()
    with pytest.raises(InputError, match="cannot be removed") as caught, open_run(tmp_path, IDENTITY):
        pass
    assert str(tmp_path / ".run.json.tmp") in str(caught.value)


def test_a_lock_that_cannot_be_opened_is_told(tmp_path: Path) -> None:
    with open_run(tmp_path, IDENTITY):
        pass
    (lock,) = {name for name in os.listdir(tmp_path) if "lock" in name}
    (tmp_path / lock).unlink()
    (tmp_path / lock).mkdir()
    with pytest.raises(InputError, match="the run directory cannot be written"), open_run(tmp_path, IDENTITY):
        pass


def test_no_journal_is_made_where_sqlite_has_no_write_ahead_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    connect = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", lambda path, **options: connect(":memory:", **options))
    with pytest.raises(InputError, match="no room for SQLite's write-ahead log"):
        create_journal(tmp_path / "journal.sqlite", SEAL)
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize(("changed", "rest"), [(1, ""), (2, ""), (3, ""), (4, "; and 1 more"), (6, "; and 3 more")])
def test_differences_beyond_the_third_are_counted(changed: int, rest: str, tmp_path: Path) -> None:
    with open_run(tmp_path, {**IDENTITY, "options": {f"k{k}": 0 for k in range(8)}}):
        pass
    now = {**IDENTITY, "options": {f"k{k}": int(k < changed) for k in range(8)}}
    listed = "; ".join(f"options.k{k} was 0, now 1" for k in range(min(changed, 3)))
    with pytest.raises(InputError) as caught, open_run(tmp_path, now):
        pass
    assert f"otherwise: {listed}{rest}; take another folder" in str(caught.value)


def test_of_a_digest_the_first_characters_are_shown(tmp_path: Path) -> None:
    with open_run(tmp_path, {**IDENTITY, "sources": "0123456789abcdef" * 4}):
        pass
    with (
        pytest.raises(InputError, match=r"was '?0123456789ab\.\.\.'?, now '?ba9876543210\.\.\."),
        open_run(tmp_path, {**IDENTITY, "sources": "ba9876543210fedc" * 4}),
    ):
        pass


def test_one_process_at_a_time(tmp_path: Path) -> None:
    child = holder(tmp_path)
    try:
        with pytest.raises(InputError, match="another process is working on this run") as caught:
            plan(three_bars(), scene_workcell(), OPTIONS, run=tmp_path)
        assert str(tmp_path) in str(caught.value)
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    assert document(plan(three_bars(), scene_workcell(), OPTIONS, run=tmp_path)) == undisturbed("exact")


def holder(folder: Path) -> int:
    """A process that works on a run until it is killed."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        with open_run(folder, run_identity(three_bars(), scene_workcell(), OPTIONS)):
            os.write(writing, b".")
            signal.pause()
    os.read(reading, 1)
    os.close(reading)
    os.close(writing)
    return child


@contextmanager
def as_nobody() -> Iterator[None]:
    """Without the rights of the superuser, whom no read-only directory stops."""
    if os.geteuid():
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


def test_a_read_only_directory(assembly_in_two_runs: tuple[Path, Path]) -> None:
    ended, cut_off = assembly_in_two_runs
    for folder in (ended, cut_off):
        folder.chmod(0o555)
    before = contents(cut_off)
    with as_nobody():
        assert document(plan(three_bars(), scene_workcell(), OPTIONS, run=ended)) == undisturbed("exact")
        with pytest.raises(InputError, match="the run directory cannot be written: permission denied"):
            plan(three_bars(), scene_workcell(), OPTIONS, run=cut_off)
        with pytest.raises(InputError, match="no run directory can be made there: permission denied"):
            plan(three_bars(), scene_workcell(), OPTIONS, run=cut_off / "new")
    assert contents(cut_off) == before


@pytest.fixture
def assembly_in_two_runs() -> Iterator[tuple[Path, Path]]:
    """A run that has ended and one that was cut off, where every user may look."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        plan(three_bars(), scene_workcell(), OPTIONS, run=folder / "ended")
        with pytest.raises(CutOffError), counted(1):
            plan(three_bars(), scene_workcell(), OPTIONS, run=folder / "cut-off")
        (folder / "cut-off" / "lock").unlink()
        yield folder / "ended", folder / "cut-off"
        for run in folder.iterdir():
            run.chmod(0o755)


@pytest.mark.parametrize("room", [0, 2_000, 20_000, 50_000, 70_000, 90_000])
def test_a_full_disk_loses_nothing(room: int, tmp_path: Path) -> None:
    """No file may grow beyond `room` bytes, which fails as a full disk does: the write is refused."""
    options = options_for("mcts")
    folder = tmp_path / "run"
    answers = 0
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
    try:
        for _ in range(2):  # the second time no further than the first
            with counted() as calls, pytest.raises(InputError, match="cannot be (written|made)") as caught:
                plan(three_bars(), scene_workcell(), options, run=folder)
            assert str(folder) in str(caught.value) and "\n" not in str(caught.value)
            answers += max(0, len(calls) - 1)  # the last was planned in vain
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not (folder / "plan.json").exists()
    with counted() as calls:
        made = plan(three_bars(), scene_workcell(), options, run=folder)
    assert document(made) == undisturbed("mcts")
    counts = undisturbed("mcts")["counts"]
    assert isinstance(counts, dict)
    assert answers + len(calls) == counts["removal_queries"]


def test_seconds_of_all_sessions_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr("takeapart.planning.run_journal.time.monotonic", lambda: now[0])
    answers = some_answers(2, np.random.default_rng(8))
    create_journal(tmp_path / "journal.sqlite", SEAL)
    journal = Journal(tmp_path / "journal.sqlite", SEAL)
    journal.start()
    for query, recorded in answers:
        now[0] += 3.0
        journal.record(query, recorded)
    journal.close()
    now[0] = 500.0
    journal = Journal(tmp_path / "journal.sqlite", SEAL)
    journal.start()
    budget = RunBudget(Budget(seconds=10, queries=5), journal)
    assert (budget.seconds, budget.queries, budget.episodes) == (10, 5, math.inf)
    now[0] += 1.0  # the search itself: was part of the first 3 s too
    journal.recall(answers[0][0])
    assert journal.seconds == 3.0 and budget.seconds == 8.0
    journal.recall(answers[0][0])
    assert journal.seconds == 3.0
    journal.recall(answers[1][0])
    assert journal.seconds == 6.0 and budget.seconds == 5.0
    now[0] += 4.0
    assert journal.seconds == 10.0 and now[0] - 500.0 == budget.seconds, "spent at the same moment"
    journal.close()


def test_the_clock_of_a_run_never_goes_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A session that is slower than the one before: what it recalls was answered earlier than its clock says."""
    now = [0.0]
    monkeypatch.setattr("takeapart.planning.run_journal.time.monotonic", lambda: now[0])
    answers = some_answers(3, np.random.default_rng(9))
    create_journal(tmp_path / "journal.sqlite", SEAL)
    journal = Journal(tmp_path / "journal.sqlite", SEAL)
    journal.start()
    for (query, recorded), at in zip(answers, (1.0, 2.0, 9.0), strict=True):
        now[0] = at
        journal.record(query, recorded)
    journal.close()
    now[0] = 100.0
    journal = Journal(tmp_path / "journal.sqlite", SEAL)
    journal.start()
    budget = RunBudget(Budget(seconds=10), journal)
    for number, at, expected in ((0, 103.0, 3.0), (1, 105.0, 5.0), (2, 106.0, 9.0), (0, 107.0, 10.0)):
        now[0] = at
        journal.recall(answers[number][0])
        assert journal.seconds == expected
        assert journal.ahead == expected - (at - 100.0) == 10 - budget.seconds
    journal.close()


def test_a_spent_budget_in_seconds_leaves_nothing_to_plan(tmp_path: Path) -> None:
    """A run whose time was up when it was killed, after its last answer, gives the plan of these answers."""
    options = replace(options_for("mcts"), budget=Budget(seconds=1000))
    with pytest.raises(CutOffError), counted(8):
        plan(three_bars(), scene_workcell(), options, run=tmp_path)
    with sqlite3.connect(tmp_path / "journal.sqlite") as connection:
        rows = connection.execute("SELECT rowid, * FROM answers ORDER BY rowid").fetchall()
        late = (*rows[-1][1:6], 1001.0, *rows[-1][7:-1])
        connection.execute(
            "UPDATE answers SET seconds = 1001.0, digest = ? WHERE rowid = ?", (_digest(late), rows[-1][0])
        )
    connection.close()
    with counted(0):
        made = plan(three_bars(), scene_workcell(), options, run=tmp_path)
    assert isinstance(made, Plan)
    assert made.counts["removal_queries"] == 8
    assert made.seconds >= 1001


def test_counts_know_what_each_thread_added() -> None:
    counts = ThreadCounts(5, 2)
    added: dict[int, int] = {}
    gate = threading.Barrier(4)

    def work(number: int) -> None:
        gate.wait()
        for _ in range(2000 * number):
            counts.motion_plans += 1
        added[number] = counts.of_this_thread

    threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert added == {number: 2000 * number for number in range(4)}
    assert counts.motion_plans == 5 + 12_000
    assert counts.removal_queries == 2


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    save_assembly(three_bars(), tmp_path / "three.json")
    (tmp_path / "cell.toml").write_text(WORKCELL)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("takeapart.cli.plan.compile_first", lambda workcell: None)
    return tmp_path


COMMAND = ["plan", "three.json", "--workcell", "cell.toml", "--run", "runs/a"]


def without_sources(file: str) -> dict[str, object]:
    """What a plan file holds but for the names of its sources, which a run does not keep."""
    made = load_plan(file)
    assert made.extra["sources"] == {"assembly": "three.json", "workcell": "cell.toml"}
    return plan_document(replace(made, extra={}))


def test_the_command_continues_and_reprints(folder: Path) -> None:
    with counted(2):
        assert isinstance(CliRunner().invoke(main, COMMAND).exception, CutOffError)
    continued = CliRunner().invoke(main, COMMAND)
    assert continued.exit_code == 0
    assert "continuing the run in runs/a, which has 2 answers of the planner" in continued.output
    assert without_sources("three.plan.json") == plan_document(load_plan("runs/a/plan.json"))
    (folder / "three.plan.json").unlink()
    with counted(0):
        again = CliRunner().invoke(main, COMMAND)
    assert again.exit_code == 0 and "has ended" in again.output
    assert without_sources("three.plan.json") == plan_document(load_plan("runs/a/plan.json"))
    other = CliRunner().invoke(main, [*COMMAND, "--seed", "3"])
    assert other.exit_code == 2 and other.output == (
        "error: runs/a: this run was started otherwise: seed was 0, now 3; take another folder\n"
    )


def test_ctrl_c_ends_the_search_and_not_the_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    planned = RemovalPlanner.plan
    command = [*COMMAND, "--search", "mcts", "--memory", "paper"]
    calls: list[int] = []

    def stopped(self: RemovalPlanner, part: int, state: int, **arguments: object) -> Removal | Blocked:
        calls.append(part)
        if len(calls) == 6:
            raise KeyboardInterrupt
        return planned(self, part, state, **arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(RemovalPlanner, "plan", stopped)
    first = CliRunner().invoke(main, command)
    assert first.exit_code == 0 and "interrupted" in first.output
    assert load_plan("three.plan.json").search["interrupted"] is True
    assert not (folder / "runs/a/plan.json").exists()
    second = CliRunner().invoke(main, command)
    assert second.exit_code == 0
    assert load_plan("runs/a/plan.json").search["interrupted"] is False
    assert load_plan("runs/a/plan.json").counts["removal_queries"] == len(calls) - 1


def test_a_killed_command_lets_go_of_its_run(tmp_path: Path) -> None:
    """With real processes: two at once, then SIGKILL, then the same command again."""
    save_assembly(three_bars(), tmp_path / "three.json")
    (tmp_path / "cell.toml").write_text(WORKCELL)
    environment = {**os.environ, "PYTHONPATH": str(Path(takeapart.__file__).resolve().parents[1])}
    command = [sys.executable, "-m", "takeapart", *COMMAND]
    child = holder_of_command(tmp_path / "runs/a")
    refused = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert refused.returncode == 2
    assert refused.stderr == (
        "error: runs/a: another process is working on this run; wait for it, or give another directory\n"
    )
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def holder_of_command(folder: Path) -> int:
    """As `holder`, with the workcell and the options of the command."""
    cell = load_workcell(str(folder.parents[1] / "cell.toml"))
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        with open_run(folder, run_identity(_saved(three_bars()), cell, options_of("exact", 0))):
            os.write(writing, b".")
            signal.pause()
    os.read(reading, 1)
    os.close(reading)
    os.close(writing)
    return child


def _saved(assembly: Assembly) -> Assembly:
    """As it comes back from a file."""
    with tempfile.TemporaryDirectory() as folder:
        save_assembly(assembly, Path(folder) / "a.json")
        return load_assembly(Path(folder) / "a.json")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "kills"), list(zip(CASES, (17, 17, 16), strict=True)), ids=lambda value: getattr(value, "name", str(value))
)
def test_fifty_kills(case: Case, kills: int, tmp_path: Path) -> None:
    outcome = disturb(case, tmp_path / "runs", kills, seed=17)
    assert len(outcome.kills) == kills
    assert any(kill.answers for kill in outcome.kills), "some came amid planning"
