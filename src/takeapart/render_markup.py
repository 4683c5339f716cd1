"""The one place where text becomes HTML: pages are built of elements, and whatever is not markup already is escaped.

Names, messages and numbers come from files that somebody else wrote. Nothing of them reaches a page but through
`element` and `joined`, which take plain text for plain text.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from html import escape


class Markup(str):
    """HTML or SVG made by this module; all other strings are plain text."""

    __slots__ = ()


NAME = re.compile(r"[a-zA-Z][a-zA-Z0-9-]*\Z")
EMPTY = frozenset({"img", "meta", "rect", "line", "path", "circle"})  # elements without content


def plain(value: object) -> Markup:
    """Text as HTML that shows just that text, also within quotes; what cannot be printed, and what turns the direction
    of writing, is shown as its number. Markup stays as it is."""
    if isinstance(value, Markup):
        return value
    text = "".join(c if c.isprintable() else " " if c.isspace() else ascii(c)[1:-1] for c in str(value))
    return Markup(escape(text, quote=True))


def joined(content: Iterable[object]) -> Markup:
    """Pieces of text and markup, one after the other."""
    return Markup("".join(plain(each) for each in content))


def element(tag: str, *content: object, **attributes: object) -> Markup:
    """``<tag attribute="value">content</tag>``.

    Args:
        content: text, which is escaped, or markup.
        attributes: their values are escaped; those of None are left out. ``class_`` stands for ``class``,
            ``stroke_width`` for ``stroke-width``.

    Raises:
        ValueError: the name of the element, or of an attribute, is none, or the attribute would run a script.
    """
    parts = [tag]
    for key, value in attributes.items():
        name = key.rstrip("_").replace("_", "-")
        if not NAME.match(name) or name.lower().startswith("on"):
            raise ValueError(f"{name!r} is no attribute that a page may have")
        if value is not None:
            parts.append(f'{name}="{plain(str(value))}"')  # markup in an attribute is text
    if not NAME.match(tag) or tag.lower() == "script":
        raise ValueError(f"{tag!r} is no element that a page may have")
    opening = " ".join(parts)
    return Markup(f"<{opening}/>" if tag in EMPTY else f"<{opening}>{joined(content)}</{tag}>")
