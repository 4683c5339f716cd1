"""Processor time of stability by contact on the shipped assemblies. ``python benchmarks/statics_time.py``.

Contacts are found once a product; states are those of one order of removals that the connectors let go.
"""

from __future__ import annotations

import argparse
import random
import time
from pathlib import Path

import numpy as np

from takeapart.experiments.tables import markdown_table, replace_between_markers
from takeapart.formats.files import data_path, load_assembly
from takeapart.stability import ConnectorStability, ContactStability
from takeapart.states import members


def times(name: str, seed: int) -> tuple[int, float, list[float]]:
    """Parts of a shipped assembly, seconds for its contacts, seconds for each state."""
    assembly = load_assembly(data_path(f"{name}.json"))
    order, stability, rng = ConnectorStability(assembly), ContactStability(assembly), random.Random(seed)
    started = time.process_time()
    _ = stability.statics
    contacts, states, state = time.process_time() - started, [], assembly.root
    while state:
        started = time.process_time()
        stability.stable(state)
        states.append(time.process_time() - started)
        state &= ~(1 << rng.choice(members(order.free(state))))
    return len(assembly.parts), contacts, states


def main() -> None:
    """Prints the table; with --document it replaces the one there."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, help="assemblies of each data set; all by default")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--document", type=Path)
    arguments = parser.parse_args()
    rows = []
    for kind in ("single", "double"):
        names = [f"{kind}/{file.stem}" for file in sorted(data_path(kind).glob("*.json"))][: arguments.count]
        found = [times(name, arguments.seed) for name in names]
        states = 1e3 * np.concatenate([each[2] for each in found])
        rows.append(
            [
                f"`{kind}`",
                f"{np.median([each[0] for each in found]):.0f}",
                f"{np.median([each[1] for each in found]):.2f} s",
                f"{len(states)}",
                f"{np.median(states):.1f} ms",
                f"{states.max():.0f} ms",
            ]
        )
    text = markdown_table(["set", "parts", "contacts", "states", "a state, median", "longest"], rows)
    print(text)
    if arguments.document:
        replace_between_markers(arguments.document, "statics", text)


if __name__ == "__main__":
    main()
