"""Watches every output in every step: not a number, infinite, outside its declared range, a whole number that does not fit."""

from __future__ import annotations

import math
import sys

import numpy as np

from robomill.orchestration.slaves.protocol import FloatArray, Port
from robomill.orchestration.system.wiring import Wiring

_MAX = sys.float_info.max


class Guard:
    """Bounds of all outputs on the bus.

    Infinite and NaN are always refused, and whole numbers that float64 or the type of an input would change; the declared range
    if `check_ranges`.
    """

    def __init__(self, wiring: Wiring, check_ranges: bool = True) -> None:
        self._wiring = wiring
        ports = [p for _, p in wiring.outputs]
        # the largest finite number where there is no bound: comparing with it catches inf, and NaN compares false
        self._low = np.array([-_MAX if p.minimum is None or not check_ranges else p.minimum for p in ports])
        self._high = np.array([_MAX if p.maximum is None or not check_ranges else p.maximum for p in ports])
        for i, ranges in wiring.whole.items():
            self._low[i] = max(self._low[i], *(low for _, low, _ in ranges))
            self._high[i] = min(self._high[i], *(high for _, _, high in ranges))
        self._above, self._below = np.zeros(len(ports), bool), np.zeros(len(ports), bool)

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Least and largest allowed value of each output; the largest finite numbers where there is no bound."""
        return self._low, self._high

    def ok(self, values: FloatArray) -> bool:
        """Whether all outputs are finite and in range."""
        np.greater_equal(values, self._low, out=self._above)
        np.less_equal(values, self._high, out=self._below)
        np.logical_and(self._above, self._below, out=self._above)
        return bool(self._above.all())

    def problem(self, values: FloatArray) -> tuple[str, str] | None:
        """(component, text) of the first output that is not all right, in the order of execution; None if all are."""
        bad = ~((values >= self._low) & (values <= self._high))
        for name in self._wiring.order:
            part = self._wiring.output_slice[name]
            for i in range(part.start, part.stop):
                if bad[i]:
                    port, value = self._wiring.outputs[i][1], float(values[i])
                    return name, self._unfit(i, value) or _text(port, value)
        return None

    def unfit(self, values: FloatArray) -> bool:
        """Whether there is a whole number among the outputs that does not get unchanged to where it goes."""
        return any(self._unfit(i, float(values[i])) for i in self._wiring.whole)

    def _unfit(self, i: int, value: float) -> str:
        """What is wrong with the whole number at place `i`; empty if it fits."""
        for target, low, high in self._wiring.whole.get(i, ()):
            if math.isfinite(value) and not low <= value <= high:
                to = f"does not fit input {target}" if target else "cannot be carried exactly (as float64)"
                return f"output {self._wiring.outputs[i][1].name} = {value:.0f} {to}: expected a whole number from {low} to {high}"
        return ""


def _text(port: Port, value: float) -> str:
    unit = "" if port.unit in (None, "1") else f" {port.unit}"
    if math.isnan(value):
        return f"output {port.name} is not a number (NaN)"
    if math.isinf(value):
        return f"output {port.name} is infinite ({value}{unit})"
    low = port.minimum is not None and value < port.minimum
    word, bound = ("below its minimum", port.minimum) if low else ("above its maximum", port.maximum)
    return f"output {port.name} = {value:.9g}{unit} is {word} {bound:.9g}{unit}"
