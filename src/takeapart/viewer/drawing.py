"""What stands in the scene of the viewer: parts with their connectors, the arm, obstacles, light."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from takeapart.model.geometry import Array, quaternion_from_rotation
from takeapart.show.robot import BROWSER_CELL, box_mesh, coarser
from takeapart.show.scene import GOAL, STEEL, Color, PlanScene, darker, rgb
from takeapart.show.surfaces import creased
from takeapart.show.view import view_of

PANEL_SHARE = 0.11  # of the camera's distance, by which everything is shifted to the left


@dataclass(eq=False)
class Nodes:
    """Handles of the scene. Every part is a frame with its own body and its connectors below it."""

    frames: list[Any] = field(default_factory=list)
    bodies: list[list[Any]] = field(default_factory=list)
    links: list[Any] = field(default_factory=list)
    paths: dict[int, Any] = field(default_factory=dict)  # made when they are first seen


def draw_light(server: Any, scene: PlanScene) -> None:
    """Camera and light."""
    view = view_of(scene)
    api = server.scene
    aside = PANEL_SHARE * view.distance * np.cross(view.direction, [0.0, 0.0, 1.0])  # the panel hides the right
    server.initial_camera.position = view.position + aside
    server.initial_camera.look_at = view.target + aside
    server.initial_camera.up = (0.0, 0.0, 1.0)
    server.initial_camera.fov = view.field
    api.configure_default_lights(enabled=False)
    api.add_light_hemisphere("/light/sky", sky_color=(255, 255, 255), ground_color=(190, 195, 205), intensity=1.6)
    low, high = scene.bounds
    position = (low + high) / 2 + view.beside_camera(np.array([-0.8, -1.4, 2.6]))
    api.add_light_directional("/light/sun", intensity=1.7, position=tuple(position), cast_shadow=False)


def draw_scene(server: Any, scene: PlanScene, on_click: Callable[[int], Callable[[Any], None]]) -> Nodes:
    """Everything that stands in the scene. Nodes bear numbers: names of files may hold what a path of nodes may not.

    Args:
        on_click: makes what hears of clicks on a part.
    """
    api, nodes = server.scene, Nodes()
    for number, obstacle in enumerate(scene.workcell.environment):
        box = obstacle.box
        handle = api.add_box(f"/environment/{number}", as_bytes(rgb(STEEL)), tuple(2 * box.half_extents))
        move(handle, box.T_frame_box)
    for i, part in enumerate(scene.assembly.parts):
        frame = api.add_frame(f"/parts/{i}", show_axes=False)
        move(frame, part.T_world_part)
        bodies = []
        for name, vertices, faces, shade, is_flat in _bodies(scene, i):
            mesh = api.add_mesh_simple(
                f"/parts/{i}/{name}", vertices, faces, color=as_bytes(shade), flat_shading=is_flat, side="double"
            )
            mesh.on_click(on_click(i))
            bodies.append(mesh)
        nodes.frames.append(frame)
        nodes.bodies.append(bodies)
    for number, link in enumerate(scene.robot.links):
        nodes.links.append(api.add_frame(f"/robot/{number}", show_axes=False))
        for k, mesh_of in enumerate(coarser(mesh, BROWSER_CELL) for mesh in link.meshes):
            vertices, _, faces = creased(mesh_of.vertices, mesh_of.faces)
            api.add_mesh_simple(f"/robot/{number}/{k}", vertices, faces, color=as_bytes(mesh_of.color), side="double")
    api.add_icosphere("/goal", 0.012, as_bytes(rgb(GOAL)), position=tuple(scene.workcell.goal))
    return nodes


def _bodies(scene: PlanScene, part: int) -> Iterator[tuple[str, NDArray[np.float32], NDArray[np.int32], Color, bool]]:
    """What is drawn of a part: name, vertices, faces, colour, and whether its triangles are flat. Sharp edges of meshes
    have vertices of their own for each side; normals are made in the browser."""
    surface, (own, walls), color = scene.surface(part), scene.boxes(part), rgb(scene.colors[part])
    if surface is not None:
        yield "shape", surface.vertices, surface.faces, color, False
    for name, boxes, shade in (("boxes", own, color), ("connectors", walls, darker(color))):
        if boxes:
            yield (name, *box_mesh(boxes), shade, True)


def move(handle: Any, T: Array) -> None:
    """Put a node at a pose (4, 4)."""
    handle.position, handle.wxyz = T[:3, 3], quaternion_from_rotation(T[:3, :3])


def as_bytes(color: Color) -> tuple[int, int, int]:
    """A colour from 0 to 255."""
    red, green, blue = (round(255 * value) for value in color)
    return red, green, blue
