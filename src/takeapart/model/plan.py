"""A plan: what the arm does, as data only."""

from __future__ import annotations

from dataclasses import dataclass, field

from takeapart.model.geometry import Array


@dataclass(frozen=True, eq=False)
class Grasp:
    """How the gripper holds a part before the part is moved (Sec. III: tau, Gamma, omega).

    Args:
        center: (3,) m, midpoint between the fingertips, world frame.
        orientation: (4,) unit quaternion (w, x, y, z) of the tool frame in the world frame; the tool's z axis is the
            approach direction, its y axis the direction in which the fingers close.
        width: opening between the fingers, m.
    """

    center: Array
    orientation: Array
    width: float


@dataclass(frozen=True, eq=False)
class PlanStep:
    """Removal of one part.

    Args:
        part: name of the part.
        grasp: at the start of the removal.
        joint_path: (M, n) joint angles, rad, in the order of `Plan.joints`; linear interpolation between rows is what
            the arm does.
        tool_path: (M, 7) tool poses of the same rows: x, y, z in m, then the quaternion w, x, y, z; world frame.
        length: sum of distances between consecutive tool positions, m (Eq. 2).
    """

    part: str
    grasp: Grasp
    joint_path: Array
    tool_path: Array
    length: float


@dataclass(frozen=True, eq=False)
class Plan:
    """An order of removals with everything needed to carry it out and to check it.

    Args:
        direction: "disassembly", or "assembly" for the inverted plan.
        steps: in the order of execution.
        total_length: sum of the step lengths, m (Eq. 3).
        straight_line_bound: no plan that grips each part somewhere in its volume is shorter, whatever planner made it,
            m.
        sequence_bound: no order is shorter, relative to the paths the planner found, m; None where the search gives
            none.
        counts: "motion_plans" and "removal_queries" that were spent.
        seconds: wall time of the search.
        seed: of the random generator.
        search: name and options of the search, and its statistics.
        hashes: SHA-256 of the "assembly" and the "workcell" in their canonical form.
        versions: of the package and the libraries that shape the result.
        assembly: the assembly's name.
        workcell: the workcell's name.
        robot: name of the arm with its gripper; empty in plans from files of version 1.
        joints: names of the arm's joints, one per column of a joint path; empty in plans from files of version 1, where
            they are those of the workcell's arm.
        remaining: names of the removable parts that a partial plan leaves where they are; empty in a plan of the whole
            product.
    """

    steps: tuple[PlanStep, ...]
    total_length: float
    straight_line_bound: float
    sequence_bound: float | None
    counts: dict[str, int]
    seconds: float
    seed: int
    search: dict[str, object]
    hashes: dict[str, str]
    versions: dict[str, str]
    assembly: str
    workcell: str
    direction: str = "disassembly"
    robot: str = ""
    joints: tuple[str, ...] = ()
    remaining: tuple[str, ...] = ()
    extra: dict[str, object] = field(default_factory=dict)

    def inverted(self) -> Plan:
        """The same plan read backwards: steps in reverse order, every path reversed."""
        steps = tuple(
            PlanStep(step.part, step.grasp, step.joint_path[::-1].copy(), step.tool_path[::-1].copy(), step.length)
            for step in reversed(self.steps)
        )
        direction = "assembly" if self.direction == "disassembly" else "disassembly"
        return Plan(**{**self.__dict__, "steps": steps, "direction": direction})
