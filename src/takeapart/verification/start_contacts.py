"""What a part that is taken out may still touch: that from which it starts, until it has come off it once."""

from __future__ import annotations

from collections.abc import Container, Mapping

from takeapart.model.assembly import Assembly
from takeapart.verification.model import Scene
from takeapart.verification.report import Finding, VerificationOptions


class StartContacts:
    """Pairs of geoms of one step that stand closer than the clearance before anything moves.

    What is lifted straight out of connectors keeps its distance at the start until the lift is done. Everything else
    may be in its neighbour as deep as it was drawn, and a little more, until the two were apart by the clearance.

    Args:
        neighbours: pairs of geoms that stand in the assembly -> their distance there, m; both orders.
        twin: geom of the held part -> the same geom where it stands in the assembly.
        clearance: m, of all other pairs.
    """

    def __init__(
        self,
        neighbours: Mapping[tuple[int, int], float],
        twin: Mapping[int, int],
        clearance: float,
        assembly: Assembly,
        scene: Scene,
        options: VerificationOptions,
    ) -> None:
        self._lifted = assembly.stands_in_connectors
        self._apart = clearance + 2 * options.clearance_tolerance  # m; from here on the clearance counts
        self._required: dict[frozenset[int], float] = {}
        allowed = allowed_overlaps(assembly)
        standing = {there: held for held, there in twin.items()}
        for (a, b), start in neighbours.items():
            if a not in standing:
                continue
            if self._lifted:
                required = max(min(clearance, start - options.penetration), -options.penetration)
            elif start >= clearance:
                continue
            else:
                depth = max(-start, 0.0) + options.penetration
                if frozenset((scene.label(a), scene.label(b))) not in allowed:
                    depth = min(depth, options.overlap_limit)
                required = -depth
            self._required[frozenset((standing[a], b))] = required

    def required(self, first: int, second: int, lifting: bool) -> float | None:
        """Distance, m, that a pair must keep now; None where it is no contact of the start, or not any more."""
        if self._lifted and not lifting:
            return None
        return self._required.get(frozenset((first, second)))

    def looked_at(self, required: float) -> float:
        """Distance, m, below which that of a contact of the start matters."""
        return required if self._lifted else self._apart

    def note(self, first: int, second: int, distance: float) -> None:
        """Ends the contact of a pair that is far enough apart, m."""
        if not self._lifted and distance >= self._apart:
            self._required.pop(frozenset((first, second)), None)

    def end_unseen(self, seen: Container[tuple[int, int]]) -> None:
        """Ends the contacts of all pairs that are out of sight: they are further apart than the clearance."""
        if not self._lifted:
            for a, b in [tuple(pair) for pair in self._required]:
                if (a, b) not in seen and (b, a) not in seen:
                    del self._required[frozenset((a, b))]


def check_drawn(
    neighbours: Mapping[tuple[int, int], float], assembly: Assembly, scene: Scene, options: VerificationOptions
) -> list[Finding]:
    """No part is drawn deeper in another than a mesh may be, unless the assembly says that it is meant."""
    if not assembly.has_meshes:
        return []
    allowed = allowed_overlaps(assembly)
    worst: dict[tuple[str, str], float] = {}
    for (a, b), distance in neighbours.items():
        names = scene.label(a), scene.label(b)
        both = all(name.startswith("part/") for name in names)
        if a < b and both and frozenset(names) not in allowed:
            worst[names] = max(worst.get(names, 0.0), -distance)
    return [
        Finding(None, "", None, "collision", f"{first} is drawn in {second}", depth)
        for (first, second), depth in worst.items()
        if depth > options.overlap_limit
    ]


def allowed_overlaps(assembly: Assembly) -> frozenset[frozenset[str]]:
    """Pairs of labels of parts that are meant to overlap."""
    return frozenset(frozenset((f"part/{a}", f"part/{b}")) for a, b in assembly.allowed_overlaps)
