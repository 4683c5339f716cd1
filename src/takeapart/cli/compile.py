"""Compiles the kernels before the work starts, in several processes, and says so: the first time takes a minute or two.

Otherwise the time limit of a first search would be spent on compiling. What was compiled is kept in numba's cache.
"""

from __future__ import annotations

import fcntl
import hashlib
import multiprocessing
import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from takeapart.cli.output import note, progress_bar

if TYPE_CHECKING:
    from takeapart.cli.kernels import Unit
    from takeapart.workcell import Workcell

NOTICE = "compiling the geometry kernels for the first time, which takes a minute or two"
WORKERS = 8  # at most; what kernels have in common is compiled one after another
TABLES_NEED = ("robot.separation.separation", "robot.self_collision._fill")


def compile_first(workcell: Workcell, orders: bool = True) -> None:
    """Compiles the kernels that are not in the cache yet, with a notice on standard error and a progress bar.

    Args:
        workcell: its robot is loaded meanwhile: the distances of its links are worked out once, too.
        orders: also the kernels of the search for orders of removals.

    Raises:
        InputError: no folder can be written for the machine code, or somebody else can write to it.
    """
    from takeapart.caching import chosen_folder

    chosen = chosen_folder()
    if chosen.remark:
        note(chosen.remark)
    if _is_noted(orders):
        return
    if not missing(orders):
        _note_complete(orders)
        return
    note(NOTICE)
    with progress_bar("compiling") as update, _alone():
        left = missing(orders)  # somebody else may have been at it
        try:
            _compile(left, workcell, update)
        except BrokenProcessPool:
            note("a process that compiled was ended; what is missing is compiled when it is first needed")


def _is_noted(orders: bool) -> bool:
    """Whether nothing has changed since nothing was missing: to look at every kernel takes a tenth of a second."""
    from takeapart.compilation import machine_code_stamp

    try:
        return _notes(orders).read_text() == machine_code_stamp()
    except (OSError, ValueError):
        return False


def _note_complete(orders: bool) -> None:
    from takeapart.compilation import machine_code_stamp

    with suppress(OSError):
        _notes(orders).write_text(machine_code_stamp())


def _notes(orders: bool) -> Path:
    """Where it is noted for these sources, wherever they lie, that nothing was missing."""
    from takeapart.caching import cache_folder

    place = hashlib.sha256(os.path.realpath(__file__).encode()).hexdigest()[:16]
    return cache_folder() / f"complete-{'orders' if orders else 'removals'}-{place}"


def missing(orders: bool) -> dict[str, Unit]:
    """What is not in the cache, by name, in the order in which it should be compiled.

    What is only there to become part of others is not missing where they are there.
    """
    from takeapart.cli.kernels import called_by, units
    from takeapart.compilation import has_machine_code

    found = {
        name: unit for name, unit in units(orders).items() if not has_machine_code(unit.dispatcher, unit.signature)
    }
    outer = {name: called_by(unit.function) for name, unit in found.items() if not unit.inner}
    return {
        name: unit
        for name, unit in found.items()
        if not unit.inner or any(unit.function in called for called in outer.values())
    }


@contextmanager
def _alone() -> Iterator[None]:
    """Holds the right to compile: of two commands that start together one waits, and finds the work done."""
    from takeapart.caching import cache_folder

    with open(cache_folder() / "compiling.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield  # the system takes the lock back, however the process ends


def _compile(units: Mapping[str, Unit], workcell: Workcell, update: Callable[[str, float | None], None]) -> None:
    """Compiles everything in several processes; what others contain before them, so that they find it in the cache."""
    from takeapart.cli.kernels import called_by

    functions = {unit.function: name for name, unit in units.items()}
    needs = {name: {functions[f] for f in called_by(unit.function) if f in functions} for name, unit in units.items()}
    tables = "distances between the robot's links"
    needs = {tables: {name for name in TABLES_NEED if name in units}} | needs
    total, done = len(needs), 0
    count = min(len(os.sched_getaffinity(0)), WORKERS, total)
    pool = _open_pool(count)
    running: dict[Future[None], str] = {}
    try:
        while needs or running:
            waiting_for = {*needs, *running.values()}
            for name in [name for name, needed in needs.items() if not needed & waiting_for]:
                if len(running) < count:
                    job = pool.submit(_load, workcell) if name == tables else pool.submit(compile_unit, name)
                    running[job] = name
                    del needs[name]
            update(", ".join(running.values()), done / total)
            for job in wait(running, return_when=FIRST_COMPLETED).done:
                del running[job]
                job.result()
                done += 1
    except BaseException:
        for process in list((pool._processes or {}).values()):
            process.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _open_pool(count: int) -> ProcessPoolExecutor:
    from takeapart.experiments.workers import prepare_process

    return ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), initializer=prepare_process)


def compile_unit(name: str) -> None:
    """Compiles one unit of `takeapart.cli.kernels` to the cache."""
    from takeapart.cli.kernels import units

    unit = units(orders=True)[name]
    unit.dispatcher.compile(unit.signature)


def _load(workcell: Workcell) -> None:
    from takeapart.robot.loading import load_robot

    load_robot(workcell)


if __name__ == "__main__":  # before tests that run side by side, so that they do not all compile the same
    from takeapart.formats.files import load_workcell

    compile_first(load_workcell("panda"))
