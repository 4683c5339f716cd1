"""Tables in documents, between two markers, written by the experiments that fill them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from takeapart.formats.documents import write_atomically
from takeapart.model.errors import InputError


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table in Markdown; columns after the first are set to the right."""
    lines = [header, ["---", *["---:"] * (len(header) - 1)], *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def replace_between_markers(document: Path, name: str, text: str) -> None:
    """Puts text between the lines ``<!-- NAME: begin -->`` and ``<!-- NAME: end -->`` of a document.

    Raises:
        InputError: the document or one of its markers is missing.
    """
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    if not document.is_file():
        raise InputError("there is no such document", str(document))
    before, found_begin, rest = document.read_text(encoding="utf-8").partition(begin)
    _, found_end, after = rest.partition(end)
    if not found_begin or not found_end:
        raise InputError(f"needs the lines {begin} and {end}, in this order", str(document))
    write_atomically(document, f"{before}{begin}\n\n{text}\n\n{end}{after}")
