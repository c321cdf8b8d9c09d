"""The table of tools: written, read, looked up, refused."""

from __future__ import annotations

import numpy as np
import pytest

from robomill.models.process import tool_table
from robomill.models.process.cutting import EndMill

TOOLS = {7: EndMill(0.006, 2.0, 0.7, 0.020), 1: EndMill(0.016, 3.0, 0.5, 0.032)}
TABLE = tool_table.rows(TOOLS)


def test_rows_are_in_order_of_number_and_read_back() -> None:
    assert TABLE.tolist() == [[1, 0.016, 3, 0.5, 0.032], [7, 0.006, 2, 0.7, 0.020]]
    assert tool_table.tools(TABLE) == TOOLS
    assert tool_table.rows({}).shape == (0, 5)
    assert tool_table.tools(tool_table.rows({})) == {}


def test_a_tool_is_found_by_its_number_among_the_rows_in_use() -> None:
    assert [tool_table.find(TABLE.ctypes.data, 2, n) for n in (1, 7, 2, 0)] == [0, 1, -1, -1]
    assert tool_table.find(TABLE.ctypes.data, 1, 7) == -1


@pytest.mark.parametrize(
    ("column", "bad"),
    [
        (tool_table.NUMBER, (0.0, -1.0, 1.5, 1e9, 7.0)),
        (tool_table.DIAMETER, (0.0, -0.016)),
        (tool_table.TEETH, (0.0, 13.0, 2.5)),
        (tool_table.HELIX, (-0.1, 1.3)),
        (tool_table.CUTTING_LENGTH, (0.0, -0.1)),
    ],
)
def test_what_is_no_tool(column: int, bad: tuple[float, ...]) -> None:
    rows = np.array([TABLE[1], TABLE[0]])
    assert tool_table.sound(rows.ctypes.data, 2, 0)
    assert tool_table.sound(rows.ctypes.data, 2, 1)
    for value in bad:
        rows[1, column] = value
        assert not tool_table.sound(rows.ctypes.data, 2, 1)
