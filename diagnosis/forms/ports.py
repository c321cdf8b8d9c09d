"""Ports at which a form may be put in, and what it would do there to what was measured: rows for the selection.

- A measured output of the component itself: what a term adds is seen as it is.
- An output that was not measured, behind which another component has measured ones: what a small constant shift of the output does there,
  at each time, tells what a term does there.
- An input of a component with several measured outputs: what a term does to them is what the component alone makes of it. One law at an
  input shows in all of them, as the component makes it (filtered, turned), where laws at the outputs would be as many.
- An input of a component with measured outputs behind it that add up what goes in (they are not replayed alone): what a term does to all
  that is measured is what the closed loop makes of it.

At an input terms are chosen by the response to pulses (`responses`), and those that are chosen are simulated.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from heapq import heappush, heappushpop

import numpy as np

from robomill.diagnosis.experiment.component_replay import KNOWN, ComponentReplay
from robomill.diagnosis.experiment.simulation import Laboratory, decimate
from robomill.diagnosis.forms.doubts import Doubts, likeliest, passed_on
from robomill.diagnosis.forms.layout import Side
from robomill.diagnosis.forms.library import OF_ONE, Term, library, periodic
from robomill.diagnosis.forms.responses import Response
from robomill.diagnosis.forms.selection import Rows
from robomill.diagnosis.forms.signals import Host, Variable, index_of, series, value, variables
from robomill.models.components.correction import TIME
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
    def of(laboratory: Laboratory, replays: Sequence[ComponentReplay], name: str, side: Side, in_loop: bool = False) -> Seen:
        """The signals of a component in these replays; `in_loop` as in `series`."""
        host = Host.of(laboratory, replays[0].index, name)
        wanted = variables(host, side)
        found = []
        for r in replays:
            ports = series(r, host, side, laboratory, in_loop)
            made = {v: value(v, ports, r.grid) for v in wanted}
            found.append({v: x for v, x in made.items() if x is not None})
        return Seen(host, side, found, [r.grid for r in replays])

    @property
    def longest(self) -> float:
        """Length [s] of the longest run."""
        return max(float(t[-1] - t[0]) for t in self.t)

    def library(self, element: str, alone: bool) -> list[Term]:
        """Terms for a port; `alone`: it is looked at by itself. Of an input none is about an output that shows it (`Host.shows`)."""
        index, unit = index_of(element), self.host.ports[element].unit or "1"
        known = [{v: x for v, x in k.items() if self.side == "output" or not self.host.shows(v.name, element)} for k in self.known]
        array = base_name(element) if self.side == "input" else ""
        return library(known, index, self.longest, OF_ONE if alone else OTHERS, unit, array)

    def angles(self, element: str) -> list[Variable]:
        """Variables that a port may be periodic in: angles and ways of its index, or all if it has none."""
        index = index_of(element)
        fit = [v for v in self.known[0] if v.unit in ("rad", "m") and not (v.rate or v.since_start) and all(v in k for k in self.known)]
        return [v for v in fit if v.index == index] or fit


@dataclass
class Problem:
    """Rows for a choice of terms, each of which is added to one port."""

    seen: Seen
    channels: tuple[str, ...]
    """Measured channels that it explains."""
    terms: list[tuple[str, Term]]
    """(element of the port, term) of each column."""
    gap: list[FloatArray]
    """What is to be explained, by condition, [n, channels] over `scale`."""
    scale: FloatArray
    """Size of one in each channel [its unit]."""
    effect: Sequence[Mapping[str, FloatArray]]
    """By condition: element -> what one unit of it does to each channel at each time, [n, channels] over `scale`."""
    decimation: int
    step: float
    """Time between samples [s]."""
    extra: Mapping[tuple[str, Term], Sequence[FloatArray]] = field(default_factory=dict)
    """Columns that were simulated, block means over the decimation of the laboratory, [blocks, channels] by condition."""
    doubts: Sequence[Sequence[FloatArray]] = ()
    """What each calibrated number may do, by condition, as `extra`."""
    noise: FloatArray = field(default_factory=lambda: np.ones(1))
    """Standard deviation of the noise of each channel, of block means over the decimation of the laboratory, over `scale`."""
    off: Sequence[float] = ()
    """How far off each calibrated number is taken to be [standard deviations]; what that does is no part of the rows."""
    base: int = 1
    """Decimation of the laboratory."""
    in_loop: bool = False
    """Whether the gap and all columns are those of the closed loop, and not of components alone."""
    approximate: bool = False
    """Whether the closed loop may do otherwise than the columns say: they are slopes, or of outputs that are not as they were measured."""
    simulated: Callable[[str, Term], Sequence[FloatArray]] | None = None
    """Simulates what a term of an element does, as `extra`, where that is by a response; None where columns are what they are."""

    @property
    def targets(self) -> tuple[str, ...]:
        """Arrays of these channels."""
        return tuple(dict.fromkeys(map(base_name, self.channels)))

    def of(self, terms: Sequence[tuple[str, Term]]) -> Problem:
        """The problem with these terms only, each of them simulated."""
        assert self.simulated is not None
        return replace(self, terms=list(terms), extra={t: self.simulated(*t) for t in terms}, simulated=None)

    def column(self, element: str, term: Term) -> list[FloatArray]:
        """What a term does, by condition, block means over the decimation, [blocks, channels]."""
        if (element, term) in self.extra:
            return [decimate(x, self.decimation // self.base) for x in self.extra[element, term]]
        known = self.seen.known
        made = [e[element] * term.values(k, len(g))[:, None] for e, k, g in zip(self.effect, known, self.gap, strict=True)]
        return [decimate(x, self.decimation) for x in made]

    def rows(self, terms: Sequence[tuple[str, Term]] | None = None, groups: Sequence[Sequence[int]] = ()) -> Rows:
        """The rows of these terms, or of all, and behind them those of sums of `groups` of them; block means."""
        terms = self.terms if terms is None else terms
        gap = [decimate(g, self.decimation) for g in self.gap]
        channels, part = gap[0].shape[1], self.decimation // self.base
        for z, parts in zip(self.off, self.doubts, strict=bool(self.off)):
            gap = [g - z * decimate(x, part) for g, x in zip(gap, parts, strict=True)]
        members = ([self.column(*terms[i]) for i in group] for group in groups)
        sums = ([np.sum(parts, axis=0) for parts in zip(*columns, strict=True)] for columns in members)
        both = _stacked(itertools.chain([gap], (self.column(*t) for t in terms), sums), 1 + len(terms) + len(groups))
        y, X = both[:, 0], both[:, 1:]
        series_ = np.concatenate([np.repeat(i * channels + np.arange(channels), len(g)) for i, g in enumerate(gap)])
        condition = np.concatenate([np.full(g.size, i) for i, g in enumerate(gap)])
        position = np.concatenate([np.tile((np.arange(len(g)) + 0.5) / len(g), channels) for g in gap])
        return Rows(y, X, series_, condition, position, self.decimation * self.step)

    def beside(self, terms: Sequence[tuple[str, Term]]) -> Problem:
        """The problem with calibrated numbers as far off as leaves least beside these terms (`likeliest`)."""
        if not self.doubts:
            return self
        part = self.decimation // self.base
        rows = replace(self, off=()).rows(terms)
        size = _stacked([[np.broadcast_to(self.noise / np.sqrt(part), decimate(g, self.decimation).shape) for g in self.gap]], 1)
        doubt = _stacked(([decimate(x, part) for x in parts] for parts in self.doubts), len(self.doubts))
        return replace(self, off=tuple(map(float, likeliest(rows.y / size[:, 0], rows.X / size, doubt / size))))

    def periodic(self, element: str, v: Variable, k: float) -> list[tuple[str, Term]]:
        """Sine and cosine as columns."""
        return [(element, t) for t in periodic(v, k)]


def _stacked(columns: Iterable[Sequence[FloatArray]], count: int) -> FloatArray:
    """One column of rows for each of so many, [n, count]; channels of a condition [samples, channels] one after the other."""
    found = np.zeros((0, count))
    for k, column in enumerate(columns):  # thousands of columns are not held twice
        rows = np.concatenate([x.T.ravel() for x in column])
        found = found if len(found) else np.empty((len(rows), count))
        found[:, k] = rows
    return found


def doubted(problem: Problem, replays: Sequence[ComponentReplay], doubts: Doubts, deviation: Mapping[str, float]) -> Problem:
    """The problem beside what calibrated numbers may do to it; `deviation`: that of the noise of each channel [its unit]."""
    if not all(deviation.get(c) for c in problem.channels):
        return problem
    at = [replays[0].channels.index(c) for c in problem.channels]
    moved = doubts.looped() if problem.in_loop else doubts.alone()
    shown = [[x[:, at] / problem.scale for x in parts] for parts in moved if any(np.any(x[:, at]) for x in parts)]
    noise = np.array([deviation[c] for c in problem.channels]) / problem.scale
    return replace(problem, doubts=shown, noise=noise, base=replays[0].laboratory.decimation)


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
    seen, d = Seen.of(laboratory, replays, component, "output"), laboratory.decimation
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
        scaled = [g / size for g in gap]
        found.append(Problem(seen, (column,), terms, scaled, np.array([size]), effect, d, replays[0].step, base=d))
    return found


def behind(laboratory: Laboratory, replays: Sequence[ComponentReplay], component: str) -> list[Problem]:
    """One problem for each output of a component that was not measured and that another one with measured outputs takes."""
    found, d = [], laboratory.decimation
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
        scale = _sizes(replays, gap, channels)
        effect: list[dict[str, FloatArray]] = []
        for r in replays:
            slopes = r.slopes(array, target)
            made = {k.partition(".")[2]: np.stack([moved[c] for c in channels], axis=1) / scale for k, moved in slopes.items()}
            effect.append(made)
        if not any(np.any(x) for made in effect for x in made.values()):
            continue
        terms = [(e, t) for e in elements for t in seen.library(e, alone=len(elements) == 1)]
        scaled = [g / scale for g in gap]
        whole = Problem(seen, tuple(channels), terms, scaled, scale, effect, d, replays[0].step, base=d, approximate=True)
        gaps = [decimate(g, d) for g in scaled]
        best = _Screened(sum(map(len, gaps)))
        for t in terms:
            best.add(t, whole.column(*t), gaps)
        found.append(replace(whole, terms=list(best.columns())))
    return found


def entering(laboratory: Laboratory, replays: Sequence[ComponentReplay], component: str, deviation: Mapping[str, float]) -> list[Problem]:
    """One problem for the inputs of a component, as far as outputs show them, the component alone.

    Terms are of inputs, of the time, and of outputs that no input of now reaches: what was measured of the others holds what the law does
    already. `deviation`: channels that count, with the standard deviation of their noise [unit of the channel].
    """
    seen = Seen.of(laboratory, replays, component, "input")
    read = {n for n, p in seen.host.ports.items() if seen.host.is_input(n) or p.dependencies == ()} | {TIME}
    seen = replace(seen, known=[{v: x for v, x in k.items() if v.name in read} for k in seen.known])
    adding = {a for r in replays for a in r.adding}
    reached = _reached(replays[0], component)
    channels = tuple(c for c in replays[0].channels if c in deviation and c.partition(".")[0] in reached and base_name(c) not in adding)
    if not channels:
        return []
    at = [replays[0].channels.index(c) for c in channels]
    gap = [np.mean(r.residuals, axis=0)[:, at] for r in replays]

    def does(r: ComponentReplay, column: str, push: FloatArray) -> FloatArray:
        moved = r.follow({column: push}, [base_name(column)], component)
        return passed_on(r, component, moved)[:, at]

    usual = {column: _usual([r.inputs[component][column] for r in replays]) for column, _ in seen.host.sources.values()}
    noise = np.array([deviation[c] for c in channels])
    return _simulated(laboratory, replays, seen, channels, gap, noise, usual, does, in_loop=False)


def into(laboratory: Laboratory, replays: Sequence[ComponentReplay], component: str) -> list[Problem]:
    """One problem for the inputs of a component with measured outputs behind it that add up, in the closed loop."""
    if not any(a.partition(".")[0] in _reached(replays[0], component) for r in replays for a in r.adding):
        return []
    seen = Seen.of(laboratory, replays, component, "input", in_loop=True)
    gap = [r.mean - r.nominal for r in replays]

    def does(r: ComponentReplay, column: str, push: FloatArray) -> FloatArray:
        return r.pushed(component, column, push) - r.nominal

    usual = {column: _usual([r.closed[0].columns[column] for r in replays]) for column, _ in seen.host.sources.values()}
    channels = tuple(replays[0].channels)
    return _simulated(laboratory, replays, seen, channels, gap, _sizes(replays, gap, channels), usual, does, in_loop=True)


Does = Callable[[ComponentReplay, str, FloatArray], FloatArray]
"""What all channels of a problem do, [n, channels], where something [n] is added to a column."""


def _simulated(
    laboratory: Laboratory,
    replays: Sequence[ComponentReplay],
    seen: Seen,
    channels: tuple[str, ...],
    gap: Sequence[FloatArray],
    scale: FloatArray,
    usual: Mapping[str, float],
    does: Does,
    *,
    in_loop: bool,
) -> list[Problem]:
    """The problem of the `gap` in some channels, over `scale`, with terms at inputs, by their `Response`; none without any term.

    `usual`: size of what passes, by column (`_push`). `in_loop`: gap and columns are those of the closed loop.
    """
    d, step, scaled = laboratory.decimation, replays[0].step, [g / scale for g in gap]
    gaps = [decimate(g, d) for g in scaled]
    best = _Screened(sum(map(len, gaps)))
    slowest = max(c.every for c in laboratory.system.components) * laboratory.system.step
    for element, (column, late) in seen.host.sources.items():
        terms = seen.library(element, alone=in_loop) if element in seen.host.ports else []
        if not terms:
            continue
        made = []
        for r, known in zip(replays, seen.known, strict=True):
            given = np.stack([_sent(term.values(known, len(r.grid)), late) for term in terms], axis=1)
            width = max(1, math.ceil(slowest / (d * r.step) - 0.5))
            response = Response.of(partial(does, r, column), len(r.grid), d, width, _push(usual[column], np.ones(1)))
            made.append(response.to(decimate(given, d)) / scale[:, None])
        for k, term in enumerate(terms):
            best.add((element, term), [x[:, :, k].copy() for x in made], gaps)
    extra = best.columns()
    read = {v.name for known in seen.known for v in known} & set(seen.host.ports)
    approximate = in_loop or not all(map(seen.host.is_input, read))

    def simulated(element: str, term: Term) -> list[FloatArray]:
        column, late = seen.host.sources[element]
        made = []
        for r, known in zip(replays, seen.known, strict=True):
            x = _sent(term.values(known, len(r.grid)), late)
            push = _push(usual[column], x)
            made.append(decimate(does(r, column, push * x) / (push * scale), d))
        return made

    if not extra:
        return []
    problem = Problem(seen, channels, list(extra), scaled, scale, [], d, step, extra, base=d, in_loop=in_loop, approximate=approximate)
    return [replace(problem, simulated=simulated)]


def _sent(x: FloatArray, late: bool) -> FloatArray:
    """A series that arrives as x [n], where what is sent may arrive a step later."""
    return np.append(x[1:], x[-1]) if late else x


class _Screened:
    """Terms that do most of the gap by themselves, as many as there are samples (after Fan & Lv 2008).

    An axis has thousands of terms at its inputs. What is more than samples cannot be told apart, and is not kept in memory.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._heap: list[tuple[float, int, tuple[str, Term], Sequence[FloatArray]]] = []
        self._count = 0

    def add(self, term: tuple[str, Term], does: Sequence[FloatArray], gap: Sequence[FloatArray]) -> None:
        """A term and what it does, by condition; one that does nothing is none."""
        self._count += 1
        size = sum(float((x**2).sum()) for x in does)
        if size > 0.0:
            alone = abs(sum(float((x * g).sum()) for x, g in zip(does, gap, strict=True))) / np.sqrt(size)
            (heappush if len(self._heap) < self._most else heappushpop)(self._heap, (alone, -self._count, term, does))

    def columns(self) -> dict[tuple[str, Term], Sequence[FloatArray]]:
        """Those that are kept, in the order in which they came."""
        return {term: does for _, _, term, does in sorted(self._heap, key=lambda entry: -entry[1])}


def _push(usual: float, x: FloatArray) -> float:
    """How much of a series [n] is tried: KNOWN of the size of what passes, or of one where nothing passes."""
    return KNOWN * (usual or 1.0) / (_usual([x]) or 1.0)


def _usual(values: Sequence[FloatArray]) -> float:
    """The largest root mean square of these series."""
    return max(float(np.sqrt(np.mean(x**2))) for x in values)


def _sizes(replays: Sequence[ComponentReplay], gap: Sequence[FloatArray], channels: Sequence[str]) -> FloatArray:
    """Size of the gap in the array of each of these channels; 1 where it is roundoff."""
    arrays = [base_name(c) for c in channels]
    of = {a: [k for k, x in enumerate(arrays) if x == a] for a in arrays}
    at = [replays[0].channels.index(c) for c in channels]
    sizes = {a: _rms(replays, [g[:, some] for g in gap], [at[k] for k in some]) for a, some in of.items()}
    return np.array([sizes[a] or 1.0 for a in arrays])


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
