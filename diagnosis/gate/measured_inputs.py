"""Mistakes in what drives a system: another sign, unit or zero of a measured input.

No simulation says what an input should be. So each usual mistake is undone, and the nominal system is driven by what is then measured.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robomill.diagnosis.experiment.measured import Condition
from robomill.diagnosis.experiment.simulation import Laboratory, Simulator
from robomill.diagnosis.gate.checks import Finding
from robomill.diagnosis.gate.log_faults import scales, shifts, zeros
from robomill.orchestration.assembly import MEASURED
from robomill.orchestration.errors import OrchestrationError
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.playback import Playback
from robomill.orchestration.slaves.protocol import FloatArray, Slave, arrays

UNDONE = "undone:"
"""Source of a component that plays what was measured, with a mistake undone."""
_PUT_RIGHT = "with that put right, the nominal system explains nearly all of the gap, or as much as any effects do"
_UNIT = f"{_PUT_RIGHT}; give the unit that it is logged in"


@dataclass(frozen=True)
class Mistake:
    """A mistake in a measured input."""

    columns: tuple[str, ...]
    """What has it, `component.port`."""
    finding: Finding
    undo: Callable[[FloatArray], FloatArray]
    """What is true of what is measured [n]."""


def mistakes(laboratory: Laboratory, n: int) -> list[Mistake]:
    """Those that the diagnosed conditions, the first `n`, may have: a sign of each input, a unit or a zero of each array."""
    found: dict[tuple[str, str, float, str], Mistake] = {}
    for i in range(n):
        condition = laboratory.conditions[i]
        for component in _players(laboratory, condition):
            for m in _of(component, condition.runs[0]):
                f = m.finding
                found.setdefault((f.channel, f.kind, f.value, f.text), m)
    return list(found.values())


def undone(simulator: Simulator, groups: Sequence[Sequence[FloatArray]], mistake: Mistake) -> list[list[FloatArray]] | None:
    """Measured repeats of the diagnosed conditions as the nominal system would see them without the mistake; None where it cannot run.

    Taken off is what the mistake undone changes in the simulation, so that what is left beside the nominal one is left of the other.
    """
    laboratory, changes, made = simulator.laboratory, simulator.seeded(()), []
    for i, group in enumerate(groups):
        (nominal,) = simulator.many([(i, changes)], "measured inputs")
        try:
            without = _without(laboratory, i, mistake).simulate(i, changes)
        except OrchestrationError:  # what no input of this machine can be
            return None
        if nominal is None or without is None:
            return None
        made.append([x - (without - nominal) for x in group])
    return made


def _players(laboratory: Laboratory, condition: Condition) -> list[str]:
    """Components that play what was measured."""
    system = condition.system or laboratory.system
    return [c.name for c in system.components if c.source.startswith(f"{MEASURED}:")]


def _of(component: str, run: Run) -> Iterator[Mistake]:
    ports = [replace(p, name=name) for name, p in run.ports.items() if name.partition(".")[0] == component and p.type == "real"]
    for p in ports:
        for zero in zeros(p.unit):
            text = f"has the wrong sign: {_PUT_RIGHT}; turn it"
            yield Mistake((p.name,), Finding(p.name, "sign", -1.0, "1", text), _scaled(zero, -1.0))
    for members in arrays(ports).values():
        columns, unit = tuple(p.name for p in members), members[0].unit
        for zero, factor, mistake in scales(unit):
            text = f"is {factor:.4g} times what it should be, {mistake}: {_UNIT}"
            yield Mistake(columns, Finding(columns[0], "unit", factor, "1", text), _scaled(zero, factor))
        for offset, mistake in shifts(unit):
            text = f"is {abs(offset):g} K too {'small' if offset < 0.0 else 'large'}, {mistake}: {_UNIT}"
            yield Mistake(columns, Finding(columns[0], "unit", offset, "K", text), _shifted(offset))


def _scaled(zero: float, factor: float) -> Callable[[FloatArray], FloatArray]:
    return lambda x: np.asarray(zero + (x - zero) / factor)


def _shifted(offset: float) -> Callable[[FloatArray], FloatArray]:
    return lambda x: np.asarray(x - offset)


def _without(laboratory: Laboratory, i: int, mistake: Mistake) -> Laboratory:
    """The laboratory with condition `i` driven by what is measured without the mistake."""
    condition, component = laboratory.conditions[i], mistake.columns[0].partition(".")[0]
    (run, *_), system = condition.runs, condition.system or laboratory.system
    if component not in _players(laboratory, condition):
        return laboratory
    true = replace(run, columns={**run.columns, **{c: mistake.undo(run.columns[c]) for c in mistake.columns if c in run.columns}})

    def resolver(source: str, name: str) -> Slave:
        if source == f"{UNDONE}{component}":
            return Playback.of_run(name, true, clamps=True)
        if laboratory.resolver is None:
            raise LookupError("no in-process components were given")
        return laboratory.resolver(source, name)

    changed = replace(condition, system=system.with_source(component, f"{UNDONE}{component}"))
    conditions = [changed if k == i else c for k, c in enumerate(laboratory.conditions)]
    return replace(laboratory, conditions=conditions, resolver=resolver)
