"""Contacts at which nothing can rub, since nothing presses there: parts that fit between others without being clamped.

A rigid peg in a rigid hole could be clamped by any force, and hold by friction whatever hangs on it; equilibrium alone
cannot say that nobody clamps it. So where a part has contacts on two opposite sides that gravity does not press on,
these guide it and do not rub. Between several parts a wedge that narrows downwards is pressed, and so are the blocks of
an arch. Pairs that are meant to overlap are clamped.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from takeapart.model.assembly import Assembly
from takeapart.stability.patches import RIM, ContactPatch

OPPOSITE = np.cos(np.radians(25.0))  # normals
SIDEWAYS = 0.15  # greatest vertical component of a normal on which weight does not press
TAPER = 0.02  # sum of the vertical components of opposite normals from which weight presses into a wedge


def rubbing(assembly: Assembly, patches: Sequence[ContactPatch]) -> list[bool]:
    """For each patch whether friction acts there."""
    meant = {frozenset(assembly.index[name] for name in pair) for pair in assembly.allowed_overlaps}
    around: list[list[tuple[int, float]]] = [[] for _ in assembly.parts]
    for k, patch in enumerate(patches):
        if {patch.first, patch.second} not in meant:
            around[patch.first].append((k, 1.0))
            around[patch.second].append((k, -1.0))
    rubs = [True] * len(patches)
    normals = [patch.normals.mean(axis=0) for patch in patches]
    normals = [normal / np.linalg.norm(normal) for normal in normals]
    for part, found in zip(assembly.parts, around, strict=True):
        if part.fixed or len(found) < 2:
            continue
        towards = np.array([sign * normals[k] for k, sign in found])
        against = towards @ towards.T < -OPPOSITE
        for a, b in combinations(range(len(found)), 2):
            if not against[a, b] or not (rubs[found[a][0]] or rubs[found[b][0]]):
                continue
            one, other = patches[found[a][0]], patches[found[b][0]]
            same_pair = {one.first, one.second} == {other.first, other.second}
            heights = towards[[a, b], 2]
            sideways = np.abs(heights).max() <= SIDEWAYS and heights.sum() <= TAPER
            if (same_pair or sideways) and _face(one, other):
                rubs[found[a][0]] = rubs[found[b][0]] = False
    return rubs


def _face(one: ContactPatch, other: ContactPatch) -> bool:
    """Whether two patches lie over each other as seen along the normal of the first."""
    across = np.linalg.svd(one.normals.mean(axis=0)[None])[2][1:]
    a, b = one.points @ across.T, other.points @ across.T
    return bool((a.min(axis=0) <= b.max(axis=0) + RIM).all() and (b.min(axis=0) <= a.max(axis=0) + RIM).all())
