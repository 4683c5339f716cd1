"""The cache folder: one that others can write to is not used, and without one there is a temporary one."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path

import pytest

from takeapart import caching
from takeapart.caching import cache_folder, chosen_folder, distrust, planted


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder that the user wants; the temporary folder is `tmp`, so that nothing is left behind."""
    monkeypatch.setenv("TAKEAPART_CACHE", str(tmp_path / "cache"))
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    caching._choose.cache_clear()
    return tmp_path / "cache"


def test_the_wanted_folder_is_made_for_the_user_alone(own: Path) -> None:
    assert cache_folder() == own
    assert chosen_folder().remark == ""
    assert stat.S_IMODE(own.stat().st_mode) == 0o700
    assert list(own.iterdir()) == []


@pytest.mark.parametrize("mode", [0o777, 0o707, 0o1777])
def test_a_folder_that_others_can_write_to_is_not_used(own: Path, mode: int) -> None:
    own.mkdir()
    own.chmod(mode)
    chosen = chosen_folder()
    assert chosen.path == own.parent / "tmp" / f"takeapart-{os.geteuid()}"
    assert stat.S_IMODE(chosen.path.stat().st_mode) == 0o700
    assert chosen.remark == (
        f"the cache folder {own} cannot be trusted: others can write to it; {chosen.path} takes its place "
        "(TAKEAPART_CACHE chooses another)"
    )


def test_nor_is_one_in_whose_place_others_can_put_another(own: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    above = own.parent / "above"
    above.mkdir()
    above.chmod(0o777)
    monkeypatch.setenv("TAKEAPART_CACHE", str(above / "cache"))
    assert f"for {above}: others can write to it" in chosen_folder().remark
    above.chmod(0o1777)  # as of /tmp: nobody can rename what belongs to another
    assert distrust(above / "cache") == ""


def test_a_link_is_followed_once(own: Path) -> None:
    real = own.parent / "real"
    real.mkdir(mode=0o700)
    own.symlink_to(real)
    assert cache_folder() == real


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")
def test_a_folder_of_another_user_is_not_used(own: Path) -> None:
    own.mkdir(mode=0o700)
    os.chown(own, 12345, 12345)
    assert "cannot be trusted: it belongs to another user" in chosen_folder().remark


def test_without_a_place_there_is_a_temporary_one(own: Path) -> None:
    own.write_text("a file where the folder would be")
    chosen = chosen_folder()
    assert chosen.path.parent == own.parent / "tmp"
    assert chosen.remark.startswith(f"the cache folder {own} cannot be written (")


def test_a_temporary_folder_that_somebody_made_before_is_not_used_either(own: Path) -> None:
    own.write_text("")
    taken = own.parent / "tmp" / f"takeapart-{os.geteuid()}"
    taken.mkdir()
    taken.chmod(0o777)
    chosen = chosen_folder().path
    assert chosen != taken and chosen.parent == taken.parent
    assert stat.S_IMODE(chosen.stat().st_mode) == 0o700


def test_what_others_left_is_found(own: Path) -> None:
    kernels = own / "kernels" / "module"
    kernels.mkdir(parents=True)
    index = kernels / "kernel.nbi"
    index.write_bytes(b"")
    for folder in (own, own / "kernels", kernels):
        folder.chmod(0o755)
    index.chmod(0o644)
    assert planted(own) is None
    index.chmod(0o666)
    assert planted(own) == index
    own.chmod(0o700)  # nobody gets at it
    assert planted(own) is None
    (kernels / "link.nbc").symlink_to(index)
    assert planted(own) == kernels / "link.nbc"
