"""The calls of FMI 3.0 co-simulation: no event mode, no early return, no intermediate updates."""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from robomill.orchestration.errors import SlaveError
from robomill.orchestration.slaves.description import FmuDescription, Variable
from robomill.orchestration.slaves.fmi import Addresses, Call, Fmi, Group, StateFunctions, address
from robomill.orchestration.slaves.protocol import Scalar

_DISCARD = 2  # of fmi3Status
ENDS, EARLY = 100, 101
"""Instead of a status that is no error: the FMU asks for the end of the simulation; it did not make the whole step."""
_flag, _number, _count, _pointer = ctypes.c_bool, ctypes.c_double, ctypes.c_size_t, ctypes.c_void_p
_LOG = ctypes.CFUNCTYPE(None, _pointer, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)


class Fmi3(Fmi):
    """See the module and `Fmi`."""

    prefix = "fmi3"
    state = StateFunctions(
        "GetFMUState", "SetFMUState", "FreeFMUState", "SerializedFMUStateSize", "SerializeFMUState", "DeserializeFMUState"
    )
    instantiation = (
        "InstantiateCoSimulation",
        (ctypes.c_char_p, ctypes.c_char_p, ctypes.c_char_p, _flag, _flag, _flag, _flag, _pointer, _count, _pointer, _LOG, _pointer),
    )
    access = _pointer, _count, _pointer, _count
    arguments: ClassVar[Mapping[str, tuple[Any, ...]]] = {
        "SetDebugLogging": (_flag, _count, _pointer),
        "EnterInitializationMode": (_flag, _number, _number, _flag, _number),
        "ExitInitializationMode": (),
        "Terminate": (),
        "DoStep": (_number, _number, _flag, _pointer, _pointer, _pointer, _pointer),
        "GetFMUState": (_pointer,),
        "SetFMUState": (_pointer,),
        "FreeFMUState": (_pointer,),
        "SerializedFMUStateSize": (_pointer, _pointer),
        "SerializeFMUState": (_pointer, _pointer, _count),
        "DeserializeFMUState": (_pointer, _count, _pointer),
    }
    dtypes: ClassVar[Mapping[str, Any]] = {
        "Float64": np.float64,
        "Float32": np.float32,
        "Int8": np.int8,
        "UInt8": np.uint8,
        "Int16": np.int16,
        "UInt16": np.uint16,
        "Int32": np.int32,
        "UInt32": np.uint32,
        "Int64": np.int64,
        "UInt64": np.uint64,
        "Boolean": np.bool_,
    }
    counted = True

    def __init__(self, description: FmuDescription, name: str, messages: deque[tuple[int, str]], final: bool) -> None:
        super().__init__(description, name, messages, final)
        self._log = _LOG(lambda _, status, __, text: messages.append((status, (text or b"").decode("utf-8", "replace").rstrip())))
        # event handling needed, terminate simulation, early return; last successful time
        self.flags = np.zeros(3, dtype=np.uint8)
        self.reached = np.zeros(1)
        at = self.flags.ctypes.data
        self._told = (bool(self.final), at, at + 1, at + 2, self.reached.ctypes.data)

    def instantiate(self) -> bool:
        """Make the instance; whether there is one."""
        resources = str(self.description.folder / "resources") + os.sep
        token = self.description.guid.encode()
        nothing = (None, 0, None, self._log, None)
        made = self.make(self.name.encode(), token, resources.encode(), False, True, False, False, *nothing)
        self.instance = ctypes.c_void_p(made)
        return bool(made)

    def enter(self, start: float, stop: float) -> Iterator[Call]:
        """The call that enters initialisation."""
        tolerance = self.description.tolerance
        yield (
            "EnterInitializationMode",
            (tolerance is not None, tolerance or 0.0, start, math.isfinite(stop), stop if math.isfinite(stop) else 0.0),
        )

    def parameter(self, variable: Variable, values: Sequence[Scalar]) -> Call:
        """The call that sets all elements of a parameter."""
        given: Any
        if variable.kind == "String":
            given = (ctypes.c_char_p * len(values))(*(str(v).encode() for v in values))
        else:
            given = np.ctypeslib.as_ctypes(np.array(values, dtype=self.dtypes[variable.kind]))
        return f"Set{variable.kind}", ((ctypes.c_uint * 1)(variable.reference), 1, given, len(values))

    def choose_log(self, categories: Sequence[str]) -> None:
        """Ask for messages of these categories only."""
        names = [n.encode() for n in categories]
        with contextlib.suppress(SlaveError):  # an FMU without this function says everything
            self.call("SetDebugLogging", True, len(names), (ctypes.c_char_p * len(names))(*names))

    def step(self, t: float, h: float) -> int:
        """From `t` to `t + h` [s]."""
        status: int = self.do_step(self.instance, t, h, *self._told)
        if 0 <= status < _DISCARD and (self.flags[1] or self.flags[2]):
            return ENDS if self.flags[1] else EARLY
        return status

    def explain(self, function: str, status: int) -> str:
        """What a call did that returned this status."""
        if status == ENDS:
            return self.ends(f"terminateSimulation at t = {self.reached[0]:.9g} s")
        if status == EARLY:
            return f"returned early, at t = {self.reached[0]:.9g} s, though it was told not to (earlyReturnAllowed = false)"
        if status == _DISCARD and function.startswith("fmi3DoStep"):
            at = f"at t = {self.reached[0]:.9g} s (lastSuccessfulTime)"
            return f"did not make the whole step (fmi3Discard) and stopped {at}: {self.in_parts()}"
        return super().explain(function, status)

    def compiled(self, inputs: Sequence[Group], outputs: Sequence[Group]) -> Addresses | None:
        """Addresses for the compiled loop, by way of functions that translate its calls; None for types that it has not."""
        from robomill.orchestration.slaves import fmi3_compiled  # only compiled loops need Numba

        at = (self.instance.value or 0, address(self.do_step), self.flags.ctypes.data, self.reached.ctypes.data)
        return fmi3_compiled.addresses(at, inputs, outputs)
