"""The experiment that runs exact search to the end."""

from __future__ import annotations

from closing import Closing, close, row
from takeapart.formats.files import load_workcell
from takeapart.robot.model import RobotModel


def test_exact_search_closes_a_shipped_assembly(robot: RobotModel) -> None:
    found = close("single/07", load_workcell("panda"), robot)
    assert found.closed
    assert found.straight_line_bound <= found.sequence_bound + 1e-9 <= found.length + 2e-9


def test_figures_by_hand() -> None:
    found = [
        Closing(1.0, 100, 12.0, 12.0, 10.0),
        Closing(3.0, 200, 11.0, 10.9, 10.0),
        Closing(2.0, 90, 13.0, 13.0, 10.0),
    ]
    assert row("single", found) == ["`single`", "2 of 3", "2.0, 1.0 to 3.0", "100, 90 to 200", "12.00 m", "20.0 %"]
