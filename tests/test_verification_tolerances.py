"""Every number that `docs/verification.md` promises: a tenth below it is accepted, a tenth above it is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from takeapart.model.assembly import Part
from takeapart.model.geometry import Array, Box, pose, quaternion_from_rotation
from takeapart.model.plan import Grasp, Plan, PlanStep
from takeapart.verification import Finding, VerificationOptions
from takeapart.verification.checks import (
    check_bound,
    check_grasp,
    check_length,
    check_payload,
    check_schema,
    check_total,
    straight_line_bound,
)
from takeapart.verification.replay import (
    Samples,
    check_goal,
    check_jumps,
    check_lift,
    check_start,
    check_tool_path,
    check_true_length,
)
from verification_scene import scene_assembly, scene_plan, scene_workcell

OPTIONS = VerificationOptions()
LIFT = 0.05  # m
SIDES = [(0.9, False), (1.1, True)]  # share of a tolerance, and whether it is refused
beyond = pytest.mark.parametrize(("share", "refused"), SIDES, ids=["within", "beyond"])


def turned(degrees: float, axis: str = "x") -> Array:
    return np.asarray(Rotation.from_euler(axis, degrees, degrees=True).as_matrix())


def step_on(joint_path: Array, length: float = 0.0) -> PlanStep:
    tool_path = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (len(joint_path), 1))
    return PlanStep("bar", Grasp(np.zeros(3), np.array([1.0, 0, 0, 0]), 0.02), joint_path, tool_path, length)


STILL = step_on(np.zeros((3, 7)))


def told(findings: list[Finding], check: str, refused: bool, depth: float | None = None) -> None:
    """One finding of the check, with the depth in its unit, or none."""
    assert [found.check for found in findings] == ([check] if refused else [])
    for found in findings:
        assert found.step in (4, None)
        if depth is not None:
            assert found.depth == pytest.approx(depth, rel=1e-6)


# --- motion


@beyond
@pytest.mark.parametrize("sign", [1, -1])
def test_rows_are_a_tenth_of_a_radian_apart_at_most(share: float, refused: bool, sign: int) -> None:
    rows = np.zeros((4, 7))
    rows[2:, 5] = sign * 0.1 * share
    told(check_jumps(step_on(rows), 4, np.zeros((4, 3)), OPTIONS), "jump", refused, 0.1 * share)


@beyond
def test_rows_are_two_centimetres_apart_at_most(share: float, refused: bool) -> None:
    positions = np.zeros((4, 3))
    positions[2:] = [0.012 * share, 0.016 * share, 0.0]  # 20 mm
    told(check_jumps(step_on(np.zeros((4, 7))), 4, positions, OPTIONS), "jump", refused, 0.02 * share)


@beyond
def test_the_tool_path_is_where_the_joints_put_the_tool(share: float, refused: bool) -> None:
    off, none = np.array([0.0, 1e-4 * share, 0.0]), np.zeros(3)
    told(check_tool_path(STILL, 4, off, none, OPTIONS), "tool_path", refused, 1e-4 * share)
    angle = np.radians(0.01) * np.array([0.0, share, 0.0])
    told(check_tool_path(STILL, 4, none, angle, OPTIONS), "tool_path", refused)


@beyond
@pytest.mark.parametrize("sign", [1, -1])
def test_the_length_is_what_the_tool_travels(share: float, refused: bool, sign: int) -> None:
    positions = np.array([[0.0, 0.0, 0.0], [0.3, 0.4, 0.0], [0.3, 0.4, 0.5]])
    step = step_on(np.zeros((3, 7)), 1.0 + sign * 1e-4 * share)
    told(check_true_length(step, 4, positions, OPTIONS), "length", refused, 1e-4 * share)


@beyond
def test_the_first_row_is_at_the_grasp(share: float, refused: bool) -> None:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = turned(30.0, "y"), [0.1, 0.2, 0.3]
    aside = T[:3, 3] + np.array([0.6e-4, 0.0, -0.8e-4]) * share
    told(check_start(STILL, 4, T, aside, T[:3, :3], OPTIONS), "start_pose", refused, 1e-4 * share)
    about = T[:3, :3] @ turned(0.01 * share, "z")
    told(check_start(STILL, 4, T, T[:3, 3], about, OPTIONS), "start_pose", refused)


@beyond
def test_the_last_row_is_at_the_goal(share: float, refused: bool) -> None:
    goal = np.array([0.1, 0.2, 0.3])
    position = goal + np.array([0.0, 0.6e-4, 0.8e-4]) * share
    told(check_goal(STILL, 4, position, goal, OPTIONS), "goal", refused, 1e-4 * share)


def lift(sideways: Array, heights: Array, degrees: Array, lifted: int) -> Samples:
    """Samples of a lift, m and degrees."""
    positions = np.column_stack([sideways, np.zeros(len(heights)), heights])
    rotations = np.array([turned(angle) for angle in degrees])
    times = np.arange(len(heights), dtype=float)
    return Samples(np.zeros((len(heights), 7)), times, positions, rotations, lifted)


HEIGHTS, NOTHING = np.array([0.1, 0.11, 0.12, 0.15, 0.15, 0.2]), np.zeros(6)  # m; full height is reached at row 3


@beyond
def test_the_lift_is_straight_and_does_not_turn(share: float, refused: bool) -> None:
    aside = np.array([0, 0, 1e-4, 0, 0, 0]) * share
    told(check_lift(STILL, 4, lift(aside, HEIGHTS, NOTHING, 3), LIFT, OPTIONS), "lift", refused, 1e-4 * share)
    told(check_lift(STILL, 4, lift(NOTHING, HEIGHTS, 500 * aside, 3), LIFT, OPTIONS), "lift", refused)
    later = np.array([0, 0, 0, 0, 0.3, 0.3])  # after the lift the part goes where it likes
    told(check_lift(STILL, 4, lift(later, HEIGHTS, 100 * later, 3), LIFT, OPTIONS), "lift", False)


@beyond
def test_the_lift_never_sinks_by_a_hundredth_of_a_millimetre(share: float, refused: bool) -> None:
    heights = np.array([0.1, 0.11, 0.11 - 1e-5 * share, 0.15, 0.15, 0.2])
    told(check_lift(STILL, 4, lift(NOTHING, heights, NOTHING, 3), LIFT, OPTIONS), "lift", refused)


def test_a_lift_that_never_ends_is_none() -> None:
    (found,) = check_lift(STILL, 4, lift(NOTHING, np.linspace(0.1, 0.149, 6), NOTHING, 6), LIFT, OPTIONS)
    assert found.check == "lift" and "not straight up to 50 mm: at 49.00 mm" in found.message and found.time == 5.0


# --- grasp and load


BAR = Part("bar", Box((0.02, 0.3, 0.03)), pose([0.5, 0.1, 0.2]), 1.0)
ACROSS = np.column_stack([[0, 1, 0], [1, 0, 0], [0, 0, -1]])  # the fingers, tool y, close along the bar's x


def grasp_findings(
    center: tuple[float, float, float] = (0.0, 0.0, 0.0), width: float = 0.02, R: Array = ACROSS, opening: float = 0.08
) -> list[Finding]:
    grasp = Grasp(np.array([0.5, 0.1, 0.2]) + center, quaternion_from_rotation(R), width)
    return check_grasp(replace(STILL, grasp=grasp), 4, BAR, opening, OPTIONS)


@beyond
@pytest.mark.parametrize("sign", [1, -1])
def test_fingers_close_to_a_hundredth_of_a_millimetre(share: float, refused: bool, sign: int) -> None:
    told(grasp_findings(width=0.02 + sign * 1e-5 * share), "width", refused, 1e-5 * share)
    told(grasp_findings((sign * 1e-5 * share, 0.0, 0.0)), "grasp", refused, 1e-5 * share)


@beyond
@pytest.mark.parametrize("axis", ["x", "z"])
@pytest.mark.parametrize("sign", [1, -1])
def test_fingers_close_squarely(share: float, refused: bool, axis: str, sign: int) -> None:
    """About the tool's own approach and finger plane; about the closing axis the hand may turn as it likes."""
    told(grasp_findings(R=ACROSS @ turned(sign * 0.05 * share, axis)), "grasp", refused)
    told(grasp_findings(R=ACROSS @ turned(sign * 40.0, "y")), "grasp", False)


@beyond
@pytest.mark.parametrize("axis", range(3))
def test_it_does_not_matter_which_axis_of_its_frame_a_part_is_gripped_along(
    share: float, refused: bool, axis: int
) -> None:
    """The same bar with its frame turned so that the fingers close along its first, second or third axis."""
    turn = np.roll(np.eye(3), axis, axis=1)
    T = pose([0.5, 0.1, 0.2])
    T[:3, :3] = turn
    size = np.abs(turn.T @ [0.02, 0.3, 0.03])
    same = Part("bar", Box((float(size[0]), float(size[1]), float(size[2]))), T, 1.0)
    for aside, width in ((0.0, 0.02 + 1e-5 * share), (1e-5 * share, 0.02)):
        grasp = Grasp(np.array([0.5 + aside, 0.17, 0.2]), quaternion_from_rotation(ACROSS), width)
        findings = check_grasp(replace(STILL, grasp=grasp), 4, same, 0.08, OPTIONS)
        told(findings, "grasp" if aside else "width", refused, 1e-5 * share)


@beyond
def test_the_grasp_is_in_the_part(share: float, refused: bool) -> None:
    told(grasp_findings((0.0, 0.15 + 1e-4 * share, 0.0)), "grasp", refused, 1e-4 * share)
    told(grasp_findings((0.0, 0.0, -0.015 - 1e-4 * share)), "grasp", refused, 1e-4 * share)


def test_the_opening_is_the_grippers() -> None:
    told(grasp_findings(opening=0.02), "width", False)
    (found,) = grasp_findings(opening=0.0199)
    assert found.check == "width" and found.depth == pytest.approx(1e-4)
    for width in (0.0, -0.02):
        assert "beyond the gripper's 0 to 80 mm" in grasp_findings(width=width)[0].message


@pytest.mark.parametrize(
    ("mass", "payload", "force", "friction", "refused"),
    [(2.9, 3.0, 1e3, 0.5, 0), (3.1, 3.0, 1e3, 0.5, 1), (1.0, 3.0, 9.9, 0.5, 0), (1.0, 3.0, 9.7, 0.5, 1)],
)
def test_friction_of_two_fingers_holds_what_the_arm_may_carry(
    mass: float, payload: float, force: float, friction: float, refused: int
) -> None:
    """1 kg weighs 9.80665 N: two fingers with friction 0.5 hold it from a force of as much on."""
    workcell = replace(scene_workcell(), payload=payload, gripping_force=force, friction=friction)
    assert len(check_payload(STILL, 4, replace(BAR, mass=mass), workcell)) == refused


# --- numbers


@beyond
@pytest.mark.parametrize("sign", [1, -1])
def test_lengths_are_told_to_a_micrometre(share: float, refused: bool, sign: int) -> None:
    plan = scene_plan()
    step = replace(plan.steps[0], length=plan.steps[0].length + sign * 1e-6 * share)
    told(check_length(step, 4, OPTIONS), "length", refused, 1e-6 * share)
    total = replace(plan, total_length=plan.total_length + sign * 3e-6 * share)  # a micrometre for each of three steps
    told(check_total(total, OPTIONS), "total_length", refused)
    bound = straight_line_bound(scene_assembly(), scene_workcell()) + sign * 1e-6 * share
    told(bounds(replace(plan, straight_line_bound=bound)), "bound", refused)


@beyond
def test_no_bound_is_above_the_total(share: float, refused: bool) -> None:
    plan = scene_plan()
    told(bounds(replace(plan, sequence_bound=plan.total_length + 3e-6 * share)), "bound", refused)
    told(bounds(replace(plan, total_length=plan.straight_line_bound - 3e-6 * share)), "bound", refused)


def bounds(plan: Plan) -> list[Finding]:
    return check_bound(plan, scene_assembly(), scene_workcell(), OPTIONS)


@beyond
def test_quaternions_are_of_unit_length_to_a_millionth(share: float, refused: bool) -> None:
    step = scene_plan().steps[0]
    tool_path = step.tool_path.copy()
    tool_path[2, 3:] *= 1 - 1e-6 * share
    told(check_schema(replace(step, tool_path=tool_path), 4, 7), "schema", refused)
    longer = replace(step.grasp, orientation=step.grasp.orientation * (1 + 1e-6 * share))
    told(check_schema(replace(step, grasp=longer), 4, 7), "schema", refused)
