"""The Q-network of Sec. V-D in dense tensors, for training; `forward` computes the same without torch, for planning.

A graph of N nodes has all N (N - 1) edges, so dense (N, N) arrays hold nothing in vain, and masks stand for padding.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from takeapart.guide.architecture import Architecture
from takeapart.guide.graph import EDGE_NUMBERS, NODE_NUMBERS


def feed_forward(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    """Two linear layers with a ReLU between them."""
    return nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU(inplace=True), nn.Linear(hidden, outputs))


class GraphLayer(nn.Module):
    """One layer of Sec. V-D, in three steps.

        e'_ij = phi_e(n_i, e_ij, n_j)
        n*_i  = SoftMax aggregation over j of ReLU(n_i joined with e'_ij)
        n'_i  = phi_n(n_i, n*_i)

    phi_e and phi_n are feed-forward networks with one hidden layer. The aggregation is sum_j m_ij softmax_j(t m_ij),
    per number, with a learned temperature t (Li et al. 2020, Eq. 4). The node's half of m_ij is the same for all j, and
    so its aggregate is ReLU(n_i). A node without neighbours has n* = 0.

    The first layer of phi_e is split, W (n_i, e_ij, n_j) = W_i n_i + W_e e_ij + W_j n_j, so that the products with
    nodes are made N times, not N^2 times.

    Args:
        node, edge: numbers per node and edge that go in.
        width: numbers per node and edge that come out.
    """

    def __init__(self, node: int, edge: int, width: int) -> None:
        super().__init__()
        self.sizes = [node, edge, node]
        self.edge = feed_forward(2 * node + edge, width, width)
        self.node = feed_forward(2 * node + width, width, width)
        self.temperature = nn.Parameter(torch.ones(()))

    def forward(self, nodes: Tensor, edges: Tensor, neighbours: Tensor) -> tuple[Tensor, Tensor]:
        """Nodes (B, N, node) and edges (B, N, N, edge) to the same with `width` numbers.

        Args:
            neighbours: (B, N, N, 1) whether j is a neighbour of i.
        """
        first, second = self.edge[0], self.edge[2]
        assert isinstance(first, nn.Linear)
        of_i, of_edge, of_j = first.weight.split(self.sizes, dim=1)
        hidden = edges @ of_edge.T + (nodes @ of_i.T + first.bias).unsqueeze(2) + (nodes @ of_j.T).unsqueeze(1)
        edges = second(torch.relu_(hidden))
        messages = torch.relu(edges)
        scores = (self.temperature * messages).masked_fill(~neighbours, torch.finfo(messages.dtype).min)
        gathered = (messages * torch.softmax(scores, dim=2)).sum(dim=2)
        own = torch.relu(nodes)
        joined = torch.cat([own, gathered], dim=2) * neighbours.any(dim=2)
        return self.node(torch.cat([nodes, joined], dim=2)), edges


class QNetwork(nn.Module):
    """Q(s, a) = phi_Q(mean of all nodes joined with the node of a) after L graph layers (Sec. V-D), for all a at once.

    The paper's Q-value is the output of phi_Q; here that is scaled to metres, and a constant per part that is still
    there is added, because a mean over nodes cannot count them (docs/deviations.md).
    """

    node_mean: Tensor
    node_scale: Tensor
    edge_scale: Tensor
    value_per_part: Tensor
    value_scale: Tensor

    def __init__(self, architecture: Architecture) -> None:
        super().__init__()
        self.architecture = architecture
        width = architecture.width
        self.layers = nn.ModuleList(
            GraphLayer(*architecture.inputs(layer), width) for layer in range(architecture.layers)
        )
        self.value = feed_forward(2 * width, width, 1)
        self.register_buffer("node_mean", torch.zeros(NODE_NUMBERS))
        self.register_buffer("node_scale", torch.ones(NODE_NUMBERS))
        self.register_buffer("edge_scale", torch.ones(EDGE_NUMBERS))
        self.register_buffer("value_per_part", torch.zeros(()))
        self.register_buffer("value_scale", torch.ones(()))

    def forward(self, nodes: Tensor, edges: Tensor, present: Tensor) -> Tensor:
        """Q-values (B, N), m; without meaning where nothing is present.

        Args:
            nodes: (B, N, 24) m.
            edges: (B, N, N, 3) m.
            present: (B, N) bool, false where padded.
        """
        itself = torch.eye(nodes.shape[1], dtype=torch.bool)
        neighbours = (present.unsqueeze(1) & ~itself).unsqueeze(3)
        nodes, edges = (nodes - self.node_mean) / self.node_scale, edges / self.edge_scale
        for layer in self.layers:
            nodes, edges = layer(nodes, edges, neighbours)
        count = present.sum(dim=1, keepdim=True)
        mean = (nodes * present.unsqueeze(2)).sum(dim=1) / count.clamp(min=1)
        joined = torch.cat([mean.unsqueeze(1).expand_as(nodes), nodes], dim=2)
        values: Tensor = count * self.value_per_part + self.value_scale * self.value(joined).squeeze(2)
        return values
