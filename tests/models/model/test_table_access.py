"""robomill.models.model.table_access: numbers and rows of a table beside the record."""

from __future__ import annotations

import math

import numpy as np
import pytest

from robomill.models.model import table_access as cell
from robomill.models.model.compiled import compiled_on_call

ROWS, COLUMNS = 1000, 3
TABLE = np.ascontiguousarray(
    np.column_stack([np.cumsum(np.random.default_rng(4).uniform(0.1, 1.0, ROWS)), np.zeros(ROWS), np.arange(ROWS)])
)
AT = TABLE.ctypes.data


@compiled_on_call
def compiled_row(address: int, rows: int, columns: int, time: float, guess: int) -> int:
    return cell.row_at(address, rows, columns, time, guess)


@compiled_on_call
def compiled_cell(address: int, rows: int, columns: int, row: int, column: int) -> float:
    return cell.cell(address, rows, columns, row, column)


def expected(time: float) -> int:
    return max(int(np.searchsorted(TABLE[:, 0], time, side="right")) - 1, 0)


@pytest.mark.parametrize("read", [cell.cell, compiled_cell], ids=["plain", "compiled"])
def test_only_what_is_in_the_table_is_read(read: object) -> None:
    assert read(AT, ROWS, COLUMNS, 999, 2) == 999.0  # type: ignore[operator]  # one of two functions
    for row, column in ((-1, 0), (ROWS, 0), (0, -1), (0, COLUMNS), (2**61, 0)):
        with pytest.raises(IndexError, match="outside of the table"):
            read(AT, ROWS, COLUMNS, row, column)  # type: ignore[operator]  # as above
    with pytest.raises(IndexError):
        read(0, 0, COLUMNS, 0, 0)  # type: ignore[operator]  # as above


def test_the_row_of_a_time_does_not_depend_on_where_the_search_begins() -> None:
    """At, just before and between the times of rows, outside of the table; from guesses inside and outside."""
    rng = np.random.default_rng(5)
    times = [
        0.0,
        TABLE[0, 0],
        TABLE[-1, 0],
        TABLE[-1, 0] + 1.0,
        TABLE[500, 0],
        float(np.nextafter(TABLE[500, 0], 0.0)),
        *rng.uniform(0, 600, 60),
    ]
    for time in times:
        for guess in (0, 1, 499, 500, 501, ROWS - 1, ROWS, -5, 2**40, *rng.integers(0, ROWS, 5)):
            assert cell.row_at(AT, ROWS, COLUMNS, float(time), int(guess)) == expected(float(time))
            assert compiled_row(AT, ROWS, COLUMNS, float(time), int(guess)) == expected(float(time))
    assert cell.row_at(AT, 1, COLUMNS, 1e9, 0) == 0


def test_the_next_row_costs_four_looks_and_any_other_a_logarithm(monkeypatch: pytest.MonkeyPatch) -> None:
    looks = []
    read = cell.cell

    def counted(*arguments: int) -> float:
        looks.append(arguments)
        return read(*arguments)

    monkeypatch.setattr(cell, "cell", counted)

    def cost(row: int, guess: int) -> int:
        looks.clear()
        cell.row_at(AT, ROWS, COLUMNS, float(TABLE[row, 0]), guess)
        return len(looks)

    assert cost(500, 500) == 2
    assert cost(501, 500) <= 4
    assert max(cost(row, guess) for row in range(0, ROWS, 37) for guess in (0, 500, ROWS - 1)) <= 2 * math.ceil(math.log2(ROWS)) + 2
