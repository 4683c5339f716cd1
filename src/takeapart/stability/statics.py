"""Static equilibrium of parts that press on each other: linear programs over the forces at points of contact.

At every point the second body presses on the first along the normal, and rubs across it within the friction cone, here
eight edges inside of it; joints pull at their points up to a strength. The parts stand if some such forces balance
every weight. Bretl, Lall: Testing static equilibrium for legged robots, IEEE T-RO 2008; Whiting et al.: Procedural
modeling of structurally-sound masonry buildings, SIGGRAPH Asia 2009 (what is missing as a measure).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Array
from takeapart.stability.patches import ContactPatch
from takeapart.stability.wedging import rubbing

if TYPE_CHECKING:
    from scipy.sparse import csc_array

GRAVITY = 9.81  # m/s^2
SIDES = 8  # of a friction cone
OFF_CENTRE = 0.03  # of the longest edge of a part: how far its centre of mass may lie elsewhere than drawn
LEAST_OFF_CENTRE, MOST_OFF_CENTRE = 5e-4, 2e-3  # m
UNCARRIED = 1e-4  # share of a weight; less than this is rounding


@dataclass(frozen=True, eq=False)
class Balance:
    """The forces nearest to equilibrium.

    Args:
        missing: (N,) share of each part's weight that nothing carries.
        tension: N, by number of the joint: the greatest at any of its points.
    """

    missing: Array
    tension: dict[int, float]

    @property
    def holds(self) -> bool:
        """Whether everything is carried."""
        return not len(self.missing) or bool(self.missing.max() <= UNCARRIED)


@dataclass(frozen=True, eq=False)
class _Forces:
    """Forces that may act at points (K, 3), m, along directions (K, 3) on the first part of a pair, and back on the
    second, up to a limit, N.

    Args:
        smooth, rough: whether they count where nothing rubs, and where it does.
        joint: number of the joint that pulls; -1 for none.
    """

    pair: tuple[int, int]
    points: Array
    directions: Array
    limit: float
    smooth: bool
    rough: bool
    joint: int = -1


class Statics:
    """Equilibrium of any set of parts of one product; what does not depend on the set is worked out once.

    Args:
        patches: where parts touch.
        friction: coefficient at all contacts.
        side_force: share of a joint's strength with which each of its points also resists sideways.
        strength: if given, N: that of every joint, instead of its own.
    """

    def __init__(
        self,
        assembly: Assembly,
        patches: Sequence[ContactPatch],
        friction: float,
        side_force: float = 0.0,
        strength: float | None = None,
    ) -> None:
        parts = assembly.parts
        self.weights = np.array([part.mass * GRAVITY for part in parts])
        self.middles = np.array(
            [part.T_world_part[:3, :3] @ part.shape.center_of_mass() + part.T_world_part[:3, 3] for part in parts]
        )
        longest = np.array([2 * part.shape.bounding_box().half_extents.max() for part in parts])
        self.off_centre = np.clip(OFF_CENTRE * longest, LEAST_OFF_CENTRE, MOST_OFF_CENTRE)  # m
        columns: list[_Forces] = []
        for patch, rubs in zip(patches, rubbing(assembly, patches), strict=True):
            pair = patch.first, patch.second
            columns.append(_Forces(pair, patch.points, patch.normals, np.inf, smooth=True, rough=not rubs))
            if rubs:
                edges = _cones(patch.normals, friction).reshape(-1, 3)
                points = np.repeat(patch.points, SIDES, axis=0)
                columns.append(_Forces(pair, points, edges, np.inf, smooth=False, rough=True))
        for number, joint in enumerate(assembly.joints):
            pair = assembly.index[joint.first], assembly.index[joint.second]
            limit = joint.strength if strength is None else strength
            axes = np.tile(joint.axis, (len(joint.points), 1))  # the first is pulled towards the second
            columns.append(_Forces(pair, joint.points, axes, limit, smooth=True, rough=True, joint=number))
            if side_force:
                across = np.linalg.svd(joint.axis[None])[2][1:]
                sides = np.tile(np.concatenate([across, -across]), (len(joint.points), 1))
                points = np.repeat(joint.points, 4, axis=0)
                columns.append(_Forces(pair, points, sides, side_force * limit, smooth=True, rough=True))
        sizes = [len(column.points) for column in columns]
        self.first = np.repeat(np.array([column.pair[0] for column in columns], dtype=np.int64), sizes)
        self.second = np.repeat(np.array([column.pair[1] for column in columns], dtype=np.int64), sizes)
        self.joint = np.repeat(np.array([column.joint for column in columns], dtype=np.int64), sizes)
        self.limits = np.repeat(np.array([column.limit for column in columns]), sizes)
        self.smooth = np.repeat(np.array([column.smooth for column in columns], dtype=bool), sizes)
        self.rough = np.repeat(np.array([column.rough for column in columns], dtype=bool), sizes)
        points = np.concatenate([np.empty((0, 3)), *(column.points for column in columns)])
        forces = np.concatenate([np.empty((0, 3)), *(column.directions for column in columns)])
        self.size = max(float(np.ptp(points, axis=0).max()), 1e-3) if len(points) else 1.0  # moments are divided by it
        values, rows = [], []
        for body, sign in ((self.first, 1.0), (self.second, -1.0)):
            moments = np.cross(points - self.middles[body], forces) / self.size
            values.append(sign * np.hstack([forces, moments]))
            rows.append(6 * body[:, None] + np.arange(6))
        from scipy.sparse import csc_array  # heavy; most products need no statics

        entries = (np.hstack(values).ravel(), (np.hstack(rows).ravel(), np.repeat(np.arange(len(points)), 12)))
        self.matrix = csc_array(entries, shape=(6 * len(parts), len(points)))

    def _columns_of(self, loose: Sequence[int], standing: NDArray[np.bool_], smooth: bool) -> NDArray[np.int64]:
        """Numbers of the forces that act on any of the loose parts, from these or from what stands anyhow."""
        there = standing.copy()
        there[list(loose)] = True
        moving = np.zeros(len(there), dtype=bool)
        moving[list(loose)] = True
        first, second = self.first, self.second
        acting = there[first] & there[second] & (moving[first] | moving[second])
        return np.nonzero(acting & (self.smooth if smooth else self.rough))[0]

    def balance(
        self,
        loose: Sequence[int],
        standing: NDArray[np.bool_],
        shift: Array,
        stronger: float = 1.0,
        smooth: bool = False,
    ) -> Balance:
        """The least share of weights that nothing carries.

        Args:
            loose: numbers of the parts that must be carried.
            standing: (parts,) which others stand anyhow: fixed, or held.
            shift: (3,) by how much of what is allowed for the centres of mass lie elsewhere.
            stronger: joints are this many times as strong as they are.
            smooth: without friction, which is quicker: what stands so stands with it.
        """
        from scipy.sparse import csc_array, hstack

        chosen = self._columns_of(loose, standing, smooth)
        rows = (6 * np.asarray(loose)[:, None] + np.arange(6)).ravel()
        weights = self.weights[list(loose)]
        unit = float(weights.mean())
        forces = self.matrix[:, chosen][rows]
        N = len(loose)
        down = np.array([0.0, 0.0, -1.0])
        moments = self.off_centre[list(loose), None] * np.cross(shift, down) / self.size
        load = weights[:, None] / unit * np.hstack([np.tile(down, (N, 1)), moments])  # (N, 6)
        lift = csc_array((-load.ravel(), (np.arange(6 * N), np.repeat(np.arange(N), 6))), shape=(6 * N, N))
        limits = self.limits[chosen] * stronger / unit
        upper = np.concatenate([limits, np.ones(N)])
        cost = np.concatenate([np.zeros(len(chosen)), np.ones(N)])
        solution = _minimum(cost, hstack([forces, lift], format="csc"), -load.ravel(), upper)
        if solution is None:
            return Balance(np.ones(N), {})  # nothing was shown
        tension: dict[int, float] = {}
        for k in np.nonzero(self.joint[chosen] >= 0)[0]:
            joint = int(self.joint[chosen[k]])
            tension[joint] = max(tension.get(joint, 0.0), float(solution[k]) * unit)
        return Balance(np.clip(solution[len(chosen) :], 0.0, 1.0), tension)


def _minimum(cost: Array, balance: csc_array, wanted: Array, upper: Array) -> Array | None:
    """Least cost over forces from 0 to `upper`, (N,), that balance what is wanted; None where the solver gives up.

    HiGHS, without presolve, is twice as fast on these programs, and this way to it costs less than `linprog`.
    """
    from scipy.optimize import Bounds, LinearConstraint, milp  # heavy; most products need no statics

    bounds, equal = Bounds(np.zeros(len(upper)), upper), LinearConstraint(balance, wanted, wanted)
    for presolve in (False, True):
        found = milp(cost, constraints=equal, bounds=bounds, options={"presolve": presolve})
        if found.status == 0:
            return np.asarray(found.x)
    return None


def _cones(normals: Array, friction: float) -> Array:
    """Edges (K, S, 3) of friction cones inside the round one, about unit normals (K, 3)."""
    helper = np.where(np.abs(normals[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    u = np.cross(normals, helper)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(normals, u)
    angles = np.arange(SIDES) * (2 * np.pi / SIDES)
    across = np.cos(angles)[:, None] * u[:, None] + np.sin(angles)[:, None] * v[:, None]
    return np.asarray(normals[:, None] + friction * across)
