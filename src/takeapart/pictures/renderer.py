"""Pictures of assemblies and plans, drawn by MuJoCo without a window: stills, a sheet of all steps, animations.

Needs the extra "view", and OpenGL: without a display, EGL (of the graphics driver, or Mesa's in software).
"""

from __future__ import annotations

import copy
import importlib
import itertools
import os
import queue
import sys
import threading
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from takeapart.model.errors import MissingExtraError, TakeapartError
from takeapart.model.geometry import Array, quaternion_from_rotation
from takeapart.pictures.model import PICTURE, RenderOptions, compiled_model
from takeapart.show.scene import CURRENT, PATH, Moment, PlanScene, darker, rgb
from takeapart.show.view import View, view_of

try:
    import mujoco
    from PIL import Image as PillowImage
except ImportError as missing:
    raise MissingExtraError("render", "view", "mujoco and pillow") from missing

Image = NDArray[np.uint8]
"""A picture (H, W, 3), red, green, blue."""

PATH_POINTS, MOVING_PATH_POINTS = 48, 16
LIGHT_RADIUS, LIGHT_DIRECTIONS = 0.012, 6  # rad, half the angle that the light fills; samples on its edge
DRAWING_THREADS = 2  # of an animation; OpenGL in software keeps one core busy with vertices, another with pixels
QUEUED = 4  # pictures of one thread that wait

_graphics = threading.Lock()  # MuJoCo opens the display, and chooses it, for all threads


class NoGraphicsError(TakeapartError):
    """There is no OpenGL to draw with."""

    def __init__(self, cause: str) -> None:
        super().__init__(
            f"no OpenGL to draw with ({cause}); on a machine without a screen install Mesa's EGL (Debian and Ubuntu: "
            "apt install libegl1 libgl1-mesa-dri), or set MUJOCO_GL=osmesa or MUJOCO_GL=glfw"
        )


class Renderer:
    """Draws moments of one scene. Use it as a context manager, in one thread: it holds memory of the driver.

    Args:
        view: by default the one that the options name, for the whole plan.
        model: of scene and view, where it was compiled already; it is changed.

    Raises:
        NoGraphicsError: there is no OpenGL.
    """

    def __init__(
        self, scene: PlanScene, options: RenderOptions = PICTURE, view: View | None = None, model: Any = None
    ) -> None:
        self.scene, self.options = scene, options
        self.view = chosen_view(scene, options) if view is None else view
        self._model = compiled_model(scene, options, self.view) if model is None else model
        self._data = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, self._data)
        body = {self._model.body(b).name: b for b in range(self._model.nbody)}
        mocap = self._model.body_mocapid
        self._parts = [int(mocap[body[f"part/{part.name}"]]) for part in scene.assembly.parts]
        self._part_geoms = [_geoms(self._model, body[f"part/{part.name}"]) for part in scene.assembly.parts]
        self._links = [int(mocap[body[f"link/{i}"]]) for i in range(len(scene.robot.links))] if options.robot else []
        self._plain = self._model.geom_rgba.copy()
        self._renderer = opened_renderer(self._model, options)

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, *_: object) -> None:
        self._renderer.close()

    def picture(self, moment: Moment | None = None) -> Image:
        """One picture: of a moment of the plan, or of the whole assembly with the arm at rest."""
        self._pose(moment)
        mujoco.mj_kinematics(self._model, self._data)
        self._renderer.update_scene(self._data, camera_of(self._model, self.view))
        if moment is not None and self.options.path:
            self._draw_path(np.asarray(self.scene.steps[moment.step].tool_path)[:, :3])
        return drawn_picture(self._renderer, self.options)

    def _pose(self, moment: Moment | None) -> None:
        scene, model = self.scene, self._model
        model.geom_rgba[:] = self._plain
        for i, part in enumerate(scene.assembly.parts):
            T, shown = part.T_world_part, True
            if moment is not None and i == moment.held:
                T = moment.T_world_held
                color = rgb(CURRENT)
                for geom, shade in zip(self._part_geoms[i], (color, darker(color)), strict=False):
                    model.geom_rgba[geom, :3] = shade
            elif moment is not None and i in moment.gone:
                shown = self.options.laid_out
                T = scene.laid_out[i]
            if not shown:
                model.geom_rgba[self._part_geoms[i], 3] = 0.0
            self._place(self._parts[i], T)
        if self._links:
            configuration = scene.workcell.home if moment is None else moment.configuration
            opening = scene.workcell.description.maximum_opening if moment is None else moment.opening
            for mocap, T in zip(self._links, scene.robot.poses(configuration, opening), strict=True):
                self._place(mocap, T)

    def _place(self, mocap: int, T: Array) -> None:
        self._data.mocap_pos[mocap] = T[:3, 3]
        self._data.mocap_quat[mocap] = quaternion_from_rotation(T[:3, :3])

    def _draw_path(self, points: Array) -> None:
        """The tool path as a line; drawn at last, since the renderer forgets it with every update."""
        drawn = self._renderer.scene
        count = MOVING_PATH_POINTS if self.options.moving else PATH_POINTS
        chosen = points[np.unique(np.linspace(0, len(points) - 1, count).astype(int))]
        for start, end in itertools.pairwise(chosen):
            if drawn.ngeom >= drawn.maxgeom or np.linalg.norm(end - start) < 1e-5:
                continue
            geom = drawn.geoms[drawn.ngeom]
            rgba = np.array([*rgb(PATH), 1.0], dtype=np.float32)
            kind = mujoco.mjtGeom.mjGEOM_CAPSULE
            mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.zeros(9), rgba)
            mujoco.mjv_connector(geom, kind, self.scene.path_radius, start, end)
            geom.emission = 0.5
            drawn.ngeom += 1


def opened_renderer(model: Any, options: RenderOptions) -> Any:
    """MuJoCo's renderer of a model.

    Raises:
        NoGraphicsError: there is no OpenGL.
    """
    try:
        with _graphics:
            _choose_graphics()
            return mujoco.Renderer(model, options.drawn_height, options.drawn_width)
    except Exception as error:  # MuJoCo and the loaders of OpenGL raise whatever they like
        raise NoGraphicsError(str(error).strip().split("\n")[0] or type(error).__name__) from error


def drawn_picture(renderer: Any, options: RenderOptions) -> Image:
    """The scene that a renderer holds, at the size of the picture."""
    drawn = PillowImage.fromarray(_pixels(renderer, options))
    return np.asarray(drawn.resize((options.width, options.height), PillowImage.Resampling.BOX))


def _pixels(renderer: Any, options: RenderOptions) -> Image:
    """The scene in all samples; where shadows are soft, the mean over directions of the light that casts them."""
    if not options.soft:
        return np.asarray(renderer.render())
    drawn = renderer.scene
    casting = [drawn.lights[k] for k in range(drawn.nlight) if drawn.lights[k].castshadow]
    directions = [np.array(light.dir, dtype=float) for light in casting]
    total: NDArray[np.uint16] = np.zeros(1, dtype=np.uint16)
    for turn in np.arange(LIGHT_DIRECTIONS) * 2 * np.pi / LIGHT_DIRECTIONS:
        for light, direction in zip(casting, directions, strict=True):
            across = np.cross(direction, (0.0, 0.0, 1.0))
            across /= np.linalg.norm(across)
            aside = np.cos(turn) * across + np.sin(turn) * np.cross(direction, across)
            light.dir = direction + LIGHT_RADIUS * aside
        total = total + renderer.render()
    return (total // LIGHT_DIRECTIONS).astype(np.uint8)


def _choose_graphics() -> None:
    """Without a screen, and where nobody said otherwise, EGL. MuJoCo chooses when it is imported, which may have been
    for another purpose, so it is made to choose again."""
    if sys.platform.startswith("linux") and not os.environ.get("DISPLAY") and not os.environ.get("MUJOCO_GL"):
        os.environ["MUJOCO_GL"] = "egl"
        importlib.reload(importlib.import_module("mujoco.rendering.classic.gl_context"))


def _geoms(model: Any, body: int) -> list[int]:
    first = int(model.body_geomadr[body])
    return list(range(first, first + int(model.body_geomnum[body])))


def camera_of(model: Any, view: View) -> Any:
    """MuJoCo's camera where a view is; the model is told how wide it looks."""
    model.vis.global_.fovy = np.degrees(view.field)
    camera = mujoco.MjvCamera()
    camera.lookat, camera.distance = view.target, view.distance
    forward = view.direction
    camera.azimuth = np.degrees(np.arctan2(forward[1], forward[0]))
    camera.elevation = np.degrees(np.arcsin(np.clip(forward[2], -1, 1)))
    return camera


def chosen_view(scene: PlanScene, options: RenderOptions, moments: Sequence[Moment] | None = None) -> View:
    """The view that the options name; moments as for `takeapart.show.view.view_of`."""
    return view_of(scene, options.view, options.robot, options.width / options.height, moments)


def step_pictures(scene: PlanScene, options: RenderOptions, fraction: float = 0.4) -> list[Image]:
    """One picture of every removal, at the given fraction of its path."""
    with Renderer(scene, options) as renderer:
        return [renderer.picture(scene.moment(step, fraction)) for step in range(len(scene.steps))]


def animation(
    scene: PlanScene, options: RenderOptions, frames: int, steps: Sequence[int] | None = None
) -> Iterator[Image]:
    """Pictures of a plan in its own direction, one after the other.

    Args:
        frames: per step, at least 2.
        steps: numbers of the removals that are shown, in the order of disassembly; by default all.
    """
    chosen = list(range(len(scene.steps)) if steps is None else steps)
    if scene.direction == "assembly":
        chosen.reverse()
    fractions = np.linspace(0.0, 1.0, frames)
    moments = [
        (step, float(fraction))
        for step in chosen
        for fraction in (fractions if scene.direction == "disassembly" else fractions[::-1])
    ]
    options = replace(options, moving=True)
    view = chosen_view(scene, options)
    model = compiled_model(scene, options, view)
    stop = threading.Event()
    outputs: list[queue.Queue[Image | Exception]] = [queue.Queue(QUEUED) for _ in range(DRAWING_THREADS)]

    def draw(first: int) -> None:
        """Every so many-th picture, with a renderer of this thread."""
        try:
            with Renderer(scene, options, view, copy.copy(model)) as renderer:
                for step, fraction in moments[first::DRAWING_THREADS]:
                    _put(outputs[first], renderer.picture(scene.moment(step, fraction)), stop)
                    if stop.is_set():
                        return
        except Exception as error:  # raised again where the pictures are taken
            _put(outputs[first], error, stop)

    threads = [threading.Thread(target=draw, args=(k,), daemon=True) for k in range(DRAWING_THREADS)]
    for thread in threads:
        thread.start()
    try:
        for number in range(len(moments)):
            found = outputs[number % DRAWING_THREADS].get()
            if isinstance(found, Exception):
                raise found
            yield found
    finally:
        stop.set()
        for thread in threads:
            thread.join()


def _put(output: queue.Queue[Image | Exception], value: Image | Exception, stop: threading.Event) -> None:
    """Waits for a place, unless nobody takes pictures any more."""
    while not stop.is_set():
        try:
            return output.put(value, timeout=0.1)
        except queue.Full:
            continue
