"""The bodies of the verifier's world, as MuJoCo has them: robot, parts, connectors and obstacles."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Array, Box, OrientedBox, TriangleMesh, pose, quaternion_from_rotation
from takeapart.verification.exact import around
from takeapart.verification.robot import compiled, gripper_prefix, mujoco, robot_specification, unchecked_pairs
from takeapart.verification.solids import Solid
from takeapart.verification.urdf import gripper_branch
from takeapart.workcell import Workcell

# MuJoCo counts its warnings, and the verifier reads the counts; it shall not print them and write them to a file too.
mujoco.set_mju_user_warning(lambda message: None)

# (contype, conaffinity): MuJoCo tests two geoms if a bit of one's contype is in the other's conaffinity: meshes of the
# robot against everything. Two boxes are never left to it (held part or gripper against what stands, `near_boxes`): its
# collider misses pairs of boxes that are apart but closer than the margin, or gives them three times the distance.
# Boxes of the arm are turned into meshes.
ROBOT_BITS = (1, 1 | 2 | 4 | 8)
STATIC_BITS = (2, 0)
HELD_BITS = (4, 0)
GRIPPER_BITS = (8, 1)
ABSENT_BITS = (0, 0)


def add_box(body: mujoco.MjsBody, box: OrientedBox, bits: tuple[int, int], margin: float = 0.0) -> mujoco.MjsGeom:
    """Adds one box, given in the body's frame."""
    return body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=box.half_extents,
        pos=box.T_frame_box[:3, 3],
        quat=quaternion_from_rotation(box.T_frame_box[:3, :3]),
        contype=bits[0],
        conaffinity=bits[1],
        margin=margin,
    )


def _as_mesh(specification: mujoco.MjSpec, geom: mujoco.MjsGeom) -> None:
    """Turns a box into a mesh of the same corners."""
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * geom.size
    name = f"box-{len(specification.meshes)}"
    specification.add_mesh(name=name, uservert=corners.ravel())
    geom.type, geom.meshname = mujoco.mjtGeom.mjGEOM_MESH, name


def place_body(body: mujoco.MjsBody, T_parent_body: Array) -> None:
    """Sets the pose (4, 4) of a body in its parent."""
    body.pos = T_parent_body[:3, 3]
    body.quat = quaternion_from_rotation(T_parent_body[:3, :3])


@dataclass(frozen=True, eq=False)
class Outline(Solid):
    """A part's mesh, shifted so that the box around it has its middle in the origin.

    Args:
        middle: (3,) m, of that box in the part's frame.
    """

    middle: Array


def outlines_of(assembly: Assembly) -> list[Outline | None]:
    """The meshes of the parts, None for boxes; equal shapes share one."""
    found: dict[int, Outline] = {}
    for part in assembly.parts:
        if not isinstance(part.shape, Box) and id(part.shape) not in found:
            surface = part.shape.surface()
            middle = around(Solid(surface))[0]
            found[id(part.shape)] = Outline(TriangleMesh(surface.vertices - middle, surface.triangles), middle)
    return [found.get(id(part.shape)) for part in assembly.parts]


def world_model(
    assembly: Assembly, workcell: Workcell, outlines: Sequence[Outline | None], sight: float
) -> mujoco.MjModel:
    """Robot, parts and obstacles; a part that is not fixed is there twice, as ``part/NAME`` and ``held/NAME``.

    Args:
        outlines: of the parts, see `outlines_of`.
        sight: pairs closer than this are seen by MuJoCo, m.

    Raises:
        InputError: the robot's files cannot be read, or are not what the description says.
    """
    description = workcell.description
    prefix = gripper_prefix(description)
    specification = robot_specification(description)
    # By default MuJoCo never tests a body against its parent; here `unchecked_pairs` decides.
    specification.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_FILTERPARENT
    place_body(specification.body(description.arm.base_link), workcell.T_world_base)
    gripper = [prefix + link for link in gripper_branch(description).links]
    for body in specification.bodies:
        for geom in body.geoms:
            is_box = geom.type == mujoco.mjtGeom.mjGEOM_BOX
            if is_box and body.name not in gripper:
                _as_mesh(specification, geom)
                is_box = False
            geom.contype, geom.conaffinity = GRIPPER_BITS if is_box else ROBOT_BITS
            geom.margin = sight
    for first, second in unchecked_pairs(description):
        specification.add_exclude(bodyname1=first, bodyname2=second)
    hand = specification.body(prefix + description.gripper.base_link)
    for i, part in enumerate(assembly.parts):
        static = specification.worldbody.add_body(name=f"part/{part.name}")
        place_body(static, part.T_world_part)
        boxes = part_boxes(assembly, i, outlines[i])
        for box in boxes:
            add_box(static, box, STATIC_BITS)
        if part.fixed:
            continue
        held = hand.add_body(name=f"held/{part.name}")
        for box in boxes:
            add_box(held, box, ABSENT_BITS, sight)
        # The gripper does not move relative to the held part: `check_fingers` looks at it once per step.
        for link in gripper:
            specification.add_exclude(bodyname1=link, bodyname2=f"held/{part.name}")
    for obstacle in workcell.environment:
        body = specification.worldbody.add_body(name=f"environment/{obstacle.name}")
        add_box(body, obstacle.box, STATIC_BITS)
    return compiled(specification, description)


def part_boxes(assembly: Assembly, i: int, outline: Outline | None) -> list[OrientedBox]:
    """Boxes of a part, in its frame, with its connectors: its shape first, of a mesh the box around it."""
    name = assembly.parts[i].name
    walls = [wall for connector in assembly.connectors if connector.host == name for wall in connector.walls]
    if outline is None:
        return list(assembly.body(i))
    middle, half = outline.middle, around(outline)[1]
    return [OrientedBox(pose(middle), half), *walls]
