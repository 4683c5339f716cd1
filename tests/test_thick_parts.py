"""Parts as thick as the gripper opens: what is above the fingers must be known closely, or none can be gripped."""

from __future__ import annotations

import pytest

from support_scenes import box
from takeapart.formats.files import load_workcell
from takeapart.model.assembly import Assembly, Connector, Part
from takeapart.model.geometry import Box, pose
from takeapart.model.plan import Plan
from takeapart.planning import PlanningOptions, plan
from takeapart.search.result import Budget
from takeapart.verification import verify_plan

MIDDLE = (0.1, 0.25)  # m


def cube_on_stand(edge: float) -> Assembly:
    """A cube between two cheeks 10 mm high, half a millimetre from either."""
    stand = Part("stand", Box((0.1, 0.1, 0.1)), pose((*MIDDLE, 0.05)), 1.0, fixed=True)
    cube = Part("cube", Box((edge, edge, edge)), pose((*MIDDLE, 0.102 + edge / 2)), 0.2)
    half = edge / 2 + 0.0015
    floor = box(0, 0, 0.051, (edge, edge, 0.002))
    cheeks = tuple(box(side * half, 0, 0.055, (0.002, edge, 0.01)) for side in (-1, 1))
    return Assembly("cube", (stand, cube), (Connector("seat", "U", "stand", "cube", (floor, *cheeks)),))


@pytest.mark.parametrize("edge", [0.05, 0.07])
def test_a_cube_is_gripped_planned_and_verified(edge: float) -> None:
    workcell, assembly = load_workcell("panda"), cube_on_stand(edge)
    made = plan(assembly, workcell, PlanningOptions(search="greedy", budget=Budget()))
    assert isinstance(made, Plan), made
    report = verify_plan(made, assembly, workcell, physics=False)
    assert not report.findings, report.findings
