"""The arm as it looks: meshes of its links from URDF, and where the links are at a configuration.

For pictures only. The planner has kinematics of its own (`takeapart.robot`), and so has the verification.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from takeapart.caching import cache_folder
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, OrientedBox, pose
from takeapart.workcell import RobotDescription

if TYPE_CHECKING:
    import trimesh  # loaded where a file is read: the cache spares that

CELL = 0.004  # m, details of meshes below this are merged
BROWSER_CELL = 0.006  # m, the same in browsers
PLAIN = (0.85, 0.86, 0.88)  # colour of geometry without one


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of one colour.

    Args:
        vertices: (V, 3) float32, m.
        faces: (F, 3) int32, anticlockwise seen from outside.
        color: red, green, blue from 0 to 1.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    color: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class LinkVisual:
    """One link: how it hangs on its parent, and what it looks like.

    Args:
        name: of the link.
        parent: number of the parent in `RobotVisual.links`; -1 for the base.
        T_parent_joint: (4, 4), at position zero of the joint.
        joint: number of the arm's joint that moves it, -1 for none; -2 for a joint of a finger.
        slides: whether the joint is prismatic.
        axis: (3,) unit vector of the joint in its own frame.
        meshes: in the link's frame.
    """

    name: str
    parent: int
    T_parent_joint: Array
    joint: int
    slides: bool
    axis: Array
    meshes: tuple[Mesh, ...]


FINGER = -2


@dataclass(frozen=True, eq=False)
class RobotVisual:
    """All links of an arm with its gripper, parents first.

    Args:
        description: where the robot's files are.
        T_world_base: (4, 4).
        hand: number of the link that carries the tool frame.
        links: parents first.
    """

    description: RobotDescription
    T_world_base: Array
    hand: int
    links: tuple[LinkVisual, ...]

    def poses(self, configuration: Array, opening: float) -> Array:
        """Poses (L, 4, 4) of all links in the world, at joint angles (n,), rad, and an opening of the fingers, m."""
        T = np.empty((len(self.links), 4, 4))
        for number, link in enumerate(self.links):
            parent = self.T_world_base if link.parent < 0 else T[link.parent]
            T[number] = parent @ link.T_parent_joint
            if link.joint == -1:
                continue
            position = opening / 2 if link.joint == FINGER else float(configuration[link.joint])
            if link.slides:
                T[number, :3, 3] += T[number, :3, :3] @ (link.axis * position)
            else:
                half = position / 2
                T[number] = T[number] @ pose(quaternion=(np.cos(half), *(np.sin(half) * link.axis)))
        return T

    def merged_vertices(self, cell: float) -> list[Array]:
        """Per link points (C, 3), m, in its frame: the mean of its meshes' vertices in every cell of a grid."""
        every = [np.concatenate([np.zeros((0, 3)), *(mesh.vertices for mesh in link.meshes)]) for link in self.links]
        return [merged(vertices, cell)[0] if len(vertices) else vertices for vertices in every]

    def tool_pose(self, configuration: Array) -> Array:
        """Pose (4, 4) of the tool in the world."""
        T_hand_tool = np.eye(4)
        T_hand_tool[:3, 3] = self.description.T_hand_tool
        return np.asarray(self.poses(configuration, 0.0)[self.hand] @ T_hand_tool)


def load_robot_visual(description: RobotDescription, T_world_base: Array) -> RobotVisual:
    """The look of a robot.

    Raises:
        InputError: its files are missing, or its links hang on each other in a way that is not understood.
    """
    urdf = ElementTree.parse(description.path(description.urdf)).getroot()
    joints = {_child(joint, "child", "link"): joint for joint in urdf.findall("joint")}
    elements = {str(link.get("name")): link for link in urdf.findall("link")}
    order = [description.base_link]
    for name in order:
        order += [child for child, joint in joints.items() if _child(joint, "parent", "link") == name]
    missing = [link for link in description.hand_links if link not in order]
    if missing:
        raise InputError(f"link {missing[0]!r} does not hang on {order[0]!r}", f"{description.name}: links")
    number = {name: i for i, name in enumerate(order)}
    links = tuple(_link(name, elements[name], joints.get(name), number, description) for name in order)
    return RobotVisual(description, T_world_base, number[description.hand_links[0]], links)


def _link(
    name: str,
    element: ElementTree.Element,
    joint: ElementTree.Element | None,
    number: dict[str, int],
    description: RobotDescription,
) -> LinkVisual:
    meshes = _meshes(element, description)
    if joint is None or name == description.base_link:
        return LinkVisual(name, -1, np.eye(4), -1, False, np.array([0.0, 0.0, 1.0]), meshes)
    joint_name, kind = str(joint.get("name")), joint.get("type")
    moving = -1
    if joint_name in description.arm_joints:
        moving = description.arm_joints.index(joint_name)
    elif joint_name in description.finger_joints:
        moving = FINGER
    axis = _numbers(_child(joint, "axis", "xyz") or "1 0 0")
    parent = number[_child(joint, "parent", "link")]
    return LinkVisual(name, parent, _origin(joint), moving, kind == "prismatic", axis / np.linalg.norm(axis), meshes)


def _child(element: ElementTree.Element, child: str, attribute: str) -> str:
    found = element.find(child)
    return "" if found is None else found.get(attribute, "")


def _numbers(text: str) -> Array:
    return np.array([float(number) for number in text.split()])


def _origin(element: ElementTree.Element) -> Array:
    """Pose (4, 4) of the element's <origin>."""
    roll, pitch, yaw = _numbers(_child(element, "origin", "rpy") or "0 0 0")
    T = np.eye(4)
    for angle, axis in ((yaw, (0, 0, 1)), (pitch, (0, 1, 0)), (roll, (1, 0, 0))):
        T = T @ pose(quaternion=(np.cos(angle / 2), *(np.sin(angle / 2) * np.array(axis))))
    T[:3, 3] = _numbers(_child(element, "origin", "xyz") or "0 0 0")
    return T


def _meshes(link: ElementTree.Element, description: RobotDescription) -> tuple[Mesh, ...]:
    """Of the visual geometry; of the collision geometry where there is no reader for the visual one's files."""
    found: list[Mesh] = []
    for element in link.findall("visual"):
        file = _child(element, "geometry/mesh", "filename")
        if file.endswith(".dae") and importlib.util.find_spec("collada") is None:
            elements = link.findall("collision")
            return tuple(mesh for other in elements for mesh in _geometry(other, description))
        found += _geometry(element, description)
    return tuple(found)


def _geometry(element: ElementTree.Element, description: RobotDescription) -> list[Mesh]:
    T = _origin(element)
    geometry = element.find("geometry")
    shape = geometry[0] if geometry is not None and len(geometry) else None
    if shape is None:
        return []
    if shape.tag == "mesh":
        T[:3, :3] *= _numbers(shape.get("scale", "1 1 1"))
        found = _file_meshes(description.resolve(shape.get("filename", "")))
    else:
        found = _primitive(shape)
    moved = [np.asarray(mesh.vertices @ T[:3, :3].T + T[:3, 3], dtype=np.float32) for mesh in found]
    return [Mesh(vertices, mesh.faces, mesh.color) for vertices, mesh in zip(moved, found, strict=True)]


def _primitive(shape: ElementTree.Element) -> list[Mesh]:
    """A box, a cylinder or a sphere; nothing for what is none of them."""
    import trimesh.creation

    if shape.tag == "box":
        mesh = trimesh.creation.box(_numbers(shape.get("size", "1 1 1")))
    elif shape.tag == "cylinder":
        mesh = trimesh.creation.cylinder(float(shape.get("radius", 1)), float(shape.get("length", 1)))
    elif shape.tag == "sphere":
        mesh = trimesh.creation.icosphere(2, float(shape.get("radius", 1)))
    else:
        return []
    return [Mesh(np.asarray(mesh.vertices, dtype=np.float32), np.asarray(mesh.faces, dtype=np.int32), PLAIN)]


def _file_meshes(path: Path) -> list[Mesh]:
    """Meshes of a file, simplified; kept in the cache folder by the file's content."""
    digest = hashlib.sha256(path.read_bytes()).hexdigest()[:24]
    file = cache_folder() / f"look-1-{digest}-{CELL * 1e4:.0f}.npz"
    if file.is_file():
        try:
            with np.load(file, allow_pickle=False) as kept:
                return [
                    Mesh(kept[f"vertices{i}"], kept[f"faces{i}"], tuple(kept["colors"][i].tolist()))
                    for i in range(len(kept["colors"]))
                ]
        except (OSError, ValueError, KeyError):
            pass  # a damaged cache is made again
    found = _read_meshes(path)
    arrays = {"colors": np.array([mesh.color for mesh in found])}
    for i, mesh in enumerate(found):
        arrays |= {f"vertices{i}": mesh.vertices, f"faces{i}": mesh.faces}
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        temporary = file.with_suffix(f".{os.getpid()}.npz")
        np.savez_compressed(temporary, allow_pickle=False, **arrays)
        temporary.replace(file)
    except OSError:
        pass  # without a place for the cache the meshes are made again next time
    return found


def _read_meshes(path: Path) -> list[Mesh]:
    """One simplified mesh per colour of a file."""
    import trimesh

    by_color: dict[tuple[float, float, float], list[trimesh.Trimesh]] = {}
    loaded = trimesh.load_scene(path).dump()
    for mesh in loaded if isinstance(loaded, list) else [loaded]:
        if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
            by_color.setdefault(_color(mesh), []).append(mesh)
    found = [simplified(*_joined(meshes), color) for color, meshes in by_color.items()]
    return [mesh for mesh in found if len(mesh.faces)]


def _joined(meshes: list[trimesh.Trimesh]) -> tuple[Array, NDArray[np.int32]]:
    """Vertices (V, 3), m, and faces (F, 3) of all meshes."""
    offsets = np.cumsum([0, *[len(mesh.vertices) for mesh in meshes]])
    faces = [np.asarray(mesh.faces) + offset for mesh, offset in zip(meshes, offsets, strict=False)]
    vertices = np.concatenate([np.asarray(mesh.vertices) for mesh in meshes])
    return vertices, np.concatenate(faces).astype(np.int32)


def _color(mesh: trimesh.Trimesh) -> tuple[float, float, float]:
    material = getattr(mesh.visual, "material", None)
    if material is None:
        return PLAIN
    red, green, blue = (float(value) / 255 for value in material.main_color[:3])
    return red, green, blue


def coarser(mesh: Mesh, cell: float) -> Mesh:
    """The same mesh with less detail, for browsers and animations; cell in m."""
    return simplified(np.asarray(mesh.vertices, dtype=float), mesh.faces, mesh.color, cell)


def simplified(
    vertices: Array, faces: NDArray[np.int32], color: tuple[float, float, float], cell: float = CELL
) -> Mesh:
    """Vertices in one cell of a grid become one, their mean (Rossignac and Borrel 1993)."""
    points, owner = merged(vertices, cell)
    kept = owner[faces]
    kept = kept[(kept[:, 0] != kept[:, 1]) & (kept[:, 1] != kept[:, 2]) & (kept[:, 2] != kept[:, 0])]
    _, first = np.unique(np.sort(kept, axis=1), axis=0, return_index=True)
    used, kept = np.unique(kept[np.sort(first)], return_inverse=True)
    return Mesh(points[used].astype(np.float32), kept.reshape(-1, 3).astype(np.int32), color)


def merged(vertices: Array, cell: float) -> tuple[Array, NDArray[np.int64]]:
    """The means (C, 3) of vertices (V, 3) in one cell of a grid, m, and which of them each vertex belongs to (V,)."""
    cells = np.floor((vertices - vertices.min(axis=0)) / cell).astype(np.int64)
    _, owner = np.unique(np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1)), return_inverse=True)
    count = np.bincount(owner)
    return np.column_stack([np.bincount(owner, weights=vertices[:, k]) / count for k in range(3)]), owner


def box_mesh(boxes: Sequence[OrientedBox]) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Vertices (24 B, 3) float32, m, and faces (12 B, 3) of boxes, faces with corners of their own."""
    quads = np.array(  # corners of `OrientedBox.corners`, anticlockwise seen from outside
        [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    )
    vertices = np.concatenate([box.corners()[quads.ravel()] for box in boxes])
    first = 4 * np.arange(6 * len(boxes))[:, None]
    faces = np.concatenate([first + [0, 1, 2], first + [0, 2, 3]])
    return vertices.astype(np.float32), faces.astype(np.int32)
