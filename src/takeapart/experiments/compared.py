"""Names of what `takeapart compare` compares; apart from `comparison`, so that the command line loads nothing heavy."""

from __future__ import annotations

from takeapart.search.registry import SEARCHES

PAPER = "mcts, paper"
"""Tree search that keeps no library, as in the paper."""

SINGLE = "random"
"""One random order: compared as the first of many."""

COMPARED = tuple(
    label
    for name in reversed(list(SEARCHES))
    if name != SINGLE
    for label in ((name, PAPER) if PAPER.startswith(f"{name},") else (name,))
)
