"""What is asked of planning: a search with its options and budget, and who looks on."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

from takeapart.model.errors import InputError, UnknownNameError
from takeapart.removal.planner import RemovalOptions
from takeapart.search.registry import SEARCHES
from takeapart.search.result import Budget
from takeapart.search.session import SettledObserver, TransitionObserver


@dataclass(frozen=True)
class PlanningOptions:
    """How a plan is made.

    Args:
        search: name of a search, see `takeapart.search.registry.SEARCHES`.
        seed: of all random choices.
        budget: when to stop searching.
        removal: options of the removal planner.
        search_options: an instance of the search's own options dataclass; None for those in the registry.
    """

    search: str = "exact"
    seed: int = 0
    budget: Budget = field(default_factory=Budget)
    removal: RemovalOptions = field(default_factory=RemovalOptions)
    search_options: Any = None

    def __post_init__(self) -> None:
        if self.search not in SEARCHES:
            raise UnknownNameError("search", self.search, list(SEARCHES))
        if self.search_options is not None:
            given, valid = type(self.search_options), type(SEARCHES[self.search].options())
            if given is not valid:
                raise InputError(
                    f"{given.__name__}; the search {self.search!r} takes {valid.__name__}", "search_options"
                )

    def of_search(self) -> Any:
        """The options of the search."""
        return self.search_options if self.search_options is not None else SEARCHES[self.search].options()


class Recorder(Protocol):
    """Takes what a search sees; `takeapart.guide.experience.ExperienceWriter` is one."""

    @property
    def observe(self) -> TransitionObserver:
        """For every removal that a query returned."""
        ...

    @property
    def observe_settled(self) -> SettledObserver:
        """For the removals of which exact search knows the cost to the goal."""
        ...
