"""What carries a part holds it, and what the gripper takes it can carry: refused by the planner, and by the judge."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from support_scenes import box, collar
from takeapart.formats.files import data_path, load_assembly
from takeapart.formats.schemas import AssemblyModel, validated
from takeapart.formats.serialization import assembly_document
from takeapart.generate.profiles import ProfileOptions, Rejected, candidate_rng, generate_candidate
from takeapart.model.assembly import Assembly, Connector, Part
from takeapart.model.errors import InputError
from takeapart.model.geometry import Box, OrientedBox, pose
from takeapart.planning import Infeasible, PlanningOptions, plan
from takeapart.removal.grasps import ungraspable
from takeapart.removal.planner import RemovalPlanner
from takeapart.stability import require_support, unsupported
from takeapart.verification.checks import check_payload
from takeapart.verification.replay import Replay
from takeapart.verification.report import VerificationOptions
from takeapart.verification.support import Support, check_support
from takeapart.workcell import Obstacle, Workcell
from verification_scene import scene_assembly, scene_plan, scene_workcell

NOT_ABOVE = r"part 'bar' tips: its weight lies"
LOW, BAR = 0.01, 0.02  # m, half the base's height; thickness of the bar


def shelf(*walls: tuple[OrientedBox, ...], height: float = 0.0, mass: float = 0.1) -> Assembly:
    """A base of 0.4 m, and a bar of the same length over it; each tuple of walls is a U on the base."""
    base = Part("base", Box((0.4, 0.06, 2 * LOW)), pose(), 1.0, fixed=True)
    bar = Part("bar", Box((0.4, BAR, BAR)), pose((0, 0, LOW + 0.002 + BAR / 2 + height)), mass)
    connectors = tuple(Connector(f"u{i}", "U", "base", "bar", found) for i, found in enumerate(walls))
    return Assembly("shelf", (base, bar), connectors)


def u_at(x: float, floor: bool = True) -> tuple[OrientedBox, ...]:
    """A U of 2 cm on the base, its floor 2 mm thick right below the bar."""
    sides = tuple(box(x, side * 0.0115, LOW + 0.01, (0.02, 0.002, 0.02)) for side in (-1, 1))
    return (*sides, box(x, 0, LOW + 0.001, (0.02, 0.025, 0.002))) if floor else sides


def judged(assembly: Assembly) -> list[str]:
    """What the judge says of the assembly as it stands, by its own rules of contact and balance."""
    return [finding.message for finding in check_support(Support(assembly), [assembly.root], [])]


def refused_by_both(assembly: Assembly, planner: str, judge: str) -> None:
    with pytest.raises(InputError, match=planner):
        require_support(assembly)
    messages = judged(assembly)
    assert any(re.search(judge, message) for message in messages), messages


def accepted_by_both(assembly: Assembly) -> None:
    require_support(assembly)
    assert judged(assembly) == []


def test_a_bar_in_two_us_stands_and_in_one_it_tips() -> None:
    accepted_by_both(shelf(u_at(-0.15), u_at(0.15)))
    accepted_by_both(shelf(u_at(0.0)))
    tips = r"part 'bar' would tip: its centre of mass lies 140\.0 mm beyond"
    refused_by_both(shelf(u_at(-0.15)), tips, NOT_ABOVE)
    refused_by_both(shelf(u_at(-0.15), u_at(-0.1)), r"lies 90\.0 mm beyond", NOT_ABOVE)
    assert unsupported(shelf(u_at(-0.15))) == ()  # it has a holder, which alone was asked before


def test_a_holder_touches_what_it_holds_and_what_it_stands_on() -> None:
    far = (box(0.3, 0.2, 0.0, (0.01, 0.01, 0.01)),)
    with pytest.raises(InputError, match=r"connectors\[0\] \(u0\): is 190\.4 mm from its host 'base'; .* within 1 mm"):
        require_support(shelf(far, height=0.28))
    with pytest.raises(InputError, match=r"is 280\.0 mm from its guest 'bar'"):
        require_support(shelf((u_at(0.0)[2],), height=0.28))
    require_support(shelf(u_at(0.0), height=0.0009))
    with pytest.raises(InputError, match=r"no wall is right below 'bar'"):
        require_support(shelf(u_at(0.0, floor=False)))
    with pytest.raises(InputError, match=r"no wall is right below 'bar'"):
        require_support(shelf(u_at(0.0), height=0.0019))


@pytest.mark.parametrize("name", ["single/13", "double/05", "examples/rack"])
def test_shipped_assemblies_are_carried(name: str) -> None:
    accepted_by_both(load_assembly(data_path(f"{name}.json")))


@pytest.mark.slow
def test_all_shipped_and_some_fresh_assemblies_are_carried() -> None:
    for file in (*data_path("single").glob("*.json"), *data_path("double").glob("*.json")):
        accepted_by_both(load_assembly(file))
    for options in (ProfileOptions(), ProfileOptions(layers=2, back=3, front=3)):
        for seed in range(400, 408):
            drawn = generate_candidate(options, candidate_rng(seed, 0), "fresh")
            if not isinstance(drawn, Rejected):
                accepted_by_both(drawn)


def heavy(name: str, mass: float) -> Assembly:
    found = load_assembly(data_path("examples/rack.json"))
    return replace(found, parts=tuple(replace(p, mass=mass) if p.name == name else p for p in found.parts))


@pytest.fixture(scope="module")
def removable() -> str:
    return next(part.name for part in load_assembly(data_path("examples/rack.json")).parts if not part.fixed)


def test_a_part_beyond_the_payload_is_refused_with_both_weights(removable: str, workcell: Workcell) -> None:
    made = plan(heavy(removable, 25.0), workcell, PlanningOptions(search="greedy"))
    assert isinstance(made, Infeasible)
    refused = {hindrance.part: hindrance for hindrance in made.hindrances}[removable]
    assert refused.stage == "grasp"
    assert str(refused) == f"{removable}: weighs 25 kg, 22 kg more than the payload of 3 kg (stage grasp)"


@pytest.mark.parametrize(
    ("mass", "changes", "cause"),
    [
        (2.99, {}, None),
        (3.0, {}, None),
        (3.01, {}, "weight"),
        (1.0, {"gripping_force": 9.9}, None),  # 2 * 0.5 * 9.9 N = 9.9 N hold 9.81 N
        (1.0, {"gripping_force": 9.7}, "slip"),
        (1.0, {"friction": 0.01}, "slip"),
    ],
)
def test_weight_against_payload_and_friction(
    workcell: Workcell, mass: float, changes: dict[str, float], cause: str | None
) -> None:
    part, cell = Part("bar", Box((0.2, 0.02, 0.02)), pose(), mass), replace(workcell, **changes)  # type: ignore[arg-type]
    assert ungraspable(part, cell) == cause
    judged = check_payload(scene_plan().steps[0], 0, part, cell)
    assert bool(judged) == (cause is not None)
    assert all(finding.check == "payload" for finding in judged)


def test_a_part_wider_than_the_fingers_open_is_refused(workcell: Workcell) -> None:
    part = Part("block", Box((0.3, 0.081, 0.09)), pose(), 1.0)
    assert ungraspable(part, workcell) == "width"
    assert ungraspable(replace(part, shape=Box((0.3, 0.079, 0.09))), workcell) is None


def test_the_planner_refuses_a_home_beyond_the_limits(workcell: Workcell) -> None:
    home = workcell.home.copy()
    home[0] = 9.0
    with pytest.raises(InputError, match=r"panda: robot.home: joint 'panda_joint1' stands at 9 rad; -2\.\d+ to 2\.\d+"):
        RemovalPlanner(scene_assembly(), replace(workcell, home=home))


def test_the_judge_refuses_a_home_beyond_the_limits_or_in_something() -> None:
    cell, options = scene_workcell(), VerificationOptions()
    assert Replay(scene_assembly(), cell, options).check_placement() == []
    for value in (9.0, -9.0):
        home = cell.home.copy()
        home[0] = value
        found = Replay(scene_assembly(), replace(cell, home=home), options).check_placement()
        messages = [f.message for f in found if f.check == "home"]
        assert messages[0].startswith(f"joint 1 rests at {value:.4g} rad; ")
    scene = Replay(scene_assembly(), cell, options).scene
    scene.place(cell.home)
    hand = scene.data.body("panda_hand").xpos.copy()
    block = Obstacle("block", OrientedBox(pose(hand), np.full(3, 0.03)))
    found = Replay(scene_assembly(), replace(cell, environment=(*cell.environment, block)), options).check_placement()
    assert any("panda_hand" in f.message and "environment/block" in f.message and f.depth > 0.01 for f in found)


def test_sizes_below_a_tenth_of_a_millimetre_are_refused() -> None:
    document = assembly_document(load_assembly(data_path("examples/rack.json")))
    document["parts"][0]["shape"]["size"][1] = 1e-4
    validated(AssemblyModel, document, "rack.json")
    document["parts"][0]["shape"]["size"][1] = 0.99e-4
    with pytest.raises(InputError, match=r"rack.json: parts\[0\].shape.size\[1\]: .*0\.0001"):
        validated(AssemblyModel, document, "rack.json")


def at(name: str, size: tuple[float, float, float], centre: tuple[float, float, float], fixed: bool = False) -> Part:
    return Part(name, Box(size), pose(centre), 0.1, fixed)


def test_only_floors_carry_not_cheeks() -> None:
    """A floor at one end, and cheeks along the whole bar: it would fall all the same."""
    cheeks = tuple(box(0, side * 0.0115, LOW + 0.01, (0.38, 0.002, 0.02)) for side in (-1, 1))
    floor = box(-0.15, 0, LOW + 0.001, (0.02, 0.021, 0.002))
    tips = r"part 'bar' would tip: its centre of mass lies 140\.0 mm beyond"
    refused_by_both(shelf((*cheeks, floor)), tips, NOT_ABOVE)


@pytest.mark.parametrize(("outside", "accepted"), [(-2e-4, True), (0.0, False), (9e-4, False)])
def test_a_centre_of_mass_lies_inside_of_what_carries_it(outside: float, accepted: bool) -> None:
    support = shelf(u_at(-0.01 - outside))
    if accepted:
        accepted_by_both(support)
    else:
        with pytest.raises(InputError, match=r"lies 0\.9 mm beyond" if outside else r"lies on the edge of what"):
            require_support(support)
        assert bool(judged(support)) == (outside > 1e-4)


@pytest.mark.parametrize(("above", "accepted"), [(0.0, True), (9e-4, True), (2e-3, False), (0.015, False)])
def test_a_post_stands_on_what_is_below_it(above: float, accepted: bool) -> None:
    base = at("base", (0.4, 0.06, 2 * LOW), (0, 0, 0), fixed=True)
    post = at("post", (0.02, 0.02, 0.2), (0, 0, LOW + 0.1 + above))
    stand = Assembly("stand", (base, post), (Connector("o", "O", "base", "post", collar(0.0, LOW, LOW + 0.02)),))
    if accepted:
        accepted_by_both(stand)
    else:
        hangs = r"part 'post' hangs: neither 'base' nor a wall .* right below"
        refused_by_both(stand, hangs, "nothing carries 100 % of the weight of part 'post'")


def test_a_bar_between_cheeks_is_not_carried() -> None:
    base = at("base", (0.4, 0.06, 2 * LOW), (0, 0, 0), fixed=True)
    bar = at("bar", (0.4, BAR, BAR), (0, 0, LOW + 0.05))
    cheeks = tuple(box(0, side * 0.0115, LOW + 0.03, (0.02, 0.002, 0.06)) for side in (-1, 1))
    held = Assembly("held", (base, bar), (Connector("o", "O", "base", "bar", cheeks),))
    refused_by_both(held, r"part 'bar' hangs", "nothing carries 100 % of the weight of part 'bar'")


@pytest.mark.parametrize(("above", "kind", "floats"), [(5e-4, "O", False), (0.01, "O", True), (5e-4, "U", True)])
def test_a_lintel_lies_on_the_posts_that_its_own_connectors_hold(
    above: float, kind: Literal["U", "O"], floats: bool
) -> None:
    """Two posts in the base, over them a bar with an O at each head; ten millimetres of air are no support."""
    base = at("base", (0.6, 0.06, 2 * LOW), (0, 0, 0), fixed=True)
    posts = tuple(at(f"post{i}", (0.02, 0.02, 0.2), (x, 0, LOW + 0.1)) for i, x in enumerate((-0.2, 0.2)))
    lintel = at("lintel", (0.5, 0.02, 0.02), (0, 0, LOW + 0.21 + above))
    feet = [
        Connector(f"foot{i}", "O", "base", f"post{i}", collar(x, LOW, LOW + 0.02)) for i, x in enumerate((-0.2, 0.2))
    ]
    heads = []
    for i, x in enumerate((-0.2, 0.2)):
        walls = tuple(wall.moved(pose((0, 0, -(LOW + 0.21 + above)))) for wall in collar(x, LOW + 0.18, LOW + 0.2))
        heads.append(Connector(f"head{i}", kind, "lintel", f"post{i}", walls))
    gate = Assembly("gate", (base, *posts, lintel), (*feet, *heads))
    assert unsupported(gate) == (("lintel",) if floats else ())
    if not floats:
        accepted_by_both(gate)
        parts = tuple(part for part in gate.parts if part.name != "post1")
        one = replace(gate, parts=parts, connectors=tuple(c for c in gate.connectors if c.guest != "post1"))
        tips = r"part 'lintel' would tip: its centre of mass lies 190\.0 mm beyond"
        refused_by_both(one, tips, "part 'lintel' tips")
    else:
        assert kind == "U" or "nothing carries 100 % of the weight of part 'lintel'" in judged(gate)
