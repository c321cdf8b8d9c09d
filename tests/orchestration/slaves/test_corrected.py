"""A component with a correction: outputs behind it, inputs before it, and errors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from robomill.orchestration.assembly import run
from robomill.orchestration.errors import SystemFileError
from robomill.orchestration.slaves.corrected import Corrected
from robomill.orchestration.slaves.protocol import FloatArray, ParameterValue, PortData
from robomill.orchestration.system.definition import Component, Connection, System

STEP = 0.1


class Block:
    """outputs = function(inputs, memory), once per step; before the first with the inputs of now."""

    restarts = True

    def __init__(self, name: str, into: list[str], out: list[str], function: Any) -> None:
        self.name, self._function = name, function
        self.ports = (*(PortData(n, "input", start=0.0) for n in into), *(PortData(n, "output") for n in out))
        self._u, self._y, self._t = np.zeros(len(into)), np.zeros(len(out)), 0.0

    def configure(self, parameters: dict[str, ParameterValue]) -> None:
        pass

    def initialise(self, start: float, stop: float, step: float) -> None:
        self._t = 0.0
        self._y[:] = self._function(self._u, 0.0, self._y * 0.0)

    def set_inputs(self, values: FloatArray) -> None:
        self._u[:] = values
        if self._t == 0.0:
            self._y[:] = self._function(self._u, 0.0, self._y * 0.0)

    def step(self, t: float, h: float) -> None:
        self._t = t + h
        self._y[:] = self._function(self._u, self._t, self._y)

    def get_outputs(self, out: FloatArray) -> None:
        out[:] = self._y

    def get_state(self) -> Any:
        return self._u.copy(), self._y.copy(), self._t

    def set_state(self, state: Any) -> None:
        self._u[:], self._y[:], self._t = state

    def close(self) -> None:
        pass


PARTS = {
    "clock": lambda: Block("clock", [], ["t"], lambda u, t, y: [t]),
    "axis": lambda: Block("axis", ["force"], ["way", "speed"], lambda u, t, y: [y[0] + STEP * u[0] if t else 0.0, u[0]]),
    "twice the force on the way": lambda: Block("c", ["way_in", "force"], ["way"], lambda u, t, y: [u[0] + 2.0 * u[1]]),
    "drag": lambda: Block("c", ["force_in", "way"], ["force"], lambda u, t, y: [u[0] - 3.0 * u[1]]),
    "unknown output": lambda: Block("c", [], ["wey"], lambda u, t, y: [0.0]),
    "unknown input": lambda: Block("c", ["forse"], ["way"], lambda u, t, y: [0.0]),
}


def resolve(source: str, name: str) -> Any:
    return PARTS[source]()


SYSTEM = System("axis", STEP, (Component("clock", "clock"), Component("axis", "axis")), (Connection("clock.t", "axis.force"),))


def test_an_output_is_corrected_with_the_signals_of_the_same_step() -> None:
    plain = run(SYSTEM, stop=1.0, resolver=resolve)
    found = run(SYSTEM.with_correction("axis", "twice the force on the way"), stop=1.0, resolver=resolve)
    assert found["axis.way"].tolist() == (plain["axis.way"] + 2.0 * plain["clock.t"]).tolist()
    assert found["axis.speed"].tolist() == plain["axis.speed"].tolist()
    assert found.info["corrections"] == {"axis": "twice the force on the way"}


def test_an_input_is_corrected_with_the_outputs_of_the_last_step() -> None:
    found = run(SYSTEM.with_correction("axis", "drag"), stop=1.0, resolver=resolve)
    way, force = found["axis.way"], found["clock.t"]
    assert way[-1] != 0.0
    np.testing.assert_array_equal(found["axis.speed"][1:], force[1:] - 3.0 * way[:-1])


@pytest.mark.parametrize(
    ("source", "text"),
    [
        ("unknown output", "correction of 'axis': output 'wey': unknown output 'wey'"),
        ("unknown input", "correction of 'axis': input 'forse': unknown port 'forse'"),
    ],
)
def test_a_correction_that_does_not_fit_is_refused(source: str, text: str) -> None:
    with pytest.raises(SystemFileError, match=text):
        run(SYSTEM.with_correction("axis", source), stop=1.0, resolver=resolve)


def test_a_state_is_that_of_both() -> None:
    slave = Corrected(PARTS["axis"](), PARTS["drag"]())
    out, again = np.zeros(2), np.zeros(2)
    slave.initialise(0.0, 1.0, STEP)
    slave.set_inputs(np.array([1.0]))
    slave.step(0.0, STEP)
    state = slave.get_state()
    for y in (out, again):
        slave.set_state(state)
        slave.set_inputs(np.array([2.0]))
        slave.step(STEP, STEP)
        slave.get_outputs(y)
    assert out.tolist() == again.tolist()
    assert slave.restarts
    slave.close()


def test_a_system_without_corrections_says_nothing_of_them() -> None:
    assert "corrections" not in run(replace(SYSTEM), stop=1.0, resolver=resolve).info
