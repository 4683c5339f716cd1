"""Pictures: what is drawn where, compared with geometry computed here; files and their errors."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image as PillowImage

from shown_plans import corrupted, small_scene, small_workcell, write_files
from small_assemblies import three_bars
from takeapart.cli.commands import main
from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.model.errors import InputError
from takeapart.pictures.output import contact_sheet, save_animation
from takeapart.pictures.renderer import NoGraphicsError, Renderer, RenderOptions, animation
from takeapart.robot.model import RobotModel
from takeapart.show.facts import blocked_by, hindrances, part_facts, why_not_earlier
from takeapart.show.robot import load_robot_visual
from takeapart.show.scene import CURRENT, PlanScene, colors_of, rgb, role_of
from takeapart.show.subject import load_subject
from takeapart.show.view import ARM_CELL, BETTER, SEEN, View, seen_shares, view_of


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("shown")


@pytest.fixture(scope="session")
def scene(folder: Path) -> PlanScene:
    return small_scene(folder)


@pytest.fixture(scope="session")
def graphics(scene: PlanScene) -> None:
    try:
        with Renderer(scene, RenderOptions(64, 48)):
            pass
    except NoGraphicsError as error:
        pytest.skip(f"pictures need OpenGL: {error}")


def test_drawn_arm_stands_where_the_planners_arm_stands(robot: RobotModel) -> None:
    workcell = load_workcell("panda")
    visual = load_robot_visual(workcell.description, workcell.T_world_base)
    rng = np.random.default_rng(0)
    for q in rng.uniform(robot.arm.lower, robot.arm.upper, (20, robot.joints)):
        assert np.allclose(visual.tool_pose(q, 0.03), robot.tool_pose(q), atol=1e-9)
    names = [link.name for link in visual.links]
    for opening in (0.0, 0.03, 0.08):
        T = visual.poses(workcell.home, opening)
        left, right = (T[names.index(name), :3, 3] for name in workcell.description.gripper.finger_links)
        assert np.linalg.norm(left - right) == pytest.approx(opening)
    assert all(
        sum(len(mesh.faces) for mesh in link.meshes) > 100
        for link in visual.links
        if "_link8" not in link.name and "tcp" not in link.name
    )


def test_held_part_starts_in_its_place_and_follows_the_tool(scene: PlanScene) -> None:
    for number, step in enumerate(scene.steps):
        part = scene.assembly.parts[scene.order[number]]
        start, end = scene.moment(number, 0.0), scene.moment(number, 1.0)
        assert np.allclose(start.T_world_held, part.T_world_part, atol=1e-4)
        first, last = (scene.robot.tool_pose(step.joint_path[row], step.grasp.width) for row in (0, -1))
        moved = last @ np.linalg.inv(first)
        assert np.allclose(end.T_world_held, moved @ part.T_world_part, atol=1e-4)
        T_world_tool = scene.robot.tool_pose(end.configuration, step.grasp.width)
        assert np.allclose(T_world_tool[:3, 3], scene.workcell.goal, atol=1e-3)
        assert not start.standing >> start.held & 1
    assert scene.moment(len(scene.steps) - 1, 0.0).standing == 0


def test_a_plan_for_assembly_shows_the_same_moments(folder: Path, scene: PlanScene) -> None:
    assert scene.plan is not None
    backwards = PlanScene(scene.assembly, scene.workcell, scene.plan.inverted())
    assert backwards.direction == "assembly" and backwards.order == scene.order
    assert np.allclose(backwards.moment(1, 0.3).configuration, scene.moment(1, 0.3).configuration)


def test_removed_parts_lie_apart_from_each_other_and_from_the_assembly() -> None:
    workcell = load_workcell("panda")
    for name in ("single/01.json", "double/01.json"):
        shown = PlanScene(load_assembly(data_path(name)), workcell)
        low, high = shown.bounds
        boxes = []
        for part, T in shown.laid_out.items():
            corners = shown.assembly.parts[part].shape.bounding_box().moved(T).corners()
            boxes.append((corners.min(axis=0), corners.max(axis=0)))
            assert boxes[-1][0][2] == pytest.approx(low[2])  # on the floor of the assembly
        assert len(boxes) == shown.assembly.root.bit_count()
        for i, (a_low, a_high) in enumerate(boxes):
            for b_low, b_high in [*boxes[:i], (low, high)]:
                assert ((a_high < b_low + 1e-9) | (b_high < a_low + 1e-9)).any()


def test_view_holds_all_corners(scene: PlanScene) -> None:
    for name in ("corner", "front", "above", "left"):
        for robot in (True, False):
            view = view_of(scene, name, robot, aspect=1.5)
            low, high = scene.bounds
            right = np.cross(view.direction, [0, 0, 1.0])
            right /= np.linalg.norm(right)
            up = np.cross(right, view.direction)
            for x in (low[0], high[0]):
                for y in (low[1], high[1]):
                    for z in (low[2], high[2]):
                        away = np.array([x, y, z]) - view.position
                        depth = away @ view.direction
                        assert abs(away @ up) / depth < np.tan(view.field / 2)
                        assert abs(away @ right) / depth < 1.5 * np.tan(view.field / 2)


def test_colors_follow_the_roles() -> None:
    assembly = load_assembly(data_path("single/01.json"))
    by_name = dict(zip((part.name for part in assembly.parts), colors_of(assembly), strict=True))
    assert by_name["frame_0_left"] == by_name["frame_0_back"] != by_name["back_0_0"] != by_name["front_0_0"]
    assert by_name["bottom_left"] == by_name["column_back_left"] != by_name["column_front_left"]  # fixed ones are grey
    assert role_of(assembly.parts[assembly.index["back_0_0"]]) == "back"


@pytest.mark.usefixtures("graphics")
def test_current_part_is_drawn_in_its_color_where_the_moment_has_it(scene: PlanScene) -> None:
    wanted = np.array(rgb(CURRENT))
    options = RenderOptions(480, 360, robot=False, path=False)
    with Renderer(scene, options) as renderer:
        centers = []
        for step in range(len(scene.steps)):
            image = renderer.picture(scene.moment(step, 0.0)) / 255
            hue = image / image.max(axis=2, keepdims=True).clip(0.05)
            rows, columns = np.nonzero((np.abs(hue - wanted / wanted.max()) < 0.12).all(axis=2))
            assert len(rows) > 20, scene.steps[step].part
            view = renderer.view
            away = scene.assembly.parts[scene.order[step]].T_world_part[:3, 3] - view.position
            right = np.cross(view.direction, [0, 0, 1.0])
            right /= np.linalg.norm(right)
            scale = 180 / np.tan(view.field / 2) / (away @ view.direction)
            expected = (180 - away @ np.cross(right, view.direction) * scale, 240 + away @ right * scale)
            centers.append((rows.mean(), columns.mean()))
            assert np.allclose(centers[-1], expected, atol=25)
    assert len({tuple(np.round(center)) for center in centers}) == len(centers)


@pytest.mark.usefixtures("graphics")
def test_soft_shadows_change_the_edges_of_shadows_only(scene: PlanScene) -> None:
    pictures = {}
    for soft in (False, True):
        with Renderer(scene, RenderOptions(320, 240, soft=soft)) as renderer:
            pictures[soft] = renderer.picture(scene.moment(0, 0.4)).astype(int)
            again = renderer.picture(scene.moment(0, 0.4))
        assert np.array_equal(again, pictures[soft])  # the light is where it was
    difference = np.abs(pictures[True] - pictures[False]).max(axis=2)
    assert 0.001 < (difference > 8).mean() < 0.1  # hard edges became soft, all else stays
    assert abs(pictures[True].mean() - pictures[False].mean()) < 1


def test_removed_parts_vanish_or_lie_beside(scene: PlanScene) -> None:
    last = scene.moment(len(scene.steps) - 1, 0.0)
    pictures = []
    for laid_out in (False, True):
        with Renderer(scene, RenderOptions(240, 180, laid_out=laid_out)) as renderer:
            pictures.append(renderer.picture(last))
    assert (pictures[0] != pictures[1]).any(axis=2).mean() > 0.001


@pytest.mark.usefixtures("graphics")
def test_command_writes_pictures_and_animations(tmp_path: Path, folder: Path) -> None:
    given = write_files(tmp_path, folder)
    for name, options in (
        ("sheet.png", ["--sheet", "--width", "96"]),
        ("step.png", ["--step", "2", "--width", "96", "--height", "96"]),
        ("plan.gif", ["--frames", "2", "--width", "96"]),
    ):
        out = tmp_path / name
        done = CliRunner().invoke(main, ["render", str(tmp_path / "plan.json"), "--out", str(out), *options, *given])
        assert done.exit_code == 0, done.output
        with PillowImage.open(out) as picture:
            assert np.asarray(picture.convert("RGB")).std() > 5
            if name == "step.png":
                assert picture.size == (96, 96)
            if name == "plan.gif":
                assert getattr(picture, "n_frames", 1) == 2 * three_bars().root.bit_count()
                picture.seek(3)
                assert picture.info["duration"] == pytest.approx(1000 / 12, abs=7)


@pytest.mark.usefixtures("graphics")
def test_animation_draws_the_moments_in_their_order_and_ends_when_nobody_looks(scene: PlanScene) -> None:
    assert scene.plan is not None
    options = RenderOptions(128, 96)
    with Renderer(scene, replace(options, moving=True)) as renderer:
        for shown in (scene, PlanScene(scene.assembly, scene.workcell, scene.plan.inverted())):
            moments = [(0, 0.0), (0, 0.5), (0, 1.0), (1, 0.0), (1, 0.5), (1, 1.0)]
            expected = [renderer.picture(scene.moment(*moment)).astype(int) for moment in moments]
            if shown is not scene:
                expected.reverse()
            for picture, other in zip(animation(shown, options, 3, [0, 1]), expected, strict=True):
                assert np.abs(picture - other).mean() < 0.1
    before = threading.active_count()
    pictures = animation(scene, options, 40)
    next(pictures)
    pictures.close()  # type: ignore[attr-defined]
    assert threading.active_count() == before


@pytest.mark.usefixtures("graphics")
def test_estimate_of_what_the_arm_hides_is_what_the_pictures_show(scene: PlanScene) -> None:
    base, goal = scene.workcell.T_world_base[:3, 3], scene.workcell.goal
    behind = (base - goal)[:2] / np.linalg.norm((base - goal)[:2])
    cells = scene.robot.merged_vertices(ARM_CELL)
    wanted = np.array(rgb(CURRENT))
    differences, shares = [], []
    for direction in (behind, -behind, np.array([behind[1], -behind[0]])):
        forward = np.array([*(-0.9 * direction), -np.sqrt(1 - 0.81)])
        right = np.cross(forward, [0, 0, 1.0]) / 0.9
        axes = np.array([right, np.cross(right, forward), forward])
        view = View((scene.bounds[0] + scene.bounds[1]) / 2, forward, 8.0, np.radians(10))  # nearly parallel rays
        drawn = {}
        for robot in (True, False):
            with Renderer(scene, RenderOptions(320, 240, robot=robot, path=False), view) as renderer:
                for moment in (scene.moment(step, fraction) for step in range(3) for fraction in (0.0, 0.5)):
                    image = renderer.picture(moment) / 255
                    hue = image / image.max(axis=2, keepdims=True).clip(0.05)
                    seen = (np.abs(hue - wanted / wanted.max()) < 0.12).all(axis=2).sum()
                    drawn[robot, moment.step, moment.fraction] = int(seen)
        for (robot, step, fraction), count in drawn.items():
            if robot or count < 40:
                continue
            shown = drawn[True, step, fraction] / count
            moment = scene.moment(step, fraction)
            with_arm = seen_shares(scene, moment, [axes], cells)[0]
            without = seen_shares(scene, moment, [axes], [np.zeros((0, 3)) for _ in cells])[0]
            shares.append(shown)
            differences.append(with_arm / without - shown)
    assert min(shares) < 0.4 and max(shares) > 0.8 and len(shares) > 8
    assert np.abs(differences).mean() < 0.15 and abs(np.mean(differences)) < 0.1


def test_view_of_a_plan_shows_more_of_the_parts_than_the_first_one(scene: PlanScene) -> None:
    cells = scene.robot.merged_vertices(ARM_CELL)
    moments = [scene.moment(step, fraction) for step in range(len(scene.steps)) for fraction in (0.0, 0.4)]

    def shown(view: View) -> float:
        right = np.cross(view.direction, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        axes = [np.array([right, np.cross(right, view.direction), view.direction])]
        return float(np.mean([min(seen_shares(scene, moment, axes, cells)[0], SEEN) for moment in moments]))

    plain = view_of(PlanScene(scene.assembly, scene.workcell))
    assert shown(view_of(scene)) >= shown(plain)
    for moment in moments:
        own, common = view_of(scene, moments=[moment]), view_of(scene)
        right = [np.cross(view.direction, [0, 0, 1.0]) for view in (own, common)]
        axes = [np.array([r, np.cross(r, v.direction), v.direction]) for r, v in zip(right, (own, common), strict=True)]
        axes = [a / np.linalg.norm(a, axis=1, keepdims=True) for a in axes]
        seen = seen_shares(scene, moment, axes, cells)
        assert min(seen[0], SEEN) >= min(seen[1], SEEN) - BETTER * SEEN


@pytest.mark.usefixtures("graphics")
def test_mp4_holds_all_frames(tmp_path: Path, scene: PlanScene) -> None:
    reader = pytest.importorskip("imageio_ffmpeg")
    save_animation(animation(scene, RenderOptions(128, 96), 3, [0, 1]), tmp_path / "plan.mp4", 10)
    frames, seconds = reader.count_frames_and_secs(str(tmp_path / "plan.mp4"))
    assert frames == 6 and seconds == pytest.approx(0.6, abs=0.1)


def test_sheet_has_a_place_for_every_picture() -> None:
    images = [np.full((60, 80, 3), 20 * k, dtype=np.uint8) for k in range(7)]
    sheet = contact_sheet(images, [str(k) for k in range(7)], "title", columns=3)
    colors = {tuple(pixel) for pixel in sheet.reshape(-1, 3).tolist()}
    assert {(20 * k,) * 3 for k in range(7)} <= colors and (255, 255, 255) in colors


def test_corrupted_plans_are_refused_in_one_line(tmp_path: Path, folder: Path) -> None:
    given = write_files(tmp_path, folder)
    file = tmp_path / "plan.json"
    rows = json.loads(file.read_text())["steps"][0]["tool_path"]
    for changes, message in (
        ({"part": "nothing"}, "no removable part"),
        ({"tool_path": [[x + 0.2, *rest] for x, *rest in rows]}, "0.200 m from where the tool path"),
    ):
        broken = corrupted(file, tmp_path / "broken.json", **changes)
        done = CliRunner().invoke(main, ["render", str(broken), "--out", str(tmp_path / "x.png"), *given])
        assert done.exit_code == 2 and message in done.output and len(done.output.splitlines()) == 1
        assert not (tmp_path / "x.png").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--out", "x.bmp"], "unknown ending"),
        (["--out", "x.gif", "--step", "1"], "an animation shows all steps"),
        (["--out", "x.png", "--sheet"], "holds no plan"),
        (["--out", "x.png", "--sheet", "--step", "1"], "give one of both"),
        (["--out", "nowhere/"], "there is no such folder"),
    ],
)
def test_misuse_is_told_in_one_line(
    options: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(main, ["render", str(data_path("single/01.json")), *options])
    assert done.exit_code == 2 and message in done.output and len(done.output.splitlines()) == 1


def test_without_graphics_the_way_out_is_told() -> None:
    code = (
        "from takeapart.cli.commands import main; import sys; sys.argv = ['takeapart', 'render', "
        f"{str(data_path('single/01.json'))!r}, '--out', '/tmp/never.png']; main()"
    )
    environment = {"PATH": "", "MUJOCO_GL": "disabled", "PYTHONPATH": ":".join(sys.path)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert done.returncode == 2 and "no OpenGL" in done.stderr and "MUJOCO_GL" in done.stderr, done.stderr
    assert len(done.stderr.strip().splitlines()) == 1 and not Path("/tmp/never.png").exists()


@pytest.mark.usefixtures("graphics")
def test_pictures_are_drawn_after_a_verification_in_the_same_process() -> None:
    code = (
        "import takeapart.verification\n"
        "from takeapart.formats.files import *\nfrom takeapart.pictures.renderer import *\n"
        "from takeapart.show.scene import PlanScene\n"
        "scene = PlanScene(load_assembly(data_path('single/01.json')), load_workcell('panda'))\n"
        "with Renderer(scene, RenderOptions(64, 48)) as renderer:\n    print(renderer.picture().std() > 5)"
    )
    environment = {k: v for k, v in os.environ.items() if k != "MUJOCO_GL"} | {"PYTHONPATH": ":".join(sys.path)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert done.stdout.strip() == "True" and "Error" not in done.stderr, done.stderr


def test_lifts_of_the_facts_are_those_of_the_planner(folder: Path) -> None:
    from takeapart.removal.planner import RemovalPlanner

    for assembly, workcell in (
        (three_bars(), small_workcell(folder)),
        (load_assembly(data_path("single/02.json")), load_workcell("panda")),
    ):
        planner = RemovalPlanner(assembly, workcell)
        found = hindrances(PlanScene(assembly, workcell))
        for i, part in enumerate(assembly.parts):
            if not part.fixed:
                lift = next(iter(planner.freedom(i)), None)
                assert found[i][1] == (assembly.root if lift is None else lift)


def test_facts_say_when_a_part_leaves_and_why_not_earlier(scene: PlanScene) -> None:
    facts = {each.name: each for each in part_facts(scene)}
    beam = facts["beam"]
    assert set(beam.carries) == {"stub", "rear"} and beam.step == 3 and beam.earliest == 3
    assert beam.freed_by == scene.steps[1].part and "would fall without it" in why_not_earlier(beam)
    for each in facts.values():
        if each.step:
            assert each.length >= each.bound - 1e-9 > 0
            assert 1 <= each.earliest <= each.step
    assert sum(each.bound for each in facts.values() if each.step) == pytest.approx(
        scene.plan.straight_line_bound if scene.plan else 0, abs=1e-6
    )
    assert "never leaves" in why_not_earlier(facts["back"])


def test_graph_has_no_edge_that_follows_from_others() -> None:
    assembly = load_assembly(data_path("single/01.json"))
    held_up = hindrances(PlanScene(assembly, load_workcell("panda")))
    edges = {(part, other) for part, other, _ in blocked_by(assembly, held_up)}
    reach = {
        (i, j) for i, masks in enumerate(held_up) for j in range(len(assembly.parts)) if (masks[0] | masks[1]) >> j & 1
    }
    full = set(edges)
    while True:  # what the edges imply is all that the masks say
        more = {(a, d) for a, b in full for c, d in edges if b == c} - full
        if not more:
            break
        full |= more
    assert reach - {(i, i) for i, _ in reach} <= full
    for edge in edges:
        others = edges - {edge}
        found: set[int] = set()
        front = {edge[0]}
        while front:
            front = {b for a, b in others if a in front} - found
            found |= front
        assert edge[1] not in found


def test_subject_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.json").write_text('{"format": "other"}')
    with pytest.raises(InputError, match="neither a plan"):
        load_subject(tmp_path / "x.json")
    with pytest.raises(InputError, match="no run directory"):
        load_subject(tmp_path)
