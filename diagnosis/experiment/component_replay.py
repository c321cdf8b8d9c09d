"""Components driven with measured inputs: simulations of one condition.

Residual of output i in repeat k: r_ik = x_ik - f_i(x_k) - bias_i, with x the measured signals, f the component that the output belongs to,
and bias the mean of the same difference for signals that are right by construction.

The system is cut open wherever an output is measured: what is behind the cut gets the measured signal. Nothing that happens upstream of
a cut, and no feedback through it, shows.

Measured inputs scatter, and a component that is not linear makes an offset of that. So the same is done with signals that are
right by construction (simulated ones with the scatter of the repeats), and what comes out of that is taken off.

Changes by parameters are simulated for the component alone, and followed through connections that are not measured.

Where the loop is cut open, nothing holds an integrator: an axis that is driven with a measured current adds up every small error, and is
metres off in the end. So a small push is added to all that is measured, once from the start and once from the middle of the run on. What
both do in the last quarter is compared: the same, where a push is forgotten; as 7 to 3, where it is added up. Outputs that add up are
not replayed.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import cast

import numpy as np
import numpy.typing as npt

from robomill.diagnosis.experiment.segments import by_array, playing
from robomill.diagnosis.experiment.simulation import DRAWS, Laboratory, Setting, decimate, refined
from robomill.orchestration.errors import OrchestrationError
from robomill.orchestration.rig import Rig
from robomill.orchestration.runs.run import Run
from robomill.orchestration.slaves.playback import Playback
from robomill.orchestration.slaves.protocol import FloatArray, Slave, base_name
from robomill.orchestration.system.definition import TICK, Component, Connection, System

PLAYBACK = "playback:"
"""Source of the components that play back measured signals."""
KNOWN = 1e-3
"""Relative deviation that counts as none: up to it the signal of a component without inputs (a program) is taken as it is simulated, and
so large is the push that shows what adds up: the answer is that of the motion that was measured. A rate of change that is such a part of
its largest is none."""
ADDS_UP = 0.5
"""Order of growth from which an output adds up what goes in: half way between one that settles (0) and an integrator (1)."""


def order_of_growth(since_start: FloatArray, since_middle: FloatArray) -> float:
    """The order p of a response that grows as t^p after a push: by what pushes since the start and since the middle do in the last quarter.

    There the pushes are 7/8 and 3/8 of the run old on average, so p = log(|since_start| / |since_middle|) / log(7 / 3), with the norms of
    both responses [n, channels] over the last quarter of their rows. 0 where the push does nothing.
    """
    last = 3 * len(since_start) // 4
    old, new = (float(np.linalg.norm(d[last:])) for d in (since_start, since_middle))
    if old == 0.0:
        return 0.0
    return math.log(old / new) / math.log(7.0 / 3.0) if new > 0.0 else math.inf


class ComponentReplay:
    """Replays of one condition: every component simulated with the measured signals as its inputs.

    Arrays of n samples are at the `grid` of the condition [s]; channels are those of the laboratory, in their units.
    """

    def __init__(self, laboratory: Laboratory, index: int, measured: Sequence[FloatArray]) -> None:
        """`index`: which condition of the laboratory; `measured`: its repeats, float64[n, channels] each."""
        self.laboratory, self.index = laboratory, index
        self.grid, self.step = laboratory.conditions[index].grid, laboratory.conditions[index].step
        self.measured = measured
        self.channels = list(laboratory.channels)
        self.system = laboratory.configured(index)
        self.cut = by_array(self.channels)
        seeds = range(1, len(measured) + 1)
        mean = np.mean(measured, axis=0)
        self.closed = [self._run(self._changed((), s)) for s in range(1, DRAWS + 1 if laboratory.seeds else 2)]
        self._ports = self.closed[0].ports
        right = [self._matrix(r) for r in self.closed]
        self.nominal = right[0]
        """The closed loop as it is; all channels, [n, channels]."""
        self.scatter = np.var(np.stack(right), axis=0, ddof=min(1, len(right) - 1)).mean(axis=0)
        """Variance of a simulation by its own noise, per channel; 0 where it has none."""
        self.known = self._known(mean)
        bias = np.mean(
            [
                z - self._matrix(self._open(z + x - mean, s))
                for z, x, s in zip(itertools.cycle(right), measured[:DRAWS], seeds, strict=False)
            ],
            axis=0,
        )
        self.residuals = [x - self._matrix(self._open(x, s)) - bias for x, s in zip(measured, seeds, strict=True)]
        """Measured less replayed, less the bias of right signals, per repeat, [n, channels]."""
        self.coarse = self._coarse(bias)
        self.base = self._open(mean, 1)
        self.mean = mean
        self.adding = self._adding()
        """Measured arrays that are not replayed, because they add up what goes in: array -> order of growth."""
        self.inputs = {c: self._sources(c) for c in (k.name for k in self.system.components)}
        """Columns that go into each component, column -> [n]: measured where they are, else as replayed."""
        self._alone: dict[str, dict[str, FloatArray]] = {}
        self._rigs: dict[str, tuple[Rig, list[Playback]]] = {}

    @staticmethod
    def of(laboratory: Laboratory, index: int) -> ComponentReplay:
        """The replay of a condition with its measured runs; a laboratory makes it once."""
        condition = laboratory.conditions[index]
        known, replay = laboratory.replays.get(index, (None, None))
        if known is not condition:
            replay = ComponentReplay(laboratory, index, [condition.matrix(r, laboratory.channels) for r in condition.runs])
            laboratory.replays[index] = condition, replay
        return cast(ComponentReplay, replay)

    # Simulations

    def _values(self, changes: Setting, seed: int = 1) -> dict[str, dict[str, float]]:
        seeds = tuple((a, float(seed)) for a in self.laboratory.seeds)
        return self.laboratory.values(self.index, (*changes, *seeds))

    def _changed(self, changes: Setting, seed: int = 1) -> System:
        system = self.system
        for component, values in self._values(changes, seed).items():
            system = system.with_parameters(component, values)
        return system

    def _known(self, mean: FloatArray) -> npt.NDArray[np.bool_]:
        """Channels of components that nothing goes into, and that are measured as they are simulated: noise of them is none."""
        alone = playing(self.system)
        small = np.sqrt(np.mean((mean - self.nominal) ** 2, axis=0)) <= KNOWN * np.sqrt(np.mean(self.nominal**2, axis=0))
        return np.asarray([c.partition(".")[0] in alone for c in self.channels] & small)

    def _run(self, system: System, playbacks: Sequence[Playback] = ()) -> Run:
        return self._rig(system, playbacks).run({}, float(self.grid[-1]))

    def _rig(self, system: System, playbacks: Sequence[Playback] = ()) -> Rig:
        slaves = {t.name: t for t in playbacks}
        others = self.laboratory.resolver

        def resolve(source: str, name: str) -> Slave:
            if source.startswith(PLAYBACK):
                return slaves[name]
            if others is None:
                raise LookupError(f"source {source!r}")
            return others(source, name)

        return Rig(system, resolve, self.laboratory.convert)

    def _coarse(self, bias: FloatArray) -> FloatArray | None:
        """What would be left of signals that are right, but of a smaller communication step, [n, channels]."""
        refinement = self.laboratory.refinement
        if refinement is None:
            return None
        fine = self._matrix(self._run(refined(self._changed(()), refinement.divide, refinement.sampled)))
        return np.asarray(fine - self._matrix(self._open(fine, 1)) - bias)

    def _adding(self) -> dict[str, float]:
        """Order of growth of the arrays in which a push is not forgotten, from ADDS_UP on."""
        since_start = np.broadcast_to(KNOWN * np.std(self.mean, axis=0), self.mean.shape)
        since_middle = np.where(self.grid[:, None] >= 0.5 * self.grid[-1], since_start, 0.0)
        base = self._matrix(self.base)
        start, middle = (self._matrix(self._open(self.mean + push, 1)) - base for push in (since_start, since_middle))
        orders = {array: order_of_growth(start[:, at], middle[:, at]) for array, at in self.cut.items()}
        return {array: p for array, p in orders.items() if p >= ADDS_UP}

    def _matrix(self, result: Run) -> FloatArray:
        return np.stack([self._on_grid(result, c) for c in self.channels], axis=1)

    def _open(self, signals: FloatArray, seed: int) -> Run:
        """Every connection from a measured output carries `signals` [n, channels] instead."""
        system = self._changed((), seed)
        signals = np.where(self.known, self.nominal, signals)
        used: dict[str, list[int]] = {}
        for c in system.connections:
            if base_name(c.source) in self.cut:
                used.setdefault(c.source.partition(".")[0], []).extend(self.cut[base_name(c.source)])
        playbacks = [
            self._playback(f"measured_{name}", {self.channels[i]: signals[:, i] for i in sorted(set(at))}) for name, at in used.items()
        ]
        connections = [replace(c, source=f"measured_{c.source}") if base_name(c.source) in self.cut else c for c in system.connections]
        parts = (*(Component(t.name, PLAYBACK) for t in playbacks), *system.components)
        return self._run(replace(system, components=parts, connections=tuple(connections)), playbacks)

    def _playback(self, name: str, series: Mapping[str, FloatArray], adds: bool = False) -> Playback:
        ports = [replace(self._ports[c], name=c.partition(".")[2]) for c in series]
        return Playback.of_series(name, ports, {p.name: v for p, v in zip(ports, series.values(), strict=True)}, self.grid, adds)

    def _sources(self, component: str) -> dict[str, FloatArray]:
        """Columns that go into a component, as they are in the replay of the mean measured run."""
        wanted = {base_name(c.source) for c in self.system.connections if c.target.partition(".")[0] == component}
        found = {}
        for name in self.base.columns:
            if base_name(name) in wanted and not name.startswith("measured_"):
                at = self.channels.index(name) if name in self.channels else -1
                measured = at >= 0 and not self.known[at]
                found[name] = self.mean[:, at] if measured else self._on_grid(self.base, name)
        return found

    def _on_grid(self, result: Run, column: str) -> FloatArray:
        """A column at the times of the grid: reals on the line between samples, whole numbers and booleans as they last were.

        Times that are less than half a tick of the master's clock apart are one.
        """
        values = result.columns[column]
        if result.ports[column].type == "real":
            return np.interp(self.grid, result.t, values)
        last = np.searchsorted(result.t, self.grid + 0.5 / TICK, side="right") - 1
        return np.asarray(values[np.maximum(last, 0)], dtype=np.float64)

    def alone(self, component: str, changes: Setting = (), shifts: Mapping[str, FloatArray] | None = None) -> dict[str, FloatArray]:
        """Outputs of a component alone, driven as in the replay of the mean run: column -> [n].

        `changes`: parameters that are changed [unit of the parameter]; `shifts`: column of an input -> what is added to it, [n].
        """
        if component not in self._rigs:
            self._rigs[component] = self._driven(component)
        rig, playbacks = self._rigs[component]
        for playback in playbacks:
            playback.play(self._into(component, playback.name, shifts or {}))
        result = rig.run({c: v for c, v in self._values(changes).items() if c == component}, float(self.grid[-1]))
        prefix = component + "."
        return {k: self._on_grid(result, k) for k in result.columns if k.startswith(prefix)}

    def _driven(self, component: str) -> tuple[Rig, list[Playback]]:
        """A component alone, opened, behind playbacks of the inputs that it has in the replay of the mean run."""
        sources = dict.fromkeys(name.partition(".")[0] for name in self.inputs[component])
        playbacks = [
            self._playback(source, {k: v for k, v in self.inputs[component].items() if k.partition(".")[0] == source})
            for source in sources
            if source != component
        ]
        connections = [c for c in self.system.connections if c.target.partition(".")[0] == component]
        parts = (*(Component(t.name, PLAYBACK) for t in playbacks), self.system.component(component))
        system = replace(self.system, components=parts, connections=tuple(connections), stop_when=None)
        return self._rig(system, playbacks), playbacks

    def _into(self, component: str, source: str, shifts: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """What a component gets from a source, with `shifts` added: port -> [n]."""
        given = {k: v + shifts[k] if k in shifts else v for k, v in self.inputs[component].items()}
        return {k.partition(".")[2]: v for k, v in given.items() if k.partition(".")[0] == source}

    def swapped(self, components: frozenset[str]) -> FloatArray:
        """The closed loop with the mean residual of the replay added to the outputs of these components; all channels, [n, channels].

        Without components it is the nominal simulation.
        """
        if not components:
            return self.nominal
        system = self._changed(())
        left = np.mean(self.residuals, axis=0)
        left[:, [i for array in self.adding for i in self.cut[array]]] = 0.0
        taken = {base_name(c.source) for c in system.connections}
        inside = [i for i, c in enumerate(self.channels) if c.partition(".")[0] in components]
        used: dict[str, list[int]] = {}
        for i in inside:
            if base_name(self.channels[i]) in taken:
                used.setdefault(self.channels[i].partition(".")[0], []).append(i)
        playbacks = [self._playback(f"swapped_{name}", {self.channels[i]: left[:, i] for i in at}, adds=True) for name, at in used.items()]
        through = {base_name(self.channels[i]) for at in used.values() for i in at}
        connections = [replace(c, source=f"swapped_{c.source}") if base_name(c.source) in through else c for c in system.connections]
        for array in through:
            connections.append(Connection(array, f"swapped_{array}_in"))
        parts = (*system.components, *(Component(t.name, PLAYBACK) for t in playbacks))
        out = self._matrix(self._run(replace(system, components=parts, connections=tuple(connections)), playbacks))
        out[:, inside] += left[:, inside]
        return out

    def pushed(self, component: str, column: str, values: FloatArray) -> FloatArray:
        """The closed loop with `values` [n] added to what a component gets of a column of another; all channels, [n, channels]."""
        system = self._changed(())
        array, source = base_name(column), column.partition(".")[0]
        members = [k for k in self.closed[0].columns if base_name(k) == array]
        playback = self._playback(f"pushed_{source}", {k: values if k == column else np.zeros(len(self.grid)) for k in members}, adds=True)
        connections = [
            replace(c, source=f"pushed_{c.source}") if c.target.partition(".")[0] == component and base_name(c.source) == array else c
            for c in system.connections
        ]
        connections.append(Connection(array, f"pushed_{array}_in"))
        parts = (*system.components, Component(playback.name, PLAYBACK))
        return self._matrix(self._run(replace(system, components=parts, connections=tuple(connections)), [playback]))

    # What it knows

    def signals(self) -> dict[str, FloatArray]:
        """The mean measured run: column -> [n]."""
        return {c: self.mean[:, i] for i, c in enumerate(self.channels)}

    def unit(self, column: str) -> str:
        """Unit of a column; "" where it has none."""
        return self._ports[column].unit or ""

    # Changes by parameters

    def hidden(self) -> list[tuple[str, str]]:
        """Connections between two components that are not measured: (output array, component that takes it)."""
        pairs = [(base_name(c.source), c.target.partition(".")[0]) for c in self.system.connections if base_name(c.source) not in self.cut]
        return [(o, d) for o, d in dict.fromkeys(pairs) if o.partition(".")[0] != d]

    def change(self, component: str, changes: Setting) -> dict[str, FloatArray] | None:
        """Change of all outputs of a component alone by `changes` [unit of the parameter], column -> [n]; None where it cannot run."""
        if component not in self._alone:
            self._alone[component] = self.alone(component)
        before = self._alone[component]
        try:
            after = self.alone(component, changes)
        except OrchestrationError:
            return None
        return {k: after[k] - before[k] for k in after}

    def in_the_loop(self, column: str) -> FloatArray:
        """A column of the nominal closed loop, [n]."""
        return self._on_grid(self.closed[0], column)

    def as_replayed(self, column: str) -> FloatArray:
        """A column of the replay of the mean measured run, [n]."""
        return self._on_grid(self.base, column)

    def change_in_loop(self, changes: Setting) -> FloatArray | None:
        """Change of all channels in the closed loop by `changes` [unit of the parameter], [n, channels]; None where it cannot run."""
        try:
            return self._matrix(self._run(self._changed(changes))) - self.nominal
        except OrchestrationError:
            return None

    def follow(self, moved: Mapping[str, FloatArray], arrays: Sequence[str], target: str) -> dict[str, FloatArray]:
        """Change of the outputs of `target`, column -> [n], when the outputs `arrays` of another component change as they do in `moved`."""
        if target not in self._alone:
            self._alone[target] = self.alone(target)
        shifts = {k: v for k, v in moved.items() if base_name(k) in arrays}
        after = self.alone(target, (), shifts)
        return {k: after[k] - self._alone[target][k] for k in after}

    def slopes(self, array: str, target: str) -> dict[str, dict[str, FloatArray]]:
        """What one unit more of each element of an output, all the time, does to the outputs of `target`: element column -> column -> [n].

        It is tried by KNOWN of the way of the element, or of its size where it stands still. Whole numbers and booleans have none.
        """
        found = {}
        for column in [k for k in self.base.columns if base_name(k) == array and self._ports[k].type == "real"]:
            x = self.as_replayed(column)
            push = KNOWN * (float(np.ptp(x)) or max(float(np.abs(x).max()), KNOWN))
            moved = self.follow({column: np.full(len(self.grid), push)}, [array], target)
            found[column] = {k: v / push for k, v in moved.items()}
        return found

    def observed(self, moved: Mapping[str, FloatArray]) -> FloatArray:
        """The measured channels among these changes (0 for the others), block means over the decimation, [n // decimation, channels]."""
        out = np.zeros((len(self.grid), len(self.channels)))
        for i, c in enumerate(self.channels):
            if c in moved:
                out[:, i] = moved[c]
        return decimate(out, self.laboratory.decimation)
