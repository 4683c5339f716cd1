"""The picture of an arm: what the planner takes it for lies around what it looks like."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner

from takeapart.cli.commands import main
from takeapart.cli.robot_picture import draw_robot
from takeapart.formats.files import load_workcell
from takeapart.model.errors import InputError
from takeapart.pictures.model import RenderOptions
from takeapart.pictures.renderer import NoGraphicsError
from takeapart.pictures.robot import bodies_at, robot_picture
from takeapart.robot.loading import load_robot
from takeapart.robot.model import RobotModel
from takeapart.show.robot import load_robot_visual

CONTAINED = 0.97  # of the corners of a link's look
NEAR = 0.02  # m, the same within so much


@pytest.fixture(scope="module")
def ur5e() -> RobotModel:
    return load_robot(load_workcell("ur5e"))


def test_hulls_lie_around_the_links_as_they_look(ur5e: RobotModel) -> None:
    """The look has kinematics of its own."""
    home = np.array(ur5e.description.arm.home)
    visual = load_robot_visual(ur5e.description, ur5e.T_world_base)
    poses = visual.poses(home, ur5e.description.maximum_opening)
    looks = {
        link.name: np.vstack([mesh.vertices @ T[:3, :3].T + T[:3, 3] for mesh in link.meshes])
        for number, (link, T) in enumerate(zip(visual.links, poses, strict=True))
        if link.meshes and number < visual.hand
    }
    found = dict(zip(ur5e.bodies, bodies_at(ur5e, home), strict=True))
    seen = 0
    for name, points in looks.items():
        if name in found and name != "base_link_inertia":  # whose look has a cable
            distance = trimesh.proximity.signed_distance(trimesh.convex.convex_hull(found[name]), points[::20])
            assert (distance > -NEAR).mean() >= CONTAINED, name
            seen += 1
    assert seen == 6


def test_the_picture_shows_hulls_pads_and_knuckles(ur5e: RobotModel) -> None:
    try:
        image = robot_picture(ur5e, RenderOptions(300, 300)).astype(int)
    except NoGraphicsError as missing:
        pytest.skip(str(missing))
    assert image.shape == (300, 300, 3)
    red, green, blue = np.moveaxis(image, 2, 0)
    shares = {
        "hulls": ((blue > red + 30) & (blue > green + 10)).mean(),
        "pads": ((green > red + 15) & (green > blue + 5)).mean(),
        "knuckles": ((red > blue + 40) & (red > green + 15)).mean(),
    }
    assert shares["hulls"] > 0.08 and shares["pads"] > 0.0008 and shares["knuckles"] > 0.0015, shares
    drawn = np.argwhere((blue > red + 30) & (blue > green + 10))
    assert drawn.min() > 2 and drawn.max() < 297  # the whole arm is seen


def test_the_command_draws_beside_its_table(tmp_path: Path) -> None:
    out = tmp_path / "arm.png"
    done = CliRunner().invoke(main, ["robot", "ur5e", "--picture", str(out)])
    if "no OpenGL" in done.stderr:
        pytest.skip(done.stderr)
    assert done.exit_code == 0, done.stderr
    assert out.read_bytes().startswith(b"\x89PNG")
    assert "pairs of links" in done.stdout and f"drawn in {out}" in done.stderr


def test_a_picture_that_cannot_be_is_refused_in_one_line(tmp_path: Path) -> None:
    done = CliRunner().invoke(main, ["robot", "ur5e", "--picture", str(tmp_path / "arm.jpg")])
    assert (done.exit_code, done.stdout) == (2, "")
    assert "give a name that ends in .png" in done.stderr and done.stderr.count("\n") == 1
    with pytest.raises(InputError, match="needs an arm with a gripper"):
        draw_robot(None, tmp_path / "arm.png")
    assert list(tmp_path.iterdir()) == []
