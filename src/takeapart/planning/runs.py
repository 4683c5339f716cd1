"""A run directory: what a plan is made for, and all that was planned for it so far.

    run.json         assembly, workcell, options, seed, versions and sources; written once
    journal.sqlite   every answer of the removal planner, see `run_journal`
    plan.json        the plan, once the search has ended
    lock             held by the process that works on the run; the system lets go of it however that process ends

A run that was cut off is continued by searching again: answers that the journal has cost nothing and count as they did
the first time, so the search passes through the same states and ends with the same plan.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from takeapart.formats.documents import canonical_json, read_json, readable_json, require_names, write_atomically
from takeapart.formats.files import load_plan, save_plan
from takeapart.formats.messages import reason, shortened, shown
from takeapart.model.errors import InputError
from takeapart.model.plan import Plan
from takeapart.planning.run_journal import Journal, count_answers, create_journal
from takeapart.search.result import Budget

FORMAT, VERSION = "takeapart/run", 1
MAXIMUM_BYTES = 64 * 2**10  # of run.json
RUN, JOURNAL, PLAN, LOCK = "run.json", "journal.sqlite", "plan.json", "lock"
SHOWN_DIFFERENCES = 3
LONGEST_LIST = 200  # letters of more than one difference

Identity = dict[str, object]
"""What a run is for, as JSON holds it: "assembly", "workcell", "options", "seed", "versions", "sources"."""


@dataclass(frozen=True, eq=False)
class Run:
    """A run that this process works on.

    Args:
        folder: its directory.
        journal: answers so far.
    """

    folder: Path
    journal: Journal

    def finish(self, plan: Plan) -> None:
        """Keep the plan of a search that has ended by itself.

        Raises:
            InputError: it cannot be written.
        """
        save_plan(plan, self.folder / PLAN)


class RunBudget:
    """A budget whose seconds are those of all sessions of a run; stands in for `Budget`.

    A search compares its own time with `seconds`: that is less by what its recalled answers had cost before.
    """

    def __init__(self, budget: Budget, journal: Journal) -> None:
        self.episodes, self.queries = budget.episodes, budget.queries
        self._seconds, self._journal = budget.seconds, journal

    @property
    def seconds(self) -> float:
        """Wall time of this session at which the run's is spent."""
        return self._seconds - self._journal.ahead


def finished_plan(folder: Path, identity: Identity) -> Plan | None:
    """The plan of a run that has ended, None if it has not; works in a read-only directory too.

    Raises:
        InputError: the directory belongs to another run, or its files are damaged.
    """
    if not (folder / RUN).exists() or not (folder / PLAN).exists():
        return None
    _require_same(folder / RUN, identity)
    return load_plan(folder / PLAN)


@contextmanager
def open_run(folder: Path, identity: Identity) -> Iterator[Run]:
    """Starts a run in a new or empty directory, or goes on with the one that is there; no other process can meanwhile.

    Raises:
        InputError: the directory is not one of a run, belongs to another run, is in use, damaged, read-only or full.
    """
    try:
        require_names(folder)
        folder.mkdir(parents=True, exist_ok=True)
        _require_run_folder(folder)
    except OSError as error:
        raise InputError(f"no run directory can be made there: {reason(error)}", shown(folder)) from None
    with _locked(folder):
        _sweep(folder)
        seal = hashlib.sha256(canonical_json(_document(identity)).encode()).hexdigest()
        if (folder / RUN).exists():
            _require_same(folder / RUN, identity)
        else:
            _begin(folder, identity, seal)
        journal = Journal(folder / JOURNAL, seal)
        try:
            yield Run(folder, journal)
        finally:
            journal.close()


def _begin(folder: Path, identity: Identity, seal: str) -> None:
    """The journal first and run.json last: where that stands, all is there."""
    if (folder / JOURNAL).exists() and count_answers(folder / JOURNAL, seal):
        raise InputError(
            "is missing, but the journal has answers; put it back, or take another folder", str(folder / RUN)
        )
    create_journal(folder / JOURNAL, seal)
    write_atomically(folder / RUN, readable_json(_document(identity)))


def _document(identity: Identity) -> Identity:
    document = _plain({"format": FORMAT, "version": VERSION, **identity})
    assert isinstance(document, dict)
    return document


def _plain(value: object) -> object:
    """As JSON gives it back; a limit that is infinite becomes null."""
    if isinstance(value, dict):
        return {str(key): _plain(child) for key, child in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(child) for child in value]
    return None if isinstance(value, float) and math.isinf(value) else value


def _require_same(path: Path, identity: Identity) -> None:
    found = read_json(path, MAXIMUM_BYTES)
    before, now = _flat(found), _flat(_document(identity))
    if before.get("format") != FORMAT or before.get("version") != VERSION:
        raise InputError(f"is no description of a run; must be of format {FORMAT!r}, version {VERSION}", shown(path))
    differences = [
        f"{_named(key)} was {_told(before, key)}, now {_told(now, key)}"
        for key in dict.fromkeys([*now, *before])
        if key not in before or key not in now or before[key] != now[key]
    ]
    if differences:
        told = max(
            k for k in range(1, SHOWN_DIFFERENCES + 1) if k == 1 or len("; ".join(differences[:k])) <= LONGEST_LIST
        )
        more = len(differences) - told
        listed = "; ".join(differences[:told]) + (f"; and {more} more" if more > 0 else "")
        raise InputError(f"this run was started otherwise: {listed}; take another folder", shown(path.parent))


def _flat(value: object, prefix: str = "") -> dict[str, object]:
    if not isinstance(value, dict):
        return {prefix: value}
    found: dict[str, object] = {}
    for key, child in value.items():
        found |= _flat(child, f"{prefix}.{key}" if prefix else str(key))
    return found


def _named(key: str) -> str:
    return key if key.isprintable() and len(key) <= 60 else shortened(key)


def _told(values: dict[str, object], key: str) -> str:
    if key not in values:
        return "not given"
    value = values[key]
    text = f"{value[:12]}..." if isinstance(value, str) and len(value) > 40 else value
    return "no limit" if value is None else shortened(text)


def _require_run_folder(folder: Path) -> None:
    """Nothing is written into a directory that holds something else."""
    strange = [
        name
        for name in sorted(os.listdir(folder))
        if name not in (RUN, PLAN, LOCK) and not name.startswith(JOURNAL) and not _is_left_over(name)
    ]
    if strange and not (folder / RUN).exists():
        raise InputError(
            f"holds {shortened(strange[0])} and no run.json; give a new or empty directory, or that of a run",
            shown(folder),
        )


def _is_left_over(name: str) -> bool:
    return name.startswith(tuple(f".{kept}." for kept in (RUN, JOURNAL, PLAN))) and ".tmp" in name


def _sweep(folder: Path) -> None:
    """Remove the halves of files that a killed process was writing."""
    for name in filter(_is_left_over, os.listdir(folder)):
        try:
            os.unlink(folder / name)
        except OSError as error:
            raise InputError(f"cannot be removed: {reason(error)}", shown(folder / name)) from None


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    try:
        descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise InputError(f"the run directory cannot be written: {reason(error)}", shown(folder)) from None
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            taken = error.errno in (errno.EWOULDBLOCK, errno.EACCES)
            cause = "another process is working on this run" if taken else f"cannot be locked: {reason(error)}"
            raise InputError(f"{cause}; wait for it, or give another directory", shown(folder)) from None
        yield
    finally:
        os.close(descriptor)
