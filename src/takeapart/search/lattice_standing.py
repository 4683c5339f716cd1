"""Which states of a lattice stand, as far as was asked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from takeapart.search.lattice import Lattice
from takeapart.search.session import Session


class LatticeStanding:
    """What is known of the rows of a lattice; all stand where nothing is ever asked.

    Attributes:
        stands: (N,) rows that are known to stand; root and goal do.
        fallen: (N,) rows that are known not to.
        asked: rows that were asked for; grows with every answer.
    """

    def __init__(self, lattice: Lattice, session: Session) -> None:
        self._lattice, self._session = lattice, session
        rows = len(lattice.states)
        self.always = session.standing.always
        self.stands: NDArray[np.bool_] = np.full(rows, self.always)
        self.stands[0] = True
        if lattice.goal >= 0:
            self.stands[lattice.goal] = True
        self.fallen: NDArray[np.bool_] = np.zeros(rows, np.bool_)
        self.asked = 0

    def ask(self, row: int) -> bool:
        """Whether the state of a row stands.

        Raises:
            BudgetSpentError: the time is over.
        """
        if not self.stands[row] and not self.fallen[row]:
            answer = self._session.stands(self._lattice.state(row))
            (self.stands if answer else self.fallen)[row] = True
            self.asked += 1
        return bool(self.stands[row])
