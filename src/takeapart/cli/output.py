"""What the commands share: exit codes, options, output files, tables, progress."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from takeapart.formats.messages import reason, shown
from takeapart.model.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.progress import Progress

    from takeapart.search.result import Budget
    from takeapart.search.result import Progress as SearchProgress

EXIT_ERROR, EXIT_INFEASIBLE, EXIT_UNVERIFIED, EXIT_INTERRUPTED = 2, 3, 4, 130

PLAIN_WIDTH = 110  # of tables where the output is no terminal
TITLE_WIDTH = 40  # of what a progress bar is for, so that bar and time fit in 80 columns with it


class FileName(click.ParamType):
    """A path; unlike `pathlib.Path` it does not overlook a slash at the end, which stands for a folder.

    Args:
        folder: whether a folder is meant, which may be made; otherwise a file, or a folder that is there.
    """

    def __init__(self, folder: bool = False) -> None:
        self.folder = folder
        self.name = "folder" if folder else "file"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path.

        Raises:
            InputError: the name is empty, holds a null character, or ends in a slash and no such folder is there.
        """
        text = os.fspath(value)
        if not text:
            raise InputError(f"the name of a {self.name} is empty", _option(param))
        if "\x00" in text:
            raise InputError("holds a null character, which no name may", shown(text))
        if not self.folder and text.endswith(os.sep) and not os.path.isdir(text):
            raise InputError("ends in '/', which stands for a folder, and there is no such folder", shown(text))
        return Path(text)


class Seconds(click.ParamType):
    """A time limit in seconds; ``inf`` is none."""

    name = "seconds"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The limit.

        Raises:
            InputError: no number above 0, or one too large to be held.
        """
        text = str(value).strip().lower()
        if text in ("inf", "infinity", "+inf"):
            note(f"{_option(param)} {text}: no time limit; Ctrl-C ends the search and keeps the best plan so far")
            return math.inf
        try:
            seconds = float(text)
        except ValueError:
            seconds = math.nan
        if not 0 < seconds < math.inf:
            raise InputError(f"{value}; must be a number of seconds above 0, or inf for no limit", _option(param))
        return seconds


class FiniteNumber(click.FloatRange):
    """A number in a range, never NaN or infinite, which `click.FloatRange` lets through."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The number; fails as click's types do."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return number


def _option(param: click.Parameter | None) -> str:
    return "" if param is None else param.opts[0] if isinstance(param, click.Option) else str(param.human_readable_name)


def examples(*commands: str) -> str:
    """The end of a help page: commands that can be copied, each on a line of its own."""
    return paragraph("Example:" if len(commands) == 1 else "Examples:", *(f"  {each}" for each in commands))


def paragraph(*lines: str) -> str:
    """Lines of a help page that stay as they are; click fills all other paragraphs anew."""
    return "\n".join(["\b", *lines])


FILE = FileName()
FOLDER = FileName(folder=True)
SECONDS = Seconds()
LARGEST_SEED = 2**63 - 1

plan_assembly_option = click.option(
    "--assembly",
    type=FILE,
    help="The assembly of a plan.  [default: the one with the plan's hash, beside it or shipped]",
)
plan_workcell_option = click.option(
    "--workcell",
    metavar="NAME|FILE.toml",
    help="The workcell.  [default: the one with the plan's hash, shipped or beside it; panda without a plan]",
)
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
        InputError: it cannot, see `takeapart.formats.documents.require_writable`; or one of the inputs would be
            overwritten.
    """
    from takeapart.formats.documents import require_writable

    require_writable(path)
    if any(_same_file(path, source) for source in inputs):
        raise InputError("is an input of this command; give another name for the output", shown(path))


def _same_file(path: Path, source: Path) -> bool:
    try:
        return path.samefile(source)
    except (OSError, ValueError):  # one of them is not there; what is wrong with an input is told when it is read
        return False


def make_folder(path: Path) -> None:
    """A folder for output that can be written, with all folders above it.

    Raises:
        InputError: it cannot be made, or no file can be made in it.
    """
    from takeapart.formats.documents import require_names, require_writable

    try:
        require_names(path)  # so that no folder is left behind above one that cannot be made
        path.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise InputError(f"the folder cannot be made: {reason(error)}", shown(path)) from None
    require_writable(path / "any")


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

    with progress_of(Console(stderr=True)) as progress:
        task = progress.add_task(description, total=None, text="")

        def update(text: str, fraction: float | None) -> None:
            share = None if fraction is None else min(1.0, fraction)
            progress.update(task, text=text, total=None if share is None else 1.0, completed=share or 0.0)

        yield update


def progress_of(console: Console) -> Progress:
    """A bar with its title and the time, and below it what is done at the moment; both fit in 80 columns."""
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
    from rich.table import Column
    from rich.text import Text

    def cut(width: int | None = None) -> Column:
        return Column(no_wrap=True, overflow="ellipsis", max_width=width)

    class TwoLines(Progress):
        def get_renderables(self) -> Iterator[RenderableType]:
            yield self.make_tasks_table(self.tasks)
            for task in self.tasks:
                if task.fields["text"]:
                    yield Text(f"  {task.fields['text']}", no_wrap=True, overflow="ellipsis")

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False, table_column=cut(TITLE_WIDTH)),
        BarColumn(24),
        TimeElapsedColumn(),
    )
    return TwoLines(*columns, console=console, transient=True)


def search_listener(update: Callable[[str, float | None], None], budget: Budget) -> Callable[[SearchProgress], None]:
    """Shows the signs of life of a search in a progress bar."""

    def listen(progress: SearchProgress) -> None:
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
