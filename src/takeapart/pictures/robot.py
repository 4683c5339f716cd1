"""An arm as it is described: its look, and around it in translucent colours what the planner takes it for."""

from __future__ import annotations

import mujoco
import numpy as np
import trimesh

from takeapart.model.geometry import Array
from takeapart.pictures.model import SHADOW_MARGIN, RenderOptions, add_mesh, lit_spec
from takeapart.pictures.renderer import Image, camera_of, drawn_picture, opened_renderer
from takeapart.robot.kinematics import forward
from takeapart.robot.model import RobotModel
from takeapart.show.robot import box_mesh, load_robot_visual
from takeapart.show.scene import STEEL, rgb
from takeapart.show.surfaces import creased
from takeapart.show.view import framed

LINKS, PADS, KNUCKLES = "#2f6fb0", "#2e9e6b", "#d9822b"  # hulls; boxes of what may touch a part, and of what may not
SHEER = 0.28  # how opaque they are
LARGER = 0.002  # m, by which hulls are drawn larger than they are: where they touch the surface, neither would be seen
ROOM = 0.12  # m, of floor around the arm
AZIMUTH, ELEVATION = -50.0, 18.0  # degrees, from where it is seen


def bodies_at(model: RobotModel, configuration: Array) -> list[Array]:
    """Corners (V, 3), m, in the world of every convex body that the planner has for the arm."""
    work = model.workspace()
    forward(model.arm, np.asarray(configuration, dtype=float), work)
    return [hull.corners @ work.R[hull.frame].T + work.p[hull.frame] for hull in model.hulls]


def robot_picture(model: RobotModel, options: RenderOptions) -> Image:
    """The arm at home with its gripper open.

    Raises:
        NoGraphicsError: there is no OpenGL.
    """
    description = model.description
    home, opening = np.array(description.arm.home), description.maximum_opening
    visual = load_robot_visual(description, model.T_world_base)
    hulls = bodies_at(model, home)
    T_tool = model.tool_pose(home, opening=opening)
    pads, knuckles = model.gripper_boxes(opening)
    seen = np.vstack([*hulls, *(box.moved(T_tool).corners() for box in (*pads, *knuckles))])
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
    view = framed(seen, AZIMUTH, ELEVATION, options.width / options.height)
    spec = lit_spec(options, middle, view)
    world = spec.worldbody
    low, half = seen.min(axis=0), np.ptp(seen, axis=0) / 2 + ROOM
    floor = [*middle[:2], low[2] - 0.01]
    world.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, size=[*half[:2], 0.0095], pos=floor, rgba=[*rgb(STEEL), 1.0], contype=0
    )
    for number, (link, T) in enumerate(zip(visual.links, visual.poses(home, opening), strict=True)):
        for k, mesh in enumerate(link.meshes):
            vertices = (mesh.vertices @ T[:3, :3].T + T[:3, 3]).astype(np.float32)
            add_mesh(spec, world, f"link/{number}/{k}", vertices, mesh.faces, mesh.color)
    for number, corners in enumerate(hulls):
        hull = trimesh.convex.convex_hull(corners)
        vertices, normals, faces = creased(hull.vertices + LARGER * hull.vertex_normals, hull.faces)
        add_mesh(spec, world, f"hull/{number}", vertices, faces, rgb(LINKS), normals, SHEER)
    for name, boxes, color in (("pads", pads, PADS), ("knuckles", knuckles, KNUCKLES)):
        if boxes:
            add_mesh(spec, world, name, *box_mesh([box.moved(T_tool) for box in boxes]), rgb(color), alpha=SHEER)
    compiled = spec.compile()
    reach = float(np.linalg.norm(seen - middle, axis=1).max()) + SHADOW_MARGIN
    compiled.vis.map.shadowclip = reach / compiled.stat.extent
    data = mujoco.MjData(compiled)
    mujoco.mj_forward(compiled, data)
    with opened_renderer(compiled, options) as renderer:
        renderer.update_scene(data, camera_of(compiled, view))
        return drawn_picture(renderer, options)
