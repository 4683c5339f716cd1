"""The forward pass of the Q-network in numpy: planning with a guide needs no torch, and starts at once.

The formulas stand in `network`; a test holds the two together.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from takeapart.guide.architecture import Architecture
from takeapart.guide.graph import Numbers, PartGeometry

Indices = NDArray[np.int64]


class ForwardPass:
    """Q-values of one state at a time.

    Args:
        architecture: of the network.
        arrays: as `Architecture.shapes` lists them.
        geometry: of the assembly.
    """

    def __init__(self, architecture: Architecture, arrays: Mapping[str, Numbers], geometry: PartGeometry) -> None:
        self._layers = [
            _Layer(arrays, f"layers.{layer}", *architecture.inputs(layer)) for layer in range(architecture.layers)
        ]
        self._nodes = (geometry.corners - arrays["node_mean"]) / arrays["node_scale"]  # (P, 24)
        self._middles = geometry.middles / arrays["edge_scale"]  # (P, 3)
        weight = arrays["value.0.weight"]
        self._of_mean = np.ascontiguousarray(weight[:, : architecture.width].T)
        self._of_node = np.ascontiguousarray(weight[:, architecture.width :].T)
        self._bias, self._last = arrays["value.0.bias"], arrays["value.2.weight"][0]
        self._last_bias = float(arrays["value.2.bias"][0])
        self._per_part, self._scale = float(arrays["value_per_part"]), float(arrays["value_scale"])

    def __call__(self, parts: Indices) -> Numbers:
        """Q-value of every part of a state, (N,) m, in the order given.

        Args:
            parts: (N,) numbers of the parts of the state, at least one.
        """
        nodes, middles = self._nodes[parts], self._middles[parts]
        edges = (middles[None, :, :] - middles[:, None, :]).reshape(-1, 3)
        for layer in self._layers:
            nodes, edges = layer(nodes, edges)
        hidden = nodes @ self._of_node + (nodes.mean(axis=0) @ self._of_mean + self._bias)
        np.maximum(hidden, 0.0, out=hidden)
        values: Numbers = len(parts) * self._per_part + self._scale * (hidden @ self._last + self._last_bias)
        return values


class _Layer:
    """One `GraphLayer`; weights are kept transposed, edges as (N * N, width)."""

    def __init__(self, arrays: Mapping[str, Numbers], name: str, node: int, edge: int) -> None:
        first = arrays[f"{name}.edge.0.weight"].T
        self.of_i, self.of_edge, self.of_j = (
            np.ascontiguousarray(rows) for rows in np.split(first, [node, node + edge], axis=0)
        )
        self.bias = arrays[f"{name}.edge.0.bias"]
        self.second = np.ascontiguousarray(arrays[f"{name}.edge.2.weight"].T)
        self.second_bias = arrays[f"{name}.edge.2.bias"]
        self.node_first = np.ascontiguousarray(arrays[f"{name}.node.0.weight"].T)
        self.node_bias = arrays[f"{name}.node.0.bias"]
        self.node_second = np.ascontiguousarray(arrays[f"{name}.node.2.weight"].T)
        self.node_second_bias = arrays[f"{name}.node.2.bias"]
        self.temperature = np.float32(arrays[f"{name}.temperature"])

    def __call__(self, nodes: Numbers, edges: Numbers) -> tuple[Numbers, Numbers]:
        count, width = len(nodes), len(self.bias)
        hidden: Numbers = (edges @ self.of_edge).reshape(count, count, width)
        hidden += (nodes @ self.of_i + self.bias)[:, None, :]
        hidden += (nodes @ self.of_j)[None, :, :]
        np.maximum(hidden, 0.0, out=hidden)
        edges = np.matmul(hidden.reshape(-1, width), self.second)
        edges += self.second_bias
        if count == 1:
            joined = np.zeros((1, nodes.shape[1] + width), np.float32)  # no neighbours
        else:
            own = np.maximum(nodes, 0.0, dtype=np.float32)
            joined = np.concatenate([own, self._gathered(edges, count)], axis=1)
        inner: Numbers = np.concatenate([nodes, joined], axis=1) @ self.node_first + self.node_bias
        np.maximum(inner, 0.0, out=inner)
        return inner @ self.node_second + self.node_second_bias, edges

    def _gathered(self, edges: Numbers, count: int) -> Numbers:
        """SoftMax aggregation of ReLU(e'_ij) over j, without j = i."""
        messages = np.maximum(edges, 0.0).reshape(count, count, -1)
        weights = self.temperature * messages
        diagonal = np.arange(count)
        weights[diagonal, diagonal] = -np.inf
        weights -= weights.max(axis=1, keepdims=True)
        np.exp(weights, out=weights)
        total = weights.sum(axis=1)
        weights *= messages
        gathered: Numbers = weights.sum(axis=1) / total
        return gathered
