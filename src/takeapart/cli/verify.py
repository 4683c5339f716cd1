"""``takeapart verify`` and ``takeapart assemble``: check a plan independently, and read it backwards."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from takeapart.cli.output import (
    EXIT_UNVERIFIED,
    FILE,
    examples,
    json_option,
    note,
    plan_assembly_option,
    plan_workcell_option,
    print_json,
    progress_bar,
    require_output,
)
from takeapart.cli.plan_output import plan_summary, print_plan

if TYPE_CHECKING:
    from takeapart.verification import VerificationReport

SHOWN_FINDINGS = 20


@click.command(
    short_help="Check a plan with an independent simulator.",
    epilog=examples(
        "takeapart verify product.plan.json",
        "takeapart verify product.plan.json --report product.verification.json",
    ),
)
@click.argument("plan", type=FILE)
@plan_assembly_option
@plan_workcell_option
@click.option(
    "--physics/--no-physics",
    default=True,
    help="Whether every intermediate assembly is also left to stand under gravity.  [default: yes]",
)
@click.option("--report", type=FILE, help="Write the whole report to this JSON file.")
@json_option
def verify(
    plan: Path, assembly: Path | None, workcell: str | None, physics: bool, report: Path | None, as_json: bool
) -> None:
    """Replay PLAN in MuJoCo and check all that it states.

    Kinematics, collisions and gravity are computed anew, without any code of the planner. What the plan states beyond
    that (bound of the order, counts, seed, history) is not checked, and listed. Exit code 0: the motions may be
    trusted; 4: they may not, and every finding is printed with step, part and moment. Needs the extra "verify":
    pip install 'takeapart[verify]'.
    """
    from takeapart.formats.documents import readable_json, write_atomically
    from takeapart.formats.files import load_plan
    from takeapart.formats.sources import sources_of
    from takeapart.verification import report_as_dict, verify_plan

    checked = load_plan(plan)
    product, cell = sources_of(checked, plan, assembly, workcell)
    if report is not None:
        require_output(report, plan, *([assembly] if assembly else []))
    with progress_bar(f"verifying {checked.assembly}"):
        outcome = verify_plan(checked, product, cell, physics=physics)
    if report is not None:
        write_atomically(report, readable_json(report_as_dict(outcome)))
    if as_json:
        print_json(report_as_dict(outcome))
    else:
        print_verdict(outcome)
    if not outcome.passed:
        raise click.exceptions.Exit(EXIT_UNVERIFIED)


def print_verdict(outcome: VerificationReport) -> None:
    """The verdict of a verification, with what it rests on or what was found."""
    from takeapart.verification import format_finding

    if outcome.passed:
        taken = f"{outcome.removable - len(outcome.remaining)} of {outcome.removable} parts"
        holds = f"holds, as a partial plan: {taken}" if outcome.remaining else "holds"
        click.echo(
            f"verified: {outcome.plan} {holds}, {outcome.steps} steps and {outcome.configurations} configurations"
        )
        if outcome.remaining:
            click.echo(f"remaining            {', '.join(outcome.remaining)}")
        if outcome.smallest_clearance is not None:
            near = outcome.smallest_clearance
            click.echo(
                f"smallest clearance   {1000 * near.distance:.2f} mm, {near.first} and {near.second}, "
                f"step {near.step + 1} ({near.part})"
            )
        if outcome.contacts:
            first, second, depth = outcome.contacts[0]
            click.echo(f"deepest contact      {1000 * depth:.2f} mm, {first} and {second}")
        if outcome.states:
            click.echo(f"under gravity        all {outcome.states} states stand")
    else:
        click.echo(f"not verified: {outcome.plan} has {len(outcome.findings)} findings")
        for finding in outcome.findings[:SHOWN_FINDINGS]:
            click.echo(f"  {format_finding(finding)}")
        if len(outcome.findings) > SHOWN_FINDINGS:
            click.echo(
                f"  ... and {len(outcome.findings) - SHOWN_FINDINGS} more (all of them: --json or --report FILE)"
            )
    click.echo(f"not checked          {', '.join(outcome.not_checked)}")


@click.command(
    short_help="Read a plan backwards: the assembly plan.",
    epilog=examples("takeapart assemble product.plan.json --out product.assembly-plan.json"),
)
@click.argument("plan", type=FILE)
@click.option("--out", type=FILE, required=True, help="The inverted plan file.")
@json_option
def assemble(plan: Path, out: Path, as_json: bool) -> None:
    """Write the inverse of PLAN: the order of parts and every path reversed.

    Of a plan for disassembly this is the plan for assembly, and the other way round. Of a partial plan it is the plan
    that adds its parts to what remains, which must have been put together before; that is said.
    """
    from takeapart.formats.files import load_plan, save_plan
    from takeapart.formats.sources import with_sources_moved

    require_output(out, plan)
    inverted = with_sources_moved(load_plan(plan).inverted(), plan, out)
    save_plan(inverted, out)
    if as_json:
        print_json({"file": str(out), **plan_summary(inverted)})
        return
    print_plan(inverted, stated=True)
    click.echo(f"written to           {out}")
    if inverted.remaining and inverted.direction == "assembly":
        note(f"it starts from a subassembly, which no plan builds: {', '.join(inverted.remaining)}")
