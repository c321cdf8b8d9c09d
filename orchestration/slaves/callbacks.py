"""Slaves that can only be called from Python, as compiled code sees them: C functions that call back, on buffers that stay.

So one such component does not keep the others of its system from being stepped by compiled code.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import numpy as np

from robomill.orchestration.slaves.native import BlockData, Native, Rollback, native_of
from robomill.orchestration.slaves.protocol import FloatArray, Slave, inputs, outputs

_ACCESS = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p)
_STEP = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int)
_STATE = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)


def face_of(slave: Slave) -> Native:
    """The native face of a slave; where it has none, one that calls back."""
    return native_of(slave) or Called(slave)


def rollback_of(slave: Any) -> Rollback:
    """A state of this slave that is kept aside; where it must be serialised for that, by way of `get_state` and `set_state`."""
    method = getattr(slave, "rollback", None)
    found: Rollback | None = method() if method is not None else None
    return found or CalledRollback(slave)


class _Calls:
    """Functions that return 0, or 1 after keeping what was raised."""

    def __init__(self) -> None:
        self._error: BaseException | None = None

    def _status(self, call: Callable[..., object], *arguments: Any) -> int:
        try:
            call(*arguments)
        except BaseException as error:  # nothing gets through the compiled code by itself, a second Ctrl-C neither
            self._error = error
            return 1
        return 0

    def _raised(self) -> Exception:
        error, self._error = self._error, None
        if isinstance(error, Exception):
            return error
        assert error is not None
        raise error


class Called(_Calls):
    """Any slave with the face of a native one (see `native.Native`)."""

    instance, limit, final = 0, 0, 1

    def __init__(self, slave: Slave) -> None:
        super().__init__()
        self._buffers = u, y = np.zeros(len(inputs(slave.ports))), np.zeros(len(outputs(slave.ports)))
        self._functions = (  # kept: their code goes with them
            _ACCESS(lambda *_: self._status(slave.set_inputs, u)),
            _STEP(lambda _, t, h, __: self._status(slave.step, t, h)),
            _ACCESS(lambda *_: self._status(slave.get_outputs, y)),
        )
        take, self.step, give = map(_address, self._functions)
        self.inputs, self.outputs = _blocks(take, u), _blocks(give, y)

    def failed(self, what: str, block: int, status: int, t: float, h: float) -> Exception:
        """What the slave raised; it is raised at once if it is no `Exception`."""
        return self._raised()


class CalledRollback(_Calls):
    """The states of any slave as a `native.Rollback`."""

    instance = kept = size = limit = 0

    def __init__(self, slave: Slave) -> None:
        super().__init__()
        self._slave = slave
        self._state: Any = None
        self._functions = _STATE(lambda *_: self._status(self.save)), _STATE(lambda *_: self._status(self.back))
        self.get, self.set = map(_address, self._functions)

    def save(self) -> None:
        """Keep the present state."""
        self._state = self._slave.get_state()

    def back(self) -> None:
        """Go back to what is kept."""
        self._slave.set_state(self._state)

    def failed(self, what: str, status: int) -> Exception:
        """What the slave raised."""
        return self._raised()


def _blocks(function: int, buffer: FloatArray) -> list[BlockData]:
    """All elements in one block without references: the function knows its buffer."""
    return [BlockData("float64", function, 0, buffer.ctypes.data, tuple(range(len(buffer))))] if len(buffer) else []


def _address(function: Any) -> int:
    return ctypes.cast(function, ctypes.c_void_p).value or 0
