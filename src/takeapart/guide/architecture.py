"""The shape of the network, and the sizes of all its arrays: what training, weights files and planning agree on."""

from __future__ import annotations

from dataclasses import dataclass

from takeapart.guide.graph import EDGE_NUMBERS, NODE_NUMBERS
from takeapart.model.errors import InputError

LARGEST_LAYERS, LARGEST_WIDTH = 16, 1024


@dataclass(frozen=True)
class Architecture:
    """Sizes of the network of Sec. V-D; the paper gives none of them.

    Args:
        layers: L, graph layers.
        width: numbers per node and edge after every layer, and of the hidden layer of every feed-forward network.
    """

    layers: int = 3
    width: int = 32

    def __post_init__(self) -> None:
        for name, most in (("layers", LARGEST_LAYERS), ("width", LARGEST_WIDTH)):
            if not 1 <= getattr(self, name) <= most:
                raise InputError(f"{getattr(self, name)}; must be from 1 to {most}", f"architecture.{name}")

    def inputs(self, layer: int) -> tuple[int, int]:
        """Numbers per node and per edge that a layer takes."""
        return (self.width, self.width) if layer else (NODE_NUMBERS, EDGE_NUMBERS)

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Names and shapes of all arrays, as the weights file holds them.

        Per layer: the edge network takes (n_i, e_ij, n_j), the node network (n_i, n*_i); `temperature` is that of the
        SoftMax aggregation. The others put inputs and Q-values on a scale near 1: nodes as (n - mean) / scale, edges
        as e / scale, and Q = parts of the state * value_per_part + value_scale * phi_Q.
        """
        width = self.width
        found: dict[str, tuple[int, ...]] = {
            "node_mean": (NODE_NUMBERS,),
            "node_scale": (NODE_NUMBERS,),
            "edge_scale": (EDGE_NUMBERS,),
            "value_per_part": (),
            "value_scale": (),
        }
        for layer in range(self.layers):
            node, edge = self.inputs(layer)
            for name, inputs in (("edge", 2 * node + edge), ("node", node + node + width)):
                found |= _two_layers(f"layers.{layer}.{name}", inputs, width, width)
            found[f"layers.{layer}.temperature"] = ()
        return found | _two_layers("value", 2 * width, width, 1)


def _two_layers(name: str, inputs: int, hidden: int, outputs: int) -> dict[str, tuple[int, ...]]:
    return {
        f"{name}.0.weight": (hidden, inputs),
        f"{name}.0.bias": (hidden,),
        f"{name}.2.weight": (outputs, hidden),
        f"{name}.2.bias": (outputs,),
    }
