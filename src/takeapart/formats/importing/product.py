"""A product from CAD: parts with shapes, masses and places, what is fixed, and everything that was found on the way."""

from __future__ import annotations

import fnmatch
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from takeapart.formats.importing.drawn import DrawnBody, valid_names
from takeapart.formats.importing.pairs import DrawnPair, DrawnPairs
from takeapart.formats.importing.reading import drawn_bodies
from takeapart.formats.importing.surfaces import GRID, Surface, split_map, surface_of
from takeapart.formats.messages import shortened, shown
from takeapart.model.assembly import CONTACT_GAP, Assembly, Part
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array
from takeapart.model.meshes import Mesh

DENSITY = 2700.0  # kg/m^3, of aluminium
DEFLECTION = 5e-5  # m
GROUND = 1e-3  # m above the lowest point of the product
LONGEST, SHORTEST = 3.0, 5e-3  # m, of a product that an arm can work on
LEAST_MASS = 1e-6  # kg; files hold masses to 1e-9 kg
FURTHEST_CARRIER = 0.05  # m


@dataclass(frozen=True)
class Floating:
    """Parts that touch each other, and nothing that is fixed.

    Args:
        parts: their numbers.
        part, carrier: number of the one among them that is nearest to what is held, and of what it is nearest to;
            None where there is none within 5 cm.
        gap: m between these two.
    """

    parts: tuple[int, ...]
    part: int
    carrier: int | None
    gap: float


@dataclass(frozen=True, eq=False)
class ImportedProduct:
    """An assembly, and what was found while it was made.

    Args:
        assembly: as it can be saved.
        drawn_names: of the parts, as the file has them.
        remarks: by number of the part, what is wrong with its surface or was changed.
        fixed_because: why what is fixed is fixed.
        pairs: parts nearer to each other than 5 mm.
        floating: parts that are joined by contacts to nothing fixed.
        unit: of the drawing, in words.
    """

    assembly: Assembly
    drawn_names: tuple[str, ...]
    remarks: dict[int, tuple[str, ...]]
    fixed_because: str
    pairs: tuple[DrawnPair, ...]
    floating: tuple[Floating, ...]
    unit: str


def import_product(
    path: str | os.PathLike[str],
    unit: str | None = None,
    fix: Sequence[str] = (),
    density: float = DENSITY,
    contact_gap: float = CONTACT_GAP,
    allow_overlap: Sequence[tuple[str, str]] = (),
    ground: bool = False,
    deflection: float = DEFLECTION,
    simplify: float = 0.0,
    progress: Callable[[str, float | None], None] = lambda text, share: None,
) -> ImportedProduct:
    """A product from a STEP file, a mesh file, or a folder of meshes in their places.

    Args:
        unit: "mm", "cm", "m" or "inch"; OBJ, STL and PLY need it, STEP says its own.
        fix: names or patterns (``plate*``) of the parts that are fixed; without any, the heaviest on the ground is.
        density: kg/m^3 of all parts.
        contact_gap: m; surfaces as near as this count as touching.
        allow_overlap: pairs of names of parts that overlap and are meant to.
        ground: whether the product is moved so that its lowest point is at z = 0.
        deflection: m, between the surfaces of a STEP file and their triangles.
        simplify: m, that closed surfaces may move by to have fewer triangles; 0 leaves them as they are.
        progress: told what is done at the moment, and how much of it.

    Raises:
        InputError: one line that says what is wrong with what was given.
        MissingExtraError: a library of the extra ``cad`` is missing.
    """
    file = Path(path)
    progress("reading", None)
    bodies, metres, words = drawn_bodies(file, unit, deflection)
    names = valid_names([body.name for body in bodies])
    _require_size(_drawn_size(bodies, metres), shown(path))
    surfaces, placed = _placed(bodies, metres, names, shown(path), simplify, progress)
    if ground:
        bottom = min(float(_world(s, T)[:, 2].min()) for s, T in zip(surfaces, placed, strict=True))
        placed = [_lifted(T, -bottom) for T in placed]
    masses = [max(LEAST_MASS, density * _volume(surface.mesh)) for surface in surfaces]
    lowest = [float(_world(s, T)[:, 2].min()) for s, T in zip(surfaces, placed, strict=True)]
    fixed, because = _fixed(names, [body.name for body in bodies], masses, lowest, fix)
    remarks = {i: surface.remarks for i, surface in enumerate(surfaces) if surface.remarks}
    assembly = Assembly(
        name=valid_names([file.resolve().stem])[0],
        parts=tuple(
            Part(name, surface.mesh, _to_a_nanometre(T), mass, i in fixed)
            for i, (name, surface, T, mass) in enumerate(zip(names, surfaces, placed, masses, strict=True))
        ),
        provenance={
            "imported_from": file.name,
            "unit": words,
            "density": density,
            "fixed": because,
            "drawn_names": {n: body.name[:200] for n, body in zip(names, bodies, strict=True) if n != body.name},
            "remarks": {names[i]: list(texts) for i, texts in remarks.items()},
        },
        contact_gap=contact_gap,
        allowed_overlaps=tuple(allow_overlap),
    )
    measured = DrawnPairs(assembly.parts)
    pairs = measured.near(lambda share: progress("measuring how near the parts are", share))
    floating = _floating(assembly, pairs, measured)
    drawn = tuple(body.name for body in bodies)
    return ImportedProduct(assembly, drawn, remarks, because, pairs, floating, words)


def _placed(
    bodies: Sequence[DrawnBody],
    metres: float,
    names: Sequence[str],
    where: str,
    simplify: float,
    progress: Callable[[str, float | None], None],
) -> tuple[list[Surface], list[Array]]:
    """Shapes and proper poses; instances of one shape have one object, a mirrored instance has its own."""
    known: dict[tuple[object, ...], Surface] = {}
    by_content: dict[str, Mesh] = {}
    surfaces, placed = [], []
    for number, body in enumerate(bodies):
        progress("reading shapes", number / len(bodies))
        if not np.isfinite(body.T_world_body).all():
            raise InputError("its place is not a finite matrix", f"{where}: {names[number]}")
        T, linear = split_map(body.T_world_body)
        key = (body.shape, *np.round(linear, 9).ravel().tolist())
        if key not in known:
            turned = body.triangles[:, ::-1] if np.linalg.det(linear) < 0 else body.triangles
            found = surface_of(metres * (body.vertices @ linear.T), turned, f"{where}: {names[number]}", simplify)
            mesh = by_content.setdefault(found.mesh.hash, found.mesh)
            known[key] = Surface(mesh, found.middle, found.remarks)
        surface = known[key]
        pose = T.copy()
        pose[:3, 3] = T[:3, :3] @ surface.middle + metres * T[:3, 3]
        surfaces.append(surface)
        placed.append(pose)
    return surfaces, placed


def _world(surface: Surface, T: Array) -> Array:
    return np.asarray(surface.mesh.surface().moved(T).vertices)


def _drawn_size(bodies: Sequence[DrawnBody], metres: float) -> float:
    """Longest edge of the bounds of all bodies, m; what is not a number is left for the surfaces to find."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for body in bodies:
        named = body.triangles.ravel()
        used = body.vertices[named[(named >= 0) & (named < len(body.vertices))]]
        used = used[np.isfinite(used).all(axis=1)] @ body.T_world_body[:3, :3].T + body.T_world_body[:3, 3]
        if len(used):
            low, high = np.minimum(low, used.min(axis=0)), np.maximum(high, used.max(axis=0))
    return metres * float((high - low).max())


def _to_a_nanometre(T: Array) -> Array:
    """As shapes are: what is drawn in other units is then the same product, not nearly the same."""
    rounded = T.copy()
    rounded[:3, 3] = np.round(T[:3, 3], GRID)
    return rounded


def _lifted(T: Array, height: float) -> Array:
    moved = T.copy()
    moved[2, 3] += height
    return moved


def _require_size(longest: float, where: str) -> None:
    if longest > LONGEST:
        raise InputError(f"{longest:.3g} m long: wrong unit? At most {LONGEST:g} m is valid; see --unit", where)
    if 0 <= longest < SHORTEST:
        raise InputError(
            f"{1e3 * longest:.3g} mm long: wrong unit? At least {1e3 * SHORTEST:g} mm is valid; see --unit", where
        )


def _volume(mesh: Mesh) -> float:
    """m^3; of an open mesh that of its hull, because its inside is not known."""
    if mesh.is_closed:
        return mesh.volume()
    from scipy.spatial import ConvexHull, QhullError

    try:
        return float(ConvexHull(mesh.surface().vertices).volume)
    except QhullError:  # flat
        return 0.0


def _fixed(
    names: Sequence[str], drawn: Sequence[str], masses: Sequence[float], lowest: Sequence[float], fix: Sequence[str]
) -> tuple[set[int], str]:
    if fix:
        fixed: set[int] = set()
        for pattern in fix:
            found = {
                i
                for i in range(len(names))
                if fnmatch.fnmatchcase(names[i], pattern) or fnmatch.fnmatchcase(drawn[i], pattern)
            }
            if not found:
                shown_names = ", ".join(names[:20]) + (", ..." if len(names) > 20 else "")
                raise InputError(f"no part is called {shortened(pattern)}; there are: {shown_names}", "--fix")
            fixed |= found
        return fixed, f"named with --fix {' --fix '.join(fix)}"[:1000]
    bottom = min(lowest)
    grounded = [i for i in range(len(names)) if lowest[i] <= bottom + GROUND]
    heaviest = max(grounded, key=lambda i: masses[i])
    others = f"the heaviest of {len(grounded)} parts" if len(grounded) > 1 else "the only part"
    return {heaviest}, f"{others} on the ground (within 1 mm of the lowest point); change it with --fix"


def _floating(assembly: Assembly, pairs: Sequence[DrawnPair], measured: DrawnPairs) -> tuple[Floating, ...]:
    """Parts that no chain of contacts joins to what is fixed, or stands on the ground at the product's lowest point."""
    touching: dict[int, set[int]] = {i: set() for i in range(len(assembly.parts))}
    for pair in pairs:
        if pair.gap <= assembly.contact_gap:
            touching[pair.first].add(pair.second)
            touching[pair.second].add(pair.first)
    bottom = float(measured.bounds[:, 0, 2].min())
    standing = {i for i in touching if measured.bounds[i, 0, 2] <= bottom + assembly.contact_gap}
    held = _joined_to(standing | {i for i, part in enumerate(assembly.parts) if part.fixed}, touching)
    left = set(touching) - held
    found = []
    while left:
        group = _joined_to({min(left)}, touching)
        left -= group
        gaps = {(i, j): measured.measured(i, j, FURTHEST_CARRIER)[0] for i in group for j in _below(i, held, measured)}
        part, carrier = min(gaps, key=lambda pair: (gaps[pair], pair))
        known = np.isfinite(gaps[part, carrier])
        gap = gaps[part, carrier] if known else FURTHEST_CARRIER
        members = tuple(sorted(group))
        found.append(Floating(members, part, carrier if known else None, gap))
    return tuple(found)


def _joined_to(start: set[int], touching: dict[int, set[int]]) -> set[int]:
    found, waiting = set(start), list(start)
    while waiting:
        for other in touching[waiting.pop()] - found:
            found.add(other)
            waiting.append(other)
    return found


def _below(i: int, held: set[int], measured: DrawnPairs) -> list[int]:
    """What is held and reaches lower than a part; all that is held where nothing does."""
    return [j for j in held if measured.bounds[j, 0, 2] <= measured.bounds[i, 0, 2] + GROUND] or sorted(held)
