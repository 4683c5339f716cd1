"""What MuJoCo draws: a model of the scene, of bodies that are placed by hand, and how finely it is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from takeapart.model.errors import MissingExtraError
from takeapart.model.geometry import Array, OrientedBox, quaternion_from_rotation
from takeapart.show.robot import BROWSER_CELL, Mesh, RobotVisual, box_mesh, coarser
from takeapart.show.scene import GOAL, STEEL, Color, PlanScene, darker, rgb
from takeapart.show.view import View

try:
    import mujoco
except ImportError as missing:
    raise MissingExtraError("render", "view", "mujoco") from missing

SAMPLES, MOVING_SAMPLES = 2.0, 1.25  # pixels per pixel along each edge; the picture is the mean of them
SHADOW_MARGIN = 0.25  # m, around the middles of links and the corners of parts


@dataclass(frozen=True)
class RenderOptions:
    """How a picture is made.

    Args:
        width, height: pixels.
        view: name of a view, see `takeapart.show.directions.DIRECTIONS`.
        robot: whether the arm is drawn.
        path: whether the tool path of the current step is drawn.
        laid_out: whether removed parts lie beside the assembly; otherwise they are hidden.
        soft: whether shadows have soft edges, which takes several times as long.
        moving: whether it is one of hundreds that are seen for a moment each: coarser, in a third of the time.
    """

    width: int = 1200
    height: int = 900
    view: str = "corner"
    robot: bool = True
    path: bool = True
    laid_out: bool = False
    soft: bool = False
    moving: bool = False

    @property
    def drawn_width(self) -> int:
        """Samples in a row."""
        return round(self.width * self._samples)

    @property
    def drawn_height(self) -> int:
        """Samples in a column."""
        return round(self.height * self._samples)

    @property
    def _samples(self) -> float:
        return MOVING_SAMPLES if self.moving else SAMPLES

    @property
    def shadow_texels(self) -> int:
        """Along an edge of the picture of shadows; a small picture does not show more."""
        return 512 if self.moving else 4096 if max(self.width, self.height) > 800 else 2048


PICTURE = RenderOptions()


def lit_spec(options: RenderOptions, middle: Array, view: View | None) -> Any:
    """Sky and light, and how finely it is drawn.

    Args:
        middle: (3,) m, which the light points at.
        view: over whose left shoulder the light comes; None for that of who looks from "corner".
    """
    spec = mujoco.MjSpec()
    spec.visual.global_.offwidth, spec.visual.global_.offheight = options.drawn_width, options.drawn_height
    spec.visual.quality.shadowsize, spec.visual.quality.offsamples = options.shadow_texels, 0
    if options.moving:  # balls and capsules of few triangles
        spec.visual.quality.numslices, spec.visual.quality.numstacks, spec.visual.quality.numquads = 8, 4, 1
    spec.visual.map.znear, spec.visual.map.zfar = 0.02, 40.0
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.45] * 3, [0.28] * 3
    spec.visual.headlight.specular = [0.05] * 3
    sky = spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=64, height=384)
    sky.builtin = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    sky.rgb1, sky.rgb2 = [0.95, 0.96, 0.98], [0.99, 0.99, 1.0]
    for offset, light, shadow in (([-0.8, -1.4, 2.6], 0.42, True), ([1.2, 1.0, 1.8], 0.12, False)):
        position = middle + (np.array(offset) if view is None else view.beside_camera(np.array(offset)))
        added = spec.worldbody.add_light(pos=position, dir=middle - position, diffuse=[light] * 3, castshadow=shadow)
        added.specular = [0.12] * 3
        added.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    return spec


def compiled_model(scene: PlanScene, options: RenderOptions, view: View) -> Any:
    """Everything as bodies that are placed by hand (MuJoCo calls them mocap bodies); nothing collides.

    A part is a body ``part/NAME`` with one geometry for its shape and, where it has connectors, one for them. The light
    comes over the left shoulder of who looks from the view.
    """
    low, high = scene.bounds
    middle = (low + high) / 2
    spec = lit_spec(options, middle, view if options.view == "corner" else None)
    world = spec.worldbody
    for obstacle in scene.workcell.environment:
        top = obstacle.box.corners()[:, 2].max()
        if options.robot or top < low[2] + 0.01:  # without the arm, only what the assembly stands on
            _add_box(world, obstacle.box, rgb(STEEL))
    for i, part in enumerate(scene.assembly.parts):
        body = world.add_body(name=f"part/{part.name}", mocap=True)
        surface, (own, walls), color = scene.surface(i), scene.boxes(i), rgb(scene.colors[i])
        if surface is not None:
            add_mesh(spec, body, f"shape/{i}", surface.vertices, surface.faces, color, surface.normals)
        for name, boxes, shade in (("boxes", own, color), ("connectors", walls, darker(color))):
            if boxes:
                _add_boxes(spec, body, f"{name}/{i}", boxes, shade)
    if options.robot:
        _add_robot(spec, scene.robot, options)
        world.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.012, 0, 0], pos=scene.workcell.goal, rgba=[*rgb(GOAL), 1.0]
        )
    model = spec.compile()
    points = scene.reached if options.robot else np.array([low, high])
    reach = float(np.linalg.norm(points - middle, axis=1).max()) + SHADOW_MARGIN
    model.vis.map.shadowclip = reach / model.stat.extent  # nothing that throws one stands farther away
    return model


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


def _add_boxes(spec: Any, body: Any, name: str, boxes: Sequence[OrientedBox], color: Color) -> None:
    """Boxes of one colour; several are one mesh, since OpenGL in software spends more on each geometry than on its
    triangles."""
    if len(boxes) == 1:
        _add_box(body, boxes[0], color)
    else:
        add_mesh(spec, body, name, *box_mesh(boxes), color)


def add_mesh(
    spec: Any,
    body: Any,
    name: str,
    vertices: NDArray[np.float32],
    faces: NDArray[np.int32],
    color: Color,
    normals: NDArray[np.float32] | None = None,
    alpha: float = 1.0,
) -> None:
    """A mesh as a geometry of a body; without normals MuJoCo makes them."""
    added = spec.add_mesh(name=name)
    added.uservert, added.userface = vertices.ravel(), faces.ravel()
    if normals is not None:
        added.usernormal, added.userfacenormal = normals.ravel(), faces.ravel()
    added.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # open meshes have no volume
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, rgba=[*color, alpha], contype=0, conaffinity=0)


def _add_robot(spec: Any, robot: RobotVisual, options: RenderOptions) -> None:
    for number, link in enumerate(robot.links):
        body = spec.worldbody.add_body(name=f"link/{number}", mocap=True)
        for k, mesh in enumerate(link.meshes):
            drawn: Mesh = coarser(mesh, BROWSER_CELL) if options.moving else mesh
            add_mesh(spec, body, f"mesh/{number}/{k}", drawn.vertices, drawn.faces, mesh.color)
