"""Experience on disk: what is written comes back, also after a kill, and nothing broken is believed."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import takeapart
from small_assemblies import three_bars, two_bars
from synthetic import random_problem
from takeapart.formats.serialization import assembly_hash
from takeapart.guide.experience import ExperienceWriter, card_markdown, data_card, read_experience
from takeapart.model.assembly import members
from takeapart.model.errors import InputError, UnknownNameError
from takeapart.search.mcts import MctsOptions, mcts
from takeapart.search.result import Budget


def write_order(folder: Path, order: list[int], flush_rows: int = 20_000, seed: int = 3) -> None:
    """One removal after the other, with rewards -0.5, -0.6, ..."""
    assembly = three_bars()
    with ExperienceWriter(folder, assembly, seed=seed, search="mcts", flush_rows=flush_rows) as writer:
        state = assembly.root
        for number, part in enumerate(order):
            following = state & ~(1 << part)
            writer.observe(state, part, -0.5 - 0.1 * number, following, members(following))
            state = following


def test_rows_come_back_as_they_were_written(tmp_path: Path) -> None:
    assembly = three_bars()
    first, second, third = members(assembly.root)
    write_order(tmp_path, [first, third, second])
    with ExperienceWriter(tmp_path, assembly, seed=4, search="exact") as writer:
        writer.observe_settled(1 << second, second, -0.7, 0, [], 0.7, 0.7)
        writer.observe_settled(1 << third, third, -0.9, 0, [], 0.8, 0.9)
    experience = read_experience(tmp_path)
    rows = {(row["state"], row["part"]): row for row in experience.table.iter_rows(named=True)}
    start = rows[f"{assembly.root:x}", first]
    assert start["next_state"] == f"{assembly.root & ~(1 << first):x}"
    assert start["next_actions"] == [second, third]
    assert (start["reward"], start["seed"], start["search"], start["bound"]) == (-0.5, 3, "mcts", None)
    assert (start["assembly"], start["assembly_hash"]) == (assembly.name, assembly_hash(assembly))
    exact = experience.table.filter((pl.col("search") == "exact") & (pl.col("part") == second)).row(0, named=True)
    assert (exact["bound"], exact["least"], exact["next_state"], exact["next_actions"]) == (0.7, 0.7, "0", [])
    bounded = experience.table.filter((pl.col("search") == "exact") & (pl.col("part") == third)).row(0, named=True)
    assert (bounded["bound"], bounded["least"], bounded["seed"]) == (None, 0.8, 4)
    assert [part.name for part in experience.assemblies[assembly_hash(assembly)].parts] == [
        part.name for part in assembly.parts
    ]


def test_hash_and_order_depend_on_content_alone(tmp_path: Path) -> None:
    order = members(three_bars().root)
    write_order(tmp_path / "one", order)
    write_order(tmp_path / "many", order, flush_rows=1)
    assert len(list((tmp_path / "many").glob("*.parquet"))) == 3
    one, many = read_experience(tmp_path / "one"), read_experience(tmp_path / "many")
    assert one.table.equals(many.table)
    assert one.hash == many.hash
    write_order(tmp_path / "other", order, seed=5)
    assert read_experience(tmp_path / "other").hash != one.hash
    both = read_experience([tmp_path / "one", tmp_path / "other"])
    assert both.table.height == 6


def test_leaving_an_assembly_out(tmp_path: Path) -> None:
    write_order(tmp_path, members(three_bars().root))
    small = two_bars()
    part = members(small.root)[0]
    with ExperienceWriter(tmp_path, small, seed=0, search="mcts") as writer:
        writer.observe(small.root, part, -0.4, small.root & ~(1 << part), [])
    experience = read_experience(tmp_path)
    assert experience.names == ["three-bars", "two-bars"]
    kept = experience.without(["two-bars"])
    assert kept.names == ["three-bars"] and list(kept.assemblies) == [assembly_hash(three_bars())]
    assert experience.only(["two-bars"]).table.height == 1
    with pytest.raises(UnknownNameError, match="valid: three-bars, two-bars"):
        experience.only(["none"])


def test_all_that_a_search_plans_is_recorded_from_many_threads(tmp_path: Path) -> None:
    problem = random_problem(3, 1)
    assembly = three_bars()
    numbers = dict(enumerate(members(assembly.root)))

    def mask(state: int) -> int:
        return sum(1 << numbers[part] for part in members(state))

    told: list[tuple[int, int, float]] = []
    with ExperienceWriter(tmp_path, assembly, seed=0, search="mcts", flush_rows=7) as writer:

        def observe(state: int, part: int, reward: float, following: int, after: object) -> None:
            told.append((mask(state), numbers[part], reward))
            writer.observe(mask(state), numbers[part], reward, mask(following), [])

        mcts(problem, MctsOptions(patience=3), Budget(episodes=5), np.random.default_rng(0), observe=observe)

        def observe_often() -> None:
            for _ in range(50):
                writer.observe(1 << numbers[0], numbers[0], -0.25, 0, [])

        threads = [threading.Thread(target=observe_often) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    rows = read_experience(tmp_path).table
    assert rows.height == len(told) + 200 == writer.rows
    written = sorted((int(row["state"], 16), row["part"], row["reward"]) for row in rows.iter_rows(named=True))
    assert written == sorted(told + [(1 << numbers[0], numbers[0], -0.25)] * 200)


ENDLESS = """
import sys
from pathlib import Path
from small_assemblies import three_bars
from takeapart.model.assembly import members
from takeapart.guide.experience import ExperienceWriter

assembly = three_bars()
part = members(assembly.root)[0]
following = assembly.root & ~(1 << part)
writer = ExperienceWriter(Path(sys.argv[1]), assembly, seed=0, search="mcts", flush_rows=500)
number = 0
while True:
    number += 1
    writer.observe(assembly.root, part, -number / 1e6, following, members(following))
"""


def test_a_kill_while_writing_loses_only_what_was_not_flushed(tmp_path: Path) -> None:
    root = Path(takeapart.__file__).resolve().parents[1]
    environment = {"PYTHONPATH": f"{root}:{Path(__file__).parent}", "PATH": ""}
    for trial in range(3):
        folder = tmp_path / str(trial)
        process = subprocess.Popen([sys.executable, "-c", ENDLESS, str(folder)], env=environment)
        end = time.monotonic() + 60
        while len(list(folder.glob("*.parquet"))) < 3 + trial and time.monotonic() < end:
            time.sleep(0.001)
        process.send_signal(signal.SIGKILL)
        process.wait()
        table = read_experience(folder).table
        files = len(list(folder.glob("*.parquet")))
        assert files >= 3
        assert table.height == 500 * files
        assert sorted(-table["reward"] * 1e6) == pytest.approx(list(range(1, table.height + 1)))  # the first, in a row


def test_a_half_written_file_is_not_looked_at(tmp_path: Path) -> None:
    write_order(tmp_path, members(three_bars().root))
    (tmp_path / ".three-bars-0.parquet.1a.tmp").write_bytes(b"PAR1 and no more")
    assert read_experience(tmp_path).table.height == 3


def broken(folder: Path, **columns: Any) -> None:
    """A folder whose rows are as given instead of true ones."""
    write_order(folder, members(three_bars().root))
    file = next(folder.glob("*.parquet"))
    table = pl.read_parquet(file)
    table.with_columns(*(pl.Series(name, value, strict=False) for name, value in columns.items())).write_parquet(file)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"state": ["xyz"] * 3}, "row 0: state: 'xyz'; must be a mask in lower-case hexadecimal digits"),
        ({"state": ["ffff"] * 3}, "has parts that are not removable or do not exist"),
        ({"next_state": ["0"] * 3}, "must be the state without the part"),
        ({"part": pl.Series([900] * 3, dtype=pl.UInt16)}, "900; must be one of the parts in the state"),
        ({"reward": [-0.5, float("nan"), -0.5]}, "reward: nan; must be from -1000 to 0 m"),
        ({"reward": [0.5] * 3}, "reward: 0.5; must be from -1000 to 0 m"),
        ({"reward": [None, -0.5, -0.5]}, "column 'reward' has 1 empty values; none is allowed"),
        ({"bound": [-1.0, None, None]}, "bound: -1.0; must be from 0 to 1e+06 m"),
        ({"seed": ["a"] * 3}, "column 'seed' is of type String; must be UInt64"),
        ({"assembly_hash": ["0" * 64] * 3}, "whose file is not in the folder"),
        ({"assembly": ["other"] * 3}, "assembly 'other' has the hash of 'three-bars'"),
        (
            {"next_actions": pl.Series([[0], [0], [0]], dtype=pl.List(pl.UInt16))},
            "next_actions: [0]; must be parts in the next state",
        ),
    ],
)
def test_rows_that_cannot_be_are_refused(tmp_path: Path, columns: dict[str, Any], message: str) -> None:
    broken(tmp_path, **columns)
    with pytest.raises(InputError) as error:
        read_experience(tmp_path)
    assert message in str(error.value)
    assert "\n" not in str(error.value) and str(tmp_path) in str(error.value)


def test_files_that_are_no_experience_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no folder of experience"):
        read_experience(tmp_path / "none")
    with pytest.raises(InputError, match="holds no experience"):
        read_experience(tmp_path)
    write_order(tmp_path, members(three_bars().root))
    file = next(tmp_path.glob("*.parquet"))
    content = file.read_bytes()
    for cut in (content[: len(content) // 2], content[:4] + bytes(len(content) - 8) + content[-4:], b"PAR1PAR1", b""):
        file.write_bytes(cut)
        with pytest.raises(InputError) as error:
            read_experience(tmp_path)
        assert file.name in str(error.value) and "\n" not in str(error.value)
    pl.DataFrame({"state": ["1"]}).write_parquet(file)
    with pytest.raises(InputError, match="has no column 'assembly'"):
        read_experience(tmp_path)


def test_data_card(tmp_path: Path) -> None:
    order = members(three_bars().root)
    write_order(tmp_path, order)
    write_order(tmp_path, order[::-1], seed=9)
    card = data_card(tmp_path)
    assert card["rows"] == 6 and card["hash"] == read_experience(tmp_path).hash
    (row,) = card["assemblies"]
    assert row["assembly_hash"] == assembly_hash(three_bars())
    assert (row["rows"], row["edges"], row["states"], row["seeds"]) == (6, 6, 5, [3, 9])
    assert row["mean_reward"] == pytest.approx(-0.6)
    assert f"| three-bars | `{assembly_hash(three_bars())[:12]}` | 3 | 6 | 5 | 6 | 0 | mcts | 3, 9 |" in card_markdown(
        card
    )
