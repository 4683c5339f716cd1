"""One page about a plan: picture, order, lengths, bounds, what waits for what, settings. Self-contained HTML."""

from __future__ import annotations

import base64
import os
from collections import Counter
from collections.abc import Sequence
from html import escape
from pathlib import Path

from takeapart.bound_texts import STATED, explanation
from takeapart.documents import write_atomically
from takeapart.errors import InputError, TakeapartError
from takeapart.messages import shown
from takeapart.plan import Plan
from takeapart.removal.result import Blocked
from takeapart.render_facts import Answers, PartFacts, blocked_by, hindrances, part_facts, why_not_earlier
from takeapart.render_scene import PlanScene
from takeapart.render_subject import Subject, load_subject
from takeapart.report_charts import Bar, bars, graph, progress, progress_note
from takeapart.run import JOURNAL
from takeapart.run_journal import recorded_answers

PICTURE_WIDTH = 1080  # pixels

STYLE = """
:root{color-scheme:light;--ink:#232b35;--soft:#5b6673;--line:#e3e7ec;--paper:#fff;--wash:#f5f7f9}
*{box-sizing:border-box}
body{margin:0;background:var(--wash);color:var(--ink);
font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,sans-serif}
main{max-width:860px;margin:0 auto;padding:20px 16px 48px}
h1{font-size:1.6rem;line-height:1.2;margin:.2em 0 .1em}h2{font-size:1.1rem;margin:0 0 .5em}
.lead{color:var(--soft);margin:0 0 1.2em}
section{background:var(--paper);border:1px solid var(--line);border-radius:12px;padding:16px;margin:0 0 16px}
.cards{display:grid;grid-template-columns:repeat(auto-fit,minmax(128px,1fr));gap:10px;background:none;border:0;padding:0}
.card{background:var(--paper);border:1px solid var(--line);border-radius:12px;padding:12px 14px}
.card b{display:block;font-size:1.35rem;line-height:1.25}.card span{color:var(--soft);font-size:.85rem}
img{width:100%;height:auto;border-radius:8px;display:block}
svg{width:100%;max-width:600px;margin:auto;height:auto;display:block;font:14px system-ui,sans-serif;fill:var(--ink)}
svg .name{font-weight:600}svg .chip{font-size:12px;fill:#1d2530}
.wide{overflow-x:auto}.graph svg{min-width:520px;max-width:none}
table{border-collapse:collapse;width:100%;font-size:.92rem}
th{text-align:left;color:var(--soft);font-weight:500}
td,th{padding:5px 8px 5px 0;border-bottom:1px solid var(--line);vertical-align:top}
td.n,th.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}
.dot{display:inline-block;width:.7em;height:.7em;border-radius:50%;margin-right:.45em}
.hash{font:12px ui-monospace,Menlo,monospace;overflow-wrap:anywhere}
.note{color:var(--soft);font-size:.88rem;margin:.6em 0 0}.bounds{margin:0 0 16px}
@media(max-width:520px){.why{display:none}body{font-size:15px}}
@media print{body{background:#fff;font-size:11pt}main{max-width:none;padding:0}section,.card{break-inside:avoid;
border-color:#ccc}.wide{overflow:visible}.graph svg{min-width:0}.why{display:table-cell}*{print-color-adjust:exact;
-webkit-print-color-adjust:exact}}
"""


def report(path: str | os.PathLike[str], assembly: Path | None = None, workcell: str | None = None) -> str:
    """The report about a plan file or a run directory, as one HTML document without any reference to other files.

    Args:
        path: of the plan or run.
        assembly, workcell: as for `takeapart.render_subject.load_subject`.

    Raises:
        InputError: there is no plan, or it does not belong to its assembly.
    """
    subject = load_subject(Path(path), assembly, workcell)
    if subject.plan is None:
        raise InputError("holds no plan (a run has one once its search has ended)", shown(path))
    answers = recorded_answers(subject.run / JOURNAL) if subject.run else []
    return report_of(subject, subject.plan, answers)


def save_report(
    path: str | os.PathLike[str],
    out: str | os.PathLike[str],
    assembly: Path | None = None,
    workcell: str | None = None,
) -> None:
    """Write the report about a plan file or a run directory, atomically.

    Raises:
        InputError: as `report`; the file cannot be written.
    """
    write_atomically(out, report(path, assembly, workcell))


def report_of(subject: Subject, plan: Plan, answers: Answers = ()) -> str:
    """The report about a plan in hand."""
    scene = PlanScene(subject.assembly, subject.workcell, plan)
    facts = part_facts(scene, answers)
    return page(plan, scene, facts, answers, picture_of(scene))


def picture_of(scene: PlanScene) -> str:
    """The assembly beside the arm, as HTML; a sentence where it cannot be drawn here."""
    try:
        from takeapart.render import Renderer, RenderOptions
        from takeapart.render_output import png_bytes

        options = RenderOptions(PICTURE_WIDTH, PICTURE_WIDTH * 3 // 4)
        with Renderer(scene, options) as renderer:
            image = renderer.picture(scene.moment(0, 0.35) if scene.steps else None)
        data = base64.b64encode(png_bytes(image, colors=128)).decode()
    except TakeapartError as error:  # no OpenGL, or the extra is not installed: the rest of the report needs neither
        return f'<p class="note">No picture: {escape(str(error))}.</p>'
    return f'<img alt="{escape(scene.assembly.name)} and the arm in the first step" src="data:image/png;base64,{data}">'


def page(plan: Plan, scene: PlanScene, facts: Sequence[PartFacts], answers: Answers, picture: str) -> str:
    """The HTML document."""
    title = f"{plan.direction.capitalize()} of {plan.assembly}"
    by_name = {each.name: each for each in facts}
    colors = dict(zip((part.name for part in scene.assembly.parts), scene.colors, strict=True))
    rows = [
        Bar(f"{number}  {step.part}", step.length, by_name[step.part].bound, colors[step.part])
        for number, step in enumerate(plan.steps, 1)
    ]
    edges = blocked_by(scene.assembly, hindrances(scene))
    sections = [
        _cards(plan),
        f"<section>{picture}</section>",
        _section(
            "Length of every step",
            bars(rows),
            "Way of the gripper, m. The line across a bar is the straight-line bound of the part: from the best point "
            "of its volume straight up, then straight to the goal.",
        ),
        _search(plan),
        _section(
            "What waits for what",
            graph(scene.assembly, edges, scene.colors),
            "A part can leave once all parts above it on its lines are gone. Solid: a part rests on it; dashed: a part "
            "is above it. Blocked paths are not in this picture, they depend on the state.",
            "wide graph",
        ),
        _order(plan, by_name, colors),
        _journal(answers),
        _settings(plan),
    ]
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body><main>"
        f'<h1>{escape(title)}</h1><p class="lead">{len(plan.steps)} parts, workcell {escape(plan.workcell)}</p>'
        f"{''.join(sections)}</main></body></html>\n"
    )


def _section(heading: str, content: str, note: str = "", kind: str = "wide") -> str:
    remark = f'<p class="note">{escape(note)}</p>' if note else ""
    return f'<section><h2>{escape(heading)}</h2><div class="{kind}">{content}</div>{remark}</section>'


def _cards(plan: Plan) -> str:
    def share(bound: float) -> str:
        return f"{(plan.total_length - bound) / bound:.1%}" if bound else "-"

    cards = [
        (f"{plan.total_length:.3f} m", "total gripper path"),
        (f"{plan.straight_line_bound:.3f} m", f"straight-line bound, proved gap {share(plan.straight_line_bound)}"),
    ]
    if plan.sequence_bound is not None:
        cards.append((f"{plan.sequence_bound:.3f} m", f"sequence bound, sequence gap {share(plan.sequence_bound)}"))
    cards += [
        (f"{plan.counts.get('removal_queries', 0)}", "removal queries"),
        (f"{plan.counts.get('motion_plans', 0)}", "motion plans"),
        (f"{plan.seconds:.1f} s", "search time"),
    ]
    boxes = "".join(f'<div class="card"><b>{value}</b><span>{escape(text)}</span></div>' for value, text in cards)
    words = explanation(bool(plan.straight_line_bound), plan.sequence_bound is not None)
    words += f" All figures are {STATED}; takeapart verify checks what it can."
    return f'<section class="cards">{boxes}</section><p class="note bounds">{escape(words)}</p>'


def _search(plan: Plan) -> str:
    history = plan.search.get("history")
    rows = history if isinstance(history, list) else []
    rows = [row for row in rows if isinstance(row, list) and len(row) == 3 and isinstance(row[0], int)]
    if not any(row[1] is not None for row in rows):
        return ""
    statistics = plan.search.get("statistics")
    proved_after = statistics.get("closed_queries") if isinstance(statistics, dict) else None
    if not isinstance(proved_after, int | float):
        proved_after = None
    floor = plan.straight_line_bound
    return _section("How the search went", progress(rows, floor, proved_after), progress_note(rows, floor))


def _order(plan: Plan, facts: dict[str, PartFacts], colors: dict[str, str]) -> str:
    running, rows = 0.0, []
    for number, step in enumerate(plan.steps, 1):
        running += step.length
        part = facts[step.part]
        rows.append(
            f'<tr><td class="n">{number}</td><td><span class="dot" style="background:{colors[step.part]}"></span>'
            f'{escape(step.part)}</td><td class="n">{step.length:.3f}</td><td class="n">{running:.3f}</td>'
            f'<td>{escape(part.grasp)}</td><td class="why">{escape(why_not_earlier(part))}</td></tr>'
        )
    head = (
        '<tr><th class="n">step</th><th>part</th><th class="n">m</th><th class="n">total</th><th>grasp</th>'
        '<th class="why">why not earlier (in the order of disassembly)</th></tr>'
    )
    return _section("Order", f"<table><thead>{head}</thead><tbody>{''.join(rows)}</tbody></table>")


def _journal(answers: Answers) -> str:
    if not answers:
        return ""
    stages = Counter(a.answer.stage if isinstance(a.answer, Blocked) else "removal found" for _, a in answers)
    rows = "".join(f'<tr><td>{escape(name)}</td><td class="n">{count}</td></tr>' for name, count in stages.items())
    return _section("What the planner answered", f"<table>{rows}</table>", "Refusals are named by their stage.")


def _settings(plan: Plan) -> str:
    rows = [("search", str(plan.search.get("name", "unknown"))), ("seed", str(plan.seed))]
    statistics = plan.search.get("statistics")
    if isinstance(statistics, dict):
        rows += [(str(name).replace("_", " "), _text(value)) for name, value in statistics.items()]
    rows += [(f"version of {name}", version) for name, version in plan.versions.items()]
    lines = [f"<tr><td>{escape(name)}</td><td>{escape(value)}</td></tr>" for name, value in rows]
    lines += [
        f'<tr><td>hash of the {escape(name)}</td><td class="hash">{escape(value)}</td></tr>'
        for name, value in plan.hashes.items()
    ]
    return _section("Settings", f"<table>{''.join(lines)}</table>")


def _text(value: object) -> str:
    return f"{value:.3f}" if isinstance(value, float) else str(value)
