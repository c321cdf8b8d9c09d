"""Logs that must be stopped: faults of recording, not of physics. The same fault is in every run of a case."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from robomill.blind.effects import EVEN
from robomill.blind.outside import Columns
from robomill.models.model.declaration import FloatArray

Fault = Callable[[Columns, FloatArray], None]
"""Changes the columns in place; times in s."""

VECTORS = ("compliance.p_BT_B", "sensor.f_T_T", "sensor.f_S_raw", "drive.q_motor", "drive.torque_motor")
"""Arrays that faults are put into."""


@dataclass(frozen=True)
class BadLog:
    """A fault as drawn: `kind` as in the gate's findings, the array or element it is in, its size."""

    kind: str
    channel: str
    value: float
    unit: str
    apply: Fault


def _members(columns: Columns, array: str) -> list[str]:
    return [n for n in columns if n.partition("[")[0] == array]


def _lag(random: np.random.Generator, array: str) -> BadLog:
    delay = 0.015 * (0.100 / 0.015) ** random.random()

    def apply(columns: Columns, t: FloatArray) -> None:
        for name in _members(columns, array):
            columns[name] = np.interp(t - delay, t, columns[name])

    return BadLog("lag", array, float(delay), "s", apply)


def _sign(random: np.random.Generator, array: str) -> BadLog:
    element = f"{array}[{int(random.integers(1, 4))}]"

    def apply(columns: Columns, t: FloatArray) -> None:
        if element in columns:
            columns[element] = -columns[element]

    return BadLog("sign", element, -1.0, "1", apply)


def _unit(random: np.random.Generator, array: str) -> BadLog:
    factor = {"compliance.p_BT_B": 1e3, "drive.q_motor": 180.0 / math.pi}.get(array, 1e-3 if random.random() < EVEN else 1.0 / 9.81)

    def apply(columns: Columns, t: FloatArray) -> None:
        for name in _members(columns, array):
            columns[name] = factor * columns[name]

    return BadLog("unit", array, float(factor), "1", apply)


def _permuted(random: np.random.Generator, array: str) -> BadLog:
    i, j = ((1, 2), (2, 3), (1, 3))[int(random.integers(3))]
    a, b = f"{array}[{i}]", f"{array}[{j}]"

    def apply(columns: Columns, t: FloatArray) -> None:
        if a in columns:
            columns[a], columns[b] = columns[b], columns[a]

    return BadLog("permuted", f"{array}[{i}],[{j}]", 1.0, "1", apply)


def _constant(random: np.random.Generator, array: str) -> BadLog:
    element, part = f"{array}[{int(random.integers(1, 4))}]", 0.5 * random.random()

    def apply(columns: Columns, t: FloatArray) -> None:
        if element in columns:
            stuck = int(part * len(t))
            columns[element][stuck:] = columns[element][stuck]

    return BadLog("constant", element, float(1.0 - part), "1", apply)


def _filter(random: np.random.Generator, array: str) -> BadLog:
    cutoff = 1.0 + 2.0 * random.random()

    def apply(columns: Columns, t: FloatArray) -> None:
        decay = math.exp(-2.0 * math.pi * cutoff * float(t[-1] - t[0]) / (len(t) - 1))
        for name in _members(columns, array):
            x, state = columns[name], float(columns[name][0])
            y = np.empty_like(x)
            for k in range(len(x)):
                state = decay * state + (1.0 - decay) * float(x[k])
                y[k] = state
            columns[name] = y

    return BadLog("filter", array, float(cutoff), "Hz", apply)


LOG_FAULTS: Mapping[str, Any] = {"lag": _lag, "sign": _sign, "unit": _unit, "permuted": _permuted, "constant": _constant, "filter": _filter}
_NOISY = ("compliance.p_BT_B", "sensor.f_T_T", "drive.q_motor")
"""Arrays in which a lag or a filter shows at all."""


def draw(kind: str, tier: str, random: np.random.Generator) -> BadLog:
    """A fault of that kind; at tier T0, which has no tracker, it is in another array than there would be at T1."""
    arrays: tuple[str, ...] = _NOISY if kind in ("lag", "filter") else VECTORS
    if tier == "T0":
        arrays = arrays[1:]
    fault: BadLog = LOG_FAULTS[kind](random, arrays[int(random.integers(len(arrays)))])
    return fault
