"""Obstacles as flat arrays with a grid over them, for the collision kernels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from takeapart.model.geometry import OrientedBox
from takeapart.robot.arrays import Flags, WorldArrays
from takeapart.robot.grid import clearance_fields, grid_fill

CELL = 0.03  # m
ROW_RADII = (0.02, 0.04, 0.06, 0.09, 0.14, 0.25)  # m
MAXIMUM_CELLS = 4_000_000


def build_world(boxes: Sequence[tuple[OrientedBox, int]], largest: float = 0.25) -> WorldArrays:
    """Arrays and grid of boxes that stand still.

    Args:
        boxes: in the world frame, each with its owner: a part number, or the number of parts for what never leaves.
        largest: radius of the largest ball that will be checked, padding included, m.
    """
    rows = np.array([radius for radius in ROW_RADII if radius < largest] + [largest])
    center = np.array([box.T_frame_box[:3, 3] for box, _ in boxes])
    axes = np.ascontiguousarray([box.T_frame_box[:3, :3].T for box, _ in boxes])
    half = np.array([box.half_extents for box, _ in boxes])
    owner = np.array([number for _, number in boxes], dtype=np.int32)

    extent = np.einsum("wai,wa->wi", np.abs(axes), half)
    margin = largest
    origin = (center - extent).min(axis=0) - margin
    size = (center + extent).max(axis=0) + margin - origin
    cell = max(CELL, float((size.prod() / MAXIMUM_CELLS) ** (1 / 3)))
    shape = np.ceil(size / cell).astype(np.int32)
    cells = int(shape.prod())

    start = np.zeros((len(rows), cells + 1), dtype=np.int32)
    entries: list[np.ndarray] = []
    total = 0
    for row, radius in enumerate(rows):
        reach = radius + cell * np.sqrt(3) / 2
        counts = np.zeros(cells + 1, dtype=np.int32)
        nothing = np.zeros(0, dtype=np.int32)
        found = grid_fill(center, axes, half, origin, cell, shape, reach, counts, nothing, True)
        first = np.cumsum(counts, dtype=np.int32)
        entry = np.zeros(found, dtype=np.int32)
        grid_fill(center, axes, half, origin, cell, shape, reach, first[:-1].copy(), entry, False)
        start[row] = first + total
        entries.append(entry)
        total += found
    field = np.zeros(cells, dtype=np.uint8)  # claims nothing until `with_field`
    entry = np.concatenate(entries)
    return WorldArrays(center, axes, half, owner, origin, cell, 1.0 / cell, shape, rows, start, entry, field)


def owner_fields(world: WorldArrays, owners: int) -> Flags:
    """Clearance of every grid cell from every owner (owners, cells), in units of FIELD_STEP."""
    fields = np.empty((owners, len(world.field)), dtype=np.uint8)
    reach = float(world.row_radius[-1])
    clearance_fields(
        world.center, world.axes, world.half, world.owner, world.origin, world.cell, world.shape, reach, fields
    )
    return fields


def with_field(world: WorldArrays, fields: Flags, present: Flags) -> WorldArrays:
    """The world for a state: its clearance field counts the owners present (owners,), no others."""
    return world._replace(field=fields[present.astype(bool)].min(axis=0))
