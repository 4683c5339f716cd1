"""What is shown of an assembly or a plan, whoever draws it: colours, moments, places for removed parts.

A moment is told by a step (0 is the first removal) and the fraction of its tool path that is behind, from 0 to 1.
Between two steps the arm jumps: a plan holds no motion from the goal to the next grasp.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from takeapart.formats.serialization import assembly_hash
from takeapart.model.assembly import Assembly, Part
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, OrientedBox, pose, pose_inverse, rotation_from_quaternion
from takeapart.model.meshes import Mesh
from takeapart.model.plan import Plan, PlanStep
from takeapart.show.robot import RobotVisual, load_robot_visual
from takeapart.show.surfaces import Surface, surfaces_of
from takeapart.states import members
from takeapart.workcell import Workcell

Color = tuple[float, float, float]

ROLES: dict[str, str] = {  # the paper's figures: frame yellow, back cyan, front purple
    "frame": "#f0bf4c",
    "back": "#4db6c6",
    "front": "#9a78cf",
    "support": "#86b978",
    "carrier": "#b3cfa4",
    "column": "#7f9cc0",
    "top": "#b4c4d8",
}
FIXED, CURRENT, PATH, GOAL = "#a3a8ae", "#f2683c", "#e4572e", "#2e9e6b"
OTHERS = (  # roles that the table does not have
    *("#4db6c6", "#f0bf4c", "#9a78cf", "#86b978", "#e08f8f", "#7f9cc0"),
    *("#c9a27a", "#4f9088", "#c77fae", "#b5bb52", "#6a7fc4", "#d9b8a4"),
)
STEEL = "#c9cdd2"  # obstacles

TURNING = 0.05  # m per rad: what turning counts of the way of the tool, as it is shown
FINGERS_OPEN = 0.02  # m, how much wider than the grasp the gripper is shown before it closes
LARGEST_MISS = 0.01  # m, of the tool from where its path says; more is a corrupted plan
LAYOUT_GAP = 0.035  # m, between parts that are laid out
PATH_SHARE, THINNEST_PATH, THICKEST_PATH = 0.008, 0.001, 0.004  # of the assembly's diagonal; m: radius of a tool path


def rgb(color: str) -> Color:
    """``"#ff8000"`` as numbers from 0 to 1."""
    red, green, blue = (int(color[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return red, green, blue


def darker(color: Color, factor: float = 0.82) -> Color:
    """The same colour in shade, for connectors."""
    return color[0] * factor, color[1] * factor, color[2] * factor


def role_of(part: Part) -> str:
    """What a part is for: "fixed", or its name up to the first underscore, digit or point."""
    if part.fixed:
        return "fixed"
    word = part.name
    for end, character in enumerate(part.name):
        if not character.isalpha():
            word = part.name[:end]
            break
    return word or "part"


def colors_of(assembly: Assembly) -> tuple[str, ...]:
    """Colour of every part: by its role; where names tell none, since all parts bear the same word, by its shape, and
    where these are equal too, one after the other."""
    free = [part for part in assembly.parts if not part.fixed]
    words = {role_of(part) for part in free}
    tells = len(words) > 1 or bool(words & set(ROLES))
    shapes = {_shape_of(part) for part in free}
    known: dict[object, str] = {"fixed": FIXED}
    known.update(ROLES)

    def color(number: int, part: Part) -> str:
        role = role_of(part)
        key: object = role
        if not (tells or part.fixed):
            key = _shape_of(part) if len(shapes) > 1 else number
        if key not in known:
            known[key] = OTHERS[(len(known) - len(ROLES) - 1) % len(OTHERS)]
        return known[key]

    return tuple(color(number, part) for number, part in enumerate(assembly.parts))


def _shape_of(part: Part) -> object:
    """What equal shapes share."""
    return part.shape.hash if isinstance(part.shape, Mesh) else part.shape


@dataclass(frozen=True, eq=False)
class Moment:
    """The workcell at one moment of a plan.

    Args:
        step: number of the removal in the order of disassembly.
        fraction: of its tool path, from 0 to 1.
        configuration: (n,) rad.
        opening: between the fingers, m.
        held: number of the part that is gripped.
        T_world_held: (4, 4).
        standing: state of the parts that stand in the assembly.
        gone: numbers of the parts that left before, in their order.
    """

    step: int
    fraction: float
    configuration: Array
    opening: float
    held: int
    T_world_held: Array
    standing: int
    gone: tuple[int, ...]


class PlanScene:
    """An assembly in its workcell, with or without a plan; a plan for assembly is read backwards.

    Raises:
        InputError: the plan does not belong to the assembly, or its steps contradict themselves.
    """

    def __init__(self, assembly: Assembly, workcell: Workcell, plan: Plan | None = None) -> None:
        self.assembly, self.workcell, self.plan = assembly, workcell, plan
        self.robot: RobotVisual = load_robot_visual(workcell.description, workcell.T_world_base)
        self.colors = colors_of(assembly)
        self.direction = "disassembly" if plan is None else plan.direction
        removals = plan if plan is None or plan.direction == "disassembly" else plan.inverted()
        self.steps: tuple[PlanStep, ...] = () if removals is None else removals.steps
        if plan is not None:
            _check(plan, self.steps, assembly, workcell)
        self.order = tuple(assembly.index[step.part] for step in self.steps)
        self._states = [assembly.root]
        for part in self.order:
            self._states.append(self._states[-1] & ~(1 << part))
        self._along = [_along(step.tool_path) for step in self.steps]
        self._held: list[Array] = []
        for number, step in enumerate(self.steps):
            self._held.append(self._grip(number, step))

    def _grip(self, number: int, step: PlanStep) -> Array:
        """Pose (4, 4) of the part in the gripper's base link, once the two ends of the path were found to be where they
        should be."""
        for row in (0, -1):
            T_world_tool = self.robot.tool_pose(step.joint_path[row], step.grasp.width)
            miss = float(np.linalg.norm(T_world_tool[:3, 3] - step.tool_path[row, :3]))
            if not miss <= LARGEST_MISS:
                raise InputError(
                    f"the joints put the tool {miss:.3f} m from where the tool path says; the plan is corrupted, or "
                    "was made for another workcell",
                    f"plan of {self.assembly.name}: steps[{number}] ({step.part})",
                )
        T_hand_world = pose_inverse(self.robot.hand_pose(step.joint_path[0]))
        return np.asarray(T_hand_world @ self.assembly.parts[self.order[number]].T_world_part)

    def along(self, step: int) -> Array:
        """Way of the tool (M,) up to each row of a step, m; turning counts a little."""
        return self._along[step]

    def grasp_text(self, step: int) -> str:
        """Where the gripper comes from, and how wide it is: "from above, 20 mm wide"."""
        grasp = self.steps[step].grasp
        return f"{_direction(rotation_from_quaternion(grasp.orientation)[:, 2])}, {1000 * grasp.width:.0f} mm wide"

    @property
    def T_hand_parts(self) -> list[Array]:
        """Per step the pose (4, 4) of its part in the gripper's base link, which does not move while fingers open."""
        return self._held

    def state(self, step: int) -> int:
        """Parts that stand before a step, its own part included."""
        return self._states[step]

    def moment(self, step: int, fraction: float, opening: float | None = None) -> Moment:
        """The workcell while a part is on its way."""
        plan_step, along = self.steps[step], self._along[step]
        rows = np.asarray(plan_step.joint_path)
        wanted = min(max(fraction, 0.0), 1.0) * along[-1]
        row = int(np.clip(np.searchsorted(along, wanted, side="right") - 1, 0, len(rows) - 2))
        span = along[row + 1] - along[row]
        share = (wanted - along[row]) / span if span > 0 else 1.0
        configuration = rows[row] + (rows[row + 1] - rows[row]) * min(share, 1.0)
        return Moment(
            step,
            fraction,
            configuration,
            plan_step.grasp.width if opening is None else opening,
            self.order[step],
            self.robot.hand_pose(configuration) @ self._held[step],
            self._states[step + 1],
            self.order[:step],
        )

    @cached_property
    def surfaces(self) -> dict[str, Surface]:
        """What is drawn of meshes, by the hash of their shape."""
        return surfaces_of(self.assembly)

    def surface(self, part: int) -> Surface | None:
        """What is drawn of a part that is a mesh."""
        shape = self.assembly.parts[part].shape
        return self.surfaces[shape.hash] if isinstance(shape, Mesh) else None

    def boxes(self, part: int) -> tuple[tuple[OrientedBox, ...], tuple[OrientedBox, ...]]:
        """Boxes that are drawn of a part, in its frame: of its shape, which are none of a mesh, and of the connectors
        on it."""
        shape = self.assembly.parts[part].shape
        return () if isinstance(shape, Mesh) else shape.boxes(), self.assembly.walls(part)

    def corners(self, part: int) -> Array:
        """Points (P, 3), m, in the frame of a part, that its hull goes through: what is drawn lies within."""
        surface = self.surface(part)
        points = [] if surface is None else [surface.vertices.astype(float)]
        return np.concatenate([*points, *(box.corners() for boxes in self.boxes(part) for box in boxes)])

    @cached_property
    def laid_out(self) -> dict[int, Array]:
        """Poses (4, 4) of the removable parts when they lie beside the assembly, first removed first, longest edge
        along the rows."""
        order = self.order or tuple(members(self.assembly.root))
        low, high = self.bounds
        base, goal = self.workcell.T_world_base[:3, 3], self.workcell.goal
        middle = (low + high) / 2
        axis = int(np.argmin(np.abs(middle - base)[:2]))  # beside the line from the arm to the assembly,
        sign = -1 if goal[axis] > middle[axis] else 1  # away from the goal
        sizes = [2 * self.assembly.parts[part].shape.bounding_box().half_extents for part in order]
        width = (high - low)[1 - axis] + 0.3
        depth, across, row_depth = 0.12, 0.0, 0.0
        placed: dict[int, Array] = {}
        for part, size in zip(order, sizes, strict=True):
            turn = _longest_first(size)
            length, thick, height = np.abs(turn @ size)
            if across and across + length > width:
                depth, across, row_depth = depth + row_depth + LAYOUT_GAP, 0.0, 0.0
            along = low[1 - axis] - 0.15 + across + length / 2
            away = (low if sign < 0 else high)[axis] + sign * (depth + thick / 2)
            T = np.eye(4)
            T[:2, 3] = (along, away) if axis == 1 else (away, along)
            T[2, 3] = low[2] + height / 2
            T[:3, :3] = turn if axis == 1 else pose(quaternion=(math.sqrt(0.5), 0, 0, math.sqrt(0.5)))[:3, :3] @ turn
            T_part_box = self.assembly.parts[part].shape.bounding_box().T_frame_box
            placed[part] = T @ pose_inverse(T_part_box)
            across += length + LAYOUT_GAP
            row_depth = max(row_depth, thick)
        return placed

    @property
    def path_radius(self) -> float:
        """Of the line that shows a tool path, m: thin beside small products."""
        low, high = self.bounds
        return float(np.clip(PATH_SHARE * np.linalg.norm(high - low), THINNEST_PATH, THICKEST_PATH))

    @cached_property
    def reached(self) -> Array:
        """Points (P, 3), m, that arm and held parts reach: at rest, and at the beginning, middle and end of every
        path."""
        links = [self.robot.poses(self.workcell.home, 0.0)[:, :3, 3]]
        for step in range(len(self.steps)):
            for fraction in (0.0, 0.5, 1.0):
                moment = self.moment(step, fraction)
                links.append(self.robot.poses(moment.configuration, 0.0)[:, :3, 3])
                box = self.assembly.parts[moment.held].shape.bounding_box()
                links.append(box.moved(moment.T_world_held).corners())
        return np.vstack(links)

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Least and greatest coordinates (3,) of the assembly, m."""
        corners = np.concatenate(
            [
                self.corners(i) @ part.T_world_part[:3, :3].T + part.T_world_part[:3, 3]
                for i, part in enumerate(self.assembly.parts)
            ]
        )
        return corners.min(axis=0), corners.max(axis=0)


def _direction(approach: Array) -> str:
    """In the words of the assembly's frame: front is x = 0, right is y = 0."""
    names = (("from the front", "from the back"), ("from the right", "from the left"), ("from below", "from above"))
    axis = int(abs(approach).argmax())
    return names[axis][0 if approach[axis] > 0 else 1]


def _longest_first(size: Array) -> Array:
    """Rotation (3, 3) that turns a box so that its longest edge is along x and its shortest along z."""
    order = np.argsort(-size, kind="stable")
    R = np.zeros((3, 3))
    R[[0, 1, 2], order] = 1.0
    if np.linalg.det(R) < 0:
        R[2] = -R[2]
    return R


def _along(tool_path: Array) -> Array:
    """Way of the tool (M,) up to each row, m, with the turning counted a little, so that it is seen."""
    moved = np.linalg.norm(np.diff(tool_path[:, :3], axis=0), axis=1)
    cosine = np.abs((tool_path[1:, 3:] * tool_path[:-1, 3:]).sum(axis=1)).clip(0, 1)
    return np.concatenate([[0.0], np.cumsum(moved + TURNING * 2 * np.arccos(cosine))])


def _check(plan: Plan, steps: tuple[PlanStep, ...], assembly: Assembly, workcell: Workcell) -> None:
    where = f"plan of {plan.assembly}"
    if assembly_hash(assembly) != plan.hashes.get("assembly"):
        raise InputError(f"was made for another assembly than {assembly.name!r}; give its own with --assembly", where)
    joints = workcell.description.arm.joints
    if plan.joints and plan.joints != joints:
        message = f"moves joints {', '.join(plan.joints)}; those of the workcell's arm are {', '.join(joints)}"
        raise InputError(message, where)
    seen: set[str] = set()
    for number, step in enumerate(steps):
        place = f"{where}: steps[{number}] ({step.part})"
        if step.part not in assembly.index or assembly.parts[assembly.index[step.part]].fixed:
            raise InputError("is no removable part of the assembly", place)
        if step.part in seen:
            raise InputError("the part was removed before", place)
        seen.add(step.part)
        if len(step.joint_path) < 2 or len(step.joint_path) != len(step.tool_path):
            raise InputError("joint path and tool path must have the same number of rows, at least 2", place)
        if step.joint_path.shape[1] != len(joints):
            raise InputError(f"{step.joint_path.shape[1]} joints; the arm of the workcell has {len(joints)}", place)
