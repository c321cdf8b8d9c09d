"""A log and its mapping become a run folder."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from robomill.logs.mapping import AXES, LogMapping, Signal, load_mapping, rotation_abc
from robomill.logs.reading import SUFFIXES, FloatArray, Log, LogError, read_log
from robomill.models.model.units import UNITS, canonical, compatible, rate_of
from robomill.orchestration.runs.importing import write_run
from robomill.orchestration.slaves.protocol import PortData


@dataclass(frozen=True)
class Imported:
    """What was written."""

    folder: Path
    rows: int
    step: float
    """Median step of the clock [s]."""
    columns: tuple[str, ...]


def import_log(
    mapping_file: Path, log_file: Path, folder: Path, overwrite: bool = False, labels: Mapping[str, Any] | None = None
) -> Imported:
    """Read `log_file` as `mapping_file` says and write the run `folder`; `labels` go before those of the mapping.

    LogError or ResultsError say what does not fit.
    """
    mapping = load_mapping(mapping_file)
    kind = mapping.format or SUFFIXES.get(log_file.suffix.lower())
    if kind is None:
        known = ", ".join(f"{s} ({k})" for s, k in SUFFIXES.items())
        raise LogError(f"{log_file}: the format of {log_file.suffix!r} is not known; known: {known}; or set log.format in {mapping_file}")
    log = read_log(log_file, kind, **mapping.csv)
    clock = _clock(mapping, log)
    times: list[FloatArray] = []
    names: list[list[str]] = []
    values: list[FloatArray] = []
    ports: dict[str, PortData] = {}
    for signal in mapping.signals:
        found, unit, own = _values(mapping, signal, log, clock)
        elements = [signal.port] if found.shape[1] == 1 else [f"{signal.port}[{i + 1}]" for i in range(found.shape[1])]
        if signal.derivative:
            unit = _rate(mapping, signal, unit)
        if signal.size is not None and signal.size > 1 and found.shape[1] == 1:
            raise _problem(mapping, signal, f"has {signal.size} elements, one column is given")
        for name in elements:
            if name in ports:
                raise _problem(mapping, signal, f"{name} is given twice")
            ports[name] = PortData(name.partition(".")[2], "output", "real", unit, description=signal.description)
        times.append(own + signal.shift)
        names.append(elements)
        values.append(found)
    t = _common_time(mapping, clock, times)
    columns: dict[str, FloatArray] = {}
    for signal, own, elements, found in zip(mapping.signals, times, names, values, strict=True):
        same = own.shape == t.shape and bool(np.all(own == t))
        for i, name in enumerate(elements):
            column = np.ascontiguousarray(found[:, i]) if same else np.interp(t, own, found[:, i])
            columns[name] = _smooth(mapping, signal, column) if signal.low_pass or signal.derivative else column
    info = {
        **mapping.about,
        "imported": {
            "log": log_file.name,
            "log_sha256": hashlib.sha256(log_file.read_bytes()).hexdigest(),
            "mapping": mapping_file.name,
            "mapping_sha256": hashlib.sha256(mapping_file.read_bytes()).hexdigest(),
            "format": kind,
            "filtered": any(s.low_pass or s.derivative for s in mapping.signals),
            "resampled": mapping.clock.step > 0.0 or any(s.shift != 0.0 for s in mapping.signals),
        },
        "labels": {**mapping.labels, **(labels or {})},
        "parameters": dict(mapping.parameters),
    }
    write_run(folder, t, columns, ports, info, overwrite)
    return Imported(folder, len(t), float(np.median(np.diff(t))), tuple(columns))


def _problem(mapping: LogMapping, signal: Signal, text: str) -> LogError:
    return LogError(f"{mapping.file}: signal {signal.port}: {text}")


def _clock(mapping: LogMapping, log: Log) -> FloatArray | None:
    """Time [s] of the rows; None if each channel of the log has its own clock or they are counted."""
    c = mapping.clock
    if c.column is None:
        return None
    t = UNITS[c.unit].factor * log[c.column] + c.offset
    _increasing(f"{log.file}: clock {c.column!r}", t)
    return t


def _increasing(what: str, t: FloatArray) -> None:
    if len(t) <= 1:
        raise LogError(f"{what}: has {len(t)} rows; expected at least 2")
    if not np.all(np.isfinite(t)):
        raise LogError(f"{what}: not a number in row {int(np.flatnonzero(~np.isfinite(t))[0]) + 1}")
    bad = np.flatnonzero(np.diff(t) <= 0.0)
    if len(bad):
        k = int(bad[0])
        raise LogError(
            f"{what}: time does not increase from row {k + 1} ({t[k]:.9g} s) to row {k + 2} ({t[k + 1]:.9g} s), "
            f"{len(bad)} times in all; remove doubled or reordered rows, or count the time with clock.rate"
        )


def _values(mapping: LogMapping, signal: Signal, log: Log, clock: FloatArray | None) -> tuple[FloatArray, str, FloatArray]:
    """Values [n, elements] in the unit of the port, that unit, and the time [n] s of the rows, without the shift."""
    names = [n for c in signal.columns for n in log.elements(c)]
    raw = [log[n] for n in names]
    if len({len(r) for r in raw}) > 1:
        raise _problem(
            mapping, signal, f"columns of different length: {', '.join(f'{n} {len(r)}' for n, r in zip(names, raw, strict=True))}"
        )
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
            raise _problem(mapping, signal, f"{factors.size} values of {what} for {x.shape[1]} columns")
    x = UNITS[unit].factor * (signal.scale * x + signal.offset) + UNITS[unit].offset
    target = (signal.target if not signal.derivative else None) or _si(unit)
    if signal.orientation:
        x, target = _quaternions(mapping, signal, x, unit), "1"
    elif signal.rotation is not None:
        if x.shape[1] != AXES:
            raise _problem(mapping, signal, f"a rotation needs three columns x, y, z; there are {x.shape[1]}")
        x = x @ signal.rotation.T
    if signal.size is not None and x.shape[1] != signal.size:
        raise _problem(mapping, signal, f"has {signal.size} elements; the mapping gives {x.shape[1]}")
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
    return x, target, _own_time(mapping, log, names, clock, len(x))


def _unit(mapping: LogMapping, signal: Signal, log: Log, names: list[str]) -> str:
    """Unit of the columns in the log: that of the mapping, checked against what the log states, if it states one."""
    stated = sorted({canonical(log.units[n]) for n in names if n in log.units})
    if signal.unit is None:
        if len(stated) != 1 or stated[0] not in UNITS:
            said = f"the log states {', '.join(repr(s) for s in stated)}" if stated else "the log states none"
            raise _problem(mapping, signal, f"a unit is missing: {said}; add unit to the signal")
        known = signal.target is not None and not signal.orientation and not signal.derivative
        if known and not compatible(stated[0], str(signal.target)):
            raise _problem(mapping, signal, f"wrong unit: the port is in {signal.target}, the log states {stated[0]!r}")
        return stated[0]
    wrong = [s for s in stated if s in UNITS and s != signal.unit]
    if wrong:
        raise _problem(mapping, signal, f"wrong unit: the mapping says {signal.unit!r}, the log states {wrong[0]!r}")
    return signal.unit


def _rate(mapping: LogMapping, signal: Signal, unit: str) -> str:
    """SI unit of the derivative of a signal."""
    found = rate_of(unit, signal.derivative)
    if found is None:
        raise _problem(
            mapping, signal, f"derivative {signal.derivative} of what is in {unit} has no unit in the table of units; leave it out"
        )
    return found


def _smooth(mapping: LogMapping, signal: Signal, x: FloatArray) -> FloatArray:
    """The signal `x` [n] at evenly spaced times: low-passed without phase, then differentiated by central differences.

    The low-pass is a Butterworth of 4th order, forwards and backwards: half the amplitude at the corner.
    """
    from scipy.signal import butter, sosfiltfilt

    if not mapping.clock.step and not mapping.clock.rate:
        raise _problem(mapping, signal, "low_pass and derivative need evenly spaced times; set clock.step (or clock.rate)")
    h = mapping.clock.step or 1.0 / mapping.clock.rate
    if signal.low_pass:
        if signal.low_pass >= 0.5 / h:
            raise _problem(mapping, signal, f"low_pass is {signal.low_pass:g} Hz; expected less than half the rate, {0.5 / h:g} Hz")
        x = x[0] + sosfiltfilt(butter(4, signal.low_pass, fs=1.0 / h, output="sos"), x - x[0])
    for _ in range(signal.derivative):
        x = np.gradient(x, h)
    return np.asarray(x)


def _si(unit: str) -> str:
    """The SI unit that measures the same."""
    return next(u for u, v in UNITS.items() if v.factor == 1.0 and v.offset == 0.0 and v.exponents == UNITS[unit].exponents)


def _quaternions(mapping: LogMapping, signal: Signal, x: FloatArray, unit: str) -> FloatArray:
    """Euler angles A, B, C [n,3] rad to quaternions [n,4], scalar first, w >= 0; turned by the rotation of the signal."""
    if x.shape[1] != AXES or not compatible(unit, "rad"):
        raise _problem(mapping, signal, f"orientation 'abc' needs three columns A, B, C in deg or rad; there are {x.shape[1]} in {unit}")
    R = rotation_abc(x)
    q = Rotation.from_matrix(R if signal.rotation is None else signal.rotation @ R).as_quat()[:, [3, 0, 1, 2]]
    return np.asarray(np.where(q[:, :1] < 0.0, -q, q))


def _own_time(mapping: LogMapping, log: Log, names: list[str], clock: FloatArray | None, rows: int) -> FloatArray:
    """Time of the rows of a signal: the clock of the mapping, or that of the channel where the log has one (MDF4)."""
    c = mapping.clock
    if clock is None:
        return np.arange(rows) / c.rate + c.offset
    if len(clock) == rows and all(log.clocks.get(n, c.column) == c.column for n in names):
        return clock
    own = sorted({log.clocks[n] for n in names if n in log.clocks})
    if len(own) != 1:
        raise LogError(f"{log.file}: column {names[0]!r} has {rows} rows, the clock {c.column!r} has {len(clock)}")
    t = log[own[0]] + c.offset
    _increasing(f"{log.file}: clock {own[0]!r}", t)
    return t


def _common_time(mapping: LogMapping, clock: FloatArray | None, times: list[FloatArray]) -> FloatArray:
    """Times of the run: those of the clock (or of the first signal) that all signals cover, or the grid of clock.step."""
    base = times[0] if clock is None else clock
    start, end = max(float(t[0]) for t in times), min(float(t[-1]) for t in times)
    if end <= start:
        raise LogError(
            f"{mapping.file}: the signals have no time in common: the last begins at {start:.9g} s, the first ends at {end:.9g} s"
        )
    if mapping.clock.step > 0.0:
        h = mapping.clock.step
        count = int(np.floor((end - start) / h * (1.0 + 1e-12) + 1e-6))
        return np.asarray(start + h * np.arange(count + 1))
    return np.asarray(base[(base >= start) & (base <= end)])
