"""``takeapart view``: an assembly, a plan or a run in the browser; and ``takeapart plan --view``."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from takeapart.cli.output import (
    EXIT_ERROR,
    FILE,
    examples,
    json_option,
    note,
    plan_assembly_option,
    plan_workcell_option,
    print_json,
    require_output,
)
from takeapart.formats.messages import reason, shown
from takeapart.model.errors import InputError, TakeapartError

if TYPE_CHECKING:
    from takeapart.model.assembly import Assembly
    from takeapart.viewer import Viewer
    from takeapart.viewer.live import LiveSearch
    from takeapart.workcell import Workcell

WATCH_PERIOD = 0.5  # s


@click.command(
    short_help="Show an assembly, a plan or a run in the browser.",
    epilog=examples("takeapart view product.plan.json", "takeapart view product.plan.json --html plan.html"),
)
@click.argument("file", type=FILE)
@click.option("--html", type=FILE, metavar="FILE", help="Write a page that plays without a server, instead of serving.")
@plan_assembly_option
@plan_workcell_option
@click.option("--port", type=click.IntRange(1024, 65535), help="Of the local address.  [default: one that is free]")
@click.option("--open", "open_browser", is_flag=True, help="Also open the page in the default browser.")
@json_option
def view(
    file: Path,
    html: Path | None,
    assembly: Path | None,
    workcell: str | None,
    port: int | None,
    open_browser: bool,
    as_json: bool,
) -> None:
    """Show FILE, an assembly, a plan or a run directory, in the browser, until Ctrl-C.

    The page plays the plan, step by step and in both directions; a click on a part tells when it leaves, why not
    earlier, and which other removals a run found. Nobody but this machine can reach it. When FILE changes, the page
    follows; when FILE is damaged, the page says so. With --html an assembly or a plan becomes one file of a few
    MB that plays from disk, without a server and without the network. Needs the extra "view": pip install
    'takeapart[view]'.
    """
    if html is not None:
        if port is not None or open_browser:
            raise click.UsageError("--html writes a file and serves nothing; leave out --port and --open")
        _write_page(file, html, assembly, workcell, as_json)
        return
    try:
        file.stat()
    except FileNotFoundError:
        raise InputError("there is no such file", shown(file)) from None
    except OSError as error:
        raise InputError(f"cannot be read: {reason(error)}", shown(file)) from None
    from takeapart.viewer import Viewer

    viewer = Viewer(port)
    stop = threading.Event()
    thread = threading.Thread(target=viewer.serve, args=(stop,), name="viewer", daemon=True)
    try:
        failed = _load(viewer, file, assembly, workcell)
        thread.start()
        if as_json:
            print_json({"url": viewer.url, "error": failed})
        note(f"showing {file} at {viewer.url} (Ctrl-C ends)")
        if open_browser:
            click.launch(viewer.url)
        failed = _follow(viewer, file, assembly, workcell, failed)
    finally:
        stop.set()
        viewer.close()
    if failed is not None:
        raise click.exceptions.Exit(EXIT_ERROR)


def _write_page(file: Path, html: Path, assembly: Path | None, workcell: str | None, as_json: bool) -> None:
    if html.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"unknown ending {html.suffix!r}; give a name that ends in .html", str(html))
    require_output(html, *([] if file.is_dir() else [file]))
    from takeapart.page.standalone import save_page

    save_page(file, html, assembly, workcell)
    if as_json:
        print_json({"file": str(html), "bytes": html.stat().st_size})
    else:
        note(f"written to {html}, {html.stat().st_size / 1e6:.1f} MB; open it in a browser")


def _load(viewer: Viewer, file: Path, assembly: Path | None, workcell: str | None) -> str | None:
    """Shows a file, or its error, which is returned."""
    from takeapart.planning.run_journal import recorded_answers
    from takeapart.planning.runs import JOURNAL
    from takeapart.show.facts import part_facts
    from takeapart.show.scene import PlanScene
    from takeapart.show.subject import load_subject

    try:
        subject = load_subject(file, assembly, workcell)
        answers = recorded_answers(subject.run / JOURNAL) if subject.run else []
        scene = PlanScene(subject.assembly, subject.workcell, subject.plan)
        viewer.show(scene, part_facts(scene, answers))
    except TakeapartError as error:
        note(f"error: {error}")
        viewer.fail(str(error))
        return str(error)
    return None


def _follow(viewer: Viewer, file: Path, assembly: Path | None, workcell: str | None, failed: str | None) -> str | None:
    """Shows the file anew whenever it changes, until Ctrl-C; returns the error that stands at the end."""
    pause, seen = threading.Event(), _stamp(file)
    try:
        while not pause.wait(WATCH_PERIOD):
            now = _stamp(file)
            if now != seen:
                seen = now
                failed = _load(viewer, file, assembly, workcell)
    except KeyboardInterrupt:
        pass
    return failed


def _stamp(file: Path) -> tuple[float, int] | None:
    from takeapart.planning.runs import PLAN

    watched = file / PLAN if file.is_dir() else file
    try:
        status = watched.stat()
    except OSError:
        return None
    return status.st_mtime, status.st_size


@contextmanager
def live_view(assembly: Assembly, workcell: Workcell) -> Iterator[LiveSearch]:
    """Shows a search while it runs; yields what listens to it."""
    from takeapart.viewer import Viewer
    from takeapart.viewer.live import LiveSearch

    viewer = Viewer()
    stop = threading.Event()
    try:
        live = LiveSearch(viewer, assembly, workcell)
        for target in (viewer.serve, live.serve):
            threading.Thread(target=target, args=(stop,), name="viewer", daemon=True).start()
        note(f"the search can be watched at {viewer.url}")
        yield live
    finally:
        stop.set()
        viewer.close()


def keep_showing(live: LiveSearch, file: Path) -> None:
    """Shows a finished plan until Ctrl-C."""
    from takeapart.formats.files import load_plan

    live.finish(load_plan(file))
    note(f"showing {file} at {live.viewer.url} (Ctrl-C ends)")
    with suppress(KeyboardInterrupt):
        threading.Event().wait()
