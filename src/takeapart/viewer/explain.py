"""Asks the planner why a part does not leave earlier than a plan has it; only when somebody wants to know."""

from __future__ import annotations

import threading

from takeapart.planning import build_problem, explain
from takeapart.problem import AssemblyProblem
from takeapart.removal.result import Blocked, Effort
from takeapart.show.facts import PartFacts
from takeapart.show.figures import LENGTH_ROUNDING
from takeapart.show.scene import PlanScene


class Explainer:
    """Holds a planner from the first question on; thread-safe, one question at a time."""

    def __init__(self, scene: PlanScene) -> None:
        self._scene = scene
        self._problem: AssemblyProblem | None = None
        self._lock = threading.Lock()

    def ask(self, part: int, facts: PartFacts) -> str:
        """What the planner says of removing a part in the first step in which gravity and lifting let it go, in one or
        two sentences. Takes seconds, the first time a minute if the planner's kernels are not compiled yet."""
        scene = self._scene
        if not scene.steps:
            return self._whole(part)
        if facts.remains:
            return self._remaining(part)
        if not facts.step or facts.earliest in (0, facts.step):
            return "It leaves at the first moment that gravity and lifting allow; there is nothing to ask."
        state = scene.state(facts.earliest - 1)
        with self._lock:
            answer = self._known().remove(state, part, Effort())
        when = f"In step {facts.earliest}, the first that gravity and lifting allow,"
        if isinstance(answer, Blocked):
            return f"{when} the planner finds no way: {self._reason(state, answer)}."
        more = answer.length - facts.length
        if abs(more) < LENGTH_ROUNDING:
            return f"{when} it could leave on a path just as long, {answer.length:.3f} m."
        longer = "longer" if more > 0 else "shorter"
        return f"{when} its path would be {answer.length:.3f} m, {abs(more):.3f} m {longer} than in step {facts.step}."

    def _whole(self, part: int) -> str:
        """Whether the part can leave the whole assembly."""
        root = self._scene.assembly.root
        with self._lock:
            answer = self._known().remove(root, part, Effort())
        if isinstance(answer, Blocked):
            return f"It cannot leave the whole assembly: {self._reason(root, answer)}."
        return f"It can leave at once, on a path of {answer.length:.3f} m."

    def _remaining(self, part: int) -> str:
        """Whether a part that a partial plan leaves can leave once all steps are done."""
        state = self._scene.state(len(self._scene.steps))
        with self._lock:
            answer = self._known().remove(state, part, Effort())
        if isinstance(answer, Blocked):
            return f"It cannot leave what remains: {self._reason(state, answer)}."
        return f"It could leave what remains, on a path of {answer.length:.3f} m."

    def _reason(self, state: int, answer: Blocked) -> str:
        name = self._scene.assembly.parts[answer.part].name
        return next(
            str(each).removeprefix(f"{name}: ")
            for each in explain(self._known(), state, (answer,))
            if each.part == name
        )

    def _known(self) -> AssemblyProblem:
        if self._problem is None:
            self._problem = build_problem(self._scene.assembly, self._scene.workcell)
        return self._problem
