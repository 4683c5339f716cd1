"""The gripper in a URDF: its fingers on both sides, how they close, and where the tool is, by moving and measuring."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from takeapart.model.description import GripperDescription
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, quaternion_from_rotation
from takeapart.robot.describe.arm import NOT_A_BASE, file_name, root_of
from takeapart.robot.describe.groups import Group, group
from takeapart.robot.urdf import Urdf, collisions

STANDARD_FORCE, STANDARD_FRICTION = 20.0, 0.5  # N, 1; a URDF says neither
MOST_DRIVERS = 4
SAMPLES = 65  # of the joints' range from closed to open
ROWS = 17  # of the table, where the gripper is no linear one
LINEAR = 1e-5  # m; a gripper whose table is linear up to this needs two rows
LEAST_STROKE = 0.002  # m
FACE = 0.001  # m; what lies so near to the innermost point of a finger belongs to its pad
FROM_TIP = 0.010  # m from the end of the pads to the tool, or half of their length if that is less
SNAP = math.radians(3)  # axes that are so near to those of the base link are these
FACING = 0.8  # cosine between the closing direction and the normal of a face that belongs to a pad


@dataclass(frozen=True)
class FoundGripper:
    """What was found.

    Args:
        least: smallest distance between the pads that the joints allow, m.
        overlap: how far the joints would close beyond touching pads, m.
    """

    gripper: GripperDescription
    least: float
    overlap: float


@dataclass(frozen=True, eq=False)
class _Finger:
    """A group of links at the end of a branch, with its geometry in the frame of its first link."""

    group: Group
    triangles: Array  # (F, 3, 3) m


def find_gripper(
    urdf: Urdf,
    base: str | None = None,
    name: str | None = None,
    force: float | None = None,
    friction: float | None = None,
) -> FoundGripper:
    """The gripper in a URDF, or in its part below a base link.

    Args:
        base: link that is mounted on the flange; the root of the file where None.
        name: of the gripper; the URDF's where None.
        force: N; `STANDARD_FORCE` where None.
        friction: `STANDARD_FRICTION` where None.

    Raises:
        InputError: it does not have two fingers with geometry that move towards each other.
    """
    base = base or _file_base(urdf)
    drivers = _drivers(urdf, base)
    fingers = _fingers(urdf, base)
    closed, opened, left, right = _best_pair(urdf, base, drivers, fingers)
    R = _tool_axes(urdf, base, drivers, closed, opened, left, right)
    shares = np.linspace(0.0, 1.0, SAMPLES)
    gaps, points = _measured(urdf, base, drivers, closed, opened, left, right, R, shares)
    if float(np.ptp(gaps)) < LEAST_STROKE or gaps[-1] <= 0:
        ends = f"from {1e3 * gaps[0]:.1f} to {1e3 * gaps[-1]:.1f} mm"
        raise InputError(f"its fingers open {ends}: no gripper", urdf.where)
    if (np.diff(gaps) < -1e-4).any():
        raise InputError("its fingers do not open all the way from one end of their joints to the other", urdf.where)
    # Openings evenly apart, from the first at which the pads do not overlap.
    least = max(float(gaps[0]), 0.0)
    bend = abs(float(np.interp(0.5, shares, gaps)) - 0.5 * float(gaps[0] + gaps[-1]))
    linear = max(bend, float(np.ptp(points, axis=0).max())) < LINEAR
    openings = np.linspace(least, float(gaps[-1]), 2 if linear else ROWS)
    at = np.interp(openings, np.maximum.accumulate(gaps), shares)
    exact, tool = _measured(urdf, base, drivers, closed, opened, left, right, R, at)
    if linear:
        tool = np.repeat(tool[-1:], 2, axis=0)
    positions = closed + at[:, None] * (opened - closed)  # (K, drivers)
    w, x, y, z = quaternion_from_rotation(R).tolist()
    gripper = GripperDescription(
        name=file_name(name or urdf.name),
        files=urdf.files,
        base_link=base,
        finger_links=tuple(
            link for finger in (left, right) for link in finger.group.links if urdf.links[link].collisions
        ),
        joints=tuple(drivers),
        openings=tuple(_digits(max(value, 0.0)) for value in exact.tolist()),
        positions=tuple(tuple(_digits(value) for value in row) for row in positions.T.tolist()),
        tool_points=tuple((_digits(a), _digits(b), _digits(c)) for a, b, c in tool.tolist()),
        tool_orientation=(_digits(w), _digits(x), _digits(y), _digits(z)),
        gripping_force=STANDARD_FORCE if force is None else force,
        friction=STANDARD_FRICTION if friction is None else friction,
    )
    return FoundGripper(gripper, least, max(-float(gaps[0]), 0.0))


def _digits(value: float) -> float:
    return round(value, 9) + 0.0


def _file_base(urdf: Urdf) -> str:
    """The root of the file, but none that stands for the room."""
    link = root_of(urdf, next(iter(urdf.links)))
    while not urdf.links[link].collisions and any(word in link.lower() for word in NOT_A_BASE):
        below = [joint for joint in urdf.below[link] if joint.kind == "fixed"]
        if len(below) != 1:
            break
        link = below[0].child
    return link


def _drivers(urdf: Urdf, base: str) -> list[str]:
    """Joints of a gripper that move by themselves, one or all together."""
    inside = set(urdf.subtree(base))
    moving = [j.name for j in urdf.joints.values() if j.parent in inside and j.kind != "fixed"]
    found = list(dict.fromkeys(urdf.driver(name) for name in moving))
    if not found:
        raise InputError(f"nothing moves below {base!r}: no gripper", urdf.where)
    if len(found) > MOST_DRIVERS:
        raise InputError(f"{len(found)} joints move by themselves below {base!r}: no two fingers", urdf.where)
    return found


def _fingers(urdf: Urdf, base: str) -> list[_Finger]:
    """The ends of the branches that have geometry."""
    found = []
    stack = [joint.child for joint in group(urdf, base).joints]
    while stack:
        here = group(urdf, stack.pop())
        stack += [joint.child for joint in here.joints]
        poses = urdf.fixed_on(here.first)
        pieces = [mesh.moved(poses[link]).triangles for link in here.links for mesh in collisions(urdf, link)]
        if pieces and not here.joints:
            found.append(_Finger(here, np.concatenate(pieces)))
    if len(found) < 2:
        raise InputError(
            f"{len(found)} fingers with collision geometry hang on {base!r}; a gripper has two", urdf.where
        )
    return found[::-1]


def _placed(urdf: Urdf, base: str, finger: _Finger, values: dict[str, float]) -> Array:
    """Triangles (F, 3, 3) of a finger in the frame of the base link."""
    T = urdf.pose(base, finger.group.first, values)
    return np.asarray(finger.triangles @ T[:3, :3].T + T[:3, 3])


def _best_pair(
    urdf: Urdf, base: str, drivers: Sequence[str], fingers: Sequence[_Finger]
) -> tuple[Array, Array, _Finger, _Finger]:
    """Values of the drivers where the gripper is closed and where it is open, and the two fingers whose middles come
    nearest to each other from the one to the other: of all ways to move the drivers together, the longest.
    """
    limits = np.array([urdf.limits(name) for name in drivers])
    best = (0.0, limits[:, 0], limits[:, 1], fingers[0], fingers[1])
    for sides in itertools.product((0, 1), repeat=len(drivers) - 1):
        closed = np.array([limits[k, side] for k, side in enumerate((0, *sides))])
        opened = limits.sum(axis=1) - closed
        for first, second in itertools.combinations(fingers, 2):
            apart = []
            for values in (closed, opened):
                at = dict(zip(drivers, values.tolist(), strict=True))
                middles = [_placed(urdf, base, f, at).reshape(-1, 3).mean(axis=0) for f in (first, second)]
                apart.append(float(np.linalg.norm(middles[0] - middles[1])))
            stroke = apart[1] - apart[0]
            if abs(stroke) > best[0] + 1e-9:
                ends = (closed, opened) if stroke > 0 else (opened, closed)
                best = (abs(stroke), *ends, first, second)
    if best[0] < LEAST_STROKE:
        raise InputError("no two of its fingers move towards each other: no gripper", urdf.where)
    return best[1:]


def _tool_axes(
    urdf: Urdf, base: str, drivers: Sequence[str], closed: Array, opened: Array, left: _Finger, right: _Finger
) -> Array:
    """Rotation (3, 3) of the tool frame in that of the base link: y from the left finger to the right one, as they move
    apart; z across it, from the base link to the fingers.
    """
    middles = []
    for values in (closed, opened):
        at = dict(zip(drivers, values.tolist(), strict=True))
        middles.append([_placed(urdf, base, f, at).reshape(-1, 3).mean(axis=0) for f in (left, right)])
    (left_0, right_0), (left_1, right_1) = middles
    y = _snapped((right_1 - right_0) - (left_1 - left_0))
    ahead = (left_1 + right_1) / 2
    z = ahead - (ahead @ y) * y
    if np.linalg.norm(z) < 1e-3:
        raise InputError("its fingers do not stand out from its base: the approach direction is not known", urdf.where)
    z = _snapped(z)
    z = z - (z @ y) * y
    z /= np.linalg.norm(z)
    return np.column_stack([np.cross(y, z), y, z])


def _snapped(direction: Array) -> Array:
    """The direction (3,) with norm 1; an axis of the frame if it is nearly one."""
    direction = direction / np.linalg.norm(direction)
    k = int(np.abs(direction).argmax())
    if abs(direction[k]) >= math.cos(SNAP):
        return np.asarray(np.eye(3)[k] * np.sign(direction[k]))
    return np.asarray(direction)


def _measured(
    urdf: Urdf,
    base: str,
    drivers: Sequence[str],
    closed: Array,
    opened: Array,
    left: _Finger,
    right: _Finger,
    R: Array,
    shares: Array,
) -> tuple[Array, Array]:
    """Distance between the pads (K,), m, and the tool's origin (K, 3) in the frame of the base link, at shares of the
    way from closed to open.
    """
    gaps, points = [], []
    for share in shares.tolist():
        values = closed + share * (opened - closed)
        at = dict(zip(drivers, values.tolist(), strict=True))
        pads = [_pad(_placed(urdf, base, finger, at) @ R, side) for finger, side in ((left, 1.0), (right, -1.0))]
        gaps.append(pads[1][1] - pads[0][1])
        points.append(R @ ((pads[0] + pads[1]) / 2))
    return np.array(gaps), np.array(points)


def _pad(triangles: Array, side: float) -> Array:
    """Point (3,) on a pad, tool axes: in the middle across, `FROM_TIP` before its end.

    Args:
        triangles: (F, 3, 3) of the finger, tool axes.
        side: 1 if the pad looks along y, -1 if against it.
    """
    inner = float((side * triangles[:, :, 1]).max())
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    facing = (np.abs(normals[:, 1]) >= FACING * areas) & (areas > 0)  # winding says nothing in many mesh files
    near = (side * triangles[:, :, 1] >= inner - FACE).all(axis=1)
    face = triangles[facing & near].reshape(-1, 3)
    if not len(face):
        face = triangles.reshape(-1, 3)
        face = face[side * face[:, 1] >= inner - FACE]
    low, high = face.min(axis=0), face.max(axis=0)
    z = high[2] - min(FROM_TIP, (high[2] - low[2]) / 2)
    return np.array([(low[0] + high[0]) / 2, side * inner, z])
