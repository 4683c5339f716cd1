"""A trained guide as the searches take it: from states to the Q-value of every part (Sec. V-E)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from takeapart.formats.files import data_path
from takeapart.guide.forward import ForwardPass
from takeapart.guide.graph import Numbers, part_geometry
from takeapart.guide.weights import Weights, load_weights
from takeapart.model.assembly import Assembly
from takeapart.model.errors import InputError
from takeapart.states import members

DEFAULT = "default"
SHIPPED = "guide/default.safetensors"  # trained on all shipped assemblies; guide/README.md is its model card


class LearnedGuide:
    """Q-values of all parts of a state by one forward pass; no state is computed twice.

    It fits `problem.Guide`. Which parts may leave is the problem's affair: the values hold all parts of the state, and
    `planning.search` takes those of the candidates.

    Attributes:
        hash: SHA-256 of the weights.
        computed: states that were computed so far.
    """

    def __init__(self, weights: Weights, assembly: Assembly) -> None:
        self.hash = weights.hash
        self._forward = ForwardPass(weights.architecture, weights.arrays, part_geometry(assembly))
        self._known: dict[int, Numbers] = {}

    def __call__(self, states: Sequence[int]) -> list[Mapping[int, float]]:
        """Per state, the expected sum of rewards, m, after removing each of its parts."""
        found: list[Mapping[int, float]] = []
        for state in states:
            parts = members(state)
            values = self._known.get(state)
            if values is None:
                values = self._forward(np.array(parts)) if parts else np.zeros(0, np.float32)
                self._known[state] = values
            found.append(dict(zip(parts, values.tolist(), strict=True)))
        return found

    @property
    def computed(self) -> int:
        return len(self._known)


def load_guide(path: Path | str, assembly: Assembly) -> LearnedGuide:
    """The guide in a weights file, for an assembly.

    Args:
        path: the file, or "default" for the guide that comes with the package.

    Raises:
        InputError: the file is missing or broken.
    """
    return LearnedGuide(load_weights(guide_path(path)), assembly)


def guide_path(path: Path | str) -> Path:
    """The weights file that is meant.

    Raises:
        InputError: no guide comes with this installation.
    """
    if str(path) != DEFAULT:
        return Path(path)
    try:
        return data_path(SHIPPED)
    except InputError:
        raise InputError("no guide comes with this installation; give the file of one", DEFAULT) from None
