"""The calls of FMI 2.0 co-simulation."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import fmpy
from fmpy import fmi2

from .calls import COUNT, NUMBER, POINTER, Call, Calls, States, Type

_FLAG = ctypes.c_int
_CO_SIMULATION = 1


class Fmi2(Calls):
    """See the module and `Calls`."""

    prefix = "fmi2"
    platform = fmpy.platform
    types: ClassVar[Mapping[str, Type]] = {
        "Real": Type("Real", NUMBER, "real"),
        "Integer": Type("Integer", ctypes.c_int, "integer"),
        "Enumeration": Type("Integer", ctypes.c_int, "integer"),
        "Boolean": Type("Boolean", _FLAG, "boolean"),
        "String": Type("String", ctypes.c_char_p, "string"),
    }
    signatures: ClassVar[Mapping[str, tuple[Any, ...]]] = {
        "fmi2FreeInstance": (),
        "fmi2SetupExperiment": (_FLAG, NUMBER, NUMBER, _FLAG, NUMBER),
        "fmi2EnterInitializationMode": (),
        "fmi2ExitInitializationMode": (),
        "fmi2Terminate": (),
        "fmi2Reset": (),
        "fmi2DoStep": (NUMBER, NUMBER, _FLAG),
        "fmi2GetFMUstate": (POINTER,),
        "fmi2SetFMUstate": (POINTER,),
        "fmi2FreeFMUstate": (POINTER,),
        "fmi2SerializedFMUstateSize": (POINTER, POINTER),
        "fmi2SerializeFMUstate": (POINTER, POINTER, COUNT),
        "fmi2DeSerializeFMUstate": (POINTER, COUNT, POINTER),
    }
    access = (POINTER, COUNT, POINTER)
    states = States(
        "fmi2GetFMUstate",
        "fmi2SetFMUstate",
        "fmi2FreeFMUstate",
        "fmi2SerializedFMUstateSize",
        "fmi2SerializeFMUstate",
        "fmi2DeSerializeFMUstate",
    )
    functions = tuple(name for name in dir(fmi2.FMU2Slave) if name.startswith("fmi2"))

    def __init__(self, folder: Path, description: Any, log: list[str]) -> None:
        super().__init__(folder, description, log)
        self._callbacks = self._made_callbacks()

    def _made_callbacks(self) -> Any:
        """One logger for all instances: FMPy's formatter of printf messages knows only one."""

        def message(_environment: Any, _instance: bytes, _status: int, _category: bytes, text: bytes) -> None:
            self._log.append((text or b"").decode("utf-8", "replace").strip())

        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(message)
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)
        if not self._made_by_pythonfmu():  # which hands over finished texts
            fmi2.addLoggerProxy(ctypes.byref(callbacks))
        return callbacks

    def instantiate(self, name: str) -> int | None:
        """Address of a new instance, if there is one."""
        made = self.function("fmi2Instantiate", POINTER)
        made.argtypes = (ctypes.c_char_p, _FLAG, ctypes.c_char_p, ctypes.c_char_p, POINTER, _FLAG, _FLAG)
        guid, resources = self.description.guid.encode(), self._location().encode()
        instance: int | None = made(name.encode(), _CO_SIMULATION, guid, resources, ctypes.addressof(self._callbacks), False, True)
        return instance

    def _location(self) -> str:
        """URI of the resources; pythonfmu decodes no escape but `%20`."""
        resources = self.folder / "resources"
        return f"file:///{resources.as_posix().lstrip('/').replace(' ', '%20')}" if self._made_by_pythonfmu() else resources.as_uri()

    def _made_by_pythonfmu(self) -> bool:
        return (self.folder / "resources" / "slavemodule.txt").is_file()

    def enter(self, call: Call, start: float) -> None:
        """Enter initialisation."""
        call("fmi2SetupExperiment", *self.tolerance, start, False, 0.0)
        call("fmi2EnterInitializationMode")

    def step(self, call: Call, t: float, h: float, final: bool) -> None:
        """From `t` to `t + h` [s]."""
        call("fmi2DoStep", t, h, final)

    def room(self, values: int) -> tuple[int, ...]:
        """Nothing: there are as many values as references."""
        return ()
