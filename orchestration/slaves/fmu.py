"""A co-simulation FMU, FMI 2.0 or 3.0, as a slave: three C calls per step on preallocated buffers."""

from __future__ import annotations

import ctypes
import tempfile
import weakref
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from robomill.orchestration.errors import SlaveError
from robomill.orchestration.slaves.description import open_fmu
from robomill.orchestration.slaves.fmi import FATAL, WARNING, Addresses, Fmi
from robomill.orchestration.slaves.fmi2 import Fmi2
from robomill.orchestration.slaves.fmi3 import Fmi3
from robomill.orchestration.slaves.protocol import FloatArray, ParameterValue, Port, Scalar
from robomill.orchestration.system.parameters import prepare

_MESSAGES = 50  # last log messages kept for error texts
_only_once: weakref.WeakValueDictionary[tuple[str, str], FmuSlave] = weakref.WeakValueDictionary()
"""Open FMUs of which a process can have one instance, by identifier and GUID."""
_PROBLEMS = ("logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal")


class FmuSlave:
    """An FMI 2.0 or 3.0 co-simulation FMU. Its temporary folder lives until `close`.

    Opening raises SlaveError with one clear sentence (see `fmu_description.open_fmu`); an FMI call
    that fails raises SlaveError with the call, its status and the FMU's own log messages. `goes_back`: it may be set back to
    before the beginning of its last step, which is made in parts; some FMUs stand still if they are told so.
    """

    def __init__(self, file: str | Path, name: str | None = None, goes_back: bool = False) -> None:
        self._dead = True  # no FMI call is allowed (before instantiation, after a fatal, after closing)
        self._folder = tempfile.TemporaryDirectory(prefix="robomill_fmu_", ignore_cleanup_errors=True)
        self.messages: deque[tuple[int, str]] = deque(maxlen=_MESSAGES)
        try:
            self.description = open_fmu(Path(file), Path(self._folder.name).resolve())
            self._name = name or self.description.identifier
            if self.description.only_once:
                self._claim()
            self._fmi: Fmi = {2: Fmi2, 3: Fmi3}[self.description.fmi](self.description, self._name, self.messages, not goes_back)
            self._inputs, self._outputs = self._fmi.groups("Set", "input"), self._fmi.groups("Get", "output")
        except BaseException:
            self._folder.cleanup()
            raise
        self._parameters: dict[str, Scalar] = {}
        self._initialising = self._stepped = self._closed = False
        self._states: list[Any] = []

    def _claim(self) -> None:
        """Be the one component of this process that runs an FMU of which it can have one instance only."""
        other = _only_once.setdefault((self.description.identifier, self.description.guid), self)
        if other is not self:
            raise SlaveError(
                f"component {self._name!r}: {self.description.file.name} can be instantiated only once per process "
                f"(canBeInstantiatedOnlyOncePerProcess), and component {other.name!r} is that instance; "
                "set isolate = true for one of them: it then runs in a process of its own"
            )

    @property
    def name(self) -> str:
        """Name of the instance."""
        return self._name

    @property
    def ports(self) -> tuple[Port, ...]:
        """Inputs, outputs and parameters in the order of the model description."""
        return self.description.ports

    @property
    def warnings(self) -> tuple[str, ...]:
        """What one should know before it runs."""
        return self.description.warnings

    def configure(self, parameters: Mapping[str, ParameterValue]) -> None:
        """Take parameters, and start values of inputs (elements or whole arrays), for the next `initialise`."""
        if not parameters:
            return
        inputs = {p.name for p in self.ports if p.causality == "input"}
        starts = {name: value for name, value in parameters.items() if name in inputs}
        self._parameters.update(prepare(self._name, self.ports, {k: v for k, v in parameters.items() if k not in starts}))
        self._parameters.update(prepare(self._name, self.ports, starts, causality="input"))

    def initialise(self, start: float, stop: float, step: float) -> None:
        """Instantiate, set parameters, enter initialisation. A second call starts a fresh instance."""
        if self._stepped or self._initialising:
            self._free_instance()
        self.messages.clear()
        if not self._fmi.instantiate():
            raise SlaveError(f"component {self._name!r}: {self._fmi.prefix}{self._fmi.instantiation[0]} failed{self._log_text()}")
        self._dead = False
        self._log_only_problems()
        self._set_parameters()
        for function, arguments in self._fmi.enter(start, stop):
            self._call(function, *arguments)
        self._initialising, self._stepped = True, False

    def _log_only_problems(self) -> None:
        """Ask for the categories of warnings and errors where the FMU has them: a chatty one costs time in every step."""
        names = [n for n in self.description.log_categories if n in _PROBLEMS]
        # pythonfmu reports its own errors without a category, so a choice would hide them; a failure only means more messages
        if names and not self.description.made_by_pythonfmu:
            self._fmi.choose_log(names)

    def _set_parameters(self) -> None:
        """Those that were given; of an array with them its other elements, too, at their starts."""
        for variable in self.description.variables if self._parameters else ():
            if any(p.name in self._parameters for p in variable.ports):
                values = [self._parameters.get(p.name, p.start) for p in variable.ports]
                missing = [p.name for p, v in zip(variable.ports, values, strict=True) if v is None]
                if missing:
                    raise SlaveError(
                        f"component {self._name!r}: parameter {missing[0]!r} has no start value: give all elements of the array"
                    )
                function, arguments = self._fmi.parameter(variable, [v for v in values if v is not None])
                self._call(function, *arguments)

    def set_inputs(self, values: FloatArray) -> None:
        """One call per type that occurs among the inputs."""
        if self._dead:
            self._refuse()
        instance = self._fmi.instance
        for group in self._inputs:
            group.load(values)
            status = group.function(instance, *group.arguments)
            if status > WARNING:
                self._failed(group.name, status)

    def leave_initialisation(self) -> None:
        """Leave initialisation before the first step does, if that has not happened: a state of later on can be set then."""
        if self._initialising:
            self._call("ExitInitializationMode")
            self._initialising, self._stepped = False, True

    def step(self, t: float, h: float) -> None:
        """From `t` to `t + h` [s]; the first one leaves initialisation."""
        if self._dead:
            self._refuse()
        if self._initialising:
            self.leave_initialisation()
        status = self._fmi.step(t, h)
        if status > WARNING:
            self._failed(self._step_text(t, h), status)

    def get_outputs(self, out: FloatArray) -> None:
        """One call per type that occurs among the outputs."""
        if self._dead:
            self._refuse()
        instance = self._fmi.instance
        for group in self._outputs:
            status = group.function(instance, *group.arguments)
            if status > WARNING:
                self._failed(group.name, status)
            out[group.place] = group.buffer

    def native(self) -> NativeFmu | None:
        """Addresses for compiled code (see `orchestration.slaves.native`), None if it cannot call this FMU."""
        found = self._fmi.compiled(self._inputs, self._outputs)
        return None if found is None else NativeFmu(self, found)

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
            raise SlaveError(
                f"component {self._name!r}: {file} cannot save its state (canGetAndSetFMUstate is false)"
                "; use an FMU that can, or a coupling without iteration and checkpoints"
            )
        pointer = ctypes.c_void_p()
        self._call(self._fmi.state.get, ctypes.byref(pointer))
        phase = (self._initialising, self._stepped)
        if not self.description.can_serialise_state:
            self._states.append(pointer)
            return phase, pointer
        size = ctypes.c_size_t()
        self._call(self._fmi.state.size, pointer, ctypes.byref(size))
        buffer = ctypes.create_string_buffer(size.value)
        self._call(self._fmi.state.serialise, pointer, buffer, size)
        self._call(self._fmi.state.free, ctypes.byref(pointer))
        return phase, buffer.raw

    def set_state(self, state: Any) -> None:
        """Go back to a state from `get_state`."""
        phase, saved = state
        if self._initialising and not phase[0]:  # many FMUs cannot go on from later on while they are in initialisation
            self.leave_initialisation()
        if isinstance(saved, bytes):
            pointer = ctypes.c_void_p()
            self._call(self._fmi.state.deserialise, ctypes.create_string_buffer(saved, len(saved)), len(saved), ctypes.byref(pointer))
            self._call(self._fmi.state.set, pointer)
            self._call(self._fmi.state.free, ctypes.byref(pointer))
        else:
            self._call(self._fmi.state.set, saved)
        self._initialising, self._stepped = phase

    def rollback(self) -> RollbackFmu | None:
        """A state that the FMU keeps aside (see `native`); None if it cannot, or forgets to free those that are replaced."""
        return RollbackFmu(self) if self.description.can_save_state and not self.description.made_by_pythonfmu else None

    def close(self) -> None:
        """Terminate, free the instance, unload the library and remove the temporary folder."""
        if self._closed:
            return
        self._closed = True
        if self.description.only_once:
            _only_once.pop((self.description.identifier, self.description.guid), None)
        self._free_instance()
        self._fmi.unload()
        self._folder.cleanup()

    def _free_instance(self) -> None:
        if not self._dead:
            for pointer in filter(None, self._states):
                self._fmi.call(self._fmi.state.free, ctypes.byref(pointer))
            if self._stepped:
                self._fmi.call("Terminate")  # its status is of no use any more
            if not self._dead:
                self._fmi.free()
        self._states.clear()
        self._dead = True

    def _call(self, function: str, *arguments: Any) -> None:
        if self._dead:
            self._refuse()
        status = self._fmi.call(function, *arguments)
        if status > WARNING:
            self._failed(self._fmi.prefix + function, status)

    def _step_text(self, t: float, h: float) -> str:
        return f"{self._fmi.prefix}DoStep(t = {t:.9g}, h = {h:.9g})"

    def _refuse(self) -> None:
        raise SlaveError(f"component {self._name!r}: is not running (not initialised, closed, or after a fatal error); load it anew")

    def _failed(self, function: str, status: int) -> None:
        # After a fatal error FMI allows no further call, not even to free the instance: the FMU may crash the process.
        self._dead = status == FATAL
        raise SlaveError(f"component {self._name!r}: {function} {self._fmi.explain(function, status)}" + self._log_text())

    def _log_text(self) -> str:
        """The FMU's messages for an error text: those that are warnings or worse if there are any, else the last few."""
        bad = [text for status, text in self.messages if status >= WARNING]
        shown = bad[-10:] or [text for _, text in self.messages][-5:]
        if not shown:
            return "; it logged nothing"
        return "; it says:\n" + "\n".join("  " + line for text in shown for line in text.splitlines())


class NativeFmu:
    """The C functions of an FMU's instance, by address."""

    limit = WARNING

    def __init__(self, slave: FmuSlave, found: Addresses) -> None:
        self._slave, self._found, self.final = slave, found, slave._fmi.final
        self.instance, self.step, self.inputs, self.outputs = found.instance, found.step, found.inputs, found.outputs

    def failed(self, what: str, block: int, status: int, t: float, h: float) -> SlaveError:
        """The error of the call, with the FMU's messages."""
        if what == "step":
            return self._slave.failure(self._slave._step_text(t, h), status)
        return self._slave.failure((self._slave._inputs if what == "inputs" else self._slave._outputs)[block].name, status)


class RollbackFmu:
    """A state that the FMU keeps aside in memory of its own, replaced by every `save`."""

    size, limit = 0, WARNING

    def __init__(self, slave: FmuSlave) -> None:
        self._slave, self._pointer = slave, ctypes.c_void_p()
        slave._states.append(self._pointer)  # freed with the instance
        self.instance, self.kept = slave._fmi.instance.value or 0, ctypes.addressof(self._pointer)
        self.get, self.set = (slave._fmi.address(name) for name in (slave._fmi.state.get, slave._fmi.state.set))

    def failed(self, what: str, status: int) -> SlaveError:
        """The error of the call, with the FMU's messages."""
        fmi = self._slave._fmi
        return self._slave.failure(fmi.prefix + (fmi.state.get if what == "save" else fmi.state.set), status)

    def save(self) -> None:
        """Keep the present state."""
        self._slave._call(self._slave._fmi.state.get, ctypes.byref(self._pointer))

    def back(self) -> None:
        """Go back to what is kept."""
        self._slave._call(self._slave._fmi.state.set, self._pointer)
