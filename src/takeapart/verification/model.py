"""The verifier's own world: arm, hand, assembly and environment as a MuJoCo model.

The arm comes from its URDF with the collision meshes as they are (MuJoCo takes the convex hull of each mesh). Every
part exists twice: as a static body in the assembly, and as a body on the hand; at any time at most one of them takes
part in collisions. Nothing here is shared with the planner's kinematics or collision code.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from takeapart.model.assembly import Assembly
from takeapart.model.errors import MissingExtraError
from takeapart.model.geometry import Array, OrientedBox, pose_inverse, quaternion_from_rotation
from takeapart.workcell import RobotDescription, Workcell

try:
    import mujoco as mujoco  # verification_physics takes it from here
except ImportError as missing:
    raise MissingExtraError("verification", "verify", "mujoco") from missing

# MuJoCo counts its warnings, and the verifier reads the counts; it shall not print them and write them to a file too.
mujoco.set_mju_user_warning(lambda message: None)

# (contype, conaffinity): MuJoCo tests two geoms if a bit of one's contype is in the other's conaffinity: meshes of the
# robot against everything. Two boxes are never left to it (held part or fingers against what stands, `near_boxes`):
# its collider misses pairs of boxes that are apart but closer than the margin, or gives them three times the distance.
ROBOT_BITS = (1, 1 | 2 | 4 | 8)
STATIC_BITS = (2, 0)
HELD_BITS = (4, 0)
FINGER_BITS = (8, 1)
ABSENT_BITS = (0, 0)

OVERLAP_SAMPLES = 200  # configurations in which links must overlap to count as links that always do


def robot_specification(description: RobotDescription) -> mujoco.MjSpec:
    """Editable model of the robot from its URDF: collision geometry only, every link kept as a body."""
    text = description.path(description.urdf).read_text(encoding="utf-8")
    text = re.sub(r"<visual>.*?</visual>", "", text, flags=re.DOTALL)
    text = re.sub(r'filename="(package://[^"]+)"', lambda found: f'filename="{description.resolve(found[1])}"', text)
    # MuJoCo's defaults for URDF do not fit: fusestatic would merge the hand into the last arm link, strippath would
    # drop the folders of the meshes, discardvisual would drop the parts that are not in the hand at the start.
    compiler = '<compiler fusestatic="false" strippath="false" discardvisual="false" balanceinertia="true"/>'
    return mujoco.MjSpec.from_string(text.replace("</robot>", f"<mujoco>{compiler}</mujoco></robot>"))


@lru_cache(maxsize=8)
def unchecked_pairs(description: RobotDescription) -> tuple[tuple[str, str], ...]:
    """Pairs of the robot's links that may touch: the next link in the chain, links without geometry skipped, and links
    that overlap in each of many configurations drawn here. No file is believed about it.
    """
    model = robot_specification(description).compile()
    data = mujoco.MjData(model)
    geoms = {
        b: range(a, a + n) for b, (a, n) in enumerate(zip(model.body_geomadr, model.body_geomnum, strict=True)) if n
    }
    links = [body for body in geoms if body]

    def before(body: int) -> int:
        parent = int(model.body_parentid[body])
        return parent if parent in geoms or not parent else before(parent)

    pairs = list(itertools.combinations(links, 2))
    found = [pair for pair in pairs if before(pair[1]) == pair[0] or before(pair[0]) == pair[1]]
    doubtful = [pair for pair in pairs if pair not in found]
    rng = np.random.default_rng(0)
    for _ in range(OVERLAP_SAMPLES):
        data.qpos[model.jnt_qposadr] = rng.uniform(model.jnt_range[:, 0], model.jnt_range[:, 1])
        mujoco.mj_kinematics(model, data)
        doubtful = [
            (a, b)
            for a, b in doubtful
            if any(mujoco.mj_geomDistance(model, data, x, y, 1.0, None) < 0 for x in geoms[a] for y in geoms[b])
        ]
    return tuple((model.body(a).name, model.body(b).name) for a, b in [*found, *doubtful])


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


def place_body(body: mujoco.MjsBody, T_parent_body: Array) -> None:
    """Sets the pose (4, 4) of a body in its parent."""
    body.pos = T_parent_body[:3, 3]
    body.quat = quaternion_from_rotation(T_parent_body[:3, :3])


class Scene:
    """Arm, hand, assembly and environment; answers where the tool is and what is close to what.

    Args:
        sight: pairs closer than this are seen by `near`, m.
    """

    def __init__(self, assembly: Assembly, workcell: Workcell, sight: float) -> None:
        self.assembly = assembly
        self.workcell = workcell
        self.sight = sight
        self.description = workcell.description
        self.model = self._compile()
        self.data = mujoco.MjData(self.model)
        model = self.model
        joints = [model.joint(name) for name in self.description.arm_joints]
        self._arm = np.array([model.jnt_qposadr[joint.id] for joint in joints])
        self._fingers = np.array([model.jnt_qposadr[model.joint(name).id] for name in self.description.finger_joints])
        self.joint_limits: Array = np.array([model.jnt_range[joint.id] for joint in joints])  # (n, 2) rad
        self._hand = model.body(self.description.hand_links[0]).id
        self.static_bodies = [model.body(f"part/{part.name}").id for part in assembly.parts]
        self.held_bodies = [-1 if part.fixed else int(model.body(f"held/{part.name}").id) for part in assembly.parts]
        box = model.geom_type == mujoco.mjtGeom.mjGEOM_BOX
        self._finger_boxes = np.nonzero(box & (model.geom_contype == FINGER_BITS[0]))[0]
        self._boxes = np.empty(0, dtype=np.intp)  # of the fingers and the held part
        self._standing = np.empty(0, dtype=np.intp)
        self._standing_center: Array = np.empty((0, 3))  # m, world
        self._standing_reach: Array = np.empty((0, 3))  # m, half extents along the world's axes
        self.held: int | None = None
        self.show(assembly.root, None)
        self.place(workcell.home)

    def _compile(self) -> mujoco.MjModel:
        specification = robot_specification(self.description)
        # By default MuJoCo never tests a body against its parent; here `unchecked_pairs` decides.
        specification.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_FILTERPARENT
        place_body(specification.body(self.description.base_link), self.workcell.T_world_base)
        for body in specification.bodies:
            for geom in body.geoms:
                is_box = geom.type == mujoco.mjtGeom.mjGEOM_BOX
                geom.contype, geom.conaffinity = FINGER_BITS if is_box else ROBOT_BITS
                geom.margin = self.sight
        for first, second in unchecked_pairs(self.description):
            specification.add_exclude(bodyname1=first, bodyname2=second)
        hand = specification.body(self.description.hand_links[0])
        for i, part in enumerate(self.assembly.parts):
            static = specification.worldbody.add_body(name=f"part/{part.name}")
            place_body(static, part.T_world_part)
            for box in self.assembly.body(i):
                add_box(static, box, STATIC_BITS)
            if part.fixed:
                continue
            held = hand.add_body(name=f"held/{part.name}")
            for box in self.assembly.body(i):
                add_box(held, box, ABSENT_BITS, self.sight)
            # The fingers do not move relative to the held part: `check_fingers` looks at them once per step.
            for finger in self.description.finger_links:
                specification.add_exclude(bodyname1=finger, bodyname2=f"held/{part.name}")
        for obstacle in self.workcell.environment:
            body = specification.worldbody.add_body(name=f"environment/{obstacle.name}")
            add_box(body, obstacle.box, STATIC_BITS)
        return specification.compile()

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
        self._boxes = np.array([*self._finger_boxes, *held_geoms], dtype=np.intp)
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

    def grip(self, T_tool_part: Array, width: float) -> None:
        """Fastens the held part to the hand and opens the fingers to a width, m."""
        if self.held is not None:
            T_hand_part = np.array(T_tool_part)
            T_hand_part[:3, 3] += self.description.T_hand_tool
            body = self.held_bodies[self.held]
            self.model.body_pos[body] = T_hand_part[:3, 3]
            self.model.body_quat[body] = quaternion_from_rotation(T_hand_part[:3, :3])
        self.data.qpos[self._fingers] = width / 2

    def place(self, configuration: Array) -> None:
        """Moves the arm to joint angles (n,), rad."""
        self.data.qpos[self._arm] = configuration
        mujoco.mj_kinematics(self.model, self.data)

    def tool(self) -> tuple[Array, Array]:
        """Position (3,), m, and rotation (3, 3) of the tool frame in the world."""
        R = self.data.xmat[self._hand].reshape(3, 3).copy()
        return self.data.xpos[self._hand] + R @ np.array(self.description.T_hand_tool), R

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

        A pair with a mesh may occur several times, and its distance be off by 0.3 mm: call `distance` before judging
        it.
        """
        mujoco.mj_collision(self.model, self.data)
        pairs, distances = self.near_boxes()
        if self.data.ncon:
            pairs = np.concatenate([self.data.contact.geom.astype(np.intp), pairs])
            distances = np.concatenate([self.data.contact.dist, distances])
        return pairs, distances

    @property
    def overflowed(self) -> bool:
        """Whether MuJoCo ever ran out of memory for contacts: then `near` has left some out."""
        return bool(self.data.warning[mujoco.mjtWarning.mjWARN_CONTACTFULL].number)

    def near_boxes(self) -> tuple[NDArray[np.intp], Array]:
        """As `near`, of the boxes of the held part and the fingers against those that stand: first by their extents
        along the world's axes, which never miss a pair, then by MuJoCo's distance."""
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
        """Things that overlap before anything moves, by more than the tolerance, m: the robot's base link in a part, a
        removable part in an obstacle. Fixed parts may be let into obstacles, the base may stand on them."""
        base = self.geoms(self.description.base_link)
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
