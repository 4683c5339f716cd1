"""What the verifier looks at along a motion: every joint's limits, what happens between rows, how deep neighbours may
overlap. Truth comes from the inverse kinematics library and from FCL on the mesh files."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from ssik.prebuilt import franka_panda_ik

from mesh_oracle import MeshOracle
from takeapart.model.assembly import Connector
from takeapart.model.geometry import Array, OrientedBox, pose
from takeapart.model.plan import PlanStep
from takeapart.verification import Finding, VerificationOptions
from takeapart.verification.replay import Replay, check_joint_limits
from takeapart.workcell import Obstacle
from verification_scene import (
    DOWNWARDS,
    line_path,
    scene_assembly,
    scene_plan,
    scene_workcell,
    tool_pose,
    tool_rows,
    track,
)

LIMITS = np.array(franka_panda_ik._JOINT_LIMITS)  # (7, 2) rad
SMALL_TURN = 1e-4  # rad


def moved(step: PlanStep, joint_path: Array) -> PlanStep:
    """The step on another joint path."""
    return replace(step, joint_path=joint_path, tool_path=tool_rows(joint_path, scene_workcell().T_world_base))


@pytest.fixture(scope="module")
def replay() -> Replay:
    return Replay(scene_assembly(), scene_workcell(), VerificationOptions())


def findings_along(replay: Replay, k: int, joint_path: Array, check: str) -> list[Finding]:
    """Findings of one check where step k of the scene follows another joint path, all parts still there."""
    step = moved(scene_plan().steps[k], joint_path)
    return [found for found in replay.step(step, k, scene_assembly().root).findings if found.check == check]


# --- limits


@pytest.mark.parametrize("side", [0, 1], ids=["lower", "upper"])
@pytest.mark.parametrize("joint", range(7))
def test_no_joint_may_leave_its_range_on_either_side(joint: int, side: int) -> None:
    """One row of three: a ten-thousandth of a radian beyond is refused with its number, and as much inside is not."""
    for beyond, refused in ((SMALL_TURN, True), (-SMALL_TURN, False)):
        rows = np.repeat(scene_plan().steps[0].joint_path[:1], 3, axis=0)
        rows[1, joint] = LIMITS[joint, side] + (beyond if side else -beyond)
        findings = check_joint_limits(moved(scene_plan().steps[0], rows), 0, LIMITS)
        assert len(findings) == refused
        for found in findings:
            assert found.message.startswith(f"joint {joint + 1} stands at {np.degrees(rows[1, joint]):.2f} deg")
            assert (found.check, found.time) == ("joint_limit", 1.0)
            assert found.depth == pytest.approx(SMALL_TURN, abs=1e-9)


@pytest.mark.parametrize("side", [0, 1], ids=["lower", "upper"])
def test_a_replay_looks_at_the_limits(replay: Replay, side: int) -> None:
    """The last joint turns beyond either end of its range, by steps that are allowed."""
    first = scene_plan().steps[0].joint_path[0]
    beyond = LIMITS[6, side] + (SMALL_TURN if side else -SMALL_TURN)
    turns = np.linspace(first[6], beyond, int(np.ceil(abs(beyond - first[6]) / 0.09)) + 1)
    rows = np.column_stack([np.repeat(first[None, :6], len(turns), axis=0), turns])
    (found,) = findings_along(replay, 0, rows, "joint_limit")
    assert found.message.startswith("joint 7") and found.time == len(rows) - 1


@pytest.mark.parametrize("side", [0, 1], ids=["lower", "upper"])
@pytest.mark.parametrize("joint", range(7))
def test_the_arm_rests_within_its_range_on_either_side(replay: Replay, joint: int, side: int) -> None:
    for beyond, refused in ((SMALL_TURN, True), (-SMALL_TURN, False)):
        home = scene_workcell().home.copy()
        home[joint] = LIMITS[joint, side] + (beyond if side else -beyond)
        resting = copy.copy(replay)
        resting.workcell = replace(scene_workcell(), home=home)
        said = [found.message for found in resting.check_placement() if " rests at " in found.message]
        assert [message.partition(" rests")[0] for message in said] == ([f"joint {joint + 1}"] if refused else [])


# --- between rows


def elbow_swing() -> Array:
    """Two rows (2, 7), rad, at which the tool has the same pose, and the elbow has not."""
    base, start = scene_workcell().T_world_base, scene_plan().steps[0].joint_path[0]
    moves = [tool_pose(start + 1e-6 * unit, base) - tool_pose(start - 1e-6 * unit, base) for unit in np.eye(7)]
    still = np.linalg.svd(np.array(moves).reshape(7, 16).T)[2][-1]
    return np.array([start, track(start + 1.2 * still, np.asarray(franka_panda_ik.fk(start)))])


def specks_in_between(rows: Array, count: int) -> list[tuple[str, OrientedBox]]:
    """Cubes of 2 mm that a link meets half way between two rows and not at either, by its hull; and its name."""
    oracle, rng = MeshOracle(scene_workcell().description), np.random.default_rng(81)
    found = []
    for link in ("panda_link2", "panda_link3", "panda_link4", "panda_link5"):
        hull = ConvexHull(oracle.vertices[link])
        facets = rng.integers(len(hull.simplices), size=50_000)
        points = np.einsum("pk,pkx->px", rng.dirichlet(np.ones(3), 50_000), hull.points[hull.simplices[facets]])
        points -= rng.uniform(0, 0.02, (50_000, 1)) * hull.equations[facets, :3]  # half way, in the link's frame
        inside = []
        for q in (rows[0], rows.mean(axis=0), rows[1]):
            oracle.place(q, 0.02)
            inside.append(oracle.urdf.get_transform(link))
        T_base_middle = inside[1]
        depth = []  # (3, P) m beyond the hull, negative inside it
        for T_base_link in inside:
            T = np.linalg.inv(T_base_link) @ T_base_middle
            local = points @ T[:3, :3].T + T[:3, 3]
            depth.append((local @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1))
        graze = (depth[1] < -2e-4) & (np.minimum(depth[0], depth[2]) > 0.003)
        for point in points[graze][:count]:
            at = (scene_workcell().T_world_base @ T_base_middle @ np.append(point, 1.0))[:3]
            found.append((link, OrientedBox(pose(at), np.full(3, 1e-3))))
    assert len(found) >= count
    return found


def test_what_the_elbow_hits_between_two_rows_is_found_though_the_tool_stands_still() -> None:
    rows = elbow_swing()
    ends = [tool_pose(q, scene_workcell().T_world_base) for q in rows]
    assert np.abs(ends[1] - ends[0]).max() < 1e-9, "the tool does not tell that anything moves"
    assert np.abs(rows[1] - rows[0]).max() > 0.3
    for link, box in specks_in_between(rows, 3):
        workcell = replace(scene_workcell(), clearance=0.0, environment=(Obstacle("speck", box),))
        looking = Replay(scene_assembly(), workcell, VerificationOptions())

        def hits(path: Array, names: set[str], looking: Replay = looking) -> bool:
            found = findings_along(looking, 0, path, "collision")
            return any(names <= set(finding.message.split()) for finding in found)

        names = {link, "environment/speck"}
        assert not hits(rows[[0, 0]], names) and not hits(rows[[1, 1]], names)
        assert hits(rows, names)
        assert hits(rows[::-1], names)


def test_no_joint_turns_further_than_the_options_say_between_two_configurations(replay: Replay) -> None:
    rows, step = elbow_swing(), scene_plan().steps[0]
    turn = np.abs(rows[1] - rows[0]).max()
    for share in (1.0, 0.25):
        path = np.array([rows[0], rows[0] + share * (rows[1] - rows[0])])
        result = replay.step(moved(step, path), 0, scene_assembly().root)
        assert result.configurations >= 1 + share * turn / np.radians(0.5)


# --- lift and clearance


@pytest.mark.parametrize(("height", "refused"), [(0.0495, True), (0.0498, True), (0.05, False)])
def test_a_part_goes_aside_no_earlier_than_at_the_full_height(replay: Replay, height: float, refused: bool) -> None:
    step, base = scene_plan().steps[2], scene_workcell().T_world_base
    start = step.tool_path[0, :3]
    corners = [start, start + [0, 0, height], start + [0.01, 0, height], start + [0.01, 0, 0.06]]
    joints = line_path(corners, DOWNWARDS["y"], base, step.joint_path[0])
    assert bool(findings_along(replay, 2, joints, "lift")) == refused


@pytest.mark.parametrize(("lowered", "least"), [(0.0, 0.0005), (0.0015, 0.0015), (0.0025, 0.0025)])
def test_the_smallest_clearance_is_told_also_where_it_is_more_than_demanded(lowered: float, least: float) -> None:
    """The fingertips reach to 0.5 mm above the block on which the loose bar lies; lowered, it is nearer to the bar."""
    assembly = scene_assembly()
    parts = list(assembly.parts)
    block = assembly.index["block"]
    parts[block] = replace(parts[block], T_world_part=parts[block].T_world_part @ pose([0.0, 0.0, -lowered]))
    looking = Replay(replace(assembly, parts=tuple(parts)), scene_workcell(), VerificationOptions())
    step = scene_plan().steps[2]
    clearance = looking.step(moved(step, step.joint_path[:4]), 2, assembly.root).clearance
    assert clearance is not None and clearance.second == "part/block"
    assert clearance.distance == pytest.approx(least, abs=1e-6)


@pytest.mark.parametrize(("above", "link"), [(0.13, "panda_link7"), (0.09, "panda_hand"), (0.30, None)])
def test_what_carries_the_gripper_keeps_from_the_part_that_it_holds(above: float, link: str | None) -> None:
    """A wall that the beam carries, at a height over the grasp, m: no simulator tests what never moves against it."""
    assembly, step = scene_assembly(), scene_plan().steps[1]
    at = step.grasp.center - assembly.parts[assembly.index["beam"]].T_world_part[:3, 3] + [0.0, 0.0, above]
    wall = Connector("mast", "U", "beam", "stub", (OrientedBox(pose(at), np.full(3, 0.004)),))
    changed = replace(assembly, connectors=(*assembly.connectors, wall))
    looking = Replay(changed, scene_workcell(), VerificationOptions())
    findings = looking.step(moved(step, step.joint_path[:2]), 1, assembly.root).findings
    hits = [found.message for found in findings if found.message.endswith("cuts into held/beam")]
    assert hits == ([f"{link} cuts into held/beam"] if link else [])


# --- neighbours


def overlapping(depth: float) -> Replay:
    """The scene with its block, here an obstacle, let into the loose bar by a depth, m."""
    assembly = scene_assembly()
    block = assembly.parts[assembly.index["block"]]
    box = OrientedBox(block.T_world_part @ pose([0.0, 0.0, depth]), np.full(3, 0.05))
    workcell = replace(scene_workcell(), clearance=0.0, environment=(Obstacle("block", box),))
    parts = tuple(part for part in assembly.parts if part.name != "block")
    return Replay(replace(assembly, parts=parts), workcell, VerificationOptions())


@pytest.mark.parametrize(("depth", "allowed"), [(5e-5, True), (9e-5, True), (1.2e-4, False), (4e-4, False)])
def test_neighbours_may_overlap_by_a_tenth_of_a_millimetre_and_no_more(depth: float, allowed: bool) -> None:
    """However deep one stands in another at the start: what is more than rounding is a collision."""
    looking, step = overlapping(depth), scene_plan().steps[2]
    hits = [found for found in looking.step(step, 2, looking.assembly.root).findings if found.check == "collision"]
    assert bool(hits) != allowed
    assert all("environment/block" in found.message for found in hits)
    assert all(found.depth == pytest.approx(depth, abs=1e-6) for found in hits)


@pytest.mark.parametrize(("demanded", "allowed"), [(0.0019, True), (0.0023, False)])
def test_neighbours_nearer_than_the_clearance_may_stay_so_while_they_part(demanded: float, allowed: bool) -> None:
    """The bar starts 1.5 mm over the block, the fingertips 2 mm: only what starts as a neighbour may be too near."""
    looking, step = overlapping(-0.0015), scene_plan().steps[2]
    looking = Replay(looking.assembly, looking.workcell, VerificationOptions(clearance=demanded))
    findings = looking.step(moved(step, step.joint_path[:16]), 2, looking.assembly.root).findings
    hits = [found.message for found in findings if found.check == "collision"]
    assert bool(hits) != allowed
    assert not any("held/loose" in message for message in hits)


@pytest.mark.parametrize(("dip", "allowed"), [(4e-5, True), (7e-5, False)])
def test_neighbours_that_overlap_at_the_start_must_not_cut_deeper(dip: float, allowed: bool) -> None:
    """The bar starts 0.05 mm in its block and is pressed down before it is lifted: 0.1 mm is the end of it."""
    looking, base = overlapping(5e-5), scene_workcell().T_world_base
    step = scene_plan().steps[2]
    start = step.tool_path[0, :3]
    joints = line_path([start, start - [0, 0, dip], start + [0, 0, 0.01]], DOWNWARDS["y"], base, step.joint_path[0])
    findings = looking.step(moved(step, joints), 2, looking.assembly.root).findings
    hits = [found for found in findings if found.check == "collision"]
    assert bool(hits) != allowed
    assert all(found.depth == pytest.approx(5e-5 + dip, abs=1e-6) for found in hits)
