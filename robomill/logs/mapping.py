"""The mapping file of a foreign log: which column is which port, in which unit, frame and sign, on which clock. See docs/import.md."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from robomill.cell.binding import convert, resolve
from robomill.fmus.components import COMPONENTS
from robomill.logs.reading import READERS, FloatArray, LogError
from robomill.models.model.declaration import Model, Variable
from robomill.models.model.units import UNITS, canonical, compatible
from robomill.orchestration.errors import PlacedError, unknown
from robomill.orchestration.slaves.protocol import arrays
from robomill.orchestration.system.parameters import prepare, quantity
from robomill.orchestration.system.toml_file import TomlFile

_TOP = ("log", "clock", "about", "components", "labels", "parameters", "signal")
_LOG = ("format", "delimiter", "decimal", "skip_rows")
_CLOCK = ("column", "unit", "offset", "rate", "step")
_ABOUT = ("program", "robot", "tool", "workpiece", "source", "licence", "description")
_SIGNAL = ("port", "column", "columns", "unit", "scale", "offset", "sign", "rotation", "orientation", "shift", "range", "description")


@dataclass(frozen=True)
class Clock:
    """Time of a row: `column` in `unit` plus `offset` [s], or counted at `rate` [Hz]; on a grid of `step` [s] if that is not 0."""

    column: str | None
    unit: str
    offset: float
    rate: float
    step: float


@dataclass(frozen=True)
class Signal:
    """Columns of a log that make one port."""

    port: str
    """`component.port`, or one element of it, `component.port[2]`."""
    columns: tuple[str, ...]
    unit: str | None
    """Unit in the log; None: the one that the log states."""
    scale: FloatArray
    """[n] or scalar, with the signs multiplied in; port = scale * column + offset, in the unit of the log."""
    offset: FloatArray
    rotation: FloatArray | None
    """[3,3]: from the frame of the log to that of the port."""
    orientation: bool
    """Columns are the Euler angles A, B, C of KUKA; the port is a quaternion."""
    shift: float
    """Time [s] that is added to the clock for this signal."""
    range: tuple[Any, Any] | None
    """Lowest and highest plausible value, as written."""
    place: str
    """Where it stands: `map.toml:12`."""
    description: str
    size: int | None
    """Number of elements of the port, where the component is known."""
    target: str | None
    """Unit of the port, where the component is known."""


@dataclass(frozen=True)
class LogMapping:
    """A mapping file."""

    file: Path
    format: str | None
    csv: Mapping[str, Any]
    clock: Clock
    about: Mapping[str, Any]
    labels: Mapping[str, Any]
    parameters: Mapping[str, Any]
    signals: tuple[Signal, ...]


class _Reader:
    """Checks entries and words what is wrong, with file and line."""

    def __init__(self, content: TomlFile) -> None:
        self.content = content

    def fail(self, path: Sequence[str | int], message: str) -> LogError:
        return LogError(f"{self.content.place(*path)}: {'.'.join(str(p) for p in path)}: {message}")

    def keys(self, path: Sequence[str | int], table: Any, known: Sequence[str]) -> dict[str, Any]:
        if not isinstance(table, dict):
            raise self.fail(path, f"expected a table with {', '.join(known)}; found {table!r}")
        for key in table:
            if key not in known:
                raise self.fail([*path, key], unknown("key", key, known))
        return table

    def text_of(self, path: Sequence[str | int], value: Any) -> str:
        if not isinstance(value, str) or not value:
            raise self.fail(path, f"expected a text; found {value!r}")
        return value

    def numbers(self, path: Sequence[str | int], value: Any) -> FloatArray:
        listed = value if isinstance(value, list) else [value]
        if not listed or any(isinstance(v, bool) or not isinstance(v, (int, float)) for v in listed):
            raise self.fail(path, f"expected a number or a list of numbers; found {value!r}")
        array = np.asarray(value, dtype=np.float64)
        if not np.all(np.isfinite(array)):
            raise self.fail(path, f"{value} is not finite")
        return array

    def quantity(self, path: Sequence[str | int], value: Any, wanted: str) -> float:
        """A text with a unit such as "-3 ms"; 0 needs none."""
        try:
            return quantity(value, wanted, convert)
        except ValueError as error:
            raise self.fail(path, str(error)) from None

    def unit(self, path: Sequence[str | int], value: Any) -> str:
        text = self.text_of(path, value)
        if canonical(text) not in UNITS:
            raise self.fail(path, unknown("unit", text, sorted(UNITS)))
        return canonical(text)


def load_mapping(file: Path) -> LogMapping:
    """Read a mapping file. LogError names file, line and key, what was found and what is expected."""
    if not file.is_file():
        raise LogError(f"no mapping file {file}")
    read = _Reader(TomlFile.load(file, LogError))
    content = read.keys([], read.content.table, _TOP)
    log = read.keys(["log"], content.get("log", {}), _LOG)
    if "format" in log and read.text_of(["log", "format"], log["format"]) not in READERS:
        raise read.fail(["log", "format"], unknown("format", str(log["format"]), READERS))
    for key in ("delimiter", "decimal"):
        if key in log and len(read.text_of(["log", key], log[key])) != 1:
            raise read.fail(["log", key], f"expected one character; found {log[key]!r}")
    if "skip_rows" in log and (type(log["skip_rows"]) is not int or log["skip_rows"] < 0):
        raise read.fail(["log", "skip_rows"], f"expected a whole number from 0; found {log['skip_rows']!r}")
    about = read.keys(["about"], content.get("about", {}), _ABOUT)
    for key, value in about.items():
        read.text_of(["about", key], value)
    models = _components(read, content.get("components", {}))
    signals = content.get("signal", [])
    if not isinstance(signals, list) or not signals:
        raise read.fail(["signal"], "expected at least one [[signal]] with port and columns; there is none")
    found = tuple(_signal(read, i, entry, models) for i, entry in enumerate(signals))
    return LogMapping(
        file,
        log.get("format"),
        {k: v for k, v in log.items() if k != "format"},
        _clock(read, content.get("clock")),
        about,
        _labels(read, content.get("labels", {})),
        _parameters(read, content.get("parameters", {}), models),
        found,
    )


def _free(read: _Reader, name: str, table: Any) -> dict[str, Any]:
    if not isinstance(table, dict):
        raise read.fail([name], f"expected a table; found {table!r}")
    return table


def _labels(read: _Reader, table: Any) -> dict[str, Any]:
    for name, value in _free(read, "labels", table).items():
        if not isinstance(value, str | bool | int | float) or (isinstance(value, float) and not math.isfinite(value)):
            raise read.fail(["labels", name], f"expected a text, a number, true or false; found {value!r}")
    return dict(table)


def _parameters(read: _Reader, table: Any, models: Mapping[str, Model]) -> dict[str, Any]:
    """In the units of the ports where the component is listed; else as written, numbers as texts: who knows the ports asks for units."""
    found: dict[str, Any] = {}
    for name, values in _free(read, "parameters", table).items():
        path = ("parameters", name)
        if not isinstance(values, dict):
            raise read.fail(path, f"expected a table of parameters; found {values!r}")
        if name not in models:
            found[name] = _unasked(values)
            continue
        slave = resolve(models[name].name, name)
        try:
            given = prepare(name, slave.ports, read.content.written(values, *path), convert, read.content.folder)
        except PlacedError as error:
            raise LogError(f"{error.place}: {error}") from None
        finally:
            slave.close()
        whole = arrays([p for p in slave.ports if p.causality == "parameter"])
        found[name] = {k: [given[p.name] for p in whole[k]] if k not in given else given[k] for k in values}
    return found


def _unasked(value: Any) -> Any:
    """Numbers as texts without a unit; zero and what is no number as it is."""
    if isinstance(value, dict):
        return {k: _unasked(v) for k, v in value.items()} if set(value) != {"value", "unit"} else value
    if isinstance(value, list):
        return [_unasked(v) for v in value]
    return value if isinstance(value, bool | str) or value == 0 else str(value)


def _components(read: _Reader, table: Any) -> dict[str, Model]:
    found = {}
    for name, source in _free(read, "components", table).items():
        if read.text_of(["components", name], source) not in COMPONENTS:
            raise read.fail(["components", name], unknown("component", str(source), COMPONENTS))
        found[name] = COMPONENTS[source]
    return found


def _clock(read: _Reader, table: Any) -> Clock:
    if table is None:
        raise LogError(f"{read.content.name}: a table [clock] is missing; give the column with the time and its unit, or a rate in Hz")
    entry = read.keys(["clock"], table, _CLOCK)
    if ("column" in entry) == ("rate" in entry):
        raise read.fail(["clock"], "give either column (and unit) or rate (Hz)")
    unit = "s"
    if "column" in entry:
        read.text_of(["clock", "column"], entry["column"])
        unit = read.unit(["clock", "unit"], entry.get("unit"))
        if not compatible(unit, "s"):
            raise read.fail(["clock", "unit"], f"{unit!r} does not measure time; expected s, ms, min or h")
    rate, step = (read.quantity(["clock", k], entry.get(k, 0), unit) for k, unit in (("rate", "Hz"), ("step", "s")))
    if rate < 0.0 or ("rate" in entry and rate == 0.0) or step < 0.0:
        raise read.fail(["clock"], "rate and step must be positive")
    return Clock(entry.get("column"), unit, read.quantity(["clock", "offset"], entry.get("offset", 0), "s"), rate, step)


def _signal(read: _Reader, index: int, table: Any, models: Mapping[str, Model]) -> Signal:
    path: list[str | int] = ["signal", index]
    entry = read.keys(path, table, _SIGNAL)
    port = read.text_of([*path, "port"], entry.get("port"))
    component, dot, name = port.partition(".")
    if not dot or not component or not name:
        raise read.fail([*path, "port"], f"{port!r} is no port; expected component.port or component.port[2]")
    if ("column" in entry) == ("columns" in entry):
        raise read.fail(path, "give either column (one, or all elements of an array) or columns (a list)")
    columns = entry.get("columns", [entry.get("column")])
    if not isinstance(columns, list) or not columns:
        raise read.fail([*path, "columns"], f"expected a list of names; found {columns!r}")
    for c in columns:
        read.text_of([*path, "columns"], c)
    unit = read.unit([*path, "unit"], entry["unit"]) if "unit" in entry else None
    size = target = None
    if component in models:
        size, target = _declared(read, [*path, "port"], models[component], name)
        if unit is not None and not compatible(unit, target) and not entry.get("orientation"):
            raise read.fail([*path, "unit"], f"wrong unit: {port} is in {target}, {unit!r} measures something else")
    sign = read.numbers([*path, "sign"], entry.get("sign", 1))
    if not np.all(np.abs(sign) == 1.0):
        raise read.fail([*path, "sign"], f"expected 1 or -1; found {entry['sign']!r}")
    low_high = None
    if "range" in entry:
        pair = entry["range"]
        if not isinstance(pair, list) or len(pair) != 2:
            raise read.fail([*path, "range"], f"expected [lowest, highest]; found {pair!r}")
        low_high = (pair[0], pair[1])
    if entry.get("orientation", "abc") != "abc":
        raise read.fail([*path, "orientation"], f"expected 'abc' (KUKA Euler angles to quaternion); found {entry['orientation']!r}")
    scale = read.numbers([*path, "scale"], entry.get("scale", 1.0))
    if scale.ndim and sign.ndim and scale.shape != sign.shape:
        raise read.fail([*path, "sign"], f"{sign.size} signs for {scale.size} scales")
    return Signal(
        port,
        tuple(columns),
        unit,
        scale * sign,
        read.numbers([*path, "offset"], entry.get("offset", 0.0)),
        _rotation(read, [*path, "rotation"], entry["rotation"]) if "rotation" in entry else None,
        "orientation" in entry,
        read.quantity([*path, "shift"], entry.get("shift", 0), "s"),
        low_high,
        read.content.place(*path, *(["range"] if low_high else [])),
        read.text_of([*path, "description"], entry["description"]) if "description" in entry else "",
        size,
        target,
    )


def _declared(read: _Reader, path: Sequence[str | int], model: Model, name: str) -> tuple[int, str]:
    """Size and unit of a port of a component; `name` may be one element."""
    ports: dict[str, Variable] = {v.name: v for v in model.variables if v.causality in ("input", "output")}
    base = name.partition("[")[0]
    if base not in ports:
        raise read.fail(path, f"{unknown('port', base, ports)} (ports of {model.name})")
    v = ports[base]
    if name != base and name not in v.element_names:
        raise read.fail(path, unknown("element", name, v.element_names))
    return (1 if name != base else len(v.element_names)), v.unit


def _rotation(read: _Reader, path: Sequence[str | int], value: Any) -> FloatArray:
    """A matrix [[..], [..], [..]] or {abc = ["90 deg", 0, 0]}, R = Rz(A) Ry(B) Rx(C)."""
    if isinstance(value, dict):
        read.keys(path, value, ("abc",))
        angles = value.get("abc")
        if not isinstance(angles, list) or len(angles) != 3:
            raise read.fail(path, f"expected three angles A, B, C; found {value!r}")
        return rotation_abc(np.array([read.quantity([*path, "abc"], a, "rad") for a in angles]))
    rows = value if isinstance(value, list) and len(value) == 3 else []
    if len(rows) != 3 or any(not isinstance(r, list) or len(r) != 3 for r in rows):
        raise read.fail(path, f"expected a matrix of 3 rows of 3 numbers or {{abc = [A, B, C]}}; found {value!r}")
    matrix = np.array([read.numbers(path, r) for r in rows])
    if not np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-6) or np.linalg.det(matrix) < 0.0:
        raise read.fail(path, "the matrix is no rotation: its rows must be orthonormal and right-handed (use sign for a flipped channel)")
    return matrix


def rotation_abc(angles: FloatArray) -> FloatArray:
    """R [..., 3, 3] = Rz(A) Ry(B) Rx(C) of angles [..., 3] rad."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("ZYX", angles).as_matrix())
