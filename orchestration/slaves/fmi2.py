"""The calls of FMI 2.0 co-simulation."""

from __future__ import annotations

import ctypes
import itertools
import math
import weakref
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar

import fmpy
import fmpy.fmi1
import numpy as np
from fmpy import fmi2

from robomill.orchestration.errors import SlaveError
from robomill.orchestration.slaves.description import FmuDescription, Variable
from robomill.orchestration.slaves.fmi import WARNING, Addresses, Call, Fmi, Group, StateFunctions, address
from robomill.orchestration.slaves.native import BlockData
from robomill.orchestration.slaves.protocol import Scalar

_DISCARD, _PENDING = 2, 5  # of fmi2Status
_LAST_SUCCESSFUL_TIME, _TERMINATED = 2, 3  # of fmi2StatusKind
_flag, _number, _count, _pointer = ctypes.c_int, ctypes.c_double, ctypes.c_size_t, ctypes.c_void_p
# The proxy that formats printf messages knows ONE logger for the whole process, so there is one here,
# which finds the instance by its environment pointer.
_instances: weakref.WeakValueDictionary[int, deque[tuple[int, str]]] = weakref.WeakValueDictionary()
_numbers = itertools.count(1)


def _log(environment: int | None, instance: bytes, status: int, category: bytes, message: bytes) -> None:
    messages = _instances.get(environment or 0)
    if messages is None:  # an FMU that somebody else runs through FMPy
        fmpy.fmi1.printLogMessage(environment, instance, status, category, message)
    else:
        messages.append((status, (message or b"").decode("utf-8", "replace").rstrip()))


_LOGGER = fmi2.fmi2CallbackLoggerTYPE(_log)
_ALLOCATE = fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
_FREE = fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)


class Fmi2(Fmi):
    """See the module and `Fmi`."""

    prefix = "fmi2"
    state = StateFunctions(
        "GetFMUstate", "SetFMUstate", "FreeFMUstate", "SerializedFMUstateSize", "SerializeFMUstate", "DeSerializeFMUstate"
    )
    instantiation = "Instantiate", (ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p, _pointer, _flag, _flag)
    access = _pointer, _count, _pointer
    arguments: ClassVar[Mapping[str, tuple[Any, ...]]] = {
        "SetDebugLogging": (_flag, _count, _pointer),
        "SetupExperiment": (_flag, _number, _number, _flag, _number),
        "EnterInitializationMode": (),
        "ExitInitializationMode": (),
        "Terminate": (),
        "DoStep": (_number, _number, _flag),
        "GetFMUstate": (_pointer,),
        "SetFMUstate": (_pointer,),
        "FreeFMUstate": (_pointer,),
        "SerializedFMUstateSize": (_pointer, _pointer),
        "SerializeFMUstate": (_pointer, _pointer, _count),
        "DeSerializeFMUstate": (_pointer, _count, _pointer),
    }
    dtypes: ClassVar[Mapping[str, Any]] = {"Real": np.float64, "Integer": np.int32, "Boolean": np.int32}
    counted = False

    def __init__(self, description: FmuDescription, name: str, messages: deque[tuple[int, str]], final: bool) -> None:
        super().__init__(description, name, messages, final)
        number = next(_numbers)
        _instances[number] = self.messages
        self._callbacks = fmi2.fmi2CallbackFunctions(_LOGGER, _ALLOCATE, _FREE, componentEnvironment=number)
        if not self.description.made_by_pythonfmu:
            # pythonfmu hands over finished texts: a per cent sign in one would be formatted with garbage
            fmi2.addLoggerProxy(ctypes.byref(self._callbacks))

    def instantiate(self) -> bool:
        """Make the instance; whether there is one."""
        names = self.name.encode(), fmi2.fmi2CoSimulation, self.description.guid.encode(), self._location().encode()
        visible, logging = 0, 1
        made = self.make(*names, ctypes.byref(self._callbacks), visible, logging)
        self.instance = ctypes.c_void_p(made)
        return bool(made)

    def _location(self) -> str:
        """URI of the resources. For pythonfmu with one escape, `%20` for a blank: it decodes no other, and crashes where nothing is."""
        resources = self.description.folder / "resources"
        if not self.description.made_by_pythonfmu:
            return resources.as_uri()
        if "%20" in resources.as_posix():
            raise SlaveError(
                f"component {self.name!r}: {self.description.file.name} is unpacked to {resources.parent}, and the library of pythonfmu "
                "takes %20 in a name for a blank: set TMPDIR to another folder"
            )
        return f"file:///{resources.as_posix().lstrip('/').replace(' ', '%20')}"

    def enter(self, start: float, stop: float) -> Iterator[Call]:
        """The calls that enter initialisation."""
        tolerance = self.description.tolerance
        yield (
            "SetupExperiment",
            (int(tolerance is not None), tolerance or 0.0, start, int(math.isfinite(stop)), stop if math.isfinite(stop) else 0.0),
        )
        yield "EnterInitializationMode", ()

    def parameter(self, variable: Variable, values: Sequence[Scalar]) -> Call:
        """The call that sets a parameter."""
        reference, (value,) = (ctypes.c_uint * 1)(variable.reference), values
        given: Any
        if variable.kind == "String":
            given = (ctypes.c_char_p * 1)(str(value).encode())
        elif variable.kind == "Real":
            given = (ctypes.c_double * 1)(float(value))
        else:
            given = (ctypes.c_int * 1)(int(value))
        return f"Set{variable.kind}", (reference, 1, given)

    def choose_log(self, categories: Sequence[str]) -> None:
        """Ask for messages of these categories only."""
        names = [n.encode() for n in categories]
        self.call("SetDebugLogging", 1, len(names), (ctypes.c_char_p * len(names))(*names))

    def step(self, t: float, h: float) -> int:
        """From `t` to `t + h` [s]."""
        status: int = self.do_step(self.instance, t, h, self.final)
        return status

    def explain(self, function: str, status: int) -> str:
        """What a call did that returned this status; of a step that was discarded the FMU knows more."""
        if not function.startswith("fmi2DoStep") or status not in (_DISCARD, _PENDING):
            return super().explain(function, status)
        if status == _PENDING:
            return "goes on in the background (fmi2Pending), which is not supported: export the FMU without canRunAsynchronuously"
        reached = self._told("RealStatus", _LAST_SUCCESSFUL_TIME, ctypes.c_double())
        where = "" if reached is None else f" at t = {reached:.9g} s (fmi2LastSuccessfulTime)"
        if self._told("BooleanStatus", _TERMINATED, ctypes.c_int()):
            return self.ends(f"fmi2Terminated{where}")
        return f"did not make the whole step (fmi2Discard) and stopped{where or ', it does not say when'}: {self.in_parts()}"

    def _told(self, what: str, kind: int, place: Any) -> Any:
        """What the FMU says of its last step (`fmi2StatusKind`); None if it does not."""
        try:
            function = self.function(f"Get{what}", ctypes.c_int, _pointer, ctypes.c_int, _pointer)
        except AttributeError:
            return None
        return place.value if function(self.instance, kind, ctypes.byref(place)) <= WARNING else None

    def compiled(self, inputs: Sequence[Group], outputs: Sequence[Group]) -> Addresses:
        """Addresses for the compiled loop, whose calls are those of FMI 2.0."""
        return Addresses(self.instance.value or 0, address(self.do_step), [_block(g) for g in inputs], [_block(g) for g in outputs])


def _block(group: Group) -> BlockData:
    return BlockData(str(group.buffer.dtype), address(group.function), group.references.ctypes.data, group.buffer.ctypes.data, group.places)
