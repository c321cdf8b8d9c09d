"""FMI 3.0 behind the calls that the compiled loop makes, which are those of FMI 2.0 (`orchestration.slaves.native`).

Compiled functions stand in between: they get addresses instead of the instance and the value references, and find there
what FMI 3.0 wants besides: numbers of values, places for what a step reports. Booleans, of one byte, become int32.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import cfunc as numba_cfunc
from numba import types
from numba.extending import intrinsic as numba_intrinsic

from robomill.orchestration.slaves.fmi import Addresses, Group, address
from robomill.orchestration.slaves.native import BlockData

# Numba's decorators change signatures in ways that types cannot say
cfunc: Callable[..., Callable[[Callable[..., Any]], Any]] = numba_cfunc
intrinsic: Callable[[Callable[..., Any]], Any] = numba_intrinsic
carray: Any = getattr(numba, "carray")  # noqa: B009
CPointer: Any = types.CPointer

_WORD = ir.IntType(64)
_DIRECT = ("float64", "int32", "int64")
# Words of the record that stands for the instance, and of that which stands for value references
_INSTANCE, _FUNCTION, _FLAGS, _REACHED = range(4)
_ACCESS, _REFERENCES, _COUNT, _BYTES = range(4)
_DISCARD, _ENDS, _EARLY = 2, 100, 101  # as in `fmi3`; Numba's cache does not notice constants of other modules


def _fit(builder: Any, value: Any, kind: Any) -> Any:
    """An int64 as an address or a smaller integer; anything else as it is."""
    if isinstance(kind, ir.PointerType):
        return builder.inttoptr(value, kind)
    return builder.trunc(value, kind) if isinstance(kind, ir.IntType) and kind.width < _WORD.width else value


def _caller(*kinds: Any) -> Any:
    """An intrinsic `call(function, ...)` of an address with arguments of these LLVM types; addresses and sizes are int64."""
    given = tuple(types.float64 if isinstance(k, ir.DoubleType) else types.int64 for k in kinds)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = ir.PointerType(ir.FunctionType(ir.IntType(32), list(kinds)))
        function = builder.inttoptr(args[0], kind)
        values = [_fit(builder, value, wanted) for value, wanted in zip(args[1:], kinds, strict=True)]
        return builder.call(function, values)

    return given, generate


_P, _I, _D, _B = ir.PointerType(ir.IntType(8)), ir.IntType(64), ir.DoubleType(), ir.IntType(8)


@intrinsic
def _call_access(context: Any, function: Any, instance: Any, references: Any, n: Any, buffer: Any, values: Any) -> Any:
    """`function(instance, references, n, buffer, values)`, like fmi3SetFloat64; returns its status."""
    given, generate = _caller(_P, _P, _I, _P, _I)
    return types.int32(types.int64, *given), generate


@intrinsic
def _call_step(
    context: Any, function: Any, instance: Any, t: Any, h: Any, none: Any, event: Any, ends: Any, early: Any, reached: Any
) -> Any:
    """`function(instance, t, h, none, event, ends, early, reached)`, fmi3DoStep; returns its status."""
    given, generate = _caller(_P, _D, _D, _B, _P, _P, _P, _P)
    return types.int32(types.int64, *given), generate


def _at(kind: Any, bits: int) -> Any:
    """An intrinsic that turns an address into a pointer to numbers of a type."""

    @intrinsic
    def pointer(context: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return builder.inttoptr(args[0], ir.PointerType(ir.IntType(bits)))

        return CPointer(kind)(types.int64), generate

    return pointer


_words, _ints, _bytes = _at(types.int64, 64), _at(types.int32, 32), _at(types.uint8, 8)
_access_type = types.int32(types.int64, types.int64, types.int64, types.int64)


@cfunc(types.int32(types.int64, types.float64, types.float64, types.int32), cache=True)
def _step(record: int, t: float, h: float, final: int) -> Any:
    words = carray(_words(record), 4)
    at = words[_FLAGS]
    status = _call_step(words[_FUNCTION], words[_INSTANCE], t, h, final, at, at + 1, at + 2, words[_REACHED])
    flags = carray(_bytes(at), 3)
    if 0 <= status < _DISCARD and (flags[1] or flags[2]):
        return _ENDS if flags[1] else _EARLY
    return status


@cfunc(_access_type, cache=True)
def _access(record: int, block: int, n: int, buffer: int) -> Any:
    words, own = carray(_words(record), 4), carray(_words(block), 4)
    return _call_access(own[_ACCESS], words[_INSTANCE], own[_REFERENCES], own[_COUNT], buffer, n)


@cfunc(_access_type, cache=True)
def _set_booleans(record: int, block: int, n: int, buffer: int) -> Any:
    words, own = carray(_words(record), 4), carray(_words(block), 4)
    numbers, flags = carray(_ints(buffer), n), carray(_bytes(own[_BYTES]), n)
    for i in range(n):
        flags[i] = numbers[i] != 0
    return _call_access(own[_ACCESS], words[_INSTANCE], own[_REFERENCES], own[_COUNT], own[_BYTES], n)


@cfunc(_access_type, cache=True)
def _get_booleans(record: int, block: int, n: int, buffer: int) -> Any:
    words, own = carray(_words(record), 4), carray(_words(block), 4)
    status = _call_access(own[_ACCESS], words[_INSTANCE], own[_REFERENCES], own[_COUNT], own[_BYTES], n)
    numbers, flags = carray(_ints(buffer), n), carray(_bytes(own[_BYTES]), n)
    for i in range(n):
        numbers[i] = flags[i]
    return status


def addresses(step: Sequence[int], inputs: Sequence[Group], outputs: Sequence[Group]) -> Addresses | None:
    """What the compiled loop calls to step an FMU; None if it has inputs or outputs of a type that the loop does not carry.

    `step`: addresses of the instance, of its fmi3DoStep, of the three flags and of the time that a step reports.
    """
    kinds = {str(g.buffer.dtype) for g in (*inputs, *outputs)}
    if not kinds <= {*_DIRECT, "bool"}:
        return None
    record = np.array(step, dtype=np.int64)
    kept: list[Any] = [record]
    ins, outs = [_block(g, _set_booleans, kept) for g in inputs], [_block(g, _get_booleans, kept) for g in outputs]
    return Addresses(record.ctypes.data, _step.address, ins, outs, kept)


def _block(group: Group, booleans: Any, kept: list[Any]) -> BlockData:
    of_flags = group.buffer.dtype == np.bool_
    buffer = np.zeros(len(group.buffer), dtype=np.int32) if of_flags else group.buffer
    own = np.array([address(group.function), group.references.ctypes.data, len(group.references), group.buffer.ctypes.data], dtype=np.int64)
    kept += [buffer, own]
    function = (booleans if of_flags else _access).address
    return BlockData(str(buffer.dtype), function, own.ctypes.data, buffer.ctypes.data, group.places)
