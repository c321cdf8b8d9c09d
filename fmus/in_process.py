"""A model as a slave of the master without an FMU around it: the same record, the same functions, no C interface between."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robomill.fmus.address import Addresses, Rollback
from robomill.fmus.instance import ComponentError, Instance, State, all_finite
from robomill.fmus.interface import Port, interface_of
from robomill.models.model.declaration import FloatArray, Model


class InProcessSlave:
    """Implements the master's slave protocol (`orchestration.slaves.protocol.Slave`) by structure; nothing is imported from there.

    `plain=True` runs the model uncompiled: for the debugger, print and coverage.
    """

    restarts = True

    def __init__(self, model: Model, name: str | None = None, plain: bool = False) -> None:
        self.name = name or model.name
        self.interface = interface_of(model)
        self.ports: tuple[Port, ...] = self.interface.ports
        self._instance: Instance | None = Instance(self.interface, self.name, plain)
        self._bind(self._instance)

    def _bind(self, instance: Instance) -> None:
        """Views of the record as flat images: reals stand together (see `Model.dtype`)."""
        self._inputs = _Image(self.interface.inputs, instance)
        self._outputs = _Image(self.interface.outputs, instance)

    @property
    def instance(self) -> Instance:
        """The instance behind it; ComponentError after `close`."""
        if self._instance is None:
            raise ComponentError(f"{self.name}: was closed; open it anew")
        return self._instance

    def configure(self, parameters: Mapping[str, Any]) -> None:
        """Set parameters [unit of the port] by element, scalar or whole-array name; tables by rows or the path of a .npy file.

        Start values of inputs are set in the same way.

        ComponentError names the parameter, what was given, what is expected and, for unknown names, what there is.
        """
        instance = self.instance
        for name, value in parameters.items():
            if name in instance.tables:
                instance.load_table(name, value)
                continue
            port = self.interface.by_name.get(name)
            ports = (port,) if port is not None else self._elements(name)
            if ports[0].causality not in ("parameter", "input"):
                raise ComponentError(f"{self.name}: {name} is an {ports[0].causality}; set parameters and inputs only")
            values = [value] if port is not None else self._values(name, value, len(ports))
            for p, v in zip(ports, values, strict=True):
                instance.set(p, v)

    def _elements(self, name: str) -> tuple[Port, ...]:
        found = tuple(p for p in self.ports if p.variable == name)
        if not found:
            known = dict.fromkeys(p.variable for p in self.interface.parameters)
            raise ComponentError(f"{self.name}: unknown parameter {name!r}; available: {', '.join(known) or 'none'}")
        return found

    def _values(self, name: str, value: Any, count: int) -> list[Any]:
        shape = self.interface.model.variable(name).shape
        array = np.asarray(value)
        if array.shape not in (shape, (count,)):
            raise ComponentError(
                f"{self.name}: parameter {name} has shape {list(shape)}; found a value of shape {list(array.shape)}"
                "; give a value of that shape"
            )
        values: list[Any] = array.ravel().tolist()
        return values

    def initialise(self, start: float, stop: float, step: float) -> None:
        """Enter initialisation: outputs follow inputs and parameters until the first step. ComponentError with the model's message.

        Models start at t = 0 and take any horizon; `start`, `stop` and `step` [s] are only checked.
        """
        if not (start < stop and step > 0.0):
            raise ComponentError(f"{self.name}: from {start} s to {stop} s in steps of {step} s: expected start < stop and a positive step")
        self.instance.init()

    def set_inputs(self, values: FloatArray) -> None:
        """Take all inputs [unit of the port], float64[n_inputs]. ComponentError names one that is not finite."""
        self._inputs.write(values)
        self.instance.stale = True

    def leave_initialisation(self) -> None:
        """What the first step does before it steps: after it a state can be kept by `rollback`."""
        self.instance.leave_initialisation()

    def step(self, t: float, h: float) -> None:
        """From t to t + h [s] with the inputs held. ComponentError: component, time and the model's message."""
        self.instance.step(t, h)

    def get_outputs(self, out: FloatArray) -> None:
        """Write all outputs [unit of the port] into `out`, float64[n_outputs]."""
        instance = self.instance
        if instance.stale and not instance.running:
            instance.init()
        self._outputs.read(out)

    def native(self) -> Addresses | None:
        """Addresses for the compiled master, None if the model runs uncompiled. The record stays where it is until `close`."""
        return Addresses(self.instance) if self.instance.compiled else None

    def rollback(self) -> Rollback:
        """A place for a copy of the state, to go back to again and again; after `leave_initialisation`."""
        return Rollback(self.instance)

    def get_state(self) -> State:
        """A copy of the complete state."""
        return self.instance.state()

    def set_state(self, state: State) -> None:
        """Back to a state from `get_state` of this component: the next steps repeat bitwise."""
        self.instance.restore(state)

    def reset(self) -> None:
        """As new: starts, built-in tables."""
        self.instance.reset()

    def close(self) -> None:
        """Give everything up; may be repeated."""
        self._instance = None


class _Image:
    """The inputs or the outputs of an instance as one float64 array."""

    def __init__(self, ports: Sequence[Port], instance: Instance) -> None:
        self._ports = ports
        self._name = instance.name
        self._instance = instance
        reals = [(i, p.reference) for i, p in enumerate(ports) if p.type == "real"]
        self._others = [(i, p) for i, p in enumerate(ports) if p.type != "real"]
        first = reals[0][1] if reals else 0
        self._record: FloatArray = instance.floats[first : first + len(reals)]
        assert [r for _, r in reals] == list(range(first, first + len(reals)))
        positions = [i for i, _ in reals]
        contiguous = positions == list(range(len(positions)))
        self._positions: Any = slice(0, len(positions)) if contiguous else np.array(positions, dtype=np.intp)
        self._finite = np.zeros(len(ports), dtype=np.bool_)

    def write(self, values: FloatArray) -> None:
        """`values` -> record, refused with the name of the port if one is not finite."""
        if not all_finite(values, self._finite):
            bad = int(np.flatnonzero(~np.isfinite(values))[0])
            raise ComponentError(
                f"{self._name}: input {self._ports[bad].name} = {values[bad]} is not a finite number; correct what is connected to it"
            )
        self._record[:] = values[self._positions]
        for i, port in self._others:
            self._instance.set(port, values[i])

    def read(self, out: FloatArray) -> None:
        """Record -> `out`."""
        out[self._positions] = self._record
        for i, port in self._others:
            out[i] = self._instance.integers[port.reference]
