"""Kills ``takeapart plan --run`` again and again, and compares the plan in the end with one that was never disturbed.

    python tests/kill_harness.py --kills 100

Every trial plans in a directory of its own: the command is started and killed (SIGKILL) one to four times, each time
at a moment drawn at random, then it may end. Then the plan must be the same, byte for byte but for the seconds; no
answer of the planner that was in the journal after a kill may be missing later; and no query may have been planned and
recorded twice. Prints the table of docs/reliability.md.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import takeapart
from small_assemblies import WORKCELL, three_bars
from takeapart.formats.files import data_path, load_assembly, save_assembly
from takeapart.model.assembly import Assembly

MOMENTS = ("any time", "while the directory is made", "while answers are written", "while the plan is written")
SHARES = (0.45, 0.1, 0.35, 0.1)
MOST_KILLS = 4  # in a row
POLL = 2e-4  # s


def first_to_leave(assembly: Assembly, count: int) -> Assembly:
    """The assembly with only the first few parts of its witness removable."""
    leaving = set(assembly.witness[:count])
    parts = tuple(replace(part, fixed=part.name not in leaving) for part in assembly.parts)
    return Assembly(f"{assembly.name}-{count}", parts, assembly.connectors)


@dataclass(frozen=True)
class Case:
    """A command that is killed."""

    name: str
    assembly: Callable[[], Assembly]
    workcell: str
    arguments: tuple[str, ...]


def _profiles() -> Assembly:
    return first_to_leave(load_assembly(data_path("single/01.json")), 8)


CASES = (
    Case("exact, 2 threads, profiles", _profiles, "panda", ("--search", "exact", "--workers", "2")),
    Case(
        "mcts, memory of the paper, three bars",
        three_bars,
        "cell.toml",
        ("--search", "mcts", "--memory", "paper", "--attempts", "2", "--episodes", "20"),
    ),
    Case("restarts, profiles", _profiles, "panda", ("--search", "restarts", "--episodes", "5", "--queries", "15")),
)


@dataclass(frozen=True)
class Reference:
    """What an undisturbed run gives.

    Args:
        seconds: that it took, start of the process included.
        plan: its plan without the seconds.
        answers: of the planner.
    """

    seconds: float
    plan: str
    answers: int


@dataclass(frozen=True)
class Kill:
    """A kill: what moment was aimed at, and the answers in the journal after it; None before there was a journal."""

    moment: str
    answers: int | None


class Harness:
    """Runs one case in a folder of its own."""

    def __init__(self, case: Case, folder: Path) -> None:
        self.case, self.folder = case, folder
        folder.mkdir(parents=True)
        save_assembly(case.assembly(), folder / "assembly.json")
        (folder / "cell.toml").write_text(WORKCELL)
        self.start("warm").communicate()  # compiles, where that was not done yet
        started = time.monotonic()
        self.finish("reference")
        self.reference = Reference(time.monotonic() - started, self.plan("reference"), self.answers("reference") or 0)

    def start(self, run: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "takeapart", "plan", "assembly.json", "--workcell", self.case.workcell]
        environment = {**os.environ, "PYTHONPATH": str(Path(takeapart.__file__).resolve().parents[1])}
        return subprocess.Popen(
            [*command, *self.case.arguments, "--run", run, "--out", f"{run}.json"],
            cwd=self.folder,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )

    def finish(self, run: str) -> None:
        process = self.start(run)
        _, message = process.communicate()
        assert process.returncode == 0, message

    def plan(self, run: str) -> str:
        """The plan of a run that has ended, without the time that it took."""
        text = (self.folder / run / "plan.json").read_text()
        beside = json.loads((self.folder / f"{run}.json").read_text())
        assert beside["extra"].pop("sources") == {"assembly": "assembly.json", "workcell": self.case.workcell}
        assert beside == {"extra": {}, **json.loads(text)}
        return re.sub(r'"seconds": [^,]*,', "", text, count=1)

    def answers(self, run: str) -> int | None:
        """Answers in the journal, read from a copy; None where there is no journal yet."""
        with tempfile.TemporaryDirectory() as copy:
            for name in ("journal.sqlite", "journal.sqlite-wal"):
                if (self.folder / run / name).exists():
                    shutil.copy(self.folder / run / name, copy)
            if not (Path(copy) / "journal.sqlite").exists():
                return None
            connection = sqlite3.connect(Path(copy) / "journal.sqlite")
            count: int = connection.execute("SELECT count(*) FROM answers").fetchone()[0]
            connection.close()
            return count

    def kill_once(self, run: str, rng: np.random.Generator) -> Kill | None:
        """Start the command and kill it at random; None if it had ended before."""
        moment = str(rng.choice(MOMENTS, p=SHARES))
        reached = self._moment(run, moment, rng)
        process = self.start(run)
        while process.poll() is None and not reached():
            time.sleep(POLL)
        process.send_signal(signal.SIGKILL)
        _, message = process.communicate()
        assert process.returncode in (0, -signal.SIGKILL), message
        return None if process.returncode == 0 else Kill(moment, self.answers(run))

    def _moment(self, run: str, moment: str, rng: np.random.Generator) -> Callable[[], bool]:
        """Whether the moment has come."""
        directory = self.folder / run
        if moment == MOMENTS[0]:
            end = time.monotonic() + rng.uniform(0, self.reference.seconds)
            return lambda: time.monotonic() >= end
        if moment == MOMENTS[1]:
            return _delayed(lambda: (directory / "lock").exists(), rng.uniform(0, 0.05))
        if moment == MOMENTS[3]:
            return _delayed(lambda: any(".plan.json" in name for name in _names(directory)), rng.uniform(0, 0.002))
        log, wanted = directory / "journal.sqlite-wal", int(rng.integers(1, max(2, self.reference.answers)))
        sizes: set[int] = set()

        def written() -> bool:
            sizes.add(log.stat().st_size if log.exists() else 0)
            return len(sizes) > wanted

        return _delayed(written, rng.uniform(0, 0.003))

    def trial(self, run: str, kills: int, rng: np.random.Generator) -> list[Kill]:
        """Kill a run up to so many times, let it end, and compare.

        Raises:
            AssertionError: it did not end, gave another plan, lost an answer, or planned one twice.
        """
        done: list[Kill] = []
        for _ in range(kills):
            kill = self.kill_once(run, rng)
            if kill is None:
                break
            done.append(kill)
        counts = [kill.answers for kill in done if kill.answers is not None]
        assert all(before <= after for before, after in itertools.pairwise(counts)), f"answers were lost: {done}"
        self.finish(run)
        assert self.plan(run) == self.reference.plan, f"another plan after {done}"
        assert self.answers(run) == self.reference.answers, f"not the same answers after {done}"
        journal = {f"journal.sqlite{end}" for end in ("", "-wal", "-shm")}  # all three, if killed before it was closed
        left = set(_names(self.folder / run)) - {"run.json", "plan.json", "lock"} - journal
        assert not left, f"left over: {left}"
        shutil.rmtree(self.folder / run)
        return done


def _names(directory: Path) -> list[str]:
    try:
        return os.listdir(directory)
    except FileNotFoundError:
        return []


def _delayed(event: Callable[[], bool], delay: float) -> Callable[[], bool]:
    """Whether so many seconds have passed since an event was seen."""
    seen: list[float] = []

    def reached() -> bool:
        if not seen and event():
            seen.append(time.monotonic())
        return bool(seen) and time.monotonic() >= seen[0] + delay

    return reached


@dataclass(frozen=True)
class Outcome:
    """What happened to one case: kills by moment, those with no answer yet and with some, and the runs compared."""

    case: Case
    reference: Reference
    kills: tuple[Kill, ...]
    runs: int


def disturb(case: Case, folder: Path, kills: int, seed: int) -> Outcome:
    """Kill a case so many times in all, in as many runs as that takes."""
    rng = np.random.default_rng(seed)
    harness = Harness(case, folder)
    done: list[Kill] = []
    runs = 0
    while len(done) < kills:
        row = min(int(rng.integers(1, MOST_KILLS + 1)), kills - len(done))
        done += harness.trial(f"run-{runs}", row, rng)
        runs += 1
    return Outcome(case, harness.reference, tuple(done), runs)


def table(outcomes: list[Outcome]) -> str:
    """In Markdown; a row for each case."""
    lines = [
        f"| case | queries | kills | {' | '.join(MOMENTS)} | before the first answer | runs compared | same plan |",
        "|---|---|---|" + "---|" * (len(MOMENTS) + 3),
    ]
    for outcome in outcomes:
        by_moment = Counter(kill.moment for kill in outcome.kills)
        cells = [outcome.case.name, outcome.reference.answers, len(outcome.kills)]
        cells += [by_moment[moment] for moment in MOMENTS]
        cells += [sum(not kill.answers for kill in outcome.kills), outcome.runs, outcome.runs]
        lines.append(f"| {' | '.join(str(cell) for cell in cells)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--kills", type=int, default=100, help="in all")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    options = parser.parse_args()
    outcomes = []
    with tempfile.TemporaryDirectory() as folder:
        for number, case in enumerate(CASES):
            kills = options.kills // len(CASES) + (number < options.kills % len(CASES))
            if kills:
                outcomes.append(disturb(case, Path(folder) / str(number), kills, options.seed + number))
                print(table(outcomes[-1:]), file=sys.stderr, flush=True)
    print(table(outcomes))


if __name__ == "__main__":
    main()
