"""Surfaces of parts beside an assembly file: OBJ files of corners and triangles alone, in metres, numbers in full.

A file is named by its path from the folder of the assembly file and by the hash of its content, so that a product moves
with its folder and a surface that was changed is not taken for the one that was planned with.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath

import numpy as np

from takeapart.formats.documents import read_bytes, write_atomically
from takeapart.formats.messages import shortened, shown
from takeapart.model.assembly import Assembly
from takeapart.model.errors import InputError
from takeapart.model.geometry import TriangleMesh
from takeapart.model.meshes import Mesh

MESH_FOLDER = "meshes"
MESH_ENDING = ".obj"
MAXIMUM_MESH_BYTES = 64 * 2**20
MAXIMUM_TRIANGLES = 2_000_000  # of all different meshes of a product
DIGITS_IN_NAMES = 8  # of a mesh's hash


def mesh_files(assembly: Assembly) -> dict[str, str]:
    """Path of the file of every different mesh, by its hash, from the folder of the assembly file.

    A file is called as the first part that has the mesh, with the first digits of the hash: products in one folder
    share what is equal and never overwrite what is not.
    """
    found: dict[str, str] = {}
    for part in assembly.parts:
        if isinstance(part.shape, Mesh) and part.shape.hash not in found:
            digest = part.shape.hash
            found[digest] = f"{MESH_FOLDER}/{part.name[:48]}-{digest[:DIGITS_IN_NAMES]}{MESH_ENDING}"
    return found


def save_meshes(assembly: Assembly, folder: Path) -> None:
    """Write the meshes of an assembly below the folder of its file, each atomically; what is there already stays.

    Raises:
        InputError: a file cannot be written.
    """
    files = mesh_files(assembly)
    for part in assembly.parts:
        if isinstance(part.shape, Mesh) and part.shape.hash in files:
            target = folder / files.pop(part.shape.hash)
            content = obj_text(part.shape.surface()).encode()
            if not _holds(target, content):
                write_atomically(target, content)


def _holds(path: Path, content: bytes) -> bool:
    try:
        return path.stat().st_size == len(content) and path.read_bytes() == content
    except OSError:
        return False


def load_meshes(named: Iterable[tuple[str, str, str]], folder: Path) -> Mapping[str, Mesh]:
    """The meshes that an assembly file names; equal ones are one object.

    Args:
        named: file, hash, and the place where both are named, for messages.
        folder: of the assembly file.

    Returns:
        Meshes by hash.

    Raises:
        InputError: a path that leads out of the folder, a file that is missing, broken or not the one of this hash, too
            many triangles.
    """
    found: dict[str, Mesh] = {}
    read: dict[str, str] = {}  # hash of what a file holds
    triangles = 0
    for file, digest, where in named:
        if file not in read:
            mesh = _load_mesh(file, folder, where)
            read[file] = mesh.hash
            if mesh.hash not in found:
                triangles += len(mesh.surface().triangles)
            found.setdefault(mesh.hash, mesh)
        if read[file] != digest:
            raise InputError(
                f"{shortened(file)} has the hash {read[file][:12]}..., not {digest[:12]}... as it is said here; "
                "the file has been changed: import the product again",
                where,
            )
        if triangles > MAXIMUM_TRIANGLES:
            raise InputError(
                f"the meshes up to here have {triangles} triangles; at most {MAXIMUM_TRIANGLES} are allowed", where
            )
    return found


def _load_mesh(file: str, folder: Path, where: str) -> Mesh:
    path = PurePosixPath(file)
    if path.is_absolute() or ".." in path.parts or "\\" in file or not file.isprintable():
        raise InputError(f"{shortened(file)}; must be a path inside the folder of the assembly file", where)
    target = folder / path
    if not Path(os.path.realpath(target)).is_relative_to(os.path.realpath(folder)):
        raise InputError(f"{shortened(file)} is a link that leads out of the folder of the assembly file", where)
    try:
        return Mesh(read_obj(target))
    except InputError as error:
        place = "" if error.where == "mesh" else error.where.removeprefix(shown(target)).removeprefix(":").strip()
        raise InputError(f"{shortened(file)}: {f'{place}: ' if place else ''}{error.message}", where) from None


def obj_text(mesh: TriangleMesh) -> str:
    """An OBJ file; what is read of it has the same numbers to the last digit."""
    corners = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in mesh.vertices.tolist())
    return corners + "".join(f"f {a} {b} {c}\n" for a, b, c in (mesh.triangles.astype(np.int64) + 1).tolist())


def read_obj(path: Path) -> TriangleMesh:
    """The surface in an OBJ file of corners and triangles alone, m.

    Raises:
        InputError: the file cannot be read, is too large, or holds anything else; with the line.
    """
    content = read_bytes(path, MAXIMUM_MESH_BYTES)
    corners: list[bytes] = []
    faces: list[bytes] = []
    for number, line in enumerate(content.splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith(b"#"):
            continue
        if words[0] not in (b"v", b"f") or len(words) != 4:
            text = shortened(line.decode("utf-8", "replace"))
            raise InputError(f"{text}; must be 'v x y z' or 'f i j k'", f"{shown(path)}: line {number}")
        (corners if words[0] == b"v" else faces).extend(words[1:])
    try:
        vertices = np.array([float(word) for word in corners], dtype=float).reshape(-1, 3)
        triangles = np.array([int(word) for word in faces], dtype=np.int64).reshape(-1, 3) - 1
    except (ValueError, OverflowError):
        raise InputError("holds a text where a number must stand", shown(path)) from None
    if len(triangles) and (triangles.min() < 0 or triangles.max() >= len(vertices)):
        bad = int(triangles.min() if triangles.min() < 0 else triangles.max()) + 1
        raise InputError(f"a triangle names corner {bad}; 1 to {len(vertices)} are there", shown(path))
    return TriangleMesh(vertices, triangles.astype(np.int32))
