"""What a report tells of a verification: the file that ``takeapart verify --report`` wrote about the same plan."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from takeapart.formats.documents import read_json
from takeapart.formats.messages import shown
from takeapart.formats.serialization import motion_hash
from takeapart.model.errors import InputError
from takeapart.model.plan import Plan

MAXIMUM_BYTES = 16 * 2**20
PLAN_ENDING, ENDING = ".plan.json", ".verification.json"


@dataclass(frozen=True)
class Verified:
    """A verification of the plan in hand.

    Args:
        passed: whether it found nothing.
        findings: number of its findings.
        clearances: part -> smallest distance, m, between things that may not touch, in the step of the part; None where
            nothing came within `sight`.
        sight: m, larger distances were not measured.
    """

    passed: bool
    findings: int
    clearances: dict[str, float | None]
    sight: float


def verification_beside(plan: Path) -> Path | None:
    """Where the verification of ``x.plan.json`` is looked for: ``x.verification.json``, if there is one."""
    stem = plan.name.removesuffix(PLAN_ENDING) if plan.name.endswith(PLAN_ENDING) else plan.stem
    found = plan.with_name(stem + ENDING)
    return found if found.is_file() and found != plan else None


def load_verification(path: str | os.PathLike[str], plan: Plan) -> Verified:
    """The verification in a file.

    Raises:
        InputError: the file holds none, or one of other motions.
    """
    where, document = shown(path), read_json(path, MAXIMUM_BYTES)
    try:
        assert isinstance(document, dict)
        passed, motion, rows = document["passed"], document["motion"], document["clearances"]
        findings, sight = document["findings"], document["options"]["sight"]
        assert isinstance(passed, bool) and isinstance(findings, list) and isinstance(rows, list)
        assert _is_distance(sight) and passed == (not findings)
        steps = plan.steps if plan.direction == "disassembly" else plan.steps[::-1]
        distances = [None if row is None else row["distance"] for row in rows]
        assert all(distance is None or _is_distance(distance) for distance in distances)
    except (AssertionError, KeyError, TypeError):
        raise InputError("holds no verification; 'takeapart verify PLAN --report FILE' writes one", where) from None
    if motion != motion_hash(plan):
        raise InputError("is the verification of another plan; verify this one again", where)
    if len(distances) != len(steps):  # steps that could not be replayed: which ones is not told
        return Verified(passed, len(findings), {}, float(sight))
    clearances = {step.part: distance for step, distance in zip(steps, distances, strict=True)}
    return Verified(passed, len(findings), clearances, float(sight))


def _is_distance(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e3
