"""Small valid documents, as plain data, for the tests of files."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

Document = dict[str, Any]

WORKCELL = """
format = "takeapart/workcell"
version = 1
name = "bench"
goal = [-0.25, -0.20, 0.35]
lift_height = 0.05
clearance = 0.001

[robot]
model = "panda"
home = [0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398]

[robot.base]
position = [-0.30, 0.20, 0.20]
orientation = [1.0, 0.0, 0.0, 0.0]

[[environment]]
name = "table"
size = [1.6, 1.4, 0.04]
position = [0.1, 0.2, -0.02]
orientation = [1.0, 0.0, 0.0, 0.0]
"""


def pose(x: float, y: float, z: float) -> Document:
    return {"position": [x, y, z], "orientation": [1.0, 0.0, 0.0, 0.0]}


def assembly() -> Document:
    """A fixed base, a bar on it, and a turned block; the base carries the bar's end in a connector of one wall."""
    return {
        "format": "takeapart/assembly",
        "version": 1,
        "name": "bench",
        "parts": [
            part("base", [0.4, 0.4, 0.02], pose(0.2, 0.2, 0.01), fixed=True),
            part("bar", [0.3, 0.02, 0.02], pose(0.2, 0.2, 0.03)),
            part("block", [0.05, 0.04, 0.03], {"position": [0.1, 0.1, 0.05], "orientation": [0.9689, 0, 0, 0.2474]}),
        ],
        "connectors": [
            {
                "name": "holder",
                "kind": "U",
                "host": "base",
                "guest": "bar",
                "walls": [{"size": [0.02, 0.002, 0.02], **pose(0.0, 0.0115, 0.02)}],
            }
        ],
        "witness": ["block", "bar"],
        "provenance": {"generator": "by hand", "seed": 7},
    }


def part(name: str, size: list[float], where: Document, fixed: bool = False) -> Document:
    return {"name": name, "shape": {"kind": "box", "size": size}, "pose": where, "mass": 0.5, "fixed": fixed}


def plan() -> Document:
    rows = 4
    step = {
        "part": "block",
        "grasp": {"center": [0.1, 0.1, 0.05], "orientation": [0.0, 1.0, 0.0, 0.0], "width": 0.04},
        "joint_path": [[0.1 * i, -0.5, 0.0, -2.0, 0.0, 1.5, 0.123456789] for i in range(rows)],
        "tool_path": [[0.1, 0.1, 0.05 + 0.01 * i, 0.0, 1.0, 0.0, 0.0] for i in range(rows)],
        "length": 0.03,
    }
    return {
        "format": "takeapart/plan",
        "version": 2,
        "robot": "panda",
        "joints": [f"panda_joint{i}" for i in range(1, 8)],
        "assembly": "bench",
        "workcell": "bench",
        "direction": "disassembly",
        "total_length": 0.06,
        "straight_line_bound": 0.05,
        "sequence_bound": None,
        "counts": {"motion_plans": 12, "removal_queries": 3},
        "seconds": 1.25,
        "seed": 7,
        "search": {"name": "mcts", "episodes": 20, "options": {"memory": "library"}},
        "hashes": {"assembly": "0" * 64, "workcell": "f" * 64},
        "versions": {"takeapart": "0.1.0"},
        "steps": [step, {**copy.deepcopy(step), "part": "bar"}],
    }


def snapshot(folder: Path) -> dict[str, bytes]:
    """Everything in a folder, to see whether something was written."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
