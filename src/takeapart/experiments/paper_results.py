"""What the jobs of `reproduce paper` found, as rows of tables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from takeapart.experiments.jobs import Outcome
from takeapart.experiments.paired_statistics import Comparison, compare
from takeapart.experiments.paper_jobs import Product, guided_name, guides_for
from takeapart.experiments.schedule import Kept

SHARES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Of the motion plans that both searches of a pair made; there their lengths are compared."""

SAME = 1e-9  # m

TITLES = {"single": "D1", "double": "D2"}


@dataclass(frozen=True)
class Point:
    """A sequence that was the shortest so far: what it took to find it, and its length, m."""

    queries: int
    motion_plans: int
    length: float


@dataclass(frozen=True)
class SearchRun:
    """A Monte Carlo tree search.

    Args:
        trace: improvements; the first is the initial sequence, the last the shortest. Empty if none was found.
        episode, step: where the shortest was found, from 1; 0 if none was.
        queries, motion_plans: of the whole search.
        guide_share: of the processor time, that the guide took.
    """

    trace: tuple[Point, ...]
    episode: int
    step: int
    queries: int
    motion_plans: int
    guide_share: float

    @property
    def initial(self) -> Point:
        """The first sequence; infinite where none was found."""
        return self.trace[0] if self.trace else Point(self.queries, self.motion_plans, math.inf)

    @property
    def shortest(self) -> Point:
        """The shortest sequence; infinite where none was found."""
        return self.trace[-1] if self.trace else Point(self.queries, self.motion_plans, math.inf)

    def length_at(self, motion_plans: float) -> float:
        """Of the shortest sequence found with at most so many motion plans, m; infinite if there was none."""
        return min((point.length for point in self.trace if point.motion_plans <= motion_plans), default=math.inf)

    def plans_to(self, length: float) -> float:
        """Motion plans after which a sequence not longer than that was known; infinite if never."""
        reached = (point.motion_plans for point in self.trace if point.length <= length + SAME)
        return min(reached, default=math.inf)


def search_run(outcome: Outcome) -> SearchRun:
    """From the outcome of a `SearchTask`."""
    trace: list[Point] = []
    for _, queries, motion_plans, length in outcome["trace"]:
        if not trace or length < trace[-1].length:
            trace.append(Point(int(queries), int(motion_plans), length))
    statistics = outcome["statistics"]
    seconds = outcome["search_seconds"]
    return SearchRun(
        tuple(trace),
        int(statistics.get("found_episode", 0)),
        int(statistics.get("found_step", 0)),
        outcome["removal_queries"],
        outcome["motion_plans"],
        outcome["guide_seconds"] / seconds if seconds > 0 else 0.0,
    )


@dataclass(frozen=True)
class Reference:
    """What exact search found; lengths in m, infinite or minus infinity where there is none."""

    length: float
    sequence_bound: float
    straight_line_bound: float
    queries: int
    motion_plans: int


@dataclass(frozen=True, eq=False)
class Row:
    """A row of Table I or II.

    Args:
        product: the assembly.
        vanilla: search without a guide.
        guided: searches with the guides trained on the data sets.
        reference: exact search.
        orders: lengths of the orders that were found, each with all of the planner's effort, m; by "random", "vanilla",
            the guide's data set, "exact". Infinite where one of its removals was not found again.
    """

    product: Product
    vanilla: SearchRun
    guided: Mapping[str, SearchRun]
    reference: Reference
    orders: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Replanning:
    """An assembly of Fig. 5.

    Args:
        lengths: per repeat one total path length for each number of replans, m; NaN where a removal was not found.
        seconds, motion_plans: likewise, per part.
    """

    product: Product
    lengths: Sequence[Sequence[float]]
    seconds: Sequence[Sequence[float]]
    motion_plans: Sequence[Sequence[float]]


@dataclass(frozen=True, eq=False)
class EqualCost:
    """Vanilla and guided search of an assembly, both cut after as many motion plans.

    Args:
        trained_on: the guide's data set.
        share: of the motion plans that the one with fewer made.
        motion_plans: where they are cut.
        vanilla, guided: lengths, m; infinite where no sequence was found by then.
    """

    product: Product
    trained_on: str
    share: float
    motion_plans: int
    vanilla: float
    guided: float


@dataclass(frozen=True, eq=False)
class Saving:
    """What it takes to be as good as vanilla search is in the end.

    Args:
        target: shortest length of the vanilla search, m.
        vanilla, guided: motion plans until a sequence of that length was known; infinite if never.
    """

    product: Product
    trained_on: str
    target: float
    vanilla: float
    guided: float

    @property
    def saved(self) -> float:
        """Share of vanilla's motion plans; negative where the guided search took more, minus infinity if forever."""
        return 1.0 - self.guided / self.vanilla


def table_rows(products: Sequence[Product], results: Mapping[str, Kept]) -> list[Row]:
    """All rows of both tables."""
    return [
        Row(
            product,
            search_run(results[f"vanilla/{product.name}"].outcome),
            {kind: search_run(results[guided_name(product, kind)].outcome) for kind in guides_for(product)},
            _reference(results[f"reference/{product.name}"].outcome),
            _orders(product, results[f"orders/{product.name}"].outcome),
        )
        for product in products
    ]


def replannings(products: Sequence[Product], results: Mapping[str, Kept]) -> list[Replanning]:
    """Fig. 5."""
    found = []
    for product in products:
        kept = results.get(f"figure5/{product.name}")
        if kept is not None:
            outcome = kept.outcome
            lengths = [[math.nan if length is None else length for length in row] for row in outcome["lengths"]]
            found.append(Replanning(product, lengths, outcome["seconds_per_part"], outcome["motion_plans_per_part"]))
    return found


def equal_costs(rows: Sequence[Row]) -> list[EqualCost]:
    """Every pair of searches at every share of the cost that both paid."""
    found = []
    for row in rows:
        for kind, guided in row.guided.items():
            for share in SHARES:
                plans = round(share * min(row.vanilla.motion_plans, guided.motion_plans))
                lengths = row.vanilla.length_at(plans), guided.length_at(plans)
                found.append(EqualCost(row.product, kind, share, plans, *lengths))
    return found


def savings(rows: Sequence[Row]) -> list[Saving]:
    """Every pair of searches; those whose vanilla search found nothing have no target and are left out."""
    return [
        Saving(row.product, kind, target.length, target.motion_plans, guided.plans_to(target.length))
        for row in rows
        for kind, guided in row.guided.items()
        if math.isfinite((target := row.vanilla.shortest).length)
    ]


def _orders(product: Product, outcome: Outcome) -> dict[str, float]:
    names = {"random": "random", "vanilla": f"vanilla/{product.name}", "exact": f"reference/{product.name}"}
    names |= {kind: guided_name(product, kind) for kind in guides_for(product)}
    lengths = outcome["lengths"]
    return {key: math.inf if lengths[name] is None else float(lengths[name]) for key, name in names.items()}


def _reference(outcome: Outcome) -> Reference:
    def number(name: str, missing: float) -> float:
        return missing if outcome[name] is None else float(outcome[name])

    return Reference(
        number("length", math.inf),
        number("sequence_bound", -math.inf),
        number("straight_line_bound", -math.inf),
        outcome["removal_queries"],
        outcome["motion_plans"],
    )


def guide_columns(kind: str) -> dict[str, str]:
    """Names of the guided columns by the data set of the guide: "guided" where there is one guide only."""
    return {"single": "guided"} if kind == "single" else {"single": "guided_d1", "double": "guided_d2"}


def comparisons(rows: Sequence[Row], seed: int) -> dict[tuple[str, str, str], Comparison]:
    """Guided against vanilla search by set, guide, and "as in the paper" (all episodes) or "at equal motion plans"."""
    found = {}
    for kind, trained_on in pairs_in(rows):
        own = [row for row in rows if row.product.kind == kind]
        ends = [(row.vanilla.shortest.length, row.guided[trained_on].shortest.length) for row in own]
        last = [(cost.vanilla, cost.guided) for cost in equal_costs_of(own, trained_on) if cost.share == SHARES[-1]]
        for name, lengths in (("all episodes", ends), ("equal motion plans", last)):
            first, second = zip(*lengths, strict=True)
            found[kind, trained_on, name] = compare(first, second, np.random.default_rng(seed))
    return found


def equal_costs_of(rows: Sequence[Row], trained_on: str) -> list[EqualCost]:
    """Only those of one guide."""
    return [cost for cost in equal_costs(rows) if cost.trained_on == trained_on]


def pairs_in(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """Sets with the guides tried on them."""
    return list(dict.fromkeys((row.product.kind, trained_on) for row in rows for trained_on in row.guided))
