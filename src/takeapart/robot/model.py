"""The arm as the planner knows it: a serial chain read from URDF, links as convex hulls with spheres around them."""

from __future__ import annotations

import hashlib
import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from takeapart.errors import InputError
from takeapart.geometry import Array, OrientedBox, pose_inverse
from takeapart.robot.arrays import ArmArrays, HeldArrays, Workspace, workspace
from takeapart.robot.cover import SphereCover, sphere_cover
from takeapart.robot.hand import move_load
from takeapart.robot.kept import keep, kept
from takeapart.robot.kinematics import forward
from takeapart.robot.self_collision import BodyPair, ConvexBody, body_pairs, turning_joints
from takeapart.workcell import RobotDescription, Workcell

BASE_INFLATION, ARM_INFLATION, WRIST_INFLATION, HAND_INFLATION = 0.03, 0.025, 0.02, 0.015  # m
LARGEST_PROBE = 0.16  # m, edge of the cells in which a load is looked up in the grid


@dataclass(frozen=True, eq=False)
class RobotModel:
    """Kinematics and collision cover of an arm in its workcell.

    Args:
        description: where the robot's files are.
        arm: arrays for the kernels, with the tool where it is at opening 0; see `arm_at`.
        T_last_flange: (4, 4) pose of the flange in the frame of the last joint.
        T_flange_gripper: (4, 4).
        fingers: (finger link, box in the hand's frame at opening 0, direction (3,) in which it opens).
        inflation: per covered link, how far its spheres reach beyond its hull, m.
        bodies: names of the covered links, in the order of the arrays.
        pairs: how each pair of them is checked for meeting the other.
        hulls: the covered links as convex bodies.
    """

    description: RobotDescription
    arm: ArmArrays
    T_last_flange: Array
    T_flange_gripper: Array
    fingers: tuple[tuple[str, OrientedBox, Array], ...]
    inflation: Mapping[str, float]
    bodies: tuple[str, ...]
    pairs: tuple[BodyPair, ...]
    hulls: tuple[ConvexBody, ...]

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return len(self.arm.lower)

    @property
    def T_world_base(self) -> Array:
        """(4, 4)."""
        return np.vstack([self.arm.T_world_base, [0, 0, 0, 1]])

    @cached_property
    def _arms(self) -> dict[float, ArmArrays]:
        """By opening, as far as they were asked for."""
        return {0.0: self.arm}

    def arm_at(self, opening: float) -> ArmArrays:
        """The arm with the tool where it is at an opening of the fingers, m: the same object where it does not move."""
        if not self.description.gripper.tool_moves:
            return self.arm
        if opening not in self._arms:
            T_tool = self.T_last_flange @ self.T_flange_gripper @ self.description.gripper.T_base_tool(opening)
            self._arms[opening] = self.arm._replace(T_tool=np.ascontiguousarray(T_tool[:3]))
        return self._arms[opening]

    def T_flange_tool(self, opening: float) -> Array:
        """(4, 4) at an opening of the fingers, m."""
        return np.asarray(self.T_flange_gripper @ self.description.gripper.T_base_tool(opening))

    @property
    def tool_openings(self) -> tuple[float, ...]:
        """Openings, m, that tell apart where the tool can be: its ends where it moves, one where it does not."""
        gripper = self.description.gripper
        return (0.0, gripper.maximum_opening) if gripper.tool_moves else (0.0,)

    @cached_property
    def _fingers(self) -> int:
        """Number of boxes of the gripper that move."""
        return len(self.finger_boxes(0.0))

    def workspace(self, boxes: int = 64) -> Workspace:
        """Scratch memory for a load of at most so many boxes, fingers not counted; one for each thread."""
        return workspace(self.arm, self._fingers + boxes)

    @property
    def largest_ball(self) -> float:
        """Radius of the largest ball that the kernels look up in the grid of the world, m."""
        return max(float(self.arm.sphere_radius.max()), LARGEST_PROBE * 3**0.5 / 2)

    def tool_pose(self, q: Array, work: Workspace | None = None, opening: float = 0.0) -> Array:
        """Pose (4, 4) of the tool in the world at a configuration (n,), rad, and an opening of the fingers, m."""
        work = work or self.workspace()
        forward(self.arm_at(opening), np.asarray(q, dtype=float), work)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = work.R_tool, work.p_tool
        return T

    def gripper_boxes(self, opening: float) -> tuple[list[OrientedBox], list[OrientedBox]]:
        """What moves of the gripper at an opening, m, in the tool frame: pads, which may touch the part, and knuckles,
        which may not.
        """
        T_tool_hand = pose_inverse(self.description.gripper.T_base_tool(opening))
        moved = []
        for _, box, direction in self.fingers:
            T = box.T_frame_box.copy()
            T[:3, 3] += direction * opening / 2
            moved.append(OrientedBox(T_tool_hand @ T, box.half_extents))
        return moved, []

    def finger_boxes(self, opening: float) -> list[OrientedBox]:
        """Pads and knuckles in one, in this order."""
        pads, knuckles = self.gripper_boxes(opening)
        return [*pads, *knuckles]

    def held(
        self, opening: float, T_tool_part: Array | None = None, body: Sequence[OrientedBox] = (), gripped: int = 1
    ) -> HeldArrays:
        """What moves with the tool: the gripper's pads and knuckles, and the boxes of a part.

        Args:
            opening: between the fingers, m.
            T_tool_part: (4, 4) pose of the part in the tool frame.
            body: the part's boxes in its own frame.
            gripped: the first so many of them may touch the pads, the others are walls of connectors.
        """
        pads, knuckles = self.gripper_boxes(opening)
        fingers = [*pads, *knuckles]
        part = [box.moved(T_tool_part) for box in body] if T_tool_part is not None else []
        boxes = fingers + part
        groups = [_box_around(fingers), _box_around(part)]
        centers, radii = zip(*(_probes(box) for box in boxes), strict=True)
        counts = [len(found) for found in centers]
        return HeldArrays(
            center=np.array([box.T_frame_box[:3, 3] for box in boxes]),
            axes=np.ascontiguousarray([box.T_frame_box[:3, :3].T for box in boxes]),
            half=np.array([box.half_extents for box in boxes]),
            meets_world=np.ones(len(boxes), dtype=np.uint8),
            probe_center=np.concatenate(centers),
            probe_radius=np.repeat(radii, counts),
            probe_box=np.repeat(np.arange(len(boxes), dtype=np.int32), counts),
            group=np.array([0, len(fingers), len(boxes)], dtype=np.int32),
            first_knuckle=len(pads),
            first_wall=len(fingers) + gripped,
            group_center=np.array([box.T_frame_box[:3, 3] for box in groups]),
            group_axes=np.ascontiguousarray([box.T_frame_box[:3, :3].T for box in groups]),
            group_half=np.array([box.half_extents for box in groups]),
            group_radius=np.array([np.linalg.norm(box.half_extents) for box in groups]),
        )


def moved_load(held: HeldArrays, T: Array) -> HeldArrays:
    """The same load with its part (not its fingers) moved by a pose (4, 4) in the tool frame."""
    moved = copied_load(held)
    move_load(held, np.ascontiguousarray(T), moved)
    return moved


def copied_load(held: HeldArrays) -> HeldArrays:
    """A load with arrays of its own for all that differs from grasp to grasp."""
    return held._replace(
        center=held.center.copy(),
        axes=held.axes.copy(),
        meets_world=held.meets_world.copy(),
        probe_center=held.probe_center.copy(),
        group_center=held.group_center.copy(),
        group_axes=held.group_axes.copy(),
    )


def _box_around(boxes: Sequence[OrientedBox]) -> OrientedBox:
    """A box that contains all boxes, with the axes of the first of them; without any, nothing at the tool's origin."""
    if not boxes:
        return OrientedBox(np.eye(4), np.full(3, 1e-9))
    T = boxes[0].T_frame_box.copy()
    corners = np.concatenate([box.corners() for box in boxes]) @ T[:3, :3]
    low, high = corners.min(axis=0), corners.max(axis=0)
    T[:3, 3] = T[:3, :3] @ ((low + high) / 2)
    return OrientedBox(T, (high - low) / 2 + 1e-9)


def _probes(box: OrientedBox) -> tuple[Array, float]:
    """Small spheres that together contain a box, centres (C, 3), m, and radius, m: each contains a cell of it."""
    half = box.half_extents.tolist()
    edge = min(max(4 * sorted(half)[1], 0.016), LARGEST_PROBE)
    counts = np.array([max(1, math.ceil(2 * h / edge - 1e-9)) for h in half])
    cell = box.half_extents / counts
    offsets = 2 * np.indices(counts.tolist()).reshape(3, -1).T + 1 - counts
    return box.T_frame_box[:3, 3] + offsets * cell @ box.T_frame_box[:3, :3].T, math.hypot(*cell) + 1e-9


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
    T_hand_tool = description.gripper.T_base_tool(0.0)

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
        turning=np.array(turning_joints(lowest, highest), dtype=np.int32),
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
    return RobotModel(
        description, arm, T_last_flange, T_flange_hand, fingers, inflation, tuple(bodies), pairs, tuple(hulls)
    )


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
