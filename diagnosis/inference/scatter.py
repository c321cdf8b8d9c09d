"""What repeats scatter, or swing within samples, for a while in several arrays, and good machines do not.

The former is the mark of something that differs from run to run. In the mean over repeats it nearly vanishes, and their scatter would be
taken for noise. The latter is faster than the samples, which are means. But noise of a device is there all the time, and what a simulation
with other noise does is known. A correction that is lost now and then, or a cutter that every start of the spindle finds at another angle,
is seen where something changes, and in all arrays behind it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

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
    """A while in which repeats scatter, or swing within samples, more than those of a good machine."""

    channel: str
    """The channel that does so most."""
    condition: str
    """Its condition."""
    span: tuple[float, float]
    """From when to when [s]."""
    times: float
    """Standard deviation of the array that is second most over what it may, over that."""


def spell(search: Search) -> Spell | None:
    """The while in which two arrays scatter most over what they may, if that is SHOWS times it or more; None where there is none.

    Only of conditions that were measured three times or more, as time series, and simulated with different noise: what two runs differ by
    is one number, which chance makes large in some spell.
    """
    e = search.evidence
    over = {}
    for i, edges in _repeated(search):
        measured = _variance([x[:, e.active] for x in search.groups[i]], edges)
        over[i] = edges, excess(measured, _variance(e.nominals[i], edges), e.discrepancy)
    return _shown(search, over)


def swing(search: Search, fit: Fit) -> Spell | None:
    """The while in which two arrays swing most within samples over what a model does there, if that is SHOWS times it or more; else None.

    A sample is the mean over several communication steps. What is faster, such as the turn of a spindle, is not in it, and no effect
    explains it. Only of time series.
    """
    e, laboratory = search.evidence, search.simulator.laboratory
    if e.decimation == 1:
        return None
    every = replace(laboratory, decimation=1)
    here = [i for i in range(len(search.groups)) if not e.independent[i] and laboratory.factor(i) >= 2 * every.factor(i)]
    with search.simulator.beside(every) as simulator:
        simulated = simulator.repeated(here, setting(fit.values), POLISH, "all samples")
    over = {}
    for i, runs in zip(here, simulated, strict=True):
        if runs is None:
            continue
        factor = laboratory.factor(i) // every.factor(i)
        edges = _edges(len(search.groups[i][0]), e.decimation)
        measured, known = (_within([x[:, e.active] for x in group], factor, edges) for group in (every.measured_in(i), runs))
        over[i] = edges, excess(measured, known, e.discrepancy)
    return _shown(search, over)


def _shown(search: Search, over: Mapping[int, tuple[npt.NDArray[np.int_], FloatArray]]) -> Spell | None:
    """The while in which the array that is second most over what it may is so most, if that is SHOWS times it or more.

    `over`: index of a condition -> first samples of its spells, and variance over what it may be there, [spells, active channels]. What one
    device does alone is its noise.
    """
    e, laboratory = search.evidence, search.simulator.laboratory
    names = [c for c, on in zip(laboratory.channels, e.active, strict=True) if on]
    found: Spell | None = None
    for i, (edges, excesses) in over.items():
        judged = excesses * (e.judged & e.there[i])
        arrays = np.stack([judged[:, e.arrays == a].max(axis=1) for a in np.unique(e.arrays)], axis=1)
        if arrays.shape[1] <= 1:
            continue
        second = np.sort(arrays, axis=1)[:, -2]
        k = int(second.argmax())
        times = float(np.sqrt(second[k]))
        if times >= SHOWS and (found is None or times > found.times):
            begin, end = (float(laboratory.conditions[i].grid[0] + e.decimation * laboratory.system.step * j) for j in edges[k : k + 2])
            found = Spell(names[int(judged[k].argmax())], list(e.space.blocks)[i], (begin, end), times)
    return found


def _repeated(search: Search) -> Iterator[tuple[int, npt.NDArray[np.int_]]]:
    """Conditions that were measured and simulated three times or more, as time series, and the first samples of their spells."""
    e = search.evidence
    for i, runs in enumerate(search.groups):
        if not e.independent[i] and min(len(runs), len(e.nominals[i])) - 1 > 1:
            yield i, _edges(len(runs[0]), e.decimation)


def _edges(samples: int, decimation: int) -> npt.NDArray[np.int_]:
    """First samples of the spells of a condition, and the end of the last one."""
    rows = max(1, round(SPELL / decimation))
    return np.linspace(0, samples, max(1, samples // rows) + 1).astype(int)


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
            odds.append(0.5 * (e.space.chi2 - e.space.square(left)))
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
    return Fit((c,), {c.addresses[0]: value}, {c.addresses[0]: deviation}, evidence, e.space.square(left), signature, slope)


def with_chance(search: Search, fits: Sequence[Fit]) -> list[Fit]:
    """The fits, with those of single effects that a seed draws in place of what their mean alone says."""
    drawn = [c for c in search.candidates if c.effect in search.catalogue.drawn]
    found = {c.name: fit for c in drawn if (fit := by_chance(search, c)) is not None and fit.large_enough()}
    return [f for f in fits if len(f.model) != 1 or f.model[0].name not in found] + list(found.values())


def excess(measured: FloatArray, known: FloatArray, discrepancy: FloatArray) -> FloatArray:
    """Variance over what it may be, by spell and channel: [spells, channels].

    It may be that of the usual spell (median), which noise has all the time, with that of simulations in this spell (`known`) and the
    square of the `discrepancy` [channels] of two formulations.
    """
    return np.asarray(measured / (np.median(measured, axis=0) + known + discrepancy**2 + 1e-300))


def _variance(runs: Sequence[FloatArray], edges: npt.NDArray[np.int_]) -> FloatArray:
    """Variance of repeats in each spell, [spells, channels]."""
    variance = np.stack(runs).var(axis=0, ddof=1)
    return np.stack([variance[a:b].mean(axis=0) for a, b in itertools.pairwise(edges)])


def _within(runs: Sequence[FloatArray], factor: int, edges: npt.NDArray[np.int_]) -> FloatArray:
    """Variance within blocks of `factor` rows in each spell of blocks, mean over the runs: [spells, channels].

    It is about the straight line through the mean of a block with the slope of the blocks around it: what moves steadily does not swing.
    """
    found = []
    for x in runs:
        blocks = x[: len(x) // factor * factor].reshape(-1, factor, x.shape[1])
        means = blocks.mean(axis=1)
        line = np.gradient(means, axis=0)[:, None] / factor * (np.arange(factor) - 0.5 * (factor - 1))[:, None]
        found.append(((blocks - means[:, None] - line) ** 2).sum(axis=1) / (factor - 1))
    variance = np.mean(found, axis=0)
    return np.stack([variance[a:b].mean(axis=0) for a, b in itertools.pairwise(edges)])
