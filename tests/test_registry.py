"""The registry of searches: all of them can be run by it, and no other list of their names stands anywhere."""

from __future__ import annotations

import ast
import inspect
import math
from dataclasses import is_dataclass
from pathlib import Path

import numpy as np
import pytest

import takeapart
from synthetic import exact_guide, random_problem
from takeapart.cli.search_options import option_values, options_of
from takeapart.experiments.compared import COMPARED, PAPER
from takeapart.model.errors import InputError, TakeapartError
from takeapart.planning import PlanningOptions
from takeapart.search.registry import SEARCHES, searches_that_take
from takeapart.search.result import Budget

PACKAGE = Path(takeapart.__file__).parent
SCRIPTS = Path(__file__).parents[1] / "benchmarks"


@pytest.mark.parametrize("name", SEARCHES)
def test_every_search_is_what_its_entry_says(name: str) -> None:
    entry = SEARCHES[name]
    function, options = entry.load()
    assert entry.name == name and is_dataclass(options)
    parameters = inspect.signature(function).parameters
    assert list(parameters)[:3] == ["problem", "options", "budget"] and set(entry.takes) == set(list(parameters)[3:])


@pytest.mark.parametrize("name", SEARCHES)
def test_every_search_runs_by_its_entry(name: str) -> None:
    entry, problem = SEARCHES[name], random_problem(6, 1)
    heard: list[object] = []
    seen: list[object] = []
    budget = Budget(episodes=20) if entry.anytime else Budget()
    result = entry.run(
        problem,
        entry.options(),
        budget,
        np.random.default_rng(0),
        heard.append,
        exact_guide(problem),
        lambda *transition: seen.append(transition),
    )
    assert {removal.part for removal in result.removals} == set(range(6))
    assert heard and bool(seen) == ("observe" in entry.takes)
    optimum = problem.optimum()[0]
    assert result.length >= optimum - 1e-9
    if entry.proves:
        assert result.length == pytest.approx(optimum) and result.sequence_bound == pytest.approx(optimum)


@pytest.mark.parametrize("name", SEARCHES)
def test_every_search_tells_that_there_is_no_order(name: str) -> None:
    entry = SEARCHES[name]
    result = entry.run(random_problem(5, 1, feasible=False), entry.options(), Budget(), np.random.default_rng(0))
    assert result.infeasible and math.isinf(result.length) and result.refusals


def test_options_of_another_search_are_refused() -> None:
    with pytest.raises(InputError, match=r"search_options: BeamOptions; the search 'exact' takes ExactOptions"):
        PlanningOptions(search_options=SEARCHES["beam"].options())
    assert PlanningOptions(search="beam").of_search() == SEARCHES["beam"].options()


def test_what_is_compared_follows_from_the_registry() -> None:
    assert {*COMPARED, "random"} == {*SEARCHES, PAPER} and COMPARED.index(PAPER) == COMPARED.index("mcts") + 1
    assert set(searches_that_take("listen")) == set(SEARCHES)


def names_in(node: ast.AST) -> set[str]:
    """Search names among the elements of a literal: a tuple, list, set, the keys of a dictionary, or Literal[...]."""
    elements: list[ast.expr | None] = []
    if isinstance(node, ast.Tuple | ast.List | ast.Set):
        elements = list(node.elts)
    elif isinstance(node, ast.Dict):
        elements = list(node.keys)
    values = [each.value for each in elements if isinstance(each, ast.Constant)]
    return {value for value in values if isinstance(value, str) and value in SEARCHES}


def test_no_other_list_of_searches_stands_anywhere() -> None:
    found = [
        f"{file.name}:{node.lineno}"
        for file in [*PACKAGE.rglob("*.py"), *SCRIPTS.glob("*.py")]
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.expr) and len(names_in(node)) > 2
    ]
    assert found == []
    assert len(names_in(ast.parse("a = ('exact', 'mcts', 'beam')").body[0].value)) == 3  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", SEARCHES)
def test_every_plain_option_can_be_set_on_the_command_line(name: str) -> None:
    before = option_values(SEARCHES[name].options())
    assert any(option.endswith("attempts") for option in before)
    for option, value in before.items():
        other = {bool: lambda: not value, str: lambda: "paper", float: lambda: value / 2 or 0.5}.get(
            type(value), lambda: value + 1
        )()
        made = options_of(name, 0, settings=(f"{option}={str(other).lower()}",)).of_search()
        assert option_values(made) == before | {option: other}


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("explore=1", r"--set: mcts has no option 'explore'; valid: exploration, search_budget, attempts, memory, "),
        ("exploration=far", r"--set exploration: 'far'; must be a number"),
        ("exploration=nan", r"--set exploration: 'nan'; must be a number"),
        ("exploration", r"--set exploration: ''; must be a number"),
        ("attempts=1.5", r"--set attempts: '1.5'; must be a whole number"),
        ("epsilon=2", r"mcts.epsilon: 2.0; must be from 0 to 1"),
        ("memory=none", r"unknown memory 'none'; valid: library, paper"),
    ],
)
def test_settings_that_cannot_be_are_told(setting: str, message: str) -> None:
    with pytest.raises(TakeapartError, match=message):
        options_of("mcts", 0, settings=(setting,))
