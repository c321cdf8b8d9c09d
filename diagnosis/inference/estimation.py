"""Which effects explain the gap: fits, evidence, probabilities.

Everything happens on whitened residuals y (measured mean minus nominal simulation). A model is a set of candidates; its
signature s(x), x = value / prior scale, is the change of the whitened simulation. Numbers that are only known to a standard
deviation (nuisances) are marginalised: with their whitened columns B in units of that deviation the inner product is
u'v - u'B (I + B'B)^-1 B'v.

1. One simulation per parameter at its prior scale gives a column; inner products of all columns then fit and rank every
   candidate alone as if its signature were proportional.
2. The best are fitted again by Gauss-Newton on real simulations (the column is updated by Broyden's rule).
3. Models grow by one candidate at a time from the best ones (beam). Evidence is Laplace's approximation, for a single
   parameter an integral over its prior.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import logsumexp

from robomill.diagnosis.catalogue import Address, Candidate
from robomill.orchestration.slaves.protocol import FloatArray

Model = tuple[Candidate, ...]
"""Candidates that are switched on together; () is the nominal model."""

PRIOR_OF_SIZE = {0: 0.3, 1: 0.4, 2: 0.2, 3: 0.1}
"""Probability of so many effects before the data, shared among all sets of that size."""


ALIKE = 0.97
"""Correlation from which a nuisance is taken as the same thing as a parameter that is fitted."""

UNDETERMINED = 1.0
"""Standard deviation, over the value, from which data do not say how large an effect is."""


@dataclass
class Fit:
    """A model with its best parameters."""

    model: Model
    values: dict[Address, float]
    """Best values [unit of the parameter]."""
    deviations: dict[Address, float]
    """Their standard deviations [unit]."""
    log_evidence: float
    """Relative to the nominal model."""
    energy: float
    """Whitened energy that remains, nuisances fitted."""
    exact: bool = False
    """Whether it comes from simulations at the best values, not from the screening's columns."""
    signature: FloatArray | None = None
    columns: FloatArray | None = None
    """d signature / dx at the best values, [n, parameters]."""
    log_prior: float = 0.0
    predictive: dict[str, float] = field(default_factory=dict)
    """condition -> gain in log score there, when fitted to all the others."""

    @property
    def name(self) -> str:
        """What is on."""
        return " + ".join(c.name for c in self.model) or "nominal"

    def large_enough(self) -> bool:
        """Whether each effect has a number that counts as a finding."""
        return all(c.large_enough(self.values) for c in self.model)


@dataclass(frozen=True)
class Gram:
    """Products of columns with each other, [k, k], and with the nuisances, [m, k]."""

    plain: FloatArray
    projected: FloatArray


class Space:
    """Whitened residual, columns of the candidates, and the inner product with the nuisances marginalised."""

    def __init__(
        self,
        y: FloatArray,
        blocks: Mapping[str, slice],
        nuisances: FloatArray,
        names: Sequence[Address] = (),
        products: FloatArray | None = None,
        gone: Collection[Address] = (),
    ) -> None:
        """`y` [n]; `blocks` condition -> its part of y; `nuisances` [n, m] whitened, per standard deviation, called `names`.

        `products`: nuisances' nuisances, if known; `gone`: names that do not count.
        """
        self.y, self.blocks, self.nuisances, self.names, self.gone = y, blocks, nuisances, tuple(names), frozenset(gone)
        self._products: FloatArray = nuisances.T @ nuisances if products is None else products
        m = nuisances.shape[1]
        here = np.ix_(*2 * [[i for i in range(m) if i >= len(self.names) or self.names[i] not in self.gone]])
        precision = (np.eye(m) + self._products)[here]
        self._inner = np.zeros((m, m))
        self._inner[here] = np.linalg.inv(precision)
        self.energy = float(self.dot(y, y))
        self.log_determinant = float(np.linalg.slogdet(precision)[1])
        self._without: dict[frozenset[Address], Space] = {}
        self.alike: dict[Address, dict[Address, float]] = {}
        """parameter -> nuisances that do the same as it, and their standard deviation in its unit."""

    def without(self, addresses: Sequence[Address]) -> Space:
        """The same where these nuisances are not: they are effects of the model that is looked at."""
        gone = frozenset(n for a in addresses for n in self.alike.get(a, ()))
        if not gone:
            return self
        if gone not in self._without:
            self._without[gone] = Space(self.y, self.blocks, self.nuisances, self.names, self._products, gone)
        return self._without[gone]

    def less(self, names: Collection[Address]) -> Space:
        """The same for good without these nuisances."""
        kept = [i for i, name in enumerate(self.names) if name not in names]
        if len(kept) == len(self.names):
            return self
        return Space(self.y, self.blocks, self.nuisances[:, kept], [self.names[i] for i in kept])

    def moved(self, left: FloatArray) -> FloatArray:
        """Deviations by which the nuisances are moved to explain the residual `left`, [m]."""
        return np.asarray(self._inner @ (self.nuisances.T @ left))

    def divided(self, blocks: Mapping[str, slice]) -> Space:
        """The same with other blocks."""
        space = Space(self.y, blocks, self.nuisances, self.names, self._products, self.gone)
        space.alike = self.alike
        return space

    def find_alike(self, columns: Mapping[Address, FloatArray], scales: Mapping[Address, float]) -> None:
        """Note which nuisances have (nearly) the same column as a parameter; `columns` are per prior scale [unit of the parameter]."""
        sizes = np.sqrt(np.diag(self._products))
        places = {name: i for i, name in enumerate(self.names)}
        projected = self.nuisances.T @ np.stack(list(columns.values()), axis=1) if columns else np.zeros((len(sizes), 0))
        for (a, c), products in zip(columns.items(), projected.T, strict=True):
            energy = float(c @ c) + 1e-300
            same = np.abs(products) > ALIKE * sizes * float(np.linalg.norm(c))
            if a in places:
                same[places[a]] = True
            self.alike[a] = {self.names[i]: float(abs(products[i]) / energy * scales[a]) for i in np.flatnonzero(same)}

    def explained(self, left: FloatArray) -> FloatArray:
        """What the nuisances make of the residual `left`."""
        return np.asarray(self.nuisances @ self.moved(left))

    def dot(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Inner product of vectors or of the columns of matrices."""
        left = self.nuisances.T @ a
        right = left if b is a else self.nuisances.T @ b
        return np.asarray(a.T @ b - left.T @ (self._inner @ right))

    def gram(self, matrix: FloatArray) -> Gram:
        """Inner products of the columns of a matrix, for this space and those that are it `without` some nuisances."""
        return Gram(matrix.T @ matrix, self.nuisances.T @ matrix)

    def within(self, gram: Gram, chosen: Sequence[int]) -> FloatArray:
        """The inner products of some of these columns, here."""
        part = gram.projected[:, chosen]
        return np.asarray(gram.plain[np.ix_(chosen, chosen)] - part.T @ (self._inner @ part))

    def energies(self, vectors: FloatArray) -> FloatArray:
        """Inner product of each column of [n, k] with itself, [k]."""
        left = self.nuisances.T @ vectors
        return np.asarray((vectors * vectors).sum(axis=0) - (left * (self._inner @ left)).sum(axis=0))

    def only(self, blocks: Sequence[str]) -> Space:
        """The same restricted to some conditions."""
        rows = np.concatenate([np.arange(self.y.size)[self.blocks[b]] for b in blocks])
        return Space(self.y[rows], {}, self.nuisances[rows], self.names, None, self.gone)

    def rows(self, blocks: Sequence[str]) -> FloatArray:
        """Indices of the rows of some conditions."""
        return np.concatenate([np.arange(self.y.size)[self.blocks[b]] for b in blocks])


def quadratic_fit(model: Model, y: FloatArray, base: FloatArray, columns: FloatArray, start: FloatArray, space: Space) -> Fit:
    """The best x for the signature base + columns (x - start), with bounds and priors; float64[k] in prior scales."""
    own = space.without([a for c in model for a in c.addresses])
    together = np.column_stack([columns, y - base + columns @ start])
    return solved(model, own.dot(together, together), space, own)


def solved(model: Model, products: FloatArray, space: Space, own: Space) -> Fit:
    """The same from the inner products of the columns and, last, of the residual at x = 0; `own`: `space` without what the model has."""
    hessian, gradient, constant = products[:-1, :-1], products[:-1, -1], float(products[-1, -1])
    fit = solve(model, hessian, gradient, constant, space.energy, *scaled_bounds(model))
    fit.log_evidence += 0.5 * (space.log_determinant - own.log_determinant)
    return fit


def scaled_bounds(model: Model) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Scales [unit] and bounds [scales] of the parameters of a model."""
    scales, low, high = [], [], []
    for c in model:
        for _ in c.parameters:
            scales.append(c.prior.scale)
            low.append(c.bounds[0] / c.prior.scale)
            high.append(c.bounds[1] / c.prior.scale)
    return np.array(scales), np.array(low), np.array(high)


def solve(
    model: Model,
    hessian: FloatArray,
    gradient: FloatArray,
    constant: float,
    energy: float,
    scales: FloatArray,
    low: FloatArray,
    high: FloatArray,
) -> Fit:
    """Minimise (x'Hx - 2 g'x + constant) / 2 within the bounds; evidence relative to `energy` / 2."""
    addresses = [a for c in model for a in c.addresses]
    priors = [c.prior for c in model for _ in c.parameters]
    k = len(addresses)
    # the prior takes part as a normal one: it matters only where the data say little
    regular = hessian + np.diag([1.0 / (1.0 if p.kind == "normal" else 4.0) for p in priors])
    x = np.clip(np.linalg.solve(regular, gradient), low, high)
    for _ in range(30):  # coordinates that are at a bound stay there, the others are solved again
        before = x.copy()
        for i in range(k):
            x[i] = min(max((gradient[i] - regular[i] @ x + regular[i, i] * x[i]) / regular[i, i], low[i]), high[i])
        if np.allclose(x, before, rtol=1e-10, atol=1e-12):
            break
    remaining = float(x @ hessian @ x - 2.0 * gradient @ x + constant)
    covariance = np.linalg.inv(regular)
    if k == 1:
        c = model[0]
        u = _points(c, float(x[0]), math.sqrt(covariance[0, 0]))
        terms = -0.5 * (hessian[0, 0] * u * u - 2.0 * gradient[0] * u + constant - energy)
        density = np.array([c.prior.log_density(v * scales[0]) for v in u]) + math.log(scales[0])
        weights = np.log(np.maximum(np.gradient(u), 1e-300))
        log_evidence = float(logsumexp(terms + density + weights))
    else:
        density_at = sum(p.log_density(float(v) * s) + math.log(s) for p, v, s in zip(priors, x, scales, strict=True))
        log_evidence = (
            0.5 * (energy - remaining) + density_at + 0.5 * k * math.log(2.0 * math.pi) - 0.5 * float(np.linalg.slogdet(regular)[1])
        )
    size = sum(len(c.parameters) for c in model)
    assert size == k
    values = {a: float(v * s) for a, v, s in zip(addresses, x, scales, strict=True)}
    spread = {a: float(math.sqrt(max(covariance[i, i], 0.0)) * scales[i]) for i, a in enumerate(addresses)}
    return Fit(model, values, spread, log_evidence, remaining)


def _points(c: Candidate, x: float, width: float) -> FloatArray:
    """Where the integrand over one parameter is looked at: the whole prior, and finely about the best value [prior scales]."""
    near = x + width * np.linspace(-8.0, 8.0, 161)
    if c.both_signs:
        wide = np.linspace(-6.0, 6.0, 241)
    else:
        wide = np.exp(np.linspace(-5.0, 5.0, 241) * c.prior.spread)
    points = np.unique(np.concatenate([near, wide]))
    low, high = c.bounds[0] / c.prior.scale, c.bounds[1] / c.prior.scale
    return np.asarray(points[(points >= low) & (points <= high)])


def log_priors(models: Sequence[Model], candidates: Sequence[Candidate]) -> list[float]:
    """Log of the probability of each model before the data: effects share that of their number, locations that of their effect."""
    effects = len({c.effect for c in candidates})
    out = []
    for m in models:
        n = len(m)
        sets = math.comb(effects, n) if n <= effects else 1
        out.append(math.log(PRIOR_OF_SIZE.get(n, 0.02)) - math.log(max(sets, 1)) - sum(math.log(c.locations) for c in m))
    return out


def probabilities(fits: Sequence[Fit], candidates: Sequence[Candidate]) -> FloatArray:
    """Of the models in `fits`, after the data."""
    priors = log_priors([f.model for f in fits], candidates)
    scores = np.array([f.log_evidence + p for f, p in zip(fits, priors, strict=True)])
    return np.asarray(np.exp(scores - logsumexp(scores)))


@dataclass(frozen=True)
class LeftOut:
    """One part of the data, and what the others say about it."""

    predicted: float
    """Gain in log score there when the model is fitted to all the others (linear about the best values)."""
    fitted: float
    """The same at the best values."""
    determined: bool
    """Whether the others say how large the effects are: not if an effect shows in this part only."""


def leave_one_out(fit: Fit, space: Space) -> dict[str, LeftOut]:
    """Each part (block of the space), left out of the fit; empty where there is one part only."""
    assert fit.signature is not None
    assert fit.columns is not None
    scales, low, high = scaled_bounds(fit.model)
    addresses = [a for c in fit.model for a in c.addresses]
    best = np.array([fit.values[a] for a in addresses]) / scales
    own = space.without(addresses)
    gains = {}
    for name in space.blocks:
        others = [b for b in space.blocks if b != name]
        if not others:
            return {}
        rest, here = space.rows(others), space.rows([name])
        inner = own.only(others)
        target = inner.y - fit.signature[rest] + fit.columns[rest] @ best
        columns = fit.columns[rest]
        refit = solve(fit.model, inner.dot(columns, columns), inner.dot(columns, target), 0.0, 0.0, scales, low, high)
        x = np.array([refit.values[a] for a in addresses]) / scales
        there, plain = own.only([name]), space.only([name])
        left = there.y - fit.signature[here]
        moved = left - fit.columns[here] @ (x - best)
        gains[name] = LeftOut(
            float(0.5 * (plain.energy - there.dot(moved, moved))),
            float(0.5 * (plain.energy - there.dot(left, left))),
            all(refit.deviations[a] < UNDETERMINED * size for c in fit.model for a, size in c.sizes(fit.values).items()),
        )
    return gains
