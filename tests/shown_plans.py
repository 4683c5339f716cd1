"""A small plan as files, for the tests of pictures, reports and viewers; planned once per process."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any

from small_assemblies import WORKCELL, three_bars
from takeapart.formats.files import load_workcell, save_assembly, save_plan
from takeapart.model.plan import Plan
from takeapart.planning import PlanningOptions, plan
from takeapart.show.scene import PlanScene
from takeapart.workcell import Workcell


@functools.cache
def small_workcell(folder: Path) -> Workcell:
    file = folder / "cell.toml"
    file.write_text(WORKCELL)
    return load_workcell(file)


@functools.cache
def small_plan(folder: Path) -> Plan:
    """Three bars, by the exact search."""
    made = plan(three_bars(), small_workcell(folder), PlanningOptions())
    assert isinstance(made, Plan)
    return made


def small_scene(folder: Path) -> PlanScene:
    return PlanScene(three_bars(), small_workcell(folder), small_plan(folder))


def write_files(folder: Path, shared: Path) -> list[str]:
    """plan.json, product.json and cell.toml in a folder; the options that name the latter two."""
    (folder / "cell.toml").write_text(WORKCELL)
    save_assembly(three_bars(), folder / "product.json")
    save_plan(small_plan(shared), folder / "plan.json")
    return ["--assembly", str(folder / "product.json"), "--workcell", str(folder / "cell.toml")]


def corrupted(file: Path, out: Path, **steps: Any) -> Path:
    """The plan with other values in its first step: ``corrupted(file, out, part="nothing")``."""
    document = json.loads(file.read_text())
    document["steps"][0] |= steps
    out.write_text(json.dumps(document))
    return out
