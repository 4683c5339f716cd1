"""All searches by name. Command line, planning, comparison and experiments read this, and know no search by themselves.

A new search is a file in this folder with a function and its options, and an entry here. Nothing is loaded before a
search runs, so that the command line can list them all at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

    from takeapart.problem import Guide, Problem
    from takeapart.search.result import Budget, ProgressListener, SearchResult
    from takeapart.search.session import SettledObserver, TransitionObserver


@dataclass(frozen=True)
class SearchEntry:
    """A search.

    Args:
        name: as users write it.
        description: what it does, in a few words.
        load: gives the function, and its options as they are taken by default. The function takes the problem, the
            options and the budget, and by name what `takes` says; it returns a `SearchResult`.
        takes: of "rng" (a random generator), "guide", "listen" (told about progress), "observe" (told every
            transition), "observe_settled" (told what is known in the end).
        proves: with time enough it ends with the best order and its proof, relative to the paths the planner finds.
        anytime: it goes on finding shorter orders until its budget is spent, and has no end of its own.
    """

    name: str
    description: str
    load: Callable[[], tuple[Callable[..., SearchResult], Any]]
    takes: tuple[str, ...]
    proves: bool = False
    anytime: bool = False

    def options(self) -> Any:
        """The options that the search takes by default, an instance of its options dataclass."""
        return self.load()[1]

    def run(
        self,
        problem: Problem,
        options: Any,
        budget: Budget,
        rng: np.random.Generator,
        listen: ProgressListener | None = None,
        guide: Guide | None = None,
        observe: TransitionObserver | None = None,
        observe_settled: SettledObserver | None = None,
    ) -> SearchResult:
        """Searches; what the search does not take is left out."""
        given = {
            "rng": rng,
            "listen": listen,
            "guide": guide,
            "observe": observe,
            "observe_settled": observe_settled,
        }
        return self.load()[0](problem, options, budget, **{name: given[name] for name in self.takes})


def _exact() -> tuple[Callable[..., SearchResult], Any]:
    from takeapart.search.exact import ExactOptions, exact

    return exact, ExactOptions()


def _best_first() -> tuple[Callable[..., SearchResult], Any]:
    from takeapart.search.best_first import BestFirstOptions, best_first

    return best_first, BestFirstOptions()


def _mcts() -> tuple[Callable[..., SearchResult], Any]:
    from takeapart.search.mcts import MctsOptions, mcts

    return mcts, MctsOptions(attempts=1)


def _beam() -> tuple[Callable[..., SearchResult], Any]:
    from takeapart.search.beam import BeamOptions, beam

    return beam, BeamOptions()


def _greedy() -> tuple[Callable[..., SearchResult], Any]:
    from takeapart.search.simple_orders import OrderOptions, greedy

    return greedy, OrderOptions(monotone=True)


def _restarts() -> tuple[Callable[..., SearchResult], Any]:
    from takeapart.search.simple_orders import OrderOptions, RestartOptions, random_restarts

    return random_restarts, RestartOptions(OrderOptions(monotone=True))


def _random() -> tuple[Callable[..., SearchResult], Any]:
    from takeapart.search.simple_orders import OrderOptions, random_order

    return random_order, OrderOptions(monotone=True)


_ENTRIES = (
    SearchEntry(
        "exact",
        "best order, with a bound",
        _exact,
        ("listen", "guide", "observe", "observe_settled"),
        proves=True,
    ),
    SearchEntry(
        "best-first",
        "the same without listing all states, for many parts",
        _best_first,
        ("listen", "guide", "observe"),
        proves=True,
    ),
    SearchEntry(
        "mcts",
        "Monte Carlo tree search as in the paper",
        _mcts,
        ("rng", "guide", "listen", "observe"),
        anytime=True,
    ),
    SearchEntry("beam", "the best few states of each size", _beam, ("rng", "listen", "guide")),
    SearchEntry("greedy", "always the shortest next removal", _greedy, ("rng", "listen", "guide")),
    SearchEntry("restarts", "best of many random orders", _restarts, ("rng", "listen"), anytime=True),
    SearchEntry("random", "one of them", _random, ("rng", "listen")),
)

SEARCHES: Mapping[str, SearchEntry] = MappingProxyType({entry.name: entry for entry in _ENTRIES})


def searches_that_take(what: str) -> tuple[str, ...]:
    """Names of the searches that take a guide, an observer, and so on."""
    return tuple(name for name, entry in SEARCHES.items() if what in entry.takes)
