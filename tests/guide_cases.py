"""Experience of small synthetic problems, told as that of a hand-made assembly of as many parts."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from synthetic import SyntheticProblem
from takeapart.guide.experience import ExperienceWriter
from takeapart.model.assembly import Assembly, Part
from takeapart.model.geometry import Box, pose


def blocks(count: int, seed: int = 0, name: str = "blocks") -> Assembly:
    """Boxes of different sizes on a grid; part k of a synthetic problem is part k of the assembly."""
    rng = np.random.default_rng((seed, count))
    places = rng.permutation(27)[:count]
    return Assembly(
        name,
        tuple(
            Part(
                f"block{k}",
                Box(tuple(rng.uniform(0.02, 0.09, 3).tolist())),
                pose(0.1 * np.array(np.unravel_index(place, (3, 3, 3)))),
                0.1,
            )
            for k, place in enumerate(places)
        ),
    )


def record_everything(problem: SyntheticProblem, assembly: Assembly, folder: Path) -> None:
    """All removals of all reachable states, at their true cost."""
    with ExperienceWriter(folder, assembly, seed=0, search="mcts") as writer:
        for state, parts in problem.reachable().items():
            for part in parts:
                following = state & ~(1 << part)
                cost = problem.true_cost(state, part)
                writer.observe(state, part, -cost, following, problem.candidates(following))


def true_value(problem: SyntheticProblem, state: int, part: int) -> float:
    """The optimal Q-value of a removal, m; minus infinity where it leads nowhere."""
    return -(problem.true_cost(state, part) + problem.optimum(state & ~(1 << part))[0])
