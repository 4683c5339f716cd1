"""Least strength of a stud for which models of bricks stand. ``python benchmarks/brick_verdicts.py``.

Eight of the models were built by others, who published whether they stand (StableLego, 2024). Studs are left out of
the files: where one brick lies on another, or on the plate, every place of the grid that they share is a stud, which
pulls up to a strength. Two more models: studs also resist sideways with a share of their strength (--side-force), and
studs in what is only one stud wide grip more firmly (--narrow).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from takeapart.experiments.tables import markdown_table, replace_between_markers
from takeapart.formats.files import load_assembly
from takeapart.model.assembly import Assembly, Joint
from takeapart.model.geometry import Array
from takeapart.stability.contacts import ContactStability

CASES = Path(__file__).resolve().parents[2] / "shared" / "cases" / "bricks"
STUD = 0.016  # m, between studs
WEAKEST, STRONGEST, HALVINGS = 1e-3, 100.0, 22  # N a stud: what is searched, and how finely
STANDS = {  # as published
    "stair_19": True,
    "stair_20": False,
    "stair_20_good": True,
    "stick_light": True,
    "stick_heavy": False,
    "stick_heavy_good": True,
    "external_weight_good": True,
    "external_weight_fail": False,
}


def with_studs(assembly: Assembly, narrow: float = 1.0) -> Assembly:
    """The same bricks, held by a stud of 1 N at every place of the grid that two of them share; where that is one row
    only, of `narrow` N."""
    corners = [np.array([box.corners() for box in part.boxes_in_world()]) for part in assembly.parts]
    low, high = (np.array([bound(points, axis=(0, 1)) for points in corners]) for bound in (np.min, np.max))
    joints = []
    for i, below in enumerate(assembly.parts):
        for k, above in enumerate(assembly.parts):
            first, last = np.maximum(low[i], low[k])[:2], np.minimum(high[i], high[k])[:2]
            if abs(low[k, 2] - high[i, 2]) < 1e-4 and (last - first > STUD / 2).all():
                points = _grid(first, last, float(high[i, 2]))
                name = f"{below.name}-{above.name}"
                strength = narrow if (last - first).min() < 1.5 * STUD else 1.0
                axis = np.array([0.0, 0.0, 1.0])
                joints.append(Joint(name, "clutch", below.name, above.name, points, axis, strength))
    return replace(assembly, joints=tuple(joints))


def _grid(first: Array, last: Array, height: float) -> Array:
    """(K, 3) m: middles of the studs of an area."""
    x, y = (first[k] + STUD * (np.arange(round((last[k] - first[k]) / STUD)) + 0.5) for k in (0, 1))
    return np.array([(a, b, height) for a in x for b in y])


def least_strength(assembly: Assembly, side_force: float = 0.0) -> float:
    """N a stud from which bricks with studs stand, without any margin; infinite where none is enough."""

    def stands(strength: float) -> bool:
        return stability.statics.balance(loose, standing, np.zeros(3), strength).holds

    stability = ContactStability(assembly, side_force)
    loose = [i for i, part in enumerate(assembly.parts) if not part.fixed]
    standing = stability.standing()
    low, high = WEAKEST, STRONGEST
    if not stands(high):
        return np.inf
    if stands(low):
        return 0.0
    for _ in range(HALVINGS):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if stands(middle) else (middle, high)
    return high


def main() -> None:
    """Prints the table; with --document it replaces the one there."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=Path, default=CASES, help="folder of the models")
    parser.add_argument("--side-force", type=float, default=1.0, help="share of the strength, in the second model")
    parser.add_argument("--narrow", type=float, default=1.65, help="times as strong, in the third model")
    parser.add_argument("--models", nargs="*", default=list(STANDS))
    parser.add_argument("--document", type=Path)
    arguments = parser.parse_args()
    if not arguments.cases.is_dir():
        print(f"no models of bricks at {arguments.cases}; --cases says where they are")
        return
    rows, found = [], []
    for name in arguments.models:
        bricks = load_assembly(arguments.cases / f"{name}.json")
        alike = with_studs(bricks)
        strengths = [least_strength(alike), least_strength(alike, arguments.side_force)]
        strengths.append(least_strength(with_studs(bricks, arguments.narrow)))
        found.append(strengths)
        verdict = {True: "stands", False: "collapses"}.get(STANDS.get(name), "")  # type: ignore[arg-type]
        rows.append([f"`{name}`", str(bricks.root.bit_count()), verdict, *(f"{value:.2f}" for value in strengths)])
    rows.append(["one strength for all", "", "", *_common(arguments.models, np.array(found))])
    header = ["model", "bricks", "published", "N a stud", f"with side forces of {arguments.side_force:g}"]
    header.append(f"narrow ones {arguments.narrow:g} times as firm")
    text = markdown_table(header, rows)
    print(text)
    if arguments.document:
        replace_between_markers(arguments.document, "bricks", text)


def _common(models: Sequence[str], found: Array) -> list[str]:
    """For each side force which strength tells all that stand from all that collapse."""
    texts = []
    for column in found.T:
        enough = max((value for name, value in zip(models, column, strict=True) if STANDS.get(name)), default=0.0)
        fails = [value for name, value in zip(models, column, strict=True) if STANDS.get(name) is False]
        least = min(fails, default=np.inf)
        texts.append(f"{enough:.2f} to {least:.2f}" if enough < least else "none")
    return texts


if __name__ == "__main__":
    main()
