"""A training that is under way, as one file: a training that was killed goes on from there to the same weights.

The file is of the safetensors format, as weights are; nothing is pickled. It holds the current, the best, and (for
double Q-learning) the target network's weights, both moments of Adam, and as metadata the step and the log.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from takeapart.formats.documents import canonical_json
from takeapart.formats.messages import shown
from takeapart.guide.weights import read_arrays, write_arrays
from takeapart.model.errors import InputError

FORMAT, VERSION = "takeapart/guide-checkpoint", "1"
MAXIMUM_BYTES = 512 * 2**20
MOMENTS = ("exp_avg", "exp_avg_sq")  # what Adam keeps per parameter

LogRow = dict[str, float]


@dataclass(frozen=True)
class Stage:
    """How far a training has come.

    Args:
        step: steps done.
        best_step: with the best weights so far.
        best: regret and error of these on the held-out states, m.
        log: a row per evaluation.
        done: no more steps are to be made.
    """

    step: int
    best_step: int
    best: tuple[float, float]
    log: tuple[LogRow, ...]
    done: bool


def save_checkpoint(
    path: Path,
    identity: str,
    stage: Stage,
    networks: Mapping[str, Mapping[str, Tensor]],
    network: nn.Module,
    optimizer: torch.optim.Adam,
) -> None:
    """Write a checkpoint, atomically.

    Args:
        identity: what is trained on what; a checkpoint of another training is refused.
        networks: arrays of the networks by the name of their role.
        network: that is trained, with `optimizer`.

    Raises:
        InputError: it cannot be written.
    """
    arrays = {f"{role}/{name}": array for role, state in networks.items() for name, array in state.items()}
    for name, parameter in network.named_parameters():
        for moment in MOMENTS:
            arrays[f"{moment}/{name}"] = optimizer.state[parameter][moment]
    metadata = {
        "format": FORMAT,
        "version": VERSION,
        "identity": identity,
        "stage": canonical_json(asdict(stage)),
    }
    write_arrays(path, {name: array.detach().numpy() for name, array in arrays.items()}, metadata)


def load_checkpoint(
    path: Path,
    identity: str,
    networks: Mapping[str, nn.Module],
    network: nn.Module,
    optimizer: torch.optim.Adam,
) -> Stage:
    """Put networks and optimizer into the state of a checkpoint.

    Raises:
        InputError: the file is damaged, or of another training.
    """
    where = shown(path)
    arrays, metadata = read_arrays(path, MAXIMUM_BYTES)
    if (metadata.get("format"), metadata.get("version")) != (FORMAT, VERSION):
        raise InputError("is no checkpoint of a training; move it out of the way", where)
    if metadata.get("identity") != identity:
        raise InputError(
            "is the checkpoint of another training (other options or experience); delete it or give another --out",
            where,
        )
    expected = {f"{role}/{name}": a for role, module in networks.items() for name, a in module.state_dict().items()}
    expected |= {f"{moment}/{name}": a for moment in MOMENTS for name, a in network.named_parameters()}
    if {name: array.shape for name, array in arrays.items()} != {name: tuple(a.shape) for name, a in expected.items()}:
        raise InputError("is damaged: it does not hold the arrays of this training; delete it to start anew", where)
    try:
        found = json.loads(metadata["stage"])
        best, log = found.pop("best"), found.pop("log")
        stage = Stage(**found, best=(float(best[0]), float(best[1])), log=tuple(dict(row) for row in log))
    except (KeyError, TypeError, ValueError, IndexError):
        raise InputError("is damaged: its stage cannot be read; delete it to start anew", where) from None
    tensors = {name: torch.tensor(array) for name, array in arrays.items()}
    for role, module in networks.items():
        module.load_state_dict({name: tensors[f"{role}/{name}"] for name in module.state_dict()})
    for name, parameter in network.named_parameters():
        moments = {moment: tensors[f"{moment}/{name}"] for moment in MOMENTS}
        optimizer.state[parameter] = {"step": torch.tensor(float(stage.step)), **moments}
    return stage
