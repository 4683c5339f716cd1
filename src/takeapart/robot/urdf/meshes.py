"""The geometry of links as triangles: mesh files with scale, boxes, cylinders and spheres.

A cylinder or a sphere is replaced by a polyhedron around it: nothing of it stands outside, and at most `SAGITTA` of
what stands inside of the polyhedron is not part of it.
"""

from __future__ import annotations

import hashlib
import importlib.util
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from takeapart.model.errors import InputError
from takeapart.model.geometry import Array
from takeapart.robot.kept import keep, kept
from takeapart.robot.urdf.tree import Geometry, Urdf

SAGITTA = 0.001  # m
FEWEST_SIDES, MOST_SIDES = 12, 64  # of the polyhedron of a cylinder
MAXIMUM_MESH_BYTES = 256 * 2**20
NEEDS = {".dae": ("collada", "pycollada")}  # module and package that trimesh reads a kind of file with


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """Triangles, anticlockwise seen from outside.

    Args:
        vertices: (V, 3) m.
        faces: (F, 3) numbers of the vertices.
        color: red, green, blue from 0 to 1; None where nothing is said.
    """

    vertices: Array
    faces: NDArray[np.int64]
    color: tuple[float, float, float] | None = None

    def moved(self, T: Array) -> TriangleMesh:
        """The same mesh under an affine map (4, 4); where it mirrors, the triangles are turned round."""
        faces = self.faces if np.linalg.det(T[:3, :3]) > 0 else self.faces[:, ::-1]
        return TriangleMesh(self.vertices @ T[:3, :3].T + T[:3, 3], faces, self.color)

    @property
    def triangles(self) -> Array:
        """Corners (F, 3, 3), m."""
        return np.asarray(self.vertices[self.faces])


def collisions(urdf: Urdf, link: str) -> tuple[TriangleMesh, ...]:
    """Collision geometry of a link in its frame, one mesh for each element; none where the link has none.

    Raises:
        InputError: a mesh is missing or cannot be read.
    """
    return tuple(mesh for shape in urdf.link(link).collisions for mesh in _together(geometry_meshes(urdf, shape)))


def visuals(urdf: Urdf, link: str) -> tuple[TriangleMesh, ...]:
    """What a link looks like, in its frame, one mesh for each colour of each element.

    Raises:
        InputError: a mesh is missing or cannot be read.
    """
    return tuple(mesh for shape in urdf.link(link).visuals for mesh in geometry_meshes(urdf, shape))


def convex_corners(urdf: Urdf, shape: Geometry) -> Array:
    """Corners (V, 3), m, of a convex polyhedron around a shape, in the frame of its link; exact for meshes' convex
    hulls and boxes. That of a mesh is found once per file content and kept in the cache folder.

    Raises:
        InputError: a mesh is missing or cannot be read.
    """
    if shape.kind != "mesh":
        (mesh,) = geometry_meshes(urdf, shape)
        return mesh.vertices
    path = urdf.files.resolve(shape.uri)
    corners = _file_corners(str(path), digest_of(path), urdf.where)
    return _scaled(corners, shape) @ shape.T_link[:3, :3].T + shape.T_link[:3, 3]


def geometry_meshes(urdf: Urdf, shape: Geometry) -> tuple[TriangleMesh, ...]:
    """A shape in the frame of its link: one mesh for each colour.

    Raises:
        InputError: a mesh is missing or cannot be read.
    """
    if shape.kind == "mesh":
        path = urdf.files.resolve(shape.uri)
        found = _file_meshes(str(path), digest_of(path), urdf.where)
        T = shape.T_link @ np.diag([*shape.size, 1.0])
        return tuple(TriangleMesh(m.vertices, m.faces, shape.color or m.color).moved(T) for m in found)
    vertices, faces = _primitive(shape.kind, shape.size)
    return (TriangleMesh(vertices, faces, shape.color).moved(shape.T_link),)


def _together(meshes: Sequence[TriangleMesh]) -> tuple[TriangleMesh, ...]:
    if not meshes:
        return ()
    offsets = np.cumsum([0, *[len(mesh.vertices) for mesh in meshes]])
    faces = np.concatenate([mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)])
    return (TriangleMesh(np.concatenate([mesh.vertices for mesh in meshes]), faces),)


def _scaled(points: Array, shape: Geometry) -> Array:
    return points if shape.size == (1.0, 1.0, 1.0) else np.asarray(points * shape.size)


# ---- mesh files


def digest_of(path: Path) -> str:
    """SHA-256 of a file's content."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


@lru_cache(maxsize=256)
def _file_corners(path: str, digest: str, where: str) -> Array:
    """Corners (V, 3), m, of the convex hull of a mesh file."""
    name = f"corners-1-{digest[:24]}"
    known = kept(name)
    if known is not None and known.ndim == 2 and known.shape[1] == 3 and len(known) > 3 and np.isfinite(known).all():
        return np.ascontiguousarray(known, dtype=float)
    found = hull_of(np.concatenate([mesh.vertices for mesh in _file_meshes(path, digest, where)]), path)
    keep(name, found[0])
    return found[0]


def hull_of(points: Array, where: str) -> tuple[Array, NDArray[np.int64], Array]:
    """Convex hull of points (N, 3), m: corners (V, 3), faces (F, 3), outward normals (F, 3).

    Raises:
        InputError: the points lie in a plane.
    """
    import trimesh  # takes longer to import than all else of the planner, and mostly its results are kept already
    from scipy.spatial import QhullError

    try:
        hull = trimesh.PointCloud(points).convex_hull
    except (QhullError, ValueError, IndexError):
        raise InputError("the mesh is flat; collision geometry must have a volume", where) from None
    return np.asarray(hull.vertices, dtype=float), np.asarray(hull.faces), np.asarray(hull.face_normals)


@lru_cache(maxsize=64)
def _file_meshes(path: str, digest: str, where: str) -> tuple[TriangleMesh, ...]:
    """Meshes of a file, m, one for each colour."""
    file = Path(path)
    if file.stat().st_size > MAXIMUM_MESH_BYTES:
        raise InputError(f"mesh {path} is larger than {MAXIMUM_MESH_BYTES >> 20} MiB, the most that is read", where)
    module, package = NEEDS.get(file.suffix.lower(), ("", ""))
    if module and importlib.util.find_spec(module) is None:
        raise InputError(
            f"mesh {path} needs the package {package!r} to be read; install it with: pip install {package}", where
        )
    import trimesh

    try:
        loaded = trimesh.load_scene(file).dump()
    except Exception as error:  # whatever a reader of trimesh raises for a broken file
        cause = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"mesh {path} cannot be read: {cause}", where) from None
    pieces = [mesh for mesh in loaded if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
    if not pieces:
        raise InputError(f"mesh {path} has no triangles", where)
    by_color: dict[tuple[float, float, float] | None, list[TriangleMesh]] = {}
    for mesh in pieces:
        vertices = _unit(mesh) * np.asarray(mesh.vertices, dtype=float)
        found = TriangleMesh(vertices, np.asarray(mesh.faces, dtype=np.int64))
        if not np.isfinite(found.vertices).all():
            raise InputError(f"mesh {path} has a vertex that is no finite number", where)
        by_color.setdefault(_color(mesh), []).append(found)
    return tuple(
        TriangleMesh(mesh.vertices, mesh.faces, color)
        for color, meshes in by_color.items()
        for mesh in _together(meshes)
    )


def _unit(mesh: Any) -> float:
    """What a mesh's file says that its unit is, m; Collada says one, the other formats of URDF are in metres."""
    from trimesh.units import unit_conversion

    return float(unit_conversion(str(mesh.metadata.get("units") or "meters"), "meters"))


def _color(mesh: Any) -> tuple[float, float, float] | None:
    material = getattr(mesh.visual, "material", None)
    if material is None:
        return None
    red, green, blue = (float(value) / 255 for value in material.main_color[:3])
    return red, green, blue


# ---- shapes with a formula


@lru_cache(maxsize=256)
def _primitive(kind: str, size: tuple[float, ...]) -> tuple[Array, NDArray[np.int64]]:
    if kind == "box":
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
        points = signs * np.array(size) / 2
    elif kind == "cylinder":
        points = _prism(*size)
    else:
        points = _around_sphere(size[0])
    vertices, faces, _ = hull_of(points, kind)
    return vertices, faces


def _prism(radius: float, length: float) -> Array:
    """Corners of a prism around a cylinder along z, its sides as many as `SAGITTA` asks for."""
    sides = MOST_SIDES
    for count in range(FEWEST_SIDES, MOST_SIDES + 1, 4):
        if radius / math.cos(math.pi / count) - radius <= SAGITTA:
            sides = count
            break
    angles = 2 * math.pi * np.arange(sides) / sides
    ring = radius / math.cos(math.pi / sides) * np.column_stack([np.cos(angles), np.sin(angles)])
    return np.array([[x, y, z] for z in (-length / 2, length / 2) for x, y in ring])


def _around_sphere(radius: float) -> Array:
    """Corners of an icosahedron subdivided and blown up until the sphere lies inside."""
    import trimesh

    for subdivisions in (1, 2, 3):
        ball = trimesh.creation.icosphere(subdivisions=subdivisions)
        inner = float(np.einsum("ij,ij->i", ball.face_normals, ball.triangles[:, 0]).min())
        if radius / inner - radius <= SAGITTA:
            break
    return np.asarray(ball.vertices, dtype=float) * (radius / inner)
