"""Products that somebody drew, imported, planned by exact search and verified, each in a process of its own.
``python benchmarks/cases_table.py --cases ../shared/cases --document docs/products.md``.

The shipped products: ``--cases data/products --out out/products --marker drawn --document docs/products.md``.
A product is a folder: with a STEP or GLB file, with an ``assembly.json``, or with meshes in their places. What is found
of it is kept in the output folder; with ``--only NAME`` that row is worked out again and the others stay. Lengths and
clearances are those of the verification.
"""

from __future__ import annotations

import argparse
import math
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from drawn_products import Trial, imported, too_deep, trials
from kept_rows import publish, read_row, write_and_verify, write_row
from speed import random_edges
from takeapart.collision.fields import mesh_field
from takeapart.experiments.tables import markdown_table
from takeapart.formats.files import load_assembly, load_workcell, save_assembly
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array, Box, pose, pose_inverse
from takeapart.model.plan import Plan, PlanStep
from takeapart.planning import PlanningOptions, build_problem, plan_of, search
from takeapart.problem import AssemblyProblem
from takeapart.removal.exits import Exit
from takeapart.removal.following import end_of
from takeapart.removal.planner import RemovalPlanner
from takeapart.removal.result import Blocked, Removal
from takeapart.search.result import Budget

MARKER = "cases"
COLD_QUERIES = 30
CASES = Path(__file__).resolve().parents[2] / "shared" / "cases"
LEAST_TURN = 0.1  # rad, of a way
SAME_PLACE = 1e-5  # m and unit vectors; the end of an exit is one of the rows of a path
MOST_PAIRS = 4  # that overlap too deep, and are shown
LINE = 300  # letters of a refusal that are shown


@dataclass(frozen=True)
class Row:
    """What came of a trial.

    Args:
        parts: all of the product.
        removable: of them, those that are not fixed.
        length: of the plan, m, recomputed by the verification; None where there is no plan.
        proved: whether the search closed: no order is shorter for the removals found, or there is none.
        refusal: why there is no plan, where that is so.
        deep: pairs that overlap too deep as drawn, with the depth, the deepest first.
        exits: how each part leaves, in the order of removal.
        queries: removal queries.
        fields, exits_time, search_time: processor time, s: fields of all shapes, built anew; contacts, exits, statics
            and arm; the search.
        cold, median: processor time of a query, ms, medians: at random edges with nothing known but shapes, fields and
            exits, and of those that the search asked.
        clearance: smallest that the verification saw, m.
        findings: of the verification; None where nothing was verified.
        first_finding: the first of them in words.
        unjudged: what it could not judge.
    """

    name: str
    options: str
    parts: int
    removable: int
    length: float | None = None
    proved: bool = False
    refusal: str = ""
    deep: tuple[str, ...] = ()
    exits: tuple[str, ...] = ()
    queries: int = 0
    fields: float = 0.0
    exits_time: float = 0.0
    search_time: float = 0.0
    cold: float | None = None
    median: float | None = None
    clearance: float | None = None
    findings: int | None = None
    first_finding: str = ""
    unjudged: tuple[str, ...] = ()


class TimedQueries:
    """Processor time of every removal query of a problem, s."""

    def __init__(self, problem: AssemblyProblem) -> None:
        self.times: list[float] = []
        plan = problem.planner.plan

        def timed(part: int, *arguments: object, **named: object) -> Removal | Blocked:
            started = time.thread_time()
            found: Removal | Blocked = plan(part, *arguments, **named)  # type: ignore[arg-type]
            self.times.append(time.thread_time() - started)
            return found

        problem.planner.plan = timed  # type: ignore[method-assign]

    def median(self) -> float | None:
        """Median of all queries, ms."""
        return 1e3 * statistics.median(self.times) if self.times else None


def cold_query(problem: AssemblyProblem) -> float:
    """Median processor time, ms, of queries at random edges, each with grasps and ways of the arm forgotten."""
    rng, times = np.random.default_rng(0), []
    for state, part in random_edges(problem, COLD_QUERIES, rng):
        problem.planner.forget_grasps()
        started = time.thread_time()
        RemovalPlanner.plan(problem.planner, part, state, rng=rng)  # not the timed one
        times.append(time.thread_time() - started)
    return 1e3 * statistics.median(times)


def row_of(trial: Trial, cases: Path, folder: Path, unit: str, budget: Budget) -> Row:
    """Imports, plans and verifies one product; what is made is in a folder of its own."""
    here = folder / trial.name
    try:
        save_assembly(imported(trial, cases, unit), here / "assembly.json")
        assembly, workcell = load_assembly(here / "assembly.json"), load_workcell(trial.workcell)
    except InputError as refused:
        return Row(trial.name, trial.told, 0, 0, refusal=_line(str(refused)))
    shapes = {id(part.shape): part.shape for part in assembly.parts}.values()
    mesh_field(Box((0.01, 0.01, 0.01)).surface())  # reads its machine code
    start = time.process_time()
    for shape in shapes:
        if not isinstance(shape, Box):
            mesh_field(shape.surface())
    row = Row(
        trial.name, trial.told, len(assembly.parts), assembly.root.bit_count(), fields=time.process_time() - start
    )
    names = [part.name for part in assembly.parts]
    pairs = too_deep(assembly) if assembly.has_meshes else []
    row = replace(
        row, deep=tuple(f"{names[each.first]}, {names[each.second]}: {1e3 * depth:.2f} mm" for each, depth in pairs)
    )
    options, start = PlanningOptions(budget=budget), time.process_time()
    try:
        problem = build_problem(assembly, workcell, options)
    except InputError as refused:
        return replace(row, refusal=_line(str(refused)))
    row = replace(row, exits_time=time.process_time() - start)
    queries, start = TimedQueries(problem), time.process_time()
    result = search(problem, options)
    row = replace(row, search_time=time.process_time() - start, queries=problem.counts.removal_queries)
    row = replace(row, median=queries.median())
    made = plan_of(problem, result, options, row.search_time)
    if not isinstance(made, Plan):
        return replace(row, refusal=_line(str(made)), proved=made.proved)
    report = write_and_verify(made, here / "product.plan.json", assembly, workcell)
    nearest = report.smallest_clearance
    row = replace(row, cold=cold_query(problem))
    return replace(
        row,
        length=report.agreement.total_length_recomputed,
        proved=made.sequence_bound is not None and made.sequence_bound >= made.total_length - 1e-6,
        exits=tuple(_way_of(step, problem) for step in made.steps),
        clearance=None if nearest is None else nearest.distance,
        findings=len(report.findings),
        first_finding=_line(f"{report.findings[0].check}: {report.findings[0].message}") if report.findings else "",
        unjudged=report.unjudged,
    )


def _line(text: str) -> str:
    first = text.splitlines()[0].replace("|", "/")
    first = first.partition(": parts: ")[2] or first  # the product's name stands beside it
    return first if len(first) <= LINE else f"{first[: LINE - 4]} ..."


def _way_of(step: PlanStep, problem: AssemblyProblem) -> str:
    """Which exit a step follows, in a word: the one at whose end one of the rows of its path has the part."""
    poses = np.array([pose(row[:3], row[3:]) for row in step.tool_path])
    motions = (poses @ pose_inverse(poses[0]))[:, :3]
    for way in problem.planner.exits.exits(problem.assembly.index[step.part]):
        if (np.abs(motions - end_of(way)).max(axis=(1, 2)) < SAME_PLACE).any():
            return _word(way)
    return "unknown"


def _word(way: Exit) -> str:
    turned = sum(_angle(a[:3, :3].T @ b[:3, :3]) for a, b in pairwise(way.poses))
    if way.kind == "pushes":
        pieces = _pushes(way.poses)
        told = f"by {pieces} push{'es' if pieces > 1 else ''}"
        return f"{told} and turns of {math.degrees(turned):.0f} degrees" if turned > LEAST_TURN else told
    if way.kind == "screw":
        return f"by {turned / (2 * math.pi):.1f} turns"
    assert way.direction is not None
    steep = round(math.degrees(math.asin(max(-1.0, min(1.0, float(way.direction[2]))))))
    return {90: "up", -90: "down", 0: "sideways"}.get(steep, f"at {steep} degrees")


def _pushes(poses: Array) -> int:
    """How many straight pieces a way has, without turns on the spot."""
    shifts = np.diff(poses[:, :3, 3], axis=0)
    turns = [_angle(a[:3, :3].T @ b[:3, :3]) > LEAST_TURN / 10 for a, b in pairwise(poses)]
    return sum(not turn and float(np.linalg.norm(shift)) > 0 for shift, turn in zip(shifts, turns, strict=True))


def _angle(R: Array) -> float:
    return math.acos(max(-1.0, min(1.0, (float(np.trace(R)) - 1) / 2)))


def kept_row(trial: Trial, folder: Path) -> Row | None:
    """What is kept of a trial, if anything."""
    return read_row(Row, folder / f"{trial.name}.json")


def keep(row: Row, folder: Path) -> None:
    """Writes a row where `kept_row` finds it."""
    write_row(row, folder / f"{row.name}.json")


def in_own_process(trial: Trial, arguments: argparse.Namespace) -> None:
    """Works out a row in another process, and keeps that it was stopped where it takes too long or breaks."""
    command = [sys.executable, __file__, "--child", trial.name, *(["--quick"] if arguments.quick else [])]
    for name in ("cases", "out", "unit", "workcell"):
        command += [f"--{name}", str(getattr(arguments, name))]
    told = ""
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=arguments.limit)
        if done.returncode:
            told = f"broke: {(done.stderr.strip() or 'without a word').splitlines()[-1]}"
    except subprocess.TimeoutExpired:
        told = f"stopped after {arguments.limit:g} s of wall time"
    if told:
        keep(Row(trial.name, trial.told, 0, 0, refusal=_line(told)), arguments.out)


def table(rows: Sequence[Row], tried: Sequence[Trial]) -> str:
    """The products that have a plan, those that have none, and what the words need."""
    heads = ["product", "parts", "length, m", "ways out", "queries", "a query, ms: cold, in the search"]
    heads += ["fields, s", "contacts, exits, s", "search, s", "smallest clearance, mm", "verified"]
    planned = [
        [
            row.name, f"{row.removable} of {row.parts}", f"{row.length:.3f}{'' if row.proved else ' (not proved)'}",
            _counted(row.exits), row.queries, f"{row.cold or 0:.0f}, {row.median or 0:.0f}", f"{row.fields:.1f}",
            f"{row.exits_time:.1f}", f"{row.search_time:.1f}",
            "more than 3" if row.clearance is None else f"{1e3 * row.clearance:.2f}",
            "yes" if row.findings == 0 else f"**no, {row.findings} findings**; {row.first_finding}",
        ]
        for row in rows if row.length is not None
    ]  # fmt: skip
    refused = [
        [
            row.name,
            row.parts or "",
            "yes" if row.proved else "",
            "; ".join(row.deep[:MOST_PAIRS]),
            row.refusal,
        ]
        for row in rows
        if row.length is None
    ]
    whys = [
        f"- {trial.name}: {trial.told}{'; ' if trial.why else ''}{trial.why}."
        for trial in tried
        if trial.told and any(row.name == trial.name for row in rows)
    ]
    rough = [f"- {row.name}: {line}." for row in rows for line in row.unjudged]
    texts = [markdown_table(heads, planned)] if planned else []
    if refused:
        texts += ["Without a plan:", _left_table(["product", "parts", "proved", "too deep as drawn", "why"], refused)]
    texts += ["Options, and why:", "\n".join(whys)] if whys else []
    texts += ["What the verification says that it could not judge:", "\n".join(rough)] if rough else []
    return "\n\n".join(texts)


def _left_table(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """As `markdown_table`, the last column to the left."""
    first, rule, *rest = markdown_table(heads, rows).splitlines()
    return "\n".join([first, f"{rule[: rule.rindex('---:')]}--- |", *rest])


def _counted(words: Sequence[str]) -> str:
    """How many parts leave how, in the order of the first of each."""
    return ", ".join(f"{words.count(word)} {word}" for word in dict.fromkeys(words))


def main() -> None:
    """Prints the table; with --document it replaces the one there."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=Path, default=CASES, help="folder of product folders")
    parser.add_argument("--unit", default="m", help="of meshes, which do not say it")
    parser.add_argument("--workcell", default="panda", help="name or file, for products without options of their own")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="these alone are worked out again")
    parser.add_argument("--limit", type=float, default=1800.0, metavar="SECONDS", help="of a product")
    parser.add_argument("--quick", action="store_true", help="a small budget of queries")
    parser.add_argument("--out", type=Path, default=Path("out/cases"), help="folder of what is kept")
    parser.add_argument("--document", type=Path, help="document whose table is replaced")
    parser.add_argument("--marker", default=MARKER, help="of the table in the document")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if not arguments.cases.is_dir():
        print(f"no products at {arguments.cases}; --cases says where they are")
        return
    arguments.out.mkdir(parents=True, exist_ok=True)
    tried = trials(arguments.cases, workcell=arguments.workcell)
    if arguments.child:
        (trial,) = (trial for trial in tried if trial.name == arguments.child)
        budget = Budget(queries=30) if arguments.quick else Budget()
        keep(row_of(trial, arguments.cases, arguments.out, arguments.unit, budget), arguments.out)
        return
    for trial in trials(arguments.cases, arguments.only, arguments.workcell):
        in_own_process(trial, arguments)
        print(kept_row(trial, arguments.out), flush=True)
    rows = [row for trial in tried if (row := kept_row(trial, arguments.out)) is not None]
    publish(table(rows, tried), arguments.marker, arguments.document)


if __name__ == "__main__":
    main()
