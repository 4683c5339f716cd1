"""State graph and network: against torch-geometric, without torch, and under renumbering and padding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from graph_oracle import oracle_values
from small_assemblies import three_bars
from takeapart.formats.files import data_path, load_assembly
from takeapart.guide.architecture import Architecture
from takeapart.guide.forward import ForwardPass
from takeapart.guide.graph import batched, part_geometry, state_graph
from takeapart.guide.network import QNetwork
from takeapart.model.assembly import Assembly, members
from takeapart.model.geometry import Box, pose


@pytest.fixture(scope="module")
def profiles() -> Assembly:
    return load_assembly(data_path("single/01.json"))


def drawn_network(layers: int = 3, width: int = 16, seed: int = 0, dtype: torch.dtype = torch.float32) -> QNetwork:
    """A network whose arrays are all drawn, also those that training would begin with ones and zeros."""
    generator = torch.Generator().manual_seed(seed)
    network = QNetwork(Architecture(layers, width)).to(dtype)
    with torch.no_grad():
        for name, array in network.state_dict().items():
            spread = torch.randn(array.shape, generator=generator, dtype=dtype)
            if name.endswith(("scale", "temperature")):
                array.copy_(0.5 + spread.abs())
            else:
                array.copy_(2.0 * spread / max(1, array.shape[-1] if array.ndim else 1) ** 0.5)
    return network


def values_of(network: QNetwork, assembly: Assembly, states: list[int]) -> list[dict[int, float]]:
    """Per state, Q-value of every part, m."""
    batch = batched([state_graph(assembly, state) for state in states])
    arrays = (torch.from_numpy(batch.nodes), torch.from_numpy(batch.edges), torch.from_numpy(batch.present))
    with torch.no_grad():
        values = network(*arrays).numpy()
    return [
        {int(part): float(value) for part, value in zip(parts, row, strict=True) if part >= 0}
        for parts, row in zip(batch.parts, values, strict=True)
    ]


def some_states(assembly: Assembly) -> list[int]:
    rng = np.random.default_rng(4)
    parts = members(assembly.root)
    drawn = [sum(1 << part for part in parts if rng.random() < share) for share in (0.2, 0.5, 0.8)]
    return [assembly.root, 1 << parts[0], 1 << parts[0] | 1 << parts[3], *drawn]


def test_graph_of_a_state() -> None:
    assembly = three_bars()
    parts = members(assembly.root)
    state = assembly.root & ~(1 << parts[1])
    graph = state_graph(assembly, state)
    assert graph.parts.tolist() == [parts[0], parts[2]]
    everything = np.concatenate(
        [part.shape.bounding_box().moved(part.T_world_part).corners() for part in assembly.parts]
    )
    origin = everything.min(axis=0)
    for i, part in enumerate(graph.parts):
        box = assembly.parts[part].shape.bounding_box().moved(assembly.parts[part].T_world_part)
        expected = sorted((np.round(box.corners() - origin, 6)).tolist())
        assert graph.nodes[i].reshape(8, 3) == pytest.approx(np.array(expected), abs=1e-6)
        for j, other in enumerate(graph.parts):
            way = assembly.parts[other].T_world_part[:3, 3] - assembly.parts[part].T_world_part[:3, 3]
            assert graph.edges[i, j] == pytest.approx(way, abs=1e-6)


def test_graph_does_not_depend_on_where_the_product_stands_or_how_parts_were_drawn() -> None:
    assembly = three_bars()
    T = pose([1.3, -0.7, 0.4])
    moved = Assembly("moved", tuple(replace(part, T_world_part=T @ part.T_world_part) for part in assembly.parts))
    quarter = pose([0, 0, 0], [0.5**0.5, 0, 0, 0.5**0.5])  # about z: x and y edges of the box change places
    turned = []
    for part in assembly.parts:
        assert isinstance(part.shape, Box)
        x, y, z = part.shape.size
        turned.append(replace(part, shape=Box((y, x, z)), T_world_part=part.T_world_part @ quarter))
    reference = state_graph(assembly, assembly.root)
    for other in (moved, Assembly("turned", tuple(turned))):
        graph = state_graph(other, other.root)
        assert graph.nodes == pytest.approx(reference.nodes, abs=1e-6)
        assert graph.edges == pytest.approx(reference.edges, abs=1e-6)


def test_network_agrees_with_torch_geometric(profiles: Assembly) -> None:
    network = drawn_network(dtype=torch.float64)
    for state in some_states(profiles):
        graph = state_graph(profiles, state)
        nodes, edges = torch.from_numpy(graph.nodes).double(), torch.from_numpy(graph.edges).double()
        with torch.no_grad():
            expected = oracle_values(network, nodes, edges)
            found = network(nodes[None], edges[None], torch.ones(1, len(nodes), dtype=torch.bool))[0]
        assert found.numpy() == pytest.approx(expected.numpy(), abs=1e-9)
        assert len(nodes) == 1 or float(expected.std()) > 0.05  # the parts are told apart


def test_in_single_precision_too(profiles: Assembly) -> None:
    network = drawn_network()
    graph = state_graph(profiles, profiles.root)
    with torch.no_grad():
        expected = oracle_values(network, torch.from_numpy(graph.nodes), torch.from_numpy(graph.edges)).numpy()
    (found,) = values_of(network, profiles, [profiles.root])
    scale = float(np.abs(expected).max())
    assert np.array(list(found.values())) / scale == pytest.approx(expected / scale, abs=1e-5)


def test_padding_changes_nothing(profiles: Assembly) -> None:
    network = drawn_network()
    states = some_states(profiles)
    together = values_of(network, profiles, states)
    for state, values in zip(states, together, strict=True):
        (alone,) = values_of(network, profiles, [state])
        assert values == pytest.approx(alone, rel=1e-4, abs=1e-4)


def test_values_do_not_depend_on_the_numbers_of_parts(profiles: Assembly) -> None:
    network = drawn_network()
    order = np.random.default_rng(2).permutation(len(profiles.parts))
    renumbered = Assembly("renumbered", tuple(profiles.parts[k] for k in order))
    (before,) = values_of(network, profiles, [profiles.root])
    (after,) = values_of(network, renumbered, [renumbered.root])
    names_before = {profiles.parts[part].name: value for part, value in before.items()}
    names_after = {renumbered.parts[part].name: value for part, value in after.items()}
    assert names_after == pytest.approx(names_before, rel=1e-4, abs=1e-4)
    assert max(before.values()) - min(before.values()) > 0.1


@pytest.mark.parametrize(("layers", "width"), [(1, 4), (3, 16), (4, 32)])
def test_forward_pass_without_torch_is_the_same(profiles: Assembly, layers: int, width: int) -> None:
    network = drawn_network(layers, width)
    arrays = {name: array.numpy() for name, array in network.state_dict().items()}
    assert {name: array.shape for name, array in arrays.items()} == network.architecture.shapes()
    forward = ForwardPass(network.architecture, arrays, part_geometry(profiles))
    for state in some_states(profiles):
        (expected,) = values_of(network, profiles, [state])
        found = forward(np.array(members(state)))
        assert found.dtype == np.float32
        assert found == pytest.approx(list(expected.values()), rel=1e-4, abs=1e-4)
