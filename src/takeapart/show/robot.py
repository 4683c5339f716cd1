"""The robot as it looks: meshes of its links from URDF, and where the links are at a configuration and an opening.

For pictures only. The planner has kinematics of its own (`takeapart.robot`), and so has the verification.
"""

from __future__ import annotations

import os
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from takeapart.caching import cache_folder, read_arrays
from takeapart.model.description import RobotDescription
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, OrientedBox, pose
from takeapart.robot.urdf import Geometry, Link, Urdf, read_urdf
from takeapart.robot.urdf.meshes import digest_of, geometry_meshes

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
        joint: number of the joint that moves it among `RobotVisual.values`; -1 for none.
        multiplier, offset: the joint stands at multiplier * value + offset, rad or m: some follow others.
        slides: whether the joint is prismatic.
        axis: (3,) unit vector of the joint in its own frame.
        meshes: in the link's frame.
    """

    name: str
    parent: int
    T_parent_joint: Array
    joint: int
    multiplier: float
    offset: float
    slides: bool
    axis: Array
    meshes: tuple[Mesh, ...]


@dataclass(frozen=True, eq=False)
class RobotVisual:
    """All links of an arm with its gripper, parents first.

    Args:
        description: where the robot's files are.
        T_world_base: (4, 4).
        hand: number of the gripper's base link, which carries the held part.
        links: parents first.
    """

    description: RobotDescription
    T_world_base: Array
    hand: int
    links: tuple[LinkVisual, ...]

    def values(self, configuration: Array, opening: float) -> Array:
        """Positions of the joints that links name: of the arm (n,), rad, then those that an opening, m, sets in the
        gripper, rad or m."""
        gripper = self.description.gripper
        positions = gripper.joint_positions(opening)
        return np.array([*configuration, *(positions[name] for name in gripper.joints)], dtype=float)

    def poses(self, configuration: Array, opening: float) -> Array:
        """Poses (L, 4, 4) of all links in the world, at joint angles (n,), rad, and an opening of the fingers, m."""
        values = self.values(configuration, opening)
        T = np.empty((len(self.links), 4, 4))
        for number, link in enumerate(self.links):
            parent = self.T_world_base if link.parent < 0 else T[link.parent]
            T[number] = parent @ link.T_parent_joint
            if link.joint < 0:
                continue
            position = link.multiplier * values[link.joint] + link.offset
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

    def hand_pose(self, configuration: Array) -> Array:
        """Pose (4, 4) of the gripper's base link in the world; the opening does not move it."""
        return np.asarray(self.poses(configuration, 0.0)[self.hand])

    def tool_pose(self, configuration: Array, opening: float) -> Array:
        """Pose (4, 4) of the tool in the world at an opening, m."""
        return np.asarray(self.hand_pose(configuration) @ self.description.gripper.T_base_tool(opening))


def load_robot_visual(description: RobotDescription, T_world_base: Array) -> RobotVisual:
    """The look of a robot.

    Raises:
        InputError: its files are missing, or do not hold the links that the description names.
    """
    arm, gripper = description.arm, description.gripper
    urdf, hand = read_urdf(arm.files), read_urdf(gripper.files)
    cut = frozenset(arm.left_out) | ({gripper.base_link} if hand.files.urdf == urdf.files.urdf else frozenset())
    links: list[LinkVisual] = []
    _hang(links, urdf, urdf.subtree(arm.base_link, cut), arm.joints, 0)
    names = [link.name for link in links]
    if arm.flange_link not in names:
        raise InputError(f"link {arm.flange_link!r} does not hang on {arm.base_link!r}", urdf.where)
    number = len(links)
    _hang(links, hand, hand.subtree(gripper.base_link), gripper.joints, len(arm.joints))
    mounted = replace(links[number], parent=names.index(arm.flange_link), T_parent_joint=description.T_flange_gripper)
    links[number] = mounted
    return RobotVisual(description, T_world_base, number, tuple(links))


def _hang(links: list[LinkVisual], urdf: Urdf, names: Sequence[str], joints: Sequence[str], first: int) -> None:
    """Adds links of a file, the first of which hangs on nothing; its joints are numbered from `first`. Joints that are
    not named and follow none of them stand at zero."""
    number = {name: len(links) + i for i, name in enumerate(names)}
    z = np.array([0.0, 0.0, 1.0])
    links.append(LinkVisual(names[0], -1, np.eye(4), -1, 1.0, 0.0, False, z, _meshes(urdf, urdf.links[names[0]])))
    for name in names[1:]:
        joint = urdf.above[name]
        driver = urdf.driver(joint.name)
        moving = first + joints.index(driver) if joint.kind != "fixed" and driver in joints else -1
        offset = urdf.value(joint.name, {driver: 0.0})
        multiplier = urdf.value(joint.name, {driver: 1.0}) - offset
        meshes = _meshes(urdf, urdf.links[name])
        slides = joint.kind == "prismatic"
        links.append(
            LinkVisual(
                name, number[joint.parent], joint.T_parent, moving, multiplier, offset, slides, joint.axis, meshes
            )
        )


def _meshes(urdf: Urdf, link: Link) -> tuple[Mesh, ...]:
    """Of the visual geometry; of the collision geometry where there is none, or its files cannot be read."""
    try:
        return tuple(mesh for shape in link.visuals or link.collisions for mesh in _shape_meshes(urdf, shape))
    except InputError:
        if not link.visuals:
            raise
        return tuple(mesh for shape in link.collisions for mesh in _shape_meshes(urdf, shape))


def _shape_meshes(urdf: Urdf, shape: Geometry) -> list[Mesh]:
    found = _simplified_meshes(urdf, replace(shape, T_link=np.eye(4), color=None))
    R, p = shape.T_link[:3, :3], shape.T_link[:3, 3]
    moved = [np.asarray(mesh.vertices @ R.T + p, dtype=np.float32) for mesh in found]
    return [Mesh(vertices, mesh.faces, shape.color or mesh.color) for vertices, mesh in zip(moved, found, strict=True)]


def _simplified_meshes(urdf: Urdf, shape: Geometry) -> list[Mesh]:
    """A shape in its own frame, scaled, one mesh for each colour. What comes from files is simplified, and kept in the
    cache folder by the file's content."""
    if shape.kind != "mesh":
        return [
            Mesh(np.asarray(mesh.vertices, dtype=np.float32), mesh.faces.astype(np.int32), PLAIN)
            for mesh in geometry_meshes(urdf, shape)
        ]
    scale = "" if shape.size == (1.0, 1.0, 1.0) else "-" + "-".join(f"{factor:g}" for factor in shape.size)
    file = cache_folder() / f"look-2-{digest_of(urdf.files.resolve(shape.uri))[:24]}-{CELL * 1e4:.0f}{scale}.npz"
    if file.is_file():
        try:
            kept = read_arrays(file)
            return [
                Mesh(kept[f"vertices{i}"], kept[f"faces{i}"], tuple(kept["colors"][i].tolist()))
                for i in range(len(kept["colors"]))
            ]
        except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
            pass  # a damaged cache is made again
    every = (
        simplified(mesh.vertices, mesh.faces.astype(np.int32), mesh.color or PLAIN)
        for mesh in geometry_meshes(urdf, shape)
    )
    found = [mesh for mesh in every if len(mesh.faces)]
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


def coarser(mesh: Mesh, cell: float) -> Mesh:
    """The same mesh with less detail, for browsers and animations; cell in m. One that is smaller than that stays."""
    found = simplified(np.asarray(mesh.vertices, dtype=float), mesh.faces, mesh.color, cell)
    return found if len(found.faces) else mesh


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
