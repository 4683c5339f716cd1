"""The decision process: what is counted, what is kept, and what an answer may depend on."""

from __future__ import annotations

import math

import numpy as np
import pytest

from conftest import Edge, random_states
from takeapart.model.assembly import Assembly, Part, members
from takeapart.model.geometry import Box, pose
from takeapart.problem import AssemblyProblem
from takeapart.removal.bounds import EdgeBounds
from takeapart.removal.planner import RemovalPlanner
from takeapart.removal.result import Blocked, Effort, Removal
from takeapart.robot.model import RobotModel
from takeapart.stability import ConnectorStability, Stability
from takeapart.workcell import Workcell


def new_problem(planner: RemovalPlanner, seed: int = 0) -> AssemblyProblem:
    return AssemblyProblem(planner, ConnectorStability(planner.assembly), seed)


def removable(planner: RemovalPlanner, edges: list[Edge]) -> tuple[Edge, Removal]:
    """An edge on which a removal is found, with the removal of a problem that knows nothing."""
    for edge in edges:
        answer = new_problem(planner).remove(edge.state, edge.part, Effort())
        if isinstance(answer, Removal):
            return edge, answer
    raise AssertionError("nothing can be removed")


def spent(problem: AssemblyProblem) -> tuple[int, int]:
    return problem.counts.removal_queries, problem.counts.motion_plans


def same(a: Removal | Blocked, b: Removal | Blocked) -> bool:
    if isinstance(a, Removal) and isinstance(b, Removal):
        return a.joint_path.tobytes() == b.joint_path.tobytes() and (a.length, a.blockers) == (b.length, b.blockers)
    return a == b


def test_candidates_are_what_gravity_and_lifting_let_go(problem: AssemblyProblem) -> None:
    assembly, planner = problem.assembly, problem.planner
    before = spent(problem)
    free = hindered = 0
    for state in random_states(assembly, 500, np.random.default_rng(1)):
        expected = []
        for part in members(state):
            lift = next(iter(planner.freedom(part)), None)
            liftable = lift is not None and not any(state >> other & 1 for other in members(lift))
            assert isinstance(problem.stability, Stability)
            carries = [p for p in members(state) if p != part and problem.stability.needs(p) >> part & 1]
            if liftable and not carries:
                expected.append(part)
        assert list(problem.candidates(state)) == expected
        for part in members(state):
            hindrance = problem.hindrance(state, part)
            assert (hindrance is None) == (part in expected)
            if hindrance is not None:
                hindered += 1
                assert hindrance.stage in ("stability", "lift")
                assert not hindrance.blamed & ~state
                # Without those to blame it is no longer that which keeps it.
                later = problem.hindrance(state & ~hindrance.blamed, part)
                assert hindrance.blamed == 0 or later is None or later.stage != hindrance.stage
            else:
                free += 1
    assert free > 300 and hindered > 300
    assert spent(problem) == before, "candidates cost nothing"


def test_hindered_parts_are_refused_without_a_query(problem: AssemblyProblem) -> None:
    before = spent(problem)
    refused = 0
    for part in set(members(problem.root)) - set(problem.candidates(problem.root)):
        answer = problem.remove(problem.root, part, Effort())
        assert isinstance(answer, Blocked) and answer == problem.hindrance(problem.root, part)
        refused += 1
    assert refused > 5
    assert spent(problem) == before


def test_a_query_is_counted_and_closes_its_edge(planner: RemovalPlanner, edges: list[Edge]) -> None:
    edge, _ = removable(planner, edges)
    problem = new_problem(planner)
    queries, plans = spent(problem)
    assert problem.upper(edge.state, edge.part) == math.inf
    assert problem.lower(edge.state, edge.part) == planner.candidate_bound(edge.part)
    removal = problem.remove(edge.state, edge.part, Effort())
    assert isinstance(removal, Removal)
    assert problem.counts.removal_queries == queries + 1
    assert problem.counts.motion_plans > plans
    assert problem.upper(edge.state, edge.part) == problem.lower(edge.state, edge.part) == removal.length
    after = spent(problem)
    again = problem.remove(edge.state, edge.part, Effort())
    assert again is removal
    assert spent(problem) == after, "a closed edge costs nothing"
    shorter = problem.remove(edge.state, edge.part, Effort(shorter_than=removal.length))
    assert isinstance(shorter, Blocked) and spent(problem) == after


def test_a_removal_serves_every_larger_state_that_its_mask_allows(planner: RemovalPlanner, edges: list[Edge]) -> None:
    edge, _ = removable(planner, edges)
    problem = new_problem(planner)
    alone = 1 << edge.part
    removal = problem.remove(alone, edge.part, Effort())
    assert isinstance(removal, Removal)
    after = spent(problem)
    served = 0
    for state in random_states(problem.assembly, 300, np.random.default_rng(2)):
        state |= alone
        allowed = not removal.blockers & state & ~alone
        assert (problem.upper(state, edge.part) == removal.length) == allowed
        assert problem.lower(state, edge.part) >= removal.length - 1e-12
        if allowed and problem.hindrance(state, edge.part) is None:
            assert problem.remove(state, edge.part, Effort()) is removal
            served += 1
    assert served > 5
    assert spent(problem) == after


def test_more_attempts_than_before_are_planned(planner: RemovalPlanner, edges: list[Edge]) -> None:
    edge, first = removable(planner, edges)
    problem = new_problem(planner)
    problem.remove(edge.state, edge.part, Effort())
    queries, _ = spent(problem)
    answer = problem.remove(edge.state, edge.part, Effort(attempts=2))
    assert isinstance(answer, Removal) and answer.length <= first.length
    assert problem.counts.removal_queries == queries + 1
    problem.remove(edge.state, edge.part, Effort(attempts=2))
    problem.remove(edge.state, edge.part, Effort(attempts=1))
    assert problem.counts.removal_queries == queries + 1


def test_fresh_removals_are_planned_anew_and_not_kept(planner: RemovalPlanner, edges: list[Edge]) -> None:
    edge, first = removable(planner, edges)
    problem = new_problem(planner)
    queries, _ = spent(problem)
    answers = [problem.remove(edge.state, edge.part, Effort(fresh=True)) for _ in range(3)]
    assert problem.counts.removal_queries == queries + 3
    assert same(answers[0], first), "the first question has the first random numbers, kept or not"
    assert problem.upper(edge.state, edge.part) == math.inf
    assert not problem.edge_bounds.removals(edge.part)
    assert not problem.edge_bounds.closed_edges(edge.part)


def test_answers_depend_on_the_seed_and_not_on_the_order_of_asking(planner: RemovalPlanner, edges: list[Edge]) -> None:
    chosen = edges[:10]
    forwards, backwards = new_problem(planner), new_problem(planner)
    fresh = Effort(fresh=True)
    first = [forwards.remove(edge.state, edge.part, fresh) for edge in chosen]
    last = [backwards.remove(edge.state, edge.part, fresh) for edge in reversed(chosen)][::-1]
    assert all(same(a, b) for a, b in zip(first, last, strict=True))
    second = [forwards.remove(edge.state, edge.part, fresh) for edge in chosen]
    other = new_problem(planner, seed=1)
    reseeded = [other.remove(edge.state, edge.part, fresh) for edge in chosen]
    assert not all(same(a, b) for a, b in zip(first, second, strict=True)), "asked again, other random numbers"
    assert not all(same(a, b) for a, b in zip(first, reseeded, strict=True))


def test_a_library_answers_before_the_planner(planner: RemovalPlanner, edges: list[Edge]) -> None:
    edge, _ = removable(planner, edges)
    first = new_problem(planner)
    removal = first.remove(edge.state, edge.part, Effort())
    second = AssemblyProblem(planner, ConnectorStability(planner.assembly), library=first.edge_bounds)
    before = spent(second)
    assert second.remove(edge.state, edge.part, Effort()) is removal
    assert spent(second) == before


def test_an_empty_library_that_is_given_is_used(planner: RemovalPlanner, edges: list[Edge]) -> None:
    edge, _ = removable(planner, edges)
    library = EdgeBounds([0.0] * len(planner.assembly.parts))
    problem = AssemblyProblem(planner, ConnectorStability(planner.assembly), library=library)
    removal = problem.remove(edge.state, edge.part, Effort())
    assert library.removals(edge.part) == (removal,)


def test_static_bounds_are_the_straight_lines_of_grasp_candidates(problem: AssemblyProblem) -> None:
    cell = problem.planner.workcell
    for part in members(problem.root):
        body = problem.assembly.parts[part]
        box = body.shape.bounding_box()
        axis = int(np.argmax(box.half_extents))
        reach = float(box.half_extents[axis]) - 0.03
        offsets = np.arange(-reach, reach + 1e-6, 0.02)
        centers = [(body.T_world_part @ np.append(np.eye(3)[axis] * offset, 1))[:3] for offset in offsets]
        expected = min(0.05 + math.dist(center + [0, 0, 0.05], cell.goal) for center in centers)
        assert problem.edge_bounds.static(part) == pytest.approx(expected, abs=1e-9)


def many_blocks(count: int) -> Assembly:
    """Blocks in rows, none near another."""
    places = [(0.3 + 0.06 * (k % 10), -0.2 + 0.06 * (k // 10), 0.01) for k in range(count)]
    return Assembly("blocks", tuple(Part(f"b{k}", Box((0.02,) * 3), pose(at), 0.1) for k, at in enumerate(places)))


def test_random_numbers_of_a_query_depend_on_every_part_that_stands_there(
    workcell: Workcell, robot: RobotModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More parts than fit into one word, or two: any of them makes a difference, and so do part, turn and seed."""
    assembly, drawn = many_blocks(70), []

    def plan(part: int, state: int, *, rng: np.random.Generator, **_: object) -> Blocked:
        drawn.append(float(rng.random()))
        return Blocked(part, "path", 0)

    planner = RemovalPlanner(assembly, workcell, robot=robot)
    monkeypatch.setattr(planner, "plan", plan)
    root = assembly.root
    for problem in (new_problem(planner), new_problem(planner, seed=1)):
        problem.remove(root, 0, Effort())  # first: what cannot leave a smaller state is not asked for in a larger one
        for gone in range(1, 70):
            problem.remove(root & ~(1 << gone), 0, Effort())
        problem.remove(root, 0, Effort(fresh=True))
        problem.remove(root, 1, Effort())
    assert len(drawn) == 2 * 72
    assert len(set(drawn)) == len(drawn)


def test_a_refusal_is_the_planners_unless_only_something_shorter_was_wanted(
    planner: RemovalPlanner, edges: list[Edge], monkeypatch: pytest.MonkeyPatch
) -> None:
    edge, removal = removable(planner, edges)
    refused = Blocked(edge.part, "grasp", edge.state & ~(1 << edge.part))
    problem = new_problem(planner)
    monkeypatch.setattr(planner, "plan", lambda *_, **__: refused)
    assert problem.remove(edge.state, edge.part, Effort()) == refused
    problem = new_problem(planner)
    monkeypatch.setattr(planner, "plan", lambda *_, **__: removal)
    assert problem.remove(edge.state, edge.part, Effort()) is removal
    answer = problem.remove(edge.state, edge.part, Effort(shorter_than=removal.length / 2))
    assert answer == Blocked(edge.part, "path", 0)
