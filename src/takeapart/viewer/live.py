"""Watching a search: best length and bound against time, and the best plan so far."""

from __future__ import annotations

import math
import threading
import time
from typing import Any

import numpy as np
import viser

from takeapart.formats.serialization import assembly_hash, workcell_hash
from takeapart.model.assembly import Assembly
from takeapart.model.plan import Plan, PlanStep
from takeapart.removal.result import Removal
from takeapart.search.result import Progress
from takeapart.show.figures import lasting_bounds
from takeapart.show.scene import PlanScene
from takeapart.viewer import Viewer
from takeapart.viewer.texts import block, search_text, sent
from takeapart.workcell import Workcell

PERIOD = 0.5  # s, between changes of the page
SCENE_PERIOD = 3.0  # s, between plans
MAXIMUM_POINTS = 500


class LiveSearch:
    """Listens to a search and shows it; hand it to `takeapart.planning.plan` as its listener.

    The search itself is not slowed down: what it tells is kept, and shown by the thread that runs `serve`.
    """

    def __init__(self, viewer: Viewer, assembly: Assembly, workcell: Workcell) -> None:
        self.viewer, self._assembly, self._workcell = viewer, assembly, workcell
        self._hashes = {"assembly": assembly_hash(assembly), "workcell": workcell_hash(workcell)}
        self._rows: list[tuple[float, float, float]] = []  # s, m, m
        self._last: Progress | None = None
        self._shown: tuple[Removal, ...] = ()
        self._chart: Any = None
        self._text: Any = None
        self._started = time.monotonic()
        viewer.below = self._panel
        viewer.show(PlanScene(assembly, workcell))

    def __call__(self, progress: Progress) -> None:
        """A sign of life of the search."""
        self._last = progress
        length, bound = (value if 0 <= value < math.inf else math.nan for value in (progress.length, progress.bound))
        if len(self._rows) >= MAXIMUM_POINTS:
            del self._rows[1::2]
        self._rows.append((time.monotonic() - self._started, length, bound))

    def serve(self, stop: threading.Event) -> None:
        """Keeps the page up to date until it is told to stop; runs beside the viewer's own thread."""
        drawn = 0.0
        while not stop.wait(PERIOD):
            progress = self._last
            if progress is None:
                continue
            with self.viewer.lock:
                if progress.removals != self._shown and time.monotonic() - drawn > SCENE_PERIOD:
                    self._shown, drawn = progress.removals, time.monotonic()
                    self.viewer.show(PlanScene(self._assembly, self._workcell, self.plan_so_far(progress)))
                self._refresh(progress)

    def finish(self, plan: Plan) -> None:
        """Shows the plan that the search ended with."""
        with self.viewer.lock:
            self._shown = self._last.removals if self._last is not None else ()
            self.viewer.show(PlanScene(self._assembly, self._workcell, plan))

    def plan_so_far(self, progress: Progress) -> Plan:
        """The best sequence of a search that is under way, as a plan without bounds of its own."""
        parts = self._assembly.parts
        return Plan(
            steps=tuple(
                PlanStep(parts[each.part].name, each.grasp, each.joint_path, each.tool_path, each.length)
                for each in progress.removals
            ),
            total_length=progress.length,
            straight_line_bound=0.0,
            sequence_bound=progress.bound if 0 < progress.bound < math.inf else None,
            counts={"removal_queries": progress.queries},
            seconds=progress.seconds,
            seed=0,
            search={},
            hashes=self._hashes,
            versions={},
            assembly=self._assembly.name,
            workcell=self._workcell.name,
            robot=self._workcell.description.name,
            joints=self._workcell.description.arm.joints,
        )

    def _panel(self) -> None:
        gui = self.viewer.server.gui
        with gui.add_folder("Search"):
            self._text = gui.add_html(sent(block("The search has not told anything yet.")))
            self._chart = gui.add_uplot(
                self._data(),
                (
                    viser.uplot.Series(label="s"),
                    viser.uplot.Series(label="length, m", stroke="#2f6fb0", width=2),
                    viser.uplot.Series(label="sequence bound, m", stroke="#d9822b", width=2),
                ),
                scales={"x": viser.uplot.Scale(time=False, auto=True), "y": viser.uplot.Scale(auto=True)},
                aspect=1.4,
            )
        if self._last is not None:
            self._refresh(self._last)

    def _refresh(self, progress: Progress) -> None:
        self._text.content = sent(search_text(progress.length, progress.bound, progress.queries, self._rows[-1][0]))
        self._chart.data = self._data()

    def _data(self) -> tuple[np.ndarray, ...]:
        rows = np.array(self._rows or [(0.0, math.nan, math.nan)], dtype=float)
        return rows[:, 0].copy(), rows[:, 1].copy(), np.array(lasting_bounds(rows[:, 2].tolist()))
