"""Rigid transforms and shapes.

A pose is a (4, 4) homogeneous matrix named ``T_a_b``: it maps coordinates in frame b to frame a. Quaternions are
(w, x, y, z). Lengths are metres. Nothing outside this module and the collision kernels may assume that a shape is a
box or that it is aligned with an axis: shapes are asked for their cover by oriented boxes, which is exact for boxes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Triangles = NDArray[np.int32]


def pose(position: ArrayLike = (0.0, 0.0, 0.0), quaternion: ArrayLike = (1.0, 0.0, 0.0, 0.0)) -> Array:
    """Pose (4, 4) from a position (3,), m, and a unit quaternion (w, x, y, z)."""
    T = np.eye(4)
    T[:3, :3] = rotation_from_quaternion(quaternion)
    T[:3, 3] = position
    return T


def pose_inverse(T: Array) -> Array:
    """Inverse of a pose (4, 4), or of a stack of poses (..., 4, 4)."""
    R_t = np.swapaxes(T[..., :3, :3], -1, -2)
    inverse = np.zeros_like(T)
    inverse[..., :3, :3] = R_t
    inverse[..., :3, 3] = -(R_t @ T[..., :3, 3, None])[..., 0]
    inverse[..., 3, 3] = 1.0
    return inverse


def rotation_from_quaternion(quaternion: ArrayLike) -> Array:
    """Rotation matrix (3, 3) of a quaternion (w, x, y, z), normalised first."""
    w, x, y, z = np.asarray(quaternion, dtype=float) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(R: ArrayLike) -> Array:
    """Unit quaternion (4,) (w, x, y, z), w >= 0, of a rotation matrix (3, 3).

    Shepperd's method: the largest of the four squared components is found first, so no division is ill-conditioned.
    """
    m = np.asarray(R, dtype=float)
    squares = np.array([np.trace(m), m[0, 0], m[1, 1], m[2, 2]])
    k = int(np.argmax(squares))
    if k == 0:
        q = np.array([1 + squares[0], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    elif k == 1:
        q = np.array([m[2, 1] - m[1, 2], 1 + 2 * m[0, 0] - squares[0], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]])
    elif k == 2:
        q = np.array([m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], 1 + 2 * m[1, 1] - squares[0], m[1, 2] + m[2, 1]])
    else:
        q = np.array([m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], 1 + 2 * m[2, 2] - squares[0]])
    q /= np.linalg.norm(q)
    return -q if q[0] < 0 else q


@dataclass(frozen=True, eq=False)
class OrientedBox:
    """A box: pose of its centre in some frame, and half its size along its own axes."""

    T_frame_box: Array  # (4, 4)
    half_extents: Array  # (3,) m

    def moved(self, T_other_frame: Array) -> OrientedBox:
        """The same box expressed in another frame."""
        return OrientedBox(T_other_frame @ self.T_frame_box, self.half_extents)

    def corners(self) -> Array:
        """The eight corners (8, 3), m, in the frame of the box's pose."""
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
        return (signs * self.half_extents) @ self.T_frame_box[:3, :3].T + self.T_frame_box[:3, 3]


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """A surface.

    Args:
        vertices: (V, 3) m.
        triangles: (T, 3) numbers of vertices, counter-clockwise as seen from outside.
    """

    vertices: Array
    triangles: Triangles

    def moved(self, T_other_frame: Array) -> TriangleMesh:
        """The same surface expressed in another frame."""
        return TriangleMesh(self.vertices @ T_other_frame[:3, :3].T + T_other_frame[:3, 3], self.triangles)

    @cached_property
    def corners(self) -> Array:
        """(T, 3, 3) m: the three corners of every triangle."""
        return np.asarray(self.vertices[self.triangles])

    @cached_property
    def bounds(self) -> Array:
        """(2, 3) m: least and greatest coordinates."""
        return np.array([self.vertices.min(axis=0), self.vertices.max(axis=0)])


def area_normals(corners: Array) -> Array:
    """(T, 3) m^2: of triangles (T, 3, 3), m, the outward normals, twice the area long."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


BOX_TRIANGLES = np.array(  # of the corners of `OrientedBox.corners`
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ],
    dtype=np.int32,
)  # fmt: skip


@runtime_checkable
class Shape(Protocol):
    """What the rest of the package may ask of a part's geometry; all answers are in the part's frame."""

    def boxes(self) -> tuple[OrientedBox, ...]:
        """Oriented boxes whose union contains the shape; exact where the shape is a box."""
        ...

    def bounding_box(self) -> OrientedBox:
        """One oriented box that contains the shape."""
        ...

    def surface(self) -> TriangleMesh:
        """Its surface, exact."""
        ...

    def volume(self) -> float:
        """Volume, m^3."""
        ...

    def center_of_mass(self) -> Array:
        """(3,) m, of a body of even density."""
        ...


@dataclass(frozen=True)
class Box:
    """A box centred at the origin of its part's frame.

    Args:
        size: full edge lengths along x, y, z, m.
    """

    size: tuple[float, float, float]

    def boxes(self) -> tuple[OrientedBox, ...]:
        return (self.bounding_box(),)

    def bounding_box(self) -> OrientedBox:
        return OrientedBox(np.eye(4), np.array(self.size) / 2)

    def surface(self) -> TriangleMesh:
        return TriangleMesh(self.bounding_box().corners(), BOX_TRIANGLES)

    def volume(self) -> float:
        return float(np.prod(self.size))

    def center_of_mass(self) -> Array:
        return np.zeros(3)


def box_separation(T_a: Array, half_a: Array, T_b: Array, half_b: Array) -> Array:
    """Signed separation of pairs of oriented boxes by the separating axis test.

    Positive: a lower bound of the distance between the boxes. Negative: minus the least translation that parts them
    (exact for boxes). Gottschalk, Lin, Manocha: OBBTree, SIGGRAPH 1996.

    Args:
        T_a, T_b: (N, 4, 4) poses of the box centres in one common frame.
        half_a, half_b: (N, 3) half sizes, m.

    Returns:
        (N,) separation, m.
    """
    R_a, R_b = T_a[:, :3, :3], T_b[:, :3, :3]
    axes_a, axes_b = np.swapaxes(R_a, 1, 2), np.swapaxes(R_b, 1, 2)  # (N, 3, 3), rows are axes
    crosses = np.cross(axes_a[:, :, None, :], axes_b[:, None, :, :]).reshape(-1, 9, 3)
    norms = np.linalg.norm(crosses, axis=2, keepdims=True)
    parallel = norms < 1e-6  # a cross product of parallel edges adds no axis: reuse a face normal
    crosses = np.where(parallel, axes_a[:, :1, :], crosses / np.where(parallel, 1.0, norms))
    axes = np.concatenate([axes_a, axes_b, crosses], axis=1)  # (N, 15, 3)
    gap = np.abs(np.einsum("nij,nj->ni", axes, T_b[:, :3, 3] - T_a[:, :3, 3]))
    reach_a = np.einsum("nik,nk->ni", np.abs(axes @ R_a), half_a)
    reach_b = np.einsum("nik,nk->ni", np.abs(axes @ R_b), half_b)
    return np.asarray((gap - reach_a - reach_b).max(axis=1))
