"""The command line as a whole. Every command stands in a module of its own.

Exit codes: 0 done, 2 broken input or misuse, 3 no feasible order, 4 a plan did not pass its verification, 130 stopped
by Ctrl-C before there was anything to keep. Whatever is wrong is told in one line on standard error.

Nothing heavy is imported before a command runs, so that ``takeapart --help`` answers at once.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Sequence
from typing import Any

import click

import takeapart
from takeapart.cli.compare import compare
from takeapart.cli.demo import demo
from takeapart.cli.generate import generate
from takeapart.cli.import_product import import_product
from takeapart.cli.inspect import explain, show
from takeapart.cli.output import EXIT_ERROR, EXIT_INTERRUPTED, paragraph
from takeapart.cli.plan import plan
from takeapart.cli.render import render
from takeapart.cli.report import report
from takeapart.cli.reproduce import reproduce
from takeapart.cli.robot import robot
from takeapart.cli.train import train
from takeapart.cli.verify import assemble, verify
from takeapart.cli.view import view
from takeapart.formats.messages import reason, shown
from takeapart.model.errors import TakeapartError


class CommandLine(click.Group):
    """A group of commands that ends every failure with one line and an exit code."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        **extra: Any,
    ) -> Any:
        """Runs a command and leaves the process with its exit code."""
        try:
            code = super().main(args, prog_name or "takeapart", complete_var, standalone_mode=False, **extra)
        except click.Abort:  # click makes this of Ctrl-C
            _complain("interrupted; nothing was written that is not complete")
            code = EXIT_INTERRUPTED
        except click.UsageError as error:
            command = error.ctx.command_path if error.ctx is not None else "takeapart"
            _complain(f"{error.format_message().rstrip('.')} (see: {command} --help)")
            code = error.exit_code
        except click.ClickException as error:
            _complain(error.format_message())
            code = error.exit_code
        except TakeapartError as error:
            _complain(str(error))
            code = EXIT_ERROR
        except OSError as error:  # what no command foresaw, as a full standard output
            named = isinstance(error.filename, str | bytes)
            where = f"{shown(os.fsdecode(error.filename))}: " if named else "the system refused: "
            _complain(f"{where}{reason(error)}")
            code = EXIT_ERROR
        _flush_output()
        sys.exit(code if isinstance(code, int) else 0)

    def list_commands(self, ctx: click.Context) -> list[str]:
        """In the order in which they are met, not by the alphabet."""
        return list(self.commands)


def _flush_output() -> None:
    """So that a full or closed output does not end in the interpreter's own words while it shuts down."""
    try:
        sys.stdout.flush()
    except (OSError, ValueError):
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _complain(message: str) -> None:
    click.echo(f"error: {' '.join(message.split())}", err=True)


@click.group(
    name="takeapart",
    cls=CommandLine,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    help="Plan how a robot builds a product by planning how it takes the product apart.\n\n"
    + paragraph(
        "A first look:",
        "  takeapart demo",
        "Your own product:",
        "  takeapart import product.step --out product/",
        "  takeapart show product.json",
        "  takeapart plan product.json --workcell cell.toml",
        "  takeapart verify product.plan.json",
        "  takeapart view product.plan.json",
        "No plan? Why:",
        "  takeapart explain product.json --workcell cell.toml",
    )
    + "\n\nEvery command explains itself: takeapart COMMAND --help.",
    epilog=paragraph(
        "Exit codes:",
        "  0    done",
        "  2    broken input or misuse: one line says what, where and what is valid",
        "  3    no feasible order",
        "  4    a plan did not pass its verification",
        "  130  stopped by Ctrl-C before there was anything to keep",
    ),
)
@click.version_option(takeapart.__version__, prog_name="takeapart")
@click.pass_context
def main(context: click.Context) -> None:
    """All commands; without any of them the help is printed."""
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


for _command in (
    demo,
    generate,
    import_product,
    plan,
    show,
    explain,
    assemble,
    verify,
    view,
    render,
    report,
    robot,
    compare,
    train,
    reproduce,
):
    main.add_command(_command)
