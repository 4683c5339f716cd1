"""One page about a plan: picture, order, lengths, bounds, what waits for what, settings. Self-contained HTML."""

from __future__ import annotations

import base64
import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from takeapart.formats.bound_texts import STATED, explanation, gap
from takeapart.formats.documents import write_atomically
from takeapart.formats.messages import shown
from takeapart.formats.plan_texts import partial_claim, partial_text, straight_line_text, title_of
from takeapart.model.errors import InputError, TakeapartError
from takeapart.model.plan import Plan
from takeapart.planning.run_journal import recorded_answers
from takeapart.planning.runs import JOURNAL
from takeapart.removal.result import Blocked
from takeapart.report.charts import Bar, bars, graph, progress, progress_note
from takeapart.report.verification import Verified, load_verification, verification_beside
from takeapart.show.facts import (
    Answers,
    PartFacts,
    blocked_by,
    freedom,
    freedom_note,
    hindrances,
    part_facts,
    why_not_earlier,
)
from takeapart.show.markup import Markup, document, element, joined
from takeapart.show.scene import PlanScene
from takeapart.show.subject import Subject, load_subject

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
.cards{display:grid;grid-template-columns:repeat(auto-fit,minmax(142px,1fr));gap:10px;background:none;border:0;padding:0}
.card{background:var(--paper);border:1px solid var(--line);border-radius:12px;padding:12px 14px}
.card b{display:block;font-size:1.35rem;line-height:1.25;white-space:nowrap}
.card span{display:block;color:var(--soft);font-size:.85rem}
img{width:100%;height:auto;border-radius:8px;display:block}
svg{width:100%;max-width:480px;margin:auto;height:auto;display:block;font:14px system-ui,sans-serif;fill:var(--ink)}
svg .name{font-weight:600}svg .chip{font-size:12px;fill:#1d2530}
.wide{overflow-x:auto}.graph svg{max-width:560px}
table{border-collapse:collapse;width:100%;font-size:.92rem}
th{text-align:left;color:var(--soft);font-weight:500}
td,th{padding:5px 8px 5px 0;border-bottom:1px solid var(--line);vertical-align:top}
td.n,th.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}
svg.dot{display:inline-block;width:.7em;height:.7em;margin:0 .45em 0 0}
.steps td,.steps th{padding:5px 10px 5px 0}.steps tr.first td{border-bottom:0;padding-bottom:0}
.steps tr.more td{color:var(--soft);font-size:.85rem;padding-top:0}.steps td{overflow-wrap:anywhere}
.steps th:nth-child(2){width:100%}.steps th:last-child{white-space:normal}
.steps td.n:last-child,.steps th:last-child{padding-right:0}
.hash{font:12px ui-monospace,Menlo,monospace;overflow-wrap:anywhere}
.note{color:var(--soft);font-size:.88rem;margin:.6em 0 0}.bounds{margin:0 0 16px}
@media(max-width:520px){body{font-size:15px}section{padding:14px 12px}.steps td,.steps th{padding-right:7px}}
@media print{body{background:#fff;font-size:11pt}main{max-width:none;padding:0}section,.card{break-inside:avoid;
border-color:#ccc}.wide{overflow:visible}*{print-color-adjust:exact;
-webkit-print-color-adjust:exact}}
"""


def report(
    path: str | os.PathLike[str],
    assembly: Path | None = None,
    workcell: str | None = None,
    verification: Path | None = None,
) -> str:
    """The report about a plan file or a run directory, as one HTML document without any reference to other files.

    Args:
        path: of the plan or run.
        assembly, workcell: as for `takeapart.show.subject.load_subject`.
        verification: file that ``takeapart verify --report`` wrote about the plan; by default the one that stands
            beside the plan, see `takeapart.report.verification.verification_beside`.

    Raises:
        InputError: there is no plan, or it does not belong to its assembly, or the verification not to the plan.
    """
    subject = load_subject(Path(path), assembly, workcell)
    if subject.plan is None:
        raise InputError("holds no plan (a run has one once its search has ended)", shown(path))
    answers = recorded_answers(subject.run / JOURNAL) if subject.run else []
    file = verification or (None if subject.run else verification_beside(Path(path)))
    return report_of(subject, subject.plan, answers, load_verification(file, subject.plan) if file else None)


def save_report(
    path: str | os.PathLike[str],
    out: str | os.PathLike[str],
    assembly: Path | None = None,
    workcell: str | None = None,
    verification: Path | None = None,
) -> None:
    """Write the report about a plan file or a run directory, atomically.

    Raises:
        InputError: as `report`; the file cannot be written.
    """
    write_atomically(out, report(path, assembly, workcell, verification))


def report_of(subject: Subject, plan: Plan, answers: Answers = (), verified: Verified | None = None) -> str:
    """The report about a plan in hand."""
    scene = PlanScene(subject.assembly, subject.workcell, plan)
    facts = part_facts(scene, answers)
    return page(plan, scene, facts, answers, picture_of(scene), verified)


def picture_of(scene: PlanScene) -> Markup:
    """The assembly beside the arm, as HTML; a sentence where it cannot be drawn here."""
    try:
        from takeapart.pictures.output import png_bytes
        from takeapart.pictures.renderer import Renderer, RenderOptions

        options = RenderOptions(PICTURE_WIDTH, PICTURE_WIDTH * 3 // 4, soft=True)
        with Renderer(scene, options) as renderer:
            image = renderer.picture(scene.moment(0, 0.35) if scene.steps else None)
        data = base64.b64encode(png_bytes(image, colors=128)).decode()
    except TakeapartError as error:  # no OpenGL, or the extra is not installed: the rest of the report needs neither
        return element("p", f"No picture: {error}.", class_="note")
    words = f"{scene.assembly.name} and the arm in the first step"
    return element("img", alt=words, src=f"data:image/png;base64,{data}")


def page(
    plan: Plan,
    scene: PlanScene,
    facts: Sequence[PartFacts],
    answers: Answers,
    picture: Markup,
    verified: Verified | None = None,
) -> Markup:
    """The HTML document."""
    title = title_of(plan)
    by_name = {each.name: each for each in facts}
    colors = dict(zip((part.name for part in scene.assembly.parts), scene.colors, strict=True))
    rows = [
        Bar(f"{number}  {step.part}", step.length, by_name[step.part].bound, colors[step.part])
        for number, step in enumerate(plan.steps, 1)
    ]
    edges = blocked_by(scene.assembly, hindrances(scene))
    sections = [
        _cards(plan, verified),
        element("section", picture),
        _section(
            "Length of every step",
            bars(rows),
            "Way of the gripper, m. The line across a bar is the straight-line bound of the part: from the best point "
            f"of its volume {'straight up, then ' if scene.assembly.is_lifted else ''}straight to the goal.",
        ),
        _search(plan),
        _section(
            "What waits for what",
            graph(scene.assembly, edges, scene.colors),
            "A part can leave once all parts above it on its lines are gone. Solid: a part rests on it; dashed: a part "
            f"is {'above it' if scene.assembly.is_lifted else 'in every way out of it'}. Blocked paths are not in this "
            "picture, they depend on the state.",
            "wide graph",
        ),
        _order(plan, by_name, colors, verified),
        _remaining(plan, by_name, colors),
        _journal(answers),
        _settings(plan),
    ]
    parts = f"Partial: {partial_text(plan)}" if plan.remaining else f"{len(plan.steps)} parts"
    lead = element("p", f"{parts}; workcell {plan.workcell}", class_="lead")
    return document(title, STYLE, element("main", element("h1", title), lead, *sections))


def _section(heading: str, content: Markup, note: str = "", kind: str = "wide") -> Markup:
    remark = element("p", note, class_="note") if note else ""
    return element("section", element("h2", heading), element("div", content, class_=kind), remark)


def _cards(plan: Plan, verified: Verified | None) -> Markup:
    def above(name: str, bound: float) -> str:
        share = gap(plan.total_length, bound)
        return "" if share is None else f"{name} {share:.1%}"

    cards = [
        (f"{plan.total_length:.3f} m", "total gripper path", ""),
        (f"{plan.straight_line_bound:.3f} m", "straight-line bound", above("proved gap", plan.straight_line_bound)),
    ]
    if plan.sequence_bound is not None:
        cards.append((f"{plan.sequence_bound:.3f} m", "sequence bound", above("sequence gap", plan.sequence_bound)))
    known = [value for value in verified.clearances.values() if value is not None] if verified else []
    if known:
        cards.append((f"{1000 * min(known):.2f} mm", "smallest clearance", ""))
    cards += [
        (f"{plan.counts.get('removal_queries', 0)}", "removal queries", ""),
        (f"{plan.counts.get('motion_plans', 0)}", "motion plans", ""),
        (f"{plan.seconds:.1f} s", "search time", ""),
    ]
    boxes = [
        element("div", element("b", value), *(element("span", text) for text in texts if text), class_="card")
        for value, *texts in cards
    ]
    words = [
        explanation(straight_line_text(plan) if plan.straight_line_bound else "", plan.sequence_bound is not None),
        *([f"How far the plan goes: {partial_claim(plan)}."] if plan.remaining else []),
        f"All figures are {STATED};",
    ]
    if verified is None:
        words.append("takeapart verify checks what it can.")
    elif verified.passed:
        words.append("a verification of this plan has found nothing against it.")
    else:
        words.append(f"a verification of this plan has {verified.findings} findings: it may not be trusted.")
    return joined([element("section", *boxes, class_="cards"), element("p", " ".join(words), class_="note bounds")])


def _search(plan: Plan) -> Markup:
    history = plan.search.get("history")
    rows = history if isinstance(history, list) else []
    rows = [row for row in rows if isinstance(row, list) and len(row) == 3 and isinstance(row[0], int)]
    if not any(row[1] is not None for row in rows):
        return Markup()
    statistics = plan.search.get("statistics")
    proved_after = statistics.get("closed_queries") if isinstance(statistics, dict) else None
    if not isinstance(proved_after, int | float):
        proved_after = None
    floor = plan.straight_line_bound
    return _section("How the search went", progress(rows, floor, proved_after), progress_note(rows, floor))


def _order(plan: Plan, facts: dict[str, PartFacts], colors: dict[str, str], verified: Verified | None) -> Markup:
    """Two lines for every step, so that it can be read on a narrow screen: its numbers, and why no earlier."""
    clearances = verified.clearances if verified else {}
    names = ["step", "part", "m", "total", *(["clear, mm"] if clearances else [])]
    head = element("tr", *(element("th", name, class_=None if name == "part" else "n") for name in names))
    running, rows = 0.0, []
    for number, step in enumerate(plan.steps, 1):
        running += step.length
        part = facts[step.part]
        dot = _dot(colors[step.part])
        cells = [f"{step.length:.3f}", f"{running:.3f}"]
        if clearances and verified:
            near = clearances[step.part]
            cells.append("-" if near is None else f"{1000 * near:.2f}")
        rows += [
            element(
                "tr",
                element("td", number, class_="n"),
                element("td", dot, step.part),
                *(element("td", cell, class_="n") for cell in cells),
                class_="first",
            ),
            element(
                "tr",
                element("td", "; ".join(text for text in (part.grasp, freedom(part)) if text), colspan=len(names)),
                class_="more",
            ),
        ]
    note = freedom_note(list(facts.values()))
    if plan.direction == "assembly":
        note += " Steps in these words are those of the disassembly."
    if verified and clearances:
        note += " Clear: smallest distance between things that may not touch, as the verification measured it"
        note += f"; a dash where nothing came within about {1000 * verified.sight:g} mm."
    table = element("table", element("thead", head), element("tbody", *rows), class_="steps")
    return _section("Order", table, note)


def _remaining(plan: Plan, facts: dict[str, PartFacts], colors: dict[str, str]) -> Markup:
    """What a partial plan leaves where it is."""
    if not plan.remaining:
        return Markup()
    rows = [
        element("tr", element("td", _dot(colors[name]), name), element("td", why_not_earlier(facts[name])))
        for name in plan.remaining
    ]
    return _section("Parts that remain", element("table", *rows), "They stand in every picture as they stood.")


def _dot(color: str) -> Markup:
    return element("svg", element("circle", cx=5, cy=5, r=5, fill=color), class_="dot", viewBox="0 0 10 10")


def _journal(answers: Answers) -> Markup:
    if not answers:
        return Markup()
    stages = Counter(a.answer.stage if isinstance(a.answer, Blocked) else "removal found" for _, a in answers)
    rows = [element("tr", element("td", name), element("td", count, class_="n")) for name, count in stages.items()]
    return _section("What the planner answered", element("table", *rows), "Refusals are named by their stage.")


def _settings(plan: Plan) -> Markup:
    rows = [("search", str(plan.search.get("name", "unknown"))), ("seed", str(plan.seed))]
    statistics = plan.search.get("statistics")
    if isinstance(statistics, dict):
        rows += [(str(name).replace("_", " "), _text(value)) for name, value in statistics.items()]
    rows += [(f"version of {name}", version) for name, version in plan.versions.items()]
    lines = [element("tr", element("td", name), element("td", value)) for name, value in rows]
    lines += [
        element("tr", element("td", f"hash of the {name}"), element("td", value, class_="hash"))
        for name, value in plan.hashes.items()
    ]
    return _section("Settings", element("table", *lines))


def _text(value: object) -> str:
    return f"{value:.3f}" if isinstance(value, float) else str(value)
