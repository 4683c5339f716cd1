"""``takeapart demo``: a shipped assembly, planned and verified."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from takeapart.cli.output import (
    EXIT_UNVERIFIED,
    FOLDER,
    SECONDS,
    examples,
    json_option,
    make_folder,
    note,
    print_json,
    progress_bar,
    require_output,
    seed_option,
)
from takeapart.cli.plan import make_plan
from takeapart.cli.plan_output import plan_summary, print_plan, save_or_explain
from takeapart.cli.search_options import options_of
from takeapart.cli.verify import print_verdict
from takeapart.model.errors import MissingExtraError
from takeapart.search.registry import SEARCHES

if TYPE_CHECKING:
    from takeapart.model.assembly import Assembly
    from takeapart.model.plan import Plan
    from takeapart.verification import VerificationReport
    from takeapart.workcell import Workcell

DEMO_ASSEMBLY = "single/01.json"
DEMO_WORKCELL = "panda"


@click.command(
    short_help="Plan and verify a shipped assembly.",
    epilog=examples("takeapart demo", "takeapart demo --search greedy --out first"),
)
@click.option(
    "--out", type=FOLDER, default=Path("out/demo"), show_default=True, help="Folder of plan.json; made if needed."
)
@click.option(
    "--search", type=click.Choice(list(SEARCHES)), default="exact", show_default=True, help="As of the command plan."
)
@click.option(
    "--seconds",
    type=SECONDS,
    default=40.0,
    show_default=True,
    help="Time limit of the search, inf for none; the best plan so far is kept.",
)
@seed_option
@json_option
def demo(out: Path, search: str, seconds: float, seed: int, as_json: bool) -> None:
    """Plan the disassembly of a shipped assembly of 21 aluminium profiles with a Franka Panda.

    Writes plan.json and prints the order with the length of the gripper's path for each part, the total, and how far
    it can be from the best. The plan is then verified independently if MuJoCo is installed. At last plan.html, which
    plays the plan in a browser, and report.html are written beside it.
    """
    from takeapart.formats.files import data_path, load_assembly, load_workcell

    assembly, workcell = load_assembly(data_path(DEMO_ASSEMBLY)), load_workcell(DEMO_WORKCELL)
    make_folder(out)
    file = out / "plan.json"
    require_output(file)
    made, interrupted = make_plan(assembly, workcell, options_of(search, seed, seconds=seconds))
    plan = save_or_explain(made, interrupted, file, as_json)
    if not as_json:
        print_plan(plan)
        click.echo(f"written to           {file}")
    outcome = _verified(plan, assembly, workcell)
    if as_json:
        verified = None if outcome is None else outcome.passed
        summary = plan_summary(plan)
        print_json({"feasible": True, "file": str(file), "interrupted": interrupted, **summary, "verified": verified})
    elif outcome is not None:
        print_verdict(outcome)
    _show(file, out, as_json)
    if outcome is not None and not outcome.passed:
        raise click.exceptions.Exit(EXIT_UNVERIFIED)


def _verified(plan: Plan, assembly: Assembly, workcell: Workcell) -> VerificationReport | None:
    """What the verification says; None, with a note on how to install it, without MuJoCo."""
    try:
        from takeapart.verification import verify_plan
    except MissingExtraError as missing:
        note(f"not verified: {missing}")
        return None
    with progress_bar(f"verifying {assembly.name}"):
        return verify_plan(plan, assembly, workcell)


def _show(plan: Path, folder: Path, as_json: bool) -> None:
    """Writes the pages that show a plan, and says where they are, or in one line why they are not."""
    from takeapart.model.errors import TakeapartError
    from takeapart.page.standalone import save_page
    from takeapart.report import save_report

    for write, name, purpose in (
        (save_page, "plan.html", "plays the plan in a browser"),
        (save_report, "report.html", "all about the plan on one page"),
    ):
        try:
            write(plan, folder / name)
        except TakeapartError as error:
            note(f"{name} was not written: {error}")
            continue
        if not as_json:
            click.echo(f"written to           {folder / name}: {purpose}")
