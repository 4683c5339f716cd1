"""An assembly or a plan as one HTML file that plays from disk, without a server and without the network.

The file holds the arm's meshes, the parts, the joint paths and what is told of each part as data, and a player in plain
JavaScript and WebGL (`assets`). The player computes the arm's forward kinematics itself.
"""

from __future__ import annotations

import base64
import json
import math
import os
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from takeapart.formats.bound_texts import explanation
from takeapart.formats.documents import write_atomically
from takeapart.formats.messages import shown
from takeapart.formats.plan_texts import partial_claim, partial_text, straight_line_text, title_of
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array
from takeapart.model.plan import Plan
from takeapart.planning.run_journal import recorded_answers
from takeapart.planning.runs import JOURNAL
from takeapart.show.facts import PartFacts, part_facts, why_not_earlier
from takeapart.show.markup import digest_source
from takeapart.show.playback import GRIP, PLAYBACK, SPEEDS, TOOL_SPEED
from takeapart.show.robot import BROWSER_CELL, Mesh, RobotVisual, coarser
from takeapart.show.scene import CURRENT, FINGERS_OPEN, GOAL, PATH, STEEL, PlanScene
from takeapart.show.subject import load_subject
from takeapart.show.surfaces import NORMAL_STEPS, Surface, creased
from takeapart.show.view import view_of

ASSETS = Path(__file__).resolve().parent / "assets"
MAXIMUM_BYTES = 10 * 2**20
FORMAT, VERSION = "takeapart/page", 3
HULL_CELL = 0.008  # m, details of shadows below this are merged
LIGHT = np.array([-0.38, -0.55, 1.0])  # toward it, for who looks from "corner"
PATH_POINTS = 80  # of the line that shows a tool path


def save_page(
    path: str | os.PathLike[str],
    out: str | os.PathLike[str],
    assembly: Path | None = None,
    workcell: str | None = None,
) -> None:
    """Write the page of an assembly, a plan or a run directory, atomically.

    Args:
        path: of the file or directory; of an assembly the page shows the parts, there is nothing to play.
        out: the HTML file.
        assembly, workcell: as for `takeapart.show.subject.load_subject`.

    Raises:
        InputError: the run has no plan yet, a plan does not belong to its assembly, the page would exceed 10 MB, or it
            cannot be written.
    """
    subject = load_subject(Path(path), assembly, workcell)
    if subject.run is not None and subject.plan is None:
        raise InputError("holds no plan yet; a run has one once its search has ended", shown(path))
    answers = recorded_answers(subject.run / JOURNAL) if subject.run else []
    scene = PlanScene(subject.assembly, subject.workcell, subject.plan)
    text = page(scene, part_facts(scene, answers))
    if len(text) > MAXIMUM_BYTES:
        raise InputError(f"the page would have {len(text) / 2**20:.1f} MiB; at most 10 are written", shown(out))
    write_atomically(out, text)


def page(scene: PlanScene, facts: Sequence[PartFacts]) -> str:
    """The HTML document of an assembly or a plan."""
    return assembled(json.dumps(document(scene, facts), separators=(",", ":"), allow_nan=False))


def assembled(data: str) -> str:
    """The player around its data. The player stands first, so that it can tell when the data were cut off.

    The page's policy lets run this player, named by its hash, and nothing else, and reaches no network.
    """
    data = data.replace("<", "\\u003c")  # nothing in the data may end its element
    style, script = (
        "\n".join((ASSETS / file).read_text(encoding="utf-8") for file in files)
        for files in (("player.css",), ("motion.js", "drawing.js", "player.js"))
    )
    policy = (
        f"default-src 'none'; script-src {digest_source(script)}; style-src {digest_source(style)}; "
        "base-uri 'none'; form-action 'none'"
    )
    html = (ASSETS / "player.html").read_text(encoding="utf-8")
    for name, text in (("policy", policy), ("style", style), ("script", script)):
        html = html.replace(f"/*{name}*/", text)
    return html.replace("/*checksum*/", str(zlib.crc32(data.encode()))).replace("/*data*/", data)


def document(scene: PlanScene, facts: Sequence[PartFacts]) -> dict[str, Any]:
    """All that the player knows, as JSON holds it: m, rad; poses row by row. Without a plan there are no steps."""
    view, plan, name = view_of(scene), scene.plan, scene.assembly.name
    return {
        "format": FORMAT,
        "version": VERSION,
        "title": name if plan is None else title_of(plan),
        "partial": "" if plan is None else partial_text(plan),
        "partial_claim": "" if plan is None else partial_claim(plan),
        "direction": scene.direction,
        "workcell": scene.workcell.name,
        "total": None if plan is None else plan.total_length,
        "bounds": {}
        if plan is None
        else {"straight-line bound": plan.straight_line_bound, "sequence bound": plan.sequence_bound},
        "bounds_note": "" if plan is None else _bounds_note(plan),
        "playback": {
            "note": PLAYBACK,
            "grip": GRIP,
            "tool_speed": TOOL_SPEED,
            "fingers_open": FINGERS_OPEN,
            "speeds": SPEEDS,
        },
        "counts": {} if plan is None else plan.counts,
        "colors": {"current": CURRENT, "path": PATH, "goal": GOAL, "obstacle": STEEL},
        "shapes": [_surface(each) for each in scene.surfaces.values()],
        "parts": [_part(scene, i, each) for i, each in enumerate(facts)],
        "steps": [_step(scene, k) for k in range(len(scene.steps))],
        "robot": robot_document(scene.robot),
        "home": scene.workcell.home.tolist(),
        "goal": scene.workcell.goal.tolist(),
        "obstacles": [_box(o.box.T_frame_box, o.box.half_extents) for o in scene.workcell.environment],
        "floor": _floor(scene),
        "path_radius": round(scene.path_radius, 5),
        "opening": scene.workcell.description.maximum_opening,
        "view": {
            "target": view.target.tolist(),
            "direction": view.direction.tolist(),
            "distance": view.distance,
            "field": view.field,
            "light": _numbers(view.beside_camera(LIGHT)),
        },
    }


def _bounds_note(plan: Plan) -> str:
    return explanation(straight_line_text(plan) if plan.straight_line_bound else "", bool(plan.sequence_bound))


def facts_document(facts: PartFacts) -> dict[str, Any]:
    """What the panel tells of a part."""
    return {
        "why": why_not_earlier(facts),
        "alternatives": [
            {"length": each.length, "blockers": list(each.blockers), "step": each.step} for each in facts.alternatives
        ],
        "refusals": facts.refusals,
    }


def _part(scene: PlanScene, i: int, facts: PartFacts) -> dict[str, Any]:
    part, surface = scene.assembly.parts[i], scene.surface(i)
    boxes, walls = scene.boxes(i)
    return {
        "name": part.name,
        "role": facts.role,
        "color": scene.colors[i],
        "fixed": part.fixed,
        "pose": _numbers(part.T_world_part),
        "laid": _numbers(scene.laid_out[i]) if i in scene.laid_out else None,
        "shape": None if surface is None else list(scene.surfaces.values()).index(surface),
        "boxes": [_box(box.T_frame_box, box.half_extents) for box in (*boxes, *walls)],
        "own": len(boxes),
        "size": [round(1000 * edge, 1) for edge in facts.size],
        "mass": part.mass,
        "bound": facts.bound if math.isfinite(facts.bound) else None,
        **facts_document(facts),
    }


def _step(scene: PlanScene, k: int) -> dict[str, Any]:
    step = scene.steps[k]
    points = np.asarray(step.tool_path)[:, :3]
    chosen = np.unique(np.linspace(0, len(points) - 1, PATH_POINTS).astype(int))
    facts = scene.assembly.parts[scene.order[k]]
    return {
        "part": scene.order[k],
        "name": facts.name,
        "length": step.length,
        "width": step.grasp.width,
        "grasp": scene.grasp_text(k),
        "held": _numbers(scene.T_hand_parts[k]),
        "rows": len(step.joint_path),
        "joints": _packed(np.asarray(step.joint_path, dtype="<f4")),
        "along": _packed(scene.along(k).astype("<f4")),
        "path": _packed(points[chosen].astype("<f4")),
    }


def robot_document(robot: RobotVisual) -> dict[str, Any]:
    """Links, joints and meshes of the arm."""
    return {
        "base": _numbers(robot.T_world_base),
        "hand": robot.hand,
        "openings": _numbers(np.array(robot.description.gripper.openings)),
        "positions": [_numbers(np.array(row)) for row in robot.description.gripper.positions],
        "links": [
            {
                "parent": link.parent,
                "pose": _numbers(link.T_parent_joint),
                "joint": link.joint,
                "follows": [link.multiplier, link.offset],
                "slides": link.slides,
                "axis": _numbers(link.axis),
                "meshes": [_mesh(mesh) for mesh in link.meshes],
                "shadow": _hull(link.meshes) if link.meshes else None,
            }
            for link in robot.links
        ],
    }


def _mesh(mesh: Mesh) -> dict[str, Any]:
    """A piece of the arm, in its own colour."""
    coarse = coarser(mesh, BROWSER_CELL)
    return {
        "color": [round(value, 3) for value in mesh.color],
        **_triangles(*creased(coarse.vertices, coarse.faces)),
    }


def _surface(surface: Surface) -> dict[str, Any]:
    """A shape that one or more parts have."""
    return {"triangles": surface.triangles, **_triangles(surface.vertices, surface.normals, surface.faces)}


def _triangles(vertices: NDArray[np.float32], normals: NDArray[np.float32], faces: NDArray[np.int32]) -> dict[str, Any]:
    """Positions as 16-bit fractions of the bounding box, normals as bytes."""
    low = vertices.min(axis=0).astype(float)
    size = np.maximum(vertices.max(axis=0) - low, 1e-6)
    return {
        "low": _numbers(low),
        "size": _numbers(size),
        "positions": _packed(np.round((vertices - low) / size * 65535).astype("<u2")),
        "normals": _packed(np.round(normals * NORMAL_STEPS).astype("i1")),
        "faces": _packed(faces.astype("<u4" if len(vertices) > 65535 else "<u2")),
        "wide": len(vertices) > 65535,
    }


def _hull(meshes: Sequence[Mesh]) -> dict[str, Any]:
    """The convex hull of a link: what throws its shadow."""
    points = np.concatenate([mesh.vertices for mesh in meshes])
    coarse = np.unique(np.round(points / HULL_CELL), axis=0) * HULL_CELL
    is_thick = np.ptp(coarse, axis=0).min() >= 2 * HULL_CELL  # thinner ones may be flat in the grid
    hull = trimesh.convex.convex_hull(coarse if is_thick else points)
    return {"positions": _packed(np.asarray(hull.vertices, dtype="<f4")), "faces": _packed(hull.faces.astype("<u2"))}


def _floor(scene: PlanScene) -> float:
    """Height, m, on which shadows fall: the top of what the assembly stands on, or its lowest point."""
    low = float(scene.bounds[0][2])
    tops = [float(obstacle.box.corners()[:, 2].max()) for obstacle in scene.workcell.environment]
    return max((top for top in tops if top < low + 0.01), default=low)


def _box(T: Array, half: Array) -> list[float]:
    """Pose, row by row, and half extents: 15 numbers."""
    return [*_numbers(T[:3]), *_numbers(half)]


def _numbers(values: Array) -> list[float]:
    return [round(float(value), 7) + 0.0 for value in np.asarray(values).ravel()]


def _packed(values: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()
