"""Broken files led by coverage: ``python tests/fuzz_atheris.py --inputs 20000``, if the package atheris is installed.

atheris (libFuzzer for Python, ``pip install atheris``) keeps those inputs that reach code of the package that none had
reached, and changes them further. Readers, examples and what counts as a fault are those of `fuzz_readers.py`; the
readers stand in `fuzzed_readers.py`, which also says how to add one. Every reader is fuzzed in a process of its own,
because libFuzzer ends its process.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import random
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

EXAMPLES = 200  # broken inputs of `fuzz_readers` that atheris starts from
LONGEST_INPUT = 65_536  # bytes; the example of a journal has 32,768


class FaultError(Exception):
    """An input that a reader took wrongly."""


def fuzz_one(name: str, inputs: int, seed: int, faults: Path) -> None:
    """Fuzzes one reader; ends the process, with a code other than 0 if there was a fault."""
    import atheris

    with atheris.instrument_imports(include=["takeapart"]):
        import fuzz_readers

    reader, rng = fuzz_readers.READERS[name], random.Random(f"{name} {seed}")
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as folder:
        corpus, file = Path(folder) / "corpus", Path(folder) / "work" / f"input{reader.suffix}"
        corpus.mkdir()
        file.parent.mkdir()
        (corpus / "example").write_bytes(reader.example)
        for number in range(EXAMPLES):
            kind = reader.kinds[number % len(reader.kinds)]
            (corpus / str(number)).write_bytes(fuzz_readers.broken_input(reader, kind, rng))
        words = Path(folder) / "words"
        words.write_text("".join(f'"{escaped(piece)}"\n' for piece in fuzz_readers.PIECES if piece))

        def take(content: bytes) -> None:
            fault, _ = fuzz_readers.fault_of(reader, file, content)
            beside = [path.name for path in file.parent.iterdir() if path != file]
            if fault or beside:
                raise FaultError(fault or f"left {beside[0]!r} beside the input")

        options = [f"-runs={inputs}", f"-seed={seed + 1}", f"-max_len={LONGEST_INPUT}", "-timeout=0", "-verbosity=1"]
        options += [f"-dict={words}", f"-artifact_prefix={faults}/{name}-", "-print_final_stats=1"]
        atheris.Setup([sys.argv[0], *options, str(corpus)], take)
        atheris.Fuzz()


def escaped(piece: bytes) -> str:
    """Bytes as libFuzzer's dictionaries hold them."""
    return "".join(f"\\x{byte:02x}" for byte in piece)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns 1 if there was a fault."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=20_000, help="for every reader")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--faults", type=Path, default=Path("out/fuzz"), help="folder for inputs that are taken wrongly"
    )
    parser.add_argument("--reader", help="only this one, in this process")
    given = parser.parse_args(arguments)
    if importlib.util.find_spec("atheris") is None:
        print("atheris is not installed (pip install atheris): no fuzzing led by coverage")
        return 0
    given.faults.mkdir(parents=True, exist_ok=True)
    if given.reader:
        fuzz_one(given.reader, given.inputs, given.seed, given.faults.resolve())
    from fuzzed_readers import READERS

    failed = []
    for name in READERS:
        command = [sys.executable, __file__, "--reader", name, "--inputs", str(given.inputs), "--seed", str(given.seed)]
        done = subprocess.run(
            [*command, "--faults", str(given.faults)], capture_output=True, text=True, env={**os.environ}
        )
        print(f"{name}: {told(done.stdout + done.stderr)}", flush=True)
        if done.returncode:
            failed.append(name)
            print(done.stdout[-2000:] + done.stderr[-2000:])
    return 1 if failed else 0


def told(log: str) -> str:
    """What libFuzzer says of its work, in a few words."""
    runs = re.search(r"number_of_executed_units: (\d+)", log) or re.search(r"Done (\d+) runs", log)
    reached = re.findall(r"cov: (\d+) ft: \d+ corp: (\d+)", log)
    places = f", {reached[0][0]} places of the code reached at first and {reached[-1][0]} in the end" if reached else ""
    return f"{runs[1] if runs else 'unknown number of'} inputs{places}"


if __name__ == "__main__":
    sys.exit(main())
