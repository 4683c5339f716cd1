"""What lies on what, and which parts may leave without another one falling."""

from takeapart.stability.connectors import ConnectorStability, Stability, require_support, unsupported

__all__ = [
    "ConnectorStability",
    "Stability",
    "require_support",
    "unsupported",
]
