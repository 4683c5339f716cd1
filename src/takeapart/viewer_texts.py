"""What the panel of the viewer says, in Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from takeapart.render_facts import PartFacts, why_not_earlier
from takeapart.render_scene import PlanScene
from takeapart.viewer_time import Timeline


def _table(rows: Sequence[tuple[str, str]]) -> str:
    return "\n".join(["| | |", "|---|---:|", *(f"| {name} | {value} |" for name, value in rows)])


def totals_text(scene: PlanScene) -> str:
    """Total, bounds and gaps of a plan; of an assembly what it consists of."""
    plan = scene.plan
    if plan is None:
        parts, removable = len(scene.assembly.parts), scene.assembly.root.bit_count()
        return f"{parts} parts, {removable} of them removable. A plan file shows how they leave."
    rows = [("total gripper path", f"{plan.total_length:.3f} m")]
    for name, bound in (("straight-line", plan.straight_line_bound), ("sequence", plan.sequence_bound)):
        if bound:
            kind = "proved gap" if name == "straight-line" else "sequence gap"
            rows += [
                (f"{name} bound", f"{bound:.3f} m"),
                (kind, f"{(plan.total_length - bound) / bound:.1%}"),
            ]
    return _table(rows)


def now_text(scene: PlanScene, timeline: Timeline, step: int) -> str:
    """The current step."""
    number, plan_step = timeline.number(step), scene.steps[step]
    played = scene.steps[: step + 1] if timeline.direction == "disassembly" else scene.steps[step:]
    return _table(
        [
            ("**step**", f"**{number} of {len(scene.steps)}**"),
            ("part", plan_step.part),
            ("grasp", scene.grasp_text(step)),
            ("gripper path", f"{plan_step.length:.3f} m"),
            ("running total", f"{sum(each.length for each in played):.3f} m"),
        ]
    )


def part_text(scene: PlanScene, facts: PartFacts) -> str:
    """All about one part."""
    rows = [
        ("size", " × ".join(f"{1000 * edge:.4g}" for edge in facts.size) + " mm"),
        ("mass", f"{facts.mass:.3f} kg"),
    ]
    if facts.step:
        rows += [
            ("leaves in step", f"{facts.step} of {len(scene.steps)}"),
            ("gripper path", f"{facts.length:.3f} m"),
            ("straight-line bound", f"{facts.bound:.3f} m"),
        ]
    text = f"### {facts.name}\n\n{_table(rows)}\n\n{why_not_earlier(facts)}"
    if facts.alternatives:
        text += "\n\nOther removals in the library:\n\n"
        text += _table(
            [
                (
                    f"{each.length:.3f} m",
                    (f"without {', '.join(each.blockers)}" if each.blockers else "in any state")
                    + (f", from step {each.step}" if each.step else ""),
                )
                for each in facts.alternatives
            ]
        )
    if facts.refusals:
        text += f"\n\nRefused {', '.join(f'{count} times at {stage}' for stage, count in facts.refusals.items())}."
    return text


def search_text(length: float, bound: float, queries: int, seconds: float) -> str:
    """How a running search stands; lengths in m, infinite where not known."""
    known, bounded = 0 <= length < float("inf"), 0 <= bound < float("inf")
    rows = [
        ("best length", f"{length:.3f} m" if known else "none yet"),
        ("bound", f"{bound:.3f} m" if bounded else "none yet"),
    ]
    if known and bounded and bound:
        rows.append(("gap", f"{(length - bound) / bound:.1%}"))
    return _table([*rows, ("removal queries", str(queries)), ("time", f"{seconds:.0f} s")])
