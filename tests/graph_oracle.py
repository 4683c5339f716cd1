"""The Q-network of Sec. V-D on torch-geometric, layer by layer as the paper prints it, on the weights of ours."""

from __future__ import annotations

import torch
from torch import Tensor
from torch_geometric.nn import MessagePassing
from torch_geometric.nn.aggr import SoftmaxAggregation

from takeapart.guide.network import GraphLayer, QNetwork


class OracleLayer(MessagePassing):
    """phi_e on (n_i, e_ij, n_j), SoftMax over ReLU(n_i joined with e_ij), phi_n on (n_i, n*_i); nothing split."""

    def __init__(self, ours: GraphLayer) -> None:
        super().__init__(aggr=SoftmaxAggregation(t=float(ours.temperature.detach())))
        self.ours = ours

    def forward(self, nodes: Tensor, pairs: Tensor, edges: Tensor) -> tuple[Tensor, Tensor]:
        """`pairs` (2, E): j and i of every edge attribute e_ij; the messages of e_ij gather at i."""
        j, i = pairs
        edges = self.ours.edge(torch.cat([nodes[i], edges, nodes[j]], dim=1))
        gathered = self.propagate(pairs, x=nodes, edges=edges, size=(len(nodes), len(nodes)))
        return self.ours.node(torch.cat([nodes, gathered], dim=1)), edges

    def message(self, x_i: Tensor, edges: Tensor) -> Tensor:
        return torch.relu(torch.cat([x_i, edges], dim=1))


def oracle_values(network: QNetwork, nodes: Tensor, edges: Tensor) -> Tensor:
    """Q-values (N,) of one graph: nodes (N, 24), edges (N, N, 3)."""
    count = len(nodes)
    pairs = torch.tensor([(j, i) for i in range(count) for j in range(count) if i != j], dtype=torch.long)
    pairs = pairs.reshape(-1, 2).T
    attributes = edges[pairs[1], pairs[0]] / network.edge_scale
    nodes = (nodes - network.node_mean) / network.node_scale
    for layer in network.layers:
        assert isinstance(layer, GraphLayer)
        nodes, attributes = OracleLayer(layer)(nodes, pairs, attributes)
    joined = torch.cat([nodes.mean(dim=0, keepdim=True).expand_as(nodes), nodes], dim=1)
    return count * network.value_per_part + network.value_scale * network.value(joined)[:, 0]
