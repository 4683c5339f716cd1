"""Whether the pads of a gripper lie on a part of any form: measured on the finger links and the part's triangles."""

from __future__ import annotations

from typing import Any

import numpy as np

from takeapart.model.geometry import Array
from takeapart.model.plan import PlanStep
from takeapart.verification.model import Scene
from takeapart.verification.report import Finding, VerificationOptions
from takeapart.verification.solids import placed


def check_pads(step: PlanStep, k: int, scene: Scene, held: int, options: VerificationOptions) -> list[Finding]:
    """The fingers of both sides are on the part, with enough of their surface.

    The area is that of what the fingers and the part have in common when the fingers close by `pad_gap` more, seen
    along the closing direction; of an open surface only the distance is known.

    Args:
        held: number of the held part's geom, a mesh.
    """
    findings = []
    _, R = scene.tool()
    exact = scene.exact
    for side, sign in zip(scene.sides, (-1.0, 1.0), strict=True):
        names, verb = " and ".join(side), "does" if len(side) == 1 else "do"
        geoms = [geom for link in side for geom in scene.geoms(link)]
        gap = min(scene.distance(geom, held) for geom in geoms)
        if gap > options.pad_gap:
            message = f"{names} {verb} not touch {step.part!r}"
            findings.append(Finding(k, step.part, 0.0, "finger_contact", message, gap))
            continue
        if not exact.solid(held).is_closed:
            continue
        area = _common_area(scene, geoms, held, -sign * options.pad_gap * R[:, 1], R)
        if area < options.pad_area:
            message = (
                f"{names} {verb} touch {step.part!r} on {1e6 * area:.1f} mm² only; "
                f"{1e6 * options.pad_area:.0f} mm² are needed"
            )
            findings.append(Finding(k, step.part, 0.0, "finger_contact", message))
    return findings


def _common_area(scene: Scene, geoms: list[int], held: int, shift: Array, R_world_tool: Array) -> float:
    """Area, m^2, of what geoms, moved by a shift (3,), m, share with the held part, seen along the tool's y."""
    exact = scene.exact
    part = placed(exact.solid(held), exact.pose(held))
    T_view_world = np.zeros((3, 4))
    T_view_world[:, :3] = R_world_tool.T[[2, 0, 1]]  # the closing direction becomes z, along which it is projected
    outline: Any = None
    for geom in geoms:
        T = exact.pose(geom)
        T[:3, 3] += shift
        common = placed(exact.solid(geom), T) ^ part
        if not common.is_empty():
            seen = common.transform(T_view_world).project()
            outline = seen if outline is None else outline + seen
    return 0.0 if outline is None else float(outline.area())
