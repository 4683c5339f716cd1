"""What the commands share: exit codes, options, output files, tables, progress."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from takeapart.errors import InputError

if TYPE_CHECKING:
    from takeapart.search.result import Budget, Progress

EXIT_ERROR, EXIT_INFEASIBLE, EXIT_UNVERIFIED, EXIT_INTERRUPTED = 2, 3, 4, 130

PLAIN_WIDTH = 110  # of tables where the output is no terminal

FILE = click.Path(path_type=Path)
LARGEST_SEED = 2**63 - 1

json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON, for machines.")
seed_option = click.option(
    "--seed",
    type=click.IntRange(0, LARGEST_SEED),
    default=0,
    show_default=True,
    help="Of all random choices; the same input and seed give the same result.",
)
workcell_option = click.option(
    "--workcell",
    default="panda",
    show_default=True,
    metavar="NAME|FILE.toml",
    help="Arm, gripper, goal and obstacles: the name of a shipped workcell or a TOML file.",
)


def print_json(data: object) -> None:
    """One JSON document on standard output."""
    click.echo(json.dumps(data, indent=2, allow_nan=False))


def note(message: str) -> None:
    """A remark on standard error, where it disturbs no machine that reads the output."""
    click.echo(message, err=True)


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table on standard output. Columns whose name starts with ">" are aligned to the right."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title or None, title_justify="left", title_style="bold", box=None, pad_edge=False)
    for column in columns:
        right = column.startswith(">")
        table.add_column(column.removeprefix(">"), justify="right" if right else "left", overflow="fold")
    for row in rows:
        table.add_row(*row)
    terminal = sys.stdout.isatty()
    console = Console(markup=False, highlight=False, emoji=False, width=None if terminal else PLAIN_WIDTH)
    with console.capture() as capture:
        console.print(table)
    click.echo("\n".join(line.rstrip() for line in capture.get().splitlines()))


def metres(value: float | None) -> str:
    """A length for people."""
    return "-" if value is None or not math.isfinite(value) else f"{value:.3f} m"


def require_output(path: Path, *inputs: Path) -> None:
    """Finds out before the work starts whether a file can be written where it shall go.

    Raises:
        InputError: there is no such folder, the path is a folder, or one of the inputs would be overwritten.
    """
    if not path.parent.is_dir():
        raise InputError(f"cannot be written: there is no folder {path.parent}; make it first", str(path))
    if path.is_dir():
        raise InputError("cannot be written: it is a folder; give the name of a file", str(path))
    if any(source.exists() and path.exists() and path.samefile(source) for source in inputs):
        raise InputError("is an input of this command; give another name to --out", str(path))


def make_folder(path: Path) -> None:
    """A folder for output, with all folders above it.

    Raises:
        InputError: it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"the folder cannot be made: {(error.strerror or str(error)).lower()}", str(path)) from None


@contextmanager
def progress_bar(description: str) -> Iterator[Callable[[str, float | None], None]]:
    """A progress bar on standard error; nothing at all where that is no terminal.

    Yields:
        update(text, fraction): what is done at the moment, and how much of all, from 0 to 1, if that is known.
    """
    if not sys.stderr.isatty():
        yield lambda text, fraction: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns: tuple[Any, ...] = (
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(24),
        TimeElapsedColumn(),
        TextColumn("{task.fields[text]}", markup=False),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(description, total=None, text="")

        def update(text: str, fraction: float | None) -> None:
            share = None if fraction is None else min(1.0, fraction)
            progress.update(task, text=text, total=None if share is None else 1.0, completed=share or 0.0)

        yield update


def search_listener(update: Callable[[str, float | None], None], budget: Budget) -> Callable[[Progress], None]:
    """Shows the signs of life of a search in a progress bar."""

    def listen(progress: Progress) -> None:
        shares = (
            progress.episode / budget.episodes,
            progress.seconds / budget.seconds,
            progress.queries / budget.queries,
        )
        limited = any(math.isfinite(limit) for limit in (budget.episodes, budget.seconds, budget.queries))
        text = f"best {metres(progress.length)}, {progress.queries} queries"
        if math.isfinite(progress.bound):
            text += f", bound {metres(progress.bound)}"
        update(text, max(shares) if limited else None)

    return listen
