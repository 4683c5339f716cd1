"""The arm's collision meshes as they are, against each other, with the library FCL: an oracle for self-collision."""

from __future__ import annotations

from itertools import combinations

import fcl
import numpy as np
import trimesh
import yourdfpy

from takeapart.model.geometry import Array
from takeapart.workcell import RobotDescription


class MeshOracle:
    """All links of a robot with meshes or boxes, placed by another reader of URDF than the planner's.

    Pairs are left out where one link is the next one of the other in the chain.
    """

    def __init__(self, description: RobotDescription) -> None:
        self.description = description
        self.urdf = yourdfpy.URDF.load(
            str(description.path(description.urdf)),
            filename_handler=lambda name: str(description.resolve(name)),
            build_scene_graph=True,
            build_collision_scene_graph=False,
            load_meshes=False,
            load_collision_meshes=False,
        )
        self.objects: dict[str, list[tuple[fcl.CollisionObject, Array]]] = {}
        self.vertices: dict[str, Array] = {}  # (V, 3) m, of a link's meshes, in the link's frame
        for name, link in self.urdf.link_map.items():
            for collision in link.collisions:
                T = np.eye(4) if collision.origin is None else collision.origin
                if collision.geometry.mesh is not None:
                    mesh = trimesh.load_mesh(str(description.resolve(collision.geometry.mesh.filename)))
                    model = fcl.BVHModel()
                    model.beginModel(len(mesh.vertices), len(mesh.faces))
                    model.addSubModel(mesh.vertices, mesh.faces)
                    model.endModel()
                    vertices = mesh.vertices @ T[:3, :3].T + T[:3, 3]
                    self.vertices[name] = np.vstack([self.vertices.get(name, np.empty((0, 3))), vertices])
                else:
                    model = fcl.Box(*collision.geometry.box.size)
                self.objects.setdefault(name, []).append((fcl.CollisionObject(model), T))
        parents = {joint.child: joint.parent for joint in self.urdf.joint_map.values()}
        self.pairs = [
            (a, b)
            for a, b in combinations(self.objects, 2)
            if a not in self._next(b, parents) and b not in self._next(a, parents)
        ]

    def _next(self, link: str, parents: dict[str, str]) -> set[str]:
        """The next link with geometry before a link, links without any skipped."""
        link = parents.get(link, "")
        while link and link not in self.objects:
            link = parents.get(link, "")
        return {link}

    def place(self, q: Array, opening: float) -> None:
        names = [*self.description.arm_joints, *self.description.finger_joints]
        angles = [*q, *[opening / 2] * len(self.description.finger_joints)]
        self.urdf.update_cfg(dict(zip(names, angles, strict=True)))
        for name, objects in self.objects.items():
            T_link = self.urdf.get_transform(name)
            for found, T in objects:
                pose = T_link @ T
                found.setTransform(fcl.Transform(pose[:3, :3], pose[:3, 3]))

    def meeting(self) -> list[tuple[str, str]]:
        """Pairs of links that touch where they were placed last."""
        return [
            (a, b)
            for a, b in self.pairs
            if any(
                fcl.collide(x, y, fcl.CollisionRequest(), fcl.CollisionResult())
                for x, _ in self.objects[a]
                for y, _ in self.objects[b]
            )
        ]

    def distance(self, a: str, b: str) -> float:
        """Distance of two links that do not touch, m."""
        return min(
            float(fcl.distance(x, y, fcl.DistanceRequest(), fcl.DistanceResult()))
            for x, _ in self.objects[a]
            for y, _ in self.objects[b]
        )
