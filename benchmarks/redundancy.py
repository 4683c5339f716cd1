"""Whether sampling the arm's redundancy loses grasps. ``python benchmarks/redundancy.py``.

A grasp is lost if none of the sampled inverse kinematics solutions can hold and lift the part clear of what never
leaves, although another solution can. For grasps without any way, as many more solutions are sought by Newton's method
from random configurations, and lifted in the same manner.
"""

from __future__ import annotations

import argparse

import numpy as np

from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.model.geometry import Array, pose_inverse
from takeapart.removal.planner import RemovalPlanner
from takeapart.robot.ik import solver_of
from takeapart.robot.loading import load_robot
from takeapart.robot.model import RobotModel
from takeapart.states import members


class MoreSolutions:
    """Stands in for the inverse kinematics: solutions that Newton's method finds from random configurations."""

    def __init__(self, robot: RobotModel, count: int, rng: np.random.Generator) -> None:
        self._solver = solver_of(robot)
        self._T_base_world = pose_inverse(robot.T_world_base)
        self._robot, self._count, self._rng = robot, count, rng

    def solve(self, T_world_tool: Array, opening: float = 0.0) -> Array:
        """Distinct solutions (S, n), rad."""
        T_tool_flange = pose_inverse(self._robot.T_flange_tool(opening))
        T = self._solver.to_library(self._T_base_world @ T_world_tool @ T_tool_flange)
        arm = self._robot.arm
        found: list[Array] = []
        for _ in range(self._count):
            seed = self._rng.uniform(arm.lower, arm.upper)
            for solution in self._solver.module.solve(T, q_seed=seed, max_solutions=1, allow_rescue=False):
                if all(np.abs(solution.q - q).max() > 1e-3 for q in found):
                    found.append(np.asarray(solution.q))
        return np.array(found).reshape(-1, self._robot.joints)

    def solve_both(self, T_world_tool: Array, opening: float = 0.0) -> tuple[Array, Array]:
        """For the pose, and turned by half a turn about the approach direction."""
        turned = T_world_tool.copy()
        turned[:3, :2] *= -1
        return self.solve(T_world_tool, opening), self.solve(turned, opening)


def main() -> None:
    """Prints how many grasps have a way, how many have none, and how many of those the denser sample rescues."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--assemblies", type=int, default=3)
    parser.add_argument("--grasps", type=int, default=200, help="grasps looked at in each assembly")
    parser.add_argument("--solutions", type=int, default=200, help="random configurations for each grasp without a way")
    arguments = parser.parse_args()
    rng = np.random.default_rng(0)
    workcell = load_workcell("panda")
    robot = load_robot(workcell)
    ways = none = lost = solutions = 0
    for k in range(1, arguments.assemblies + 1):
        planner = RemovalPlanner(load_assembly(data_path(f"single/{k:02d}.json")), workcell, robot=robot)
        dense = RemovalPlanner(
            planner.assembly, workcell, robot=robot, ik=MoreSolutions(robot, arguments.solutions, rng)
        )
        work = robot.workspace()
        pairs = [(p, n) for p in members(planner.assembly.root) for n in range(len(planner.reach.candidates(p)))]
        for index in rng.permutation(len(pairs))[: arguments.grasps]:
            part, number = pairs[int(index)]
            if planner.reach.hands(part, work)[number].blockers is None:
                continue
            branches = planner.reach.branches(part, number, 0, work)
            solutions += len(branches)
            if branches:
                ways += 1
            else:
                none += 1
                lost += bool(dense.reach.branches(part, number, 0, work))
    print(f"grasps that the hand can take: {ways + none}; with a way to hold and lift the part: {ways}")
    print(f"ways for each of those on average: {solutions / max(ways, 1):.1f}")
    print(f"grasps without a way: {none}; of these the denser sample finds one for: {lost}")


if __name__ == "__main__":
    main()
