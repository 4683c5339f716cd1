"""The options of searches on the command line: a few have a name there, ``--set`` reaches all of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any

from takeapart.model.errors import InputError
from takeapart.search.registry import SEARCHES

if TYPE_CHECKING:
    from takeapart.planning import PlanningOptions

PLAIN = {int: "a whole number", float: "a number", str: "a word", bool: "true or false"}


def options_of(
    search: str,
    seed: int,
    episodes: int | None = None,
    seconds: float | None = None,
    queries: int | None = None,
    named: Mapping[str, Any] | None = None,
    settings: Sequence[str] = (),
) -> PlanningOptions:
    """The command's options as those of the library.

    Args:
        named: options of the search that have a name on the command line, see `changed`; None where not given.
        settings: as ``--set`` takes them, "name=value".

    Raises:
        InputError: the search has no such option, or the value is not valid.
    """
    from takeapart.planning import PlanningOptions
    from takeapart.search.result import Budget

    budget = Budget(episodes or math.inf, seconds or math.inf, queries or math.inf)
    chosen = SEARCHES[search].options()
    for name, value in (named or {}).items():
        if value is not None:
            chosen = changed(chosen, name, value)
    for setting in settings:
        name, _, text = setting.partition("=")
        valid = option_values(chosen)
        if name not in valid:
            raise InputError(f"{search} has no option {name!r}; valid: {', '.join(valid)}", "--set")
        chosen = changed(chosen, name, parsed(text, type(valid[name]), f"--set {name}"))
    return PlanningOptions(search, seed, budget, search_options=chosen)


def option_values(options: Any) -> dict[str, Any]:
    """All options that are a number, a word, or true or false; those of an option with options of its own as a.b."""
    found: dict[str, Any] = {}
    for each in fields(options):
        value = getattr(options, each.name)
        if is_dataclass(value):
            found |= {f"{each.name}.{name}": inner for name, inner in option_values(value).items()}
        elif type(value) in PLAIN:
            found[each.name] = value
    return found


def changed(options: Any, name: str, value: Any) -> Any:
    """The options with another value of one of them, named as in `option_values`.

    Raises:
        InputError: the value is not valid.
    """
    first, _, rest = name.partition(".")
    return replace(options, **{first: changed(getattr(options, first), rest, value) if rest else value})


def parsed(text: str, kind: type, where: str) -> Any:
    """A value of a kind in PLAIN.

    Raises:
        InputError: the text is none.
    """
    try:
        if kind is bool:
            return {"true": True, "false": False}[text.lower()]
        value = kind(text)
    except (ValueError, KeyError):
        raise InputError(f"{text!r}; must be {PLAIN[kind]}", where) from None
    if isinstance(value, float) and math.isnan(value):
        raise InputError(f"{text!r}; must be {PLAIN[kind]}", where)
    return value
