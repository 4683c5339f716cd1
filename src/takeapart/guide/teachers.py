"""What the network is taught: a loss for a few states or removals drawn from the experience.

- "backup": Q-values by in-sample backup (`dataset`).
- "exact": what exact search knows. Where it knows the cost to the goal, that is the target; where it only knows bounds,
  any Q-value between them is right, and others are as wrong as they are far from the nearest.
- "dqn": double Q-learning (van Hasselt et al. 2016) on recorded removals, as the paper has it (Sec. V-D) with
  gamma = 1: r + Q_target(s', argmax over a' of Q(s', a')), a' among the parts that gravity and lifting let go.

All use the Huber loss in units of `value_scale`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import huber_loss

from takeapart.guide.dataset import GOAL, StateTable
from takeapart.guide.graph import Indices, Numbers
from takeapart.guide.network import QNetwork

CHUNK = 16  # states evaluated together: they and what they need for the gradient stay in the cache

Target = tuple[Numbers, Numbers]
"""(F,) least and greatest Q-value that is right, m; not a number where nothing is taught."""


class Teacher(Protocol):
    """Gives the gradient of one step."""

    def learn(self, network: QNetwork, rng: np.random.Generator) -> float:
        """Draw a batch, add the gradient of its loss to the network's parameters, and return the loss."""
        ...


def evaluate(network: QNetwork, table: StateTable, rows: Indices) -> Iterator[tuple[Indices, Indices, Tensor]]:
    """Q-values of states, a few of similar size at a time, so that little is padding.

    Yields:
        positions in `rows` (B,), places (B, N) with -1 where padded, and Q-values (B, N), m.
    """
    order = np.argsort(table.counts[rows], kind="stable")
    for start in range(0, len(order), CHUNK):
        positions = order[start : start + CHUNK]
        places, present = table.places(rows[positions])
        graphs = table.batch(places, present)
        # Copies, because the memory of numpy is not always aligned, and results would depend on that.
        arrays = [torch.tensor(array) for array in (graphs.nodes, graphs.edges, graphs.present)]
        yield positions, np.where(present, places, -1), network(*arrays)


def interval_targets(table: StateTable, teacher: str) -> Target:
    """What "backup" and "exact" teach."""
    if teacher == "backup":
        return table.reached, table.reached
    low = np.where(np.isnan(table.known), table.reached, table.known)
    low = np.where(np.isnan(table.least), np.nan, low)
    high = np.where(np.isnan(table.known), np.fmax(table.least, low), table.known)
    return low.astype(np.float32), high.astype(np.float32)


class IntervalTeacher:
    """Teaches all actions of a state at once.

    Args:
        table: of states.
        targets: for its places.
        rows: of the states to learn from; those without targets are left out.
        batch: states per step.
    """

    def __init__(self, table: StateTable, targets: Target, rows: Indices, batch: int) -> None:
        self.table, self.targets, self.batch = table, targets, batch
        taught = np.add.reduceat(np.isfinite(targets[0]).astype(np.int64), table.first[:-1]) > 0
        self.rows = rows[taught[rows]]

    def learn(self, network: QNetwork, rng: np.random.Generator) -> float:
        rows = self.rows[rng.integers(len(self.rows), size=self.batch)]
        low, high = self.targets
        total = sum(int(np.isfinite(low[self.table.first[row] : self.table.first[row + 1]]).sum()) for row in rows)
        loss = 0.0
        for _, places, values in evaluate(network, self.table, rows):
            taught = (places >= 0) & np.isfinite(low[places])
            found = values[torch.tensor(taught)]
            least, most = torch.tensor(low[places[taught]]), torch.tensor(high[places[taught]])
            part = scaled_loss(network, found, torch.minimum(torch.maximum(found.detach(), least), most)) / total
            part.backward()
            loss += float(part.detach())
        return loss


class DoubleQTeacher:
    """Teaches the removals that were recorded.

    Args:
        table: of states and removals.
        rows: states to learn from.
        batch: removals per step.
        target: network with the weights of some time ago.
        dead_end: price of a dead end per part left, m.
    """

    def __init__(self, table: StateTable, rows: Indices, batch: int, target: QNetwork, dead_end: float) -> None:
        self.table, self.batch, self.target, self.dead_end = table, batch, target, dead_end
        self.states = table.states_of_places()
        self.steps = np.nonzero(np.isin(self.states[table.step_place], rows))[0]
        self.choice = np.add.reduceat(table.allowed.astype(np.int64), table.first[:-1]) > 0

    def learn(self, network: QNetwork, rng: np.random.Generator) -> float:
        table = self.table
        steps = self.steps[rng.integers(len(self.steps), size=self.batch)]
        place = table.step_place[steps]
        aim = table.step_reward[steps] + self.next_values(network, table.step_next[steps])
        loss = 0.0
        for positions, places, values in evaluate(network, table, self.states[place]):
            column = place[positions] - places[:, 0]
            found = values[torch.arange(len(positions)), torch.tensor(column)]
            part = scaled_loss(network, found, torch.tensor(aim[positions])) / self.batch
            part.backward()
            loss += float(part.detach())
        return loss

    def next_values(self, network: QNetwork, rows: Indices) -> Numbers:
        """Value of the next states (B,), m, by the double Q-learning rule."""
        result = np.zeros(len(rows), np.float32)
        dead = (rows != GOAL) & ~self.choice[rows]
        result[dead] = -self.dead_end * self.table.counts[rows[dead]]
        going = np.nonzero((rows != GOAL) & ~dead)[0]
        with torch.no_grad():
            pairs = zip(
                evaluate(network, self.table, rows[going]), evaluate(self.target, self.table, rows[going]), strict=True
            )
            for (positions, places, values), (_, _, judged) in pairs:
                allowed = torch.tensor((places >= 0) & self.table.allowed[places])
                chosen = values.masked_fill(~allowed, -torch.inf).argmax(dim=1, keepdim=True)
                result[going[positions]] = judged.gather(1, chosen)[:, 0].numpy()
        return result


def scaled_loss(network: QNetwork, found: Tensor, aim: Tensor) -> Tensor:
    """Sum of Huber losses in units of the network's value scale."""
    return huber_loss(found / network.value_scale, aim / network.value_scale, reduction="sum")
