"""The verifier against independent truth: another library's kinematics, mesh files read here, closed formulas, and
corrupted plans whose fault is known."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ssik.prebuilt import franka_panda_ik

from box_oracle import box_distance
from mutation_table import ASSEMBLIES, judged, scene_target, shipped_target
from plan_mutations import MUTATIONS, Corrupted
from takeapart.experiments import verify_all
from takeapart.formats.files import load_assembly, load_plan, load_workcell
from takeapart.generate.profiles import ProfileOptions, candidate_rng, generate_candidate
from takeapart.model.assembly import Assembly, Connector, members
from takeapart.model.geometry import Array, OrientedBox, box_separation, pose, quaternion_from_rotation
from takeapart.model.plan import Plan, PlanStep
from takeapart.planning import SEARCHES
from takeapart.stability import ConnectorStability
from takeapart.verification import (
    Finding,
    VerificationOptions,
    Verifier,
    compare_stability,
    format_finding,
    report_as_dict,
    stand_under_gravity,
    states_of,
    verify_plan,
)
from takeapart.verification.checks import carriers, straight_line_bound, unsupported
from takeapart.verification.model import Scene
from takeapart.verification.replay import Replay
from takeapart.verification.robot import mujoco
from takeapart.workcell import Obstacle, Workcell
from verification_scene import (
    DOWNWARDS,
    line_path,
    scene_assembly,
    scene_bound,
    scene_plan,
    scene_workcell,
    tool_pose,
    tool_rows,
)

ROOT = Path(__file__).parents[1]


def findings_of(plan: Plan, options: VerificationOptions | None = None) -> tuple[Finding, ...]:
    return verify_plan(plan, scene_assembly(), scene_workcell(), options).findings


def with_step(k: int, step: PlanStep) -> Plan:
    """The scene's plan with one step replaced, lengths adapted."""
    length = float(np.linalg.norm(np.diff(step.tool_path[:, :3], axis=0), axis=1).sum())
    steps = [*scene_plan().steps[:k], replace(step, length=length), *scene_plan().steps[k + 1 :]]
    return replace(scene_plan(), steps=tuple(steps), total_length=sum(item.length for item in steps))


def with_detour(k: int, row: int, corners: list[Array]) -> Plan:
    """The scene's plan with a straight-line detour from a row through corners and back."""
    step, base = scene_plan().steps[k], scene_workcell().T_world_base
    rotation = tool_pose(step.joint_path[row], base)[:3, :3]
    joints = line_path([step.tool_path[row, :3], *corners], rotation, base, step.joint_path[row])
    joint_path = np.vstack([step.joint_path[:row], joints, joints[-2::-1], step.joint_path[row + 1 :]])
    return with_step(k, replace(step, joint_path=joint_path, tool_path=tool_rows(joint_path, base)))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(scene_assembly(), scene_workcell(), sight=0.003)


def random_configurations(scene: Scene, count: int, seed: int) -> Iterator[Array]:
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield rng.uniform(scene.joint_limits[:, 0], scene.joint_limits[:, 1])


def crowded_configurations(count: int, seed: int) -> Iterator[Array]:
    """Configurations scattered about those of the plan: many of them in collision."""
    rng = np.random.default_rng(seed)
    rows = np.vstack([step.joint_path for step in scene_plan().steps])
    for _ in range(count):
        yield rows[rng.integers(len(rows))] + rng.normal(scale=0.15, size=7)


# --- the model ---


def test_kinematics_agree_with_another_library(scene: Scene) -> None:
    for q in random_configurations(scene, 1000, 0):
        scene.place(q)
        position, rotation = scene.tool()
        expected = tool_pose(q, scene_workcell().T_world_base)
        assert np.abs(position - expected[:3, 3]).max() < 1e-6
        assert np.abs(rotation - expected[:3, :3]).max() < 1e-6


def test_joint_limits_are_those_of_the_inverse_kinematics_library(scene: Scene) -> None:
    assert np.allclose(scene.joint_limits, np.array(franka_panda_ik._JOINT_LIMITS), atol=1e-9)


def test_links_collide_with_their_real_meshes(scene: Scene) -> None:
    mesh, box = int(mujoco.mjtGeom.mjGEOM_MESH), int(mujoco.mjtGeom.mjGEOM_BOX)
    for link in [f"panda_link{i}" for i in range(8)] + ["panda_hand"]:
        (geom,) = scene.geoms(link)
        assert scene.model.geom_type[geom] == mesh
        assert scene.model.geom_contype[geom]
        assert scene.model.mesh_graphadr[scene.model.geom_dataid[geom]] >= 0  # MuJoCo has built the convex hull
    for finger in ("panda_leftfinger", "panda_rightfinger"):
        assert [int(scene.model.geom_type[geom]) for geom in scene.geoms(finger)] == [box] * 4


def stl_points(path: Path) -> Array:
    """Points (P, 3) on the surface of a binary STL file: the corners of its facets, and ten points on each facet."""
    data = path.read_bytes()
    count = int(np.frombuffer(data, "<u4", 1, 80)[0])
    facets = np.frombuffer(data, np.dtype([("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")]), count, 84)
    weights = np.vstack([np.eye(3), np.random.default_rng(0).dirichlet(np.ones(3), 10)])
    return np.asarray(np.einsum("wk,fkx->fwx", weights, facets["v"].astype(float)).reshape(-1, 3))


def test_no_point_of_a_link_enters_a_box_unseen() -> None:
    """Random boxes about the arm: wherever a point of a mesh file lies in one, the pair is reported as penetrating."""
    rng = np.random.default_rng(3)
    boxes = []
    for _ in range(30):
        quaternion = rng.normal(size=4)
        T = pose(rng.uniform([-0.8, -0.4, 0.3], [0.2, 0.6, 1.2]), quaternion / np.linalg.norm(quaternion))
        boxes.append(OrientedBox(T, rng.uniform(0.005, 0.08, 3)))
    obstacles = tuple(Obstacle(str(i), box) for i, box in enumerate(boxes))
    scene = Scene(scene_assembly(), replace(scene_workcell(), environment=obstacles), sight=0.003)
    description = scene_workcell().description
    folder = "package://example-robot-data/robots/panda_description/meshes/collision/"
    resolve = description.arm.files.resolve
    meshes = {f"panda_link{i}": stl_points(resolve(f"{folder}link{i}.stl")) for i in range(1, 8)}
    meshes["panda_hand"] = stl_points(resolve(f"{folder}hand.stl"))
    centres = np.array([box.T_frame_box[:3, 3] for box in boxes])
    reach = np.array([np.linalg.norm(box.half_extents) for box in boxes])
    hits = 0
    for q in random_configurations(scene, 100, 1):
        scene.place(q)
        pairs, distances = scene.near()
        deep = {
            frozenset((scene.label(a), scene.label(b))) for (a, b), d in zip(pairs, distances, strict=True) if d < 0
        }
        for link, points in meshes.items():
            body = scene.model.body(link).id
            world = points @ scene.data.xmat[body].reshape(3, 3).T + scene.data.xpos[body]
            middle, radius = world.mean(axis=0), float(np.ptp(world, axis=0).max())
            for b in np.nonzero(np.linalg.norm(centres - middle, axis=1) < reach + radius)[0]:
                local = (world - centres[b]) @ boxes[b].T_frame_box[:3, :3]
                if (np.abs(local) < boxes[b].half_extents - 1e-4).all(axis=1).any():
                    hits += 1
                    assert frozenset((link, f"environment/{b}")) in deep
    assert hits > 100


def test_held_and_standing_boxes_agree_with_the_separating_axis_test(scene: Scene) -> None:
    """Held part against standing parts on random configurations: nothing missed, depth exact."""
    assembly = scene_assembly()
    number = assembly.index["beam"]
    step = scene_plan().steps[1]
    scene.show(assembly.root, number)
    T_world_tool = tool_pose(step.joint_path[0], scene_workcell().T_world_base)
    T_tool_part = np.linalg.inv(T_world_tool) @ assembly.parts[number].T_world_part
    scene.grip(T_tool_part, 0.02)
    others = [
        (f"part/{part.name}", box.moved(part.T_world_part))
        for i, part in enumerate(assembly.parts)
        if i != number
        for box in assembly.body(i)
    ]
    T_other = np.array([box.T_frame_box for _, box in others])
    half_other = np.array([box.half_extents for _, box in others])
    hits = 0
    for q in crowded_configurations(600, 2):
        scene.place(q)
        pairs, distances = scene.near()
        seen: dict[str, float] = {}
        for (a, b), distance in zip(pairs, distances, strict=True):
            names = {scene.label(a), scene.label(b)}
            if "held/beam" in names:
                (other,) = names - {"held/beam"}
                seen[other] = min(seen.get(other, 1.0), float(distance))
        T_world_part = tool_pose(q, scene_workcell().T_world_base) @ T_tool_part
        expected: dict[str, float] = {}
        for box in assembly.body(number):
            T = np.repeat((T_world_part @ box.T_frame_box)[None], len(others), 0)
            separation = box_separation(T, np.repeat(box.half_extents[None], len(others), 0), T_other, half_other)
            for (name, _), value in zip(others, separation, strict=True):
                expected[name] = min(expected.get(name, 1.0), float(value))
        for name, value in expected.items():
            if value < -1e-6:
                hits += 1
                assert seen[name] == pytest.approx(value, abs=3e-4)
            elif value > 1e-6:
                assert seen.get(name, 1.0) > 0
    assert hits > 20


def test_separate_boxes_within_sight_are_all_seen_at_their_distance() -> None:
    """Held part and fingers against what stands, apart by up to 8 cm: MuJoCo's own contacts leave out some of these."""
    scene = Scene(scene_assembly(), scene_workcell(), sight=0.08)
    assembly = scene_assembly()
    number = assembly.index["beam"]
    scene.show(assembly.root, number)
    grasp = tool_pose(scene_plan().steps[1].joint_path[0], scene_workcell().T_world_base)
    scene.grip(np.linalg.inv(grasp) @ assembly.parts[number].T_world_part, 0.02)
    model, data = scene.model, scene.data

    def box_of(geom: int) -> OrientedBox:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
        return OrientedBox(T, model.geom_size[geom].copy())

    fingers = [geom for finger in scene.description.gripper.finger_links for geom in scene.geoms(finger)]
    moving = [*fingers, *scene.geoms(scene.held_bodies[number])]
    standing = [
        geom for i, part in enumerate(assembly.parts) if i != number for geom in scene.geoms(f"part/{part.name}")
    ] + scene.geoms("environment/table")
    apart = 0
    for q in crowded_configurations(100, 4):
        scene.place(q)
        pairs, distances = scene.near()
        seen = {(a, b): float(d) for (a, b), d in zip(pairs.tolist(), distances.tolist(), strict=True)}
        for a in moving:
            for b in standing:
                spheres = np.linalg.norm(model.geom_size[[a, b]], axis=1).sum()
                if np.linalg.norm(data.geom_xpos[a] - data.geom_xpos[b]) > 0.0801 + spheres:
                    assert (a, b) not in seen
                    continue
                expected = box_distance(box_of(a), box_of(b))
                if 1e-4 < expected < 0.0799:
                    apart += 1
                    assert seen[a, b] == pytest.approx(expected, abs=1e-5)
                elif expected > 0.0801:
                    assert (a, b) not in seen
    assert apart > 150


def test_absent_parts_are_not_seen(scene: Scene) -> None:
    """The tool in the middle of the loose bar: a hit while the bar is there, none when it is gone."""
    assembly = scene_assembly()
    q = scene_plan().steps[2].joint_path[0]
    loose = assembly.index["loose"]
    for state, expected in ((assembly.root, True), (assembly.root & ~(1 << loose), False)):
        scene.show(state, None)
        scene.grip(np.eye(4), 0.01)
        scene.place(q)
        pairs, distances = scene.near()
        hit = [
            pair for pair, d in zip(pairs, distances, strict=True) if d < 0 and "part/loose" in map(scene.label, pair)
        ]
        assert bool(hit) == expected


# --- a valid plan ---


def test_valid_plan_passes_with_known_clearance() -> None:
    report = verify_plan(scene_plan(), scene_assembly(), scene_workcell())
    assert report.passed and report.findings == ()
    assert report.steps == 3
    # Fingertips reach 9.5 mm beyond the tool point (URDF), the block's top is 10 mm below the middle of the loose bar.
    assert report.smallest_clearance is not None
    assert report.smallest_clearance.distance == pytest.approx(5e-4, abs=1e-6)
    assert report.smallest_clearance.second == "part/block"
    assert report.agreement.tool_position < 1e-9 and report.agreement.total_length < 1e-9
    assert report.configurations > 1000 * scene_plan().total_length  # at most 1 mm apart
    json.dumps(report_as_dict(report), allow_nan=False)


def test_plan_for_assembly_is_read_backwards() -> None:
    assert findings_of(scene_plan().inverted()) == ()


def test_demanded_clearance_is_enforced() -> None:
    findings = findings_of(scene_plan(), VerificationOptions(clearance=0.001))
    assert {(finding.part, finding.check) for finding in findings} == {("loose", "collision")}
    assert all("part/block" in finding.message and "comes within 0.500 mm" in finding.message for finding in findings)


def test_the_workcells_clearance_is_demanded_by_default() -> None:
    """The fingertips pass the block at 0.5 mm: allowed where 0.5 mm are kept, not where 0.6 mm are."""
    for clearance, parts in ((0.0005, set()), (0.0006, {"loose"})):
        workcell = replace(scene_workcell(), clearance=clearance)
        report = verify_plan(scene_plan(), scene_assembly(), workcell, hashes=scene_plan().hashes)
        assert {finding.part for finding in report.findings} == parts
        assert {finding.check for finding in report.findings} <= {"collision"}


def test_neighbours_keep_their_play_during_the_lift() -> None:
    """The beam leaves its connectors at 0.5 mm from their cheeks although 0.8 mm of clearance are demanded; 0.2 mm to
    the side, which the tool's tolerance would not forbid, is too close."""
    step, base = scene_plan().steps[1], scene_workcell().T_world_base
    start = step.tool_path[0, :3]
    rows = int(np.argmax(step.tool_path[:, 2] >= start[2] + 0.05 - 1e-6))
    corners = [start, start + [0.0002, 0, 0.004], start + [0.0002, 0, 0.01], start + [0, 0, 0.05]]
    joints = line_path(corners, DOWNWARDS["y"], base, step.joint_path[0])
    joint_path = np.vstack([joints, step.joint_path[rows + 1 :]])
    plan = with_step(1, replace(step, joint_path=joint_path, tool_path=tool_rows(joint_path, base)))
    options = VerificationOptions(clearance=0.0008, position_tolerance=0.001)
    straight = [f for f in findings_of(scene_plan(), options) if f.part == "beam"]
    aside = [f for f in findings_of(plan, options) if f.part == "beam"]
    assert straight == []
    assert {finding.check for finding in aside} == {"collision"}
    # At the start the cheeks are 0.5 mm away, and 0.4 mm must stay; the rows are 0.2 mm to the side.
    assert all(finding.depth == pytest.approx(1e-4, abs=2e-5) for finding in aside)


def test_fingers_keep_the_clearance_from_connectors_that_the_part_carries() -> None:
    """A wall on the beam, 0.3 mm beside a finger that holds the beam."""
    assembly = scene_assembly()
    beam = assembly.parts[assembly.index["beam"]]
    grasp = scene_plan().steps[1].tool_path[0, :3] - beam.T_world_part[:3, 3]
    half_finger = 0.00875  # m, along the beam: half of the fingertip's box in the URDF
    for gap, found in ((0.0003, True), (0.0008, False)):
        wall = OrientedBox(pose(grasp + [0.0125, half_finger + gap + 0.002, 0.0]), np.array([0.001, 0.002, 0.005]))
        connectors = (*assembly.connectors, Connector("extra", "U", "beam", "stub", (wall,)))
        changed = replace(assembly, connectors=connectors)
        report = verify_plan(scene_plan(), changed, scene_workcell(), hashes=scene_plan().hashes)
        messages = [f.message for f in report.findings if f.part == "beam" and "held/beam" in f.message]
        assert any("finger is only 0.300 mm from held/beam" in message for message in messages) == found


def test_a_verifier_replays_a_step_once() -> None:
    """The same step in the same state is recalled, under its number; a changed step or state is replayed."""
    verifier = Verifier(scene_assembly(), scene_workcell())
    first = verifier.verify(scene_plan())
    again = verifier.verify(scene_plan())
    assert verifier.distinct_steps == 3
    assert (again.findings, again.configurations) == (first.findings, first.configurations)
    loose_first = replace(scene_plan(), steps=(scene_plan().steps[2], *scene_plan().steps[:2]))
    moved = verifier.verify(loose_first)
    assert verifier.distinct_steps == 6  # every state is another
    assert moved.passed and moved.smallest_clearance is not None and moved.smallest_clearance.step == 0
    broken = replace(scene_plan().steps[2], joint_path=scene_plan().steps[2].joint_path + 0.01)
    assert any(f.check == "start_pose" and f.step == 2 for f in verifier.verify(with_step(2, broken)).findings)


def test_bound_agrees_with_the_rule_written_out() -> None:
    assert straight_line_bound(scene_assembly(), scene_workcell()) == pytest.approx(scene_bound(), abs=1e-12)


def test_samples_are_fine_enough_everywhere() -> None:
    """Corners of the held part and tool, moved by the other library's kinematics, never travel more than 1 mm."""
    options = VerificationOptions()
    replay = Replay(scene_assembly(), scene_workcell(), options)
    step = scene_plan().steps[1]
    # Turning the last joint makes the ends of the beam travel further than the tool does.
    swing = np.interp(np.arange(len(step.joint_path)), [0, 20, len(step.joint_path) - 1], [0.0, 0.0, 1.0])
    joint_path = step.joint_path + swing[:, None] * [0, 0, 0, 0, 0, 0, 1]
    step = replace(step, joint_path=joint_path, tool_path=tool_rows(joint_path, scene_workcell().T_world_base))
    number = scene_assembly().index["beam"]
    replay.scene.show(scene_assembly().root, number)
    base = scene_workcell().T_world_base
    T_tool_part = np.linalg.inv(tool_pose(joint_path[0], base)) @ scene_assembly().parts[number].T_world_part
    replay.scene.grip(T_tool_part, 0.02)
    positions, rotations = replay._tool_poses(joint_path)
    samples = replay._samples(step, number, positions, rotations)
    corners = np.vstack([box.corners() for box in scene_assembly().body(number)])
    points = np.vstack([corners @ T_tool_part[:3, :3].T + T_tool_part[:3, 3], np.zeros(3)])
    poses = np.array([tool_pose(q, base) for q in samples.configurations])
    moved = np.einsum("sij,pj->spi", poses[:, :3, :3], points) + poses[:, None, :3, 3]
    assert np.linalg.norm(np.diff(moved, axis=0), axis=2).max() <= options.tool_step * 1.001
    assert np.abs(np.diff(samples.configurations, axis=0)).max() <= options.joint_step * 1.001
    assert set(range(len(joint_path))) <= set(samples.times)  # every row is checked itself
    for time, q in zip(samples.times[::50], samples.configurations[::50], strict=True):
        expected = [np.interp(time, np.arange(len(joint_path)), joint_path[:, j]) for j in range(7)]
        assert np.allclose(q, expected, atol=1e-12)


# --- contacts that are allowed, and those that are not ---


def test_sideways_lift_hits_the_cheek_of_the_connector() -> None:
    """1 mm sideways in the connector, where 0.5 mm is free: the lift is not straight, and the beam hits its hosts."""
    step, base = scene_plan().steps[1], scene_workcell().T_world_base
    start = step.tool_path[0, :3]
    rows = int(np.argmax(step.tool_path[:, 2] >= start[2] + 0.05 - 1e-6))
    corners = [start, start + [0.001, 0, 0.004], start + [0.001, 0, 0.02], start + [0, 0, 0.05]]
    joints = line_path(corners, DOWNWARDS["y"], base, step.joint_path[0])
    joint_path = np.vstack([joints, step.joint_path[rows + 1 :]])
    plan = with_step(1, replace(step, joint_path=joint_path, tool_path=tool_rows(joint_path, base)))
    findings = findings_of(plan)
    assert {finding.check for finding in findings} == {"lift", "collision"}
    hits = [finding for finding in findings if finding.check == "collision"]
    assert {finding.message for finding in hits} == {"part/left hits held/beam", "part/right hits held/beam"} or {
        finding.message for finding in hits
    } == {"held/beam hits part/left", "held/beam hits part/right"}
    assert all(finding.depth == pytest.approx(5e-4, abs=5e-5) for finding in hits)


@pytest.mark.parametrize(("depth", "allowed"), [(-2e-4, True), (5e-5, False)])
def test_resting_contact_is_allowed_in_the_lift_only(depth: float, allowed: bool) -> None:
    """After the lift the beam is lowered again, to just above or 0.05 mm into the floors of its connectors."""
    start = scene_plan().steps[1].tool_path[0, :3]
    row = int(np.argmax(scene_plan().steps[1].tool_path[:, 2] >= start[2] + 0.05 - 1e-6)) + 1
    plan = with_detour(1, row, [start + [0, 0, 0.03], start - [0, 0, depth]])
    findings = findings_of(plan, VerificationOptions(clearance=0.0))
    assert {finding.check for finding in findings} == (set() if allowed else {"collision"})
    for finding in findings:
        assert finding.depth == pytest.approx(depth, abs=1e-5)
        assert finding.time is not None and finding.time > row


def test_table_under_the_loose_bar_is_hit_by_the_fingers() -> None:
    """A block 0.6 mm higher than the fingertips' reach allows, as an obstacle beside the bar."""
    workcell = scene_workcell()
    table = workcell.environment[0]
    T = table.box.T_frame_box.copy()
    T[:3, 3] = [0.12, 0.40, 0.0506]  # the block itself, 0.6 mm higher than the part, but free of the bar
    half = np.array([0.05, 0.05, 0.05])
    raised = replace(table, name="raised", box=replace(table.box, T_frame_box=T, half_extents=half))
    changed: Workcell = replace(workcell, environment=(table, raised))
    findings = verify_plan(scene_plan(), scene_assembly(), changed, hashes=scene_plan().hashes).findings
    collisions = {finding.message for finding in findings if finding.check == "collision"}
    assert any("panda_leftfinger" in message and "environment/raised" in message for message in collisions)
    assert "part/loose stands in environment/raised" in collisions  # 0.6 mm is more than drawings may overlap


def test_findings_are_one_line_each() -> None:
    k = 1
    broken = replace(scene_plan().steps[k], grasp=replace(scene_plan().steps[k].grasp, width=0.025))
    lines = [format_finding(finding) for finding in findings_of(with_step(k, broken))]
    assert any(line.startswith("step 2 beam row 0.00: width:") and line.endswith("(5.000 mm)") for line in lines)
    assert all("\n" not in line for line in lines)


# --- stability and physics ---


def test_connector_rule_on_the_scene() -> None:
    assembly = scene_assembly()
    without_beam = assembly.root & ~assembly.state_of(["beam"])
    assert unsupported(assembly, assembly.root) == []
    assert unsupported(assembly, without_beam) == [("stub", "beam")]
    assert unsupported(assembly, assembly.state_of(["beam"])) == []


def test_connector_rule_agrees_with_the_planners_on_profile_assemblies() -> None:
    """Two versions of the rule, written apart, on random states of ten generated assemblies."""
    rng = np.random.default_rng(11)
    candidates = (generate_candidate(ProfileOptions(), candidate_rng(0, k), "candidate") for k in range(200))
    assemblies = [found for found in candidates if isinstance(found, Assembly)][:10]
    seen: Counter[bool] = Counter()
    for assembly in assemblies:
        rule = ConnectorStability(assembly)
        part_of = {part.name: part for part in assembly.parts}
        for _ in range(50):
            state = assembly.root
            for i in rng.permutation(members(state))[: int(rng.integers(6))]:
                state &= ~(1 << int(i))
            expected = all(rule.needs(i) & ~state == 0 for i in members(state))
            by_connectors = [
                (part, host) for part, host in unsupported(assembly, state) if carriers(assembly, part_of[part])
            ]
            assert (not by_connectors) == expected
            seen[expected] += 1
    assert len(assemblies) == 10 and min(seen[True], seen[False]) > 50


@pytest.mark.slow
def test_rule_and_physics_agree_on_a_profile_assembly() -> None:
    """One random order that keeps the rule, and every removal from the full assembly that breaks it."""
    rng = np.random.default_rng(5)
    candidates = (generate_candidate(ProfileOptions(), candidate_rng(0, k), "candidate") for k in range(200))
    assembly = next(found for found in candidates if isinstance(found, Assembly))
    order = [assembly.root]
    while order[-1]:
        following = [order[-1] & ~(1 << i) for i in members(order[-1])]
        stable = [state for state in following if not unsupported(assembly, state)]
        order.append(stable[int(rng.integers(len(stable)))])
    broken = [assembly.root & ~(1 << i) for i in members(assembly.root)]
    broken = [state for state in broken if unsupported(assembly, state)]
    comparison = compare_stability(assembly, [*order, *broken])
    assert (comparison.both_stand, comparison.both_fall) == (len(order), len(broken))


def test_rule_and_physics_agree_on_all_states_of_the_scene() -> None:
    assembly = scene_assembly()
    free = members(assembly.root)
    states = [sum(1 << i for k, i in enumerate(free) if mask >> k & 1) for mask in range(1 << len(free))]
    comparison = compare_stability(assembly, states)
    assert (comparison.both_stand, comparison.both_fall) == (6, 2)  # the stub without the beam, loose bar or not
    assert comparison.agreement == 1.0


def test_a_part_without_its_host_falls_and_is_named() -> None:
    report = stand_under_gravity(scene_assembly(), scene_assembly().state_of(["stub", "loose"]))
    assert [finding.part for finding in report.findings] == ["stub"]
    assert not report.stands


def test_free_fall_is_as_deep_as_gravity_says() -> None:
    """A lifted bar with nothing under it: g t^2 / 2 before it reaches anything (0.04 s: 7.8 mm)."""
    assembly = scene_assembly()
    parts = list(assembly.parts)
    loose = assembly.index["loose"]
    T = parts[loose].T_world_part.copy()
    T[2, 3] += 0.3
    parts[loose] = replace(parts[loose], T_world_part=T)
    report = stand_under_gravity(replace(assembly, parts=tuple(parts)), assembly.state_of(["loose"]), seconds=0.04)
    assert report.largest_shift == pytest.approx(0.5 * 9.81 * 0.04**2, rel=0.06)


def test_physics_findings_reach_the_report() -> None:
    steps = scene_plan().steps
    order = (steps[1], steps[0], steps[2])
    report = verify_plan(replace(scene_plan(), steps=order), scene_assembly(), scene_workcell(), physics=True)
    physics = [finding for finding in report.findings if finding.check == "physics"]
    assert [(finding.step, finding.part) for finding in physics] == [(0, "beam")]
    assert "'stub' does not stand" in physics[0].message
    assert report.states == 4
    assert states_of(replace(scene_plan(), steps=order), scene_assembly())[-1] == 0


# --- corrupted plans ---


def refused_for_the_right_reason(corrupted: Corrupted) -> bool:
    """The expected check, in the expected step."""
    return any(
        finding.check == corrupted.check and corrupted.step in (None, finding.step)
        for finding in findings_of(corrupted.plan)
    )


@pytest.mark.parametrize("name", list(MUTATIONS))
def test_corrupted_plan_is_refused(name: str) -> None:
    rng = np.random.default_rng(7)
    attempts = (MUTATIONS[name](scene_target(), rng) for _ in range(20))
    corrupted = next(attempt for attempt in attempts if attempt is not None)
    assert refused_for_the_right_reason(corrupted)


@pytest.mark.slow
def test_five_hundred_corrupted_plans_are_refused() -> None:
    """The untouched plans pass (`judged` checks that), every corrupted one is refused for the right reason."""
    rng = np.random.default_rng(2024)
    results = judged("scene", scene_target(), 100, rng)
    for name in ASSEMBLIES[:2]:
        results += judged(name, shipped_target(name), 200, rng)
    wrong = [(r.target, r.corrupted.name, r.findings) for r in results if not r.right_reason]
    assert wrong == []
    assert len(results) == 500 and {r.corrupted.name for r in results} == set(MUTATIONS)


@pytest.mark.slow
@pytest.mark.parametrize(
    "path", sorted(ROOT.glob("data/plans/**/*.json")) + sorted(ROOT.glob("out/**/plan.json")), ids=str
)
def test_plans_on_disk_pass(path: Path) -> None:
    """Plans that the planner has written: ``assembly`` and ``workcell`` name files below ``data``."""
    plan = load_plan(path)
    assembly = next((load_assembly(p) for p in ROOT.glob("data/*/*.json") if load_name(p) == plan.assembly), None)
    if assembly is None:
        pytest.skip(f"no assembly {plan.assembly!r} below data")
    report = verify_plan(plan, assembly, load_workcell(plan.workcell), physics=True)
    assert [format_finding(finding) for finding in report.findings] == []


@pytest.mark.slow
@pytest.mark.timeout(3600)  # five minutes of processor time, on a machine that may have other work
def test_plans_of_all_searches_pass_on_two_shipped_assemblies(tmp_path: Path) -> None:
    """`make verify-all` in small; the second call does nothing again and finds the same."""
    assert verify_all.main(["--quick", "--out", str(tmp_path)]) == 0
    outcomes = [json.loads(path.read_text())["outcome"] for path in sorted(tmp_path.glob("*.json"))]
    assert [outcome["assembly"] for outcome in outcomes] == ["double/01", "single/03"]
    for outcome in outcomes:
        assert {verdict["search"] for verdict in outcome["verdicts"]} == set(SEARCHES)
        assert outcome["agreement"]["only_rule_stands"] == outcome["agreement"]["only_physics_stands"] == 0
        assert outcome["agreement"]["both_fall"] > 10
    before = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert verify_all.main(["--quick", "--out", str(tmp_path)]) == 0
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == before


def load_name(path: Path) -> str:
    """Name of the assembly in a file; empty for other files."""
    document = json.loads(path.read_text(encoding="utf-8"))
    return str(document.get("name", "")) if document.get("format") == "takeapart/assembly" else ""


def test_quaternion_conversion_of_the_scene_is_consistent() -> None:
    """The tool path's quaternions are those of MuJoCo's rotation, up to sign."""
    scene = Scene(scene_assembly(), scene_workcell(), sight=0.003)
    step = scene_plan().steps[0]
    scene.place(step.joint_path[10])
    _, rotation = scene.tool()
    assert abs(float(quaternion_from_rotation(rotation) @ step.tool_path[10, 3:])) == pytest.approx(1.0, abs=1e-9)
