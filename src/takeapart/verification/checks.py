"""Checks of a plan that need no simulation: names, numbers, grasps, lengths, bound and stability.

Each check is a function that returns findings. Stability and bound are written again here from the design's rules, so
that an error in the planner's versions is seen.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from takeapart.model.assembly import Assembly, Part
from takeapart.model.geometry import Array, Box, OrientedBox, Shape, pose
from takeapart.model.plan import Grasp, Plan, PlanStep
from takeapart.verification.report import Finding, VerificationOptions
from takeapart.workcell import Workcell

ORIGINS = ("assembly", "workcell")
DIRECTIONS = ("disassembly", "assembly")
STANDARD_GRAVITY = 9.80665  # m/s^2
EQUAL_EDGES = 1e-3  # m; a part whose two longest edges differ by no more has no long axis
BOX_VOLUME = 1e-6  # relative; a mesh whose volume is that of the box around it is a box
GRASP_OVERHANG = 0.012  # m, by which the tool's point may be outside the box around a mesh that it grips
NOTHING_BELOW = "anything to rest on"


def check_heading(plan: Plan) -> list[Finding]:
    """What is said about the plan as a whole can be read: which way it goes, what it cost, when it ends."""
    findings = []
    if plan.direction not in DIRECTIONS:
        message = f"direction {plan.direction!r}; must be one of {', '.join(DIRECTIONS)}"
        findings.append(Finding(None, "", None, "schema", message))
    numbers = {"total_length": plan.total_length, "seconds": plan.seconds, **plan.counts}
    for name, value in numbers.items():
        if not (math.isfinite(value) and value >= 0):
            findings.append(Finding(None, "", None, "schema", f"{name} is {value}; must be finite and not negative"))
    return findings


def check_hashes(plan: Plan, hashes: Mapping[str, str], names: Mapping[str, str]) -> list[Finding]:
    """The plan was made for this assembly and this workcell, and says so by name too."""
    findings = []
    for origin, stated_name in zip(ORIGINS, (plan.assembly, plan.workcell), strict=True):
        if stated_name != names[origin]:
            message = f"made for {origin} {stated_name!r}, but this one is {names[origin]!r}"
            findings.append(Finding(None, "", None, "hash", message))
        if origin in hashes and plan.hashes.get(origin) != hashes[origin]:
            stated = plan.hashes.get(origin)
            message = f"made for another {origin}: hash {stated!r}, but this one has {hashes[origin]!r}"
            findings.append(Finding(None, "", None, "hash", message))
    return findings


def check_robot(plan: Plan, workcell: Workcell) -> list[Finding]:
    """The joints that the plan moves are those of the workcell's arm, in this order; a file of version 1 names none."""
    joints = workcell.description.arm.joints
    if not plan.joints or plan.joints == joints:
        return []
    message = f"moves joints {', '.join(plan.joints)}; those of the workcell's arm are {', '.join(joints)}"
    return [Finding(None, "", None, "robot", message)]


def check_order(plan: Plan, assembly: Assembly) -> list[Finding]:
    """Every removable part leaves exactly once, or is said to remain, and nothing else does."""
    findings = []
    seen: dict[str, int] = {}
    for k, step in enumerate(plan.steps):
        message = ""
        if step.part not in assembly.index:
            message = f"there is no part {step.part!r} in assembly {assembly.name!r}"
        elif assembly.parts[assembly.index[step.part]].fixed:
            message = f"part {step.part!r} is fixed"
        elif step.part in seen:
            message = f"part {step.part!r} has left before, in step {seen[step.part] + 1}"
        if message:
            findings.append(Finding(k, step.part, None, "order", message))
        seen.setdefault(step.part, k)
    removable = {part.name for part in assembly.parts if not part.fixed}
    strange = [name for name in plan.remaining if name not in removable]
    if strange:
        message = f"said to remain, but no removable part: {', '.join(strange)}"
        findings.append(Finding(None, "", None, "order", message))
    both = [name for name in plan.remaining if name in seen]
    if both:
        findings.append(Finding(None, "", None, "order", f"said to remain, but removed: {', '.join(both)}"))
    left = {*seen, *plan.remaining}
    missing = [part.name for part in assembly.parts if not part.fixed and part.name not in left]
    if missing:
        findings.append(Finding(None, "", None, "order", f"never removed: {', '.join(missing)}"))
    return findings


def check_schema(step: PlanStep, k: int, joints: int) -> list[Finding]:
    """Shapes agree, numbers are finite, quaternions are unit. Other checks of the step need this one to pass."""
    rows = len(step.joint_path)
    wrong = [
        (step.joint_path.shape != (rows, joints) or rows < 2, f"joint path of shape {step.joint_path.shape}"),
        (step.tool_path.shape != (rows, 7), f"tool path of shape {step.tool_path.shape} for {rows} rows"),
        (step.grasp.center.shape != (3,) or step.grasp.orientation.shape != (4,), "grasp of wrong shape"),
    ]
    messages = [message for failed, message in wrong if failed]
    if not messages:
        numbers = [step.joint_path, step.tool_path, step.grasp.center, step.grasp.orientation]
        scalars = [step.grasp.width, step.length]
        if not all(np.isfinite(value).all() for value in numbers) or not all(map(math.isfinite, scalars)):
            messages.append("a number is not finite")
        else:
            norms = np.linalg.norm(np.vstack([step.tool_path[:, 3:], step.grasp.orientation]), axis=1)
            worst = float(np.abs(norms - 1).max())
            if worst > 1e-6:
                messages.append(f"a quaternion has norm off by {worst:.2g}; at most 1e-6 is allowed")
    return [Finding(k, step.part, None, "schema", message) for message in messages]


def grasp_pose(grasp: Grasp) -> Array:
    """Pose (4, 4) of the tool at the grasp, in the world."""
    return pose(grasp.center, grasp.orientation)


def check_grasp(
    step: PlanStep, k: int, part: Part, maximum_opening: float, options: VerificationOptions
) -> list[Finding]:
    """The grasp centre lies in the part and the fingers close squarely on two opposite faces at the stated width."""
    findings = []
    width = step.grasp.width
    if not 0 < width <= maximum_opening + 1e-9:
        message = f"opening {1e3 * width:.2f} mm is beyond the gripper's 0 to {1e3 * maximum_opening:.0f} mm"
        findings.append(Finding(k, step.part, 0.0, "width", message, max(width - maximum_opening, -width)))
    T_world_grasp = grasp_pose(step.grasp)
    boxes = gripped_boxes(part)
    outside = [_depth_outside(box, T_world_grasp[:3, 3]) for box in boxes]
    box = boxes[int(np.argmin(outside))]
    if min(outside) > options.position_tolerance:
        message = f"the grasp centre lies outside part {part.name!r}"
        return [*findings, Finding(k, step.part, 0.0, "grasp", message, min(outside))]
    if not fills_its_box(part.shape):
        return findings  # `pads.check_pads` looks at the surface
    closing = box.T_frame_box[:3, :3].T @ T_world_grasp[:3, 1]  # closing axis of the fingers in the box's frame
    axis = int(np.argmax(np.abs(closing)))
    tilt = math.acos(min(1.0, abs(float(closing[axis]))))
    if tilt > options.square_tolerance:
        message = f"the fingers close {math.degrees(tilt):.2f} deg off the normal of the faces of {part.name!r}"
        return [*findings, Finding(k, step.part, 0.0, "grasp", message)]
    extent = 2 * float(box.half_extents[axis])
    off_centre = abs(float((box.T_frame_box[:3, :3].T @ (T_world_grasp[:3, 3] - box.T_frame_box[:3, 3]))[axis]))
    if abs(width - extent) > options.width_tolerance:
        message = f"opening {1e3 * width:.3f} mm, but {part.name!r} is {1e3 * extent:.3f} mm wide there"
        findings.append(Finding(k, step.part, 0.0, "width", message, abs(width - extent)))
    if off_centre > options.width_tolerance:
        message = f"the grasp centre is not midway between the two faces of {part.name!r}"
        findings.append(Finding(k, step.part, 0.0, "grasp", message, off_centre))
    return findings


def check_payload(step: PlanStep, k: int, part: Part, workcell: Workcell) -> list[Finding]:
    """The arm may carry the part, and friction of both fingers holds its weight."""
    findings = []
    if part.mass > workcell.payload:
        message = f"{part.name!r} weighs {part.mass:.4g} kg; the payload is {workcell.payload:.4g} kg"
        findings.append(Finding(k, step.part, 0.0, "payload", message))
    weight, held = part.mass * STANDARD_GRAVITY, 2 * workcell.friction * workcell.gripping_force  # N
    if weight > held:
        message = f"{part.name!r} slips: its weight is {weight:.4g} N, friction of the fingers holds {held:.4g} N"
        findings.append(Finding(k, step.part, 0.0, "payload", message))
    return findings


def _depth_outside(box: OrientedBox, point: Array) -> float:
    """Distance of a point (3,) from a box, m; 0 inside."""
    local = box.T_frame_box[:3, :3].T @ (point - box.T_frame_box[:3, 3])
    return float(np.linalg.norm(np.maximum(np.abs(local) - box.half_extents, 0.0)))


def path_length(points: Array) -> float:
    """Length, m, of a path through points (M, 3) (Eq. 1 and 2)."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def check_length(step: PlanStep, k: int, options: VerificationOptions) -> list[Finding]:
    """The stated length is that of the tool path (Eq. 2)."""
    length = path_length(step.tool_path[:, :3])
    error = abs(length - step.length)
    if error <= options.length_tolerance:
        return []
    message = f"stated {step.length:.6f} m, but the tool path measures {length:.6f} m"
    return [Finding(k, step.part, None, "length", message, error)]


def check_total(plan: Plan, options: VerificationOptions) -> list[Finding]:
    """The total is the sum of the tool paths (Eq. 3)."""
    total = sum(path_length(step.tool_path[:, :3]) for step in plan.steps if step.tool_path.ndim == 2)
    error = abs(total - plan.total_length)
    if error <= options.length_tolerance * max(1, len(plan.steps)):
        return []
    message = f"stated {plan.total_length:.6f} m, but the tool paths measure {total:.6f} m"
    return [Finding(None, "", None, "total_length", message, error)]


def straight_line_bound(assembly: Assembly, workcell: Workcell, remaining: Sequence[str] = ()) -> float:
    """Sum over the removable parts that do not remain, m, of the distance from the nearest point of the part to the
    goal, and of what is lifted of the lift and the distance that is left from there: no plan whose grasps are all where
    `check_grasp` demands them is shorter."""
    lift = workcell.lift_height if assembly.is_lifted else 0.0  # m
    before_the_lift = workcell.goal - np.array([0.0, 0.0, lift])  # (3,) m, in the world
    bound = 0.0
    for part in assembly.parts:
        if not part.fixed and part.name not in remaining:
            bound += lift + min(_depth_outside(box, before_the_lift) for box in gripped_boxes(part))
    return bound


def fills_its_box(shape: Shape) -> bool:
    """Whether a shape is a box: a mesh is one if its volume is that of the smallest box around it."""
    if isinstance(shape, Box):
        return True
    around = 8 * float(shape.bounding_box().half_extents.prod())
    return abs(around - shape.volume()) <= BOX_VOLUME * around


def gripped_boxes(part: Part) -> list[OrientedBox]:
    """Boxes, in the world, in which the tool's point must be at the grasp: those of the part, or the one around a mesh
    and `GRASP_OVERHANG` beyond it, since fingers grip over edges."""
    box = part.shape.bounding_box()
    beyond = 0.0 if fills_its_box(part.shape) else GRASP_OVERHANG
    return [OrientedBox(box.T_frame_box, box.half_extents + beyond).moved(part.T_world_part)]


def check_bound(plan: Plan, assembly: Assembly, workcell: Workcell, options: VerificationOptions) -> list[Finding]:
    """The straight-line bound is what the rule gives, and no stated bound exceeds the stated total."""
    findings = []
    tolerance = options.length_tolerance * max(1, len(plan.steps))
    expected = straight_line_bound(assembly, workcell, plan.remaining)
    error = abs(plan.straight_line_bound - expected)
    if not error <= options.length_tolerance:  # a bound that is no number is refused too
        message = f"straight-line bound {plan.straight_line_bound:.6f} m, but the parts give {expected:.6f} m"
        findings.append(Finding(None, "", None, "bound", message, error))
    for name, bound in (("straight-line", plan.straight_line_bound), ("sequence", plan.sequence_bound)):
        if bound is not None and not bound <= plan.total_length + tolerance:
            message = f"{name} bound {bound:.6f} m exceeds the total {plan.total_length:.6f} m"
            findings.append(Finding(None, "", None, "bound", message, bound - plan.total_length))
    return findings


def carriers(assembly: Assembly, part: Part) -> set[str]:
    """Names of the hosts that must stay as long as `part` does: those of all its connectors, but of a part that
    stands upright only the one below (design, section 5)."""
    box = part.shape.bounding_box().moved(part.T_world_part)
    long_axis = box.T_frame_box[:3, int(np.argmax(box.half_extents))]
    second, first = sorted(2 * box.half_extents)[1:]
    slender = first - second > EQUAL_EDGES
    upright = slender and abs(float(long_axis[2])) > math.cos(math.radians(45))
    hosts = set()
    for connector in assembly.connectors:
        if connector.guest != part.name:
            continue
        T_world_host = assembly.parts[assembly.index[connector.host]].T_world_part
        heights = [float(wall.moved(T_world_host).T_frame_box[2, 3]) for wall in connector.walls]
        if not upright or sum(heights) / len(heights) < box.T_frame_box[2, 3]:
            hosts.add(connector.host)
    return hosts


def underneath(assembly: Assembly, number: int, touching: float) -> set[str]:
    """Names of the parts that a part lies on: somewhere one of their boxes is right below one of its own, by the
    extents of both along the world's axes, and at most `touching`, m, away."""
    lower, upper = _extents(assembly, number)
    found = set()
    for i, other in enumerate(assembly.parts):
        if i == number:
            continue
        low, high = _extents(assembly, i)
        over = (lower[:, None, :2] < high[None, :, :2]).all(axis=2) & (upper[:, None, :2] > low[None, :, :2]).all(
            axis=2
        )
        near = np.abs(lower[:, None, 2] - high[None, :, 2]) <= touching
        if (over & near).any():
            found.add(other.name)
    return found


def _extents(assembly: Assembly, number: int) -> tuple[Array, Array]:
    """Least and greatest world coordinates (B, 3), m, of the boxes of a part, its connectors included."""
    T_world_part = assembly.parts[number].T_world_part
    corners = np.array([box.moved(T_world_part).corners() for box in assembly.body(number)])
    return corners.min(axis=1), corners.max(axis=1)


@functools.lru_cache(maxsize=8)
def needs(assembly: Assembly) -> dict[str, frozenset[str]]:
    """Per removable part the names of those that must stay as long as it does: what carries it by connectors or, where
    no connector does, all that it lies on. A part that lies on nothing needs what no state has."""
    touching = VerificationOptions().touching
    return {
        part.name: frozenset(carriers(assembly, part) or underneath(assembly, i, touching) or {NOTHING_BELOW})
        for i, part in enumerate(assembly.parts)
        if not part.fixed
    }


def unsupported(assembly: Assembly, state: int) -> list[tuple[str, str]]:
    """Pairs (part, missing support) of the removable parts in a state."""
    present = {part.name for i, part in enumerate(assembly.parts) if part.fixed or state >> i & 1}
    return [
        (name, support)
        for name, needed in needs(assembly).items()
        if name in present
        for support in sorted(needed - present)
    ]


def check_stability(plan: Plan, assembly: Assembly) -> list[Finding]:
    """In the beginning and after every step each part that is there has what it rests on."""
    state = assembly.root
    reported = set(unsupported(assembly, state))
    findings = [
        Finding(None, "", None, "stability", f"part {part!r} stands without {support!r} before anything moves")
        for part, support in sorted(reported)
    ]
    for k, step in enumerate(plan.steps):
        if step.part not in assembly.index:
            continue
        state &= ~(1 << assembly.index[step.part])
        for part, host in unsupported(assembly, state):
            if (part, host) not in reported:
                reported.add((part, host))
                findings.append(Finding(k, step.part, None, "stability", f"part {part!r} is left without {host!r}"))
    return findings
