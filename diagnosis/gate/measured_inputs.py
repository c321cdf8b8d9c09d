"""Mistakes in what drives a system: another sign, unit or zero of a measured input, or two that are interchanged.

No simulation says what an input should be. So each usual mistake is undone, and the nominal system is driven by what is then measured.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robomill.diagnosis.experiment.measured import Condition
from robomill.diagnosis.experiment.segments import by_array
from robomill.diagnosis.experiment.simulation import Laboratory, Simulator
from robomill.diagnosis.gate.checks import Finding
from robomill.diagnosis.gate.log_faults import Operator, exact
from robomill.orchestration.assembly import MEASURED
from robomill.orchestration.errors import OrchestrationError
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.playback import Playback
from robomill.orchestration.slaves.protocol import FloatArray, Slave

UNDONE = "undone:"
"""Source of a component that plays what was measured, with a mistake undone."""
_PUT_RIGHT = ": with that put right, the nominal system explains nearly all of the gap, or as much as any effects do"


@dataclass(frozen=True)
class Mistake:
    """A mistake in a measured input."""

    columns: tuple[str, ...]
    """What has it, `component.port`."""
    finding: Finding
    operator: Operator


def mistakes(laboratory: Laboratory, n: int) -> list[Mistake]:
    """Those that the diagnosed conditions, the first `n`, may have: a sign, a unit, a zero, two interchanged."""
    found: dict[Finding, Mistake] = {}
    for condition in laboratory.conditions[:n]:
        for component in _players(laboratory, condition):
            for m in _of(component, condition.runs[0]):
                found.setdefault(m.finding, m)
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
    ports = {name: p for name, p in run.ports.items() if name.partition(".")[0] == component and p.type == "real"}
    channels, units = list(ports), [p.unit for p in ports.values()]
    whole = {members[0]: tuple(members) for members in by_array(channels).values()}
    for o in exact(channels, units):
        if o.kind == "unit":  # of a device: of a whole array
            if members := whole.get(o.members[0]):
                yield _in(channels, replace(o, members=members, matrix=o.scale * np.eye(len(members))))
        elif o.kind == "sign" or (o.matrix >= 0.0).all():  # interchanged and turned are two mistakes
            yield _in(channels, o)


def _in(channels: Sequence[str], o: Operator) -> Mistake:
    return Mistake(tuple(channels[i] for i in o.members), o.finding(channels, _PUT_RIGHT), o)


def _without(laboratory: Laboratory, i: int, mistake: Mistake) -> Laboratory:
    """The laboratory with condition `i` driven by what is measured without the mistake."""
    condition, component = laboratory.conditions[i], mistake.columns[0].partition(".")[0]
    (run, *_), system = condition.runs, condition.system or laboratory.system
    if component not in _players(laboratory, condition):
        return laboratory
    there = [c for c in mistake.columns if c in run.columns]
    if there != list(mistake.columns):
        return laboratory
    logged = np.stack([run.columns[c] for c in there], axis=1)
    true = replace(run, columns={**run.columns, **dict(zip(there, mistake.operator.true(logged).T, strict=True))})

    def resolver(source: str, name: str) -> Slave:
        if source == f"{UNDONE}{component}":
            return Playback.of_run(name, true, clamps=True)
        if laboratory.resolver is None:
            raise LookupError("no in-process components were given")
        return laboratory.resolver(source, name)

    changed = replace(condition, system=system.with_source(component, f"{UNDONE}{component}"))
    conditions = [changed if k == i else c for k, c in enumerate(laboratory.conditions)]
    return replace(laboratory, conditions=conditions, resolver=resolver)
