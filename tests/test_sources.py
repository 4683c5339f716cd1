"""The files that a plan was made from are found again by their hashes, wherever all of them were moved to."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest

from small_assemblies import WORKCELL, three_bars, two_bars
from takeapart.formats.files import (
    assembly_hash,
    data_path,
    load_assembly,
    load_plan,
    load_workcell,
    save_assembly,
    save_plan,
)
from takeapart.formats.serialization import workcell_hash
from takeapart.formats.sources import source_assembly, source_workcell, with_sources, with_sources_moved
from takeapart.model.errors import InputError
from takeapart.model.plan import Plan
from verification_scene import scene_plan


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save_assembly(two_bars(), tmp_path / "mine.json")
    (tmp_path / "cell.toml").write_text(WORKCELL)
    return tmp_path


def made_from(folder: Path) -> Plan:
    hashes = {
        "assembly": assembly_hash(load_assembly(folder / "mine.json")),
        "workcell": workcell_hash(load_workcell(folder / "cell.toml")),
    }
    return replace(scene_plan(), assembly="two-bars", workcell="scene", hashes=hashes)


def test_sources_beside_the_plan_are_found_by_hash_under_any_name(folder: Path) -> None:
    plan = made_from(folder)
    (folder / "mine.json").rename(folder / "other.json")
    (folder / "cell.toml").rename(folder / "z.toml")
    (folder / "broken.json").write_text('{"format": "takeapart/assembly", "name": "two-bars"')
    (folder / "broken.toml").write_text("[")
    os.mkfifo(folder / "pipe.json")
    assert assembly_hash(source_assembly(plan, [folder], "p.json")) == plan.hashes["assembly"]
    assert workcell_hash(source_workcell(plan, [folder], "p.json")) == plan.hashes["workcell"]


def test_named_sources_are_found_when_all_was_moved(folder: Path) -> None:
    plans = folder / "plans"
    plans.mkdir()
    plan = with_sources(made_from(folder), plans / "p.json", folder / "mine.json", folder / "cell.toml")
    assert plan.extra["sources"] == {"assembly": "../mine.json", "workcell": "../cell.toml"}
    save_plan(plan, plans / "p.json")
    there = folder.with_name("moved")
    folder.rename(there)
    loaded = load_plan(there / "plans" / "p.json")
    assert source_assembly(loaded, [there / "plans"], "p.json").name == "two-bars"
    assert source_workcell(loaded, [there / "plans"], "p.json").name == "scene"
    elsewhere = with_sources_moved(loaded, there / "plans" / "p.json", there / "q.json")
    assert elsewhere.extra["sources"] == {"assembly": "mine.json", "workcell": "cell.toml"}


def test_a_changed_source_is_named(folder: Path) -> None:
    plan = made_from(folder)
    changed = replace(two_bars(), parts=tuple(replace(part, mass=0.2) for part in two_bars().parts))
    save_assembly(changed, folder / "mine.json")
    (folder / "cell.toml").write_text(WORKCELL.replace("0.42", "0.41"))
    with pytest.raises(InputError, match=r"^p: .*mine\.json holds one of this name that is not the same.*--assembly"):
        source_assembly(plan, [folder], "p")
    with pytest.raises(InputError, match=r"^p: .*cell\.toml holds one of this name that is not the same.*--workcell"):
        source_workcell(plan, [folder], "p")


def test_another_assembly_of_the_folder_is_not_taken(folder: Path) -> None:
    plan = made_from(folder)
    save_assembly(replace(three_bars(), name="two-bars"), folder / "a.json")
    assert len(source_assembly(plan, [folder], "p").parts) == len(two_bars().parts)


@pytest.mark.parametrize("named", ["/etc/passwd", "../nothing.json", "a\x00.json", "x" * 5000 + ".json", 7, None])
def test_a_plan_that_names_anything_does_no_harm(folder: Path, named: object) -> None:
    plan = replace(made_from(folder), extra={"sources": {"assembly": named, "workcell": named}})
    assert source_assembly(plan, [folder], "p").name == "two-bars"
    assert source_workcell(replace(plan, extra={"sources": named}), [folder], "p").name == "scene"


def test_shipped_sources_are_found_from_anywhere(tmp_path: Path) -> None:
    shipped = load_assembly(data_path("single/01.json"))
    hashes = {"assembly": assembly_hash(shipped), "workcell": workcell_hash(load_workcell("panda"))}
    plan = replace(scene_plan(), assembly=shipped.name, workcell="panda", hashes=hashes)
    assert source_assembly(plan, [tmp_path], "p").name == shipped.name
    assert source_workcell(plan, [tmp_path], "p").name == "panda"
    other = replace(plan, hashes={**hashes, "workcell": "0" * 64})
    assert source_workcell(other, [tmp_path], "p").name == "panda", "the verification tells that it is another one"
