"""What is compiled before the work starts is all that the work needs, and machine code is not believed to fit."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from takeapart import compilation
from takeapart.cli import compile as cli_compile
from takeapart.cli.kernels import Unit, called_by, units
from takeapart.compilation import LeanKernel, compiled, compiled_apart, compiled_lean, has_machine_code
from takeapart.formats.files import load_workcell
from takeapart.model.assembly import Assembly, Part
from takeapart.model.geometry import Box, pose
from takeapart.model.plan import Grasp
from takeapart.problem import Standing
from takeapart.removal.bounds import EdgeBounds
from takeapart.removal.planner import RemovalOptions, RemovalPlanner
from takeapart.removal.result import Blocked, Counts, Effort, Removal
from takeapart.search.exact import ExactOptions, exact
from takeapart.search.result import Budget


@compiled_lean
def twice(x: float) -> float:
    return 2.0 * x


@compiled_apart
def thrice(x: float) -> float:
    return x + twice(x)


@compiled
def six_times(x: float) -> float:
    return twice(thrice(x))


def test_kernels_call_each_other_and_python_calls_all() -> None:
    assert (six_times(1.5), thrice(1.5), twice(1.5)) == (9.0, 4.5, 3.0)
    assert isinstance(twice, LeanKernel) and vars(twice)["__name__"] == "twice"
    assert called_by(six_times.py_func) == {twice.py_func, thrice.py_func}  # type: ignore[attr-defined]


def test_machine_code_is_of_one_processor_and_of_types(monkeypatch: pytest.MonkeyPatch) -> None:
    import numba

    dispatcher: Any = six_times
    dispatcher(1.0)
    assert has_machine_code(dispatcher, (numba.float64,))
    assert not has_machine_code(dispatcher, (numba.complex128,))
    codegen = dispatcher.targetctx.codegen()
    triple, _, features = codegen.magic_tuple()
    monkeypatch.setattr(type(codegen), "magic_tuple", lambda self: (triple, "another-processor", features))
    assert not has_machine_code(dispatcher, (numba.float64,))


def test_a_damaged_index_is_no_machine_code() -> None:
    import numba

    dispatcher: Any = six_times
    dispatcher(1.0)
    index = Path(dispatcher._cache._cache_file._index_path)
    content = index.read_bytes()
    index.write_bytes(content[:-5])
    assert not has_machine_code(dispatcher, (numba.float64,))
    index.write_bytes(content)
    assert has_machine_code(dispatcher, (numba.float64,))


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_machine_code_that_was_cut_off_is_compiled_again(share: float) -> None:
    dispatcher: Any = six_times
    dispatcher(1.0)
    cache = dispatcher._cache._cache_file
    key = dispatcher._cache._index_key(dispatcher.signatures[0], dispatcher.targetctx.codegen())
    file = Path(cache._data_path(cache._load_index()[key]))
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    again: Any = compiled(six_times.py_func)  # type: ignore[attr-defined]
    assert again(1.5) == 9.0
    assert len(file.read_bytes()) > 0.9 * len(content)


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("TAKEAPART_CACHE", str(tmp_path))
    compilation._group_folder.cache_clear()
    yield
    compilation._group_folder.cache_clear()


@pytest.mark.usefixtures("empty_cache")
def test_the_note_that_nothing_is_missing_holds_until_something_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = compilation._group_folder(compilation.GROUPS[0]) / "kernel.nbc"
    kept.write_bytes(b"code")
    assert not cli_compile._is_noted(True)
    cli_compile._note_complete(True)
    assert cli_compile._is_noted(True) and not cli_compile._is_noted(False)
    kept.write_bytes(b"other code")
    assert not cli_compile._is_noted(True)
    cli_compile._note_complete(True)
    kept.unlink()
    assert not cli_compile._is_noted(True)
    cli_compile._note_complete(True)
    codegen = type(compilation.cpu_target.target_context.codegen())
    monkeypatch.setattr(codegen, "magic_tuple", lambda self: ("another", "processor", ""))
    assert not cli_compile._is_noted(True)


class TwoParts:
    """Two parts that leave in any order, at a fixed length; no geometry."""

    root = 0b11
    freedom = ((0,), (0,))  # with it the enumeration of states is the compiled one

    def __init__(self) -> None:
        self.counts, self.edge_bounds, self.standing = Counts(), EdgeBounds([0.0, 0.0]), Standing()

    def candidates(self, state: int) -> Sequence[int]:
        return [part for part in range(2) if state >> part & 1]

    def hindrance(self, state: int, part: int) -> None:
        return None

    def upper(self, state: int, part: int) -> float:
        return math.inf

    def lower(self, state: int, part: int) -> float:
        return 0.0

    def remove(self, state: int, part: int, effort: Effort) -> Removal | Blocked:
        grasp = Grasp(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), 0.02)
        return Removal(part, grasp, np.zeros((2, 1)), np.zeros((2, 7)), 1.0, 0)


def plan_one_removal() -> None:
    """All stages of the planner, for a loose bar near the goal that stands in the way."""
    # Without tries for straight paths and bends, the trees have to find the path.
    workcell, options = load_workcell("panda"), RemovalOptions(straight_attempts=0, bend_attempts=0)
    base = workcell.T_world_base[:3, 3]
    towards = workcell.goal[:2] - base[:2]
    for turn in (0.6, -0.6, 1.2):  # rad, around the arm's base, until a place is reached
        rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        x, y = base[:2] + rotation @ (towards / np.linalg.norm(towards)) * 0.45
        bar = Part("bar", Box((0.02, 0.16, 0.02)), pose([x, y, base[2] + 0.2]), 0.1)
        planner = RemovalPlanner(Assembly("bar", (bar,)), workcell, options)
        planner.plan(0, 1, rng=np.random.default_rng(0))
        if planner.counts.motion_plans:
            return
    pytest.fail("no place is reached")


def kernels_of_the_planner() -> Iterator[tuple[Any, Any]]:
    """All kernels with the dispatcher that Python calls."""
    for name, module in list(sys.modules.items()):
        if name.startswith(("takeapart.robot.", "takeapart.motion.", "takeapart.search.")):
            for member in vars(module).values():
                if hasattr(member, "py_func") and member.py_func.__module__ == name:
                    yield member.py_func, member.called if isinstance(member, LeanKernel) else member


def test_what_is_compiled_beforehand_is_what_planning_needs() -> None:
    plan_one_removal()
    exact(TwoParts(), ExactOptions(), Budget())
    listed = {unit.dispatcher: unit for unit in units(orders=True).values()}
    contained = set().union(*(called_by(unit.function) for unit in listed.values()))
    left_out = [
        f"{function.__module__}.{function.__name__}"
        for function, dispatcher in kernels_of_the_planner()
        if dispatcher.signatures and dispatcher not in listed and function not in contained
    ]
    # Other tests of this process may have called kernels that no command calls.
    assert not set(left_out) & {"takeapart.motion.smooth.shorten", "takeapart.motion.rrt.rrt_connect"}
    used = [unit for unit in listed.values() if unit.dispatcher.signatures and not unit.inner]
    assert {"motion.rrt.rrt_connect", "motion.smooth.shorten", "robot.hand.hand_masks"} <= {u.name for u in used}
    for unit in used:
        assert unit.signature in unit.dispatcher.signatures, unit.name


def test_what_stands_in_others_is_not_missing_where_they_are_there(monkeypatch: pytest.MonkeyPatch) -> None:
    def there(dispatcher: Any, signature: Any) -> bool:
        return next(unit for unit in units(orders=True).values() if unit.dispatcher is dispatcher).name in have

    monkeypatch.setattr("takeapart.compilation.has_machine_code", there)
    every = units(orders=True)
    have = {name for name, unit in every.items() if not unit.inner}
    assert cli_compile.missing(orders=True) == {}
    have.remove("motion.rrt.rrt_connect")
    left = set(cli_compile.missing(orders=True))
    assert {"motion.rrt.rrt_connect", "motion.scene.piece_free", "robot.kernels.placed"} <= left
    assert not left & {"robot.separation.separation", "robot.kernels.collect_placed"}
    have.clear()
    assert set(cli_compile.TABLES_NEED) <= set(cli_compile.missing(orders=False)), "else tables are filled in silence"


def test_what_others_contain_is_compiled_before_them(monkeypatch: pytest.MonkeyPatch) -> None:
    from concurrent.futures import ThreadPoolExecutor

    done: list[str] = []
    every = units(orders=True)

    def note_down(name: str) -> None:
        inside = {unit.name for unit in every.values() if unit.function in called_by(every[name].function)}
        assert inside <= set(done)
        done.append(name)

    monkeypatch.setattr(cli_compile, "_open_pool", lambda count: ThreadPoolExecutor(count))
    monkeypatch.setattr(cli_compile, "compile_unit", note_down)
    monkeypatch.setattr(cli_compile, "_load", lambda workcell: done.append("tables"))
    shares: list[float | None] = []
    cli_compile._compile(every, load_workcell("panda"), lambda text, share: shares.append(share))
    assert set(done) == {*every, "tables"} and len(done) == len(every) + 1
    assert done.index("tables") > max(done.index(name) for name in cli_compile.TABLES_NEED)
    assert shares == sorted(shares, key=float) and shares[0] == 0.0  # type: ignore[arg-type]


def test_heavy_libraries_are_imported_only_where_they_are_used() -> None:
    program = (
        "import sys, takeapart.planning\n"
        "from takeapart.robot.ik import InverseKinematics\n"
        "from takeapart.robot.loading import load_robot\n"
        "from takeapart.formats.files import load_workcell\n"
        "load_robot(load_workcell('panda')) if sys.argv[1] == 'robot' else None\n"
        "InverseKinematics(load_robot(load_workcell('panda'))) if sys.argv[1] == 'robot' else None\n"
        "print(*sys.modules)"
    )
    for what, absent in (
        ("planning", {"trimesh", "ssik", "sympy", "mpmath", "scipy.signal", "scipy.stats", "mujoco", "torch", "rich"}),
        ("robot", {"sympy.core", "mpmath.libmp", "scipy.signal", "scipy.stats", "scipy.optimize", "mujoco", "torch"}),
    ):
        load = subprocess.run([sys.executable, "-c", program, what], capture_output=True, text=True, check=True)
        assert not set(load.stdout.split()) & absent, what


def test_every_unit_has_a_name_of_its_own() -> None:
    assert all(isinstance(unit, Unit) and name == unit.name for name, unit in units(orders=True).items())
    assert set(units(orders=False)) < set(units(orders=True))
