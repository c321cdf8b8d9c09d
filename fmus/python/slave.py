"""The FMU side of a model in Python: what the pythonfmu library calls, in terms of an `Instance`.

What that library (0.7) does with it, and what follows from that:

- A callback returns normally = OK. There is no way to return `fmi2Error` or a warning.
- `do_step` may return False = `fmi2Discard` plus `fmi2Terminated`: "this slave wants to end here".
  FMPy takes that as a regular end and returns the results so far. An error must not look like that.
- An exception = `fmi2Fatal`, and only its `repr` reaches the importer. The library then also gives
  up its references to instance, class and log, and once more when the instance is freed: a crash.
  So `failure` gives it one more of each beforehand, and an instance survives its errors.
- While the exception is pending the library delivers queued log messages; a logger written in Python
  would run with a foreign exception set. So nothing may be queued when one is raised.
- Log messages, and the text of the exception, go nowhere unless the importer has switched logging on.
  Errors are therefore written to stderr, too.
- `reset` makes a new Python object and crashes if that fails: `__init__` only allocates.
- States are Python objects that the library keeps; their serialisation is asked of the class.
"""

from __future__ import annotations

import ctypes
import json
import sys
import traceback
from array import array
from collections.abc import Callable, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, TypeVar

from robomill.fmus.instance import ComponentError, Instance, State, TableState
from robomill.fmus.interface import Interface, Port, PortType
from robomill.models.model.declaration import Model

_OK, _WARNING = 0, 1
_CATEGORIES = {_OK: "logAll", _WARNING: "logStatusWarning"}
_Method = TypeVar("_Method", bound=Callable[..., Any])


class Failure(Exception):  # noqa: N818  # its repr is what people read
    """An error on its way to the importer: the library shows the `repr`, so that is the text."""

    def __repr__(self) -> str:
        return str(self).replace("%", "%%")  # the importer's logger takes it as a printf format


class Message(NamedTuple):
    """An entry of the log that the library fetches."""

    status: int
    category: str
    msg: str


class BadState(NamedTuple):
    """Stands for bytes that are no state of this FMU until an instance can complain."""

    reason: str


def _guarded(method: _Method) -> _Method:
    """Turn whatever a callback raises into a `Failure` with everything in its text."""

    @wraps(method)
    def guarded(self: Slave, *arguments: Any) -> Any:
        try:
            return method(self, *arguments)
        except BaseException as error:  # Ctrl-C, too, must not reach the library as it is
            failure = self.failure(error)
        raise failure  # outside the handler: without a context

    return guarded  # type: ignore[return-value]  # same arguments and results


class Fmi2Slave:
    """The library looks for a class derived from one of this name."""


class Slave(Fmi2Slave):
    """One FMU instance. `slave_class` derives the class of a component from it."""

    interface: ClassVar[Interface]
    identity: ClassVar[str]
    """Content hash of the FMU: its states fit no other."""
    notes: ClassVar[tuple[str, ...]] = ()
    """Warnings for the log of every instance, such as that a cache could not be written."""

    def __init__(self, instance_name: str = "", resources: str = "", **_: Any) -> None:
        self._log: list[Message] = [Message(_WARNING, _CATEGORIES[_WARNING], note) for note in self.notes]
        self._instance = Instance(self.interface, instance_name or None, tables=Path(resources) / "tables" if resources else None)
        self._inputs_end = len(self.interface.inputs)
        self._reals = self._instance.floats.data
        self._images: dict[tuple[int, ...], slice | None] = {}
        self._initialised = False
        self._failed = ""

    # Log and errors

    def _get_log_queue(self) -> list[Message]:
        return self._log

    def log(self, text: str, status: int = _OK) -> None:
        """Queue a message: it is delivered after the callback, if the importer has switched logging on."""
        self._log.append(Message(status, _CATEGORIES[status], text.replace("%", "%%")))

    def failure(self, error: BaseException) -> Failure:
        """Make the exception for the library: text, traceback unless it is a plain refusal, messages not yet delivered."""
        text = str(error)
        if not isinstance(error, ComponentError) or error.__cause__ is not None:
            text = f"{self._instance.name}: {text}\n" + "".join(traceback.format_exception(error))
        text = "\n".join([*(m.msg for m in self._log if m.status != _OK), text])
        self._log.clear()
        for lost in (type(self), self, self._log):
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(lost))
        if sys.stderr is not None:
            print(f"[fmi2Fatal] {text}", file=sys.stderr, flush=True)
        return Failure(text)

    # Phases

    @_guarded
    def setup_experiment(self, start: float, stop: float | None, tolerance: float | None) -> None:
        """Start and stop time [s]; models take any. Tables that no file was named for get the rows that the FMU carries."""
        self._instance.load_built_in()

    @_guarded
    def enter_initialization_mode(self) -> None:
        """Compile (or load what was compiled earlier), so that it does not take place in the first step."""
        if not self._instance.compiled:
            self.log(f"{self._instance.name}: Numba is not installed here; the model runs in plain Python, some 100 times slower", _WARNING)

    @_guarded
    def exit_initialization_mode(self) -> None:
        """Compute states and outputs for t = start."""
        if self._instance.stale:
            self._instance.init()
        self._initialised = self._instance.running = True

    @_guarded
    def do_step(self, t: float, h: float) -> bool:
        """From t to t + h [s]. After an error the instance needs a reset or an earlier state."""
        if not self._initialised:
            raise ComponentError(f"{self._instance.name}: a step before the end of initialisation; call exitInitializationMode first")
        if self._failed:
            raise ComponentError(
                f"{self._instance.name}: cannot go on after an error; reset it or restore a state. The error was: {self._failed}"
            )
        try:
            self._instance.step(t, h)
        except ComponentError as error:
            self._failed = str(error)
            raise
        return True

    @_guarded
    def terminate(self) -> None:
        """Nothing to do."""

    # Values

    @_guarded
    def get_real(self, references: list[int]) -> list[float]:
        """Values [unit]; during initialisation those that follow from the inputs set so far."""
        if self._instance.stale and not self._instance.running:
            self._refresh(references)
        key = tuple(references)
        image = self._images[key] if key in self._images else self._image(key)
        if image is not None:
            values: list[float] = self._reals[image].tolist()  # type: ignore[assignment]  # a view of doubles
            return values
        reals = self._reals
        return [reals[i] for i in references]

    @_guarded
    def set_real(self, references: list[int], values: list[float]) -> None:
        """Inputs and parameters [unit]; one that is refused is named and nothing is set after it."""
        key = tuple(references)
        image = self._images[key] if key in self._images else self._image(key)
        if image is not None and image.stop <= self._inputs_end:
            total = sum(values)
            if total - total == 0.0:  # all are finite
                self._reals[image] = array("d", values)
                self._instance.stale = True
                return
        for reference, value in zip(references, values, strict=True):
            self._instance.set(self._port(reference, "real"), value)

    def _image(self, references: tuple[int, ...]) -> slice | None:
        """The part of the record that these value references are, if they are one; looked up once for each set of references."""
        for reference in references:
            self._port(reference, "real")
        first = references[0] if references else 0
        whole = references == tuple(range(first, first + len(references)))
        self._images[references] = slice(first, first + len(references)) if whole else None
        return self._images[references]

    def _port(self, reference: int, *types: PortType) -> Port:
        port = self.interface.by_reference.get(reference)
        if port is None or port.type not in types:
            found = f"is {port.name}, a {port.type}" if port else "does not exist"
            raise ComponentError(f"{self._instance.name}: value reference {reference} {found}; expected a {' or '.join(types)}")
        return port

    def _get(self, references: Sequence[int], kind: PortType) -> list[Any]:
        if self._instance.stale and not self._instance.running:
            self._refresh(references)
        return [self._instance.get(self._port(r, kind)) for r in references]

    def _set(self, references: Sequence[int], values: Sequence[Any], kind: PortType) -> None:
        for reference, value in zip(references, values, strict=True):
            self._instance.set(self._port(reference, kind), value)

    def _refresh(self, references: Sequence[int]) -> None:
        """Outputs read during initialisation follow the inputs set so far."""
        ports = self.interface.by_reference
        if any(r in ports and ports[r].causality == "output" for r in references):
            self._instance.init()

    @_guarded
    def get_integer(self, references: list[int]) -> list[int]:
        """Values."""
        return self._get(references, "integer")

    @_guarded
    def get_boolean(self, references: list[int]) -> list[bool]:
        """Values."""
        return self._get(references, "boolean")

    @_guarded
    def get_string(self, references: list[int]) -> list[str]:
        """Paths of tables, empty for the built-in rows."""
        return self._get(references, "string")

    @_guarded
    def set_integer(self, references: list[int], values: list[int]) -> None:
        """Inputs and parameters."""
        self._set(references, values, "integer")

    @_guarded
    def set_boolean(self, references: list[int], values: list[bool]) -> None:
        """Inputs and parameters."""
        self._set(references, values, "boolean")

    @_guarded
    def set_string(self, references: list[int], values: list[str]) -> None:
        """Paths of tables: absolute or relative to the working directory; empty = the built-in rows."""
        self._set(references, values, "string")

    # State

    @_guarded
    def _get_fmu_state(self) -> tuple[State, bool, str]:
        return self._instance.state(), self._initialised, self._failed

    @_guarded
    def _set_fmu_state(self, state: tuple[State, bool, str] | BadState) -> None:
        if isinstance(state, BadState):
            raise ComponentError(f"{self._instance.name}: {state.reason}")
        self._instance.restore(state[0])
        self._initialised, self._failed = state[1:]

    @classmethod
    def _fmu_state_to_bytes(cls, state: tuple[State, bool, str] | BadState) -> bytes:
        """A line of JSON, then the words of the record. Tables come from files, so path and hash say what they are."""
        if isinstance(state, BadState):
            return b""
        words, stale, running, tables = state[0]
        header = {"fmu": cls.identity, "stale": stale, "running": running, "tables": [(t.path, t.digest) for t in tables]}
        return b"\n".join((json.dumps({**header, "initialised": state[1], "failed": state[2]}).encode(), words))

    @classmethod
    def _fmu_state_from_bytes(cls, serialised: bytes) -> tuple[State, bool, str] | BadState:
        try:
            line, words = serialised.split(b"\n", 1)
            header = json.loads(line)
            if header["fmu"] != cls.identity:
                return BadState(f"the state is one of FMU {header['fmu']}; this is {cls.identity}")
            tables = tuple(TableState(path, digest, None) for path, digest in header["tables"])
            return State(words, header["stale"], header["running"], tables), header["initialised"], header["failed"]
        except Exception as error:
            return BadState(f"not a state of this FMU ({type(error).__name__}: {error})")


def slave_class(model: Model, identity: str, notes: Sequence[str] = ()) -> type[Slave]:
    """The slave class of a component. `notes` become warnings in the log of every instance."""
    return type(
        "ComponentSlave", (Slave,), {"interface": Interface(model), "identity": identity, "notes": tuple(notes), "__module__": __name__}
    )
