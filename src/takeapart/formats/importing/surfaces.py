"""From drawn triangles to shapes: corners joined by position, closed ones turned outwards, each with what was found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from takeapart.model.errors import InputError, MissingExtraError
from takeapart.model.geometry import Array, TriangleMesh
from takeapart.model.meshes import MOST_TRIANGLES, Mesh

SAME_PLACE = 1e-7  # m; corners as near as this are one
GRID = 9  # decimals of a metre: what differs by rounding alone is the same shape
RIGID = 1e-4  # of the entries of a rotation, written with 32-bit floats


@dataclass(frozen=True, eq=False)
class Surface:
    """A shape in the part's frame, whose origin is the middle of its bounds, and what was found.

    Args:
        middle: (3,) m, that origin in the frame of the drawing.
        remarks: what is wrong or was changed, in words.
    """

    mesh: Mesh
    middle: Array
    remarks: tuple[str, ...]


def surface_of(vertices: Array, triangles: NDArray[np.int64], where: str, simplify: float = 0.0) -> Surface:
    """The shape of a drawn body.

    Args:
        vertices: (V, 3) m.
        where: for messages.
        simplify: m; a closed surface may move by this much to have fewer triangles; 0 leaves it as it is.

    Raises:
        InputError: not a number, a corner that is not there, no triangles, too many, or no extent.
    """
    if len(triangles) > MOST_TRIANGLES and not simplify:
        raise InputError(
            f"{len(triangles)} triangles; at most {MOST_TRIANGLES} are allowed in one part: "
            "export it coarser, or give --simplify 0.1mm",
            where,
        )
    if len(triangles) and (triangles.min() < 0 or triangles.max() >= len(vertices)):
        raise InputError(f"a triangle names corner {int(triangles.max())} of {len(vertices)}", where)
    if not np.isfinite(vertices[triangles.ravel()]).all():
        raise InputError("a corner is not a finite number", where)
    vertices, triangles = _joined(vertices, triangles)
    flat = (triangles[:, [0, 1, 2]] == triangles[:, [1, 2, 0]]).any(axis=1)
    triangles = triangles[~flat]
    if not len(triangles):
        raise InputError("has no triangle with an area", where)
    remarks: list[str] = []
    if simplify:
        vertices, triangles = _simplified(vertices, triangles, simplify, remarks)
    middle = _on_grid((vertices.min(axis=0) + vertices.max(axis=0)) / 2)
    local = np.round(vertices - middle, GRID) + 0.0
    try:
        mesh = Mesh(TriangleMesh(local, triangles.astype(np.int32)))
        if not mesh.is_closed:
            mesh = _wound(mesh, remarks)
        if mesh.is_closed and _signed_volume(mesh.triangle_mesh) < 0:
            mesh = Mesh(TriangleMesh(local, np.ascontiguousarray(mesh.triangle_mesh.triangles[:, ::-1])))
            remarks.append("was inside out: turned")
    except InputError as error:
        raise InputError(error.message, where) from None
    if not mesh.is_closed:
        remarks.append(f"open: {open_edges(mesh)} edges do not join two triangles; its inside is not known")
    return Surface(mesh, middle, tuple(remarks))


def _simplified(
    vertices: Array, triangles: NDArray[np.int64], within: float, remarks: list[str]
) -> tuple[Array, NDArray[np.int64]]:
    """Fewer triangles, each within a distance (m) of the surface, where that is closed."""
    try:
        import manifold3d
    except ImportError:
        raise MissingExtraError("import --simplify", "cad", "manifold3d") from None
    body = manifold3d.Manifold(manifold3d.Mesh64(np.ascontiguousarray(vertices), triangles.astype(np.uint64)))
    if body.status() != manifold3d.Error.NoError or body.is_empty():
        remarks.append("not simplified: only a closed surface can be")
        return vertices, triangles
    found = body.simplify(within).to_mesh64()
    if len(found.tri_verts) < len(triangles):
        remarks.append(f"simplified from {len(triangles)} to {len(found.tri_verts)} faces, within {1e3 * within:g} mm")
        return np.asarray(found.vert_properties)[:, :3], np.asarray(found.tri_verts).astype(np.int64)
    return vertices, triangles


def _on_grid(point: Array) -> Array:
    """A point (3,) m of the grid. The middle of what is drawn to a nanometre is often half way between two of them:
    these go one way, whatever rounding has left of the half."""
    return np.asarray(np.floor(point * 10**GRID + 0.75) / 10**GRID)


def _joined(vertices: Array, triangles: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """Corners at the same place made one, in the order in which they are met; those without triangles are left out."""
    used = triangles.ravel()
    rounded = np.round(vertices[used] / SAME_PLACE).astype(np.int64)
    _, first, inverse = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return vertices[used[first[order]]], rank[inverse.ravel()].reshape(-1, 3)


def _wound(mesh: Mesh, remarks: list[str]) -> Mesh:
    """The same with all triangles wound alike, where only that is amiss."""
    edges = np.sort(_edges(mesh.triangle_mesh.triangles), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    if not (count == 2).all():
        return mesh
    import trimesh

    found = trimesh.Trimesh(mesh.triangle_mesh.vertices, mesh.triangle_mesh.triangles, process=False)
    trimesh.repair.fix_winding(found)
    turned = Mesh(TriangleMesh(mesh.triangle_mesh.vertices, np.array(found.faces, np.int32)))
    if turned.is_closed:
        remarks.append("triangles were wound both ways: turned alike")
        return turned
    return mesh


def open_edges(mesh: Mesh) -> int:
    """How many edges do not join exactly two triangles."""
    _, count = np.unique(np.sort(_edges(mesh.triangle_mesh.triangles), axis=1), axis=0, return_counts=True)
    return int((count != 2).sum())


def _edges(triangles: NDArray[np.int32]) -> NDArray[np.int32]:
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


def _signed_volume(mesh: TriangleMesh) -> float:
    a, b, c = np.moveaxis(mesh.corners, 1, 0)
    return float(np.einsum("ni,ni->n", a, np.cross(b, c)).sum()) / 6


def split_map(T: Array) -> tuple[Array, Array]:
    """An affine map (4, 4) as a proper pose (4, 4) after a linear map (3, 3) of the shape.

    The linear map is the identity for a rigid place, one mirror for a mirrored one, all of it where it scales.
    """
    linear = T[:3, :3]
    placed = np.eye(4)
    placed[:3, 3] = T[:3, 3]
    if np.abs(linear @ linear.T - np.eye(3)).max() > RIGID:
        return placed, linear
    mirror = np.diag([-1.0 if np.linalg.det(linear) < 0 else 1.0, 1.0, 1.0])
    left, _, right = np.linalg.svd(linear @ mirror)
    placed[:3, :3] = left @ right
    return placed, mirror
