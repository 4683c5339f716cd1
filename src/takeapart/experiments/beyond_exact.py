"""Beyond exact search: where the states are too many to enumerate, a guide has to earn its place.

Every search, with and without a guide, plans the same assemblies within the same number of removal queries, each with a
library of its own that is empty at the start. Jobs are kept as by `paper`.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from takeapart.experiments.beyond_report import GUIDED, BeyondRun, beyond_markdown, draw, runs_csv
from takeapart.experiments.beyond_tasks import SEARCHED, BeyondTask
from takeapart.experiments.jobs import Job
from takeapart.experiments.paper_figures import figure_modules
from takeapart.experiments.schedule import Kept, ScheduleListener, run_schedule
from takeapart.experiments.tables import replace_between_markers
from takeapart.experiments.workers import Workers
from takeapart.formats.documents import write_atomically
from takeapart.formats.files import load_assembly, load_workcell
from takeapart.formats.messages import reason, shown
from takeapart.guide.policy import guide_path
from takeapart.model.assembly import Assembly
from takeapart.model.errors import InputError

MARKER = "results-beyond"


@dataclass(frozen=True)
class BeyondSettings:
    """What is compared.

    Args:
        assemblies: files.
        guide: file with the weights, or "default" for the guide that comes with the package.
        workcell: name of a shipped one or a file.
        seed: of all random choices.
        queries: removal queries of every search.
    """

    assemblies: tuple[Path, ...]
    guide: Path
    workcell: str = "panda"
    seed: int = 0
    queries: int = 1000

    def __post_init__(self) -> None:
        if not self.assemblies:
            raise InputError("at least one assembly is needed", "settings.assemblies")
        if self.queries < 1:
            raise InputError(f"{self.queries}; must be at least 1", "settings.queries")


def job_name(number: int, search: str, guided: bool) -> str:
    """Name of a job; assemblies are numbered from 1."""
    return f"beyond/{number:02d}-{search}{'-guided' if guided else ''}"


def beyond_jobs(settings: BeyondSettings, assemblies: Sequence[Assembly]) -> list[Job]:
    """A job per assembly, search, with and without the guide.

    Raises:
        InputError: the guide's file cannot be read.
    """
    workcell = load_workcell(settings.workcell)
    try:
        weights = guide_path(settings.guide).read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {reason(error)}", shown(settings.guide)) from None
    return [
        Job(
            job_name(number, search, guided),
            BeyondTask(assembly, workcell, settings.seed, search, settings.queries, weights if guided else None),
        )
        for number, assembly in enumerate(assemblies, 1)
        for search in SEARCHED
        for guided in GUIDED
    ]


def beyond_runs(assemblies: Sequence[Assembly], results: Mapping[str, Kept]) -> list[BeyondRun]:
    """Results of all jobs."""
    runs = []
    for number, assembly in enumerate(assemblies, 1):
        for search in SEARCHED:
            for guided in GUIDED:
                outcome = results[job_name(number, search, guided)].outcome
                trace = tuple((int(asked), float(length)) for asked, _, length in outcome["trace"])
                spent = outcome["removal_queries"], outcome["motion_plans"]
                bound = outcome["sequence_bound"]
                runs.append(BeyondRun(assembly.name, outcome["parts"], search, guided, trace, bound, *spent))
    return runs


def compare_beyond(
    settings: BeyondSettings,
    out: Path,
    workers: Workers,
    listen: ScheduleListener | None = None,
    document: Path | None = None,
) -> list[Path]:
    """Runs what is missing; writes beyond.csv, beyond.md and beyond.png.

    Args:
        out: folder for them; results of jobs are kept in its folder ``work``.
        workers: who does the jobs; let go at the end.
        listen: is told about progress.
        document: whose block ``results-beyond`` is filled too.

    Raises:
        InputError: an input is broken, two assemblies have the same name, or something cannot be written.
        TakeapartError: a job failed.
    """
    try:
        figure_modules()
        assemblies = [load_assembly(path) for path in settings.assemblies]
        names = [assembly.name for assembly in assemblies]
        if len(set(names)) < len(names):
            raise InputError(f"two assemblies have the same name ({', '.join(names)})", "settings.assemblies")
        jobs = beyond_jobs(settings, assemblies)
    except BaseException:
        workers.stop(now=True)
        raise
    results = run_schedule(jobs, out / "work", workers, listen)
    runs = beyond_runs(assemblies, results)
    picture = io.BytesIO()
    draw(runs, settings.queries).savefig(picture, format="png", dpi=150)
    text = beyond_markdown(runs, settings.queries)
    files: dict[str, str | bytes] = {
        "beyond.md": f"{text}\n",
        "beyond.csv": runs_csv(runs, settings.queries),
        "beyond.png": picture.getvalue(),
    }
    for name, content in files.items():
        write_atomically(out / name, content)
    if document is not None:
        replace_between_markers(document, MARKER, text)
    return [out / name for name in files]
