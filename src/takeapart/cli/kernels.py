"""The kernels that a plan needs, each with the types of its arguments: enough to compile them beforehand."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numba
import numpy as np

from takeapart.collision import bounds, fields, grids, meeting, parting, passing, points, screws, triangles
from takeapart.compilation import LeanKernel
from takeapart.motion import blockers, edges, legs, lifts, rrt, scene, smooth
from takeapart.removal import contact_maps
from takeapart.robot import arrays, grid, hand, kernels, kinematics, self_collision, separation
from takeapart.search import lattice, lattice_bounds

ELEMENTS = {
    "Floats": float,
    "Array": float,
    "Integers": np.int32,
    "Flags": np.uint8,
    "Indices": np.int64,
    "Counters": np.uint64,
}
ELEMENTS |= {"Distances": np.uint16, "RandomState": np.uint64, "Grid": np.int16, "Coarse": np.float32}
NUMBERS = {"int": 0, "float": 0.0}


def example(form: type[Any]) -> Any:
    """A named tuple of arrays of the declared types, with the dimensions that the comments beside them give.

    Raises:
        ValueError: an array whose comment does not begin with its shape.
    """
    shapes = dict(re.findall(r"^    (\w+): \w+  # \(([^)]*)\)", inspect.getsource(form), re.MULTILINE))
    values: list[Any] = []
    for name, declared in form.__annotations__.items():
        kind = str(getattr(declared, "__forward_arg__", declared))  # annotations are not evaluated
        if kind in ELEMENTS and name not in shapes:
            raise ValueError(f"{form.__name__}.{name}: the comment must begin with the shape, as in '# (n, 3) m'")
        if kind in ELEMENTS:
            dimensions = len([size for size in shapes[name].split(",") if size.strip()])
            values.append(np.zeros((1,) * dimensions, ELEMENTS[kind]))
        else:
            values.append(NUMBERS[kind] if kind in NUMBERS else example(getattr(arrays, kind)))
    return form(*values)


@dataclass(frozen=True, eq=False)
class Unit:
    """What is compiled at once.

    Args:
        name: for people.
        function: in Python.
        dispatcher: numba's.
        signature: types of the arguments, in numba's terms.
        inner: whether it is there only to become part of others.
    """

    name: str
    function: Callable[..., Any]
    dispatcher: Any
    signature: tuple[Any, ...]
    inner: bool


@cache
def units(orders: bool) -> dict[str, Unit]:
    """By name. What others contain comes first, then what takes long.

    Args:
        orders: with the kernels of the search for orders of removals.
    """
    arm, held, world = (example(form) for form in (arrays.ArmArrays, arrays.HeldArrays, arrays.WorldArrays))
    work, situation = example(arrays.Workspace), example(scene.Scene)
    one, two, three = (np.zeros((1,) * k) for k in (1, 2, 3))
    flags, table = np.zeros(1, np.uint8), np.zeros((1, 1), np.uint8)
    int16, int32, int64 = (np.zeros(1, kind) for kind in (np.int16, np.int32, np.int64))
    words, bits = np.zeros(1, np.uint64), np.zeros((1, 1), np.uint64)
    shared = [
        (kernels._hits_itself, (arm, held, 0.0, work)),
        (kernels.held_hits_world, (arm, held, world, flags, 0.0, work, flags, True)),
        (kernels.placed, (arm, held, world, flags, 0.0, work)),
        (kernels.collect_placed, (arm, held, world, flags, 0.0, work, flags)),
        (scene.look_at, (situation, one, one, 0.0, 0.0)),
        (scene.piece_free, (situation, one, one)),
        (scene.is_free, (situation, one)),
        (edges.tool_edge, (situation, one, one, 0.0, two)),
    ]
    called = [
        (separation.separation, (two, two, two, one, 0.0, 0.0, two)),
        (self_collision._fill, (two, two, three, one, one, np.zeros((1, 1), np.uint16))),
        (hand.hand_masks, (arm, held, world, flags, 0.0, 0.0, two, three, three, one, 0.0, held, work, table, table)),
        (blockers.path_blockers, (situation, two, flags)),
        (legs.two_legs, (situation, two, two, two, 0, 0.0, 0.0, 0)),
        (smooth.shorten, (situation, two, 0.0, 0, 0.0, 0.0, 0, 0)),
        (rrt.rrt_connect, (situation, two, two, 0, 0.0, 0)),
        (lifts.lift_ends, (situation, two, three, three, table, flags)),
        (lifts.complete_lifts, (situation, three, table, flags)),
        (legs.one_leg, (situation, two, two, 0.0)),
        (blockers.configuration_blockers, (situation, two, table)),
        (kernels.check, (arm, held, world, flags, 0.0, one, work)),
        (legs.bends, (world, flags, one, one, 0.0, 0, 0.0, 0)),
        (edges.resampled, (situation, two, 0.0, True)),
        (edges.waypoints, (situation, two, 0.0)),
        (legs.near_pairs, (arm, two, two, 0)),
        (legs.joint_distances, (arm, two, two)),
        (hand.move_load, (held, two, held)),
        (kinematics.forward, (arm, one, work)),
        (kinematics.tool_poses, (arm, two, work, two)),
        (kinematics.tool_steps, (arm, two, work, one)),
        (kinematics.mark_solutions, (example(arrays.ChainArrays), two, two, example(arrays.ChainFrames), flags)),
        (kinematics.wind_to_middle, (one, one, int32, two, flags)),
        (grid.grid_fill, (two, three, two, one, 0.0, int32, 0.0, int32, int32, True)),
        (grid.clearance_fields, (two, three, two, int32, one, 0.0, int32, 0.0, table)),
    ]
    view = example(contact_maps.ContactMap)
    called += [  # of grasps on meshes
        (contact_maps.touched_areas, (view, two, one, two, 0.0, one, 0.0, 0.0)),
        (contact_maps.lengths_behind, (view, two, two, 0.0, 0)),
        (contact_maps.crossings, (three, one, one, 0.0, int32)),
        (contact_maps.pinches, (view, np.zeros((1, 1), np.int32), 0.0, 0)),
        (contact_maps.closings, (view, np.zeros((1, 1), np.int32), 0.0, 0.0, 0.0)),
        (contact_maps.lengths_along, (view, two, two, 0.0, 0.0)),
    ]
    field, cloud, tree = example(fields.Field), example(points.Cloud), example(triangles.TriangleTree)
    grid16, counts, middles = np.zeros((1, 1, 1), np.int16), np.zeros((1, 1, 1), np.int8), example(fields.Field).coarse
    side, covers, some = (
        passing.Side(field, cloud, two, two, two),
        bounds.covers_of([np.zeros((1, 2, 3))]),
        np.zeros(1, np.bool_),
    )
    called += [  # of contact between parts
        (grids._fill, (tree, one, 0.0, 0.0, counts, grid16, middles, 0)),
        (meeting.cloud_hit, (field, cloud, two, one, 0.0, 0.0)),
        (grids._count_crossings, (three, one, 0.0, 0, counts)),
        (screws._travel, (field, two, example(screws.ScrewArrays), 0.0, 0.0)),
        (parting.parted_after, (field, two, one, 0.0, 0.0, 0.0)),
        (parting.nearer_than, (field, two, two, 0.0)),
        (meeting.points_below, (field, cloud, two, 0.0)),
        (meeting.cloud_distance, (field, cloud, two, 0.0)),
        (triangles.distances, (two, tree, 0.0)),
        (fields.signed_distances, (field, two)),
        (bounds.pass_near, (three, three, two, 0.0, one)),
        (bounds.clear_after, (three, covers, some, two, two, example(bounds.Way))),
        (bounds.near_at, (three, covers, some, one, one, 0.0, 0.0)),
        (passing.passes, (side, side, passing.Keep(0.0, True, 0.0, 0.0), one)),
    ]
    of_orders = [
        (lattice._count_candidates, (bits, bits, int64)),
        (lattice._expand_layer, (bits, bits, int64, int16, int32, bits, int32)),
        (lattice._group_by_part, (int64, int16, int64, int32, int32)),
        (lattice._intersection, (bits, int32)),
        (lattice.cost_to_go, (int64, int32, one, int32, one)),
        (lattice.cost_from_root, (int64, int32, one, int32, one)),
        (lattice_bounds._take_removal, (bits, int32, int32, words, 0.0, one, one)),
        (lattice_bounds._take_closed, (bits, int32, int32, words, 0.0, one, one)),
    ]
    found = [_unit(kernel, arguments, inner=True) for kernel, arguments in shared]
    found += [_unit(kernel, arguments) for kernel, arguments in [*called, *(of_orders if orders else [])]]
    return {unit.name: unit for unit in found}


def _unit(kernel: Any, arguments: tuple[Any, ...], inner: bool = False) -> Unit:
    function, lean = kernel.py_func, isinstance(kernel, LeanKernel)
    name = f"{function.__module__.removeprefix('takeapart.')}.{function.__name__}"
    dispatcher = (kernel.inner if inner else kernel.called) if lean else kernel
    return Unit(name, function, dispatcher, tuple(numba.typeof(argument) for argument in arguments), inner)


def called_by(function: Callable[..., Any]) -> set[Callable[..., Any]]:
    """The kernels, as functions in Python, that a kernel calls, and those that these call."""
    found: set[Callable[..., Any]] = set()
    waiting = [function]
    while waiting:
        caller = waiting.pop()
        for name in caller.__code__.co_names:
            called = getattr(caller.__globals__.get(name), "py_func", None)
            if called is not None and called not in found:
                found.add(called)
                waiting.append(called)
    return found
