"""Where an arm could stand so that it can take products apart: a small search over places, each judged by how many
parts it takes away from there."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from takeapart.model.assembly import Assembly
from takeapart.model.description import RobotDescription
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, OrientedBox, pose
from takeapart.problem import AssemblyProblem
from takeapart.removal.planner import RemovalPlanner
from takeapart.removal.result import Effort, Removal
from takeapart.robot.extent import arm_extent
from takeapart.robot.loading import load_robot
from takeapart.stability import stability_of
from takeapart.states import members
from takeapart.workcell import Obstacle, Workcell

BELOW = 0.002  # m from the product down to the table
TABLE, PEDESTAL = 0.04, 0.22  # m, thickness; edge
MARGIN = 0.5  # m of the table around everything
PANDA_REACH = 0.95  # m; the places are those of the cells in which a Panda stands, scaled by the reach
AWAY = (0.30, 0.22, 0.38, 0.46)  # m from the product to the base's axis, along x
HEIGHTS = (0.20, 0.35, 0.05, 0.50)  # m from the table to the base
GOALS = ((0.05, -0.40, 0.15), (0.05, 0.40, 0.15), (0.0, -0.45, 0.30), (0.10, -0.45, 0.05))  # m from the base


@dataclass(frozen=True, eq=False)
class Placed:
    """A workcell that was found.

    Args:
        removable: parts that the arm takes away in it one after the other, of all products together.
        of: removable parts of the products.
        tried: places that were looked at.
    """

    workcell: Workcell
    removable: int
    of: int
    tried: int


def placed_for(
    description: RobotDescription,
    assemblies: Sequence[Assembly],
    name: str,
    told: Callable[[str, float], None] | None = None,
) -> Placed:
    """The first place from which the arm takes every product apart, or the one from which it takes away most parts.

    Args:
        assemblies: products that all stand at the same place, each by itself.
        name: of the workcell.
        told: is told what is done, and how much of all, from 0 to 1.

    Raises:
        InputError: the arm can stand at none of the places, with what hinders it at the last.
    """
    boxes = [
        box.moved(part.T_world_part)
        for assembly in assemblies
        for i, part in enumerate(assembly.parts)
        for box in assembly.body(i)
    ]
    corners = np.concatenate([box.corners() for box in boxes])
    low, high = corners.min(axis=0), corners.max(axis=0)
    total = sum(len(members(assembly.root)) for assembly in assemblies)
    robot = load_robot(_cell(description, name, (low, high), (AWAY[0], HEIGHTS[0], GOALS[0]), 1.0))
    scale = arm_extent(robot).length / PANDA_REACH
    best: Placed | None = None
    hindrance, tried = "", 0
    places = list(itertools.product(AWAY, HEIGHTS, GOALS))
    places.sort(key=lambda place: GOALS.index(place[2]))
    for place in places:
        cell = _cell(description, name, (low, high), place, scale)
        tried += 1
        if told is not None:
            told(f"place {tried}, best {best.removable if best else 0} of {total} parts", tried / len(places))
        moved = replace(robot, arm=robot.arm._replace(T_world_base=np.ascontiguousarray(cell.T_world_base[:3])))
        count, left = 0, total
        try:
            for assembly in assemblies:
                if best is not None and count + left <= best.removable:
                    break  # as good as the best at most
                count += taken_away(RemovalPlanner(assembly, cell, robot=moved))
                left -= len(members(assembly.root))
        except InputError as error:
            hindrance = str(error)
            continue
        if best is None or count > best.removable:
            best = Placed(cell, count, total, tried)
        if count == total:
            break
    if best is None:
        names = ", ".join(assembly.name for assembly in assemblies)
        raise InputError(f"the arm finds no place before {names}; at the last: {hindrance}", description.name)
    return replace(best, tried=tried)


def taken_away(planner: RemovalPlanner) -> int:
    """Number of parts that are taken away if always the first that can leave does. What leaves early hinders no other,
    so another order would take away as many, but for paths that the planner finds in one order only.
    """
    problem = AssemblyProblem(planner, stability_of(planner.assembly), seed=0)
    state, count = planner.assembly.root, 0
    while True:
        for part in problem.candidates(state):
            if isinstance(problem.remove(state, part, Effort()), Removal):
                state, count = state & ~(1 << part), count + 1
                break
        else:
            return count


def _cell(
    description: RobotDescription,
    name: str,
    corners: tuple[Array, Array],
    place: tuple[float, float, tuple[float, float, float]],
    scale: float,
) -> Workcell:
    """The workcell at one place: distance of the base, its height, goal from the base, m, all but the height scaled."""
    low, high = corners
    away, height, goal = place
    top = float(low[2]) - BELOW
    base = np.round([low[0] - away * scale, (low[1] + high[1]) / 2, top + height], 3)
    return Workcell(
        name=name,
        description=description,
        T_world_base=pose(base),
        home=np.array(description.arm.home),
        goal=np.round(base + np.array(goal) * scale, 3),
        environment=_surroundings(base, low, high, top),
    )


def _surroundings(base: Array, low: Array, high: Array, top: float) -> tuple[Obstacle, ...]:
    """Table below the product, m, and pedestal below the base."""
    near, far = np.minimum(low, base)[:2] - MARGIN, np.maximum(high, base)[:2] + MARGIN
    size, middle = np.ceil((far - near) * 10) / 10, np.round((near + far) / 2, 3)
    table = OrientedBox(pose([*middle, top - TABLE / 2]), np.array([*size, TABLE]) / 2)
    found = [Obstacle("table", table)]
    height = float(base[2]) - top
    if height > 1e-3 and math.isfinite(height):
        column = OrientedBox(pose([*base[:2], top + height / 2]), np.array([PEDESTAL, PEDESTAL, height]) / 2)
        found.append(Obstacle("pedestal", column))
    return tuple(found)
