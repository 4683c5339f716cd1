"""Documents: text files that hold plain data. Reading has limits, writing leaves all or nothing.

JSON here is stricter than Python's: a key may stand only once in an object, integers have at most 40 digits.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import secrets
import stat
import tomllib
from pathlib import Path

from takeapart.formats.messages import reason, shortened, shown
from takeapart.model.errors import InputError

MAXIMUM_CONTAINERS = 2_000_000  # opening brackets: bounds the memory that a document may take
MAXIMUM_VALUES = 10_000_000  # commas, likewise
MAXIMUM_DIGITS = 40
MAXIMUM_TOML_KEY = 1000  # dots in a row of keys; the standard library needs quadratic time for them
LINE_LENGTH = 110  # of what is written


def read_json(path: str | os.PathLike[str], maximum_bytes: int) -> object:
    """Plain data of a JSON file; NaN and infinities pass, so that the schema can say where they stand.

    Raises:
        InputError: the file cannot be read, is larger than `maximum_bytes`, or is not JSON; with line and column.
    """
    where, text = shown(path), _read_text(path, maximum_bytes)
    _check_extent(text, where)
    try:
        return json.loads(text, object_pairs_hook=_once, parse_int=_whole_number)
    except json.JSONDecodeError as error:
        end = error.pos >= len(text.rstrip()) or error.msg.startswith("Unterminated")
        cause = "it ends too early" if end else error.msg[:1].lower() + error.msg[1:]
        raise InputError(f"not valid JSON: {cause} (line {error.lineno}, column {error.colno})", where) from None
    except _Refused as error:
        raise InputError(str(error), where) from None
    except RecursionError:
        raise InputError("nested too deeply", where) from None


def read_toml(path: str | os.PathLike[str], maximum_bytes: int) -> object:
    """Plain data of a TOML file.

    Raises:
        InputError: the file cannot be read, is larger than `maximum_bytes`, or is not TOML; with line and column.
    """
    where, text = shown(path), _read_text(path, maximum_bytes)
    if re.search(rf"(?:\.[^.\n]*){{{MAXIMUM_TOML_KEY}}}", text):
        raise InputError(f"not valid TOML: a line with more than {MAXIMUM_TOML_KEY} dots", where)
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        message = str(error)
        raise InputError(f"not valid TOML: {message[:1].lower() + message[1:]}", where) from None
    except RecursionError:
        raise InputError("nested too deeply", where) from None
    except ValueError:  # a number or date that Python cannot hold
        raise InputError("not valid TOML: it holds a number with too many digits", where) from None


class _Refused(Exception):
    """Found while parsing, where the file's name is not known."""


def _once(pairs: list[tuple[str, object]]) -> dict[str, object]:
    found = dict(pairs)
    if len(found) < len(pairs):
        keys: set[str] = set()
        for key, _ in pairs:
            if key in keys:
                raise _Refused(f"the key {shortened(key)} stands twice in one object; it may stand only once")
            keys.add(key)
    return found


def _whole_number(digits: str) -> int:
    if len(digits) > MAXIMUM_DIGITS:
        raise _Refused(f"a number with {len(digits)} digits; at most {MAXIMUM_DIGITS} are allowed")
    return int(digits)


def _check_extent(text: str, where: str) -> None:
    containers = text.count("[") + text.count("{")
    if containers > MAXIMUM_CONTAINERS:
        raise InputError(f"holds {containers} lists and objects; at most {MAXIMUM_CONTAINERS} are allowed", where)
    values = text.count(",")
    if values > MAXIMUM_VALUES:
        raise InputError(f"holds more than {MAXIMUM_VALUES} values", where)


def read_bytes(path: str | os.PathLike[str], maximum_bytes: int) -> bytes:
    """The content of a regular file.

    Raises:
        InputError: the file cannot be read, is empty, or is larger than `maximum_bytes`.
    """
    where = shown(path)
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # a pipe without a writer must not wait
    except FileNotFoundError:
        raise InputError("there is no such file", where) from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        raise InputError(f"cannot be read: {reason(error)}", where) from None
    try:
        mode = os.fstat(descriptor).st_mode
        if not stat.S_ISREG(mode):
            raise InputError("is a folder, not a file" if stat.S_ISDIR(mode) else "is not a regular file", where)
        with open(descriptor, "rb", closefd=False) as file:
            content = file.read(maximum_bytes + 1)
    except OSError as error:
        raise InputError(f"cannot be read: {reason(error)}", where) from None
    finally:
        os.close(descriptor)
    if len(content) > maximum_bytes:
        raise InputError(f"is larger than {maximum_bytes / 2**20:g} MiB, the most that is read", where)
    if not content.strip():
        raise InputError("the file is empty", where)
    return content


def _read_text(path: str | os.PathLike[str], maximum_bytes: int) -> str:
    where, content = shown(path), read_bytes(path, maximum_bytes)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise InputError(f"not a text file: byte {error.start} (line {line}) is not UTF-8", where) from None


def canonical_json(data: object) -> str:
    """JSON with sorted keys and without spaces: the same text for the same data, for hashes."""
    return json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)


def readable_json(data: object) -> str:
    """JSON for people: one row of numbers per line, small objects on one line, keys in the order given."""
    return _layout(data, 0) + "\n"


def _layout(value: object, indent: int) -> str:
    if not isinstance(value, dict | list) or not value:
        return json.dumps(value, allow_nan=False)
    children = list(value.values()) if isinstance(value, dict) else value
    if not any(isinstance(child, dict | list) for child in children):
        line = json.dumps(value, allow_nan=False)
        if len(line) <= LINE_LENGTH or all(isinstance(child, int | float) for child in children):
            return line
    space = "  " * (indent + 1)
    if isinstance(value, dict):
        rows = [f"{space}{json.dumps(key)}: {_layout(child, indent + 1)}" for key, child in value.items()]
        if len(rows) <= 4 and not any("\n" in row for row in rows):  # a small object whose values are flat
            line = "{" + ", ".join(row.strip() for row in rows) + "}"
            if len(line) <= LINE_LENGTH:
                return line
        return "{\n" + ",\n".join(rows) + "\n" + "  " * indent + "}"
    return "[\n" + ",\n".join(space + _layout(child, indent + 1) for child in value) + "\n" + "  " * indent + "]"


def write_atomically(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write a file so that it holds, whatever happens, either all that it held before or all of `content`.

    A temporary file in the same folder is filled, brought to the disk, and renamed. Folders that are missing are made.

    Raises:
        InputError: the folder cannot be made, is read-only or full; the name stands for something that is no file.
    """
    where = shown(path)
    data = content.encode() if isinstance(content, str) else content
    try:
        target = _target(path, where)
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary = target.with_name(f".{target.name[:100]}.{secrets.token_hex(6)}.tmp")
        try:
            _fill(temporary, data, target)
            os.replace(temporary, target)
        except BaseException:  # also Ctrl-C: nothing half written stays behind
            with contextlib.suppress(OSError):
                os.unlink(temporary)
            raise
        _flush_folder(target.parent)
    except (OSError, ValueError) as error:
        full = isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        cause = f"no space is left ({reason(error)})" if full else reason(error)
        raise InputError(f"cannot be written: {cause}", where) from None


def require_writable(path: str | os.PathLike[str]) -> None:
    """Finds out, before the work starts, whether `write_atomically` could write a file; nothing is left behind.

    Raises:
        InputError: it could not: a folder is no folder or closed, the name is too long or stands for something else.
    """
    where = shown(path)
    try:
        target = _target(path, where)
        folder = target.parent
        while not folder.exists():
            folder = folder.parent
        if not folder.is_dir():
            raise InputError(f"cannot be written: {shown(folder)} is a file, not a folder", where)
        require_names(target)
        probe = folder / f".{target.name[:100]}.{secrets.token_hex(6)}.tmp"
        os.close(os.open(probe, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600))
        os.unlink(probe)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be written: {reason(error)}", where) from None


def require_names(path: Path) -> None:
    """Finds out whether all names of a path are possible, also those below a folder that is not there yet.

    The system itself looks no further than to the first that is missing.

    Raises:
        OSError: a name is too long for its file system.
    """
    folder = path.absolute()
    missing: list[str] = []
    while not folder.exists() and folder != folder.parent:
        missing.append(folder.name)
        folder = folder.parent
    for name in missing:
        with contextlib.suppress(FileNotFoundError):
            os.stat(folder / name)


def _target(path: str | os.PathLike[str], where: str) -> Path:
    """The file behind all links, if one may be written there."""
    if os.fspath(path).endswith(os.sep):
        raise InputError("cannot be written: the name ends in '/' and stands for a folder; give that of a file", where)
    target = Path(os.path.realpath(path))
    try:
        mode = os.stat(target).st_mode
    except FileNotFoundError:
        return target
    if stat.S_ISDIR(mode):
        raise InputError("cannot be written: it is a folder; give the name of a file", where)
    if not stat.S_ISREG(mode):  # replacing a device would be worse than refusing it
        raise InputError("cannot be written: it is not a regular file", where)
    if not os.access(target, os.W_OK):
        raise InputError("cannot be written: the file is read-only", where)
    return target


def _fill(temporary: Path, data: bytes, target: Path) -> None:
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
    with os.fdopen(descriptor, "wb") as file:
        if target.exists():
            os.fchmod(descriptor, stat.S_IMODE(target.stat().st_mode))
        file.write(data)
        file.flush()
        os.fsync(descriptor)


def _flush_folder(folder: Path) -> None:
    """Bring the renaming to the disk; some file systems cannot, and then the file is still whole."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
