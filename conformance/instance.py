"""An unpacked FMU and its instances, as the checks see them: elements of variables, rows of inputs, one log."""

from __future__ import annotations

import csv
import ctypes
import itertools
import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from .calls import CallFailed, Calls, Type
from .fmi2 import Fmi2
from .fmi3 import Fmi3

STEPS = 20
STEP = 0.004
"""Communication step where the FMU does not name one [s]."""
_VERSIONS: Mapping[str, type[Calls]] = {"2": Fmi2, "3": Fmi3}
"""By the first digit of the version of FMI."""
_LABELS = ("OK", "warning", "discard", "error", "fatal", "pending")


class Variable:
    """A variable of the model description with its elements: one, or in FMI 3.0 as many as the array has."""

    def __init__(self, described: Any, of_type: Type) -> None:
        declared = described.declaredType
        self.name: str = described.name
        self.type = of_type
        self.reference = int(described.valueReference)
        self.is_array = bool(described.dimensions)
        self.minimum = _bound(described.min, declared and declared.min, -math.inf)
        self.maximum = _bound(described.max, declared and declared.max, math.inf)
        shape = described.shape if self.is_array else ()
        names = [
            f"{self.name}[{','.join(map(str, index))}]" if index else self.name
            for index in itertools.product(*(range(1, length + 1) for length in shape))
        ]
        starts = described.start.split() if self.is_array and described.start else [described.start]
        if len(starts) == 1:
            starts *= len(names)
        if len(starts) != len(names):
            raise CallFailed(f"array {self.name} has {len(names)} elements and {len(starts)} start values")
        self.elements = tuple(Element(name, self, _start(text, of_type)) for name, text in zip(names, starts, strict=True))


class Element(NamedTuple):
    """One value of a variable, and its start value (text for strings)."""

    name: str
    variable: Variable
    start: Any


def _bound(own: str | None, declared: str | None, default: float) -> float:
    text = own if own is not None else declared
    return default if text is None else float(text)


def _start(text: str | None, of_type: Type) -> Any:
    if of_type.kind == "string":
        return text or ""
    if not text:
        return 0.0
    return {"true": 1.0, "false": 0.0}[text] if text in ("true", "false") else float(of_type.c(_number(text, of_type)).value)


def _number(value: Any, of_type: Type) -> Any:
    """As ctypes wants it for a C type."""
    if of_type.kind == "string":
        return str(value).encode()
    return float(value) if of_type.kind == "real" else int(value)


class Fmu:
    """An unpacked FMU and what the checks need to know about it. `CallFailed` if its library cannot be loaded."""

    def __init__(self, path: Path) -> None:
        import fmpy

        self.folder = Path(fmpy.extract(str(path), unzipdir=str(Path("fmu").absolute())))
        self.md: Any = fmpy.read_model_description(str(self.folder), validate=False)
        self.flags: Any = self.md.coSimulation
        self.log: list[str] = []
        """Messages of all instances since the check began."""
        self.calls = _VERSIONS[self.md.fmiVersion[0]](self.folder, self.md, self.log)
        self.inputs = [e for v in self._variables("input") if v.type.kind != "string" for e in v.elements]
        self.outputs = [e for v in self._variables("output") if v.type.kind != "string" for e in v.elements]
        self.parameters = [e for v in self._variables("parameter") for e in v.elements]
        default = self.md.defaultExperiment
        self.h = float(default.stepSize) if default is not None and default.stepSize else STEP
        self.start = float(default.startTime) if default is not None and default.startTime else 0.0
        self.parameter_values: dict[str, Any] = {}
        self.reference_rows: list[list[float]] = []
        self.rows = self._excitation()
        self.instances = 0
        """How many were made in this process."""
        self.trajectory: list[list[float]] | None = None
        """Outputs of the first run, which the other checks compare with."""

    def _variables(self, causality: str) -> Iterator[Variable]:
        """Those that can be set and read outside of event mode; arrays of texts, whose starts FMPy does not read, are left out."""
        for v in self.md.modelVariables:
            if v.causality == causality and v.type in self.calls.types and not v.clocks and not (v.type == "String" and v.dimensions):
                yield Variable(v, self.calls.types[v.type])

    def _excitation(self) -> list[list[float]]:
        """Inputs per step, in the order of `inputs`."""
        reference = self.folder / "documentation" / "reference"
        if (reference / "in.csv").is_file() and (reference / "out.csv").is_file():
            if (reference / "parameters.json").is_file():
                values = json.loads((reference / "parameters.json").read_text(encoding="utf-8"))
                self.parameter_values = {n: str(reference / v) if isinstance(v, str) else v for n, v in values.items()}
            self.reference_rows = _columns(reference / "out.csv", [e.name for e in self.outputs])
            return _columns(reference / "in.csv", [e.name for e in self.inputs])
        return [self.moved(k) for k in range(STEPS)]

    def moved(self, k: int, phase: float = 0.0) -> list[float]:
        """Start values of the inputs; reals moved by at most 0.1 % (0.0001 around zero), the others kept."""
        row = []
        for i, e in enumerate(self.inputs):
            value = e.start
            if e.variable.type.kind == "real":
                value += (abs(value) or 0.1) * 1e-3 * math.sin(0.3 * k + i + phase)
                value = min(max(value, e.variable.minimum), e.variable.maximum)
            row.append(value)
        return row


def _columns(file: Path, names: Sequence[str]) -> list[list[float]]:
    """Values of the elements `names` by row: each in a column of its own, or an array in one, its elements separated by blanks."""
    with file.open(encoding="utf-8", newline="") as stream:
        head, *rows = csv.reader(stream)
    places: list[tuple[int, int]] = []
    """(column, position within it)."""
    taken: Counter[str] = Counter()
    for name in names:
        array = name.partition("[")[0]
        column = name if name in head else array
        if column in head:
            places.append((head.index(column), taken[column]))
            taken[column] += 1
    missing = [n for n in names if n not in head and n.partition("[")[0] not in head]
    if missing:
        raise ValueError(f"{file.name}: no column {some(missing)}")
    values = [[[float(x) for x in text.split()] for text in row] for row in rows]
    for array, count in taken.items():
        wrong = next((k for k, row in enumerate(values) if len(row[head.index(array)]) != count), None)
        if wrong is not None:
            found = len(values[wrong][head.index(array)])
            raise ValueError(f"{file.name}, row {wrong + 2}: {array} has {found} values; expected {count}, separated by blanks")
    return [[row[i][k] for i, k in places] for row in values]


def some(names: Sequence[str], limit: int = 4) -> str:
    """The first few names."""
    return ", ".join(names[:limit]) + (f", ... ({len(names)} in all)" if len(names) > limit else "")


class OnlyOnce(Exception):  # noqa: N818  # not an error
    """There has been an instance of an FMU of which a process can have one only."""


class Instance:
    """One instance of the FMU; raw calls, every status looked at, its log kept."""

    def __init__(self, fmu: Fmu, name: str = "instance") -> None:
        self.fmu, self.log, self._calls = fmu, fmu.log, fmu.calls
        self._set: dict[str, Any] = {}
        """What was set, by element: in FMI 3.0 an array is set as a whole, the elements that are not meant included."""
        self._states = 0  # that are kept to go back to
        if fmu.instances and fmu.flags.canBeInstantiatedOnlyOncePerProcess:
            raise OnlyOnce("canBeInstantiatedOnlyOncePerProcess is true, and this check needs a second instance")
        fmu.instances += 1
        made = self._calls.instantiate(name)
        if not made:
            raise CallFailed(f"{self._calls.prefix}Instantiate: no instance: {self.logged()}")
        self.address = made

    def logged(self) -> str:
        """What it logged, in one line."""
        return " | ".join(" ".join(text.split()) for text in self.log[-3:]) or "(nothing logged)"

    def call(self, function: str, *arguments: Any) -> None:
        """An FMI function of this instance. `CallFailed` unless it returns OK or warning."""
        status = self._calls.function(function)(self.address, *arguments)
        if status not in (0, 1):
            label = _LABELS[status] if 0 <= status < len(_LABELS) else str(status)
            raise CallFailed(f"{function} returned {label}: {self.logged()}", fatal=label == "fatal")

    def set(self, elements: Sequence[Element], values: Sequence[Any]) -> None:
        """Set elements, one call per type."""
        self._set |= {e.name: value for e, value in zip(elements, values, strict=True)}
        for of_type, variables in _by_type(e.variable for e in elements):
            given = [_number(self._set.get(e.name, e.start), of_type) for v in variables for e in v.elements]
            self.access("Set", of_type, [v.reference for v in variables], (of_type.c * len(given))(*given))

    def read(self, elements: Sequence[Element]) -> list[float]:
        """The values of elements, one call per type."""
        values: dict[str, float] = {}
        for of_type, variables in _by_type(e.variable for e in elements):
            found = [e.name for v in variables for e in v.elements]
            buffer = (of_type.c * len(found))()
            self.access("Get", of_type, [v.reference for v in variables], buffer)
            values |= {name: float(x) for name, x in zip(found, buffer, strict=True)}
        return [values[e.name] for e in elements]

    def access(self, way: str, of_type: Type, references: Sequence[int], buffer: Any, room: int | None = None) -> None:
        """Set or get variables (`way`) of one type; in FMI 3.0 the FMU is told that the buffer has `room` for so many values, or all."""
        pointers = (ctypes.c_uint * len(references))(*references)
        told = self._calls.room(len(buffer) if room is None else room)
        self.call(f"{self._calls.prefix}{way}{of_type.name}", pointers, len(references), buffer, *told)

    def get(self) -> list[float]:
        """All outputs, in the order of the model description."""
        return self.read(self.fmu.outputs)

    def configure(self) -> None:
        """Set the parameters of the reference results."""
        known = {e.name: e for e in self.fmu.parameters}
        given = self.fmu.parameter_values
        self.set([known[name] for name in given], list(given.values()))

    def enter(self) -> None:
        """Set the parameters and enter initialisation."""
        self.configure()
        self._calls.enter(self.call, self.fmu.start)

    def leave(self) -> None:
        """Leave initialisation."""
        self.call(f"{self._calls.prefix}ExitInitializationMode")

    def initialise(self, row: Sequence[float] | None = None) -> list[float]:
        """From instantiated to stepping; outputs at the start, which many FMUs compute no earlier than when they leave initialisation."""
        self.enter()
        self.set(self.fmu.inputs, self.fmu.rows[0] if row is None else row)
        self.leave()
        return self.get()

    def advance(self, k: int, h: float | None = None) -> None:
        """Make step number k with the inputs as they are; of another length `h` [s] if given."""
        self._calls.step(self.call, self.fmu.start + k * self.fmu.h, self.fmu.h if h is None else h, not self._states)

    def step(self, k: int, row: Sequence[float] | None = None) -> list[float]:
        """Step number k; outputs after it."""
        self.set(self.fmu.inputs, self.fmu.rows[k] if row is None else row)
        self.advance(k)
        return self.get()

    def run(self) -> list[list[float]]:
        """Initialise and take all steps; outputs at all times."""
        return [self.initialise(), *(self.step(k) for k in range(len(self.fmu.rows)))]

    def terminate(self) -> None:
        """End the run."""
        self.call(f"{self._calls.prefix}Terminate")

    def reset(self) -> None:
        """Back to how it was made."""
        self.call(f"{self._calls.prefix}Reset")
        self._set.clear()

    def state(self) -> Any:
        """A copy of its state."""
        pointer = ctypes.c_void_p()
        self.call(self._calls.states.get, ctypes.byref(pointer))
        self._states += 1
        return pointer

    def restore(self, pointer: Any) -> None:
        """Back to that state. What `set` fills arrays up with stays, so set all inputs before a part of them."""
        self.call(self._calls.states.set, pointer)

    def forget(self, pointer: Any) -> None:
        """Free a state."""
        self.call(self._calls.states.free, ctypes.byref(pointer))
        self._states -= 1

    def serialise(self, pointer: Any) -> bytes:
        """A state as bytes."""
        size = ctypes.c_size_t()
        self.call(self._calls.states.size, pointer, ctypes.byref(size))
        data = ctypes.create_string_buffer(size.value)
        self.call(self._calls.states.serialise, pointer, data, size)
        return data.raw

    def deserialise(self, data: bytes) -> Any:
        """Bytes as a state."""
        pointer = ctypes.c_void_p()
        self._states += 1
        self.call(self._calls.states.deserialise, ctypes.create_string_buffer(data, len(data)), len(data), ctypes.byref(pointer))
        return pointer

    def free(self) -> None:
        """Free it; its library stays loaded for the others."""
        self._calls.free(self.address)


def _by_type(variables: Iterable[Variable]) -> list[tuple[Type, list[Variable]]]:
    """Different variables by the functions that get and set them."""
    groups: dict[str, list[Variable]] = {}
    for v in dict.fromkeys(variables):
        groups.setdefault(v.type.name, []).append(v)
    return [(found[0].type, found) for found in groups.values()]
