"""The calls of FMI 3.0 co-simulation: no event mode, no early return, no intermediate updates."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import fmpy
from fmpy import fmi3

from .calls import COUNT, NUMBER, POINTER, Call, CallFailed, Calls, States, Type

_FLAG, _TEXT = ctypes.c_bool, ctypes.c_char_p
_TIME_ERROR = 1e-6
"""Largest distance between the time an FMU says it has reached and the end of the step, relative to the step."""


class Fmi3(Calls):
    """See the module and `Calls`."""

    prefix = "fmi3"
    platform = fmpy.platform_tuple
    types: ClassVar[Mapping[str, Type]] = {
        "Float64": Type("Float64", NUMBER, "real"),
        "Float32": Type("Float32", ctypes.c_float, "real"),
        **{f"Int{n}": Type(f"Int{n}", getattr(ctypes, f"c_int{n}"), "integer") for n in (8, 16, 32, 64)},
        **{f"UInt{n}": Type(f"UInt{n}", getattr(ctypes, f"c_uint{n}"), "integer") for n in (8, 16, 32, 64)},
        "Enumeration": Type("Int64", ctypes.c_int64, "integer"),
        "Boolean": Type("Boolean", _FLAG, "boolean"),
        "String": Type("String", _TEXT, "string"),
    }
    signatures: ClassVar[Mapping[str, tuple[Any, ...]]] = {
        "fmi3FreeInstance": (),
        "fmi3EnterInitializationMode": (_FLAG, NUMBER, NUMBER, _FLAG, NUMBER),
        "fmi3ExitInitializationMode": (),
        "fmi3Terminate": (),
        "fmi3Reset": (),
        "fmi3DoStep": (NUMBER, NUMBER, _FLAG, POINTER, POINTER, POINTER, POINTER),
        "fmi3GetFMUState": (POINTER,),
        "fmi3SetFMUState": (POINTER,),
        "fmi3FreeFMUState": (POINTER,),
        "fmi3SerializedFMUStateSize": (POINTER, POINTER),
        "fmi3SerializeFMUState": (POINTER, POINTER, COUNT),
        "fmi3DeserializeFMUState": (POINTER, COUNT, POINTER),
    }
    access = (POINTER, COUNT, POINTER, COUNT)
    states = States(
        "fmi3GetFMUState",
        "fmi3SetFMUState",
        "fmi3FreeFMUState",
        "fmi3SerializedFMUStateSize",
        "fmi3SerializeFMUState",
        "fmi3DeserializeFMUState",
    )
    functions = tuple(name for name in dir(fmi3.FMU3Slave) if name.startswith("fmi3"))

    def __init__(self, folder: Path, description: Any, log: list[str]) -> None:
        super().__init__(folder, description, log)
        self._message = fmi3.fmi3LogMessageCallback(
            lambda _environment, _status, _category, text: log.append((text or b"").decode("utf-8", "replace").strip())
        )

    def instantiate(self, name: str) -> int | None:
        """Address of a new instance, if there is one."""
        made = self.function("fmi3InstantiateCoSimulation", POINTER)
        flags = (_FLAG, _FLAG, _FLAG, _FLAG)
        made.argtypes = (_TEXT, _TEXT, _TEXT, *flags, POINTER, COUNT, POINTER, fmi3.fmi3LogMessageCallback, POINTER)
        token, resources = self.description.guid.encode(), str(self.folder / "resources") + os.sep
        visible, logging, events, early_return = False, True, False, False
        instance: int | None = made(
            *(name.encode(), token, resources.encode(), visible, logging, events, early_return), None, 0, None, self._message, None
        )
        return instance

    def enter(self, call: Call, start: float) -> None:
        """Enter initialisation."""
        call("fmi3EnterInitializationMode", *self.tolerance, start, False, 0.0)

    def step(self, call: Call, t: float, h: float, final: bool) -> None:
        """From `t` to `t + h` [s]. `CallFailed`, too, if the FMU returns early, wants to end here or wants event mode."""
        events, ends, early = (_FLAG * 1)(), (_FLAG * 1)(), (_FLAG * 1)()
        reached = (NUMBER * 1)()
        call("fmi3DoStep", t, h, final, events, ends, early, reached)
        if ends[0]:
            raise CallFailed(f"fmi3DoStep asks for the end of the simulation at t = {t:.9g} s (terminateSimulation)")
        if early[0]:
            raise CallFailed(f"fmi3DoStep returned early from t = {t:.9g} s, though it was told not to (earlyReturnAllowed = false)")
        if events[0]:
            raise CallFailed(f"fmi3DoStep from t = {t:.9g} s wants event mode, which it was told not to (eventModeUsed = false)")
        if not self.remark and not abs(reached[0] - (t + h)) <= _TIME_ERROR * h:
            self.remark = f"fmi3DoStep from t = {t:.9g} s of {h:.9g} s gives {reached[0]:.9g} s as lastSuccessfulTime"

    def room(self, values: int) -> tuple[int, ...]:
        """The number of values: arrays have more than references."""
        return (values,)
