"""Simulations of the conditions with effects on: run once, kept, on as many processes as are wanted."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from robomill.diagnosis.candidates import LOGGING, Address, physical, selects
from robomill.diagnosis.catalogue import Refinement
from robomill.diagnosis.experiment.measured import Condition
from robomill.diagnosis.experiment.observation import observe
from robomill.diagnosis.experiment.pool import pool
from robomill.diagnosis.experiment.store import Store
from robomill.orchestration.assembly import Resolver
from robomill.orchestration.errors import OrchestrationError
from robomill.orchestration.rig import Rig
from robomill.orchestration.slaves.protocol import FloatArray, PortData
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.parameters import Convert, same_unit_only

DRAWS = 3
"""Simulations with other noise, or machines with other calibrated numbers, that stand for all where only a correction or a part of a
deviation comes of them (cost)."""

Setting = tuple[tuple[Address, float], ...]
"""What is changed against the nominal system: address and value [unit of the parameter], sorted."""

FINER: Address = ("", "finer step")
"""The change of a system to a smaller communication step (`refined`), by 1; without a refinement in the catalogue it does nothing."""

Report = Callable[[str, int, int], object]
"""(what is done, how many are done, how many there are)."""


def setting(values: Mapping[Address, float]) -> Setting:
    """What is changed, as a Setting: sorted, without zeros, so that the same change is the same simulation; `values` [unit]."""
    return tuple(sorted((a, float(v)) for a, v in values.items() if v != 0.0))


@dataclass
class Laboratory:
    """What a simulation needs to know; handed to worker processes once.

    n rows are those of the grid of a condition, after block means over `decimation` of them; channels are measured real outputs.
    """

    system: System
    conditions: Sequence[Condition]
    channels: Sequence[str]
    resolver: Resolver | None = None
    convert: Convert = same_unit_only
    quiet: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    nominal: Mapping[Address, float] = field(default_factory=dict)
    """Values that changes are added to, where they are not zero."""
    decimation: int = 1
    seeds: Sequence[Address] = ()
    """Parameters that make a simulation another repeat of itself."""
    refinement: Refinement | None = None
    ports: Mapping[str, PortData] = field(default_factory=dict)
    """The channels, as the system has them."""
    _logged: tuple[tuple[int, Setting], FloatArray | None] | None = field(default=None, init=False, repr=False)
    """The simulation to which faults of the log were last applied."""
    _rigs: dict[tuple[int, int, bool], tuple[Condition, Rig]] = field(default_factory=dict, init=False, repr=False)
    """(thread, index of a condition, whether at a finer step) -> that condition, and its system with the channels that it has."""
    replays: dict[int, tuple[Condition, Any]] = field(default_factory=dict, init=False, repr=False)
    """Index of a condition -> that condition, and its replay with the measured runs (`ComponentReplay.of`)."""

    def __getstate__(self) -> dict[str, Any]:
        """All but what belongs to this process: worker processes open systems of their own."""
        return {**self.__dict__, "_logged": None, "_rigs": {}, "replays": {}}

    def factor(self, index: int) -> int:
        """Points of the grid of condition `index` in a block: as long as `decimation` communication steps of the system, or nearly."""
        return max(1, round(self.decimation * self.system.step / self.conditions[index].step))

    def there(self, name: str) -> npt.NDArray[np.bool_]:
        """Which channels say anything in the condition of that name, [channels]."""
        condition = next(c for c in self.conditions if c.name == name)
        return np.array([condition.has(c) for c in self.channels])

    def independent(self, name: str) -> bool:
        """Whether each sample of the condition of that name is a measurement of its own."""
        return next(c for c in self.conditions if c.name == name).independent

    def differs(self, names: Sequence[str], address: Address) -> bool:
        """Whether a number is given anew in the conditions of these names: it has not the same value in all of them that have it."""
        having = [i for i, c in enumerate(self.conditions) if c.name in names and self._is_there(i, address)]
        return len({self.nominal_of(i).get(address, 0.0) for i in having}) > 1

    def shown(self, index: int) -> list[int]:
        """Indices of the channels that say anything in condition `index`."""
        return [k for k, c in enumerate(self.channels) if self.conditions[index].has(c)]

    def shown_in(self, conditions: Sequence[int]) -> Laboratory:
        """The laboratory with the channels that all of these conditions have: what one of them lacks is not measured in any."""
        shown = [c for c in self.channels if all(self.conditions[i].has(c) for i in conditions)]
        return self if shown == list(self.channels) else replace(self, channels=shown)

    def measured(self) -> list[list[FloatArray]]:
        """The repeats of every condition as its simulations are, [samples, channels]."""
        return [self.measured_in(i) for i in range(len(self.conditions))]

    def measured_in(self, index: int) -> list[FloatArray]:
        """The repeats of condition `index` as its simulations are, [samples, channels]."""
        condition = self.conditions[index]
        return [decimate(condition.matrix(r, self.channels), self.factor(index)) for r in condition.runs]

    def effective(self, index: int, changes: Setting) -> Setting:
        """Those of the changes that condition `index` has parameters or channels for: the others do nothing there."""
        return tuple(c for c in changes if self._is_there(index, c[0]))

    def _is_there(self, index: int, address: Address) -> bool:
        condition, (component, parameter) = self.conditions[index], address
        if address == FINER:
            return self.refinement is not None
        if component == LOGGING:
            pattern = parameter.partition(" ")[2]
            return condition.channels is None or any(selects(pattern, c) for c in condition.channels)
        if condition.settable is not None:
            return condition.settable.issuperset(physical({address: 1.0}))
        return condition.system is None or any(c.name == component for c in condition.system.components)

    def signature(self, index: int) -> tuple[Any, ...]:
        """All that a simulation of condition `index` depends on, except for the changes."""
        step = (self.refinement.divide, self.refinement.sampled) if self.refinement is not None else ()
        c = self.conditions[index]
        channels = [name for name in self.channels if c.has(name)]
        return (self.configured(index), c.grid, self.channels, channels, self.nominal_of(index), self.factor(index), step)

    def configured(self, index: int) -> System:
        """The nominal system of condition `index`, without noise."""
        system = self.conditions[index].system or self.system
        quiet = {c: {k: v for k, v in values.items() if self._is_there(index, (c, k))} for c, values in self.quiet.items()}
        for component, values in [*self.conditions[index].parameters.items(), *quiet.items()]:
            if any(c.name == component for c in system.components):
                system = system.with_parameters(component, values)
        return system

    def nominal_of(self, index: int) -> Mapping[Address, float]:
        """Values that changes of condition `index` are added to [unit], where they are not zero."""
        own = self.conditions[index].nominal
        return self.nominal if own is None else own

    def simulate(self, index: int, changes: Setting) -> FloatArray | None:
        """The channels of condition `index`, block means over `decimation` steps, [n, channels]; None where the system cannot run."""
        observed = [(parameter, value) for (component, parameter), value in changes if component == LOGGING]
        physical = tuple(c for c in changes if c[0][0] != LOGGING)
        if not observed:
            full = self._simulate(index, physical)
        else:  # many faults of the log are tried on the same simulation
            logged = self._logged
            if logged is None or logged[0] != (index, physical):
                logged = self._logged = (index, physical), self._simulate(index, physical)
            full = logged[1]
        if full is None:
            return None
        if observed:
            full = full.copy()
            for parameter, value in observed:
                observe(full, self.conditions[index].grid, self.channels, parameter, value)
            full[:, [not self.conditions[index].has(name) for name in self.channels]] = 0.0
        return decimate(full, self.factor(index))

    def sampled(self, index: int, changes: Setting) -> FloatArray | None:
        """All samples of the channels, [n, channels]; None where the system cannot run. Faults of the log are not in it."""
        return self._simulate(index, tuple(sorted((*changes, *((a, 1.0) for a in self.seeds)))))

    def _simulate(self, index: int, changes: Setting) -> FloatArray | None:
        """All samples of the channels, [n, channels]."""
        condition = self.conditions[index]
        try:
            result = self._rig(index, (FINER, 1.0) in changes).run(self.values(index, changes), float(condition.grid[-1]))
        except OrchestrationError:
            if not changes:
                raise
            return None
        nothing = np.zeros(len(result.t))
        columns = [result.columns.get(name, nothing) for name in self.channels]
        found = np.stack([np.interp(condition.grid, result.t, column) for column in columns], axis=1)
        # what runs away so far that squares of squares overflow cannot run either
        return found if not changes or float(np.abs(found).max(initial=0.0)) < float(np.finfo(float).max) ** 0.25 else None

    def values(self, index: int, changes: Setting) -> dict[str, dict[str, float]]:
        """What the parameters of condition `index` are with these changes: component -> parameter -> value [unit of the parameter]."""
        nominal = self.nominal_of(index)
        found: dict[str, dict[str, float]] = {}
        for (component, parameter), value in physical({a: v for a, v in self.effective(index, changes) if a != FINER}).items():
            found.setdefault(component, {})[parameter] = value + nominal.get((component, parameter), 0.0)
        return found

    def _rig(self, index: int, finer: bool) -> Rig:
        """The system of condition `index`, opened; a thread has its own. `finer`: at a smaller communication step."""
        condition, key = self.conditions[index], (threading.get_ident(), index, finer)
        known, rig = self._rigs.get(key, (None, None))
        if rig is None or known is not condition:  # the conditions of a laboratory may be replaced
            shown = [name for name in self.channels if condition.has(name)]
            system = self.configured(index)
            if finer and self.refinement is not None:
                system = refined(system, self.refinement.divide, self.refinement.sampled)
            rig = Rig(system, self.resolver, self.convert, shown)
            self._rigs[key] = condition, rig
        return rig


def decimate(full: FloatArray, factor: int) -> FloatArray:
    """Block means over `factor` rows of [n, channels]: [n // factor, channels]; what is left over at the end goes."""
    n = len(full) // factor
    means: FloatArray = full[: n * factor].reshape(n, factor, -1).mean(axis=1)
    return means


def _simulated(task: tuple[int, Setting]) -> tuple[int, Setting]:
    """What of a task (condition, setting) is simulated: all but faults of the log."""
    index, changes = task
    return index, tuple(c for c in changes if c[0][0] != LOGGING)


def refined(system: System, divide: int, sampled: Sequence[str]) -> System:
    """The system at a part of its communication step; components in `sampled` keep their cycle."""
    components = tuple(replace(c, every=c.every * divide) if c.name in sampled else c for c in system.components)
    return replace(system, step=system.step / divide, components=components)


class Simulator:
    """Simulates the conditions of a laboratory, each setting once, and keeps the results. Use it in `with`.

    On `workers` processes, or with a `scheduler` (tcp://host:port) on the workers of that Dask cluster, which must see the same files.
    """

    def __init__(
        self,
        laboratory: Laboratory,
        workers: int = 1,
        report: Report | None = None,
        store: Store | None = None,
        scheduler: str | None = None,
    ) -> None:
        self.laboratory, self._store, self._scheduler = laboratory, store, scheduler
        self._keys: dict[int, str] = {}
        self._known: dict[tuple[int, Setting], FloatArray | None] = {}
        self._workers, self._report = workers, report
        # measured samples are not simulated with
        work = replace(laboratory, conditions=[replace(c, runs=()) for c in laboratory.conditions]) if scheduler else laboratory
        self._pool = pool(work.simulate, workers, scheduler)
        self.count = 0
        """Simulations that were run."""
        self.found = 0
        """Simulations that an interrupted diagnosis had left."""
        self.expected = 0
        """About how many there will be in all; 0: not known."""

    def __enter__(self) -> Simulator:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.close()

    def beside(self, laboratory: Laboratory) -> Simulator:
        """Another one for another laboratory; what it simulates is counted there."""
        return Simulator(laboratory, self._workers, self._report, self._store, self._scheduler)

    def many(self, tasks: Sequence[tuple[int, Setting]], what: str = "simulations") -> list[FloatArray | None]:
        """Channels [n, channels] of each task (condition, setting), in the order of the tasks; None where the system cannot run."""
        tasks = [(i, self.laboratory.effective(i, changes)) for i, changes in tasks]
        new = [t for t in dict.fromkeys(tasks) if t not in self._known and not self._stored(t)]
        new.sort(key=_simulated)  # what differs by faults of the log alone is simulated once
        results = self._pool.map(new) if self._pool is not None and new else (self.laboratory.simulate(*t) for t in new)
        for done, (task, result) in enumerate(zip(new, results, strict=True), 1):
            self._known[task] = result
            self.count += 1
            if self._store is not None:
                self._store.put(self._key(task), result)
            if self._report is not None:
                self._report(what, done, len(new))
                if self.expected:
                    self._report("diagnosis", len(self._known), max(self.expected, len(self._known)))
        return [self._known[t] for t in tasks]

    def _stored(self, task: tuple[int, Setting]) -> bool:
        """Whether a simulation is on disk; it is taken from there."""
        if self._store is None:
            return False
        there, result = self._store.get(self._key(task))
        if there:
            self._known[task] = result
            self.found += 1
        return there

    def _key(self, task: tuple[int, Setting]) -> str:
        assert self._store is not None
        index, changes = task
        if index not in self._keys:
            self._keys[index] = self._store.key(*self.laboratory.signature(index))
        return self._store.key(self._keys[index], changes)

    def repeated(self, indices: Sequence[int], changes: Setting, count: int, what: str = "simulations") -> list[list[FloatArray] | None]:
        """`count` repeats of each of these conditions with different noise (one where the system has none); None where it cannot run."""
        seeds = range(1, count + 1 if self.laboratory.seeds else 2)
        results = iter(self.many([(i, self.seeded(changes, s)) for i in indices for s in seeds], what))
        found: list[list[FloatArray] | None] = []
        for _ in indices:
            group = [next(results) for _ in seeds]
            complete = [g for g in group if g is not None]
            found.append(complete if len(complete) == len(group) else None)
        return found

    def seeded(self, changes: Setting, seed: int = 1) -> Setting:
        """The changes with all seeds of the noise set to `seed`, sorted."""
        return tuple(sorted((*changes, *((a, float(seed)) for a in self.laboratory.seeds))))
