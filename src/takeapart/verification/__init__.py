"""Independent replay of a plan: nothing here imports what it is there to check."""

from takeapart.verification.physics import (
    StabilityComparison,
    StandingReport,
    compare_stability,
    stand_under_gravity,
)
from takeapart.verification.report import (
    Agreement,
    Clearance,
    Finding,
    VerificationOptions,
    VerificationReport,
    format_finding,
    report_as_dict,
)
from takeapart.verification.verifier import Verifier, states_of, verify_plan

__all__ = [
    "Agreement",
    "Clearance",
    "Finding",
    "StabilityComparison",
    "StandingReport",
    "VerificationOptions",
    "VerificationReport",
    "Verifier",
    "compare_stability",
    "format_finding",
    "report_as_dict",
    "stand_under_gravity",
    "states_of",
    "verify_plan",
]
