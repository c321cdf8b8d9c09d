"""Laws of no name that do better in the place of a named effect: then the effect is a stand-in, however little its model leaves.

Where the right effect is not in the catalogue, the others take its place, and together they may close as much. But each of them has a law,
and a law that is not the machine's is beaten. So each effect of the best model is taken out of it in turn, and every term of the library
of forms is put in its place, at each measured output in which the effect does something. The others stay, and all are fitted anew. What
counts is how well blocks of time are predicted that were left out (`selection`). Effects of one kind that act in several outputs are also
exchanged for the same law in all of them.

Machines simulated with the best model are the yardstick: where the law of an effect is that of the machine, hardly any of many terms
predicts better, and by little. The noise of these machines is like what the model leaves: white, and with a part that remembers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from robomill.diagnosis.candidates import LOGGING, Address, Candidate
from robomill.diagnosis.experiment.component_replay import ComponentReplay
from robomill.diagnosis.experiment.simulation import Laboratory, decimate, setting
from robomill.diagnosis.forms.library import Term
from robomill.diagnosis.forms.ports import Problem, alike, direct
from robomill.diagnosis.forms.selection import Labels, Rows
from robomill.diagnosis.forms.signals import index_of
from robomill.diagnosis.inference.ceiling import FOLDS
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.intervals import MATERIAL, Noise
from robomill.diagnosis.inference.machines import MACHINES
from robomill.orchestration.errors import OrchestrationError
from robomill.orchestration.slaves.protocol import FloatArray

LITTLE = 0.02
"""Share [1] of a gap that is little. A model that leaves no more explains a large gap; a law that does better by no more says nothing
against an effect (DIAGNOSIS2, lesson 7: 2 % of the gap, over all or in one channel)."""


@dataclass(frozen=True)
class Instead:
    """A law that does better than an effect of the best model in its place."""

    effect: str
    """Name of the effect and its place; only its kind, where the same law does better in the place of all of them."""
    ports: tuple[str, ...]
    """Measured outputs at which the law is added."""
    law: str
    """The term, as a formula has it; of several ports the index is `i`."""
    gain: float
    """Squares of left-out blocks that are predicted better with it, over those of the gap of the port; of several ports, the mean."""
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

    @staticmethod
    def of(found: Sequence[Instead], ports: Sequence[Port]) -> Laws:
        """Doubt is cast on each effect in the ports of a law, and on each of the kind in whose place it is."""
        kinds: dict[str, float] = {}
        doubtful: dict[str, float] = {}
        for p in ports:
            for x in found:
                if p.name in x.ports:
                    doubtful.update({c.name: min(x.p, doubtful.get(c.name, 1.0)) for c in p.does})
                    beaten = (c.effect for c in p.does if x.effect in (c.name, c.effect))
                    kinds.update({kind: min(x.p, kinds.get(kind, 1.0)) for kind in beaten})
        return Laws(tuple(sorted(found, key=lambda x: -x.gain)), doubtful, kinds)

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

    @property
    def left(self) -> float:
        """Share of the gap that the best model leaves."""
        return float((self.rows.y**2).sum()) / self.gap


def laws(laboratory: Laboratory, n: int, best: Fit, calibrated: Mapping[Address, float], false_alarm: float) -> Laws:
    """The laws that do better than effects of the best model; `n`: how many conditions are diagnosed.

    `calibrated`: what the model has calibrated numbers off by [unit]: no law is about that.

    None where no output of a component with an effect was measured, where the system cannot be replayed, and where a fault of the log is
    part of the model: it is in the measured signals that components are driven with. Two questions are asked, each with the rate of
    false alarms `false_alarm`: is an effect beaten in an output, and is a kind of effects beaten in all of its outputs?
    """
    own = [i for i in range(n) if alike(laboratory, i)]
    if not own or any(c.component == LOGGING for c in best.model):
        return Laws()
    try:
        looked_at = ports(laboratory.shown_in(own), own, best, calibrated)
    except OrchestrationError:
        return Laws()
    apart = all(laboratory.conditions[i].independent for i in own)
    tried = [Exchanged(p, apart) for p in looked_at]
    kinds = shared(tried)
    open_ = [t for t in tried if t.port.left > LITTLE]
    tries = sum(len(t.effects) for t in open_)
    found = [x for t in open_ for x in better(t, tries)]
    found += [x for kind, places in kinds.items() for x in everywhere(kind, places, len(kinds))]
    return Laws.of([x for x in found if x.p <= false_alarm], looked_at)


def ports(laboratory: Laboratory, own: Sequence[int], best: Fit, calibrated: Mapping[Address, float]) -> list[Port]:
    """Measured outputs of the components of the best model, with the effects that close MATERIAL of the gap there or more."""
    components = list(dict.fromkeys(c.component for c in best.model))
    if not any(channel.partition(".")[0] in components for channel in laboratory.channels):
        return []
    with_it = [_with(laboratory, i, {**calibrated, **best.values}) for i in own]
    replays = [ComponentReplay.of(one, i) for one, i in zip(with_it, own, strict=True)]
    found = []
    for component in components:
        members = [c for c in best.model if c.component == component]
        moved = {c: [r.change(component, tuple((a, 0.0) for a in c.addresses)) for r in replays] for c in members}
        found += [_port(problem, component, replays, moved) for problem in direct(with_it[0], replays, component)]
    return found


def _with(laboratory: Laboratory, i: int, changes: Mapping[Address, float]) -> Laboratory:
    """The laboratory whose nominal system of condition `i` has these changes [unit]."""
    quiet: dict[str, Mapping[str, Any]] = dict(laboratory.quiet)
    for component, values in laboratory.values(i, setting(changes)).items():
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


@dataclass(frozen=True)
class Left:
    """Squares of left-out blocks over those of the gap of a port, on some machines."""

    effect: FloatArray
    """With the effect, [machines]."""
    laws: FloatArray
    """With each law in its place, [laws, machines]; infinite where a law is no other than what stays."""

    @property
    def gains(self) -> FloatArray:
        """What is predicted better with each law, [laws, machines]."""
        return self.effect - self.laws

    @property
    def ratios(self) -> FloatArray:
        """Log of what is left with the effect over what is left with each law, [laws, machines]."""
        return np.asarray(np.log(self.effect) - np.log(self.laws))


class Exchanged:
    """A port in which each effect is taken out, and each term is put in its place; all others stay, and are fitted anew.

    A law that has more than half of its squares in one block is no rival: what it does there the other blocks cannot say.
    """

    def __init__(self, port: Port, apart: bool) -> None:
        self.port, self.effects = port, list(port.does)
        rows, k = port.rows, len(self.effects)
        does = np.stack([port.does[c] for c in self.effects], axis=1) if k else np.zeros((len(rows.y), 0))
        self._model, self._apart = does.sum(axis=1), apart
        self._rows = replace(rows, y=rows.y + self._model, X=np.concatenate([does, rows.X], axis=1))
        self._parts = rows.spans(FOLDS)
        self._products = self._rows.products(self._parts)
        squares = np.diagonal(self._products.gram, axis1=1, axis2=2)[:, k:]  # of each law in each block
        self.laws = np.flatnonzero(squares.max(axis=0) <= 0.5 * squares.sum(axis=0))
        """Terms of the problem that are rivals, [laws]."""

    def left(self, j: int) -> Left:
        """What is left in the place of effect `j`."""
        return self._left(j)

    def simulated(self, j: int) -> Left:
        """What is left there on machines simulated with the best model."""
        return self._left(j, *self._machines)

    def _left(self, j: int, *instead: FloatArray) -> Left:
        k = len(self.effects)
        left = self._products.left_beside([i for i in range(k) if i != j], None, *instead)
        return Left(left[j] / self.port.gap, left[k + self.laws] / self.port.gap)

    @cached_property
    def _machines(self) -> tuple[FloatArray, FloatArray]:
        return _machines(self._rows, self._model, self._parts, self._apart)

    def law(self, i: int) -> Term:
        """The term of the i-th law."""
        return self.port.problem.terms[int(self.laws[i])][1]

    def patterns(self) -> dict[str, int]:
        """Laws by what is the same in all joints (`Term.pattern`) -> place in `laws`."""
        index = index_of(self.port.name)
        return {self.law(i).pattern(index): i for i in range(len(self.laws))}


def better(tried: Exchanged, tries: int) -> list[Instead]:
    """For each effect in a port the law that does better by more than LITTLE of the gap, with its rank."""
    found = []
    for j, c in enumerate(tried.effects):
        gains = tried.left(j).gains[:, 0]
        if not len(gains) or (gain := float(gains.max())) <= LITTLE:
            continue
        above = int((tried.simulated(j).gains.max(axis=0) >= gain).sum())
        p = min(1.0, tries * (1 + above) / (1 + MACHINES))
        found.append(Instead(c.name, (tried.port.name,), tried.law(int(gains.argmax())).text, gain, p))
    return found


Places = Sequence[tuple[Exchanged, int]]
"""Ports in which effects of a kind act, and which of their effects is of the kind."""


def shared(tried: Sequence[Exchanged]) -> dict[str, Places]:
    """Kinds of effects that act in several ports and close more than LITTLE of the gap there in the mean: what does less is no matter."""
    places: dict[str, list[tuple[Exchanged, int]]] = {}
    for t in tried:
        for j, c in enumerate(t.effects):
            places.setdefault(c.effect, []).append((t, j))
    strong = {k: np.mean([float((t.port.does[t.effects[j]] ** 2).sum()) / t.port.gap for t, j in at]) > LITTLE for k, at in places.items()}
    return {kind: at for kind, at in places.items() if strong[kind] and len({t.port.name for t, _ in at}) > 1}


def everywhere(kind: str, places: Places, tries: int) -> list[Instead]:
    """The law that does better than a kind of effects in the place of all of them, by more than LITTLE of the gap in the mean, if any.

    Friction in six joints is one idea. In each of them a rival may do better by so little that chance does as much; but chance does not
    let the same law do better in all. Ranked is the mean of the `Left.ratios`: a joint with little noise says as much as one with much.
    """
    known = [t.patterns() for t, _ in places]
    same = [law for law in known[0] if all(law in other for other in known)]
    if not same:
        return []
    at = [[own[law] for law in same] for own in known]

    def compared(left: Sequence[Left]) -> tuple[FloatArray, FloatArray]:
        """Means over the ports of gains and of ratios; the latter where the former are not little, [laws, machines]."""
        gains: FloatArray = np.mean([x.gains[laws] for x, laws in zip(left, at, strict=True)], axis=0)
        ratios = np.mean([x.ratios[laws] for x, laws in zip(left, at, strict=True)], axis=0)
        return gains, np.where(gains > LITTLE, ratios, -np.inf)

    gains, ratios = (x[:, 0] for x in compared([t.left(j) for t, j in places]))
    best = int(ratios.argmax())
    if np.isneginf(ratios[best]):
        return []
    above = int((compared([t.simulated(j) for t, j in places])[1].max(axis=0) >= ratios[best]).sum())
    ports = tuple(dict.fromkeys(t.port.name for t, _ in places))
    return [Instead(kind, ports, same[best], float(gains[best]), min(1.0, tries * (1 + above) / (1 + MACHINES)))]


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
