"""Fields, contacts and exits of products: what they cost in processor time.

Command: ``python benchmarks/contact_fields.py PRODUCT/assembly.json ...``; without a file, a shipped assembly of boxes.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from takeapart.collision.contact import Contacts
from takeapart.collision.fields import field_of, mesh_field, signed_distances
from takeapart.experiments.tables import markdown_table
from takeapart.formats.files import data_path, load_assembly
from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Box
from takeapart.removal.exits import Exits

CLEARANCE = 0.001  # m
QUERIES = 100_000
Result = TypeVar("Result")


def timed(work: Callable[[], Result]) -> tuple[Result, float]:
    """What some work gives, and the processor time that it took, s."""
    start = time.process_time()
    result = work()
    return result, time.process_time() - start


def row(assembly: Assembly) -> list[str]:
    """Figures of one product."""
    shapes = {id(part.shape): part.shape for part in assembly.parts}.values()
    meshes = [shape for shape in shapes if not isinstance(shape, Box)]
    _, building = timed(lambda: [mesh_field(shape.surface()) for shape in meshes])
    field = field_of(assembly.parts[0].shape)
    points = np.random.default_rng(0).uniform(field.middle - field.half, field.middle + field.half, (QUERIES, 3))
    signed_distances(field, points[:1])
    _, asking = timed(lambda: signed_distances(field, points))
    contacts = Contacts(assembly)
    findings, measuring = timed(lambda: contacts.findings)
    exits = Exits(assembly, contacts, (), CLEARANCE)
    removable = [k for k, part in enumerate(assembly.parts) if not part.fixed]
    found, leaving = timed(lambda: [exits.exits(k) for k in removable])
    free = sum(any(way.blockers == 0 for way in ways) for ways in found)
    return [
        assembly.name, str(len(assembly.parts)), f"{building:.2f}", f"{1e9 * asking / QUERIES:.0f}", str(len(findings)),
        f"{measuring:.2f}", f"{1e3 * leaving / max(1, len(removable)):.1f}", f"{free} of {len(removable)}",
    ]  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; always returns 0."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="*", type=Path)
    given = parser.parse_args(arguments)
    files = given.files or [data_path("single/01.json")]
    row(load_assembly(files[0]))  # kernels are compiled
    heads = [
        "product",
        "parts",
        "fields, s",
        "query, ns",
        "near pairs",
        "contacts, s",
        "exits, ms a part",
        "free at once",
    ]
    print(markdown_table(heads, [row(load_assembly(file)) for file in files]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
