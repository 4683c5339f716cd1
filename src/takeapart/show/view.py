"""From where a scene is seen: views by name, and the one of several that hides least of the parts on their way.

How much is hidden is estimated without OpenGL: points of a part are seen along parallel rays past the boxes of the
parts that stand, without their connectors, and past spheres that stand for the arm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from takeapart.model.geometry import Array, OrientedBox, pose_inverse, rotation_from_quaternion
from takeapart.show.directions import DIRECTIONS
from takeapart.show.scene import Moment, PlanScene

TURNS = (112, 90, 68)  # degrees from the line from the arm to the assembly; the first if none is better
ELEVATION = 24  # degrees
BETTER = 0.08  # by what share another view has to show more before it is taken
SEEN = 0.5  # a part of which this share is seen counts as seen
FRACTIONS = (0.0, 0.4)  # of every path, at which parts should be seen
ARM_CELL = 0.035  # m, of the grid in whose cells vertices of the arm are one sphere
ARM_RADIUS = 0.018  # m
NEAR = 0.012  # m, what is closer to a point does not hide it: fingers touch what they hold
POINTS_ALONG = 5  # of a box along each edge where part of it may be seen


@dataclass(frozen=True, eq=False)
class View:
    """From where a picture is taken.

    Args:
        target: (3,) m, the point in the middle.
        direction: (3,) unit vector from the camera to the target.
        distance: m.
        field: vertical field of view, rad.
    """

    target: Array
    direction: Array
    distance: float
    field: float = math.radians(32)

    @property
    def position(self) -> Array:
        """Where the camera stands (3,), m."""
        return np.asarray(self.target - self.distance * self.direction)

    def beside_camera(self, offset: Array) -> Array:
        """A vector (3,), given for who looks from "corner", turned with the camera: where light comes from."""
        half = (math.atan2(-self.direction[1], -self.direction[0]) - math.radians(DIRECTIONS["corner"][0])) / 2
        return np.asarray(rotation_from_quaternion((math.cos(half), 0, 0, math.sin(half))) @ offset)


def view_of(
    scene: PlanScene,
    name: str = "corner",
    robot: bool = True,
    aspect: float = 4 / 3,
    moments: Sequence[Moment] | None = None,
) -> View:
    """A view that shows the whole assembly, and the arm if it is drawn.

    Args:
        name: one of `DIRECTIONS`; "corner" is turned so that the arm stands beside the assembly, and so that arm and
            assembly hide little of the parts on their way.
        aspect: width of the picture divided by its height.
        moments: at which the part on its way should be seen; by default some of every step.
    """
    if name == "corner" and robot:
        return _framed(scene, *_least_hidden(scene, moments), robot, aspect)
    return _framed(scene, *DIRECTIONS[name], robot, aspect)


def _framed(scene: PlanScene, azimuth: float, elevation: float, robot: bool, aspect: float) -> View:
    """A view of a scene from a direction, degrees."""
    low, high = scene.bounds
    points = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    if robot:
        points = np.vstack([points, scene.workcell.T_world_base[:3, 3], scene.workcell.goal, scene.reached])
    return framed(points, azimuth, elevation, aspect)


def framed(points: Array, azimuth: float, elevation: float, aspect: float) -> View:
    """A view from a direction, degrees, as near as points (P, 3), m, allow that are all seen."""
    right, up, direction = _axes(azimuth, elevation)
    target = _middle(points, right, up, direction)
    field = math.radians(32)
    tangent_v, tangent_h = math.tan(field / 2), math.tan(field / 2) * aspect
    offset = points - target
    depth = offset @ direction
    sideways = np.maximum(np.abs(offset @ up) / tangent_v, np.abs(offset @ right) / tangent_h)
    return View(target, direction, 1.08 * float((sideways - depth).max()), field)


def _axes(azimuth: float, elevation: float) -> Array:
    """Right, up and forward (3, 3) of a camera that stands at two angles, degrees, as seen from its target."""
    a, e = math.radians(azimuth), math.radians(elevation)
    forward = -np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    right = np.array([-math.sin(a), math.cos(a), 0.0])
    return np.array([right, np.cross(right, forward), forward])


def _least_hidden(scene: PlanScene, moments: Sequence[Moment] | None) -> tuple[float, float]:
    """Azimuth and elevation, degrees: across the line from the arm to the assembly, from the goal's side, unless more
    of the parts is seen from elsewhere."""
    low, high = scene.bounds
    base, middle = scene.workcell.T_world_base[:3, 3], (low + high) / 2
    toward = math.degrees(math.atan2(*(middle - base)[1::-1]))
    side = math.copysign(1.0, float(np.cross(middle - base, scene.workcell.goal - base)[2]))
    places = [(toward + sign * turn, float(ELEVATION)) for sign in (side, -side) for turn in TURNS]
    if moments is None:
        moments = [scene.moment(step, fraction) for step in range(len(scene.steps)) for fraction in FRACTIONS]
    if not moments:
        return places[0]
    axes, cells = [_axes(*place) for place in places], scene.robot.merged_vertices(ARM_CELL)
    seen = np.array([seen_shares(scene, moment, axes, cells) for moment in moments]).clip(0, SEEN).mean(axis=0) / SEEN
    best = int(seen.argmax())
    return places[best if seen[best] > seen[0] + BETTER else 0]


def seen_shares(scene: PlanScene, moment: Moment, axes: Sequence[Array], cells: Sequence[Array]) -> Array:
    """The share of the part on its way that neither arm nor standing parts hide, per camera (V,).

    Args:
        axes: of each camera right, up and forward (3, 3), in the world.
        cells: of the arm, see `takeapart.show.robot.RobotVisual.merged_vertices`.
    """
    assembly = scene.assembly
    part = assembly.parts[moment.held]
    surfaces = [_surface(box.moved(moment.T_world_held)) for box in part.shape.boxes()]
    points, normals = (np.concatenate(each) for each in zip(*surfaces, strict=True))
    standing = [part for i, part in enumerate(assembly.parts) if part.fixed or moment.standing >> i & 1]
    boxes = [box.moved(part.T_world_part) for part in standing for box in part.shape.boxes()]
    boxes += [obstacle.box for obstacle in scene.workcell.environment]
    T_box_world = np.array([pose_inverse(box.T_frame_box) for box in boxes]).reshape(-1, 4, 4)
    half = np.array([box.half_extents for box in boxes]).reshape(-1, 3)
    poses = scene.robot.poses(moment.configuration, moment.opening)
    arm = np.concatenate([c @ T[:3, :3].T + T[:3, 3] for c, T in zip(cells, poses, strict=True)])
    shares = []
    for right, up, forward in axes:
        facing = points[normals @ forward < -0.05]
        hidden = _behind_spheres(facing, arm, np.array([right, up, forward]))
        hidden[~hidden] = _behind_boxes(facing[~hidden], -forward, T_box_world, half)
        shares.append(1 - hidden.mean() if len(facing) else 0.0)
    return np.array(shares)


def _surface(box: OrientedBox) -> tuple[Array, Array]:
    """Points (P, 3), m, on the faces of a box, along its longest edge, and the normals (P, 3) of their faces."""
    longest = int(np.argmax(box.half_extents))
    steps = np.linspace(-1, 1, 2 * POINTS_ALONG + 1)[1::2]
    points, normals = [], []
    for axis in (k for k in range(3) if k != longest):
        for sign in (-1.0, 1.0):
            local = np.zeros((POINTS_ALONG, 3))
            local[:, longest] = steps * box.half_extents[longest]
            local[:, axis] = sign * box.half_extents[axis]
            points.append(local @ box.T_frame_box[:3, :3].T + box.T_frame_box[:3, 3])
            normals.append(np.tile(sign * box.T_frame_box[:3, axis], (POINTS_ALONG, 1)))
    return np.concatenate(points), np.concatenate(normals)


def _behind_spheres(points: Array, centers: Array, axes: Array) -> NDArray[np.bool_]:
    """Which points (P,) a sphere hides."""
    offset = (centers @ axes.T)[None] - (points @ axes.T)[:, None]  # (P, S, 3)
    hit = ((offset[..., :2] ** 2).sum(axis=2) < ARM_RADIUS**2) & (offset[..., 2] < -NEAR)
    return np.asarray(hit.any(axis=1), dtype=np.bool_)


def _behind_boxes(points: Array, toward: Array, T_box_world: Array, half: Array) -> NDArray[np.bool_]:
    """Which points (P,) a box hides from a camera far away in a direction (3,); by slabs (Kay and Kajiya 1986)."""
    start = np.einsum("bij,pj->pbi", T_box_world[:, :3, :3], points + NEAR * toward) + T_box_world[:, :3, 3]
    along = T_box_world[:, :3, :3] @ toward
    along = np.where(np.abs(along) < 1e-9, 1e-9, along)
    first, second = (-half - start) / along, (half - start) / along
    enter, leave = np.minimum(first, second).max(axis=2), np.maximum(first, second).min(axis=2)
    hit = leave > np.maximum(enter, 0.0)
    return np.asarray(hit.any(axis=1), dtype=np.bool_)


def _middle(points: Array, right: Array, up: Array, direction: Array) -> Array:
    """The point (3,) in the middle of points (P, 3) along three axes."""
    axes = np.array([right, up, direction])
    seen = points @ axes.T
    return np.asarray(((seen.min(axis=0) + seen.max(axis=0)) / 2) @ axes)
