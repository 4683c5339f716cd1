"""The columns of experience files, and the checks that every file passes before a row of it is used."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping
from pathlib import Path

import polars as pl

from takeapart.formats.documents import read_bytes
from takeapart.formats.messages import reason, shortened, shown
from takeapart.model.assembly import Assembly
from takeapart.model.errors import InputError

HASH_LETTERS = 12  # of an assembly's hash in file names
MAXIMUM_FILE_BYTES = 256 * 2**20
MAXIMUM_ROWS = 20_000_000  # of one file
MASK = re.compile(r"0|[1-9a-f][0-9a-f]{0,249}")  # 1000 parts
MAXIMUM_LENGTH = 1000.0  # m, of one removal; assemblies and workcells are smaller by far

SCHEMA: dict[str, pl.DataType] = {
    "assembly": pl.String(),
    "assembly_hash": pl.String(),
    "state": pl.String(),
    "part": pl.UInt16(),
    "reward": pl.Float64(),
    "next_state": pl.String(),
    "next_actions": pl.List(pl.UInt16()),
    "seed": pl.UInt64(),
    "search": pl.String(),
    "bound": pl.Float64(),
    "least": pl.Float64(),
}
NULLABLE = ("bound", "least")


def read_rows(file: Path) -> pl.DataFrame:
    """The columns of a Parquet file.

    Raises:
        InputError: it cannot be read, is too large, no Parquet, or has other columns.
    """
    where = shown(file)
    content = read_bytes(file, MAXIMUM_FILE_BYTES)
    try:
        rows = pl.scan_parquet(io.BytesIO(content)).select(pl.len()).collect().item()
        if rows > MAXIMUM_ROWS:
            raise InputError(f"holds {rows} rows; at most {MAXIMUM_ROWS} are read", where)
        table = pl.read_parquet(io.BytesIO(content))
    except InputError:
        raise
    except (pl.exceptions.PolarsError, OSError, ValueError, OverflowError) as error:
        first = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"is damaged or no Parquet file: {shortened(first)}", where) from None
    except BaseException as error:  # a panic of the Parquet reader derives from BaseException
        if isinstance(error, KeyboardInterrupt | SystemExit | MemoryError):
            raise
        raise InputError(f"is damaged or no Parquet file: {shortened(reason(Exception(error)))}", where) from None
    for name, kind in SCHEMA.items():
        if name not in table.columns:
            raise InputError(f"has no column {name!r}; valid: {', '.join(SCHEMA)}", where)
        if table[name].dtype != kind:
            raise InputError(f"column {name!r} is of type {table[name].dtype}; must be {kind}", where)
        if name not in NULLABLE and table[name].null_count():
            raise InputError(f"column {name!r} has {table[name].null_count()} empty values; none is allowed", where)
    return table.select(list(SCHEMA))


def checked_table(table: pl.DataFrame, assemblies: Mapping[str, Assembly], where: str) -> pl.DataFrame:
    """The same table, if every row of it can have happened.

    Raises:
        InputError: names the first value that cannot be, and what would be valid.
    """
    for key in table["assembly_hash"].unique(maintain_order=True).to_list():
        if key not in assemblies:
            raise InputError(f"is about an assembly {shortened(key)} whose file is not in the folder", where)
    by_name = table.select("assembly", "assembly_hash").unique(maintain_order=True)
    for name, key in by_name.iter_rows():
        if assemblies[key].name != name:
            raise InputError(f"assembly {shortened(name)} has the hash of {assemblies[key].name!r}", where)
    _check_numbers(table, where)
    columns = ("assembly_hash", "state", "part", "next_state", "next_actions")
    for row, (key, state, part, following, actions) in enumerate(table.select(columns).iter_rows()):
        _check_transition(assemblies[key], state, part, following, actions, f"{where}: row {row}")
    return table


def _check_numbers(table: pl.DataFrame, where: str) -> None:
    for name, sign in (("reward", -1.0), ("bound", 1.0), ("least", 1.0)):
        for value in table[name].drop_nulls().unique().to_list():
            limit = MAXIMUM_LENGTH * (1 if name == "reward" else 1000)
            if not math.isfinite(value) or not 0.0 <= sign * value <= limit:
                valid = f"from {-limit:g} to 0 m" if sign < 0 else f"from 0 to {limit:g} m"
                raise InputError(f"{value}; must be {valid}", f"{where}: {name}")


def _check_transition(
    assembly: Assembly, state_text: str, part: int, next_text: str, actions: list[int], where: str
) -> None:
    for text in (state_text, next_text):
        if not MASK.fullmatch(text):
            raise InputError(f"{shortened(text)}; must be a mask in lower-case hexadecimal digits", f"{where}: state")
    state, following = int(state_text, 16), int(next_text, 16)
    if state & ~assembly.root:
        raise InputError(f"{shortened(state_text)} has parts that are not removable or do not exist", f"{where}: state")
    if not state >> part & 1:
        raise InputError(f"{part}; must be one of the parts in the state {shortened(state_text)}", f"{where}: part")
    if following != state & ~(1 << part):
        raise InputError(f"{shortened(next_text)}; must be the state without the part", f"{where}: next_state")
    if any(action is None or not following >> action & 1 for action in actions):
        raise InputError(f"{shortened(actions)}; must be parts in the next state", f"{where}: next_actions")
