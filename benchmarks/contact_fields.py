"""Fields, contacts and exits of products: what they cost in processor time.

Command: ``python benchmarks/contact_fields.py PRODUCT/assembly.json ...``; without a file, a shipped assembly of boxes.

Fields are built anew, whatever the cache holds; contacts have them, and sample all surfaces. Kernels are compiled
before. Straight exits are those of every part of the whole product, with all masks; the figure beside it has the rest
as well: pushes and turns where no straight way leads out, and those of parts that wait for each other.

The last lines are of two plates of 0.3 x 0.3 m, 10 mm thick, face to face: how near they are in one pose, and whether
one slides along the other for 0.6 m; both asked both ways.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from takeapart.collision.contact import NEAR, Contacts, body_of
from takeapart.collision.fields import field_of, mesh_field, signed_distances
from takeapart.collision.meeting import cloud_distance, cloud_hit
from takeapart.experiments.tables import markdown_table
from takeapart.formats.files import data_path, load_assembly
from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Box, TriangleMesh
from takeapart.model.meshes import Mesh
from takeapart.removal.exits import Exit, Exits

CLEARANCE = 0.001  # m
QUERIES = 100_000
Result = TypeVar("Result")


class TimedExits(Exits):
    """Exits that know what they cost.

    Attributes:
        alone: s, of the exits of each part that need no other's.
        pushing: s, of pushes and screws among these.
    """

    alone = pushing = 0.0

    def _find(self, part: int) -> tuple[Exit, ...]:
        before = self.pushing
        found, took = timed(lambda: super(TimedExits, self)._find(part))
        self.alone += took - (self.pushing - before)
        return found

    def _winding(self, part: int, bodies: Collection[int]) -> tuple[Exit | None, int]:
        found, took = timed(lambda: super(TimedExits, self)._winding(part, bodies))
        self.pushing += took
        return found


def timed(work: Callable[[], Result]) -> tuple[Result, float]:
    """What some work gives, and the processor time that it took, s."""
    start = time.process_time()
    result = work()
    return result, time.process_time() - start


def row(assembly: Assembly) -> list[str]:
    """Figures of one product."""
    shapes = {id(part.shape): part.shape for part in assembly.parts}.values()
    meshes = [shape for shape in shapes if not isinstance(shape, Box)]
    start = time.perf_counter()
    _, building = timed(lambda: [mesh_field(shape.surface()) for shape in meshes])
    waited = time.perf_counter() - start
    field = field_of(assembly.parts[0].shape)
    points = np.random.default_rng(0).uniform(field.middle - field.half, field.middle + field.half, (QUERIES, 3))
    signed_distances(field, points[:1])
    _, asking = timed(lambda: signed_distances(field, points))
    contacts = Contacts(assembly)
    findings, measuring = timed(lambda: contacts.findings)
    exits = TimedExits(assembly, contacts, (), CLEARANCE)
    removable = [k for k, part in enumerate(assembly.parts) if not part.fixed]
    found, leaving = timed(lambda: [exits.exits(k) for k in removable])
    free = sum(any(way.blockers == 0 for way in ways) for ways in found)
    return [
        assembly.name, str(len(assembly.parts)), f"{building:.2f}", f"{waited:.2f}",
        f"{1e9 * asking / QUERIES:.0f}", str(len(findings)),
        f"{measuring:.2f}", *(f"{1e3 * each / max(1, len(removable)):.1f}" for each in (exits.alone, leaving)),
        f"{free} of {len(removable)}",
    ]  # fmt: skip


def plates(cells: int) -> str:
    """What two flush plates whose large faces have so many cells each way cost."""
    places = np.linspace(-0.15, 0.15, cells + 1)
    x, y = (each.ravel() for each in np.meshgrid(places, places, indexing="ij"))
    top = np.column_stack([x, y, np.full(len(x), 0.005)])
    number = np.arange(len(x)).reshape(cells + 1, -1)
    a, b, c, d = (each.ravel() for each in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    upper = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    rim = np.concatenate([number[:, 0], number[-1, 1:], number[-2::-1, -1], number[0, -2:0:-1]])  # all around once
    after, below = np.roll(rim, -1), len(x)
    sides = np.concatenate(
        [np.column_stack([rim, rim + below, after + below]), np.column_stack([rim, after + below, after])]
    )
    triangles = np.concatenate([upper, upper[:, ::-1] + below, sides]).astype(np.int32)
    body = body_of(Mesh(TriangleMesh(np.concatenate([top, top * [1, 1, -1]]), triangles)))
    T, back = np.eye(4), np.eye(4)
    T[2, 3], back[2, 3] = 0.01, -0.01

    def check() -> float:
        distance = cloud_distance(body.field, body.cloud, T, NEAR)
        return min(distance, cloud_distance(body.field, body.cloud, back, NEAR))

    def slide() -> float:
        found = cloud_hit(body.field, body.cloud, T, along, -1e-4 - body.field.step, 0.6)
        return min(found, cloud_hit(body.field, body.cloud, back, -along, -1e-4 - body.field.step, 0.6))

    along = np.array([1.0, 0.0, 0.0])
    assert abs(check()) < body.field.step and slide() == np.inf
    _, checking = timed(lambda: [check() for _ in range(1000)])
    _, sliding = timed(lambda: [slide() for _ in range(1000)])
    return f"{len(triangles)} triangles, {checking:.3f} ms a pose, {sliding:.3f} ms a slide"


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
        "of wall time",
        "query, ns",
        "near pairs",
        "contacts, s",
        "straight exits, ms a part",
        "with pushes",
        "free at once",
    ]
    print(markdown_table(heads, [row(load_assembly(file)) for file in files]))
    for cells in (1, 30, 150):
        print(f"\nTwo flush plates: {plates(cells)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
