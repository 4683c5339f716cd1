"""Products that nobody here made, read from the folder beside the project; tests skip where it is absent."""

from __future__ import annotations

import functools
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from takeapart.model.assembly import Assembly, Part
from takeapart.model.geometry import Array, TriangleMesh
from takeapart.model.meshes import Mesh

CASES = Path(__file__).resolve().parents[2] / "shared" / "cases"
DENSITY = 1000.0  # kg/m^3
ON_GROUND = 5e-4  # m; a part whose lowest point is as low as this stands on the ground
MERGED = 7  # digits after the point, m, in which corners that are one are equal


def facts(name: str) -> dict[str, object]:
    """What is known of a case: sizes, and for every near pair gap, depth and volume of the overlap."""
    found: dict[str, object] = json.loads((folder(name) / "meta.json").read_text())
    return found


def folder(name: str) -> Path:
    """The folder of a case; the test is skipped where there is none."""
    if not (CASES / name).is_dir():
        pytest.skip(f"no product {name}: it is no part of the project")
    return CASES / name


def surface(file: Path) -> tuple[TriangleMesh, Array]:
    """The surface of one file, around the middle of its bounds, and where that middle is (3,), m."""
    read = trimesh.load_mesh(str(file), process=False)
    mesh = trimesh.Trimesh(np.asarray(read.vertices), np.asarray(read.faces), process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=MERGED)
    mesh.update_faces(mesh.nondegenerate_faces())
    middle = np.round(mesh.bounds.mean(axis=0), 6)
    return TriangleMesh(np.asarray(mesh.vertices - middle), np.asarray(mesh.faces, dtype=np.int32)), middle


@functools.cache
def case(name: str, overlaps: tuple[tuple[str, str], ...] = ()) -> Assembly:
    """A case as an assembly in metres. Fixed is the heaviest part on the ground; of factory_pegs, the plates.

    Args:
        name: of the folder.
        overlaps: pairs of parts that may overlap as drawn.
    """
    files = sorted(folder(name).glob("*.obj"))
    meshes = {file.stem: surface(file) for file in files}
    shapes = {part: Mesh(mesh) for part, (mesh, _) in meshes.items()}
    masses = {part: max(DENSITY * shape.volume(), 1e-4) for part, shape in shapes.items()}
    lowest = {part: float(mesh.vertices[:, 2].min() + middle[2]) for part, (mesh, middle) in meshes.items()}
    ground = min(lowest.values())
    heaviest = max((part for part in shapes if lowest[part] < ground + ON_GROUND), key=lambda part: masses[part])
    fixed = {part for part in shapes if part.startswith("hole_")} or {heaviest}
    parts = []
    for part, shape in shapes.items():
        T = np.eye(4)
        T[:3, 3] = meshes[part][1]
        parts.append(Part(part, shape, T, masses[part], part in fixed))
    return Assembly(name, tuple(parts), allowed_overlaps=overlaps)
