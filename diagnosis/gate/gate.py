"""The gate: all that is said of a log before it is diagnosed, with the nominal system or with the best model."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from robomill.diagnosis.candidates import Candidate, Nuisance
from robomill.diagnosis.experiment.measured import Condition
from robomill.diagnosis.experiment.segments import playing
from robomill.diagnosis.experiment.simulation import Laboratory, Setting, Simulator, setting
from robomill.diagnosis.gate import checks, log_faults, repeats, run_set
from robomill.diagnosis.gate.checks import Finding
from robomill.diagnosis.inference.sensitivities import NOMINAL
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.protocol import FloatArray

SIMULATIONS = "the log"
"""What the simulations of the gate are called where progress is shown."""


@dataclass(frozen=True)
class Gate:
    """Measured repeats beside simulated ones; what is wrong with them, each thing once."""

    laboratory: Laboratory
    simulator: Simulator
    groups: Sequence[Sequence[FloatArray]]
    """Measured repeats of each condition, [samples, channels], averaged as simulations are."""
    n: int
    """The first `n` conditions are diagnosed; of the others only the program is looked at."""
    candidates: Sequence[Candidate]
    """Effects of the catalogue: what one of them can change is no program, and no clock is later than theirs."""
    nuisances: Sequence[Nuisance]
    """Calibrated numbers: a program that is off as they may be is no other one."""

    def findings(self, changes: Setting = ()) -> list[Finding]:
        """What is wrong with the log where the system has these changes; nothing where that cannot run."""
        found: list[Finding] = []
        simulated = self.simulator.repeated(range(self.n), changes, NOMINAL, SIMULATIONS)
        for condition, group, models in zip(self.laboratory.conditions, self.groups, simulated, strict=False):
            if models is not None:
                found += self._of(condition, group, models)
        return once([*found, *self._other_programs()])

    def without(self, faults: Sequence[Finding]) -> list[list[FloatArray]]:
        """Measured repeats of the diagnosed conditions as they were before these faults (`log_faults.undone`)."""
        groups = [list(group) for group in self.groups[: self.n]]
        simulated = self.simulator.repeated(range(self.n), (), NOMINAL, SIMULATIONS)
        for condition, group, models in zip(self.laboratory.conditions, groups, simulated, strict=False):
            if models is not None:
                at = self._shown(condition)
                middle, channels = np.mean(models, axis=0)[:, at], [self.laboratory.channels[i] for i in at]
                units = [self.laboratory.ports[c].unit for c in channels]
                for k, x in enumerate(group):
                    group[k] = x.copy()
                    group[k][:, at] = log_faults.undone(faults, x[:, at], middle, channels, units)
        return groups

    def _of(self, condition: Condition, group: Sequence[FloatArray], models: Sequence[FloatArray]) -> list[Finding]:
        """Findings of one condition, from measured and simulated repeats [samples, channels]."""
        at, step = self._shown(condition), _step(condition, models[0])
        channels = [self.laboratory.channels[i] for i in at]
        measured, simulated = [x[:, at] for x in group], [s[:, at] for s in models]
        middle, names = np.mean(simulated, axis=0), [r.folder.name for r in condition.runs]
        ranges = {c: (p.minimum, p.maximum) for c, p in self.laboratory.ports.items()}
        noise = np.sqrt(repeats.usual_scatter(measured if len(measured) > 1 else simulated))
        found = checks.spikes(condition, channels)
        found += repeats.copies(measured, simulated, names) or repeats.compared(measured, simulated, channels, names, step)
        for r, x in zip(condition.runs, measured, strict=True):
            found += checks.raw(r, channels, ranges, condition.step)
            found += beside(r, x, middle, channels, step, noise, self.limits)
        return found

    @cached_property
    def limits(self) -> dict[str, tuple[float, float]]:
        """Channels that are at a limit in some runs, and their `checks.limits_of`."""
        found = {}
        for i, name in enumerate(self.laboratory.channels):
            there = [group for c, group in zip(self.laboratory.conditions, self.groups, strict=True) if c.has(name)]
            both = checks.limits_of([x[:, i] for group in there for x in group]) if there else (np.nan, np.nan)
            if not np.all(np.isnan(both)):
                found[name] = both
        return found

    def _other_programs(self) -> list[Finding]:
        """Recorded programs, held-out ones too, that are not what the nominal system plays."""
        changing = {c.component for c in self.candidates}
        plays = [playing(c.system or self.laboratory.system) - changing for c in self.laboratory.conditions]
        if not any(name.partition(".")[0] in played for played in plays for name in self.laboratory.channels):
            return []
        latest = run_set.latest_clock(self.candidates)
        found: list[Finding] = []
        simulated = self.simulator.repeated(range(len(self.groups)), (), NOMINAL, SIMULATIONS)
        for i, (condition, group, models, played) in enumerate(zip(self.laboratory.conditions, self.groups, simulated, plays, strict=True)):
            if models is None:
                continue
            at = self._shown(condition)
            channels, mean, step = [self.laboratory.channels[i] for i in at], np.mean(models, axis=0)[:, at], _step(condition, models[0])
            told = (channels, played, step, latest)
            for r, x in zip(condition.runs, group, strict=True):
                if other := run_set.other_program(r, x[:, at], mean, *told):
                    changes = [c[:, at] for c in self._within_tolerance(i, played)]
                    other = run_set.other_program(r, x[:, at], mean, *told, changes)
                found += other
        return found

    def _within_tolerance(self, i: int, played: Collection[str]) -> list[FloatArray]:
        """What three standard deviations of each calibrated number of these components change in condition `i`, [samples, channels]."""
        far = [setting({u.address: 3.0 * u.scale}) for u in self.nuisances if u.address[0] in played]
        nominal, *other = self.simulator.many([(i, changes) for changes in ((), *far)], SIMULATIONS)
        return [x - nominal for x in other if x is not None] if nominal is not None else []

    def _shown(self, condition: Condition) -> list[int]:
        """Places of the channels that say anything in a condition."""
        return [i for i, name in enumerate(self.laboratory.channels) if condition.has(name)]


def beside(
    run: Run,
    x: FloatArray,
    s: FloatArray,
    channels: Sequence[str],
    step: float,
    noise: FloatArray,
    limits: Mapping[str, tuple[float, float]] = MappingProxyType({}),
) -> list[Finding]:
    """What a measured run [samples, channels] says beside its simulation; `step` [s] between samples, `noise` [unit] per channel."""
    still = checks.standstill(run, x, s, channels, step, noise, limits)
    wrong, units = {f.channel for f in still}, [run.ports[c].unit for c in channels]
    return still + log_faults.judged(x, s, channels, units, noise, frozenset(i for i, c in enumerate(channels) if c in wrong))


def once(findings: Sequence[Finding]) -> list[Finding]:
    """One finding of each kind for each channel: the first, or the first that is fatal; how many there are is said."""
    groups: dict[tuple[str, str], list[Finding]] = {}
    for f in findings:
        groups.setdefault((f.channel, f.kind), []).append(f)
    said = []
    for group in groups.values():
        first = next((f for f in group if f.fatal), group[0])
        said.append(replace(first, text=f"{first.text} ({len(group)} such findings)") if len(group) > 1 else first)
    return said


def _step(condition: Condition, rows: FloatArray) -> float:
    """Time [s] between the rows of a simulation of a condition."""
    return condition.step * (len(condition.grid) // len(rows))
