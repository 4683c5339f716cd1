"""What a file to be shown holds: an assembly, a plan with the assembly and workcell it was made for, or a run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from takeapart.assembly import Assembly
from takeapart.documents import read_json
from takeapart.errors import InputError, UnknownNameError
from takeapart.files import MAXIMUM_PLAN_BYTES, data_path, load_assembly, load_plan, load_workcell
from takeapart.messages import shown
from takeapart.plan import Plan
from takeapart.run import MAXIMUM_BYTES, PLAN, RUN
from takeapart.serialization import assembly_hash
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
        assembly: file of the plan's assembly; by default the shipped one with the plan's hash.
        workcell: name or file; by default the one that the plan names, or "panda" for an assembly.

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
    product = _assembly(plan.assembly, plan.hashes["assembly"], assembly, shown(path))
    return Subject(path, product, _workcell(plan.workcell, workcell, shown(path)), plan)


def _run(folder: Path, assembly: Path | None, workcell: str | None) -> Subject:
    where = shown(folder)
    if not (folder / RUN).exists():
        raise InputError(f"is no run directory: it holds no {RUN}", where)
    document = read_json(folder / RUN, MAXIMUM_BYTES)
    try:
        assert isinstance(document, dict)
        name, digest = str(document["assembly"]["name"]), str(document["assembly"]["hash"])
        cell = str(document["workcell"]["name"])
    except (AssertionError, KeyError, TypeError):
        raise InputError("does not say for which assembly and workcell the run is", f"{where}/{RUN}") from None
    plan = load_plan(folder / PLAN) if (folder / PLAN).exists() else None
    return Subject(folder, _assembly(name, digest, assembly, where), _workcell(cell, workcell, where), plan, folder)


def _assembly(name: str, digest: str, given: Path | None, where: str) -> Assembly:
    if given is not None:
        return load_assembly(given)
    likely = sorted(data_path(".").glob("*/*.json"), key=lambda file: (file.stem not in name, file))
    for file in likely:  # reading all takes seconds
        found = load_assembly(file)
        if found.name == name and assembly_hash(found) == digest:
            return found
    raise InputError(
        f"was made for assembly {name!r}; none of this hash is shipped, give it with --assembly FILE", where
    )


def _workcell(name: str, given: str | None, where: str) -> Workcell:
    try:
        return load_workcell(given or name)
    except UnknownNameError as error:
        if given:
            raise
        raise InputError(
            f"the plan's workcell {name!r} is not shipped; give it with --workcell FILE.toml", where
        ) from error
