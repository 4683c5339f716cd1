"""Weights of a guide as a safetensors file, read with limits, and neither read nor written with torch.

The file is what https://github.com/huggingface/safetensors describes: the length of a header, the header (JSON), and
the bytes of all arrays. Its metadata say what the arrays are for and what they were learned from;
docs/file-formats.md lists them.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from takeapart.formats.documents import canonical_json, read_bytes, write_atomically
from takeapart.formats.messages import shortened, shown
from takeapart.guide.architecture import Architecture
from takeapart.guide.graph import Numbers
from takeapart.model.errors import InputError

FORMAT, VERSION = "takeapart/guide", "1"
MAXIMUM_BYTES = 64 * 2**20
MAXIMUM_HEADER = 4 * 2**20


@dataclass(frozen=True, eq=False)
class Weights:
    """What a weights file holds.

    Args:
        architecture: of the network.
        arrays: 32-bit floats, named and shaped as `Architecture.shapes` says.
        training: how the weights came about: options, hash of the experience, assemblies, figures.
    """

    architecture: Architecture
    arrays: Mapping[str, Numbers]
    training: Mapping[str, Any]

    @property
    def hash(self) -> str:
        """SHA-256 of all arrays."""
        return arrays_hash(self.arrays)


def arrays_hash(arrays: Mapping[str, Numbers]) -> str:
    """SHA-256 of names and content, by ascending name."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(f"{name}:".encode())
        digest.update(np.ascontiguousarray(arrays[name], dtype="<f4").tobytes())
    return digest.hexdigest()


def save_weights(weights: Weights, path: Path) -> None:
    """Write a weights file, atomically.

    Raises:
        InputError: it cannot be written.
    """
    metadata = {
        "format": FORMAT,
        "version": VERSION,
        "architecture": canonical_json(asdict(weights.architecture)),
        "training": canonical_json(dict(weights.training)),
        "hash": weights.hash,
    }
    write_arrays(path, weights.arrays, metadata)


def load_weights(path: Path) -> Weights:
    """The weights in a file.

    Raises:
        InputError: one line that names the file, what is wrong with it, and what is valid.
    """
    where = shown(path)
    arrays, metadata = read_arrays(path, MAXIMUM_BYTES)
    if metadata.get("format") != FORMAT or metadata.get("version") != VERSION:
        found = f"format {shortened(metadata.get('format'))}, version {shortened(metadata.get('version'))}"
        raise InputError(f"is no guide: {found}; must be format {FORMAT!r}, version {VERSION!r}", where)
    sizes = _object(metadata, "architecture", where)
    valid = {"layers", "width"}
    if set(sizes) != valid or not all(isinstance(size, int) and not isinstance(size, bool) for size in sizes.values()):
        raise InputError(f"architecture {shortened(sizes)}; must hold the whole numbers layers and width", where)
    try:
        architecture = Architecture(**sizes)
    except InputError as error:
        raise InputError(error.message, f"{where}: {error.where}") from None
    shapes = architecture.shapes()
    for name in {**shapes, **arrays}:
        if name not in arrays:
            raise InputError(f"has no array {name!r}", where)
        if name not in shapes:
            raise InputError(f"has an array {shortened(name)} that is not part of the network", where)
        if arrays[name].shape != shapes[name]:
            raise InputError(f"has shape {arrays[name].shape}; must be {shapes[name]}", f"{where}: {name}")
        if not np.isfinite(arrays[name]).all():
            raise InputError("holds numbers that are not finite", f"{where}: {name}")
        if name.endswith("_scale") and not (arrays[name] > 0).all():
            raise InputError("every scale must be above 0", f"{where}: {name}")
    if metadata.get("hash") != arrays_hash(arrays):
        raise InputError("the weights do not have the hash that the file states; it is damaged", where)
    return Weights(architecture, arrays, _object(metadata, "training", where))


def write_arrays(path: Path, arrays: Mapping[str, Numbers], metadata: Mapping[str, str]) -> None:
    """Write 32-bit floats as a safetensors file, atomically; the same content gives the same bytes.

    Raises:
        InputError: it cannot be written.
    """
    header: dict[str, Any] = {"__metadata__": dict(metadata)}
    data = bytearray()
    for name in sorted(arrays):
        content = np.asarray(arrays[name], dtype="<f4").tobytes()
        header[name] = {
            "dtype": "F32",
            "shape": list(arrays[name].shape),
            "data_offsets": [len(data), len(data) + len(content)],
        }
        data += content
    text = canonical_json(header).encode()
    text += b" " * (-len(text) % 8)  # the arrays begin at a multiple of eight
    write_atomically(path, len(text).to_bytes(8, "little") + text + bytes(data))


def read_arrays(path: Path, maximum_bytes: int) -> tuple[dict[str, Numbers], dict[str, str]]:
    """Arrays and metadata of a safetensors file that holds nothing but 32-bit floats.

    Raises:
        InputError: it cannot be read, is too large, or breaks the format.
    """
    where, content = shown(path), read_bytes(path, maximum_bytes)
    length = int.from_bytes(content[:8], "little")
    if len(content) < 8 or not 2 <= length <= min(MAXIMUM_HEADER, len(content) - 8):
        raise InputError("is cut off or no safetensors file", where)
    try:
        header = json.loads(content[8 : 8 + length].decode())
    except (ValueError, RecursionError):
        raise InputError("is damaged or no safetensors file: its header is not JSON", where) from None
    if not isinstance(header, dict):
        raise InputError("is damaged or no safetensors file: its header is no object", where)
    metadata = header.pop("__metadata__", {})
    if not isinstance(metadata, dict) or not all(isinstance(value, str) for value in metadata.values()):
        raise InputError("the metadata must be texts", where)
    data = memoryview(content)[8 + length :]
    arrays: dict[str, Numbers] = {}
    end = 0
    for name, entry in sorted(header.items(), key=lambda item: _begin(item[1])):
        shape, begin = _entry(entry, f"{where}: {shortened(name)}")
        size = 4 * int(np.prod(shape, dtype=object))
        if begin != end or begin + size != entry["data_offsets"][1] or begin + size > len(data):
            raise InputError("its bytes overlap others, leave a gap, or are cut off", f"{where}: {shortened(name)}")
        end = begin + size
        arrays[name] = np.frombuffer(data[begin:end], dtype="<f4").astype(np.float32).reshape(shape)
    if end != len(data):
        raise InputError(f"has {len(data) - end} bytes that belong to no array", where)
    return arrays, metadata


def _begin(entry: object) -> int:
    offsets = entry.get("data_offsets") if isinstance(entry, dict) else None
    begin = offsets[0] if isinstance(offsets, list) and offsets else None
    return begin if isinstance(begin, int) else -1


def _entry(entry: Any, where: str) -> tuple[tuple[int, ...], int]:
    """Shape and begin of an array."""
    if not isinstance(entry, dict) or entry.get("dtype") != "F32":
        raise InputError("must be an array of 32-bit floats (F32)", where)
    for key, least, most in (("shape", 0, 8), ("data_offsets", 2, 2)):
        numbers = entry.get(key)
        if (
            not isinstance(numbers, list)
            or not least <= len(numbers) <= most
            or not all(isinstance(number, int) and 0 <= number <= MAXIMUM_BYTES for number in numbers)
        ):
            raise InputError(f"{key} {shortened(numbers)}; must be {least} to {most} whole numbers from 0", where)
    return tuple(entry["shape"]), entry["data_offsets"][0]


def _object(metadata: Mapping[str, str], key: str, where: str) -> dict[str, Any]:
    try:
        found = json.loads(metadata.get(key, ""))
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise InputError(f"{shortened(metadata.get(key))}; must be a JSON object", f"{where}: {key}")
    return found
