"""The table of docs/robots.md: python benchmarks/robots.py

Arm, joints, bodies, spheres and how far they reach beyond the hulls, processor time of one query of inverse kinematics,
and which pairs of bodies are left out and why.
"""

from __future__ import annotations

import sys
import time
from collections import Counter

import numpy as np

from takeapart.formats.robot_files import load_robot_description
from takeapart.robot.ik import InverseKinematics
from takeapart.robot.loading import load_robot
from takeapart.workcell import Workcell

NAMES = ("panda", "ur5e", "xarm7")
POSES = 200


def row(name: str) -> str:
    description = load_robot_description(name)
    arm = description.arm
    cell = Workcell(name, description, np.eye(4), np.array(arm.home), np.array([0.3, 0.0, 0.3]))
    robot = load_robot(cell)
    pairs = Counter(pair.treatment for pair in robot.pairs)
    widest = sorted({round(1e3 * value) for value in robot.inflation.values()}, reverse=True)
    solver, rng, spent, found = InverseKinematics(robot), np.random.default_rng(0), 0.0, 0
    for _ in range(POSES):
        target = robot.tool_pose(rng.uniform(robot.arm.lower, robot.arm.upper), opening=0.02)
        begin = time.process_time()
        found += len(solver.solve(target, 0.02))
        spent += time.process_time() - begin
    cells = [
        description.name,
        str(robot.joints),
        str(len(robot.bodies)),
        str(len(robot.arm.sphere_radius)),
        ", ".join(map(str, widest)),
        f"{1e3 * spent / POSES:.2f}",
        f"{found / POSES:.1f}",
        *(str(pairs[treatment]) for treatment in ("neighbours", "always touch", "never meet", "table", "hulls")),
    ]
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    for robot_name in sys.argv[1:] or NAMES:
        print(row(robot_name))
