"""The one interface between the master and a component, wherever the component comes from.

A slave is an FMU (`orchestration.slaves.fmu`), an in-process model (given from outside by a resolver) or
a recording (`orchestration.slaves.playback`). The master calls it in this order::

    configure(parameters)                              # any number of times, before initialise
    initialise(start, stop, step)                      # enters initialisation; inputs at their starts
    set_inputs(u); get_outputs(y)                      # any number of times, t = start
    leave_initialisation(); get_outputs(y)             # the outputs at the start
    [ set_inputs(u); step(t, h); get_outputs(y) ] ...
    close()                                            # always, also after an error; may be repeated

`leave_initialisation()` is there where it does something; a slave that was not told to leave does so in its first step.
A slave may also have `native()`: addresses for the compiled loop (`orchestration.slaves.native`), and `warnings`: texts, what one should
know before it runs. One with `restarts = True` gives its state before it is initialised, too, and can be put back to it whatever has
happened since, to be configured and run again; the addresses that it has given stay valid (`orchestration.rig`).

`Slave` and `Port` are protocols: who implements them need not import this file. Ports are scalars.
An element of an array is a port called `base[1]`, `base[2]` or `base[1,2]` (counted from one); the
elements of an array stand next to each other, in C order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Scalar = float | int | bool | str
ParameterValue = Scalar | Sequence[Any]
CARRIED = ("real", "integer", "boolean")
"""Types of ports that can be connected and recorded: numbers on the bus. The others (string, binary, clock) keep their values."""
EXACT = 2**53 - 1
"""Largest whole number that float64 tells from all others: what goes from component to component is float64."""
INT64 = (-(2**63), 2**63 - 1)


class Port(Protocol):
    """One scalar variable of a component as others see it.

    Inputs and outputs that are real, integer (enumerations, too) or boolean can be connected; on the bus all are float64
    (booleans 0.0 and 1.0). Those of other types are there to be named, and stay at their starts. Parameters may be strings.
    Values, start, minimum and maximum are in `unit`.
    A port may also have `limits`: (least, largest) whole number that its type holds, and all between; see `whole_range`.
    """

    @property
    def name(self) -> str:
        """Name of the element: `x`, `q[1]`."""
        ...

    @property
    def causality(self) -> str:
        """`input`, `output`, `parameter`, or `structural parameter`, which cannot be set."""
        ...

    @property
    def type(self) -> str:
        """`real`, `integer`, `boolean`, `string`, `binary` or `clock`."""
        ...

    @property
    def unit(self) -> str | None:
        """Unit of the value; None = not declared, which matches every unit. Dimensionless is "1"."""
        ...

    @property
    def start(self) -> Scalar | None:
        """Value before anything is set; None = not declared."""
        ...

    @property
    def minimum(self) -> float | None:
        """Least value allowed, None = unbounded."""
        ...

    @property
    def maximum(self) -> float | None:
        """Largest value allowed, None = unbounded."""
        ...

    @property
    def description(self) -> str:
        """One line for people."""
        ...

    @property
    def dependencies(self) -> tuple[str, ...] | None:
        """Outputs only: element names of the inputs it is an instantaneous function of in a step; None = unknown = all."""
        ...


@dataclass(frozen=True, slots=True)
class PortData:
    """A `Port` as plain data."""

    name: str
    causality: str
    type: str = "real"
    unit: str | None = None
    start: Scalar | None = None
    minimum: float | None = None
    maximum: float | None = None
    description: str = ""
    dependencies: tuple[str, ...] | None = None
    limits: tuple[int, int] | None = field(default=None, compare=False)
    """Least and largest whole number that its type holds, and all between; None = those of 64 bits."""
    items: tuple[tuple[str, int], ...] = ()
    """Names and values of an enumeration."""


@runtime_checkable
class Slave(Protocol):
    """A component that can be stepped.

    Whatever it raises ends the run, with component and time. An exception class of its own is taken to
    speak to users: its text is shown; one of Python's built-in exceptions is shown with its traceback.
    """

    @property
    def name(self) -> str:
        """Name of the instance in the system, for messages."""
        ...

    @property
    def ports(self) -> Sequence[Port]:
        """All inputs, outputs and parameters; the order of inputs (outputs) here is that of `set_inputs` (`get_outputs`)."""
        ...

    def configure(self, parameters: Mapping[str, ParameterValue]) -> None:
        """Set parameters, and start values of inputs, before `initialise`, in the unit of their port.

        A key is an element (`q[1]`), a scalar, or the base name of an array with a (nested) sequence of its shape.
        """
        ...

    def initialise(self, start: float, stop: float, step: float) -> None:
        """Enter initialisation at time `start` [s]; the run will go to `stop` [s, may be inf] in steps of `step` [s]."""
        ...

    def set_inputs(self, values: FloatArray) -> None:
        """Take all inputs, float64[n_inputs]. The slave copies what it keeps: the array is reused."""
        ...

    def step(self, t: float, h: float) -> None:
        """Advance from `t` [s] to `t + h` [s] with the inputs held."""
        ...

    def get_outputs(self, out: FloatArray) -> None:
        """Write all outputs into `out`, float64[n_outputs].

        In initialisation they are consistent with the inputs set so far, as far as the slave knows them then; after it they
        are those at the start, and then those of the last step.
        """
        ...

    def get_state(self) -> Any:
        """A copy of the complete state, for `set_state` of this instance; an error if it cannot be saved."""
        ...

    def set_state(self, state: Any) -> None:
        """Go back to a state from `get_state`: the next steps repeat bitwise."""
        ...

    def close(self) -> None:
        """Free everything; may be called at any time, and again."""
        ...


def leave_initialisation(slave: Slave) -> None:
    """Have a slave leave initialisation, if that is anything to it."""
    leave = getattr(slave, "leave_initialisation", None)
    if leave is not None:
        leave()


def plain(p: Port) -> PortData:
    """A port as plain data."""
    about = (p.name, p.causality, p.type, p.unit, p.start, p.minimum, p.maximum, p.description, p.dependencies)
    return PortData(*about, getattr(p, "limits", None), tuple(items(p).items()))


def items(p: Port) -> dict[str, int]:
    """Value by name of the items of an enumeration; only ports of FMUs have them."""
    return dict(getattr(p, "items", ()))


def whole_range(p: Port) -> tuple[int, int]:
    """Least and largest whole number that gets to this port unchanged: parameters as they are, inputs and outputs as float64."""
    low, high = getattr(p, "limits", None) or INT64
    return (low, high) if p.causality == "parameter" else (max(low, -EXACT), min(high, EXACT))


@cache
def base_name(name: str) -> str:
    """Name of the array that an element belongs to: `q[1]` -> `q`; a scalar's own name stays."""
    return name[: name.rindex("[")] if name.endswith("]") and "[" in name else name


def inputs(ports: Sequence[Port]) -> tuple[Port, ...]:
    """The input ports that can be connected, in the order of `Slave.set_inputs`."""
    return tuple(p for p in ports if p.causality == "input" and p.type in CARRIED)


def outputs(ports: Sequence[Port]) -> tuple[Port, ...]:
    """The output ports that can be connected, in the order of `Slave.get_outputs`."""
    return tuple(p for p in ports if p.causality == "output" and p.type in CARRIED)


def arrays(ports: Sequence[Port]) -> dict[str, tuple[Port, ...]]:
    """Elements by base name, in their order; a scalar is an entry of one element under its own name."""
    found: dict[str, list[Port]] = {}
    for p in ports:
        found.setdefault(base_name(p.name), []).append(p)
    return {name: tuple(elements) for name, elements in found.items()}
