"""Who does the jobs of an experiment: processes of this machine, or a Ray cluster."""

from __future__ import annotations

import multiprocessing
import multiprocessing.process
import os
import signal
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from typing import Any, Protocol

from takeapart.experiments.jobs import Answer, Files, Task, perform
from takeapart.model.errors import InputError, MissingExtraError

RAY = "ray"
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")


class Workers(Protocol):
    """Does jobs, several at a time."""

    count: int
    """How many."""

    def submit(self, task: Task, needed: Mapping[str, Files]) -> Future[Answer]:
        """Start a task."""
        ...

    def stop(self, now: bool) -> None:
        """Let the workers go; `now`: whatever they are doing."""
        ...


def open_workers(text: str) -> Workers:
    """Workers that a user names.

    Args:
        text: a number of processes; "auto" for one per core; "ray" for the Ray cluster of this machine, which is
            started if there is none; "ray://host:port" for another.

    Raises:
        InputError: it is none of these, or the cluster cannot be reached.
        MissingExtraError: Ray is not installed.
    """
    if text == RAY or text.startswith(f"{RAY}://"):
        return RayWorkers(None if text == RAY else text)
    if text == "auto":
        return LocalWorkers(os.cpu_count() or 1)
    if text.isdecimal() and 1 <= int(text) <= 256:
        return LocalWorkers(int(text))
    raise InputError(f"{text!r}; must be a number from 1 to 256, 'auto', 'ray' or 'ray://HOST:PORT'", "workers")


class LocalWorkers:
    """Processes of this machine. Each keeps what it has imported and compiled for its next job."""

    def __init__(self, count: int) -> None:
        self.count = count
        context = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(count, context, initializer=prepare_process)

    def submit(self, task: Task, needed: Mapping[str, Files]) -> Future[Answer]:
        """Start a task."""
        return self._pool.submit(perform, task, needed)

    def stop(self, now: bool) -> None:
        """Let the processes go; `now`: whatever they are doing."""
        processes = list((self._pool._processes or {}).values()) if now else []
        self._pool.shutdown(wait=not now, cancel_futures=now)
        for process in processes:
            process.terminate()
        for process in processes:
            process.join()


def prepare_process() -> None:
    """What a new process does first: Ctrl-C and the end of the main process are no concern of its jobs."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the main process decides
    os.environ |= ONE_THREAD  # before torch is imported
    parent = multiprocessing.parent_process()
    if parent is not None:  # a killed main process must not leave workers behind
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: multiprocessing.process.BaseProcess) -> None:
    parent.join()
    os._exit(1)


class RayWorkers:
    """A Ray cluster. Files travel with the jobs, so its machines need no folder in common.

    Args:
        address: None for the cluster of this machine.
    """

    def __init__(self, address: str | None) -> None:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        try:
            import ray
        except ImportError:
            raise MissingExtraError("--workers ray", "cluster", "ray") from None
        self._ray = ray
        self._own = not ray.is_initialized()
        if self._own:
            try:
                ray.init(address, log_to_driver=False, runtime_env={"env_vars": ONE_THREAD})
            except (ConnectionError, ImportError, RuntimeError, ValueError) as error:
                told = " ".join(str(error).split())
                raise InputError(f"the Ray cluster cannot be reached: {told}", "workers") from None
        self.count = max(1, int(ray.cluster_resources().get("CPU", 1)))
        self._perform: Callable[..., Any] = ray.remote(num_cpus=1)(perform).remote
        self._running: dict[Future[Answer], Any] = {}

    def submit(self, task: Task, needed: Mapping[str, Files]) -> Future[Answer]:
        """Start a task."""
        reference = self._perform(task, needed)
        future: Future[Answer] = reference.future()
        self._running[future] = reference
        future.add_done_callback(lambda done: self._running.pop(done, None))
        return future

    def stop(self, now: bool) -> None:
        """Let the cluster go; `now`: cancel what it is doing."""
        for reference in list(self._running.values()) if now else []:
            self._ray.cancel(reference, force=True)
        if self._own:
            self._ray.shutdown()
