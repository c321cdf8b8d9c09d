"""How far the gap shrinks: closure and ceiling of each figure, on diagnosed runs, held-out repeats and held-out conditions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from robomill.diagnosis.candidates import Address
from robomill.diagnosis.experiment.segments import by_array
from robomill.diagnosis.experiment.simulation import setting
from robomill.diagnosis.inference.ceiling import predicted_gap
from robomill.diagnosis.inference.search import Search
from robomill.diagnosis.localisation.where import WHOLE
from robomill.diagnosis.outcome import closure
from robomill.orchestration.slaves.protocol import FloatArray

CLOSING = 4
"""Simulations with different noise that the closure is measured with."""
DIAGNOSED, REPEAT, CONDITION = "diagnosed runs", "held-out repeat", "held-out condition"
"""Kinds of runs that it is measured on, the hardest test last."""
HARDEST_FIRST = (CONDITION, REPEAT, DIAGNOSED)
"""As they are listed, the hardest test first."""

Groups = Sequence[Sequence[FloatArray]]
"""Repeats of each condition, [samples, channels]."""


def metrics(search: Search, titles: Mapping[str, str]) -> dict[str, list[int]]:
    """Arrays of channels that count as one figure, array -> indices of its active channels: those with a title, or all."""
    every = by_array(search.simulator.laboratory.channels)
    groups = {g: active for g, members in every.items() if (active := [i for i in members if search.evidence.active[i]])}
    wanted = [g for g in groups if g in titles] or list(groups)
    return {g: groups[g] for g in wanted}


@dataclass(frozen=True)
class _Figure:
    """What counts as one figure."""

    channel: str
    metric: str
    unit: str
    members: npt.NDArray[np.intp]
    """Indices of its channels."""
    weight: FloatArray
    """Factor of each channel of the laboratory, [channels]."""


class Closing:
    """Runs of every condition beside the nominal simulation, of which the closure of a model is asked.

    `groups`: measured repeats of every condition, the diagnosed ones first; `titles`: array -> what the difference there is called.
    """

    def __init__(self, search: Search, groups: Groups, titles: Mapping[str, str]) -> None:
        self.search, self.groups = search, groups
        laboratory, whitening = search.simulator.laboratory, search.evidence.whitening
        conditions, n = laboratory.conditions, len(search.groups)
        self._before = search.simulator.repeated(range(len(conditions)), (), CLOSING, "closure")
        self._seen = {c.name: i for i, c in enumerate(conditions[:n])}
        self.kinds: dict[str, list[int]] = {DIAGNOSED: list(range(n))}
        """Kind of runs -> indices of its conditions."""
        for i in range(n, len(conditions)):
            self.kinds.setdefault(REPEAT if conditions[i].name in self._seen else CONDITION, []).append(i)
        active = np.flatnonzero(search.evidence.active)
        self._spread, scale = np.zeros(len(laboratory.channels)), np.zeros(len(laboratory.channels))
        self._spread[active] = whitening.deviation
        scale[active] = 1.0 / np.sqrt(np.diag(whitening.factor @ whitening.factor.T))
        self._figures = [_Figure(WHOLE, WHOLE, "1", active, scale)]
        for name, members in metrics(search, titles).items():
            unit = laboratory.ports[laboratory.channels[members[0]]].unit or ""
            self._figures.append(_Figure(name, titles.get(name, name), unit, np.array(members, dtype=np.intp), np.ones(len(scale))))
        self._predicted = _predicted(self._before, groups, n, search.evidence.active)

    @property
    def hardest(self) -> str:
        """The hardest kind of test that there is."""
        return next(kind for kind in HARDEST_FIRST if kind in self.kinds)

    def of(self, adopted: Mapping[Address, float], kinds: Sequence[str]) -> tuple[closure.HowFar, ...]:
        """Closure and ceiling of each figure on runs of these kinds: the closed loop simulated with the `adopted` values [unit]."""
        wanted = [i for kind in kinds for i in self.kinds[kind]]
        simulated = self.search.simulator.repeated(wanted, setting(adopted), CLOSING, "closure")
        return self.with_these(dict(zip(wanted, simulated, strict=True)), kinds)

    def with_these(self, after: Mapping[int, Sequence[FloatArray] | None], kinds: Sequence[str]) -> tuple[closure.HowFar, ...]:
        """Closure and ceiling of each figure, from repeats of the conditions of these kinds that were simulated with something mended."""
        return tuple(h for kind in kinds for f in self._figures if (h := self._closure(kind, f, after)) is not None)

    def _closure(self, kind: str, figure: _Figure, after: Mapping[int, Sequence[FloatArray] | None]) -> closure.HowFar | None:
        """One figure on one kind of runs; None where none of its conditions has its channels, or can run."""
        laboratory, weight, parts = self.search.simulator.laboratory, figure.weight, []
        for i in self.kinds[kind]:
            b, a = self._before[i], after[i]
            index = np.intersect1d(figure.members, laboratory.shown(i))
            if b is None or a is None or not len(index):
                continue
            repeats = self.groups[self._seen[laboratory.conditions[i].name]] if kind == REPEAT else ()
            parts.append(
                closure.products(
                    [(x * weight)[:, index] for x in self.groups[i]],
                    _halves(b, weight, index),
                    _halves(a, weight, index),
                    ((self._spread * weight) ** 2)[index],
                    [(x * weight)[:, index] for x in repeats],
                    (self._predicted[i] * weight)[:, index] if i in self._predicted else None,
                    guessed=self.search.evidence.whitening.guessed,
                )
            )
        return closure.figures(parts, f"{figure.metric} rms", figure.channel, figure.unit, kind) if parts else None


def _predicted(simulated: Sequence[Sequence[FloatArray] | None], groups: Groups, n: int, active: Any) -> dict[int, FloatArray]:
    """What a regression predicts of the gap in conditions that were measured once, [samples, channels]; the first `n` are known."""
    means = {i: np.mean(group, axis=0) for i, group in enumerate(simulated) if group is not None}
    gaps = {i: np.mean(groups[i], axis=0)[: len(mean)] - mean for i, mean in means.items()}
    known = {i: (means[i][:, active], gaps[i]) for i in range(n) if i in means}
    once = [i for i in means if len(groups[i]) == 1]
    return {i: predicted_gap(means[i][:, active], gaps[i], [pair for k, pair in known.items() if k != i]) for i in once}


def _halves(group: Sequence[FloatArray], weight: FloatArray, index: Any) -> closure.Halves:
    """Two independent means of simulations (the same one twice where there is only one)."""
    return (np.mean(group[::2], axis=0) * weight)[:, index], (np.mean(group[1::2] or group, axis=0) * weight)[:, index]
