"""Values, paths and pydantic's findings as they stand in error messages: always one short line."""

from __future__ import annotations

import os
import reprlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

_SHORT = reprlib.Repr()
_SHORT.maxlevel, _SHORT.maxdict, _SHORT.maxlist, _SHORT.maxstring, _SHORT.maxlong, _SHORT.maxother = 2, 2, 4, 40, 40, 40


def shortened(value: object) -> str:
    """A value as it is shown in a message: one line of at most about 60 characters."""
    try:
        text = _SHORT.repr(value)
    except ValueError:  # Python refuses to write integers of more than 4300 digits
        return "a huge integer"
    text = "".join(character if character.isprintable() else ascii(character)[1:-1] for character in text)
    return text if len(text) <= 60 else f"{text[:57]}..."


def shown(path: str | os.PathLike[str]) -> str:
    """A path as it stands in messages: always one line."""
    text = os.fspath(path)
    return text if text.isprintable() and text else repr(text)


def reason(error: Exception) -> str:
    """Why the system refused, in a few words."""
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return text[:1].lower() + text[1:]


def place(location: tuple[int | str, ...]) -> str:
    """``parts[3].shape.size[1]`` for ("parts", 3, "shape", "size", 1)."""
    text = ""
    for step in location:
        if isinstance(step, int):
            text += f"[{step}]"
        elif step.isidentifier() and len(step) <= 64:
            text += f".{step}" if text else step
        else:
            text += f"[{shortened(step)}]"
    return text


_VALID = {
    "missing": "is missing",
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "bool_type": "must be true or false",
    "string_type": "must be a text",
    "list_type": "must be a list",
    "dict_type": "must be an object",
    "model_type": "must be an object",
    "finite_number": "must be a finite number",
    "greater_than": "must be above {gt:g}",
    "greater_than_equal": "must be at least {ge:g}",
    "less_than": "must be below {lt:g}",
    "less_than_equal": "must be at most {le:g}",
    "too_short": "has {actual_length} entries; must have at least {min_length}",
    "string_too_long": "must be at most {max_length} characters",
    "literal_error": "must be {expected}",
}


def sentence(error: ErrorDetails) -> str:
    """One line: the value where it helps, and what is valid."""
    kind, context, value = error["type"], error.get("ctx", {}), error["input"]
    if kind == "too_long":  # the number given by pydantic stops counting at the limit
        found = f"{len(value)} entries" if isinstance(value, list | dict) else "too many entries"
        return f"{found}; at most {context['max_length']} are allowed"
    if kind == "string_pattern_mismatch":
        valid = "64 digits of a SHA-256" if "a-f" in context["pattern"] else "1 to 64 letters, digits, '.', '_' or '-'"
        return f"{shortened(value)}; must be {valid}"
    if kind == "union_tag_not_found":
        return "is missing"
    if kind == "union_tag_invalid":
        return f"{shortened(value.get('kind'))}; must be {context['expected_tags'].replace(', ', ' or ')}"
    valid = _VALID[kind].format(**context) if kind in _VALID else error["msg"]
    return valid if kind in ("missing", "too_short", "unknown_key", "rows") else f"{shortened(value)}; {valid}"


def kind_of(value: object) -> str:
    """What a value is called in JSON."""
    if value is None:
        return "null"
    names = {dict: "an object", list: "a list", str: "a text", bool: "a truth value"}
    return names.get(type(value), "a number" if isinstance(value, int | float) else "a value of another kind")
