"""A robot's collision meshes as they are, against each other, with the library FCL: an oracle for self-collision."""

from __future__ import annotations

from itertools import combinations

import fcl
import numpy as np
import trimesh
import yourdfpy

from takeapart.model.description import RobotDescription, RobotFiles
from takeapart.model.geometry import Array


def _read(files: RobotFiles) -> yourdfpy.URDF:
    return yourdfpy.URDF.load(
        str(files.urdf),
        filename_handler=lambda name: str(files.resolve(name)),
        build_scene_graph=True,
        build_collision_scene_graph=False,
        load_meshes=False,
        load_collision_meshes=False,
    )


def _model(geometry: yourdfpy.Geometry, files: RobotFiles) -> tuple[fcl.CollisionGeometry, Array]:
    """The geometry, and the corners (V, 3), m, of its mesh; none of a primitive."""
    if geometry.box is not None:
        return fcl.Box(*geometry.box.size), np.empty((0, 3))
    if geometry.cylinder is not None:
        return fcl.Cylinder(geometry.cylinder.radius, geometry.cylinder.length), np.empty((0, 3))
    if geometry.sphere is not None:
        return fcl.Sphere(geometry.sphere.radius), np.empty((0, 3))
    mesh = trimesh.load_mesh(str(files.resolve(geometry.mesh.filename)))
    scale = 1.0 if geometry.mesh.scale is None else geometry.mesh.scale
    vertices = np.asarray(mesh.vertices) * scale
    model = fcl.BVHModel()
    model.beginModel(len(vertices), len(mesh.faces))
    model.addSubModel(vertices, mesh.faces)
    model.endModel()
    return model, vertices


class MeshOracle:
    """All links of a robot with meshes or boxes, placed by a library's own kinematics, not by the planner's.

    Pairs are left out where one link is the next one of the other in the chain, and those of the gripper's own links,
    which overlap where they are joined, but for its fingers.
    """

    def __init__(self, description: RobotDescription) -> None:
        self.description = description
        arm, gripper = description.arm, description.gripper
        self.urdf, self.gripper = _read(arm.files), _read(gripper.files)
        one_file = arm.files.urdf == gripper.files.urdf
        below = self._below(self.gripper, gripper.base_link)
        # Two files may have links of one name.
        known = set() if one_file else set(self.urdf.link_map)
        self.own = {f"gripper's {name}" if name in known else name: name for name in below}  # the gripper's links
        named = {name: key for key, name in self.own.items()}
        self.objects: dict[str, list[tuple[fcl.CollisionObject, Array]]] = {}
        self.vertices: dict[str, Array] = {}  # (V, 3) m, of a link's meshes, in the link's frame
        arm_links = {name: link for name, link in self.urdf.link_map.items() if not (one_file and name in below)}
        hand_links = {named[name]: self.gripper.link_map[name] for name in below}
        for files, links in ((arm.files, arm_links), (gripper.files, hand_links)):
            for name, link in links.items():
                for collision in link.collisions:
                    T = np.eye(4) if collision.origin is None else collision.origin
                    model, corners = _model(collision.geometry, files)
                    if len(corners):
                        corners = corners @ T[:3, :3].T + T[:3, 3]
                        self.vertices[name] = np.vstack([self.vertices.get(name, np.empty((0, 3))), corners])
                    self.objects.setdefault(name, []).append((fcl.CollisionObject(model), T))
        parents = {joint.child: joint.parent for joint in self.urdf.joint_map.values() if joint.child in arm_links}
        parents |= {
            named[joint.child]: named[joint.parent]
            for joint in self.gripper.joint_map.values()
            if joint.child in below and joint.child != gripper.base_link
        }
        parents[named[gripper.base_link]] = arm.flange_link
        fingers = {named[name] for name in gripper.finger_links}
        self.pairs = [
            (a, b)
            for a, b in combinations(self.objects, 2)
            if a not in self._next(b, parents)
            and b not in self._next(a, parents)
            and (not {a, b} <= self.own.keys() or {a, b} <= fingers)
        ]

    @staticmethod
    def _below(urdf: yourdfpy.URDF, base: str) -> set[str]:
        found = {base}
        while new := {j.child for j in urdf.joint_map.values() if j.parent in found} - found:
            found |= new
        return found

    def _next(self, link: str, parents: dict[str, str]) -> set[str]:
        """The next link with geometry before a link, links without any skipped."""
        link = parents.get(link, "")
        while link and link not in self.objects:
            link = parents.get(link, "")
        return {link}

    def poses(self, q: Array, opening: float) -> dict[str, Array]:
        """Pose (4, 4) of every link with geometry in the arm's base link."""
        arm, gripper = self.description.arm, self.description.gripper
        self.urdf.update_cfg(dict(zip(arm.joints, q, strict=True)))
        self.gripper.update_cfg(gripper.joint_positions(opening))
        T_base_gripper = self.urdf.get_transform(arm.flange_link, arm.base_link) @ self.description.T_flange_gripper
        return {
            name: T_base_gripper @ self.gripper.get_transform(self.own[name], gripper.base_link)
            if name in self.own
            else self.urdf.get_transform(name, arm.base_link)
            for name in self.objects
        }

    def place(self, q: Array, opening: float) -> None:
        for name, T_link in self.poses(q, opening).items():
            for found, T in self.objects[name]:
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
