"""Why a part cannot leave, in numbers: each is worked out here by hand, or by taking bodies away one at a time."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from ssik.prebuilt import franka_panda_ik

from small_assemblies import three_bars
from takeapart.formats.files import data_path, load_assembly
from takeapart.model.assembly import Assembly, Connector, Part, members
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, Box, OrientedBox, pose
from takeapart.model.meshes import Mesh
from takeapart.model.plan import Plan
from takeapart.planning import Hindrance, Infeasible, PlanningOptions, build_problem, explain, plan_of, search
from takeapart.problem import AssemblyProblem
from takeapart.removal.goals import ORIENTATIONS, super_fibonacci
from takeapart.removal.lifting import contact_height
from takeapart.removal.placement import overlap_depth
from takeapart.removal.planner import RemovalOptions, RemovalPlanner
from takeapart.removal.reasons import Reason, Reasons
from takeapart.removal.result import Blocked
from takeapart.removal.wording import counted, listed, millimetres
from takeapart.robot.extent import arm_extent
from takeapart.robot.ik import InverseKinematics
from takeapart.robot.kinematics import forward
from takeapart.robot.model import RobotModel
from takeapart.stability import ConnectorStability
from takeapart.workcell import Obstacle, Workcell
from verification_scene import T_FLANGE_TOOL, scene_workcell

SHOULDER = np.array([-0.30, 0.20, 0.20 + 0.333])  # the Panda's first joint turns about z, its frame stands 333 mm high
FREE_BAR = Part("bar", Box((0.02, 0.20, 0.02)), pose([0.10, 0.20, 0.15]), 0.1)


def block(name: str, center: Sequence[float], size: tuple[float, float, float], fixed: bool = True) -> Part:
    return Part(name, Box(size), pose(np.array(center, dtype=float)), 0.1, fixed)


def obstacle(name: str, center: Sequence[float], size: Sequence[float]) -> Obstacle:
    return Obstacle(name, OrientedBox(pose(np.array(center, dtype=float)), np.array(size) / 2))


def planner_of(robot: RobotModel, cell: Workcell, *parts: Part) -> RemovalPlanner:
    options = RemovalOptions(tree_failures=2, tree_iterations=100)
    return RemovalPlanner(Assembly("small", parts), cell, options, robot)


def asked(planner: RemovalPlanner, part: int = 0) -> Reason:
    """Why a part cannot leave the whole assembly."""
    state = planner.assembly.root
    answer = planner.plan(part, state, rng=np.random.default_rng(0))
    assert isinstance(answer, Blocked)
    reason = Reasons(planner).of(answer, state)
    assert reason.stage == answer.stage
    assert "\n" not in str(reason)
    return reason


# ---- gravity and lift


def test_gravity_names_what_would_fall() -> None:
    assembly = three_bars()
    problem = build_problem(assembly, scene_workcell())
    (beam,) = explain(problem, assembly.root)
    assert beam == Hindrance(
        "beam", Reason("stability", "gravity", "without it stub and rear would fall", blamed=("stub", "rear"))
    )
    assert beam.stage == "stability"
    assert str(beam) == "beam: without it stub and rear would fall (stage stability)"


def test_a_lift_says_after_how_much_each_body_is_hit(robot: RobotModel, workcell: Workcell) -> None:
    """The bar's upper side is at 160 mm. A lid begins at 172 mm, so it is hit after 12 mm, and a beam
    begins at 190 mm. A cover begins at 210.5 mm: 50 mm higher the bar is free, but closer than the clearance."""
    lid = block("lid", [0.10, 0.15, 0.182], (0.02, 0.02, 0.02), fixed=False)
    beam = block("beam", [0.10, 0.25, 0.20], (0.02, 0.02, 0.02), fixed=False)
    cover = block("cover", [0.10, 0.20, 0.2205], (0.02, 0.02, 0.02), fixed=False)
    reason = asked(planner_of(robot, workcell, FREE_BAR, cover, beam, lid))
    assert (reason.stage, reason.cause) == ("lift", "lift")
    assert reason.text == (
        "only straight up is tried: lifted by 50 mm it hits lid after 12 mm, hits beam after 30 mm and "
        "comes within 0.5 mm of cover, closer than the 1.1 mm that planning keeps"
    )
    assert reason.numbers == (("lift_height", 0.05),)
    assert [name for name, _ in reason.hits] == ["lid", "beam", "cover"]
    assert [height for _, height in reason.hits] == pytest.approx([0.012, 0.03, 0.05], abs=1e-6)
    assert reason.blamed == ("cover", "beam", "lid")


def test_what_lies_on_a_part_is_hit_at_once(robot: RobotModel, workcell: Workcell) -> None:
    lid = block("lid", [0.10, 0.15, 0.17], (0.02, 0.02, 0.02), fixed=False)
    reason = asked(planner_of(robot, workcell, FREE_BAR, lid))
    assert reason.text == "only straight up is tried: lifted by 50 mm it hits lid at once"


def test_overlaps_that_are_meant_are_meant_when_reasons_are_asked(robot: RobotModel, workcell: Workcell) -> None:
    """A body of triangles, sunk by 2 mm into a base that cuts into another fixed one."""
    sunk = Part("sunk", Mesh(Box((0.02, 0.02, 0.022)).surface()), pose([0.1, 0.2, 0.009]), 0.1)
    base, pillar = (
        block("base", [0.1, 0.2, -0.01], (0.1, 0.1, 0.02)),
        block("pillar", [0.13, 0.2, 0], (0.02, 0.1, 0.04)),
    )
    fixed = [replace(each, shape=Mesh(each.shape.surface())) for each in (base, pillar)]
    assembly = Assembly("sunk", (sunk, *fixed), allowed_overlaps=(("base", "sunk"),))
    planner = RemovalPlanner(assembly, replace(workcell, environment=()), robot=robot, is_placed=True)
    assert planner.freedom(0) == (0,)
    assert Reasons(planner).named.exits.exits(0)[0].blockers == 0


def test_boxes_meet_where_one_begins_to_cut_into_the_other() -> None:
    """A bar slides along a post that it touches, up to a peg that sticks out of it 20 mm above the bar's upper side; a
    roof that slopes by 45 degrees stands with its edge 20 mm above the bar."""
    bar = OrientedBox(pose([0.0, 0.0, 0.0]), np.array([0.1, 0.01, 0.01]))
    post = OrientedBox(pose([0.11, 0.0, 0.0]), np.array([0.01, 0.01, 1.0]))
    peg = OrientedBox(pose([0.105, 0.0, 0.04]), np.array([0.01, 0.01, 0.01]))
    edge = np.sqrt(2) * 0.01  # from the middle of the roof to its edge
    roof = OrientedBox(pose([0.0, 0.0, 0.03 + edge], (np.cos(np.pi / 8), np.sin(np.pi / 8), 0, 0)), np.full(3, 0.01))
    assert contact_height(bar, 0.05, post) == 0.05
    assert contact_height(bar, 0.05, peg) == pytest.approx(0.02, abs=1e-6)
    assert contact_height(bar, 0.019, peg) == 0.019
    assert contact_height(bar, 0.05, roof) == pytest.approx(0.02, abs=1e-6)
    resting = OrientedBox(pose([0.0, 0.0, 0.02]), np.array([0.01, 0.01, 0.01]))  # on top of the bar
    assert contact_height(bar, 0.05, resting) == pytest.approx(0.0, abs=1e-6)


def test_a_lift_into_what_never_leaves_blames_that(robot: RobotModel, workcell: Workcell) -> None:
    lid = block("lid", [0.10, 0.15, 0.182], (0.02, 0.02, 0.02), fixed=False)
    shelf = obstacle("shelf", [0.10, 0.25, 0.205], (0.02, 0.02, 0.02))
    crowded = replace(workcell, environment=(*workcell.environment, shelf))
    reason = asked(planner_of(robot, crowded, FREE_BAR, lid))
    assert "hits lid after 12 mm and hits shelf after 35 mm" in reason.text
    assert reason.blamed == ("shelf",)
    rail = block("rail", [0.10, 0.25, 0.205], (0.02, 0.02, 0.02))
    assert asked(planner_of(robot, workcell, FREE_BAR, lid, rail)).blamed == ("rail",)


def test_an_obstacle_called_like_a_host_hosts_nothing(robot: RobotModel, workcell: Workcell) -> None:
    """The post's wall ends under the bar; an obstacle of the post's name far away has no such wall."""
    post = block("table", [0.10, 0.05, 0.10], (0.02, 0.02, 0.10))
    wall = OrientedBox(pose([0.0, 0.05, 0.02]), np.array([0.01, 0.03, 0.001]))
    lid = block("lid", [0.10, 0.15, 0.182], (0.02, 0.02, 0.02))
    assembly = Assembly("small", (FREE_BAR, post, lid), (Connector("holder", "U", "table", "bar", (wall,)),))
    assert [each.name for each in workcell.environment] == ["table", "pedestal"]
    named = Reasons(RemovalPlanner(assembly, workcell, robot=robot)).named.assembly
    assert [len(named.body(i)) for i in range(5)] == [1, 2, 1, 1, 1]


def test_obstacles_of_one_name_are_one_body(robot: RobotModel, workcell: Workcell) -> None:
    """Two lids of the same name 12 and 30 mm above the bar, and a third that is called like a part."""
    lids = [
        obstacle("lid", [0.10, 0.25, 0.20], (0.02, 0.02, 0.02)),
        obstacle("lid", [0.10, 0.15, 0.182], (0.02, 0.02, 0.02)),
        obstacle("bar", [0.10, 0.20, 0.195], (0.02, 0.02, 0.02)),
    ]
    reason = asked(planner_of(robot, replace(workcell, environment=tuple(lids)), FREE_BAR))
    assert [name for name, _ in reason.hits] == ["lid", "obstacle bar"]
    assert [height for _, height in reason.hits] == pytest.approx([0.012, 0.025], abs=1e-6)
    assert reason.blamed == ("lid", "obstacle bar")
    halves = [obstacle("table", [0.10, y, -0.022], (1.0, 0.3, 0.04)) for y in (0.05, 0.35)]
    plate = Part("plate", Box((0.06, 0.24, 0.004)), pose([0.10, 0.20, 0.002]), 0.1)
    both = asked(planner_of(robot, replace(workcell, environment=tuple(halves)), plate))
    assert both.blamed == ("table",) and dict(both.hits)["table"] <= dict(both.numbers)["grasps"]
    assert "the hand hits table in all " in both.text


# ---- what no gripper can hold


def test_too_heavy_for_the_arm(robot: RobotModel, workcell: Workcell) -> None:
    reason = asked(planner_of(robot, workcell, replace(FREE_BAR, mass=3.25)))
    assert (reason.stage, reason.cause, reason.blamed, reason.hits) == ("grasp", "weight", (), ())
    assert reason.text == "weighs 3.25 kg, 0.25 kg more than the payload of 3 kg"
    assert dict(reason.numbers) == {"mass": 3.25, "payload": 3.0}


def test_too_heavy_for_the_fingers(robot: RobotModel, workcell: Workcell) -> None:
    """2 fingers * 0.1 * 70 N = 14 N hold 1.427 kg; the bar weighs 2 kg * 9.81 m/s^2 = 19.62 N."""
    reason = asked(planner_of(robot, replace(workcell, friction=0.1), replace(FREE_BAR, mass=2.0)))
    assert (reason.stage, reason.cause) == ("grasp", "slip")
    assert reason.text == ("weighs 2 kg and slips: two fingers that press with 70 N at friction 0.1 hold 1.43 kg")
    numbers = {"mass": 2.0, "grip": 14 / 9.81, "weight": 19.62, "gripping_force": 70.0, "friction": 0.1}
    assert dict(reason.numbers) == pytest.approx(numbers)


def test_too_wide(robot: RobotModel, workcell: Workcell) -> None:
    crate = Part("crate", Box((0.12, 0.30, 0.13)), pose([0.20, 0.20, 0.15]), 0.5)
    reason = asked(planner_of(robot, workcell, crate))
    assert (reason.stage, reason.cause) == ("grasp", "width")
    assert reason.text == "its narrowest side of 120 mm is 40 mm wider than the fingers' opening of 80 mm"
    assert dict(reason.numbers) == pytest.approx({"width": 0.12, "other_width": 0.13, "opening": 0.08})
    hair = asked(planner_of(robot, workcell, replace(crate, shape=Box((0.08019, 0.30, 0.13)))))
    assert hair.text == "its narrowest side of 80.19 mm is 0.19 mm wider than the fingers' opening of 80 mm"


def test_what_can_never_be_held_says_so_although_it_is_covered_too(robot: RobotModel, workcell: Workcell) -> None:
    lid = block("lid", [0.10, 0.20, 0.182], (0.02, 0.02, 0.02), fixed=False)
    planner = planner_of(robot, workcell, replace(FREE_BAR, mass=25.0), lid)
    problem = AssemblyProblem(planner, ConnectorStability(planner.assembly))
    assert planner.plan(0, 0b11, rng=np.random.default_rng(0)) == Blocked(0, "grasp", 0)
    assert problem.hindrance(0b11, 0) == Blocked(0, "grasp", 0)
    assert problem.candidates(0b11) == [1] and problem.candidates(0b01) == []
    assert explain(problem, 0b11)[0].reason.cause == "weight"
    lighter = planner_of(robot, workcell, FREE_BAR, lid)
    assert lighter.plan(0, 0b11, rng=np.random.default_rng(0)) == Blocked(0, "lift", 0b10)


# ---- the hand


def stuck(planner: RemovalPlanner) -> list[bool]:
    """Per grasp of the first part, whether the hand hits what never leaves, or the part itself."""
    return [hand.blockers is None for hand in planner.reach.hands(0, planner.workspace())]


def test_the_hand_hits_each_body_in_as_many_grasps_as_if_it_stood_there_alone(
    robot: RobotModel, workcell: Workcell
) -> None:
    """Walls 2 mm beside the bar, too near for fingers, and a stand right below it."""
    bodies = [
        block("left", [0.122, 0.20, 0.12], (0.02, 0.24, 0.16)),
        block("right", [0.078, 0.17, 0.12], (0.02, 0.10, 0.16)),
        block("front", [0.078, 0.27, 0.12], (0.02, 0.06, 0.16), fixed=False),
    ]
    stand = obstacle("stand", [0.10, 0.20, 0.067], (0.02, 0.24, 0.136))
    cell = replace(workcell, environment=())
    alone = stuck(planner_of(robot, cell, FREE_BAR))
    pressed = {body.name: stuck(planner_of(robot, cell, FREE_BAR, replace(body, fixed=True))) for body in bodies}
    pressed["stand"] = stuck(planner_of(robot, replace(cell, environment=(stand,)), FREE_BAR))
    assert not any(alone)
    in_the_way = [{name for name, hits in pressed.items() if hits[k]} for k in range(len(alone))]
    counts = {name: sum(name in names for names in in_the_way) for name in pressed}
    assert all(in_the_way) and 0 < counts["front"] < counts["left"]
    reason = asked(planner_of(robot, replace(cell, environment=(stand,)), FREE_BAR, *bodies))
    assert (reason.stage, reason.cause) == ("grasp", "hand")
    assert dict(reason.numbers) == {"grasps": len(alone)}
    assert dict(reason.hits) == counts
    most = max(counts, key=lambda name: counts[name])
    assert reason.text.startswith(f"the hand hits {most} in {counts[most]} of {len(alone)} grasps")
    assert set(reason.blamed) in in_the_way
    assert len(reason.blamed) == min(map(len, in_the_way))


def test_a_plate_on_the_table_cannot_be_gripped(robot: RobotModel, workcell: Workcell) -> None:
    """The plate is 4 mm thick and lies 2 mm above the table, too near for any finger. Eight positions along its longest
    edge, each with two ways to close, two sides to come from and two finger orders; one along the edge of 78 mm, where
    the other edge is too wide to close across."""
    plate = Part("plate", Box((0.078, 0.20, 0.004)), pose([0.10, 0.20, 0.002]), 0.1)
    reason = asked(planner_of(robot, workcell, plate))
    assert (reason.stage, reason.cause, reason.blamed) == ("grasp", "hand", ("table",))
    # From the side the hand meets the plate, which reaches 39 mm from between the fingertips towards the palm.
    across, along = 8 * 2 * 2, 8 * 2 * 2 + 1 * 2 * 2
    counts = " (nearer than 1.6 mm counts: the clearance of 1 mm and 0.6 mm that planning adds)"
    assert reason.text == f"the hand hits table in all {across} grasps{counts}; in {along} more it hits the part itself"
    assert dict(reason.numbers) == {"grasps": across + along}
    assert dict(reason.hits) == {"table": across, "the part itself": along}


# ---- the arm


def test_a_rack_two_metres_away(workcell: Workcell) -> None:
    rack = load_assembly(data_path("examples/rack.json"))
    away = replace(rack, parts=tuple(replace(p, T_world_part=pose([2, 0, 0]) @ p.T_world_part) for p in rack.parts))
    problem = build_problem(away, workcell)
    rung = away.index["rung_0.2"]
    reason = Reasons(problem.planner).of(Blocked(rung, "ik", 0), away.root)
    assert (reason.stage, reason.cause, reason.blamed) == ("ik", "reach", ())
    # The rung is 279 mm long around x = 2.2 m; its nearest grasp is 30 mm from its front end.
    nearest = np.array([2.2 - 0.279 / 2 + 0.03, 0.20, 0.24])
    distance = float(np.linalg.norm(nearest - SHOULDER))
    assert dict(reason.numbers)["distance"] == pytest.approx(distance, abs=1e-9)
    assert reason.text == f"is out of reach: {distance:.3f} m from the arm's shoulder, the tool reaches 0.947 m"


def test_the_reach_is_the_greatest_distance_that_an_optimizer_finds(robot: RobotModel) -> None:
    """By the forward kinematics of the inverse kinematics library."""
    extent = arm_extent(robot)
    np.testing.assert_allclose(extent.shoulder, SHOULDER, atol=1e-9)
    bounds = list(zip(robot.arm.lower, robot.arm.upper, strict=True))

    def closeness(q: Array) -> float:
        tool = (np.asarray(franka_panda_ik.fk(q)) @ T_FLANGE_TOOL)[:3, 3]
        return -float(np.linalg.norm(tool - [0.0, 0.0, 0.333]))

    rng = np.random.default_rng(4)
    starts = rng.uniform(robot.arm.lower, robot.arm.upper, (12, robot.joints))
    best = max(-float(minimize(closeness, start, bounds=bounds, method="L-BFGS-B").fun) for start in starts)
    assert extent.length == pytest.approx(best, abs=2e-4)
    assert max(-closeness(q) for q in rng.uniform(robot.arm.lower, robot.arm.upper, (2000, 7))) <= extent.length
    assert extent.distances(SHOULDER + [[0.3, 0.0, 0.4], [0.0, 0.0, 0.0]]) == pytest.approx([0.5, 0.0])


def test_a_wall_that_the_arm_would_have_to_pass_through(robot: RobotModel, workcell: Workcell) -> None:
    """Between the arm and the bar, from far below to far above all that the arm reaches: whatever holds the bar crosses
    it."""
    wall = obstacle("wall", [-0.05, 0.20, 0.50], (0.02, 3.0, 3.0))
    home = workcell.home.copy()
    home[0] = 2.8  # away from the wall
    cell = replace(workcell, home=home, goal=np.array([-0.55, -0.20, 0.45]), environment=(*workcell.environment, wall))
    planner = planner_of(robot, cell, FREE_BAR)
    reason = asked(planner)
    assert (reason.stage, reason.cause, reason.blamed) == ("ik", "arm", ("wall",))
    hits, numbers = dict(reason.hits), dict(reason.numbers)
    counts = " (nearer than 1.6 mm counts: the clearance of 1 mm and 0.6 mm that planning adds)"
    assert reason.text == f"the arm hits wall in all {numbers['ways']} ways to hold and lift it{counts}"
    hands = planner.reach.hands(0, planner.workspace())
    free = [hand for hand in hands if hand.blockers is not None]
    assert numbers["grasps"] == len(free)
    ik, work, corners, solutions = InverseKinematics(robot), robot.workspace(), wall.box.corners(), 0
    for hand in free[::6]:
        for q in ik.solve(FREE_BAR.T_world_part @ hand.candidate.T_part_tool):
            forward(robot.arm, np.ascontiguousarray(q), work)
            links = [hull.corners @ work.R[hull.frame].T + work.p[hull.frame] for hull in robot.hulls]
            assert max(overlap_depth(link, corners) for link in links) > 0
            solutions += 1
    assert solutions > 0
    assert hits["wall"] == numbers["ways"] > 0


def test_near_enough_but_in_no_configuration(robot: RobotModel, workcell: Workcell) -> None:
    """Along the line from the shoulder, and so far that the tool would have to point along the bar."""
    far = Part("bar", Box((0.20, 0.02, 0.02)), pose(SHOULDER + [0.96, 0.0, 0.0]), 0.1)
    reason = asked(planner_of(robot, workcell, far))
    numbers = dict(reason.numbers)
    assert (reason.stage, reason.cause) == ("ik", "reach")
    assert numbers["distance"] == pytest.approx(0.96 - 0.10 + 0.03, abs=1e-9) and numbers["distance"] < numbers["reach"]
    assert reason.text == (
        f"no configuration within the joint limits lifts it straight up, in all {numbers['grasps']} free grasps; the "
        "nearest is 0.890 m from the arm's shoulder, the tool reaches 0.947 m"
    )


def test_the_distance_is_that_of_the_nearest_grasp_that_the_hand_can_take(
    robot: RobotModel, workcell: Workcell
) -> None:
    """Walls 2 mm beside the first 60 mm of a bar leave no room for fingers there, nor for the hand beside them."""
    far = Part("bar", Box((0.40, 0.02, 0.02)), pose([2.2, 0.20, 0.30]), 0.1)
    walls = [block(f"wall{side}", [2.03, 0.20 + side * 0.022, 0.30], (0.06, 0.02, 0.06)) for side in (1, -1)]
    reason = asked(planner_of(robot, workcell, far, *walls))
    open_bar = asked(planner_of(robot, workcell, far))
    first = 2.0 + 0.03  # m, then every 2 cm
    steps = [float(np.linalg.norm([first + 0.02 * k, 0.20, 0.30] - SHOULDER)) for k in range(8)]
    assert dict(open_bar.numbers)["distance"] == pytest.approx(steps[0], abs=1e-9)
    # The grasps at 30 and 50 mm stand between the walls.
    assert min(abs(dict(reason.numbers)["distance"] - step) for step in steps[2:]) < 1e-9
    assert dict(reason.numbers)["grasps"] < dict(open_bar.numbers)["grasps"]


# ---- the path


def test_a_path_that_is_not_found_names_what_stands_on_every_straight_line(
    robot: RobotModel, workcell: Workcell
) -> None:
    crate = block("crate", workcell.goal.tolist(), (0.06, 0.06, 0.06), fixed=False)
    aside = block("aside", [0.10, 0.45, 0.15], (0.02, 0.1, 0.02), fixed=False)
    planner = planner_of(robot, workcell, FREE_BAR, crate, aside)
    reason = asked(planner)
    assert (reason.stage, reason.cause, reason.blamed) == ("path", "path", ("crate",))
    work = planner.workspace()
    hands = planner.reach.hands(0, work)
    usable = [
        k for k, hand in enumerate(hands) if hand.blockers == 0 and planner.reach.branches(0, k, 0b110, work)
    ]  # nothing else is near the bar
    assert (
        f"with all {len(usable)} grasps that hand and arm can take; every straight line to it meets crate"
        in reason.text
    )
    # The bar's end towards the goal is at y = 0.10 m, its first grasp 3 cm further: 5 cm up, then straight.
    grip = np.array([0.10, 0.13, 0.20])
    line = 0.05 + float(np.linalg.norm(grip - workcell.goal))
    assert dict(reason.numbers)["grasps"] == len(usable)
    assert line - 1e-9 <= dict(reason.numbers)["straight_line"] < line + 0.1


def test_a_larger_state_has_its_own_stage(robot: RobotModel, workcell: Workcell) -> None:
    """What is known from a smaller state is told as it is in the one that was asked about."""
    lid = block("aside", [0.10, 0.45, 0.15], (0.02, 0.1, 0.02), fixed=False)
    walls = [
        block("left", [0.122, 0.20, 0.10], (0.02, 0.24, 0.16), fixed=False),
        block("right", [0.078, 0.20, 0.10], (0.02, 0.24, 0.16), fixed=False),
    ]
    ends = [
        block(f"end{k}", [0.10, 0.20 + s * 0.112, 0.10], (0.02, 0.02, 0.16), fixed=False) for k, s in enumerate((1, -1))
    ]
    planner = planner_of(robot, workcell, FREE_BAR, *walls, *ends, lid)
    reasons = Reasons(planner)
    answer = planner.plan(0, planner.assembly.root, rng=np.random.default_rng(0))
    assert isinstance(answer, Blocked) and answer.stage == "grasp"
    assert reasons.of(Blocked(0, "path", 0), planner.assembly.root).stage == "grasp"
    assert reasons.of(Blocked(0, "path", 0), 1).stage == "path"


# ---- bodies with numbers of their own


def test_masks_with_every_body_numbered_are_those_of_the_planner(planner: RemovalPlanner) -> None:
    named = Reasons(planner).named
    root = planner.assembly.root
    permanent = ~root & (1 << len(named.assembly.parts)) - 1
    assert named.assembly.root == root | permanent
    compared = 0
    for part in members(root)[::3]:
        lift, own_lift = planner.exits.exits(part)[0].blockers, named.exits.exits(part)[0].blockers
        assert own_lift is not None
        assert lift == (None if own_lift & permanent else own_lift)
        hands = planner.reach.hands(part, planner.workspace())
        for hand, other in zip(hands, named.reach.hands(part, named.workspace()), strict=True):
            assert (hand.candidate.T_part_tool == other.candidate.T_part_tool).all()
            if other.blockers is None or other.blockers & permanent:
                assert hand.blockers is None
            else:
                assert hand.blockers == other.blockers
                compared += 1
    assert compared > 50


def test_reasons_of_meshes_measure_no_ways_out_again(
    robot: RobotModel, workcell: Workcell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A plug in a fixed socket, whose cap is above it, on a table of 1.6 m, whose field would take seconds."""
    plug = block("plug", [0.1, 0.2, 0.04], (0.02, 0.02, 0.08), fixed=False)
    cap = block("cap", [0.1, 0.2, 0.091], (0.03, 0.03, 0.02), fixed=False)
    walls = [
        block(f"wall{k}", [0.1 + 0.02 * x, 0.2 + 0.02 * y, 0.005], (0.0198, 0.0198, 0.01))
        for k, (x, y) in enumerate([(1, 0), (-1, 0), (0, 1), (0, -1)])
    ]
    bodies = [replace(each, shape=Mesh(each.shape.surface())) for each in (plug, cap, *walls)]
    planner = planner_of(robot, workcell, *bodies)
    monkeypatch.setattr("takeapart.removal.planner.Contacts", None)
    monkeypatch.setattr("takeapart.removal.planner.Exits", None)
    reason = asked(planner)
    assert reason.cause == "lift" and reason.blamed == ("cap",)
    assert "up it hits cap after" in reason.text
    named = Reasons(planner).named
    permanent = (1 << len(named.assembly.parts)) - 1 & ~planner.assembly.root
    hands = planner.reach.hands(0, planner.workspace())
    others = named.reach.hands(0, named.workspace())
    compared = 0
    for hand, other in zip(hands, others, strict=True):
        closed = other.way is None or other.way & permanent
        assert hand.way == (None if closed else other.way)
        compared += not closed
    assert 0 < compared < len(hands)


def test_a_way_into_what_never_leaves_names_it(robot: RobotModel, workcell: Workcell) -> None:
    """A plug that stands between a floor and a roof, in a shaft as wide as itself."""
    plug = block("plug", [0.1, 0.2, 0.05], (0.02, 0.02, 0.04), fixed=False)
    walls = [
        block(f"wall{k}", [0.1 + 0.02 * x, 0.2 + 0.02 * y, 0.05], (0.0198, 0.0198, 0.04))
        for k, (x, y) in enumerate([(1, 0), (-1, 0), (0, 1), (0, -1)])
    ]
    ends = [block("floor", [0.1, 0.2, 0.02], (0.06, 0.06, 0.02)), block("roof", [0.1, 0.2, 0.085], (0.06, 0.06, 0.02))]
    bodies = [replace(each, shape=Mesh(each.shape.surface())) for each in (plug, *walls, *ends)]
    reason = asked(planner_of(robot, workcell, *bodies))
    assert reason.cause == "lift"
    assert "up it hits roof after" in reason.text
    assert "roof" in dict(reason.hits) and reason.blamed


def test_nothing_is_worked_out_before_somebody_asks() -> None:
    options = PlanningOptions(search="greedy")
    problem = build_problem(three_bars(), scene_workcell(), options)
    made = plan_of(problem, search(problem, options), options, 0.0)
    assert isinstance(made, Plan)
    assert "reasons" not in vars(problem)
    explain(problem, problem.root)
    assert "named" not in vars(problem.reasons)  # gravity needs no second planner


# ---- the goal


def refused(robot: RobotModel, cell: Workcell, *others: Part) -> str:
    with pytest.raises(InputError) as raised:
        planner_of(robot, cell, FREE_BAR, *others)
    return str(raised.value)


def test_a_goal_out_of_reach_is_told_with_distance_and_reach(robot: RobotModel, workcell: Workcell) -> None:
    message = refused(robot, replace(workcell, goal=SHOULDER + [0.0, 0.0, 1.25]))
    assert message == (
        "panda: goal: (-0.3, 0.2, 1.783) m is out of reach: 1.250 m from the arm's shoulder, the tool reaches 0.947 m"
    )
    almost = arm_extent(robot).length - 1e-5  # where the tool has to point away from the shoulder
    near = refused(robot, replace(workcell, goal=SHOULDER + [almost, 0.0, 0.0]))
    assert f"none of {ORIENTATIONS} orientations of the tool there is within the joint limits" in near
    assert f"it is {almost:.3f} m from the arm's shoulder, the tool reaches 0.947 m" in near


def test_a_goal_under_the_table_names_the_table_and_the_distance(robot: RobotModel, workcell: Workcell) -> None:
    """The table's lower side is at -42 mm. The pedestal is not told, nor a part that can leave, which every such
    configuration hits too."""
    crate = block("crate", [0.30, 0.20, -0.10], (0.06, 0.06, 0.06), fixed=False)
    goal = np.array([0.30, 0.20, -0.10])
    ik = InverseKinematics(robot)
    total = sum(len(ik.solve(pose(goal, quaternion))) for quaternion in super_fibonacci(ORIENTATIONS))
    message = refused(robot, replace(workcell, goal=goal), crate)
    assert message == (
        f"panda: goal: (0.3, 0.2, -0.1) m, 58 mm from obstacle 'table': the arm hits obstacle 'table' in all {total} "
        "configurations that put the tool there"
    )
    planner_of(robot, replace(workcell, goal=goal, environment=()), FREE_BAR)


def test_a_goal_inside_the_arm_is_told_too(robot: RobotModel, workcell: Workcell) -> None:
    cell = replace(workcell, goal=SHOULDER, environment=())
    assert re.search(r"\) m: the arm hits itself in all \d+ configurations", refused(robot, cell))


def test_a_goal_in_a_wall_of_a_fixed_part(robot: RobotModel, workcell: Workcell) -> None:
    post = block("post", [0.10, 0.45, 0.10], (0.02, 0.02, 0.10))
    wall = OrientedBox(pose([0.0, -0.03, 0.0]), np.array([0.01, 0.01, 0.01]))
    assembly = Assembly("small", (FREE_BAR, post), (Connector("holder", "U", "post", "bar", (wall,)),))
    with pytest.raises(InputError, match=r"lies 8 mm inside fixed part 'post'"):
        RemovalPlanner(assembly, replace(workcell, goal=np.array([0.10, 0.418, 0.10])), robot=robot)


# ---- words


def test_lengths_are_told_to_a_hundredth_of_a_millimetre() -> None:
    told = [millimetres(length) for length in (0.05, 0.0007287, 0.01235, 0.00001234, 0.8553, 2.0)]
    assert told == ["50 mm", "0.73 mm", "12.35 mm", "0.012 mm", "855.3 mm", "2000 mm"]


def test_names_and_counts_in_words() -> None:
    assert listed(["a"]) == "a"
    assert listed(["a", "b", "c"]) == "a, b and c"
    assert listed(list("abcdefg")) == "a, b, c, d and 3 more"
    assert counted([("table", 14)], 14, "grasps") == "table in all 14 grasps"
    assert counted([("lid", 9), ("table", 5)], 14, "grasps") == "lid in 9 of 14 grasps and table in 5"
    many = [("a", 9), ("b", 8), ("c", 8), ("d", 3)]
    assert counted([*many, ("e", 1)], 14, "ways") == "a in 9 of 14 ways, b in 8, c in 8, d in 3 and 1 other body"
    assert counted([*many, ("e", 1), ("f", 1)], 14, "ways").endswith("d in 3 and 2 other bodies")
    assert counted([("lid", 3), ("table", 3), ("post", 1)], 3, "ways") == "lid and table in all 3 ways"
    assert counted([("lid", 1)], 1, "grasps") == "lid in the only one of the grasps"


def test_a_long_list_of_reasons_begins_with_those_that_wait_for_nobody() -> None:
    waiting = [Hindrance(f"w{k}", Reason("stability", "gravity", "without it x would fall")) for k in range(7)]
    heavy = Hindrance("heavy", Reason("grasp", "weight", "weighs 4 kg, 1 kg more than the payload of 3 kg"))
    remaining = tuple(each.part for each in (*waiting, heavy))
    told = str(Infeasible(remaining, (*waiting, heavy), True))
    assert told.startswith("no feasible order; with 8 parts left: heavy: weighs 4 kg")
    assert told.endswith("w4: without it x would fall (stage stability); and 2 more: w5 and w6")
    many = [Hindrance(f"h{k}", Reason("grasp", "weight", "weighs 4 kg")) for k in range(9)]
    stuck = Hindrance("stuck", Reason("lift", "lift", "it hits lid after 3 mm"))
    told = str(Infeasible(tuple(f"h{k}" for k in range(9)) + ("stuck",), (*many, stuck), True))
    assert "10 parts left: h0: weighs 4 kg (stage grasp); stuck: it hits lid after 3 mm (stage lift); h1" in told
    assert told.endswith("; and 4 more: h5, h6, h7 and h8")
    text = str(Infeasible(("a",), (heavy,), False))
    assert text.startswith("no feasible order found within the budget; with 1 part left: heavy")
