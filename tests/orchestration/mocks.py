"""Slaves for testing the master: a few lines each, no FMU, no model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from robomill.orchestration.slaves.protocol import FloatArray, ParameterValue, Port, PortData, inputs, outputs
from robomill.orchestration.system.definition import Component, Connection, System


class Mock:
    """A slave made of ports and a function (inputs, time reached) -> outputs; calls are logged.

    `function` is evaluated during initialisation and after each step.
    """

    def __init__(self, name: str, ports: Sequence[Port], function: Callable[[FloatArray, float], Sequence[float]]) -> None:
        self.name, self.ports, self.function = name, tuple(ports), function
        self.u: FloatArray = np.array([float(p.start or 0.0) for p in inputs(ports)])
        self.y: FloatArray = np.zeros(len(outputs(ports)))
        self.t = 0.0
        self.stepped = False
        self.parameters: dict[str, Any] = {}
        self.calls: list[str] = []
        self.closed = 0

    def configure(self, parameters: Mapping[str, ParameterValue]) -> None:
        self.parameters.update(parameters)

    def initialise(self, start: float, stop: float, step: float) -> None:
        self.t = start

    def set_inputs(self, values: FloatArray) -> None:
        self.u[:] = values

    def step(self, t: float, h: float) -> None:
        assert t == self.t or abs(t - self.t) < 1e-12, "steps follow each other"
        self.t, self.stepped = round((t + h) * 1e9) / 1e9, True  # as the master counts
        self.calls.append(f"{self.name}({t:.9g})")
        self.y[:] = self.function(self.u, self.t)

    def get_outputs(self, out: FloatArray) -> None:
        if not self.stepped:
            self.y[:] = self.function(self.u, self.t)
        out[:] = self.y

    def get_state(self) -> Any:
        return self.y.copy(), self.t

    def set_state(self, state: Any) -> None:
        self.y, self.t = state

    def close(self) -> None:
        self.closed += 1


def source(name: str, function: Callable[[float], float], unit: str = "1") -> Mock:
    """A source: y = function(t)."""
    return Mock(name, [PortData("y", "output", unit=unit, dependencies=())], lambda u, t: [function(t)])


def gain(name: str, factor: float = 1.0, offset: float = 0.0, **output: Any) -> Mock:
    """An amplifier: y = factor u + offset, direct feedthrough."""
    ports = [PortData("u", "input", unit="1", start=0.0), PortData("y", "output", **{"unit": "1", "dependencies": ("u",), **output})]
    return Mock(name, ports, lambda u, t: [factor * u[0] + offset])


class Integrator(Mock):
    """The state y' = factor u, exact for an input held over the step; no feedthrough of the instantaneous kind."""

    def __init__(self, name: str, factor: float, start: float) -> None:
        ports = [PortData("u", "input", unit="1", start=0.0), PortData("y", "output", unit="1", dependencies=())]
        super().__init__(name, ports, lambda u, t: [self.value])
        self.factor, self.value = factor, start

    def step(self, t: float, h: float) -> None:
        self.value += h * self.factor * self.u[0]
        super().step(t, h)


def system(slaves: Sequence[Any], *connections: str, algorithm: str = "gauss-seidel", step: float = 0.004, **more: Any) -> System:
    """A system of these slaves; a connection is written "a.y -> b.u", or "a.y => b.u" if delayed."""
    made = []
    for text in connections:
        left, arrow, right = text.split()
        made.append(Connection(left, right, arrow == "=>"))
    components = tuple(Component(s.name, "mock") for s in slaves)
    return System("test", step, components, tuple(made), algorithm, **more)


def resolver(slaves: Sequence[Any]) -> Callable[[str, str], Any]:
    """Gives out the slaves by the name of the instance."""
    by_name = {s.name: s for s in slaves}

    def resolve(source: str, name: str) -> Any:
        if source != "mock":
            raise LookupError(f"unknown component; available: mock (found {source!r})")
        return by_name[name]

    return resolve
