"""The mapping file of a foreign log: which column is which port, in which unit, frame, sign, on which clock. See docs/how_to/import.md."""

from __future__ import annotations

import datetime
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from robomill.cell.binding import convert
from robomill.fmus.components import COMPONENTS, beside, component, is_component
from robomill.fmus.in_process import InProcessSlave
from robomill.logs.cutting import EDGES, Cut, Instant, Marker
from robomill.logs.reading import READERS, CsvForm, FloatArray, LogError
from robomill.models.model.declaration import Model, Variable
from robomill.models.model.units import EXPECTED, are_turns, compatible, unit_of
from robomill.orchestration.errors import PlacedError, unknown
from robomill.orchestration.slaves.protocol import arrays
from robomill.orchestration.system.entries import Entry
from robomill.orchestration.system.parameters import prepare

AXES = 3
"""Components of a vector, and Euler angles A, B, C of an orientation."""
TOP = ("log", "clock", "cut", "about", "components", "labels", "parameters", "signal")
_ABOUT = ("program", "robot", "tool", "workpiece", "source", "licence", "description")
SIGNAL = (
    *(
        "column",
        "columns",
        "shape",
        "unit",
        "scale",
        "offset",
        "sign",
        "rotation",
        "orientation",
        "shift",
        "low_pass",
        "derivative",
        "range",
    ),
    "description",
)
LOG = ("format", "delimiter", "decimal", "skip_rows", "unit_row", "encoding", "stamps")
CLOCK = ("column", "unit", "format", "offset", "rate", "step")
_STAMPS = ("header", "received")
CUT = ("from", "to", "period", "at", "marker", "when", "level", "while", "length")
"""Keys of the tables of a mapping."""
_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ].*")
ISO = "iso"
"""Format of a clock that holds dates and times as ISO 8601 writes them."""


@dataclass(frozen=True)
class Clock:
    """Time of a row: `column` in `unit` plus `offset` [s], or counted at `rate` [Hz]; on a grid of `step` [s] if that is not 0."""

    column: str | None
    unit: str
    format: str | None
    """The column holds dates and times of this format (`ISO`, or as strptime has it); time counts from the first."""
    offset: float
    rate: float
    step: float


@dataclass(frozen=True)
class Signal:
    """Columns of a log that make one port."""

    port: str
    """`component.port`, or one element of it, `component.port[2]`."""
    columns: tuple[str, ...]
    shape: tuple[int, ...]
    """The columns are the elements of a matrix of this shape, row by row; (): a vector, or as the columns of the log are counted."""
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
    elements: tuple[str, ...] | None
    """Names of the elements of the port, where the component is known."""
    target: str | None
    """Unit of the port, where the component is known."""


@dataclass(frozen=True)
class LogMapping:
    """A mapping file."""

    file: Path
    format: str | None
    csv: CsvForm
    stamps: str
    """Where the times of a ROS bag come from: "header" or "received"."""
    clock: Clock
    cut: Cut
    about: Mapping[str, Any]
    labels: Mapping[str, Any]
    parameters: Mapping[str, Any]
    signals: tuple[Signal, ...]


def load_mapping(file: Path) -> LogMapping:
    """Read a mapping file. LogError names file, line and key, what was found and what is expected."""
    if not file.is_file():
        raise LogError(f"no mapping file {file}")
    top = Entry.load(file, LogError, convert).keys((), TOP)
    if "clock" not in top:
        raise top.fail("a table [clock] is missing; give the column with the time and its unit, or a rate in Hz")
    models = {name: _component(entry) for name, entry in top.get("components", {}).items()}
    signals = tuple(_signal(entry, models) for entry in top.get("signal", []).each())
    if not signals:
        raise top.get("signal", []).fail("expected at least one [[signal]] with port and columns; there is none")
    log = top.get("log", {}).keys((), LOG)
    return LogMapping(
        file,
        log["format"].choice(READERS) if "format" in log else None,
        _csv_form(log),
        log["stamps"].choice(_STAMPS) if "stamps" in log else _STAMPS[0],
        _clock(top["clock"]),
        _cut(top.get("cut", {})),
        {key: entry.text() for key, entry in top.get("about", {}).keys((), _ABOUT).items()},
        {name: _label(entry) for name, entry in top.get("labels", {}).items()},
        {name: _parameters(entry, name, models) for name, entry in top.get("parameters", {}).items()},
        signals,
    )


def _csv_form(log: Entry) -> CsvForm:
    for key in ("delimiter", "decimal"):
        if key in log and len(log[key].text(blank=True)) != 1:
            raise log[key].expected("one character")
    default = CsvForm()
    form = CsvForm(
        log.get("delimiter", default.delimiter).text(blank=True),
        log.get("decimal", default.decimal).text(blank=True),
        log.get("skip_rows", default.skip_rows).count(0),
        log.get("unit_row", default.unit_row).flag(),
        log.get("encoding", default.encoding).text(),
    )
    if form.delimiter == form.decimal:
        raise log.fail(f"delimiter and decimal are both {form.delimiter!r}; one of them must be another")
    return form


def _label(entry: Entry) -> Any:
    if not isinstance(entry.value, str | bool | int | float) or (isinstance(entry.value, float) and not math.isfinite(entry.value)):
        raise entry.expected("a text, a number, true or false")
    return entry.value


def _parameters(entry: Entry, name: str, models: Mapping[str, Model]) -> Any:
    """In the units of the ports where the component is listed; else as written, numbers as texts: who knows the ports asks for units."""
    values = entry.written()
    if name not in models:
        return _unasked(entry.value)
    slave = InProcessSlave(models[name], name)
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
    try:
        unit_of(entry.text())
    except ValueError as error:
        raise entry.fail(f"{error}; {EXPECTED}") from None
    return entry.text()


def _clock(entry: Entry) -> Clock:
    entry.keys((), CLOCK)
    if ("column" in entry) == ("rate" in entry):
        raise entry.fail("give either column (and unit) or rate (Hz)")
    column, unit = entry["column"].text() if "column" in entry else None, "s"
    form = entry["format"].text() if "format" in entry else None
    if form is not None and (column is None or "unit" in entry):
        raise entry["format"].fail("format is of a column with dates and times, which has no unit; give column and format alone")
    if form not in (None, ISO) and "%" not in str(form):
        raise entry["format"].expected(f"{ISO!r} or a format of strptime such as '%d.%m.%Y %H:%M:%S.%f'")
    if column is not None and form is None:
        unit = _unit(entry.get("unit", None))
        if not compatible(unit, "s"):
            raise entry["unit"].fail(f"{unit!r} does not measure time; expected s, ms, min or h, or format = 'iso' for dates and times")
    rate, step = entry.get("rate", 0).si("Hz"), entry.get("step", 0).si("s")
    if rate < 0.0 or ("rate" in entry and rate == 0.0) or step < 0.0:
        raise entry.fail("rate and step must be positive")
    return Clock(column, unit, form, entry.get("offset", 0).si("s"), rate, step)


def _cut(entry: Entry) -> Cut:
    entry.keys((), CUT)
    ways = [key for key in ("period", "at", "marker") if key in entry]
    if len(ways) > 1:
        raise entry.fail(f"{' and '.join(ways)} both cut the log; give one of period, at and marker")
    for key in ("when", "level", "while"):
        if key in entry and "marker" not in entry:
            raise entry[key].fail("belongs to a marker; give marker, the column that it is about")
    if "length" in entry and not ways:
        raise entry["length"].fail("is that of the pieces; give period, at or marker, or to")
    times = {key: entry[key].si("s") for key in ("period", "length") if key in entry}
    for key, value in times.items():
        if value <= 0.0:
            raise entry[key].expected("a positive time")
    return Cut(
        f"{entry.place}: {entry.name}",
        _instant(entry["from"]) if "from" in entry else None,
        _instant(entry["to"]) if "to" in entry else None,
        times.get("period"),
        tuple(_instant(e) for e in entry["at"].each()) if "at" in entry else (),
        _marker(entry) if "marker" in entry else None,
        times.get("length"),
    )


def _marker(entry: Entry) -> Marker:
    value: float | str | None = None
    if "while" in entry:
        if "when" in entry or "level" in entry:
            raise entry["while"].fail("gives the pieces alone; leave out when and level")
        value = entry["while"].value
        value = entry["while"].text() if isinstance(value, str) else float(value) if isinstance(value, bool) else entry["while"].number()
    when = entry["when"].choice(EDGES) if "when" in entry else EDGES[0]
    return Marker(entry["marker"].text(), when, entry["level"].number() if "level" in entry else None, value)


def _instant(entry: Entry) -> Instant:
    """A time of the run, "2.5 s", or a date and time of day, as TOML or ISO 8601 write it."""
    value = entry.value
    if isinstance(value, str) and _DATE.fullmatch(value.strip()):
        try:
            value = datetime.datetime.fromisoformat(value.strip())
        except ValueError:
            raise entry.expected("a date and time such as 2024-05-03T10:15:00Z") from None
    return value if isinstance(value, datetime.datetime) else entry.si("s")


def _signal(entry: Entry, models: Mapping[str, Model]) -> Signal:
    port = entry.keys({"port"}, SIGNAL)["port"].text()
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
    if low_pass < 0.0 or ("low_pass" in entry and low_pass == 0.0):
        raise entry["low_pass"].expected("a frequency above 0 Hz")
    elements = target = None
    if component in models:
        elements, target = _declared(entry["port"], models[component], name)
        shown = rate_of(unit, derivative) if unit is not None else None
        if shown is not None and not (compatible(shown, target) or are_turns(shown, target) or orientation):
            raise entry["unit"].fail(f"wrong unit: {port} is in {target}, {unit!r} measures something else")
    sign, scale = _numbers(entry.get("sign", 1)), _numbers(entry.get("scale", 1.0))
    if not np.all(np.abs(sign) == 1.0):
        raise entry["sign"].expected("1 or -1")
    if scale.ndim and sign.ndim and scale.shape != sign.shape:
        raise entry["sign"].fail(f"{sign.size} signs for {scale.size} scales")
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
        _shape(entry["shape"]) if "shape" in entry else (),
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
        elements,
        target,
    )


def _shape(entry: Entry) -> tuple[int, ...]:
    return tuple(e.count(1) for e in entry.each())


def _numbers(entry: Entry) -> FloatArray:
    """A number, or a list of them."""
    listed = isinstance(entry.value, list) and entry.value
    return np.array([e.number() for e in entry.each()] if listed else entry.number("a number or a list of numbers"))


def _declared(entry: Entry, model: Model, name: str) -> tuple[tuple[str, ...], str]:
    """Names of the elements and unit of a port of a component; `name` may be one element."""
    ports: dict[str, Variable] = {v.name: v for v in model.variables if v.causality in ("input", "output")}
    base = name.partition("[")[0]
    if base not in ports:
        raise entry.fail(f"{unknown('port', base, ports)} (ports of {model.name})")
    v = ports[base]
    if name != base and name not in v.element_names:
        raise entry.fail(unknown("element", name, v.element_names))
    return ((name,) if name != base else v.element_names), v.unit


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


def rate_of(unit: str, times: int) -> str:
    """What the derivative of so many `times` of a quantity in `unit` is in; the unit itself where that is 0."""
    return unit if times == 0 else unit_of(f"({unit_of(unit).si})/s{times}").si


def rotation_abc(angles: FloatArray) -> FloatArray:
    """R [..., 3, 3] = Rz(A) Ry(B) Rx(C) of angles [..., 3] rad."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("ZYX", angles).as_matrix())
