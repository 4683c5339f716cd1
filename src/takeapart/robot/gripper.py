"""What of a gripper moves with its opening, as boxes: pads, which touch the part, and knuckles, which must not.

A mesh is replaced by boxes that contain its convex hull: by one where that wastes little, else by one for each of some
slices. They are found once per file and kept.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from takeapart.model.description import GripperDescription, RobotDescription
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, OrientedBox
from takeapart.robot.kept import keep, kept
from takeapart.robot.urdf import Geometry, Urdf, convex_corners, read_urdf
from takeapart.robot.urdf.meshes import hull_of

LARGEST_WASTE = 0.004  # m that a corner of a box may stand away from the hull that it contains
MOST_SLICES = 3  # of what touches the part; of other links one less

Boxes = tuple[tuple[Array, Array], ...]  # pose (4, 4) in the link, half edges (3,), m


def gripper_boxes(
    description: RobotDescription | GripperDescription, opening: float
) -> tuple[list[OrientedBox], list[OrientedBox]]:
    """What moves of the gripper, in the frame of its base link at an opening between the pads, m: pads, then knuckles.

    Raises:
        InputError: a finger has no collision geometry, or a mesh is missing or cannot be read.
    """
    gripper = description.gripper if isinstance(description, RobotDescription) else description
    urdf = read_urdf(gripper.files)
    poses = urdf.poses(gripper.base_link, gripper.joint_positions(opening))
    pads, knuckles = _moving_boxes(gripper)
    return _placed(pads, poses), _placed(knuckles, poses)


def box_links(description: RobotDescription | GripperDescription) -> tuple[str, ...]:
    """Link that each box of `gripper_boxes` belongs to, pads first."""
    gripper = description.gripper if isinstance(description, RobotDescription) else description
    return tuple(link for boxes in _moving_boxes(gripper) for link, found in boxes.items() for _ in found)


def _placed(boxes: Mapping[str, Boxes], poses: Mapping[str, Array]) -> list[OrientedBox]:
    return [OrientedBox(poses[link] @ T, half) for link, found in boxes.items() for T, half in found]


@lru_cache(maxsize=16)
def _moving_boxes(gripper: GripperDescription) -> tuple[dict[str, Boxes], dict[str, Boxes]]:
    """Boxes of the links with pads, and of all others that move, by link, in the link's frame."""
    urdf = read_urdf(gripper.files)
    links = urdf.subtree(gripper.base_link)
    where = f"{gripper.name}: {urdf.where}"
    for finger in gripper.finger_links:
        if finger not in links:
            raise InputError(f"finger {finger!r} does not hang on {gripper.base_link!r}", where)
    if not any(urdf.links[finger].collisions for finger in gripper.finger_links):
        raise InputError(f"no finger ({', '.join(gripper.finger_links)}) has collision geometry", where)
    fixed = urdf.fixed_on(gripper.base_link)
    others = [link for link in links if link not in fixed and link not in gripper.finger_links]
    pads = {link: _link_boxes(urdf, link, MOST_SLICES) for link in gripper.finger_links}
    return pads, {link: _link_boxes(urdf, link, MOST_SLICES - 1) for link in others}


def _link_boxes(urdf: Urdf, link: str, most: int) -> Boxes:
    return tuple(box for shape in urdf.links[link].collisions for box in _shape_boxes(urdf, shape, most))


def _shape_boxes(urdf: Urdf, shape: Geometry, most: int) -> Boxes:
    if shape.kind == "box":
        return ((shape.T_link, np.array(shape.size) / 2),)
    corners = convex_corners(urdf, Geometry(shape.kind, np.eye(4), shape.size, shape.uri))
    return tuple((shape.T_link @ T, half) for T, half in _hull_boxes(corners.tobytes(), most))


@lru_cache(maxsize=256)
def _hull_boxes(corners: bytes, most: int) -> Boxes:
    """Boxes around the convex hull of points (V, 3), m; kept in the cache folder."""
    name = f"boxes-1-{hashlib.sha256(corners).hexdigest()[:24]}-{most}"
    rows = kept(name)
    if rows is None or rows.ndim != 2 or rows.shape[1] != 15 or not len(rows) or not np.isfinite(rows).all():
        found = boxes_around(np.frombuffer(corners).reshape(-1, 3), most)
        rows = np.array([[*T[:3].ravel(), *half] for T, half in found])
        keep(name, rows)
    return tuple((np.vstack([row[:12].reshape(3, 4), [0, 0, 0, 1]]), row[12:].copy()) for row in rows)


def boxes_around(corners: Array, most: int = MOST_SLICES) -> Boxes:
    """Boxes that together contain the convex hull of points (V, 3), m: the fewest slices across its longest extent of
    which no box stands more than `LARGEST_WASTE` away from its slice, at most `most`.
    """
    found: Boxes = ()
    for count in range(1, most + 1):
        slices = _slices(corners, count)
        found = tuple(_smallest_box(points) for points in slices)
        if max(_waste(points, *box) for points, box in zip(slices, found, strict=True)) <= LARGEST_WASTE:
            break
    return found


def _slices(corners: Array, count: int) -> list[Array]:
    """Corners of the slices of a convex hull across its longest extent, all equally thick."""
    if count == 1:
        return [corners]
    T, half = _smallest_box(corners)
    axis = T[:3, int(half.argmax())]
    heights = (corners - T[:3, 3]) @ axis
    levels = np.linspace(heights.min(), heights.max(), count + 1)
    vertices, faces, _ = hull_of(corners, "slices")
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
    a, b = vertices[edges[:, 0]], vertices[edges[:, 1]]
    h_a, h_b = (a - T[:3, 3]) @ axis, (b - T[:3, 3]) @ axis
    cuts = []
    for level in levels[1:-1]:
        crossing = (h_a - level) * (h_b - level) < 0
        share = ((level - h_a[crossing]) / (h_b[crossing] - h_a[crossing]))[:, None]
        cuts.append(a[crossing] + share * (b[crossing] - a[crossing]))
    found = []
    for k in range(count):
        inside = corners[(heights >= levels[k] - 1e-12) & (heights <= levels[k + 1] + 1e-12)]
        found.append(np.concatenate([inside, *(cuts[j] for j in (k - 1, k) if 0 <= j < count - 1)]))
    return found


def _smallest_box(points: Array) -> tuple[Array, Array]:
    """Pose (4, 4) and half edges (3,), m, of an oriented box around points."""
    import trimesh

    T_box_points, extents = trimesh.bounds.oriented_bounds(points)
    return np.linalg.inv(T_box_points), np.asarray(extents, dtype=float) / 2 + 1e-9


def _waste(points: Array, T: Array, half: Array) -> float:
    """Distance, m, of the box's corners from the hull of the points, at least."""
    vertices, faces, normals = hull_of(points, "waste")
    offsets = np.einsum("ij,ij->i", normals, vertices[faces[:, 0]])
    return float((OrientedBox(T, half).corners() @ normals.T - offsets).max(axis=1).max())
