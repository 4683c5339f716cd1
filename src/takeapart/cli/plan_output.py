"""What the command line says of a plan, or of why there is none."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from takeapart.cli.output import EXIT_INFEASIBLE, EXIT_INTERRUPTED, metres, note, print_json, print_table
from takeapart.formats.bound_texts import BELIEVE, SEQUENCE, STATED, gap
from takeapart.formats.plan_texts import partial_claim, partial_text, straight_line_text, title_of

if TYPE_CHECKING:
    from takeapart.model.plan import Plan
    from takeapart.planning import Hindrance, Infeasible


NOT_VERIFIED = f"all numbers are {STATED}; takeapart verify checks what it can and lists the rest"


def save_or_explain(
    made: Plan | Infeasible,
    interrupted: bool,
    out: Path,
    as_json: bool,
    partial: bool = False,
    sources: Callable[[Plan], Plan] = lambda plan: plan,
) -> Plan:
    """Writes a plan, or says why there is none and ends the command.

    Args:
        partial: where there is none, the plan that takes out what it can is written.
        sources: gives a partial plan the names of the files it was made from.
    """
    from takeapart.formats.files import save_plan
    from takeapart.model.plan import Plan

    if not isinstance(made, Plan):
        written = out if partial and made.partial is not None else None
        if written is not None and made.partial is not None:
            save_plan(sources(made.partial), written)
        if as_json:
            print_json(_infeasible_document(made, interrupted, written))
        elif written is not None and made.partial is not None:
            print_plan(made.partial)
            click.echo(f"written to           {written}")
        if interrupted:
            kept = "nothing was written" if written is None else _partial_text(made, written)
            note(f"interrupted before any plan was found; {kept}")
        else:
            note(f"{made}; {_partial_text(made, written)}")
        raise click.exceptions.Exit(EXIT_INTERRUPTED if interrupted else EXIT_INFEASIBLE)
    save_plan(made, out)
    if interrupted:
        note(f"interrupted; the best plan so far was written to {out}")
    return made


def _partial_text(made: Infeasible, written: Path | None) -> str:
    """What was written, or how it is got."""
    if made.deepest is None or made.partial is None:
        stuck = made.deepest is not None and made.deepest.is_deepest
        return "nothing was written" + ("; no part can leave" if stuck else "")
    out = len(made.partial.steps)
    known = "" if made.deepest.is_deepest else ", perhaps more,"
    parts = f"{out} of {out + len(made.remaining)} parts{known}"
    if written is not None:
        return f"a partial plan that takes out {parts} was written to {written}"
    return f"nothing was written; {parts} can leave before that: --partial writes this plan"


def _deepest_document(made: Infeasible, written: Path | None) -> dict[str, object] | None:
    if made.deepest is None:
        return None
    summary = plan_summary(made.partial) if made.partial is not None else {"order": [], "total_length": 0.0}
    return {
        "file": None if written is None else str(written),
        "order": summary["order"],
        "total_length": summary["total_length"],
        "deepest_proved": made.deepest.is_deepest,
        "shortest_proved": made.deepest.is_shortest,
    }


def _infeasible_document(made: Infeasible, interrupted: bool, written: Path | None) -> dict[str, object]:
    return {
        "feasible": False,
        "interrupted": interrupted,
        "proved": made.proved,
        "remaining": list(made.remaining),
        "hindrances": [hindrance_document(hindrance) for hindrance in made.hindrances],
        "partial": _deepest_document(made, written),
    }


def hindrance_document(hindrance: Hindrance) -> dict[str, object]:
    """Why a part cannot leave, for machines."""
    reason = hindrance.reason
    return {
        "part": hindrance.part,
        "stage": reason.stage,
        "cause": reason.cause,
        "text": reason.text,
        "numbers": dict(reason.numbers),
        "hits": dict(reason.hits),
        "blamed": list(reason.blamed),
    }


def plan_summary(plan: Plan) -> dict[str, object]:
    """What a plan says, without its paths."""
    return {
        "assembly": plan.assembly,
        "workcell": plan.workcell,
        "direction": plan.direction,
        **({"remaining": list(plan.remaining)} if plan.remaining else {}),
        "order": [{"part": step.part, "length": step.length} for step in plan.steps],
        "total_length": plan.total_length,
        "straight_line_bound": plan.straight_line_bound,
        "proved_gap": gap(plan.total_length, plan.straight_line_bound),
        "sequence_bound": plan.sequence_bound,
        "sequence_gap": gap(plan.total_length, plan.sequence_bound),
        "counts": plan.counts,
        "seconds": plan.seconds,
        "seed": plan.seed,
        "search": plan.search,
    }


def print_plan(plan: Plan, sizes: dict[str, str] | None = None, stated: bool = False) -> None:
    """The order of a plan with the gripper path of every part, and the totals.

    Args:
        plan: what is printed.
        sizes: of the parts by their names, if the assembly is known.
        stated: whether the plan comes from a file, which may state anything; its numbers are marked then.
    """
    columns = [">step", "part", *(["size, mm"] if sizes else []), ">gripper path", ">waypoints"]
    rows = [
        [
            str(number),
            step.part,
            *([sizes.get(step.part, "?")] if sizes else []),
            metres(step.length),
            str(len(step.joint_path)),
        ]
        for number, step in enumerate(plan.steps, 1)
    ]
    title = title_of(plan)
    print_table(f"{title[0].lower()}{title[1:]} in workcell {plan.workcell}", columns, rows)
    mark = ", stated" if stated else ""
    click.echo()
    if plan.remaining:
        click.echo(f"partial              {partial_text(plan)} ({partial_claim(plan)}{mark})")
    click.echo(f"total gripper path   {metres(plan.total_length)}{mark}")
    proved = _gap_text("proved gap", gap(plan.total_length, plan.straight_line_bound), straight_line_text(plan))
    click.echo(f"straight-line bound  {metres(plan.straight_line_bound)}{mark}{proved}")
    if plan.sequence_bound is not None:
        relative = _gap_text("sequence gap", gap(plan.total_length, plan.sequence_bound), SEQUENCE)
        click.echo(f"sequence bound       {metres(plan.sequence_bound)}{mark}{relative}")
        click.echo(f"which gap to believe {BELIEVE}")
    counts = plan.counts
    click.echo(
        f"search               {plan.search.get('name', 'unknown')}, seed {plan.seed}: {plan.seconds:.1f} s, "
        f"{counts.get('removal_queries', 0)} removal queries, {counts.get('motion_plans', 0)} motion plans{mark}"
    )
    if stated:
        click.echo(f"not verified         {NOT_VERIFIED}")


def _gap_text(kind: str, share: float | None, basis: str) -> str:
    return "" if share is None else f"  ({kind} {share:.1%}; {basis})"
