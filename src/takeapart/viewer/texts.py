"""What the panel of the viewer says: markup made by `takeapart.show.markup`, so that nothing of a file can run."""

from __future__ import annotations

from collections.abc import Sequence

from takeapart.formats.bound_texts import BELIEVE, SEQUENCE, STATED
from takeapart.formats.plan_texts import partial_claim, partial_text, straight_line_text, title_of
from takeapart.model.plan import Plan
from takeapart.show.facts import PartFacts, why_not_earlier
from takeapart.show.figures import plan_figures
from takeapart.show.markup import Markup, element, joined
from takeapart.show.playback import PLAYBACK, Timeline
from takeapart.show.scene import CURRENT, PlanScene

BLOCK = "padding:0.1em 0.9em;font-size:0.86em;line-height:1.4;overflow-wrap:anywhere"
SOFT = "color:#5d6875"
LIST = "max-height:15em;overflow-y:auto;border:1px solid #dfe4ea;border-radius:6px"


def sent(text: Markup) -> str:
    """Markup as viser takes it, a string of the plain kind. The only way for text to an HTML element of the panel."""
    if not isinstance(text, Markup):
        raise TypeError("the panel shows markup only")
    return str(text)


def block(*content: object) -> Markup:
    """A piece of the panel."""
    return element("div", *content, style=BLOCK)


def heading(text: str) -> Markup:
    """A title within the panel."""
    return element("div", text, style="font-weight:600;font-size:1.12em;margin:0.2em 0")


def remark(text: str) -> Markup:
    """What explains a figure."""
    return element("div", text, style=f"{SOFT};font-size:0.92em;margin:0.15em 0")


def table(rows: Sequence[tuple[str, str]]) -> Markup:
    """Names on the left, values on the right."""
    cell = "padding:1px 0;vertical-align:top"
    return element(
        "table",
        *(
            element(
                "tr",
                element("td", name, style=f"{cell};padding-right:0.8em;{SOFT}"),
                element("td", value, style=f"{cell};text-align:right;font-variant-numeric:tabular-nums"),
            )
            for name, value in rows
        ),
        style="width:100%;border-collapse:collapse",
    )


def error_text(message: str) -> Markup:
    """What stands in place of a scene."""
    return block(heading("This cannot be shown"), message)


def totals_text(scene: PlanScene, facts: Sequence[PartFacts]) -> Markup:
    """Title, total, bounds and gaps of a plan; of an assembly what it consists of."""
    plan = scene.plan
    if plan is None:
        parts, removable = len(scene.assembly.parts), scene.assembly.root.bit_count()
        text = f"{parts} parts, {removable} of them removable. A plan file shows how they leave."
        return block(heading(scene.assembly.name), text)
    told = [remark(f"Partial: {partial_text(plan)}."), remark(f"Stated: {partial_claim(plan)}.")]
    return block(heading(title_of(plan)), *(told if plan.remaining else []), _figures(plan, facts))


def _figures(plan: Plan, facts: Sequence[PartFacts]) -> Markup:
    figures = plan_figures(plan, facts)
    rows, remarks = [("total gripper path", f"{figures.total:.3f} m")], list(figures.differences)
    if figures.proved_gap is not None:
        rows += [
            ("straight-line bound", f"{figures.straight_line_bound:.3f} m"),
            ("proved gap", f"{figures.proved_gap:.1%}"),
        ]
        remarks.append(f"Straight-line bound: {straight_line_text(plan)}.")
    if figures.sequence_gap is not None:
        rows += [
            ("sequence bound", f"{figures.sequence_bound:.3f} m"),
            ("sequence gap", f"{figures.sequence_gap:.1%}"),
        ]
        remarks.append(f"Sequence bound, {STATED}: {SEQUENCE}; believe {BELIEVE}.")
    return joined([table(rows), *(remark(text) for text in remarks)])


def now_text(scene: PlanScene, timeline: Timeline, step: int) -> Markup:
    """The current step."""
    number, plan_step = timeline.number(step), scene.steps[step]
    played = scene.steps[: step + 1] if timeline.direction == "disassembly" else scene.steps[step:]
    return block(
        table(
            [
                ("step", f"{number} of {len(scene.steps)}"),
                ("part", plan_step.part),
                ("grasp", scene.grasp_text(step)),
                ("gripper path", f"{plan_step.length:.3f} m"),
                ("running total", f"{sum(each.length for each in played):.3f} m"),
            ]
        )
    )


def steps_text(scene: PlanScene, timeline: Timeline, current: int) -> Markup:
    """All steps in the order in which they are played."""
    rows = []
    for k in timeline.order:
        number = timeline.number(k)
        look = f"background:{CURRENT}2e;font-weight:600" if k == current else ""
        if number < timeline.number(current):
            look = "color:#98a2ad"
        dot = (
            f"display:inline-block;width:0.7em;height:0.7em;border-radius:50%;background:{scene.colors[scene.order[k]]}"
        )
        rows.append(
            element(
                "tr",
                element("td", number, style="text-align:right;padding:0 0.6em 0 0.3em"),
                element("td", element("span", style=dot), f" {scene.steps[k].part}"),
                element("td", f"{scene.steps[k].length:.3f} m", style="text-align:right;padding-right:0.5em"),
                style=look,
            )
        )
    return block(
        element("div", element("table", *rows, style="width:100%;border-collapse:collapse"), style=LIST),
        remark(PLAYBACK),
    )


def step_names(scene: PlanScene, timeline: Timeline) -> tuple[str, ...]:
    """One line for every step, in the order in which they are played: what the list to jump to a step offers."""
    return tuple(f"{timeline.number(k)}  {scene.steps[k].part}" for k in timeline.order)


def part_text(scene: PlanScene, facts: PartFacts, answer: str = "") -> Markup:
    """All about one part.

    Args:
        answer: of the planner, who was asked why the part does not leave earlier.
    """
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
    pieces: list[object] = [
        heading(facts.name),
        table(rows),
        element("p", why_not_earlier(facts), style="margin:0.4em 0"),
    ]
    if facts.alternatives:
        pieces.append(remark("Other removals in the library:"))
        pieces.append(
            table(
                [
                    (
                        f"{each.length:.3f} m",
                        (f"without {', '.join(each.blockers)}" if each.blockers else "in any state")
                        + (f", from step {each.step}" if each.step else ""),
                    )
                    for each in facts.alternatives
                ]
            )
        )
    if facts.refusals:
        counts = ", ".join(f"{count} times at {stage}" for stage, count in facts.refusals.items())
        pieces.append(remark(f"Refused {counts}."))
    if answer:
        pieces.append(element("p", element("b", "The planner: "), answer, style="margin:0.4em 0"))
    return block(*pieces)


def search_text(length: float, bound: float, queries: int, seconds: float) -> Markup:
    """How a running search stands; lengths in m, infinite where not known."""
    known, bounded = 0 <= length < float("inf"), 0 <= bound < float("inf")
    rows = [
        ("best length", f"{length:.3f} m" if known else "none yet"),
        ("sequence bound", f"{bound:.3f} m" if bounded else "none yet"),
    ]
    if known and bounded and bound:
        rows.append(("sequence gap", f"{(length - bound) / bound:.1%}"))
    rows += [("removal queries", str(queries)), ("time", f"{seconds:.0f} s")]
    return block(
        table(rows),
        remark(f"Sequence bound: {SEQUENCE}; a shorter path lowers it, also where it is drawn already."),
    )
