"""What a GIF of a plan costs: wall time, processor time of all threads, peak memory. Table of docs/benchmarks.md.

    python benchmarks/animation.py --document docs/benchmarks.md

Without --plan the shipped assembly single/01 of 21 parts is planned first.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from takeapart.experiments.tables import replace_between_markers
from takeapart.formats.files import data_path


def main() -> int:
    """Measures, prints, and puts the line into the document."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--document", type=Path)
    parser.add_argument("--plan", type=Path, help="the plan that is shown")
    parser.add_argument("--frames", type=int, help="pictures of a step, as of `takeapart render`")
    given = parser.parse_args()
    command = [sys.executable, "-m", "takeapart"]
    with tempfile.TemporaryDirectory() as name:
        folder, plan = Path(name), given.plan
        if plan is None:
            plan = folder / "plan.json"
            product = str(data_path("single/01.json"))
            subprocess.run([*command, "plan", product, "--search", "greedy", "--out", str(plan)], check=True)
        out = folder / "plan.gif"
        begin = time.monotonic()
        frames = [] if given.frames is None else ["--frames", str(given.frames)]
        child = subprocess.Popen([*command, "render", str(plan), "--out", str(out), *frames])
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        wall = time.monotonic() - begin
        if child.returncode:
            return 1
        size = out.stat().st_size
    processor = used.ru_utime + used.ru_stime
    load = os.getloadavg()[0]
    text = (
        f"{wall:.1f} s, of the processor {processor:.1f} s in all threads, at most {used.ru_maxrss / 1024:.0f} MB of "
        f"memory, a file of {size / 1e6:.1f} MB; {os.cpu_count()} cores, load {load:.1f}."
    )
    print(text)
    if given.document:
        replace_between_markers(given.document, "animation", text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
