"""A plan in the browser: a server on this machine alone that shows arm, parts and paths, and a panel to play them.

Needs the extra "view". The page belongs to nobody else: the server listens on the loopback address only.
"""

from __future__ import annotations

import contextlib
import io
import math
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from takeapart.errors import InputError, MissingExtraError
from takeapart.geometry import Array, quaternion_from_rotation
from takeapart.render_facts import PartFacts, part_facts
from takeapart.render_robot import BROWSER_CELL, coarser
from takeapart.render_scene import CURRENT, GOAL, PATH, STEEL, Color, PlanScene, darker, rgb, view_of
from takeapart.viewer_explain import Explainer
from takeapart.viewer_texts import now_text, part_text, totals_text
from takeapart.viewer_time import SPEEDS, Timeline

try:
    import viser
except ImportError as missing:
    raise MissingExtraError("view", "view", "viser") from missing

LOOPBACK = "127.0.0.1"
FRAMES_PER_SECOND = 30.0
PANEL_SHARE = 0.11  # of the camera's distance, by which everything is shifted to the left
HINT = "Click a part to see when it leaves, and why not earlier."


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """The server prints to standard output, which belongs to the command."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield


def free_port() -> int:
    """A port of the loopback address that nobody listens on."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])


@dataclass(eq=False)
class _Controls:
    """Handles of the panel."""

    time: Any
    play: Any
    speed: Any
    direction: Any
    laid: Any
    paths: Any
    now: Any
    part: Any
    ask: Any


@dataclass(eq=False)
class _Nodes:
    """Handles of the scene. Every part is a frame with its own body and its connectors below it."""

    frames: list[Any] = field(default_factory=list)
    bodies: list[list[Any]] = field(default_factory=list)
    links: list[Any] = field(default_factory=list)
    paths: dict[int, Any] = field(default_factory=dict)  # made when they are first seen


class Viewer:
    """Serves one page.

    Args:
        port: of the loopback address; by default one that is free.

    Raises:
        InputError: the port is taken.
    """

    def __init__(self, port: int | None = None) -> None:
        wanted = port or free_port()
        with _silence():
            self.server = viser.ViserServer(host=LOOPBACK, port=wanted, label="takeapart", verbose=False)
        if port and self.server.get_port() != port:
            self.close()
            raise InputError(f"{port} is taken on this machine; leave --port out to have a free one", "--port")
        self.server.scene.set_up_direction("+z")
        self.server.scene.configure_environment_map(hdri=None)  # it would come from the network
        self.server.gui.configure_theme(control_width="medium", show_logo=False, show_share_button=False)
        self.lock = threading.RLock()
        self.scene: PlanScene | None = None
        self.facts: tuple[PartFacts, ...] = ()
        self.timeline = Timeline((), "disassembly")
        self.time, self.playing, self.picked = 0.0, False, -1
        self._nodes = _Nodes()
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
        with _silence():
            self.server.stop()

    def fail(self, message: str) -> None:
        """Shows an error in place of the scene."""
        with self.lock:
            self._clear()
            self.server.gui.add_markdown(f"### This cannot be shown\n\n{message}")
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
                self._light(scene)
                self._nodes = self._draw(scene)
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
                _move(frame, T)
                frame.visible = not gone or bool(controls.laid.value)
            self._place_robot(moment.configuration, moment.opening)
            controls.time.value = min(round(self.time, 2), controls.time.max)
            if place.step != self._shown_step:
                self._shown_step = place.step
                self._paint()
                controls.now.content = now_text(scene, self.timeline, place.step)
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
                    f"/paths/{k}", segments, _bytes(rgb(PATH)), thickness=3.0, thickness_units="screen"
                )
            elif k in self._nodes.paths:
                self._nodes.paths[k].visible = wanted

    def _place_robot(self, configuration: Array, opening: float) -> None:
        assert self.scene is not None
        for handle, T in zip(self._nodes.links, self.scene.robot.poses(configuration, opening), strict=True):
            _move(handle, T)

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
                body.color = _bytes(shade)

    def _light(self, scene: PlanScene) -> None:
        view = view_of(scene)
        api = self.server.scene
        aside = PANEL_SHARE * view.distance * np.cross(view.direction, [0.0, 0.0, 1.0])  # the panel hides the right
        self.server.initial_camera.position = view.position + aside
        self.server.initial_camera.look_at = view.target + aside
        self.server.initial_camera.up = (0.0, 0.0, 1.0)
        self.server.initial_camera.fov = view.field
        api.configure_default_lights(enabled=False)
        api.add_light_hemisphere("/light/sky", sky_color=(255, 255, 255), ground_color=(190, 195, 205), intensity=1.6)
        low, high = scene.bounds
        position = (low + high) / 2 + [-0.8, -1.4, 2.6]
        api.add_light_directional("/light/sun", intensity=1.7, position=tuple(position), cast_shadow=False)

    def _draw(self, scene: PlanScene) -> _Nodes:
        api, nodes = self.server.scene, _Nodes()
        for obstacle in scene.workcell.environment:
            box = obstacle.box
            handle = api.add_box(f"/environment/{obstacle.name}", _bytes(rgb(STEEL)), tuple(2 * box.half_extents))
            _move(handle, box.T_frame_box)
        for i, part in enumerate(scene.assembly.parts):
            frame = api.add_frame(f"/parts/{part.name}", show_axes=False)
            _move(frame, part.T_world_part)
            body, own = scene.assembly.body(i), len(part.shape.boxes())
            color = rgb(scene.colors[i])
            bodies = []
            for name, boxes, shade in (("shape", body[:own], color), ("connectors", body[own:], darker(color))):
                if boxes:
                    vertices, faces = box_mesh(boxes)
                    mesh = api.add_mesh_simple(
                        f"/parts/{part.name}/{name}", vertices, faces, color=_bytes(shade), flat_shading=True
                    )
                    mesh.on_click(self._picking(i))
                    bodies.append(mesh)
            nodes.frames.append(frame)
            nodes.bodies.append(bodies)
        for number, link in enumerate(scene.robot.links):
            nodes.links.append(api.add_frame(f"/robot/{number}", show_axes=False))
            for k, mesh_of in enumerate(coarser(mesh, BROWSER_CELL) for mesh in link.meshes):
                api.add_mesh_simple(
                    f"/robot/{number}/{k}", mesh_of.vertices, mesh_of.faces, color=_bytes(mesh_of.color), side="double"
                )
        api.add_icosphere("/goal", 0.012, _bytes(rgb(GOAL)), position=tuple(scene.workcell.goal))
        return nodes

    def _panel(self, scene: PlanScene) -> _Controls:
        gui, has_plan = self.server.gui, bool(scene.steps)
        gui.set_panel_label("takeapart")
        title = f"{scene.direction.capitalize()} of {scene.assembly.name}" if has_plan else scene.assembly.name
        gui.add_markdown(f"### {title}\n\n{totals_text(scene)}")
        total = math.ceil(100 * max(self.timeline.total, 0.01)) / 100
        steps = gui.add_button_group("step", ("back", "forward"), visible=has_plan)
        controls = _Controls(
            time=gui.add_slider("time, s", 0.0, total, 0.01, 0.0, visible=has_plan),
            play=gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY, visible=has_plan),
            speed=gui.add_dropdown("speed", tuple(SPEEDS), initial_value="1x", visible=has_plan),
            direction=gui.add_dropdown(
                "direction", ("disassembly", "assembly"), initial_value=scene.direction, visible=has_plan
            ),
            laid=gui.add_checkbox("removed parts", True, visible=has_plan),
            paths=gui.add_checkbox("all paths", False, visible=has_plan),
            now=gui.add_markdown("", visible=has_plan),
            part=gui.add_markdown(HINT),
            ask=gui.add_button("Ask the planner", icon=viser.Icon.HELP, visible=False),
        )
        controls.play.on_click(lambda _: self._set_playing(not self.playing))
        steps.on_click(lambda event: self.jump(1 if event.target.value == "forward" else -1))
        controls.time.on_update(self._dragged)
        controls.direction.on_update(lambda _: self._turn_around())
        for box in (controls.laid, controls.paths):
            box.on_update(lambda _: self._redraw())
        controls.ask.on_click(lambda _: self._ask())
        return controls

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
            self._controls.part.content = part_text(self.scene, self.facts[part])
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
        text = part_text(scene, self.facts[part])
        controls.ask.disabled = True
        controls.part.content = f"{text}\n\n*The planner is being asked ...*"
        try:
            answer = explainer.ask(part, self.facts[part])
        except Exception as error:  # whatever it is, it must not end the viewer
            answer = f"The planner could not be asked: {error}"
        with self.lock:
            controls.ask.disabled = False
            if self.picked == part and self._controls is controls:
                controls.part.content = f"{text}\n\n**The planner:** {answer}"


def box_mesh(boxes: Sequence[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (24 B, 3) float32, m, and faces (12 B, 3) of boxes, faces with corners of their own."""
    quads = np.array(  # corners of `OrientedBox.corners`, anticlockwise seen from outside
        [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    )
    vertices = np.concatenate([box.corners()[quads.ravel()] for box in boxes])
    first = 4 * np.arange(6 * len(boxes))[:, None]
    faces = np.concatenate([first + [0, 1, 2], first + [0, 2, 3]])
    return vertices.astype(np.float32), faces.astype(np.int32)


def _move(handle: Any, T: Array) -> None:
    handle.position, handle.wxyz = T[:3, 3], quaternion_from_rotation(T[:3, :3])


def _bytes(color: Color) -> tuple[int, int, int]:
    red, green, blue = (round(255 * value) for value in color)
    return red, green, blue
