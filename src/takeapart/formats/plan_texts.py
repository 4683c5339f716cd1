"""What a plan is called wherever it is shown, and what is said of one that leaves parts where they are."""

from __future__ import annotations

from typing import TYPE_CHECKING

from takeapart.formats.bound_texts import STRAIGHT_LINE

if TYPE_CHECKING:  # the command line has these words without loading what a plan is made of
    from takeapart.model.plan import Plan

SAME_PARTS = "no plan that takes out the same parts, and grips each somewhere in its volume, is shorter"


def title_of(plan: Plan) -> str:
    """What stands above a plan: Disassembly of pump, or Partial assembly of camera."""
    direction = f"partial {plan.direction}" if plan.remaining else plan.direction
    return f"{direction.capitalize()} of {plan.assembly}"


def partial_text(plan: Plan) -> str:
    """How much of the product a partial plan takes out, and what remains; empty for a plan of the whole product."""
    if not plan.remaining:
        return ""
    taken, which = len(plan.steps), "this remains" if len(plan.remaining) == 1 else "these remain"
    return f"{taken} of {taken + len(plan.remaining)} parts; {which}: {', '.join(plan.remaining)}"


def partial_claim(plan: Plan) -> str:
    """What its file states of how far a partial plan goes; empty for a plan of the whole product."""
    if not plan.remaining:
        return ""
    if plan.search.get("partial_deepest") is True:
        return "no more parts can leave, for the removals that the planner finds"
    return "perhaps more parts can leave"


def straight_line_text(plan: Plan) -> str:
    """What the straight-line bound of a plan says."""
    return SAME_PARTS if plan.remaining else STRAIGHT_LINE
