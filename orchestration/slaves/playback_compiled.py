"""The step of `playback`, compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
from numba import types

from robomill.orchestration.slaves.playback_kernel import HEAD, look_up

# Numba's decorators and types are not typed
carray: Any = getattr(numba, "carray")  # noqa: B009
cfunc: Callable[..., Callable[[Callable[..., Any]], Any]] = numba.cfunc
CPointer: Any = types.CPointer
_look_up: Any = numba.njit(look_up)


@cfunc(types.int32(CPointer(types.float64), types.float64, types.float64, types.int32))
def step(data: Any, t: float, h: float, _final: int) -> Any:
    """`int f(double *data, double t, double h, int)`: the outputs at t + h [s]."""
    head = carray(data, (HEAD,))
    n, m = int(head[0]), int(head[1])
    return _look_up(carray(data, (HEAD + 3 * m + n + n * m,)), t + h)
