"""The files that a plan was made from: named in it, and found again by their hashes wherever they lie beside it."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

from takeapart.formats.documents import read_bytes
from takeapart.formats.files import (
    MAXIMUM_ASSEMBLY_BYTES,
    WORKCELL_ENDING,
    PathLike,
    assembly_hash,
    data_path,
    load_assembly,
    load_workcell,
    workcell_hash,
)
from takeapart.formats.messages import shown
from takeapart.formats.serialization import workcell_hash_by_name
from takeapart.model.assembly import Assembly
from takeapart.model.errors import InputError
from takeapart.model.plan import Plan
from takeapart.workcell import Workcell

MAXIMUM_NEIGHBOURS = 1000  # files of a folder that are looked at
SHIPPED_ASSEMBLIES = ("*/*.json", "products/*/assembly.json")


def with_sources(plan: Plan, path: PathLike, assembly: PathLike, workcell: PathLike) -> Plan:
    """The plan with the files that it was made from, for `source_assembly` and `source_workcell`.

    Args:
        path: of the plan file; the sources are named relative to its folder, so that all can be moved together.
        workcell: name or path.
    """
    cell = os.fspath(workcell)
    named = {"assembly": _relative(assembly, path), "workcell": _relative(cell, path) if _is_file_name(cell) else cell}
    return replace(plan, extra={**plan.extra, "sources": named})


def with_sources_moved(plan: Plan, before: PathLike, after: PathLike) -> Plan:
    """The plan with its sources named from the folder of another plan file."""
    assembly, workcell = _named(plan, "assembly"), _named(plan, "workcell")
    if not assembly or not workcell:
        return plan
    folder = Path(before).parent
    return with_sources(plan, after, folder / assembly, folder / workcell if _is_file_name(workcell) else workcell)


def sources_of(
    plan: Plan, path: PathLike, assembly: PathLike | None, workcell: PathLike | None
) -> tuple[Assembly, Workcell]:
    """Assembly and workcell of a plan file: those that are given, else those that it was made for.

    Args:
        path: of the plan file, which may lie beside its sources.
        assembly, workcell: what the user names instead.

    Raises:
        InputError: as `source_assembly` and `source_workcell`; what is given is broken.
    """
    folders, where = [Path(path).parent], shown(path)
    product = load_assembly(assembly) if assembly else source_assembly(plan, folders, where)
    return product, load_workcell(workcell) if workcell else source_workcell(plan, folders, where)


def source_assembly(plan: Plan, folders: Sequence[PathLike], where: str) -> Assembly:
    """The assembly that a plan was made for, found by its hash.

    First the file that the plan names is looked at, then those in the folders, at last those that are shipped.

    Args:
        folders: where the plan lies; names in the plan are relative to the first.
        where: the plan, for messages.

    Raises:
        InputError: there is none; a file that has been changed since is named.
    """
    return assembly_of_hash(plan.assembly, plan.hashes["assembly"], folders, where, _named(plan, "assembly"))


def assembly_of_hash(name: str, digest: str, folders: Sequence[PathLike], where: str, named: str = "") -> Assembly:
    """As `source_assembly`, where there is no plan yet."""
    other = ""
    files = (file for pattern in SHIPPED_ASSEMBLIES for file in data_path(".").glob(pattern))
    shipped = sorted(files, key=lambda file: (file.stem not in name and file.parent.name != name, file))
    for file in (*_neighbours(folders, named, ".json"), *shipped):
        try:
            content = read_bytes(file, MAXIMUM_ASSEMBLY_BYTES)
            if b'"takeapart/assembly"' not in content or f'"{name}"'.encode() not in content:
                continue  # known without reading all of it
            found = load_assembly(file)
        except InputError:  # a neighbour that is broken or closed is not what is sought
            continue
        if found.name == name and assembly_hash(found) == digest:
            return found
        if found.name == name and not other:
            other = f"; {shown(file)} holds one of this name that is not the same (has it been changed since?)"
    raise InputError(
        f"was made for assembly {name!r}, which is neither beside it nor shipped{other}; give it with --assembly FILE",
        where,
    )


def source_workcell(plan: Plan, folders: Sequence[PathLike], where: str) -> Workcell:
    """The workcell that a plan was made for, found by its hash as `source_assembly` is.

    A shipped workcell of the plan's name but with another hash is the answer where nothing fits better: the
    verification tells that it is another one.

    Raises:
        InputError: there is none, nor a shipped one of its name.
    """
    named = _named(plan, "workcell")
    return workcell_of_hash(plan.workcell, plan.hashes["workcell"], folders, where, named, by_name=not plan.joints)


def workcell_of_hash(
    name: str, digest: str, folders: Sequence[PathLike], where: str, named: str = "", by_name: bool = False
) -> Workcell:
    """As `source_workcell`, where there is no plan yet.

    Args:
        by_name: whether the hash may be one that holds the robot's name alone, as in plan files of version 1.
    """

    def fits(workcell: Workcell) -> bool:
        return workcell_hash(workcell) == digest or (by_name and workcell_hash_by_name(workcell) == digest)

    shipped, other = data_path("workcells").glob("*.toml"), ""
    likely = next((file for file in shipped if file.stem == name), None)
    same_name = load_workcell(likely) if likely else None
    if same_name is not None and fits(same_name):
        return same_name
    for file in _neighbours(folders, named, WORKCELL_ENDING):
        try:
            found = load_workcell(file)
        except InputError:
            continue
        if fits(found):
            return found
        if found.name == name and not other:
            other = f"; {shown(file)} holds one of this name that is not the same (has it been changed since?)"
    if same_name is not None:
        return same_name
    raise InputError(
        f"the plan's workcell {name!r} is neither beside it nor shipped{other}; give it with --workcell FILE.toml",
        where,
    )


def _neighbours(folders: Sequence[PathLike], named: str, ending: str) -> Iterator[Path]:
    """The file that a plan names, and the files of the folders; none of them twice."""
    seen: set[str] = set()
    for number, folder in enumerate(folders):
        first = [Path(folder) / named] if number == 0 and _is_relative(named, ending) else []
        try:
            around = sorted(islice(Path(folder).glob(f"*{ending}"), MAXIMUM_NEIGHBOURS))
        except OSError:  # a closed folder
            around = []
        for file in (*first, *around):
            real = os.path.realpath(file)
            if real not in seen:
                seen.add(real)
                yield file


def _named(plan: Plan, source: str) -> str:
    """What a plan says of a source; a plan file may say anything there, and only names are taken."""
    sources = plan.extra.get("sources")
    named = sources.get(source) if isinstance(sources, dict) else None
    return named if isinstance(named, str) else ""


def _is_relative(named: str, ending: str) -> bool:
    return named.endswith(ending) and not os.path.isabs(named) and "\x00" not in named


def _is_file_name(workcell: str) -> bool:
    return workcell.endswith(WORKCELL_ENDING)


def _relative(file: PathLike, plan: PathLike) -> str:
    return Path(os.path.relpath(file, Path(plan).parent)).as_posix()
