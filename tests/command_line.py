"""The command line as tests call it: in this process, from a folder of the user's."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from small_assemblies import WORKCELL
from takeapart.cli import compile as cli_compile
from takeapart.cli.commands import main
from takeapart.formats.files import save_assembly
from takeapart.model.assembly import Assembly


def enter(folder: Path, assemblies: Iterable[Assembly], monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes a folder the place where the user stands, with assemblies, a workcell, and the output of an earlier run."""
    for assembly in assemblies:
        save_assembly(assembly, folder / f"{assembly.name}.json")
    (folder / "cell.toml").write_text(WORKCELL)
    (folder / "old.json").write_text("an earlier plan")
    monkeypatch.setattr(cli_compile, "missing", lambda orders: {})  # whether the cache is warm or not: no notice
    monkeypatch.chdir(folder)


def run(*arguments: str) -> Result:
    """What a command leaves; no error of it is anything but an exit."""
    result = CliRunner().invoke(main, arguments)
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def plan(assembly: str, *arguments: str) -> Result:
    """Of `takeapart plan` in the workcell of `enter`."""
    return run("plan", assembly, "--workcell", "cell.toml", *arguments)
