"""Replay of a step against exact triangles: the held part and the robot against parts that are meshes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from takeapart.model.assembly import Assembly
from takeapart.model.geometry import Array, Box, OrientedBox, TriangleMesh, pose
from takeapart.model.plan import PlanStep
from takeapart.verification.checks import grasp_pose
from takeapart.verification.model import Scene, part_in_tool
from takeapart.verification.report import Clearance, Finding, VerificationOptions
from takeapart.verification.robot import mujoco
from takeapart.verification.solids import Solid, hull_solid, separation, shared_volume
from takeapart.workcell import Workcell

OVERLAP_LIMIT = 5e-4  # m; deeper, a pair must be one of `Assembly.allowed_overlaps`
PAD_REACH = 5e-4  # m; pads are this close to a mesh, and no deeper in it
PAD_AREA = 1e-5  # m^2; least area of a pad that faces a mesh within its reach


@dataclass(frozen=True, eq=False)
class Motion:
    """A body along the samples of a step."""

    name: str
    solid: Solid
    poses: Array  # (S, 4, 4) T_world_body


class MeshReplay:
    """What the replay of boxes leaves out: every pair with the surface of a mesh."""

    def __init__(self, assembly: Assembly, workcell: Workcell, options: VerificationOptions, scene: Scene) -> None:
        self.assembly, self.workcell, self.options, self.scene = assembly, workcell, options, scene
        self.clearance = options.demanded_clearance(workcell)
        shared: dict[int, Solid] = {}
        self.solids: list[list[Solid]] = []
        for part in assembly.parts:
            is_mesh = not isinstance(part.shape, Box)
            shape = shared.setdefault(id(part.shape), Solid(part.shape.surface(), is_mesh))
            walls = [w for c in assembly.connectors if c.host == part.name for w in c.walls]
            self.solids.append([shape, *(_box_solid(wall) for wall in walls)])
        self.obstacles = [(f"environment/{o.name}", _box_solid(o.box)) for o in workcell.environment]
        self.allowed = {frozenset(pair) for pair in assembly.allowed_overlaps}
        self._starts: dict[tuple[int, int, str, int], float] = {}
        self._links = self._robot()
        self.deepest: dict[tuple[str, str], float] = {}  # m, of part against part, over all steps

    @property
    def open_parts(self) -> tuple[str, ...]:
        """Names of the parts whose surface is not closed: judged by where surfaces cross."""
        parts = zip(self.assembly.parts, self.solids, strict=True)
        return tuple(part.name for part, solids in parts if solids[0].is_mesh and solids[0].manifold is None)

    def drawn(self) -> list[Finding]:
        """Parts that overlap as drawn by more than the limit, unless they are meant to."""
        findings, parts = [], self.assembly.parts
        for i, part in enumerate(parts):
            for j in range(i):
                if not (self.solids[i][0].is_mesh or self.solids[j][0].is_mesh):
                    continue
                depth = -self._start(i, 0, f"part/{parts[j].name}", 0, self.solids[j][0], parts[j].T_world_part)
                if depth > OVERLAP_LIMIT and frozenset((part.name, parts[j].name)) not in self.allowed:
                    message = f"part/{parts[j].name} overlaps part/{part.name} as drawn"
                    findings.append(Finding(None, "", None, "collision", message, depth))
        return findings

    def _start(self, i: int, own: int, name: str, k: int, solid: Solid, T: Array) -> float:
        """Separation, m, of a solid of part i from another one in the finished assembly; infinite where both are far
        apart."""
        key = (i, own, name, k)
        if key not in self._starts:
            mine, T_mine = self.solids[i][own], self.assembly.parts[i].T_world_part
            near = _bounds_gap(mine, T_mine[None], solid, T)[0] < self.options.sight
            self._starts[key] = separation(mine, T_mine, solid, T) if near else math.inf
        return self._starts[key]

    def _robot(self) -> list[tuple[int, Solid]]:
        """Every geom of the robot with its convex hull."""
        scene, model = self.scene, self.scene.model
        found = []
        for geom in range(model.ngeom):
            name = scene.label(geom)
            if name.startswith(("part/", "held/", "environment/")) or not model.geom_contype[geom]:
                continue
            found.append((geom, hull_solid(_points(model, geom))))
        return found

    def check(
        self, step: PlanStep, k: int, number: int, state: int, configurations: Array, times: Array
    ) -> tuple[list[Finding], Clearance | None]:
        """Nothing touches a mesh that may not, along the samples of a step: configurations (S, n) at rows (S,)."""
        scene, parts = self.scene, self.assembly.parts
        T_tool_part = part_in_tool(grasp_pose(step.grasp), parts[number].T_world_part)
        held, robot = self._poses(configurations, T_tool_part)
        present = [i for i, p in enumerate(parts) if p.fixed or (state >> i & 1 and i != number)]
        standing = [
            (f"part/{parts[i].name}", n, solid, parts[i].T_world_part)
            for i in present
            for n, solid in enumerate(self.solids[i])
        ]
        around = [(name, 0, solid, np.eye(4)) for name, solid in self.obstacles]
        findings: dict[tuple[str, str], Finding] = {}
        nearest: Clearance | None = None
        for own, solid in enumerate(self.solids[number]):
            motion = Motion(f"held/{step.part}", solid, held)
            for name, n, other, T in [*standing, *around]:
                if solid.is_mesh or other.is_mesh:
                    start = self._start(number, own, name, n, other, T)
                    nearest = self._follow(motion, name, other, T, start, step, k, times, findings, nearest)
        for g, (geom, solid) in enumerate(self._links):
            motion = Motion(scene.label(geom), solid, robot[:, g])
            for name, _, other, T in standing:
                if other.is_mesh:
                    nearest = self._follow(motion, name, other, T, math.inf, step, k, times, findings, nearest)
        return [*self._fingers(step, k, number, held[0], robot[0]), *findings.values()], nearest

    def _poses(self, configurations: Array, T_tool_part: Array) -> tuple[Array, Array]:
        """(S, 4, 4) of the held part and (S, G, 4, 4) of the robot's geoms, in the world."""
        scene, geoms = self.scene, [geom for geom, _ in self._links]
        held = np.tile(np.eye(4), (len(configurations), 1, 1))
        robot = np.tile(np.eye(4), (len(configurations), len(geoms), 1, 1))
        for s, configuration in enumerate(configurations):
            scene.place(configuration)
            held[s, :3, 3], held[s, :3, :3] = scene.tool()
            robot[s, :, :3, :3] = scene.data.geom_xmat[geoms].reshape(-1, 3, 3)
            robot[s, :, :3, 3] = scene.data.geom_xpos[geoms]
        return held @ T_tool_part, robot

    def _follow(
        self,
        motion: Motion,
        name: str,
        other: Solid,
        T: Array,
        start: float,
        step: PlanStep,
        k: int,
        times: Array,
        findings: dict[tuple[str, str], Finding],
        nearest: Clearance | None,
    ) -> Clearance | None:
        """One pair along the samples. No sample is looked at in which the bodies cannot have come close enough."""
        pair = frozenset((motion.name.removeprefix("held/"), name.removeprefix("part/")))
        contact = start < self.clearance  # until it was further away than that
        deepest_allowed = max(-start, 0.0) + self.options.penetration
        if pair not in self.allowed:
            deepest_allowed = min(deepest_allowed, OVERLAP_LIMIT)
        bounds = _bounds_gap(motion.solid, motion.poses, other, T)
        corners = np.einsum("sij,cj->sci", motion.poses[:, :3, :3], motion.solid.corners())
        corners += motion.poses[:, None, :3, 3]
        travel = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=2).max(axis=1)))
        s, names, worst = 0, (motion.name, name), 0.0
        while s < len(times):
            sight = max(self.clearance, 0.0) if contact else self.options.sight
            if bounds[s] > sight:
                contact = False
                near = np.nonzero(bounds[s:] <= self.options.sight)[0]
                if not len(near):
                    break
                s += int(near[0])
                continue
            distance = separation(motion.solid, motion.poses[s], other, T)
            contact = contact and distance <= self.clearance
            required = -deepest_allowed if contact else self.clearance
            if contact and distance < 0 and name.startswith("part/"):
                self.deepest[names] = max(self.deepest.get(names, 0.0), -distance)
            if not contact and distance < self.options.sight and (nearest is None or distance < nearest.distance):
                nearest = Clearance(distance, k, step.part, float(times[s]), *names)
            if distance < required and required - distance > worst:
                worst = required - distance
                first = findings[names].time if names in findings else float(times[s])
                kind = "hits" if distance < 0 else f"comes within {1e3 * distance:.3f} mm of"
                depth = -distance if distance < 0 else required - distance
                message = f"{motion.name} {kind} {name}"
                findings[names] = Finding(k, step.part, first, "collision", message, depth)
            enough = self.clearance if nearest is None or contact else min(nearest.distance, self.options.sight)
            slack = distance - (required if contact else max(required, enough))
            s = max(s + 1, int(np.searchsorted(travel, travel[s] + slack)))
        return nearest

    def _fingers(self, step: PlanStep, k: int, number: int, T_held: Array, robot: Array) -> list[Finding]:
        """Pads of both sides lie on a held mesh with enough area and do not sink in; the rest of the hand keeps off."""
        solid, scene = self.solids[number][0], self.scene
        if not solid.is_mesh:
            return []
        findings = []
        inward = grasp_pose(step.grasp)[:3, 1]
        of_geom = {geom: (body, robot[g]) for g, (geom, body) in enumerate(self._links)}
        for side, sign in zip(scene.sides, (1.0, -1.0), strict=True):
            names = " and ".join(side)
            bodies = [of_geom[g] for link in side for g in scene.geoms(link) if g in of_geom]
            gap = min(separation(body, T, solid, T_held) for body, T in bodies)
            if gap > PAD_REACH:
                message = f"{names}: no pad touches {step.part!r}"
                findings.append(Finding(k, step.part, 0.0, "finger_contact", message, gap))
            elif gap < -PAD_REACH:
                findings.append(Finding(k, step.part, 0.0, "collision", f"{names} cuts into {step.part!r}", -gap))
            elif solid.manifold is not None:
                T_shift = pose(sign * inward * (PAD_REACH + max(gap, 0.0)))
                area = sum(shared_volume(body, T_shift @ T, solid, T_held) for body, T in bodies) / PAD_REACH
                if area < PAD_AREA:
                    message = f"{names}: only {1e6 * area:.1f} mm2 of a pad lie on {step.part!r}"
                    findings.append(Finding(k, step.part, 0.0, "finger_contact", message))
        for link in scene.carried_links:
            if link in scene.finger_bodies:
                continue
            for body, T in (of_geom[g] for g in scene.geoms(link) if g in of_geom):
                gap = separation(body, T, solid, T_held)
                if gap < self.clearance:
                    message = f"{link} is {1e3 * gap:.3f} mm from held/{step.part}"
                    findings.append(Finding(k, step.part, 0.0, "collision", message, self.clearance - gap))
        return findings


def _box_solid(box: OrientedBox) -> Solid:
    surface = Box(tuple(2 * box.half_extents)).surface()
    return Solid(TriangleMesh(surface.moved(box.T_frame_box).vertices, surface.triangles), is_mesh=False)


def _bounds_gap(a: Solid, T_a: Array, b: Solid, T_b: Array) -> Array:
    """Least possible distance (S,), m, by the boxes around both along the world's axes; T_a is (S, 4, 4)."""
    apart = np.abs(T_a[:, :3, :3] @ a.middle + T_a[:, :3, 3] - T_b[:3, :3] @ b.middle - T_b[:3, 3])
    apart -= np.abs(T_a[:, :3, :3]) @ a.half + np.abs(T_b[:3, :3]) @ b.half
    return np.asarray(np.linalg.norm(np.maximum(apart, 0.0), axis=1))


def _points(model: mujoco.MjModel, geom: int) -> Array:
    """Points (V, 3), m, whose hull holds a geom of the robot; exact for meshes and boxes, 1 % wider for round ones."""
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    if kind == int(mujoco.mjtGeom.mjGEOM_MESH):
        first, count = (int(table[model.geom_dataid[geom]]) for table in (model.mesh_vertadr, model.mesh_vertnum))
        return np.asarray(model.mesh_vert[first : first + count], dtype=float)
    if kind == int(mujoco.mjtGeom.mjGEOM_BOX):
        return np.asarray(Box(tuple(2 * size)).surface().vertices)
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ring = 1.01 * size[0] * np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    if kind == int(mujoco.mjtGeom.mjGEOM_CYLINDER):
        return np.concatenate([ring + [0, 0, size[1]], ring - [0, 0, size[1]]])
    tilts = np.linspace(-np.pi / 2, np.pi / 2, 13)
    ball = np.concatenate([ring * np.cos(t) + [0, 0, 1.01 * size[0] * np.sin(t)] for t in tilts])
    if kind == int(mujoco.mjtGeom.mjGEOM_CAPSULE):
        return np.concatenate([ball + [0, 0, size[1]], ball - [0, 0, size[1]]])
    return np.asarray(ball)
