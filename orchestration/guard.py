"""Watches every output in every step: not a number, infinite, outside its declared range."""

from __future__ import annotations

import math
import sys

import numpy as np

from orchestration.slave import FloatArray, Port
from orchestration.wiring import Wiring

_MAX = sys.float_info.max


class Guard:
    """Bounds of all outputs on the bus. Infinite and NaN are always refused, the declared range if `check_ranges`."""

    def __init__(self, wiring: Wiring, check_ranges: bool = True) -> None:
        self._wiring = wiring
        ports = [p for _, p in wiring.outputs]
        # the largest finite number where there is no bound: comparing with it catches inf, and NaN compares false
        self._low = np.array([-_MAX if p.minimum is None or not check_ranges else p.minimum for p in ports])
        self._high = np.array([_MAX if p.maximum is None or not check_ranges else p.maximum for p in ports])
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
                    return name, _text(self._wiring.outputs[i][1], float(values[i]))
        return None


def _text(port: Port, value: float) -> str:
    unit = "" if port.unit in (None, "1") else f" {port.unit}"
    if math.isnan(value):
        return f"output {port.name} is not a number (NaN)"
    if math.isinf(value):
        return f"output {port.name} is infinite ({value}{unit})"
    low = port.minimum is not None and value < port.minimum
    word, bound = ("below its minimum", port.minimum) if low else ("above its maximum", port.maximum)
    return f"output {port.name} = {value:.9g}{unit} is {word} {bound:.9g}{unit}"
