"""The arm of a workcell as the planner knows it, read from URDF: chain, hulls, sphere cover, self-collision pairs."""

from __future__ import annotations

import hashlib
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np

from takeapart.errors import InputError
from takeapart.geometry import Array, OrientedBox, pose_inverse
from takeapart.robot.arrays import ArmArrays
from takeapart.robot.cover import SphereCover, sphere_cover
from takeapart.robot.kept import keep, kept
from takeapart.robot.model import RobotModel
from takeapart.robot.self_collision import ConvexBody, body_pairs
from takeapart.workcell import RobotDescription, Workcell

BASE_INFLATION, ARM_INFLATION, WRIST_INFLATION, HAND_INFLATION = 0.03, 0.025, 0.02, 0.015  # m


def load_robot(workcell: Workcell) -> RobotModel:
    """The arm of a workcell.

    Raises:
        InputError: the robot's files are missing, or its chain is not one of revolute joints.
    """
    description = workcell.description
    urdf = ElementTree.parse(description.path(description.urdf)).getroot()
    joints = {_text(joint, "child", "link"): joint for joint in urdf.iter("joint") if joint.find("child") is not None}
    T_joint, lower, upper, links, aligned = _chain(urdf, joints, description)

    n = len(T_joint)
    T_last_flange = aligned[-1] @ _fixed_transform(joints, links[-1], description.flange_link)
    T_flange_hand = _fixed_transform(joints, description.flange_link, description.hand_links[0])
    T_hand_tool = np.eye(4)
    T_hand_tool[:3, 3] = description.T_hand_tool

    bodies = [*links, description.hand_links[0]]
    frames = [*range(n + 1), n]
    T_frame_body = [*aligned, T_last_flange @ T_flange_hand]
    inflations = [BASE_INFLATION, *[ARM_INFLATION] * (n - 3), *[WRIST_INFLATION] * 3, HAND_INFLATION]
    covers = [
        _link_cover(urdf, link, description, inflation) for link, inflation in zip(bodies, inflations, strict=True)
    ]
    centers = [c.centers @ T[:3, :3].T + T[:3, 3] for c, T in zip(covers, T_frame_body, strict=True)]
    balls = [
        (middle := c.mean(axis=0), float((np.linalg.norm(c - middle, axis=1) + k.radii).max()))
        for c, k in zip(centers, covers, strict=True)
    ]
    radii = np.concatenate([c.radii for c in covers])
    hulls = [
        ConvexBody(_link_corners(urdf, link, description) @ T[:3, :3].T + T[:3, 3], frame, body <= n)
        for body, (link, T, frame) in enumerate(zip(bodies, T_frame_body, frames, strict=True))
    ]
    chain, lowest, highest = np.ascontiguousarray([T[:3] for T in T_joint]), np.array(lower), np.array(upper)
    pairs, tables = body_pairs(hulls, chain, lowest, highest)
    arm = ArmArrays(
        T_world_base=np.ascontiguousarray(workcell.T_world_base[:3]),
        T_joint=chain,
        T_tool=np.ascontiguousarray((T_last_flange @ T_flange_hand @ T_hand_tool)[:3]),
        lower=lowest,
        upper=highest,
        sphere_center=(spheres := np.concatenate(centers)),
        sphere_x=spheres[:, 0].copy(),
        sphere_y=spheres[:, 1].copy(),
        sphere_z=spheres[:, 2].copy(),
        sphere_radius=radii,
        body_start=np.cumsum([0, *[len(c) for c in centers]]).astype(np.uint64),
        corner=np.ascontiguousarray(np.concatenate([hull.corners for hull in hulls])),
        corner_start=np.cumsum([0, *[len(hull.corners) for hull in hulls]], dtype=np.int64),
        body_frame=np.array(frames, dtype=np.uint64),
        body_center=np.array([center for center, _ in balls]),
        body_radius=np.array([radius for _, radius in balls]),
        self_pairs=np.array(
            [(pair.first, pair.second) for pair in pairs if pair.treatment == "hulls"], dtype=np.int32
        ).reshape(-1, 2),
        near_joints=np.array([table.joints for table in tables], dtype=np.int32).reshape(-1, 2),
        near_lower=np.array([table.lower for table in tables]).reshape(-1, 2),
        near_step=np.array([table.step for table in tables]).reshape(-1, 2),
        near_shape=np.array([table.distances.shape for table in tables], dtype=np.int32).reshape(-1, 2),
        near_reach=np.array([table.reach for table in tables]).reshape(-1, 2),
        near_start=np.cumsum([0, *[table.distances.size for table in tables]], dtype=np.int64)[:-1],
        near_distance=np.concatenate([np.zeros(0, np.uint16), *[table.distances.ravel() for table in tables]]),
        held_bodies=np.array([b for b in range(len(bodies)) if frames[b] < n], dtype=np.int32),
    )
    fingers = tuple(_finger_boxes(urdf, joints, description))
    inflation = {link: c.inflation for link, c in zip(bodies, covers, strict=True)}
    T_flange_tool = T_flange_hand @ T_hand_tool
    return RobotModel(description, arm, fingers, T_flange_tool, inflation, tuple(bodies), pairs, tuple(hulls))


def _text(element: ElementTree.Element, child: str, attribute: str) -> str:
    found = element.find(child)
    return found.get(attribute, "") if found is not None else ""


def _numbers(text: str) -> Array:
    return np.array([float(number) for number in text.split()])


def _origin(element: ElementTree.Element) -> Array:
    """Pose (4, 4) of a URDF element's <origin>: fixed-axis roll, pitch, yaw."""
    origin = element.find("origin")
    T = np.eye(4)
    if origin is None:
        return T
    (cr, cp, cy), (sr, sp, sy) = (f(_numbers(origin.get("rpy", "0 0 0"))) for f in (np.cos, np.sin))
    Rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    Ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    Rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    T[:3, :3] = Rz @ Ry @ Rx
    T[:3, 3] = _numbers(origin.get("xyz", "0 0 0"))
    return T


def _align_z(axis: Array) -> Array:
    """Rotation as a pose (4, 4) that takes the z axis to a given axis (3,)."""
    axis = axis / np.linalg.norm(axis)
    T = np.eye(4)
    if axis[2] > 1 - 1e-12:
        return T
    side = np.cross([0.0, 0.0, 1.0], axis)
    side = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(side) < 1e-9 else side / np.linalg.norm(side)
    T[:3, :3] = np.column_stack([side, np.cross(axis, side), axis])
    return T


def _chain(
    urdf: ElementTree.Element, joints: Mapping[str, ElementTree.Element], description: RobotDescription
) -> tuple[list[Array], list[float], list[float], list[str], list[Array]]:
    """Joint transforms with every axis turned to z; also per link the pose (4, 4) of its frame in the joint's frame."""
    by_name = {joint.get("name"): joint for joint in urdf.iter("joint")}
    transforms, lower, upper = [], [], []
    links, aligned = [description.base_link], [np.eye(4)]
    for name in description.arm_joints:
        joint = by_name.get(name)
        if joint is None or joint.get("type") != "revolute":
            kind = "missing" if joint is None else f"of type {joint.get('type')!r}"
            raise InputError(
                f"joint {name!r} is {kind}; it must be revolute", f"{description.name}: {description.urdf}"
            )
        if _text(joint, "parent", "link") != links[-1]:
            raise InputError(
                f"joint {name!r} does not follow link {links[-1]!r}", f"{description.name}: {description.urdf}"
            )
        turn = _align_z(_numbers(_text(joint, "axis", "xyz") or "1 0 0"))
        transforms.append(aligned[-1] @ _origin(joint) @ turn)
        lower.append(float(_text(joint, "limit", "lower")))
        upper.append(float(_text(joint, "limit", "upper")))
        links.append(_text(joint, "child", "link"))
        aligned.append(pose_inverse(turn))
    return transforms, lower, upper, links, aligned


def _fixed_transform(joints: Mapping[str, ElementTree.Element], ancestor: str, link: str) -> Array:
    """Pose (4, 4) of a link in the frame of an ancestor, all joints between them at zero."""
    T = np.eye(4)
    while link != ancestor:
        joint = joints[link]
        T = _origin(joint) @ T
        link = _text(joint, "parent", "link")
    return T


def _collision_elements(urdf: ElementTree.Element, link: str) -> list[ElementTree.Element]:
    return [c for element in urdf.iter("link") if element.get("name") == link for c in element.iter("collision")]


def _link_cover(urdf: ElementTree.Element, link: str, description: RobotDescription, inflation: float) -> SphereCover:
    """Spheres around the collision geometry of a link, in the link's frame."""
    parts = []
    for element in _collision_elements(urdf, link):
        mesh = element.find("geometry/mesh")
        if mesh is None:
            raise InputError(
                f"link {link!r} has collision geometry that is no mesh", f"{description.name}: {description.urdf}"
            )
        path = description.resolve(mesh.get("filename", ""))
        found = _mesh_cover(str(path), _digest(path), inflation)
        T = _origin(element)
        parts.append(SphereCover(found.centers @ T[:3, :3].T + T[:3, 3], found.radii, found.inflation))
    if not parts:
        raise InputError(f"link {link!r} has no collision geometry", f"{description.name}: {description.urdf}")
    return SphereCover(
        np.concatenate([p.centers for p in parts]),
        np.concatenate([p.radii for p in parts]),
        max(p.inflation for p in parts),
    )


def _link_corners(urdf: ElementTree.Element, link: str, description: RobotDescription) -> Array:
    """Corners (V, 3), m, of the convex hull of a link's collision meshes, in the link's frame."""
    corners = []
    for element in _collision_elements(urdf, link):
        T = _origin(element)
        path = description.resolve(element.find("geometry/mesh").get("filename", ""))  # type: ignore[union-attr]
        corners.append(_mesh_corners(str(path), _digest(path)) @ T[:3, :3].T + T[:3, 3])
    together = np.concatenate(corners)
    if len(corners) == 1:
        return together
    import trimesh

    return np.asarray(trimesh.convex.convex_hull(together).vertices, dtype=float)


@lru_cache(maxsize=64)
def _mesh_corners(path: str, digest: str) -> Array:
    """Corners (V, 3), m, of the convex hull of a mesh file; computed once per file content, as its cover is."""
    name = f"corners-1-{digest[:24]}"
    known = kept(name)
    if known is not None and known.ndim == 2 and known.shape[1] == 3 and len(known) > 3 and np.isfinite(known).all():
        return np.ascontiguousarray(known, dtype=float)
    import trimesh  # takes longer to import than all else of the planner, and mostly the corners are there already

    found = np.asarray(trimesh.load_mesh(path).convex_hull.vertices, dtype=float)
    keep(name, found)
    return found


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@lru_cache(maxsize=64)
def _mesh_cover(path: str, digest: str, inflation: float) -> SphereCover:
    """Cover of the convex hull of a mesh file; computed once per file content and kept in the cache folder."""
    name = f"cover-2-{digest[:24]}-{inflation * 1e4:.0f}"
    rows = kept(name)
    if rows is not None and rows.ndim == 2 and rows.shape[1] == 4 and len(rows) > 1 and np.isfinite(rows).all():
        return SphereCover(rows[1:, :3], rows[1:, 3], float(rows[0, 3]))
    import trimesh

    hull = trimesh.load_mesh(path).convex_hull
    found = sphere_cover(
        np.asarray(hull.triangles, dtype=float), np.asarray(hull.face_normals), inflation, np.random.default_rng(0)
    )
    keep(name, np.vstack([[0, 0, 0, found.inflation], np.column_stack([found.centers, found.radii])]))
    return found


def _finger_boxes(
    urdf: ElementTree.Element, joints: Mapping[str, ElementTree.Element], description: RobotDescription
) -> list[tuple[str, OrientedBox, Array]]:
    """Boxes of the fingers in the hand's frame at opening 0; a mesh is replaced by its oriented bounding box."""
    found = []
    for link in description.finger_links:
        joint = joints[link]
        T_hand_finger = _fixed_transform(joints, description.hand_links[0], link)
        direction = T_hand_finger[:3, :3] @ _numbers(_text(joint, "axis", "xyz"))
        for element in _collision_elements(urdf, link):
            T = T_hand_finger @ _origin(element)
            box, mesh = element.find("geometry/box"), element.find("geometry/mesh")
            if box is not None:
                found.append((link, OrientedBox(T, _numbers(box.get("size", "")) / 2), direction))
            elif mesh is not None:
                import trimesh

                bound = trimesh.load_mesh(description.resolve(mesh.get("filename", ""))).bounding_box_oriented.primitive
                found.append((link, OrientedBox(T @ bound.transform, np.asarray(bound.extents) / 2), direction))
    return found
