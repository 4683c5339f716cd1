"""Small wrong changes of the sources, and whether the tests near them notice: ``make mutants``.

Cosmic Ray knows what can be changed in a line of Python; here is drawn what is changed, and by which tests it is
judged. From every area of the sources the same number of places is drawn, and for every place one of the possible
changes, but none that only puts an operator on bits into arithmetic, which any test would notice. A change is made in a
copy of the project, then the tests of the area that execute its line run there until the first fails (`mutant_trial`).
Where a module holds compiled kernels the tests run uncompiled, those that are quick enough that way.

Every fate is kept in a log at once: a run that was cut off, or given few minutes, goes on where it was.

A change that no test notices is a survivor. Some survivors do the same as before, or differ only in a message or in
speed: `data/surviving_mutants.toml` says which and why. All others count against the tests.
"""

from __future__ import annotations

import argparse
import ast
import difflib
import hashlib
import json
import math
import sys
import time
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

from mutant_trial import Judges, Tree
from takeapart.experiments.tables import markdown_table, replace_between_markers

ROOT = Path(__file__).resolve().parents[1]
REASONS = ROOT / "tests" / "data" / "surviving_mutants.toml"
MARKER = "mutants"
ARITHMETIC = ("Add", "Sub", "Mul", "Div", "FloorDiv", "Mod", "Pow")
BITWISE = ("RShift", "LShift", "BitOr", "BitAnd", "BitXor")
HARMLESS = ("equivalent", "message", "speed", "tuning")  # what a reason may begin with


@dataclass(frozen=True)
class Area:
    """Modules that the same tests judge.

    Args:
        modules: patterns below src/takeapart.
        tests: names of test files.
        uncompiled: those of modules with compiled kernels, which run as plain Python then.
    """

    modules: tuple[str, ...]
    tests: tuple[str, ...]
    uncompiled: tuple[str, ...] = ()


SEARCHES = ("lattice", "mcts", "baselines", "exact", "best_first", "refinement", "order_search", "determinism")
AREAS = {
    "verification": Area(
        ("verification/*.py",),
        (
            *("verification_tolerances", "verification_motion", "verification_holes", "verification"),
            *("carriers", "carrying"),
        ),
    ),
    "motion": Area(("motion/*.py",), (), ("motion_proofs", "motion")),
    "kernels": Area(
        ("robot/*.py",),
        ("motion_proofs", "self_collision", "robot", "kernels", "removal"),
        ("motion_proofs", "self_collision", "robot", "kernels"),
    ),
    "removal": Area(("removal/*.py",), ("bounds", "carrying", "removal", "planning")),
    "search": Area(("search/*.py",), SEARCHES, SEARCHES),
    "stability": Area(
        ("stability/connectors.py", "problem/*.py"), ("carriers", "stability", "carrying", "problem", "planning")
    ),
    "runs": Area(("planning/run*.py",), ("faults",)),
}


@dataclass(frozen=True)
class Mutant:
    """One small change.

    Args:
        area: name in AREAS.
        module: path below src/takeapart.
        line: of the change, from 1.
        operator, occurrence: as Cosmic Ray counts them.
        before, after: the changed line.
    """

    area: str
    module: str
    line: int
    operator: str
    occurrence: int
    before: str
    after: str

    @property
    def key(self) -> str:
        """Names the change in the file of reasons; no line numbers, which move."""
        return f"{self.module}: {self.before} -> {self.after}"


@dataclass(frozen=True)
class Fate:
    """What became of a mutant.

    Args:
        outcome: "killed", "timeout" or "survived".
        tests: that were to judge it.
    """

    mutant: Mutant
    outcome: str
    tests: int


def modules_of(area: Area) -> list[Path]:
    package = ROOT / "src" / "takeapart"
    return sorted(path for pattern in area.modules for path in package.glob(pattern) if path.name != "__init__.py")


def tests_of(area: Area, compiled: bool) -> list[str]:
    files = [f"tests/test_{name}.py" for name in (area.tests if compiled else area.uncompiled)]
    return [file for file in files if (ROOT / file).is_file()]


def is_compiled(module: Path) -> bool:
    return b"@compiled" in module.read_bytes()


def uninteresting_lines(source: str) -> set[int]:
    """Lines whose change shows nowhere: annotations, and decorators that only make things faster."""
    found: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        for note in (getattr(node, "annotation", None), getattr(node, "returns", None)):
            if isinstance(note, ast.expr) and not (isinstance(node, ast.AnnAssign) and node.value is not None):
                found.update(range(note.lineno, (note.end_lineno or note.lineno) + 1))
    for number, text in enumerate(source.splitlines(), 1):
        if text.strip().startswith(("@compiled", "@cache", "@lru_cache")):
            found.add(number)
    return found


def possible(area: str, module: Path) -> Iterator[list[Mutant]]:
    """Per place of a module the changes that can be made there."""
    source = module.read_text(encoding="utf-8")
    lines, skipped = source.splitlines(), uninteresting_lines(source)
    places: defaultdict[tuple[object, ...], list[tuple[str, int]]] = defaultdict(list)
    nodes = list(ast_nodes(get_ast(source)))
    for name in operator_names():
        if "BinaryOperator" in name and name.split("_")[1] in ARITHMETIC and name.split("_")[2] in BITWISE:
            continue
        try:
            operator = get_operator(name)()
        except TypeError:
            continue  # needs names of variables
        occurrence = 0
        for node in nodes:
            for position in operator.mutation_positions(node):
                if position[0][0] not in skipped:
                    places[tuple(position)].append((name, occurrence))
                occurrence += 1
    relative = str(module.relative_to(ROOT / "src" / "takeapart"))
    for place, changes in sorted(places.items(), key=str):
        line = place[0][0]  # type: ignore[index]
        yield [Mutant(area, relative, line, name, number, lines[line - 1].strip(), "") for name, number in changes]


def mutated(mutant: Mutant, source: str) -> str | None:
    """The changed source; None where it would not be another program."""
    changed = mutate_code(source, get_operator(mutant.operator)(), mutant.occurrence)
    if changed is None or changed == source:
        return None
    try:
        same = ast.dump(ast.parse(changed)) == ast.dump(ast.parse(source))
    except SyntaxError:
        return None
    return None if same else changed


def drawn(area: str, count: int, seed: int) -> list[Mutant]:
    """Changes at different places of an area, in the order in which they were drawn."""
    rng = np.random.default_rng([seed, list(AREAS).index(area)])
    places = [place for module in modules_of(AREAS[area]) for place in possible(area, module)]
    found: list[Mutant] = []
    for k in rng.permutation(len(places)):
        choice = places[k][int(rng.integers(len(places[k])))]
        source = (ROOT / "src" / "takeapart" / choice.module).read_text(encoding="utf-8")
        changed = mutated(choice, source)
        if changed is None:
            continue
        added = [row[1:] for row in difflib.ndiff(source.splitlines(), changed.splitlines()) if row.startswith("+ ")]
        removed = [row[1:] for row in difflib.ndiff(source.splitlines(), changed.splitlines()) if row.startswith("- ")]
        before, after = (" ".join(" ".join(rows).split()) for rows in (removed, added))
        found.append(Mutant(**{**asdict(choice), "before": before, "after": after or "nothing"}))
        if len(found) == count:
            break
    return found


def judged(tree: Tree, mutants: Sequence[Mutant], log: Path, minutes: float) -> None:
    """Tries one mutant after the other; every fate is written to the log as soon as it is known."""
    started = time.monotonic()
    known: dict[tuple[str, bool], Judges] = {}
    with log.open("a", encoding="utf-8") as file:
        for number, mutant in enumerate(mutants, 1):
            if time.monotonic() - started > 60 * minutes:
                print(f"time is over; {len(mutants) - number + 1} are left for the next call", flush=True)
                return
            compiled = not is_compiled(ROOT / "src" / "takeapart" / mutant.module)
            if (mutant.area, compiled) not in known:
                found = known[mutant.area, compiled] = tree.judges(
                    tests_of(AREAS[mutant.area], compiled), AREAS[mutant.area].modules, compiled, log.parent
                )
                way = "compiled" if compiled else "uncompiled"
                print(f"{mutant.area}, {way}: {len(found.seconds)} test functions", flush=True)
            judges = known[mutant.area, compiled]
            source = tree.source(mutant.module)
            changed = mutated(mutant, source)
            if changed is None:
                raise AssertionError(f"{mutant.key}: no such change")
            tests = judges.of(mutant.module, source, mutant.line)
            outcome = tree.trial(mutant.module, changed, tests, judges, compiled) if tests else "survived"
            file.write(json.dumps({**asdict(mutant), "outcome": outcome, "tests": len(tests)}) + "\n")
            file.flush()
            print(f"{number}/{len(mutants)} {outcome}: {mutant.module}:{mutant.line} ({len(tests)} tests)", flush=True)
            if outcome == "survived":
                print(f"    {mutant.before}\n    {mutant.after}", flush=True)


def sample_of(area: str, count: int, seed: int, kept: Path) -> list[Mutant]:
    """As `drawn`, which takes a while; the answer is kept for as long as the sources do not change."""
    digest = hashlib.sha256(f"{area} {count} {seed}".encode())
    for module in modules_of(AREAS[area]):
        digest.update(module.read_bytes())
    file = kept / f"sample-{digest.hexdigest()[:16]}.json"
    if not file.is_file():
        file.write_text(json.dumps([asdict(mutant) for mutant in drawn(area, count, seed)]), encoding="utf-8")
    return [Mutant(**values) for values in json.loads(file.read_text(encoding="utf-8"))]


def read_log(log: Path) -> dict[str, Fate]:
    """The latest fate of every mutant, by its key."""
    found = {}
    for row in log.read_text(encoding="utf-8").splitlines() if log.is_file() else []:
        values = json.loads(row)
        mutant = Mutant(**{each.name: values[each.name] for each in fields(Mutant)})
        found[mutant.key] = Fate(mutant, values["outcome"], values["tests"])
    return found


def read_reasons() -> dict[str, str]:
    """Why survivors are no gap of the tests, by the key of the mutant."""
    if not REASONS.is_file():
        return {}
    reasons: dict[str, str] = tomllib.loads(REASONS.read_text(encoding="utf-8"))
    for key, reason in reasons.items():
        assert reason.startswith(HARMLESS), f"{key}: a reason begins with one of {', '.join(HARMLESS)}"
    return reasons


def markdown(fates: Sequence[Fate], sample: int, reasons: dict[str, str]) -> tuple[str, float]:
    """The tables of the document, and the share of the changes in behaviour that the tests notice."""
    counts: defaultdict[str, Counter[str]] = defaultdict(Counter)
    survivors = []
    for fate in fates:
        reason = reasons.get(fate.mutant.key, "gap") if fate.outcome == "survived" else ""
        kind = fate.outcome if not reason else "gap" if reason == "gap" else "harmless"
        for name in (fate.mutant.area, "all"):
            counts[name][kind] += 1
        if reason:
            place = f"`{fate.mutant.module}:{fate.mutant.line}`"
            survivors.append([place, f"`{fate.mutant.before}`", f"`{fate.mutant.after}`", reason])
    rows = []
    for name in [*(name for name in AREAS if name in counts), "all"]:
        found = counts[name]
        noticed = found["killed"] + found["timeout"]
        share = noticed / max(noticed + found["gap"], 1)
        numbers = [sum(found.values()), found["killed"], found["timeout"], found["harmless"], found["gap"]]
        rows.append([name, *map(str, numbers), f"{100 * share:.0f} %"])
    head = ["area", "changes", "test failed", "never ended", "harmless", "not noticed", "noticed of those that matter"]
    cells = [[cell.replace("|", "\\|") for cell in row] for row in survivors]
    tried = f"{len(fates)} of the {sample} changes drawn were tried."
    return "\n\n".join(
        [tried, markdown_table(head, rows), markdown_table(["line", "before", "after", "why"], cells)]
    ), share


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mutants", type=int, default=210, help="changes in all, as many from every area")
    parser.add_argument("--areas", nargs="+", choices=list(AREAS), default=list(AREAS), help="only these")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=math.inf, help="then stop; the next call goes on")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "mutants", help="folder for the copy and the log")
    parser.add_argument("--survivors", action="store_true", help="try again what survived, by the log")
    parser.add_argument("--from-log", action="store_true", help="no tests, only the tables")
    parser.add_argument("--document", type=Path, help="file whose tables are replaced")
    options = parser.parse_args(arguments)
    options.work.mkdir(parents=True, exist_ok=True)
    log = options.work / "log.jsonl"
    each = -(-options.mutants // len(AREAS))
    sample = [mutant for area in options.areas for mutant in sample_of(area, each, options.seed, options.work)]
    known = read_log(log)
    if not options.from_log:
        again = [m for m in sample if m.key in known and known[m.key].outcome == "survived"]
        chosen = again if options.survivors else [m for m in sample if m.key not in known]
        judged(Tree(options.work / "tree"), chosen, log, options.minutes)
        known = read_log(log)
    fates = [known[mutant.key] for mutant in sample if mutant.key in known]
    tables, share = markdown(fates, len(sample), read_reasons())
    print(tables)
    if options.document:
        replace_between_markers(options.document, MARKER, tables)
    return 0 if share >= 0.9 and len(fates) == len(sample) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
