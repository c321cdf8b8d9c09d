"""How `init` and `step` read a table: one number at a time, at its address, and never outside of the table."""

from __future__ import annotations

from robomill.models.model.kernels import kernel, number_at


@kernel
def cell(address: int, rows: int, columns: int, row: int, column: int) -> float:
    """The number in a row and column, counted from zero, of the table of (rows, columns) numbers at an address.

    A record has the first two as `<table>_at` and `<table>_rows`. IndexError outside of the table.
    """
    if not (0 <= row < rows and 0 <= column < columns):
        raise IndexError("outside of the table")
    return number_at(address + 8 * (row * columns + column))


@kernel
def row_at(address: int, rows: int, columns: int, time: float, guess: int) -> int:
    """The last row whose number in column 0, which increases from row to row, is not above `time`; row 0 if there is none.

    Found by steps that double from row `guess` on, and bisection: the guess itself costs two looks, the row after it four, any
    other a logarithm of their distance. The result does not depend on the guess. `rows` is at least one.
    """
    low, high = 0, rows - 1  # the row wanted is in low..high
    near = min(max(guess, 0), high)
    if cell(address, rows, columns, near, 0) <= time:
        low = near
        step = 1
        while low + step <= high and cell(address, rows, columns, low + step, 0) <= time:
            low += step
            step += step
        high = min(high, low + step - 1)
    else:
        high = max(near - 1, 0)
    while low < high:
        middle = (low + high + 1) // 2
        if cell(address, rows, columns, middle, 0) <= time:
            low = middle
        else:
            high = middle - 1
    return low
