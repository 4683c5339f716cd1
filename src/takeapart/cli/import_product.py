"""takeapart import: a product from CAD becomes an assembly file with its meshes, and what was found is told."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from takeapart.cli.output import (
    FILE,
    FOLDER,
    FiniteNumber,
    examples,
    json_option,
    note,
    print_json,
    print_table,
    progress_bar,
    require_output,
)
from takeapart.formats.messages import shortened, shown
from takeapart.model.errors import InputError

if TYPE_CHECKING:
    from takeapart.formats.importing import DrawnPair, Floating, ImportedProduct

SHOWN_DEPTH = 1e-5  # m; what overlaps less is told as contact
REPORTED_DEPTH, REFUSED_DEPTH = 2.5e-4, 5e-4  # m; what a planner swallows and tells, and what it refuses
UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "inch": 0.0254}


class Millimetres(click.ParamType):
    """A length with its unit, ``2mm`` or ``0.1inch``; a bare number is metres, as everywhere."""

    name = "length"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The length, m.

        Raises:
            InputError: no number, or an unknown unit.
        """
        found = re.fullmatch(r"\s*([0-9.eE+-]+)\s*(mm|cm|m|inch|)\s*", str(value))
        try:
            length = float(found[1]) * UNITS[found[2] or "m"] if found else math.nan
        except ValueError:
            length = math.nan
        if not 0 <= length < math.inf:
            where = param.opts[0] if param is not None else ""
            raise InputError(f"{shortened(value)}; must be a length such as 2mm, 0.2cm, 0.002m or 0.1inch", where)
        return length


LENGTH = Millimetres()


@click.command(
    "import",
    short_help="Make a product of a STEP file, or of a folder of meshes.",
    epilog=examples(
        "takeapart import gearbox.step --out gearbox/",
        "takeapart import parts/ --unit mm --fix base --out product/",
        "takeapart import duct/ --unit m --contact-gap 2mm --out duct/product",
    ),
)
@click.argument("source", metavar="FILE|FOLDER", type=FILE)
@click.option("--out", required=True, type=FOLDER, help="Folder for assembly.json and meshes/.")
@click.option(
    "--unit", metavar="mm|cm|m|inch", help="Of OBJ, STL and PLY, which do not say it; of STEP, instead of its own."
)
@click.option("--fix", multiple=True, metavar="NAME", help="A part, or a pattern such as 'plate*', that never leaves.")
@click.option(
    "--density",
    type=FiniteNumber(1, 25_000),
    default=2700.0,
    show_default=True,
    help="Of all parts, kg per cubic metre; the default is aluminium.",
)
@click.option("--contact-gap", type=LENGTH, default="0.5mm", show_default=True, help="Surfaces as near as this touch.")
@click.option(
    "--allow-overlap", multiple=True, metavar="A,B", help="Two parts that overlap as drawn, and are meant to."
)
@click.option("--ground", is_flag=True, help="Move the product so that its lowest point is at z = 0.")
@click.option(
    "--deflection",
    type=LENGTH,
    default="0.05mm",
    show_default=True,
    help="Largest distance between the surfaces of a STEP file and their triangles.",
)
@click.option("--simplify", type=LENGTH, default=0.0, help="How far closed surfaces may move to have fewer faces.")
@json_option
def import_product(
    source: Path,
    out: Path,
    unit: str | None,
    fix: tuple[str, ...],
    density: float,
    contact_gap: float,
    allow_overlap: tuple[str, ...],
    ground: bool,
    deflection: float,
    simplify: float,
    as_json: bool,
) -> None:
    """Make a product of a STEP file, or of a folder of meshes in their places.

    Every mesh file is a part; STEP and GLB hold the parts with their names. Prints what is found: sizes, masses, what
    is fixed and why, which parts touch, overlap or stand apart, what floats. Nothing is repaired silently.
    """
    from takeapart.formats.files import load_assembly, save_assembly
    from takeapart.formats.importing import import_product as read_product

    if not 1e-6 <= deflection <= 0.01:
        raise InputError(f"{1e3 * deflection:g} mm; must be from 0.001mm to 10mm", "--deflection")
    if simplify > 0.01:
        raise InputError(f"{1e3 * simplify:g} mm; must be at most 10mm", "--simplify")
    file = out / "assembly.json"
    require_output(file, source)
    pairs = [_pair(text) for text in allow_overlap]
    with progress_bar(f"importing {source.name}") as update:
        found = read_product(source, unit, fix, density, contact_gap, pairs, ground, deflection, simplify, update)
    save_assembly(found.assembly, file)
    load_assembly(file)  # what was written is read again
    if as_json:
        print_json(_document(found, file))
    else:
        _print(found, file)


def _pair(text: str) -> tuple[str, str]:
    names = [name.strip() for name in text.split(",")]
    if len(names) != 2 or not all(names):
        raise InputError(f"{shortened(text)}; must be two names of parts with a comma between", "--allow-overlap")
    return names[0], names[1]


def _document(found: ImportedProduct, file: Path) -> dict[str, Any]:
    names = [part.name for part in found.assembly.parts]
    return {
        "file": str(file),
        "unit": found.unit,
        "fixed_because": found.fixed_because,
        "parts": [
            {
                "name": part.name,
                "drawn_name": drawn,
                "size": _size(found, i),
                "mass": part.mass,
                "triangles": len(part.shape.surface().triangles),
                "closed": _is_closed(found, i),
                "fixed": part.fixed,
                "remarks": list(found.remarks.get(i, ())),
            }
            for i, (part, drawn) in enumerate(zip(found.assembly.parts, found.drawn_names, strict=True))
        ],
        "pairs": [
            {
                "first": names[pair.first],
                "second": names[pair.second],
                "gap": pair.gap,
                "depth": None if math.isnan(pair.depth) else pair.depth,
                "finding": _finding(found, pair),
            }
            for pair in found.pairs
        ],
        "floating": [
            {
                "parts": [names[i] for i in each.parts],
                "nearest": names[each.part],
                "carrier": None if each.carrier is None else names[each.carrier],
                "gap": None if each.carrier is None else each.gap,
            }
            for each in found.floating
        ],
    }


def _size(found: ImportedProduct, i: int) -> list[float]:
    low, high = found.assembly.parts[i].shape.surface().bounds
    return [round(float(value), 9) for value in high - low]


def _is_closed(found: ImportedProduct, i: int) -> bool:
    return not any(remark.startswith("open") for remark in found.remarks.get(i, ()))


def _finding(found: ImportedProduct, pair: DrawnPair) -> str:
    """What a pair is, in words."""
    names = {found.assembly.parts[pair.first].name, found.assembly.parts[pair.second].name}
    allowed = any(set(each) == names for each in found.assembly.allowed_overlaps)
    if pair.depth > SHOWN_DEPTH:
        if pair.depth <= REPORTED_DEPTH:
            return "overlap"
        if allowed:
            return "overlap, allowed"
        return "too deep: see --allow-overlap" if pair.depth > REFUSED_DEPTH else "press fit or wrong drawing?"
    touches = pair.gap <= found.assembly.contact_gap
    if math.isnan(pair.depth):
        return f"{'contact' if touches else 'gap'}; overlap not known, a part is open"
    return "contact" if touches else "gap"


def _print(found: ImportedProduct, file: Path) -> None:
    parts = found.assembly.parts
    rows = []
    for i, part in enumerate(parts):
        size = " x ".join(f"{1e3 * edge:.1f}" for edge in _size(found, i))
        closed = "yes" if _is_closed(found, i) else "no"
        fixed = "fixed" if part.fixed else ""
        rows.append([part.name, size, f"{part.mass:.4g}", str(len(part.shape.surface().triangles)), closed, fixed])
    print_table("", ["part", ">size, mm", ">mass, kg", ">faces", "closed", ""], rows)
    click.echo("")
    click.echo(f"unit: {found.unit}; density {found.assembly.provenance['density']:g} kg/m3 for all parts")
    click.echo(f"fixed: {', '.join(part.name for part in parts if part.fixed)}; {found.fixed_because}")
    for i, drawn in enumerate(found.drawn_names):
        if drawn != parts[i].name:
            click.echo(f"named: {parts[i].name}, drawn as {shortened(drawn)}")
    if found.pairs:
        click.echo("")
        by_depth = sorted(found.pairs, key=lambda p: (-p.depth if p.depth > SHOWN_DEPTH else 0.0, p.gap))
        print_table(
            "",
            ["near pairs", "", ">gap, mm", ">overlap, mm", ""],
            [
                [
                    parts[pair.first].name,
                    parts[pair.second].name,
                    f"{1e3 * pair.gap:.3f}",
                    "?" if math.isnan(pair.depth) else f"{1e3 * pair.depth:.2f}" if pair.depth > SHOWN_DEPTH else "-",
                    _finding(found, pair),
                ]
                for pair in by_depth
            ],
        )
    for i, remarks in found.remarks.items():
        for remark in remarks:
            note(f"{parts[i].name}: {remark}")
    for each in found.floating:
        note(_floating(found, each))
    click.echo(f"written: {shown(file)}")


def _floating(found: ImportedProduct, each: Floating) -> str:
    """Who floats, and what would carry it."""
    parts = found.assembly.parts
    names = ", ".join(parts[i].name for i in each.parts[:8]) + (", ..." if len(each.parts) > 8 else "")
    verb = "floats" if len(each.parts) == 1 else "float"
    gap = math.ceil(1e4 * each.gap - 1e-6) / 10
    if each.carrier is None:
        return f"{names} {verb}: nothing that is held is within {1e3 * each.gap:g} mm; name with --fix what is fixed"
    which = f"{parts[each.part].name} is {1e3 * each.gap:.3f} mm off {parts[each.carrier].name}"
    cure = f"--contact-gap {gap:g}mm counts that as contact" if gap <= 10 else "further than any contact"
    return f"{names} {verb}: {which}; {cure}"
