"""Values and intervals of the effects of a model where noise is a guess: ordinary least squares with all of the catalogue beside them.

Effects are selected on whitened data, where reversals decide; there laws of friction are wrong. Their values come from plain squares, each
channel over what is left of it. An effect that is not named is not zero: it is free within its prior and its bounds, so that what is named
does not stand for it. What two formulations of one machine may leave is free, too, as far as tolerances say how large and how slow it is.
What is left is white noise plus an Ornstein-Uhlenbeck process of bounded memory, by channel; the covariance of the estimate is that of
least squares with such noise (White, Econometrica 48 (1980) 817), of the priors, and of what laws may miss (FORM).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import lsq_linear
from scipy.signal import lfilter

from robomill.diagnosis.candidates import Address
from robomill.diagnosis.experiment.simulation import setting
from robomill.diagnosis.inference.estimation import Fit, Model
from robomill.diagnosis.inference.evidence import FORM
from robomill.diagnosis.inference.fitting import POLISH, SHARPER
from robomill.diagnosis.inference.search import Search
from robomill.orchestration.slaves.protocol import FloatArray

MEMORY = 0.3
"""Memory [s] of the noise, at most: with a longer one the noise takes what is the law's (DIAGNOSIS2, lesson 1)."""
MATERIAL = 0.005
"""Part of the squares of the gap of a channel that an effect or a term must close (DIAGNOSIS2: an effect that closes less is listed, not
named)."""


@dataclass(frozen=True)
class Known:
    """What is known of an effect."""

    values: Mapping[Address, float]
    """Its numbers [unit]."""
    deviations: Mapping[Address, float]
    """Their standard deviations [unit]."""
    closes: float
    """Part of the squares of the gap that is closed by it, when all the others are there: in the channel where that is most [1]."""


@dataclass(frozen=True)
class Noise:
    """White noise plus an Ornstein-Uhlenbeck process in a channel."""

    white: float
    """Variance [unit^2]."""
    coloured: float
    """Variance of the process [unit^2]."""
    keeps: float
    """Its correlation from one sample to the next [1]."""

    @staticmethod
    def of(parts: Sequence[FloatArray], step: float) -> Noise:
        """That of what is left of a channel in several runs, [samples] each, every `step` [s]; infinite: samples have no memory.

        Least squares of the autocovariance up to MEMORY, among memories from a sample to that.
        """
        count = max(sum(len(x) for x in parts), 1)
        whole = sum(float(x @ x) for x in parts) / count
        lags = np.arange(1, min(math.ceil(MEMORY / step), min(map(len, parts), default=1) - 1) + 1)
        shown = np.array([sum(float(x[k:] @ x[:-k]) for x in parts) for k in lags]) / count
        best, found = math.inf, Noise(whole, 0.0, 0.0)
        for keeps in np.exp(-step / np.geomspace(step, MEMORY, 9)) if len(lags) and step < MEMORY else ():
            shape = keeps**lags
            coloured = float(np.clip(shape @ shown / (shape @ shape), 0.0, whole))
            if (off := float(((shown - coloured * shape) ** 2).sum())) < best:
                best, found = off, Noise(whole - coloured, coloured, float(keeps))
        return found

    @property
    def weight(self) -> float:
        """1 / standard deviation; 0 where there is nothing."""
        return (self.white + self.coloured) ** -0.5 if self.white + self.coloured > 0.0 else 0.0

    def times(self, columns: FloatArray) -> FloatArray:
        """Its covariance matrix times columns [samples, k]."""
        if not self.coloured:
            return self.white * columns
        forward = lfilter([1.0], [1.0, -self.keeps], columns, axis=0)
        backward = lfilter([1.0], [1.0, -self.keeps], columns[::-1], axis=0)[::-1]
        return np.asarray(self.white * columns + self.coloured * (forward + backward - columns))

    def drawn(self, random: np.random.Generator, rows: int, columns: int) -> FloatArray:
        """Independent sequences of it, [rows, columns]."""
        pushes = np.sqrt(self.coloured) * random.normal(size=(rows, columns))
        pushes[1:] *= np.sqrt(1.0 - self.keeps**2)
        return np.asarray(lfilter([1.0], [1.0, -self.keeps], pushes, axis=0) + np.sqrt(self.white) * random.normal(size=(rows, columns)))

    @property
    def worth(self) -> float:
        """Part of the samples that are left if each were independent of the others, for the variance of a mean."""
        long = self.white + self.coloured * (1.0 + self.keeps) / (1.0 - self.keeps)
        return (self.white + self.coloured) / long if long > 0.0 else 1.0


@dataclass(frozen=True)
class Problem:
    """What is left of each run, and what each number of any candidate or tolerance does to it, about values of all of them."""

    order: Sequence[Address]
    """The numbers."""
    scales: FloatArray
    """Their prior scales [unit], [numbers]."""
    low: FloatArray
    """Least values [unit], [numbers]."""
    high: FloatArray
    """Largest values [unit], [numbers]."""
    at: FloatArray
    """The values about which all this is [prior scales], [numbers]."""
    named: npt.NDArray[np.bool_]
    """Which numbers are of the model: they have no prior, [numbers]."""
    left: Sequence[FloatArray]
    """For each condition [samples, channels]."""
    slopes: Sequence[FloatArray]
    """For each condition [samples, channels, numbers], per scale."""
    step: float
    """Time between samples [s]; infinite where they have no memory."""
    parameters: int
    """How many of the numbers are parameters, the first ones; the others are waves that two formulations may differ by."""

    @staticmethod
    def of(search: Search, fit: Fit, values: Mapping[Address, float]) -> Problem | None:
        """About `values` [unit]; each condition is simulated once for each number. None where none can run; else those that cannot go."""
        e, simulator, n = search.evidence, search.simulator, len(search.groups)
        laboratory = simulator.laboratory
        known = {a: (c.prior.scale, *c.bounds) for c in fit.model for a in c.addresses}
        names = {c.name for c in fit.model}
        for c in search.candidates:  # of all variants of an effect the first one
            if c.name not in names and not any(c.excludes(m) for m in fit.model):
                names.add(c.name)
                known = dict.fromkeys(c.addresses, (c.prior.scale, *c.bounds)) | known
        known = {u.address: (u.scale, -math.inf, math.inf) for u in search.nuisances} | known
        at = {a: values.get(a, 0.0) for a in known}
        steps = {a: 0.05 * abs(at[a]) + 0.01 * s if a in fit.values else 0.3 * s for a, (s, _, _) in known.items()}
        steps = {a: s if at[a] + s <= known[a][2] else -s for a, s in steps.items()}
        settings = [setting(at), *(setting({**at, a: at[a] + s}) for a, s in steps.items())]
        results = simulator.many([(i, simulator.seeded(s)) for s in settings for i in range(n)], "intervals")
        ran = [results[k * n : (k + 1) * n] for k in range(len(settings))]
        moved = {a: some for a, some in zip(steps, ran[1:], strict=True) if all(r is not None for r in some)}
        waves = [((f"formulation {i + 1}", f"wave {k + 1}"), i, w) for i, ws in enumerate(e.waves) for k, w in enumerate(ws)]
        left, slopes, step = [], [], math.inf
        for i, (base, rest) in enumerate(zip(ran[0], _left(search, at), strict=True)):
            if base is None or rest is None:
                continue
            rows, on = slice(0 if e.independent[i] else e.whitening.begin, None), e.active
            if not e.independent[i]:
                step = min(step, laboratory.conditions[i].step * laboratory.factor(i))
            left.append(rest)
            changed = [(some[i], known[a][0] / steps[a]) for a, some in moved.items()]
            own = [(x - base)[rows, on] * e.there[i] * per for x, per in changed if x is not None]
            own += [(w * e.there[i])[rows] if k == i else np.zeros_like(rest) for _, k, w in waves]
            slopes.append(np.stack(own, axis=-1))
        known |= {a: (1.0, -math.inf, math.inf) for a, _, _ in waves}
        order = [*moved, *(a for a, _, _ in waves)]
        scales, low, high = (np.array([known[a][k] for a in order]) for k in range(3))
        here, named = np.array([at.get(a, 0.0) for a in order]) / scales, np.array([a in fit.values for a in order])
        return Problem(order, scales, low, high, here, named, left, slopes, step, len(moved)) if left else None

    def solved(self) -> Solution:
        """The values by least squares, as if slopes were the same everywhere.

        Channels are weighed by what the model leaves, and then by what least squares leave; so noise is found. Of noise that remembers
        the samples are worth fewer than they are (`Noise.worth`): else it would outweigh the priors where the data say little.
        """
        prior = np.where(self.named, 0.0, 1.0)
        gaps = [r + J @ self.at for r, J in zip(self.left, self.slopes, strict=True)]
        noise = self._noise(self.left)
        for counted in (False, False, True):
            weights = np.array([v.weight * (math.sqrt(v.worth) if counted else 1.0) for v in noise])
            gram = np.diag(prior) + sum(np.einsum("tci,tcj,c->ij", J, J, weights**2, optimize=True) for J in self.slopes)
            product = sum(np.einsum("tci,tc,c->i", J, y, weights**2, optimize=True) for J, y in zip(self.slopes, gaps, strict=True))
            x = _bounded(gram, np.asarray(product), self.low / self.scales, self.high / self.scales)
            rest = [y - J @ x for y, J in zip(gaps, self.slopes, strict=True)]
            noise = noise if counted else self._noise(rest)
        inverse = _inverse(gram)
        form = self._form(weights, x)
        middle = np.diag(prior) + sum(self._scatter(noise, weights, inverse)) + form @ form.T
        variances = np.maximum(np.diag(inverse @ middle @ inverse), 0.0)
        deviations = np.sqrt(np.where(np.diag(gram) > 0.0, variances, np.inf))  # what does nothing at these values may be anything
        return Solution(x, deviations, gaps, rest, noise)

    def _scatter(self, noise: Sequence[Noise], weights: FloatArray, inverse: FloatArray) -> list[FloatArray]:
        """Covariance of the products of the slopes and the noise of each channel, both weighed, [numbers, numbers].

        The noise was found in what all numbers leave; `inverse` [numbers, numbers], that of the gram matrix, says how many samples these
        have used up, of those that are there if each were independent.
        """
        found = []
        for c, v in enumerate(noise):
            parts = [J[:, c] * weights[c] for J in self.slopes]
            used = sum(float(np.einsum("ti,ij,tj->", J, inverse, J, optimize=True)) for J in parts)
            there = v.worth * sum(len(J) for J in parts)
            found.append(sum((J.T @ v.times(J) for J in parts), np.zeros_like(inverse)) * weights[c] ** 2 * there / max(there - used, 1.0))
        return found

    def _form(self, weights: FloatArray, x: FloatArray) -> FloatArray:
        """What effects of the sizes x [prior scales] may do otherwise than their laws say, FORM of it in each channel by itself.

        By its products with the slopes, both weighed: one column for each channel and parameter, [numbers, channels * parameters].
        """
        n = self.parameters
        grams = [w**2 * sum(J[:, c].T @ J[:, c, :n] for J in self.slopes) for c, w in enumerate(weights)]
        return np.concatenate([FORM * of * x[:n] for of in grams], axis=1)

    def seen(self, solution: Solution) -> tuple[FloatArray, FloatArray]:
        """What least squares see of all numbers: their precision P [numbers, numbers] and P times their values [numbers], without priors.

        Least squares look at the products g = J'Wy of slopes and gaps alone, with W the weights of the channels. Of values x they are
        N(G x, M), with G = J'WJ and M what noise does to them, and what an effect may do in each channel otherwise than its law says
        (FORM of it). Then P = G M^-1 G, and P x = G M^-1 g.
        """
        noise = solution.noise
        weights = np.array([v.weight for v in noise])
        G = sum(np.einsum("tci,tcj,c->ij", J, J, weights**2, optimize=True) for J in self.slopes)
        g = sum(np.einsum("tci,tc,c->i", J, y, weights**2, optimize=True) for J, y in zip(self.slopes, solution.gaps, strict=True))
        form = self._form(weights, solution.x)
        inverse = _inverse(G + np.diag(np.where(self.named, 0.0, 1.0)))
        M = sum(self._scatter(noise, weights, inverse)) + form @ form.T
        size = np.sqrt(np.diag(M))
        size[size == 0.0] = 1.0  # a number that does nothing
        across = np.linalg.solve(M / np.outer(size, size) + 1e-6 * np.eye(len(G)), np.column_stack([G, g]) / size[:, None])
        return G.T @ (across[:, :-1] / size[:, None]), G.T @ (across[:, -1] / size)

    def known(self, solution: Solution, model: Model) -> dict[str, Known]:
        """What is known of each effect of a model, by name."""
        place = {a: i for i, a in enumerate(self.order)}
        squares = sum((y**2).sum(axis=0) for y in solution.gaps) + 1e-300
        found = {}
        for candidate in model:
            here, x = [place[a] for a in candidate.addresses if a in place], solution.x
            without = sum(((r + J[:, :, here] @ x[here]) ** 2).sum(axis=0) for r, J in zip(solution.rest, self.slopes, strict=True))
            closes = float(np.max((without - sum((r**2).sum(axis=0) for r in solution.rest)) / squares))
            values, spread = ({self.order[i]: float(v[i] * self.scales[i]) for i in here} for v in (x, solution.deviations))
            found[candidate.name] = Known(values, spread, closes)
        return found

    def _noise(self, rest: Sequence[FloatArray]) -> list[Noise]:
        """That of each channel, from what is left of all conditions that have it."""
        return [Noise.of([x[:, c] for x in rest if x[:, c].any()], self.step) for c in range(rest[0].shape[1])]


@dataclass(frozen=True)
class Solution:
    """Values of all numbers of a problem."""

    x: FloatArray
    """[prior scales], [numbers]."""
    deviations: FloatArray
    """Their standard deviations [prior scales], [numbers]."""
    gaps: Sequence[FloatArray]
    """What is left of each condition without any of them [samples, channels]."""
    rest: Sequence[FloatArray]
    """What is left with all of them [samples, channels]."""
    noise: Sequence[Noise]
    """That of each channel."""


def _inverse(gram: FloatArray) -> FloatArray:
    """The inverse of a gram matrix [numbers, numbers]; a number that does nothing stays apart from the others."""
    size = np.diag(gram)
    return np.asarray(np.linalg.inv(gram + np.diag(np.where(size > 0.0, 1e-12 * size, 1.0))))


def _bounded(gram: FloatArray, product: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """The x within its bounds that minimises x'Gx - 2 p'x; a trace of the diagonal keeps at zero what nothing says anything of."""
    size = np.sqrt(np.diag(gram))
    size[size == 0.0] = 1.0
    factor = np.linalg.cholesky(gram / np.outer(size, size) + 1e-12 * np.eye(len(gram)))
    found = lsq_linear(factor.T, np.linalg.solve(factor, product / size), (low * size, high * size), method="bvls")
    return np.asarray(found.x / size)


def _left(search: Search, values: Mapping[Address, float]) -> list[FloatArray | None]:
    """Measured minus simulated with these values [unit], of each condition [samples, channels]; None where it cannot run."""
    e = search.evidence
    means = search.simulator.repeated(range(len(search.groups)), setting(values), POLISH, "intervals")
    found: list[FloatArray | None] = []
    for i, (mean, group) in enumerate(zip(means, search.groups, strict=True)):
        rows = slice(0 if e.independent[i] else e.whitening.begin, None)
        found.append(None if mean is None else (np.mean(group, axis=0) - np.mean(mean, axis=0))[rows, e.active] * e.there[i])
    return found


def by_least_squares(search: Search, fit: Fit) -> dict[str, Known]:
    """What is known of each effect of a model, by name, where noise is a guess; empty where it is known, or without an effect.

    Gauss-Newton: where the slopes of before move the values on from what a simulation at them leaves, slopes are taken anew.
    """
    problem = Problem.of(search, fit, fit.values) if fit.model and search.evidence.whitening.guessed else None
    if problem is None:
        return {}
    solution = problem.solved()
    for _ in range(SHARPER):
        n = problem.parameters
        there = solution.x * (np.arange(len(solution.x)) < n)  # waves are not simulated
        values = dict(zip(problem.order[:n], (float(v) for v in (there * problem.scales)[:n]), strict=True))
        left = [r for r in _left(search, values) if r is not None]
        if len(left) < len(problem.left):
            break
        on = replace(problem, at=there, left=left).solved().x - solution.x
        if np.all(np.abs(on) < 0.3 * solution.deviations, where=problem.named):  # as fits settle in the search
            break
        again = Problem.of(search, fit, values)
        if again is None or len(again.order) < len(problem.order):
            break
        problem, solution = again, again.solved()
    return problem.known(solution, fit.model)
