"""Has jobs done in an order that their needs allow, and keeps every result, so that an interrupted run goes on.

FOLDER/jobs/<name>.json   key, times, outcome, digests of the files; written last, so where it stands all is there
FOLDER/files/<name>/...   files of the job
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import math
import os
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path

from takeapart.experiments.jobs import Answer, Files, Job, Outcome, job_keys, read_files, write_files
from takeapart.experiments.workers import Workers
from takeapart.formats.documents import write_atomically
from takeapart.formats.messages import reason, shown
from takeapart.model.errors import InputError, TakeapartError

TURN = 0.5  # s, between two signs of life


@dataclass(frozen=True)
class Kept:
    """A finished job.

    Args:
        outcome: numbers it found.
        folder: with its files.
        seconds, processor_seconds: it took, s.
    """

    outcome: Outcome
    folder: Path
    seconds: float
    processor_seconds: float


@dataclass(frozen=True)
class ScheduleProgress:
    """A sign of life.

    Args:
        done, total: numbers of jobs.
        running: names of the jobs being done.
        share: of the work that is done, from 0 to 1.
        seconds_left: None as long as there is nothing to judge by.
    """

    done: int
    total: int
    running: tuple[str, ...]
    share: float
    seconds_left: float | None


ScheduleListener = Callable[[ScheduleProgress], None]


class Store:
    """Results of jobs in a folder.

    Raises:
        InputError: the folder cannot be made, or another process works in it.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            (folder / "jobs").mkdir(parents=True, exist_ok=True)
            (folder / "files").mkdir(exist_ok=True)
            self._lock = os.open(folder / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except OSError as error:
            raise InputError(f"the folder cannot be made: {reason(error)}", shown(folder)) from None
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self.close()
            raise InputError("another process works in this folder; wait, or take another", shown(folder)) from None

    def close(self) -> None:
        """Lets other processes work in the folder."""
        os.close(self._lock)

    def kept(self, name: str, key: str) -> Kept | None:
        """The result of a job, if it was done with this key and is still whole."""
        record, folder = self._record(name), self.folder / "files" / name
        try:
            document = json.loads(record.read_text(encoding="utf-8"))
            whole = document["key"] == key and document["files"] == _digests(read_files(folder))
            return Kept(document["outcome"], folder, *document["seconds"]) if whole else None
        except (OSError, ValueError, KeyError, TypeError):
            return None  # never written, or damaged: it is done again

    def keep(self, name: str, key: str, answer: Answer) -> Kept:
        """Write down a result.

        Raises:
            InputError: it cannot be written.
        """
        record, folder = self._record(name), self.folder / "files" / name
        try:
            record.unlink(missing_ok=True)
            shutil.rmtree(folder, ignore_errors=True)
            write_files(folder, answer.files)
            record.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"cannot be written: {reason(error)}", shown(folder)) from None
        seconds = (round(answer.seconds, 3), round(answer.processor_seconds, 3))
        document = {"key": key, "seconds": seconds, "files": _digests(answer.files), "outcome": answer.outcome}
        write_atomically(record, json.dumps(document, allow_nan=False))
        return Kept(answer.outcome, folder, *seconds)

    def _record(self, name: str) -> Path:
        return self.folder / "jobs" / f"{name}.json"


def _digests(files: Files) -> dict[str, str]:
    return {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}


def run_schedule(
    jobs: Sequence[Job], folder: Path, workers: Workers, listen: ScheduleListener | None = None
) -> dict[str, Kept]:
    """Results of all jobs, by their names; those that are missing are worked out now.

    Args:
        jobs: each after those that it needs; where several could be started, the first ones are.
        folder: where results are kept.
        workers: who does them; they are let go at the end, however it comes.
        listen: is told about progress.

    Raises:
        InputError: the folder cannot be written, or another process works in it.
        TakeapartError: a job failed; the results so far are kept.
        KeyboardInterrupt: likewise.
    """
    finished, store = False, None
    try:
        keys, store = job_keys(jobs), Store(folder)
        results = {job.name: found for job in jobs if (found := store.kept(job.name, keys[job.name])) is not None}
        waiting = [job for job in jobs if job.name not in results]
        running: dict[Future[Answer], tuple[Job, float]] = {}
        estimate = _Estimate(jobs, workers.count)
        while waiting or running:
            for job in [job for job in waiting if all(name in results for name in job.needs)]:
                if len(running) >= workers.count:
                    break
                needed = {name: read_files(results[name].folder) for name in job.needs}
                running[workers.submit(job.task, needed)] = (job, time.monotonic())
                waiting.remove(job)
            if listen is not None:
                listen(estimate.progress(results, {job.name: started for job, started in running.values()}))
            for future in wait(running, TURN, FIRST_COMPLETED).done:
                job, _ = running.pop(future)
                results[job.name] = store.keep(job.name, keys[job.name], _answer_of(job, future))
        finished = True
    finally:
        workers.stop(now=not finished)
        if store is not None:
            store.close()
    return results


def _answer_of(job: Job, future: Future[Answer]) -> Answer:
    try:
        return future.result()
    except BrokenProcessPool:
        raise TakeapartError(
            f"job {job.name}: a worker process died (was it out of memory?); the same command goes on from here"
        ) from None
    except TakeapartError as error:
        raise TakeapartError(f"job {job.name}: {error}") from error


class _Estimate:
    """How long it will take, by how long jobs took for what they were expected to cost."""

    def __init__(self, jobs: Sequence[Job], workers: int) -> None:
        self._jobs, self._workers = jobs, workers

    def progress(self, results: Mapping[str, Kept], running: Mapping[str, float]) -> ScheduleProgress:
        known: dict[str, tuple[float, float]] = {}  # by phase: seconds and cost of finished jobs
        for job in self._jobs:
            if job.name in results:
                seconds, cost = known.get(job.phase, (0.0, 0.0))
                known[job.phase] = seconds + results[job.name].seconds, cost + job.task.cost
        overall = sum(seconds for seconds, _ in known.values()), sum(cost for _, cost in known.values())

        def expected(job: Job) -> float:
            seconds, cost = known.get(job.phase, overall)
            return job.task.cost * seconds / cost if cost else math.nan

        now = time.monotonic()
        done = sum(kept.seconds for kept in results.values())
        left = longest = 0.0
        for job in self._jobs:
            if job.name not in results:
                spent = now - running[job.name] if job.name in running else 0.0
                still = max(expected(job) - spent, 0.0)
                done, left, longest = done + spent, left + still, max(longest, still)
        judged = math.isfinite(left)
        return ScheduleProgress(
            done=len(results),
            total=len(self._jobs),
            running=tuple(running),
            share=done / (done + left) if judged and done + left > 0 else len(results) / max(1, len(self._jobs)),
            seconds_left=max(left / self._workers, longest) if judged else None,
        )
