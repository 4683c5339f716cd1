"""Several assemblies around one robot, as one product with many parts.

A robot's reach bounds the size of an assembly, not the number of parts around it: cell k stands where the given one
stands, turned by k quarter turns about the vertical axis of the robot's base. Each cell is as reachable as the first,
as far as the robot can turn; what differs is the way to the goal, which all cells share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from takeapart.model.assembly import NAME_PATTERN, Assembly
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array

QUARTER_TURNS = ((1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (-1.0, 0.0))  # cosine and sine: front, left, right, back
LARGEST_COUNT = len(QUARTER_TURNS)


def cells_around(assemblies: Sequence[Assembly], T_world_base: Array, name: str) -> Assembly:
    """One assembly of up to four, in front of the robot, to its left, to its right, and behind it, in this order.

    Args:
        assemblies: each as it stands in front of the robot; a part `p` of number k becomes `k-p`.
        T_world_base: (4, 4) pose of the robot's base, whose z axis they are turned about.
        name: of the result.

    Raises:
        InputError: none or too many assemblies, a part's name that becomes too long, cells that overlap.
    """
    if not 1 <= len(assemblies) <= LARGEST_COUNT:
        raise InputError(f"{len(assemblies)} cells; must be from 1 to {LARGEST_COUNT}", name)
    parts, connectors, witness = [], [], []
    for k, assembly in enumerate(assemblies):
        T = _turned(T_world_base, *QUARTER_TURNS[k])
        for part in assembly.parts:
            if not NAME_PATTERN.fullmatch(f"{k}-{part.name}"):
                raise InputError(f"{part.name!r} is too long for a cell", f"{assembly.name}: parts")
            parts.append(replace(part, name=f"{k}-{part.name}", T_world_part=T @ part.T_world_part))
        connectors += [
            replace(each, name=f"{k}-{each.name}", host=f"{k}-{each.host}", guest=f"{k}-{each.guest}")
            for each in assembly.connectors
        ]
        witness += [f"{k}-{part}" for part in assembly.witness]
    provenance: dict[str, object] = {
        "generator": "takeapart.cells",
        "cells": [{"name": assembly.name, **assembly.provenance} for assembly in assemblies],
    }
    complete = all(assembly.witness for assembly in assemblies)
    return Assembly(name, tuple(parts), tuple(connectors), tuple(witness) if complete else (), provenance)


def _turned(T_world_base: Array, cosine: float, sine: float) -> Array:
    """Map of the world onto itself: a turn about the base's z axis; exact, since it is by quarter turns."""
    turn = np.eye(4)
    turn[:2, :2] = [[cosine, -sine], [sine, cosine]]
    turn[:2, 3] = T_world_base[:2, 3] - turn[:2, :2] @ T_world_base[:2, 3]
    return turn
