"""Bodies of a GLB file (glTF 2.0, binary): names, places and instances as they stand in it."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

from takeapart.formats.importing.drawn import NAMELESS, DrawnBody, mended
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, rotation_from_quaternion

MAXIMUM_NODES = 20_000
INDEX_TYPES = {5121: "<u1", 5123: "<u2", 5125: "<u4"}
FLOATS, TRIANGLES = 5126, 4


def glb_bodies(content: bytes, where: str, product: str) -> list[DrawnBody]:
    """All bodies of the file's scene.

    Args:
        where: for messages.
        product: name for bodies without any.

    Raises:
        InputError: not such a file, a file that ends early, or one whose geometry is packed.
    """
    try:
        document, data = _chunks(content)
        return _Scene(document, data, product).bodies()
    except _Unreadable as error:
        raise InputError(f"cannot be read as GLB: {error}", where) from None
    except (struct.error, ValueError, KeyError, IndexError, TypeError, AttributeError, RecursionError, OverflowError):
        raise InputError("cannot be read as GLB: it is damaged", where) from None


class _Unreadable(Exception):
    pass


def _chunks(content: bytes) -> tuple[dict[str, Any], bytes]:
    magic, version, length = struct.unpack_from("<4sII", content)
    if magic != b"glTF" or version != 2:
        raise _Unreadable("it does not start as one of version 2 does")
    if length > len(content):
        raise _Unreadable(f"it says that it has {length} bytes, and has {len(content)}")
    chunks: dict[bytes, bytes] = {}
    place = 12
    while place + 8 <= length:
        size, kind = struct.unpack_from("<I4s", content, place)
        chunks.setdefault(kind, content[place + 8 : place + 8 + size])
        place += 8 + size
    return json.loads(chunks[b"JSON"]), chunks.get(b"BIN\x00", b"")


class _Scene:
    def __init__(self, document: dict[str, Any], data: bytes, product: str) -> None:
        self.document, self.data, self.product = document, data, product
        self.nodes = document.get("nodes", [])
        self.meshes: dict[int, tuple[Array, Any]] = {}
        for each in document.get("extensionsRequired", []):
            raise _Unreadable(f"it needs the extension {str(each)[:40]!r}, which is not known here")
        if len(self.nodes) > MAXIMUM_NODES:
            raise _Unreadable(f"it has {len(self.nodes)} nodes; at most {MAXIMUM_NODES} are read")

    def bodies(self) -> list[DrawnBody]:
        scenes = self.document.get("scenes")
        children = {child for node in self.nodes for child in node.get("children", ())}
        roots = scenes[self.document.get("scene", 0)].get("nodes", []) if scenes else []
        roots = roots or [i for i in range(len(self.nodes)) if i not in children]
        found: list[DrawnBody] = []
        waiting = [(root, np.eye(4), self.product) for root in reversed(roots)]
        visited = 0
        while waiting:
            number, T_world_parent, name = waiting.pop()
            visited += 1
            if visited > MAXIMUM_NODES:
                raise _Unreadable("its nodes go round in a circle, or are too many")
            node = self.nodes[number]
            own = mended(str(node.get("name", ""))).strip()
            name = name if NAMELESS.fullmatch(own) else own
            T = T_world_parent @ _matrix(node)
            if "mesh" in node:
                vertices, triangles = self.mesh(node["mesh"])
                if len(triangles):
                    found.append(DrawnBody(name, vertices, triangles, T, node["mesh"]))
            waiting += [(child, T, name) for child in reversed(node.get("children", []))]
        return found

    def mesh(self, number: int) -> tuple[Array, Any]:
        if number not in self.meshes:
            vertices, triangles, count = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], 0
            for primitive in self.document["meshes"][number]["primitives"]:
                if primitive.get("mode", TRIANGLES) != TRIANGLES:
                    continue  # lines and points bound nothing
                points = self.accessor(primitive["attributes"]["POSITION"], 3).astype(float)
                numbers = (
                    self.accessor(primitive["indices"], 1).astype(np.int64).ravel()
                    if "indices" in primitive
                    else np.arange(len(points))
                )
                if len(numbers) and numbers.max() >= len(points):
                    raise _Unreadable(f"a triangle names corner {numbers.max()} of {len(points)}")
                vertices.append(points)
                triangles.append(numbers[: len(numbers) // 3 * 3].reshape(-1, 3) + count)
                count += len(points)
            self.meshes[number] = np.concatenate(vertices), np.concatenate(triangles)
        return self.meshes[number]

    def accessor(self, number: int, columns: int) -> Any:
        accessor = self.document["accessors"][number]
        kind = "<f4" if accessor["componentType"] == FLOATS else INDEX_TYPES[accessor["componentType"]]
        view = self.document["bufferViews"][accessor["bufferView"]]
        if view.get("buffer", 0) or "uri" in self.document["buffers"][0] or "sparse" in accessor:
            raise _Unreadable("its geometry is not inside of it")
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        size, count = np.dtype(kind).itemsize, int(accessor["count"])
        stride = view.get("byteStride", size * columns)
        if min(start, count, stride - size * columns) < 0 or start + stride * (count - 1) + size * columns > len(
            self.data
        ):
            raise _Unreadable("its geometry ends early")
        return np.ndarray((count, columns), kind, self.data, start, (stride, size))


def _matrix(node: dict[str, Any]) -> Array:
    if "matrix" in node:
        return np.array(node["matrix"], dtype=float).reshape(4, 4).T
    T = np.eye(4)
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    T[:3, :3] = rotation_from_quaternion((w, x, y, z)) * np.array(node.get("scale", (1, 1, 1)), dtype=float)
    T[:3, 3] = node.get("translation", (0, 0, 0))
    return T
