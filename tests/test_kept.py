"""Arrays kept in the cache folder: read again as they were, made again where the file is damaged or cannot be kept."""

from __future__ import annotations

import gc
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from takeapart.collision.kept import keep_arrays, kept_arrays
from takeapart.formats.files import load_workcell
from takeapart.robot import covering
from takeapart.robot.kept import keep, kept
from takeapart.robot.loading import load_robot
from takeapart.robot.urdf import meshes


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("TAKEAPART_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.mark.parametrize("array", [np.arange(6.0).reshape(2, 3), np.array([[3, 65535]], dtype=np.uint16)])
def test_what_is_kept_comes_back(folder: Path, array: np.ndarray) -> None:
    assert kept("name") is None
    keep("name", array)
    found = kept("name")
    assert found is not None and found.dtype == array.dtype
    np.testing.assert_array_equal(found, array)
    assert [file.name for file in folder.iterdir()] == ["name.npy"]


@pytest.mark.parametrize("content", [b"", b"\x93NUMPY", b"not an array", b"\x80\x04\x95"])
def test_a_damaged_file_is_as_none(folder: Path, content: bytes) -> None:
    keep("name", np.zeros(3))
    (folder / "name.npy").write_bytes(content)
    assert kept("name") is None


def test_objects_are_never_unpickled(folder: Path) -> None:
    folder.mkdir()
    np.save(folder / "name.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    assert kept("name") is None


def test_a_temporary_place_is_used_where_there_is_none(folder: Path) -> None:
    folder.write_text("a file where the folder would be")
    keep("name", np.arange(3.0))
    np.testing.assert_array_equal(kept("name"), np.arange(3.0))
    assert folder.read_text() == "a file where the folder would be"


@pytest.mark.slow
def test_a_robot_is_the_same_from_kept_arrays_and_from_damaged_ones(folder: Path) -> None:
    first = load_robot(load_workcell("panda"))
    for file in folder.glob("c*.npy"):  # covers and corners, not the tables
        file.write_bytes(file.read_bytes()[:-8])
    covering._kept_cover.cache_clear()
    meshes._file_corners.cache_clear()
    again = load_robot(load_workcell("panda"))
    assert first.pairs == again.pairs
    for before, after in zip(first.arm, again.arm, strict=True):
        np.testing.assert_array_equal(before, after)


def test_threads_read_at_once(folder: Path) -> None:
    """Python 3.11 fails where another thread parses while the collector of garbage runs in the middle of parsing, and
    numpy parses the head of its files."""
    keep("name", np.arange(3.0))
    keep_arrays("names", {"first": np.arange(3.0), "second": np.eye(2)})

    def give_way(phase: str, info: dict[str, int]) -> None:
        time.sleep(0)

    before = gc.get_threshold()
    gc.callbacks.append(give_way)
    gc.set_threshold(20)
    try:
        with ThreadPoolExecutor(8) as pool:
            single = [pool.submit(kept, "name") for _ in range(200)]
            several = [pool.submit(kept_arrays, "names", {"first": 1, "second": 2}) for _ in range(100)]
    finally:
        gc.set_threshold(*before)
        gc.callbacks.remove(give_way)
    for job in single:
        np.testing.assert_array_equal(job.result(), np.arange(3.0))
    assert all(found is not None and found["second"].shape == (2, 2) for found in (job.result() for job in several))
