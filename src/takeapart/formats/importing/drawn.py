"""What a drawing holds: bodies with names and places, before anything is decided about them."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from takeapart.model.assembly import NAME_PATTERN
from takeapart.model.geometry import Array

# Names that CAD kernels give where the drawing has none.
NAMELESS = re.compile(r"(?:SOLID|COMPOUND|COMPSOLID|SHELL|NAUO\d*|=>.*|\d*|Open CASCADE.*)", re.IGNORECASE)
ESCAPED = re.compile(r"\\X2\\((?:[0-9A-Fa-f]{4})+)\\X0\\")  # ISO 10303-21, 6.4.3.3
LETTERS = str.maketrans(
    {"ß": "ss", "ø": "o", "Ø": "O", "æ": "ae", "Æ": "Ae", "œ": "oe", "Œ": "Oe", "ł": "l", "Ł": "L", "đ": "d", "Đ": "D"}
)


@dataclass(frozen=True, eq=False)
class DrawnBody:
    """One body at one place.

    Args:
        name: as drawn, of the body or of the nearest ancestor that has one.
        vertices: (V, 3) in the body's frame, in the unit of the file.
        triangles: (T, 3) numbers of vertices.
        T_world_body: (4, 4), any affine map: it may mirror and scale.
        shape: equal for bodies that are instances of one shape.
    """

    name: str
    vertices: Array
    triangles: NDArray[np.int64]
    T_world_body: Array
    shape: int


def mended(name: str) -> str:
    """A name as it was drawn: UTF-8 that was read as Latin-1, and letters escaped as STEP does it, are put right."""
    name = ESCAPED.sub(lambda found: bytes.fromhex(found[1]).decode("utf-16-be", "replace"), name)
    try:
        return name.encode("latin-1").decode("utf-8")
    except UnicodeError:
        return name


def valid_names(drawn: list[str]) -> list[str]:
    """Names that an assembly may have, each once, as near to the drawn ones as they can be: screw, screw-2, ..."""
    found: list[str] = []
    taken: set[str] = set()
    plain = [_plain(name) for name in drawn]
    drawn_so = {name.lower() for name in plain}
    for name in plain:
        count, candidate = 1, name
        while candidate.lower() in taken or (count > 1 and candidate.lower() in drawn_so):
            count += 1
            candidate = f"{name[: 63 - len(str(count))]}-{count}"
        taken.add(candidate.lower())
        found.append(candidate)
    return found


def _plain(name: str) -> str:
    ascii_only = unicodedata.normalize("NFKD", name.translate(LETTERS)).encode("ascii", "ignore").decode()
    text = re.sub(r"[^A-Za-z0-9._-]+", "-", ascii_only).strip("-._")[:64]
    return text if NAME_PATTERN.fullmatch(text) else "part"
