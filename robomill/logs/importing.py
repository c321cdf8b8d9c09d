"""A log and its mapping become a run folder, or one for each repeat that is cut out of it."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from robomill.logs.cutting import TICK, Span, spans
from robomill.logs.mapping import AXES, LogMapping, Signal, load_mapping, rate_of, rotation_abc
from robomill.logs.reading import SUFFIXES, FloatArray, Log, LogError, format_of, read_log
from robomill.logs.timing import Timing
from robomill.models.model.units import are_turns, compatible, convert, unit_of
from robomill.orchestration.runs.importing import refuse_taken, remove_run, write_run
from robomill.orchestration.slaves.protocol import PortData

REPEAT = "repeat_"
"""Folder of a repeat within that of the import, before its number."""
MIRRORED = 15
"""Rows that a filter forwards and backwards mirrors at each end: three times its coefficients (`scipy.signal.sosfiltfilt`)."""

FORGOTTEN = 10.0
"""Periods of its corner after which a low-pass has forgotten that there was an end: its slowest part decays by 1.08 in 2 pi of these,
to e^-24 (the poles of a Butterworth of 4th order have real parts of 0.38 and 0.92 of the corner)."""


@dataclass(frozen=True)
class Imported:
    """A run that was written."""

    folder: Path
    rows: int
    step: float
    """Median step of the clock [s]."""
    columns: tuple[str, ...]
    span: Span
    """Begin and end [s] in the time of the log."""
    gap: Span | None
    """Begin and end [s] of the longest time without a row of the log, where that is rows longer than usual; in the time of the log."""


@dataclass(frozen=True)
class _Piece:
    """A run that is to be written."""

    folder: Path
    t: FloatArray
    columns: Mapping[str, FloatArray]
    span: Span
    labels: Mapping[str, Any]


@dataclass(frozen=True)
class _Series:
    """Elements of a port at times of their own."""

    names: tuple[str, ...]
    t: FloatArray
    values: FloatArray
    """[n, elements] in the unit of the port, before it is differentiated."""
    signal: Signal


def import_log(
    mapping_file: Path, log_file: Path, folder: Path, overwrite: bool = False, labels: Mapping[str, Any] | None = None
) -> tuple[list[Imported], str]:
    """Read `log_file` as `mapping_file` says and write the run `folder`; `labels` go before those of the mapping.

    Where the mapping cuts the log into repeats, each is a run `folder`/repeat_1, ..., whose time begins at zero. Its number is its label
    `repeat`; they count from the one that is given. Returned are the runs, and a sentence about what was left out ("" if nothing was).
    LogError or ResultsError say what does not fit; nothing is written then.
    """
    mapping = load_mapping(mapping_file)
    kind = mapping.format or format_of(log_file)
    if kind is None:
        known = ", ".join(f"{s} ({k})" for s, k in SUFFIXES.items())
        raise LogError(f"{log_file}: the format of {log_file.suffix!r} is not known; known: {known}; or set log.format in {mapping_file}")
    log = read_log(log_file, kind, mapping.csv, mapping.stamps)
    timing = Timing.read(mapping.clock, log)
    series, ports = _series(mapping, log, timing)
    base = timing.of_rows((), len(series[0].values)) if timing.t is None else timing.t
    first, last = _covered(mapping, series)
    step = mapping.clock.step or float(np.median(np.diff(base)))
    pieces, left_out = spans(mapping.cut, log, (first, last + step), timing.seconds, timing.of_rows)
    given = {**mapping.labels, **(labels or {})}
    runs: list[_Piece] = []
    for number, (begin, end) in enumerate(pieces, 1):
        t = timing.within(base, begin, end, last)
        if len(t) <= 1:
            raise LogError(
                f"{mapping.cut.place}: piece {number} of {len(pieces)}, {begin:.9g} s to {end:.9g} s, has {len(t)} rows; "
                "expected at least 2: leave short pieces out with length, or choose the window"
            )
        columns = {name: _shown(mapping, s, t, i) for s in series for i, name in enumerate(s.names)}
        if mapping.cut.repeats:
            repeat = _first_repeat(mapping, given) + number - 1
            runs.append(_Piece(folder / f"{REPEAT}{repeat}", t - begin, columns, (begin, end), {**given, "repeat": repeat}))
        else:
            runs.append(_Piece(folder, t, columns, (begin, end), given))
    _make_room(folder, [r.folder for r in runs], mapping.cut.repeats, overwrite)
    source = {
        "log": log_file.name,
        "log_sha256": _digest(log_file),
        "mapping": mapping_file.name,
        "mapping_sha256": _digest(mapping_file),
        "format": kind,
        "filtered": any(s.low_pass or s.derivative for s in mapping.signals),
        "resampled": mapping.clock.step > 0.0 or not all(np.array_equal(s.t, base) for s in series),
    }
    for r in runs:
        about = {**source, "begin": r.span[0], "end": r.span[1], "date": timing.date(r.span[0])}
        info = {**mapping.about, "imported": about, "labels": r.labels, "parameters": dict(mapping.parameters)}
        write_run(r.folder, r.t, r.columns, ports, info, overwrite)
    return [
        Imported(r.folder, len(r.t), float(np.median(np.diff(r.t))), tuple(r.columns), r.span, _gap(base, r.span)) for r in runs
    ], left_out


def _gap(base: FloatArray, span: Span) -> Span | None:
    """The longest time between two rows of the clock `base` in a span, if at least one row is missing there."""
    t = base[(base >= span[0] - TICK) & (base < span[1] - TICK)]
    steps = np.diff(t)
    if not len(steps) or round(float(steps.max() / np.median(np.diff(base)))) <= 1:
        return None
    k = int(steps.argmax())
    return float(t[k]), float(t[k + 1])


def _first_repeat(mapping: LogMapping, labels: Mapping[str, Any]) -> int:
    first = labels.get("repeat", 1)
    if isinstance(first, bool) or not isinstance(first, int):
        raise LogError(f"{mapping.file}: [labels] repeat: expected a whole number, from which the repeats count; found {first!r}")
    return first


def _make_room(folder: Path, places: Sequence[Path], repeats: bool, overwrite: bool) -> None:
    """Remove repeats of an earlier import that are not replaced, or refuse what is there."""
    stale = sorted({f for f in folder.glob(f"{REPEAT}*") if f.is_dir()} - set(places)) if repeats else []
    for place in stale:
        if overwrite:
            remove_run(place)
    if not overwrite:
        for place in (*places, *stale):
            refuse_taken(place)


def _digest(file: Path) -> str:
    """SHA-256 of a file, or of all files in a folder, in the order of their names."""
    digest = hashlib.sha256()
    for f in sorted(file.rglob("*")) if file.is_dir() else [file]:
        if f.is_file():
            digest.update(f.read_bytes())
    return digest.hexdigest()


def _series(mapping: LogMapping, log: Log, timing: Timing) -> tuple[list[_Series], dict[str, PortData]]:
    """All signals, and their ports by element."""
    series: list[_Series] = []
    ports: dict[str, PortData] = {}
    for signal in mapping.signals:
        names = [n for c in signal.columns for n in log.elements(c)]
        values, unit = _values(mapping, signal, log, names)
        elements = _elements(mapping, signal, names, values.shape[1])
        for name in elements:
            if name in ports:
                raise _problem(mapping, signal, f"{name} is given twice; give each element in one signal only")
            ports[name] = PortData(
                name.partition(".")[2], "output", "real", rate_of(unit, signal.derivative), description=signal.description
            )
        series.append(_Series(elements, timing.of_rows(names, len(values)) + signal.shift, values, signal))
    return series, ports


def _elements(mapping: LogMapping, signal: Signal, names: list[str], count: int) -> tuple[str, ...]:
    """Names `component.port`, `component.port[1]` or `component.port[1,1]` of the columns that a signal makes."""
    component = signal.port.partition(".")[0]
    if signal.elements is not None:
        if len(signal.elements) > 1 and count == 1:
            raise _problem(mapping, signal, f"has {len(signal.elements)} elements, one column is given; give one column for each element")
        if len(signal.elements) != count:
            raise _problem(
                mapping, signal, f"has {len(signal.elements)} elements; the mapping gives {count}; give one column for each element"
            )
        return tuple(f"{component}.{e}" for e in signal.elements)
    if signal.shape:
        if math.prod(signal.shape) != count:
            raise _problem(
                mapping,
                signal,
                f"the shape {list(signal.shape)} has {math.prod(signal.shape)} elements, there are {count} columns; correct one of them",
            )
        return tuple(f"{signal.port}[{','.join(str(i + 1) for i in index)}]" for index in np.ndindex(*signal.shape))
    if count == 1:
        return (signal.port,)
    own = [n.rpartition("[")[2] for n in names]
    if len(signal.columns) == 1 and not signal.orientation and all("," in o for o in own):
        return tuple(f"{signal.port}[{o}" for o in own)  # a matrix of the log
    return tuple(f"{signal.port}[{i + 1}]" for i in range(count))


def _problem(mapping: LogMapping, signal: Signal, text: str) -> LogError:
    return LogError(f"{mapping.file}: signal {signal.port}: {text}")


def _values(mapping: LogMapping, signal: Signal, log: Log, names: list[str]) -> tuple[FloatArray, str]:
    """Values [n, elements] in the unit of the port, and that unit."""
    raw = [log[n] for n in names]
    if len({len(r) for r in raw}) > 1:
        lengths = ", ".join(f"{n} {len(r)}" for n, r in zip(names, raw, strict=True))
        raise _problem(mapping, signal, f"columns of different length: {lengths}; take columns of one group, or a signal for each element")
    for name, column in zip(names, raw, strict=True):
        bad = np.flatnonzero(~np.isfinite(column))
        if len(bad):
            raise LogError(
                f"{log.file}: column {name!r} has {len(bad)} values that are no numbers (NaN, infinite or missing), the first in row "
                f"{int(bad[0]) + 1} of {len(column)}; cut the log there or fill the gap before importing"
            )
    unit = _unit(mapping, signal, log, names)
    x = np.stack(raw, axis=1)
    for what, factors in (("scale or sign", signal.scale), ("offset", signal.offset)):
        if factors.ndim and factors.shape != (x.shape[1],):
            raise _problem(mapping, signal, f"{factors.size} values of {what} for {x.shape[1]} columns; give one, or one per column")
    x = unit_of(unit).factor * (signal.scale * x + signal.offset) + unit_of(unit).offset
    target = (None if signal.derivative else signal.target) or unit_of(unit).si
    if are_turns(unit, target):
        x = 2.0 * math.pi * x
    if signal.orientation:
        x, target = _quaternions(mapping, signal, x, unit), "1"
    elif signal.rotation is not None:
        if x.shape[1] != AXES:
            raise _problem(
                mapping, signal, f"a rotation needs three columns x, y, z; there are {x.shape[1]}; give three, or leave rotation out"
            )
        x = x @ signal.rotation.T
    if signal.range is not None:
        least, most = (value.si(target) for value in signal.range.each())
        if least >= most:
            raise signal.range.expected("[lowest, highest]")
        low, high = float(x.min()), float(x.max())
        if low < least or high > most:
            raise _problem(
                mapping,
                signal,
                f"values from {low:.6g} to {high:.6g} {target} are outside the range [{least:g}, {most:g}] {target} "
                f"that the mapping expects; is {unit!r} the wrong unit, or the scale?",
            )
    return x, target


def _shown(mapping: LogMapping, series: _Series, t: FloatArray, element: int) -> FloatArray:
    """An element of a series at the times `t` [n]: low-passed without phase, then differentiated by central differences, if that is asked.

    The low-pass is a Butterworth of 4th order, forwards and backwards: half the amplitude at the corner. Times are evenly spaced then.
    Both see what was recorded before and after these times: a piece of a log does not begin and end where the log does.
    """
    signal = series.signal
    if not signal.low_pass and not signal.derivative:
        return np.interp(t, series.t, series.values[:, element])
    if not mapping.clock.step and not mapping.clock.rate:
        raise _problem(mapping, signal, "low_pass and derivative need evenly spaced times; set clock.step (or clock.rate)")
    h = mapping.clock.step or 1.0 / mapping.clock.rate
    if signal.low_pass >= 0.5 / h:
        raise _problem(mapping, signal, f"low_pass is {signal.low_pass:g} Hz; expected less than half the rate, {0.5 / h:g} Hz")
    around = signal.derivative + (math.ceil(FORGOTTEN / (signal.low_pass * h)) if signal.low_pass else 0)
    before, after = (min(around, max(math.floor(room / h + TICK), 0)) for room in (t[0] - series.t[0], series.t[-1] - t[-1]))
    grid = np.concatenate([t[0] - h * np.arange(before, 0, -1), t, t[-1] + h * np.arange(1, after + 1)])
    x = np.interp(grid, series.t, series.values[:, element])
    if signal.low_pass:
        if len(x) <= MIRRORED:
            raise _problem(
                mapping, signal, f"low_pass needs more than {MIRRORED} rows, there are {len(x)}; import a longer log, or leave it out"
            )
        x = x[0] + sosfiltfilt(butter(4, signal.low_pass, fs=1.0 / h, output="sos"), x - x[0])
    for _ in range(signal.derivative):
        x = np.gradient(x, h)
    return np.asarray(x[before : before + len(t)])


def _unit(mapping: LogMapping, signal: Signal, log: Log, names: list[str]) -> str:
    """Unit of the columns in the log: that of the mapping, checked against what the log states, if it states one that is known."""
    stated = sorted({log.units[n] for n in names if n in log.units})
    known = [s for s in stated if compatible(s, s)]
    if signal.unit is None:
        if len(stated) != 1 or not known:
            said = f"the log states {', '.join(repr(s) for s in stated)}" if stated else "the log states none"
            raise _problem(mapping, signal, f"a unit is missing: {said}; add unit to the signal")
        shown = rate_of(known[0], signal.derivative)
        fits = signal.target is None or compatible(shown, signal.target) or are_turns(shown, signal.target)
        if not fits and not signal.orientation:
            raise _problem(
                mapping, signal, f"wrong unit: the port is in {signal.target}, the log states {known[0]!r}; correct the port or the column"
            )
        return known[0]
    wrong = [s for s in known if not _same(s, signal.unit)]
    if wrong:
        raise _problem(
            mapping, signal, f"wrong unit: the mapping says {signal.unit!r}, the log states {wrong[0]!r}; correct unit in the signal"
        )
    return signal.unit


def _same(a: str, b: str) -> bool:
    """Whether two spellings mean one unit; turns per time are rpm or Hz."""
    if unit_of(a) == unit_of(b):
        return True
    for turns, other in ((a, b), (b, a)):
        if are_turns(turns, other):
            return math.isclose(convert(1.0, turns, other), 1.0)
    return False


def _quaternions(mapping: LogMapping, signal: Signal, x: FloatArray, unit: str) -> FloatArray:
    """Euler angles A, B, C [n,3] rad to quaternions [n,4], scalar first, w >= 0; turned by the rotation of the signal."""
    if x.shape[1] != AXES or not compatible(unit, "rad"):
        raise _problem(
            mapping,
            signal,
            f"orientation 'abc' needs three columns A, B, C in deg or rad; there are {x.shape[1]} in {unit}; correct columns and unit",
        )
    R = rotation_abc(x)
    q = Rotation.from_matrix(R if signal.rotation is None else signal.rotation @ R).as_quat()[:, [3, 0, 1, 2]]
    return np.asarray(np.where(q[:, :1] < 0.0, -q, q))


def _covered(mapping: LogMapping, series: Sequence[_Series]) -> Span:
    """First and last time [s] of what all signals cover."""
    start, end = max(float(s.t[0]) for s in series), min(float(s.t[-1]) for s in series)
    if end <= start:
        raise LogError(
            f"{mapping.file}: the signals have no time in common: the last begins at {start:.9g} s, the first ends at {end:.9g} s"
            "; correct clocks and shifts, or leave signals out"
        )
    return start, end
