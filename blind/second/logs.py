"""How runs are logged: noise of the instruments, stamps of the logger, and what may go wrong with a log. Own draws, own colours."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from robomill.blind.second.kernel import FloatArray
from robomill.blind.world import MEASURED, NOISE, STEP, TRACKER

Columns = dict[str, FloatArray]
ARRAYS = (TRACKER, "sensor.f_T_T", "sensor.f_S_raw", "drive.q_motor", "drive.torque_motor")
"""Arrays that a fault may be in; the first one needs a tracker."""
LATE_START = 3.5e-3
"""s by which the first stamp of a good log may be late."""
PER_SET = ("copies", "aborted")
"""Faults of the set of runs, not of each."""


def coloured(n: int, tau: float, random: np.random.Generator) -> FloatArray:
    """An Ornstein-Uhlenbeck process of unit variance, (n,), correlation time tau [s]."""
    decay = math.exp(-STEP / tau)
    white = random.standard_normal(n) * math.sqrt(1.0 - decay**2)
    white[0] = random.standard_normal()
    found: FloatArray = lfilter([1.0], [1.0, -decay], white)
    return found


def measured(columns: Columns, tier: str, tau: float, random: np.random.Generator) -> Columns:
    """What the instruments show: white noise, noise of correlation time tau [s], an offset of each run.

    The draws do not depend on the tier.
    """
    result: Columns = {}
    for array in (*MEASURED, TRACKER):
        white, colour, offset = NOISE.get(array, (0.0, 0.0, 0.0))
        for name in (k for k in columns if k.partition("[")[0] == array):
            values = columns[name].copy()
            if white > 0.0:
                values += white * random.standard_normal(len(values)) + colour * coloured(len(values), tau, random)
                values += offset * random.standard_normal()
            if tier != "T0" or array != TRACKER:
                result[name] = values
    return result


def stamps(t: FloatArray, random: np.random.Generator) -> FloatArray:
    """Stamps of a good log: drift, jitter (two-sided exponential), and in every second run a first sample that comes late."""
    drift = 1.0 + 5e-6 * float(random.standard_normal())
    found: FloatArray = drift * t + np.clip(random.laplace(0.0, 3e-5, len(t)), -1e-3, 1e-3)
    found -= found[0]
    late = LATE_START * random.random()
    if random.random() < 0.5:
        found[0] = min(late, 0.9 * found[1])
    return found


@dataclass(frozen=True)
class LogFault:
    """A fault as drawn: kind, array or element, size, what it does to the columns of a run."""

    kind: str
    channel: str
    value: float
    unit: str
    apply: Callable[[Columns, FloatArray], None]


Maker = Callable[[np.random.Generator, str], LogFault]


def _members(columns: Columns, array: str) -> list[str]:
    return [n for n in columns if n.partition("[")[0] == array]


def shift(columns: Columns, t: FloatArray, names: list[str], delay: float) -> None:
    """Make columns late by a time [s], in place."""
    for name in names:
        columns[name] = np.interp(t - delay, t, columns[name])


def _lag(random: np.random.Generator, array: str) -> LogFault:
    delay = float(0.015 * (0.1 / 0.015) ** random.random())
    return LogFault("lag", array, delay, "s", lambda c, t: shift(c, t, _members(c, array), delay))


def _late_clock(random: np.random.Generator, array: str) -> LogFault:
    device = array.partition(".")[0]
    delay = float(0.015 * (0.1 / 0.015) ** random.random())
    return LogFault("late_clock", device, delay, "s", lambda c, t: shift(c, t, [n for n in c if n.startswith(f"{device}.")], delay))


def _scaled(kind: str, factor: float, names: Callable[[Columns], list[str]], channel: str) -> LogFault:
    def apply(columns: Columns, t: FloatArray) -> None:
        for name in names(columns):
            columns[name] = factor * columns[name]

    return LogFault(kind, channel, factor, "1", apply)


def _sign(random: np.random.Generator, array: str) -> LogFault:
    element = f"{array}[{int(random.integers(1, 4))}]"
    return _scaled("sign", -1.0, lambda c: [element], element)


def _unit(random: np.random.Generator, array: str) -> LogFault:
    factor = {TRACKER: 1e3, "drive.q_motor": math.degrees(1.0)}.get(array, float(random.choice([1e-3, 1e3, 1.0 / 9.81])))
    return _scaled("unit", factor, lambda c: _members(c, array), array)


def _permuted(random: np.random.Generator, array: str) -> LogFault:
    i, j = (int(k) + 1 for k in random.choice(3, 2, replace=False))

    def apply(columns: Columns, t: FloatArray) -> None:
        a, b = f"{array}[{i}]", f"{array}[{j}]"
        columns[a], columns[b] = columns[b], columns[a]

    return LogFault("permuted", f"{array}[{min(i, j)}],[{max(i, j)}]", 1.0, "1", apply)


def _swapped_axes(random: np.random.Generator, array: str) -> LogFault:
    """A vector in axes that are a quarter turn off."""
    about = int(random.integers(3))
    i, j = (about + 1) % 3 + 1, (about + 2) % 3 + 1

    def apply(columns: Columns, t: FloatArray) -> None:
        a, b = f"{array}[{i}]", f"{array}[{j}]"
        columns[a], columns[b] = -columns[b], columns[a]

    return LogFault("swapped_axes", f"{array}[{i}],[{j}]", 90.0, "deg", apply)


def _constant(random: np.random.Generator, array: str) -> LogFault:
    element, part = f"{array}[{int(random.integers(1, 4))}]", 0.5 * random.random()

    def apply(columns: Columns, t: FloatArray) -> None:
        k = int(part * len(t))
        columns[element][k:] = columns[element][k]

    return LogFault("constant", element, float(1.0 - part), "1", apply)


def _filter(random: np.random.Generator, array: str) -> LogFault:
    cutoff, order = float(random.uniform(1.0, 3.0)), int(random.integers(1, 3))

    def apply(columns: Columns, t: FloatArray) -> None:
        decay = math.exp(-2.0 * math.pi * cutoff * STEP)
        for name in _members(columns, array):
            values = columns[name] - columns[name][0]
            for _ in range(order):
                values = lfilter([1.0 - decay], [1.0, -decay], values)
            columns[name] = values + columns[name][0]

    return LogFault("filter", array, cutoff, "Hz", apply)


def _copies(random: np.random.Generator, array: str) -> LogFault:
    return LogFault("copies", "", 1.0, "1", lambda c, t: None)


def _aborted(random: np.random.Generator, array: str) -> LogFault:
    return LogFault("aborted", "", float(random.uniform(0.3, 0.8)), "1", lambda c, t: None)


LOG_FAULTS: Mapping[str, Maker] = {
    "lag": _lag,
    "late_clock": _late_clock,
    "sign": _sign,
    "unit": _unit,
    "permuted": _permuted,
    "swapped_axes": _swapped_axes,
    "constant": _constant,
    "filter": _filter,
    "copies": _copies,
    "aborted": _aborted,
}


def draw(kind: str, tier: str, random: np.random.Generator) -> LogFault:
    """A fault of a kind, in an array that the tier has. LookupError: no such kind."""
    if kind not in LOG_FAULTS:
        raise LookupError(f"fault {kind!r} of the log: expected one of {', '.join(LOG_FAULTS)}")
    arrays: tuple[str, ...] = ARRAYS if tier != "T0" else ARRAYS[1:]
    if kind in ("lag", "late_clock", "filter"):
        arrays = tuple(a for a in arrays if a in (TRACKER, "sensor.f_T_T", "drive.q_motor"))
    return LOG_FAULTS[kind](random, arrays[int(random.integers(len(arrays)))])
