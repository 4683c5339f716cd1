"""Where results that only cost time are kept, and why that place can be trusted.

numba reads the machine code of kernels with pickle, so whoever can write to the folder can run code as its reader. A
folder is used only if nobody but its user (and root) can write to it, or put another folder in its place: each folder
from the root down belongs to the user or to root, and others may write to none of them, except for folders such as
/tmp, in which nobody can rename what belongs to somebody else. Where the user's cache folder is no such place, or
cannot be written, a folder of the user's own among the temporary files takes its place.
"""

from __future__ import annotations

import functools
import grp
import os
import pwd
import stat
import tempfile
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from takeapart.model.errors import InputError

VARIABLE = "TAKEAPART_CACHE"

# numpy parses the head of its files as Python, and CPython 3.11 raises a SystemError where two threads parse at once.
_parsing = threading.Lock()


@dataclass(frozen=True)
class CacheFolder:
    """A folder that was found fit for use.

    Args:
        path: the folder, without symbolic links; it exists.
        remark: why it is not the usual one; empty where it is.
    """

    path: Path
    remark: str = ""


def cache_folder() -> Path:
    """The folder for what can be worked out again.

    It is that of TAKEAPART_CACHE, or takeapart/ in the user's cache folder, or a temporary one where that cannot be
    written or cannot be trusted.

    Raises:
        InputError: there is no folder for temporary files either.
    """
    return chosen_folder().path


def chosen_folder() -> CacheFolder:
    """As `cache_folder`, with the reason for a temporary folder. The choice is made once for each wanted folder."""
    return _choose(_wanted_folder())


def _wanted_folder() -> Path | None:
    """None for a user without a home, who says nothing else."""
    own = os.environ.get(VARIABLE)
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    if not own and base.startswith("~"):
        return None
    return Path(own or Path(base) / "takeapart").absolute()


@functools.cache
def _choose(wanted: Path | None) -> CacheFolder:
    reason = unfitness(wanted) if wanted else "cannot be found, for there is no home folder"
    if wanted and not reason:
        return CacheFolder(wanted.resolve())
    name = f"the cache folder {wanted}" if wanted else "the cache folder"
    try:
        temporary = Path(tempfile.gettempdir()).resolve() / f"takeapart-{os.geteuid()}"
        if unfitness(temporary):  # somebody else was there first
            temporary = Path(tempfile.mkdtemp(prefix="takeapart-")).resolve()
    except OSError as error:
        raise InputError(f"{name} {reason}, and none can be made among the temporary files: {error}") from None
    return CacheFolder(temporary, f"{name} {reason}; {temporary} takes its place ({VARIABLE} chooses another)")


def unfitness(folder: Path) -> str:
    """Why a folder cannot be used as a cache, in words that follow its name; empty if it can. It is made if missing."""
    try:
        _make(folder)
        doubt = distrust(folder)
        if doubt:
            return doubt
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        return f"cannot be written ({(error.strerror or str(error)).lower()})"
    return ""


def read_array(file: Path) -> NDArray[Any]:
    """The array of an .npy file, from any thread.

    Raises:
        OSError, ValueError, EOFError: there is no such file, or it is damaged.
    """
    with _parsing:
        found = np.load(file, allow_pickle=False)
    if not isinstance(found, np.ndarray):
        raise ValueError(f"{file} holds several arrays")
    return found


def read_arrays(file: Path) -> dict[str, NDArray[Any]]:
    """All arrays of an .npz file by their names, from any thread.

    Raises:
        OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile: there is no such file, or it is damaged.
    """
    with _parsing:
        found = np.load(file, allow_pickle=False)
        if isinstance(found, np.ndarray):
            raise ValueError(f"{file} holds a single array")
        with found:
            return dict(found)


def _make(folder: Path) -> None:
    """Makes a folder and those above it that are missing, for the user alone."""
    if not folder.is_dir():
        if folder.parent != folder:
            _make(folder.parent)
        folder.mkdir(mode=0o700, exist_ok=True)


def distrust(folder: Path) -> str:
    """Why somebody else could change what stands in a folder, in words that follow its name; empty if nobody could.

    Raises:
        OSError: it cannot be looked at.
    """
    real = folder.resolve(strict=True)
    for place in (real, *real.parents):
        name = "" if place == real else f", for {place}"
        found = place.stat()
        if found.st_uid not in (os.geteuid(), 0):
            return f"cannot be trusted{name}: it belongs to another user"
        # In a folder above with the sticky bit, others can write, but not rename what the user has there.
        if _others_write(found) and (place == real or not found.st_mode & stat.S_ISVTX):
            return f"cannot be trusted{name}: others can write to it"
    return ""


def planted(folder: Path) -> Path | None:
    """The first thing below a folder that somebody else wrote, or can write: left from when the folder was open to all.

    Raises:
        OSError: it cannot be looked at.
    """
    closed = not folder.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO)  # then nobody gets at what stands in it
    for above, folders, files in os.walk(folder):
        for entry in (*folders, *files):
            place = Path(above, entry)
            found = place.lstat()
            if found.st_uid not in (os.geteuid(), 0) or stat.S_ISLNK(found.st_mode):
                return place
            if not closed and _others_write(found):
                return place
    return None


def _others_write(found: os.stat_result) -> bool:
    return bool(found.st_mode & stat.S_IWOTH or (found.st_mode & stat.S_IWGRP and not _alone(found)))


def _alone(found: os.stat_result) -> bool:
    """Whether the group that may write has no member but the user: many systems give every user such a group."""
    try:
        group, user = grp.getgrgid(found.st_gid), pwd.getpwuid(os.geteuid())
    except KeyError:
        return False
    return group.gr_gid == user.pw_gid and group.gr_name == user.pw_name and set(group.gr_mem) <= {user.pw_name}
