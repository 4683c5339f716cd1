"""Directions in which a part may leave: up first, then those that its own form and its neighbours suggest."""

from __future__ import annotations

from functools import cache

import numpy as np

from takeapart.collision.contact import Contacts
from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Array

SAME = 0.9995  # cosine; directions that differ by less are one
EXACT = 1e-4  # rad; an axis of the part that differs by more from a direction is one of its own
WORLD = 5  # directions that are the world's own, at the beginning
FACETS = 6  # largest groups of parallel facets of a part that are tried
SPHERE = 96  # directions all around


def directions_of(assembly: Assembly, contacts: Contacts, part: int) -> tuple[Array, ...]:
    """Unit vectors (3,) in the world: straight up, the axes of the world and of the part's tight box, the normals of
    its largest facets, those of its neighbours, and away from the middle of the product."""
    chosen: list[Array] = []

    def add(direction: Array) -> None:
        length = float(np.linalg.norm(direction))
        if length > 1e-9:
            unit = np.where(np.abs(direction / length) < 1e-9, 0.0, direction / length)
            unit = unit / np.linalg.norm(unit)
            if all(float(unit @ other) < SAME for other in chosen):
                chosen.append(unit)

    for axis in ((0, 0, 1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)):
        add(np.array(axis, dtype=float))
    body = assembly.parts[part]
    box = body.shape.bounding_box().moved(body.T_world_part)
    for axis in box.T_frame_box[:3, :3].T:
        add(axis)
        add(-axis)
    for normal in _facet_normals(assembly, contacts, part):
        add(normal)
        add(-normal)
    for exact in contacts.body(part).axes:
        _add_exactly(body.T_world_part[:3, :3] @ exact, chosen)
        _add_exactly(-body.T_world_part[:3, :3] @ exact, chosen)
    for other in range(len(assembly.parts)):
        if other != part and contacts.finding(part, other) is not None:
            for normal in _facet_normals(assembly, contacts, other)[:3]:
                add(normal)
                add(-normal)
    for angle in np.arange(0.0, 2 * np.pi, np.pi / 6):
        add(np.array([np.cos(angle), np.sin(angle), 0.0]))
    add(np.array([0.0, 0.0, -1.0]))
    return tuple(chosen)


def _add_exactly(axis: Array, chosen: list[Array]) -> None:
    """Puts an axis in the place of a direction that is nearly the same, the world's excepted, or adds it: a tight fit
    leaves no play for what is nearly right."""
    near = [k for k, other in enumerate(chosen) if float(axis @ other) >= SAME]
    if any(float(np.linalg.norm(axis - chosen[k])) < EXACT for k in near):
        return
    inexact = [k for k in near if k >= WORLD]
    if inexact:
        chosen[inexact[0]] = axis
    else:
        chosen.append(axis)


def _facet_normals(assembly: Assembly, contacts: Contacts, part: int) -> list[Array]:
    """Normals in the world of the largest groups of parallel facets, the largest first."""
    return [assembly.parts[part].T_world_part[:3, :3] @ normal for normal in contacts.body(part).facets[:FACETS]]


@cache
def sphere() -> tuple[Array, ...]:
    """Evenly spread unit vectors, upward ones first: a Fibonacci spiral."""
    k = np.arange(SPHERE) + 0.5
    z = 1 - 2 * k / SPHERE
    r, angle = np.sqrt(1 - z * z), np.pi * (1 + np.sqrt(5)) * k
    return tuple(np.column_stack([r * np.cos(angle), r * np.sin(angle), z]))
