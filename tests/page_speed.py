"""How fast pages are: time to the first picture, and time per frame while playing. Table of docs/viewer.md.

    python tests/page_speed.py --document docs/viewer.md [--plan PLAN]

Without --plan a shipped assembly of 30 parts is planned first.
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from browser import opened, wait_until
from takeapart.formats.files import data_path
from takeapart.page.standalone import save_page
from takeapart.show.scene import PlanScene
from takeapart.show.subject import load_subject
from takeapart.viewer import Viewer

START, END = "<!-- figures -->", "<!-- end of figures -->"
SECONDS = 10.0  # of playing
FRAMES = """(() => { window.gaps = []; let last;
const frame = now => { if (last) gaps.push(now - last); last = now; requestAnimationFrame(frame); };
requestAnimationFrame(frame); })()"""


def standalone(plan: Path, folder: Path) -> tuple[float, list[float], int]:
    """Seconds to the first picture, seconds per frame, bytes."""
    out = folder / "plan.html"
    save_page(plan, out)
    with opened(out.as_uri(), offline=True) as found:
        wait_until(found.page, "window.takeapart && window.takeapart.firstPicture > 0", 60_000)
        first = found.page.evaluate("takeapart.firstPicture") / 1000
        found.page.click("#play")
        found.page.wait_for_timeout(1000 * SECONDS)
        frames = [gap / 1000 for gap in found.page.evaluate("takeapart.player.frames")]
    return first, frames, out.stat().st_size


def served(plan: Path) -> tuple[float, list[float]]:
    """The viewer's page: seconds from the address to a picture that is not blank, seconds per frame."""
    subject = load_subject(plan)
    viewer, stop = Viewer(), threading.Event()
    try:
        viewer.show(PlanScene(subject.assembly, subject.workcell, subject.plan))
        thread = threading.Thread(target=viewer.serve, args=(stop,), daemon=True)
        thread.start()
        with opened(viewer.url) as found:
            deadline = time.monotonic() + 120
            first = math.nan
            while time.monotonic() < deadline and math.isnan(first):
                if found.page.locator("canvas").count() and found.picture().std() > 20:
                    first = found.page.evaluate("performance.now()") / 1000  # since the address was opened
            found.page.evaluate(FRAMES)
            found.page.get_by_role("button", name="Play").click()
            found.page.wait_for_timeout(1000 * SECONDS)
            return first, [gap / 1000 for gap in found.page.evaluate("gaps")]
    finally:
        stop.set()
        viewer.close()


def row(name: str, first: float, frames: list[float]) -> str:
    """A row of the table."""
    middle, slow = np.percentile(frames, [50, 95])
    return f"| {name} | {first:.1f} s | {1000 * middle:.0f} ms | {1000 * slow:.0f} ms |"


def main() -> int:
    """Measures, prints, and puts the table into the document."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--document", type=Path)
    parser.add_argument("--plan", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        plan = given.plan
        if plan is None:
            plan = folder / "plan.json"
            command = [
                sys.executable,
                "-m",
                "takeapart",
                "plan",
                str(data_path("double/01.json")),
                "--search",
                "greedy",
            ]
            subprocess.run([*command, "--out", str(plan)], check=True)
        first, frames, size = standalone(plan, folder)
        rows = [row("standalone page, from disk", first, frames), row("`takeapart view`", *served(plan))]
    parts = len(load_subject(plan).plan.steps) if given.plan else 30  # type: ignore[union-attr]
    load = os.getloadavg()[0] / (os.cpu_count() or 1)
    text = "\n".join(
        [
            f"A plan of {parts} parts in headless Chromium, 1200 x 800 pixels, WebGL **in software** on "
            f"{os.cpu_count()} cores that had {load:.1f} times their work already; a graphics card is far faster. "
            f"The standalone page has {size / 1e6:.1f} MB. `python tests/page_speed.py --document docs/viewer.md`:",
            "",
            "| page | first picture after | frame, median | frame, 95th percentile |",
            "|---|---|---|---|",
            *rows,
        ]
    )
    print(text)
    if given.document:
        document = given.document.read_text(encoding="utf-8")
        before, after = document.split(START)[0], document.split(END)[-1]
        given.document.write_text(f"{before}{START}\n{text}\n{END}{after}", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
