"""Pages in a real browser: the standalone page from disk without a network, and the viewer's own page."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from browser import PATIENCE, Opened, opened, wait_until
from other_robots import BETWEEN_PADS, bar_case
from shown_plans import small_scene, write_files
from takeapart.formats.files import data_path, load_workcell
from takeapart.model.errors import InputError
from takeapart.page.standalone import MAXIMUM_BYTES, assembled, page, save_page
from takeapart.show.facts import part_facts
from takeapart.show.playback import GRIP, SPEEDS, TOOL_SPEED, USUAL_SPEED, Timeline
from takeapart.show.scene import PlanScene
from takeapart.viewer import Viewer
from takeapart.viewer.drawing import box_mesh

SRC = Path(__file__).resolve().parents[1] / "src"


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("shown")


@pytest.fixture(scope="session")
def page_file(folder: Path) -> Path:
    write_files(folder, folder)
    out = folder / "plan.html"
    save_page(folder / "plan.json", out, folder / "product.json", str(folder / "cell.toml"))
    return out


def drawn(found: Opened) -> None:
    """Waits until the page has shown its first picture."""
    wait_until(found.page, "window.takeapart && window.takeapart.firstPicture > 0")


def differ(first: np.ndarray, second: np.ndarray) -> float:
    """Share of the pixels that differ visibly."""
    return float((np.abs(first.astype(int) - second.astype(int)).max(axis=2) > 24).mean())


# Quick: one browser, one small page.


def test_standalone_page_plays_from_disk_without_a_network(page_file: Path, folder: Path) -> None:
    scene = small_scene(folder)
    assert page_file.stat().st_size < MAXIMUM_BYTES
    with opened(page_file.as_uri(), 900, 640, offline=True) as found:
        drawn(found)
        page = found.page
        first = found.picture()
        assert first.std() > 20 and len(np.unique(first.reshape(-1, 3), axis=0)) > 100  # not blank
        page.click("#forward")
        wait_until(page, "document.querySelector('#now').textContent.includes('2 of 3')")
        page.wait_for_timeout(500)
        assert differ(first, found.picture()) > 0.004
        before = page.evaluate("takeapart.player.time")
        page.click("#play")
        wait_until(page, f"takeapart.player.time > {before} + 0.2")
        page.click("#play")
        stopped = page.evaluate("takeapart.player.time")
        page.wait_for_timeout(300)
        assert page.evaluate("takeapart.player.time") == stopped
        # The page's own kinematics put every link where the plan says.
        for k, step in enumerate(scene.steps):
            place = page.evaluate(
                "([k, f]) => { const p = takeapart.player, q = p.timeline.configuration(k, f, p.data.home.length);"
                "return p.arm.poses(q, 0.037); }",
                [k, 0.37],
            )
            T = scene.robot.poses(scene.moment(k, 0.37).configuration, 0.037)
            assert np.allclose(np.reshape(place, (-1, 4, 4)), T, atol=2e-4), step.part
        # It plays as the viewer does.
        timeline = Timeline([float(scene.along(k)[-1]) for k in range(3)], scene.direction)
        assert page.evaluate("takeapart.player.timeline.total") == pytest.approx(
            timeline.total, abs=1e-3
        )  # of a file, rounded
        assert page.evaluate("takeapart.player.timeline.at(0.1).extra") == pytest.approx(timeline.at(0.1).extra)
        assert page.locator("#speed option").all_inner_texts() == list(SPEEDS)
        assert page.evaluate("[...document.querySelectorAll('#speed option')].map(o => +o.value)") == [*SPEEDS.values()]
        assert page.locator("#speed").input_value() == f"{SPEEDS[USUAL_SPEED]:g}"
        assert all(url.startswith(("file:", "data:", "blob:")) for url in found.requests)
        assert found.errors == []


# Slow: everything else that a page does.


@pytest.mark.slow
def test_page_of_an_assembly_shows_its_parts_and_nothing_to_play(page_file: Path, folder: Path, tmp_path: Path) -> None:
    save_page(folder / "product.json", tmp_path / "product.html", None, str(folder / "cell.toml"))
    with opened((tmp_path / "product.html").as_uri(), 900, 640, offline=True) as found:
        drawn(found)
        page, parts = found.page, small_scene(folder).assembly.parts
        assert found.picture().std() > 20
        for hidden in ("#bar", "#list", "#now"):
            assert not page.locator(hidden).is_visible()
        assert re.split(r"\s+", page.locator("#totals").inner_text())[:2] == ["parts", str(len(parts))]
        beam = [part.name for part in parts].index("beam")
        page.evaluate(f"takeapart.player.choose({beam})")
        text = page.locator("#picked").inner_text()
        assert text.startswith("beam") and "would fall without it" in text and "straight-line bound" not in text
        page.keyboard.press("Space")
        page.keyboard.press("ArrowRight")
        assert page.evaluate("takeapart.player.playing") is False
        assert found.errors == []


@pytest.mark.slow
def test_standalone_page_of_thirty_parts_is_responsive_and_tells_of_its_parts(tmp_path: Path) -> None:
    plan_file = tmp_path / "plan.json"
    command = [sys.executable, "-m", "takeapart", "plan", str(data_path("double/01.json")), "--search", "greedy"]
    environment = os.environ | {"PYTHONPATH": str(SRC)}
    subprocess.run([*command, "--out", str(plan_file)], check=True, capture_output=True, env=environment)
    save_page(plan_file, tmp_path / "plan.html")
    with opened((tmp_path / "plan.html").as_uri(), offline=True) as found:
        drawn(found)
        page = found.page
        found.keep("page.png")
        for button in page.locator("#list button").all():
            button.click()
            name = button.locator("span").nth(1).inner_text()
            assert page.locator("#picked h2").inner_text() == name
            assert "straight-line bound" in page.locator("#picked").inner_text()
        page.select_option("#direction", "assembly")
        assert page.locator("#list button span:nth-child(2)").first.inner_text() == name
        page.click("#list button >> nth=0")
        assert "1 of 30" in page.locator("#now").inner_text()
        found.keep("page-assembly.png")
        assert found.errors == []


@pytest.mark.slow
def test_click_on_a_part_fills_the_panel(page_file: Path, folder: Path) -> None:
    scene = small_scene(folder)
    with opened(page_file.as_uri(), 900, 640) as found:
        drawn(found)
        page = found.page
        target = scene.assembly.parts[scene.assembly.index["beam"]].T_world_part[:3, 3]
        x, y = page.evaluate(
            "p => { const o = takeapart.player.orbit, c = o.canvas, m = o.matrix, v = [...p, 1];"
            "const r = [0, 1, 2, 3].map(i => v.reduce((s, x, j) => s + m[4 * i + j] * x, 0));"
            "return [(r[0] / r[3] + 1) / 2 * c.clientWidth, (1 - r[1] / r[3]) / 2 * c.clientHeight]; }",
            target.tolist(),
        )
        page.locator("canvas").click(position={"x": x, "y": y})
        text = page.locator("#picked").inner_text()
        assert text.startswith("beam") and "would fall without it" in text and "3 of 3" in text
        before = found.picture()
        page.mouse.move(300, 300)
        page.mouse.down()
        page.mouse.move(420, 330, steps=4)
        page.mouse.up()
        page.wait_for_timeout(600)
        assert differ(before, found.picture()) > 0.02  # the camera turned
        assert found.errors == []


@pytest.mark.slow
def test_phone_sees_picture_and_panel(page_file: Path) -> None:
    with opened(page_file.as_uri(), 390, 844) as found:
        drawn(found)
        assert found.picture().std() > 20
        box = found.page.locator("#panel").bounding_box()
        assert box and box["y"] > 300 and box["width"] > 380
        assert found.page.evaluate("document.documentElement.scrollWidth") <= 390
        found.keep("page-phone.png")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda text: text[: len(text) - len(text) // 3], "checksum does not fit"),
        (lambda text: text[: text.index('id="data"')], "cut off"),
        (lambda text: text.replace('"rows":', '"rowz":', 1), "checksum does not fit"),
    ],
)
def test_damaged_page_says_so(damage: Any, message: str, page_file: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.html"
    broken.write_text(damage(page_file.read_text()))
    with opened(broken.as_uri(), 900, 640) as found:
        found.page.wait_for_selector("#error:not([hidden])", timeout=PATIENCE)
        assert message in found.page.locator("#error").inner_text()


@pytest.mark.slow
def test_page_of_contradictory_data_says_so(page_file: Path, tmp_path: Path) -> None:
    text = page_file.read_text()
    found = re.search(r'id="data"[^>]*>(.*)</script>', text, re.DOTALL)
    assert found is not None
    data = json.loads(found.group(1))
    data["steps"][1]["rows"] += 1
    broken = tmp_path / "broken.html"
    broken.write_text(assembled(json.dumps(data)))  # the checksum fits
    with opened(broken.as_uri(), 900, 640) as shown:
        shown.page.wait_for_selector("#error:not([hidden])", timeout=PATIENCE)
        assert "is damaged" in shown.page.locator("#error").inner_text()


@contextmanager
def served(file: Path, *options: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """The command `takeapart view`, its address, and Ctrl-C at the end."""
    process = subprocess.Popen(
        [sys.executable, "-m", "takeapart", "view", str(file), *options],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(SRC)},
    )
    try:
        assert process.stderr is not None
        for line in process.stderr:
            address = re.search(r"http://127\.0\.0\.1:\d+", line)
            if address:
                break
        else:
            raise AssertionError("the command ended without an address")
        yield address[0], process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            process.wait(60)


@pytest.mark.slow
def test_viewer_plays_and_follows_its_file(folder: Path, tmp_path: Path) -> None:
    given = write_files(tmp_path, folder)
    file = tmp_path / "plan.json"
    with served(file, *given) as (address, process), opened(address) as found:
        page = found.page
        page.get_by_text("Disassembly of three-bars").wait_for(timeout=PATIENCE)
        page.wait_for_timeout(9_000)
        first = found.picture()
        assert first.std() > 10
        page.get_by_text("forward", exact=True).click()
        page.get_by_text("2 of 3").wait_for(timeout=PATIENCE)
        page.wait_for_timeout(6_000)
        assert differ(first, found.picture()) > 0.003
        page.get_by_role("button", name="Play").click()
        page.get_by_text("3 of 3").wait_for(timeout=PATIENCE)
        page.get_by_role("button", name=re.compile("Play|Pause")).wait_for()
        found.keep("viewer.png")
        good = file.read_text()
        file.write_text(good[: len(good) // 2])
        page.get_by_text("This cannot be shown").wait_for(timeout=PATIENCE)
        assert "not valid JSON" in page.locator("body").inner_text()
        found.keep("viewer-error.png")
        file.write_text(good)
        page.get_by_text("Disassembly of three-bars").wait_for(timeout=PATIENCE)
        assert faults(found.errors) == []
        assert all(url.startswith((address, "data:", "blob:", address.replace("http", "ws"))) for url in found.requests)
    assert process.returncode == 0


def faults(errors: list[str]) -> list[str]:
    """Errors of a page, but for one: where a plan is replaced while it is shown, the page of viser may get an update of
    a control after the control is gone, and says so.
    """
    return [error for error in errors if "update non-existent component" not in error]


@pytest.mark.slow
def test_viewer_opened_with_a_corrupted_plan_shows_the_error(folder: Path, tmp_path: Path) -> None:
    given = write_files(tmp_path, folder)
    file = tmp_path / "plan.json"
    file.write_text(file.read_text().replace('"part": "beam"', '"part": "nothing"'))
    with served(file, *given) as (address, process), opened(address) as found:
        found.page.get_by_text("This cannot be shown").wait_for(timeout=PATIENCE)
        assert "no removable part" in found.page.locator("body").inner_text()
        found.keep("viewer-corrupted.png")
    assert process.returncode == 2


@pytest.mark.slow
def test_search_can_be_watched(folder: Path, tmp_path: Path) -> None:
    given = write_files(tmp_path, folder)
    process = subprocess.Popen(
        [sys.executable, "-m", "takeapart", "plan", str(tmp_path / "product.json"), "--workcell", given[-1]]
        + ["--out", str(tmp_path / "new.json"), "--view"],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        env=os.environ | {"PYTHONPATH": str(SRC)},
    )
    try:
        assert process.stderr is not None
        lines = iter(process.stderr.readline, "")
        address = next(match[0] for line in lines if (match := re.search(r"http://127\.0\.0\.1:\d+", line)))
        with opened(address) as found:
            page = found.page
            page.get_by_text("Disassembly of three-bars").wait_for(timeout=PATIENCE)
            page.get_by_text("best length").wait_for(timeout=PATIENCE)
            page.wait_for_timeout(8_000)
            assert found.picture().std() > 10
            assert page.locator(".uplot canvas").count() == 1
            found.keep("viewer-search.png")
            assert faults(found.errors) == []
        assert (tmp_path / "new.json").exists()
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0


# Without a browser.


def test_viewer_listens_on_the_loopback_address_alone_and_refuses_a_taken_port(folder: Path) -> None:
    viewer = Viewer()
    try:
        assert viewer.url.startswith("http://127.0.0.1:") and viewer.server.get_host() == "127.0.0.1"
        with pytest.raises(InputError, match="is taken"):
            Viewer(int(viewer.url.rsplit(":", 1)[1]))
    finally:
        viewer.close()


def test_viewer_moves_parts_as_the_plan_does(folder: Path) -> None:
    scene = small_scene(folder)
    viewer = Viewer()
    try:
        viewer.show(scene)
        viewer.pick(scene.order[0])
        assert viewer._controls is not None and scene.steps[0].part in viewer._controls.part.content
        viewer.jump(1)
        viewer.run_frame(0.0)
        first, second = (viewer._nodes.frames[part] for part in scene.order[:2])
        assert np.allclose(first.position, scene.laid_out[scene.order[0]][:3, 3])
        assert np.allclose(second.position, scene.moment(1, 0.0).T_world_held[:3, 3], atol=1e-6)
        assert "2 of 3" in viewer._controls.now.content
        viewer._controls.laid.value = False
        viewer._redraw()
        viewer.run_frame(0.0)
        assert not first.visible and second.visible
        viewer._set_playing(True)
        before = viewer.time
        viewer.run_frame(0.25)
        assert viewer.time == pytest.approx(before + 0.25)
        viewer.run_frame(1000.0)
        assert viewer.time == pytest.approx(viewer.timeline.total) and not viewer.playing
        viewer.fail("a reason")
        viewer.run_frame(0.1)
        assert viewer.scene is None
    finally:
        viewer.close()


def test_boxes_are_closed_and_face_outwards() -> None:
    for name in ("single/01.json",):
        from takeapart.formats.files import load_assembly

        scene = PlanScene(load_assembly(data_path(name)), load_workcell("panda"))
        for i in (0, 12, 25):
            body = scene.assembly.body(i)
            vertices, faces = box_mesh(body)
            a, b, c = (vertices[faces[:, k]].astype(float) for k in range(3))
            volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
            assert volume == pytest.approx(sum(8 * box.half_extents.prod() for box in body), rel=1e-4)


@pytest.mark.parametrize("direction", ["disassembly", "assembly"])
def test_timeline_grips_moves_and_lets_go(direction: str) -> None:
    timeline = Timeline((0.5, 1.0, 0.25), direction)
    assert timeline.total == pytest.approx(3 * 2 * GRIP + 1.75 / TOOL_SPEED)
    forward = direction == "disassembly"
    begin, end = timeline.at(1e-6), timeline.at(timeline.total - 1e-6)
    assert (begin.step, end.step) == ((0, 2) if forward else (2, 0))
    assert (begin.fraction, end.fraction) == ((0.0, 1.0) if forward else (1.0, 0.0))
    assert begin.extra > 0.019 and end.extra > 0.019
    middle = timeline.at(timeline.start(1) + GRIP + 0.5 / TOOL_SPEED)
    assert middle.step == 1 and middle.fraction == pytest.approx(0.5) and middle.extra == 0.0
    assert [timeline.number(k) for k in range(3)] == ([1, 2, 3] if forward else [3, 2, 1])
    time_now, visited = 0.0, []
    while time_now < timeline.total:
        visited.append(timeline.at(time_now).step)
        time_now = timeline.jump(time_now, 1)
    assert visited == ([0, 1, 2] if forward else [2, 1, 0])
    assert timeline.at(timeline.jump(timeline.start(1) + 1.0, -1)).step == 1


def test_explainer_says_what_the_planner_says(folder: Path) -> None:
    from takeapart.show.facts import part_facts
    from takeapart.viewer.explain import Explainer

    scene = small_scene(folder)
    facts = part_facts(scene)
    explainer = Explainer(scene)
    later = scene.order[1]  # a stub that could leave first as well
    answer = explainer.ask(later, facts[later])
    assert "In step 1" in answer and re.search(r"\d\.\d{3} m", answer)
    assert "nothing to ask" in explainer.ask(scene.order[0], facts[scene.order[0]])
    whole = Explainer(PlanScene(scene.assembly, scene.workcell))
    bare = part_facts(PlanScene(scene.assembly, scene.workcell))
    beam = scene.assembly.index["beam"]
    assert "without it stub and rear would fall" in whole.ask(beam, bare[beam])


def test_search_is_told_while_it_runs(folder: Path) -> None:
    import threading

    from takeapart.planning import PlanningOptions, plan
    from takeapart.search.result import Progress
    from takeapart.viewer.live import LiveSearch

    scene = small_scene(folder)
    viewer = Viewer()
    try:
        live = LiveSearch(viewer, scene.assembly, scene.workcell)
        heard: list[Progress] = []

        def listen(progress: Progress) -> None:
            heard.append(progress)
            live(progress)

        plan(scene.assembly, scene.workcell, PlanningOptions(), listen=listen)
        stop = threading.Event()
        thread = threading.Thread(target=live.serve, args=(stop,))
        thread.start()
        deadline = time.monotonic() + 60
        while viewer.scene is None or not viewer.scene.steps:
            assert time.monotonic() < deadline
            time.sleep(0.1)
        stop.set()
        thread.join()
        assert [step.length for step in viewer.scene.steps] == [removal.length for removal in heard[-1].removals]
        assert f"{heard[-1].length:.3f} m" in live._text.content
        assert live._chart.data[1][-1] == pytest.approx(heard[-1].length)
    finally:
        viewer.close()


def test_page_closes_a_gripper_whose_joints_follow_each_other(tmp_path: Path) -> None:
    """A UR5e with a 2F-85: six joints, five of which follow the one that the opening sets."""
    case = bar_case("ur5e")
    scene = PlanScene(case.assembly, case.workcell, case.plan)
    (tmp_path / "page.html").write_text(page(scene, part_facts(scene, [])), encoding="utf-8")
    with opened((tmp_path / "page.html").as_uri(), 900, 640, offline=True) as found:
        drawn(found)
        found.keep("ur5e.png")
        names = [link.name for link in scene.robot.links]
        pads = [names.index(name) for name in case.workcell.description.gripper.finger_links]
        for opening in (0.001, 0.011, 0.02, 0.0801, BETWEEN_PADS):
            place = found.page.evaluate(
                "([f, o]) => { const p = takeapart.player, q = p.timeline.configuration(0, f, p.data.home.length);"
                "return p.arm.poses(q, o); }",
                [0.6, opening],
            )
            T = scene.robot.poses(scene.moment(0, 0.6).configuration, opening)
            shown = np.reshape(place, (-1, 4, 4))
            assert np.allclose(shown, T, atol=2e-4)
            left, right = shown[pads, :3, 3]
            # The links' frames are as far further apart than the pads as they are where the gripper is wide open.
            still = "o => takeapart.player.arm.poses([0, 0, 0, 0, 0, 0], o)"
            wide = np.reshape(found.page.evaluate(still, BETWEEN_PADS), (-1, 4, 4))
            apart = float(np.linalg.norm(np.subtract(*wide[pads, :3, 3])))
            assert np.linalg.norm(left - right) == pytest.approx(apart - BETWEEN_PADS + opening, abs=1e-4)
        assert found.errors == []
