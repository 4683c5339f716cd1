"""``takeapart report``: one page about a plan or a run."""

from __future__ import annotations

from pathlib import Path

import click

from takeapart.cli.output import (
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
from takeapart.model.errors import InputError


@click.command(
    short_help="Write one page about a plan or a run: picture, lengths, bounds, reasons.",
    epilog=examples("takeapart report product.plan.json --out report.html"),
)
@click.argument("file", metavar="PLAN|RUN", type=FILE)
@click.option("--out", type=FILE, required=True, help="The HTML file; it needs no other file.")
@plan_assembly_option
@plan_workcell_option
@click.option(
    "--verification",
    type=FILE,
    help="What 'takeapart verify --report' wrote about the plan.  [default: x.verification.json beside x.plan.json]",
)
@json_option
def report(
    file: Path, out: Path, assembly: Path | None, workcell: str | None, verification: Path | None, as_json: bool
) -> None:
    """Write one HTML page about PLAN, a plan file, or RUN, a run directory whose search has ended.

    It shows the assembly, the order, the length of every step beside its bound, length and bound against queries, which
    part waits for which, counts, settings and hashes; it can be read on a phone and printed. Of a run it also tells
    what the planner answered, of a verified plan the clearance of every step. The picture needs the extra "view" and
    OpenGL, all else does not.
    """
    if out.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"unknown ending {out.suffix!r}; give a name that ends in .html", str(out))
    require_output(out, *([] if file.is_dir() else [file]), *([verification] if verification else []))
    from takeapart.report import save_report

    with progress_bar(f"writing {out}"):
        save_report(file, out, assembly, workcell, verification)
    if as_json:
        print_json({"file": str(out), "bytes": out.stat().st_size})
    else:
        note(f"written to {out}")
