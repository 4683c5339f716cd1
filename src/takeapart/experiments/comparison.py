"""All searches at equal removal queries, on the same assemblies and seeds (`takeapart compare`).

Every run starts with an empty removal library and the same planner, and may ask the same number of removal queries,
each one attempt of the planner. What a run found, and after how many queries, is kept in one file per run, so that a
comparison that was stopped goes on where it was.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from takeapart.experiments.compared import COMPARED, PAPER
from takeapart.experiments.tables import markdown_table
from takeapart.formats.documents import readable_json, write_atomically
from takeapart.formats.serialization import assembly_hash, workcell_hash
from takeapart.model.assembly import Assembly
from takeapart.model.errors import InputError, UnknownNameError
from takeapart.model.geometry import Array
from takeapart.planning import versions
from takeapart.problem import AssemblyProblem
from takeapart.removal.planner import RemovalPlanner
from takeapart.removal.result import Counts
from takeapart.search.beam import BeamOptions, beam
from takeapart.search.refinement import RefinementOptions
from takeapart.search.registry import SEARCHES
from takeapart.search.result import Budget, Progress, ProgressListener, SearchResult
from takeapart.stability import stability_of
from takeapart.workcell import Workcell

PATIENCE = 2000  # episodes without a query or a gain, after which a search has nothing left to do
MAXIMUM_WIDTH = 2**16
LEAST_RANGE = 0.01  # of the ratios that the plot shows: differences far below one percent look like none
ALL_QUERIES = RefinementOptions(passes=10**6, worth=0.0)  # refines until the budget is spent


@dataclass(frozen=True)
class Comparison:
    """What is compared.

    Args:
        queries: removal queries that every run may ask.
        seeds: every search runs with seeds 0 .. seeds - 1 on every assembly.
        searches: names out of `COMPARED`.
    """

    queries: int
    seeds: int = 1
    searches: tuple[str, ...] = COMPARED

    def __post_init__(self) -> None:
        for name in self.searches:
            if name not in COMPARED:
                raise UnknownNameError("search", name, list(COMPARED))


@dataclass(frozen=True)
class Outcome:
    """One run.

    Args:
        improvements: (queries, length, m) whenever something shorter was found.
        length: m; infinite if no plan was found.
        bound: sequence bound, m; None where the search gives none.
        seconds: wall time of the search.
    """

    search: str
    assembly: str
    seed: int
    improvements: tuple[tuple[int, float], ...]
    length: float
    bound: float | None
    queries: int
    motion_plans: int
    seconds: float

    def length_at(self, queries: float) -> float:
        """The best length after so many queries, m; infinite if there was no plan yet."""
        return min((length for asked, length in self.improvements if asked <= queries), default=math.inf)


def search_by_name(
    name: str, problem: AssemblyProblem, queries: int, seed: int, listen: ProgressListener
) -> SearchResult:
    """Runs one of `COMPARED` until the queries are spent or it has nothing left to ask."""
    budget, rng = Budget(queries=queries), np.random.default_rng([seed, 1])
    if name == "beam":
        return _widening_beam(problem, budget, rng, listen)
    entry = SEARCHES["mcts" if name == PAPER else name]
    options = entry.options()
    if entry.anytime:
        options = replace(options, patience=PATIENCE)
    if name == PAPER:
        options = replace(options, memory="paper")
    if name == "exact":
        options = replace(options, refinement=ALL_QUERIES)
    return entry.run(problem, options, budget, rng, listen)


def _widening_beam(
    problem: AssemblyProblem, budget: Budget, rng: np.random.Generator, listen: ProgressListener
) -> SearchResult:
    """Beams of widths 1, 2, 4, ... until the budget is spent, or the beam holds every state; the best of them."""
    width, best, start = 1, SearchResult((), math.inf), problem.counts.removal_queries
    while True:
        asked = problem.counts.removal_queries - start

        def listen_on(progress: Progress, before: int = asked) -> None:
            listen(Progress(progress.episode, progress.length, -math.inf, before + progress.queries, progress.seconds))

        left = budget.queries - asked
        if left <= 0 or width > MAXIMUM_WIDTH:
            return best
        found = beam(problem, BeamOptions(width), Budget(queries=left), rng, listen_on)
        proved = found.sequence_bound is not None and found.length <= found.sequence_bound + 1e-9
        best = found if found.length < best.length else best
        if proved or found.interrupted:
            return best
        width *= 2


def compare(
    assemblies: Sequence[Assembly],
    workcell: Workcell,
    comparison: Comparison,
    folder: Path,
    progress: Callable[[str, float], None] = lambda text, share: None,
) -> Iterator[Outcome]:
    """Runs what is missing in the folder, and gives all runs, those kept from before included.

    Args:
        folder: one JSON file for each run; the file `comparison.json` says what it was made for.
        progress: is told what runs at the moment, and the share of all runs done.

    Raises:
        InputError: the folder belongs to another comparison.
    """
    _require_same(folder, assemblies, workcell, comparison)
    total = len(assemblies) * comparison.seeds * len(comparison.searches)
    done = 0
    for assembly in assemblies:
        planner: RemovalPlanner | None = None
        for seed in range(comparison.seeds):
            for name in comparison.searches:
                file = folder / f"{assembly.name}-{seed}-{name.replace(', ', '-')}.json"
                progress(f"{assembly.name}, seed {seed}, {name}", done / total)
                if not file.exists():
                    planner = planner or RemovalPlanner(assembly, workcell)
                    outcome = _run(planner, name, comparison.queries, seed)
                    if outcome is None:
                        raise KeyboardInterrupt
                    write_atomically(file, readable_json(_written(outcome)))
                done += 1
                yield load(file)


def _run(planner: RemovalPlanner, name: str, queries: int, seed: int) -> Outcome | None:
    """One run with an empty library; None if Ctrl-C ended it."""
    planner.counts = Counts()
    problem = AssemblyProblem(planner, stability_of(planner.assembly), seed)
    improvements: list[tuple[int, float]] = []

    def listen(progress: Progress) -> None:
        if progress.length < (improvements[-1][1] if improvements else math.inf):
            improvements.append((progress.queries, progress.length))

    started = time.monotonic()
    found = search_by_name(name, problem, queries, seed, listen)
    if found.interrupted:
        return None
    return Outcome(
        name,
        planner.assembly.name,
        seed,
        tuple(improvements),
        found.length,
        found.sequence_bound,
        problem.counts.removal_queries,
        problem.counts.motion_plans,
        time.monotonic() - started,
    )


def _written(outcome: Outcome) -> dict[str, object]:
    """As JSON, which has no infinity."""
    return asdict(outcome) | {"length": outcome.length if math.isfinite(outcome.length) else None}


def load(file: Path) -> Outcome:
    """A run that was kept."""
    data = json.loads(file.read_text(encoding="utf-8"))
    length = math.inf if data["length"] is None else data["length"]
    improvements = tuple((int(asked), float(found)) for asked, found in data["improvements"])
    return Outcome(**data | {"length": length, "improvements": improvements})


def _require_same(folder: Path, assemblies: Sequence[Assembly], workcell: Workcell, comparison: Comparison) -> None:
    """Runs at another budget or with another planner cannot be compared; more seeds and searches can be added."""
    identity = {
        "queries": comparison.queries,
        "workcell": workcell_hash(workcell),
        "versions": versions(),
        "assemblies": {assembly.name: assembly_hash(assembly) for assembly in assemblies},
    }
    file = folder / "comparison.json"
    if not file.exists():
        write_atomically(file, readable_json(identity))
        return
    before = json.loads(file.read_text(encoding="utf-8"))
    differing = [key for key in identity if before.get(key) != identity[key]]
    if differing:
        raise InputError(f"holds a comparison with other {', '.join(differing)}; take another folder", str(folder))


@dataclass(frozen=True)
class Line:
    """A search over all its runs.

    Args:
        solved: runs that found a plan.
        length, ratio: means over these runs, m, and to the shortest length known of the assembly.
        half_width: of the 95 % confidence interval of the ratio (normal approximation); NaN for one run.
        shortest: runs that found the shortest length known.
        queries, motion_plans, seconds: means.
    """

    search: str
    runs: int
    solved: int
    length: float
    ratio: float
    half_width: float
    shortest: int
    queries: float
    motion_plans: float
    seconds: float


def summary(outcomes: Sequence[Outcome]) -> list[Line]:
    """One line for each search, in the order in which they first appear."""
    best = _shortest(outcomes)
    lines = []
    for name in dict.fromkeys(each.search for each in outcomes):
        runs = [each for each in outcomes if each.search == name]
        solved = [each for each in runs if math.isfinite(each.length)]
        ratios = np.array([each.length / best[each.assembly] for each in solved])
        lines.append(
            Line(
                name,
                len(runs),
                len(solved),
                float(np.mean([each.length for each in solved])) if solved else math.nan,
                float(ratios.mean()) if solved else math.nan,
                _half_width(ratios[:, None])[0] if len(solved) > 1 else math.nan,
                int((ratios <= 1 + 1e-9).sum()),
                float(np.mean([each.queries for each in runs])),
                float(np.mean([each.motion_plans for each in runs])),
                float(np.mean([each.seconds for each in runs])),
            )
        )
    return lines


def table(lines: Sequence[Line]) -> str:
    """In Markdown."""
    header = [
        "search",
        "solved",
        "length, m",
        "ratio to the shortest known",
        "shortest",
        "queries",
        "motion plans",
        "s",
    ]
    rows = [
        [
            each.search,
            f"{each.solved} of {each.runs}",
            f"{each.length:.3f}" if each.solved else "-",
            _with_interval(each),
            each.shortest,
            f"{each.queries:.0f}",
            f"{each.motion_plans:.0f}",
            f"{each.seconds:.1f}",
        ]
        for each in lines
    ]
    return markdown_table(header, rows)


def _with_interval(line: Line) -> str:
    """Mean and half of its interval; one run has none, and no run no mean."""
    if not line.solved:
        return "-"
    return f"{line.ratio:.4f}" + (f" ± {line.half_width:.4f}" if math.isfinite(line.half_width) else "")


def comma_separated(lines: Sequence[Line]) -> str:
    """As CSV; what is not known is empty."""
    rows = [
        ",".join(f'"{value}"' if isinstance(value, str) else "" if value != value else str(value) for value in row)
        for row in (asdict(each).values() for each in lines)
    ]
    return "\n".join([",".join(asdict(lines[0])), *rows]) + "\n"


def curve(outcomes: Sequence[Outcome], search: str, queries: Array) -> tuple[Array, Array]:
    """Mean ratio to the shortest length known (Q,), and half the width of its 95 % band, after `queries` (Q,).

    NaN where not every run of the search had a plan yet: a mean over those that had one would be no mean of all.
    """
    best = _shortest(outcomes)
    runs = [each for each in outcomes if each.search == search]
    ratios = np.array([[each.length_at(q) / best[each.assembly] for q in queries] for each in runs])
    complete = np.isfinite(ratios).all(axis=0)
    mean, half = np.full(len(queries), math.nan), np.full(len(queries), math.nan)
    mean[complete] = ratios[:, complete].mean(axis=0)
    if len(runs) > 1:
        half[complete] = _half_width(ratios[:, complete])
    return mean, half


def plot(outcomes: Sequence[Outcome], file: Path) -> None:
    """Best length against removal queries: one curve for each search, with its band where there are several runs.

    Raises:
        InputError: the plotting library is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise InputError("needs matplotlib; install it with: pip install 'takeapart[view]'", str(file)) from None
    queries = np.arange(1.0, max(each.queries for each in outcomes) + 1)
    figure = Figure(figsize=(8, 5), layout="constrained")
    axes, banded = figure.subplots(), False
    for name in dict.fromkeys(each.search for each in outcomes):
        mean, half = curve(outcomes, name, queries)
        (line,) = axes.step(queries, mean, where="post", label=name)
        if np.isfinite(half).any():
            axes.fill_between(
                queries, mean - half, mean + half, step="post", alpha=0.2, color=line.get_color(), linewidth=0
            )
            banded = True
    axes.set_xlabel("removal queries")
    axes.set_ylabel("length / shortest length known of the assembly")
    axes.set_title("Best plan so far" + (": mean and 95 % band over assemblies and seeds" if banded else ", one run"))
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.set_ylim(1 - LEAST_RANGE / 10, max(axes.get_ylim()[1], 1 + LEAST_RANGE))
    axes.legend()
    figure.savefig(file, dpi=150)


def _shortest(outcomes: Sequence[Outcome]) -> dict[str, float]:
    best: dict[str, float] = {}
    for each in outcomes:
        best[each.assembly] = min(best.get(each.assembly, math.inf), each.length)
    return best


def _half_width(samples: Array) -> Array:
    """Half the 95 % confidence interval of the mean of each column, by the normal approximation."""
    return np.asarray(1.96 * samples.std(axis=0, ddof=1) / math.sqrt(len(samples)))
