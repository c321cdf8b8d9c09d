"""The tools of a program: one row per tool, as milling_force and the evaluation of a run read them."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from robomill.models.model.declaration import FloatArray, kernel
from robomill.models.model.table_access import cell
from robomill.models.process.cutting import MAX_TEETH, EndMill

COLUMNS = ("number", "diameter", "teeth", "helix", "cutting_length")
"""T number of the program (1 or more), diameter [m], number of teeth, helix angle [rad], length of the cutting edges [m]."""
NUMBER, DIAMETER, TEETH, HELIX, CUTTING_LENGTH = range(len(COLUMNS))
SHOWN = 64
"""Numbers that an error message lists."""
LARGEST_NUMBER = 99999999.0
"""Eight digits, the longest T word in use."""
MAX_HELIX = 1.2
"""Largest helix angle [rad]."""


def rows(tools: Mapping[int, EndMill]) -> FloatArray:
    """The table (n, 5) of tools by number, in ascending order."""
    return np.array([[n, m.diameter, m.teeth, m.helix, m.cutting_length] for n, m in sorted(tools.items())]).reshape(-1, len(COLUMNS))


def tools(table: FloatArray) -> dict[int, EndMill]:
    """The tools of a table (n, 5) by number: the inverse of `rows`."""
    return {int(row[NUMBER]): EndMill(*map(float, row[DIAMETER:])) for row in table}


@kernel
def number(address: int, rows: int, row: int, column: int) -> float:
    """A number of the table of so many rows at an address (`models.model.table_access`)."""
    return cell(address, rows, len(COLUMNS), row, column)


@kernel
def sound(address: int, rows: int, row: int) -> bool:
    """Whether row `row` is a tool: whole number of 1 or more that no earlier row has, dimensions within bounds."""
    name = number(address, rows, row, NUMBER)
    if not (name >= 1.0 and name <= LARGEST_NUMBER and name == math.floor(name)):
        return False
    for i in range(row):
        if number(address, rows, i, NUMBER) == name:
            return False
    teeth = number(address, rows, row, TEETH)
    if not (teeth >= 1.0 and teeth <= MAX_TEETH and teeth == math.floor(teeth)):
        return False
    sizes = number(address, rows, row, DIAMETER) > 0.0 and number(address, rows, row, CUTTING_LENGTH) > 0.0
    helix = number(address, rows, row, HELIX)
    return sizes and helix >= 0.0 and helix <= MAX_HELIX


@kernel
def find(address: int, rows: int, name: int) -> int:
    """Row of the tool of that number; -1 if there is none."""
    for row in range(rows):
        if int(number(address, rows, row, NUMBER)) == name:
            return row
    return -1
