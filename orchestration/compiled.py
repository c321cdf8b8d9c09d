"""The loop of the compiled master: one function that walks through tables of addresses (see `chunks`, which lays them out).

Numba compiles it once and keeps it on disk; it knows no FMU, only addresses of C functions that it calls as they are.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit as numba_njit
from numba import types
from numba.extending import intrinsic as numba_intrinsic

# Numba's decorators change signatures in ways that types cannot say
njit: Callable[..., Callable[[Callable[..., Any]], Any]] = numba_njit
intrinsic: Callable[[Callable[..., Any]], Any] = numba_intrinsic

TICK = 1_000_000_000  # as in `system`; Numba's cache does not notice constants of other modules

OPTIONS = {"error_model": "numpy", "_nrt": False}
"""Without counting references to the tables at every use: that took longer than the calls themselves."""
DONE, STOPPED, FAILED, VIOLATED = range(4)
"""Outcomes in the first place of the report."""
KINDS = ("float64", "int32", "int64")
"""Types of the buffers, by their number in the column KIND."""
# Columns of the table of components (parts) and of the table of blocks
INSTANCE, STEP, LIMIT, SETS, SETS_END, GETS, GETS_END, RATE, EVERY, COUNT, BEGAN, EACH = range(12)
KIND, FUNCTION, REFERENCES, N, BUFFER, FIRST, DIRECT = range(7)


def _pointer(builder: Any, value: Any, kind: Any) -> Any:
    return builder.inttoptr(value, ir.PointerType(kind))


@intrinsic
def _call_values(context: Any, function: Any, instance: Any, references: Any, count: Any, buffer: Any) -> Any:
    """`function(instance, references, count, buffer)`, all given as integers, like fmi2SetReal; returns its status."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        byte, size = ir.IntType(8), ir.IntType(64)
        kind = ir.FunctionType(ir.IntType(32), [ir.PointerType(byte), ir.PointerType(byte), size, ir.PointerType(byte)])
        f = _pointer(builder, args[0], kind)
        given = [_pointer(builder, args[1], byte), _pointer(builder, args[2], byte), args[3], _pointer(builder, args[4], byte)]
        return builder.call(f, given)

    return types.int32(types.int64, types.int64, types.int64, types.int64, types.int64), generate


@intrinsic
def _call_step(context: Any, function: Any, instance: Any, t: Any, h: Any) -> Any:
    """`function(instance, t, h, 0)`, like fmi2DoStep; returns its status."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        byte, whole, double = ir.IntType(8), ir.IntType(32), ir.DoubleType()
        f = _pointer(builder, args[0], ir.FunctionType(whole, [ir.PointerType(byte), double, double, whole]))
        return builder.call(f, [_pointer(builder, args[1], byte), args[2], args[3], ir.Constant(whole, 0)])

    return types.int32(types.int64, types.int64, types.float64, types.float64), generate


def _memory(kind: Any, number: Any) -> tuple[Any, Any]:
    """Intrinsics that load and store one number at an address."""

    @intrinsic
    def load(context: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return builder.load(_pointer(builder, args[0], number))

        return kind(types.int64), generate

    @intrinsic
    def store(context: Any, address: Any, value: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            builder.store(args[1], _pointer(builder, args[0], number))
            return context.get_dummy_value()

        return types.void(types.int64, kind), generate

    return load, store


_load_f64, _store_f64 = _memory(types.float64, ir.DoubleType())
_load_i32, _store_i32 = _memory(types.int32, ir.IntType(32))
_load_i64, _store_i64 = _memory(types.int64, ir.IntType(64))


@njit(inline="always", **OPTIONS)
def _set(blocks: Any, b: int, bus: Any, gather: Any, instance: int) -> Any:
    """Inputs of block `b` from the bus; returns the status."""
    n, buffer, first = blocks[b, N], blocks[b, BUFFER], blocks[b, FIRST]
    if blocks[b, DIRECT] == 0:
        if blocks[b, KIND] == 0:
            for i in range(n):
                _store_f64(buffer + 8 * i, bus[gather[first + i]])
        elif blocks[b, KIND] == 1:
            for i in range(n):
                _store_i32(buffer + 4 * i, np.int32(bus[gather[first + i]]))
        else:
            for i in range(n):
                _store_i64(buffer + 8 * i, np.int64(bus[gather[first + i]]))
    if blocks[b, FUNCTION] == 0:
        return 0
    return _call_values(blocks[b, FUNCTION], instance, blocks[b, REFERENCES], n, buffer)


@njit(inline="always", **OPTIONS)
def _get(blocks: Any, b: int, bus: Any, gather: Any, instance: int, limit: int) -> Any:
    """Outputs of block `b` to the bus; returns the status."""
    n, buffer, first = blocks[b, N], blocks[b, BUFFER], blocks[b, FIRST]
    status = 0
    if blocks[b, FUNCTION] != 0:
        status = _call_values(blocks[b, FUNCTION], instance, blocks[b, REFERENCES], n, buffer)
        if status < 0 or status > limit or blocks[b, DIRECT] == 1:
            return status
    if blocks[b, KIND] == 0:
        for i in range(n):
            bus[gather[first + i]] = _load_f64(buffer + 8 * i)
    elif blocks[b, KIND] == 1:
        for i in range(n):
            bus[gather[first + i]] = _load_i32(buffer + 4 * i)
    else:
        for i in range(n):
            bus[gather[first + i]] = _load_i64(buffer + 8 * i)
    return status


@njit(inline="always", **OPTIONS)
def _call_part(
    phase: int, c: int, ticks: Any, now: int, t: float, h: float, parts: Any, blocks: Any, gather: Any, bus: Any, report: Any
) -> bool:
    """One phase (0 inputs, 1 step, 2 outputs) of component `c`; False if a call failed, with `report` saying which."""
    instance, limit = parts[c, INSTANCE], parts[c, LIMIT]
    if phase == 1:
        each = parts[c, EACH]
        for i in range(parts[c, RATE]):
            begin = t if parts[c, BEGAN] + i * each == now else (parts[c, BEGAN] + i * each) / TICK
            status = _call_step(parts[c, STEP], instance, begin, h if each == ticks[1] else each / TICK)
            if status < 0 or status > limit:
                report[0], report[1], report[2], report[3], report[4] = FAILED, c, phase, i, status
                return False
        return True
    first = parts[c, SETS] if phase == 0 else parts[c, GETS]
    end = parts[c, SETS_END] if phase == 0 else parts[c, GETS_END]
    for b in range(first, end):
        status = _set(blocks, b, bus, gather, instance) if phase == 0 else _get(blocks, b, bus, gather, instance, limit)
        if status < 0 or status > limit:
            report[0], report[1], report[2], report[3], report[4] = FAILED, c, phase, b - first, status
            return False
    return True


@njit(cache=True, nogil=True, **OPTIONS)
def advance(
    steps: int, ticks: Any, jacobi: bool, delayed: bool, watched: int, parts: Any, blocks: Any, gather: Any, bus: Any,
    low: Any, high: Any, rows: Any, report: Any,
) -> int:  # fmt: skip
    """Make up to `steps` steps; returns how many were made and are in `rows` (t, outputs). The rest is told by `report`.

    `ticks`: [start, step, done so far]. `report`: [outcome, component, phase, block, status].
    """
    n = len(low)
    h = ticks[1] / TICK
    for k in range(steps):
        now = ticks[0] + (ticks[2] + k) * ticks[1]
        t = now / TICK
        if delayed:
            for i in range(n):
                bus[n + i] = bus[i]
        for c in range(len(parts)):
            if parts[c, COUNT] == 0:
                parts[c, BEGAN] = now
        # Gauss-Seidel: one sweep, all phases of a component after each other; Jacobi: a sweep of all components per phase
        for sweep in range(3 if jacobi else 1):
            for c in range(len(parts)):
                if parts[c, COUNT] == parts[c, EVERY] - 1:
                    for phase in range(sweep if jacobi else 0, sweep + 1 if jacobi else 3):
                        if not _call_part(phase, c, ticks, now, t, h, parts, blocks, gather, bus, report):
                            return k
        for c in range(len(parts)):
            parts[c, COUNT] = 0 if parts[c, COUNT] == parts[c, EVERY] - 1 else parts[c, COUNT] + 1
        good = True
        rows[k, 0] = (now + ticks[1]) / TICK
        for i in range(n):
            value = bus[i]
            good &= (value >= low[i]) & (value <= high[i])  # false for NaN
            rows[k, 1 + i] = value
        if not good:
            report[0] = VIOLATED
            return k
        if watched >= 0 and bus[watched] != 0.0:
            report[0] = STOPPED
            return k + 1
    report[0] = DONE
    return steps
