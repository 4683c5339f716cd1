"""Corruptions of a valid plan, one at a time, each with the check that must refuse it.

Every mutation keeps the rest of the plan consistent (lengths, total, tool paths), so that the verifier cannot refuse it
for a cheaper reason than the right one. A mutation that finds nothing to corrupt returns None.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Array, quaternion_from_rotation, rotation_from_quaternion
from takeapart.model.plan import Grasp, Plan, PlanStep
from takeapart.workcell import Workcell
from verification_scene import line_path, tool_rows

PANDA_LIMIT_7 = 2.8973  # rad, last joint


@dataclass(frozen=True)
class Corrupted:
    """A corrupted plan: the verifier must give a finding of `check` in `step` (None: of the plan or of any step)."""

    name: str
    plan: Plan
    check: str
    step: int | None


@dataclass(frozen=True)
class Target:
    """What mutations may look at."""

    plan: Plan
    assembly: Assembly
    workcell: Workcell


Mutation = Callable[[Target, np.random.Generator], Corrupted | None]
MUTATIONS: dict[str, Mutation] = {}


def mutation(function: Mutation) -> Mutation:
    MUTATIONS[function.__name__] = function
    return function


def corrupted_plans(target: Target, count: int, rng: np.random.Generator) -> Iterator[Corrupted]:
    """`count` corrupted plans, all mutations in turn."""
    made, names = 0, list(MUTATIONS)
    for k in range(20 * count):
        if made == count:
            return
        corrupted = MUTATIONS[names[k % len(names)]](target, rng)
        if corrupted is not None:
            made += 1
            yield corrupted
    raise AssertionError(f"only {made} of {count} corrupted plans could be made")


def _lengths(plan: Plan) -> Plan:
    """The same plan with the total that its steps give."""
    return replace(plan, total_length=sum(step.length for step in plan.steps))


def _with_steps(plan: Plan, steps: list[PlanStep]) -> Plan:
    return _lengths(replace(plan, steps=tuple(steps)))


def _changed(target: Target, name: str, check: str, k: int, **changes: object) -> Corrupted:
    """The plan with one step changed and the total adapted."""
    steps = list(target.plan.steps)
    steps[k] = replace(steps[k], **changes)  # type: ignore[arg-type]
    return Corrupted(name, _with_steps(target.plan, steps), check, k)


def _rerouted(target: Target, name: str, check: str, k: int, joint_path: Array, tool_path: Array) -> Corrupted:
    """The plan with one path replaced, its length and the total adapted."""
    length = float(np.linalg.norm(np.diff(tool_path[:, :3], axis=0), axis=1).sum())
    return _changed(target, name, check, k, joint_path=joint_path, tool_path=tool_path, length=length)


def _any_step(target: Target, rng: np.random.Generator) -> tuple[int, PlanStep]:
    k = int(rng.integers(len(target.plan.steps)))
    return k, target.plan.steps[k]


def _lift_rows(target: Target, step: PlanStep) -> int:
    """Number of the first row at full lift height."""
    height = step.tool_path[:, 2] - step.tool_path[0, 2]
    return int(np.argmax(height >= target.workcell.lift_height - 1e-6))


# --- bookkeeping ---


@mutation
def wrong_hash(target: Target, rng: np.random.Generator) -> Corrupted:
    origin = ("assembly", "workcell")[int(rng.integers(2))]
    plan = replace(target.plan, hashes={**target.plan.hashes, origin: "0" * 64})
    return Corrupted("wrong_hash", plan, "hash", None)


@mutation
def other_name(target: Target, rng: np.random.Generator) -> Corrupted:
    """The hashes are right, but the plan says that it is for something else."""
    origin = ("assembly", "workcell")[int(rng.integers(2))]
    return Corrupted("other_name", replace(target.plan, **{origin: "another"}), "hash", None)  # type: ignore[arg-type]


@mutation
def other_joints(target: Target, rng: np.random.Generator) -> Corrupted:
    """The same paths for the joints of another arm, or for these in another order."""
    joints = list(target.plan.joints)
    i, j = rng.choice(len(joints), 2, replace=False)
    joints[i], joints[j] = (joints[j], joints[i]) if rng.integers(2) else ("joint1", joints[j])
    return Corrupted("other_joints", replace(target.plan, joints=tuple(joints)), "robot", None)


@mutation
def made_for_another_base(target: Target, rng: np.random.Generator) -> Corrupted:
    """As planned where the robot stands some millimetres away; hashes forged."""
    offset = rng.normal(size=3)
    offset *= rng.uniform(5e-4, 0.01) / np.linalg.norm(offset)
    steps = [
        replace(
            step,
            grasp=replace(step.grasp, center=step.grasp.center + offset),
            tool_path=step.tool_path + [*offset, 0, 0, 0, 0],
        )
        for step in target.plan.steps
    ]
    return Corrupted("made_for_another_base", _with_steps(target.plan, steps), "tool_path", None)


@mutation
def direction_unknown(target: Target, rng: np.random.Generator) -> Corrupted:
    name = ("", "sideways", "Assembly")[int(rng.integers(3))]
    return Corrupted("direction_unknown", replace(target.plan, direction=name), "schema", None)


@mutation
def part_dropped(target: Target, rng: np.random.Generator) -> Corrupted:
    k, _ = _any_step(target, rng)
    steps = [step for i, step in enumerate(target.plan.steps) if i != k]
    return Corrupted("part_dropped", _with_steps(target.plan, steps), "order", None)


@mutation
def part_duplicated(target: Target, rng: np.random.Generator) -> Corrupted:
    k, step = _any_step(target, rng)
    steps = list(target.plan.steps)
    at = int(rng.integers(k + 1, len(steps) + 1))
    steps.insert(at, step)
    return Corrupted("part_duplicated", _with_steps(target.plan, steps), "order", at)


@mutation
def part_unknown(target: Target, rng: np.random.Generator) -> Corrupted:
    k, step = _any_step(target, rng)
    return _changed(target, "part_unknown", "order", k, part=step.part + "-x")


@mutation
def part_fixed(target: Target, rng: np.random.Generator) -> Corrupted:
    k, _ = _any_step(target, rng)
    fixed = [part.name for part in target.assembly.parts if part.fixed]
    return _changed(target, "part_fixed", "order", k, part=fixed[int(rng.integers(len(fixed)))])


@mutation
def names_exchanged(target: Target, rng: np.random.Generator) -> Corrupted:
    """Two steps keep their grasps and paths, but claim each other's part."""
    steps = list(target.plan.steps)
    a, b = sorted(int(i) for i in rng.choice(len(steps), 2, replace=False))
    steps[a], steps[b] = replace(steps[a], part=steps[b].part), replace(steps[b], part=steps[a].part)
    return Corrupted("names_exchanged", _with_steps(target.plan, steps), "grasp", None)


# --- order ---


def _guests(target: Target, host: str) -> list[int]:
    """Steps of the parts that the connectors of `host` carry from below (all U; O only for uprights)."""
    guests = {c.guest for c in target.assembly.connectors if c.host == host and c.kind == "U"}
    return [k for k, step in enumerate(target.plan.steps) if step.part in guests]


@mutation
def unstable_order(target: Target, rng: np.random.Generator) -> Corrupted | None:
    """A host leaves before the part that it carries."""
    pairs = [(h, g) for h, step in enumerate(target.plan.steps) for g in _guests(target, step.part) if g < h]
    if not pairs:
        return None
    host, guest = pairs[int(rng.integers(len(pairs)))]
    steps = list(target.plan.steps)
    steps.insert(guest, steps.pop(host))
    return Corrupted("unstable_order", _with_steps(target.plan, steps), "stability", guest)


@mutation
def steps_swapped(target: Target, rng: np.random.Generator) -> Corrupted | None:
    """Host and guest change places."""
    pairs = [(h, g) for h, step in enumerate(target.plan.steps) for g in _guests(target, step.part) if g < h]
    if not pairs:
        return None
    host, guest = pairs[int(rng.integers(len(pairs)))]
    steps = list(target.plan.steps)
    steps[host], steps[guest] = steps[guest], steps[host]
    return Corrupted("steps_swapped", _with_steps(target.plan, steps), "stability", guest)


@mutation
def carried_along(target: Target, rng: np.random.Generator) -> Corrupted | None:
    """As `unstable_order`, refused for another right reason: the host's connector hits the guest above it."""
    corrupted = unstable_order(target, rng)
    return corrupted and replace(corrupted, name="carried_along", check="collision")


# --- grasp ---


@mutation
def grasp_beside(target: Target, rng: np.random.Generator) -> Corrupted:
    k, step = _any_step(target, rng)
    offset = 0.03 * rotation_from_quaternion(step.grasp.orientation)[:, 2] * rng.choice([-1, 1])
    grasp = Grasp(step.grasp.center + offset, step.grasp.orientation, step.grasp.width)
    return _changed(target, "grasp_beside", "grasp", k, grasp=grasp)


@mutation
def grasp_elsewhere(target: Target, rng: np.random.Generator) -> Corrupted:
    """The grasp moves along the part, the path does not."""
    k, step = _any_step(target, rng)
    offset = rng.uniform(5e-4, 0.01) * rotation_from_quaternion(step.grasp.orientation)[:, 0]
    grasp = Grasp(step.grasp.center + offset, step.grasp.orientation, step.grasp.width)
    return _changed(target, "grasp_elsewhere", "start_pose", k, grasp=grasp)


@mutation
def grasp_turned(target: Target, rng: np.random.Generator) -> Corrupted:
    """The grasp is turned about the approach direction, the path is not."""
    k, step = _any_step(target, rng)
    orientation = _turned(step.grasp.orientation, rng.uniform(0.002, np.pi / 2))
    grasp = Grasp(step.grasp.center, orientation, step.grasp.width)
    return _changed(target, "grasp_turned", "start_pose", k, grasp=grasp)


@mutation
def grasp_oblique(target: Target, rng: np.random.Generator) -> Corrupted:
    """Grasp and path agree, but the fingers close obliquely: the last joint turns by the same angle all along."""
    k, step = _any_step(target, rng)
    angle = float(np.exp(rng.uniform(np.log(0.001), np.log(0.4)))) * (1 if step.joint_path[:, 6].mean() < 0 else -1)
    return Corrupted("grasp_oblique", with_wrist_turned(target, k, angle), "grasp", k)


@mutation
def fingers_ajar(target: Target, rng: np.random.Generator) -> Corrupted:
    k, step = _any_step(target, rng)
    grasp = replace(step.grasp, width=step.grasp.width + float(rng.uniform(3e-4, 0.01)))
    return _changed(target, "fingers_ajar", "finger_contact", k, grasp=grasp)


@mutation
def width_wrong(target: Target, rng: np.random.Generator) -> Corrupted:
    k, step = _any_step(target, rng)
    width = step.grasp.width + float(rng.choice([-1, 1]) * rng.uniform(2e-5, 5e-3))
    return _changed(target, "width_wrong", "width", k, grasp=replace(step.grasp, width=width))


@mutation
def width_beyond_gripper(target: Target, rng: np.random.Generator) -> Corrupted:
    k, step = _any_step(target, rng)
    width = target.workcell.description.maximum_opening + float(rng.uniform(1e-4, 0.05))
    return _changed(target, "width_beyond_gripper", "width", k, grasp=replace(step.grasp, width=width))


# --- lengths and bounds ---


@mutation
def length_shortened(target: Target, rng: np.random.Generator) -> Corrupted:
    k, step = _any_step(target, rng)
    return _changed(target, "length_shortened", "length", k, length=step.length - float(rng.uniform(1e-5, 0.1)))


@mutation
def length_trimmed(target: Target, rng: np.random.Generator) -> Corrupted | None:
    """Every row of the tool path is off by less than its tolerance, but all so that the path becomes shorter."""
    k, step = _any_step(target, rng)
    tool_path = step.tool_path.copy()
    points = tool_path[:, :3]
    for _ in range(400):  # drawn tight as far as the tolerance allows; the ends move along the path
        inner = np.vstack([points[1:2], (points[:-2] + points[2:]) / 2, points[-2:-1]])
        off = inner - step.tool_path[:, :3]
        points = (
            step.tool_path[:, :3] + off * np.minimum(1, 9e-5 / np.maximum(np.linalg.norm(off, axis=1), 1e-12))[:, None]
        )
    tool_path[:, :3] = points
    corrupted = _rerouted(target, "length_trimmed", "length", k, step.joint_path, tool_path)
    return corrupted if step.length - corrupted.plan.steps[k].length > 1.2e-4 else None


@mutation
def total_shortened(target: Target, rng: np.random.Generator) -> Corrupted:
    total = target.plan.total_length - float(rng.uniform(1e-4, 0.1))
    return Corrupted("total_shortened", replace(target.plan, total_length=total), "total_length", None)


@mutation
def bound_raised(target: Target, rng: np.random.Generator) -> Corrupted:
    bound = target.plan.straight_line_bound + float(rng.uniform(1e-5, 5.0))
    return Corrupted("bound_raised", replace(target.plan, straight_line_bound=bound), "bound", None)


@mutation
def sequence_bound_above_total(target: Target, rng: np.random.Generator) -> Corrupted:
    bound = target.plan.total_length + float(rng.uniform(1e-3, 1.0))
    return Corrupted("sequence_bound_above_total", replace(target.plan, sequence_bound=bound), "bound", None)


@mutation
def bound_not_a_number(target: Target, rng: np.random.Generator) -> Corrupted:
    plans = (
        replace(target.plan, straight_line_bound=np.nan),
        replace(target.plan, sequence_bound=np.nan),
        replace(target.plan, sequence_bound=np.inf),
    )
    plan = plans[int(rng.integers(3))]
    return Corrupted("bound_not_a_number", plan, "bound", None)


# --- paths ---


def _turned(quaternion: Array, angle: float) -> Array:
    """Orientation turned about its own z axis."""
    turn = rotation_from_quaternion([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])
    return quaternion_from_rotation(rotation_from_quaternion(quaternion) @ turn)


def _wrist_turned(step: PlanStep, angles: Array) -> tuple[Array, Array]:
    """Joint and tool path with the last joint turned by angles (M,): the tool turns about its own z axis in place."""
    joint_path, tool_path = step.joint_path.copy(), step.tool_path.copy()
    joint_path[:, 6] += angles
    tool_path[:, 3:] = [_turned(row, angle) for row, angle in zip(tool_path[:, 3:], angles, strict=True)]
    return joint_path, tool_path


def with_wrist_turned(target: Target, k: int, angle: float) -> Plan:
    """The plan with the last joint turned all along a step, and the grasp with it."""
    step = target.plan.steps[k]
    joint_path, tool_path = _wrist_turned(step, np.full(len(step.joint_path), angle))
    grasp = Grasp(step.grasp.center, _turned(step.grasp.orientation, angle), step.grasp.width)
    steps = list(target.plan.steps)
    steps[k] = replace(step, grasp=grasp, joint_path=joint_path, tool_path=tool_path)
    return _with_steps(target.plan, steps)


@mutation
def joint_beyond_limit(target: Target, rng: np.random.Generator) -> Corrupted:
    """The last joint swings smoothly over its limit and back, after the lift; the tool path follows."""
    k, step = _any_step(target, rng)
    first, rows = _lift_rows(target, step), len(step.joint_path)
    peak = int(rng.integers(first + (rows - first) // 3, rows - (rows - first) // 3))
    excess = PANDA_LIMIT_7 - step.joint_path[peak, 6] + float(rng.uniform(0.002, 0.1))
    angles = np.interp(np.arange(rows), [first, peak, rows - 1], [0.0, excess, 0.0])
    return _rerouted(target, "joint_beyond_limit", "joint_limit", k, *_wrist_turned(step, angles))


@mutation
def jump(target: Target, rng: np.random.Generator) -> Corrupted:
    """Rows are missing in the middle."""
    k, step = _any_step(target, rng)
    first = _lift_rows(target, step)
    a = int(rng.integers(first + 1, first + max(2, (len(step.joint_path) - first) // 2)))
    far = np.linalg.norm(step.tool_path[a:, :3] - step.tool_path[a, :3], axis=1) > 0.021
    b = a + int(np.argmax(far)) if far.any() else len(step.joint_path) - 1
    keep = np.r_[0 : a + 1, b : len(step.joint_path)]
    return _rerouted(target, "jump", "jump", k, step.joint_path[keep], step.tool_path[keep])


@mutation
def wrist_flipped(target: Target, rng: np.random.Generator) -> Corrupted:
    """From some row on, the last joint stands elsewhere: a jump that the tool's position does not show."""
    k, step = _any_step(target, rng)
    first, rows = _lift_rows(target, step), len(step.joint_path)
    angle = float(rng.uniform(0.15, 0.4)) * (1 if step.joint_path[:, 6].mean() < 0 else -1)
    angles = np.where(np.arange(rows) > int(rng.integers(first + 1, rows - 1)), angle, 0.0)
    return _rerouted(target, "wrist_flipped", "jump", k, *_wrist_turned(step, angles))


@mutation
def joint_nudged(target: Target, rng: np.random.Generator) -> Corrupted:
    """One joint of one row is off; the tool path does not know."""
    k, step = _any_step(target, rng)
    joint_path = step.joint_path.copy()
    joint_path[int(rng.integers(len(joint_path))), int(rng.integers(7))] += rng.choice([-1, 1]) * rng.uniform(
        0.003, 0.05
    )
    return _changed(target, "joint_nudged", "tool_path", k, joint_path=joint_path)


@mutation
def tool_path_falsified(target: Target, rng: np.random.Generator) -> Corrupted:
    k, step = _any_step(target, rng)
    tool_path = step.tool_path.copy()
    offset = rng.normal(size=3)
    tool_path[int(rng.integers(len(tool_path))), :3] += rng.uniform(1.5e-4, 0.01) * offset / np.linalg.norm(offset)
    return _rerouted(target, "tool_path_falsified", "tool_path", k, step.joint_path, tool_path)


@mutation
def orientation_falsified(target: Target, rng: np.random.Generator) -> Corrupted:
    k, step = _any_step(target, rng)
    tool_path = step.tool_path.copy()
    row = int(rng.integers(len(tool_path)))
    tool_path[row, 3:] = _turned(tool_path[row, 3:], float(np.radians(rng.uniform(0.02, 5.0))))
    return _rerouted(target, "orientation_falsified", "tool_path", k, step.joint_path, tool_path)


@mutation
def tool_path_straightened(target: Target, rng: np.random.Generator) -> Corrupted | None:
    """The tool path claims a short cut that the joints do not take."""
    k, step = _any_step(target, rng)
    tool_path = step.tool_path.copy()
    first = _lift_rows(target, step)
    tool_path[first:, :3] = np.linspace(tool_path[first, :3], tool_path[-1, :3], len(tool_path) - first)
    if np.linalg.norm(tool_path[:, :3] - step.tool_path[:, :3], axis=1).max() < 2e-4:
        return None
    return _rerouted(target, "tool_path_straightened", "tool_path", k, step.joint_path, tool_path)


@mutation
def lift_skipped(target: Target, rng: np.random.Generator) -> Corrupted | None:
    """The part is pulled sideways from where it stands, to a place over the end of the lift."""
    k, step = _any_step(target, rng)
    first = _lift_rows(target, step)
    rotation = rotation_from_quaternion(step.tool_path[0, 3:])
    side = rotation[:, int(rng.integers(2))] * [1.0, 1.0, 0.0]
    if np.linalg.norm(side) < 0.5:
        return None  # a tool that comes from the side may have this axis upright
    corner = step.tool_path[0, :3] + rng.uniform(0.005, 0.02) * side + [0.0, 0.0, 0.02]
    base = target.workcell.T_world_base
    corners = [step.tool_path[0, :3], corner, step.tool_path[first, :3]]
    joints = line_path(corners, rotation, base, step.joint_path[0])
    if np.abs(joints[-1] - step.joint_path[first]).max() > 0.05 or np.abs(np.diff(joints, axis=0)).max() > 0.1:
        return None  # the redundant arm came back in another posture
    joint_path = np.vstack([joints, step.joint_path[first + 1 :]])
    tool_path = np.vstack([tool_rows(joints, base), step.tool_path[first + 1 :]])
    return _rerouted(target, "lift_skipped", "lift", k, joint_path, tool_path)


@mutation
def lift_bobs(target: Target, rng: np.random.Generator) -> Corrupted:
    """Two rows of the lift are exchanged: up, down, up."""
    k, step = _any_step(target, rng)
    order = np.arange(len(step.joint_path))
    a = int(rng.integers(1, _lift_rows(target, step) - 1))
    order[[a, a + 1]] = a + 1, a
    return _rerouted(target, "lift_bobs", "lift", k, step.joint_path[order], step.tool_path[order])


@mutation
def lift_sinks(target: Target, rng: np.random.Generator) -> Corrupted:
    """Halfway up the part sinks again by a few millimetres, in rows so close that none of them shows it."""
    k, step = _any_step(target, rng)
    a = int(rng.integers(1, _lift_rows(target, step) - 1))
    depth = float(rng.uniform(5e-4, 2e-3))
    pieces = int(np.ceil(np.linalg.norm(step.tool_path[a + 1, :3] - step.tool_path[a, :3]) / 8e-6))
    share = np.linspace(0, 1, pieces + 1)[: max(2, round(pieces * min(1.0, depth / 5e-3)))]
    between = step.joint_path[a] + (step.joint_path[a + 1] - step.joint_path[a]) * share[:, None]
    joints = np.vstack([step.joint_path[: a + 1], between[1:], between[-2::-1], step.joint_path[a + 1 :]])
    return _rerouted(target, "lift_sinks", "lift", k, joints, tool_rows(joints, target.workcell.T_world_base))


@mutation
def lift_turns(target: Target, rng: np.random.Generator) -> Corrupted:
    """The tool turns about its axis while it lifts."""
    k, step = _any_step(target, rng)
    first = _lift_rows(target, step)
    angle = float(rng.uniform(0.01, 0.2)) * (1 if step.joint_path[:, 6].mean() < 0 else -1)
    angles = np.interp(np.arange(len(step.joint_path)), [0, first], [0.0, angle])
    return _rerouted(target, "lift_turns", "lift", k, *_wrist_turned(step, angles))


@mutation
def goal_missed(target: Target, rng: np.random.Generator) -> Corrupted:
    k, step = _any_step(target, rng)
    cut = int(rng.integers(1, 6))
    return _rerouted(target, "goal_missed", "goal", k, step.joint_path[:-cut], step.tool_path[:-cut])


@mutation
def path_reversed(target: Target, rng: np.random.Generator) -> Corrupted:
    k, step = _any_step(target, rng)
    return _rerouted(target, "path_reversed", "start_pose", k, step.joint_path[::-1], step.tool_path[::-1])


@mutation
def waypoint_in_bar(target: Target, rng: np.random.Generator) -> Corrupted | None:
    """A smooth detour drives the tool into the middle of a bar that is still there, and back."""
    k, step = _any_step(target, rng)
    gone = {other.part for other in target.plan.steps[: k + 1]}
    bars = [part for part in target.assembly.parts if part.name not in gone]
    bar = bars[int(rng.integers(len(bars)))]
    rows = np.arange(_lift_rows(target, step) + 1, len(step.joint_path) - 1)
    centre = bar.T_world_part[:3, 3]
    row = int(rows[np.argmin(np.linalg.norm(step.tool_path[rows, :3] - centre, axis=1))])
    base = target.workcell.T_world_base
    rotation = rotation_from_quaternion(step.tool_path[row, 3:])
    detour = line_path([step.tool_path[row, :3], centre], rotation, base, step.joint_path[row])[1:]
    tool = tool_rows(detour, base)
    off = np.linalg.norm(tool[-1, :3] - centre)
    if off > 1e-6 or np.abs(np.diff(detour, axis=0)).max() > 0.09:
        return None  # out of reach, or too close to a singularity
    joint_path = np.vstack([step.joint_path[: row + 1], detour, detour[-2::-1], step.joint_path[row:]])
    tool_path = np.vstack([step.tool_path[: row + 1], tool, tool[-2::-1], step.tool_path[row:]])
    return _rerouted(target, "waypoint_in_bar", "collision", k, joint_path, tool_path)


@mutation
def waypoint_in_environment(target: Target, rng: np.random.Generator) -> Corrupted | None:
    """A smooth detour drives the tool into an obstacle, and back."""
    k, step = _any_step(target, rng)
    if not target.workcell.environment:
        return None
    obstacle = target.workcell.environment[int(rng.integers(len(target.workcell.environment)))].box
    first, rows = _lift_rows(target, step), len(step.joint_path)
    row = int(rng.integers(first + 1, rows - 1))
    T, half = obstacle.T_frame_box, obstacle.half_extents
    local = T[:3, :3].T @ (step.tool_path[row, :3] - T[:3, 3])
    inside = T[:3, 3] + T[:3, :3] @ np.clip(local, -0.7 * half, 0.7 * half)
    base = target.workcell.T_world_base
    rotation = rotation_from_quaternion(step.tool_path[row, 3:])
    detour = line_path([step.tool_path[row, :3], inside], rotation, base, step.joint_path[row])[1:]
    tool = tool_rows(detour, base)
    if np.linalg.norm(tool[-1, :3] - inside) > 1e-6 or np.abs(np.diff(detour, axis=0)).max() > 0.09:
        return None  # out of reach, or too close to a singularity
    joint_path = np.vstack([step.joint_path[: row + 1], detour, detour[-2::-1], step.joint_path[row:]])
    tool_path = np.vstack([step.tool_path[: row + 1], tool, tool[-2::-1], step.tool_path[row:]])
    return _rerouted(target, "waypoint_in_environment", "collision", k, joint_path, tool_path)


@mutation
def start_skipped(target: Target, rng: np.random.Generator) -> Corrupted:
    """The path begins above the grasp."""
    k, step = _any_step(target, rng)
    cut = int(rng.integers(1, 4))
    return _rerouted(target, "start_skipped", "start_pose", k, step.joint_path[cut:], step.tool_path[cut:])


@mutation
def waypoint_missing_number(target: Target, rng: np.random.Generator) -> Corrupted:
    k, step = _any_step(target, rng)
    joint_path = step.joint_path.copy()
    joint_path[int(rng.integers(len(joint_path))), int(rng.integers(7))] = rng.choice([np.nan, np.inf])
    return _changed(target, "waypoint_missing_number", "schema", k, joint_path=joint_path)


@mutation
def tool_rows_missing(target: Target, rng: np.random.Generator) -> Corrupted:
    k, step = _any_step(target, rng)
    return _changed(target, "tool_rows_missing", "schema", k, tool_path=step.tool_path[:-1])


@mutation
def quaternion_scaled(target: Target, rng: np.random.Generator) -> Corrupted:
    k, step = _any_step(target, rng)
    tool_path = step.tool_path.copy()
    tool_path[int(rng.integers(len(tool_path))), 3:] *= 1 + rng.uniform(1e-5, 1e-2)
    return _changed(target, "quaternion_scaled", "schema", k, tool_path=tool_path)


@mutation
def direction_mislabelled(target: Target, rng: np.random.Generator) -> Corrupted:
    plan = replace(target.plan, direction="assembly")
    return Corrupted("direction_mislabelled", plan, "start_pose", None)
