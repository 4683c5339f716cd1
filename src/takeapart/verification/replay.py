"""Replay of a plan's motions in MuJoCo: every step in the state in which it happens."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Array, rotation_from_quaternion
from takeapart.model.plan import PlanStep
from takeapart.verification.checks import grasp_pose, path_length
from takeapart.verification.model import Scene, part_in_tool
from takeapart.verification.pads import check_pads
from takeapart.verification.report import Clearance, Finding, VerificationOptions
from takeapart.verification.start_contacts import StartContacts, check_drawn
from takeapart.workcell import Workcell

ROUGHNESS = 4e-4  # m, error of the distances that `Scene.near` gives; measured: at most 3e-4


@dataclass(frozen=True, eq=False)
class Samples:
    """Configurations of one step, dense enough to be checked one by one."""

    configurations: Array  # (S, n) rad
    times: Array  # (S,) row of the path, fractional between rows
    positions: Array  # (S, 3) m, tool in the world
    rotations: Array  # (S, 3, 3)
    lifted: int  # number of the first sample at full lift height; S if there is none


@dataclass(frozen=True)
class StepResult:
    """What the replay of one step found."""

    findings: tuple[Finding, ...]
    configurations: int
    clearance: Clearance | None
    tool_position: float  # m, largest difference from the stated tool path
    tool_angle: float  # rad
    length: float  # m, from the verifier's own kinematics at the rows
    length_error: float  # m, of the stated length


class Replay:
    """Replays steps in one scene; built once per plan."""

    def __init__(self, assembly: Assembly, workcell: Workcell, options: VerificationOptions) -> None:
        self.assembly = assembly
        self.workcell = workcell
        self.options = options
        self.clearance = options.demanded_clearance(workcell)  # m
        self.scene = Scene(assembly, workcell, max(options.sight, self.clearance + 2 * ROUGHNESS))
        self.deepest: dict[tuple[str, str], float] = {}  # m, of contacts of the start, over all steps replayed
        self.neighbours = self.scene.touching_at_start(max(options.touching, self.clearance + options.penetration))

    def check_placement(self) -> list[Finding]:
        """Arm, assembly and environment do not stand in each other before anything moves."""
        return [
            *(
                Finding(None, "", None, "collision", f"{first} stands in {second}", depth)
                for first, second, depth in self.scene.misplaced(self.options.penetration)
            ),
            *check_drawn(self.neighbours, self.assembly, self.scene, self.options),
            *self._check_home(),
        ]

    def _check_home(self) -> list[Finding]:
        """The arm at rest is within its limits, and neither in itself nor in anything; its base may stand on what is
        there (MuJoCo does not test bodies that never move against each other)."""
        scene, home = self.scene, self.workcell.home
        findings = []
        for joint, (low, high) in enumerate(scene.joint_limits):
            if not low - 1e-9 <= home[joint] <= high + 1e-9:
                message = f"joint {joint + 1} rests at {home[joint]:.4g} rad; {low:.4g} to {high:.4g} is valid"
                findings.append(Finding(None, "", None, "home", message))
        scene.show(self.assembly.root, None)
        scene.place(home)
        seen = set()
        for a, b in self._pairs():
            names = (scene.label(a), scene.label(b))
            depth = -scene.distance(a, b)
            if depth > self.options.penetration and names not in seen:
                seen.add(names)
                findings.append(Finding(None, "", None, "home", f"at rest {names[0]} is in {names[1]}", depth))
        return findings

    def step(self, step: PlanStep, k: int, state: int) -> StepResult:
        """All checks of one step's motion, in the state before the part leaves."""
        scene, options = self.scene, self.options
        number = self.assembly.index[step.part]
        T_world_grasp = grasp_pose(step.grasp)
        scene.show(state, number)
        scene.grip(part_in_tool(T_world_grasp, self.assembly.parts[number].T_world_part), step.grasp.width)
        positions, rotations = self._tool_poses(step.joint_path)
        position_errors = np.linalg.norm(positions - step.tool_path[:, :3], axis=1)
        stated = np.array([rotation_from_quaternion(row) for row in step.tool_path[:, 3:]])
        angle_errors = _angles(rotations, stated)
        samples = self._samples(step, number, positions, rotations)
        findings = [
            *check_joint_limits(step, k, scene.joint_limits),
            *check_jumps(step, k, positions, options),
            *check_tool_path(step, k, position_errors, angle_errors, options),
            *check_true_length(step, k, samples.positions, options),
            *check_start(step, k, T_world_grasp, positions[0], rotations[0], options),
            *(check_lift(step, k, samples, self.workcell.lift_height, options) if self.assembly.is_lifted else []),
            *check_goal(step, k, positions[-1], self.workcell.goal, options),
        ]
        scene.place(step.joint_path[0])
        findings += self._check_fingers(step, k, number)
        collisions, clearance = self._check_collisions(step, k, number, samples)
        return StepResult(
            tuple(findings + collisions),
            len(samples.times),
            clearance,
            float(position_errors.max()),
            float(angle_errors.max()),
            path_length(positions),
            abs(path_length(positions) - step.length),
        )

    def _tool_poses(self, configurations: Array) -> tuple[Array, Array]:
        """Tool positions (S, 3) and rotations (S, 3, 3) of configurations (S, n)."""
        positions, rotations = np.empty((len(configurations), 3)), np.empty((len(configurations), 3, 3))
        for s, configuration in enumerate(configurations):
            self.scene.place(configuration)
            positions[s], rotations[s] = self.scene.tool()
        return positions, rotations

    def _samples(self, step: PlanStep, number: int, positions: Array, rotations: Array) -> Samples:
        """Interpolates between rows so that the tool, and the corners of the held part, the fingers, the hand and the
        link that carries it, move at most `tool_step` at a time.

        Between rows the arm moves on arcs: the first pass aims a little finer than allowed, later ones refine wherever
        it still moves too far (rows that are close in space with a detour in between)."""
        scene, options = self.scene, self.options
        carried = [
            *scene.geoms(scene.held_bodies[number]),
            *(g for link in scene.carried_links for g in scene.geoms(link)),
        ]
        points = np.vstack([np.zeros(3), scene.corners_in_tool(carried)])  # (P, 3) m, tool frame
        rows = np.asarray(step.joint_path, dtype=float)
        times = np.arange(len(rows), dtype=float)
        configurations = rows
        for aim in (0.97, *[1.0] * 7):
            moved = np.einsum("sij,pj->spi", rotations, points) + positions[:, None]
            travel = np.linalg.norm(np.diff(moved, axis=0), axis=2).max(axis=1) / options.tool_step
            turn = np.abs(np.diff(configurations, axis=0)).max(axis=1) / options.joint_step
            pieces = np.maximum(np.ceil(np.maximum(travel, turn) / aim - 1e-6), 1).astype(int)
            pieces = np.minimum(pieces, 1000)  # a jump is a finding of its own and must not cost minutes
            if pieces.max() == 1:
                break
            parts = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(times, times[1:], pieces, strict=False)]
            times = np.append(np.concatenate(parts), times[-1])
            configurations = _interpolated(rows, times)
            positions, rotations = self._tool_poses(configurations)
        raised = positions[:, 2] >= positions[0, 2] + self.workcell.lift_height - 1e-5
        return Samples(
            configurations, times, positions, rotations, int(np.argmax(raised)) if raised.any() else len(times)
        )

    def _check_fingers(self, step: PlanStep, k: int, number: int) -> list[Finding]:
        """The gripper is at its opening, fingers of both sides touch the held part, and neither they nor the rest of
        the gripper cut into it. Constant along the path."""
        scene, options = self.scene, self.options
        held = scene.geoms(scene.held_bodies[number])
        meshed = held[0] in scene.exact.geoms
        body = held[:1]  # the rest are connector walls
        findings = check_gripper(step, k, scene, options)
        if meshed:
            findings += check_pads(step, k, scene, held[0], options)
        for side in scene.sides:
            gap = min(scene.distance(a, b) for link in side for a in scene.geoms(link) for b in body)
            if not meshed and gap > options.finger_gap:
                names = " and ".join(side)
                message = f"{names} {'does' if len(side) == 1 else 'do'} not touch {step.part!r}"
                findings.append(Finding(k, step.part, 0.0, "finger_contact", message, gap))
        for link in scene.carried_links:
            shortfall, distance = max(
                (self._required_of_hand(link, b in body, meshed) - gap, gap)
                for a in scene.geoms(link)
                for b in held
                for gap in (scene.distance(a, b),)
            )
            if shortfall > 0:
                kind = "cuts into" if distance < 0 else f"is only {1e3 * distance:.3f} mm from"
                message = f"{link} {kind} held/{step.part}"
                depth = -distance if distance < 0 else shortfall
                findings.append(Finding(k, step.part, 0.0, "collision", message, depth))
        return findings

    def _required_of_hand(self, link: str, of_part: bool, meshed: bool) -> float:
        """Distance, m, that a link which does not move relative to the held part keeps from it: fingers touch the part
        itself, but not the connectors that it carries."""
        if link in self.scene.finger_bodies and of_part:
            return -(self.options.pad_depth if meshed else self.options.penetration)
        return self.clearance

    def _check_collisions(
        self, step: PlanStep, k: int, number: int, samples: Samples
    ) -> tuple[list[Finding], Clearance | None]:
        """Nothing touches that may not, at every sample."""
        scene, options = self.scene, self.options
        held, static = scene.geoms(scene.held_bodies[number]), scene.geoms(scene.static_bodies[number])
        twin = dict(zip(held, static, strict=True))
        contacts = StartContacts(self.neighbours, twin, self.clearance, self.assembly, scene, options)
        deepest: dict[tuple[str, str], Finding] = {}
        least: dict[tuple[str, str], float] = {}  # distance of the deepest
        clearance: Clearance | None = None
        for s, configuration in enumerate(samples.configurations):
            scene.place(configuration)
            pairs = self._pairs()
            contacts.end_unseen(pairs)
            for (a, b), rough in pairs.items():
                start = contacts.required(a, b, s < samples.lifted)
                closest = clearance.distance if clearance is not None else math.inf
                limit = max(self.clearance, closest) if start is None else contacts.looked_at(start)
                if rough >= limit + ROUGHNESS:
                    contacts.note(a, b, rough - ROUGHNESS)
                    continue
                distance = scene.distance(a, b)
                contacts.note(a, b, distance)
                start = contacts.required(a, b, s < samples.lifted)
                required = self.clearance if start is None else start
                time, names = float(samples.times[s]), (scene.label(a), scene.label(b))
                if start is not None and distance < 0 and self.assembly.has_meshes:
                    self.deepest[names] = max(self.deepest.get(names, 0.0), -distance)
                if start is None and distance < closest:
                    clearance = Clearance(distance, k, step.part, time, *names)
                if distance < min(required, least.get(names, math.inf)):
                    least[names] = distance
                    depth = -distance if distance < 0 else required - distance
                    first_time = deepest[names].time if names in deepest else time
                    kind = "hits" if distance < 0 else f"comes within {1e3 * distance:.3f} mm of"
                    message = f"{names[0]} {kind} {names[1]}"
                    deepest[names] = Finding(k, step.part, first_time, "collision", message, depth)
        findings = list(deepest.values())
        if scene.overflowed:
            message = "more contacts than the simulator has memory for: not all of them were seen"
            findings.append(Finding(k, step.part, None, "collision", message))
        return findings, clearance

    def _pairs(self) -> dict[tuple[int, int], float]:
        """Pairs of geoms in sight at the scene's present configuration, with their rough distance, m."""
        pairs, distances = self.scene.near()
        closest: dict[tuple[int, int], float] = {}
        for (a, b), distance in zip(pairs.tolist(), distances.tolist(), strict=True):
            closest[a, b] = min(distance, closest.get((a, b), math.inf))
        return closest


def check_gripper(step: PlanStep, k: int, scene: Scene, options: VerificationOptions) -> list[Finding]:
    """The gripper can open so far, and its pads are then where its description says: half the opening from the tool
    point on either side, and square to the closing direction."""
    findings = []
    name, opening = scene.gripper.name, scene.opening
    for joint, position, (low, high) in scene.joints.beyond_limits(opening):
        message = f"{joint} of {name} stands at {position:.4g}; {low:.4g} to {high:.4g} is valid"
        findings.append(Finding(k, step.part, 0.0, "gripper", message))
    for side, pad in zip(scene.sides, scene.pads(), strict=True):
        names = " and ".join(side)
        if math.isinf(pad.distance):
            message = f"{names}: no pad beside the tool point at an opening of {1e3 * opening:.3f} mm"
            findings.append(Finding(k, step.part, 0.0, "gripper", message))
            continue
        error = abs(pad.distance - opening / 2)
        if error > options.finger_gap:
            message = (
                f"{names}: the pad is {1e3 * pad.distance:.3f} mm from the tool point at an opening of "
                f"{1e3 * opening:.3f} mm; must be half of that"
            )
            findings.append(Finding(k, step.part, 0.0, "gripper", message, error))
        if pad.tilt > options.pad_tilt:
            message = f"{names}: the pad is {math.degrees(pad.tilt):.2f} deg off the square to the closing direction"
            findings.append(Finding(k, step.part, 0.0, "gripper", message))
    return findings


def check_joint_limits(step: PlanStep, k: int, limits: Array) -> list[Finding]:
    """No joint leaves its range, limits (n, 2) rad."""
    excess = np.maximum(limits[:, 0] - step.joint_path, step.joint_path - limits[:, 1])  # (M, n) rad
    findings = []
    for joint in np.nonzero((excess > 1e-9).any(axis=0))[0]:
        row = int(np.argmax(excess[:, joint]))
        low, high = np.degrees(limits[joint])
        angle = math.degrees(step.joint_path[row, joint])
        message = f"joint {joint + 1} stands at {angle:.2f} deg; {low:.2f} to {high:.2f} is valid"
        findings.append(Finding(k, step.part, float(row), "joint_limit", message, float(excess[row, joint])))
    return findings


def check_jumps(step: PlanStep, k: int, positions: Array, options: VerificationOptions) -> list[Finding]:
    """Neighbouring rows are close in every joint and in the tool's position."""
    findings = []
    turns = np.abs(np.diff(step.joint_path, axis=0)).max(axis=1)
    row = int(np.argmax(turns))
    if turns[row] > options.joint_jump:
        message = f"a joint turns {turns[row]:.3f} rad to the next row; at most {options.joint_jump} is allowed"
        findings.append(Finding(k, step.part, float(row), "jump", message, float(turns[row])))
    moves = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    row = int(np.argmax(moves))
    if moves[row] > options.tool_jump:
        message = f"the tool moves to the next row by more than {1e3 * options.tool_jump:.0f} mm"
        findings.append(Finding(k, step.part, float(row), "jump", message, float(moves[row])))
    return findings


def check_tool_path(
    step: PlanStep, k: int, position_errors: Array, angle_errors: Array, options: VerificationOptions
) -> list[Finding]:
    """The stated tool path is where the joints put the tool; errors (M,) in m and rad."""
    findings = []
    row = int(np.argmax(position_errors))
    if position_errors[row] > options.position_tolerance:
        message = "the joints put the tool elsewhere than the tool path says"
        findings.append(Finding(k, step.part, float(row), "tool_path", message, float(position_errors[row])))
    row = int(np.argmax(angle_errors))
    if angle_errors[row] > options.angle_tolerance:
        message = f"the joints turn the tool {math.degrees(angle_errors[row]):.3f} deg from what the tool path says"
        findings.append(Finding(k, step.part, float(row), "tool_path", message))
    return findings


def check_true_length(step: PlanStep, k: int, positions: Array, options: VerificationOptions) -> list[Finding]:
    """The stated length is what the tool really travels, positions (S, 3), m, along the motion between the rows too:
    neither may tolerances of the tool path add up from row to row, nor rows be left out where the motion bends."""
    travelled = path_length(positions)
    error = abs(travelled - step.length)
    if error <= options.position_tolerance:
        return []
    message = f"stated {step.length:.6f} m, but the joints move the tool {travelled:.6f} m"
    return [Finding(k, step.part, None, "length", message, error)]


def check_start(
    step: PlanStep, k: int, T_world_grasp: Array, position: Array, rotation: Array, options: VerificationOptions
) -> list[Finding]:
    """The first row holds the part where it stands: the tool is at the grasp."""
    shift = float(np.linalg.norm(position - T_world_grasp[:3, 3]))
    angle = float(_angles(rotation[None], T_world_grasp[None, :3, :3])[0])
    if shift <= options.position_tolerance and angle <= options.angle_tolerance:
        return []
    message = f"the first row is not at the grasp: the tool is turned by {math.degrees(angle):.3f} deg and displaced"
    return [Finding(k, step.part, 0.0, "start_pose", message, shift)]


def check_lift(
    step: PlanStep, k: int, samples: Samples, lift_height: float, options: VerificationOptions
) -> list[Finding]:
    """The path begins with the lift: straight up, without turning, never down again before the full height."""
    count = samples.lifted + 1
    rise = samples.positions[:count, 2] - samples.positions[0, 2]
    drift = np.linalg.norm(samples.positions[:count, :2] - samples.positions[0, :2], axis=1)
    angle = _angles(samples.rotations[:count], np.repeat(samples.rotations[:1], len(rise), axis=0))
    bad = (drift > options.position_tolerance) | (angle > options.lift_angle_tolerance)
    bad |= rise < np.maximum.accumulate(rise) - 1e-5
    bad[-1] |= samples.lifted == len(samples.times)
    if not bad.any():
        return []
    s = int(np.argmax(bad))
    message = (
        f"not straight up to {1e3 * lift_height:.0f} mm: at {1e3 * rise[s]:.2f} mm the tool is turned by "
        f"{math.degrees(angle[s]):.3f} deg and off the line"
    )
    return [Finding(k, step.part, float(samples.times[s]), "lift", message, float(drift[s]))]


def check_goal(step: PlanStep, k: int, position: Array, goal: Array, options: VerificationOptions) -> list[Finding]:
    """The last row puts the tool at the goal."""
    miss = float(np.linalg.norm(position - goal))
    if miss <= options.position_tolerance:
        return []
    return [Finding(k, step.part, float(len(step.joint_path) - 1), "goal", "the tool ends off the goal", miss)]


def _angles(first: Array, second: Array) -> Array:
    """Angles (S,), rad, between rotations (S, 3, 3); exact for small angles, unlike the arc cosine of the trace."""
    chord = np.linalg.norm((first - second).reshape(len(first), 9), axis=1) / math.sqrt(8)
    return np.asarray(2 * np.arcsin(np.minimum(chord, 1.0)))


def _interpolated(rows: Array, times: Array) -> Array:
    """Configurations (S, n) at fractional rows (S,)."""
    low = np.minimum(times.astype(int), len(rows) - 2)
    fraction = (times - low)[:, None]
    return np.asarray(rows[low] * (1 - fraction) + rows[low + 1] * fraction)
