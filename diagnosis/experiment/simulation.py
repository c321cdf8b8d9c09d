"""Simulations of the conditions with effects on: run once, kept, on as many processes as are wanted."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from robomill.diagnosis.catalogue import LOGGING, Address, Refinement, physical
from robomill.diagnosis.experiment.measured import Condition
from robomill.diagnosis.experiment.observation import observe
from robomill.diagnosis.experiment.store import Store
from robomill.orchestration.assembly import Resolver, run
from robomill.orchestration.errors import OrchestrationError
from robomill.orchestration.slaves.protocol import FloatArray, PortData
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.parameters import Convert, same_unit_only

Setting = tuple[tuple[Address, float], ...]
"""What is changed against the nominal system: address and value [unit of the parameter], sorted."""

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
    _logged: dict[tuple[int, Setting], FloatArray | None] = field(default_factory=dict, repr=False)
    """The simulation to which faults of the log were last applied."""

    def signature(self, index: int) -> tuple[Any, ...]:
        """All that a simulation of condition `index` depends on, except for the changes."""
        sampled = self.refinement.sampled if self.refinement is not None else ()
        return (self.configured(index), self.conditions[index].grid, self.channels, self.nominal, self.decimation, sampled)

    def configured(self, index: int) -> System:
        """The nominal system of condition `index`, without noise."""
        system = self.conditions[index].system or self.system
        for component, values in [*self.conditions[index].parameters.items(), *self.quiet.items()]:
            if any(c.name == component for c in system.components):
                system = system.with_parameters(component, values)
        return system

    def simulate(self, index: int, changes: Setting) -> FloatArray | None:
        """The channels of condition `index`, block means over `decimation` steps, [n, channels]; None where the system cannot run."""
        observed = [(parameter, value) for (component, parameter), value in changes if component == LOGGING]
        physical = tuple(c for c in changes if c[0][0] != LOGGING)
        if not observed:
            full = self._simulate(index, physical)
        else:  # many faults of the log are tried on the same simulation
            if (index, physical) not in self._logged:
                self._logged.clear()
                self._logged[index, physical] = self._simulate(index, physical)
            full = self._logged[index, physical]
        if full is None:
            return None
        if observed:
            full = full.copy()
            for parameter, value in observed:
                observe(full, self.conditions[index].grid, self.channels, parameter, value)
        return decimate(full, self.decimation)

    def sampled(self, index: int, changes: Setting) -> FloatArray | None:
        """All samples of the channels, [n, channels]; None where the system cannot run. Faults of the log are not in it."""
        return self._simulate(index, tuple(sorted((*changes, *((a, 1.0) for a in self.seeds)))))

    def _simulate(self, index: int, changes: Setting) -> FloatArray | None:
        """All samples of the channels, [n, channels]."""
        condition = self.conditions[index]
        system = self.configured(index)
        for (component, parameter), value in physical(dict(changes)).items():
            if condition.system is None or any(c.name == component for c in system.components):
                system = system.with_parameters(component, {parameter: value + self.nominal.get((component, parameter), 0.0)})
        try:
            result = run(system, None, stop=float(condition.grid[-1]), resolver=self.resolver, convert=self.convert)
        except OrchestrationError:
            if not changes:
                raise
            return None
        # a channel that another system does not have says nothing
        columns = [result.columns.get(name, np.zeros(len(result.t))) for name in self.channels]
        return np.stack([np.interp(condition.grid, result.t, column) for column in columns], axis=1)


def decimate(full: FloatArray, factor: int) -> FloatArray:
    """Block means over `factor` rows of [n, channels]: [n // factor, channels]; what is left over at the end goes."""
    n = len(full) // factor
    means: FloatArray = full[: n * factor].reshape(n, factor, -1).mean(axis=1)
    return means


def refined(system: System, divide: int, sampled: Sequence[str]) -> System:
    """The system at a part of its communication step; components in `sampled` keep their cycle."""
    components = tuple(replace(c, every=c.every * divide) if c.name in sampled else c for c in system.components)
    return replace(system, step=system.step / divide, components=components)


_LABORATORY: Laboratory | None = None


def _enter(laboratory: Laboratory) -> None:
    global _LABORATORY  # noqa: PLW0603 - a worker process has one laboratory, given when it starts
    _LABORATORY = laboratory
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which ends its workers
    for name in ("SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_DFL)  # forked, it would do what the parent does then


def _work(task: tuple[int, Setting]) -> FloatArray | None:
    assert _LABORATORY is not None
    return _LABORATORY.simulate(*task)


class Simulator:
    """Simulates the conditions of a laboratory on `workers` processes, each setting once, and keeps the results. Use it in `with`."""

    def __init__(self, laboratory: Laboratory, workers: int = 1, report: Report | None = None, store: Store | None = None) -> None:
        self.laboratory, self._store = laboratory, store
        self._keys: dict[int, str] = {}
        self._known: dict[tuple[int, Setting], FloatArray | None] = {}
        self._workers, self._report = workers, report
        self._pool: ProcessPoolExecutor | None = None
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
            self._pool.shutdown(cancel_futures=True)

    def beside(self, laboratory: Laboratory) -> Simulator:
        """Another one for another laboratory; what it simulates is counted there."""
        return Simulator(laboratory, self._workers, self._report, self._store)

    def many(self, tasks: Sequence[tuple[int, Setting]], what: str = "simulations") -> list[FloatArray | None]:
        """Channels [n, channels] of each task (condition, setting), in the order of the tasks; None where the system cannot run."""
        new = [t for t in dict.fromkeys(tasks) if t not in self._known and not self._stored(t)]
        if self._workers > 1 and len(new) > 1:
            if self._pool is None:
                # forked workers have the compiled models already; other platforms compile anew
                method = "fork" if "fork" in multiprocessing.get_all_start_methods() else "spawn"
                self._pool = ProcessPoolExecutor(self._workers, multiprocessing.get_context(method), _enter, (self.laboratory,))
            results = self._pool.map(_work, new, chunksize=max(1, min(4, len(new) // (2 * self._workers))))
        else:
            results = (self.laboratory.simulate(*t) for t in new)
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
