"""A system cut in two: the partner's components on one side of the wire, the robot's on the other.

What crosses the cut comes out of a `Remote`, a slave whose outputs are what came over the wire. The components keep their names, so
both sides record the columns of the whole system.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from robomill.cell.binding import convert, resolve
from robomill.cell.rsi.settings import Link, Signal
from robomill.orchestration.assembly import Assembly, assemble
from robomill.orchestration.errors import OrchestrationError
from robomill.orchestration.loop.master import Master, Observer
from robomill.orchestration.slaves.protocol import FloatArray, ParameterValue, Slave
from robomill.orchestration.system.definition import Component, System

_REMOTE = "rsi:"
HORIZON = 1e6
"""End of a session that nobody has fixed [s]: what FMUs are told."""


class Remote:
    """A component on the other side of the wire: its outputs are `values`, which the link fills, in the units of the ports."""

    def __init__(self, name: str, signals: Sequence[Signal]) -> None:
        self.name = name
        # the end of a step is when they are there: they depend on nothing on this side
        self.ports = tuple(replace(p, start=0.0, dependencies=()) for s in signals for p in s.ports)
        self.values = np.zeros(len(self.ports))

    def configure(self, parameters: Mapping[str, ParameterValue]) -> None:
        """Parameters are set on the other side."""

    def initialise(self, start: float, stop: float, step: float) -> None:
        """Nothing to do."""

    def set_inputs(self, values: FloatArray) -> None:
        """There are no inputs."""

    def step(self, t: float, h: float) -> None:
        """Made on the other side."""

    def get_outputs(self, out: FloatArray) -> None:
        """What came last."""
        out[:] = self.values

    def get_state(self) -> Any:
        """What came last."""
        return self.values.copy()

    def set_state(self, state: Any) -> None:
        """Back to what had come."""
        self.values[:] = state

    def close(self) -> None:
        """Nothing to free."""


@dataclass(frozen=True)
class Side:
    """The components of one side, opened and wired, and what stands for those of the other."""

    assembly: Assembly
    remotes: tuple[Remote, ...]
    notes: tuple[str, ...]
    """Connections that the wire does not carry, or carries later."""

    def close(self) -> None:
        """Close the components."""
        self.assembly.close()


def open_side(system: System, link: Link, partner: bool) -> Side:
    """Open the partner's or the robot's components of `system`. Raises what `assemble` raises."""
    own = [c for c in system.components if (c.name in link.partner) == partner]
    arriving = link.send if partner else link.receive
    made = {name: Remote(name, [s for s in arriving if s.component == name]) for name in dict.fromkeys(s.component for s in arriving)}
    carried = {s.array for s in arriving}
    names = {c.name for c in own}
    connections, notes = [], []
    for c in system.connections:
        source, target = c.source.partition(".")[0], c.target.partition(".")[0]
        if target not in names:
            continue
        if source in names:
            connections.append(c)
        elif c.source.partition("[")[0] not in carried:
            notes.append(f"{c} is not carried by the telegram: the input keeps its start value")
        elif partner:
            connections.append(c)
        else:
            # the answer to a packet is used in the next cycle: that is the delay
            connections.append(replace(c, delayed=False))
            if not c.delayed:
                notes.append(f"{c} is not delayed in the system; over the link it is, by one cycle")

    def resolver(source: str, name: str) -> Slave:
        return made[name] if source.startswith(_REMOTE) else resolve(source, name)

    remote = tuple(Component(name, f"{_REMOTE}{name}") for name in made)
    watched = system.stop_when if (system.stop_when or "").partition(".")[0] in names else None
    side = replace(system, components=(*remote, *own), connections=tuple(connections), stop_when=watched, algorithm="gauss-seidel")
    return Side(assemble(side, resolver, convert), tuple(made.values()), tuple(notes))


def master_of(side: Side, system: System, observers: Sequence[Observer] = ()) -> Master:
    """A master of one side: the loop in Python, because what comes over the wire is copied between its steps."""
    a = side.assembly
    return Master(a.slaves, a.wiring, system.step, "gauss-seidel", observers, check_ranges=system.check_ranges, loop="python")


def warm_up(system: System, link: Link, partner: bool) -> None:
    """Compile and load what the components of a side need, with an instance that is thrown away."""
    side = open_side(system, link, partner)
    try:
        master = master_of(side, system)
        master.initialise(0.0, HORIZON, observed=False)
        master.step()
    except OrchestrationError:
        pass  # inputs of zero need not be a state of the machine; the session says what is wrong
    finally:
        side.close()


class Arriving:
    """Copies values of a telegram to the remotes that they are outputs of."""

    def __init__(self, signals: Sequence[Signal], index: dict[str, int], remotes: Sequence[Remote]) -> None:
        self._parts = []
        for remote in remotes:
            mine = [s for s in signals if s.component == remote.name]
            places = np.array([index[n] for s in mine for n in s.names], np.intp)
            factors = np.array([s.factor for s in mine for _ in s.names])
            self._parts.append((remote.values, places, factors))

    def take(self, values: FloatArray) -> None:
        """`values`: those of the telegram."""
        for out, places, factors in self._parts:
            values.take(places, out=out, mode="clip")
            np.multiply(out, factors, out=out)


class Leaving:
    """Copies outputs of this side to the places of a telegram."""

    def __init__(self, signals: Sequence[Signal], index: dict[str, int], columns: Sequence[str]) -> None:
        self.places = np.array([index[n] for s in signals for n in s.names], np.intp)
        self._sources = np.array([columns.index(f"{s.component}.{p.name}") for s in signals for p in s.ports], np.intp)
        self._factors = np.array([1.0 / s.factor for s in signals for _ in s.names])
        self.values = np.zeros(len(self.places))
        """On the wire, in the order of the signals."""

    def take(self, outputs: FloatArray) -> None:
        """`outputs`: those of all components of this side, in the order of the bus."""
        outputs.take(self._sources, out=self.values, mode="clip")
        np.multiply(self.values, self._factors, out=self.values)
