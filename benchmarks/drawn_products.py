"""Products that somebody drew: with which options each is imported and planned, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from takeapart.collision.contact import OVERLAP_LIMIT, Contacts, PairFinding
from takeapart.formats.files import load_assembly
from takeapart.formats.importing import import_product
from takeapart.model.assembly import CONTACT_GAP, Assembly

MESHES, SCENES = (".obj", ".stl", ".ply"), (".step", ".stp", ".glb")


@dataclass(frozen=True)
class Trial:
    """How a product is imported and where it is planned.

    Args:
        case: name of the folder.
        why: of these options; empty where they are the defaults.
        note: what the name of the row adds to that of the case.
        workcell: name of a shipped one.
        fix: names or patterns of fixed parts.
        contact_gap: m.
        allow_overlaps: whether all that overlaps too deep as drawn is taken as meant.
    """

    case: str
    why: str = ""
    note: str = ""
    workcell: str = "panda"
    fix: tuple[str, ...] = ()
    contact_gap: float = CONTACT_GAP
    allow_overlaps: bool = False

    @property
    def name(self) -> str:
        """Of the row, and of what is kept."""
        return f"{self.case}-{self.note}" if self.note else self.case

    @property
    def told(self) -> str:
        """The options as they are typed."""
        words = [f"--fix '{pattern}'" for pattern in self.fix]
        words += [f"--contact-gap {1e3 * self.contact_gap:g}mm"] if self.contact_gap != CONTACT_GAP else []
        words += ["--allow-overlap for each such pair"] if self.allow_overlaps else []
        words += [f"--workcell {self.workcell}"] if self.workcell != "panda" else []
        return ", ".join(words)


TRIALS = (
    Trial("choreo_bricks", "its bricks stand around the origin, where `panda` has its arm", "", "panda-table"),
    Trial("fabrica_duct", "its clips stand 1 mm off what holds them", contact_gap=2e-3),
    Trial("factory_pegs", "pegs leave plates that stay", fix=("hole_*",)),
    Trial("furniture_drawer", "the overlaps that are refused as drawn", "allowed", allow_overlaps=True),
    Trial("furniture_square_table", "its threads overlap by the depth of a thread", "allowed", allow_overlaps=True),
    Trial("o2ac_wrs_assembly_2020", "its base is 2.0 mm off the panels, its cap 1.0 mm in the shaft", "allowed",
          contact_gap=2.1e-3, allow_overlaps=True),
)  # fmt: skip


def trials(cases: Path, only: Sequence[str] = (), workcell: str = "panda") -> list[Trial]:
    """All products of a folder with their options, or some by the name of case or row; those that the table does not
    know in a workcell."""
    known = {trial.case: trial for trial in TRIALS if not trial.note}
    found = []
    for folder in sorted(cases.iterdir()):
        if folder.is_dir() and any(file.suffix.lower() in MESHES + SCENES for file in folder.iterdir()):
            found.append(known.get(folder.name, Trial(folder.name, workcell=workcell)))
            found += [trial for trial in TRIALS if trial.case == folder.name and trial.note]
        elif (folder / "assembly.json").is_file():
            found.append(known.get(folder.name, Trial(folder.name, workcell=workcell)))
    return [trial for trial in found if not only or trial.name in only or trial.case in only]


def imported(trial: Trial, cases: Path, unit: str) -> Assembly:
    """The product of a trial as an assembly.

    Raises:
        InputError: the folder holds nothing that can be read.
    """
    folder = cases / trial.case
    if (folder / "assembly.json").is_file():
        return load_assembly(folder / "assembly.json")
    scenes = [file for file in sorted(folder.iterdir()) if file.suffix.lower() in SCENES]
    source, measure = (scenes[0], None) if scenes else (folder, unit)
    assembly = import_product(source, measure, trial.fix, contact_gap=trial.contact_gap).assembly
    if trial.allow_overlaps:
        names = [part.name for part in assembly.parts]
        meant = tuple((names[each.first], names[each.second]) for each, _ in too_deep(assembly))
        assembly = replace(assembly, allowed_overlaps=meant)
    return replace(assembly, name=trial.name)


def too_deep(assembly: Assembly) -> list[tuple[PairFinding, float]]:
    """Pairs that a planner refuses unless they are meant, and how deep they overlap, m; the deepest first."""
    contacts = Contacts(assembly)
    deep = [(each, contacts.depth(each)) for each in contacts.findings if each.depth > OVERLAP_LIMIT]
    return sorted(deep, key=lambda each: -each[1])
