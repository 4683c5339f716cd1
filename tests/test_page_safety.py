"""Nothing that stands in a file, or in its name, runs in a page; and the viewer answers nobody but its own page."""

from __future__ import annotations

import http.client
import json
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from browser import PATIENCE, Opened, opened
from shown_plans import small_scene, write_files
from takeapart.cli.view import _load
from takeapart.page.standalone import page, save_page
from takeapart.report import page as report_page
from takeapart.report import report, save_report
from takeapart.report.charts import Bar, bars
from takeapart.show.facts import part_facts
from takeapart.show.figures import lasting_bounds
from takeapart.show.markup import Markup, document, element, joined, plain, stylesheet
from takeapart.show.scene import PlanScene
from takeapart.show.subject import load_subject
from takeapart.viewer import Viewer
from takeapart.viewer.texts import part_text, sent

FRAME = '<iframe srcdoc="<svg onload=top.p=1>">'  # as short as error messages are cut
IMAGE = "<img src=x onerror=top.p=1>"
SCRIPT = "</script><script>top.p=1</script>"
CLOSING = "\"'></title></style></td></text><svg onload=top.p=1>"
MARKDOWN = "[a](javascript:top.p=1) ![b](x) | `c` <svg onload=top.p=1>"
HARMLESS = {"svg", "text", "rect", "line", "p", "html", "head", "meta", "title", "style", "body"}
ATTACKS = (FRAME, IMAGE, SCRIPT, CLOSING, MARKDOWN)


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("shown")


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    served = Viewer()
    yield served
    served.close()


class Drawn:
    """In place of the renderer: what a picture shows runs nowhere, and drawing it takes longest of all."""

    def __init__(self, *_: object) -> None: ...

    def __enter__(self) -> Drawn:
        return self

    def __exit__(self, *_: object) -> None: ...

    def picture(self, *_: object) -> np.ndarray:
        return np.full((60, 80, 3), 200, dtype=np.uint8)


@pytest.fixture(autouse=True)
def quickly_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("takeapart.pictures.renderer.Renderer", Drawn)


def hostile_plan(folder: Path, shared: Path) -> tuple[Path, list[str]]:
    """A plan that is valid, and holds markup wherever it may hold free text; the options that name its sources."""
    given = write_files(folder, shared)
    document = json.loads((folder / "plan.json").read_text())
    attacks = dict(zip(ATTACKS, reversed(ATTACKS), strict=True))
    document["search"] |= {"name": FRAME, "statistics": attacks | {"note": list(ATTACKS)}, "history": [list(ATTACKS)]}
    document["versions"] |= attacks
    document["extra"] = attacks
    (folder / "plan.json").write_text(json.dumps(document))
    return folder / "plan.json", given


def ran(found: Opened) -> Any:
    """What a script of an attack leaves behind."""
    found.page.wait_for_timeout(700)
    return left_behind(found)


def left_behind(found: Opened) -> Any:
    return found.page.evaluate("window.p ?? null")


@contextmanager
def all_opened(texts: Mapping[str, str], folder: Path) -> Iterator[dict[str, Opened]]:
    """Pages written to files of these names, open side by side for long enough for scripts to run."""
    with ExitStack() as stack:
        shown = {}
        for name, text in texts.items():
            (folder / name).write_text(text)
            shown[name] = stack.enter_context(opened((folder / name).as_uri(), 900, 640, offline=True))
        next(iter(shown.values())).page.wait_for_timeout(700)
        yield shown


@pytest.mark.parametrize("attack", ATTACKS)
def test_text_stays_text(attack: str) -> None:
    for made in (plain(attack), element("b", attack), element("b", "x", title=attack), joined(["a", attack])):
        inside = made.removeprefix("<b>").removesuffix("</b>")
        inside = inside.removeprefix('<b title="').removesuffix('">x')
        assert not set(inside) & set("<>\"'") and isinstance(made, Markup)


def test_markup_is_not_escaped_twice_and_invisible_characters_are_seen() -> None:
    assert element("p", "a & b ", element("i", "<c>")) == "<p>a &amp; b <i>&lt;c&gt;</i></p>"
    assert plain("x\u202eevil\x00\ny") == r"x\u202eevil\x00 y"
    for misuse in ({"onload": "x"}, {"onClick": "x"}, {"a b": "x"}, {"x><y": "z"}):
        with pytest.raises(ValueError, match="no attribute"):
            element("p", **misuse)
    for name in ("srcdoc", "srcset", "SRCDOC"):
        with pytest.raises(ValueError, match="no attribute"):
            element("p", **{name: "x"})
    for tag in ("script", "iframe", "IFRAME", "object", "embed", "base", "style", "foreignObject", "a b"):
        with pytest.raises(ValueError, match="no element"):
            element(tag, "1")
    for address in (
        "javascript:top.p=1",
        " JavaScript:top.p=1",
        "java\tscript:top.p=1",
        "\x01javascript:top.p=1",
        "data:text/html,<svg onload=top.p=1>",
        "data:image/svg+xml;base64,AAAA",
        "vbscript:x",
        "file:///etc/passwd",
    ):
        for name in ("href", "src"):
            with pytest.raises(ValueError, match="no address"):
                element("a", "x", **{name: address})
    for address in ("https://x.org/a:b", "#top", "x/y.html?a=b:c", "data:image/png;base64,AAAA", "mailto:a@b.c"):
        assert "href=" in element("a", "x", href=address)
    with pytest.raises(ValueError, match="style sheet"):
        stylesheet("a{}</style><script>")
    with pytest.raises(TypeError, match="markup only"):
        sent("<b>plain</b>")  # type: ignore[arg-type]


def test_panel_escapes_what_a_part_is_called(folder: Path) -> None:
    facts = part_facts(small_scene(folder))[0]
    hostile = type(facts)(**{**facts.__dict__, "name": FRAME, "refusals": {IMAGE: 1}, "carries": (SCRIPT,), "step": 1})
    text = part_text(small_scene(folder), hostile, CLOSING)
    assert not any(attack in text for attack in ATTACKS) and "<svg" not in text and "&lt;iframe" in text


def test_nothing_of_a_plan_runs_in_report_and_standalone_page(tmp_path: Path, folder: Path) -> None:
    file, given = hostile_plan(tmp_path, folder)
    subject = load_subject(file, Path(given[1]), given[3])
    scene = PlanScene(subject.assembly, subject.workcell, subject.plan)
    assert subject.plan is not None
    facts = [replace(each, grasp=CLOSING, carries=(SCRIPT, FRAME), refusals={IMAGE: 1}) for each in part_facts(scene)]
    texts = {
        "report.html": report(file, Path(given[1]), given[3]),
        "reasons.html": report_page(subject.plan, scene, facts, (), element("p", FRAME)),
        "page.html": page(scene, facts),
    }
    with all_opened(texts, tmp_path) as shown:
        for name, found in shown.items():
            assert left_behind(found) is None, name
            assert found.page.locator("iframe").count() == 0
        words = shown["report.html"].page.locator("body").inner_text()
        assert FRAME in words and IMAGE in words  # shown, not run
        assert SCRIPT in shown["reasons.html"].page.locator("body").inner_text()


def test_names_of_parts_stay_text_in_the_charts() -> None:
    for drawn in (
        bars([Bar(FRAME, 1.0, 0.5, "#112233"), Bar(SCRIPT, 1.0, 0.5, CLOSING)]),
        document(CLOSING, "p{}", FRAME, SCRIPT).removeprefix("<!doctype html>"),
    ):
        assert not any(attack in drawn for attack in ATTACKS) and "&lt;iframe" in drawn
        assert {each.tag.rpartition("}")[2] for each in ElementTree.fromstring(drawn).iter()} <= HARMLESS


@pytest.mark.parametrize("name", [f"{IMAGE}.plan.json", "\"'></title><svg onload=top.p=1>.plan.json"])
def test_plan_in_a_file_named_with_markup_is_reported_and_shown(name: str, tmp_path: Path, folder: Path) -> None:
    file, given = hostile_plan(tmp_path, folder)
    named = file.rename(tmp_path / name.replace("/", "\u2215"))
    save_report(named, tmp_path / "report.html", Path(given[1]), given[3])
    save_page(named, tmp_path / "page.html", Path(given[1]), given[3])
    texts = {out: (tmp_path / out).read_text() for out in ("report.html", "page.html")}
    with all_opened(texts, tmp_path) as shown:
        for found in shown.values():
            assert left_behind(found) is None and found.page.locator("iframe, img[src=x]").count() == 0
            assert not found.errors  # the policy of the page lets its own style, script and picture through
            assert "Disassembly of three-bars" in found.page.locator("h1").inner_text()


def test_policy_of_a_page_stops_what_was_not_escaped(tmp_path: Path, folder: Path) -> None:
    """Even markup that gets into a page runs nothing and calls nobody: the second line of defence."""
    file, given = hostile_plan(tmp_path, folder)
    save_report(file, tmp_path / "report.html", Path(given[1]), given[3])
    save_page(file, tmp_path / "page.html", Path(given[1]), given[3])
    attack = f"</h1>{FRAME}</iframe><p id=seen>here</p>{IMAGE}<script>top.p=1</script><svg onload=top.p=1></svg><h1>"
    texts = {}
    for out in ("report.html", "page.html"):
        texts[out] = (tmp_path / out).read_text().replace("</h1>", attack, 1)
        texts[f"free-{out}"] = texts[out].replace("Content-Security-Policy", "x-nothing")
    with all_opened(texts, tmp_path) as shown:
        for out in ("report.html", "page.html"):
            assert shown[out].page.locator("#seen").inner_text() == "here"
            assert left_behind(shown[out]) is None
            assert left_behind(shown[f"free-{out}"]) == 1  # the attack is one


@pytest.mark.slow
def test_nothing_of_a_plan_or_of_an_error_runs_in_the_viewer(tmp_path: Path, folder: Path) -> None:
    file, given = hostile_plan(tmp_path, folder)
    subject = load_subject(file, Path(given[1]), given[3])
    named = json.loads((tmp_path / "product.json").read_text()) | {"name": FRAME}
    (tmp_path / "named.json").write_text(json.dumps(named))
    called = tmp_path / f"{IMAGE}.json"
    called.write_text("{")
    (tmp_path / "run").mkdir()
    run = {"assembly": {"name": MARKDOWN, "hash": "0" * 64}, "workcell": {"name": FRAME, "hash": "0" * 64}}
    (tmp_path / "run" / "run.json").write_text(json.dumps(run))
    viewer = Viewer()
    try:
        viewer.show(PlanScene(subject.assembly, subject.workcell, subject.plan))
        with opened(viewer.url, 900, 640) as found:
            found.page.get_by_text("Disassembly of three-bars").wait_for(timeout=PATIENCE)
            assert ran(found) is None
            for shown, words in (
                (tmp_path / "named.json", "<iframe"),
                (called, IMAGE),
                (tmp_path / "run", "javascript:top.p=1"),
            ):
                assert _load(viewer, shown, None, None)
                found.page.get_by_text(words).first.wait_for(timeout=PATIENCE)
                assert ran(found) is None, shown
                assert found.page.locator("iframe, a[href^=javascript], img[src=x]").count() == 0
    finally:
        viewer.close()


def asked(port: int, headers: dict[str, str], upgrade: bool) -> int:
    """Status of the answer to a request with just these headers."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    try:
        connection.putrequest("GET", "/", skip_host=True, skip_accept_encoding=True)
        if upgrade:
            headers |= {
                "Upgrade": "websocket",
                "Connection": "Upgrade",
                "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
                "Sec-WebSocket-Version": "13",
                "Sec-WebSocket-Protocol": "viser-v0",
            }
        for name, value in headers.items():
            connection.putheader(name, value)
        connection.endheaders()
        return connection.getresponse().status
    finally:
        connection.close()


@pytest.mark.parametrize("upgrade", [False, True])
def test_viewer_refuses_foreign_hosts_and_origins(viewer: Viewer, upgrade: bool) -> None:
    port = viewer.server.get_port()
    own, fine = f"127.0.0.1:{port}", 101 if upgrade else 200
    assert asked(port, {"Host": own}, upgrade) == fine
    assert asked(port, {"Host": own, "Origin": f"http://{own}"}, upgrade) == fine
    assert asked(port, {"Host": f"localhost:{port}", "Origin": f"http://localhost:{port}"}, upgrade) == fine
    for host in ("evil.example", f"evil.example:{port}", "127.0.0.1", f"127.0.0.1:{port + 1}", f"x{own}", f"{own}.x"):
        assert asked(port, {"Host": host}, upgrade) == 403, host
    for origin in ("http://evil.example", "null", f"https://{own}", f"http://127.0.0.1:{port + 1}", f"http://{own}.x"):
        assert asked(port, {"Host": own, "Origin": origin}, upgrade) == 403, origin


def test_viewer_sends_its_policy(viewer: Viewer) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", viewer.server.get_port(), timeout=60)
    connection.request("GET", "/")
    policy = connection.getresponse().headers["Content-Security-Policy"]
    connection.close()
    assert "default-src 'none'" in policy and "script-src-attr 'none'" in policy and "frame-src 'none'" in policy


def test_file_named_with_markup_is_told_as_text(tmp_path: Path) -> None:
    file = tmp_path / f"{IMAGE}.json"
    file.write_text("{}")
    viewer = Viewer()
    try:
        told: list[str] = []
        viewer.server.gui.add_html = told.append  # type: ignore[method-assign, assignment]
        assert _load(viewer, file, None, None)
        assert told and IMAGE not in told[0] and "&lt;img" in told[0]
    finally:
        viewer.close()


def test_a_bound_that_fell_later_is_not_drawn_above_what_is_left_of_it() -> None:
    nan = float("nan")
    kept = lasting_bounds([nan, 1.0, 5.0, 4.0, nan, 4.5])
    assert [k for k in kept if k == k] == [1.0, 4.0, 4.0, 4.5] and kept[0] != kept[0] and kept[4] != kept[4]
