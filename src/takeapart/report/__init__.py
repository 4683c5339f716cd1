"""One page about a plan."""

from takeapart.report.document import page, report, save_report

__all__ = [
    "page",
    "report",
    "save_report",
]
