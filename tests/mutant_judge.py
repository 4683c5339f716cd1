"""The process that judges changes: it imports the tests once, and tries every change in a fork of itself.

Called by `mutant_trial` in the copy of the project: ``python tests/mutant_judge.py measure ANSWER PATTERN.. -- FILE..``
tells what every test executes; ``python tests/mutant_judge.py serve -- FILE..`` answers one line of JSON on standard
output for every one on standard input.
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import resource
import signal
import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import CodeType, FrameType, FunctionType
from typing import Any

import hypothesis
import pytest
from coverage import Coverage

LONGEST_TEST = 4.0  # s of the processor, of a test that judges; what takes longer does not take part
LONGEST_FIXTURE = 6.0  # s of the processor
LONGEST_MEASURE = 45.0  # s of the processor, of all tests of an area; files share it, and what they leave over
PATIENCE = 4.0  # a test that takes so many times what it takes without a change, and MORE_PATIENCE, never ends
MORE_PATIENCE = 4.0  # s of the processor
ON_THE_WALL = 40.0  # s, as many for every one of the processor
NEVER_ENDS, NOT_PUT_IN = 3, 4  # exit codes


class TooLong(BaseException):
    """A test or a fixture has taken more time than it may."""


@contextlib.contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Raises TooLong in what takes more of the processor."""

    def stop(signum: int, frame: FrameType | None) -> None:
        raise TooLong

    signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds, 1.0)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


class Judge:
    """What both ways share, as a plug-in of pytest."""

    def pytest_collection(self) -> None:
        """Machines are busy: no test fails because an example took long."""
        repeatable = hypothesis.settings.get_profile("repeatable")
        checks = list(hypothesis.HealthCheck)
        hypothesis.settings.register_profile("judging", repeatable, deadline=None, suppress_health_check=checks)
        hypothesis.settings.load_profile("judging")


class Measuring(Judge):
    """Runs every test once and tells how long it takes and which lines it executes."""

    def __init__(self, modules: Sequence[str], answer: Path) -> None:
        self.package = Path.cwd() / "src" / "takeapart"
        self.coverage = Coverage(
            data_file=None, config_file=False, messages=False, include=[str(self.package / name) for name in modules]
        )
        self.answer = answer
        self.context: list[str] = []
        self.fixtures: dict[str, list[str]] = {}
        self.seconds: dict[str, float] = {}
        self.fixture_seconds: dict[str, float] = {}
        self.endless: set[str] = set()
        self.outcomes: defaultdict[str, list[str]] = defaultdict(list)
        self.coverage.start()

    @contextlib.contextmanager
    def _executing(self, name: str) -> Iterator[None]:
        self.context.append(name)
        self.coverage.switch_context(name)
        try:
            yield
        finally:
            self.context.pop()
            self.coverage.switch_context(self.context[-1] if self.context else "pytest")

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Any:
        started = time.process_time()
        try:
            with self._executing(f"fixture {fixturedef.argname}"):
                return (yield)
        except TooLong:
            self.endless.add(fixturedef.argname)
            raise
        finally:
            seconds = time.process_time() - started
            self.fixture_seconds[fixturedef.argname] = max(seconds, self.fixture_seconds.get(fixturedef.argname, 0.0))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self) -> Any:
        with at_most(LONGEST_FIXTURE):
            return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Any:
        started = time.process_time()
        try:
            with self._executing(item.nodeid), at_most(LONGEST_TEST):
                return (yield)
        finally:
            self.seconds[item.nodeid] = time.process_time() - started

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.outcomes[report.nodeid].append(report.outcome)

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        self.coverage.switch_context("pytest")
        started = time.process_time()
        session.items[:] = first_cases_first(session.items)
        files = [item.nodeid.partition("::")[0] for item in session.items]
        left, too_long, ends = list(dict.fromkeys(files)), set(), 0.0
        for k, item in enumerate(session.items):
            function = item.nodeid.partition("[")[0]
            used = time.process_time() - started
            if files[k] in left:
                ends = used + (LONGEST_MEASURE - used) / len(left)
                left.remove(files[k])
            if used > ends or function in too_long or self.endless & set(getattr(item, "fixturenames", [])):
                continue  # other cases of a long test will take as long
            session._setupstate.teardown_exact(item)  # what the tests left out would have torn down
            after = session.items[k + 1] if k + 1 < len(session.items) else None
            with contextlib.suppress(TooLong):
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
            if self.seconds.get(item.nodeid, 0.0) > LONGEST_TEST:
                too_long.add(function)
            self.fixtures[item.nodeid] = list(getattr(item, "fixturenames", []))
        self.coverage.stop()
        self.answer.write_text(json.dumps(self._found()), encoding="utf-8")
        return True

    def _found(self) -> dict[str, object]:
        usable = {name: seconds for name, seconds in self.seconds.items() if self.outcomes[name] == ["passed"] * 3}
        data = self.coverage.get_data()
        executed = {}
        for file in data.measured_files():
            lines = data.contexts_by_lineno(file)
            executed[str(Path(file).relative_to(self.package))] = lines
        fixtures = {name: self.fixtures[name] for name in usable}
        times = {"seconds": usable, "fixture_seconds": self.fixture_seconds}
        return {**times, "fixtures": fixtures, "executed": executed}


class Serving(Judge):
    """Tries changes, each in a fork, as they are asked for."""

    def __init__(self) -> None:
        self.asked, self.answers = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
        os.dup2(2, 1)

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        items = {item.nodeid: item for item in session.items}
        self._answer("ready")
        for line in self.asked:
            order = json.loads(line)
            if order == "names":
                self._answer(*items)
                continue
            chosen = [(items[name], seconds) for name, seconds in order["tests"]]
            self._answer(*self._trial(session, chosen, order))
        return True

    def _answer(self, *answer: str) -> None:
        self.answers.write(json.dumps(answer) + "\n")
        self.answers.flush()

    def _trial(
        self, session: pytest.Session, chosen: Sequence[tuple[pytest.Item, float]], order: dict[str, Any]
    ) -> tuple[str, str]:
        """Outcome of a change, and the test that noticed it."""
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            os.setsid()
            code = 1
            try:
                code = self._tests(session, chosen, order, writing)
            finally:
                os._exit(code)
        _, status = os.waitpid(child, 0)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)  # workers that a test has left behind
        os.close(writing)
        with os.fdopen(reading) as file:
            begun = file.read().splitlines()
        code = os.waitstatus_to_exitcode(status)
        if code == 0:
            return "survived", ""
        if code == NOT_PUT_IN:
            return "not put in", ""
        never = code in (NEVER_ENDS, -signal.SIGALRM, -signal.SIGXCPU, -signal.SIGKILL)
        return "timeout" if never else "killed", begun[-1] if begun else ""

    def _tests(
        self, session: pytest.Session, chosen: Sequence[tuple[pytest.Item, float]], order: dict[str, Any], writing: int
    ) -> int:
        """In the fork: runs the tests until one fails; exit code."""
        os.dup2(os.open(os.devnull, os.O_RDWR), 0)
        seconds = sum(PATIENCE * each + MORE_PATIENCE for _, each in chosen) + LONGEST_FIXTURE
        resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds) + 5))
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(int(min(ON_THE_WALL * seconds, 1800)))
        if order["changed"] and not put_in(order["file"], order["original"], order["changed"]):
            return NOT_PUT_IN
        signal.signal(signal.SIGPROF, lambda signum, frame: os._exit(NEVER_ENDS))
        for k, (item, each) in enumerate(chosen):
            if time.process_time() > order["seconds"]:
                break
            os.write(writing, f"{item.nodeid}\n".encode())
            after = chosen[k + 1][0] if k + 1 < len(chosen) else None
            signal.setitimer(signal.ITIMER_PROF, PATIENCE * each + MORE_PATIENCE)
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
            if session.testsfailed:
                return 1
        return 0


def first_cases_first(items: Sequence[pytest.Item]) -> list[pytest.Item]:
    """File by file the first cases of all functions, then the second ones, and so on."""
    ordered: defaultdict[str, list[tuple[int, pytest.Item]]] = defaultdict(list)
    seen: defaultdict[str, int] = defaultdict(int)
    for item in items:
        file, function = item.nodeid.partition("::")[0], item.nodeid.partition("[")[0]
        ordered[file].append((seen[function], item))
        seen[function] += 1
    return [item for cases in ordered.values() for _, item in sorted(cases, key=lambda case: case[0])]


def put_in(file: str, original: str, changed: str) -> bool:
    """Puts changed code into the functions of a module that is imported already; False where that does not suffice."""
    pairs: dict[tuple[str, int], CodeType] = {}
    if not _paired(compile(original, file, "exec"), compile(changed, file, "exec"), pairs):
        return False
    for found in gc.get_objects():
        if isinstance(found, FunctionType) and found.__code__.co_filename == file:
            new = pairs.get((found.__code__.co_qualname, found.__code__.co_firstlineno))
            if new is not None:
                found.__code__ = new
    return bool(pairs)


def _paired(old: CodeType, new: CodeType, pairs: dict[tuple[str, int], CodeType]) -> bool:
    """Notes the code of functions that differs; False if that of modules or classes does."""
    inner = [[each for each in code.co_consts if isinstance(each, CodeType)] for code in (old, new)]
    if [each.co_name for each in inner[0]] != [each.co_name for each in inner[1]]:
        return False
    if old.co_flags & 1:  # optimized: the code of a function
        if old.co_freevars != new.co_freevars:
            return False
        if old != new:
            pairs[old.co_qualname, old.co_firstlineno] = new
    else:
        plain = [[each for each in code.co_consts if not isinstance(each, CodeType)] for code in (old, new)]
        if old.co_code != new.co_code or old.co_names != new.co_names or repr(plain[0]) != repr(plain[1]):
            return False
    for one, other in zip(*inner, strict=True):
        if not old.co_flags & 1 and one.co_name in ("<listcomp>", "<dictcomp>", "<setcomp>", "<genexpr>"):
            if one != other:
                return False
        elif not _paired(one, other, pairs):
            return False
    return True


def main(arguments: Sequence[str]) -> int:
    k = arguments.index("--")
    way, files = arguments[0], arguments[k + 1 :]
    judge = Measuring(arguments[2:k], Path(arguments[1])) if way == "measure" else Serving()
    options = ["-q", "--tb=no", "-p", "no:cacheprovider", "-p", "no:xdist", "-m", "not slow"]
    return int(pytest.main([*options, *files], plugins=[judge]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
