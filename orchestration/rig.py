"""A system that is opened once and run many times with other parameters: what a study of hundreds of short runs needs."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from robomill.orchestration.assembly import Resolver, assemble, attributed, master_of
from robomill.orchestration.runs.memory import Memory
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.multirate import MultiRate
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.parameters import Convert, prepare, same_unit_only

Changes = Mapping[str, Mapping[str, Any]]
"""component -> parameter -> value: a number in the unit of the port."""


class Rig:
    """Runs of one system in memory, each with its own changes of the parameters.

    A run gives the same bits as one that opens everything anew: before each, all components are put back to the state that they had
    after they had been opened and had got the parameters of the system. Where one cannot be (an FMU, a process of its own), every run
    opens all of them. One thread at a time may use it.
    """

    def __init__(
        self, system: System, resolver: Resolver | None = None, convert: Convert = same_unit_only, columns: Collection[str] | None = None
    ) -> None:
        """`columns`: outputs (`component.port`) that are kept, as far as they are there; None: all. Raises what `assemble` raises."""
        self.system, self._resolver, self._convert, self._columns = system, resolver, convert, columns
        assembly = assemble(system, resolver, convert)
        self._slaves = {name: s.inside if isinstance(s, MultiRate) else s for name, s in assembly.slaves.items()}
        self._stays = all(getattr(s, "restarts", False) for s in self._slaves.values())
        if not self._stays:
            assembly.close()
            return
        self._bare = {name: s.get_state() for name, s in self._slaves.items()}
        self._about = assembly.about()
        self._memory = Memory(columns=columns)
        self._master = master_of(assembly, (self._memory,))

    def run(self, changes: Changes, stop: float) -> Run:
        """Run the system with these parameters changed from 0 to `stop` [s]. Raises what `assembly.run` does; that spoils no later run."""
        return self._again(changes, stop) if self._stays else self._anew(changes, stop)

    def _again(self, changes: Changes, stop: float) -> Run:
        for name, slave in self._slaves.items():
            slave.set_state(self._bare[name])
        parameters = dict(self._about["parameters"])
        for name, given in changes.items():
            component = self.system.component(name)
            with attributed(self.system, component):
                slave = self._slaves[name]
                values = prepare(name, slave.ports, given, self._convert, self.system.folder)
                slave.configure(values)
                parameters[name] = {**parameters[name], **values}
        self._memory.about = {**self._about, "parameters": parameters}
        self._master.run(stop, until=self.system.stop_when)
        return self._memory.run()

    def _anew(self, changes: Changes, stop: float) -> Run:
        system = self.system
        for name, given in changes.items():
            system = system.with_parameters(name, given)
        with assemble(system, self._resolver, self._convert) as assembly:
            memory = Memory(assembly.about(), self._columns)
            master_of(assembly, (memory,)).run(stop, until=system.stop_when)
        return memory.run()
