"""From runs to a laboratory: which channels say something in which condition, which parameters there are, what is believed of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from robomill.diagnosis.candidates import LOGGING, Address, Candidate, Nuisance
from robomill.diagnosis.catalogue import Catalogue
from robomill.diagnosis.experiment.campaign import Campaign
from robomill.diagnosis.experiment.measured import Condition, DataError, in_units
from robomill.diagnosis.experiment.simulation import Laboratory, decimate
from robomill.diagnosis.gate import run_set
from robomill.diagnosis.gate.checks import Finding
from robomill.diagnosis.inference.adequacy import MISFIT
from robomill.diagnosis.numbers import lacking
from robomill.orchestration.assembly import MEASURED, Resolver, assemble, run
from robomill.orchestration.slaves.protocol import PortData, base_name
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.parameters import Convert

ROWS = 1500
"""Samples that a diagnosis works on, over all conditions: longer logs are averaged in blocks."""
RINGING = 4 * ROWS
"""Samples, where means over more would lose what the machine does."""


@dataclass(frozen=True)
class Prepared:
    """What a diagnosis starts from."""

    laboratory: Laboratory
    """Its first `n` conditions are diagnosed, the others are held out."""
    n: int
    catalogue: Catalogue
    """What of the catalogue any of the systems has."""
    nuisances: tuple[Nuisance, ...]
    numbers: tuple[Candidate, ...]
    """Numbers of the model that the catalogue lacks (`numbers.lacking`)."""
    skipped: tuple[str, ...]
    """What of the catalogue none of the systems has, in words."""
    findings: tuple[Finding, ...]
    """Repeats that were cut short."""


@dataclass(frozen=True)
class _Settable:
    """The parameters of a system as it is in one condition."""

    units: dict[Address, str]
    """Unit of each element."""
    values: dict[Address, float]
    """Value of each real element [unit]."""
    ranges: dict[Address, tuple[float, float]]
    """Least and largest value that it can have [unit]."""
    outputs: frozenset[str]
    """`component.port[1]` of each output."""

    @property
    def names(self) -> frozenset[Address]:
        """Elements, and arrays as a whole."""
        return frozenset((c, name) for c, p in self.units for name in (p, p.partition("[")[0]))


def prepared(campaign: Campaign, catalogue: Catalogue, resolver: Resolver | None, convert: Convert) -> Prepared:
    """The laboratory of a campaign. DataError where the runs do not fit their systems, CatalogueError for units that differ."""
    run_set.check_each(campaign.runs, campaign.held_out)
    for part in campaign.parts:
        for measured in (*part.runs, *part.held_out):
            run_set.check_clock(measured, part.system, resolver, convert)
    conditions, short = run_set.complete(campaign.conditions())
    system, n = campaign.system, sum(not c.held_out for c in conditions)
    bare = Laboratory(system, conditions, (), resolver, convert)
    settable = [_settable(bare.configured(i), resolver, convert) for i in range(len(conditions))]
    first: dict[Address, float] = {}
    units: dict[Address, str] = {}
    ranges: dict[Address, tuple[float, float]] = {}
    for s in settable:
        first, units, ranges = s.values | first, s.units | units, s.ranges | ranges
    within: dict[str, list[str]] = {component: [] for c in conditions for component in _components(c.system or system)}
    for component, name in units:
        within[component].append(name)
    catalogue, skipped = catalogue.within(within, frozenset[str]().union(*(s.outputs for s in settable)))
    catalogue.check_units(units, convert)
    nuisances = tuple(replace(u, allowed=ranges.get(u.address, u.allowed)) for u in _nuisances(catalogue, first, units))
    given = {a: first[a] for c in catalogue.candidates for a in c.addresses if first.get(a)}
    catalogue.check_phases(first)
    beyond = {a: (low - first.get(a, 0.0), high - first.get(a, 0.0)) for a, (low, high) in ranges.items()}
    catalogue = catalogue.limited(beyond)
    same = {a: value for a, value in first.items() if all(s.values.get(a, value) == value for s in settable)}  # others are of a program
    numbers = replace(catalogue, candidates=lacking(catalogue, nuisances, same, units)).limited(beyond).candidates
    given |= {a: first[a] for c in numbers for a in c.addresses}
    addresses = [*(u.address for u in nuisances), *given, *((c.component, c.start) for c in catalogue.candidates if c.start)]
    conditions = [
        replace(c, settable=s.names, nominal={a: s.values[a] for a in addresses if s.values.get(a)})
        for c, s in zip(conditions, settable, strict=True)
    ]
    laboratory = Laboratory(
        system,
        conditions,
        (),
        resolver,
        convert,
        catalogue.quiet,
        given | {u.address: u.nominal for u in nuisances if u.nominal},
        seeds=catalogue.seeds,
        refinement=catalogue.refinement,
    )
    laboratory.conditions, laboratory.ports = _with_channels(laboratory, n)
    laboratory.channels, laboratory.decimation = list(laboratory.ports), 1
    laboratory.decimation = _decimation(laboratory, n, any(c.has_phase for c in catalogue.candidates))
    return Prepared(laboratory, n, catalogue, nuisances, numbers, skipped, tuple(short))


def _components(system: System) -> list[str]:
    return [c.name for c in system.components]


def _settable(system: System, resolver: Resolver | None, convert: Convert) -> _Settable:
    units: dict[Address, str] = {}
    values: dict[Address, float] = {}
    ranges: dict[Address, tuple[float, float]] = {}
    outputs: set[str] = set()
    with assemble(system, resolver, convert) as assembly:
        for name, slave in assembly.slaves.items():
            parameters = [p for p in slave.ports if p.causality == "parameter"]
            units |= {(name, p.name): p.unit or "1" for p in parameters}
            ranges |= {
                (name, p.name): (-math.inf if p.minimum is None else p.minimum, math.inf if p.maximum is None else p.maximum)
                for p in parameters
                if p.type == "real"
            }
            starts = {p.name: p.start for p in parameters if p.type == "real"}
            given = {**starts, **assembly.parameters.get(name, {})}
            values |= {(name, k): float(v) for k, v in given.items() if k in starts and isinstance(v, int | float)}
            outputs |= {f"{name}.{p.name}" for p in slave.ports if p.causality == "output"}
    return _Settable(units, values, ranges, frozenset(outputs))


def _nuisances(catalogue: Catalogue, values: Mapping[Address, float], units: Mapping[Address, str]) -> tuple[Nuisance, ...]:
    """The catalogue's tolerances about the values that the parameters have in the first condition that has them; clocks in s."""
    of: dict[str, dict[str, float]] = {}
    for (component, name), value in values.items():
        of.setdefault(component, {})[name] = value
    clocks = [Nuisance(t.address, t.size, unit="s") for t in catalogue.tolerances if t.address[0] == LOGGING]
    numbers = [u for t in catalogue.tolerances if t.address[0] != LOGGING for u in t.nuisances(of.get(t.address[0], {}))]
    return (*clocks, *(replace(u, unit=units.get(u.address, u.unit)) for u in numbers))


def _with_channels(laboratory: Laboratory, n: int) -> tuple[list[Condition], dict[str, PortData]]:
    """The conditions with the channels that say something there, in the units of the ports; all such channels of the first `n` conditions.

    A channel is a real output of the system of a condition that all its runs have, unless its component plays what was measured.
    DataError where there is none.
    """
    outputs: dict[int, dict[str, PortData]] = {}
    ports: dict[str, PortData] = {}
    made = []
    for i, c in enumerate(laboratory.conditions):
        system = c.system or laboratory.system
        if id(system) not in outputs:
            simulated = run(laboratory.configured(i), None, stop=2 * system.step, resolver=laboratory.resolver, convert=laboratory.convert)
            played = {part.name for part in system.components if part.source.startswith(f"{MEASURED}:")}
            outputs[id(system)] = {
                name: p for name, p in simulated.ports.items() if p.type == "real" and name.partition(".")[0] not in played
            }
        shown = {name: p for name, p in outputs[id(system)].items() if all(name in r.columns for r in c.runs)}
        if not shown:
            has = ", ".join(sorted({base_name(name) for r in c.runs for name in r.columns}))
            known = ", ".join(dict.fromkeys(map(base_name, outputs[id(system)])))
            raise DataError(
                f"{c.name}: no measured column is an output of the system; measured: {has}; outputs: {known}"
                "; import the log with the names of the system's ports"
            )
        for name in shown.keys() & ports.keys():
            if shown[name].unit != ports[name].unit:
                raise DataError(
                    f"{c.name}: {name} is in {shown[name].unit} in system {system.name!r}, and in {ports[name].unit} in another of this "
                    "campaign; give their ports one unit"
                )
        if i < n:
            ports = ports | {name: p for name, p in shown.items() if name not in ports}
        elif not shown.keys() & ports.keys():
            raise DataError(
                f"{c.name}: is held out, and no diagnosed run has a channel that it has: {', '.join(sorted(shown))}; "
                "leave it out, or add runs that have one of these"
            )
        made.append(
            replace(c, runs=tuple(in_units(r, shown, laboratory.convert) for r in c.runs), channels=frozenset(shown.keys() & ports.keys()))
        )
    return made, ports


def _decimation(laboratory: Laboratory, n: int, turns: bool) -> int:
    """Communication steps of the system that a sample is the mean over: at most ROWS samples, none shorter than a step of any system.

    Where nothing was repeated, noise is what is fast, and what the machine does within a sample would be taken for it. There a sample is
    no longer than its means keep all but MISFIT of the variance of each signal of the nominal system, with at most RINGING samples. But
    where something `turns` with a phase that nobody knows, such as a cutter, it is not compared sample by sample.
    """
    step, conditions = laboratory.system.step, laboratory.conditions
    points = sum(len(c.grid) * round(c.step / step, 6) for c in conditions[:n])
    least = max(1, *(math.ceil(round(c.step / step, 6)) for c in conditions))
    longest = max(least, math.ceil(points / ROWS))
    if turns or any(len(c.runs) > 1 for c in conditions[:n]):
        return longest
    signals = [laboratory.sampled(i, ()) for i in range(n)] if longest > least else []

    def kept(factor: int) -> float:
        """Share of the variance that the means have, of the channel that loses most."""
        whole, there = np.zeros(len(laboratory.channels)), np.zeros(len(laboratory.channels))
        for x, c in zip(signals, conditions, strict=False):
            if x is not None:
                samples = max(1, round(factor * step / c.step))
                whole += ((x - x.mean(axis=0)) ** 2).sum(axis=0)
                there += samples * ((decimate(x, samples) - x.mean(axis=0)) ** 2).sum(axis=0)
        return float((there[whole > 0.0] / whole[whole > 0.0]).min(initial=1.0))

    least = max(least, math.ceil(points / RINGING))
    return next((k for k in range(longest, least, -1) if kept(k) > 1.0 - MISFIT), min(least, longest))
