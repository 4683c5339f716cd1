"""The figures of a plan that pages show: what is computed here from its paths, and what the file merely states."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from takeapart.formats.bound_texts import gap
from takeapart.model.plan import Plan
from takeapart.show.facts import PartFacts

LENGTH_ROUNDING = 5e-4  # m, differences below this are not seen in what is shown


@dataclass(frozen=True)
class PlanFigures:
    """Lengths of a plan, m.

    Args:
        total: of its tool paths, added up here.
        straight_line_bound: of its parts, computed here.
        sequence_bound: as the file states it; None where it states none.
        differences: one sentence for each figure of the file that is not the one computed here.
    """

    total: float
    straight_line_bound: float
    sequence_bound: float | None
    differences: tuple[str, ...] = ()

    @property
    def proved_gap(self) -> float | None:
        """Against the straight-line bound, as a share."""
        return gap(self.total, self.straight_line_bound)

    @property
    def sequence_gap(self) -> float | None:
        """Against the sequence bound, as a share."""
        return gap(self.total, self.sequence_bound)


def plan_figures(plan: Plan, facts: Sequence[PartFacts]) -> PlanFigures:
    """The figures of a plan.

    Args:
        facts: of all parts of its assembly.
    """
    total = sum(float(np.linalg.norm(np.diff(step.tool_path[:, :3], axis=0), axis=1).sum()) for step in plan.steps)
    bound = sum(each.bound for each in facts if each.step and math.isfinite(each.bound))
    differences = tuple(
        f"The file states {stated:.3f} m as {name}; its paths give {found:.3f} m."
        for name, stated, found in (
            ("total length", plan.total_length, total),
            ("straight-line bound", plan.straight_line_bound, bound),
        )
        if stated and not abs(stated - found) < LENGTH_ROUNDING
    )
    return PlanFigures(total, bound, plan.sequence_bound, differences)


def lasting_bounds(bounds: Sequence[float]) -> list[float]:
    """What of each bound still holds for all paths that were found up to the end of the search.

    A sequence bound holds relative to the paths known when it was computed. A shorter path that is found later lowers
    it, so of every bound only the least of those that came after it lasts. Values that are not known (nan) stay so.
    """
    kept, least = [], math.inf
    for bound in reversed(bounds):
        least = least if math.isnan(bound) else min(least, bound)
        kept.append(math.nan if math.isnan(bound) else least)
    return kept[::-1]
