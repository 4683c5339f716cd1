"""Ways around the verifier that were once open: what it must not take for granted, in MuJoCo or in a plan."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from mutation_table import scene_target
from plan_mutations import MUTATIONS, with_wrist_turned
from takeapart.formats.serialization import workcell_hash_by_name
from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Array
from takeapart.model.plan import Grasp, Plan, PlanStep
from takeapart.verification import Verifier, stand_under_gravity, verify_plan
from takeapart.verification import physics as physics_of_states
from takeapart.verification.checks import NOTHING_BELOW, check_schema, unsupported
from takeapart.verification.robot import mujoco
from verification_scene import scene_assembly, scene_plan, scene_workcell, tool_rows


@pytest.mark.parametrize("name", [name for name in MUTATIONS if not name.startswith("direction")])
def test_corrupted_plan_is_refused_when_it_is_read_backwards(name: str) -> None:
    """A plan for assembly is checked for all that a plan for disassembly is."""
    rng = np.random.default_rng(8)
    corrupted = next(made for made in (MUTATIONS[name](scene_target(), rng) for _ in range(20)) if made is not None)
    findings = verify_plan(corrupted.plan.inverted(), scene_assembly(), scene_workcell()).findings
    assert any(f.check == corrupted.check and corrupted.step in (None, f.step) for f in findings)


def test_a_part_without_connectors_needs_all_that_it_lies_on() -> None:
    """The loose bar on its block, on another bar that may leave, and in the air."""
    assembly = scene_assembly()
    loose, block = assembly.index["loose"], assembly.index["block"]
    free = list(assembly.parts)
    free[block] = replace(free[block], fixed=False)
    removable = replace(assembly, parts=tuple(free))
    assert unsupported(removable, removable.root) == [("block", NOTHING_BELOW)]
    assert unsupported(removable, removable.root & ~(1 << block)) == [("loose", "block")]
    order = [PlanStep("block", *_rest_of(scene_plan().steps[2])), *scene_plan().steps]
    report = verify_plan(replace(scene_plan(), steps=tuple(order)), removable, scene_workcell(), hashes={})
    messages = {f.step: f.message for f in report.findings if f.check == "stability"}
    assert messages == {
        None: f"part 'block' stands without {NOTHING_BELOW!r} before anything moves",
        0: "part 'loose' is left without 'block'",
    }
    for height, floats in ((0.0008, False), (0.003, True)):
        parts = list(assembly.parts)
        T = parts[loose].T_world_part.copy()
        T[2, 3] += height
        parts[loose] = replace(parts[loose], T_world_part=T)
        changed = replace(assembly, parts=tuple(parts))
        assert bool(unsupported(changed, changed.root)) == floats
        findings = verify_plan(scene_plan(), changed, scene_workcell(), hashes={}).findings
        assert any(f.check == "stability" and "'loose'" in f.message for f in findings) == floats


def _rest_of(step: PlanStep) -> tuple[Grasp, Array, Array, float]:
    return step.grasp, step.joint_path, step.tool_path, step.length


def test_a_simulation_that_breaks_down_is_no_proof(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """MuJoCo sets a state back to the start where numbers overflow: nothing has moved then, and nothing is shown."""
    monkeypatch.chdir(tmp_path)
    made = physics_of_states.gravity_model

    def heavy(assembly: Assembly, state: int) -> mujoco.MjModel:
        model = made(assembly, state)
        model.opt.gravity[:] = [0.0, 0.0, -1e13]
        return model

    monkeypatch.setattr(physics_of_states, "gravity_model", heavy)
    report = stand_under_gravity(scene_assembly(), scene_assembly().root)
    assert report.largest_shift == 0.0
    assert [finding.message for finding in report.findings] == ["the simulation broke down: BADQACC"]
    assert list(tmp_path.iterdir()) == [], "MuJoCo keeps no log of it"


def test_contacts_that_were_left_out_are_told() -> None:
    """MuJoCo counts a warning when its memory for contacts is full."""
    verifier = Verifier(scene_assembly(), scene_workcell())
    verifier.replay.scene.data.warning[mujoco.mjtWarning.mjWARN_CONTACTFULL].number = 1
    findings = verifier.verify(scene_plan()).findings
    assert [(f.step, f.check) for f in findings] == [(0, "collision"), (1, "collision"), (2, "collision")]
    assert all("not all of them were seen" in finding.message for finding in findings)


def test_numbers_of_the_heading_must_be_finite() -> None:
    for change in ({"seconds": np.nan}, {"counts": {"motion_plans": -1}}, {"total_length": np.inf}):
        findings = verify_plan(replace(scene_plan(), **change), scene_assembly(), scene_workcell()).findings
        assert any(f.check == "schema" and f.message.split()[0] in ("motion_plans", *change) for f in findings)


def test_length_is_measured_between_the_rows_too() -> None:
    """The wrist swings to and fro over 0.8 rad: with rows 0.08 rad apart the tool travels further on its arcs than from
    row to row, and a length of the rows says too little."""
    step, base = scene_plan().steps[2], scene_workcell().T_world_base
    row = len(step.joint_path) - 20
    stated, travelled, refused = [], [], []
    for spacing in (0.005, 0.08):
        swing = np.interp(np.arange(0.0, 6.4, spacing), np.linspace(0.0, 6.4, 9), [0.0, -0.8] * 4 + [0.0])
        wave = np.repeat(step.joint_path[row : row + 1], len(swing), axis=0)
        wave[:, 5] += swing
        ends = step.joint_path[:row], step.joint_path[row:]
        path = np.vstack([ends[0], wave, ends[1]])
        tool = tool_rows(path, base)
        length = float(np.linalg.norm(np.diff(tool[:, :3], axis=0), axis=1).sum())
        dense = np.vstack([a + (b - a) * np.arange(20)[:, None] / 20 for a, b in pairwise(path)] + [path[-1:]])
        travelled.append(float(np.linalg.norm(np.diff(tool_rows(dense, base)[:, :3], axis=0), axis=1).sum()))
        stated.append(length)
        changed = replace(step, joint_path=path, tool_path=tool, length=length)
        steps = (*scene_plan().steps[:2], changed)
        plan = replace(scene_plan(), steps=steps, total_length=sum(each.length for each in steps))
        findings = verify_plan(plan, scene_assembly(), scene_workcell(), physics=False).findings
        assert not [f for f in findings if f.check in ("jump", "tool_path", "schema", "total_length")]
        refused.append([f.depth for f in findings if f.check == "length"])
    assert travelled[0] - stated[0] < 1e-4 < 2e-4 < travelled[1] - stated[1]
    assert refused[0] == []
    assert refused[1] == [pytest.approx(travelled[1] - stated[1], abs=1e-5)]


@pytest.mark.parametrize(("angle", "accepted"), [(np.radians(0.03), True), (np.radians(0.1), False)])
def test_fingers_close_squarely(angle: float, accepted: bool) -> None:
    """Grasp and path agree, but the hand is turned a little about its approach."""
    corrupted = with_wrist_turned(scene_target(), 0, float(angle))
    findings = verify_plan(corrupted, scene_assembly(), scene_workcell(), physics=False).findings
    assert any(f.check == "grasp" and "off the normal" in f.message for f in findings) != accepted


@pytest.mark.parametrize(("beside", "accepted"), [(5e-5, True), (2e-4, False)])
def test_both_fingers_touch_what_they_hold(beside: float, accepted: bool) -> None:
    """Each finger stands this far, m, beside the part; what the width itself has to be is another check."""
    steps = list(scene_plan().steps)
    steps[0] = replace(steps[0], grasp=replace(steps[0].grasp, width=steps[0].grasp.width + 2 * beside))
    plan = replace(scene_plan(), steps=tuple(steps))
    findings = verify_plan(plan, scene_assembly(), scene_workcell(), physics=False).findings
    assert any(f.check == "finger_contact" for f in findings) != accepted


def test_a_path_has_two_rows_or_more_of_as_many_numbers_as_the_arm_has_joints() -> None:
    step = scene_plan().steps[0]
    for rows, joints, right in ((1, 7, False), (2, 7, True), (3, 7, True), (3, 6, False), (3, 8, False)):
        path = replace(step, joint_path=np.zeros((rows, joints)), tool_path=step.tool_path[:rows])
        assert [finding.check for finding in check_schema(path, 4, 7)] == ([] if right else ["schema"])
    for tool_path in (step.tool_path[:2], step.tool_path[:3, :6]):
        path = replace(step, joint_path=np.zeros((3, 7)), tool_path=tool_path)
        assert [(finding.check, finding.step) for finding in check_schema(path, 4, 7)] == [("schema", 4)]


def test_a_plan_of_version_1_names_its_workcell_by_the_robots_name() -> None:
    by_name = workcell_hash_by_name(scene_workcell())
    plan = replace(scene_plan(), robot="", joints=(), hashes={**scene_plan().hashes, "workcell": by_name})

    def checks(tried: Plan) -> list[str]:
        report = verify_plan(tried, scene_assembly(), scene_workcell(), physics=False)
        return [finding.check for finding in report.findings]

    assert checks(plan) == []
    assert checks(replace(plan, joints=scene_plan().joints)) == ["hash"]  # later files know the robot's files
    assert checks(replace(plan, hashes={**plan.hashes, "workcell": "0" * 64})) == ["hash"]
