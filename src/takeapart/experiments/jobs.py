"""Jobs of an experiment: pure functions from options and files to numbers and files.

A job reads nothing but what it is handed, so it can run in any process, on any machine, and its result can be kept: it
is worth as much as its key, a digest of everything that shapes it.
"""

from __future__ import annotations

import hashlib
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from takeapart.formats.documents import canonical_json
from takeapart.model.errors import InputError

Outcome = dict[str, Any]
"""What a job found, as JSON holds it."""

Files = Mapping[str, bytes]
"""Contents by path below the folder of a job."""

TASKS = ("experiments.beyond_tasks", "experiments.paper_tasks")
"""Modules that hold the work of jobs."""


class Task(Protocol):
    """The work of a job. Can be pickled."""

    @property
    def cost(self) -> float:
        """Rough amount of work, for estimates of the time left; comparable among tasks of one class."""
        ...

    def identity(self) -> Outcome:
        """All options and the hashes of all data, as JSON holds them."""
        ...

    def run(self, needed: Mapping[str, Path], out: Path) -> Outcome:
        """Do the work.

        Args:
            needed: folder with the files of every job that this one needs.
            out: folder for files of its own.
        """
        ...


@dataclass(frozen=True)
class Job:
    """A task with a name, and the names of the jobs whose files it needs."""

    name: str
    task: Task
    needs: tuple[str, ...] = ()

    @property
    def phase(self) -> str:
        """What the name says before the first slash."""
        return self.name.partition("/")[0]


@dataclass(frozen=True)
class Answer:
    """Result of a job.

    Args:
        outcome: numbers.
        files: it wrote.
        seconds: wall time, s.
        processor_seconds: s.
    """

    outcome: Outcome
    files: Files
    seconds: float
    processor_seconds: float


def perform(task: Task, needed: Mapping[str, Files]) -> Answer:
    """Runs a task in a folder of its own, here and now."""
    started, used = time.perf_counter(), time.process_time()
    with tempfile.TemporaryDirectory(prefix="takeapart-") as folder:
        root = Path(folder)
        out = root / "out"
        out.mkdir()
        folders: dict[str, Path] = {}
        for number, (name, files) in enumerate(needed.items()):
            folders[name] = root / f"needed-{number}"
            write_files(folders[name], files)
        outcome = task.run(folders, out)
        files = read_files(out)
    return Answer(outcome, files, time.perf_counter() - started, time.process_time() - used)


def read_files(folder: Path) -> dict[str, bytes]:
    """All files in a folder and below, by their path from there."""
    found = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


def write_files(folder: Path, files: Files) -> None:
    """The opposite of `read_files`."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content)


def job_keys(jobs: Sequence[Job]) -> dict[str, str]:
    """For each job the digest of all that shapes its result: options, data, versions, code, and the jobs it needs.

    Args:
        jobs: each after those that it needs.

    Raises:
        InputError: a name stands twice, or a job needs one that does not stand before it.
    """
    from takeapart.planning import (  # here, so that worker processes of light tasks start at once
        sources_digest,
        versions,
    )

    keys: dict[str, str] = {}
    for job in jobs:
        missing = [name for name in job.needs if name not in keys]
        if job.name in keys or missing:
            cause = f"needs {', '.join(missing)}, which must stand before it" if missing else "stands twice"
            raise InputError(cause, f"job {job.name}")
        described = {
            "task": type(job.task).__name__,
            "identity": job.task.identity(),
            "versions": versions(),
            "sources": sources_digest(TASKS),
            "needs": {name: keys[name] for name in job.needs},
        }
        keys[job.name] = hashlib.sha256(canonical_json(described).encode()).hexdigest()
    return keys
