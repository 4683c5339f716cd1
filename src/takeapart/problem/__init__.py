"""The decision process that every search sees."""

from takeapart.problem.process import AssemblyProblem, Guide, Problem
from takeapart.problem.standing import Standing, Statics

__all__ = [
    "AssemblyProblem",
    "Guide",
    "Problem",
    "Standing",
    "Statics",
]
