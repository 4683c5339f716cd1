"""The decision process that every search sees."""

from takeapart.problem.process import AssemblyProblem, Guide, Problem

__all__ = [
    "AssemblyProblem",
    "Guide",
    "Problem",
]
