"""The verifier's own world: arm, gripper, assembly and environment as a MuJoCo model.

The robot comes from its URDF files with the collision geometry as it is (MuJoCo takes the convex hull of each mesh).
Every part exists twice: as a static body in the assembly, and as a body on the gripper's base; at any time at most one
of them takes part in collisions. Nothing here is shared with the planner's kinematics or collision code.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from takeapart.model.assembly import Assembly
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, pose_inverse, quaternion_from_rotation
from takeapart.verification.bodies import (
    ABSENT_BITS,
    GRIPPER_BITS,
    HELD_BITS,
    ROBOT_BITS,
    STATIC_BITS,
    outlines_of,
    world_model,
)
from takeapart.verification.exact import ExactPairs, as_array
from takeapart.verification.gripper import PadMeasure, pad_measure
from takeapart.verification.robot import Joints, gripper_bodies, gripper_prefix, mujoco
from takeapart.verification.urdf import arm_branch
from takeapart.workcell import Workcell


class Scene:
    """Arm, gripper, assembly and environment; answers where the tool is and what is close to what.

    Args:
        sight: pairs closer than this are seen by `near`, m.

    Raises:
        InputError: the robot's files cannot be read, or are not what the description says.
    """

    def __init__(self, assembly: Assembly, workcell: Workcell, sight: float) -> None:
        self.assembly = assembly
        self.workcell = workcell
        self.sight = sight
        self.description = workcell.description
        self.gripper = self.description.gripper
        self._prefix = gripper_prefix(self.description)
        self.outlines = outlines_of(assembly)
        self.model = world_model(assembly, workcell, self.outlines, sight)
        self.data = mujoco.MjData(self.model)
        model = self.model
        self.joints = Joints(model, self.description)
        self.joint_limits = self.joints.limits  # (n, 2) rad
        self._hand = model.body(self._prefix + self.gripper.base_link).id
        self.static_bodies = [model.body(f"part/{part.name}").id for part in assembly.parts]
        self.held_bodies = [-1 if part.fixed else int(model.body(f"held/{part.name}").id) for part in assembly.parts]
        self.exact = ExactPairs(
            model,
            self.data,
            {
                self.geoms(body)[0]: outline
                for bodies in (self.static_bodies, self.held_bodies)
                for body, outline in zip(bodies, self.outlines, strict=True)
                if body >= 0 and outline is not None
            },
        )
        self._exact = as_array(sorted(self.exact.geoms))
        still = {geom for body in self.base_bodies for geom in self.geoms(body)}
        bits = (ROBOT_BITS[0], GRIPPER_BITS[0])
        self._robot = as_array(
            [geom for geom in range(model.ngeom) if model.geom_contype[geom] in bits and geom not in still]
        )
        carried = {geom for link in self.carried_links for geom in self.geoms(link)}
        self._links_before = as_array([geom for geom in self._robot if geom not in carried])
        self._exact_standing = as_array([])
        self._held_geoms = as_array([])
        box = model.geom_type == mujoco.mjtGeom.mjGEOM_BOX
        self._gripper_boxes = np.nonzero(box & (model.geom_contype == GRIPPER_BITS[0]))[0]
        self._boxes = np.empty(0, dtype=np.intp)  # of the gripper and the held part
        self._standing = np.empty(0, dtype=np.intp)
        self._standing_center: Array = np.empty((0, 3))  # m, world
        self._standing_reach: Array = np.empty((0, 3))  # m, half extents along the world's axes
        self.held: int | None = None
        self.opening = 0.0  # m
        self._T_hand_tool: Array = np.eye(4)
        self.show(assembly.root, None)
        self.open(self.gripper.openings[0])
        self.place(workcell.home)
        self.sides = self._sides()

    def _sides(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Bodies of the finger links that stand on the negative and the positive side of the tool point along the
        closing direction, with the gripper wide open."""
        self.open(self.gripper.openings[-1])
        mujoco.mj_kinematics(self.model, self.data)
        sides: tuple[list[str], list[str]] = ([], [])
        for link in self.gripper.finger_links:
            corners = self.corners_in_tool(self.geoms(self._prefix + link))
            sides[bool(corners[:, 1].mean() > 0)].append(self._prefix + link)
        self.open(self.gripper.openings[0])
        mujoco.mj_kinematics(self.model, self.data)
        if not sides[0] or not sides[1]:
            message = "all its finger links stand on one side of the tool point, by the closing direction stated"
            raise InputError(message, f"gripper {self.gripper.name!r}")
        return tuple(sides[0]), tuple(sides[1])

    @property
    def carried_links(self) -> list[str]:
        """Bodies that do not move relative to the held part: the link that carries the gripper, what is fastened to
        it, and the gripper. MuJoCo does not test them against the part."""
        model = self.model
        numbers = {b for b in range(model.nbody) if model.body_weldid[b] == model.body_weldid[self._hand]}
        numbers |= set(gripper_bodies(model, self.description))
        names = [str(model.body(b).name) for b in sorted(numbers)]
        return [name for name in names if not name.startswith("held/") and self.geoms(name)]

    @property
    def finger_bodies(self) -> tuple[str, ...]:
        """Bodies of the links with the pads."""
        return tuple(self._prefix + link for link in self.gripper.finger_links)

    @property
    def base_bodies(self) -> list[str]:
        """Bodies of the arm that never move."""
        still = (str(self.model.body(name).name) for name in arm_branch(self.description).links)
        return [name for name in still if not self.model.body_weldid[self.model.body(name).id] and self.geoms(name)]

    def label(self, geom: int) -> str:
        """Name of the body of a geom: a link, ``part/NAME``, ``held/NAME`` or ``environment/NAME``."""
        return str(self.model.body(self.model.geom_bodyid[geom]).name)

    def geoms(self, body: int | str) -> list[int]:
        """Numbers of the geoms of a body."""
        number = body if isinstance(body, int) else int(self.model.body(body).id)
        first = int(self.model.body_geomadr[number])
        return list(range(first, first + int(self.model.body_geomnum[number])))

    def show(self, state: int, held: int | None) -> None:
        """Lets exactly the parts of a state and the fixed parts stand in the assembly, and one part be in the hand."""
        for i, part in enumerate(self.assembly.parts):
            present = part.fixed or bool(state >> i & 1 and i != held)
            self._set_bits(self.static_bodies[i], STATIC_BITS if present else ABSENT_BITS)
            if not part.fixed:
                self._set_bits(self.held_bodies[i], HELD_BITS if i == held else ABSENT_BITS)
        self.held = held
        held_geoms = [] if held is None else self.geoms(self.held_bodies[held])
        self._held_geoms = as_array(held_geoms)
        self._boxes = as_array([*self._gripper_boxes, *(g for g in held_geoms if g not in self.exact.geoms)])
        shown = [i for i, part in enumerate(self.assembly.parts) if part.fixed or (state >> i & 1 and i != held)]
        first = [self.geoms(self.static_bodies[i])[0] for i in shown]
        self._exact_standing = as_array([geom for geom in first if geom in self.exact.geoms])
        self._standing = np.nonzero(self.model.geom_contype == STATIC_BITS[0])[0]
        mujoco.mj_kinematics(self.model, self.data)
        self._standing_center = self.data.geom_xpos[self._standing].copy()
        self._standing_reach = self._reach(self._standing)

    def _reach(self, geoms: NDArray[np.intp]) -> Array:
        """Half extents (k, 3), m, of boxes along the world's axes."""
        R = np.abs(self.data.geom_xmat[geoms].reshape(-1, 3, 3))
        return np.asarray(np.matmul(R, self.model.geom_size[geoms][:, :, None])[:, :, 0])

    def _set_bits(self, body: int, bits: tuple[int, int]) -> None:
        geoms = self.geoms(body)
        self.model.geom_contype[geoms], self.model.geom_conaffinity[geoms] = bits
        self.model.body_contype[body], self.model.body_conaffinity[body] = bits  # the broad phase reads these
        outlined = [
            geom for geom in geoms if geom in self.exact.geoms
        ]  # `ExactPairs` judges them, and not by their box
        self.model.geom_contype[outlined], self.model.geom_conaffinity[outlined] = ABSENT_BITS

    def grip(self, T_tool_part: Array, width: float) -> None:
        """Opens the gripper to a width, m, and fastens the held part to it."""
        self.open(width)
        if self.held is not None:
            T_hand_part = self._T_hand_tool @ T_tool_part
            body = self.held_bodies[self.held]
            self.model.body_pos[body] = T_hand_part[:3, 3]
            self.model.body_quat[body] = quaternion_from_rotation(T_hand_part[:3, :3])

    def open(self, width: float) -> None:
        """Sets the joints of the gripper, and with them the tool frame, to an opening, m."""
        self.opening = width
        self._T_hand_tool = self.gripper.T_base_tool(width)
        self.joints.set_opening(self.data, width)

    def place(self, configuration: Array) -> None:
        """Moves the arm to joint angles (n,), rad."""
        self.joints.set_arm(self.data, configuration)
        mujoco.mj_kinematics(self.model, self.data)

    def tool(self) -> tuple[Array, Array]:
        """Position (3,), m, and rotation (3, 3) of the tool frame in the world."""
        R = self.data.xmat[self._hand].reshape(3, 3)
        return self.data.xpos[self._hand] + R @ self._T_hand_tool[:3, 3], R @ self._T_hand_tool[:3, :3]

    def pads(self) -> tuple[PadMeasure, PadMeasure]:
        """What is met from the tool point along the negative and the positive closing direction: by the fingers of the
        one side, and of the other."""
        position, R = self.tool()
        minus, plus = (
            pad_measure(self.model, self.data, [g for body in side for g in self.geoms(body)], position, sign * R[:, 1])
            for side, sign in zip(self.sides, (-1.0, 1.0), strict=True)
        )
        return minus, plus

    def corners_in_tool(self, geoms: Sequence[int]) -> Array:
        """Corners (8 k, 3), m, of the boxes around geoms, in the tool frame."""
        numbers = np.array(geoms, dtype=np.intp)
        middle, half = self.model.geom_aabb[numbers, None, :3], self.model.geom_aabb[numbers, None, 3:]
        signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
        R_world_geom = self.data.geom_xmat[numbers].reshape(-1, 3, 3)
        corners = np.einsum("kij,kcj->kci", R_world_geom, middle + signs * half) + self.data.geom_xpos[numbers, None]
        position, R_world_tool = self.tool()
        return np.asarray((corners.reshape(-1, 3) - position) @ R_world_tool)

    def near(self) -> tuple[NDArray[np.intp], Array]:
        """Pairs of geoms (k, 2) that stand closer than the sight, with their distance (k,), m: exact between two boxes.

        A pair with a mesh may occur several times, and its distance be off by 0.3 mm; with a part's mesh, it is only a
        lower bound: call `distance` before judging it.
        """
        mujoco.mj_collision(self.model, self.data)
        pairs, distances = self.near_boxes()
        if self.exact.geoms:
            held = self._held_geoms
            outlined = held[np.isin(held, self._exact)]
            groups = (
                (np.concatenate([self._robot, held]), self._exact_standing),
                (outlined, self._standing),
                (self._links_before, outlined),
            )
            found = [self.exact.near(moving, standing, self.sight) for moving, standing in groups]
            pairs = np.concatenate([pairs, *(each[0] for each in found)])
            distances = np.concatenate([distances, *(each[1] for each in found)])
        if self.data.ncon:
            pairs = np.concatenate([self.data.contact.geom.astype(np.intp), pairs])
            distances = np.concatenate([self.data.contact.dist, distances])
        return pairs, distances

    @property
    def overflowed(self) -> bool:
        """Whether MuJoCo ever ran out of memory for contacts: then `near` has left some out."""
        return bool(self.data.warning[mujoco.mjtWarning.mjWARN_CONTACTFULL].number)

    def near_boxes(self) -> tuple[NDArray[np.intp], Array]:
        """As `near`, of the boxes of the held part and the gripper against those that stand: first by their extents
        along the world's axes, which never miss a pair, then by MuJoCo's distance."""
        if not len(self._boxes):  # nothing is held, and the gripper has none
            return np.empty((0, 2), dtype=np.intp), np.empty(0)
        center, reach = self.data.geom_xpos[self._boxes], self._reach(self._boxes)
        lower, upper = (center - reach).min(axis=0) - self.sight, (center + reach).max(axis=0) + self.sight
        around = (self._standing_center - self._standing_reach < upper) & (
            self._standing_center + self._standing_reach > lower
        )
        standing = np.nonzero(around.all(axis=1))[0]
        gap = np.abs(center[:, None] - self._standing_center[standing])
        gap -= reach[:, None]
        gap -= self._standing_reach[standing]
        rows, columns = np.nonzero((gap < self.sight).all(axis=2))
        pairs = np.column_stack([self._boxes[rows], self._standing[standing[columns]]])
        distances = np.array([self.distance(a, b, self.sight) for a, b in pairs.tolist()])
        closer = distances < self.sight
        return pairs[closer], distances[closer]

    def distance(self, first: int, second: int, limit: float = 1.0) -> float:
        """Distance of two geoms, m, negative if they penetrate; at most the limit."""
        if first in self.exact.geoms or second in self.exact.geoms:
            return min(self.exact.distance(first, second), limit)
        return float(mujoco.mj_geomDistance(self.model, self.data, first, second, limit, None))

    def touching_at_start(self, reach: float) -> dict[tuple[int, int], float]:
        """Distances, m, of all pairs of geoms of different parts, or part and obstacle, closer than `reach` in the
        finished assembly; keys (a, b) in both orders. Static bodies only, so the arm does not matter."""
        obstacles = [int(self.model.body(f"environment/{o.name}").id) for o in self.workcell.environment]
        bodies = [*self.static_bodies, *obstacles]
        geoms = np.array([geom for body in bodies for geom in self.geoms(body)])
        owner = self.model.geom_bodyid[geoms]
        obstacle = owner > max(self.static_bodies)
        R = self.data.geom_xmat[geoms].reshape(-1, 3, 3)
        half = np.einsum("nij,nj->ni", np.abs(R), self.model.geom_size[geoms])
        lower, upper = self.data.geom_xpos[geoms] - half, self.data.geom_xpos[geoms] + half
        found: dict[tuple[int, int], float] = {}
        for a in range(len(geoms)):
            close = (lower[a] < upper + reach).all(axis=1) & (lower < upper[a] + reach).all(axis=1)
            close &= (owner != owner[a]) & ~(obstacle & obstacle[a])
            for b in np.nonzero(close)[0]:
                first, second = int(geoms[a]), int(geoms[b])
                if first < second:
                    distance = self.distance(first, second, 2 * reach)
                    if distance < reach:
                        found[first, second] = found[second, first] = distance
        return found

    def misplaced(self, tolerance: float) -> list[tuple[str, str, float]]:
        """Things that overlap before anything moves, by more than the tolerance, m: the robot's base in a part, a
        removable part in an obstacle. Fixed parts may be let into obstacles, the base may stand on them."""
        base = [geom for body in self.base_bodies for geom in self.geoms(body)]
        parts = [geom for body in self.static_bodies for geom in self.geoms(body)]
        free = [
            geom
            for body, part in zip(self.static_bodies, self.assembly.parts, strict=True)
            for geom in self.geoms(body)
            if not part.fixed
        ]
        obstacles = [geom for o in self.workcell.environment for geom in self.geoms(f"environment/{o.name}")]
        pairs = [(a, b) for a in base for b in parts] + [(a, b) for a in free for b in obstacles]
        found = [(self.label(a), self.label(b), -self.distance(a, b)) for a, b in pairs]
        return [(first, second, depth) for first, second, depth in found if depth > tolerance]


def part_in_tool(T_world_tool: Array, T_world_part: Array) -> Array:
    """Pose (4, 4) of a part in the tool frame."""
    return pose_inverse(T_world_tool) @ T_world_part
