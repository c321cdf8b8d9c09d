"""An FMI 2.0 co-simulation FMU as a slave: three C calls per step on preallocated buffers."""

from __future__ import annotations

import ctypes
import itertools
import os
import tempfile
import weakref
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import fmpy
import fmpy.fmi1
import numpy as np
import numpy.typing as npt
from fmpy import fmi2

from orchestration.errors import SlaveError
from orchestration.fmu_description import open_fmu
from orchestration.native import BlockData
from orchestration.parameters import prepare
from orchestration.slave import FloatArray, ParameterValue, Port, Scalar, inputs, outputs

_STATUS = ("OK", "warning", "discard", "error", "fatal", "pending")
_WARNING, _FATAL = 1, 4
_MESSAGES = 50  # last log messages kept for error texts
_PROBLEMS = ("logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal")
_BUFFER = {"real": np.float64, "integer": np.int32, "boolean": np.int32}
_CALL = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_void_p)
_DO_STEP = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int)

# The proxy that formats printf messages knows ONE logger for the whole process, so there is one here,
# which finds the instance by its environment pointer.
_instances: weakref.WeakValueDictionary[int, FmuSlave] = weakref.WeakValueDictionary()
_numbers = itertools.count(1)


def _log(environment: int | None, instance: bytes, status: int, category: bytes, message: bytes) -> None:
    slave = _instances.get(environment or 0)
    if slave is None:  # an FMU that somebody else runs through FMPy
        fmpy.fmi1.printLogMessage(environment, instance, status, category, message)
    else:
        slave.messages.append((status, (message or b"").decode("utf-8", "replace").rstrip()))


_LOGGER = fmi2.fmi2CallbackLoggerTYPE(_log)
_ALLOCATE = fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
_FREE = fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)


class _Group:
    """The variables of one type and direction: value references, a buffer, and where they stand in the flat image."""

    def __init__(self, kind: str, ports: Sequence[Port], references: Mapping[str, int], function: Any) -> None:
        positions = [i for i, p in enumerate(ports) if p.type == kind]
        self.kind, self.count = kind, len(positions)
        together = positions == list(range(positions[0], positions[0] + self.count)) if positions else False
        self.place: Any = slice(positions[0], positions[0] + self.count) if together else np.array(positions, dtype=np.intp)
        """Index of these variables in the flat image."""
        self.references = np.array([references[ports[i].name] for i in positions], dtype=np.uint32)
        self.buffer: npt.NDArray[Any] = np.zeros(self.count, dtype=_BUFFER[kind])
        self.function = function
        self.place_of_each = tuple(positions)
        self.arguments = (self.references.ctypes.data, self.count, self.buffer.ctypes.data)


class FmuSlave:
    """An FMI 2.0 co-simulation FMU. Its temporary folder lives until `close`.

    Opening raises SlaveError with one clear sentence (see `fmu_description.open_fmu`); an FMI call
    that fails raises SlaveError with the call, its status and the FMU's own log messages.
    """

    def __init__(self, file: str | Path, name: str | None = None) -> None:
        self._dead = True  # no FMI call is allowed (before instantiation, after a fatal, after closing)
        self._folder = tempfile.TemporaryDirectory(prefix="robomill_fmu_", ignore_cleanup_errors=True)
        self.messages: deque[tuple[int, str]] = deque(maxlen=_MESSAGES)
        try:
            self.description = open_fmu(Path(file), Path(self._folder.name).resolve())
            self._name = name or self.description.identifier
            self._fmu = self._load()
        except BaseException:
            self._folder.cleanup()
            raise
        self._parameters: dict[str, Scalar] = {}
        self._number = next(_numbers)
        _instances[self._number] = self
        self._callbacks = fmi2.fmi2CallbackFunctions(_LOGGER, _ALLOCATE, _FREE, componentEnvironment=self._number)
        if not self.description.made_by_pythonfmu:
            # pythonfmu hands over finished texts: a per cent sign in one would be formatted with garbage
            fmi2.addLoggerProxy(ctypes.byref(self._callbacks))
        self._initialising = self._stepped = self._closed = False
        self._states: list[Any] = []
        dll, ports, references = self._fmu.dll, self.description.ports, self.description.references
        kinds = {"real": "Real", "integer": "Integer", "boolean": "Boolean"}
        self._inputs = [_Group(k, inputs(ports), references, _CALL((f"fmi2Set{f}", dll))) for k, f in kinds.items()]
        self._outputs = [_Group(k, outputs(ports), references, _CALL((f"fmi2Get{f}", dll))) for k, f in kinds.items()]
        self._inputs, self._outputs = [g for g in self._inputs if g.count], [g for g in self._outputs if g.count]
        self._do_step = _DO_STEP(("fmi2DoStep", dll))

    @property
    def name(self) -> str:
        """Name of the instance."""
        return self._name

    @property
    def ports(self) -> tuple[Port, ...]:
        """Inputs, outputs and parameters in the order of the model description."""
        return self.description.ports

    def _load(self) -> Any:
        here = Path.cwd()
        try:
            return fmi2.FMU2Slave(
                guid=self.description.guid,
                modelIdentifier=self.description.identifier,
                unzipDirectory=str(self.description.folder),
                instanceName=self._name,
            )
        except Exception as error:  # FMPy raises bare Exception, AttributeError for a function that is not there
            raise SlaveError(f"{self.description.file}: its binary cannot be loaded: {error}") from None
        finally:
            os.chdir(here)  # FMPy leaves the process in the binary's folder when loading fails

    def configure(self, parameters: Mapping[str, ParameterValue]) -> None:
        """Take parameters (elements or whole arrays) for the next `initialise`."""
        self._parameters.update(prepare(self._name, self.ports, parameters))

    def initialise(self, start: float, stop: float, step: float) -> None:
        """Instantiate, set parameters, enter initialisation. A second call starts a fresh instance."""
        if self._stepped or self._initialising:
            self._free_instance()
        self.messages.clear()
        try:
            self._fmu.instantiate(callbacks=self._callbacks, loggingOn=True)
        except Exception:
            raise SlaveError(f"component {self._name!r}: fmi2Instantiate failed" + self._log_text()) from None
        self._dead = False
        self._component = ctypes.c_void_p(self._fmu.component)
        self._log_only_problems()
        self._set_parameters()
        self._call("fmi2SetupExperiment", 0, 0.0, start, int(np.isfinite(stop)), stop if np.isfinite(stop) else 0.0)
        self._call("fmi2EnterInitializationMode")
        self._initialising, self._stepped = True, False

    def _log_only_problems(self) -> None:
        """Ask for the categories of warnings and errors where the FMU has them: a chatty one costs time in every step."""
        names = [n.encode() for n in self.description.log_categories if n in _PROBLEMS]
        # pythonfmu reports its own errors without a category, so a choice would hide them; a failure only means more messages
        if names and not self.description.made_by_pythonfmu:
            self._fmu._functions["fmi2SetDebugLogging"](self._fmu.component, 1, len(names), (ctypes.c_char_p * len(names))(*names))

    def _set_parameters(self) -> None:
        types = {p.name: p.type for p in self.ports}
        for name, value in self._parameters.items():
            reference = (ctypes.c_uint * 1)(self.description.references[name])
            kind = types[name]
            if kind == "string":
                self._call("fmi2SetString", reference, 1, (ctypes.c_char_p * 1)(str(value).encode()))
            elif kind == "real":
                self._call("fmi2SetReal", reference, 1, (ctypes.c_double * 1)(float(value)))
            else:
                self._call(f"fmi2Set{kind.capitalize()}", reference, 1, (ctypes.c_int * 1)(int(value)))

    def set_inputs(self, values: FloatArray) -> None:
        """One fmi2Set call per type that occurs among the inputs."""
        if self._dead:
            self._refuse()
        for group in self._inputs:
            group.buffer[:] = values[group.place]
            status = group.function(self._component, *group.arguments)
            if status > _WARNING:
                self._failed(f"fmi2Set{group.kind.capitalize()}", status)

    def leave_initialisation(self) -> None:
        """Leave initialisation before the first step does, if that has not happened: a state of later on can be set then."""
        if self._initialising:
            self._call("fmi2ExitInitializationMode")
            self._initialising, self._stepped = False, True

    def step(self, t: float, h: float) -> None:
        """fmi2DoStep from `t` to `t + h` [s]; the first one leaves initialisation."""
        if self._dead:
            self._refuse()
        if self._initialising:
            self.leave_initialisation()
        status = self._do_step(self._component, t, h, 0)
        if status > _WARNING:
            self._failed(f"fmi2DoStep(t = {t:.9g}, h = {h:.9g})", status)

    def get_outputs(self, out: FloatArray) -> None:
        """One fmi2Get call per type that occurs among the outputs."""
        if self._dead:
            self._refuse()
        for group in self._outputs:
            status = group.function(self._component, *group.arguments)
            if status > _WARNING:
                self._failed(f"fmi2Get{group.kind.capitalize()}", status)
            out[group.place] = group.buffer

    def native(self) -> NativeFmu:
        """Addresses for compiled code (see `orchestration.native`); the instance has made its first step."""
        return NativeFmu(self)

    def failure(self, call: str, status: int) -> SlaveError:
        """The error of a call that returned `status`; after a fatal one no further call is made."""
        try:
            self._failed(call, status)
        except SlaveError as error:
            return error
        raise AssertionError("unreachable")

    def get_state(self) -> Any:
        """The state as (phase, bytes), or (phase, pointer) where the FMU cannot serialise it."""
        if not self.description.can_save_state:
            file = self.description.file.name
            raise SlaveError(f"component {self._name!r}: {file} cannot save its state (canGetAndSetFMUstate is false)")
        pointer = ctypes.c_void_p()
        self._call("fmi2GetFMUstate", ctypes.byref(pointer))
        phase = (self._initialising, self._stepped)
        if not self.description.can_serialise_state:
            self._states.append(pointer)
            return phase, pointer
        size = ctypes.c_size_t()
        self._call("fmi2SerializedFMUstateSize", pointer, ctypes.byref(size))
        buffer = ctypes.create_string_buffer(size.value)
        self._call("fmi2SerializeFMUstate", pointer, buffer, size)
        self._call("fmi2FreeFMUstate", ctypes.byref(pointer))
        return phase, buffer.raw

    def set_state(self, state: Any) -> None:
        """Go back to a state from `get_state`."""
        phase, saved = state
        if self._initialising and not phase[0]:  # many FMUs cannot go on from later on while they are in initialisation
            self.leave_initialisation()
        if isinstance(saved, bytes):
            pointer = ctypes.c_void_p()
            self._call("fmi2DeSerializeFMUstate", ctypes.create_string_buffer(saved, len(saved)), len(saved), ctypes.byref(pointer))
            self._call("fmi2SetFMUstate", pointer)
            self._call("fmi2FreeFMUstate", ctypes.byref(pointer))
        else:
            self._call("fmi2SetFMUstate", saved)
        self._initialising, self._stepped = phase

    def close(self) -> None:
        """Terminate, free the instance, unload the library and remove the temporary folder."""
        if self._closed:
            return
        self._closed = True
        self._free_instance()
        self._fmu.freeLibrary()
        self._folder.cleanup()

    def _free_instance(self) -> None:
        if not self._dead:
            for pointer in self._states:
                self._fmu.fmi2FreeFMUstate(self._fmu.component, ctypes.byref(pointer))
            if self._stepped:
                self._fmu._functions["fmi2Terminate"](self._fmu.component)  # its status is of no use any more
            if not self._dead:
                self._fmu.fmi2FreeInstance(self._fmu.component)
        self._states.clear()
        self._dead = True

    def _call(self, function: str, *arguments: Any) -> None:
        if self._dead:
            self._refuse()
        status = self._fmu._functions[function](self._fmu.component, *arguments)
        if status > _WARNING:
            self._failed(function, status)

    def _refuse(self) -> None:
        raise SlaveError(f"component {self._name!r}: is not running (not initialised, closed, or after a fatal error)")

    def _failed(self, function: str, status: int) -> None:
        # After a fatal error FMI allows no further call, not even to free the instance: the FMU may crash the process.
        self._dead = status == _FATAL
        word = _STATUS[status] if 0 <= status < len(_STATUS) else "not a status of FMI"
        raise SlaveError(f"component {self._name!r}: {function} returned {status} ({word})" + self._log_text())

    def _log_text(self) -> str:
        """The FMU's messages for an error text: those that are warnings or worse if there are any, else the last few."""
        bad = [text for status, text in self.messages if status >= _WARNING]
        shown = bad[-10:] or [text for _, text in self.messages][-5:]
        if not shown:
            return "; it logged nothing"
        return "; it says:\n" + "\n".join("  " + line for text in shown for line in text.splitlines())


class NativeFmu:
    """The C functions of an FMU's instance, by address."""

    limit = _WARNING

    def __init__(self, slave: FmuSlave) -> None:
        self._slave = slave
        self.instance = slave._component.value or 0
        self.step = _address(slave._do_step)
        self.inputs = [_block(g) for g in slave._inputs]
        self.outputs = [_block(g) for g in slave._outputs]

    def failed(self, what: str, block: int, status: int, t: float, h: float) -> SlaveError:
        """The error of the call, with the FMU's messages."""
        if what == "step":
            return self._slave.failure(f"fmi2DoStep(t = {t:.9g}, h = {h:.9g})", status)
        group = (self._slave._inputs if what == "inputs" else self._slave._outputs)[block]
        return self._slave.failure(f"fmi2{'Set' if what == 'inputs' else 'Get'}{group.kind.capitalize()}", status)


def _block(group: _Group) -> BlockData:
    kind = "float64" if group.kind == "real" else "int32"
    return BlockData(kind, _address(group.function), group.references.ctypes.data, group.buffer.ctypes.data, group.place_of_each)


def _address(function: Any) -> int:
    return ctypes.cast(function, ctypes.c_void_p).value or 0
