"""Python slaves that the generator puts between two components: what no parameter of the models can do.

They exist only in the generator's world. An `Insert` is a function of time and inputs; `insert` rewires a system so that
signals pass through it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from robomill.orchestration.slaves.protocol import FloatArray, PortData, Slave
from robomill.orchestration.system.definition import Component, Connection, System

Function = Callable[[float, float, FloatArray], FloatArray]
"""(t, h, inputs) -> outputs, once per step; h is 0 at the start. Must keep its own state."""
Layout = Mapping[str, tuple[int, str]]
"""Array name -> (elements, unit)."""


class Insert:
    """A slave around a function. `make` gives a fresh function for each run."""

    def __init__(self, name: str, inputs: Layout, outputs: Layout, make: Callable[[], Function]) -> None:
        self.name, self._make = name, make
        self.ports: Sequence[PortData] = tuple(
            PortData(f"{base}[{i + 1}]", causality, "real", unit, 0.0 if causality == "input" else None, description=base)
            for causality, layout in (("input", inputs), ("output", outputs))
            for base, (count, unit) in layout.items()
            for i in range(count)
        )
        self._u = np.zeros(sum(count for count, _ in inputs.values()))
        self._y = np.zeros(sum(count for count, _ in outputs.values()))
        self._running = False

    def configure(self, parameters: Mapping[str, Any]) -> None:
        """It has no parameters."""

    def initialise(self, start: float, stop: float, step: float) -> None:
        """A fresh function."""
        self._running = False

    def set_inputs(self, values: FloatArray) -> None:
        """Keep a copy."""
        self._u[:] = values

    def step(self, t: float, h: float) -> None:
        """Call the function for the step that ends at t + h [s]."""
        self._running = True
        self._y[:] = self._function(t + h, h, self._u)

    def get_outputs(self, out: FloatArray) -> None:
        """Outputs of the last step; before the first those of the function at the start."""
        if not self._running:
            self._function = self._make()
            self._y[:] = self._function(0.0, 0.0, self._u)
        out[:] = self._y

    def get_state(self) -> Any:
        """Not offered: generator runs are neither iterated nor resumed."""
        raise NotImplementedError(f"{self.name}: inserts of the blind generator have no state to save")

    def set_state(self, state: Any) -> None:
        """Not offered."""
        raise NotImplementedError(f"{self.name}: inserts of the blind generator have no state to set")

    def close(self) -> None:
        """Nothing to close."""


def insert(
    system: System, name: str, through: Mapping[str, tuple[str, str]], targets: Sequence[str], beside: Sequence[Connection] = ()
) -> System:
    """The system with component `name` (source `blind:name`) between outputs and those inputs that begin with one of `targets`.

    `through`: output such as `drive.q_link` -> (input, output of the insert); `beside`: further connections into it.
    Delayed connections stay delayed, behind the insert.
    """
    rewired: list[Connection] = []
    for c in system.connections:
        if c.source in through and c.target.partition(".")[0] in targets:
            rewired.append(replace(c, source=f"{name}.{through[c.source][1]}"))
        else:
            rewired.append(c)
    into = [Connection(source, f"{name}.{ports[0]}") for source, ports in through.items()]
    return replace(system, components=(*system.components, Component(name, f"blind:{name}")), connections=(*rewired, *into, *beside))


def resolver(inserts: Mapping[str, Callable[[], Slave]], others: Callable[[str, str], Slave]) -> Callable[[str, str], Slave]:
    """Resolver that knows the inserts and hands on all else."""

    def resolve(source: str, name: str) -> Slave:
        return inserts[name]() if source.startswith("blind:") else others(source, name)

    return resolve
