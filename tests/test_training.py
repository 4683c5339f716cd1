"""Learning: targets against brute force, both ways of learning to the known optimum, and trainings that are killed."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import takeapart
from guide_cases import blocks, record_everything, true_value
from synthetic import SyntheticProblem, problem_with_dead_ends, random_problem
from takeapart.guide.architecture import Architecture
from takeapart.guide.dataset import GOAL, StateTable, state_table
from takeapart.guide.experience import Experience, ExperienceWriter, read_experience
from takeapart.guide.network import QNetwork
from takeapart.guide.policy import load_guide
from takeapart.guide.teachers import DoubleQTeacher, evaluate, interval_targets
from takeapart.guide.training import TrainingOptions, TrainingProgress, checkpoint_path, log_path, train
from takeapart.model.assembly import members
from takeapart.model.errors import InputError, UnknownNameError
from takeapart.search.exact import ExactOptions, exact
from takeapart.search.result import Budget

SMALL = TrainingOptions(
    architecture=Architecture(2, 24), steps=600, batch=16, evaluate_every=100, patience=100, learning_rate=5e-3
)


def recorded(folder: Path, problem: SyntheticProblem, seed: int = 0) -> Experience:
    record_everything(problem, blocks(problem.root.bit_count(), seed), folder)
    return read_experience(folder)


def values_in(table: StateTable, values: np.ndarray) -> dict[int, dict[int, float]]:
    """Per state, the values of its parts that are numbers; only for a table of one assembly."""
    found = {}
    for first, end in zip(table.first, table.first[1:], strict=False):
        parts = table.nodes[first:end]
        row = {int(part): float(value) for part, value in zip(parts, values[first:end], strict=True)}
        found[sum(1 << part for part in row)] = {part: value for part, value in row.items() if np.isfinite(value)}
    return found


@pytest.mark.parametrize("seed", range(5))
def test_backups_over_everything_are_the_optimal_values(tmp_path: Path, seed: int) -> None:
    problem = random_problem(6, seed)
    table = state_table(recorded(tmp_path, problem), dead_end=2.0)
    found = values_in(table, table.reached)
    for state, removable in problem.reachable().items():
        if state:
            expected = {part: true_value(problem, state, part) for part in removable}
            assert found[state] == pytest.approx(expected, abs=1e-5)


def test_dead_ends_have_their_price_and_the_goal_has_none(tmp_path: Path) -> None:
    problem = problem_with_dead_ends(6, 1)
    table = state_table(recorded(tmp_path, problem), dead_end=100.0)
    found = values_in(table, table.reached)
    reachable = problem.reachable()
    dead = {state for state, removable in reachable.items() if state and not removable}
    assert dead
    for state, removable in reachable.items():
        for part in removable:
            following = state & ~(1 << part)
            if following in dead:
                expected = -problem.true_cost(state, part) - 100.0 * following.bit_count()
                assert found[state][part] == pytest.approx(expected, abs=1e-3)
    assert max(found[problem.root].values()) == pytest.approx(-problem.optimum()[0], abs=1e-4)


def test_the_best_of_several_rewards_counts_and_what_leads_nowhere_has_no_value(tmp_path: Path) -> None:
    assembly = blocks(3)
    with ExperienceWriter(tmp_path, assembly, seed=0, search="mcts") as writer:
        for reward in (-0.9, -0.6, -0.8):
            writer.observe(0b111, 0, reward, 0b110, [1, 2])
        writer.observe(0b111, 1, -0.5, 0b101, [0])
        writer.observe(0b110, 1, -0.4, 0b100, [2])
        writer.observe(0b100, 2, -0.3, 0, [])
    table = state_table(read_experience(tmp_path), dead_end=2.0)
    found = values_in(table, table.reached)
    assert found[0b111] == pytest.approx({0: -1.3})  # nobody has seen how it goes on from 0b101
    assert found[0b110] == pytest.approx({1: -0.7})
    assert found[0b101] == {}
    assert int((table.step_next == GOAL).sum()) == 1


@pytest.mark.parametrize("seed", range(4))
def test_what_exact_search_tells_holds_the_optimal_values(tmp_path: Path, seed: int) -> None:
    problem = random_problem(9, seed)
    assembly = blocks(9)
    with ExperienceWriter(tmp_path, assembly, seed=0, search="exact") as writer:
        exact(problem, ExactOptions(), Budget(), observe=writer.observe, observe_settled=writer.observe_settled)
    table = state_table(read_experience(tmp_path), dead_end=2.0)
    low, high = (values_in(table, bounds) for bounds in interval_targets(table, "exact"))
    known = values_in(table, table.known)
    assert max(known[problem.root].values()) == pytest.approx(-problem.optimum()[0], abs=1e-5)
    bounded = 0
    for state in high:
        for part, value in high[state].items():
            truth = true_value(problem, state, part)
            assert low[state].get(part, -np.inf) - 1e-5 <= truth <= value + 1e-5
            bounded += 1
        for part, value in known[state].items():
            assert value == pytest.approx(true_value(problem, state, part), abs=1e-5)
    assert bounded > sum(len(values) for values in known.values()) > 10


@pytest.mark.parametrize("teacher", ["backup", pytest.param("dqn", marks=pytest.mark.slow)])
def test_both_ways_of_learning_find_the_known_optimum(tmp_path: Path, teacher: str) -> None:
    problem = random_problem(5, 3)
    experience = recorded(tmp_path / "seen", problem)
    options = replace(SMALL, teacher=teacher, steps=900 if teacher == "dqn" else 500)  # type: ignore[arg-type]
    trained = train(experience, options, tmp_path / "guide.safetensors")
    assert trained.random_regret > 0.03
    assert trained.regret < 0.2 * trained.random_regret
    guide = load_guide(trained.path, blocks(5))
    state, order = problem.root, []
    while state:
        (values,) = guide([state])
        removable = problem.reachable()[state]
        order.append(max(removable, key=values.__getitem__))
        state &= ~(1 << order[-1])
    assert problem.order_length(order) == pytest.approx(problem.optimum()[0], rel=0.01)
    assert max(guide([problem.root])[0][part] for part in problem.reachable()[problem.root]) == pytest.approx(
        -problem.optimum()[0], abs=0.1
    )


def test_double_q_learning_takes_one_networks_choice_and_the_others_value_of_it(tmp_path: Path) -> None:
    """r + Q_target(s', argmax over the parts that may go of Q(s', a')), state by state."""
    problem = problem_with_dead_ends(6, 2)
    table = state_table(recorded(tmp_path, problem), dead_end=2.0)
    torch.manual_seed(0)
    network, target = QNetwork(Architecture(2, 8)), QNetwork(Architecture(2, 8))
    for each in (network, target):
        for parameter in each.parameters():
            torch.nn.init.normal_(parameter, std=0.7)
    rows = np.arange(len(table.first) - 1)
    teacher = DoubleQTeacher(table, rows, 8, target, dead_end=2.0)
    asked = np.append(rows, GOAL)
    found = teacher.next_values(network, asked)
    differ = dead = 0
    for row, value in zip(asked, found, strict=True):
        if row == GOAL:
            assert value == 0.0
            continue
        allowed = table.allowed[table.first[row] : table.first[row + 1]]
        if not allowed.any():
            assert value == pytest.approx(-2.0 * len(allowed))
            dead += 1
            continue
        mine, others = (
            next(iter(evaluate(each, table, np.array([row]))))[2][0].detach().numpy() for each in (network, target)
        )
        chosen = max(np.flatnonzero(allowed), key=mine.__getitem__)
        assert value == pytest.approx(others[chosen], abs=1e-5)
        differ += abs(others[chosen] - mine[chosen]) > 0.01 and others[chosen] < others[allowed].max() - 0.01
    assert differ > 5 and dead > 0


def test_the_target_network_is_the_network_of_some_steps_ago(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[list[float], list[float]]] = []

    class Watched(DoubleQTeacher):
        def learn(self, network: QNetwork, rng: np.random.Generator) -> float:
            weights = [torch.cat([p.detach().ravel() for p in each.parameters()]) for each in (network, self.target)]
            seen.append((weights[0].tolist(), weights[1].tolist()))
            return super().learn(network, rng)

    monkeypatch.setattr("takeapart.guide.training.DoubleQTeacher", Watched)
    options = replace(SMALL, teacher="dqn", steps=8, evaluate_every=4, target_every=3)
    train(recorded(tmp_path / "seen", random_problem(4, 3)), options, tmp_path / "guide.safetensors")
    assert len(seen) == 8
    for step, (_, target) in enumerate(seen):
        assert target == seen[step - step % 3][0]
    assert seen[1][0] != seen[0][0]


def test_the_exact_teacher_needs_bounds_and_learns_from_them(tmp_path: Path) -> None:
    problem = random_problem(7, 1)
    experience = recorded(tmp_path / "plain", problem)
    with pytest.raises(InputError, match="no removal has a bound"):
        train(experience, replace(SMALL, teacher="exact"), tmp_path / "guide.safetensors")
    with ExperienceWriter(tmp_path / "exact", blocks(7), seed=0, search="exact") as writer:
        exact(problem, ExactOptions(), Budget(), observe_settled=writer.observe_settled)
    trained = train(read_experience(tmp_path / "exact"), replace(SMALL, teacher="exact"), tmp_path / "g.safetensors")
    assert trained.regret < 0.3 * trained.random_regret


def test_early_stopping_keeps_the_best_and_logs_every_evaluation(tmp_path: Path) -> None:
    for seed in range(3):
        record_everything(random_problem(5, seed), blocks(5, seed, f"blocks{seed}"), tmp_path / "seen")
    experience = read_experience(tmp_path / "seen")
    told: list[TrainingProgress] = []
    options = replace(SMALL, held_out=("blocks1",), evaluate_every=20, patience=3, steps=2000)
    trained = train(experience, options, tmp_path / "guide.safetensors", told.append)
    assert trained.held_out == ("blocks1",)
    assert trained.steps == told[-1].step < 2000
    assert trained.steps - trained.best_step == 60
    with log_path(trained.path).open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["step"]) for row in rows] == [progress.step for progress in told]
    best = min(rows, key=lambda row: float(row["regret"]))
    assert float(best["regret"]) == pytest.approx(trained.regret, rel=1e-4)
    assert int(best["step"]) == trained.best_step
    assert not checkpoint_path(trained.path).exists()
    again = train(experience, options, trained.path, told.append)  # finished: nothing is done
    assert again == trained and len(told) == len(rows)
    with pytest.raises(InputError, match="is the guide of another training"):
        train(experience, replace(options, seed=1), trained.path)
    with pytest.raises(UnknownNameError, match="valid: blocks0, blocks1, blocks2"):
        train(experience, replace(options, held_out=("blocks9",)), tmp_path / "other.safetensors")


TRAINING = """
import sys
from dataclasses import replace
from pathlib import Path
from test_training import SMALL
from takeapart.guide.experience import read_experience
from takeapart.guide.training import train

folder, out, teacher = sys.argv[1:]
options = replace(SMALL, teacher=teacher, evaluate_every=10, steps=100, target_every=25)
train(read_experience(Path(folder)), options, Path(out))
"""


@pytest.mark.parametrize(
    ("teacher", "kills_after"), [("backup", (2,)), pytest.param("dqn", (1, 3), marks=pytest.mark.slow)]
)
def test_a_training_that_is_killed_ends_with_the_same_weights(
    tmp_path: Path, teacher: str, kills_after: tuple[int, ...]
) -> None:
    experience = recorded(tmp_path / "seen", random_problem(5, 3))
    options = replace(SMALL, teacher=teacher, evaluate_every=10, steps=100, target_every=25)  # type: ignore[arg-type]
    undisturbed = train(experience, options, tmp_path / "undisturbed.safetensors")
    out = tmp_path / "killed.safetensors"
    root = Path(takeapart.__file__).resolve().parents[1]
    environment = {**os.environ, "PYTHONPATH": f"{root}:{Path(__file__).parent}"}
    command = [sys.executable, "-c", TRAINING, str(tmp_path / "seen"), str(out), teacher]
    kills = 0
    for evaluations in kills_after:
        process = subprocess.Popen(command, env=environment)
        end = time.monotonic() + 120
        while process.poll() is None and time.monotonic() < end:
            if log_path(out).exists() and len(log_path(out).read_text().splitlines()) > evaluations:
                break
            time.sleep(0.002)
        process.send_signal(signal.SIGKILL)
        kills += process.wait() == -signal.SIGKILL
    assert kills >= 1 and not out.exists() and checkpoint_path(out).exists()
    continued = train(experience, options, out)
    assert continued.hash == undisturbed.hash
    assert (continued.best_step, continued.regret) == (undisturbed.best_step, undisturbed.regret)
    assert out.read_bytes() == undisturbed.path.read_bytes()


def test_checkpoints_of_other_trainings_and_broken_ones_are_refused(tmp_path: Path) -> None:
    experience = recorded(tmp_path / "seen", random_problem(4, 3))
    out = tmp_path / "guide.safetensors"
    options = replace(SMALL, steps=40, evaluate_every=20)

    class StopError(Exception):
        pass

    def stop(progress: TrainingProgress) -> None:
        raise StopError

    with pytest.raises(StopError):
        train(experience, options, out, stop)
    with pytest.raises(InputError, match="is the checkpoint of another training"):
        train(experience, replace(options, seed=5), out)
    content = checkpoint_path(out).read_bytes()
    for broken in (content[:1000], content[:-4], b"nonsense" * 40):
        checkpoint_path(out).write_bytes(broken)
        with pytest.raises(InputError) as error:
            train(experience, options, out)
        assert checkpoint_path(out).name in str(error.value) and "\n" not in str(error.value)
    checkpoint_path(out).write_bytes(content)
    assert train(experience, options, out).steps == 40


def test_a_tiny_assembly_is_taken_apart_in_its_best_order(tmp_path: Path) -> None:
    """From recorded MCTS of three bars in a workcell to a guide whose greedy order is the brute-force optimum."""
    import itertools

    from small_assemblies import three_bars
    from takeapart.planning import PlanningOptions, build_problem, search
    from takeapart.removal.result import Effort, Removal
    from verification_scene import scene_workcell

    assembly = three_bars()
    planning = PlanningOptions(search="mcts", budget=Budget(episodes=10))
    problem = build_problem(assembly, scene_workcell(), planning)
    with ExperienceWriter(tmp_path / "seen", assembly, seed=0, search="mcts") as writer:
        search(problem, planning, record=writer)
    options = replace(SMALL, steps=200)
    trained = train(read_experience(tmp_path / "seen"), options, tmp_path / "guide.safetensors")
    guide = load_guide(trained.path, assembly)

    def length(order: tuple[int, ...]) -> float:
        state, total = problem.root, 0.0
        for part in order:
            answer = problem.remove(state, part, Effort()) if part in problem.candidates(state) else None
            if not isinstance(answer, Removal):
                return np.inf
            total += answer.length
            state &= ~(1 << part)
        return total

    state, greedy = problem.root, []
    while state:
        (values,) = guide([state])
        greedy.append(max(problem.candidates(state), key=values.__getitem__))
        state &= ~(1 << greedy[-1])
    best = min(length(order) for order in itertools.permutations(members(problem.root)))
    assert length(tuple(greedy)) == pytest.approx(best, abs=1e-9)
