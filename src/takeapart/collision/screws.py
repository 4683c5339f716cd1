"""How far a part moves along a screw until it meets another: a straight line, a turn, or both about one axis."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from takeapart.collision.fields import Field, signed_distance
from takeapart.collision.sweep import LEAST_STEP
from takeapart.compilation import compiled
from takeapart.model.geometry import Array


@dataclass(frozen=True, eq=False)
class Screw:
    """A motion of one parameter s.

    Args:
        along: (3,) m of travel for s = 1; along the axis if there is a turn.
        turn: rad for s = 1.
        axis: (3,) unit vector about which it turns.
        center: (3,) m, a point of the axis.
    """

    along: Array
    turn: float
    axis: Array
    center: Array

    def pose(self, s: float) -> Array:
        """(4, 4) displacement after s."""
        T = np.eye(4)
        x, y, z = self.axis
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        T[:3, :3] += math.sin(self.turn * s) * cross + (1 - math.cos(self.turn * s)) * (cross @ cross)
        T[:3, 3] = self.center - T[:3, :3] @ self.center + s * self.along
        return T

    def seen_from(self, T_other_frame: Array) -> Screw:
        """The same motion expressed in another frame."""
        R = T_other_frame[:3, :3]
        return Screw(R @ self.along, self.turn, R @ self.axis, R @ self.center + T_other_frame[:3, 3])

    def backwards(self) -> Screw:
        """The inverse motion: how the rest moves as seen from what moves."""
        return Screw(-self.along, -self.turn, self.axis, self.center)

    def travel(self, field: Field, points: Array, length: float, kept: float) -> float:
        """The least s at which one of points (N, 3) of the field's frame is nearer to the surface than `kept`, m, and
        goes further in; `length` if none does.

        A point steps as far as it is away, at least 0.2 mm, so between two looks an overlap exceeds what is tolerated
        by no more than half of that.
        """
        arrays = ScrewArrays(
            np.ascontiguousarray(self.along, float), self.turn, np.ascontiguousarray(self.axis, float),
            np.ascontiguousarray(self.center, float),
        )  # fmt: skip
        return float(_travel(field, points, arrays, length, kept))


class ScrewArrays(NamedTuple):
    """As `Screw`, for kernels."""

    along: Array  # (3,)
    turn: float
    axis: Array  # (3,)
    center: Array  # (3,)


@compiled
def _travel(field: Field, points: Array, screw: ScrewArrays, length: float, kept: float) -> float:
    nearest = length
    kx, ky, kz = screw.axis[0], screw.axis[1], screw.axis[2]
    straight2 = screw.along[0] ** 2 + screw.along[1] ** 2 + screw.along[2] ** 2
    for i in range(len(points)):
        x, y, z = points[i, 0] - screw.center[0], points[i, 1] - screw.center[1], points[i, 2] - screw.center[2]
        on = kx * x + ky * y + kz * z
        ax, ay, az = on * kx, on * ky, on * kz  # along the axis, and across it, where it turns
        rx, ry, rz = x - ax, y - ay, z - az
        qx, qy, qz = ky * rz - kz * ry, kz * rx - kx * rz, kx * ry - ky * rx
        speed = math.sqrt(straight2 + screw.turn * screw.turn * (rx * rx + ry * ry + rz * rz))
        if speed < 1e-12:
            continue
        s = 0.0
        while s < nearest:
            c, n = math.cos(screw.turn * s), math.sin(screw.turn * s)
            away = signed_distance(
                field,
                screw.center[0] + ax + c * rx + n * qx + s * screw.along[0],
                screw.center[1] + ay + c * ry + n * qy + s * screw.along[1],
                screw.center[2] + az + c * rz + n * qz + s * screw.along[2],
            )
            if away < kept:
                nearest = s
                break
            s += max(away - kept, LEAST_STEP) / speed
    return nearest
