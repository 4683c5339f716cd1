"""What `reproduce paper` does, in full and in small."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from takeapart.model.errors import InputError
from takeapart.removal.paths import RemovalOptions
from takeapart.search.mcts import MctsOptions

SETS = ("single", "double")
"""Data sets D1 and D2 of Sec. VI."""

SINGLE = tuple(f"single/{number:02d}" for number in range(1, 15))
DOUBLE = tuple(f"double/{number:02d}" for number in range(1, 8))

ONE_PATH = RemovalOptions(
    leg_grasps=4, tree_paths=1, tree_failures=6, finalists=1, shortening_moves=60, shortening_patience=20
)
"""To plan a removal once is to find one path and to shorten it, as in Sec. VII-A. By default this planner does several
times as much in one query, which leaves nothing for planning it again.
"""


@dataclass(frozen=True)
class PaperSettings:
    """The experiments of Sec. VII.

    Args:
        single, double: assemblies of D1 and D2: shipped ones (``single/01``) or files (``product.json``).
        workcell: name of a shipped one or a file.
        seed: of all random choices.
        figure_assemblies: the first so many of D2 are in Fig. 5 (Sec. VII-A: three).
        replans: a removal is planned at most so often for Fig. 5 (six).
        repeats: of Fig. 5 (50).
        removal: how a removal is planned, but for the exact search, which has all of the planner.
        mcts: search budget, attempts, epsilon of Sec. VII; "paper" memory.
        episodes: of every search. The paper gives no number; 20 is the greatest in its tables.
        queries: limit of removal queries of every search.
        training: options of `guide.training.TrainingOptions` that differ from their defaults.
        reference_queries: of the exact search that says how much there was to gain.
        order_attempts: how often each removal of an order that was found is planned again, to judge the order alone.
    """

    single: tuple[str, ...] = SINGLE
    double: tuple[str, ...] = DOUBLE
    workcell: str = "panda"
    seed: int = 0
    figure_assemblies: int = 3
    replans: int = 6
    repeats: int = 50
    removal: RemovalOptions = ONE_PATH
    mcts: MctsOptions = field(default_factory=lambda: MctsOptions(memory="paper"))
    episodes: int = 20
    queries: float = math.inf
    training: Mapping[str, Any] = field(default_factory=lambda: {"teacher": "backup"})
    reference_queries: int = 1500
    order_attempts: int = 8

    def __post_init__(self) -> None:
        for name in SETS:
            if len(getattr(self, name)) < 2:
                raise InputError("at least two assemblies are needed, to leave one out", f"settings.{name}")
        for name in (
            "figure_assemblies",
            "replans",
            "repeats",
            "episodes",
            "queries",
            "reference_queries",
            "order_attempts",
        ):
            if getattr(self, name) < 1:
                raise InputError(f"{getattr(self, name)}; must be at least 1", f"settings.{name}")


def full_settings(seed: int = 0) -> PaperSettings:
    """All of Sec. VII."""
    return PaperSettings(seed=seed)


def quick_settings(seed: int = 0) -> PaperSettings:
    """Every table and every plot within minutes; the figures in them mean nothing."""
    return PaperSettings(
        single=SINGLE[:2],
        double=DOUBLE[:2],
        seed=seed,
        figure_assemblies=1,
        replans=3,
        repeats=2,
        mcts=MctsOptions(memory="paper", search_budget=1, attempts=2),
        episodes=1,
        queries=200,
        training={"teacher": "backup", "steps": 40, "batch": 16, "evaluate_every": 20},
        reference_queries=30,
        order_attempts=1,
    )
