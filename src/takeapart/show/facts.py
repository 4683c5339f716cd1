"""What is told of a part beside its picture: when it leaves, why not earlier, and other ways that the planner found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from takeapart.collision.contact import Contacts
from takeapart.model.assembly import Assembly
from takeapart.model.geometry import OrientedBox
from takeapart.removal.exits import Exits
from takeapart.removal.grasps import volume_bound
from takeapart.removal.journal import RecordedAnswer, RemovalQuery
from takeapart.removal.lifting import lift_blockers
from takeapart.removal.margins import padding, passing
from takeapart.removal.result import Blocked, Removal
from takeapart.show.scene import PlanScene, role_of
from takeapart.stability import ConnectorStability, stability_of
from takeapart.states import members

SHOWN_ALTERNATIVES = 6

Answers = Sequence[tuple[RemovalQuery, RecordedAnswer]]


@dataclass(frozen=True)
class Alternative:
    """Another removal of a part that a run found.

    Args:
        length: m.
        blockers: names of the parts that must be gone before.
        step: of the plan from which it is possible, counted from 1; 0 where one of them leaves after the part.
    """

    length: float
    blockers: tuple[str, ...]
    step: int


@dataclass(frozen=True)
class PartFacts:
    """A part in a plan.

    Args:
        name, role: see `takeapart.show.scene.role_of`.
        size: edges of its bounding box, m.
        mass: kg.
        step: in which it leaves in a disassembly, counted from 1; 0 where it stays.
        length: of its path, m.
        bound: straight up and straight to the goal, from the best point of its volume, m.
        grasp: in words.
        carries: names of the parts that would fall if it left first.
        under: names of the parts it would hit when lifted first.
        lifts: False where it can never be lifted, because of something that never leaves.
        earliest: first step in which gravity and lifting let it go, given the order of the plan; 0 without a plan.
        freed_by: name of the part whose leaving made that possible; empty where it is possible from the start.
        alternatives: shortest first.
        refusals: how often the planner refused it, by stage.
        is_lifted: whether straight up is its only way out; else more than what is told here may keep it.
        remains: whether a plan leaves it where it is; what it carries, and what is in its way, are then those that
            remain too.
    """

    name: str
    role: str
    size: tuple[float, float, float]
    mass: float
    step: int = 0
    length: float = 0.0
    bound: float = 0.0
    grasp: str = ""
    carries: tuple[str, ...] = ()
    under: tuple[str, ...] = ()
    lifts: bool = True
    earliest: int = 0
    freed_by: str = ""
    alternatives: tuple[Alternative, ...] = ()
    refusals: dict[str, int] = field(default_factory=dict)
    is_lifted: bool = True
    remains: bool = False


def hindrances(scene: PlanScene) -> list[tuple[int, int]]:
    """Per part the states of the parts that gravity, and lifting, want gone before it; root where it never lifts."""
    assembly, cell = scene.assembly, scene.workcell
    obstacles = tuple(obstacle.box for obstacle in cell.environment)
    if not assembly.is_lifted:
        return _hindrances_of_exits(assembly, obstacles, passing(cell.clearance))
    stability = ConnectorStability(assembly)
    lifting = lift_blockers(assembly, cell.lift_height, padding(cell.clearance), obstacles, passing(cell.clearance))
    return [
        (0, 0)
        if part.fixed
        else (stability.dependents(i, assembly.root), assembly.root if lifting[i] is None else lifting[i] or 0)
        for i, part in enumerate(assembly.parts)
    ]


def _hindrances_of_exits(
    assembly: Assembly, obstacles: tuple[OrientedBox, ...], clearance: float
) -> list[tuple[int, int]]:
    """The same where parts leave in any direction: who has nothing else to rest on, and what every way out meets. More
    may keep a part; that is asked state by state."""
    stability, rule = stability_of(assembly), Exits(assembly, Contacts(assembly), obstacles, clearance)
    found = []
    for i, part in enumerate(assembly.parts):
        masks = [way.blockers for way in rule.exits(i) if way.blockers is not None]
        met = assembly.root
        for mask in masks:
            met &= mask
        found.append((0, 0) if part.fixed else (stability.dependents(i, assembly.root), met))
    return found


def part_facts(scene: PlanScene, answers: Answers = ()) -> tuple[PartFacts, ...]:
    """What is known of every part, in the order of the assembly.

    Args:
        answers: of the planner, from the journal of a run.
    """
    assembly, held_up = scene.assembly, hindrances(scene)
    facts = []
    for i, part in enumerate(assembly.parts):
        box = part.shape.bounding_box()
        x, y, z = (float(2 * half) for half in box.half_extents)
        common = PartFacts(part.name, role_of(part), (x, y, z), part.mass)
        if part.fixed:
            facts.append(common)
            continue
        carried, lifted = held_up[i]
        step = scene.order.index(i) + 1 if i in scene.order else 0
        remains = bool(scene.steps) and not step
        seen = scene.state(len(scene.steps)) if remains else assembly.root
        earliest, freed_by = _earliest(scene, i, carried | lifted)
        own = [answer.answer for query, answer in answers if query.part == i]
        stages = [answer.stage for answer in own if isinstance(answer, Blocked)]
        facts.append(
            PartFacts(
                part.name,
                common.role,
                common.size,
                part.mass,
                step,
                scene.steps[step - 1].length if step else 0.0,
                volume_bound(part, scene.workcell.lift_height if assembly.is_lifted else 0.0, scene.workcell.goal),
                scene.grasp_text(step - 1) if step else "",
                tuple(assembly.names(carried & seen)),
                tuple(assembly.names(lifted & seen & ~(1 << i))) if lifted != assembly.root else (),
                lifted != assembly.root,
                earliest,
                freed_by,
                _alternatives(scene, i, [answer for answer in own if isinstance(answer, Removal)]),
                {stage: stages.count(stage) for stage in dict.fromkeys(stages)},
                assembly.is_lifted,
                remains,
            )
        )
    return tuple(facts)


def _earliest(scene: PlanScene, part: int, mask: int) -> tuple[int, str]:
    """First step, from 1, whose state shares no part with a mask, and the part that left last before it; (0, "") where
    there is none up to the step in which the part leaves."""
    mask &= ~(1 << part)
    for step in range(len(scene.order)):
        if not scene.state(step) & mask:
            return step + 1, scene.assembly.parts[scene.order[step - 1]].name if step else ""
        if scene.order[step] == part:
            break
    return 0, ""


def _alternatives(scene: PlanScene, part: int, removals: list[Removal]) -> tuple[Alternative, ...]:
    kept: list[Removal] = []
    for removal in sorted(removals, key=lambda each: (each.length, each.blockers.bit_count())):
        if not any(removal.blockers & other.blockers == other.blockers for other in kept):  # else longer for nothing
            kept.append(removal)
    return tuple(
        Alternative(
            removal.length,
            tuple(scene.assembly.names(removal.blockers & ~(1 << part))),
            _earliest(scene, part, removal.blockers)[0],
        )
        for removal in kept[:SHOWN_ALTERNATIVES]
    )


def why_not_earlier(facts: PartFacts) -> str:
    """One or two sentences for people."""
    if facts.role == "fixed":
        return "Fixed: it never leaves, and nothing may hit it."
    if not facts.lifts:
        way = "be lifted" if facts.is_lifted else "get out"
        return f"It can never {way}: something that never leaves is in the way."
    reasons = [f"{_listed(facts.carries)} would fall without it"] if facts.carries else []
    if facts.remains:
        if facts.under:
            way = "lifted, it would hit" if facts.is_lifted else "every way out meets"
            reasons.append(f"{way} {_listed(facts.under)}")
        why = f": {', and '.join(reasons)}" if reasons else "; 'takeapart explain' tells what keeps it"
        return f"It remains, the plan is partial{why}."
    if not facts.is_lifted:
        reasons += [f"every way out meets {_listed(facts.under)}"] if facts.under else []
        start = f"At the start {', and '.join(reasons)}. " if reasons else ""
        return f"{start}The order of the plan has it in step {facts.step}." if facts.step else start.strip()
    if not facts.carries and not facts.under:
        start = "Gravity and lifting let it go from the start"
    else:
        if facts.under:
            reasons.append(f"lifted, it would hit {_listed(facts.under)}")
        start = f"At the start {', and '.join(reasons)}"
        if facts.earliest:
            start += f"; that ends in step {facts.earliest}, when {facts.freed_by} is gone"
    if not facts.step:  # no plan
        return f"{start}."
    if facts.earliest == facts.step:
        return f"{start}: it leaves at the first moment that they allow."
    return f"{start}. The order of the plan has it in step {facts.step}."


FREEDOM_NOTE = (
    "Carries: parts that would fall without it. Below: parts that it would hit when lifted. Free from: the first step "
    "of the disassembly in which gravity and lifting let it go, given the order; where it leaves later, that is the "
    "choice of the plan."
)
"""What `freedom` means of parts that are lifted, to be said once."""

FREEDOM_NOTE_OF_EXITS = (
    "Carries: parts that would fall without it. Behind: parts that every way out of it meets. More may keep it: that "
    "depends on the state."
)
"""The same of parts that leave in any direction."""


def freedom_note(facts: Sequence[PartFacts]) -> str:
    """What `freedom` means of the parts of a product."""
    return FREEDOM_NOTE if all(each.is_lifted for each in facts) else FREEDOM_NOTE_OF_EXITS


def freedom(facts: PartFacts) -> str:
    """Why a part leaves no earlier, in the terms of `FREEDOM_NOTE`: only what is its own."""
    reasons = [f"carries {_listed(facts.carries)}"] if facts.carries else []
    if facts.under and set(facts.under) == set(facts.carries):
        reasons = [f"carries and is {'below' if facts.is_lifted else 'behind'} {_listed(facts.carries)}"]
    elif facts.under:
        reasons.append(f"{'below' if facts.is_lifted else 'behind'} {_listed(facts.under)}")
    if not facts.lifts:
        return "; ".join([*reasons, "can never be lifted"])
    if not facts.is_lifted:
        return "; ".join(reasons)
    if not facts.earliest:
        return "; ".join([*reasons, "not free when it leaves"])
    return "; ".join([*reasons, f"free from step {facts.earliest}" if facts.earliest > 1 else "free from the start"])


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def blocked_by(assembly: Assembly, held_up: Sequence[tuple[int, int]]) -> list[tuple[int, int, str]]:
    """Edges of the blocked-by graph, without those that follow from others: part, part that must leave before, why."""
    direct = {i: (gravity | lift) & ~(1 << i) for i, (gravity, lift) in enumerate(held_up)}

    def all_before(part: int, seen: int = 0) -> int:
        for other in members(direct[part] & ~seen):
            seen |= 1 << other
            seen |= all_before(other, seen)
        return seen

    closure = {i: all_before(i) for i in direct}
    edges = []
    for i, mask in direct.items():
        for other in members(mask):
            if not any(closure[between] >> other & 1 for between in members(mask) if between != other):
                why = "gravity" if held_up[i][0] >> other & 1 else "lift"
                edges.append((i, other, why))
    return edges
