"""The stock of tri-dexels: its box, and the cells that fill it.

The record is that of the component `tridexel_milling_force`, whose states these kernels fill.
"""

from __future__ import annotations

import math

from robomill.models.model.declaration import Record, kernel
from robomill.models.model.table_access import cell
from robomill.models.process import dexels, tridexels


@kernel
def box(s: Record) -> None:
    """Lower corner and size of the box of the stock, in P."""
    if s.stock_rows == 0:
        for i in range(3):
            s.extent[i] = s.block_size[i] + (2.0 * s.engagement_error if i < 2 else s.stock_error)
            s.origin[i] = -0.5 * s.extent[i] if i < 2 else -s.block_size[2]
        return
    for i in range(3):
        low = high = cell(s.stock_at, s.stock_rows, tridexels.COLUMNS, 0, i)
        for row in range(s.stock_rows):
            for corner in range(3):
                x = cell(s.stock_at, s.stock_rows, tridexels.COLUMNS, row, 3 * corner + i)
                low = min(low, x)
                high = max(high, x)
        s.origin[i] = low + (s.stock_error if i == 2 else 0.0)
        s.extent[i] = high - low


@kernel
def lay_out(s: Record, spacing: float) -> bool:
    """Number and size of the cells for a spacing [m]; False if their lines have no room."""
    most = 4.0 * tridexels.CAPACITY
    for i in range(3):
        # compare as reals first: the count itself may not fit an integer
        if s.extent[i] / spacing * (s.extent[(i + 1) % 3] / spacing) * s.segments > most:
            return False
    for i in range(3):
        s.cells[i] = dexels.cells(s.extent[i], spacing)
        s.pitch[i] = s.extent[i] / s.cells[i]
    fits: bool = tridexels.word_of(tridexels.lines(s.cells), s.segments) <= tridexels.CAPACITY
    return fits


@kernel
def finest(s: Record) -> float:
    """Finest spacing [m], a whole number of micrometres, with which the lines have room."""
    area = s.extent[0] * s.extent[1] + s.extent[1] * s.extent[2] + s.extent[2] * s.extent[0]
    spacing = math.floor(1e6 * math.sqrt(area * s.segments / tridexels.CAPACITY)) * 1e-6
    while spacing <= 0.0 or not lay_out(s, spacing):
        spacing += 1e-6
    return spacing
