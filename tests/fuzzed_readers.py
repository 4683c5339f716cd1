"""Every reader of files, with a valid file to start from: what all fuzzers work on.

To add a reader, add an entry to `READERS`: a function that takes a path, and the bytes of a small valid file. That is
all: `fuzz_readers.py` (random), `fuzz_atheris.py` (led by coverage) and the hypothesis tests of
`test_reliability_inputs.py` go through this table. Where the file holds plain data, give that too as `document`, and as
`encoded` what makes a file of it; then the data are changed, not only the bytes. A file with a header of JSON before
binary data, as safetensors has, is `document = header` and `encoded = lambda header: length + json + data`.

A reader must return, or raise a `TakeapartError` whose message is one line that begins with the path of the file (or of
its folder). A library that raises something else has to be wrapped in the reader.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import example_documents
from takeapart.formats.files import load_assembly, load_plan, load_workcell
from takeapart.planning.run_journal import Journal, count_answers, create_journal
from takeapart.planning.runs import FORMAT, VERSION, Identity, _require_same
from takeapart.removal.journal import RecordedAnswer, RemovalQuery
from takeapart.removal.result import Blocked

SEAL = "a" * 64
IDENTITY: Identity = {"seed": 0, "options": {"search": "exact", "budget": {"seconds": None}}}


def json_bytes(document: Any) -> bytes:
    """A file of JSON; what JSON has no words for is written as Python does, lone surrogates too."""
    return json.dumps(document).encode("utf-8", "surrogatepass")


@dataclass(frozen=True)
class Reader:
    """One reader.

    Args:
        load: takes the path of a file.
        suffix: of the file's name.
        example: a valid file.
        document: its data, if they are to be changed; `encoded` makes a file of them.
        kinds: of input, see `fuzz_readers.broken_input`.
    """

    load: Callable[[Path], object]
    suffix: str
    example: bytes
    document: Any = None
    encoded: Callable[[Any], bytes] = json_bytes
    kinds: tuple[str, ...] = ("bytes", "noise")


def of_json(load: Callable[[Path], object], document: Any) -> Reader:
    """The reader of a file of JSON."""
    return Reader(load, ".json", json_bytes(document), document, json_bytes, ("data", "bytes", "noise"))


def journal_bytes() -> bytes:
    """A journal with three answers."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "journal.sqlite"
        create_journal(path, SEAL)
        journal = Journal(path, SEAL)
        for part in range(3):
            query = RemovalQuery(2**40 + 7, part, 0, 1, float(np.inf))
            journal.record(query, RecordedAnswer(Blocked(part, "ik", 2**40), part))
        journal.close()
        return path.read_bytes()


READERS = {
    "assembly": of_json(load_assembly, example_documents.assembly()),
    "plan": of_json(load_plan, example_documents.plan()),
    "workcell": Reader(load_workcell, ".toml", example_documents.WORKCELL.encode(), kinds=("bytes", "lines", "noise")),
    "run": of_json(lambda path: _require_same(path, IDENTITY), {"format": FORMAT, "version": VERSION, **IDENTITY}),
    "journal": Reader(lambda path: count_answers(path, SEAL), ".sqlite", journal_bytes()),
}
