"""Bad input: every kind of it gives one line that names file, place, value and what is valid; nothing is written.

The fuzz harness changes valid documents, as data and as bytes. `make slow` runs it on many more inputs.
"""

from __future__ import annotations

import copy
import json
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import example_documents
import fuzz_readers
import fuzzed_readers
from fuzzed_readers import Reader
from takeapart.formats.files import load_assembly, load_plan, load_workcell
from takeapart.model.errors import InputError, TakeapartError

Path_ = tuple[str | int, ...]
READERS: dict[str, Callable[[Path], object]] = {"json": load_assembly, "plan": load_plan, "toml": load_workcell}
NONE = object()


def changed(document: Any, path: Path_, value: object) -> Any:
    """A copy in which one place holds something else, or nothing."""
    document = copy.deepcopy(document)
    place = document
    for step in path[:-1]:
        place = place[step]
    if value is NONE:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    return document


def refusal(reader: Callable[[Path], object], path: Path, content: bytes | str) -> str:
    """The message of a refusal, without the file's name; fails where the file is taken."""
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError) as caught:
        reader(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: "), message
    assert len(message.splitlines()) == 1
    assert len(message) < 350 + len(str(path))
    return message.removeprefix(f"{path}: ")


def test_the_examples_are_valid(tmp_path: Path) -> None:
    """Otherwise the tests below would show nothing."""
    (tmp_path / "a.json").write_text(json.dumps(example_documents.assembly()))
    (tmp_path / "p.json").write_text(json.dumps(example_documents.plan()))
    (tmp_path / "w.toml").write_text(example_documents.WORKCELL)
    assert len(load_assembly(tmp_path / "a.json").parts) == 3
    assert len(load_plan(tmp_path / "p.json").steps) == 2
    assert load_workcell(tmp_path / "w.toml").name == "bench"


ASSEMBLY_ERRORS: list[tuple[Path_, object, str]] = [
    (("format",), "takeapart/plan", "format: format 'takeapart/plan'; must be 'takeapart/assembly'"),
    (("format",), NONE, "format: there is no key 'format'; must be 'takeapart/assembly'"),
    (("version",), 3, "version: version 3; this release reads version 1 and 2"),
    (("version",), True, "version: version True; this release reads version 1 and 2"),
    (("version",), "1", "version: version '1'; this release reads version 1 and 2"),
    (("name",), "../evil", "name: '../evil'; must be 1 to 64 letters, digits, '.', '_' or '-'"),
    (("name",), "a\n", "name: 'a\\n'; must be 1 to 64 letters, digits, '.', '_' or '-'"),
    (("parts",), [], "parts: has 0 entries; must have at least 1"),
    (("parts",), {}, "parts: {}; must be a list"),
    (("parts",), NONE, "parts: is missing"),
    (("parts", 0), 5, "parts[0]: 5; must be an object"),
    (("parts", 1, "mass"), float("nan"), "parts[1].mass: nan; must be a finite number"),
    (("parts", 1, "mass"), float("-inf"), "parts[1].mass: -inf; must be a finite number"),
    (("parts", 1, "mass"), "0.5", "parts[1].mass: '0.5'; must be a number"),
    (("parts", 1, "mass"), True, "parts[1].mass: True; must be a number"),
    (("parts", 1, "mass"), None, "parts[1].mass: None; must be a number"),
    (("parts", 1, "mass"), 0, "parts[1].mass: 0; must be above 0"),
    (("parts", 1, "mass"), NONE, "parts[1].mass: is missing"),
    (("parts", 1, "mas"), 1, "parts[1]: unknown key 'mas'; valid: name, shape, pose, mass, fixed"),
    (("parts", 1, "{0}\n"), 1, "parts[1]: unknown key '{0}\\n'; valid: name, shape, pose, mass, fixed"),
    (("parts", 1, "fixed"), 1, "parts[1].fixed: 1; must be true or false"),
    (("parts", 1, "name"), "base", "parts[1].name: name 'base' is used before, by parts[0]"),
    (("parts", 1, "shape", "kind"), "ball", "parts[1].shape.kind: 'ball'; must be 'box' or 'mesh'"),
    (("parts", 1, "shape", "size", 1), -0.02, "parts[1].shape.size[1]: -0.02; must be at least 0.0001"),
    (("parts", 1, "shape", "size"), [1.0, 1.0], "parts[1].shape.size: has 2 entries; must have at least 3"),
    (("parts", 1, "shape", "size"), [1.0] * 4, "parts[1].shape.size: 4 entries; at most 3 are allowed"),
    (("parts", 1, "pose", "position", 0), 400, "parts[1].pose.position[0]: 400; must be at most 100"),
    (
        ("parts", 1, "pose", "orientation"),
        [1, 0, 0, 0.1],
        "parts[1].pose.orientation: [1, 0, 0, 0.1]; its norm is 1.00499; must be a unit quaternion",
    ),
    (
        ("parts", 1, "pose", "orientation"),
        [0, 0, 0, 0],
        "parts[1].pose.orientation: [0, 0, 0, 0]; its norm is 0; must be a unit quaternion",
    ),
    (("connectors", 0, "kind"), "V", "connectors[0].kind: 'V'; must be 'U' or 'O'"),
    (("connectors", 0, "host"), "nobody", "connectors[0] (holder).host: there is no part 'nobody'"),
    (("connectors", 0, "guest"), "base", "connectors[0] (holder): host and guest are the same part 'base'"),
    (("connectors", 0, "walls"), [], "connectors[0].walls: has 0 entries; must have at least 1"),
    (("witness",), ["bar"], "witness: must name every removable part exactly once"),
    (
        ("provenance", "x"),
        float("inf"),
        "provenance: {'generator': 'by hand', 'seed': 7, ...}; holds inf; only finite numbers are allowed",
    ),
    (
        ("provenance", "x"),
        [[[[[[[[[]]]]]]]]],
        "provenance: {'generator': 'by hand', 'seed': 7, ...}; nested deeper than 8 levels",
    ),
    (("provenance",), {"x": [0] * 30_000}, "provenance: {'x': [0, 0, 0, 0, ...]}; more than 20000 values"),
    (
        ("provenance",),
        {"x": "y" * 5000},
        "provenance: {'x': 'yyyyyyyyyyyyyyyyy...yyyyyyyyyyyyyyyyyy'}; holds a text longer than 4096 characters",
    ),
    (
        ("parts", 2, "pose", "position"),
        [0.2, 0.2, 0.05],
        "parts: parts 'base' and 'block' overlap by 5.00 mm; at most 0.1 mm is allowed",
    ),
]


@pytest.mark.parametrize(("path", "value", "message"), ASSEMBLY_ERRORS)
def test_assembly_errors(tmp_path: Path, path: Path_, value: object, message: str) -> None:
    document = changed(example_documents.assembly(), path, value)
    assert refusal(load_assembly, tmp_path / "a.json", json.dumps(document)) == message


PLAN_ERRORS: list[tuple[Path_, object, str]] = [
    (("steps", 1, "tool_path", 2, 4), float("nan"), "steps[1].tool_path[2][4]: nan; must be a finite number"),
    (
        ("steps", 1, "tool_path", 2, 4),
        0.9,
        "steps[1].tool_path[2]: [0.1, 0.1, 0.07, 0.0, ...]; its norm is 0.9; must be a unit quaternion",
    ),
    (("steps", 1, "tool_path", 2), [0.0] * 6, "steps[1].tool_path[2]: has 6 entries; must have at least 7"),
    (
        ("steps", 0, "tool_path", 3),
        NONE,
        "steps[0]: joint_path has 4 rows and tool_path 3; they must have the same number",
    ),
    (
        ("steps", 0, "joint_path", 3),
        [0.0] * 6,
        "steps[0]: joint_path[3] has 6 angles; every row must have 7, as the first has",
    ),
    (("steps", 0, "joint_path"), [[0.0] * 7], "steps[0].joint_path: has 1 entries; must have at least 2"),
    (("steps", 0, "grasp", "width"), -0.01, "steps[0].grasp.width: -0.01; must be at least 0"),
    (("steps", 0, "part"), "", "steps[0].part: ''; must be 1 to 64 letters, digits, '.', '_' or '-'"),
    (("counts", "motion_plans"), 1.5, "counts.motion_plans: 1.5; must be a whole number"),
    (("counts", "removal_queries"), -1, "counts.removal_queries: -1; must be at least 0"),
    (("hashes", "assembly"), "F" * 64, f"hashes.assembly: '{'F' * 17}...{'F' * 18}'; must be 64 digits of a SHA-256"),
    (("direction",), "sideways", "direction: 'sideways'; must be 'disassembly' or 'assembly'"),
    (("seed",), 10**39, f"seed: {10**39}; must be at most 1.84467e+19"),
    (("sequence_bound",), NONE, "sequence_bound: is missing"),
    (("steps",), [{}] * 1001, "steps[0].part: is missing"),
]


@pytest.mark.parametrize(("path", "value", "message"), PLAN_ERRORS)
def test_plan_errors(tmp_path: Path, path: Path_, value: object, message: str) -> None:
    document = changed(example_documents.plan(), path, value)
    assert refusal(load_plan, tmp_path / "p.json", json.dumps(document)) == message


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            '"panda"',
            '"pandas"',
            "robot.model: unknown robot 'pandas'; valid: a path that ends in .toml, panda, robotiq-2f-85, ur5e, xarm7",
        ),
        (
            '"panda"',
            '"pan' + "[" * 3000 + 'da"',
            f"robot.model: unknown robot \"'pan{'[' * 14}...{'[' * 16}da'\"; valid: a path that ends in "
            ".toml, panda, robotiq-2f-85, ur5e, xarm7",
        ),
        ("[0.0, -0.785398,", "[-0.785398,", "robot.home: must be 7 finite joint angles, rad"),
        ("lift_height = 0.05", "lift_height = nan", "lift_height: nan; must be a finite number"),
        ("lift_height = 0.05", "lift_height = 0", "lift_height: 0; must be above 0"),
        ("[robot]", "[robot]\npayload = 0", "robot.payload: 0; must be above 0"),
        ("[robot]", "[robot]\npayload = 10001", "robot.payload: 10001; must be at most 10000"),
        ("[robot]", "[robot]\ngripping_force = inf", "robot.gripping_force: inf; must be a finite number"),
        ("[robot]", "[robot]\nfriction = nan", "robot.friction: nan; must be a finite number"),
        ("clearance = 0.001", "clearance = 0.03", "clearance: 0.03; must be at most 0.02"),
        (
            "clearance = 0.001",
            "clearence = 0.001",
            "unknown key 'clearence'; valid: format, version, name, goal, lift_height, clearance, robot, environment",
        ),
        ("goal = [-0.25, -0.20, 0.35]", "goal = 1979-05-27", "goal: datetime.date(1979, 5, 27); must be a list"),
        ("[1.6, 1.4, 0.04]", "[1.6, 1.4, -0.04]", "environment[0].size[2]: -0.04; must be at least 0.0001"),
        ("version = 1", "version = 1\nversion = 1", "not valid TOML: cannot overwrite a value (at line 4, column 12)"),
        ("version = 1", "version = ", "not valid TOML: invalid value (at line 3, column 11)"),
        ("version = 1", "version = " + "1" * 5000, "not valid TOML: it holds a number with too many digits"),
        ("version = 1", "version = 0x" + "f" * 9000, "version: version a huge integer; this release reads version 1"),
        ("version = 1", "a" + ".a" * 20_000 + " = 1", "not valid TOML: a line with more than 1000 dots"),
        ("version = 1", "a = " + "[" * 20_000, "nested too deeply"),
        ('format = "takeapart/workcell"', "", "format: there is no key 'format'; must be 'takeapart/workcell'"),
    ],
)
def test_workcell_errors(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in example_documents.WORKCELL
    content = example_documents.WORKCELL.replace(old, new, 1)
    assert refusal(load_workcell, tmp_path / "w.toml", content) == message


VALID = json.dumps(example_documents.assembly(), indent=1)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "the file is empty"),
        (" \n\n", "the file is empty"),
        (VALID[:200], "not valid JSON: it ends too early (line 16, column 4)"),
        ('{"format": "take', "not valid JSON: it ends too early (line 1, column 12)"),
        (VALID + "}", "not valid JSON: extra data (line "),
        ("{'format': 1}", "not valid JSON: expecting property name enclosed in double quotes (line 1, column 2)"),
        ("[]", 'holds a list; must be an object with "format": "takeapart/assembly"'),
        ("null", 'holds null; must be an object with "format": "takeapart/assembly"'),
        ("7", 'holds a number; must be an object with "format": "takeapart/assembly"'),
        (VALID.replace("0.5", "1e999", 1), "parts[0].mass: inf; must be a finite number"),
        (VALID.replace("0.5", "NaN", 1), "parts[0].mass: nan; must be a finite number"),
        (VALID.replace("0.5", "-Infinity", 1), "parts[0].mass: -inf; must be a finite number"),
        (VALID.replace("0.5", "1" + "0" * 5000, 1), "a number with 5001 digits; at most 40 are allowed"),
        (VALID.replace("0.5", "1" + "0" * 30, 1), f"parts[0].mass: {10**30}; must be at most 100000"),
        (VALID.replace('"mass"', '"name"', 1), "the key 'name' stands twice in one object; it may stand only once"),
        (VALID.replace('"by hand"', "[" * 100_000), "nested too deeply"),
        (VALID.replace('"by hand"', '{"a":' * 100_000), "nested too deeply"),
        (b"\x89PNG\r\n\x1a\n\x00\x00", "not a text file: byte 0 (line 1) is not UTF-8"),
        (b'{"format":\n"\xff"}', "not a text file: byte 12 (line 2) is not UTF-8"),
        (b"\x00" * 100, "not valid JSON: expecting value (line 1, column 1)"),
        (VALID.encode("utf-16"), "not a text file: byte 0 (line 1) is not UTF-8"),
        (VALID.replace('"by hand"', '"\\ud800"').replace('"base"', '"\\ud800"', 1), "parts[0].name: "),
    ],
)
def test_what_is_no_document(tmp_path: Path, content: str | bytes, message: str) -> None:
    found = refusal(load_assembly, tmp_path / "a.json", content)
    assert found.startswith(message) if message.endswith((" ", "line ")) else found == message


def test_too_many_walls_in_all(tmp_path: Path) -> None:
    document = example_documents.assembly()
    holder = document["connectors"][0]
    holder["walls"] *= 50
    document["connectors"] = [{**holder, "name": f"holder-{i}"} for i in range(161)]
    message = "connectors: 8050 walls in all; at most 8000 are allowed"
    assert refusal(load_assembly, tmp_path / "a.json", json.dumps(document)) == message


def test_byte_order_mark_is_no_error(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_bytes(b"\xef\xbb\xbf" + VALID.encode())
    assert load_assembly(tmp_path / "a.json").name == "bench"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("missing.json", "there is no such file"),
        ("folder", "is a folder, not a file"),
        ("pipe", "is not a regular file"),
        ("a\x00b", "cannot be read: embedded null byte"),
        ("/dev/zero", "is not a regular file"),
        ("a.json/b.json", "cannot be read: not a directory"),
        ("two\nlines", "there is no such file"),
    ],
)
def test_names_that_cannot_be_read(tmp_path: Path, name: str, message: str) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "a.json").write_text(VALID)
    os.mkfifo(tmp_path / "pipe")
    for reader in (
        load_assembly,
        load_plan,
        lambda path: load_workcell(f"{path}.toml") if name == "missing.json" else load_plan(path),
    ):
        with pytest.raises(InputError) as caught:
            reader(tmp_path / name)
        assert str(caught.value).endswith(f": {message}")
        assert "\n" not in str(caught.value)


PARTS = VALID[: VALID.index("[") + 1]
PART = json.dumps(example_documents.part("a", [1.0, 1.0, 1.0], example_documents.pose(0, 0, 0)))


@pytest.mark.parametrize(
    ("reader", "head", "item", "count", "tail", "message"),
    [
        (load_assembly, PARTS, "{},", 1_000_000, "{}]}", "parts[0].name: is missing"),
        (load_assembly, PARTS, PART + ",", 1_000, PART + "]}", "parts: 1001 entries; at most 1000 are allowed"),
        (load_assembly, PARTS, PART + ",", 1_000_000, "]}", "is larger than 8 MiB, the most that is read"),
        (load_assembly, PARTS, "1,", 4_000_000, "1]}", "parts[0]: 1; must be an object"),
        (load_assembly, "", "[", 4_000_000, "", "holds 4000000 lists and objects; at most 2000000 are allowed"),
        (load_plan, "[", "1,", 30_000_000, "", "holds more than 10000000 values"),
        (load_plan, "", "[],", 16_000_000, "", "holds 16000000 lists and objects; at most 2000000 are allowed"),
        (load_plan, "", " ", 65 * 2**20, "", "is larger than 64 MiB, the most that is read"),
        (load_plan, "", " ", 60 * 2**20, "", "the file is empty"),
        (load_plan, '"', "\\u0041", 10_000_000, '"', 'holds a text; must be an object with "format": "takeapart/plan"'),
    ],
)
def test_huge_files_are_refused_quickly(
    tmp_path: Path, reader: Callable[[Path], object], head: str, item: str, count: int, tail: str, message: str
) -> None:
    content = head + item * count + tail
    started = time.process_time()
    assert refusal(reader, tmp_path / "huge", content) == message
    assert time.process_time() - started < 20  # 5 s is promised; this catches what never ends, on slow machines too


def test_many_repeated_toml_tables_are_refused_quickly(tmp_path: Path) -> None:
    content = example_documents.WORKCELL + '\n[[environment]]\nname = "x"' * 2000
    assert refusal(load_workcell, tmp_path / "w.toml", content).startswith("environment[1].position: is missing")
    content = example_documents.WORKCELL + "#" * 70_000
    assert refusal(load_workcell, tmp_path / "w.toml", content).startswith("is larger than 0.0625 MiB")


# ---------------------------------------------------------------------------------------------------------- fuzzing

scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.integers(-(10**400), 10**400),
    st.floats(),
    st.text(max_size=20),
    st.sampled_from(["U", "O", "base", "bar", "box", "takeapart/assembly", "a" * 5000, "\ud800", "{0}", "%s", "../x"]),
    st.sampled_from([0, -1, 1e-320, 1e308, 2**63, 2**64, 5e-324, -0.0, 100.0, 1e5]),
)
values = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)


def places(document: Any, here: Path_ = ()) -> list[Path_]:
    found: list[Path_] = [here] if here else []
    items = (
        document.items() if isinstance(document, dict) else enumerate(document) if isinstance(document, list) else ()
    )
    for key, child in items:
        found += places(child, (*here, key))
    return found


@st.composite
def mutated(draw: st.DrawFn, document: Any) -> Any:
    """A valid document with one to three places replaced, deleted, doubled or swapped."""
    document = copy.deepcopy(document)
    for _ in range(draw(st.integers(1, 3))):
        path = draw(st.sampled_from(places(document)))
        kind = draw(st.sampled_from(["replace", "delete", "move", "add"]))
        if kind == "delete":
            document = changed(document, path, NONE)
        elif kind == "move":
            other = draw(st.sampled_from(places(document)))
            source = document
            for step in other:
                source = source[step]
            document = changed(document, path, copy.deepcopy(source))
        elif kind == "add":
            document = (
                changed(document, (*path[:-1], draw(st.text(max_size=8))), draw(values))
                if isinstance(path[-1], str)
                else changed(document, path, draw(values))
            )
        else:
            document = changed(document, path, draw(values))
        if not places(document):
            break
    return document


@st.composite
def damaged(draw: st.DrawFn, example: bytes) -> bytes:
    """The bytes of a valid document, cut, overwritten or with pieces put in."""
    data = bytearray(example)
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(data)))
        length = draw(st.integers(0, 40))
        piece = draw(
            st.one_of(
                st.binary(max_size=20),
                st.sampled_from(
                    [b"", b"{", b"]", b'"', b",", b"1e999", b"NaN", b"[[[", b"\n", b"=", b"0x" + b"f" * 99]
                ),
            )
        )
        data[start : start + length] = piece
    return bytes(data)


def check_reader(reader: Callable[[Path], object], folder: Path, suffix: str, content: bytes) -> None:
    """Taken or refused with one line; nothing else happens."""
    path = folder / f"input{suffix}"
    path.write_bytes(content)
    before = example_documents.snapshot(folder)
    started = time.process_time()
    try:
        reader(path)
    except TakeapartError as error:
        message = str(error)
        assert message.isprintable()
        assert message.startswith((f"{path}: ", f"{path.parent}: "))
        assert len(message) < 350 + len(str(path))
        message.encode()
    assert time.process_time() - started < 5
    assert example_documents.snapshot(folder) == before


def fuzz(examples: int, reader: Reader, kind: str, folder: Path) -> None:
    strategies = {"data": mutated(reader.document).map(reader.encoded), "noise": st.binary(max_size=200)}
    inputs = strategies.get(kind, damaged(reader.example))

    @settings(max_examples=examples, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(inputs)
    def run(content: bytes) -> None:
        check_reader(reader.load, folder, reader.suffix, content)

    run()


FUZZED = [
    pytest.param(reader, kind, id=f"{name}, {kind}")
    for name, reader in fuzzed_readers.READERS.items()
    for kind in reader.kinds
    if kind != "lines"
]


@pytest.mark.parametrize(("reader", "kind"), FUZZED)
def test_fuzz(tmp_path: Path, reader: Reader, kind: str) -> None:
    fuzz(200, reader, kind, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(("reader", "kind"), FUZZED)
def test_fuzz_long(tmp_path: Path, reader: Reader, kind: str) -> None:
    fuzz(int(os.environ.get("TAKEAPART_FUZZ_INPUTS", "2000")), reader, kind, tmp_path)


@pytest.mark.parametrize("name", fuzzed_readers.READERS)
def test_every_example_is_taken(name: str, tmp_path: Path) -> None:
    """Otherwise a fuzzer would look no further than the first refusal."""
    reader = fuzzed_readers.READERS[name]
    path = tmp_path / f"input{reader.suffix}"
    path.write_bytes(reader.example)
    assert fuzz_readers.fault_of(reader, path, reader.example) == ("", True)
    if reader.document is not None:
        assert fuzz_readers.fault_of(reader, path, reader.encoded(reader.document)) == ("", True)


def test_fuzz_without_library_finds_nothing() -> None:
    """`make fuzz` in small."""
    tallies = fuzz_readers.fuzz(900, seed=1, processes=1)
    assert [fault for tally in tallies for fault in tally.faults] == []
    assert sum(tally.refused for tally in tallies) > 800
    assert sum(tally.taken for tally in tallies) > 5


def _breaks(path: Path) -> object:
    raise KeyError("x")


def _writes(path: Path) -> object:
    return (path.parent / "other").write_text("x")


def _removes(path: Path) -> object:
    path.unlink()
    return None


def _hangs(path: Path) -> object:
    while True:
        time.sleep(0.01)


def _says_too_little(path: Path) -> object:
    raise InputError("two\nlines", str(path))


@pytest.mark.parametrize(
    ("load", "fault"),
    [
        (_breaks, "KeyError"),
        (_writes, "for writing"),
        (_removes, "os.remove"),
        (_hangs, "took longer"),
        (_says_too_little, "not one line"),
    ],
)
def test_fuzzer_sees_faults(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, load: Callable[[Path], object], fault: str
) -> None:
    monkeypatch.setattr(fuzz_readers, "LONGEST", 0.2)
    reader = replace(fuzz_readers.READERS["assembly"], load=load)
    found, taken = fuzz_readers.fault_of(reader, tmp_path / "input.json", b"{}")
    assert fault in found and not taken
