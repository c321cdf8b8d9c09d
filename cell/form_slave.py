"""A form as a slave in Python that begins at once: to compile its model takes 13 s, and its record in plain Python 1.7 ms a step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from robomill.models.components.correction import elements, factor, kind_of, place_of
from robomill.orchestration.slaves.protocol import FloatArray, ParameterValue, PortData


class FormSlave:
    """The equation of `models.components.correction` in the master's slave protocol, without parameters; the same numbers."""

    restarts = True

    def __init__(self, name: str, specification: Mapping[str, Any]) -> None:
        self.name = name
        signals, corrected = specification["signals"], specification["corrected"]
        into = [*elements(signals), *elements(corrected, "_in")]
        out = elements(corrected)
        self.ports = (
            *(PortData(n, "input", unit=u, start=0.0) for n, u in into),
            *(PortData(n, "output", unit=u) for n, u in out),
        )
        places = {n: k for k, (n, _) in enumerate(into)}
        at = {n: k for k, (n, _) in enumerate(out)}
        self._m, self._passing = len(into), len(into) - len(out)
        self._terms = [
            (
                at[t["element"]],
                float(t["coefficient"]),
                [(kind_of(f), place_of(f, places, at), f["shape"]) for f in t["factors"]],
            )
            for t in specification["terms"]
        ]
        self._u = [0.0] * self._m
        self._start()

    def _start(self) -> None:
        self._z = [*self._u, *([0.0] * (2 * self._m)), 0.0]
        self._before: list[float] | None = None
        self._started = self._u
        self._y = self._sum()

    def _sum(self) -> list[float]:
        y = self._z[self._passing : self._m]
        for element, coefficient, parts in self._terms:
            value = coefficient
            for kind, variable, shape in parts:
                value *= factor(kind, self._z[variable], shape)
            y[element] += value
        return y

    def configure(self, parameters: Mapping[str, ParameterValue]) -> None:
        """It has no parameters."""

    def initialise(self, start: float, stop: float, step: float) -> None:
        """At the start its outputs follow its inputs."""
        self._start()

    def set_inputs(self, values: FloatArray) -> None:
        """Take all inputs."""
        self._u = values.tolist()

    def step(self, t: float, h: float) -> None:
        """The form at t + h [s]."""
        if self._before is None:
            self._before = self._started = self._u
        rates = ((u - b) / h for u, b in zip(self._u, self._before, strict=True))
        self._z = [*self._u, *rates, *(u - s for u, s in zip(self._u, self._started, strict=True)), t + h]
        self._before = self._u
        self._y = self._sum()

    def get_outputs(self, out: FloatArray) -> None:
        """What passed in the last step, and the form; before the first step with the inputs of now."""
        if self._before is None:
            self._start()
        out[:] = self._y

    def get_state(self) -> Any:
        """All that changes."""
        return self._u, self._z, self._before, self._started, self._y

    def set_state(self, state: Any) -> None:
        """Go back to a state from `get_state`."""
        self._u, self._z, self._before, self._started, self._y = state

    def close(self) -> None:
        """Nothing to free."""
