"""What a way out would hit, against bodies moved in fine steps: FCL tells distances, manifold3d what is common."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import fcl
import numpy as np
import pytest
from manifold3d import Manifold, Mesh64
from scipy.spatial.transform import Rotation

from takeapart.collision.contact import Contacts
from takeapart.collision.fields import FIELD_ERROR
from takeapart.model.assembly import Assembly, Part
from takeapart.model.geometry import Array, Box, Shape, TriangleMesh
from takeapart.model.meshes import Mesh
from takeapart.removal.exits import Exit, Exits

CLEARANCE = 0.001  # m
STEP = 2.5e-4  # m, between looked at places
MOVABLE = 5


def block(low: tuple[float, float, float], high: tuple[float, float, float]) -> Manifold:
    return Manifold.cube(np.subtract(high, low)).translate(low)


@cache
def shapes() -> tuple[Shape, ...]:
    """An angle, a pin with a head, a ring and a wedge, of 16 to 30 mm."""
    angle = block((-12, -8, -12), (12, 8, -4)) + block((-12, -8, -12), (-4, 8, 12))
    pin = Manifold.cylinder(24, 4, 4, 24, True) + Manifold.cylinder(6, 8, 8, 24, True).translate((0, 0, 12))
    ring = Manifold.cylinder(8, 13, 13, 32, True) - Manifold.cylinder(20, 6, 6, 32, True)
    wedge = Manifold.hull_points(np.array([(-10, -8, -8), (10, -8, -8), (-10, 8, -8), (10, 8, -8), (-10, -8, 8)]))
    return tuple(Mesh(_surface(solid)) for solid in (angle, pin, ring, wedge))


def _surface(solid: Manifold) -> TriangleMesh:
    mesh = solid.to_mesh64()
    return TriangleMesh(np.asarray(mesh.vert_properties)[:, :3] * 1e-3, np.asarray(mesh.tri_verts, dtype=np.int32))


class Exact:
    """A part for the oracle."""

    def __init__(self, part: Part) -> None:
        surface = part.shape.surface()
        self.T = part.T_world_part
        self.tree = fcl.BVHModel()
        self.tree.beginModel(len(surface.vertices), len(surface.triangles))
        self.tree.addSubModel(surface.vertices, np.asarray(surface.triangles, dtype=np.int64))
        self.tree.endModel()
        self.solid = Manifold(Mesh64(surface.vertices * 1e3, np.asarray(surface.triangles, dtype=np.uint64)))

    def placed(self, shift: Array) -> fcl.CollisionObject:
        return fcl.CollisionObject(self.tree, fcl.Transform(self.T[:3, :3], self.T[:3, 3] + shift))

    def distance(self, other: Exact, shift: Array) -> float:
        """Of surfaces, m; 0 where they cross."""
        still = other.placed(np.zeros(3))
        return max(0.0, float(fcl.distance(self.placed(shift), still, fcl.DistanceRequest(), fcl.DistanceResult())))

    def depth(self, other: Exact, shift: Array) -> float:
        """Thickness of what is common after a shift, 2 V / A, m."""
        moved = np.column_stack([self.T[:3, :3], 1e3 * (self.T[:3, 3] + shift)])
        still = np.column_stack([other.T[:3, :3], 1e3 * other.T[:3, 3]])
        common = self.solid.transform(moved) ^ other.solid.transform(still)
        return 2e-3 * common.volume() / common.surface_area() if common.volume() > 1e-9 else 0.0


def product(seed: int) -> Assembly:
    """Five bodies at random over a plate, none in another; every other one is pushed until it touches."""
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[2, 3] = -0.01
    parts = [Part("plate", Box((0.09, 0.09, 0.02)), T, 1.0, fixed=True)]
    while len(parts) <= MOVABLE:
        T = np.eye(4)
        T[:3, :3] = Rotation.random(random_state=int(rng.integers(1 << 31))).as_matrix()
        T[:3, 3] = rng.uniform((-0.03, -0.03, 0.012), (0.03, 0.03, 0.05))
        drawn = Part(f"body{len(parts)}", shapes()[int(rng.integers(4))], T, 0.1)
        around = [Exact(part) for part in parts]
        gaps = [Exact(drawn).distance(other, np.zeros(3)) for other in around]
        if min(gaps) < 1e-4 or any(Exact(drawn).depth(other, np.zeros(3)) for other in around):
            continue
        if len(parts) % 2:  # falls until it nearly touches
            while min(Exact(drawn).distance(other, np.zeros(3)) for other in around) > 2e-5 and T[2, 3] > 0:
                T[2, 3] -= min(Exact(drawn).distance(other, np.zeros(3)) for other in around)
                drawn = Part(drawn.name, drawn.shape, T, 0.1)
        parts.append(drawn)
    return Assembly(f"random{seed}", tuple(parts))


def met(bodies: list[Exact], part: int, other: int, way: Exit) -> tuple[float, float]:
    """Deepest overlap and least distance of two parts along a straight way, m."""
    (first, last), deepest, nearest = way.poses[:, :3, 3], 0.0, np.inf
    count = int(np.ceil(np.linalg.norm(last - first) / STEP))
    for k in range(count + 1):
        shift = (last - first) * k / count
        nearest = min(nearest, apart := bodies[part].distance(bodies[other], shift))
        if apart == 0.0:
            deepest = max(deepest, bodies[part].depth(bodies[other], shift))
    return deepest, nearest


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 8))])
def test_blockers_are_what_a_part_meets(seed: int) -> None:
    assembly = product(seed)
    contacts, bodies = Contacts(assembly), [Exact(part) for part in assembly.parts]
    exits = Exits(assembly, contacts, (), CLEARANCE)
    missed, invented, looked = [], [], 0
    for part in range(1, len(assembly.parts)):
        for way in exits.exits(part):
            if way.kind != "straight":
                continue
            hits = {number for number, _ in way.hits}  # the number of parts stands for what is fixed
            assert way.blockers is None if len(assembly.parts) in hits else way.blockers == sum(1 << k for k in hits)
            for other in range(len(assembly.parts)):
                if other == part:
                    continue
                looked += 1
                told = (len(assembly.parts) if assembly.parts[other].fixed else other) in hits
                deepest, nearest = met(bodies, part, other, way)
                error = FIELD_ERROR * max(contacts.body(part).field.step, contacts.body(other).field.step)
                if not told and deepest > contacts.tolerance(part, other):
                    missed.append((part, other, deepest))
                if told and nearest > CLEARANCE + error + STEP:
                    invented.append((part, other, nearest))
    assert looked > 20
    assert not missed, "it would be hit, and is no blocker"
    assert not invented, "it is never near, and is a blocker"


def test_the_oracle_sees_what_is_known() -> None:
    T = np.eye(4)
    T[0, 3] = 0.03
    bodies = [
        Exact(Part("a", Box((0.02, 0.02, 0.02)), np.eye(4), 1.0)),
        Exact(Part("b", Box((0.02, 0.02, 0.02)), T, 1.0)),
    ]
    poses = np.repeat(np.eye(4)[None], 2, axis=0)
    poses[1, 0, 3] = 0.012
    deepest, nearest = met(bodies, 0, 1, Exit("straight", poses, 2, np.array([1.0, 0.0, 0.0])))
    assert nearest == 0.0
    assert deepest == pytest.approx(2 * (0.02**2 * 0.002) / (2 * 0.02**2 + 4 * 0.02 * 0.002), rel=1e-3)
    assert len(list(pairwise(poses))) == 1
