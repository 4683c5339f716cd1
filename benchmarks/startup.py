"""What a command costs before and beside its work: processor time of new processes. Table of docs/benchmarks.md.

    python benchmarks/startup.py --document docs/benchmarks.md

The kernels must be compiled already. Other work on the machine makes processors slower, so the least of several runs
counts.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from takeapart.experiments.tables import replace_between_markers
from takeapart.formats.files import data_path

PRODUCT = str(data_path("single/01.json"))
STARTED = {
    "`python -c 'import numba'`": ["-c", "import numba"],
    "`python -c 'import takeapart.planning'`": ["-c", "import takeapart.planning"],
    "`takeapart explain data/single/01.json`": ["-m", "takeapart", "explain", PRODUCT],
    "`takeapart plan data/single/01.json --search greedy`": ["-m", "takeapart", "plan", PRODUCT, "--search", "greedy"],
}


def main() -> int:
    """Measures, prints, and puts the table into the document."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--document", type=Path)
    parser.add_argument("--repeats", type=int, default=5)
    given = parser.parse_args()
    rows = ["| started | least processor time | largest |", "|---|---:|---:|"]
    for name, arguments in STARTED.items():
        seconds = [processor_time(arguments) for _ in range(given.repeats)]
        rows.append(f"| {name} | {min(seconds):.2f} s | {max(seconds):.2f} s |")
    load = os.getloadavg()[0]
    text = "\n".join([*rows, "", f"{given.repeats} runs of each; {os.cpu_count()} cores, load {load:.1f}."])
    print(text)
    if given.document:
        replace_between_markers(given.document, "startup", text)
    return 0


def processor_time(arguments: list[str]) -> float:
    """Of a new process, s."""
    with tempfile.TemporaryDirectory() as folder:  # the plan is written there
        command, quiet = [sys.executable, *arguments], subprocess.DEVNULL
        child = subprocess.Popen(command, cwd=folder, stdout=quiet, stderr=quiet)
        _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise RuntimeError(f"{' '.join(arguments)} ended with {child.returncode}")
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    sys.exit(main())
