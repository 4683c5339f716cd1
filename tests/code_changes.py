"""Small wrong changes of sources: which can be made, and which of them are drawn.

Cosmic Ray knows what can be changed in a line of Python. Every place of an area has a rank of its own, a digest of
seed, module, text of the line and which of the equal ones it is; the lowest ranks are drawn, and at each place the
change of the lowest rank. So a change of the sources exchanges what is drawn on the lines that it touches, no more.
"""

from __future__ import annotations

import ast
import difflib
import hashlib
import json
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

PACKAGE = Path(__file__).resolve().parents[1] / "src" / "takeapart"
ARITHMETIC = ("Add", "Sub", "Mul", "Div", "FloorDiv", "Mod", "Pow")
BITWISE = ("RShift", "LShift", "BitOr", "BitAnd", "BitXor")


@dataclass(frozen=True)
class Mutant:
    """One small change.

    Args:
        area: whose tests judge it.
        module: path below src/takeapart.
        line: of the change, from 1.
        operator, occurrence: as Cosmic Ray counts them.
        before, after: the changed lines.
        equal: how many changes drawn before it in its module read the same.
    """

    area: str
    module: str
    line: int
    operator: str
    occurrence: int
    before: str
    after: str
    equal: int = 0

    @property
    def key(self) -> str:
        """Names the change in the log and in the file of reasons; no line numbers, which move."""
        again = f" ({self.equal + 1})" if self.equal else ""
        return f"{self.module}: {self.before} -> {self.after}{again}"


@dataclass(frozen=True)
class Place:
    """Where a module can be changed.

    Args:
        rank: by which places are drawn.
        line: from 1.
        changes: operators and occurrences, as Cosmic Ray counts them, in the order of their own ranks.
    """

    rank: str
    line: int
    changes: tuple[tuple[str, int], ...]


def rank(*of: object) -> str:
    return hashlib.sha256(repr(of).encode()).hexdigest()


def uninteresting_lines(source: str) -> set[int]:
    """Lines whose change shows nowhere: annotations, and decorators that only make things faster."""
    found: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        for note in (getattr(node, "annotation", None), getattr(node, "returns", None)):
            if isinstance(note, ast.expr) and not (isinstance(node, ast.AnnAssign) and node.value is not None):
                found.update(range(note.lineno, (note.end_lineno or note.lineno) + 1))
    for number, text in enumerate(source.splitlines(), 1):
        if text.strip().startswith(("@compiled", "@cache", "@lru_cache")):
            found.add(number)
    return found


@cache
def operators() -> dict[str, type]:
    """Cosmic Ray's operators; none that only puts an operator on bits into arithmetic, which any test would notice."""
    found = {}
    for name in operator_names():
        if "BinaryOperator" in name and name.split("_")[1] in ARITHMETIC and name.split("_")[2] in BITWISE:
            continue
        try:
            get_operator(name)()
        except TypeError:
            continue  # needs names of variables
        found[name] = get_operator(name)
    return found


def places_of(module: str, source: str, seed: int) -> list[Place]:
    """Where a module can be changed, and how, with their ranks."""
    lines, skipped = source.splitlines(), uninteresting_lines(source)
    found: defaultdict[tuple[tuple[int, int], ...], list[tuple[str, int]]] = defaultdict(list)
    nodes = list(ast_nodes(get_ast(source)))
    for name, operator in operators().items():
        made, occurrence = operator(), 0
        for node in nodes:
            for position in made.mutation_positions(node):
                if position[0][0] not in skipped:
                    found[tuple(tuple(corner) for corner in position)].append((name, occurrence))
                occurrence += 1
    seen: Counter[str] = Counter()
    places = []
    for position, changes in sorted(found.items()):
        text = lines[position[0][0] - 1].strip()
        own = rank(seed, module, text, seen[text])
        seen[text] += 1
        ordered = sorted(changes, key=lambda change: rank(own, change[0]))
        places.append(Place(own, position[0][0], tuple(ordered)))
    return places


def mutated(mutant: Mutant, source: str) -> str | None:
    """The changed source; None where it would not be another program."""
    changed = mutate_code(source, operators()[mutant.operator](), mutant.occurrence)
    if changed is None or changed == source:
        return None
    try:
        same = ast.dump(ast.parse(changed)) == ast.dump(ast.parse(source))
    except SyntaxError:
        return None
    return None if same else changed


def change_at(area: str, module: str, source: str, place: Place) -> Mutant | None:
    """The first change of a place that makes another program."""
    for name, occurrence in place.changes:
        bare = Mutant(area, module, place.line, name, occurrence, "", "")
        changed = mutated(bare, source)
        if changed is not None:
            rows = list(difflib.ndiff(source.splitlines(), changed.splitlines()))
            before, after = (
                " ".join(" ".join(row[1:] for row in rows if row.startswith(sign)).split()) for sign in ("- ", "+ ")
            )
            return Mutant(area, module, place.line, name, occurrence, before, after or "nothing")
    return None


def drawn(area: str, modules: Sequence[Path], count: int, seed: int, kept: Path) -> list[Mutant]:
    """Changes at different places of some modules: those of the lowest ranks, in their order.

    Args:
        kept: folder where the places of a module, which take seconds to find, are kept while it stays the same.
    """
    sources = {str(path.relative_to(PACKAGE)): path.read_text(encoding="utf-8") for path in modules}
    places = [(place, name) for name, source in sources.items() for place in _kept_places(name, source, seed, kept)]
    found: list[Mutant] = []
    seen: Counter[str] = Counter()
    for place, name in sorted(places, key=lambda item: item[0].rank):
        if len(found) == count:
            break
        mutant = change_at(area, name, sources[name], place)
        if mutant is not None:
            found.append(Mutant(**{**asdict(mutant), "equal": seen[mutant.key]}))
            seen[mutant.key] += 1
    return found


def _kept_places(module: str, source: str, seed: int, kept: Path) -> list[Place]:
    file = kept / f"places-{rank(module, source, seed)[:16]}.json"
    if not file.is_file():
        file.write_text(json.dumps([asdict(place) for place in places_of(module, source, seed)]), encoding="utf-8")
    rows = json.loads(file.read_text(encoding="utf-8"))
    return [Place(row["rank"], row["line"], tuple((name, k) for name, k in row["changes"])) for row in rows]
