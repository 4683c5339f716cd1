"""Pictures of assemblies and plans, drawn by MuJoCo without a window: stills, a sheet of all steps, animations.

Needs the extra "view", and OpenGL: without a display, EGL (of the graphics driver, or Mesa's in software).
"""

from __future__ import annotations

import functools
import importlib
import itertools
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from takeapart.errors import MissingExtraError, TakeapartError
from takeapart.geometry import Array, OrientedBox, quaternion_from_rotation
from takeapart.render_robot import RobotVisual
from takeapart.render_scene import CURRENT, GOAL, PATH, STEEL, Color, Moment, PlanScene, View, darker, rgb, view_of

try:
    import mujoco
except ImportError as missing:
    raise MissingExtraError("render", "view", "mujoco") from missing

Image = NDArray[np.uint8]
"""A picture (H, W, 3), red, green, blue."""

PATH_RADIUS, PATH_POINTS = 0.0035, 48
LIGHT_RADIUS, LIGHT_DIRECTIONS = 0.012, 6  # rad, half the angle that the light fills; samples on its edge
SAMPLES = 2  # pixels per pixel along each edge; the picture is the mean of them


class NoGraphicsError(TakeapartError):
    """There is no OpenGL to draw with."""

    def __init__(self, cause: str) -> None:
        super().__init__(
            f"no OpenGL to draw with ({cause}); on a machine without a screen install Mesa's EGL (Debian and Ubuntu: "
            "apt install libegl1 libgl1-mesa-dri), or set MUJOCO_GL=osmesa or MUJOCO_GL=glfw"
        )


@dataclass(frozen=True)
class RenderOptions:
    """How a picture is made.

    Args:
        width, height: pixels.
        view: name of a view, see `takeapart.render_scene.DIRECTIONS`.
        robot: whether the arm is drawn.
        path: whether the tool path of the current step is drawn.
        laid_out: whether removed parts lie beside the assembly; otherwise they are hidden.
        soft: whether shadows have soft edges, which takes several times as long.
    """

    width: int = 1200
    height: int = 900
    view: str = "corner"
    robot: bool = True
    path: bool = True
    laid_out: bool = False
    soft: bool = False


class Renderer:
    """Draws moments of one scene. Use it as a context manager: it holds memory of the graphics driver.

    Raises:
        NoGraphicsError: there is no OpenGL.
    """

    def __init__(self, scene: PlanScene, options: RenderOptions = RenderOptions()) -> None:
        self.scene, self.options = scene, options
        self._model = _specification(scene, options).compile()
        self._data = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, self._data)
        body = {self._model.body(b).name: b for b in range(self._model.nbody)}
        mocap = self._model.body_mocapid
        self._parts = [int(mocap[body[f"part/{part.name}"]]) for part in scene.assembly.parts]
        self._part_geoms = [_geoms(self._model, body[f"part/{part.name}"]) for part in scene.assembly.parts]
        self._links = [int(mocap[body[f"link/{i}"]]) for i in range(len(scene.robot.links))] if options.robot else []
        self._plain = self._model.geom_rgba.copy()
        try:
            _choose_graphics()
            self._renderer = mujoco.Renderer(self._model, options.height * SAMPLES, options.width * SAMPLES)
        except Exception as error:  # MuJoCo and the loaders of OpenGL raise whatever they like
            raise NoGraphicsError(str(error).strip().split("\n")[0] or type(error).__name__) from error
        self.view = view_of(scene, options.view, options.robot, options.width / options.height)

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, *_: object) -> None:
        self._renderer.close()

    def picture(self, moment: Moment | None = None, view: View | None = None) -> Image:
        """One picture: of a moment of the plan, or of the whole assembly with the arm at rest."""
        self._pose(moment)
        mujoco.mj_kinematics(self._model, self._data)
        self._renderer.update_scene(self._data, _camera(self._model, view or self.view))
        if moment is not None and self.options.path:
            self._draw_path(np.asarray(self.scene.steps[moment.step].tool_path)[:, :3])
        pixels = self._pixels()
        # Sums of every other row and column: ten times as fast as a reduction over axes of two.
        rows = functools.reduce(np.add, (pixels[k::SAMPLES] for k in range(SAMPLES)))
        total = functools.reduce(np.add, (rows[:, k::SAMPLES] for k in range(SAMPLES)))
        return np.asarray(total // SAMPLES**2, dtype=np.uint8)

    def _pixels(self) -> NDArray[np.uint16]:
        """The scene in all samples; where shadows are soft, the mean over directions of the light that casts them."""
        if not self.options.soft:
            return self._renderer.render().astype(np.uint16)
        drawn = self._renderer.scene
        casting = [drawn.lights[k] for k in range(drawn.nlight) if drawn.lights[k].castshadow]
        directions = [np.array(light.dir, dtype=float) for light in casting]
        total: NDArray[np.uint16] = np.zeros(1, dtype=np.uint16)
        for turn in np.arange(LIGHT_DIRECTIONS) * 2 * np.pi / LIGHT_DIRECTIONS:
            for light, direction in zip(casting, directions, strict=True):
                across = np.cross(direction, (0.0, 0.0, 1.0))
                across /= np.linalg.norm(across)
                aside = np.cos(turn) * across + np.sin(turn) * np.cross(direction, across)
                light.dir = direction + LIGHT_RADIUS * aside
            total = total + self._renderer.render()
        return total // LIGHT_DIRECTIONS

    def _pose(self, moment: Moment | None) -> None:
        scene, model = self.scene, self._model
        model.geom_rgba[:] = self._plain
        for i, part in enumerate(scene.assembly.parts):
            T, shown = part.T_world_part, True
            if moment is not None and i == moment.held:
                T = moment.T_world_held
                color = rgb(CURRENT)
                for k, geom in enumerate(self._part_geoms[i]):
                    model.geom_rgba[geom, :3] = color if k < len(part.shape.boxes()) else darker(color)
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
        chosen = points[np.unique(np.linspace(0, len(points) - 1, PATH_POINTS).astype(int))]
        for start, end in itertools.pairwise(chosen):
            if drawn.ngeom >= drawn.maxgeom or np.linalg.norm(end - start) < 1e-5:
                continue
            geom = drawn.geoms[drawn.ngeom]
            rgba = np.array([*rgb(PATH), 1.0], dtype=np.float32)
            kind = mujoco.mjtGeom.mjGEOM_CAPSULE
            mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.zeros(9), rgba)
            mujoco.mjv_connector(geom, kind, PATH_RADIUS, start, end)
            geom.emission = 0.5
            drawn.ngeom += 1


def _choose_graphics() -> None:
    """Without a screen, and where nobody said otherwise, EGL. MuJoCo chooses when it is imported, which may have been
    for another purpose, so it is made to choose again."""
    if sys.platform.startswith("linux") and not os.environ.get("DISPLAY") and not os.environ.get("MUJOCO_GL"):
        os.environ["MUJOCO_GL"] = "egl"
        importlib.reload(importlib.import_module("mujoco.rendering.classic.gl_context"))


def _geoms(model: Any, body: int) -> list[int]:
    first = int(model.body_geomadr[body])
    return list(range(first, first + int(model.body_geomnum[body])))


def _camera(model: Any, view: View) -> Any:
    model.vis.global_.fovy = np.degrees(view.field)
    camera = mujoco.MjvCamera()
    camera.lookat, camera.distance = view.target, view.distance
    forward = view.direction
    camera.azimuth = np.degrees(np.arctan2(forward[1], forward[0]))
    camera.elevation = np.degrees(np.arcsin(np.clip(forward[2], -1, 1)))
    return camera


def _specification(scene: PlanScene, options: RenderOptions) -> Any:
    """Everything as bodies that are placed by hand (MuJoCo calls them mocap bodies); nothing collides."""
    spec = mujoco.MjSpec()
    spec.visual.global_.offwidth, spec.visual.global_.offheight = options.width * SAMPLES, options.height * SAMPLES
    spec.visual.quality.shadowsize, spec.visual.quality.offsamples = _shadow_texels(options), 0
    spec.visual.map.znear, spec.visual.map.zfar = 0.02, 40.0
    spec.visual.map.shadowclip = 1.6
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.45] * 3, [0.28] * 3
    spec.visual.headlight.specular = [0.05] * 3
    sky = spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=64, height=384)
    sky.builtin = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    sky.rgb1, sky.rgb2 = [0.95, 0.96, 0.98], [0.99, 0.99, 1.0]
    world = spec.worldbody
    low, high = scene.bounds
    middle = (low + high) / 2
    for offset, light, shadow in (([-0.8, -1.4, 2.6], 0.42, True), ([1.2, 1.0, 1.8], 0.12, False)):
        position = middle + offset
        added = world.add_light(pos=position, dir=middle - position, diffuse=[light] * 3, castshadow=shadow)
        added.specular = [0.12] * 3
        added.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    for obstacle in scene.workcell.environment:
        top = obstacle.box.corners()[:, 2].max()
        if options.robot or top < low[2] + 0.01:  # without the arm, only what the assembly stands on
            _add_box(world, obstacle.box, rgb(STEEL))
    colors = [rgb(color) for color in scene.colors]
    for i, part in enumerate(scene.assembly.parts):
        body = world.add_body(name=f"part/{part.name}", mocap=True)
        own = len(part.shape.boxes())
        for k, box in enumerate(scene.assembly.body(i)):
            _add_box(body, box, colors[i] if k < own else darker(colors[i]))
    if options.robot:
        _add_robot(spec, scene.robot)
        world.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.012, 0, 0], pos=scene.workcell.goal, rgba=[*rgb(GOAL), 1.0]
        )
    return spec


def _shadow_texels(options: RenderOptions) -> int:
    """Along an edge of the picture of shadows; a small picture does not show more, and an animation has hundreds."""
    return 4096 if max(options.width, options.height) > 800 else 2048


def _add_box(body: Any, box: OrientedBox, color: Color) -> None:
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=box.half_extents,
        pos=box.T_frame_box[:3, 3],
        quat=quaternion_from_rotation(box.T_frame_box[:3, :3]),
        rgba=[*color, 1.0],
        contype=0,
        conaffinity=0,
    )


def _add_robot(spec: Any, robot: RobotVisual) -> None:
    for number, link in enumerate(robot.links):
        body = spec.worldbody.add_body(name=f"link/{number}", mocap=True)
        for k, mesh in enumerate(link.meshes):
            name = f"mesh/{number}/{k}"
            added = spec.add_mesh(name=name)
            added.uservert, added.userface = mesh.vertices.ravel(), mesh.faces.ravel()
            added.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # open meshes have no volume
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, rgba=[*mesh.color, 1.0], contype=0, conaffinity=0
            )


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
    with Renderer(scene, options) as renderer:
        for step in chosen:
            fractions = np.linspace(0.0, 1.0, frames)
            for fraction in fractions if scene.direction == "disassembly" else fractions[::-1]:
                yield renderer.picture(scene.moment(step, float(fraction)))
