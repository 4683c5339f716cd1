"""``takeapart verify`` and ``takeapart assemble``: check a plan independently, and read it backwards."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from takeapart.cli_inspect import assembly_of
from takeapart.cli_output import EXIT_UNVERIFIED, FILE, json_option, print_json, progress_bar, require_output
from takeapart.cli_plan_output import plan_summary, print_plan
from takeapart.errors import InputError, UnknownNameError

if TYPE_CHECKING:
    from takeapart.plan import Plan
    from takeapart.verification import VerificationReport
    from takeapart.workcell import Workcell

SHOWN_FINDINGS = 20


@click.command(
    short_help="Check a plan with an independent simulator.",
    epilog="Example: takeapart verify product.plan.json --assembly product.json --report report.json",
)
@click.argument("plan", type=FILE)
@click.option("--assembly", type=FILE, help="The assembly of the plan.  [default: a shipped one with the plan's hash]")
@click.option(
    "--workcell",
    metavar="NAME|FILE.toml",
    help="The workcell of the plan.  [default: the shipped one with the name in the plan]",
)
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
    from takeapart.documents import readable_json, write_atomically
    from takeapart.files import load_plan
    from takeapart.verification import report_as_dict, verify_plan

    checked = load_plan(plan)
    product = assembly_of(checked, assembly)
    if product is None:
        raise InputError(
            f"was made for assembly {checked.assembly!r}; none of this hash is shipped, give it with --assembly FILE",
            str(plan),
        )
    cell = workcell_of(checked, workcell)
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


def workcell_of(plan: Plan, given: str | None) -> Workcell:
    """The workcell of a plan: the given one, or else the shipped one with the name in the plan.

    Raises:
        InputError: neither is there, or the given file is broken.
    """
    from takeapart.files import load_workcell

    try:
        return load_workcell(given or plan.workcell)
    except UnknownNameError as error:
        if given:
            raise
        raise InputError(
            f"the plan's workcell {plan.workcell!r} is not shipped; give it with --workcell FILE.toml"
        ) from error


def print_verdict(outcome: VerificationReport) -> None:
    """The verdict of a verification, with what it rests on or what was found."""
    from takeapart.verification import format_finding

    if outcome.passed:
        click.echo(f"verified: {outcome.plan} holds, {outcome.steps} steps and {outcome.configurations} configurations")
        if outcome.smallest_clearance is not None:
            near = outcome.smallest_clearance
            click.echo(
                f"smallest clearance   {1000 * near.distance:.2f} mm, {near.first} and {near.second}, "
                f"step {near.step + 1} ({near.part})"
            )
        if outcome.states:
            click.echo(f"under gravity        all {outcome.states} states stand")
        click.echo(f"not checked          {', '.join(outcome.not_checked)}")
        return
    click.echo(f"not verified: {outcome.plan} has {len(outcome.findings)} findings")
    for finding in outcome.findings[:SHOWN_FINDINGS]:
        click.echo(f"  {format_finding(finding)}")
    if len(outcome.findings) > SHOWN_FINDINGS:
        click.echo(f"  ... and {len(outcome.findings) - SHOWN_FINDINGS} more (all of them: --json or --report FILE)")


@click.command(
    short_help="Read a plan backwards: the assembly plan.",
    epilog="Example: takeapart assemble product.plan.json --out product.assembly-plan.json",
)
@click.argument("plan", type=FILE)
@click.option("--out", type=FILE, required=True, help="The inverted plan file.")
@json_option
def assemble(plan: Path, out: Path, as_json: bool) -> None:
    """Write the inverse of PLAN: the order of parts and every path reversed.

    Of a plan for disassembly this is the plan for assembly, and the other way round.
    """
    from takeapart.files import load_plan, save_plan

    require_output(out, plan)
    inverted = load_plan(plan).inverted()
    save_plan(inverted, out)
    if as_json:
        print_json({"file": str(out), **plan_summary(inverted)})
        return
    print_plan(inverted)
    click.echo(f"written to           {out}")
