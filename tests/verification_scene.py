"""A small scene with a valid plan that no planner made: the joint paths follow straight lines by Newton steps on the
inverse kinematics library's own forward kinematics."""

from __future__ import annotations

import functools
import math
from itertools import pairwise

import numpy as np
from ssik.prebuilt import franka_panda_ik

from takeapart.formats.robot_files import load_robot_description
from takeapart.formats.serialization import assembly_hash, workcell_hash
from takeapart.model.assembly import Assembly, Connector, Part
from takeapart.model.geometry import Array, Box, OrientedBox, pose, pose_inverse, quaternion_from_rotation
from takeapart.model.plan import Grasp, Plan, PlanStep
from takeapart.workcell import Obstacle, Workcell

SPACING = 0.004  # m between rows
DOWNWARDS = {  # tool rotations that look down; the fingers (tool y) close across a bar along ...
    "y": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
    "x": np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]),
}
T_FLANGE_TOOL = pose([0.0, 0.0, 0.1034], [np.cos(np.pi / 8), 0.0, 0.0, -np.sin(np.pi / 8)])  # hand is turned by -45 deg


def u_walls(host: Array, guest: Array, axis: str, sign: int) -> tuple[OrientedBox, ...]:
    """Floor and two cheeks in the host's frame (axes as the world's). `host` and `guest` are centres (3,); the guest
    leaves the host's face in the direction `sign` along `axis`."""
    along, across = ("x", "y") if axis == "x" else ("y", "x")
    i, j = "xyz".index(along), "xyz".index(across)
    walls = []
    for offset, thickness, low, high in (
        (0.0, 0.025, -0.012, -0.010),
        (-0.0115, 0.002, -0.012, 0.010),
        (0.0115, 0.002, -0.012, 0.010),
    ):
        centre, size = np.zeros(3), np.zeros(3)
        centre[i] = sign * (0.010 + (0.0005 + 0.020) / 2)
        size[i] = 0.0195
        centre[j], size[j] = guest[j] - host[j] + offset, thickness
        centre[2], size[2] = guest[2] - host[2] + (low + high) / 2, high - low
        walls.append(OrientedBox(pose(centre), size / 2))
    return tuple(walls)


def bar(name: str, centre: list[float], size: list[float], fixed: bool = False) -> Part:
    return Part(name, Box((size[0], size[1], size[2])), pose(centre), 0.48 * max(size), fixed)


@functools.cache
def scene_assembly() -> Assembly:
    """Two fixed posts carry a beam, the beam and a third post carry a stub; another bar lies loose on a fixed block."""
    parts = (
        bar("left", [0.10, 0.16, 0.1], [0.02, 0.02, 0.22], True),
        bar("right", [0.10, -0.16, 0.1], [0.02, 0.02, 0.22], True),
        bar("front", [-0.05, 0.0, 0.1], [0.02, 0.02, 0.22], True),
        bar("block", [0.12, 0.40, 0.05], [0.1, 0.1, 0.1], True),
        bar("beam", [0.10, 0.0, 0.19], [0.02, 0.299, 0.02]),
        bar("stub", [0.025, 0.0, 0.19], [0.129, 0.02, 0.02]),
        bar("loose", [0.12, 0.40, 0.11], [0.02, 0.16, 0.02]),
    )
    at = {part.name: part.T_world_part[:3, 3] for part in parts}
    connectors = (
        Connector("left-beam", "U", "left", "beam", u_walls(at["left"], at["beam"], "y", -1)),
        Connector("right-beam", "U", "right", "beam", u_walls(at["right"], at["beam"], "y", 1)),
        Connector("beam-stub", "U", "beam", "stub", u_walls(at["beam"], at["stub"], "x", -1)),
        Connector("front-stub", "U", "front", "stub", u_walls(at["front"], at["stub"], "x", 1)),
    )
    return Assembly("scene", parts, connectors)


@functools.cache
def scene_workcell() -> Workcell:
    return Workcell(
        name="scene",
        description=load_robot_description("panda"),
        T_world_base=pose([-0.45, 0.1, 0.0]),
        home=np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]),
        goal=np.array([-0.05, -0.30, 0.42]),
        clearance=0.0005,  # what the fingertips keep from the block under the loose bar
        environment=(Obstacle("table", OrientedBox(pose([0.0, 0.0, -0.1]), np.array([0.7, 0.7, 0.04]))),),
    )


def flange_target(position: Array, rotation: Array, T_world_base: Array) -> Array:
    """Pose (4, 4) of the flange in the robot's base for a tool pose in the world."""
    T_world_tool = pose(position)
    T_world_tool[:3, :3] = rotation
    return np.asarray(pose_inverse(T_world_base) @ T_world_tool @ pose_inverse(T_FLANGE_TOOL))


def tool_pose(q: Array, T_world_base: Array) -> Array:
    """Pose (4, 4) of the tool in the world by the inverse kinematics library's forward kinematics."""
    return np.asarray(T_world_base @ np.asarray(franka_panda_ik.fk(q)) @ T_FLANGE_TOOL)


def _twist(T: Array, target: Array) -> Array:
    """Small displacement (6,) from one pose to another."""
    R = target[:3, :3] @ T[:3, :3].T
    turn = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return np.concatenate([target[:3, 3] - T[:3, 3], turn])


def track(q: Array, target: Array) -> Array:
    """Joint angles near `q` that reach a flange pose, by Newton's method."""
    for _ in range(20):
        T = np.asarray(franka_panda_ik.fk(q))
        error = _twist(T, target)
        if np.abs(error).max() < 1e-12:
            break
        steps = [np.asarray(franka_panda_ik.fk(q + 1e-6 * unit)) for unit in np.eye(7)]
        jacobian = np.array([_twist(T, moved) for moved in steps]).T / 1e-6
        q = q + np.linalg.pinv(jacobian) @ error
    return q


def line_path(corners: list[Array], rotation: Array, T_world_base: Array, seed: Array) -> Array:
    """Joint path (M, 7) whose tool follows straight lines between corners without turning; every corner is a row.
    The first row is tracked from the joint angles `seed` (7,)."""
    points = [np.asarray(corners[0])]
    for a, b in pairwise(corners):
        pieces = int(np.ceil(np.linalg.norm(np.asarray(b) - a) / SPACING))
        points += [a + (np.asarray(b) - a) * k / pieces for k in range(1, pieces + 1)]
    q = seed
    rows = []
    for point in points:
        q = track(q, flange_target(point, rotation, T_world_base))
        rows.append(q)
    return np.array(rows)


def tool_rows(joint_path: Array, T_world_base: Array) -> Array:
    """Tool path (M, 7) of a joint path."""
    poses = [tool_pose(q, T_world_base) for q in joint_path]
    return np.array([[*T[:3, 3], *quaternion_from_rotation(T[:3, :3])] for T in poses])


def step_through(part: str, center: list[float], axis: str, via: list[list[float]], width: float = 0.02) -> PlanStep:
    """A step that lifts the part by 5 cm, then follows straight lines through `via` to the goal."""
    grasp_center = np.array(center)
    lifted = grasp_center + [0.0, 0.0, scene_workcell().lift_height]
    corners = [grasp_center, lifted, *(np.array(point) for point in via), scene_workcell().goal]
    base, rotation = scene_workcell().T_world_base, DOWNWARDS[axis]
    branches = franka_panda_ik.solve(flange_target(grasp_center, rotation, base), q_seed=scene_workcell().home)
    joint_path = line_path(corners, rotation, base, np.asarray(branches[0].q, dtype=float))
    tool_path = tool_rows(joint_path, base)
    length = float(np.linalg.norm(np.diff(tool_path[:, :3], axis=0), axis=1).sum())
    grasp = Grasp(grasp_center, quaternion_from_rotation(DOWNWARDS[axis]), width)
    return PlanStep(part, grasp, joint_path, tool_path, length)


def scene_bound() -> float:
    """Straight-line bound of the scene, written out: from the point of every bar that is nearest, 5 cm up, then
    straight to the goal. All bars are 2 cm wide and high."""
    goal = [-0.05, -0.30, 0.42]
    beam = math.dist([0.09, -0.1495, 0.25], goal)
    stub = math.dist([-0.0395, -0.01, 0.25], goal)
    loose = math.dist([0.11, 0.32, 0.17], goal)
    return 3 * 0.05 + beam + stub + loose


@functools.cache
def scene_plan() -> Plan:
    """Stub, beam, loose: a plan that keeps every rule."""
    steps = (
        step_through("stub", [0.025, 0.0, 0.19], "x", [[0.025, 0.0, 0.42]]),
        step_through("beam", [0.10, -0.06, 0.19], "y", [[0.10, -0.06, 0.42]]),
        step_through("loose", [0.12, 0.40, 0.11], "y", [[0.12, 0.40, 0.42]]),
    )
    return Plan(
        steps=steps,
        total_length=sum(step.length for step in steps),
        straight_line_bound=scene_bound(),
        sequence_bound=None,
        counts={"motion_plans": 0, "removal_queries": 0},
        seconds=0.0,
        seed=0,
        search={},
        hashes={"assembly": assembly_hash(scene_assembly()), "workcell": workcell_hash(scene_workcell())},
        versions={},
        assembly="scene",
        workcell="scene",
        robot="panda",
        joints=tuple(f"panda_joint{i}" for i in range(1, 8)),
    )
