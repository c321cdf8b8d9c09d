"""One instance of a model: its record, checked access to it, initialisation, steps, state. Every Python face is built on it."""

from __future__ import annotations

import math
import operator
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from robomill.fmus.interface import WORD, Interface, Port
from robomill.models.model.declaration import FloatArray, Model, point, record
from robomill.models.model.model_code import model_code
from robomill.models.model.table import Table, from_file, from_rows

DEFAULT_STEP = 0.004
"""Communication step that the model descriptions name [s]."""


class ComponentError(RuntimeError):
    """What a component refuses or cannot do; the text names component, variable or time, value and what is expected.

    Remedy: correct the value that it names, or what is connected to the input; after a failed step reset the component.
    """


class TableState(NamedTuple):
    """What a state says about a table. Its rows are in a file or built in; rows that were given as such are in the state."""

    path: str
    digest: str
    rows: FloatArray | None


class State(NamedTuple):
    """A copy of everything an instance knows. No address is in it: a table is known by its file and the hash of its rows."""

    words: bytes
    stale: bool
    running: bool
    tables: tuple[TableState, ...]
    """In the order of the declaration."""


class Instance:
    """A record with its functions. Compiled by default; plain Python on request or without Numba (`compiled` tells)."""

    def __init__(self, interface: Interface, name: str | None = None, plain: bool = False, tables: Path | None = None) -> None:
        """`tables`: a folder whose NAME.npy holds the built-in rows of the table NAME, those of an FMU; None: those of the model."""
        self.interface = interface
        self._folder = tables
        self.model: Model = interface.model
        self.name = name or self.model.name
        self.plain = plain
        self.data = self.model.new()
        self.floats: FloatArray = self.data.view(np.float64)
        self.integers: npt.NDArray[np.int64] = self.data.view(np.int64)
        self.tables: dict[str, Table] = dict(self.model.built_in)
        """What the record points to."""
        self.running = False
        """Whether the first step has been taken."""
        self.stale = True
        """Whether `init` has to run before outputs are read."""
        self._functions: tuple[Any, Any, Any] | None = None
        reals = [p.reference for p in interface.outputs if p.type == "real"]
        self._real_outputs = self.floats[min(reals, default=0) : max(reals, default=-1) + 1]
        self._finite = np.zeros(len(self._real_outputs), dtype=np.bool_)

    @property
    def compiled(self) -> bool:
        """Whether the compiled functions run; compiles or loads them if that has not happened."""
        self._load()
        return not self.plain

    def _load(self) -> tuple[Any, Any, Any]:
        """`init`, `step` and what they take: the address of the record (compiled) or the record (plain)."""
        if self._functions is None:
            if not self.plain:
                try:
                    code = model_code(self.model)  # loaded here rather than in the first step
                    self._functions = code.init, code.step, self.data.ctypes.data
                except ImportError:
                    self.plain = True
                except ValueError as error:  # functions that cannot be compiled
                    raise ComponentError(f"{self.name}: {error}") from None
            if self.plain:
                self._functions = (*self.model.plain(), record(self.data))
        assert self._functions is not None
        return self._functions

    # Values

    def get(self, port: Port) -> float | int | bool | str:
        """Value of a port [unit]."""
        if port.type == "real":
            return float(self.floats[port.reference])
        if port.type == "string":
            return self.tables[port.name].path
        value = int(self.integers[port.reference])
        return bool(value) if port.type == "boolean" else value

    def set(self, port: Port, value: Any) -> None:
        """Set an input or a parameter. ComponentError says what is wrong: type, not finite, out of bounds, fixed while running."""
        if port.causality == "output":
            raise ComponentError(f"{self.name}: {port.name} is an output and cannot be set; set an input or a parameter")
        if port.causality == "parameter" and self.running and port.variability == "fixed":
            raise ComponentError(
                f"{self.name}: parameter {port.name} is fixed: it can be set before the first step only; set it before initialisation"
            )
        if port.type == "string":
            self.load_table(port.name, value)
            return
        number = self._number(port, value)
        if port.type == "real":
            self.floats[port.reference] = number
        else:
            self.integers[port.reference] = number
        self.stale = True

    def _number(self, port: Port, value: Any) -> float | int:
        """The value as it is stored, after all checks."""
        if isinstance(value, np.generic):
            value = value.item()
        shown = f"{self.name}: {port.causality} {port.name} = {value!r}" + (f" {port.unit}" if port.unit not in (None, "1") else "")
        number: float | int
        try:
            number = float(value) if port.type == "real" else operator.index(int(value) if value == int(value) else value)
        except (TypeError, ValueError, OverflowError):
            raise ComponentError(f"{shown}: expected a {'number' if port.type == 'real' else 'whole number'}") from None
        if not math.isfinite(number):
            raise ComponentError(f"{shown} is not a finite number")
        low, high = (0, 1) if port.type == "boolean" else (port.minimum, port.maximum)
        if port.type == "boolean" or port.causality == "parameter":  # bounds of real inputs are for information: loops may overshoot
            if low is not None and number < low:
                raise ComponentError(f"{shown} is below its minimum {low:.9g}" + _unit(port))
            if high is not None and number > high:
                raise ComponentError(f"{shown} is above its maximum {high:.9g}" + _unit(port))
        return number

    def load_table(self, name: str, source: str | Path | Sequence[Any] | FloatArray | None) -> None:
        """Fill the table `name` from a .npy file or rows; "" or None puts the built-in rows back. ComponentError says what does not fit."""
        if self.running:
            raise ComponentError(
                f"{self.name}: table {name} is fixed: it can be set before the first step only; set it before initialisation"
            )
        self._put_table(name, self._read_table(name, source))
        self.stale = True

    def _read_table(self, name: str, source: str | Path | Sequence[Any] | FloatArray | None) -> Table:
        columns = self.model.variable(name).shape[0]
        path = str(source) if isinstance(source, str | Path) else ""
        try:
            if path:
                return from_file(path, columns)
            return self._built_in(name, columns) if source is None or isinstance(source, str) else from_rows(source, columns)
        except (OSError, ValueError, TypeError, MemoryError) as error:
            raise ComponentError(f"{self.name}: table {name}{f' from {path!r}' if path else ''}: {error}") from None

    def _put_table(self, name: str, table: Table) -> None:
        self.tables[name] = table
        point(self.data, name, table)

    def load_built_in(self) -> None:
        """The built-in rows from the folder, for the tables that nothing was loaded into. ComponentError says what does not fit."""
        for name, table in self.tables.items():
            if not table.path:
                self.load_table(name, "")

    def _built_in(self, name: str, columns: int) -> Table:
        if self._folder is None:
            return self.model.built_in[name]
        return replace(from_file(self._folder / f"{name}.npy", columns), path="")

    # Running

    def init(self) -> None:
        """States and outputs at t = 0 from parameters and inputs. ComponentError with the model's message."""
        function, _, argument = self._load()
        try:
            status = function(argument)
        except Exception as error:
            raise ComponentError(f"{self.name}: {type(error).__name__} during initialisation: {error}") from error
        if status != 0:
            raise ComponentError(self._message(status, 0.0) + " (during initialisation)")
        self._check_outputs("after initialisation")
        self.stale = False

    def step(self, t: float, h: float) -> None:
        """From t to t + h [s]; nothing happens in a step that is `rounding`.

        ComponentError with the model's message; the instance then needs a state or a reset.
        """
        t, h = float(t), float(h)
        if not 0.0 < h < math.inf or not math.isfinite(t):
            raise ComponentError(f"{self.name}: step from t = {t} s of h = {h} s: expected a finite time and a positive step")
        self.leave_initialisation()
        if h <= rounding(t):
            return
        _, function, argument = self._load()
        try:
            status = function(argument, t, h)
        except Exception as error:
            raise ComponentError(f"{self.name}: {type(error).__name__} in the step from t = {t:.9g} s: {error}") from error
        if status != 0:
            raise ComponentError(self.status_text(status, t, h))
        if not all_finite(self._real_outputs, self._finite):
            self._check_outputs(f"at t = {t + h:.9g} s")

    def leave_initialisation(self) -> None:
        """What the first step does before it steps; from then on the words of the record are the whole state."""
        if not self.running:
            if self.stale:
                self.init()
            self.running = True

    def status_text(self, status: int, t: float, h: float) -> str:
        """The text for a status of the step from t to t + h [s]."""
        return self._message(status, t) + f" (step from t = {t:.9g} s, h = {h:.9g} s)"

    def _message(self, status: int, t: float) -> str:
        text = self.model.message(status, record(self.data), t)
        return text if self.name == self.model.name else f"{self.name} ({text.partition(':')[0]}):{text.partition(':')[2]}"

    def _check_outputs(self, when: str) -> None:
        """Refuse outputs that are not finite."""
        for port in self.interface.outputs:
            if port.type == "real" and not math.isfinite(self.floats[port.reference]):
                raise ComponentError(f"{self.name}: output {port.name} is {self.floats[port.reference]} {when}")

    # State

    def state(self) -> State:
        """A copy of everything."""
        words = self.data.view(np.uint8)[: self.interface.tables_at].tobytes()
        return State(words, self.stale, self.running, tuple(self._table_state(name, table) for name, table in self.tables.items()))

    def _table_state(self, name: str, table: Table) -> TableState:
        found = bool(table.path) or table is self.model.built_in[name]
        return TableState(table.path, table.digest, None if found else table.rows)

    def restore(self, state: State) -> None:
        """Back to a copy, bit by bit. ComponentError if it is not one of this model, or the rows of a table are no longer to be found."""
        image = self.data.view(np.uint8)
        split = self.interface.tables_at
        if len(state.words) != split or len(state.tables) != len(self.tables):
            raise ComponentError(
                f"{self.name}: a state of {len(state.words)} bytes and {len(state.tables)} tables; "
                f"one of {self.model.name} has {split} and {len(self.tables)}"
            )
        tables = {name: self._find_table(name, kept) for name, kept in zip(self.tables, state.tables, strict=True)}
        image[:split] = np.frombuffer(state.words, np.uint8)
        for name, table in tables.items():
            self._put_table(name, table)
        self.stale, self.running = state.stale, state.running

    def _find_table(self, name: str, kept: TableState) -> Table:
        """The table of a state: that of this instance if it has the same rows, wherever they came from, else read again."""
        if self.tables[name].digest == kept.digest:
            return self.tables[name]
        table = self._read_table(name, kept.rows if kept.rows is not None else kept.path)
        if table.digest != kept.digest:
            where = f"in {kept.path!r} there are" if kept.path else "built in are"
            raise ComponentError(f"{self.name}: table {name}: {where} other rows than when the state was saved; put those back")
        return table

    def reset(self) -> None:
        """As after construction: every variable at its start, built-in tables."""
        self.data[:] = self.model.new()
        self.tables = dict(self.model.built_in)
        self.running, self.stale = False, True


def rounding(t: float) -> float:
    """How far an importer that adds up steps can be from the time t [s] that it means; never half a step.

    It has made t / DEFAULT_STEP additions, each of which rounds by half a unit in the last place of t at most. What is left of the
    last step up to its stop time is then no step: 4e-13 s after 7 s in OMSimulator.
    """
    return min(abs(t) / DEFAULT_STEP * abs(t) * 0.5 * sys.float_info.epsilon, 0.5 * DEFAULT_STEP)


def all_finite(values: FloatArray, scratch: npt.NDArray[np.bool_]) -> bool:
    """Whether there is no NaN or infinity among `values`; a third of the time of `np.isfinite(values).all()`."""
    return b"\0" not in np.isfinite(values, out=scratch).tobytes()


def _unit(port: Port) -> str:
    return f" {port.unit}" if port.unit not in (None, "1") else ""


assert np.dtype(np.float64).itemsize == np.dtype(np.int64).itemsize == WORD
