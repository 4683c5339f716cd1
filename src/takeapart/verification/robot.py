"""The robot of the verification: the arm with the gripper on its flange as a MuJoCo model, and what its joints do."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from takeapart.model.description import RobotDescription
from takeapart.model.errors import InputError, MissingExtraError
from takeapart.model.geometry import Array, quaternion_from_rotation
from takeapart.verification.urdf import UrdfBranch, arm_branch, gripper_branch

try:
    import mujoco as mujoco  # the other modules of the verification take it from here
except ImportError as missing:
    raise MissingExtraError("verification", "verify", "mujoco") from missing

OVERLAP_SAMPLES = 200  # configurations in which links must overlap to count as links that always do


ATTACHED = "gripper/"


def gripper_prefix(description: RobotDescription) -> str:
    """What stands before the names of the gripper's links and joints: nothing, unless the arm has one of them too."""
    arm, gripper = arm_branch(description), gripper_branch(description)
    return ATTACHED if {*arm.links, *arm.joints} & {*gripper.links, *gripper.joints} else ""


def _parsed(branch: UrdfBranch, further: Mapping[str, bytes]) -> mujoco.MjSpec:
    """Editable model of a branch: collision geometry only, every link kept as a body; with further mesh files, of what
    will be attached to it: MuJoCo looks for them here."""
    try:
        return mujoco.MjSpec.from_string(branch.xml, assets={**branch.assets, **further})
    except ValueError as error:
        raise InputError(f"MuJoCo cannot read it: {str(error).splitlines()[0]}", branch.name) from None


def robot_specification(description: RobotDescription) -> mujoco.MjSpec:
    """Editable model of the arm with the gripper on its flange.

    Raises:
        InputError: a file cannot be read, or does not hold what the description says.
    """
    branch = gripper_branch(description)
    found, gripper = _parsed(arm_branch(description), branch.assets), _parsed(branch, {})
    T = description.T_flange_gripper
    mount = found.body(description.arm.flange_link).add_frame(pos=T[:3, 3], quat=quaternion_from_rotation(T[:3, :3]))
    attached = mount.attach_body(gripper.body(description.gripper.base_link), ATTACHED, "")
    prefix = gripper_prefix(description)
    for body in [attached, *attached.find_all("body")]:
        for element in [body, *body.joints]:
            element.name = prefix + element.name.removeprefix(ATTACHED)
    return found


def compiled(specification: mujoco.MjSpec, description: RobotDescription) -> mujoco.MjModel:
    """The model of a specification.

    Raises:
        InputError: MuJoCo refuses it, for example a mesh that is flat.
    """
    try:
        return specification.compile()
    except ValueError as error:
        raise InputError(f"MuJoCo cannot build it: {str(error).splitlines()[0]}", description.name) from None


class Joints:
    """Writes joint positions into MuJoCo's state: those of the arm, those that the opening of the gripper sets, and
    those that follow others.

    Args:
        limits: (n, 2) rad, of the arm's joints; infinite where a joint turns without end.
    """

    def __init__(self, model: mujoco.MjModel, description: RobotDescription) -> None:
        self.gripper = description.gripper
        arm, gripper, prefix = arm_branch(description), gripper_branch(description), gripper_prefix(description)
        self.limits: Array = np.array([arm.limits[name] for name in description.arm.joints])
        self.gripper_limits = {name: gripper.limits[name] for name in self.gripper.joints}
        self._arm = _addresses(model, description.arm.joints)
        self._gripper = _addresses(model, [prefix + name for name in self.gripper.joints])
        follow = [*arm.mimics, *gripper.mimics]
        before = [""] * len(arm.mimics) + [prefix] * len(gripper.mimics)
        self._followers = _addresses(model, [p + mimic.joint for p, mimic in zip(before, follow, strict=True)])
        self._followed = _addresses(model, [p + mimic.follows for p, mimic in zip(before, follow, strict=True)])
        self._multiplier: Array = np.array([mimic.multiplier for mimic in follow])
        self._offset: Array = np.array([mimic.offset for mimic in follow])

    def set_arm(self, data: mujoco.MjData, configuration: Array) -> None:
        """Joint angles (n,), rad."""
        data.qpos[self._arm] = configuration
        self._follow(data)

    def set_opening(self, data: mujoco.MjData, opening: float) -> None:
        """Distance between the pads, m, as the description has it."""
        positions = self.gripper.joint_positions(opening)
        data.qpos[self._gripper] = [positions[name] for name in self.gripper.joints]
        self._follow(data)

    def _follow(self, data: mujoco.MjData) -> None:
        data.qpos[self._followers] = self._multiplier * data.qpos[self._followed] + self._offset

    def beyond_limits(self, opening: float) -> list[tuple[str, float, tuple[float, float]]]:
        """Joints of the gripper that the opening sets outside their limits: name, position, limits, rad or m."""
        positions = self.gripper.joint_positions(opening)
        return [
            (name, positions[name], (low, high))
            for name, (low, high) in self.gripper_limits.items()
            if not low - 1e-9 <= positions[name] <= high + 1e-9
        ]

    def scattered(self, data: mujoco.MjData, rng: np.random.Generator) -> None:
        """Sets all joints at random: inside their limits, or all the way round where they have none."""
        limits = np.where(np.isinf(self.limits), [-np.pi, np.pi], self.limits)
        self.set_arm(data, rng.uniform(limits[:, 0], limits[:, 1]))
        self.set_opening(data, rng.uniform(self.gripper.openings[0], self.gripper.openings[-1]))


def _addresses(model: mujoco.MjModel, names: list[str] | tuple[str, ...]) -> NDArray[np.intp]:
    """Where the positions of joints stand in MuJoCo's state."""
    return np.array([model.jnt_qposadr[model.joint(name).id] for name in names], dtype=np.intp)


def gripper_bodies(model: mujoco.MjModel, description: RobotDescription) -> list[int]:
    """Numbers of the bodies that are links of the gripper."""
    prefix = gripper_prefix(description)
    return [int(model.body(prefix + link).id) for link in gripper_branch(description).links]


@lru_cache(maxsize=8)
def unchecked_pairs(description: RobotDescription) -> tuple[tuple[str, str], ...]:
    """Pairs of the robot's links that may touch: the next link in the chain, links without geometry skipped; links of
    the gripper with each other; and links that overlap in each of many configurations drawn here. No file is believed
    about it.
    """
    model = compiled(robot_specification(description), description)
    data, joints = mujoco.MjData(model), Joints(model, description)
    geoms = {
        b: range(a, a + n) for b, (a, n) in enumerate(zip(model.body_geomadr, model.body_geomnum, strict=True)) if n
    }
    links = [body for body in geoms if body]
    gripper = set(gripper_bodies(model, description))

    def before(body: int) -> int:
        parent = int(model.body_parentid[body])
        return parent if parent in geoms or not parent else before(parent)

    pairs = list(itertools.combinations(links, 2))
    found = [(a, b) for a, b in pairs if before(b) == a or before(a) == b or {a, b} <= gripper]
    doubtful = [pair for pair in pairs if pair not in found]
    rng = np.random.default_rng(0)
    for _ in range(OVERLAP_SAMPLES):
        joints.scattered(data, rng)
        mujoco.mj_kinematics(model, data)
        doubtful = [
            (a, b)
            for a, b in doubtful
            if any(mujoco.mj_geomDistance(model, data, x, y, 1.0, None) < 0 for x in geoms[a] for y in geoms[b])
        ]
    return tuple((model.body(a).name, model.body(b).name) for a, b in [*found, *doubtful])
