"""The loop of the compiled master: one function that walks through tables of addresses (see `chunks`, which lays them out).

Numba compiles it once, and `loop_code` keeps it on disk; it knows no FMU, only addresses of C functions that it calls as they are.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit as numba_njit
from numba import types
from numba.extending import intrinsic as numba_intrinsic

from robomill.orchestration.loop.operations import (
    BEGAN,
    BUFFER,
    CALL,
    COMPONENT,
    COUNT,
    DONE,
    EACH,
    EVERY,
    EXACT,
    FAILED,
    FIRST,
    FUNCTION,
    GET,
    INSTANCE,
    INT32,
    LIMIT,
    MEAN,
    OPERATION,
    RATE,
    REFERENCES,
    SET,
    STEP,
    STOPPED,
    TICK,
    UNFIT,
    VIOLATED,
    N,
)

# Numba's decorators change signatures in ways that types cannot say
njit: Callable[..., Callable[[Callable[..., Any]], Any]] = numba_njit
intrinsic: Callable[[Callable[..., Any]], Any] = numba_intrinsic

OPTIONS = {"error_model": "numpy", "_nrt": False}
"""Without counting references to the tables at every use: that took longer than the calls themselves."""


def pointer(builder: Any, value: Any, kind: Any) -> Any:
    """A whole number as a pointer to something of this kind, in LLVM."""
    return builder.inttoptr(value, ir.PointerType(kind))


@intrinsic
def _call_values(context: Any, function: Any, instance: Any, references: Any, count: Any, buffer: Any) -> Any:
    """`function(instance, references, count, buffer)`, all given as integers, like fmi2SetReal; returns its status."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        byte, size = ir.IntType(8), ir.IntType(64)
        kind = ir.FunctionType(ir.IntType(32), [ir.PointerType(byte), ir.PointerType(byte), size, ir.PointerType(byte)])
        f = pointer(builder, args[0], kind)
        given = [pointer(builder, args[1], byte), pointer(builder, args[2], byte), args[3], pointer(builder, args[4], byte)]
        return builder.call(f, given)

    return types.int32(types.int64, types.int64, types.int64, types.int64, types.int64), generate


@intrinsic
def _call_step(context: Any, function: Any, instance: Any, t: Any, h: Any, final: Any) -> Any:
    """`function(instance, t, h, final)`, like fmi2DoStep; returns its status."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        byte, whole, double = ir.IntType(8), ir.IntType(32), ir.DoubleType()
        f = pointer(builder, args[0], ir.FunctionType(whole, [ir.PointerType(byte), double, double, whole]))
        return builder.call(f, [pointer(builder, args[1], byte), args[2], args[3], builder.trunc(args[4], whole)])

    return types.int32(types.int64, types.int64, types.float64, types.float64, types.int64), generate


def _memory(kind: Any, number: Any) -> tuple[Any, Any]:
    """Intrinsics that load and store one number at an address."""

    @intrinsic
    def load(context: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return builder.load(pointer(builder, args[0], number))

        return kind(types.int64), generate

    @intrinsic
    def store(context: Any, address: Any, value: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            builder.store(args[1], pointer(builder, args[0], number))
            return context.get_dummy_value()

        return types.void(types.int64, kind), generate

    return load, store


_load_f64, _store_f64 = _memory(types.float64, ir.DoubleType())
_load_i32, _store_i32 = _memory(types.int32, ir.IntType(32))
load_i64, _store_i64 = _memory(types.int64, ir.IntType(64))


@njit(inline="always", **OPTIONS)
def _load(ops: Any, o: int, bus: Any, places: Any, n_outputs: int) -> bool:
    """Bus to the buffer of an operation; whether it can hold the values. Behind the outputs on the bus stand those of the last step."""
    n, buffer, first, kind = ops[o, N], ops[o, BUFFER], ops[o, FIRST], ops[o, OPERATION] - SET
    if kind == 0:
        for i in range(n):
            place = places[first + i]
            if place < MEAN:
                _store_f64(buffer + 8 * i, bus[place])
            else:
                place -= MEAN
                _store_f64(buffer + 8 * i, 0.5 * (bus[place] + bus[n_outputs + place]))
    elif kind == 1:
        for i in range(n):
            value = bus[places[first + i]]
            if not -INT32 - 1 <= value <= INT32:
                return False
            _store_i32(buffer + 4 * i, np.int32(value))
    else:
        for i in range(n):
            value = bus[places[first + i]]
            if not -EXACT <= value <= EXACT:
                return False
            _store_i64(buffer + 8 * i, np.int64(value))
    return True


@njit(inline="always", **OPTIONS)
def _unload(ops: Any, o: int, bus: Any, places: Any) -> None:
    """Buffer of an operation to the bus."""
    n, buffer, first, kind = ops[o, N], ops[o, BUFFER], ops[o, FIRST], ops[o, OPERATION] - GET
    if kind == 0:
        for i in range(n):
            bus[places[first + i]] = _load_f64(buffer + 8 * i)
    elif kind == 1:
        for i in range(n):
            bus[places[first + i]] = _load_i32(buffer + 4 * i)
    else:
        for i in range(n):
            bus[places[first + i]] = load_i64(buffer + 8 * i)


@njit(**OPTIONS)
def _small_steps(ops: Any, o: int, clocks: Any) -> int:
    """The steps of a component at another rate; returns the status of the last one made."""
    c = ops[o, COMPONENT]
    each, status = clocks[c, EACH], 0
    for i in range(clocks[c, RATE]):
        status = _call_step(ops[o, FUNCTION], ops[o, INSTANCE], (clocks[c, BEGAN] + i * each) / TICK, each / TICK, ops[o, N])
        if status < 0 or status > ops[o, LIMIT]:
            break
    return status


@njit(**OPTIONS)
def _converted(ops: Any, o: int, bus: Any, n_outputs: int, places: Any) -> int:
    """A set or get by way of a buffer; returns its status. Not inlined: the quicker operations are, and need the registers."""
    what, function, status = ops[o, OPERATION], ops[o, FUNCTION], 0
    if what < GET and not _load(ops, o, bus, places, n_outputs):
        return UNFIT
    if function != 0:
        status = _call_values(function, ops[o, INSTANCE], ops[o, REFERENCES], ops[o, N], ops[o, BUFFER])
    if what >= GET and 0 <= status <= ops[o, LIMIT]:
        _unload(ops, o, bus, places)
    return status


@njit(inline="always", **OPTIONS)
def operate(
    ops: Any, o: int, rates: bool, clocks: Any, bus: Any, n_outputs: int, places: Any, called: Any, t: float, h: float
) -> int:  # fmt: skip
    """One operation in the step of the system from `t` to `t + h` [s]; returns its status. `called` tells whose it is."""
    what, status = ops[o, OPERATION], 0
    called[0] = ops[o, COMPONENT]
    if rates and clocks[ops[o, COMPONENT], COUNT] != clocks[ops[o, COMPONENT], EVERY] - 1:
        return 0
    if what == CALL:
        status = _call_values(ops[o, FUNCTION], ops[o, INSTANCE], ops[o, REFERENCES], ops[o, N], ops[o, BUFFER])
    elif what != STEP:
        status = _converted(ops, o, bus, n_outputs, places)
    elif rates:
        status = _small_steps(ops, o, clocks)
    else:
        status = _call_step(ops[o, FUNCTION], ops[o, INSTANCE], t, h, ops[o, N])
    return int(status)


@njit(inline="always", **OPTIONS)
def begin(rates: bool, clocks: Any, now: int) -> None:
    """A step of the system begins at `now` [ticks]."""
    if rates:
        for c in range(len(clocks)):
            if clocks[c, COUNT] == 0:
                clocks[c, BEGAN] = now


@njit(inline="always", **OPTIONS)
def finish(rates: bool, clocks: Any, now: int, k: int, bus: Any, low: Any, high: Any, columns: Any) -> bool:
    """A step of the system has ended at `now` [ticks]: write its row; false if an output is out of its bounds."""
    n = len(low)
    if rates:
        for c in range(len(clocks)):
            clocks[c, COUNT] = 0 if clocks[c, COUNT] == clocks[c, EVERY] - 1 else clocks[c, COUNT] + 1
    good = True
    for i in range(n):
        good &= (bus[i] >= low[i]) & (bus[i] <= high[i])  # false for NaN
    if good and len(columns) > 0:
        columns[0, k] = now / TICK
        for i in range(n):
            columns[1 + i, k] = bus[i]
    return good


def advance(
    steps: int, ticks: Any, rates: bool, delayed: bool, watched: int, ops: Any, clocks: Any, places: Any, bus: Any,
    low: Any, high: Any, columns: Any, report: Any, called: Any,
) -> int:  # fmt: skip
    """Make up to `steps` steps; returns how many were made and are in `columns` (t, outputs). The rest is told by `report`.

    `ticks`: [start, step, done so far]. `rates`: some component has another rate. `report`: [outcome, operation, status]. `called`:
    [number of the component that is being called], for whoever finds it after a crash.
    """
    n, h = len(low), ticks[1] / TICK
    for k in range(steps):
        now = ticks[0] + (ticks[2] + k) * ticks[1]
        t = now / TICK
        if delayed:
            for i in range(n):
                bus[n + i] = bus[i]
        begin(rates, clocks, now)
        for o in range(len(ops)):
            status = operate(ops, o, rates, clocks, bus, n, places, called, t, h)
            if status < 0 or status > ops[o, LIMIT]:
                report[0], report[1], report[2] = FAILED, o, status
                return k
        if not finish(rates, clocks, now + ticks[1], k, bus, low, high, columns):
            report[0] = VIOLATED
            return k
        if watched >= 0 and bus[watched] != 0.0:
            report[0] = STOPPED
            return k + 1
    report[0] = DONE
    return steps
