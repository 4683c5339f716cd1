"""From an assembly to a plan, on assemblies of two and three bars."""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from small_assemblies import deadlock, floating, three_bars, two_bars
from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.formats.serialization import assembly_hash, plan_document, workcell_hash
from takeapart.model.errors import InputError, UnknownNameError
from takeapart.model.plan import Plan
from takeapart.planning import (
    SEARCHES,
    Infeasible,
    PlanningOptions,
    build_problem,
    explain,
    plan,
    plan_of,
    search,
)
from takeapart.removal.result import Effort, Removal
from takeapart.search.exact import ExactOptions
from takeapart.search.mcts import MctsOptions
from takeapart.search.result import Budget
from verification_scene import scene_workcell

OPTIONS = PlanningOptions(budget=Budget(episodes=20))


@functools.cache
def planned(name: str = "exact") -> Plan:
    made = plan(three_bars(), scene_workcell(), replace(OPTIONS, search=name))
    assert isinstance(made, Plan), made
    return made


def straight_line_bounds() -> float:
    """Written out anew: from the best point of every bar 5 cm up, then straight to the goal at (-0.05, -0.30, 0.42).
    All bars are 2 cm high and stand at a height of 0.19 m, so the best points are at 0.20 m, and at 0.25 m lifted."""
    beam = math.dist([0.09, -0.1495, 0.25], [-0.05, -0.30, 0.42])  # y from -0.1495 to 0.1495, x from 0.09 to 0.11
    stub = math.dist([-0.0395, -0.01, 0.25], [-0.05, -0.30, 0.42])  # x from -0.0395 to 0.0895, y from -0.01 to 0.01
    rear = math.dist([0.1105, -0.01, 0.25], [-0.05, -0.30, 0.42])  # x from 0.1105 to 0.2395
    return 3 * 0.05 + beam + stub + rear


@pytest.mark.parametrize("name", SEARCHES)
def test_every_search_gives_a_whole_plan(name: str) -> None:
    made = planned(name)
    assert sorted(step.part for step in made.steps) == ["beam", "rear", "stub"]
    assert made.steps[-1].part == "beam"  # the stubs would fall without it
    for step in made.steps:
        moved = np.linalg.norm(np.diff(step.tool_path[:, :3], axis=0), axis=1).sum()
        assert step.length == pytest.approx(moved, abs=1e-9)
        assert step.tool_path[-1, :3] == pytest.approx(scene_workcell().goal, abs=1e-6)
    assert made.total_length == pytest.approx(sum(step.length for step in made.steps))
    assert made.straight_line_bound <= made.total_length
    assert made.search["name"] == name


def test_what_a_plan_states_about_itself() -> None:
    made = planned()
    assert made.straight_line_bound == pytest.approx(straight_line_bounds(), abs=1e-9)
    assert made.hashes == {"assembly": assembly_hash(three_bars()), "workcell": workcell_hash(scene_workcell())}
    assert (made.assembly, made.workcell, made.direction) == ("three-bars", "scene", "disassembly")
    assert made.counts["removal_queries"] >= 3
    assert "takeapart" in made.versions


def test_the_plan_holds_before_the_independent_verification() -> None:
    verification = pytest.importorskip("takeapart.verification")
    report = verification.verify_plan(planned(), three_bars(), scene_workcell())
    assert [verification.format_finding(finding) for finding in report.findings] == []
    assert report.steps == 3


def test_exact_search_is_as_short_as_the_best_of_all_orders() -> None:
    assembly = three_bars()
    problem = build_problem(assembly, scene_workcell(), OPTIONS)
    result = search(problem, OPTIONS)
    lengths = []
    for order in itertools.permutations(["stub", "rear", "beam"]):
        state, total = assembly.root, 0.0
        for name in order:
            answer = problem.remove(state, assembly.index[name], Effort())
            total += answer.length if isinstance(answer, Removal) else math.inf
            state &= ~(1 << assembly.index[name])
        lengths.append(total)
    assert result.length == pytest.approx(min(lengths), abs=1e-9)
    assert result.sequence_bound == pytest.approx(result.length, abs=1e-9)
    assert sum(math.isfinite(length) for length in lengths) == 2


@pytest.mark.parametrize("name", ["exact", "mcts"])
def test_the_same_seed_gives_the_same_plan(name: str) -> None:
    again = plan(three_bars(), scene_workcell(), replace(OPTIONS, search=name))
    assert isinstance(again, Plan)
    documents = [plan_document(replace(made, seconds=0.0)) for made in (planned(name), again)]
    assert documents[0] == documents[1]


def test_threads_do_not_change_the_plan() -> None:
    options = replace(OPTIONS, search_options=ExactOptions(workers=2))
    again = plan(three_bars(), scene_workcell(), options)
    assert isinstance(again, Plan)
    assert plan_document(replace(again, seconds=0.0)) == plan_document(replace(planned(), seconds=0.0))


@pytest.mark.parametrize("name", SEARCHES)
def test_no_feasible_order(name: str) -> None:
    made = plan(deadlock(), scene_workcell(), replace(OPTIONS, search=name))
    assert isinstance(made, Infeasible)
    assert made.proved
    assert made.remaining == ("beam", "stub")
    assert {(each.part, each.stage, each.reason.blamed) for each in made.hindrances} == {
        ("beam", "stability", ("stub",)),
        ("stub", "lift", ("beam",)),
    }
    # The roof begins 11 mm above the middle of the stub, whose upper side is 10 mm above it.
    lifted = "stub: only straight up is tried: lifted by 50 mm it hits beam after 1 mm (stage lift)"
    assert (
        str(made)
        == f"no feasible order; with 2 parts left: {lifted}; beam: without it stub would fall (stage stability)"
    )
    assert "\n" not in str(made)


def test_a_goal_out_of_reach_is_refused_before_planning() -> None:
    workcell = replace(scene_workcell(), goal=np.array([3.0, 0.0, 0.4]))
    with pytest.raises(
        InputError, match=r"^scene: goal: \(3, 0, 0.4\) m is out of reach: 3\.45\d m from the arm's shoulder"
    ):
        plan(two_bars(), workcell, OPTIONS)


def test_a_part_out_of_reach() -> None:
    """With all others fixed, there is nobody to blame."""
    small = two_bars()
    alone = replace(small, parts=tuple(replace(part, fixed=part.name != "stub") for part in small.parts))
    base = scene_workcell().T_world_base.copy()
    base[0, 3] = -3.0
    goal = scene_workcell().goal + (base - scene_workcell().T_world_base)[:3, 3]
    made = plan(alone, replace(scene_workcell(), T_world_base=base, goal=goal), OPTIONS)
    assert isinstance(made, Infeasible)
    (hindrance,) = made.hindrances
    assert (hindrance.part, hindrance.stage, hindrance.reason.cause) == ("stub", "ik", "reach")
    assert hindrance.reason.blamed == ()


def test_a_budget_that_ran_out_proves_nothing() -> None:
    made = plan(three_bars(), scene_workcell(), replace(OPTIONS, search="random", budget=Budget(queries=1)))
    assert isinstance(made, Infeasible)
    assert not made.proved
    assert str(made).startswith("no feasible order found within the budget; with 2 parts left: beam: ")
    assert str(made).endswith("; not asked within the budget: rear; there may be an order")
    assert made.deepest is not None
    assert not made.deepest.is_deepest


def test_explain_names_what_hinders_each_part() -> None:
    assembly = three_bars()
    problem = build_problem(assembly, scene_workcell(), OPTIONS)

    def told(names: list[str]) -> list[str]:
        return [str(hindrance) for hindrance in explain(problem, assembly.state_of(names))]

    assert told(["stub", "rear", "beam"]) == ["beam: without it stub and rear would fall (stage stability)"]
    assert told(["beam", "rear"]) == ["beam: without it rear would fall (stage stability)"]
    assert told(["beam"]) == []


def test_the_best_plan_so_far_survives_an_interrupt() -> None:
    problem = build_problem(two_bars(), scene_workcell(), OPTIONS)
    options = replace(OPTIONS, search="mcts", search_options=MctsOptions(attempts=1, memory="paper"))
    planner_plan, calls = problem.planner.plan, itertools.count(1)

    def interrupted_plan(*args: object, **keywords: object) -> object:
        if next(calls) == 3:  # one expansion and one simulation have found a sequence
            raise KeyboardInterrupt
        return planner_plan(*args, **keywords)  # type: ignore[arg-type]

    problem.planner.plan = interrupted_plan  # type: ignore[method-assign, assignment]
    made = plan_of(problem, search(problem, options), options, 0.0)
    assert isinstance(made, Plan)
    assert [step.part for step in made.steps] == ["stub", "beam"]
    assert made.search["interrupted"] is True


def test_misuse_is_told() -> None:
    with pytest.raises(UnknownNameError, match="unknown search 'best'; valid: beam, best-first, exact"):
        PlanningOptions(search="best")
    with pytest.raises(InputError, match="part 'stub' drops"):
        plan(floating(), scene_workcell())


@pytest.mark.slow
@pytest.mark.parametrize("name", [f"single/{k:02d}" for k in range(1, 15)] + [f"double/{k:02d}" for k in range(1, 8)])
def test_every_shipped_assembly_can_be_taken_apart(name: str) -> None:
    """A planner that loses a few ways to hold a part has lost whole assemblies: the greedy search notices at once."""
    assembly = load_assembly(data_path(f"{name}.json"))
    problem = build_problem(assembly, load_workcell("panda"))
    found = search(problem, PlanningOptions(search="greedy"))
    assert len(found.removals) == assembly.root.bit_count(), found.refusals
