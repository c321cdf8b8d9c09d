"""What repeats scatter for a while in several arrays, and good machines do not: the mark of something that differs from run to run.

In the mean over repeats it nearly vanishes, and their scatter would be taken for noise. But noise of a device is there all the time, and
what a simulation with other noise scatters is known. A correction that is lost now and then, or a cutter that every start of the spindle
finds at another angle, is seen where something changes, and in all arrays behind it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from robomill.diagnosis.candidates import Candidate
from robomill.diagnosis.experiment.simulation import setting
from robomill.diagnosis.inference.estimation import Fit
from robomill.diagnosis.inference.fitting import POLISH
from robomill.diagnosis.inference.noise import SPELL
from robomill.diagnosis.inference.search import Search
from robomill.diagnosis.inference.visibility import SHOWS
from robomill.orchestration.slaves.protocol import FloatArray


@dataclass(frozen=True)
class Spell:
    """A while in which repeats scatter more than those of a good machine."""

    channel: str
    """The channel that scatters most."""
    condition: str
    """Its condition."""
    span: tuple[float, float]
    """From when to when [s]."""
    times: float
    """Scatter of the array that scatters second most over what it may, standard deviations."""


def spell(search: Search) -> Spell | None:
    """The while in which two arrays scatter most over what they may, if that is SHOWS times it or more; None where there is none.

    Only of conditions that were measured three times or more, as time series, and simulated with different noise: what two runs differ by
    is one number, which chance makes large in some spell. What is judged is the second array: what one device does alone is its noise.
    """
    e, laboratory = search.evidence, search.simulator.laboratory
    names = [c for c, on in zip(laboratory.channels, e.active, strict=True) if on]
    found: Spell | None = None
    for i, edges in _repeated(search):
        condition, runs = list(e.space.blocks)[i], search.groups[i]
        over = excess([x[:, e.active] for x in runs], e.nominals[i], e.discrepancy, edges) * (e.judged & e.there[i])
        arrays = np.stack([over[:, e.arrays == a].max(axis=1) for a in np.unique(e.arrays)], axis=1)
        if arrays.shape[1] <= 1:
            continue
        second = np.sort(arrays, axis=1)[:, -2]
        k = int(second.argmax())
        times = float(np.sqrt(second[k]))
        if times >= SHOWS and (found is None or times > found.times):
            begin, end = (float(laboratory.conditions[i].grid[0] + e.decimation * laboratory.system.step * j) for j in edges[k : k + 2])
            found = Spell(names[int(over[k].argmax())], condition, (begin, end), times)
    return found


def _repeated(search: Search) -> Iterator[tuple[int, npt.NDArray[np.int_]]]:
    """Conditions that were measured and simulated three times or more, as time series, and the first samples of their spells."""
    e = search.evidence
    for i, runs in enumerate(search.groups):
        if not e.independent[i] and min(len(runs), len(e.nominals[i])) - 1 > 1:
            rows = max(1, round(SPELL / e.decimation))
            yield i, np.linspace(0, len(runs[0]), max(1, len(runs[0]) // rows) + 1).astype(int)


@dataclass(frozen=True)
class Scattered:
    """Variances of repeats in one condition, by spell and channel [spells, channels]."""

    freedom: int
    """Repeats less one."""
    measured: FloatArray
    nominal: FloatArray
    """Those of simulations of the nominal system."""
    discrepancy: FloatArray
    """Square of what two formulations leave, [channels]."""

    def expected(self, simulated: FloatArray) -> FloatArray:
        """Variance that repeats have where simulated ones have `simulated`: that, noise that is there all the time, and discrepancy."""
        noise = np.median(np.maximum(self.measured - simulated, 0.0), axis=0)
        return np.asarray(noise + simulated + self.discrepancy + 1e-300)

    def log_odds(self, sizes: Sequence[FloatArray]) -> FloatArray:
        """Log odds of each simulated scatter [spells, channels] against the nominal one, [sizes].

        The variance of f + 1 repeats is V chi2(f) / f. All channels of a spell see one thing, so that each spell counts once: with the mean
        over the channels, weighted by the squared share of the effect in their variance, as the information on its size is.
        """
        plain = self.expected(self.nominal)
        models = [self.expected(v) for v in sizes]
        shares = [np.maximum(v - self.nominal, 0.0) / m for v, m in zip(sizes, models, strict=True)]
        weights = np.max(shares, axis=0) ** 2
        weights /= weights.sum(axis=1, keepdims=True) + 1e-300
        gains = [np.log(plain / m) + self.measured / plain - self.measured / m for m in models]
        return np.array([0.5 * self.freedom * float((weights * g).sum()) for g in gains])

    def level(self, simulated: FloatArray) -> float:
        """Variance over the expected one, mean over the spells: that of the worst channel."""
        return float(np.max((self.measured / self.expected(simulated)).mean(axis=0), initial=0.0))


def scattered(search: Search, simulated: Sequence[Sequence[FloatArray] | None]) -> list[tuple[Scattered, FloatArray]]:
    """What each repeated condition scatters, and what these simulations do there; empty where one of them could not run."""
    e, found = search.evidence, []
    for i, edges in _repeated(search):
        group, use = simulated[i], e.judged & e.there[i]
        if group is None:
            return []
        measured, nominal, model = (
            _variance([x[:, use] for x in runs], edges)
            for runs in ([x[:, e.active] for x in search.groups[i]], e.nominals[i], [x[:, e.active] for x in group])
        )
        found.append((Scattered(min(len(search.groups[i]), len(group)) - 1, measured, nominal, e.discrepancy[use] ** 2), model))
    return found


def levels(search: Search, fit: Fit) -> tuple[float, float]:
    """Scatter of repeats over that of the nominal system and of a model (`Scattered.level`), in the worst condition.

    Both are 0 if the model has no effect that a seed draws.
    """
    if not any(c.effect in search.catalogue.drawn for c in fit.model):
        return 0.0, 0.0
    known = scattered(search, search.simulator.repeated(range(len(search.groups)), setting(fit.values), POLISH, "scatter"))
    before, after = [s.level(s.nominal) for s, _ in known], [s.level(v) for s, v in known]
    return max(before, default=0.0), max(after, default=0.0)


def by_chance(search: Search, c: Candidate) -> Fit | None:
    """The fit of an effect that a seed draws, from what repeats scatter and from their mean; None where nothing was repeated.

    Its evidence is the integral over the prior, at every half of its deviation up to two of them.
    """
    e, n = search.evidence, len(search.groups)
    if len(c.parameters) > 1 or not any(True for _ in _repeated(search)):
        return None
    z = np.linspace(-2.0, 2.0, 9)
    x = c.prior.scale * (np.exp(c.prior.spread * z) if c.prior.kind == "log-normal" else z)
    z, x = z[(x > 0.0) & (x < c.maximum)], x[(x > 0.0) & (x < c.maximum)]
    ran = [search.simulator.repeated(range(n), setting({c.addresses[0]: float(v)}), POLISH, "scatter") for v in x]
    odds, kept = [], []
    known = [scattered(search, r) for r in ran]
    for k, group in enumerate(ran):
        if (there := e.mean_signature(group)) is not None and known[k]:
            left = e.space.y - there
            odds.append(0.5 * (e.space.chi2 - float(e.space.dot(left, left))))
            kept.append(k)
    if not kept:
        return None
    for parts in zip(*(known[k] for k in kept), strict=True):
        odds = list(odds + parts[0][0].log_odds([v for _, v in parts]))
    fine = np.linspace(z[kept[0]], z[kept[-1]], 401)
    log = np.interp(fine, z[kept], odds) - 0.5 * fine**2
    weights = np.exp(log - log.max())
    evidence = float(log.max() + np.log(weights.sum() * (fine[1] - fine[0]) / math.sqrt(2.0 * math.pi)))
    values, weights = np.interp(fine, z[kept], x[kept]), weights / weights.sum()
    value = float(weights @ values)
    deviation = math.sqrt(float(weights @ (values - value) ** 2))
    signature = e.mean_signature(search.simulator.repeated(range(n), setting({c.addresses[0]: value}), POLISH, "scatter"))
    if signature is None:
        return None
    left = e.space.y - signature
    slope = (signature * (c.prior.scale / value))[:, None]
    return Fit((c,), {c.addresses[0]: value}, {c.addresses[0]: deviation}, evidence, float(e.space.dot(left, left)), signature, slope)


def with_chance(search: Search, fits: Sequence[Fit]) -> list[Fit]:
    """The fits, with those of single effects that a seed draws in place of what their mean alone says."""
    drawn = [c for c in search.candidates if c.effect in search.catalogue.drawn]
    found = {c.name: fit for c in drawn if (fit := by_chance(search, c)) is not None and fit.large_enough()}
    return [f for f in fits if len(f.model) != 1 or f.model[0].name not in found] + list(found.values())


def excess(runs: Sequence[FloatArray], simulated: Sequence[FloatArray], discrepancy: FloatArray, edges: npt.NDArray[np.int_]) -> FloatArray:
    """Variance of repeats over what it may be, by spell and channel: [spells, channels].

    `runs`, `simulated`: [samples, channels] each; `edges`: first samples of the spells, and the end of the last one. It may be that of the
    usual spell (median), which noise has all the time, with that of the simulated repeats in this spell and the square of the `discrepancy`
    [channels] of two formulations.
    """
    measured, known = (_variance(x, edges) for x in (runs, simulated))
    return np.asarray(measured / (np.median(measured, axis=0) + known + discrepancy**2 + 1e-300))


def _variance(runs: Sequence[FloatArray], edges: npt.NDArray[np.int_]) -> FloatArray:
    """Variance of repeats in each spell, [spells, channels]."""
    variance = np.stack(runs).var(axis=0, ddof=1)
    return np.stack([variance[a:b].mean(axis=0) for a, b in itertools.pairwise(edges)])
