"""The arm as the planner knows it: a serial chain read from URDF, links as convex hulls with spheres around them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from takeapart.model.geometry import Array, OrientedBox, pose_inverse
from takeapart.robot.arrays import ArmArrays, HeldArrays, Workspace, workspace
from takeapart.robot.gripper import gripper_boxes
from takeapart.robot.hand import move_load
from takeapart.robot.kinematics import forward
from takeapart.robot.self_collision import BodyPair, ConvexBody
from takeapart.workcell import RobotDescription

LARGEST_PROBE = 0.16  # m, edge of the cells in which a load is looked up in the grid


@dataclass(frozen=True, eq=False)
class RobotModel:
    """Kinematics and collision cover of an arm in its workcell.

    Args:
        description: where the robot's files are.
        arm: arrays for the kernels, with the tool where it is at opening 0; see `arm_at`.
        T_last_flange: (4, 4) pose of the flange in the frame of the last joint.
        inflation: per covered link, how far its spheres reach beyond its hull, m.
        bodies: names of the covered links, in the order of the arrays.
        pairs: how each pair of them is checked for meeting the other.
        hulls: the covered links as convex bodies.
    """

    description: RobotDescription
    arm: ArmArrays
    T_last_flange: Array
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
        if not self.tool_moves:
            return self.arm
        if opening not in self._arms:
            T_tool = self.T_last_flange @ self.T_flange_tool(opening)
            self._arms[opening] = self.arm._replace(T_tool=np.ascontiguousarray(T_tool[:3]))
        return self._arms[opening]

    def T_flange_tool(self, opening: float) -> Array:
        """(4, 4) at an opening of the fingers, m."""
        return self.description.T_flange_tool(opening)

    @cached_property
    def tool_moves(self) -> bool:
        """Whether the tool frame depends on the opening."""
        return self.description.gripper.tool_moves

    @property
    def tool_openings(self) -> tuple[float, ...]:
        """Openings, m, that tell apart where the tool can be: its ends where it moves, one where it does not."""
        return (0.0, self.description.gripper.maximum_opening) if self.tool_moves else (0.0,)

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
        """What moves of the gripper at an opening between the pads, m, in the tool frame: pads, which may touch the
        part, and knuckles, which may not.
        """
        pads, knuckles = gripper_boxes(self.description, opening)
        T_tool_base = pose_inverse(self.description.gripper.T_base_tool(opening))
        return [box.moved(T_tool_base) for box in pads], [box.moved(T_tool_base) for box in knuckles]

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
