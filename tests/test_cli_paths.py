"""Every path of every command, given names that the system or the command has to refuse: one line, nothing written."""

from __future__ import annotations

import codecs
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from small_assemblies import WORKCELL, two_bars
from takeapart.cli.commands import main
from takeapart.formats.files import save_assembly, save_plan
from verification_scene import scene_plan

NOBODY = 65534
ENDINGS = {
    "--workcell": ".toml",
    "--html": ".html",
    "--picture": ".png",
    "report --out": ".html",
    "robot --out": ".toml",
    "render --out": ".png",
}
FOLDERS = {"generate --out", "demo --out", "compare --out", "reproduce paper --out", "reproduce beyond --out"}
FOLDERS |= {"plan --run", "plan --experience", "generate products --out"}
PATHS = {"--out", "--run", "--experience", "--guide", "--workcell", "--assembly", "--html", "--report", "--document"}
PATHS |= {"--verification", "--product", "--picture"}
COMMANDS = {
    "plan": ["a.json"],
    "show": ["p.json"],
    "explain": ["a.json"],
    "import": ["parts", "--unit", "m", "--out", "o"],
    "assemble": ["p.json", "--out", "o.json"],
    "verify": ["p.json", "--assembly", "a.json", "--workcell", "cell.toml"],
    "view": ["p.json", "--html", "o.html", "--assembly", "a.json", "--workcell", "cell.toml"],
    "render": ["p.json", "--out", "o.png", "--assembly", "a.json", "--workcell", "cell.toml"],
    "report": ["p.json", "--out", "o.html", "--assembly", "a.json", "--workcell", "cell.toml"],
    "compare": ["a.json", "--budget-queries", "1"],
    "train": ["seen"],
    "generate": [],
    "generate products": [],
    "demo": [],
    "robot": ["panda", "--product", "a.json", "--workcell", "new.toml"],
    "reproduce paper": ["--quick"],
    "reproduce beyond": ["a.json"],
}
HOSTILE = {
    "long": "x" * 300,
    "long, in a new folder": f"new/{'x' * 300}",
    "device": "/dev/full",
    "slash": "new/",
    "loop": "loop",
    "null": "a\x00b",
    "empty": "",
    "through a file": "a.json/file",
    "closed": "closed/file",  # last: the others have imported what the command needs, perhaps from a closed folder
}
FACETS = ("0 0 0 0 .1 0 .1 0 0", "0 0 0 .1 0 0 0 0 .1", "0 0 0 0 0 .1 0 .1 0", ".1 0 0 0 .1 0 0 0 .1")
SOLID = "solid bar\n"
for corners in map(str.split, FACETS):
    vertices = "".join(f"vertex {' '.join(corners[k : k + 3])}\n" for k in (0, 3, 6))
    SOLID += f"facet normal 0 0 0\nouter loop\n{vertices}endloop\nendfacet\n"
SOLID += "endsolid bar\n"


def path_options(name: str) -> list[str]:
    """The options of a command that take a path, by what they are declared to take."""
    command: click.Command = main
    for word in name.split():
        assert isinstance(command, click.Group)
        command = command.commands[word]
    return [
        option
        for parameter in command.params
        for option in parameter.opts
        if isinstance(parameter, click.Option) and (option == "--workcell" or parameter.type.name in ("file", "folder"))
    ]


def places() -> list[tuple[str, str]]:
    """Commands, each with what of it is a path: an option, or "" for its argument."""
    return [
        (command, place)
        for command, arguments in COMMANDS.items()
        for place in (*([""] if arguments and not arguments[0].startswith("-") else []), *path_options(command))
    ]


@contextmanager
def unprivileged(folder: Path) -> Iterator[None]:
    """As somebody who is refused what permissions do not grant; the superuser never is."""
    if os.geteuid() != 0:
        yield
        return
    for path in (folder, *folder.rglob("*")):
        os.chown(path, NOBODY, NOBODY, follow_symlinks=False)
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Not below a folder of the superuser, where nobody else could come."""
    codecs.lookup("utf-8-sig")
    here = Path(tempfile.mkdtemp())
    save_assembly(two_bars(), here / "a.json")
    save_plan(scene_plan(), here / "p.json")
    (here / "cell.toml").write_text(WORKCELL)
    (here / "seen").mkdir()
    (here / "parts").mkdir()
    (here / "parts" / "bar.stl").write_text(SOLID)
    (here / "closed").mkdir(0)
    for ending in {"", *ENDINGS.values()}:
        (here / f"loop{ending}").symlink_to(f"loop{ending}")
    monkeypatch.chdir(here)

    def work_begins(*_: object, **__: object) -> None:
        raise AssertionError("the work began before the path was looked at")

    for module in ("plan", "inspect", "generate", "compare", "reproduce", "robot"):
        monkeypatch.setattr(f"takeapart.cli.{module}.compile_first", work_begins)
    yield here
    (here / "closed").chmod(0o700)
    shutil.rmtree(here)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else b"" for path in folder.rglob("*")}


@pytest.mark.parametrize(("command", "place"), places())
def test_hostile_paths_are_refused_in_one_line(command: str, place: str, folder: Path) -> None:
    ending = ENDINGS.get(place, ENDINGS.get(f"{command} {place}", ""))
    for kind, hostile in HOSTILE.items():
        if kind == "slash" and f"{command} {place}" in FOLDERS:
            continue  # a folder that is made
        name = hostile + (ending if kind not in ("slash", "device", "empty") else "")
        arguments = [*command.split(), *COMMANDS[command]]
        if place:
            arguments += [place, name]
        else:
            arguments[len(command.split())] = name
        if command == "plan" and place == "--guide":
            arguments += ["--search", "mcts"]
        before = contents(folder)
        with unprivileged(folder) if kind == "closed" else nullcontext():
            done = CliRunner().invoke(main, arguments)
        told = (command, place, kind, done.output, done.exception)
        assert isinstance(done.exception, SystemExit) and done.exit_code == 2, told
        assert done.stderr.startswith("error: ") and done.stderr.count("\n") == 1 and len(done.stderr) < 1000, told
        assert done.stdout == "", told
        assert contents(folder) == before, told


def test_all_commands_and_all_their_paths_are_tried() -> None:
    names = {*main.commands} - {"reproduce"}
    for name, command in main.commands.items():
        if isinstance(command, click.Group):
            names |= {f"{name} {each}" for each in command.commands}
    assert set(COMMANDS) == names
    assert {option for command in COMMANDS for option in path_options(command)} == PATHS


@pytest.mark.parametrize("command", ["show", "view", "plan", "verify"])
def test_a_link_to_itself_is_told_from_a_file_that_is_not_there(command: str, folder: Path) -> None:
    for name, told in (("loop", "symbolic links"), ("nothing", "there is no such file")):
        assert told in CliRunner().invoke(main, [command, name]).stderr


def test_outputs_in_new_folders_are_made(folder: Path) -> None:
    done = CliRunner().invoke(main, ["assemble", "p.json", "--out", "new/deep/o.json"])
    assert done.exit_code == 0 and (folder / "new/deep/o.json").is_file()


def test_a_full_standard_output_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    monkeypatch.setattr("takeapart.cli.commands._complain", told.append)
    with open("/dev/full", "w") as full, pytest.raises(SystemExit) as ended:
        monkeypatch.setattr("sys.stdout", full)
        main(["show", "panda"])
    assert ended.value.code == 2 and told == ["the system refused: no space left on device"]
