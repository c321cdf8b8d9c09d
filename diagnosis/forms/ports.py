"""Ports at which a form may be put in, and what it would do there to what was measured: rows for the selection.

- A measured output of the component itself: what a term adds is seen as it is.
- An output that was not measured, behind which another component has measured ones: what a small constant shift of the output does there,
  at each time, tells what a term does there.
- An input of a component with measured outputs behind it that add up what goes in (they are not replayed alone): what a term does to all
  that is measured is simulated in the closed loop.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from robomill.diagnosis.experiment.component_replay import KNOWN, ComponentReplay
from robomill.diagnosis.experiment.simulation import Laboratory, decimate
from robomill.diagnosis.forms.layout import Side
from robomill.diagnosis.forms.library import OF_ONE, Term, library, periodic
from robomill.diagnosis.forms.selection import Rows
from robomill.diagnosis.forms.signals import Host, Variable, series, value, variables
from robomill.orchestration.slaves.protocol import FloatArray, base_name

OTHERS = ("value", "sign")
"""Kinds of terms of other joints, where all joints of a port are looked at together."""

Signals = Mapping[Variable, FloatArray]


@dataclass(frozen=True)
class Seen:
    """What a component has seen in each condition: variable -> [n], with the times [n] [s]."""

    host: Host
    side: Side
    known: Sequence[Signals]
    t: Sequence[FloatArray]

    @staticmethod
    def of(laboratory: Laboratory, replays: Sequence[ComponentReplay], name: str, side: Side) -> Seen:
        """The signals of a component in these replays."""
        host = Host.of(laboratory, replays[0].index, name)
        wanted = variables(host, side)
        found = []
        for r in replays:
            ports = series(r, host, side, laboratory)
            made = {v: value(v, ports, r.grid) for v in wanted}
            found.append({v: x for v, x in made.items() if x is not None})
        return Seen(host, side, found, [r.grid for r in replays])

    @property
    def longest(self) -> float:
        """Length [s] of the longest run."""
        return max(float(t[-1] - t[0]) for t in self.t)

    def library(self, element: str, alone: bool) -> list[Term]:
        """Terms for a port; `alone`: it is looked at by itself. Of an input none is about an output that shows it (`Host.shows`)."""
        index, unit = element.partition("[")[2].rstrip("]"), self.host.ports[element].unit or "1"
        known = [{v: x for v, x in k.items() if self.side == "output" or not self.host.shows(v.name, element)} for k in self.known]
        return library(known, index, self.longest, OF_ONE if alone else OTHERS, unit)

    def angles(self, element: str) -> list[Variable]:
        """Variables that a port may be periodic in: angles and ways of its index, or all if it has none."""
        index = element.partition("[")[2].rstrip("]")
        fit = [v for v in self.known[0] if v.unit in ("rad", "m") and not (v.rate or v.since_start) and all(v in k for k in self.known)]
        return [v for v in fit if v.index == index] or fit


@dataclass
class Problem:
    """Rows for a choice of terms, each of which is added to one port."""

    seen: Seen
    targets: tuple[str, ...]
    """Measured arrays that it explains."""
    terms: list[tuple[str, Term]]
    """(element of the port, term) of each column."""
    gap: list[FloatArray]
    """What is to be explained, by condition, [n, channels] over `scale`."""
    effect: Sequence[Mapping[str, FloatArray]]
    """By condition: element -> what one unit of it does to each channel at each time, [n, channels] over `scale`."""
    decimation: int
    step: float
    """Time between samples [s]."""
    extra: Mapping[tuple[str, Term], Sequence[FloatArray]] = field(default_factory=dict)
    """Columns that were simulated, [n, channels] by condition."""

    def column(self, element: str, term: Term) -> list[FloatArray]:
        """What a term does, by condition, [n, channels]."""
        if (element, term) in self.extra:
            return list(self.extra[element, term])
        known = self.seen.known
        return [e[element] * term.values(k, len(g))[:, None] for e, k, g in zip(self.effect, known, self.gap, strict=True)]

    def rows(self, terms: Sequence[tuple[str, Term]] | None = None) -> Rows:
        """The rows of these terms, or of all; block means over the decimation."""
        terms = self.terms if terms is None else terms
        gap = [decimate(g, self.decimation) for g in self.gap]
        columns = [[decimate(x, self.decimation) for x in self.column(*t)] for t in terms]
        channels = gap[0].shape[1]
        y = np.concatenate([g.T.ravel() for g in gap])
        X = np.stack([np.concatenate([x.T.ravel() for x in c]) for c in columns], axis=1) if terms else np.zeros((len(y), 0))
        series_ = np.concatenate([np.repeat(i * channels + np.arange(channels), len(g)) for i, g in enumerate(gap)])
        condition = np.concatenate([np.full(g.size, i) for i, g in enumerate(gap)])
        position = np.concatenate([np.tile((np.arange(len(g)) + 0.5) / len(g), channels) for g in gap])
        return Rows(y, X, series_, condition, position, self.decimation * self.step)

    def periodic(self, element: str, v: Variable, k: float) -> list[tuple[str, Term]]:
        """Sine and cosine as columns."""
        return [(element, t) for t in periodic(v, k)]


def alike(laboratory: Laboratory, i: int) -> bool:
    """Whether a condition is made by the components and connections of the system that is diagnosed."""
    system, own = laboratory.system, laboratory.conditions[i].system
    return own is None or ([c.name for c in own.components], own.connections) == ([c.name for c in system.components], system.connections)


def direct(laboratory: Laboratory, replays: Sequence[ComponentReplay], component: str) -> list[Problem]:
    """One problem for each measured output of a component that can be replayed."""
    adding = {a for r in replays for a in r.adding}
    channels = [c for c in replays[0].channels if c.partition(".")[0] == component and base_name(c) not in adding]
    if not channels:
        return []
    seen = Seen.of(laboratory, replays, component, "output")
    found = []
    for column in channels:
        element = column.partition(".")[2]
        if element not in seen.host.ports:
            continue
        at = [replays[0].channels.index(column)]
        gap = [np.mean(r.residuals, axis=0)[:, at] for r in replays]
        size = _rms(replays, gap, at)
        if size == 0.0:
            continue
        effect = [{element: np.full((len(g), 1), 1.0 / size)} for g in gap]
        terms = [(element, t) for t in seen.library(element, alone=True)]
        found.append(Problem(seen, (base_name(column),), terms, [g / size for g in gap], effect, laboratory.decimation, replays[0].step))
    return found


def behind(laboratory: Laboratory, replays: Sequence[ComponentReplay], component: str) -> list[Problem]:
    """One problem for each output of a component that was not measured and that another one with measured outputs takes."""
    found = []
    for array, target in replays[0].hidden():
        adding = {a for r in replays for a in r.adding}
        channels = [c for c in replays[0].channels if c.partition(".")[0] == target and base_name(c) not in adding]
        if array.partition(".")[0] != component or not channels:
            continue
        seen = Seen.of(laboratory, replays, component, "output")
        base = array.partition(".")[2]
        elements = [p for p in seen.host.ports if base_name(p) == base]
        at = [replays[0].channels.index(c) for c in channels]
        gap = [np.mean(r.residuals, axis=0)[:, at] for r in replays]
        of = {a: [k for k, c in enumerate(channels) if base_name(c) == a] for a in map(base_name, channels)}
        sizes = {a: _rms(replays, [g[:, some] for g in gap], [at[k] for k in some]) for a, some in of.items()}
        scale = np.array([sizes[base_name(c)] or 1.0 for c in channels])
        effect: list[dict[str, FloatArray]] = []
        for r in replays:
            made = {}
            for e in elements:
                column = f"{component}.{e}"
                way = float(np.ptp(r.base.columns[column])) or max(float(np.abs(r.base.columns[column]).max()), KNOWN)
                moved = r.follow({column: np.full(len(r.grid), KNOWN * way)}, [array], target)
                made[e] = np.stack([moved[c] for c in channels], axis=1) / (KNOWN * way * scale)
            effect.append(made)
        if not any(np.any(x) for made in effect for x in made.values()):
            continue
        terms = [(e, t) for e in elements for t in seen.library(e, alone=len(elements) == 1)]
        problem = Problem(seen, tuple(sizes), terms, [g / scale for g in gap], effect, laboratory.decimation, replays[0].step)
        found.append(problem)
    return found


def into(laboratory: Laboratory, replays: Sequence[ComponentReplay], component: str) -> list[Problem]:
    """One problem for the inputs of a component with measured outputs behind it that add up; each term is simulated in the closed loop."""
    if not any(a.partition(".")[0] in _reached(replays[0], component) for r in replays for a in r.adding):
        return []
    seen = Seen.of(laboratory, replays, component, "input")
    channels = replays[0].channels
    gap = [r.mean - r.nominal for r in replays]
    arrays = list(map(base_name, channels))
    of = {a: [k for k, x in enumerate(arrays) if x == a] for a in arrays}
    sizes = {a: _rms(replays, [g[:, some] for g in gap], some) or 1.0 for a, some in of.items()}
    scale = np.array([sizes[a] for a in arrays])
    terms, extra = [], {}
    for element, (column, _) in seen.host.sources.items():
        if element not in seen.host.ports:
            continue
        usual = max(float(np.sqrt(np.mean(r.closed[0].columns[column] ** 2))) for r in replays)
        for term in seen.library(element, alone=True):
            made = []
            for r, known in zip(replays, seen.known, strict=True):
                x = term.values(known, len(r.grid))
                push = KNOWN * usual / (float(np.sqrt(np.mean(x**2))) or 1.0)
                made.append((r.pushed(component, column, push * x) - r.nominal) / (push * scale))
            if any(np.any(x) for x in made):
                terms.append((element, term))
                extra[element, term] = made
    step, scaled = replays[0].step, [g / scale for g in gap]
    return [Problem(seen, tuple(dict.fromkeys(arrays)), terms, scaled, [], laboratory.decimation, step, extra)] if terms else []


def _reached(replay: ComponentReplay, component: str) -> set[str]:
    """The component, and those that its outputs reach without being measured."""
    found, new = set(), {component}
    while new:
        found |= new
        new = {target for array, target in replay.hidden() if array.partition(".")[0] in new} - found
    return found


def _rms(replays: Sequence[ComponentReplay], gap: Sequence[FloatArray], channels: Sequence[int]) -> float:
    """Root mean square of the gap in these channels, [n, channels] by replay; 0 where it is roundoff of what was measured there."""
    size, signal = (float(np.sqrt(np.mean(np.concatenate(x) ** 2))) for x in (gap, [r.mean[:, channels] for r in replays]))
    return size if size > np.sqrt(np.finfo(np.float64).eps) * signal else 0.0
