"""A plan in the browser: a server on this machine alone that shows arm, parts and paths, and a panel to play them.

Needs the extra "view". The page belongs to nobody else: the server listens on the loopback address only.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser

from takeapart.model.geometry import Array
from takeapart.show.facts import PartFacts, part_facts
from takeapart.show.playback import PLAYBACK, SPEEDS, USUAL_SPEED, Timeline
from takeapart.show.scene import CURRENT, PATH, PlanScene, darker, rgb
from takeapart.viewer.drawing import Nodes, as_bytes, draw_light, draw_scene, move
from takeapart.viewer.explain import Explainer
from takeapart.viewer.server import LOOPBACK, silence, started_server
from takeapart.viewer.texts import (
    block,
    error_text,
    now_text,
    part_text,
    sent,
    step_names,
    steps_text,
    totals_text,
)

FRAMES_PER_SECOND = 30.0
MAXIMUM_NUMBERS = 7  # below the slider
HINT = "Click a part to see when it leaves, and why not earlier."


@dataclass(eq=False)
class _Controls:
    """Handles of the panel."""

    time: Any
    play: Any
    speed: Any
    direction: Any
    laid: Any
    paths: Any
    steps: Any
    list: Any
    now: Any
    part: Any
    ask: Any


class Viewer:
    """Serves one page.

    Args:
        port: of the loopback address; by default one that is free.

    Raises:
        InputError: the port is taken.
    """

    def __init__(self, port: int | None = None) -> None:
        self.server = started_server(port)
        self.server.scene.set_up_direction("+z")
        self.server.scene.configure_environment_map(hdri=None)  # it would come from the network
        self.server.gui.configure_theme(control_width="medium", show_logo=False, show_share_button=False)
        self.lock = threading.RLock()
        self.scene: PlanScene | None = None
        self.facts: tuple[PartFacts, ...] = ()
        self.timeline = Timeline((), "disassembly")
        self.time, self.playing, self.picked = 0.0, False, -1
        self._nodes = Nodes()
        self._controls: _Controls | None = None
        self._explainer: Explainer | None = None
        self._changed = True
        self._shown_step = -1
        self.below: Callable[[], None] | None = None  # adds to the panel whenever it is made anew

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{LOOPBACK}:{self.server.get_port()}"

    def close(self) -> None:
        """Ends the server."""
        with silence():
            self.server.stop()

    def fail(self, message: str) -> None:
        """Shows an error in place of the scene."""
        with self.lock:
            self._clear()
            self.server.gui.add_html(sent(error_text(message)))
            self.server.scene.add_label("/error", message[:120], anchor="center-center")

    def show(self, scene: PlanScene, facts: Sequence[PartFacts] | None = None) -> None:
        """Shows an assembly, or a plan, in place of whatever was shown before.

        Args:
            facts: of its parts; by default those that need no run.
        """
        with self.lock:
            self._clear()
            self.scene, self.facts = scene, tuple(part_facts(scene) if facts is None else facts)
            self._explainer = Explainer(scene)
            self.timeline = Timeline(tuple(scene.along(k)[-1] for k in range(len(scene.steps))), scene.direction)
            self.time, self.playing, self.picked = 0.0, False, -1
            with self.server.atomic():
                draw_light(self.server, scene)
                self._nodes = draw_scene(self.server, scene, self._picking)
                self._controls = self._panel(scene)
                if self.below is not None:
                    self.below()
            self._changed, self._shown_step = True, -1
            self.update()

    def _clear(self) -> None:
        self.scene, self._controls, self.playing = None, None, False
        self.server.scene.reset()
        self.server.gui.reset()

    def run_frame(self, seconds: float) -> None:
        """Moves time on, if it plays, and draws what changed."""
        with self.lock:
            if self.scene is None or self._controls is None:
                return
            if self.playing:
                self.time = min(self.time + seconds * SPEEDS[self._controls.speed.value], self.timeline.total)
                self._changed = True
                if self.time >= self.timeline.total:
                    self._set_playing(False)
            self.update()

    def serve(self, stop: threading.Event) -> None:
        """Draws frames until it is told to stop."""
        last = time.monotonic()
        while not stop.wait(1 / FRAMES_PER_SECOND):
            now = time.monotonic()
            self.run_frame(min(now - last, 0.25))
            last = now

    def update(self) -> None:
        """Brings page and time together."""
        scene, controls = self.scene, self._controls
        if not self._changed or scene is None or controls is None:
            return
        self._changed = False
        if not scene.steps:
            self._place_robot(scene.workcell.home, scene.workcell.description.maximum_opening)
            return
        place = self.timeline.at(self.time)
        opening = scene.steps[place.step].grasp.width + place.extra
        moment = scene.moment(place.step, place.fraction, min(opening, scene.workcell.description.maximum_opening))
        with self.server.atomic():
            for i, part in enumerate(scene.assembly.parts):
                gone = i in moment.gone
                T = moment.T_world_held if i == moment.held else scene.laid_out[i] if gone else part.T_world_part
                frame = self._nodes.frames[i]
                move(frame, T)
                frame.visible = not gone or bool(controls.laid.value)
            self._place_robot(moment.configuration, moment.opening)
            controls.time.value = min(round(self.time, 2), controls.time.max)
            if place.step != self._shown_step:
                self._shown_step = place.step
                self._paint()
                controls.now.content = sent(now_text(scene, self.timeline, place.step))
                controls.list.content = sent(steps_text(scene, self.timeline, place.step))
                controls.steps.value = step_names(scene, self.timeline)[self.timeline.number(place.step) - 1]
                self._show_paths(place.step, bool(controls.paths.value))

    def _show_paths(self, current: int, all_paths: bool) -> None:
        """The tool path of the current step, or of all."""
        assert self.scene is not None
        for k, step in enumerate(self.scene.steps):
            wanted = k == current or all_paths
            if wanted and k not in self._nodes.paths:
                points = np.asarray(step.tool_path)[:, :3]
                segments = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
                self._nodes.paths[k] = self.server.scene.add_line_segments(
                    f"/paths/{k}", segments, as_bytes(rgb(PATH)), thickness=3.0, thickness_units="screen"
                )
            elif k in self._nodes.paths:
                self._nodes.paths[k].visible = wanted

    def _place_robot(self, configuration: Array, opening: float) -> None:
        assert self.scene is not None
        for handle, T in zip(self._nodes.links, self.scene.robot.poses(configuration, opening), strict=True):
            move(handle, T)

    def _paint(self) -> None:
        """Current part and picked part in their own colours."""
        assert self.scene is not None
        for i, bodies in enumerate(self._nodes.bodies):
            color = rgb(self.scene.colors[i])
            if i == self.picked:
                color = tuple(min(1.0, 0.45 + 0.6 * value) for value in color)  # type: ignore[assignment]
            if self.scene.order and i == self.scene.order[max(self._shown_step, 0)]:
                color = rgb(CURRENT)
            for body, shade in zip(bodies, (color, darker(color)), strict=False):
                body.color = as_bytes(shade)

    def _panel(self, scene: PlanScene) -> _Controls:
        gui, has_plan = self.server.gui, bool(scene.steps)
        gui.set_panel_label("takeapart")
        gui.add_html(sent(totals_text(scene, self.facts)))
        total = math.ceil(100 * max(self.timeline.total, 0.01)) / 100
        steps = gui.add_button_group("step", ("back", "forward"), visible=has_plan)
        controls = _Controls(
            time=gui.add_slider(
                "playback, s", 0.0, total, 0.01, 0.0, marks=self._marks(total), visible=has_plan, hint=PLAYBACK
            ),
            play=gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY, visible=has_plan),
            speed=gui.add_dropdown("speed", tuple(SPEEDS), initial_value=USUAL_SPEED, visible=has_plan),
            direction=gui.add_dropdown(
                "direction", ("disassembly", "assembly"), initial_value=scene.direction, visible=has_plan
            ),
            laid=gui.add_checkbox("removed parts", True, visible=has_plan),
            paths=gui.add_checkbox("all paths", False, visible=has_plan),
            now=gui.add_html("", visible=has_plan),
            steps=gui.add_dropdown("go to", step_names(scene, self.timeline) or ("-",), visible=has_plan),
            list=gui.add_html("", visible=has_plan),
            part=gui.add_html(sent(block(HINT))),
            ask=gui.add_button("Ask the planner", icon=viser.Icon.HELP, visible=False),
        )
        controls.play.on_click(lambda _: self._set_playing(not self.playing))
        steps.on_click(lambda event: self.jump(1 if event.target.value == "forward" else -1))
        controls.time.on_update(self._dragged)
        controls.steps.on_update(self._chosen)
        controls.direction.on_update(lambda _: self._turn_around())
        for box in (controls.laid, controls.paths):
            box.on_update(lambda _: self._redraw())
        controls.ask.on_click(lambda _: self._ask())
        return controls

    def _marks(self, total: float) -> tuple[Any, ...] | None:
        """Ticks of the slider at the beginning of every step, a few of them with its number."""
        order = self.timeline.order
        each = max(1, math.ceil(len(order) / MAXIMUM_NUMBERS))
        marks: list[Any] = []
        for n, k in enumerate(order):
            at = min(round(self.timeline.start(k), 2), total)
            marks.append((at, str(n + 1)) if n % each == 0 else at)
        return tuple(marks) or None

    def _chosen(self, event: Any) -> None:
        """Somebody chose a step from the list."""
        if event.client is None or self._controls is None or self.scene is None:
            return
        with self.lock:
            names = step_names(self.scene, self.timeline)
            if self._controls.steps.value in names:
                self._set_playing(False)
                self.time = self.timeline.start(self.timeline.order[names.index(self._controls.steps.value)]) + 1e-6
                self._changed = True

    def _set_playing(self, playing: bool) -> None:
        with self.lock:
            if self._controls is None:
                return
            if playing and self.time >= self.timeline.total:
                self.time = 0.0
            self.playing = playing
            self._controls.play.label = "Pause" if playing else "Play"
            self._controls.play.icon = viser.Icon.PLAYER_PAUSE if playing else viser.Icon.PLAYER_PLAY

    def _dragged(self, event: Any) -> None:
        if event.client is None or self._controls is None:  # set by the viewer itself
            return
        with self.lock:
            self._set_playing(False)
            self.time = float(self._controls.time.value)
            self._changed = True

    def jump(self, by: int) -> None:
        """To the beginning of the next step, or of the one before."""
        with self.lock:
            self._set_playing(False)
            self.time = self.timeline.jump(self.time, by)
            self._changed = True

    def _turn_around(self) -> None:
        with self.lock:
            if self._controls is not None and self._controls.direction.value != self.timeline.direction:
                self.timeline = Timeline(self.timeline.ways, self._controls.direction.value)
                self.time = self.timeline.total - self.time
                self._controls.time.marks = self._marks(self._controls.time.max)
                self._controls.steps.options = step_names(self.scene, self.timeline) if self.scene else ("-",)
                self._redraw()

    def _redraw(self) -> None:
        with self.lock:
            self._changed, self._shown_step = True, -1

    def pick(self, part: int) -> None:
        """Tells what is known of a part."""
        with self.lock:
            if self._controls is None or self.scene is None:
                return
            self.picked = part
            self._controls.part.content = sent(part_text(self.scene, self.facts[part]))
            self._controls.ask.visible = not self.scene.assembly.parts[part].fixed
            self._redraw()

    def _picking(self, part: int) -> Callable[[Any], None]:
        return lambda _: self.pick(part)

    def _ask(self) -> None:
        """Asks the planner about the picked part; the page stays responsive meanwhile."""
        with self.lock:
            part, controls, scene, explainer = self.picked, self._controls, self.scene, self._explainer
        if controls is None or scene is None or explainer is None or part < 0:
            return
        facts = self.facts[part]
        controls.ask.disabled = True
        controls.part.content = sent(part_text(scene, facts, "is being asked ..."))
        try:
            answer = explainer.ask(part, facts)
        except Exception as error:  # whatever it is, it must not end the viewer
            answer = f"could not be asked: {error}"
        with self.lock:
            controls.ask.disabled = False
            if self.picked == part and self._controls is controls:
                controls.part.content = sent(part_text(scene, facts, answer))
