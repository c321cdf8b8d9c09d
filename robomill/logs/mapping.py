"""The mapping file of a foreign log: which column is which port, in which unit, frame and sign, on which clock. See docs/import.md."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from robomill.cell.binding import convert, resolve
from robomill.fmus.components import COMPONENTS, beside, component, is_component
from robomill.logs.reading import READERS, FloatArray, LogError
from robomill.models.model.declaration import Model, Variable
from robomill.models.model.units import UNITS, canonical, compatible, rate_of
from robomill.orchestration.errors import PlacedError, unknown
from robomill.orchestration.slaves.protocol import arrays
from robomill.orchestration.system.entries import Entry
from robomill.orchestration.system.parameters import prepare

AXES = 3
"""Components of a vector, and Euler angles A, B, C of an orientation."""
_TOP = ("log", "clock", "about", "components", "labels", "parameters", "signal")
_ABOUT = ("program", "robot", "tool", "workpiece", "source", "licence", "description")
_SIGNAL = (
    "column",
    "columns",
    "unit",
    "scale",
    "offset",
    "sign",
    "rotation",
    "orientation",
    "shift",
    "range",
    "description",
    "low_pass",
    "derivative",
)


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
    low_pass: float
    """Corner [Hz] of a zero-phase low-pass; 0: none."""
    derivative: int
    """How often the signal is differentiated with respect to time."""
    range: Entry | None
    """Lowest and highest plausible value, as written."""
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


def load_mapping(file: Path) -> LogMapping:
    """Read a mapping file. LogError names file, line and key, what was found and what is expected."""
    if not file.is_file():
        raise LogError(f"no mapping file {file}")
    top = Entry.load(file, LogError, convert).keys((), _TOP)
    if "clock" not in top:
        raise top.fail("a table [clock] is missing; give the column with the time and its unit, or a rate in Hz")
    log = top.get("log", {}).keys((), ("format", "delimiter", "decimal", "skip_rows"))
    for key in ("delimiter", "decimal"):
        if key in log and len(log[key].text(blank=True)) != 1:
            raise log[key].expected("one character")
    if "skip_rows" in log:
        log["skip_rows"].count(0)
    models = {name: _component(entry) for name, entry in top.get("components", {}).items()}
    signals = tuple(_signal(entry, models) for entry in top.get("signal", []).each())
    if not signals:
        raise top.get("signal", []).fail("expected at least one [[signal]] with port and columns; there is none")
    return LogMapping(
        file,
        log["format"].choice(READERS) if "format" in log else None,
        {k: v for k, v in log.value.items() if k != "format"},
        _clock(top["clock"]),
        {key: entry.text() for key, entry in top.get("about", {}).keys((), _ABOUT).items()},
        {name: _label(entry) for name, entry in top.get("labels", {}).items()},
        {name: _parameters(entry, name, models) for name, entry in top.get("parameters", {}).items()},
        signals,
    )


def _label(entry: Entry) -> Any:
    if not isinstance(entry.value, str | bool | int | float) or (isinstance(entry.value, float) and not math.isfinite(entry.value)):
        raise entry.expected("a text, a number, true or false")
    return entry.value


def _parameters(entry: Entry, name: str, models: Mapping[str, Model]) -> Any:
    """In the units of the ports where the component is listed; else as written, numbers as texts: who knows the ports asks for units."""
    values = entry.written()
    if name not in models:
        return _unasked(entry.value)
    slave = resolve(models[name].name, name)
    try:
        given = prepare(name, slave.ports, values, convert, entry.content.folder)
    except PlacedError as error:
        raise LogError(f"{error.place}: {error}") from None
    finally:
        slave.close()
    whole = arrays([p for p in slave.ports if p.causality == "parameter"])
    return {k: [given[p.name] for p in whole[k]] if k not in given else given[k] for k in values}


def _unasked(value: Any) -> Any:
    """Numbers as texts without a unit; zero and what is no number as it is."""
    if isinstance(value, dict):
        return {k: _unasked(v) for k, v in value.items()} if set(value) != {"value", "unit"} else value
    if isinstance(value, list):
        return [_unasked(v) for v in value]
    return value if isinstance(value, bool | str) or value == 0 else str(value)


def _component(entry: Entry) -> Model:
    if not is_component(entry.text()):
        raise entry.fail(unknown("component", entry.value, COMPONENTS))
    with entry.blamed_for(ValueError):
        return component(beside(entry.value, entry.content.folder))


def _unit(entry: Entry) -> str:
    if canonical(entry.text()) not in UNITS:
        raise entry.fail(unknown("unit", entry.value, sorted(UNITS)))
    return canonical(entry.value)


def _clock(entry: Entry) -> Clock:
    entry.keys((), ("column", "unit", "offset", "rate", "step"))
    if ("column" in entry) == ("rate" in entry):
        raise entry.fail("give either column (and unit) or rate (Hz)")
    column, unit = entry["column"].text() if "column" in entry else None, "s"
    if column is not None:
        unit = _unit(entry.get("unit", None))
        if not compatible(unit, "s"):
            raise entry["unit"].fail(f"{unit!r} does not measure time; expected s, ms, min or h")
    rate, step = entry.get("rate", 0).si("Hz"), entry.get("step", 0).si("s")
    if rate < 0.0 or ("rate" in entry and rate == 0.0) or step < 0.0:
        raise entry.fail("rate and step must be positive")
    return Clock(column, unit, entry.get("offset", 0).si("s"), rate, step)


def _signal(entry: Entry, models: Mapping[str, Model]) -> Signal:
    port = entry.keys({"port"}, _SIGNAL)["port"].text()
    component, _, name = port.partition(".")
    if not component or not name:
        raise entry["port"].fail(f"{port!r} is no port; expected component.port or component.port[2]")
    if ("column" in entry) == ("columns" in entry):
        raise entry.fail("give either column (one, or all elements of an array) or columns (a list)")
    columns = (entry["column"].text(),) if "column" in entry else entry["columns"].texts()
    if not columns:
        raise entry["columns"].expected("a list of names")
    orientation = "orientation" in entry
    if orientation and entry["orientation"].value != "abc":
        raise entry["orientation"].expected("'abc' (KUKA Euler angles to quaternion)")
    unit = _unit(entry["unit"]) if "unit" in entry else None
    low_pass, derivative = entry.get("low_pass", 0).si("Hz"), entry["derivative"].count(1) if "derivative" in entry else 0
    size = target = None
    if component in models:
        size, target = _declared(entry["port"], models[component], name)
        found = rate_of(unit, derivative) if unit is not None and derivative else unit
        if unit is not None and not orientation and (found is None or not compatible(found, target)):
            raise entry["unit"].fail(f"wrong unit: {port} is in {target}, {unit!r} measures something else")
    sign, scale = _numbers(entry.get("sign", 1)), _numbers(entry.get("scale", 1.0))
    if not np.all(np.abs(sign) == 1.0):
        raise entry["sign"].expected("1 or -1")
    if scale.ndim and sign.ndim and scale.shape != sign.shape:
        raise entry["sign"].fail(f"{sign.size} signs for {scale.size} scales")
    if low_pass < 0.0 or ("low_pass" in entry and low_pass == 0.0):
        raise entry["low_pass"].expected("a frequency above 0 Hz")
    limits = None
    if "range" in entry:
        limits = entry["range"]
        match limits.each():
            case [_, _]:
                pass
            case _:
                raise limits.expected("[lowest, highest]")
    return Signal(
        port,
        columns,
        unit,
        scale * sign,
        _numbers(entry.get("offset", 0.0)),
        _rotation(entry["rotation"]) if "rotation" in entry else None,
        orientation,
        entry.get("shift", 0).si("s"),
        low_pass,
        derivative,
        limits,
        entry["description"].text() if "description" in entry else "",
        size,
        target,
    )


def _numbers(entry: Entry) -> FloatArray:
    """A number, or a list of them."""
    listed = isinstance(entry.value, list) and entry.value
    return np.array([e.number() for e in entry.each()] if listed else entry.number("a number or a list of numbers"))


def _declared(entry: Entry, model: Model, name: str) -> tuple[int, str]:
    """Size and unit of a port of a component; `name` may be one element."""
    ports: dict[str, Variable] = {v.name: v for v in model.variables if v.causality in ("input", "output")}
    base = name.partition("[")[0]
    if base not in ports:
        raise entry.fail(f"{unknown('port', base, ports)} (ports of {model.name})")
    v = ports[base]
    if name != base and name not in v.element_names:
        raise entry.fail(unknown("element", name, v.element_names))
    return (1 if name != base else len(v.element_names)), v.unit


def _rotation(entry: Entry) -> FloatArray:
    """A matrix [[..], [..], [..]] or {abc = ["90 deg", 0, 0]}, R = Rz(A) Ry(B) Rx(C)."""
    if isinstance(entry.value, dict):
        return rotation_abc(np.array(entry.keys({"abc"})["abc"].vector("rad")))
    rows = [_numbers(row) for row in entry.each()]
    if [row.shape for row in rows] != [(3,)] * 3:
        raise entry.expected("a matrix of 3 rows of 3 numbers or {abc = [A, B, C]}")
    matrix = np.array(rows)
    if not np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-6) or np.linalg.det(matrix) < 0.0:
        raise entry.fail("the matrix is no rotation: its rows must be orthonormal and right-handed (use sign for a flipped channel)")
    return matrix


def rotation_abc(angles: FloatArray) -> FloatArray:
    """R [..., 3, 3] = Rz(A) Ry(B) Rx(C) of angles [..., 3] rad."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("ZYX", angles).as_matrix())
