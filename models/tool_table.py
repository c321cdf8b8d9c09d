"""The tools of a program: one row per tool, as milling_force and the evaluation of a run read them."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from models.cutting import MAX_TEETH, EndMill
from models.declaration import FloatArray, kernel

COLUMNS = ("number", "diameter", "teeth", "helix", "cutting_length")
"""T number of the program (1 or more), diameter [m], number of teeth, helix angle [rad], length of the cutting edges [m]."""
NUMBER, DIAMETER, TEETH, HELIX, CUTTING_LENGTH = range(len(COLUMNS))
CAPACITY = 64
"""Tools that a table holds."""
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
def sound(table: FloatArray, row: int) -> bool:
    """Whether row `row` is a tool: whole number of 1 or more that no earlier row has, dimensions within bounds."""
    number = table[row, NUMBER]
    if not (number >= 1.0 and number <= LARGEST_NUMBER and number == math.floor(number)):
        return False
    for i in range(row):
        if table[i, NUMBER] == number:
            return False
    teeth = table[row, TEETH]
    if not (teeth >= 1.0 and teeth <= MAX_TEETH and teeth == math.floor(teeth)):
        return False
    sizes: bool = table[row, DIAMETER] > 0.0 and table[row, CUTTING_LENGTH] > 0.0
    return sizes and table[row, HELIX] >= 0.0 and table[row, HELIX] <= MAX_HELIX


@kernel
def find(table: FloatArray, count: int, number: int) -> int:
    """Row of the tool of that number among the first `count`; -1 if there is none."""
    for row in range(count):
        if int(table[row, NUMBER]) == number:
            return row
    return -1
