"""Several assemblies around one robot."""

from __future__ import annotations

import numpy as np
import pytest

from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.generate.cells import cells_around
from takeapart.model.assembly import Assembly
from takeapart.model.errors import InputError
from takeapart.stability import ConnectorStability, unsupported


@pytest.fixture(scope="module")
def product() -> Assembly:
    return load_assembly(data_path("single/01.json"))


def test_each_cell_stands_before_the_robot_as_the_first_does(product: Assembly) -> None:
    T = load_workcell("panda-cells").T_world_base
    four = cells_around([product] * 4, T, "four")
    count = len(product.parts)
    turns = []
    for k in range(4):
        parts = four.parts[k * count : (k + 1) * count]
        to_base = [np.linalg.inv(T) @ part.T_world_part for part in parts]
        first = [np.linalg.inv(T) @ part.T_world_part for part in product.parts]
        turn = to_base[0] @ np.linalg.inv(first[0])
        for mine, original in zip(to_base, first, strict=True):
            np.testing.assert_allclose(mine, turn @ original, atol=1e-12)
        np.testing.assert_allclose(turn[2], [0, 0, 1, 0], atol=1e-12)
        np.testing.assert_allclose(turn[:3, 3], 0, atol=1e-12)
        turns.append(round(np.degrees(np.arctan2(turn[1, 0], turn[0, 0]))) % 360)
    assert turns == [0, 90, 270, 180]


def test_gravity_knows_each_cell_alone(product: Assembly) -> None:
    two = cells_around([product, product], load_workcell("panda-cells").T_world_base, "two")
    one, both = ConnectorStability(product), ConnectorStability(two)
    shift = len(product.parts)
    assert two.root == product.root | product.root << shift
    assert both.free(two.root) == one.free(product.root) | one.free(product.root) << shift
    assert not unsupported(two)
    assert two.witness == tuple(f"{k}-{name}" for k in range(2) for name in product.witness)


@pytest.mark.parametrize("count", [0, 5])
def test_no_more_cells_than_there_are_sides(product: Assembly, count: int) -> None:
    with pytest.raises(InputError, match=f"{count} cells; must be from 1 to 4"):
        cells_around([product] * count, np.eye(4), "too many")


def test_cells_that_overlap_are_refused(product: Assembly) -> None:
    base = np.eye(4)
    base[:2, 3] = 0.2  # in the middle of the assembly
    with pytest.raises(InputError):
        cells_around([product, product], base, "overlap")
