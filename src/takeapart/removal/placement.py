"""Whether planning has a place to start from and to end at: the arm at rest, the goal, obstacles beside the product.

Each of these is asked once, before any removal is planned, and told with the bodies and the distance. Otherwise the
same fault came back from every part as a removal that does not exist.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from takeapart.collision.contact import SPACING
from takeapart.collision.fields import box_field, least_distance, surface_points
from takeapart.model.assembly import OVERLAP_TOLERANCE, Assembly
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, Box, OrientedBox, box_separation
from takeapart.motion.blockers import configuration_blockers
from takeapart.motion.scene import new_scene
from takeapart.removal.goals import ORIENTATIONS, GoalConfigurations
from takeapart.removal.wording import away, counted, millimetres, point
from takeapart.robot.arrays import Workspace
from takeapart.robot.extent import arm_extent
from takeapart.robot.gripper import box_links
from takeapart.robot.kinematics import forward
from takeapart.robot.model import RobotModel
from takeapart.robot.world import build_world
from takeapart.workcell import Workcell


def require_placement(assembly: Assembly, workcell: Workcell, robot: RobotModel) -> None:
    """Refuses what no plan can start from or end at.

    Raises:
        InputError: home is beyond a joint limit or in collision, the goal lies inside what never leaves, or an obstacle
            reaches into a removable part; the message names the two bodies and the depth.
    """
    _require_limits(workcell, robot)
    _require_free_parts(assembly, workcell)
    _require_free_goal(assembly, workcell)
    _require_free_home(assembly, workcell, robot)


def require_reached_goal(
    assembly: Assembly,
    workcell: Workcell,
    robot: RobotModel,
    goals: GoalConfigurations,
    padding: float,
    work: Workspace,
) -> None:
    """Refuses a goal at which the arm cannot put the tool, whatever it holds.

    Args:
        goals: configurations with the tool there.
        padding: distance kept, m.

    Raises:
        InputError: there is no such configuration, or each hits something that never leaves; the message names what,
            or the distance and the arm's reach.
    """
    if goals.is_reached(work):
        return
    where, place = f"{workcell.name}: goal", point(workcell.goal)
    rows = np.array(list(goals.solutions()))
    if len(rows):
        counts = _hits(assembly, workcell, robot, rows, padding, work)
        what = counted(counts, len(rows), "configurations that put the tool there")
        near = [(_outside(box, workcell.goal), name) for name, box in _permanent(assembly, workcell)]
        beside = [f", {millimetres(distance)} from {name}" for distance, name in sorted(near)[:1]]
        raise InputError(f"{place}{''.join(beside)}: the arm hits {what}", where)
    extent = arm_extent(robot)
    distance = float(extent.distances(workcell.goal[None])[0])
    if distance > extent.length:
        raise InputError(f"{place} is out of reach: {away(distance, extent)}", where)
    what = f"none of {ORIENTATIONS} orientations of the tool there is within the joint limits"
    raise InputError(f"{place}: {what}; it is {away(distance, extent)}", where)


def overlap_depth(first: Array, second: Array) -> float:
    """The least translation that parts the convex hulls of two sets of corners (V, 3) and (W, 3), m; 0 where they are
    apart.

    It is the distance of the origin from the surface of the Minkowski difference (Cameron, Culley: Determining the
    Minimum Translational Distance between Two Convex Polyhedra, ICRA 1986).
    """
    # Most bodies are apart along a side of the second one, which is a box, or from middle to middle.
    likely = np.vstack([second - second[0], second.mean(axis=0) - first.mean(axis=0), np.eye(3)])
    likely = np.vstack([likely, -likely])
    if ((first @ likely.T).max(axis=0) < (second @ likely.T).min(axis=0)).any():
        return 0.0
    normals = _facet_normals(first, second)
    # Along a direction n the second body has to move max(n a) - min(n b) to leave the first.
    shifts = (normals @ first.T).max(axis=1) - (normals @ second.T).min(axis=1)
    return max(float(shifts.min()), 0.0)


def _facet_normals(first: Array, second: Array) -> Array:
    """Outward unit normals (F, 3) of the facets of the Minkowski difference."""
    from scipy.spatial import ConvexHull  # takes longer to import than a small product to plan, and is rarely needed

    first, second = first[ConvexHull(first).vertices], second[ConvexHull(second).vertices]
    difference = (first[:, None] - second).reshape(-1, 3)
    return np.asarray(ConvexHull(difference).equations[:, :3])


def _require_limits(workcell: Workcell, robot: RobotModel) -> None:
    for joint, angle, low, high in zip(
        workcell.description.arm.joints, workcell.home, robot.arm.lower, robot.arm.upper, strict=True
    ):
        if not low <= angle <= high:
            raise InputError(
                f"joint {joint!r} stands at {angle:.4g} rad; {low:.4g} to {high:.4g} is valid",
                f"{workcell.name}: robot.home",
            )


def _require_free_parts(assembly: Assembly, workcell: Workcell) -> None:
    for i, part in enumerate(assembly.parts):
        for obstacle in () if part.fixed else workcell.environment:
            name, depth = f"part {part.name!r}", _depth_in(obstacle.box, assembly, i)
            if depth > OVERLAP_TOLERANCE:
                raise InputError(
                    f"reaches {1e3 * depth:.4g} mm into {name} of {assembly.name}; "
                    f"{1e3 * OVERLAP_TOLERANCE:.1f} mm is allowed",
                    f"{workcell.name}: obstacle {obstacle.name!r}",
                )


def _depth_in(obstacle: OrientedBox, assembly: Assembly, i: int) -> float:
    """How deep a part, with what it hosts, reaches into a box, m; of a mesh, its deepest corner or point between."""
    part = assembly.parts[i]
    boxes = [box.moved(part.T_world_part) for box in assembly.body(i)]
    depth = max(-_separation(box, obstacle) for box in boxes)
    if isinstance(part.shape, Box) or depth <= 0:
        return depth
    points = surface_points(part.shape.surface().moved(part.T_world_part), SPACING)
    return -least_distance(box_field(obstacle.T_frame_box, obstacle.half_extents), points)


def _require_free_goal(assembly: Assembly, workcell: Workcell) -> None:
    for name, box in _permanent(assembly, workcell):
        depth = float((box.half_extents - np.abs(_local(box, workcell.goal))).min())
        if depth > 0:
            raise InputError(
                f"{point(workcell.goal)} lies {1e3 * depth:.4g} mm inside {name}; "
                "the tool ends here, so it must be outside of what never leaves",
                f"{workcell.name}: goal",
            )


def _require_free_home(assembly: Assembly, workcell: Workcell, robot: RobotModel) -> None:
    work = robot.workspace()
    forward(robot.arm, np.asarray(workcell.home, dtype=float), work)
    links = [hull.corners @ work.R[hull.frame].T + work.p[hull.frame] for hull in robot.hulls]
    bodies = [  # the base may touch what it stands on
        (name, corners) for name, corners, hull in zip(robot.bodies, links, robot.hulls, strict=True) if hull.frame
    ]
    T_world_tool = robot.tool_pose(workcell.home, work)
    for name, box in zip(box_links(robot.description), robot.finger_boxes(0.0), strict=True):
        bodies.append((name, box.moved(T_world_tool).corners()))
    around = [
        (name, box.corners())
        for bodies in (_permanent(assembly, workcell), _removable(assembly))
        for name, box in bodies
    ]
    meetings = [
        (overlap_depth(corners, others), link, name)
        for link, corners in bodies
        for name, others in around
        if (corners.max(axis=0) >= others.min(axis=0)).all() and (corners.min(axis=0) <= others.max(axis=0)).all()
    ]
    meetings += [
        (overlap_depth(links[pair.first], links[pair.second]), robot.bodies[pair.first], robot.bodies[pair.second])
        for pair in robot.pairs
        if pair.treatment in ("table", "hulls")
    ]
    depth, first, second = max(meetings, default=(0.0, "", ""))
    if depth > OVERLAP_TOLERANCE:
        raise InputError(
            f"the arm at rest is in collision: {first} reaches {1e3 * depth:.4g} mm into {second}",
            f"{workcell.name}: robot.home",
        )


def _hits(
    assembly: Assembly, workcell: Workcell, robot: RobotModel, rows: Array, padding: float, work: Workspace
) -> list[tuple[str, int]]:
    """In how many of the configurations (K, n) the arm hits what never leaves, by name, the most frequent first."""
    bodies = list(_permanent(assembly, workcell))
    names = list(dict.fromkeys(name for name, _ in bodies))
    boxes = [(box, names.index(name)) for name, box in bodies]
    boxes += [(box, len(names)) for _, box in _removable(assembly)]  # so that there are any
    world = build_world(boxes, robot.largest_ball + padding)
    hits = np.zeros((len(rows), len(names) + 1), dtype=np.uint8)
    scene = new_scene(robot.arm, robot.held(0.0), world, np.ones_like(hits[0]), padding, 0.0, work)
    hits[:, -1] = configuration_blockers(scene, rows, hits)  # instead of the removable parts
    counts = zip([*names, "itself"], hits.sum(axis=0, dtype=int).tolist(), strict=True)
    return sorted([pair for pair in counts if pair[1]], key=lambda pair: -pair[1])


def _permanent(assembly: Assembly, workcell: Workcell) -> Iterator[tuple[str, OrientedBox]]:
    """What never leaves, by name, in the world frame: obstacles, and fixed parts with what they host."""
    for obstacle in workcell.environment:
        yield f"obstacle {obstacle.name!r}", obstacle.box
    for i, part in enumerate(assembly.parts):
        if part.fixed:
            for box in assembly.body(i):
                yield f"fixed part {part.name!r}", box.moved(part.T_world_part)


def _removable(assembly: Assembly) -> Iterator[tuple[str, OrientedBox]]:
    """The removable parts with what they host, by name, in the world frame."""
    for i, part in enumerate(assembly.parts):
        if not part.fixed:
            for box in assembly.body(i):
                yield f"part {part.name!r}", box.moved(part.T_world_part)


def _local(box: OrientedBox, position: Array) -> Array:
    """A position (3,), m, in the box's own frame."""
    return np.asarray(box.T_frame_box[:3, :3].T @ (position - box.T_frame_box[:3, 3]))


def _outside(box: OrientedBox, position: Array) -> float:
    """Distance of a position (3,) from a box, m; 0 inside."""
    return float(np.linalg.norm(np.maximum(np.abs(_local(box, position)) - box.half_extents, 0.0)))


def _separation(first: OrientedBox, second: OrientedBox) -> float:
    return float(
        box_separation(
            first.T_frame_box[None], first.half_extents[None], second.T_frame_box[None], second.half_extents[None]
        )[0]
    )
