"""How far the gap shrinks: closure and ceiling of each figure, on diagnosed runs, held-out repeats and held-out conditions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robomill.diagnosis.catalogue import Address
from robomill.diagnosis.experiment.simulation import setting
from robomill.diagnosis.inference.search import Search
from robomill.diagnosis.outcome import closure
from robomill.diagnosis.outcome.ceiling import predicted_gap
from robomill.orchestration.slaves.protocol import FloatArray, base_name

CLOSING = 4
"""Simulations with different noise that the closure is measured with."""

Groups = Sequence[Sequence[FloatArray]]
"""Repeats of each condition, [samples, channels]."""
Simulated = Sequence[Sequence[FloatArray] | None]
"""Simulated repeats of each condition, [samples, channels]; None for one that cannot run."""


def metrics(search: Search, titles: Mapping[str, str]) -> dict[str, list[int]]:
    """Arrays of channels that count as one figure, array -> indices of its active channels: those with a title, or all."""
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(search.simulator.laboratory.channels):
        if search.evidence.active[i]:
            groups.setdefault(base_name(name), []).append(i)
    wanted = [g for g in groups if g in titles] or list(groups)
    return {g: groups[g] for g in wanted}


def how_far(search: Search, groups: Groups, adopted: Mapping[Address, float], titles: Mapping[str, str]) -> tuple[closure.HowFar, ...]:
    """Closure and ceiling of each figure: the closed loop simulated with the `adopted` values [unit].

    `groups`: measured repeats of every condition, the diagnosed ones first; `titles`: array -> what the difference there is called.
    """
    every = range(len(search.simulator.laboratory.conditions))
    before, after = (search.simulator.repeated(every, changes, CLOSING, "closure") for changes in ((), setting(adopted)))
    return shrunk(search, groups, before, after, titles)


def shrunk(search: Search, groups: Groups, before: Simulated, after: Simulated, titles: Mapping[str, str]) -> tuple[closure.HowFar, ...]:
    """Closure and ceiling of each figure, from repeats of every condition simulated `before` and `after` something was mended."""
    laboratory, whitening = search.simulator.laboratory, search.evidence.whitening
    conditions, n = laboratory.conditions, len(search.groups)
    seen = {c.name: i for i, c in enumerate(conditions[:n])}
    kinds: dict[str, list[int]] = {"diagnosed runs": list(range(n))}
    for i in range(n, len(conditions)):
        kinds.setdefault("held-out repeat" if conditions[i].name in seen else "held-out condition", []).append(i)
    active = np.flatnonzero(search.evidence.active)
    spread, scale = np.zeros(len(laboratory.channels)), np.zeros(len(laboratory.channels))
    spread[active] = whitening.deviation
    scale[active] = 1.0 / np.sqrt(np.diag(whitening.factor @ whitening.factor.T))
    figures = [("all channels, whitened", "1", active, scale)]
    for name, members in metrics(search, titles).items():
        figures.append((name, laboratory.ports[laboratory.channels[members[0]]].unit or "", np.array(members), np.ones(len(scale))))
    predicted = _predicted(before, groups, n, search.evidence.active)
    listed = []
    for kind, members in kinds.items():
        for name, unit, chosen, weight in figures:
            parts = []
            for i in members:
                b, a = before[i], after[i]
                index = np.intersect1d(chosen, laboratory.shown(i))
                if b is None or a is None or not len(index):
                    continue
                repeats = groups[seen[conditions[i].name]] if kind == "held-out repeat" else ()
                parts.append(
                    closure.products(
                        [(x * weight)[:, index] for x in groups[i]],
                        _halves(b, weight, index),
                        _halves(a, weight, index),
                        ((spread * weight) ** 2)[index],
                        [(x * weight)[:, index] for x in repeats],
                        (predicted[i] * weight)[:, index] if i in predicted else None,
                    )
                )
            if parts:
                listed.append(closure.figures(parts, f"{titles.get(name, name)} rms", name, unit, kind))
    return tuple(listed)


def _predicted(simulated: Simulated, groups: Groups, n: int, active: Any) -> dict[int, FloatArray]:
    """What a regression predicts of the gap in conditions that were measured once, [samples, channels]; the first `n` are known."""
    means = {i: np.mean(group, axis=0) for i, group in enumerate(simulated) if group is not None}
    gaps = {i: np.mean(groups[i], axis=0)[: len(mean)] - mean for i, mean in means.items()}
    known = {i: (means[i][:, active], gaps[i]) for i in range(n) if i in means}
    once = [i for i in means if len(groups[i]) == 1]
    return {i: predicted_gap(means[i][:, active], gaps[i], [pair for k, pair in known.items() if k != i]) for i in once}


def _halves(group: Sequence[FloatArray], weight: FloatArray, index: Any) -> closure.Halves:
    """Two independent means of simulations (the same one twice where there is only one)."""
    return (np.mean(group[::2], axis=0) * weight)[:, index], (np.mean(group[1::2] or group, axis=0) * weight)[:, index]
