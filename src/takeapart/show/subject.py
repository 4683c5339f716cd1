"""What a file to be shown holds: an assembly, a plan with the assembly and workcell it was made for, or a run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from takeapart.formats.documents import read_json
from takeapart.formats.files import (
    MAXIMUM_PLAN_BYTES,
    load_assembly,
    load_plan,
    load_workcell,
)
from takeapart.formats.messages import shown
from takeapart.formats.sources import assembly_of_hash, sources_of, workcell_of_hash
from takeapart.model.assembly import Assembly
from takeapart.model.errors import InputError
from takeapart.model.plan import Plan
from takeapart.workcell import Workcell

DEFAULT_WORKCELL = "panda"


@dataclass(frozen=True, eq=False)
class Subject:
    """What is shown.

    Args:
        path: the file or run directory.
        assembly: of the plan, or the one in the file.
        workcell: of the plan, or the one given.
        plan: None for an assembly, and for a run that has not ended.
        run: the run directory, if it is one.
    """

    path: Path
    assembly: Assembly
    workcell: Workcell
    plan: Plan | None
    run: Path | None = None


def load_subject(path: Path, assembly: Path | None = None, workcell: str | None = None) -> Subject:
    """Reads an assembly, a plan, or a run directory.

    Args:
        path: of the file or directory.
        assembly: file of the plan's assembly; by default the one with the plan's hash, beside it or shipped.
        workcell: name or file; by default the one that the plan was made for, or "panda" for an assembly.

    Raises:
        InputError: one line that names the file, the place inside it, and what is valid.
    """
    if path.is_dir():
        return _run(path, assembly, workcell)
    document = read_json(path, MAXIMUM_PLAN_BYTES)
    form = document.get("format") if isinstance(document, dict) else None
    if form == "takeapart/assembly":
        if assembly is not None:
            raise InputError("is an assembly already; --assembly goes with a plan", shown(path))
        return Subject(path, load_assembly(path), load_workcell(workcell or DEFAULT_WORKCELL), None)
    if form != "takeapart/plan":
        raise InputError(
            "holds neither a plan ('takeapart/plan') nor an assembly ('takeapart/assembly')", f"{shown(path)}: format"
        )
    plan = load_plan(path)
    return Subject(path, *sources_of(plan, path, assembly, workcell), plan)


def _run(folder: Path, assembly: Path | None, workcell: str | None) -> Subject:
    from takeapart.planning.runs import MAXIMUM_BYTES, PLAN, RUN  # it brings the planner along

    where = shown(folder)
    if not (folder / RUN).exists():
        raise InputError(f"is no run directory: it holds no {RUN}", where)
    document = read_json(folder / RUN, MAXIMUM_BYTES)
    try:
        assert isinstance(document, dict)
        name, digest = str(document["assembly"]["name"]), str(document["assembly"]["hash"])
        cell, cell_digest = str(document["workcell"]["name"]), str(document["workcell"]["hash"])
    except (AssertionError, KeyError, TypeError):
        raise InputError("does not say for which assembly and workcell the run is", f"{where}/{RUN}") from None
    plan = load_plan(folder / PLAN) if (folder / PLAN).exists() else None
    around = [folder, folder.absolute().parent]
    product = load_assembly(assembly) if assembly else assembly_of_hash(name, digest, around, where)
    found = load_workcell(workcell) if workcell else workcell_of_hash(cell, cell_digest, around, where)
    return Subject(folder, product, found, plan, folder)
