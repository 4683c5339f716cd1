"""Where planning starts from and ends at: what stands wrong is named before any removal is planned, with the depth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from takeapart.model.errors import InputError
from takeapart.model.geometry import OrientedBox, pose
from takeapart.removal.placement import overlap_depth, require_placement
from takeapart.robot.loading import load_robot
from takeapart.workcell import Obstacle, Workcell
from verification_scene import scene_assembly, scene_workcell


def refusal(cell: Workcell) -> str:
    with pytest.raises(InputError) as raised:
        require_placement(scene_assembly(), cell, load_robot(cell))
    return str(raised.value)


def test_the_depth_of_two_turned_boxes_is_that_of_the_separating_axes() -> None:
    half = np.array([0.1, 0.2, 0.3])
    corners = OrientedBox(pose(), half).corners()
    for x, depth in ((0.15, 0.05), (0.19, 0.01), (0.21, 0.0)):
        moved = OrientedBox(pose((x, 0, 0)), np.array([0.1, 0.05, 0.05])).corners()
        assert overlap_depth(corners, moved) == pytest.approx(depth, abs=1e-12)
    turned = OrientedBox(pose((0.2, 0, 0), (np.cos(np.pi / 8), 0, 0, np.sin(np.pi / 8))), np.full(3, 0.1)).corners()
    assert overlap_depth(corners, turned) == pytest.approx(0.1 + 0.1 * 2**0.5 - 0.2, abs=1e-12)


def test_a_scene_where_all_stands_well_is_not_refused() -> None:
    cell = scene_workcell()
    require_placement(scene_assembly(), cell, load_robot(cell))


def test_a_goal_inside_an_obstacle_is_refused_with_the_depth() -> None:
    cell = scene_workcell()
    table = cell.environment[0]
    top = table.box.T_frame_box[:3, 3] + [0, 0, table.box.half_extents[2]]
    assert f"lies 10 mm inside obstacle {table.name!r}" in refusal(replace(cell, goal=top - [0, 0, 0.01]))
    require_placement(scene_assembly(), replace(cell, goal=top + [0, 0, 0.01]), load_robot(cell))


def test_an_obstacle_inside_a_part_is_refused_with_the_depth() -> None:
    cell, assembly = scene_workcell(), scene_assembly()
    loose = next(part for part in assembly.parts if part.name == "loose")
    box = loose.shape.bounding_box().moved(loose.T_world_part)
    axis = box.T_frame_box[:3, 0]
    for overlap in (0.004, -0.004):  # a cube that reaches 4 mm into the end of the part, or stands 4 mm before it
        T = box.T_frame_box.copy()
        T[:3, 3] += axis * (box.half_extents[0] + 0.05 - overlap)
        crowded = replace(cell, environment=(*cell.environment, Obstacle("crate", OrientedBox(T, np.full(3, 0.05)))))
        if overlap > 0:
            assert "obstacle 'crate': reaches 4 mm into part 'loose'" in refusal(crowded)
        else:
            require_placement(assembly, crowded, load_robot(cell))


def test_what_a_part_hosts_is_part_of_it() -> None:
    """The beam's connector for the stub: an obstacle inside of its wall, and below it, where nothing is."""
    cell, assembly = scene_workcell(), scene_assembly()
    beam = assembly.parts[assembly.index["beam"]]
    wall = assembly.body(assembly.index["beam"])[1].moved(beam.T_world_part)
    low = wall.corners()[:, 2].min()
    for overlap in (0.001, -0.001):
        T = pose((*wall.T_frame_box[:2, 3], low + overlap - 0.002))
        crowded = replace(cell, environment=(*cell.environment, Obstacle("pin", OrientedBox(T, np.full(3, 0.002)))))
        if overlap > 0:
            assert "obstacle 'pin': reaches 1 mm into part 'beam'" in refusal(crowded)
        else:
            require_placement(assembly, crowded, load_robot(cell))


def test_home_in_collision_is_refused_with_both_bodies_and_the_depth() -> None:
    cell = scene_workcell()
    robot = load_robot(cell)
    fingers = robot.finger_boxes(0.0)
    corners = np.concatenate([box.moved(robot.tool_pose(cell.home)).corners() for box in fingers])
    low = corners[:, 2].min()  # the fingers point down here: a slab from below meets them first
    for overlap in (0.003, -0.003):
        T = pose((*corners[:, :2].mean(axis=0), low + overlap - 0.01))
        slab = Obstacle("slab", OrientedBox(T, np.array([0.04, 0.04, 0.01])))
        crowded = replace(cell, environment=(*cell.environment, slab))
        if overlap > 0:
            message = refusal(crowded)
            assert "robot.home: the arm at rest is in collision: panda_" in message
            assert "finger reaches 3 mm into obstacle 'slab'" in message
        else:
            require_placement(scene_assembly(), crowded, robot)
