"""What lies on what, and which parts may leave without another one falling."""

from takeapart.stability.connectors import ConnectorStability, Stability, require_support, unsupported
from takeapart.stability.contacts import ContactStability, Verdict
from takeapart.stability.failures import Failure, failures
from takeapart.stability.rule import require_standing, stability_of

__all__ = [
    "ConnectorStability",
    "ContactStability",
    "Failure",
    "Stability",
    "Verdict",
    "failures",
    "require_standing",
    "require_support",
    "stability_of",
    "unsupported",
]
