"""Weights files: what other programs read, and that nothing broken is believed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import safetensors
import safetensors.numpy

from guide_cases import blocks
from takeapart.guide.architecture import Architecture
from takeapart.guide.policy import load_guide
from takeapart.guide.weights import Weights, load_weights, save_weights
from takeapart.model.errors import InputError

ARCHITECTURE = Architecture(2, 6)


def drawn_weights(seed: int = 0) -> Weights:
    rng = np.random.default_rng(seed)
    arrays = {
        name: np.abs(rng.normal(size=shape)).astype(np.float32) + np.float32(0.1)
        for name, shape in ARCHITECTURE.shapes().items()
    }
    return Weights(ARCHITECTURE, arrays, {"experience": "0" * 64, "options": {"seed": seed}})


def test_what_is_saved_is_loaded(tmp_path: Path) -> None:
    weights = drawn_weights()
    save_weights(weights, tmp_path / "a.safetensors")
    save_weights(drawn_weights(), tmp_path / "b.safetensors")
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()
    loaded = load_weights(tmp_path / "a.safetensors")
    assert loaded.architecture == ARCHITECTURE and loaded.training == weights.training
    assert loaded.hash == weights.hash != drawn_weights(1).hash
    for name, array in weights.arrays.items():
        assert loaded.arrays[name].shape == array.shape and (loaded.arrays[name] == array).all()


def test_the_library_of_the_format_reads_and_writes_the_same_file(tmp_path: Path) -> None:
    weights, path = drawn_weights(), tmp_path / "guide.safetensors"
    save_weights(weights, path)
    found = safetensors.numpy.load_file(path)
    assert set(found) == set(weights.arrays)
    assert all((found[name] == weights.arrays[name]).all() for name in found)
    with safetensors.safe_open(path, "numpy") as file:
        metadata = file.metadata()
    assert metadata["format"] == "takeapart/guide" and metadata["hash"] == weights.hash
    assert json.loads(metadata["training"]) == weights.training
    safetensors.numpy.save_file(found, path, metadata=metadata)
    assert load_weights(path).hash == weights.hash


def changed(tmp_path: Path, metadata: dict[str, str] | None = None, **arrays: np.ndarray | None) -> Path:
    """A file that the library wrote, with some arrays or metadata replaced (None: left out)."""
    path = tmp_path / "guide.safetensors"
    save_weights(drawn_weights(), path)
    with safetensors.safe_open(path, "numpy") as file:
        stated = dict(file.metadata()) | (metadata or {})
    found = {**safetensors.numpy.load_file(path), **{key.replace("__", "."): a for key, a in arrays.items()}}
    safetensors.numpy.save_file({key: a for key, a in found.items() if a is not None}, path, metadata=stated)
    return path


@pytest.mark.parametrize(
    ("metadata", "arrays", "message"),
    [
        ({"format": "other"}, {}, "is no guide: format 'other', version '1'; must be format 'takeapart/guide'"),
        ({"version": "2"}, {}, "version '2'; must be"),
        ({"architecture": "[]"}, {}, "architecture: '[]'; must be a JSON object"),
        ({"architecture": '{"layers": 2}'}, {}, "must hold the whole numbers layers and width"),
        ({"architecture": '{"layers": true, "width": 6}'}, {}, "must hold the whole numbers layers and width"),
        ({"architecture": '{"layers": 99, "width": 6}'}, {}, "architecture.layers: 99; must be from 1 to 16"),
        ({"architecture": '{"layers": 3, "width": 6}'}, {}, "has no array 'layers.2.edge.0.weight'"),
        ({"architecture": '{"layers": 1, "width": 6}'}, {}, "has an array 'layers.1.edge.0.bias' that is not part"),
        ({"training": "no"}, {}, "training: 'no'; must be a JSON object"),
        ({"hash": "0" * 64}, {}, "do not have the hash that the file states"),
        ({}, {"node_mean": np.zeros(24, np.float32)}, "do not have the hash that the file states"),
        ({}, {"node_mean": np.zeros(23, np.float32)}, "node_mean: has shape (23,); must be (24,)"),
        ({}, {"node_mean": np.zeros(24, np.float64)}, "must be an array of 32-bit floats (F32)"),
        ({}, {"node_mean": np.full(24, np.nan, np.float32)}, "node_mean: holds numbers that are not finite"),
        ({}, {"node_scale": np.zeros(24, np.float32)}, "node_scale: every scale must be above 0"),
        ({}, {"value__0__bias": None}, "has no array 'value.0.bias'"),
    ],
)
def test_files_that_are_no_guide_are_refused(
    tmp_path: Path, metadata: dict[str, str], arrays: dict[str, np.ndarray | None], message: str
) -> None:
    path = changed(tmp_path, metadata, **arrays)
    with pytest.raises(InputError) as error:
        load_weights(path)
    assert message in str(error.value) and "\n" not in str(error.value)
    assert str(error.value).startswith(str(path))


def test_broken_bytes_are_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "guide.safetensors"
    save_weights(drawn_weights(), path)
    content = path.read_bytes()
    rng = np.random.default_rng(0)
    cases = [content[: int(cut)] for cut in rng.integers(0, len(content), 40)]
    for _ in range(200):
        damaged = bytearray(content)
        damaged[int(rng.integers(len(content)))] ^= int(rng.integers(1, 256))
        cases.append(bytes(damaged))
    cases += [b"", b"\xff" * 64, (2**40).to_bytes(8, "little") + b"{}", content + b"more", b"\2" + bytes(7) + b"{}"]
    refused = 0
    for case in cases:
        path.write_bytes(case)
        try:
            load_weights(path)
        except InputError as error:
            refused += 1
            assert "\n" not in str(error) and str(path) in str(error)
    assert refused >= len(cases) - 12  # a changed letter in the description of the training goes unnoticed


def test_a_header_cannot_claim_more_than_there_is(tmp_path: Path) -> None:
    path = tmp_path / "guide.safetensors"
    for shape, offsets in (([2**26], [0, 2**28]), ([10], [0, 40]), ([-1], [0, 4]), ([1] * 9, [0, 4]), ([1], [4, 8])):
        header = json.dumps({"a": {"dtype": "F32", "shape": shape, "data_offsets": offsets}}).encode()
        path.write_bytes(len(header).to_bytes(8, "little") + header + bytes(8))
        with pytest.raises(InputError):
            load_weights(path)
    with pytest.raises(InputError, match="no such file"):
        load_guide(tmp_path / "none.safetensors", blocks(3))
