"""The judge's rule of what carries what: built cases, witness orders, and a plan for a scene that no longer holds."""

from __future__ import annotations

from dataclasses import replace

import pytest

import support_scenes as scenes
from takeapart.formats.files import data_path, load_assembly
from takeapart.model.assembly import Assembly
from takeapart.verification import verify_plan
from takeapart.verification.support import Support, check_support
from verification_scene import scene_assembly, scene_plan, scene_workcell


@pytest.mark.parametrize(
    ("assembly", "message"),
    [
        (scenes.cantilever(), "part 'bar' tips: its weight lies 180.0 mm beyond what carries it"),
        (scenes.floorless(), "connector 'holder' has no floor below 'bar', within 1 mm"),
        (scenes.floorless(), "nothing carries 100 % of the weight of part 'bar'"),
        (scenes.post(0.015), "nothing carries 100 % of the weight of part 'post'"),
        (scenes.bar_between_cheeks(), "nothing carries 100 % of the weight of part 'bar'"),
        (scenes.lintel(0.010), "nothing carries 100 % of the weight of part 'lintel'"),
        (scenes.lintel(kind="U"), "connector 'head' has no floor below 'post', within 1 mm"),
        (scenes.lintel(x=0.0109), "part 'lintel' tips: its weight lies 0.9 mm beyond what carries it"),
        (scenes.seesaw(0.0009), "part 'bar' tips: its weight lies 0.9 mm beyond what carries it"),
        (scenes.far_holder(), "connector 'holder' is 165.0 mm from its host 'base'"),
        (scenes.far_holder(), "connector 'holder' is 339.8 mm from its guest 'bar'"),
        (scenes.corner_holder(), "connector 'holder' is 1.7 mm from its host 'host'"),
    ],
)
def test_what_does_not_hold_is_a_finding(assembly: Assembly, message: str) -> None:
    findings = check_support(Support(assembly), [assembly.root], [])
    assert message in [finding.message for finding in findings]
    assert {finding.check for finding in findings} == {"support"}


@pytest.mark.parametrize(
    "assembly",
    [scenes.post(), scenes.post(0.0009), scenes.lintel(), scenes.lintel(x=0.0089), scenes.seesaw(-0.002)],
)
def test_what_holds_is_none(assembly: Assembly) -> None:
    assert check_support(Support(assembly), [assembly.root], []) == []


@pytest.mark.parametrize("name", ["examples/rack", "single/01", "single/13", "double/01", "double/07"])
def test_witness_orders_hold_in_every_state(name: str) -> None:
    assembly = load_assembly(data_path(f"{name}.json"))
    states = [assembly.root]
    for part in assembly.witness:
        states.append(states[-1] & ~assembly.state_of([part]))
    assert check_support(Support(assembly), states, assembly.witness) == []


def test_a_plan_is_refused_without_physics_where_a_u_has_lost_its_floor() -> None:
    assembly = scene_assembly()
    connectors = list(assembly.connectors)
    assert connectors[-1].name == "front-stub"
    connectors[-1] = replace(connectors[-1], walls=connectors[-1].walls[1:])
    changed = replace(assembly, connectors=tuple(connectors))
    for scene, holds in ((assembly, True), (changed, False)):
        report = verify_plan(scene_plan(), scene, scene_workcell(), hashes={}, physics=False)
        messages = [finding.message for finding in report.findings if finding.check == "support"]
        assert (messages == []) == holds
    assert "connector 'front-stub' has no floor below 'stub', within 1 mm" in messages
    assert any(message.startswith("part 'stub' tips") for message in messages)
