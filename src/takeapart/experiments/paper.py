"""All experiments of Sec. VII by one call: Fig. 5, Tables I and II, and what they say at equal planner calls."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from takeapart.experiments.paper_figures import figure_modules
from takeapart.experiments.paper_jobs import load_products, paper_jobs
from takeapart.experiments.paper_report import fill_document, findings, write_results
from takeapart.experiments.paper_settings import PaperSettings
from takeapart.experiments.schedule import ScheduleListener, run_schedule
from takeapart.experiments.workers import Workers

WORK = "work"  # folder below the output where results of jobs are kept


@dataclass(frozen=True)
class Reproduced:
    """What was written.

    Args:
        files: tables, plots, report.
        report: in Markdown; one of them.
        seconds: this call took, s.
    """

    files: Sequence[Path]
    report: Path
    seconds: float


def reproduce(
    settings: PaperSettings,
    out: Path,
    workers: Workers,
    listen: ScheduleListener | None = None,
    document: Path | None = None,
) -> Reproduced:
    """Runs what is missing and writes all tables and plots.

    Args:
        out: folder for them; what is done is kept in its folder ``work``, and a call that was cut off goes on there.
        workers: who does the jobs; let go at the end.
        listen: is told about progress.
        document: whose marked blocks are filled too.

    Raises:
        InputError: an assembly or workcell is broken, or something cannot be written.
        MissingExtraError: matplotlib is not installed.
        TakeapartError: a job failed.
    """
    started = time.monotonic()
    try:
        figure_modules()  # not after two hours
        jobs = paper_jobs(settings, load_products(settings))
    except BaseException:
        workers.stop(now=True)
        raise
    results = run_schedule(jobs, out / WORK, workers, listen)
    found = findings(settings, results)
    files = write_results(found, out)
    if document is not None:
        fill_document(found, document)
    report = next(file for file in files if file.suffix == ".md")
    return Reproduced(files, report, time.monotonic() - started)
