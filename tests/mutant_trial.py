"""A copy of the project where changes are tried: which tests execute a line, and whether they notice a change."""

from __future__ import annotations

import ast
import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LONGEST_TRIAL = 12.0  # s of the processor, of all tests of one change as they take without it
LONGEST_SECOND_LOOK = 60.0  # s of the processor, of all tests of a change that survived, and their fixtures


@dataclass(frozen=True)
class Judges:
    """Tests that judge the changes of an area.

    Args:
        seconds: of every test, without a change.
        fixtures: of every test.
        fixture_seconds: of every fixture.
        executed: per module below src/takeapart and line what executes it: names of tests, "fixture NAME", and "" for
            what runs when the tests are imported.
    """

    seconds: dict[str, float]
    fixtures: dict[str, list[str]]
    fixture_seconds: dict[str, float]
    executed: dict[str, dict[int, list[str]]]

    def of(self, module: str, source: str, line: int) -> list[str]:
        """Tests that may notice a change in a line, the quickest first: those that execute its statement, then those
        with fixtures that do, then, where imports do, all others; no more than LONGEST_TRIAL allows."""
        executed = self._executing(module, source, line)
        classes: list[list[str]] = [[], [], []]
        for name in sorted(self.seconds, key=self.seconds.__getitem__):
            by_fixture = any(f"fixture {fixture}" in executed for fixture in self.fixtures[name])
            classes[0 if name in executed else 1 if by_fixture else 2].append(name)
        chosen, total = [], 0.0
        for name in [*classes[0], *classes[1], *(classes[2] if "" in executed else [])]:
            total += self.seconds[name]
            if total > LONGEST_TRIAL:
                break
            chosen.append(name)
        return chosen

    def at_import(self, module: str, source: str, line: int) -> bool:
        return "" in self._executing(module, source, line)

    def allowed(self, name: str) -> float:
        """Seconds of the processor that a test takes together with its fixtures; much where it was not measured."""
        if name not in self.seconds:
            return LONGEST_SECOND_LOOK
        return self.seconds[name] + sum(self.fixture_seconds.get(fixture, 0.0) for fixture in self.fixtures[name])

    def _executing(self, module: str, source: str, line: int) -> set[str]:
        lines = self.executed.get(module, {})
        return {name for number in statement_lines(source, line) for name in lines.get(number, [])}


def statement_lines(source: str, line: int) -> range:
    """Lines of the smallest statement around a line; of one with a body only its head."""
    smallest = range(line, line + 1)
    size = sys.maxsize
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.stmt):
            body = getattr(node, "body", None)
            end = body[0].lineno if body else (node.end_lineno or node.lineno) + 1
            found = range(node.lineno, max(end, node.lineno + 1))
            if line in found and len(found) < size:
                smallest, size = found, len(found)
    return smallest


class Tree:
    """A copy of the project in which the changes are made."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()  # functions that are loaded know their file by its whole path
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

    def source(self, module: str) -> str:
        """Text of a module below src/takeapart."""
        return self._path(module).read_text(encoding="utf-8")

    def _path(self, module: str) -> Path:
        return self.folder / "src" / "takeapart" / module

    def process(self, arguments: Sequence[str], compiled: bool, kept: bool = True) -> subprocess.Popen[str]:
        """Starts `mutant_judge` in the copy.

        Args:
            kept: Python may keep what it compiles.
        """
        environment = {**os.environ, "PYTHONPATH": f"{self.folder / 'src'}", "HYPOTHESIS_DATABASE_FILE": os.devnull}
        environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        environment |= {} if compiled else {"NUMBA_DISABLE_JIT": "1"}
        environment |= {} if kept else {"PYTHONDONTWRITEBYTECODE": "1"}
        return subprocess.Popen(
            [sys.executable, "tests/mutant_judge.py", *arguments],
            cwd=self.folder,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,
        )

    def judges(self, files: Sequence[str], modules: Sequence[str], compiled: bool, kept: Path) -> Judges:
        """Tests of some files that pass, each quickly enough, and what they execute.

        Args:
            modules: patterns below src/takeapart of what is executed.
            kept: folder where the answer is kept for as long as neither these files nor these modules change.
        """
        digest = hashlib.sha256(repr((list(files), list(modules), compiled)).encode())
        sources = [path for pattern in modules for path in sorted((self.folder / "src" / "takeapart").glob(pattern))]
        for path in [*sources, *(self.folder / file for file in files), Path(__file__).with_name("mutant_judge.py")]:
            digest.update(path.read_bytes() if path.is_file() else b"")
        answer = kept / f"judges-{digest.hexdigest()[:16]}.json"
        if not answer.is_file():
            self.process(["measure", str(answer.resolve()), *modules, "--", *files], compiled).communicate()
        document = json.loads(answer.read_text(encoding="utf-8"))
        executed = {
            module: {int(line): names for line, names in lines.items()}
            for module, lines in document["executed"].items()
        }
        return Judges(document["seconds"], document["fixtures"], document["fixture_seconds"], executed)


class Bench:
    """Where the changes of an area are tried, one after the other.

    A test counts only if it passes alone without a change: one that leans on what others left behind is no judge.
    """

    def __init__(self, tree: Tree, files: Sequence[str], judges: Judges, compiled: bool) -> None:
        self.tree, self.files, self.judges, self.compiled = tree, list(files), judges, compiled
        self.proven: dict[str, bool] = {}
        self.serving: subprocess.Popen[str] | None = None

    def unmeasured(self, module: str) -> list[str]:
        """Tests, too long or too many to be measured, of the files that name a module."""
        stem = module.removesuffix(".py").replace("/", ".")
        named = [
            file
            for file in self.files
            if any(name in (self.tree.folder / file).read_text(encoding="utf-8") for name in (stem, _imported(stem)))
        ]
        names = self._answer(self._server(), "names")
        return [name for name in names if name not in self.judges.seconds and name.partition("::")[0] in named]

    def trial(self, module: str, changed: str, tests: Sequence[str], at_import: bool) -> tuple[str, str]:
        """Outcome of a change, "killed", "timeout" or "survived", and the test that noticed it."""
        chosen = [name for name in tests if self.proven.get(name, True)]
        while chosen:
            outcome, test = self._outcome(module, changed, chosen, at_import)
            if not test or self._passes_alone(test):
                return outcome, test
            chosen.remove(test)
        return "survived", ""

    def close(self) -> None:
        if self.serving is not None:
            self.serving.communicate()
            self.serving = None

    def _outcome(self, module: str, changed: str, tests: Sequence[str], at_import: bool) -> tuple[str, str]:
        path, original = self.tree._path(module), self.tree.source(module)
        times = path.stat()
        serving = self._server()
        path.write_text(changed, encoding="utf-8")
        try:
            if not at_import:
                outcome, test = self._ask(serving, tests, str(path), original, changed)
                if outcome != "not put in":
                    return outcome, test
            own = self.tree.process(["serve", "--", *self.files], self.compiled, kept=False)
            assert own.stdout is not None
            if not own.stdout.readline():
                own.communicate()
                return "killed", ""  # nothing can be imported
            found = self._ask(own, tests)
            own.communicate()
            return found
        finally:
            path.write_text(original, encoding="utf-8")
            os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))

    def _passes_alone(self, test: str) -> bool:
        if test not in self.proven:
            self.proven[test] = self._ask(self._server(), [test])[0] == "survived"
        return self.proven[test]

    def _server(self) -> subprocess.Popen[str]:
        if self.serving is None:
            self.serving = self.tree.process(["serve", "--", *self.files], self.compiled)
            assert self.serving.stdout is not None
            if not self.serving.stdout.readline():
                raise AssertionError(f"tests of {', '.join(self.files)} cannot be collected")
        return self.serving

    def _ask(
        self,
        process: subprocess.Popen[str],
        tests: Sequence[str],
        file: str = "",
        original: str = "",
        changed: str = "",
    ) -> tuple[str, str]:
        timed = [(name, self.judges.allowed(name)) for name in tests]
        order = {"tests": timed, "file": file, "original": original, "changed": changed, "seconds": LONGEST_SECOND_LOOK}
        outcome, test = self._answer(process, order)
        return outcome, test

    def _answer(self, process: subprocess.Popen[str], order: object) -> list[str]:
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write(json.dumps(order) + "\n")
        process.stdin.flush()
        answer: list[str] = json.loads(process.stdout.readline())
        return answer


def _imported(stem: str) -> str:
    """How a module is imported by the name of its package."""
    package, _, name = stem.rpartition(".")
    return f"from takeapart.{package} import {name}"
