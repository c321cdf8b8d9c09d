"""The loop of the compiled master for iterated coupling: what `iteration` does, on tables of addresses (see `chunks`)."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import register_jitable

from robomill.orchestration.loop import acceleration, compiled, operations
from robomill.orchestration.loop.compiled import OPTIONS, begin, finish, intrinsic, load_i64, njit, operate, pointer
from robomill.orchestration.loop.operations import DONE, FAILED, LIMIT, STOPPED, STUCK, TICK, UNCONVERGED, UNSAVED, VIOLATED

# Columns of the table of stages: components that are stepped once, or a loop (then it has members and unknowns)
FIRST, END, MEMBERS, MEMBERS_END, UNKNOWNS, UNKNOWNS_END = range(6)
# Columns of the table of states, one row per member of a loop (see `native.Rollback`)
OWNER, SAVE, BACK, KEPT, SIZE, WORST_STATUS = range(6)
# Columns of the table of unknowns: position on the bus, number of the array
PLACE, ARRAY = range(2)
# Rows of the scratch, one column per unknown
X, G, SCALE, SIZES, LARGEST = range(5)

_raw_memcpy: Callable[..., Any] = cgutils.raw_memcpy
_compare: Callable[..., tuple[float, int]] = njit(**OPTIONS)(acceleration.compare)
for _part in acceleration.PARTS:
    register_jitable(**OPTIONS)(_part)
_improve: Callable[..., None] = njit(**OPTIONS)(acceleration.improve)


@intrinsic
def _call_state(context: Any, function: Any, owner: Any, state: Any) -> Any:
    """`function(owner, state)`, like fmi2GetFMUstate and fmi2SetFMUstate; returns its status."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        byte = ir.IntType(8)
        kind = ir.FunctionType(ir.IntType(32), [ir.PointerType(byte), ir.PointerType(byte)])
        return builder.call(pointer(builder, args[0], kind), [pointer(builder, args[1], byte), pointer(builder, args[2], byte)])

    return types.int32(types.int64, types.int64, types.int64), generate


@intrinsic
def _copy(context: Any, to: Any, source: Any, size: Any) -> Any:
    """`size` bytes from one address to another."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        byte = ir.IntType(8)
        _raw_memcpy(builder, pointer(builder, args[0], byte), pointer(builder, args[1], byte), args[2], 1)
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), generate


@njit(inline="always", **OPTIONS)
def _save(states: Any, m: int) -> int:
    """Keep the state of a member; returns the status."""
    if states[m, SAVE] != 0:
        return int(_call_state(states[m, SAVE], states[m, OWNER], states[m, KEPT]))
    _copy(states[m, KEPT], states[m, OWNER], states[m, SIZE])
    return 0


@njit(inline="always", **OPTIONS)
def _back(states: Any, m: int) -> int:
    """Go back to the state of a member that is kept; returns the status."""
    if states[m, BACK] != 0:
        kept = load_i64(states[m, KEPT]) if states[m, KEPT] != 0 else 0
        return int(_call_state(states[m, BACK], states[m, OWNER], kept))
    _copy(states[m, OWNER], states[m, KEPT], states[m, SIZE])
    return 0


@njit(inline="always", **OPTIONS)
def _save_all(first: int, end: int, states: Any, report: Any) -> bool:
    """Keep the states of the members from `first` to `end` of a loop; false if that failed, told by `report`."""
    for m in range(first, end):
        status = _save(states, m)
        if status < 0 or status > states[m, WORST_STATUS]:
            report[0], report[1], report[2] = UNSAVED, m, status
            return False
    return True


@njit(inline="always", **OPTIONS)
def _all_back(first: int, end: int, states: Any, report: Any) -> bool:
    """Go back to the states that are kept; false if that failed, told by `report`."""
    for m in range(first, end):
        status = _back(states, m)
        if status < 0 or status > states[m, WORST_STATUS]:
            report[0], report[1], report[2] = STUCK, m, status
            return False
    return True


@njit(inline="always", **OPTIONS)
def _take(count: int, base: int, unknowns: Any, bus: Any, to: Any) -> None:
    """The unknowns of a loop from the bus."""
    for i in range(count):
        to[i] = bus[unknowns[base + i, PLACE]]


@njit(inline="always", **OPTIONS)
def _put(count: int, base: int, unknowns: Any, bus: Any, source: Any) -> None:
    """The unknowns of a loop to the bus."""
    for i in range(count):
        bus[unknowns[base + i, PLACE]] = source[i]


@njit(inline="always", **OPTIONS)
def _round(
    first: int, end: int, ops: Any, rates: bool, clocks: Any, bus: Any, n: int, places: Any, called: Any, t: float, h: float, report: Any
) -> bool:  # fmt: skip
    """The operations from `first` to `end`; false if one failed, told by `report`."""
    for o in range(first, end):
        status = operate(ops, o, rates, clocks, bus, n, places, called, t, h)
        if status < 0 or status > ops[o, LIMIT]:
            report[0], report[1], report[2] = FAILED, o, status
            return False
    return True


@njit(inline="always", **OPTIONS)
def _settle(
    s: int, rates: bool, ops: Any, clocks: Any, places: Any, bus: Any, n: int, t: float, h: float, report: Any, called: Any,
    stages: Any, states: Any, unknowns: Any, method: int, most: int, accept: bool,
    tolerance: float, relaxation: float, scratch: Any, history: Any, factor: Any, found: Any,
) -> tuple[int, float]:  # fmt: skip
    """Make the step of a stage: once, or, if it is a loop, in rounds until its signals agree.

    Returns rounds and residual of a loop, (0, 0) of what is none, (-1, 0) if something failed: `report` and `found` tell it.
    """
    x, g, scale, sizes, largest = scratch[X], scratch[G], scratch[SCALE], scratch[SIZES], scratch[LARGEST]
    first, end = stages[s, MEMBERS], stages[s, MEMBERS_END]
    base, count = stages[s, UNKNOWNS], stages[s, UNKNOWNS_END] - stages[s, UNKNOWNS]
    looped = end > first
    if not _save_all(first, end, states, report):
        return -1, 0.0
    _take(count, base, unknowns, bus, x)
    for rounds in range(1, most + 1 if looped else 2):
        if not _round(stages[s, FIRST], stages[s, END], ops, rates, clocks, bus, n, places, called, t, h, report):
            return -1, 0.0
        if not looped:
            return 0, 0.0
        _take(count, base, unknowns, bus, g)
        residual, worst = _compare(count, x, g, unknowns[base:, ARRAY], largest, sizes)
        if worst < 0 or residual <= tolerance or rounds == most:
            if worst >= 0 and residual > tolerance and not accept:
                report[0], report[1], report[2] = UNCONVERGED, s, 0
                found[0], found[1] = residual, worst
                return -1, 0.0
            return rounds, residual
        if rounds == 1:
            for i in range(count):
                scale[i] = sizes[i]
        _improve(method, relaxation, rounds, count, x, g, scale, history, factor)
        if not _all_back(first, end, states, report):
            return -1, 0.0
        _put(count, base, unknowns, bus, x)
    return 0, 0.0


def _advance(
    steps: int, ticks: Any, rates: bool, watched: int, ops: Any, clocks: Any, places: Any, bus: Any, low: Any, high: Any,
    columns: Any, report: Any, called: Any, stages: Any, states: Any, unknowns: Any, method: int, most: int, accept: bool,
    tolerance: float, relaxation: float, scratch: Any, history: Any, factor: Any, found: Any,
) -> int:  # fmt: skip
    """As `compiled.advance`. `most` is max_iterations; `history` and `factor` belong to a `Work`.

    Outcomes UNSAVED and STUCK name a member whose state could not be kept, or put back, in the place of the operation;
    UNCONVERGED a stage, and `found` is [residual, unknown] then.
    """
    n, h = len(low), ticks[1] / TICK
    for k in range(steps):
        now = ticks[0] + (ticks[2] + k) * ticks[1]
        t = now / TICK
        for i in range(n):
            bus[n + i] = bus[i]
        begin(rates, clocks, now)
        all_rounds, all_residual = 0, 0.0
        for s in range(len(stages)):
            rounds, residual = _settle(
                s, rates, ops, clocks, places, bus, n, t, h, report, called, stages, states, unknowns, method, most, accept,
                tolerance, relaxation, scratch, history, factor, found,
            )  # fmt: skip
            if rounds < 0:
                return k
            all_rounds, all_residual = max(all_rounds, rounds), max(all_residual, residual)
        bus[n - 2], bus[n - 1] = all_rounds, all_residual
        if not finish(rates, clocks, now + ticks[1], k, bus, low, high, columns):
            report[0] = VIOLATED
            return k
        if watched >= 0 and bus[watched] != 0.0:
            report[0] = STOPPED
            return k + 1
    report[0] = DONE
    return steps


# Numba looks whether this file has changed, but not those that it takes functions from: they are in the name of what it keeps
_SOURCES = b"".join(Path(str(module.__file__)).read_bytes() for module in (acceleration, compiled, operations))
_advance.__qualname__ = f"advance_{zlib.crc32(_SOURCES):08x}"
advance: Callable[..., int] = njit(cache=True, nogil=True, **OPTIONS)(_advance)
