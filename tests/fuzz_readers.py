"""Broken files by the hundred thousand: ``python tests/fuzz_readers.py --inputs 100000``.

Valid documents are changed, as data and as bytes, and given to the readers of the package. Every input must be taken or
refused with one line that names the file, within 5 s, and no file may be opened for writing, made, renamed or removed
(Python's audit events are watched while a reader runs). Needs no library; `test_reliability_inputs.py` does the same
with hypothesis, which also looks for the smallest input that fails, and `fuzz_atheris.py` with atheris, which looks for
inputs that reach more of the code. The readers stand in `fuzzed_readers.py`, which also says how to add one.
"""

from __future__ import annotations

import argparse
import copy
import json
import multiprocessing
import os
import random
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from fuzzed_readers import READERS, Reader
from takeapart.experiments.tables import markdown_table, replace_between_markers
from takeapart.model.errors import TakeapartError

MARKER = "fuzz"
LONGEST = 5.0  # s, for one input
LONGEST_MESSAGE = 350  # letters, without the file's name
BLOCK = 2_500  # inputs per random seed
FORBIDDEN = tuple(
    "os.rename os.remove os.mkdir os.rmdir os.truncate os.link os.symlink os.chmod os.system os.exec os.fork "
    "os.posix_spawn shutil. subprocess. socket. pickle.".split()
)  # audit events

SCALARS: list[Any] = [
    None, True, False, 0, 1, -1, 2, 7, 1000, 1001, 2**31, 2**63, 2**64, 10**39, 10**40, -(10**400),
    0.0, -0.0, 0.5, 1.0, 1.5, 100.0, 1e5, 1e308, -1e308, 5e-324, float("nan"), float("inf"), float("-inf"),
    "", "a", "U", "O", "box", "base", "bar", "block", "panda", "takeapart/assembly", "takeapart/plan", "assembly",
    "../x", "/dev/zero", "C:\\x", "a" * 65, "a" * 5000, "\ud800", "\x00", "\n", "\u202e", "\U0001f600", "{0}", "%s",
    "0" * 64, "__class__",
]  # fmt: skip
KEYS = ["name", "parts", "size", "mass", "format", "version", "x", "", "__proto__", "\n", "\ud800", "a" * 300]
PIECES = [
    b"", b"{", b"}", b"[", b"]", b'"', b",", b":", b"=", b"\n", b"\r", b"\x00", b"\xff", b"\xef\xbb\xbf", b"\\", b"\\u",
    b"\\ud800", b"1e999", b"-1e999", b"NaN", b"Infinity", b"nan", b"-inf", b"0x", b"0x" + b"f" * 99, b"1" * 5000,
    b"[[[", b"{{{", b"[" * 3000, b'{"a":' * 3000, b"#", b"'''", b'"""', b"[[environment]]\n", b"[robot]\n",
    b"a.b.c=1\n", b"1979-05-27", b"07:32:00", b"e", b"-", b".", b"a" * 300, b"a" + b".a" * 1200,
]  # fmt: skip


def places(document: Any) -> list[tuple[Any, Any]]:
    """Pairs (container, key) of everything in a document."""
    found: list[tuple[Any, Any]] = []
    waiting = [document]
    while waiting:
        inside = waiting.pop()
        keys = list(inside) if isinstance(inside, dict) else range(len(inside))
        found += [(inside, key) for key in keys]
        waiting += [inside[key] for key in keys if isinstance(inside[key], dict | list)]
    return found


def value(rng: random.Random, depth: int = 0) -> Any:
    """Any plain data: mostly a number or text that is at a limit."""
    kind = rng.random()
    if depth > 3 or kind < 0.7:
        return rng.choice(SCALARS)
    if kind < 0.8:
        return rng.choice([rng.uniform(-2, 2), rng.randint(-5, 5), rng.getrandbits(80), chr(rng.randrange(0x110000))])
    if kind < 0.9:
        return [value(rng, depth + 1) for _ in range(rng.randrange(6))]
    return {rng.choice(KEYS): value(rng, depth + 1) for _ in range(rng.randrange(4))}


def changed_data(document: Any, rng: random.Random) -> Any:
    """A valid document with one to three places replaced, removed, added, moved or nested."""
    document = copy.deepcopy(document)
    for _ in range(rng.randint(1, 3)):
        found = places(document)
        if not found:
            break
        inside, key = rng.choice(found)
        kind = rng.choice(["replace", "replace", "remove", "add", "move", "repeat", "nest"])
        if kind == "remove":
            del inside[key]
        elif kind == "add" and isinstance(inside, dict):
            inside[rng.choice(KEYS)] = value(rng)
        elif kind == "move":
            other, there = rng.choice(found)
            inside[key] = copy.deepcopy(other[there])
        elif kind == "repeat" and isinstance(inside, list):
            inside += [copy.deepcopy(inside[key]) for _ in range(rng.choice([1, 2, 8]))]
        elif kind == "nest":
            for _ in range(rng.choice([1, 3, 9, 40])):
                inside[key] = [inside[key]]
        else:
            inside[key] = value(rng)
    return document


def changed_bytes(example: bytes, rng: random.Random) -> bytes:
    """The bytes of a valid document, cut, overwritten, or with pieces put in."""
    data = bytearray(example)
    for _ in range(rng.randint(1, 4)):
        start, kind = rng.randrange(len(data) + 1), rng.random()
        if kind < 0.1:
            del data[start:]
        elif kind < 0.2 and data:
            data[start % len(data)] ^= 1 << rng.randrange(8)
        elif kind < 0.3:
            other = rng.randrange(len(data) + 1)
            data[start:start] = data[other : other + rng.randrange(60)]
        else:
            piece = rng.choice(PIECES) if rng.random() < 0.7 else rng.randbytes(rng.randrange(20))
            data[start : start + rng.choice([0, 0, 1, 5, 40])] = piece
    return bytes(data)


def changed_lines(text: str, rng: random.Random) -> bytes:
    """Lines of a TOML file with other values, twice, elsewhere, or not at all."""
    lines = text.splitlines()
    for _ in range(rng.randint(1, 3)):
        i = rng.randrange(len(lines))
        kind = rng.random()
        if kind < 0.6 and "=" in lines[i]:
            plain = value(rng)
            lines[i] = (
                lines[i].split("=")[0] + "= " + json.dumps(plain).replace("Infinity", "inf").replace("NaN", "nan")
            )
        elif kind < 0.7 and len(lines) > 1:
            del lines[i]
        elif kind < 0.8:
            lines.insert(rng.randrange(len(lines) + 1), lines[i])
        else:
            lines.insert(i, rng.choice(KEYS) + " = " + json.dumps(value(rng)))
    return "\n".join(lines).encode("utf-8", "surrogatepass")


def broken_input(reader: Reader, kind: str, rng: random.Random) -> bytes:
    """One input of a kind for a reader."""
    if kind == "data":
        return reader.encoded(changed_data(reader.document, rng))
    if kind == "lines":
        return changed_lines(reader.example.decode(), rng)
    if kind == "bytes":
        return changed_bytes(reader.example, rng)
    return (
        rng.randbytes(rng.randrange(300)) if rng.random() < 0.5 else b"".join(rng.choices(PIECES, k=rng.randrange(8)))
    )


class Watch:
    """Notes what a reader does to files. An audit hook cannot be taken away, so there is one per process."""

    def __init__(self) -> None:
        self.active = False
        self.seen: list[str] = []
        sys.addaudithook(self.hook)

    def hook(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.active:
            return
        if event == "open":
            mode, flags = arguments[1], arguments[2] if len(arguments) > 2 else 0
            for_writing = (isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)) or (
                isinstance(mode, str) and set(mode) & set("wax+")
            )
            if for_writing:
                self.seen.append(f"opened {arguments[0]!r} for writing")
        elif event.startswith(FORBIDDEN):
            self.seen.append(f"{event} {arguments!r}")


class Hang(BaseException):
    """An input took too long; no reader catches this."""


def _too_long(number: int, frame: FrameType | None) -> None:
    raise Hang


WATCH: list[Watch] = []


def fault_of(reader: Reader, file: Path, content: bytes) -> tuple[str, bool]:
    """What is wrong with how a reader takes an input, empty if nothing is; and whether the input was taken."""
    if not WATCH:
        WATCH.append(Watch())
    watch = WATCH[0]
    file.write_bytes(content)
    watch.seen.clear()
    signal.signal(signal.SIGALRM, _too_long)
    signal.setitimer(signal.ITIMER_REAL, LONGEST)
    watch.active = True
    message = ""
    try:
        reader.load(file)
    except TakeapartError as error:
        message = str(error)
    except Hang:
        return f"took longer than {LONGEST} s", False
    except Exception:
        return traceback.format_exc(limit=-3), False
    finally:
        watch.active = False
        signal.setitimer(signal.ITIMER_REAL, 0)
    if watch.seen:
        return watch.seen[0], False
    if message and not (message.startswith((f"{file}: ", f"{file.parent}: ")) and message.isprintable()):
        return f"not one line that names the file: {message!r}", False
    if len(message) > LONGEST_MESSAGE + len(str(file)):
        return f"message of {len(message)} letters", False
    return "", not message


@dataclass(frozen=True)
class Tally:
    """What became of one block of inputs."""

    reader: str
    kind: str
    taken: int
    refused: int
    slowest: float  # s
    faults: tuple[tuple[str, bytes], ...]


def fuzz_block(name: str, kind: str, count: int, seed: int) -> Tally:
    """`count` inputs of one kind for one reader."""
    reader, rng = READERS[name], random.Random(f"{name} {kind} {seed}")
    outcome: Counter[bool] = Counter()
    faults: list[tuple[str, bytes]] = []
    slowest = 0.0
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as folder:
        file = Path(folder) / f"input{reader.suffix}"
        for _ in range(count):
            content = broken_input(reader, kind, rng)
            started = time.perf_counter()
            fault, taken = fault_of(reader, file, content)
            slowest = max(slowest, time.perf_counter() - started)
            outcome[taken] += 1
            if fault:
                faults.append((fault, content))
        if [path.name for path in Path(folder).iterdir()] != [file.name]:
            faults.append(("left a file beside the input", b""))
    return Tally(name, kind, outcome[True], outcome[False], slowest, tuple(faults))


def fuzz(inputs: int, seed: int, processes: int) -> list[Tally]:
    """About equally many inputs of every kind for every reader; the tallies of all blocks."""
    kinds = [(name, kind) for name, reader in READERS.items() for kind in reader.kinds]
    blocks = []
    for i, (name, kind) in enumerate(kinds):
        left, block = len(range(i, inputs, len(kinds))), 0
        while left > 0:
            blocks.append((name, kind, min(left, BLOCK), seed + block))
            left, block = left - BLOCK, block + 1
    if processes == 1:
        return [fuzz_block(*block) for block in blocks]
    with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(fuzz_block, *zip(*blocks, strict=True)))


def table(tallies: Sequence[Tally]) -> str:
    """One row per reader and kind of input, and the sum."""
    rows: list[list[object]] = []
    for name, kind in dict.fromkeys((tally.reader, tally.kind) for tally in tallies):
        of_kind = [tally for tally in tallies if (tally.reader, tally.kind) == (name, kind)]
        rows.append([f"{name}, {kind}", *_sums(of_kind)])
    rows.append(["**all**", *_sums(tallies)])
    return markdown_table(["reader, input", "inputs", "taken", "refused in one line", "faults", "slowest, ms"], rows)


def _sums(tallies: Sequence[Tally]) -> list[object]:
    taken, refused = sum(t.taken for t in tallies), sum(t.refused for t in tallies)
    faults = sum(len(t.faults) for t in tallies)
    slowest = max(t.slowest for t in tallies)
    return [f"{taken + refused:,}", f"{taken:,}", f"{refused - faults:,}", faults, f"{1e3 * slowest:.0f}"]


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns 1 if there was a fault."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--faults", type=Path, help="folder for inputs that are taken wrongly")
    parser.add_argument("--document", type=Path, help="document whose table is replaced")
    given = parser.parse_args(arguments)
    started = time.monotonic()
    tallies = fuzz(given.inputs, given.seed, given.processes)
    print(table(tallies))
    faults = [(tally, *fault) for tally in tallies for fault in tally.faults]
    for number, (tally, fault, content) in enumerate(faults):
        print(f"FAULT {number} ({tally.reader}, {tally.kind}): {fault}")
        if given.faults is not None:
            given.faults.mkdir(parents=True, exist_ok=True)
            (given.faults / f"{number}-{tally.reader}{READERS[tally.reader].suffix}").write_bytes(content)
    done = sum(tally.taken + tally.refused for tally in tallies)
    print(f"{done} inputs in {time.monotonic() - started:.0f} s, {len(faults)} faults")
    if given.document is not None:
        replace_between_markers(given.document, MARKER, table(tallies))
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
