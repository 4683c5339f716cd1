"""What the paper reports: Tables I and II, and what it says about Fig. 5."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PaperRun:
    """Part of a row.

    Args:
        shortest: m.
        episode, step: found after them, from 1.
    """

    shortest: float
    episode: int
    step: int


@dataclass(frozen=True)
class PaperRow:
    """A row of Table I or II.

    Args:
        initial: length of the first sequence of the vanilla search, m.
        vanilla: its shortest one.
        guided: with the guides trained on D1 ("single") and D2 ("double").
    """

    initial: float
    vanilla: PaperRun
    guided: dict[str, PaperRun]


def _row(initial: float, vanilla: tuple[float, int, int], *guided: tuple[float, int, int]) -> PaperRow:
    runs = [PaperRun(*run) for run in guided]
    return PaperRow(initial, PaperRun(*vanilla), dict(zip(("single", "double"), runs, strict=False)))


TABLE_1 = (
    _row(16.95, (16.53, 15, 1), (16.07, 2, 1)),
    _row(15.96, (14.55, 14, 7), (14.37, 7, 3)),
    _row(16.45, (14.73, 2, 6), (14.63, 4, 2)),
    _row(16.88, (16.16, 3, 1), (15.08, 2, 2)),
    _row(14.27, (13.64, 20, 10), (13.34, 5, 1)),
    _row(18.42, (15.51, 9, 1), (14.12, 14, 1)),
    _row(16.89, (16.65, 8, 3), (16.03, 1, 1)),
    _row(18.29, (17.22, 3, 3), (15.99, 16, 6)),
    _row(17.64, (15.48, 7, 1), (13.87, 6, 3)),
    _row(19.21, (15.52, 16, 7), (15.37, 1, 1)),
    _row(18.26, (17.65, 7, 3), (15.12, 2, 1)),
    _row(17.95, (16.35, 18, 3), (16.16, 9, 1)),
    _row(17.82, (16.70, 5, 3), (15.78, 1, 1)),
    _row(17.53, (15.23, 15, 2), (14.69, 2, 1)),
)

TABLE_2 = (
    _row(29.12, (24.12, 13, 20), (23.41, 6, 1), (24.33, 2, 1)),
    _row(29.31, (23.67, 10, 2), (21.79, 8, 3), (21.88, 1, 3)),
    _row(30.19, (27.70, 13, 1), (23.88, 1, 4), (24.03, 13, 4)),
    _row(31.67, (27.10, 19, 6), (24.50, 2, 2), (25.29, 2, 5)),
    _row(28.82, (27.28, 5, 1), (24.73, 2, 2), (25.42, 8, 4)),
    _row(26.65, (24.31, 17, 4), (24.67, 2, 2), (23.75, 7, 7)),
    _row(28.50, (26.11, 2, 16), (25.84, 1, 3), (26.02, 5, 8)),
)

TABLES = {"single": TABLE_1, "double": TABLE_2}

REPLANNING_GAIN = 3.0  # m, from one to six replans (Sec. VII-A)
REPLANNING_SECONDS = 5.0  # s per part, for every further replan (Sec. VII-A)
