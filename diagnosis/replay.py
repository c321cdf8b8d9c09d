"""Where: each component driven alone with measured inputs.

The system is cut open wherever an output is measured: what is behind the cut gets the measured signal. What is left between cuts is a
segment, all of whose components may be to blame for its output. Nothing that happens upstream of a cut, and no feedback through it, shows.

Measured inputs scatter, and a component that is not linear makes an offset of that. So the same is done with signals that are
right by construction (simulated ones with the scatter of the repeats), and what comes out of that is taken off.

Changes by parameters are simulated for the component alone, and followed through connections that are not measured.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from diagnosis.catalogue import LOGGING, Address, Catalogue, Nuisance
from diagnosis.evidence import SUDDEN, TRUST
from diagnosis.measured import DataError
from diagnosis.noise import whitening
from diagnosis.simulation import Laboratory, Setting, decimate, refined, with_values
from diagnosis.tape import Tape
from orchestration.assembly import run
from orchestration.errors import OrchestrationError
from orchestration.results import Run
from orchestration.slave import FloatArray, Slave, base_name
from orchestration.system import Component, Connection, System

TAPE = "tape:"
KNOWN = 1e-3
"""Relative deviation up to which the signal of a component without inputs (a program) is taken as it is simulated."""
LATENESS = 12.0**-0.5
"""Steps that the outputs of a component which is driven alone may be late: measured inputs reach it anywhere within a step."""
SEEN, WEAK = 9.0, 1e-3
"""Whitened energy from which a change is seen at all, and part of that at its own outputs below which one further on does not count."""
REACH = 0.05
"""Part of the whitened energy of an effect in an output from which a fault of the component may be looked for there."""
TEMPERATURE = 2.0
"""Variance of whitened noise: it is not exactly what it is taken for."""
SIGNIFICANT = 6.0
"""Deviations of noise from which something is left."""
RESAMPLES = 400
MORE = 1.5
"""Variance, in that of noise, from which the effects do not explain what is there."""
ROUNDS = 6
"""In which the size of what no effect explains is found."""
NULLS = 3
"""Repeats that the replay of right signals is made for."""


@dataclass(frozen=True)
class Segment:
    """A measured output, and the components between it and the cuts before it."""

    output: str
    """Array or scalar, `component.port`."""
    components: tuple[str, ...]
    """That of the output first."""


def segments(system: System, measured: Sequence[str]) -> list[Segment]:
    """One for each measured output; a component is in it that reaches the output without passing a measured one.

    Structure only: every input of a component is taken to act on every output.
    """
    before: dict[str, list[str]] = {}
    for c in system.connections:
        if _array(c.source) not in measured:
            before.setdefault(c.target.partition(".")[0], []).append(c.source.partition(".")[0])
    found = []
    for output in measured:
        members = [output.partition(".")[0]]
        for m in members:
            members += [b for b in dict.fromkeys(before.get(m, ())) if b not in members]
        found.append(Segment(output, tuple(members)))
    return found


def sets_alike(found: Sequence[Segment], components: Sequence[str]) -> list[tuple[str, ...]]:
    """Components that are in the same segments, which no replay can tell apart; each component is in one set."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for c in components:
        groups.setdefault(tuple(s.output for s in found if c in s.components), []).append(c)
    return [tuple(g) for seen, g in groups.items() if seen]


def _array(port: str) -> str:
    component, _, name = port.partition(".")
    return f"{component}.{base_name(name)}"


def intervals(on: npt.NDArray[np.bool_], grid: FloatArray, decimation: int) -> list[list[float]]:
    """[[from, to], ...] in s where `on` is true; gaps below 0.2 s are bridged."""
    step = float(grid[1] - grid[0]) * decimation
    found: list[list[float]] = []
    for i in np.flatnonzero(on):
        t = float(grid[0]) + i * step
        if found and t - found[-1][1] < 0.2 + step:
            found[-1][1] = t + step
        else:
            found.append([t, t + step])
    return [[round(float(a), 3), round(float(b), 3)] for a, b in found][:40]


def over_pairs(products: FloatArray, weights: FloatArray) -> FloatArray:
    """Mean over pairs of different repeats of their products [repeats, repeats], for each row of weights; of a single repeat its square."""
    if len(products) == 1:
        return np.full(len(weights), products[0, 0])
    off = products - np.diag(np.diag(products))
    total = np.einsum("ri,ij,rj->r", weights, off, weights)
    count = weights.sum(axis=1) ** 2 - (weights**2).sum(axis=1)
    out: FloatArray = np.where(count > 0.0, total / np.maximum(count, 1.0), np.nan)
    return out


class Bench:
    """Replays of one condition. `measured`: its repeats at the grid, all channels of the laboratory, [n, channels] each."""

    def __init__(self, laboratory: Laboratory, index: int, measured: Sequence[FloatArray]) -> None:
        self.laboratory, self.index = laboratory, index
        self.grid = laboratory.conditions[index].grid
        self.measured = measured
        self.channels = list(laboratory.channels)
        self.system = laboratory.configured(index)
        arrays = dict.fromkeys(_array(c) for c in self.channels)
        self.cut = {a: [i for i, c in enumerate(self.channels) if _array(c) == a] for a in arrays}
        seeds = range(1, len(measured) + 1)
        mean = np.mean(measured, axis=0)
        self.closed = [self._run(self._changed((), s)) for s in seeds[:NULLS]]
        self._ports = self.closed[0].ports
        right = [self._matrix(r) for r in self.closed]
        self._nominal = right[0]
        self.scatter = np.var(np.stack(right), axis=0, ddof=1).mean(axis=0)
        """Variance of a simulation by its own noise, per channel."""
        self.known = self._known(mean)
        bias = np.mean(
            [z - self._matrix(self._open(z + x - mean, s)) for z, x, s in zip(right, measured, seeds, strict=False)],
            axis=0,
        )
        self.residuals = [x - self._matrix(self._open(x, s)) - bias for x, s in zip(measured, seeds, strict=True)]
        """Measured less replayed, per repeat, [n, channels]."""
        self.coarse = self._coarse(bias)
        self.base = self._open(mean, 1)
        self.mean = mean
        self._inputs = {c: self._sources(c) for c in (k.name for k in self.system.components)}
        self._alone: dict[str, dict[str, FloatArray]] = {}

    # Simulations

    def _changed(self, changes: Setting, seed: int = 1) -> System:
        system, nominal = self.system, self.laboratory.nominal
        for (component, parameter), value in (*changes, *((a, float(seed)) for a in self.laboratory.seeds)):
            system = with_values(system, component, {parameter: value + nominal.get((component, parameter), 0.0)})
        return system

    def _known(self, mean: FloatArray) -> npt.NDArray[np.bool_]:
        """Channels of components that nothing goes into, and that are measured as they are simulated: noise of them is none."""
        driven = {c.target.partition(".")[0] for c in self.system.connections}
        small = np.sqrt(np.mean((mean - self._nominal) ** 2, axis=0)) <= KNOWN * np.sqrt(np.mean(self._nominal**2, axis=0))
        return np.asarray([c.partition(".")[0] not in driven for c in self.channels] & small)

    def _run(self, system: System, tapes: Sequence[Tape] = ()) -> Run:
        slaves = {t.name: t for t in tapes}
        others = self.laboratory.resolver

        def resolve(source: str, name: str) -> Slave:
            if source.startswith(TAPE):
                return slaves[name]
            if others is None:
                raise LookupError(f"source {source!r}")
            return others(source, name)

        return run(system, None, stop=float(self.grid[-1]), resolver=resolve, convert=self.laboratory.convert)

    def _coarse(self, bias: FloatArray) -> FloatArray | None:
        """What would be left of signals that are right, but of a smaller communication step, [n, channels]."""
        refinement = self.laboratory.refinement
        if refinement is None:
            return None
        fine = self._matrix(self._run(refined(self._changed(()), refinement.divide, refinement.sampled)))
        return np.asarray(fine - self._matrix(self._open(fine, 1)) - bias)

    def _matrix(self, result: Run) -> FloatArray:
        return np.stack([np.interp(self.grid, result.t, result.columns[c]) for c in self.channels], axis=1)

    def _open(self, signals: FloatArray, seed: int) -> Run:
        """Every connection from a measured output carries `signals` [n, channels] instead."""
        system = self._changed((), seed)
        signals = np.where(self.known, self._nominal, signals)
        used: dict[str, list[int]] = {}
        for c in system.connections:
            if _array(c.source) in self.cut:
                used.setdefault(c.source.partition(".")[0], []).extend(self.cut[_array(c.source)])
        tapes = [self._tape(f"measured_{name}", {self.channels[i]: signals[:, i] for i in sorted(set(at))}) for name, at in used.items()]
        connections = [replace(c, source=f"measured_{c.source}") if _array(c.source) in self.cut else c for c in system.connections]
        parts = (*(Component(t.name, TAPE) for t in tapes), *system.components)
        return self._run(replace(system, components=parts, connections=tuple(connections)), tapes)

    def _tape(self, name: str, series: Mapping[str, FloatArray], adds: bool = False) -> Tape:
        ports = [replace(self._ports[c], name=c.partition(".")[2]) for c in series]
        return Tape(name, ports, {p.name: v for p, v in zip(ports, series.values(), strict=True)}, self.grid, adds)

    def _sources(self, component: str) -> dict[str, FloatArray]:
        """Columns that go into a component, as they are in the replay of the mean measured run."""
        wanted = {_array(c.source) for c in self.system.connections if c.target.partition(".")[0] == component}
        found = {}
        for name in self.base.columns:
            if _array(name) in wanted and not name.startswith("measured_"):
                at = self.channels.index(name) if name in self.channels else -1
                measured = at >= 0 and not self.known[at]
                found[name] = self.mean[:, at] if measured else np.interp(self.grid, self.base.t, self.base.columns[name])
        return found

    def alone(self, component: str, changes: Setting = (), shifts: Mapping[str, FloatArray] | None = None) -> dict[str, FloatArray]:
        """Outputs of a component alone, driven as in the replay plus `shifts` (column -> change, [n]); column -> [n]."""
        system = self._changed(changes)
        by_source: dict[str, dict[str, FloatArray]] = {}
        for name, values in self._inputs[component].items():
            shift = shifts.get(name) if shifts else None
            by_source.setdefault(name.partition(".")[0], {})[name] = values if shift is None else values + shift
        tapes = [self._tape(source, series) for source, series in by_source.items() if source != component]
        connections = [c for c in system.connections if c.target.partition(".")[0] == component]
        parts = (*(Component(t.name, TAPE) for t in tapes), system.component(component))
        result = self._run(replace(system, components=parts, connections=tuple(connections), stop_when=None), tapes)
        prefix = component + "."
        return {k: np.interp(self.grid, result.t, v) for k, v in result.columns.items() if k.startswith(prefix)}

    def swapped(self, components: frozenset[str]) -> FloatArray:
        """The closed loop with what is left of the replay added to the outputs of these components; all channels, [n, channels]."""
        if not components:
            return self._nominal
        system = self._changed(())
        left = np.mean(self.residuals, axis=0)
        taken = {_array(c.source) for c in system.connections}
        inside = [i for i, c in enumerate(self.channels) if c.partition(".")[0] in components]
        used: dict[str, list[int]] = {}
        for i in inside:
            if _array(self.channels[i]) in taken:
                used.setdefault(self.channels[i].partition(".")[0], []).append(i)
        tapes = [self._tape(f"swapped_{name}", {self.channels[i]: left[:, i] for i in at}, adds=True) for name, at in used.items()]
        through = {_array(self.channels[i]) for at in used.values() for i in at}
        connections = [replace(c, source=f"swapped_{c.source}") if _array(c.source) in through else c for c in system.connections]
        for array in through:
            connections.append(Connection(array, f"swapped_{array}_in"))
        parts = (*system.components, *(Component(t.name, TAPE) for t in tapes))
        out = self._matrix(self._run(replace(system, components=parts, connections=tuple(connections)), tapes))
        out[:, inside] += left[:, inside]
        return out

    # What it knows

    def inputs(self, component: str) -> dict[str, FloatArray]:
        """Columns that go into a component, [n] each: measured where they are, else as replayed."""
        return self._inputs[component]

    def signals(self) -> dict[str, FloatArray]:
        """The mean measured run: column -> [n]."""
        return {c: self.mean[:, i] for i, c in enumerate(self.channels)}

    def unit(self, column: str) -> str:
        """Of a column."""
        return self._ports[column].unit or ""

    def units(self, columns: Iterable[str]) -> dict[str, str]:
        """Of columns."""
        return {c: self.unit(c) for c in columns}

    def times(self) -> FloatArray:
        """Of the samples [s]."""
        return self.grid

    def step(self) -> float:
        """Between samples [s]."""
        return float(self.grid[1] - self.grid[0])

    # Changes by parameters

    def hidden(self) -> list[tuple[str, str]]:
        """Connections that are not measured: (output array, component that takes it)."""
        pairs = [(_array(c.source), c.target.partition(".")[0]) for c in self.system.connections if _array(c.source) not in self.cut]
        return [(o, d) for o, d in dict.fromkeys(pairs) if o.partition(".")[0] != d]

    def change(self, component: str, changes: Setting) -> dict[str, FloatArray] | None:
        """Change of all outputs of a component by parameters; None where it cannot run."""
        if component not in self._alone:
            self._alone[component] = self.alone(component)
        before = self._alone[component]
        try:
            after = self.alone(component, changes)
        except OrchestrationError:
            return None
        return {k: after[k] - before[k] for k in after}

    def follow(self, moved: Mapping[str, FloatArray], arrays: Sequence[str], target: str) -> dict[str, FloatArray]:
        """Change of the outputs of `target` when these outputs of another component change as they do in `moved`."""
        if target not in self._alone:
            self._alone[target] = self.alone(target)
        shifts = {k: v for k, v in moved.items() if _array(k) in arrays}
        after = self.alone(target, (), shifts)
        return {k: after[k] - self._alone[target][k] for k in after}

    def observed(self, moved: Mapping[str, FloatArray]) -> FloatArray:
        """The measured channels among these changes, [n, channels]."""
        out = np.zeros((len(self.grid), len(self.channels)))
        for i, c in enumerate(self.channels):
            if c in moved:
                out[:, i] = moved[c]
        return decimate(out, self.laboratory.decimation)


@dataclass(frozen=True)
class Reading:
    """What the replay says about one segment."""

    output: str
    components: tuple[str, ...]
    """Which could be to blame: those in which a fault would show here."""
    residual: float
    """What is left of the mean run [unit of the output]: rms over time, root of the sum over the elements, noise taken off."""
    interval: tuple[float, float]
    """Of `residual`, 90 %, over the repeats."""
    whitened: float
    """Rms of what is left of the mean run, in units of its noise."""
    unexplained: float
    """The same when the tolerances of calibrated numbers have explained what they can."""
    significant: bool
    """Whether that is more than noise."""


class Replay:
    """Replays of all conditions, whitened, with the columns of parameters: who is to blame for what is left.

    `conditions`: indices of those that the system of the laboratory made. OrchestrationError where a replay fails,
    DataError where no parameter changes anything.
    """

    def __init__(self, laboratory: Laboratory, conditions: Sequence[int], catalogue: Catalogue, nuisances: Sequence[Nuisance]) -> None:
        channels, of = laboratory.channels, laboratory.conditions
        self.benches = [Bench(laboratory, i, [of[i].matrix(r, channels) for r in of[i].runs]) for i in conditions]
        self.candidates = catalogue.candidates
        self.scales = {n.address: n.scale for n in nuisances if n.address[0] != LOGGING}
        self.nuisances = set(self.scales)
        self.scales |= {a: c.prior.scale for c in catalogue.candidates for a in c.addresses if a[0] != LOGGING}
        names = {c.name for c in laboratory.system.components}
        self.scales = {a: s for a, s in self.scales.items() if a[0] in names}
        self.components = [c.name for c in laboratory.system.components if any(a[0] == c.name for a in self.scales)]
        direct = {a: m for a in self.scales if (m := self._moved(a)) is not None}
        seen = {a: [b.observed(x) for b, x in zip(self.benches, m, strict=True)] for a, m in direct.items()}
        if not any(np.any(x) for parts in seen.values() for x in parts):
            raise DataError("no parameter of the catalogue changes a measured output of its component: there is nothing to replay")
        # outputs that no parameter changes say nothing
        self.at = np.flatnonzero(np.any([np.any(x, axis=0) for parts in seen.values() for x in parts], axis=0))
        self.channels = [self.benches[0].channels[i] for i in self.at]
        self.arrays = list(dict.fromkeys(_array(c) for c in self.channels))
        self.of = np.array([self.arrays.index(_array(c)) for c in self.channels])
        """Array of each channel."""
        seen = {a: [x[:, self.at] for x in parts] for a, parts in seen.items()}
        self.groups = [[self._kept(r) for r in b.residuals] for b in self.benches]
        self._whiten(seen)
        self.strong = self._strong(direct, seen)
        for a, m in direct.items():
            if any(x == a[0] for x, _ in self.strong):
                for i, b in enumerate(self.benches):
                    for f in self._followed(b, m[i], a[0], ()):
                        seen[a][i] = seen[a][i] + b.observed(f)[:, self.at]
        self.columns = {a: self._white(x) for a, x in seen.items()}
        self._lay_out()

    def _kept(self, full: FloatArray) -> FloatArray:
        """Decimated, of all channels those that say something."""
        return decimate(full[:, self.at], self.benches[0].laboratory.decimation)

    def _moved(self, a: Address) -> list[dict[str, FloatArray]] | None:
        found = [b.change(a[0], ((a, self.scales[a]),)) for b in self.benches]
        complete = [f for f in found if f is not None]
        return complete if len(complete) == len(found) and any(np.any(v) for f in complete for v in f.values()) else None

    def _whiten(self, seen: Mapping[Address, list[FloatArray]]) -> None:
        rms = np.array([np.sqrt(np.mean(np.concatenate(x) ** 2, axis=0)) for a, x in seen.items() if a not in self.nuisances])
        means = [self._kept(b.mean) for b in self.benches]
        size = np.sqrt(np.mean(np.concatenate(means) ** 2, axis=0))
        typical = [TRUST * np.median(r[r > 1e-2 * r.max()]) if r.size and r.max() > 0.0 else 0.0 for r in rms.T]
        joint = whitening(self.groups, np.array(typical) + 1e-6 * size + 1e-12)
        # noise of a measured input is in two residuals, and whitening them together would bring the fault of one into the other
        within = joint.factor @ joint.factor.T * (self.of[:, None] == self.of)
        self.whitening = replace(joint, factor=np.linalg.cholesky(within))
        self._rates = [np.gradient(m, axis=0) / self.benches[0].laboratory.decimation for m in means]
        counts = [len(g) for g in self.groups]
        self._sudden = [np.hypot(1.0, SUDDEN * r * math.sqrt(n) / self.noise) for r, n in zip(self._rates, counts, strict=True)]

    def _white(self, parts: Sequence[FloatArray]) -> FloatArray:
        """Of means over the repeats."""
        return np.concatenate([self.whitening.apply(p / s, len(g)) for p, s, g in zip(parts, self._sudden, self.groups, strict=True)])

    def _strong(
        self, moved: Mapping[Address, list[dict[str, FloatArray]]], seen: Mapping[Address, list[FloatArray]]
    ) -> set[tuple[str, str]]:
        """Pairs of components with connections that are not measured, over which effects of the first show in outputs of the second."""
        found = set()
        bench = self.benches[0]
        for source, target in dict.fromkeys((o.partition(".")[0], d) for o, d in bench.hidden()):
            arrays = [o for o, d in bench.hidden() if d == target and o.partition(".")[0] == source]
            probes = set()
            for o in arrays:
                sizes = {a: sum(float(np.sum(v**2)) for k, v in m[0].items() if _array(k) == o) for a, m in moved.items() if a[0] == source}
                if sizes and max(sizes.values()) > 0.0:
                    probes.add(max(sizes, key=lambda a: sizes[a]))
            for a in probes:
                there = bench.observed(bench.follow(moved[a][0], arrays, target))[:, self.at]
                energy = self._energy(there)
                if energy > max(SEEN, WEAK * self._energy(seen[a][0])):
                    found.add((source, target))
        return found

    def _energy(self, change: FloatArray) -> float:
        white = self.whitening.apply(change / self._sudden[0], len(self.groups[0]))
        return float(white @ white)

    def _followed(self, bench: Bench, moved: Mapping[str, FloatArray], source: str, passed: tuple[str, ...]) -> list[dict[str, FloatArray]]:
        """Changes of outputs of other components, on all ways over connections that are not measured and strong."""
        found = []
        for target in [d for s, d in self.strong if s == source and d not in passed]:
            arrays = [o for o, d in bench.hidden() if d == target and o.partition(".")[0] == source]
            if any(np.any(v) for k, v in moved.items() if _array(k) in arrays):
                there = bench.follow(moved, arrays, target)
                found += [there, *self._followed(bench, there, target, (*passed, source))]
        return found

    def _lay_out(self) -> None:
        """Residual, columns and their inner products, output by output."""
        self.y = self._white([np.mean(g, axis=0) for g in self.groups])
        self.row = np.concatenate([np.tile(self.of, len(g[0])) for g in self.groups])
        """Array of each element of y."""
        coarse = [self._kept(b.coarse) for b in self.benches if b.coarse is not None]
        timing = []
        for k in range(len(self.arrays)):
            timing.append(self._white([LATENESS * r * (self.of == k) for r in self._rates]))
            if coarse:  # each output by itself: how much there is of it depends on the machine's own cycle
                timing.append(self._white([c * (self.of == k) for c in coarse]))
        self.doubt = np.stack([*(v for a, v in self.columns.items() if a in self.nuisances), *timing], axis=1)
        """Columns of what is not known about a machine without a fault: calibrated numbers, and what happens within a step."""
        self.effects = {
            c: np.stack([v for a, v in self.columns.items() if a[0] == c and a not in self.nuisances], axis=1)
            for c in self.components
            if any(a[0] == c and a not in self.nuisances for a in self.columns)
        }
        """Columns of the effects in each component, at the size of their priors."""
        self.reach = {c: self._reach(c) for c in self.effects}
        everything = np.concatenate([self.doubt, *self.effects.values()], axis=1)
        rows = [self.row == k for k in range(len(self.arrays))]
        self._grams = np.array([everything[r].T @ everything[r] for r in rows])
        self._on_y = np.array([everything[r].T @ self.y[r] for r in rows])
        self._energies = np.array([self.y[r] @ self.y[r] for r in rows])
        self._counts = np.array([r.sum() for r in rows])
        start, self._places = self.doubt.shape[1], dict[str, npt.NDArray[np.intp]]()
        for c, columns in self.effects.items():
            self._places[c] = np.arange(start, start + columns.shape[1])
            start += columns.shape[1]

    def _reach(self, component: str) -> set[int]:
        """Arrays in which a fault of the component would show: its own, and those where an effect of it shows as well as anywhere."""
        own = {i for i, a in enumerate(self.arrays) if a.partition(".")[0] == component}
        energy = np.array([np.bincount(self.row, c * c, len(self.arrays)) for c in self.effects[component].T])
        share = energy / (energy.sum(axis=1, keepdims=True) + 1e-300)
        return {int(i) for i in np.flatnonzero((share > REACH).any(axis=0))} | own

    # Answers

    def readings(self) -> list[Reading]:
        """One per measured output that anything goes into."""
        left = self.y - self.doubt @ np.linalg.solve(np.eye(self.doubt.shape[1]) + self.doubt.T @ self.doubt, self.doubt.T @ self.y)
        found = []
        for k, array in enumerate(self.arrays):
            members = tuple(c for c in self.effects if k in self.reach[c])
            if not members:
                continue
            here = self.row == k
            n = int(here.sum())
            limit = TEMPERATURE * (1.0 + SIGNIFICANT * math.sqrt(2.0 / n))
            energy, unexplained = float(np.mean(self.y[here] ** 2)), float(np.mean(left[here] ** 2))
            squares = self._squares(k)
            low, high = np.sqrt(np.maximum(np.nanquantile(squares[1:], (0.05, 0.95)), 0.0))
            size = math.sqrt(max(float(squares[0]), 0.0))
            found.append(
                Reading(array, members, size, (float(low), float(high)), math.sqrt(energy), math.sqrt(unexplained), unexplained > limit)
            )
        return found

    def part(self, component: str, blamed: Sequence[str], output_of: str) -> float:
        """Part of what is left of the outputs of `output_of` that this one of the blamed components explains; these parts add up to 1.

        An output in reach of none of them counts for nobody but its own component.
        """
        rows = np.isin(self.row, [k for k, a in enumerate(self.arrays) if a.partition(".")[0] == output_of])
        able = [c for c in blamed if any(self.arrays[k].partition(".")[0] == output_of for k in self.reach[c])]
        if component not in able:
            return 0.0
        if len(able) == 1:
            return 1.0
        parts = [self.effects[c] for c in able]
        matrix = np.concatenate([self.doubt, *parts], axis=1)
        x = np.linalg.solve(np.eye(matrix.shape[1]) + matrix.T @ matrix, matrix.T @ self.y)
        sizes, start = {}, self.doubt.shape[1]
        for c, p in zip(able, parts, strict=True):
            sizes[c] = float(np.sum((p[rows] @ x[start : start + p.shape[1]]) ** 2))
            start += p.shape[1]
        return sizes[component] / (sum(sizes.values()) + 1e-300)

    @property
    def noise(self) -> FloatArray:
        """Standard deviation of one run, per channel [unit], floor included."""
        return np.asarray(np.sqrt((self.whitening.factor**2).sum(axis=1)))

    @property
    def weights(self) -> FloatArray:
        """Of all channels of the laboratory in the whole gap."""
        weights = np.zeros(len(self.benches[0].channels))
        weights[self.at] = 1.0 / self.noise
        return weights

    def unit(self, array: str) -> str:
        """Of an output."""
        return self.benches[0].unit(self.channels[int(np.flatnonzero(self.of == self.arrays.index(array))[0])])

    def table(self, white: FloatArray, condition: int) -> FloatArray:
        """The part of a whitened vector that belongs to a condition, [samples, channels]."""
        sizes = [len(g[0]) * len(self.channels) for g in self.groups]
        start = sum(sizes[:condition])
        return white[start : start + sizes[condition]].reshape(-1, len(self.channels))

    def filtered(self, series: FloatArray, channels: npt.NDArray[np.intp]) -> FloatArray:
        """What the whitening makes of a series at the grid in each of these channels, but for its size: [samples, channels]."""
        x = decimate(series[:, None], self.benches[0].laboratory.decimation)
        out = np.repeat(x, len(channels), axis=1)
        a = self.whitening.coefficients[channels]
        for k in range(a.shape[1]):
            out[k + 1 :] -= a[:, k] * x[: -k - 1]
        return out

    def worst(self, white: FloatArray, outputs: Sequence[str]) -> tuple[tuple[int, int], list[list[float]]]:
        """Condition and channel with most of a whitened residual in these outputs (all if none), and the times when it is there [s]."""
        wanted = np.isin(self.of, [self.arrays.index(o) for o in outputs]) | (not outputs)
        energy = [self.table(white, i) ** 2 * wanted for i in range(len(self.groups))]
        condition = int(np.argmax([e.sum() for e in energy]))
        bench, over = self.benches[condition], energy[condition].sum(axis=1)
        times = intervals(over > 0.1 * over.max(), bench.grid, bench.laboratory.decimation)
        return (condition, int(energy[condition].sum(axis=0).argmax())), times

    def _squares(self, k: int) -> FloatArray:
        """Mean square residual of an output: of the repeats as they are, then of resampled ones."""
        rng = np.random.default_rng(0)
        total, samples = np.zeros(1 + RESAMPLES), 0
        for g in self.groups:
            flat = np.stack([r[:, self.of == k].ravel() for r in g])
            weights = np.concatenate([np.ones((1, len(g))), rng.multinomial(len(g), np.full(len(g), 1.0 / len(g)), RESAMPLES)])
            total += over_pairs(flat @ flat.T, weights)
            samples += len(g[0])
        return total / samples

    def evidence(self, blamed: Sequence[str]) -> float:
        """Log evidence of faults in these components: any effects of theirs, at the size of their priors, and anything else in reach."""
        return self._explained(blamed)[0]

    def unexplained(self, blamed: Sequence[str], component: str) -> bool:
        """Whether more than the effects of the blamed components is needed in reach of this one."""
        variance = self._explained(blamed)[1]
        return bool(max(variance[k] for k in self.reach[component]) > MORE * TEMPERATURE)

    def _explained(self, blamed: Sequence[str]) -> tuple[float, FloatArray]:
        """Log evidence, and the variance of what is left in each output, where anything is allowed."""
        at = np.concatenate([np.arange(self.doubt.shape[1]), *(self._places[c] for c in blamed)])
        grams, on_y = self._grams[:, at[:, None], at], self._on_y[:, at]
        free = sorted(set().union(*(self.reach[c] for c in blamed)))
        variance, best = np.full(len(self.arrays), TEMPERATURE), -math.inf
        for _ in range(ROUNDS):
            inner = np.eye(len(at)) + np.tensordot(1.0 / variance, grams, 1)
            x = np.linalg.solve(inner, (on_y / variance[:, None]).sum(axis=0))
            energy = self._energies - 2.0 * on_y @ x + np.einsum("i,kij,j->k", x, grams, x)
            size = (energy / variance).sum() + x @ x + np.linalg.slogdet(inner)[1] + (self._counts * np.log(variance)).sum()
            wider = sum(math.log(self._counts[k]) for k in free if variance[k] > TEMPERATURE)
            best = max(best, -0.5 * float(size + wider))
            for k in free:
                variance[k] = max(TEMPERATURE, energy[k] / self._counts[k])
        return best, variance
