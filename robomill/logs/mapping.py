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
from robomill.orchestration.system import keys
from robomill.orchestration.system.entries import Entry
from robomill.orchestration.system.keys import Keys, default, optional, required
from robomill.orchestration.system.parameters import prepare

AXES = 3
"""Components of a vector, and Euler angles A, B, C of an orientation."""
_STAMPS = ("header", "received")
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


class LogKeys(Keys):
    """The form of the log; all keys but `format` and `stamps` are for CSV."""

    format = optional(keys.choice(tuple(READERS)), "form of the log (default: by its suffix)")
    delimiter = default(
        CsvForm().delimiter, keys.text(blank=True), "one character between columns; a blank stands for any number of blanks"
    )
    decimal = default(CsvForm().decimal, keys.text(blank=True), "one character in place of the decimal point")
    skip_rows = default(CsvForm().skip_rows, keys.count(0), "rows before the names of the columns")
    unit_row = default(CsvForm().unit_row, keys.flag(), "below the names stands a row of units")
    encoding = default(CsvForm().encoding, keys.text(), "encoding of the text")
    stamps = default(_STAMPS[0], keys.choice(_STAMPS), "times of a ROS bag: those of the message headers, or those of receipt")


class ClockKeys(Keys):
    """The time of the rows. Give either `column` or `rate`."""

    column = optional(keys.text(), "column that holds the time")
    unit = optional(keys.anything("text"), "unit of that column; needed unless `format` is given")
    format = optional(keys.text(), "the column holds dates and times: `iso`, or a format of strptime; time counts from the first row")
    offset = default(0, keys.quantity("s"), "time that is added to all rows")
    rate = default(0, keys.quantity("Hz"), "rows per second, where no column has the time; above 0")
    step = default(0, keys.quantity("s"), "rows are brought to a grid of this step, on straight lines between samples; 0: left as they are")


_INSTANT = keys.anything("time of the run, or date and time", "s")
"""A time such as "2.5 s" or 2024-05-03T10:15:01."""


class CutKeys(Keys):
    """The part of the log that is imported, and how it is cut into repeats: by one of `period`, `at` and `marker`."""

    begin = optional(_INSTANT, "begin of what is imported (default: that of the log)", name="from")
    end = optional(_INSTANT, "end of what is imported (default: that of the log)", name="to")
    period = optional(keys.quantity("s"), "a repeat begins every so often; above 0")
    at = optional(keys.anything("list of times", "s"), "times at which repeats begin")
    marker = optional(keys.text(), "column of the log that says where repeats begin")
    when = default(EDGES[0], keys.choice(EDGES), "what the marker does where a repeat begins")
    level = optional(keys.number(), "value that the marker rises or falls through, in the numbers of the log (default: the middle)")
    during = optional(
        keys.anything("text, number, true or false"), "repeats are where the marker has this value; instead of `when`", name="while"
    )
    length = optional(keys.quantity("s"), "repeats end after this time, and shorter ones are left out; above 0")


class AboutKeys(Keys):
    """What is known of the recording; copied to run.toml."""

    program = optional(keys.text(), "the program that ran")
    robot = optional(keys.text(), "the robot")
    tool = optional(keys.text(), "the tool")
    workpiece = optional(keys.text(), "the workpiece")
    source = optional(keys.text(), "where the log comes from")
    licence = optional(keys.text(), "licence of the data")
    description = optional(keys.text(), "what was recorded")


class SignalKeys(Keys):
    """Columns of the log that become one port: port = rotation (sign * scale * column + offset). Give either `column` or `columns`."""

    port = required(keys.text(), "`component.port` for a whole array, or one element of it, `component.port[2]`")
    column = optional(keys.text(), "one column, or an array with all its elements")
    columns = optional(keys.texts(), "the columns of the elements, in order")
    shape = default([], keys.anything("list of whole numbers from 1"), "the columns are a matrix of this shape, row by row")
    unit = optional(keys.anything("text"), "unit in the log (default: the one that the log states)")
    scale = default(1.0, keys.anything("number, or one per column"), "factor, in the unit of the log")
    offset = default(0.0, keys.anything("number, or one per column"), "value that is added, in the unit of the log")
    sign = default(1, keys.anything("1 or -1, or one per column"), "sense of the channel")
    rotation = optional(
        keys.anything("matrix of 3 rows, or `{abc = [A, B, C]}`", "rad"),
        "from the frame of the log to that of the port: R = Rz(A) Ry(B) Rx(C)",
    )
    orientation = optional(keys.anything("text", allowed=("abc",)), "the columns are KUKA Euler angles, and the port is a quaternion")
    shift = default(0, keys.quantity("s"), "time that is added to the clock for this signal")
    low_pass = default(0, keys.quantity("Hz"), "corner of a low-pass without phase; 0: none")
    derivative = optional(keys.count(1), "how often the signal is differentiated with respect to time (default: not at all)")
    range = optional(keys.anything("[lowest, highest]"), "plausible values with units; outside means a wrong unit or scale")
    description = optional(keys.text(), "what the channel is")


class MappingKeys(Keys):
    """Which column of a log is which port, in which unit, frame and sign, on which clock."""

    log = default({}, keys.table(LogKeys), "the form of the log")
    clock = optional(keys.table(ClockKeys), "the time of the rows; always needed")
    cut = default({}, keys.table(CutKeys), "the part that is imported, and repeats")
    about = default({}, keys.table(AboutKeys), "what is known of the recording")
    components = default(
        {}, keys.named(keys.anything("text"), "component"), "sources of components, whose ports and parameters are then checked"
    )
    labels = default(
        {},
        keys.named(keys.anything("text, number, true or false"), "label"),
        'what the diagnosis asks for: condition, repeat, held_out, tier, kind; `samples = "independent"`: no time series',
    )
    parameters = default({}, keys.anything("table of `component.parameter = value`"), "what was set in the experiment, with units")
    signal = default([], keys.each(SignalKeys), "the ports; at least one")


def load_mapping(file: Path) -> LogMapping:
    """Read a mapping file. LogError names file, line and key, what was found and what is expected."""
    if not file.is_file():
        raise LogError(f"no mapping file {file}; see docs/how_to/import.md for one to begin with")
    top, k = MappingKeys.of(Entry.load(file, LogError, convert)), MappingKeys
    if "clock" not in top:
        raise top.fail("a table [clock] is missing; give the column with the time and its unit, or a rate in Hz")
    models = {name: _component(entry) for name, entry in k.components.of(top).items()}
    signals = tuple(_signal(entry, models) for entry in k.signal.entry(top).each())
    if not signals:
        raise k.signal.entry(top).fail("expected at least one [[signal]] with port and columns; there is none")
    log = k.log.of(top)
    return LogMapping(
        file,
        LogKeys.format.of(log),
        _csv_form(log),
        LogKeys.stamps.of(log),
        _clock(top["clock"]),
        _cut(k.cut.entry(top)),
        {key: entry.text() for key, entry in k.about.of(top).items()},
        {name: _label(entry) for name, entry in k.labels.of(top).items()},
        {name: _parameters(entry, name, models) for name, entry in k.parameters.of(top).items()},
        signals,
    )


def _csv_form(log: Entry) -> CsvForm:
    k = LogKeys
    for key in (k.delimiter, k.decimal):
        if len(key.of(log)) != 1:
            raise key.entry(log).expected("one character")
    form = CsvForm(k.delimiter.of(log), k.decimal.of(log), k.skip_rows.of(log), k.unit_row.of(log), k.encoding.of(log))
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
    k = ClockKeys
    k.of(entry)
    if ("column" in entry) == ("rate" in entry):
        raise entry.fail("give either column (and unit) or rate (Hz)")
    column, form, unit = k.column.of(entry), k.format.of(entry), "s"
    if form is not None and (column is None or "unit" in entry):
        raise entry["format"].fail("format is of a column with dates and times, which has no unit; give column and format alone")
    if form not in (None, ISO) and "%" not in str(form):
        raise entry["format"].expected(f"{ISO!r} or a format of strptime such as '%d.%m.%Y %H:%M:%S.%f'")
    if column is not None and form is None:
        unit = _unit(k.unit.entry(entry))
        if not compatible(unit, "s"):
            raise entry["unit"].fail(f"{unit!r} does not measure time; expected s, ms, min or h, or format = 'iso' for dates and times")
    rate, step = k.rate.of(entry), k.step.of(entry)
    if rate < 0.0 or ("rate" in entry and rate == 0.0) or step < 0.0:
        raise entry.fail(f"expected rate and step above zero; found rate {rate:g} and step {step:g}")
    return Clock(column, unit, form, k.offset.of(entry), rate, step)


def _cut(entry: Entry) -> Cut:
    k = CutKeys
    k.of(entry)
    ways = [key for key in ("period", "at", "marker") if key in entry]
    if len(ways) > 1:
        raise entry.fail(f"{' and '.join(ways)} both cut the log; give one of period, at and marker")
    for key in ("when", "level", "while"):
        if key in entry and "marker" not in entry:
            raise entry[key].fail("belongs to a marker; give marker, the column that it is about")
    if "length" in entry and not ways:
        raise entry["length"].fail("is that of the pieces; give period, at or marker, or to")
    for time in (k.period, k.length):
        if (value := time.of(entry)) is not None and value <= 0.0:
            raise time.entry(entry).expected("a positive time")
    return Cut(
        f"{entry.place}: {entry.name}",
        _instant(entry["from"]) if "from" in entry else None,
        _instant(entry["to"]) if "to" in entry else None,
        k.period.of(entry),
        tuple(_instant(e) for e in entry["at"].each()) if "at" in entry else (),
        _marker(entry) if "marker" in entry else None,
        k.length.of(entry),
    )


def _marker(entry: Entry) -> Marker:
    k = CutKeys
    value: float | str | None = None
    if "while" in entry:
        if "when" in entry or "level" in entry:
            raise entry["while"].fail("gives the pieces alone; leave out when and level")
        value = entry["while"].value
        value = entry["while"].text() if isinstance(value, str) else float(value) if isinstance(value, bool) else entry["while"].number()
    return Marker(entry["marker"].text(), k.when.of(entry), k.level.of(entry), value)


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
    k = SignalKeys
    port = k.port.of(k.of(entry))
    component, _, name = port.partition(".")
    if not component or not name:
        raise entry["port"].fail(f"{port!r} is no port; expected component.port or component.port[2]")
    if ("column" in entry) == ("columns" in entry):
        raise entry.fail("give either column (one, or all elements of an array) or columns (a list)")
    one = k.column.of(entry)
    columns = (one,) if one is not None else entry["columns"].texts()
    if not columns:
        raise entry["columns"].expected("a list of names")
    orientation = "orientation" in entry
    if orientation and entry["orientation"].value != "abc":
        raise entry["orientation"].expected("'abc' (KUKA Euler angles to quaternion)")
    unit = _unit(entry["unit"]) if "unit" in entry else None
    low_pass, derivative = k.low_pass.of(entry), k.derivative.of(entry) or 0
    if low_pass < 0.0 or ("low_pass" in entry and low_pass == 0.0):
        raise entry["low_pass"].expected("a frequency above 0 Hz")
    elements = target = None
    if component in models:
        elements, target = _declared(entry["port"], models[component], name)
        shown = rate_of(unit, derivative) if unit is not None else None
        if shown is not None and not (compatible(shown, target) or are_turns(shown, target) or orientation):
            raise entry["unit"].fail(f"wrong unit: {port} is in {target}, {unit!r} measures something else; correct the unit or the port")
    sign, scale = _numbers(k.sign.of(entry)), _numbers(k.scale.of(entry))
    if not np.all(np.abs(sign) == 1.0):
        raise entry["sign"].expected("1 or -1")
    if scale.ndim and sign.ndim and scale.shape != sign.shape:
        raise entry["sign"].fail(f"{sign.size} signs for {scale.size} scales; give as many signs as scales")
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
        tuple(e.count(1) for e in k.shape.of(entry).each()),
        unit,
        scale * sign,
        _numbers(k.offset.of(entry)),
        _rotation(entry["rotation"]) if "rotation" in entry else None,
        orientation,
        k.shift.of(entry),
        low_pass,
        derivative,
        limits,
        k.description.of(entry) or "",
        elements,
        target,
    )


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
