"""Measured runs, sorted by condition and brought to the time grid of the simulation."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from robomill.diagnosis.candidates import Address
from robomill.orchestration.assembly import MEASURED
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray, PortData
from robomill.orchestration.system.definition import System
from robomill.orchestration.system.parameters import Convert

ON_TIME, ALL_APART = 0.05, 0.25
"""Parts of a communication step by which all but one in twenty of the stamps of a log may be apart from evenly spaced ones, and all of them
together from the communication points: it was sampled at these points, whatever a late stamp says."""
INDEPENDENT = "independent"
"""Value of the label `samples`: each sample is a measurement of its own, as a static load is, and no point of a time series."""
LEAST_STEPS = 20
"""Communication steps that the repeats of a condition have in common at least (judgement): fewer say nothing of motion or noise."""


class DataError(ValueError):
    """Runs that cannot be diagnosed; the text says why."""


@dataclass(frozen=True)
class Condition:
    """Repeats of the same thing: the same parameters set by the experimenter."""

    name: str
    parameters: Mapping[str, Mapping[str, Any]]
    runs: tuple[Run, ...]
    grid: FloatArray
    """Communication points [s] of the simulation that all repeats cover, float64[n]."""
    held_out: bool = False
    system: System | None = None
    """What makes it, where that is another system than the one that is diagnosed."""
    channels: frozenset[str] | None = None
    """Channels that its system and all its runs have: the others say nothing here. None: all that its system has."""
    settable: frozenset[Address] | None = None
    """Parameters of its system, elements and whole arrays. None: all of the components that it has."""
    nominal: Mapping[Address, float] | None = None
    """Values of parameters that changes are added to, where its system has others than the one that is diagnosed."""

    independent: bool = False
    """Whether each sample is a measurement of its own (label `samples`): the order of the samples says nothing."""

    def has(self, channel: str) -> bool:
        """Whether a channel says anything here."""
        return self.channels is None or channel in self.channels

    @property
    def step(self) -> float:
        """Time between the points of the grid [s]."""
        return float(self.grid[1] - self.grid[0])

    def matrix(self, run: Run, channels: Sequence[str]) -> FloatArray:
        """The channels of a repeat at the grid, float64[n, channels]; samples that are not finite are bridged linearly.

        Channels that say nothing here are zero, as they are in the simulation.
        """
        columns = []
        t = _without_jitter(run.t, self.step)
        for name in channels:
            if not self.has(name):
                columns.append(np.zeros(len(self.grid)))
                continue
            values = run.columns[name]
            good = np.isfinite(values)
            columns.append(np.interp(self.grid, t[good], values[good]) if good.any() else np.zeros(len(self.grid)))
        return np.stack(columns, axis=1)


def in_units(run: Run, ports: Mapping[str, PortData], convert: Convert) -> Run:
    """The run with every column in the unit of the port of the same name; DataError where that cannot be."""
    columns, units = dict(run.columns), dict(run.ports)
    for name in run.columns.keys() & ports.keys():
        there, wanted = run.ports[name].unit, ports[name].unit
        if not there:
            units[name] = replace(run.ports[name], unit=wanted)
        if not there or not wanted or there == wanted:
            continue
        try:
            zero, one = convert(0.0, there, wanted), convert(1.0, there, wanted)
        except ValueError as error:
            raise DataError(
                f"{run.folder}: column {name} is in {there}, the system has it in {wanted}: {error}"
                "; correct the unit in the mapping of the import"
            ) from None
        columns[name], units[name] = zero + (one - zero) * run.columns[name], replace(run.ports[name], unit=wanted)
    return replace(run, columns=columns, ports=units)


def sort_by_condition(runs: Sequence[Run], system: System, held_out: bool = False) -> list[Condition]:
    """Conditions in the order in which they come, named by the label `condition` (or condition 1, 2, ...).

    DataError where the runs of a condition do not agree in the label `samples`, or it is not INDEPENDENT.
    """
    groups: dict[str, list[Run]] = {}
    own = any(c.source == MEASURED for c in system.components)  # each run is driven by its own signals
    for run in runs:
        # seeds are different in each repeat and say nothing about the condition
        known = {c: {k: v for k, v in values.items() if k != "seed"} for c, values in known_parameters(run, system).items()}
        label = str(run.info.get("labels", {}).get("condition", ""))
        key = [label, _content(known), str(run.folder) if own else ""]
        groups.setdefault(json.dumps(key, sort_keys=True, default=str), []).append(run)
    made: list[Condition] = []
    for i, members in enumerate(groups.values()):
        name = str(members[0].info.get("labels", {}).get("condition", "")) or f"condition {i + 1}"
        if any(c.name == name for c in made):
            name = f"{name} ({i + 1})"
        known = known_parameters(members[0], system)
        grid = common_grid(members, system.step)
        made.append(Condition(name, known, tuple(members), grid, held_out, independent=_independent(name, members)))
    return made


def _independent(name: str, runs: Sequence[Run]) -> bool:
    """Whether the label `samples` of all runs of a condition says that each sample is a measurement of its own."""
    said = [run.info.get("labels", {}).get("samples") for run in runs]
    for run, value in zip(runs, said, strict=True):
        if value not in (None, INDEPENDENT):
            raise DataError(
                f'{run.folder}: label samples is {value!r}; expected "{INDEPENDENT}", where each sample is a measurement of its own'
                "; leave the label out for a time series"
            )
    if len(set(said)) > 1:
        series, alone = (next(r.folder for r, value in zip(runs, said, strict=True) if value == wanted) for wanted in (None, INDEPENDENT))
        raise DataError(
            f'condition {name!r}: {alone} has the label samples = "{INDEPENDENT}", and {series} has no label samples; '
            "give it to all runs of the condition or to none, or name two conditions"
        )
    return INDEPENDENT in said


def driven(system: System, run: Run) -> System:
    """The system whose components with source `measured` play what was measured in `run`; itself, if it has none.

    DataError where the run has no column of such a component.
    """
    for c in system.components:
        if c.source != MEASURED:
            continue
        if c.name not in run.components:
            raise DataError(
                f"{run.folder}: component {c.name!r} of system {system.name!r} plays what was measured, and the run has no column "
                f"{c.name}.*; it has columns of {', '.join(run.components)}: map some to {c.name}.PORT when the log is imported"
            )
        system = system.with_source(c.name, f"{MEASURED}:{run.folder.resolve()}")
    return system


def is_driven(system: System) -> bool:
    """Whether components of a `driven` system play what was measured: no other run is a repeat of that."""
    return any(c.source.startswith(f"{MEASURED}:") for c in system.components)


def known_parameters(run: Run, system: System) -> dict[str, dict[str, Any]]:
    """What the experimenter says the parameters of this run were; files relative to the run's folder made absolute."""
    names = {c.name for c in system.components}
    found: dict[str, dict[str, Any]] = {}
    for component, values in run.info.get("parameters", {}).items():
        if component in names and isinstance(values, Mapping):
            found[component] = {k: _absolute(v, run.folder) for k, v in values.items()}
    return found


def _absolute(value: Any, folder: Path) -> Any:
    if isinstance(value, str) and (folder / value).is_file():
        return str((folder / value).resolve())
    return value


def _content(known: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Files by their bytes: each repeat may bring its own copy of a program."""
    return {
        c: {
            k: hashlib.sha256(Path(v).read_bytes()).hexdigest() if isinstance(v, str) and Path(v).is_file() else v
            for k, v in values.items()
        }
        for c, values in known.items()
    }


def _without_jitter(t: FloatArray, step: float) -> FloatArray:
    """Time stamps [s] put on the communication points, if there is one for each, and it is near.

    Between stamps that jitter, or that all are a small part of a step off since the log was started, interpolation would take a part of
    what is as fast as a tooth.
    """
    count = np.arange(len(t))
    for points in (np.round(t / step), count + np.round(np.median(t / step - count))):  # by the stamps, and by their order
        off = t / step - points
        middle = float(np.median(off))
        if np.all(np.diff(points) == 1.0) and abs(middle) < ALL_APART and np.quantile(np.abs(off - middle), 0.95) < ON_TIME:
            return np.asarray(points * step)
    return t


def common_grid(runs: Sequence[Run], step: float) -> FloatArray:
    """Communication points [s] that all runs cover; DataError where they are fewer than LEAST_STEPS."""
    start, end = max(float(r.t[0]) for r in runs), min(float(r.t[-1]) for r in runs)
    first, last = math.ceil(max(start, 0.0) / step - 1e-6), math.floor(end / step + 1e-6)
    if last - first < LEAST_STEPS:
        found = f"the repeats have {max(last - first, 0)} steps of {step:g} s in common"
        raise DataError(f"{runs[0].folder}: {found}; expected at least {LEAST_STEPS}: record longer runs, or leave out the short one")
    return np.asarray(np.arange(first, last + 1) * step)
