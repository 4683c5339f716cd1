"""The journal of a planning run: every answer of the removal planner, in SQLite.

One row per answered query, each in a transaction of its own, in the mode in which SQLite appends to a write-ahead log:
when the process is killed, all rows written are there, and a row half written is not. Paths are stored as the bytes of
little-endian float64 numbers, so that what is recalled is, bit for bit, what was planned. Every row has a digest.
"""

from __future__ import annotations

import hashlib
import os
import sqlite3
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from takeapart.formats.messages import reason, shown
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array
from takeapart.model.plan import Grasp
from takeapart.removal.journal import RecordedAnswer, RemovalQuery
from takeapart.removal.result import STAGES, Blocked, Removal

APPLICATION = 0x74616B65  # "take", in the header of the file
VERSION = 1

SCHEMA = f"""
PRAGMA application_id = {APPLICATION};
PRAGMA user_version = {VERSION};
CREATE TABLE run (identity TEXT NOT NULL);
CREATE TABLE answers (
    state TEXT NOT NULL,          -- mask of the parts there, hexadecimal
    part INTEGER NOT NULL,
    turn INTEGER NOT NULL,        -- how often the part was asked for in this state before
    attempts INTEGER NOT NULL,
    shorter_than REAL NOT NULL,   -- m
    seconds REAL NOT NULL,        -- time that the search had taken, in all sessions
    motion_plans INTEGER NOT NULL,
    stage TEXT,                   -- of a refusal; NULL where the part can leave
    mask TEXT NOT NULL,           -- blamed parts or blockers, hexadecimal
    length REAL,                  -- m
    grasp BLOB,                   -- center (3), m; orientation (4); width, m
    joint_path BLOB,              -- (M, n), rad
    tool_path BLOB,               -- (M, 7)
    digest BLOB NOT NULL,         -- of all columns before
    PRIMARY KEY (state, part, turn, attempts, shorter_than)
);
"""
KEY = 5  # columns that say what was asked
ANSWERS = "SELECT * FROM answers"
ONE_ANSWER = f"{ANSWERS} WHERE state = ? AND part = ? AND turn = ? AND attempts = ? AND shorter_than = ?"

Row = tuple[Any, ...]


class Journal:
    """A journal that is open in this process alone; thread-safe.

    A damaged journal is refused before anything is written to it.

    Args:
        path: of the file, as `create_journal` makes it.
        identity: of the run that it must belong to.

    Raises:
        InputError: here and in all methods: the file is missing, damaged, or of another run; the disk is full.
    """

    def __init__(self, path: Path, identity: str) -> None:
        self.path = path
        self._lock = threading.Lock()
        self._started, self._ahead = time.monotonic(), 0.0
        self.answers = count_answers(path, identity)
        with _told(path):
            self._connection = _connection(path)

    def start(self) -> None:
        """The search starts now."""
        self._started, self._ahead = time.monotonic(), 0.0

    @property
    def ahead(self) -> float:
        """Seconds by which the answers recalled took longer to find than to recall; the search has taken these too."""
        return self._ahead

    @property
    def seconds(self) -> float:
        """Time that the search has taken, those sessions included that were cut off, up to their last answer."""
        return time.monotonic() - self._started + self._ahead

    def recall(self, query: RemovalQuery) -> RecordedAnswer | None:
        """The answer of a query that was answered before; the clock of the run moves on to that time."""
        with self._lock, _told(self.path):
            row = self._connection.execute(ONE_ANSWER, _key(query)).fetchone()
            if row is None:
                return None
            self._ahead += max(0.0, row[KEY] - self.seconds)
        return _answer(row)

    def record(self, query: RemovalQuery, recorded: RecordedAnswer) -> None:
        """Keep an answer; when this returns, no end of the process can lose it."""
        with self._lock, _told(self.path):
            row = _row(query, recorded, self.seconds)
            places = ", ".join("?" * (len(row) + 1))
            self._connection.execute(f"INSERT INTO answers VALUES ({places})", (*row, _digest(row)))

    def close(self) -> None:
        """Let go of the file."""
        with self._lock:
            self._connection.close()


def create_journal(path: Path, identity: str) -> None:
    """Makes a journal without answers; it is there as a whole or not at all.

    Raises:
        InputError: the file cannot be written.
    """
    temporary = path.with_name(f".{path.name}.tmp")
    with _told(path):
        with closing(sqlite3.connect(temporary, isolation_level=None)) as connection:
            if connection.execute("PRAGMA journal_mode = WAL").fetchone() != ("wal",):
                raise InputError(
                    "cannot be made: the file system has no room for SQLite's write-ahead log", shown(path)
                )
            connection.executescript(SCHEMA)
            connection.execute("INSERT INTO run VALUES (?)", (identity,))
        os.replace(temporary, path)


def _connection(path: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    try:
        # No file of shared memory: on a full disk writing to it would end the process.
        connection.execute("PRAGMA locking_mode = EXCLUSIVE")
        connection.execute("PRAGMA synchronous = NORMAL")  # a power cut may take the last rows, never the file
        connection.execute("SELECT count(*) FROM run").fetchone()
    except BaseException:
        connection.close()
        raise
    return connection


def count_answers(path: Path, identity: str) -> int:
    """Number of answers in a journal that is whole and belongs to the run; nothing is written to it.

    Raises:
        InputError: it is missing, damaged, or of another run.
    """
    with _told(path):
        return _count_answers(path, identity)


def _count_answers(path: Path, identity: str) -> int:
    where = shown(path)
    if not path.is_file():
        raise InputError("is missing, so the run cannot be continued; start anew in another folder", where)
    log = path.with_name(f"{path.name}-wal")
    # Without a log, nothing but the file counts; then SQLite need not make a log and an index of it, which stay
    # where the file is damaged.
    alone = "" if log.exists() and log.stat().st_size else "&immutable=1"
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro{alone}", uri=True)) as connection:
        found = [connection.execute(f"PRAGMA {name}").fetchone() for name in ("application_id", "user_version")]
        if found != [(APPLICATION,), (VERSION,)]:
            raise InputError(f"is no journal of a run, version {VERSION}; it was left as it is", where)
        if connection.execute("PRAGMA integrity_check(1)").fetchone() != ("ok",):
            raise _damaged(where)
        if connection.execute("SELECT identity FROM run").fetchall() != [(identity,)]:
            raise InputError("is the journal of another run; put back the one that belongs to run.json", where)
        count = 0
        for row in connection.execute(ANSWERS):
            if row[-1] != _digest(row[:-1]):
                raise _damaged(where)
            count += 1
    return count


def recorded_answers(path: Path) -> list[tuple[RemovalQuery, RecordedAnswer]]:
    """All answers of a journal, in the order in which they were given; nothing is written to it.

    Raises:
        InputError: it is missing, damaged, or a process is working on the run.
    """
    where = shown(path)
    if not path.is_file():
        raise InputError("is missing", where)
    found = []
    with _told(path), closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as connection:
        if connection.execute("PRAGMA application_id").fetchone() != (APPLICATION,):
            raise InputError("is no journal of a run", where)
        for row in connection.execute(f"{ANSWERS} ORDER BY rowid"):
            if row[-1] != _digest(row[:-1]):
                raise _damaged(where)
            state, part, turn, attempts, shorter_than = row[:KEY]
            found.append((RemovalQuery(int(state, 16), part, turn, attempts, shorter_than), _answer(row)))
    return found


def _damaged(where: str) -> InputError:
    return InputError("is damaged and was left as it is; start anew in another folder", where)


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """What SQLite refuses, in one line."""
    where = shown(path)
    try:
        yield
    except UnicodeDecodeError:
        raise _damaged(where) from None
    except sqlite3.Error as error:
        name = getattr(error, "sqlite_errorname", "")
        if name in ("SQLITE_NOTADB", "SQLITE_ERROR") or name.startswith("SQLITE_CORRUPT"):
            raise _damaged(where) from None
        if name.startswith("SQLITE_BUSY"):
            raise InputError("another program has it open; close that and give the command again", where) from None
        full = name == "SQLITE_FULL" or name.startswith(("SQLITE_IOERR_WRITE", "SQLITE_IOERR_FSYNC"))
        cause = f"the disk is full or failing ({reason(error)})" if full else reason(error)
        raise InputError(
            f"cannot be written: {cause}; nothing is lost, the same command continues the run", where
        ) from None
    except OSError as error:
        raise InputError(f"cannot be written: {reason(error)}", where) from None


def _key(query: RemovalQuery) -> Row:
    return f"{query.state:x}", query.part, query.turn, query.attempts, float(query.shorter_than)


def _row(query: RemovalQuery, recorded: RecordedAnswer, seconds: float) -> Row:
    """All columns but the digest."""
    answer = recorded.answer
    asked = (*_key(query), seconds, recorded.motion_plans)
    if isinstance(answer, Blocked):
        return (*asked, answer.stage, f"{answer.blamed:x}", None, None, None, None)
    grasp = _bytes(np.concatenate([answer.grasp.center, answer.grasp.orientation, [answer.grasp.width]]))
    paths = _bytes(answer.joint_path), _bytes(answer.tool_path)
    return (*asked, None, f"{answer.blockers:x}", float(answer.length), grasp, *paths)


def _answer(row: Row) -> RecordedAnswer:
    part, motion_plans = row[1], row[KEY + 1]
    stage, mask, length, grasp_bytes, joint_path, tool_path = row[KEY + 2 : -1]
    if stage is not None:
        return RecordedAnswer(Blocked(part, STAGES[STAGES.index(stage)], int(mask, 16)), motion_plans)
    numbers = _numbers(grasp_bytes)
    tool_rows = _numbers(tool_path).reshape(-1, 7)
    joint_rows = _numbers(joint_path).reshape(len(tool_rows), -1)
    grasp = Grasp(numbers[:3], numbers[3:7], float(numbers[7]))
    return RecordedAnswer(Removal(part, grasp, joint_rows, tool_rows, length, int(mask, 16)), motion_plans)


def _bytes(values: Array) -> bytes:
    return np.ascontiguousarray(values, dtype="<f8").tobytes()


def _numbers(data: bytes) -> Array:
    return np.frombuffer(data, dtype="<f8").astype(np.float64)


def _digest(row: Row) -> bytes:
    digest = hashlib.blake2b(digest_size=16)
    for value in row:
        data = value if isinstance(value, bytes) else repr(value).encode()
        digest.update(f"{type(value).__name__} {len(data)}:".encode())
        digest.update(data)
    return digest.digest()
