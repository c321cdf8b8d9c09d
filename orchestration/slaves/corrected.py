"""A component behind which, or before which, another one corrects signals: its form was found in data, and it sits on the connection.

The correction is a slave of its own (an FMU, say). Its inputs and outputs are called like ports of the component. What it corrects is one
of its outputs, `torque` say; what passes to it is its input `torque_in`. An input called like a port of the component gets what is there.

Corrected outputs: the component steps, then the correction, with the inputs of the component in this step and its new outputs.
Corrected inputs: the correction steps first, with the outputs that the component had after the last step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robomill.orchestration.errors import SlaveError, unknown
from robomill.orchestration.slaves.playback import passing
from robomill.orchestration.slaves.protocol import FloatArray, ParameterValue, Port, Slave, inputs, leave_initialisation, outputs


class Corrected:
    """The slave `inside`, corrected: to others it has the ports of that one. SlaveError where the ports of the correction do not fit."""

    def __init__(self, inside: Slave, correction: Slave) -> None:
        self.inside, self.correction = inside, correction
        self.restarts = all(getattr(s, "restarts", False) for s in (inside, correction))
        into, out = _places(inputs(inside.ports)), _places(outputs(inside.ports))
        needed, changed = _places(inputs(correction.ports)), _places(outputs(correction.ports))
        self._u, self._y, self._v, self._w = (np.zeros(len(x)) for x in (into, out, needed, changed))
        self._before = any(name in into for name in changed)
        side = into if self._before else out
        what = "input" if self._before else "output"
        for name in changed:
            if name not in side:
                raise SlaveError(f"correction of {inside.name!r}: output {name!r}: {unknown(what, name, list(side))}")
        self._at = np.array([side[name] for name in changed], dtype=np.intp)
        through = {passing(name): name for name in changed}
        self._from_u: list[tuple[int, int]] = []
        self._from_y: list[tuple[int, int]] = []
        for name, k in needed.items():
            wanted = through.get(name, name)
            if wanted not in into and wanted not in out:
                raise SlaveError(f"correction of {inside.name!r}: input {name!r}: {unknown('port', wanted, [*into, *out])}")
            (self._from_u if wanted in into else self._from_y).append((k, into[wanted] if wanted in into else out[wanted]))

    @property
    def name(self) -> str:
        """Name of the instance."""
        return self.inside.name

    @property
    def ports(self) -> Sequence[Port]:
        """Those of the component."""
        return self.inside.ports

    @property
    def warnings(self) -> tuple[str, ...]:
        """Those of the component."""
        return tuple(getattr(self.inside, "warnings", ()))

    def configure(self, parameters: Mapping[str, ParameterValue]) -> None:
        """Pass the parameters on to the component."""
        self.inside.configure(parameters)

    def initialise(self, start: float, stop: float, step: float) -> None:
        """Initialise both."""
        self._y[:] = 0.0
        self.inside.initialise(start, stop, step)
        self.correction.initialise(start, stop, step)

    def leave_initialisation(self) -> None:
        """Both leave it."""
        leave_initialisation(self.inside)
        leave_initialisation(self.correction)

    def set_inputs(self, values: FloatArray) -> None:
        """Inputs of the component; corrected ones reach it with its next step."""
        self._u[:] = values
        if not self._before:
            self.inside.set_inputs(values)
            return
        self._show()  # before the first step, as it is at the start
        corrected = self._u.copy()
        corrected[self._at] = self._corrected()
        self.inside.set_inputs(corrected)

    def step(self, t: float, h: float) -> None:
        """Both step, in the order that the module says."""
        if self._before:
            self._show()
            self.correction.step(t, h)
            corrected = self._u.copy()
            corrected[self._at] = self._corrected()
            self.inside.set_inputs(corrected)
            self.inside.step(t, h)
            self.inside.get_outputs(self._y)
            return
        self.inside.step(t, h)
        self.inside.get_outputs(self._y)
        self._show()
        self.correction.step(t, h)

    def get_outputs(self, out: FloatArray) -> None:
        """Outputs of the component, corrected."""
        self.inside.get_outputs(self._y)
        out[:] = self._y
        if not self._before:
            self._show()
            out[self._at] = self._corrected()

    def _show(self) -> None:
        """The correction gets the signals of now."""
        for k, i in self._from_u:
            self._v[k] = self._u[i]
        for k, i in self._from_y:
            self._v[k] = self._y[i]
        self.correction.set_inputs(self._v)

    def _corrected(self) -> FloatArray:
        self.correction.get_outputs(self._w)
        return self._w

    def get_state(self) -> Any:
        """Both states, and the signals between them."""
        return self.inside.get_state(), self.correction.get_state(), self._u.copy(), self._y.copy()

    def set_state(self, state: Any) -> None:
        """Go back to a state from `get_state`."""
        inside, correction, self._u[:], self._y[:] = state
        self.inside.set_state(inside)
        self.correction.set_state(correction)

    def close(self) -> None:
        """Close both."""
        try:
            self.inside.close()
        finally:
            self.correction.close()


def _places(ports: Sequence[Port]) -> dict[str, int]:
    return {p.name: k for k, p in enumerate(ports)}
