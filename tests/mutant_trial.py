"""Runs tests in a copy of the project: which of them execute a line, and whether they notice a change."""

from __future__ import annotations

import ast
import hashlib
import json
import os
import resource
import shutil
import subprocess
import sys
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from xml.etree import ElementTree

from coverage import CoverageData

ROOT = Path(__file__).resolve().parents[1]
LONGEST_TEST = 60  # s, of a test that judges; what takes longer uncompiled does not take part
LONGEST_TRIAL = 240.0  # s, of all tests of one change

COVERAGE = """[run]
include = {modules}
dynamic_context = test_function
data_file = {data}
"""


@dataclass(frozen=True)
class Judges:
    """Tests that judge the changes of an area.

    Args:
        seconds: of every test function, all its cases together, without a change; the quickest first.
        executed: per module below src/takeapart and line the functions that execute it; "" stands for imports and for
            fixtures, which serve whatever test comes.
    """

    seconds: dict[str, float]
    executed: dict[str, dict[int, list[str]]] = field(default_factory=dict)

    def of(self, module: str, source: str, line: int) -> list[str]:
        """Test functions that may notice a change in a line, the quickest first: those that execute its statement,
        then, where imports or fixtures do, all others; no more than LONGEST_TRIAL allows."""
        executed: set[str] = set()
        for number in statement_lines(source, line):
            executed.update(self.executed.get(module, {}).get(number, []))
        ordered = [name for name in self.seconds if name in executed]
        if "" in executed:
            ordered += [name for name in self.seconds if name not in executed]
        chosen, total = [], 0.0
        for name in ordered:
            total += self.seconds[name]
            if total > LONGEST_TRIAL:
                break
            chosen.append(name)
        return chosen


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

    def _run(self, command: Sequence[str], compiled: bool, seconds: float) -> int | None:
        """Exit code of a command in the copy; None if it takes more processor time, or ten times that on the wall."""
        environment = {**os.environ, "PYTHONPATH": f"{self.folder / 'src'}", "PYTHONDONTWRITEBYTECODE": "1"}
        environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "HYPOTHESIS_DATABASE_FILE": os.devnull}
        environment |= {} if compiled else {"NUMBA_DISABLE_JIT": "1"}
        process = subprocess.Popen(
            [sys.executable, *command],
            cwd=self.folder,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        limit = int(seconds)
        resource.prlimit(process.pid, resource.RLIMIT_CPU, (limit, limit + 1))
        try:
            code = process.wait(10 * seconds)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, 9)
            process.wait()
            return None
        return None if code < 0 else code

    def source(self, module: str) -> str:
        """Text of a module below src/takeapart."""
        return (self.folder / "src" / "takeapart" / module).read_text(encoding="utf-8")

    def judges(self, files: Sequence[str], modules: Sequence[str], compiled: bool, kept: Path) -> Judges:
        """Test functions of some files all cases of which pass, each within LONGEST_TEST, and what they execute.

        Args:
            modules: patterns below src/takeapart of what is executed.
            kept: folder where the answer is kept for as long as neither these files nor these modules change.
        """
        digest = hashlib.sha256(repr((list(files), list(modules), compiled, LONGEST_TEST)).encode())
        sources = [path for pattern in modules for path in sorted((self.folder / "src" / "takeapart").glob(pattern))]
        for path in [*sources, *(self.folder / file for file in files)]:
            digest.update(path.read_bytes() if path.is_file() else b"")
        answer = kept / f"judges-{digest.hexdigest()[:16]}.json"
        if answer.is_file():
            document = json.loads(answer.read_text(encoding="utf-8"))
            executed = {
                module: {int(line): names for line, names in lines.items()}
                for module, lines in document["executed"].items()
            }
            return Judges(document["seconds"], executed)
        data, settings, report = kept / "coverage.data", kept / "coverage.ini", kept / "report.xml"
        data.unlink(missing_ok=True)
        included = ",".join(f"src/takeapart/{pattern}" for pattern in modules)
        settings.write_text(COVERAGE.format(data=data, modules=included), encoding="utf-8")
        command = ["-m", "coverage", "run", f"--rcfile={settings}", "-m", "pytest", "-q", "-p", "no:cacheprovider"]
        command += ["-p", "no:xdist", "-m", "not slow", f"--timeout={LONGEST_TEST}", f"--junitxml={report}", *files]
        self._run(command, compiled, 3600.0)
        found = Judges(_seconds(report), _executed(data, self.folder))
        answer.write_text(json.dumps(asdict(found)), encoding="utf-8")
        if self._run(["-m", "pytest", "-q", "--collect-only", *found.seconds], compiled, 600.0) != 0:
            raise AssertionError(f"tests of {', '.join(files)} are not found again by their names")
        return found

    def trial(self, module: str, changed: str, tests: Sequence[str], judges: Judges, compiled: bool) -> str:
        """Makes a change, runs the tests until one fails, takes the change back: "killed", "timeout" or "survived"."""
        path = self.folder / "src" / "takeapart" / module
        original, times = self.source(module), path.stat()
        path.write_text(changed, encoding="utf-8")
        command = ["-m", "pytest", "-q", "-x", "--tb=no", "-p", "no:cacheprovider", "-p", "no:xdist", "-m", "not slow"]
        seconds = 4 * sum(judges.seconds[name] for name in tests) + 90
        try:
            code = self._run([*command, f"--timeout={10 * LONGEST_TEST}", *tests], compiled, seconds)
        finally:
            path.write_text(original, encoding="utf-8")
            os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
        return "timeout" if code is None else "killed" if code else "survived"


def _seconds(report: Path) -> dict[str, float]:
    """Time of every test function, all cases together, s; none of which a case failed or was skipped."""
    total: defaultdict[str, float] = defaultdict(float)
    unusable = set()
    for case in ElementTree.parse(report).getroot().iter("testcase"):
        name = f"{case.get('classname', '').replace('.', '/')}.py::{case.get('name', '').partition('[')[0]}"
        total[name] += float(case.get("time", 0.0))
        if len(case):
            unusable.add(name)
    return dict(sorted(((k, v) for k, v in total.items() if k not in unusable), key=lambda item: item[1]))


def _executed(data: Path, folder: Path) -> dict[str, dict[int, list[str]]]:
    """Per module and line the test functions that execute it, by their names for pytest."""
    coverage = CoverageData(str(data))
    coverage.read()
    package = folder / "src" / "takeapart"
    found: dict[str, dict[int, list[str]]] = {}
    for file in coverage.measured_files():
        lines = coverage.contexts_by_lineno(file)
        found[str(Path(file).relative_to(package))] = {
            line: [_name(context) for context in contexts] for line, contexts in lines.items()
        }
    return found


def _name(context: str) -> str:
    file, _, function = context.rpartition(".")
    return f"tests/{file.rpartition('.')[2]}.py::{function}" if file else ""
