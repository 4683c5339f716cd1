"""What searches have seen, on disk: every removal that was planned, as rows of Parquet files in a folder.

    <assembly>-<hash>.assembly.json          the assembly that the rows are about
    <assembly>-<hash>-<writer>-<n>.parquet   rows, one file per flush

A file appears whole or not at all, so a folder can be read while searches write to it, and a search that is killed
loses at most the rows that it had not flushed. Any number of searches, of any assemblies, may write to one folder.
docs/file-formats.md describes the columns.
"""

from __future__ import annotations

import hashlib
import io
import math
import secrets
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any

import polars as pl

from takeapart.formats.documents import require_names, write_atomically
from takeapart.formats.files import load_assembly, save_assembly
from takeapart.formats.messages import reason, shown
from takeapart.formats.serialization import assembly_hash
from takeapart.guide.experience_checks import HASH_LETTERS, SCHEMA, checked_table, read_rows
from takeapart.model.assembly import Assembly
from takeapart.model.errors import InputError, UnknownNameError

ASSEMBLY_ENDING = ".assembly.json"
ORDER = ("assembly_hash", "state", "part", "reward", "next_state", "seed", "search", "bound", "least")
OWN_COLUMNS = ("state", "part", "reward", "next_state", "next_actions", "bound", "least")  # others hold for all rows
TOLERANCE = 1e-6  # m; a cost to the goal that is known this well is known

Values = Mapping[int, Mapping[int, float]]
"""State -> part -> optimal Q-value, m, where known."""


class ExperienceWriter:
    """Writes what one search sees; a context manager, and `observe` may be called from any thread.

    Args:
        path: folder, made if it does not exist.
        assembly: that is searched; kept in the folder too.
        seed: of the search.
        search: its name.
        flush_rows: rows kept in memory at most.
        flush_seconds: age of the oldest unflushed row at which the next one flushes, s.

    Raises:
        InputError: the folder or a file cannot be written (also from `observe` and `close`).
    """

    def __init__(
        self,
        path: Path,
        assembly: Assembly,
        *,
        seed: int,
        search: str,
        flush_rows: int = 20_000,
        flush_seconds: float = 30.0,
    ) -> None:
        self.path, self.rows = path, 0
        self._hash = assembly_hash(assembly)
        self._constant = {"assembly": assembly.name, "assembly_hash": self._hash, "seed": seed, "search": search}
        self._stem = f"{assembly.name}-{self._hash[:HASH_LETTERS]}"
        self._writer, self._files = secrets.token_hex(6), 0  # no two writers share a name
        self._flush_rows, self._flush_seconds = flush_rows, flush_seconds
        self._waiting: list[tuple[str, int, float, str, list[int], float | None, float | None]] = []
        self._oldest = 0.0
        self._lock = threading.Lock()
        try:
            require_names(path)
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"no folder for experience can be made there: {reason(error)}", shown(path)) from None
        known = path / f"{self._stem}{ASSEMBLY_ENDING}"
        if not known.exists():
            save_assembly(assembly, known)

    def __enter__(self) -> ExperienceWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def observe(self, state: int, part: int, reward: float, next_state: int, next_candidates: Sequence[int]) -> None:
        """Take a planned removal; has the form of `search.mcts.TransitionObserver`.

        Args:
            reward: minus the length of the removal, m.
            next_candidates: parts that gravity and lifting let go in the next state.
        """
        self._take(state, part, reward, next_state, next_candidates, None, None)

    def observe_settled(
        self,
        state: int,
        part: int,
        reward: float,
        next_state: int,
        next_candidates: Sequence[int],
        least: float,
        most: float,
    ) -> None:
        """Take a removal of which exact search bounds the cost to the goal; `search.exact.SettledObserver`.

        Args:
            least, most: between them is the length of the shortest sequence that begins with this removal, m: minus
                the optimal Q-value.
        """
        known = most if most - least <= TOLERANCE else None
        self._take(state, part, reward, next_state, next_candidates, known, min(least, most))

    def close(self) -> None:
        """Write what is left."""
        with self._lock:
            self._flush()

    def _take(
        self,
        state: int,
        part: int,
        reward: float,
        next_state: int,
        candidates: Sequence[int],
        bound: float | None,
        least: float | None,
    ) -> None:
        actions = sorted(int(candidate) for candidate in candidates)
        row = (f"{state:x}", int(part), float(reward), f"{next_state:x}", actions, bound, least)
        with self._lock:
            if not self._waiting:
                self._oldest = time.monotonic()
            self._waiting.append(row)
            self.rows += 1
            if len(self._waiting) >= self._flush_rows or time.monotonic() - self._oldest > self._flush_seconds:
                self._flush()

    def _flush(self) -> None:
        if not self._waiting:
            return
        columns = zip(*self._waiting, strict=True)
        changing = dict(zip(OWN_COLUMNS, columns, strict=True))
        count = len(self._waiting)
        data = {name: changing[name] if name in changing else [self._constant[name]] * count for name in SCHEMA}
        content = io.BytesIO()
        pl.DataFrame(data, schema=SCHEMA).write_parquet(content, compression="zstd")
        write_atomically(self.path / f"{self._stem}-{self._writer}-{self._files:06d}.parquet", content.getvalue())
        self._files += 1
        self._waiting = []


@dataclass(frozen=True, eq=False)
class Experience:
    """Planned removals of some assemblies.

    Args:
        table: with the columns of docs/file-formats.md, in an order that depends on its content alone.
        assemblies: by their hashes; every hash in the table is among them.
    """

    table: pl.DataFrame
    assemblies: Mapping[str, Assembly]

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the content of all rows; does not depend on how they are spread over files."""
        digest = hashlib.sha256()
        for name in ORDER:
            column = self.table[name]
            if column.dtype == pl.Float64:
                digest.update(column.fill_null(float("nan")).to_numpy().astype("<f8").tobytes())
            else:
                digest.update("\n".join(str(value) for value in column.to_list()).encode())
            digest.update(b"\0")
        return digest.hexdigest()

    @property
    def names(self) -> list[str]:
        """Names of the assemblies that have rows, ascending."""
        return sorted(set(self.table["assembly"].to_list()))

    def only(self, names: Sequence[str]) -> Experience:
        """The rows of some assemblies.

        Raises:
            UnknownNameError: there are no rows of an assembly of that name.
        """
        known = self.names
        for name in names:
            if name not in known:
                raise UnknownNameError("assembly", name, known, "experience")
        return self._where(pl.col("assembly").is_in(list(names)))

    def without(self, names: Sequence[str]) -> Experience:
        """The rows of all other assemblies; for leaving one out (Sec. VII-B)."""
        return self._where(~pl.col("assembly").is_in(list(names)))

    def _where(self, condition: pl.Expr) -> Experience:
        table = self.table.filter(condition)
        kept = set(table["assembly_hash"].unique().to_list())
        return Experience(table, {key: value for key, value in self.assemblies.items() if key in kept})


def read_experience(path: Path | Sequence[Path]) -> Experience:
    """All rows of one or several folders.

    Raises:
        InputError: a folder is missing, empty, or holds a broken file; the message names the file, what is wrong, and
            what is valid.
    """
    folders = [path] if isinstance(path, Path) else list(path)
    tables: list[pl.DataFrame] = []
    assemblies: dict[str, Assembly] = {}
    for folder in folders:
        for file in _files(folder, ASSEMBLY_ENDING):
            assembly = load_assembly(file)
            assemblies[assembly_hash(assembly)] = assembly
    for folder in folders:
        files = _files(folder, ".parquet")
        if not files:
            raise InputError("holds no experience; record some with: takeapart plan --experience DIR", shown(folder))
        tables += [checked_table(read_rows(file), assemblies, shown(file)) for file in files]
    table = pl.concat(tables).sort(ORDER, nulls_last=True, maintain_order=True)
    used = set(table["assembly_hash"].unique().to_list())
    return Experience(table, {key: assemblies[key] for key in sorted(used)})


def together(experiences: Sequence[Experience]) -> Experience:
    """All rows of several."""
    table = pl.concat([each.table for each in experiences]).sort(ORDER, nulls_last=True, maintain_order=True)
    return Experience(table, {key: value for each in experiences for key, value in each.assemblies.items()})


def known_values(experience: Experience) -> Values:
    """Q-values that exact search knows, m, in states with a choice; of one assembly."""
    values: dict[int, dict[int, float]] = {}
    rows = experience.table.filter(pl.col("bound").is_not_null()).select("state", "part", "bound")
    for state, part, cost in rows.iter_rows():
        parts = values.setdefault(int(state, 16), {})
        parts[part] = max(-cost, parts.get(part, -math.inf))
    return {state: parts for state, parts in values.items() if len(parts) > 1}


def data_card(path: Path | Sequence[Path]) -> dict[str, Any]:
    """What a data set holds, with counts and hashes.

    Raises:
        InputError: as `read_experience`.
    """
    experience = read_experience(path)
    rows = []
    for key, assembly in sorted(experience.assemblies.items(), key=lambda item: item[1].name):
        table = experience.table.filter(pl.col("assembly_hash") == key)
        rows.append(
            {
                "assembly": assembly.name,
                "assembly_hash": key,
                "removable_parts": assembly.root.bit_count(),
                "rows": table.height,
                "states": table["state"].n_unique(),
                "edges": table.select("state", "part").n_unique(),
                "with_bound": int(table["bound"].is_not_null().sum()),
                "searches": sorted(set(table["search"].to_list())),
                "seeds": sorted(set(table["seed"].to_list())),
                "mean_reward": float(sum(table["reward"].to_list()) / table.height),
            }
        )
    return {"rows": experience.table.height, "hash": experience.hash, "assemblies": rows}


def card_markdown(card: Mapping[str, Any]) -> str:
    """A data card as Markdown."""
    lines = [
        f"{card['rows']} planned removals of {len(card['assemblies'])} assemblies, hash `{card['hash'][:16]}`.",
        "",
        "| assembly | hash | parts | rows | states | edges | with bound | searches | seeds | mean reward, m |",
        "|---|---|---:|---:|---:|---:|---:|---|---|---:|",
    ]
    for row in card["assemblies"]:
        cells = [row["assembly"], f"`{row['assembly_hash'][:HASH_LETTERS]}`", row["removable_parts"], row["rows"]]
        cells += [row["states"], row["edges"], row["with_bound"], ", ".join(row["searches"])]
        cells += [", ".join(str(seed) for seed in row["seeds"]), f"{row['mean_reward']:.3f}"]
        lines.append("| " + " | ".join(str(cell) for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def _files(folder: Path, ending: str) -> list[Path]:
    """Files of a folder with an ending, by name; half-written ones end in .tmp and are not among them."""
    try:
        return sorted(file for file in folder.iterdir() if file.name.endswith(ending))
    except OSError as error:
        raise InputError(f"no folder of experience: {reason(error)}", shown(folder)) from None
