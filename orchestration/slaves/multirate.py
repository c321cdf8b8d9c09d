"""Components that step more often, or less often, than the system.

`rate = k`: k steps of h / k within each step of the system. The inputs are those of the whole step, held;
the outputs are those after the last of the k steps.

`every = k`: one step of k h in every k-th step of the system (the k-th, the 2 k-th, ...), over the time since its last.
It takes its inputs then and only then; its outputs hold in between. So it runs behind, never ahead: like a
controller that samples, and sets, at t = k h, 2 k h, ... A run that ends between two such times ends before its next step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robomill.orchestration.slaves.native import native_of
from robomill.orchestration.slaves.protocol import FloatArray, ParameterValue, Port, Slave, leave_initialisation, outputs
from robomill.orchestration.system.definition import TICK


class MultiRate:
    """A slave that steps the slave inside at another rate. One of `rate` and `every` is one."""

    def __init__(self, inside: Slave, rate: int = 1, every: int = 1) -> None:
        self.inside, self.rate, self.every = inside, rate, every
        self._held: FloatArray = np.zeros(len(outputs(inside.ports)))
        self.count, self.began = 0, 0.0
        """Steps of the system in the current interval, and when it began [s]."""
        self._stepped = False

    @property
    def name(self) -> str:
        """Name of the instance."""
        return self.inside.name

    @property
    def ports(self) -> Sequence[Port]:
        """Those of the slave inside."""
        return self.inside.ports

    @property
    def due(self) -> bool:
        """Whether the slave inside steps in the coming step of the system."""
        return self.count == self.every - 1

    def configure(self, parameters: Mapping[str, ParameterValue]) -> None:
        """Pass the parameters on."""
        self.inside.configure(parameters)

    def initialise(self, start: float, stop: float, step: float) -> None:
        """`step` [s] is that of the system; the slave inside is told its own."""
        self.count, self._stepped = 0, False
        self.inside.initialise(start, stop, round(step * TICK) * self.every // self.rate / TICK)

    def leave_initialisation(self) -> None:
        """Pass it on."""
        leave_initialisation(self.inside)

    def set_inputs(self, values: FloatArray) -> None:
        """Inputs of this step of the system: they count only if the slave inside steps in it."""
        if not self._stepped or self.due:
            self.inside.set_inputs(values)

    def step(self, t: float, h: float) -> None:
        """From `t` to `t + h` [s]: k steps, or the k-th part of one."""
        self._stepped = True
        ticks, now = round(h * TICK), round(t * TICK)
        if self.count == 0:
            self.began = t
        self.count += 1
        if self.count < self.every:
            return
        self.count = 0
        if self.every > 1:
            self.inside.step(self.began, ticks * self.every / TICK)
        else:
            part = ticks // self.rate
            for i in range(self.rate):
                self.inside.step((now + i * part) / TICK, part / TICK)

    def get_outputs(self, out: FloatArray) -> None:
        """Outputs of the slave inside after its last step."""
        if self.count == 0:
            self.inside.get_outputs(self._held)
        out[:] = self._held

    def get_state(self) -> Any:
        """The state inside, the outputs that are held and where in the interval it is."""
        return self.inside.get_state(), self._held.copy(), self.count, self.began, self._stepped

    def set_state(self, state: Any) -> None:
        """Go back to a state from `get_state`."""
        inner, held, self.count, self.began, self._stepped = state
        self.inside.set_state(inner)
        self._held[:] = held

    def native(self) -> Any:
        """Addresses of the slave inside (see `orchestration.slaves.native`): compiled code counts by itself."""
        return native_of(self.inside)

    def rollback(self) -> Any:
        """That of the slave inside, if it has one and there is nothing else to remember between two steps of the system."""
        return getattr(self.inside, "rollback", lambda: None)() if self.every == 1 else None

    def take_over(self, count: int, began: float, held: FloatArray) -> None:
        """Go on from where compiled code has stepped to: `count` and `began` [s] of the interval, the outputs that are held."""
        self.count, self.began, self._stepped = count, began, True
        self._held[:] = held

    def close(self) -> None:
        """Close the slave inside."""
        self.inside.close()
