"""Which teacher a guide learns most from. ``python -m takeapart.experiments.teachers out/paper/work/files/vanilla``.

Exact search closes every shipped assembly and writes down what it knows; vanilla MCTS has recorded its own experience
(``takeapart reproduce paper``). Guides are trained by every teacher on all assemblies but a few, and judged on those
against the Q-values that exact search knows: by their choice in single states, and by the order that they give when
nothing but the guide decides, its removals planned with the library of the exact search.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from takeapart.experiments.paired_statistics import mean_interval
from takeapart.experiments.paper_settings import SETS
from takeapart.experiments.tables import markdown_table, replace_between_markers
from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.guide.experience import Experience, ExperienceWriter, Values, known_values, read_experience, together
from takeapart.guide.policy import load_guide
from takeapart.guide.training import TeacherName, TrainingOptions, train
from takeapart.model.assembly import Assembly
from takeapart.problem import AssemblyProblem, Guide
from takeapart.removal.planner import RemovalPlanner
from takeapart.robot.loading import load_robot
from takeapart.robot.model import RobotModel
from takeapart.search.exact import ExactOptions, exact
from takeapart.search.result import Budget
from takeapart.search.simple_orders import OrderOptions, greedy, random_order
from takeapart.stability import stability_of
from takeapart.workcell import Workcell

RANDOM = "random choice"
ORDER = OrderOptions(attempts=4, monotone=True)  # of the removals that the exact search did not need


@dataclass(frozen=True)
class Lesson:
    """A teacher and what it teaches from."""

    teacher: TeacherName
    sources: tuple[str, ...]

    @property
    def name(self) -> str:
        """For the table."""
        return f"`{self.teacher}`, {' and '.join(self.sources)}"


LESSONS = (
    Lesson("dqn", ("mcts",)),
    Lesson("backup", ("mcts",)),
    Lesson("backup", ("exact",)),
    Lesson("exact", ("exact",)),
    Lesson("backup", ("mcts", "exact")),
)


@dataclass(frozen=True, eq=False)
class Solved:
    """An assembly that exact search has closed.

    Args:
        problem: with all removals that the search asked for in its library.
        length: of the shortest order, m.
        values: what the search knows.
    """

    problem: AssemblyProblem
    length: float
    values: Values


@dataclass(frozen=True)
class Judgement:
    """A guide on an assembly that it never saw, or on average.

    Args:
        regret: by how much the best known Q-value of a state exceeds that of the guide's choice, mean over states, m.
        error: mean absolute error of its Q-values, m; not a number for a random choice.
        excess: by how much the guide's own order is longer than the shortest, as a share of that.
    """

    regret: float
    error: float
    excess: float


def solve(assembly: Assembly, workcell: Workcell, robot: RobotModel, folder: Path, seed: int) -> Solved:
    """Closes an assembly; its experience is written into the folder."""
    planner = RemovalPlanner(assembly, workcell, robot=robot)
    problem = AssemblyProblem(planner, stability_of(assembly), seed)
    with ExperienceWriter(folder, assembly, seed=seed, search="exact") as writer:
        found = exact(problem, ExactOptions(), Budget(), observe_settled=writer.observe_settled)
    return Solved(problem, found.length, known_values(read_experience(folder)))


def judge(guide: Guide, solved: Solved, seed: int) -> Judgement:
    """Regret and error in all states of which the values are known, and the length of the guide's own order."""
    regrets, errors = [], []
    for state, truth in solved.values.items():
        found = guide([state])[0]
        choice = max(truth, key=lambda part: found[part])
        regrets.append(max(truth.values()) - truth[choice])
        errors += [abs(found[part] - value) for part, value in truth.items()]
    order = greedy(solved.problem, ORDER, Budget(), np.random.default_rng(seed), guide=guide)
    return Judgement(float(np.mean(regrets)), float(np.mean(errors)), order.length / solved.length - 1)


def judge_chance(solved: Solved, seed: int) -> Judgement:
    """The same for a random choice."""
    regrets = [max(truth.values()) - float(np.mean(list(truth.values()))) for truth in solved.values.values()]
    order = random_order(solved.problem, ORDER, Budget(), np.random.default_rng(seed))
    return Judgement(float(np.mean(regrets)), math.nan, order.length / solved.length - 1)


def compare_teachers(
    solved: Mapping[str, Solved],
    experience: Mapping[str, Experience],
    lessons: Sequence[Lesson],
    folds: int,
    training: Mapping[str, int],
    folder: Path,
) -> dict[str, list[Judgement]]:
    """Judgements of every lesson, one per assembly, which its guide never saw; those of chance under `RANDOM`.

    Args:
        solved: by name of the assembly.
        experience: by its source.
        folds: how many guides a lesson trains; each leaves out every so manyth assembly.
        training: options of `TrainingOptions` that differ from their defaults.
        folder: for weights and logs.
    """
    names = sorted(solved)
    seed = training.get("seed", 0)
    judged: dict[str, list[Judgement]] = {lesson.name: [] for lesson in lessons}
    for fold in range(folds):
        unseen = names[fold::folds]
        for number, lesson in enumerate(lessons):
            seen = together([experience[source] for source in lesson.sources]).without(unseen)
            weights = folder / f"{number}-{fold}.safetensors"
            train(seen, TrainingOptions(teacher=lesson.teacher, **training), weights)  # type: ignore[arg-type]
            for name in unseen:
                guide = load_guide(weights, solved[name].problem.assembly)
                judged[lesson.name].append(judge(guide, solved[name], seed))
    judged[RANDOM] = [judge_chance(solved[name], seed) for name in names]
    return judged


def teachers_markdown(judged: Mapping[str, Sequence[Judgement]]) -> str:
    """Means over the assemblies with their 95 % intervals."""
    rows = []
    for name, found in judged.items():
        regret = mean_interval([1e3 * each.regret for each in found])
        excess = mean_interval([100 * each.excess for each in found])
        error = float(np.mean([each.error for each in found]))
        rows.append(
            [
                name,
                f"{regret.mean:.1f} ± {regret.high - regret.mean:.1f}",
                "-" if math.isnan(error) else f"{error:.2f}",
                f"{excess.mean:.1f} ± {excess.high - excess.mean:.1f} %",
            ]
        )
    return markdown_table(
        ["teacher, experience of", "regret, mm", "error of Q, m", "own order above the shortest"], rows
    )


def main() -> None:
    """Prints the table; with --document it replaces the one there."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("vanilla", type=Path, help="folder with a folder of experience per assembly")
    parser.add_argument("--sets", nargs="+", choices=SETS, default=SETS)
    parser.add_argument("--count", type=int, help="assemblies of each set; all by default")
    parser.add_argument("--folds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--document", type=Path)
    arguments = parser.parse_args()
    files = [
        (kind, file) for kind in arguments.sets for file in sorted(data_path(kind).glob("*.json"))[: arguments.count]
    ]
    names = [f"{kind}/{file.stem}" for kind, file in files]
    workcell = load_workcell("panda")
    robot = load_robot(workcell)
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        solved = {}
        for name in names:
            assembly = load_assembly(data_path(f"{name}.json"))
            found = solve(assembly, workcell, robot, folder / assembly.name, arguments.seed)
            solved[assembly.name] = found
            print(f"{name}: {found.length:.3f} m, values of {len(found.values)} states", flush=True)
        experience = {
            "mcts": read_experience([arguments.vanilla / name for name in solved]),
            "exact": read_experience([folder / name for name in solved]),
        }
        training = {"steps": arguments.steps, "seed": arguments.seed}
        judged = compare_teachers(solved, experience, LESSONS, arguments.folds, training, folder)
    text = teachers_markdown(judged)
    print(text)
    if arguments.document:
        replace_between_markers(arguments.document, "teachers", text)


if __name__ == "__main__":
    main()
