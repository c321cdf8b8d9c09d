"""Laws of no name that do better in the place of a named effect: then the effect is a stand-in, however little its model leaves.

Where the right effect is not in the catalogue, the others take its place, and together they may close as much. But each of them has a law,
and a law that is not the machine's is beaten. So each effect of the best model is taken out of it in turn, and every term of the library
of forms is put in its place, at each measured output in which the effect does something. The others stay, and all are fitted anew. What
counts is how well blocks of time are predicted that were left out (`selection`).

Machines simulated with the best model are the yardstick: where the law of an effect is that of the machine, hardly any of many terms
predicts better, and by little. The noise of these machines is like what the model leaves: white, and with a part that remembers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from robomill.diagnosis.catalogue import LOGGING, Candidate
from robomill.diagnosis.experiment.component_replay import ComponentReplay
from robomill.diagnosis.experiment.simulation import Laboratory, decimate, setting
from robomill.diagnosis.forms.ports import Problem, alike, direct, replayed
from robomill.diagnosis.forms.selection import Labels, Products, Rows
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.intervals import MATERIAL, Noise
from robomill.diagnosis.inference.machines import MACHINES
from robomill.diagnosis.outcome.ceiling import FOLDS
from robomill.orchestration.errors import OrchestrationError
from robomill.orchestration.slaves.protocol import FloatArray

LITTLE = 0.02
"""Share [1] of a gap that is little. A model that leaves no more explains a large gap; a law that does better by no more says nothing
against an effect (DIAGNOSIS2, lesson 7: 2 % of the gap, over all or in one channel)."""


@dataclass(frozen=True)
class Instead:
    """A law that does better than an effect of the best model in its place."""

    effect: str
    """Name of the effect and its place."""
    port: str
    """Measured output at which the law is added."""
    law: str
    """The term, as a formula has it."""
    gain: float
    """Squares of left-out blocks that are predicted better with it, over those of the gap of the port."""
    p: float
    """Share of machines simulated with the best model in which a law does as much better, times the tries, at most 1."""


@dataclass(frozen=True)
class Laws:
    """What was found, and which effects it puts into doubt."""

    found: tuple[Instead, ...] = ()
    doubtful: Mapping[str, float] | None = None
    """Name of an effect -> the `p` of the law that puts it into doubt."""
    kinds: Mapping[str, float] | None = None
    """Kind of effect -> the same `p`: friction in six joints is one idea, and wrong in one joint it is in doubt in all."""

    def belief(self, c: Candidate) -> float:
        """Factor on the probability of an effect."""
        return min((self.doubtful or {}).get(c.name, 1.0), (self.kinds or {}).get(c.effect, 1.0))


@dataclass
class Port:
    """A measured output with the best model: `rows` of what is left there, and what each effect does [n], in the scale of the rows."""

    name: str
    problem: Problem
    rows: Rows
    does: dict[Candidate, FloatArray]

    @property
    def gap(self) -> float:
        """Squares without the effects."""
        return float(((self.rows.y + sum(self.does.values())) ** 2).sum())


def laws(laboratory: Laboratory, n: int, best: Fit, false_alarm: float) -> Laws:
    """The laws that do better than effects of the best model; `n`: how many conditions are diagnosed.

    None where no output of a component with an effect was measured, where the system cannot be replayed, and where a fault of the log is
    part of the model: it is in the measured signals that components are driven with.
    """
    own = [i for i in range(n) if alike(laboratory, i)]
    if not own or any(c.component == LOGGING for c in best.model):
        return Laws()
    try:
        looked_at = ports(laboratory.shown_in(own), own, best)
    except OrchestrationError:
        return Laws()
    tries = sum(len(p.does) for p in looked_at)
    apart = all(laboratory.conditions[i].independent for i in own)
    found = [x for p in looked_at for x in better(p, tries, apart) if x.p <= false_alarm]
    kinds: dict[str, float] = {}
    doubtful: dict[str, float] = {}
    for p in looked_at:
        for x in found:
            if x.port == p.name:
                doubtful.update({c.name: min(x.p, doubtful.get(c.name, 1.0)) for c in p.does})
                kinds.update({c.effect: min(x.p, kinds.get(c.effect, 1.0)) for c in p.does if c.name == x.effect})
    return Laws(tuple(sorted(found, key=lambda x: -x.gain)), doubtful, kinds)


def ports(laboratory: Laboratory, own: Sequence[int], best: Fit) -> list[Port]:
    """Measured outputs in which the best model leaves more than LITTLE of the gap, with the effects that close MATERIAL of it or more."""
    components = list(dict.fromkeys(c.component for c in best.model))
    if not any(channel.partition(".")[0] in components for channel in laboratory.channels):
        return []
    with_it = [_with(laboratory, i, best) for i in own]
    replays = [replayed(one, i) for one, i in zip(with_it, own, strict=True)]
    found = []
    for component in components:
        members = [c for c in best.model if c.component == component]
        moved = {c: [r.change(component, tuple((a, 0.0) for a in c.addresses)) for r in replays] for c in members}
        for problem in direct(with_it[0], replays, component):
            made = _port(problem, component, replays, moved)
            if float((made.rows.y**2).sum()) > LITTLE * made.gap:
                found.append(made)
    return found


def _with(laboratory: Laboratory, i: int, best: Fit) -> Laboratory:
    """The laboratory whose nominal system of condition `i` is the best model."""
    quiet: dict[str, Mapping[str, Any]] = dict(laboratory.quiet)
    for component, values in laboratory.values(i, setting(best.values)).items():
        quiet[component] = {**quiet.get(component, {}), **values}
    return replace(laboratory, quiet=quiet)


Moved = Mapping[Candidate, Sequence[Mapping[str, FloatArray] | None]]
"""What each effect changes in each replay when it is taken out: column -> [n]; None where the component cannot run without it."""


def _port(problem: Problem, component: str, replays: Sequence[ComponentReplay], moved: Moved) -> Port:
    element = problem.terms[0][0]
    column, rows = f"{component}.{element}", problem.rows()
    scale = float(problem.effect[0][element][0, 0])
    does = {}
    for c, changes in moved.items():
        parts = [-scale * decimate(change[column][:, None], problem.decimation)[:, 0] for change in changes if change is not None]
        if len(parts) == len(replays):
            does[c] = np.concatenate(parts)
    made = Port(column, problem, rows, does)
    gap = made.gap
    made.does = {c: x for c, x in does.items() if float((x**2).sum()) > MATERIAL * gap}
    return made


def better(port: Port, tries: int, apart: bool) -> list[Instead]:
    """For each effect in a port the law that does better by more than LITTLE of the gap, with its rank; `apart`: samples have no memory.

    A law that has more than half of its squares in one block is no rival: what it does there the other blocks cannot say.
    """
    rows, effects = port.rows, list(port.does)
    columns = np.stack([port.does[c] for c in effects], axis=1) if effects else np.zeros((len(rows.y), 0))
    wide, k = replace(rows, y=rows.y + columns.sum(axis=1), X=np.concatenate([columns, rows.X], axis=1)), len(effects)
    parts = rows.parts(FOLDS)
    products, gap = Products(wide, parts), port.gap
    squares = np.diagonal(products.gram, axis1=1, axis2=2)[:, k:]  # of each law in each block
    spread = k + np.flatnonzero(squares.max(axis=0) <= 0.5 * squares.sum(axis=0))
    if not len(spread):
        return []
    machines: tuple[FloatArray, FloatArray] | None = None
    found = []
    for j, c in enumerate(effects):
        others = [i for i in range(k) if i != j]
        left = products.left_beside(others)[:, 0]
        law = int(spread[left[spread].argmin()])
        gain = float(left[j] - left[law]) / gap
        if gain <= LITTLE:
            continue
        if machines is None:
            machines = _machines(wide, columns.sum(axis=1), parts, apart)
        simulated = products.left_beside(others, None, *machines)
        above = int(((simulated[j] - simulated[spread].min(axis=0)) / gap >= gain).sum())
        p = min(1.0, tries * (1 + above) / (1 + MACHINES))
        found.append(Instead(c.name, port.name, port.problem.terms[law - k][1].text, gain, p))
    return found


def _machines(rows: Rows, model: FloatArray, parts: Labels, apart: bool) -> tuple[FloatArray, FloatArray]:
    """Products of the terms with the gaps of MACHINES simulated machines, as `Products.left_beside` takes them.

    A gap is what the model does [n], and noise like what it leaves of these `rows`: white noise and a part that remembers, unless samples
    are `apart` from each other.
    """
    series = [np.flatnonzero(rows.series == s) for s in np.unique(rows.series)]
    noise = Noise.of([(rows.y - model)[at] for at in series], np.inf if apart else rows.step)
    random = np.random.default_rng(0)
    y = np.zeros((len(rows.y), MACHINES))
    for at in series:
        y[at] = model[at, None] + noise.drawn(random, len(at), MACHINES)
    folds = [parts == f for f in np.unique(parts)]
    return np.stack([rows.X[f].T @ y[f] for f in folds]), np.stack([(y[f] ** 2).sum(axis=0) for f in folds])
