"""The tables of compiled loops: what stands in which column, and what their outcomes are called."""

from __future__ import annotations

TICK = 1_000_000_000
"""As in `system`: what compiled code is made from is here and in the files of the loops."""
DONE, STOPPED, FAILED, VIOLATED, UNSAVED, STUCK, UNCONVERGED = range(7)
"""Outcomes in the first place of the report."""
STEP, CALL, SET, GET = 0, 1, 2, 5
"""Operations: a step; a set or get that reads or writes the bus itself; sets and gets by way of a buffer (plus the number of its kind)."""
MEAN = 1 << 40
"""Added to the place of an input that holds the mean of the values at both ends of the step."""
UNFIT = -(1 << 40)
"""Instead of a status: an input is a whole number that the type of its buffer cannot hold."""
INT32, EXACT = (1 << 31) - 1, (1 << 53) - 1  # largest of the type; of those that float64 tells from all others (`slave.EXACT`)
KINDS = ("float64", "int32", "int64")
"""Types of the buffers."""
# Columns of the table of operations, in the order in which a step makes them; N of a step is its last argument (`native.Native.final`)
OPERATION, FUNCTION, INSTANCE, REFERENCES, N, BUFFER, FIRST, LIMIT, COMPONENT = range(9)
# Columns of the table of clocks, one row per component; times in ticks
RATE, EVERY, EACH, COUNT, BEGAN = range(5)
