"""The signals of a component in the measured runs: what goes into it and what comes out of it, as its equations would see them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robomill.diagnosis.experiment.component_replay import ComponentReplay
from robomill.diagnosis.experiment.simulation import Laboratory
from robomill.models.components.correction import TIME
from robomill.models.model.units import compatible
from robomill.orchestration.assembly import assemble
from robomill.orchestration.slaves.protocol import FloatArray, Port, arrays, base_name, inputs, outputs
from robomill.orchestration.system.definition import Connection

HAVE_A_SPEED = ("rad", "m")
"""Units of what has a velocity."""


def index_of(element: str) -> str:
    """Index of an element of an array, `1,2` of `m[1,2]`; "" of a scalar."""
    return element.partition("[")[2].rstrip("]")


@dataclass(frozen=True)
class Variable:
    """A variable of a form: an element of a port (`qd[1]`), its rate, what it changed since the start, or the time."""

    name: str
    rate: bool
    unit: str
    count: int
    """Elements of its array; 0: a scalar."""
    since_start: bool = False
    """Whether it is what the element changed since the start."""

    @property
    def text(self) -> str:
        """As a formula has it."""
        if self.since_start:
            return f"({self.name} - {self.name} at t = 0)"
        return f"d({self.name})/dt" if self.rate else self.name

    @property
    def index(self) -> str:
        """Index of the element; "" of a scalar."""
        return index_of(self.name)


@dataclass(frozen=True)
class Host:
    """The component that a form is put into: its ports, and which of its inputs see what was there a step before."""

    name: str
    ports: Mapping[str, Port]
    """Inputs and outputs by name of the element."""
    counts: Mapping[str, int]
    """Elements of each array; 0 of a scalar."""
    sources: Mapping[str, tuple[str, bool]]
    """Input -> column that goes into it (`component.port`), and whether a step late."""

    @staticmethod
    def of(laboratory: Laboratory, index: int, name: str) -> Host:
        """The component of that name in condition `index`."""
        system = laboratory.configured(index)
        with assemble(system, laboratory.resolver, laboratory.convert) as assembly:
            known = {n: [*inputs(s.ports), *outputs(s.ports)] for n, s in assembly.slaves.items()}
            rank = {n: k for k, n in enumerate(assembly.wiring.order)}
        sources: dict[str, tuple[str, bool]] = {}
        for c in system.connections:
            origin, target = c.source.partition(".")[0], c.target.partition(".")[0]
            if target != name:
                continue
            late = c.delayed or system.algorithm == "jacobi" or (system.algorithm == "gauss-seidel" and rank[origin] >= rank[target])
            for column, element in _pairs(c, known):
                sources[element] = (column, late)
        ports = {p.name: p for p in known[name] if p.type == "real" and "," not in p.name}
        counts = {
            base: len(members) if members[0].name != base else 0
            for base, members in arrays(tuple(known[name])).items()
            if all(p.name in ports for p in members)
        }
        return Host(name, {n: p for n, p in ports.items() if base_name(n) in counts}, counts, sources)

    def is_input(self, element: str) -> bool:
        """Whether a port goes in."""
        return self.ports[element].causality == "input"

    def shows(self, name: str, element: str) -> bool:
        """Whether an output shows what goes into an input: it may take it in the same step, and is the same quantity.

        As it was measured it holds what the input should have been, and so says nothing of why; in the loop it follows the input.
        """
        port, given = self.ports.get(name), self.ports[element]
        if port is None or port.causality != "output" or (port.dependencies is not None and element not in port.dependencies):
            return False
        return (port.unit or "1") == (given.unit or "1") or compatible(port.unit or "1", given.unit or "1")


def _pairs(c: Connection, known: Mapping[str, Sequence[Port]]) -> list[tuple[str, str]]:
    """(column, element of the input) of a connection."""
    ends = []
    for end, causality in ((c.source, "output"), (c.target, "input")):
        component, _, port = end.partition(".")
        ends.append([p.name for p in known[component] if p.causality == causality and port in (p.name, base_name(p.name))])
    return [(f"{c.source.partition('.')[0]}.{a}", b) for a, b in zip(*ends, strict=True)]


def variables(host: Host, side: str) -> list[Variable]:
    """What a form of this component may depend on; `side`: what it corrects, outputs or inputs."""
    found = []
    rates = {p.unit for p in host.ports.values()}
    for name, p in host.ports.items():
        if host.is_input(name) and name not in host.sources:
            continue
        unit, count = p.unit or "1", host.counts[base_name(name)]
        found.append(Variable(name, False, unit, count))
        if unit in HAVE_A_SPEED:
            found.append(Variable(name, False, unit, count, since_start=True))
        has_speed = any(u and compatible(u, f"{unit}/s") for u in rates)
        if not (unit in HAVE_A_SPEED and has_speed) and (unit in HAVE_A_SPEED or (side == "output" and not host.is_input(name))):
            found.append(Variable(name, True, _per_second(unit), count))
    return [*found, Variable(TIME, False, "s", 0)]


def _per_second(unit: str) -> str:
    return "1/s" if unit == "1" else f"({unit})/s" if "/" in unit else f"{unit}/s"


def series(replay: ComponentReplay, host: Host, side: str, laboratory: Laboratory, in_loop: bool = False) -> dict[str, FloatArray]:
    """Values of the ports of the component in a condition, element -> [n]; what was never measured nor replayed is not there.

    Inputs as they were measured, or else as they were replayed, a step late where they arrive so. Outputs as the component gives them with
    these inputs, where it is they that are corrected. Else they are as measured, or as what was measured behind them has it (`restored`),
    or as they are in the nominal closed loop; a step late, which is what the component has when it steps. `in_loop`: inputs that were not
    measured are as in the nominal closed loop, because a replay adds up errors.
    """
    found: dict[str, FloatArray] = {}
    given, measured = replay.inputs[host.name], replay.signals()
    hidden = restored(replay, host.name, in_loop) if side == "input" else {}
    for element, (column, late) in host.sources.items():
        if element in host.ports and column in given:
            stated, wanted = replay.unit(column), host.ports[element].unit or ""
            values = replay.in_the_loop(column) if in_loop and column not in measured else given[column]
            if stated and wanted and stated != wanted:
                zero, one = (laboratory.convert(x, stated, wanted) for x in (0.0, 1.0))
                values = zero + (one - zero) * values
            found[element] = _late(values) if late else values
    for element in host.ports:
        column = f"{host.name}.{element}"
        if host.is_input(element):
            continue
        if side == "input":
            if column in measured:
                found[element] = _late(measured[column])
            elif element in hidden:
                found[element] = _late(hidden[element])
            elif column in replay.closed[0].columns:
                found[element] = _late(replay.in_the_loop(column))
        elif column in replay.base.columns:
            found[element] = replay.as_replayed(column)
    return found


def restored(replay: ComponentReplay, name: str, in_loop: bool) -> dict[str, FloatArray]:
    """Outputs of a component that were not measured, as what was measured behind them has it: element -> [n].

    A small constant shift of each output tells what it does there, J [n, channels, elements]. With the gap there, g [n, channels], the
    output was off by J^+ g: an output that a sensor shows is what it has shown. Without those that measured channels do not tell apart.
    """
    found: dict[str, FloatArray] = {}
    gap = replay.mean - replay.nominal if in_loop else np.mean(replay.residuals, axis=0)
    usual = replay.in_the_loop if in_loop else replay.as_replayed
    for array, target in replay.hidden():
        own = [c for c in replay.channels if c.partition(".")[0] == target]
        channels = [c for c in own if in_loop or base_name(c) not in replay.adding]
        if array.partition(".")[0] != name or not channels:
            continue
        slopes = replay.slopes(array, target)
        if not slopes:
            continue
        J = np.stack([np.stack([moved[c] for c in channels], axis=1) for moved in slopes.values()], axis=2)
        if np.median(np.linalg.matrix_rank(J)) == len(slopes):  # at the start nothing may show yet
            at = [replay.channels.index(c) for c in channels]
            off = (np.linalg.pinv(J) @ gap[:, at, None])[..., 0]
            found |= {k.partition(".")[2]: usual(k) + off[:, j] for j, k in enumerate(slopes)}
    return found


def _late(values: FloatArray) -> FloatArray:
    return np.concatenate([values[:1], values[:-1]])


def value(variable: Variable, known: Mapping[str, FloatArray], t: FloatArray) -> FloatArray | None:
    """Series [n] of a variable; None where its port says nothing. A rate is that over the last step, as the form has it."""
    if variable.name == TIME:
        return np.asarray(t - t[0])
    x = known.get(variable.name)
    if x is None or np.ptp(x) <= 1e-12 * np.abs(x).max(initial=0.0):
        return None
    if variable.rate:
        return np.asarray(np.diff(x, prepend=x[0]) / (t[1] - t[0]))
    return np.asarray(x - x[0]) if variable.since_start else x
