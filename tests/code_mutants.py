"""Small wrong changes of the sources, and whether the tests near them notice: ``python tests/code_mutants.py``.

Cosmic Ray knows what can be changed in a line of Python; here is drawn what is changed, and by which tests it is
judged. For every area of the sources the same number of places is drawn, and for every place one of the possible
changes, but none that only puts an operator on bits into arithmetic, which any test would notice. A change is made in a
copy of the project, then the tests near it run there until the first fails. Where a module holds compiled kernels the
tests run uncompiled, those that are quick enough that way.

A change that no test notices is a survivor. Some survivors do the same as before, or differ only in a message or in
speed: `data/surviving_mutants.toml` says which and why. All others count against the tests.
"""

from __future__ import annotations

import argparse
import ast
import difflib
import json
import os
import shutil
import subprocess
import sys
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

from takeapart.experiments.tables import markdown_table, replace_between_markers

ROOT = Path(__file__).resolve().parents[1]
REASONS = ROOT / "tests" / "data" / "surviving_mutants.toml"
MARKER = "mutants"
LONGEST_TEST = 30  # s, of a test that judges; what takes longer uncompiled does not take part
ARITHMETIC = ("Add", "Sub", "Mul", "Div", "FloorDiv", "Mod", "Pow")
BITWISE = ("RShift", "LShift", "BitOr", "BitAnd", "BitXor")
HARMLESS = ("equivalent", "message", "speed", "tuning")  # what a reason may begin with


@dataclass(frozen=True)
class Area:
    """Modules that the same tests judge.

    Args:
        modules: patterns below src/takeapart.
        tests: names of test files, the quickest first.
    """

    modules: tuple[str, ...]
    tests: tuple[str, ...]


AREAS = {
    "motion": Area(("motion/*.py",), ("motion_proofs", "motion", "robot")),
    "kernels": Area(("robot/*.py",), ("motion_proofs", "self_collision", "robot", "kernels", "removal")),
    "removal": Area(("removal/*.py",), ("bounds", "carrying", "removal", "planning")),
    "search": Area(
        ("search/*.py",),
        ("lattice", "mcts", "baselines", "exact", "best_first", "refinement", "order_search", "determinism"),
    ),
    "stability": Area(("stability.py", "problem.py"), ("stability", "carrying", "problem", "planning")),
    "verification": Area(("verification*.py",), ("verification", "verification_holes", "self_collision")),
    "runs": Area(("run.py", "run_journal.py"), ("faults",)),
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
    """What became of a mutant: "killed", "timeout" or "survived"."""

    mutant: Mutant
    outcome: str


def modules_of(area: Area) -> list[Path]:
    package = ROOT / "src" / "takeapart"
    return sorted(path for pattern in area.modules for path in package.glob(pattern) if path.name != "__init__.py")


def tests_of(area: Area) -> list[str]:
    files = [f"tests/test_{name}.py" for name in area.tests]
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


class Tree:
    """A copy of the project in which the changes are made."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        listed = subprocess.run(
            ["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True, check=True
        )
        names = {name for name in listed.stdout.splitlines() if (ROOT / name).is_file()}
        for known in [path for path in folder.rglob("*.py") if str(path.relative_to(folder)) not in names]:
            known.unlink()
        for name in sorted(names):
            source, copy = ROOT / name, folder / name
            if not copy.is_file() or copy.read_bytes() != source.read_bytes():
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(source, copy)

    def run(self, tests: Sequence[str], compiled: bool, seconds: float, *more: str) -> int | None:
        """Exit code of the tests; None if the time is over."""
        environment = {**os.environ, "PYTHONPATH": f"{self.folder / 'src'}", "OMP_NUM_THREADS": "1"}
        environment |= {"OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
        environment |= {} if compiled else {"NUMBA_DISABLE_JIT": "1"}
        settings = "-q -p no:cacheprovider -p no:xdist --tb=no".split()
        process = subprocess.Popen(
            [sys.executable, "-m", "pytest", *settings, "-m", "not slow", *more, *tests],
            cwd=self.folder,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            return process.wait(seconds)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, 9)
            process.wait()
            return None

    def usable_tests(self, area: Area, compiled: bool) -> dict[str, float]:
        """Tests of an area that pass without a change within LONGEST_TEST, with their times, s; the quickest first."""
        report = self.folder / "report.xml"
        self.run(tests_of(area), compiled, 3600.0, f"--timeout={LONGEST_TEST}", f"--junitxml={report}")
        found = {}
        for case in ElementTree.parse(report).getroot().iter("testcase"):
            if not len(case):  # neither failed nor skipped
                file = case.get("classname", "").replace(".", "/")
                found[f"{file}.py::{case.get('name')}"] = float(case.get("time", 0.0))
        return dict(sorted(found.items(), key=lambda item: item[1]))

    def fate(self, mutant: Mutant, tests: dict[str, float], compiled: bool) -> Fate:
        """Makes the change, runs the tests, and takes the change back."""
        path = self.folder / "src" / "takeapart" / mutant.module
        original, times = path.read_text(encoding="utf-8"), path.stat()
        changed = mutated(mutant, original)
        assert changed is not None
        path.write_text(changed, encoding="utf-8")
        try:
            code = self.run(list(tests), compiled, 3 * sum(tests.values()) + 60, "-x", f"--timeout={4 * LONGEST_TEST}")
        finally:
            path.write_text(original, encoding="utf-8")
            os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
        return Fate(mutant, "timeout" if code is None else "killed" if code else "survived")


def judged(tree: Tree, mutants: Sequence[Mutant], log: Path) -> list[Fate]:
    """What becomes of all mutants; every fate is written to the log as soon as it is known."""
    usable: dict[tuple[str, bool], dict[str, float]] = {}
    fates = []
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("w", encoding="utf-8") as file:
        for number, mutant in enumerate(mutants, 1):
            compiled = not is_compiled(ROOT / "src" / "takeapart" / mutant.module)
            if (mutant.area, compiled) not in usable:
                found = usable[mutant.area, compiled] = tree.usable_tests(AREAS[mutant.area], compiled)
                way = "compiled" if compiled else "uncompiled"
                print(f"{mutant.area}, {way}: {len(found)} tests, {sum(found.values()):.0f} s", flush=True)
            fate = tree.fate(mutant, usable[mutant.area, compiled], compiled)
            fates.append(fate)
            file.write(json.dumps({**asdict(mutant), "outcome": fate.outcome}) + "\n")
            file.flush()
            print(f"{number}/{len(mutants)} {fate.outcome}: {mutant.module}:{mutant.line}", flush=True)
            if fate.outcome == "survived":
                print(f"    {mutant.before}\n    {mutant.after}", flush=True)
    return fates


def read_log(log: Path) -> list[Fate]:
    rows = [json.loads(row) for row in log.read_text(encoding="utf-8").splitlines()]
    return [Fate(Mutant(**{key: row[key] for key in row if key != "outcome"}), row["outcome"]) for row in rows]


def read_reasons() -> dict[str, str]:
    """Why survivors are no gap of the tests, by the key of the mutant."""
    if not REASONS.is_file():
        return {}
    reasons: dict[str, str] = tomllib.loads(REASONS.read_text(encoding="utf-8"))
    for key, reason in reasons.items():
        assert reason.startswith(HARMLESS), f"{key}: a reason begins with one of {', '.join(HARMLESS)}"
    return reasons


def markdown(fates: Sequence[Fate], reasons: dict[str, str]) -> tuple[str, float]:
    """The tables of the document, and the share of the changes in behaviour that the tests notice."""
    counts: defaultdict[str, Counter[str]] = defaultdict(Counter)
    survivors = []
    for fate in fates:
        reason = reasons.get(fate.mutant.key, "gap") if fate.outcome == "survived" else ""
        kind = fate.outcome if not reason else "gap" if reason == "gap" else "harmless"
        for name in (fate.mutant.area, "all"):
            counts[name][kind] += 1
        if reason:
            survivors.append([f"`{fate.mutant.module}`", f"`{fate.mutant.before}`", f"`{fate.mutant.after}`", reason])
    rows = []
    for name in [*(name for name in AREAS if name in counts), "all"]:
        found = counts[name]
        noticed = found["killed"] + found["timeout"]
        share = noticed / max(noticed + found["gap"], 1)
        numbers = [sum(found.values()), found["killed"], found["timeout"], found["harmless"], found["gap"]]
        rows.append([name, *map(str, numbers), f"{100 * share:.0f} %"])
    head = ["area", "changes", "test failed", "never ended", "harmless", "not noticed", "noticed of those that matter"]
    cells = [[cell.replace("|", "\\|") for cell in row] for row in survivors]
    tables = markdown_table(head, rows) + "\n\n" + markdown_table(["module", "before", "after", "why"], cells)
    return tables, share


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--each", type=int, default=30, help="changes per area")
    parser.add_argument("--areas", nargs="+", choices=list(AREAS), default=list(AREAS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "mutants", help="folder for the copy and the log")
    parser.add_argument("--survivors", action="store_true", help="only what survived the last time, by the log")
    parser.add_argument("--from-log", action="store_true", help="no tests, only the document")
    parser.add_argument("--document", type=Path, help="file whose tables are replaced")
    options = parser.parse_args(arguments)
    log = options.work / "log.jsonl"
    known = read_log(log) if (options.survivors or options.from_log) else []
    if options.from_log:
        fates = known
    else:
        again = [fate.mutant for fate in known if fate.outcome == "survived"]
        mutants = [mutant for area in options.areas for mutant in drawn(area, options.each, options.seed)]
        keys = {mutant.key for mutant in again}
        chosen = [mutant for mutant in mutants if mutant.key in keys] if options.survivors else mutants
        fates = judged(Tree(options.work / "tree"), chosen, options.work / "latest.jsonl")
        latest = {fate.mutant.key: fate for fate in fates}
        fates = [latest.get(fate.mutant.key, fate) for fate in known] if options.survivors else fates
        log.write_text(
            "".join(json.dumps({**asdict(fate.mutant), "outcome": fate.outcome}) + "\n" for fate in fates),
            encoding="utf-8",
        )
    tables, share = markdown(fates, read_reasons())
    print(tables)
    if options.document:
        replace_between_markers(options.document, MARKER, tables)
    return 0 if share >= 0.9 else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
