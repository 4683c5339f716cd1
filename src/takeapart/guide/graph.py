"""A state as a fully connected, directed graph (Sec. V-C): what the network sees of a product.

A node is a part: the eight corners of its oriented bounding box, 24 numbers. An edge is the vector from the mid-point
of one part to that of another.

Where the corners are measured from: the lowest corner of the axis-aligned box around the whole assembly, fixed parts
included. So the graph does not change when product and cell are moved together, nor while parts leave; and a taller or
wider product of the same kind begins at the same numbers. The axes are those of the assembly's frame: which way is up
and where the front is matters for the robot. Corners are listed by x, then y, then z, whatever frame the part was drawn
in.

Nodes are the parts of the state, which are removable ones. The paper's states are subsets of all parts; those that
never leave (bottom and back columns of the paper's assemblies) would be the same nodes in every state of an assembly,
could not tell two of its states apart, and would double the number of edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from takeapart.model.assembly import Assembly
from takeapart.states import members

Numbers = NDArray[np.float32]
Indices = NDArray[np.int64]

NODE_NUMBERS, EDGE_NUMBERS = 24, 3
RESOLUTION = 1e-6  # m; corners that differ by less in one coordinate are listed by the next


@dataclass(frozen=True, eq=False)
class StateGraph:
    """A state of N parts.

    Args:
        nodes: (N, 24) x, y, z of the eight corners, m.
        edges: (N, N, 3) vector from the mid-point of part i to that of part j, m; zero where i = j, which is no edge.
        parts: (N,) numbers of the parts, ascending.
    """

    nodes: Numbers
    edges: Numbers
    parts: Indices


@dataclass(frozen=True, eq=False)
class GraphBatch:
    """B states, padded to the N parts of the largest.

    Args:
        nodes: (B, N, 24) m; zero where padded.
        edges: (B, N, N, 3) m; zero where padded.
        present: (B, N) what is a part and no padding.
        parts: (B, N) numbers of the parts; -1 where padded.
    """

    nodes: Numbers
    edges: Numbers
    present: NDArray[np.bool_]
    parts: Indices


@dataclass(frozen=True, eq=False)
class PartGeometry:
    """What the graphs of all states of an assembly are made of; P parts, fixed ones included.

    Args:
        corners: (P, 24) m.
        middles: (P, 3) m.
    """

    corners: Numbers
    middles: Numbers


def part_geometry(assembly: Assembly) -> PartGeometry:
    """Corners and mid-points of all parts, from the lowest corner of the whole assembly."""
    boxes = [part.shape.bounding_box().moved(part.T_world_part).corners() for part in assembly.parts]
    corners = np.array(boxes)  # (P, 8, 3) m, assembly's frame
    corners -= corners.reshape(-1, 3).min(axis=0)
    rounded = np.round(corners / RESOLUTION)
    order = np.lexsort((rounded[..., 2], rounded[..., 1], rounded[..., 0]), axis=-1)  # (P, 8), by x, y, z
    corners = np.take_along_axis(corners, order[..., None], axis=1)
    middles = corners.mean(axis=1)
    return PartGeometry(corners.reshape(-1, NODE_NUMBERS).astype(np.float32), middles.astype(np.float32))


def graph_of(geometry: PartGeometry, parts: Sequence[int] | NDArray[Any]) -> StateGraph:
    """The graph of some parts, in the order given."""
    numbers = np.asarray(parts, dtype=np.int64)
    middles = geometry.middles[numbers]
    return StateGraph(geometry.corners[numbers], middles[None, :, :] - middles[:, None, :], numbers)


def state_graph(assembly: Assembly, state: int) -> StateGraph:
    """The graph of a state of an assembly."""
    return graph_of(part_geometry(assembly), members(state))


def batched(graphs: Sequence[StateGraph]) -> GraphBatch:
    """Several graphs as one, padded."""
    count, largest = len(graphs), max((len(graph.parts) for graph in graphs), default=0)
    batch = GraphBatch(
        np.zeros((count, largest, NODE_NUMBERS), np.float32),
        np.zeros((count, largest, largest, EDGE_NUMBERS), np.float32),
        np.zeros((count, largest), np.bool_),
        np.full((count, largest), -1, np.int64),
    )
    for i, graph in enumerate(graphs):
        n = len(graph.parts)
        batch.nodes[i, :n], batch.edges[i, :n, :n] = graph.nodes, graph.edges
        batch.present[i, :n], batch.parts[i, :n] = True, graph.parts
    return batch
