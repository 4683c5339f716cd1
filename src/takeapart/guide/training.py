"""Training of the Q-network on recorded experience (Sec. V-D), with early stopping on assemblies held out.

Every step draws its batch with a random generator of its own, made of seed and step: a training that goes on from a
checkpoint makes the same steps, bit for bit, as one that was never cut off. Each evaluation writes a checkpoint and the
log (CSV) beside the weights.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch

from takeapart.formats.documents import canonical_json, write_atomically
from takeapart.guide.architecture import Architecture
from takeapart.guide.checkpoint import LogRow, Stage, load_checkpoint, save_checkpoint
from takeapart.guide.dataset import StateTable, state_table
from takeapart.guide.experience import Experience
from takeapart.guide.graph import Indices, Numbers
from takeapart.guide.network import QNetwork
from takeapart.guide.teacher_names import TEACHERS, TeacherName
from takeapart.guide.teachers import DoubleQTeacher, IntervalTeacher, Teacher, evaluate, interval_targets
from takeapart.guide.weights import Weights, load_weights, save_weights
from takeapart.model.errors import InputError, UnknownNameError

SMALLEST_SCALE = 0.01  # m; numbers that do not vary are not blown up


@dataclass(frozen=True)
class TrainingOptions:
    """Options of `train`. The paper gives no number of these but gamma (1, Eq. 4 read as a sum of lengths).

    Args:
        teacher: "backup", "exact" or "dqn"; see `teachers`.
        architecture: of the network.
        steps: gradient steps at most.
        batch: states per step ("dqn": removals), as in Mnih et al. 2015.
        learning_rate: of Adam (Kingma and Ba 2015) at the start; it falls to zero along half a cosine.
        gradient_norm: longer gradients are cut to this length.
        evaluate_every: steps between evaluations on the states held out.
        patience: evaluations in a row without a better one, after which the training ends.
        held_out: names of the assemblies that are held out; by default `held_out_share` of them, drawn by the seed.
        held_out_share: 0 to 0.5; with a single assembly nothing is held out, and its own states judge.
        held_out_states: states of these that are looked at per evaluation, at most.
        target_every: steps between two copies to the target network ("dqn").
        dead_end: price of a dead end per part left, m; above the length of any removal of the paper's assemblies.
        seed: of weights, batches and what is held out.
    """

    teacher: TeacherName = "backup"
    architecture: Architecture = field(default_factory=Architecture)
    steps: int = 1000
    batch: int = 32
    learning_rate: float = 2e-3
    gradient_norm: float = 10.0
    evaluate_every: int = 50
    patience: int = 8
    held_out: tuple[str, ...] = ()
    held_out_share: float = 0.15
    held_out_states: int = 600
    target_every: int = 200
    dead_end: float = 2.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.teacher not in TEACHERS:
            raise UnknownNameError("teacher", self.teacher, list(TEACHERS), "training.teacher")
        for name in ("steps", "batch", "evaluate_every", "patience", "held_out_states", "target_every"):
            if getattr(self, name) < 1:
                raise InputError(f"{getattr(self, name)}; must be at least 1", f"training.{name}")
        for name in ("learning_rate", "gradient_norm"):
            if not 0 < getattr(self, name) < math.inf:
                raise InputError(f"{getattr(self, name)}; must be above 0 and finite", f"training.{name}")
        if not 0 <= self.held_out_share <= 0.5:
            raise InputError(f"{self.held_out_share}; must be from 0 to 0.5", "training.held_out_share")
        if not 0 <= self.dead_end < math.inf:
            raise InputError(f"{self.dead_end}; must be at least 0 and finite", "training.dead_end")
        if self.seed < 0:
            raise InputError(f"{self.seed}; must be at least 0", "training.seed")


@dataclass(frozen=True)
class TrainingProgress:
    """A sign of life of a training.

    Args:
        step, steps: done, and to be done at most.
        loss: mean training loss since the last sign, without unit.
        error: mean absolute error of the Q-values on the states held out, m.
        regret: how much worse than the best known part the network's choice is, mean over states held out, m.
        random_regret: the same for a random choice, m.
        best_regret: the least regret so far, m.
        seconds: since the training began or was taken up again.
    """

    step: int
    steps: int
    loss: float
    error: float
    regret: float
    random_regret: float
    best_regret: float
    seconds: float


Identity = dict[str, object]
"""What is trained on what: "options" and the hash of the "experience"."""

TrainingListener = Callable[[TrainingProgress], None]


@dataclass(frozen=True)
class TrainedGuide:
    """What `train` leaves behind.

    Args:
        path: the weights.
        log: the CSV file with a row per evaluation.
        hash: of the weights.
        steps: made.
        best_step: whose weights are kept.
        error, regret, random_regret: of these on the states held out, m; see `TrainingProgress`.
        held_out: names of the assemblies held out.
    """

    path: Path
    log: Path
    hash: str
    steps: int
    best_step: int
    error: float
    regret: float
    random_regret: float
    held_out: tuple[str, ...]


def train(
    experience: Experience, options: TrainingOptions, out: Path, listen: TrainingListener | None = None
) -> TrainedGuide:
    """Train a guide; called again after a kill, it goes on where it was.

    Args:
        out: weights file; the checkpoint and the log stand beside it. If it holds the result of the same training
            already, nothing is done.
        listen: is told every evaluation.

    Returns:
        where the weights are and how good they are on what was held out.

    Raises:
        InputError: there is nothing to learn from, an assembly to hold out is unknown, `out` is the guide of another
            training, or a file cannot be read or written.
    """
    identity: Identity = {"options": asdict(options), "experience": experience.hash}
    if out.exists():
        return _finished(out, identity)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # sums must not depend on the machine; more threads gain nothing at this size
    try:
        return _Training(experience, options, out, identity).run(listen)
    finally:
        torch.set_num_threads(threads)


def held_out_names(names: tuple[str, ...], options: TrainingOptions) -> tuple[str, ...]:
    """Names of the assemblies that are held out.

    Raises:
        UnknownNameError: one is unknown.
        InputError: all are held out.
    """
    for name in options.held_out:
        if name not in names:
            raise UnknownNameError("assembly", name, list(names), "training.held_out")
    if options.held_out:
        if set(options.held_out) == set(names):
            raise InputError("every assembly is held out; leave one to learn from", "training.held_out")
        return tuple(sorted(set(options.held_out)))
    if len(names) == 1 or options.held_out_share == 0:
        return ()
    count = max(1, round(options.held_out_share * len(names)))
    drawn = np.random.default_rng([options.seed, 1]).permutation(len(names))[:count]
    return tuple(names[i] for i in sorted(drawn))


class _Judge:
    """Error and regret of a network on a fixed sample of states."""

    def __init__(self, table: StateTable, rows: Indices, limit: int, rng: np.random.Generator) -> None:
        self.table = table
        self.value = table.best_known
        known = np.isfinite(self.value)
        choices = np.add.reduceat(known.astype(np.int64), table.first[:-1])
        told = rows[choices[rows] > 1] if (choices[rows] > 1).any() else rows[choices[rows] > 0]
        self.rows = told if len(told) <= limit else np.sort(rng.choice(told, limit, replace=False))
        differences = [self._values(row).max() - self._values(row).mean() for row in self.rows]
        self.random_regret = float(np.mean(differences))

    def _values(self, row: int) -> Numbers:
        value = self.value[self.table.first[row] : self.table.first[row + 1]]
        return value[np.isfinite(value)]

    def judge(self, network: QNetwork) -> tuple[float, float]:
        """Regret and error, m."""
        regret, error, count = 0.0, 0.0, 0
        with torch.no_grad():
            for _, places, values in evaluate(network, self.table, self.rows):
                known = (places >= 0) & np.isfinite(self.value[places])
                truth = np.where(known, self.value[places], -np.inf)
                found = np.where(known, values.numpy(), -np.inf)
                chosen = found.argmax(axis=1)
                regret += float((truth.max(axis=1) - truth[np.arange(len(truth)), chosen]).sum())
                error += float(np.abs(found[known] - truth[known]).sum())
                count += int(known.sum())
        return regret / len(self.rows), error / count


class _Training:
    """One run: networks, optimizer, teacher, and what is judged."""

    def __init__(
        self, experience: Experience, options: TrainingOptions, out: Path, identity: dict[str, object]
    ) -> None:
        self.options, self.out, self.identity = options, out, identity
        self.checkpoint, self.log_file = checkpoint_path(out), log_path(out)
        table = state_table(experience, options.dead_end)
        self.held_out = held_out_names(table.names, options)
        rows = table.rows_of([name for name in table.names if name not in self.held_out])
        judged = table.rows_of(self.held_out) if self.held_out else rows
        self.judge = _Judge(table, judged, options.held_out_states, np.random.default_rng([options.seed, 2]))
        torch_state = torch.get_rng_state()
        torch.manual_seed(options.seed)
        self.network, self.best = (QNetwork(options.architecture) for _ in range(2))
        torch.set_rng_state(torch_state)
        _scale(self.network, table, rows)
        self.best.load_state_dict(self.network.state_dict())
        self.networks = {"network": self.network, "best": self.best}
        self.teacher: Teacher
        if options.teacher == "dqn":
            target = QNetwork(options.architecture)
            target.load_state_dict(self.network.state_dict())
            self.networks["target"] = target
            self.teacher = DoubleQTeacher(table, rows, options.batch, target, options.dead_end)
        else:
            targets = interval_targets(table, options.teacher)
            teacher = IntervalTeacher(table, targets, rows, options.batch)
            if not len(teacher.rows):
                needed = "no removal has a bound; record with: takeapart plan --search exact --experience DIR"
                raise InputError(needed if options.teacher == "exact" else "no sequence was recorded to its end")
            self.teacher = teacher
        self.optimizer = torch.optim.Adam(self.network.parameters(), options.learning_rate, foreach=False)

    def run(self, listen: TrainingListener | None) -> TrainedGuide:
        options, seal = self.options, canonical_json(self.identity)
        stage = Stage(0, 0, (math.inf, math.inf), (), False)
        if self.checkpoint.exists():
            stage = load_checkpoint(self.checkpoint, seal, self.networks, self.network, self.optimizer)
        started, losses = time.monotonic(), []
        while not stage.done:
            for step in range(stage.step + 1, min(stage.step + options.evaluate_every, options.steps) + 1):
                losses.append(self.step(step))
            stage = self.evaluated(stage, step, float(np.mean(losses)), time.monotonic() - started)
            states = {role: module.state_dict() for role, module in self.networks.items()}
            save_checkpoint(self.checkpoint, seal, stage, states, self.network, self.optimizer)
            write_atomically(self.log_file, _csv(stage.log))
            losses = []
            if listen is not None:
                row = stage.log[-1]
                listen(
                    TrainingProgress(
                        stage.step,
                        options.steps,
                        row["loss"],
                        row["error"],
                        row["regret"],
                        self.judge.random_regret,
                        stage.best[0],
                        row["seconds"],
                    )
                )
        return self.finish(stage)

    def step(self, step: int) -> float:
        """One gradient step; steps count from 1."""
        options = self.options
        if options.teacher == "dqn" and (step - 1) % options.target_every == 0:
            self.networks["target"].load_state_dict(self.network.state_dict())
        for group in self.optimizer.param_groups:
            group["lr"] = 0.5 * options.learning_rate * (1 + math.cos(math.pi * (step - 1) / options.steps))
        self.optimizer.zero_grad(set_to_none=True)
        loss = self.teacher.learn(self.network, np.random.default_rng([options.seed, 3, step]))
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), options.gradient_norm, foreach=False)
        self.optimizer.step()
        return loss

    def evaluated(self, stage: Stage, step: int, loss: float, seconds: float) -> Stage:
        """The stage after an evaluation; the best weights are kept."""
        found = self.judge.judge(self.network)
        best, best_step = stage.best, stage.best_step
        if found < best:
            best, best_step = found, step
            self.best.load_state_dict(self.network.state_dict())
        row: LogRow = {"step": step, "loss": loss, "error": found[1], "regret": found[0]}
        row |= {"random_regret": self.judge.random_regret, "seconds": round(seconds, 3)}
        waited = (step - best_step) >= self.options.patience * self.options.evaluate_every
        return Stage(step, best_step, best, (*stage.log, row), waited or step >= self.options.steps)

    def finish(self, stage: Stage) -> TrainedGuide:
        """Write the best weights, and remove the checkpoint."""
        training = {
            **self.identity,
            "assemblies": [name for name in self.judge.table.names if name not in self.held_out],
            "held_out": list(self.held_out),
            "steps": stage.step,
            "best_step": stage.best_step,
            "regret": stage.best[0],
            "error": stage.best[1],
            "random_regret": self.judge.random_regret,
        }
        arrays = {name: array.numpy() for name, array in self.best.state_dict().items()}
        save_weights(Weights(self.options.architecture, arrays, training), self.out)
        self.checkpoint.unlink(missing_ok=True)
        return _finished(self.out, self.identity)


def checkpoint_path(out: Path) -> Path:
    """Where a training keeps its checkpoint."""
    return out.with_name(f"{out.name}.checkpoint")


def log_path(out: Path) -> Path:
    """Where a training keeps its log."""
    return out.with_name(f"{out.name}.csv")


def _finished(out: Path, identity: Identity) -> TrainedGuide:
    weights = load_weights(out)
    made = weights.training
    if canonical_json({key: made.get(key) for key in identity}) != canonical_json(identity):
        raise InputError("is the guide of another training; give another --out", str(out))
    return TrainedGuide(
        out,
        log_path(out),
        weights.hash,
        made["steps"],
        made["best_step"],
        made["error"],
        made["regret"],
        made["random_regret"],
        tuple(made["held_out"]),
    )


def _scale(network: QNetwork, table: StateTable, rows: Indices) -> None:
    """Set the scales of inputs and values from the states to learn from."""
    learned = np.isin(table.states_of_places(), rows)
    corners, middles = table.corners[table.nodes[learned]], table.middles[table.nodes[learned]]
    residual = table.best_known - table.mean_reward * np.repeat(table.counts, table.counts)
    residual = residual[learned & np.isfinite(residual)]
    spread = float(np.sqrt(np.mean(residual**2))) if len(residual) else 1.0
    with torch.no_grad():
        network.node_mean.copy_(torch.tensor(corners.mean(axis=0)))
        network.node_scale.copy_(torch.tensor(np.maximum(corners.std(axis=0), SMALLEST_SCALE)))
        network.edge_scale.copy_(torch.tensor(np.maximum(np.sqrt(2.0) * middles.std(axis=0), SMALLEST_SCALE)))
        network.value_per_part.fill_(table.mean_reward)
        network.value_scale.fill_(max(spread, SMALLEST_SCALE))


def _csv(log: tuple[LogRow, ...]) -> str:
    lines = [",".join(log[0])]
    return "\n".join(lines + [",".join(f"{value:.6g}" for value in row.values()) for row in log]) + "\n"
