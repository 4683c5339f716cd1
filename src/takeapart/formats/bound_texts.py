"""What the two bounds of a plan say, in the words that stand wherever one of them is shown."""

from __future__ import annotations

STRAIGHT_LINE = "no plan that grips each part somewhere in its volume is shorter"
SEQUENCE = "relative to the paths the planner found"
BELIEVE = "the proved gap, of the whole plan; the sequence gap is that of the order alone"
STATED = "stated by the file, not checked"
ROUNDING = 1e-9  # of a length: sums of the same lengths in another order differ by less


def gap(length: float, bound: float | None) -> float | None:
    """(length - bound) / bound; 0 where they differ by rounding alone, None where there is no bound."""
    if not bound:
        return None
    share = (length - bound) / bound
    return share if abs(share) > ROUNDING else 0.0


def explanation(straight_line: str, sequence: bool) -> str:
    """One line about the bounds that a plan has; empty where it has none.

    Args:
        straight_line: what that bound says, empty where the plan has none.
        sequence: whether there is the other one.
    """
    words = []
    if straight_line:
        words.append(f"Straight-line bound: {straight_line}.")
    if sequence:
        words.append(f"Sequence bound: no order is shorter, {SEQUENCE}.")
    if straight_line and sequence:
        words.append(f"Believe {BELIEVE}.")
    return " ".join(words)
