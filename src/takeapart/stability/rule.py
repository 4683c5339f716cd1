"""Which rule of gravity a product is planned with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

from takeapart.model.assembly import Assembly
from takeapart.model.errors import InputError
from takeapart.stability.connectors import ConnectorStability, require_support, unsupported
from takeapart.stability.contacts import ContactStability
from takeapart.stability.failures import Failure, failures

WIDER_GAPS = (1e-3, 2e-3, 5e-3)  # m; what is tried where a product does not stand as drawn


@lru_cache(maxsize=8)  # contacts of meshes take seconds, and several ask for the same product
def stability_of(assembly: Assembly) -> ConnectorStability | ContactStability:
    """Connectors say what falls where they carry every part of a product of boxes; statics by contact elsewhere."""
    if assembly.connectors and not assembly.has_meshes and not unsupported(assembly):
        return ConnectorStability(assembly)
    return ContactStability(assembly)


def require_standing(assembly: Assembly) -> ConnectorStability | ContactStability:
    """The rule for a product that stands as drawn.

    Raises:
        InputError: a part falls in the full product: which, why, and which contact gap would do; or a connector that
            the rule relies on holds nothing.
    """
    rule = stability_of(assembly)
    if isinstance(rule, ConnectorStability):
        require_support(assembly)
        return rule
    found = failures(rule, assembly.root)
    if found:
        first = next((failure for failure in found if failure.cause != "rests"), found[0])
        more = f" (and {len(found) - 1} more fall{'s' if len(found) == 2 else ''})" if len(found) > 1 else ""
        raise InputError(
            f"part {first.text(assembly)}{more}; {_remedy(assembly, found)}",
            f"{assembly.name}: parts",
        )
    return rule


def _remedy(assembly: Assembly, found: Sequence[Failure]) -> str:
    fewest, best = len(found), 0.0
    if any(failure.cause in ("floats", "drops", "tips") for failure in found):
        for gap in WIDER_GAPS:
            if gap > assembly.contact_gap and fewest:
                falling = len(ContactStability(replace(assembly, contact_gap=gap)).floating())
                fewest, best = (falling, gap) if falling < fewest else (fewest, best)
    if not best:
        return "it must be carried, fastened by a joint, or fixed"
    effect = f"{fewest} {'falls' if fewest == 1 else 'fall'}" if fewest else "everything stands"
    return f"with a contact gap of {1e3 * best:g} mm {effect}"
