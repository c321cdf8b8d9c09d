"""A component that plays back series in memory, or adds them to what passes through it, at the speed of the compiled master.

`orchestration.slaves.playback` plays back the columns of a run and interpolates between its times; here the samples are those of the
communication points already, and there is one for each.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from robomill.orchestration.slaves.native import BlockData
from robomill.orchestration.slaves.protocol import FloatArray, ParameterValue, Port, PortData

_HEAD = 5
"""Numbers before the data: rows, columns, time of the first row [s], step [s], factor on the inputs."""


class Tape:
    """Outputs at time t = the row of that time (the first or last one outside), plus the inputs if it `adds`.

    `series`: port -> values at the times `grid` [s] (equal steps), in the unit of the port. The inputs of one that adds are called
    like the outputs, with `_in` behind the name of the array: `p[2]` -> `p_in[2]`.
    """

    def __init__(self, name: str, ports: Sequence[Port], series: Mapping[str, FloatArray], grid: FloatArray, adds: bool = False) -> None:
        table = np.stack([series[p.name] for p in ports], axis=1)
        n, m = table.shape
        head = (n, m, grid[0], grid[1] - grid[0], float(adds))
        self.name, self._m = name, m
        self._data = np.concatenate([head, np.zeros(2 * m), np.ascontiguousarray(table, dtype=np.float64).ravel()])
        self._u, self._y = self._data[_HEAD : _HEAD + m], self._data[_HEAD + m : _HEAD + 2 * m]
        inputs = [PortData(passing(p.name), "input", p.type, p.unit, 0.0) for p in ports] if adds else []
        through = [(passing(p.name),) if adds else () for p in ports]
        outputs = [
            PortData(p.name, "output", p.type, p.unit, float(v), dependencies=d) for p, v, d in zip(ports, table[0], through, strict=True)
        ]
        self.ports: tuple[Port, ...] = (*inputs, *outputs)

    def configure(self, parameters: Mapping[str, ParameterValue]) -> None:
        """It has no parameters."""

    def initialise(self, start: float, stop: float, step: float) -> None:
        """Go to time `start` [s]."""
        self._time = start

    def set_inputs(self, values: FloatArray) -> None:
        """Keep a copy."""
        self._u[: len(values)] = values

    def step(self, t: float, h: float) -> None:
        """Go to t + h [s]."""
        self._time = t + h

    def get_outputs(self, out: FloatArray) -> None:
        """The row of the time reached."""
        _look_up(self._data, self._time)
        out[:] = self._y

    def get_state(self) -> Any:
        """Time and inputs."""
        return self._time, self._u.copy()

    def set_state(self, state: Any) -> None:
        """Back to a state."""
        self._time, self._u[:] = state

    def native(self) -> _Addresses:
        """Addresses for the compiled master."""
        return _Addresses(self._data, self._m)

    def close(self) -> None:
        """Nothing to free."""


def passing(port: str) -> str:
    """Input that passes through to an output: `p[2]` -> `p_in[2]`."""
    base, bracket, index = port.partition("[")
    return f"{base}_in{bracket}{index}"


def _look_up(a: Any, t: float) -> None:
    n, m = int(a[0]), int(a[1])
    k = min(max(int(np.floor((t - a[2]) / a[3] + 0.5)), 0), n - 1)
    for i in range(m):
        a[_HEAD + m + i] = a[_HEAD + 2 * m + k * m + i] + a[4] * a[_HEAD + i]


class _Addresses:
    """What `orchestration.slaves.native` asks for."""

    limit, final = 0, 1

    def __init__(self, data: FloatArray, m: int) -> None:
        self._data = data
        self.instance: int = data.ctypes.data
        self.step: int = _step().address
        first = self.instance + 8 * _HEAD
        adds = data[4] != 0.0
        self.inputs = [BlockData("float64", 0, 0, first, tuple(range(m)))] if adds else []
        self.outputs = [BlockData("float64", 0, 0, first + 8 * m, tuple(range(m)))]

    def failed(self, what: str, block: int, status: int, t: float, h: float) -> Exception:
        """Its step cannot fail."""
        return AssertionError(f"{what} {block}: status {status} at t = {t} s")


@cache
def _step() -> Any:
    """`int f(double *data, double t, double h, int)`: compiled once, kept on disk."""
    import numba

    # Numba's decorators and types are not typed
    carray: Any = numba.carray  # type: ignore[attr-defined]
    types: Any = numba.types
    look_up: Any = numba.njit(_look_up)
    head = _HEAD

    def tape_step(data: Any, t: float, h: float, _: int) -> int:
        sizes = carray(data, (head,))
        n, m = int(sizes[0]), int(sizes[1])
        look_up(carray(data, (head + 2 * m + n * m,)), t + h)
        return 0

    signature = types.int32(types.CPointer(types.float64), types.float64, types.float64, types.int32)
    return numba.cfunc(signature)(tape_step)
