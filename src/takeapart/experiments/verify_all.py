"""Plans every shipped assembly by every search, and has every plan verified.

Searches on one assembly share a removal library, which saves time and makes later plans only shorter. Every plan is
written to a file and read again before it is verified. What is done for an assembly is kept in the output folder and
not done again, as long as sources, data and options are the same.

Command: ``python -m takeapart.experiments.verify_all``.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import multiprocessing
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from takeapart.experiments.tables import markdown_table, replace_between_markers
from takeapart.formats.documents import write_atomically
from takeapart.formats.files import data_path, load_assembly, load_plan, load_workcell, save_plan
from takeapart.formats.serialization import workcell_hash
from takeapart.model.assembly import members
from takeapart.model.plan import Plan
from takeapart.planning import PlanningOptions, build_problem, plan_of, search, sources_digest
from takeapart.problem import AssemblyProblem
from takeapart.search.registry import SEARCHES, SearchEntry
from takeapart.search.result import Budget
from takeapart.verification import Verifier, format_finding, states_of
from takeapart.verification.checks import unsupported

QUICK = ("single/03", "double/01")
PLANS_MARKER, STABILITY_MARKER, SUMMARY_MARKER = "verify-all", "stability-agreement", "verify-all-summary"


@dataclass(frozen=True)
class Settings:
    """What is planned for every assembly.

    Args:
        searches: that are used.
        random_seeds: number of random orders.
        exact_queries: budget of the exact search. Budgets in seconds would make the tables depend on what else the
            machine does; searches on one assembly share a library, so later ones have most answers for nothing.
        queries: budget of restarts and MCTS, each.
        beam_width: small, so that beam search comes to its end and needs no budget.
        episodes: of MCTS, and number of random restarts.
        agreement_orders: random orders on whose states the connector rule is compared with physics.
        workcell: name of a shipped one, or a file.
    """

    searches: tuple[str, ...] = tuple(SEARCHES)
    random_seeds: int = 15
    exact_queries: int = 500
    queries: int = 200
    beam_width: int = 2
    episodes: int = 10
    agreement_orders: int = 10
    workcell: str = "panda"


@dataclass(frozen=True)
class Verdict:
    """One plan: what was planned, and what its verification says.

    Args:
        length: m, of the tool path; NaN where no plan was found.
        clearance: m, smallest distance seen between things that may not touch; NaN if nothing came in sight.
        findings: one line each.
    """

    search: str
    seed: int
    length: float = math.nan
    steps: int = 0
    configurations: int = 0
    clearance: float = math.nan
    closest: str = ""
    findings: tuple[str, ...] = ()
    verification_seconds: float = 0.0


@dataclass(frozen=True)
class Agreement:
    """States on which connector rule and physics were compared; the last two should be 0."""

    both_stand: int
    both_fall: int
    only_rule_stands: int
    only_physics_stands: int


@dataclass(frozen=True)
class AssemblyOutcome:
    """Everything about one assembly.

    Args:
        parts: removable ones.
        distinct_steps: motions in states that differ; the others are repetitions that another plan had too.
        states: that stood under gravity, each once.
        largest_shift, largest_tilt: m and rad, over all states of all plans.
    """

    assembly: str
    parts: int
    verdicts: tuple[Verdict, ...]
    distinct_steps: int
    states: int
    largest_shift: float
    largest_tilt: float
    agreement: Agreement
    seconds: float


def searches_of(settings: Settings) -> list[PlanningOptions]:
    """Options of every plan that is made for an assembly."""
    orders = [PlanningOptions(search="random", seed=seed) for seed in range(settings.random_seeds)]
    others = [
        PlanningOptions(search=name, budget=_budget(entry, settings), search_options=_options(entry, settings))
        for name, entry in reversed(list(SEARCHES.items()))
        if name != "random"
    ]
    return [options for options in [*orders, *others] if options.search in settings.searches]


def _budget(entry: SearchEntry, settings: Settings) -> Budget:
    """What a search may spend; one that ends by itself may do so."""
    if entry.proves:
        return Budget(queries=settings.exact_queries)
    return Budget(episodes=settings.episodes, queries=settings.queries) if entry.anytime else Budget()


def _options(entry: SearchEntry, settings: Settings) -> object:
    return replace(entry.options(), width=settings.beam_width) if entry.name == "beam" else entry.options()


def verified(
    problem: AssemblyProblem, options: PlanningOptions, verifier: Verifier, file: Path
) -> tuple[Verdict, Plan | None]:
    """Plans once and verifies what stands in the plan file. The file stays where the plan is refused."""
    started = time.monotonic()
    made = plan_of(problem, search(problem, options), options, time.monotonic() - started)
    if not isinstance(made, Plan):
        return Verdict(options.search, options.seed, findings=()), None
    save_plan(made, file)
    plan = load_plan(file)
    report = verifier.verify(plan, physics=True)
    if report.passed:
        file.unlink()
    near = report.smallest_clearance
    verdict = Verdict(
        search=options.search,
        seed=options.seed,
        length=report.agreement.total_length_recomputed,
        steps=report.steps,
        configurations=report.configurations,
        clearance=near.distance if near else math.nan,
        closest=f"{near.first} and {near.second}, step {near.step + 1} ({near.part})" if near else "",
        findings=tuple(format_finding(finding) for finding in report.findings),
        verification_seconds=report.seconds,
    )
    return verdict, plan


def compare(verifier: Verifier, plans: Sequence[Plan], rng: np.random.Generator) -> Agreement:
    """The connector rule against physics: on all states of plans, and on each of these without one part more, drawn
    among those without which the rule says that something falls."""
    assembly = verifier.assembly
    standing = {state for plan in plans for state in states_of(plan, assembly)}
    broken: set[int] = set()
    for state in sorted(standing):
        without = [state & ~(1 << part) for part in members(state)]
        falling = [smaller for smaller in without if unsupported(assembly, smaller)]
        if falling:
            broken.add(falling[int(rng.integers(len(falling)))])
    outcomes = [(not unsupported(assembly, state), verifier.stand(state).stands) for state in sorted(standing | broken)]
    return Agreement(
        outcomes.count((True, True)),
        outcomes.count((False, False)),
        outcomes.count((True, False)),
        outcomes.count((False, True)),
    )


def verify_assembly(name: str, settings: Settings, folder: Path) -> AssemblyOutcome:
    """All plans of one shipped assembly, named as ``single/03``."""
    started = time.monotonic()
    assembly, workcell = load_assembly(data_path(f"{name}.json")), load_workcell(settings.workcell)
    problem, verifier = build_problem(assembly, workcell), Verifier(assembly, workcell)
    verdicts: list[Verdict] = []
    random_plans: list[Plan] = []
    for options in searches_of(settings):
        file = folder / f"{name.replace('/', '-')}.{options.search}-{options.seed}.plan.json"
        verdict, plan = verified(problem, options, verifier, file)
        verdicts.append(verdict)
        if plan is not None and options.search == "random":
            random_plans.append(plan)
        print(f"{name}  {progress_line(verdict)}", flush=True)
    tried = [report for state, report in verifier.standing.items() if not unsupported(assembly, state)]
    agreement = compare(verifier, random_plans[: settings.agreement_orders], np.random.default_rng(0))
    return AssemblyOutcome(
        assembly=name,
        parts=len(members(assembly.root)),
        verdicts=tuple(verdicts),
        distinct_steps=verifier.distinct_steps,
        states=len(tried),
        largest_shift=max((report.largest_shift for report in tried), default=0.0),
        largest_tilt=max((report.largest_tilt for report in tried), default=0.0),
        agreement=agreement,
        seconds=time.monotonic() - started,
    )


def progress_line(verdict: Verdict) -> str:
    """One plan, for the screen."""
    if not verdict.steps:
        return f"{verdict.search:8} seed {verdict.seed:2}: no plan within the budget"
    text = (
        f"{verdict.search:8} seed {verdict.seed:2}: {verdict.length:7.3f} m, {verdict.configurations} configurations, "
        f"{1e3 * verdict.clearance:.2f} mm, {verdict.verification_seconds:.1f} s"
    )
    return text + "".join(f"\n    FINDING {finding}" for finding in verdict.findings)


# --- results kept between runs ---


def fingerprint(name: str, settings: Settings) -> str:
    """Digest of everything that shapes the outcome of an assembly: sources, data, options."""
    cell = workcell_hash(load_workcell(settings.workcell))  # with its robot and the robot's files
    digest = hashlib.sha256(json.dumps([name, asdict(settings), sources_digest(), cell]).encode())
    digest.update(data_path(f"{name}.json").read_bytes())
    return digest.hexdigest()


def kept(file: Path, key: str) -> AssemblyOutcome | None:
    """The outcome in a file of an earlier run, if it is of the same sources, data and options."""
    if not file.is_file():
        return None
    document = json.loads(file.read_text(encoding="utf-8"))
    if document["fingerprint"] != key:
        return None
    outcome = document["outcome"]
    verdicts = tuple(Verdict(**{**item, "findings": tuple(item["findings"])}) for item in outcome["verdicts"])
    return AssemblyOutcome(**{**outcome, "verdicts": verdicts, "agreement": Agreement(**outcome["agreement"])})


def run(names: Sequence[str], settings: Settings, folder: Path, processes: int) -> list[AssemblyOutcome]:
    """The outcomes of assemblies, in their order; those that are missing are worked out now."""
    folder.mkdir(parents=True, exist_ok=True)
    keys = {name: fingerprint(name, settings) for name in names}
    files = {name: folder / f"{name.replace('/', '-')}.json" for name in names}
    outcomes = {name: found for name in names if (found := kept(files[name], keys[name])) is not None}
    todo = [name for name in names if name not in outcomes]
    print(f"{len(todo)} assemblies to do, {len(outcomes)} done before", flush=True)
    with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool:
        futures = {pool.submit(verify_assembly, name, settings, folder): name for name in todo}
        for future in as_completed(futures):
            name, outcome = futures[future], future.result()
            outcomes[name] = outcome
            content = {"fingerprint": keys[name], "outcome": asdict(outcome)}
            write_atomically(files[name], json.dumps(content, indent=1))
            print(f"{name} done in {outcome.seconds:.0f} s; {len(outcomes)} of {len(names)}", flush=True)
    return [outcomes[name] for name in names]


# --- tables ---


def plans_table(outcomes: Sequence[AssemblyOutcome]) -> str:
    """One row per assembly and search; random orders in one row."""
    rows = []
    for outcome in outcomes:
        for name in dict.fromkeys(verdict.search for verdict in outcome.verdicts):
            verdicts = [verdict for verdict in outcome.verdicts if verdict.search == name]
            found = [verdict for verdict in verdicts if verdict.steps]
            passed = sum(not verdict.findings for verdict in found)
            if not found:
                rows.append([outcome.assembly, name, "-", "-", "-", "no plan within the budget"])
                continue
            lengths = sorted({f"{verdict.length:.3f}" for verdict in found}, key=float)
            rows.append(
                [
                    outcome.assembly,
                    name if len(verdicts) == 1 else f"{name}, {len(verdicts)} seeds",
                    " to ".join(dict.fromkeys((lengths[0], lengths[-1]))),
                    f"{sum(verdict.configurations for verdict in found):,}",
                    f"{1e3 * np.nanmin([verdict.clearance for verdict in found]):.2f}",
                    ("holds" if passed == len(found) else "REFUSED")
                    + ("" if len(verdicts) == 1 else f", {passed} of {len(verdicts)}"),
                ]
            )
    header = ["assembly", "search", "length, m", "configurations", "smallest clearance, mm", "verdict"]
    return markdown_table(header, rows)


def stability_table(outcomes: Sequence[AssemblyOutcome]) -> str:
    """Connector rule against physics, one row per assembly."""
    rows: list[list[object]] = []
    for outcome in outcomes:
        found = outcome.agreement
        counts = [found.both_stand, found.both_fall, found.only_rule_stands, found.only_physics_stands]
        shift, tilt = f"{1e3 * outcome.largest_shift:.2f}", f"{math.degrees(outcome.largest_tilt):.2f}"
        rows.append([outcome.assembly, *counts, outcome.states, shift, tilt])
    header = ["assembly", "both: stands", "both: falls", "only rule: stands", "only physics: stands"]
    return markdown_table([*header, "states of all plans", "largest shift, mm", "largest tilt, deg"], rows)


def summary(outcomes: Sequence[AssemblyOutcome]) -> str:
    """One paragraph: how much was checked."""
    verdicts = [verdict for outcome in outcomes for verdict in outcome.verdicts if verdict.steps]
    passed = sum(not verdict.findings for verdict in verdicts)
    clearance = np.nanmin([verdict.clearance for verdict in verdicts]) if verdicts else math.nan
    return (
        f"{passed} of {len(verdicts)} plans of {len(outcomes)} assemblies hold: "
        f"{sum(verdict.steps for verdict in verdicts):,} steps "
        f"({sum(outcome.distinct_steps for outcome in outcomes):,} that differ in motion or state) with "
        f"{sum(verdict.configurations for verdict in verdicts):,} configurations; smallest clearance "
        f"{1e3 * clearance:.2f} mm. {sum(outcome.states for outcome in outcomes):,} different states stood under "
        f"gravity; no part moved more than {1e3 * max(outcome.largest_shift for outcome in outcomes):.2f} mm."
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns 4 if a plan is refused or a search found none, else 0."""
    shipped = [
        f"{kind}/{file.stem}" for kind in ("single", "double") for file in sorted(data_path(kind).glob("*.json"))
    ]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--assemblies", nargs="+", choices=shipped, metavar="KIND/NUMBER", help="only these")
    parser.add_argument("--quick", action="store_true", help="two assemblies, two random orders, short searches")
    parser.add_argument("--out", type=Path, default=Path("out/verify-all"), help="folder of what is kept")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--random-seeds", type=int, default=Settings.random_seeds, help="random orders per assembly")
    parser.add_argument("--document", type=Path, help="document whose tables are replaced")
    parser.add_argument("--searches", nargs="+", choices=SEARCHES, default=list(SEARCHES), help="only these")
    parser.add_argument("--exact-queries", type=int, default=Settings.exact_queries, help="budget of exact search")
    parser.add_argument(
        "--workcell", default=Settings.workcell, help="a shipped workcell, or a file that ends in .toml"
    )
    given = parser.parse_args(arguments)
    settings = Settings(tuple(given.searches), given.random_seeds, given.exact_queries, workcell=given.workcell)
    names = given.assemblies or shipped
    if given.quick:
        names = given.assemblies or [name for name in QUICK if name in shipped]
        settings = replace(settings, random_seeds=2, exact_queries=100, queries=60, episodes=3, agreement_orders=1)
    outcomes = run(names, settings, given.out, given.processes)
    print(summary(outcomes))
    if given.document is not None:
        replace_between_markers(given.document, SUMMARY_MARKER, summary(outcomes))
        replace_between_markers(given.document, PLANS_MARKER, plans_table(outcomes))
        replace_between_markers(given.document, STABILITY_MARKER, stability_table(outcomes))
    verdicts = [verdict for outcome in outcomes for verdict in outcome.verdicts]
    return 4 if any(verdict.findings or not verdict.steps for verdict in verdicts) else 0


if __name__ == "__main__":
    sys.exit(main())
