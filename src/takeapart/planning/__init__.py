"""From an assembly and a workcell to a plan: the one call that most users need, and runs that survive a kill."""

from takeapart.planning.infeasible import Hindrance, Infeasible, blocked_parts, explain, infeasible_of
from takeapart.planning.options import PlanningOptions, Recorder
from takeapart.planning.plans import (
    build_problem,
    of_candidates,
    plan,
    plan_in_run,
    plan_of,
    run_identity,
    search,
)
from takeapart.planning.shaping import sources_digest, versions
from takeapart.search.registry import SEARCHES

__all__ = [
    "SEARCHES",
    "Hindrance",
    "Infeasible",
    "PlanningOptions",
    "Recorder",
    "blocked_parts",
    "build_problem",
    "explain",
    "infeasible_of",
    "of_candidates",
    "plan",
    "plan_in_run",
    "plan_of",
    "run_identity",
    "search",
    "sources_digest",
    "versions",
]
