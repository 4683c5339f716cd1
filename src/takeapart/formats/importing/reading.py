"""The bodies of a STEP file, of a mesh file, or of a folder of mesh files.

STEP is tessellated by cascadio (Open CASCADE) in a process of its own: what a broken file does to it ends in one line.
"""

from __future__ import annotations

import importlib.util
import os
import re
import stat
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from takeapart.formats.documents import read_bytes
from takeapart.formats.importing.drawn import DrawnBody
from takeapart.formats.importing.glb import glb_bodies
from takeapart.formats.messages import reason, shortened, shown
from takeapart.model.assembly import MAXIMUM_PARTS
from takeapart.model.errors import InputError, MissingExtraError

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}
STEP_ENDINGS, MESH_ENDINGS = (".step", ".stp"), (".obj", ".stl", ".ply", ".glb")
MAXIMUM_BYTES = 256 * 2**20  # of one file
MAXIMUM_FOLDER_BYTES = 2**30
LONGEST_TESSELLATION = 600.0  # s

TESSELLATE = """
import sys, cascadio
sys.exit(cascadio.step_to_glb(sys.argv[1], sys.argv[2], tol_linear=float(sys.argv[3]), tol_angular=0.3) or 0)
"""


def drawn_bodies(path: Path, unit: str | None, deflection: float) -> tuple[list[DrawnBody], float, str]:
    """The bodies of a product, the length of the file's unit in metres, and the unit in words.

    Args:
        unit: of OBJ, STL and PLY files, which do not say it.
        deflection: m, largest distance between the surface of a STEP file and its triangles.

    Raises:
        InputError: what is there is not what can be read, in one line.
        MissingExtraError: cascadio is missing.
    """
    where = shown(path)
    if unit is not None and unit not in UNITS:
        raise InputError(f"unknown unit {shortened(unit)}; valid: {', '.join(UNITS)}", "--unit")
    files = _files(path, where)
    endings = {file.suffix.lower() for file in files}
    if endings & {*STEP_ENDINGS} and len(files) > 1:
        raise InputError("holds STEP files; give one of them, which holds the whole product", where)
    says_itself = endings <= {*STEP_ENDINGS, ".glb"}
    if not says_itself and unit is None:
        raise InputError("OBJ, STL and PLY files do not say their unit; give --unit mm, cm, m or inch", where)
    if not says_itself and ".glb" in endings and unit != "m":
        raise InputError(f"GLB is in metres, the other files in {unit}; put them into folders of their own", where)
    found: list[DrawnBody] = []
    for number, file in enumerate(files):
        single = len(files) == 1 and not path.is_dir()
        bodies = _bodies(file, deflection, single)
        found += [
            DrawnBody(each.name, each.vertices, each.triangles, each.T_world_body, each.shape + 1_000_000 * number)
            for each in bodies
        ]
    if not found:
        raise InputError("holds no bodies", where)
    if len(found) > MAXIMUM_PARTS:
        raise InputError(f"holds {len(found)} bodies; at most {MAXIMUM_PARTS} parts are allowed", where)
    if endings & {*STEP_ENDINGS}:
        stated = _stated_unit(files[0])
        if unit is None:
            return found, 1.0, f"{stated or 'its own'}, as the file says"
        if stated is None:
            raise InputError(f"the unit of {where} is not understood, so it cannot be replaced by {unit}", "--unit")
        return found, UNITS[unit] / UNITS[stated], f"{unit}, where the file says {stated}"
    return found, UNITS[unit or "m"], unit or "m"


def _stated_unit(file: Path) -> str | None:
    """The unit of lengths in a STEP file; None where it is another one, or several."""
    content = re.sub(rb"\s+", b"", read_bytes(file, MAXIMUM_BYTES)).upper()
    found = set(re.findall(rb"SI_UNIT\((\.[A-Z]+\.|\$),\.METRE\.\)", content))
    if b"CONVERSION_BASED_UNIT('INCH'" in content:
        return "inch"
    names = {b"$": "m", b".CENTI.": "cm", b".MILLI.": "mm"}
    return names.get(found.pop()) if len(found) == 1 else None


def _files(path: Path, where: str) -> list[Path]:
    try:
        if not path.is_dir():
            files = [path]
        else:
            entries = sorted(each for each in path.iterdir() if not each.name.startswith("."))
            files = [each for each in entries if each.suffix.lower() in (*STEP_ENDINGS, *MESH_ENDINGS)]
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read: {reason(error)}", where) from None
    valid = "STEP, OBJ, STL, PLY or GLB"
    if not files:
        raise InputError(f"holds no file that ends in {', '.join((*STEP_ENDINGS, *MESH_ENDINGS))}", where)
    if len(files) > MAXIMUM_PARTS:
        raise InputError(f"holds {len(files)} files; at most {MAXIMUM_PARTS} parts are allowed", where)
    total = 0
    for file in files:
        try:
            status = file.stat()
        except FileNotFoundError:
            raise InputError("there is no such file", shown(file)) from None
        except (OSError, ValueError) as error:
            raise InputError(f"cannot be read: {reason(error)}", shown(file)) from None
        if not stat.S_ISREG(status.st_mode):
            raise InputError("is not a regular file", shown(file))
        if file.suffix.lower() not in (*STEP_ENDINGS, *MESH_ENDINGS):
            raise InputError(f"ends in {shortened(file.suffix)}; {valid} is read", shown(file))
        if status.st_size > MAXIMUM_BYTES:
            raise InputError(
                f"has {status.st_size / 2**20:.0f} MiB; at most {MAXIMUM_BYTES // 2**20} MiB are read", shown(file)
            )
        total += status.st_size
    if total > MAXIMUM_FOLDER_BYTES:
        raise InputError(f"its files have {total / 2**20:.0f} MiB; at most 1024 MiB are read", where)
    return files


def _bodies(file: Path, deflection: float, single: bool) -> list[DrawnBody]:
    ending = file.suffix.lower()
    if ending in STEP_ENDINGS:
        return glb_bodies(_tessellated(file, deflection), shown(file), file.stem)
    content = read_bytes(file, MAXIMUM_BYTES)
    if ending == ".glb":
        return glb_bodies(content, shown(file), file.stem)
    return _meshes(file, content, ending[1:], single)


def _tessellated(file: Path, deflection: float) -> bytes:
    if importlib.util.find_spec("cascadio") is None:
        raise MissingExtraError("import of STEP", "cad", "cascadio")
    head = read_bytes(file, MAXIMUM_BYTES)[:4096]
    if b"ISO-10303-21" not in head:
        raise InputError("is not a STEP file: it does not start with ISO-10303-21", shown(file))
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "made.glb"
        command = [sys.executable, "-c", TESSELLATE, os.path.realpath(file), str(made), f"{1e3 * deflection:.6g}"]
        try:
            subprocess.run(command, capture_output=True, check=False, timeout=LONGEST_TESSELLATION, cwd=folder)
        except subprocess.TimeoutExpired:
            raise InputError(f"took longer than {LONGEST_TESSELLATION:g} s to tessellate", shown(file)) from None
        if not made.exists() or not made.stat().st_size:
            raise InputError("cannot be read as STEP: it is damaged, or holds no shapes", shown(file))
        return read_bytes(made, 4 * MAXIMUM_BYTES)


def _meshes(file: Path, content: bytes, kind: str, single: bool) -> list[DrawnBody]:
    """The meshes of a file; one of OBJ alone may hold several objects, else a file is a part."""
    import io

    import trimesh

    options: dict[str, Any] = (
        {"split_objects": single, "skip_materials": True, "maintain_order": True} if kind == "obj" else {}
    )
    try:
        scene = trimesh.load_scene(io.BytesIO(content), file_type=kind, process=False, **options)
        meshes = [(name, each) for name, each in scene.geometry.items() if isinstance(each, trimesh.Trimesh)]
        parts = [(name, np.array(each.vertices, dtype=float), np.array(each.faces, np.int64)) for name, each in meshes]
    except Exception as error:  # whatever a broken file does to the reader
        detail = shortened(str(error).splitlines()[0])[:60] if str(error) else type(error).__name__
        raise InputError(f"cannot be read as {kind.upper()}: {detail}", shown(file)) from None
    parts = [each for each in parts if len(each[2])]
    if not parts:
        raise InputError("holds no triangles", shown(file))
    if len(parts) > 1 and not single:
        starts = np.cumsum([0, *(len(each[1]) for each in parts)])
        triangles = np.concatenate([each[2] + start for each, start in zip(parts, starts, strict=False)])
        parts = [(file.stem, np.concatenate([each[1] for each in parts]), triangles)]
    return [
        DrawnBody(file.stem if len(parts) == 1 else name, vertices, triangles, np.eye(4), i)
        for i, (name, vertices, triangles) in enumerate(parts)
    ]
