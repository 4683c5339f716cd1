"""Tasks for tests of the schedule: arithmetic instead of planning, so that it can be checked by hand."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from takeapart.experiments.jobs import Job, Outcome
from takeapart.model.errors import TakeapartError


@dataclass(frozen=True)
class AddTask:
    """Adds `value` to the sum of the numbers in the files of the needed jobs, and writes a line into `log`.

    Args:
        trouble: "error" raises, "death" ends the process, "bug" raises what is no error of the package.
        seconds: it waits, s.
    """

    value: int
    log: str
    trouble: str = ""
    seconds: float = 0.0

    @property
    def cost(self) -> float:
        return float(self.value)

    def identity(self) -> Outcome:
        return {"value": self.value}

    def run(self, needed: Mapping[str, Path], out: Path) -> Outcome:
        with open(self.log, "a", encoding="utf-8") as log:
            log.write(f"{self.value} {os.getpid()}\n")
        time.sleep(self.seconds)
        if self.trouble == "error":
            raise TakeapartError("no luck")
        if self.trouble == "death":
            os._exit(9)
        total = self.value + sum(int((folder / "deep" / "sum.txt").read_text()) for folder in needed.values())
        (out / "deep").mkdir()
        (out / "deep" / "sum.txt").write_text(str(total))
        return {"sum": total, "threads": os.environ.get("OMP_NUM_THREADS")}


def diamond(log: Path, last: int = 8, trouble: str = "", seconds: float = 0.0) -> list[Job]:
    """Four jobs: two need the first, the last needs these two. Sums: 1, 3, 5, 8 + last."""
    text = str(log)
    return [
        Job("a/1", AddTask(1, text, seconds=seconds)),
        Job("b/2", AddTask(2, text, seconds=seconds), ("a/1",)),
        Job("b/4", AddTask(4, text, trouble, seconds), ("a/1",)),
        Job("c/8", AddTask(last, text, seconds=seconds), ("b/2", "b/4")),
    ]


def done(log: Path) -> list[int]:
    """Values of the tasks that were run, in the order in which they were started."""
    return [int(line.split()[0]) for line in log.read_text().splitlines()] if log.exists() else []


def processes(log: Path) -> set[int]:
    """Processes in which tasks were run."""
    return {int(line.split()[1]) for line in log.read_text().splitlines()}
