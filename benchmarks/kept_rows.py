"""Rows of tables that take long: kept in a file each, with what they were made of; and the table, printed or put into
its document."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from takeapart.experiments.tables import replace_between_markers
from takeapart.formats.documents import readable_json, write_atomically
from takeapart.formats.files import load_plan, save_plan
from takeapart.model.assembly import Assembly
from takeapart.model.plan import Plan
from takeapart.verification import VerificationReport, verify_plan
from takeapart.workcell import Workcell

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Row = TypeVar("Row", bound="DataclassInstance")


def write_row(row: DataclassInstance, file: Path, origin: list[Any] | None = None) -> None:
    """Keeps a row.

    Args:
        row: a dataclass of numbers, texts and tuples of them.
        origin: what the row was made of, as plain data; where it has changed, the row is not read again.
    """
    write_atomically(file, readable_json({"origin": origin, "row": asdict(row)}))


def read_row(kind: type[Row], file: Path, origin: list[Any] | None = None) -> Row | None:
    """The row that a file keeps, if there is one of this origin."""
    if not file.is_file():
        return None
    document: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    if document["origin"] != origin:
        return None
    values = {key: tuple(value) if isinstance(value, list) else value for key, value in document["row"].items()}
    return kind(**values)


def write_and_verify(made: Plan, file: Path, assembly: Assembly, workcell: Workcell) -> VerificationReport:
    """What the verification says of a plan that was written and read again."""
    save_plan(made, file)
    return verify_plan(load_plan(file), assembly, workcell)


def publish(text: str, marker: str, document: Path | None) -> None:
    """Prints a table; in the document, if one is given, it replaces what stands between its markers."""
    print(text)
    if document is not None:
        replace_between_markers(document, marker, text)
