"""The one place where text becomes HTML: pages are built of elements, and whatever is not markup already is escaped.

Names, messages and numbers come from files that somebody else wrote. Nothing of them reaches a page but through
`element` and `joined`, which take plain text for plain text.
"""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Iterable
from html import escape


class Markup(str):
    """HTML or SVG made by this module; all other strings are plain text."""

    __slots__ = ()


NAME = re.compile(r"[a-zA-Z][a-zA-Z0-9-]*\Z")
EMPTY = frozenset({"img", "meta", "rect", "line", "path", "circle"})  # elements without content
RUNNING = frozenset({"script", "iframe", "frame", "object", "embed", "base", "link", "style", "form", "foreignobject"})
ADDRESSES = frozenset({"href", "src", "action", "formaction", "poster", "data", "background"})
SCHEME = re.compile(r"[^/?#]*?:")
SAFE_ADDRESS = re.compile(r"(https?|mailto):|data:image/(png|jpeg|gif);base64,", re.IGNORECASE)


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
        ValueError: the name of the element, or of an attribute, is none; or it, or the address that it holds, could run
            a script or show another page.
    """
    parts = [tag]
    for key, value in attributes.items():
        name = key.rstrip("_").replace("_", "-")
        if not NAME.match(name) or name.lower().startswith("on") or name.lower() in ("srcdoc", "srcset"):
            raise ValueError(f"{name!r} is no attribute that a page may have")
        if name.lower() in ADDRESSES and value is not None:
            _require_safe(str(value))
        if value is not None:
            parts.append(f'{name}="{plain(str(value))}"')  # markup in an attribute is text
    if not NAME.match(tag) or tag.lower() in RUNNING:
        raise ValueError(f"{tag!r} is no element that a page may have")
    opening = " ".join(parts)
    return Markup(f"<{opening}/>" if tag in EMPTY else f"<{opening}>{joined(content)}</{tag}>")


def _require_safe(address: str) -> None:
    """Browsers drop white space and what cannot be printed before they look at the scheme, so that is done here too."""
    seen = "".join(c for c in address if c.isprintable() and not c.isspace())
    if SCHEME.match(seen) and not SAFE_ADDRESS.match(seen):
        raise ValueError(f"{address[:40]!r} is no address that a page may have; http, https, mailto and pictures are")


def stylesheet(rules: str) -> Markup:
    """The element of a page's style. Its text is the program's own and nothing of a file.

    Raises:
        ValueError: it could end its element.
    """
    if "<" in rules:
        raise ValueError("a style sheet holds no '<'")
    return Markup(f"<style>{rules}</style>")


def digest_source(text: str) -> str:
    """How a content security policy names a script or style sheet that stands in the page: by its hash."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def document(title: str, rules: str, *content: object) -> Markup:
    """A whole page without scripts and without other files: its policy allows its own style and pictures in it.

    Args:
        rules: its style sheet.
        content: of its body, text or markup.
    """
    policy = f"default-src 'none'; style-src {digest_source(rules)}; img-src data:; base-uri 'none'; form-action 'none'"
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=policy),
        element("meta", name="viewport", content="width=device-width,initial-scale=1"),
        element("title", title),
        stylesheet(rules),
    )
    page = element("html", head, element("body", *content), lang="en")
    return Markup(f"<!doctype html>{page}\n")
