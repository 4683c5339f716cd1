"""Small wrong changes of the sources, and whether the tests near them notice: ``make mutants``.

From every area of the sources changes are drawn (`code_changes`). Each is made in a copy of the project, then the tests
of the area that execute its line run there until the first fails (`mutant_trial`). Where a module holds compiled
kernels the tests run uncompiled, those that are quick enough that way.

The fates are a file of the project, `data/mutant_fates.jsonl`, written after every trial: only changes that it does not
know are tried. It names changes by what the lines read, so a change of the sources asks for trials of the lines that it
touches, and a fate stays as it is where only lines around it change; ``--again`` tries all.

A change that no test notices is a survivor. Some survivors do the same as before, or differ only in a message or in
speed: `data/surviving_mutants.toml` says which and why. All others count against the tests.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
import tomllib
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from code_changes import PACKAGE, Mutant, drawn, mutated
from mutant_trial import Bench, Judges, Tree
from takeapart.experiments.tables import markdown_table, replace_between_markers
from takeapart.formats.documents import write_atomically

ROOT = Path(__file__).resolve().parents[1]
FATES = ROOT / "tests" / "data" / "mutant_fates.jsonl"
REASONS = ROOT / "tests" / "data" / "surviving_mutants.toml"
MARKER = "mutants"
HARMLESS = ("equivalent", "message", "speed", "tuning")  # what a reason may begin with


@dataclass(frozen=True)
class Area:
    """Modules that the same tests judge.

    Args:
        share: how many changes are drawn of each 210.
        modules: patterns below src/takeapart.
        tests: names of test files.
        uncompiled: those of modules with compiled kernels, which run as plain Python then.
    """

    share: int
    modules: tuple[str, ...]
    tests: tuple[str, ...]
    uncompiled: tuple[str, ...] = ()


AREAS = {
    "stability": Area(
        26,
        ("stability/*.py", "problem/*.py"),
        ("carriers", "stability", "statics", "patches", "standing", "contact", "problem"),
    ),
    "verification": Area(
        26,
        ("verification/*.py",),
        (
            *("verification_support", "verification_tolerances", "verification_motion", "verification"),
            *("verification_meshes", "verification_robots", "verification_holes", "carriers"),
        ),
    ),
    "runs": Area(14, ("planning/run*.py",), ("faults",)),
    "search": Area(
        30,
        ("search/*.py",),
        ("deepest", "lattice", "mcts", "baselines", "exact", "best_first", "refinement", "registry", "determinism"),
        ("lattice", "exact", "refinement"),
    ),
    "collision": Area(
        26, ("collision/*.py",), ("collision_kernels", "fields", "exits", "kept"), ("collision_kernels", "fields")
    ),
    "motion": Area(26, ("motion/*.py",), (), ("motion", "motion_proofs")),
    "kernels": Area(
        26,
        ("robot/*.py",),
        ("robot", "covering_few", "self_collision", "separation", "urdf", "describing", "kept"),
        ("kernels", "robot", "self_collision", "separation", "motion_proofs"),
    ),
    "removal": Area(
        36,
        ("removal/*.py",),
        (
            "ways",
            "bounds",
            "exits",
            "placement",
            "exit_masks",
            "removal",
            "reasons",
            "carrying",
            "mesh_grasps",
            "straight_line",
        ),
        ("exits", "fields"),
    ),
}


@dataclass(frozen=True)
class Fate:
    """What became of a mutant.

    Args:
        outcome: "killed", "timeout" or "survived".
        tests: how many were to judge it.
        noticed: the test that did.
    """

    outcome: str
    tests: int
    noticed: str


def modules_of(area: Area) -> list[Path]:
    return sorted(path for pattern in area.modules for path in PACKAGE.glob(pattern) if path.name != "__init__.py")


def tests_of(area: Area, compiled: bool) -> list[str]:
    """Files of tests.

    Raises:
        AssertionError: one does not exist.
    """
    files = [f"tests/test_{name}.py" for name in (area.tests if compiled else area.uncompiled)]
    for file in files:
        assert (ROOT / file).is_file(), f"there is no {file}"
    return files


def is_compiled(module: Path) -> bool:
    return b"@compiled" in module.read_bytes()


def sample_of(areas: Sequence[str], count: int, seed: int, kept: Path) -> list[Mutant]:
    """The changes that are drawn, area by area."""
    whole = sum(area.share for area in AREAS.values())
    return [
        mutant
        for name in areas
        for mutant in drawn(name, modules_of(AREAS[name]), math.ceil(AREAS[name].share * count / whole), seed, kept)
    ]


def judged(tree: Tree, mutants: Sequence[Mutant], log: Path, minutes: float, longer: bool = False) -> None:
    """Tries one mutant after the other; every fate is written to the log as soon as it is known.

    Args:
        minutes: after these no other is begun.
        longer: tests that take long judge too, where their file names the module.
    """
    started = time.monotonic()
    compiled = {mutant: not is_compiled(PACKAGE / mutant.module) for mutant in mutants}
    ways = dict.fromkeys((mutant.area, compiled[mutant]) for mutant in mutants)
    for area, way in ways:
        files, patterns = tests_of(AREAS[area], way), AREAS[area].modules
        judges = tree.judges(files, patterns, way, tree.folder.parent)
        print(f"{area}, {'compiled' if way else 'uncompiled'}: {len(judges.seconds)} tests", flush=True)
        bench = Bench(tree, files, judges, way)
        for mutant in [each for each in mutants if (each.area, compiled[each]) == (area, way)]:
            if time.monotonic() - started > 60 * minutes:
                print("time is over; the next call goes on", flush=True)
                bench.close()
                return
            fate = tried(tree, bench, judges, mutant, longer)
            write_log(log, {**read_log(log), mutant.key: (mutant.area, fate)})
            print(f"{fate.outcome}: {mutant.module}:{mutant.line} ({fate.tests} tests) {fate.noticed}", flush=True)
            if fate.outcome == "survived":
                print(f"    {mutant.before}\n    {mutant.after}", flush=True)
        bench.close()


def tried(tree: Tree, bench: Bench, judges: Judges, mutant: Mutant, longer: bool) -> Fate:
    """Tries one mutant."""
    source = tree.source(mutant.module)
    changed = mutated(mutant, source)
    if changed is None:
        raise AssertionError(f"{mutant.key}: no such change")
    tests = judges.of(mutant.module, source, mutant.line)
    if longer:
        tests += bench.unmeasured(mutant.module)
    at_import = judges.at_import(mutant.module, source, mutant.line)
    outcome, noticed = bench.trial(mutant.module, changed, tests, at_import)
    return Fate(outcome, len(tests), noticed.removeprefix("tests/"))


def read_log(log: Path) -> dict[str, tuple[str, Fate]]:
    """Area and fate of every mutant, by its key."""
    rows = log.read_text(encoding="utf-8").splitlines() if log.is_file() else []
    return {
        row["change"]: (row["area"], Fate(row["outcome"], row["tests"], row["noticed"]))
        for row in map(json.loads, rows)
    }


def write_log(log: Path, fates: dict[str, tuple[str, Fate]]) -> None:
    """One line per mutant, in the order of their keys."""
    rows = [json.dumps({"change": key, "area": area, **asdict(fate)}) for key, (area, fate) in sorted(fates.items())]
    write_atomically(log, "\n".join(rows) + "\n")


def read_reasons() -> dict[str, str]:
    """Why survivors are no gap of the tests, by the key of the mutant."""
    reasons: dict[str, str] = tomllib.loads(REASONS.read_text(encoding="utf-8"))
    for key, reason in reasons.items():
        assert reason.startswith(HARMLESS), f"{key}: a reason begins with one of {', '.join(HARMLESS)}"
    return reasons


def markdown(fates: dict[Mutant, Fate], sample: Sequence[Mutant], reasons: dict[str, str]) -> tuple[str, float]:
    """The tables of the document, and the share of the changes in behaviour that the tests notice."""
    counts: defaultdict[str, Counter[str]] = defaultdict(Counter)
    survivors = []
    for mutant, fate in fates.items():
        open_end = "gap" if fate.tests else "no quick test"
        reason = reasons.get(mutant.key, open_end) if fate.outcome == "survived" else ""
        kind = fate.outcome if not reason else reason if reason == open_end else "harmless"
        for name in (mutant.area, "all"):
            counts[name][kind] += 1
        if reason:
            survivors.append([f"`{mutant.module}`", f"`{mutant.before}`", f"`{mutant.after}`", reason])
    rows = []
    share = 0.0
    for name in [*AREAS, "all"]:
        found = counts[name]
        noticed = found["killed"] + found["timeout"]
        missed = found["gap"] + found["no quick test"]
        share = noticed / max(noticed + missed, 1)
        asked = sum(mutant.area == name or name == "all" for mutant in sample)
        numbers = [asked, found.total(), found["killed"], found["timeout"], found["harmless"]]
        numbers += [found["gap"], found["no quick test"]]
        rows.append([name, *map(str, numbers), f"{100 * share:.0f} %" if noticed + missed else "-"])
    head = ["area", "drawn", "tried", "test failed", "never ended", "harmless", "not noticed"]
    head += ["no quick test", "noticed of those that matter"]
    cells = [[cell.replace("|", "\\|") for cell in row] for row in survivors]
    percent = 100 * len(fates) / max(len(sample), 1)
    tried = f"{len(fates)} of the {len(sample)} changes drawn were tried ({percent:.0f} %)."
    return "\n\n".join(
        [tried, markdown_table(head, rows), markdown_table(["module", "before", "after", "why"], cells)]
    ), share


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mutants", type=int, default=210, help="changes in all")
    parser.add_argument("--areas", nargs="+", choices=list(AREAS), default=list(AREAS), help="only these")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=math.inf, help="then stop; the next call goes on")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "mutants", help="folder for the copy")
    parser.add_argument("--log", type=Path, default=FATES, help="file of the fates")
    parser.add_argument("--again", action="store_true", help="try also what the log knows")
    parser.add_argument("--survivors", action="store_true", help="try again, by long tests too, what survived")
    parser.add_argument("--from-log", action="store_true", help="no tests, only the tables")
    parser.add_argument("--document", type=Path, help="file whose tables are replaced")
    options = parser.parse_args(arguments)
    options.work.mkdir(parents=True, exist_ok=True)
    sample = sample_of(options.areas, options.mutants, options.seed, options.work)
    known, reasons = read_log(options.log), read_reasons()
    if not options.from_log:
        chosen = [m for m in sample if options.again or m.key not in known or not known[m.key][1].tests]
        if options.survivors:
            survived = [m for m in sample if m.key in known and known[m.key][1].outcome == "survived"]
            chosen = [m for m in survived if m.key not in reasons]
        judged(Tree(options.work / "tree"), chosen, options.log, options.minutes, options.survivors)
        known = read_log(options.log)
    tables, share = markdown({m: known[m.key][1] for m in sample if m.key in known}, sample, reasons)
    print(tables)
    if options.document:
        replace_between_markers(options.document, MARKER, tables)
    return 0 if share >= 0.9 and all(mutant.key in known for mutant in sample) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
