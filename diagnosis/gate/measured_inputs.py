"""Mistakes in what drives a system: another sign, unit or zero of a measured input, or two that are interchanged.

No simulation says what an input should be. So each usual mistake is undone, and the nominal system is driven by what is then measured.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from robomill.diagnosis.experiment.measured import Condition
from robomill.diagnosis.experiment.segments import by_array
from robomill.diagnosis.experiment.simulation import Laboratory, Simulator
from robomill.diagnosis.gate.checks import Finding
from robomill.diagnosis.gate.log_faults import Operator, exact
from robomill.orchestration.assembly import MEASURED
from robomill.orchestration.errors import OrchestrationError
from robomill.orchestration.slaves.playback import Playback
from robomill.orchestration.slaves.protocol import FloatArray, Slave

UNDONE = "undone:"
"""Source of a component that plays what was measured, with a mistake undone."""
_PUT_RIGHT = ": with that put right, the nominal system explains nearly all of the gap"


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
        ports = {name: p for name, p in condition.runs[0].ports.items() if p.type == "real"}
        players = _players(laboratory, condition)
        inputs = {name: p.unit for name, p in ports.items() if name.partition(".")[0] in players}
        outputs = {name: ports[name].unit for name in laboratory.channels if name in ports}
        for m in (*_of_inputs(inputs), *_of_all(inputs, outputs)):
            found.setdefault(m.finding, m)
    return list(found.values())


Groups = list[list[FloatArray]]


def undone(simulator: Simulator, groups: Sequence[Sequence[FloatArray]], mistake: Mistake) -> tuple[Groups, Groups] | None:
    """Measured repeats of the diagnosed conditions as the nominal system would see them without the mistake; None where it cannot run.

    What is left beside the nominal simulation is what is left beside that without the mistake, in the units of the log: the noise is one
    of these. And the same with all that varies in what was measured, as if nothing was simulated.
    """
    laboratory, changes = simulator.laboratory, simulator.seeded(())
    left: Groups = []
    varies: Groups = []
    again = [mistake.operator.scale if c in mistake.columns else 1.0 for c in laboratory.channels]
    for i, group in enumerate(groups):
        changed = _without(laboratory, i, mistake)
        (nominal,) = simulator.many([(i, changes)], "measured inputs")
        try:
            without = changed.simulate(i, changes)
        except OrchestrationError:  # what no input of this machine can be
            return None
        if nominal is None or without is None:
            return None
        measured = list(zip(group, laboratory.measured_in(i), changed.measured_in(i), strict=True))
        left.append([x - logged + nominal + again * (true - without) for x, logged, true in measured])
        varies.append([nominal + again * (true - true.mean(axis=0)) for _, _, true in measured])
    return left, varies


def _players(laboratory: Laboratory, condition: Condition) -> list[str]:
    """Components that play what was measured."""
    system = condition.system or laboratory.system
    return [c.name for c in system.components if c.source.startswith(f"{MEASURED}:")]


def _of_inputs(units: Mapping[str, str | None]) -> Iterator[Mistake]:
    """Mistakes in inputs with these units alone."""
    channels = list(units)
    whole = {members[0]: tuple(members) for members in by_array(channels).values()}
    for o in exact(channels, list(units.values())):
        if o.kind == "unit":  # of a device: of a whole array
            if members := whole.get(o.members[0]):
                yield _in(channels, o.on(members))
        elif o.kind == "sign" or (o.matrix >= 0.0).all():  # interchanged and turned are two mistakes
            yield _in(channels, o)


def _of_all(inputs: Mapping[str, str | None], outputs: Mapping[str, str | None]) -> Iterator[Mistake]:
    """Mistakes in inputs and outputs together: a unit of all that are in one, or an input that is interchanged with an output."""
    channels, units = [*inputs, *outputs], [*inputs.values(), *outputs.values()]
    for unit in dict.fromkeys(u for u in inputs.values() if u and u in outputs.values()):
        members = tuple(i for i, u in enumerate(units) if u == unit)
        for o in exact([channels[members[0]]], [unit]):
            if o.kind == "unit":
                yield _in(channels, replace(o.on(members), what=f"{o.what}, as all signals in {unit} are"))
    arrays = by_array(channels).items()
    for (_, one), (name, other) in itertools.combinations(arrays, 2):
        alike = len(one) == len(other) == 1 or [units[i] for i in one] == [units[i] for i in other]
        if one[0] < len(inputs) <= other[0] and alike:
            swap = np.roll(np.eye(2 * len(one)), len(one), axis=0)
            yield _in(
                channels, Operator((*one, *other), swap, "axes", 1.0, "1", f"is interchanged with {name}", "give each the other's name")
            )


def _in(channels: Sequence[str], o: Operator) -> Mistake:
    return Mistake(tuple(channels[i] for i in o.members), o.finding(channels, _PUT_RIGHT), o)


def _without(laboratory: Laboratory, i: int, mistake: Mistake) -> Laboratory:
    """The laboratory with condition `i` driven by what is measured without the mistake."""
    condition = laboratory.conditions[i]
    (run, *_), system = condition.runs, condition.system or laboratory.system
    players = _players(laboratory, condition)
    if not players or not set(mistake.columns) <= set(run.columns):
        return laboratory
    logged = np.stack([run.columns[c] for c in mistake.columns], axis=1)
    true = replace(run, columns={**run.columns, **dict(zip(mistake.columns, mistake.operator.true(logged).T, strict=True))})

    def resolver(source: str, name: str) -> Slave:
        if source.startswith(UNDONE):
            return Playback.of_run(name, true, clamps=True)
        if laboratory.resolver is None:
            raise LookupError("no in-process components were given")
        return laboratory.resolver(source, name)

    for component in players:
        system = system.with_source(component, f"{UNDONE}{component}")
    changed = replace(condition, system=system, runs=(true,))
    conditions = [changed if k == i else c for k, c in enumerate(laboratory.conditions)]
    return replace(laboratory, conditions=conditions, resolver=resolver)
