"""When what happens, as a plan is played: grip, move, let go, for every step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

from takeapart.show.scene import FINGERS_OPEN, TURNING

GRIP = 0.4  # s, to close the gripper, and to open it
TOOL_SPEED = 0.25  # m/s, as it is shown; how fast the arm may go is no matter of a plan
SPEEDS = {"½×": 0.5, "1×": 1.0, "2×": 2.0, "4×": 4.0, "10×": 10.0}
"""How many times as fast a plan can be played, by the name that is shown."""

USUAL_SPEED = "1×"

PLAYBACK = (
    "Playback time, not the arm's: a plan has no timing. It is proportional to the gripper's way "
    f"({TOOL_SPEED:g} m/s at {USUAL_SPEED}, turning counted as {100 * TURNING:g} cm per radian), with {GRIP:g} s to "
    f"grip and {GRIP:g} s to let go."
)


@dataclass(frozen=True)
class Place:
    """A moment of a plan.

    Args:
        step: number of the removal, in the order of disassembly.
        fraction: of its path.
        extra: m, how much wider than the grasp the gripper is.
    """

    step: int
    fraction: float
    extra: float


class Timeline:
    """Maps seconds of playing to moments.

    Args:
        ways: of the steps, m, in the order of disassembly.
        direction: in which they are played, "disassembly" or "assembly".
    """

    def __init__(self, ways: Sequence[float], direction: str) -> None:
        self.ways, self.direction = tuple(ways), direction
        self._starts = [0.0, *accumulate(2 * GRIP + way / TOOL_SPEED for way in self.ways)]

    @property
    def order(self) -> tuple[int, ...]:
        """Numbers of the removals as they are played."""
        steps = range(len(self.ways))
        return tuple(steps if self.direction == "disassembly" else reversed(steps))

    @property
    def total(self) -> float:
        """Seconds."""
        return self._starts[-1]

    def at(self, time: float) -> Place:
        """The moment at a time since the beginning, s."""
        if self.direction == "assembly":
            time = self.total - time
        step = max(k for k in range(len(self.ways)) if k == 0 or time >= self._starts[k])
        since, moving = time - self._starts[step], self.ways[step] / TOOL_SPEED
        fraction = min(max((since - GRIP) / moving, 0.0), 1.0) if moving else 1.0
        open_ = 0.0
        if since < GRIP:
            open_ = 1 - since / GRIP
        elif since > GRIP + moving:
            open_ = min((since - GRIP - moving) / GRIP, 1.0)
        return Place(step, fraction, FINGERS_OPEN * open_)

    def start(self, step: int) -> float:
        """Second at which a step, numbered in the order of disassembly, begins."""
        return self._starts[step] if self.direction == "disassembly" else self.total - self._starts[step + 1]

    def number(self, step: int) -> int:
        """Of a step as it is played, from 1."""
        return step + 1 if self.direction == "disassembly" else len(self.ways) - step

    def jump(self, time: float, by: int) -> float:
        """The beginning of the next step (by = 1), or of this or the one before (by = -1)."""
        starts = sorted(self.start(step) for step in range(len(self.ways)))
        if by > 0:
            return next((start + 1e-6 for start in starts if start > time + 1e-3), self.total)
        return max((start + 1e-6 for start in starts if start < time - 0.05), default=0.0)
