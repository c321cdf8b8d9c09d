"""Which effects explain the gap: fits, evidence, probabilities.

Everything happens on whitened residuals y (measured mean minus nominal simulation). A model is a set of candidates; its
signature s(x), x = value / prior scale, is the change of the whitened simulation, its sensitivities are ds/dx. Numbers that are
only known to a standard deviation (nuisances) are marginalised: with their whitened sensitivities B, per standard deviation, the
inner product is <u, v> = u'v - u'B (I + B'B)^-1 B'v, and chi2 of a residual u is <u, u>.

1. One simulation per parameter at its prior scale gives a sensitivity; inner products of all of them then fit and rank every
   candidate alone as if its signature were proportional, s(x) = x ds/dx.
2. The best are fitted again by Gauss-Newton on real simulations (the sensitivity is updated by Broyden's rule).
3. Models grow by one candidate at a time from the best ones (beam). Evidence is Laplace's approximation, for a single
   parameter an integral over its prior.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field

import numpy as np
from scipy.special import logsumexp

from robomill.diagnosis.candidates import Address, Candidate
from robomill.diagnosis.inference.columns import Columns
from robomill.orchestration.slaves.protocol import FloatArray

Model = tuple[Candidate, ...]
"""Candidates that are switched on together; () is the nominal model."""

FORM_ERROR: Address = ("", "form")
"""Name of the nuisances that stand for what effects do otherwise than their laws say."""

SAME_SIGNATURE = 0.97
"""Correlation of whitened sensitivities from which a nuisance is taken as the same thing as a parameter that is fitted."""


@dataclass
class Fit:
    """A model with its best parameters: the x that minimises chi2 of y - s(x) plus the prior's part, within the bounds."""

    model: Model
    values: dict[Address, float]
    """Best values [unit of the parameter]."""
    deviations: dict[Address, float]
    """Their standard deviations [unit]."""
    log_evidence: float
    """Log of the evidence over that of the nominal model [nats]."""
    chi2: float
    """Whitened sum of squares that remains, <y - s, y - s>: nuisances fitted, `form` not."""
    signature: FloatArray | None = None
    """s(x) at the best values: whitened change against the nominal simulation, [n]. What `calibrated` numbers do is in it as far as their
    slopes do not have it."""
    sensitivities: FloatArray | None = None
    """ds/dx at the best values, per prior scale, [n, parameters]."""
    predictive: dict[str, float] = field(default_factory=dict)
    """condition -> gain in log score there [nats], when fitted to all the others."""
    form: FloatArray | None = None
    """What its effects may do otherwise than their laws say, [n, k]: see `Evidence.form`. None: too little to see."""
    calibrated: Mapping[Address, float] = field(default_factory=dict)
    """Calibrated numbers it was simulated with, as far off as the data have them [unit]; none: as they are given (`Fitting.calibrate`)."""

    @property
    def name(self) -> str:
        """What is on: `backlash @ joint 2 + gain @ x`, or `nominal`."""
        return " + ".join(c.name for c in self.model) or "nominal"

    def signatures(self) -> dict[Candidate, FloatArray]:
        """What each effect adds to the whitened residual, [n]: sensitivities at the fitted values, times these.

        Empty where the sensitivities are not known.
        """
        if self.sensitivities is None:
            return {}
        found, at = {}, 0
        for c in self.model:
            x = np.array([self.values[a] / c.prior.scale for a in c.addresses])
            found[c] = np.asarray(self.sensitivities[:, at : at + len(x)] @ x)
            at += len(x)
        return found

    def large_enough(self) -> bool:
        """Whether each effect has a number that counts as a finding: `minimum` of the catalogue or more."""
        return all(c.large_enough(self.values) for c in self.model)


@dataclass(frozen=True)
class Gram:
    """Products of the columns of a matrix V, [n, k], from which inner products in any space follow."""

    plain: FloatArray
    """V'V, [k, k]."""
    projected: FloatArray
    """B'V with the sensitivities B of the nuisances, [m, k]."""


class Space:
    """The whitened residual y and the inner product with the nuisances marginalised, <u, v> = u'v - u'B (I + B'B)^-1 B'v."""

    def __init__(
        self,
        y: FloatArray,
        blocks: Mapping[str, slice],
        nuisances: FloatArray | Columns,
        names: Sequence[Address] = (),
        gone: Collection[Address] = (),
    ) -> None:
        """`y` [n]; `blocks` condition -> its part of y; `nuisances` B [n, m], whitened sensitivities per standard deviation.

        `names`: parameter of each nuisance; `gone`: names that do not count.
        """
        self.y, self.blocks, self.names, self.gone = y, blocks, tuple(names), frozenset(gone)
        self.nuisances = nuisances if isinstance(nuisances, Columns) else Columns.of(nuisances, blocks)
        self._products = self.nuisances.products()
        m = self.nuisances.shape[1]
        here = np.ix_(*2 * [[i for i in range(m) if i >= len(self.names) or self.names[i] not in self.gone]])
        precision = (np.eye(m) + self._products)[here]
        self._inner = np.zeros((m, m))
        self._inner[here] = np.linalg.inv(precision)
        self._on_y = self.nuisances.across(y)
        self.chi2 = float(y @ y - self._on_y @ (self._inner @ self._on_y))
        self.log_determinant = float(np.linalg.slogdet(precision)[1])
        self._without: dict[frozenset[Address], Space] = {}
        self.alike: dict[Address, dict[Address, float]] = {}
        """parameter -> nuisances that do the same as it, and their standard deviation in its unit."""

    def without(self, addresses: Sequence[Address]) -> Space:
        """Space where what is like these parameters is no nuisance: it is an effect of the model that is looked at."""
        gone = frozenset(n for a in addresses for n in self.alike.get(a, ()))
        if not gone:
            return self
        if gone not in self._without:
            self._without[gone] = self.lacking(gone)
        return self._without[gone]

    def lacking(self, gone: Collection[Address]) -> Space:
        """Space where these nuisances do not count; the data and the sensitivities are shared.

        With the inverse [[P, Q], [Q', R]] of I + B'B, R of those that are gone, the inverse for the others alone is P - Q R^-1 Q', and
        det R is the factor that its determinant has less (Schur complement).
        """
        made = copy(self)
        made.gone, made._without, made.alike = self.gone | frozenset(gone), {}, {}
        out = [i for i, name in enumerate(self.names) if name in gone and name not in self.gone]
        across, within = self._inner[:, out], self._inner[np.ix_(out, out)]
        made._inner = self._inner - across @ np.linalg.solve(within, across.T)
        made._inner[out], made._inner[:, out] = 0.0, 0.0
        made.chi2 = float(self.y @ self.y - self._on_y @ (made._inner @ self._on_y))
        made.log_determinant = self.log_determinant + float(np.linalg.slogdet(within)[1])
        return made

    def less(self, names: Collection[Address]) -> Space:
        """A space of its own that has all nuisances but these; this one where none of them is here."""
        kept = [i for i, name in enumerate(self.names) if name not in names]
        if len(kept) == len(self.names):
            return self
        return Space(self.y, self.blocks, self.nuisances.chosen(kept), [self.names[i] for i in kept])

    def widened(self, columns: FloatArray | None) -> Space:
        """A space of its own that has these nuisances, [n, k], too; this one where there are none."""
        if columns is None or not columns.shape[1]:
            return self
        names = [*self.names, *[("", "")] * (self.nuisances.shape[1] - len(self.names)), *[FORM_ERROR] * columns.shape[1]]
        wide = Space(self.y, self.blocks, self.nuisances.beside(columns), names, self.gone)
        wide.alike = self.alike
        return wide

    def moved(self, left: FloatArray) -> FloatArray:
        """Standard deviations by which the nuisances are moved to explain the residual `left` [n]: (I + B'B)^-1 B' left, [m]."""
        return np.asarray(self._inner @ self.nuisances.across(left))

    def covariance(self, nuisances: Sequence[int]) -> FloatArray:
        """Covariance of these nuisances after the data, [k, k], where it was the unit matrix before: a part of (I + B'B)^-1."""
        return self._inner[np.ix_(nuisances, nuisances)]

    def find_alike(self, sensitivities: Mapping[Address, FloatArray], scales: Mapping[Address, float]) -> None:
        """Note in `alike` which nuisances have (nearly) the same sensitivity as a parameter.

        That is a correlation |b'v| / (|b| |v|) above SAME_SIGNATURE, or the same address. `sensitivities`: parameter -> v [n], per prior
        scale; `scales`: these prior scales [unit of the parameter].
        """
        sizes = np.sqrt(np.diag(self._products))
        places = {name: i for i, name in enumerate(self.names)}
        projected = self.nuisances.across(np.stack(list(sensitivities.values())).T) if sensitivities else np.zeros((len(sizes), 0))
        for (a, c), products in zip(sensitivities.items(), projected.T, strict=True):
            square = float(c @ c) + 1e-300
            same = np.abs(products) > SAME_SIGNATURE * sizes * float(np.linalg.norm(c))
            if a in places:
                same[places[a]] = True
            self.alike[a] = {self.names[i]: float(abs(products[i]) / square * scales[a]) for i in np.flatnonzero(same)}

    def explained(self, left: FloatArray) -> FloatArray:
        """What the nuisances make of the residual `left` [n]: B (I + B'B)^-1 B' left, [n]."""
        return np.asarray(self.nuisances.along(self.moved(left)))

    def dot(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Inner product <a, b> of vectors [n], or of the columns of matrices [n, k] and [n, l]: [k, l]."""
        left = self.nuisances.across(a)
        right = left if b is a else self.nuisances.across(b)
        return np.asarray(a.T @ b - left.T @ (self._inner @ right))

    def square(self, vector: FloatArray) -> float:
        """<v, v> of a vector [n]."""
        return float(self.dot(vector, vector))

    def against(self, vector: FloatArray) -> tuple[float, float]:
        """<v, y> and <v, v> of a vector [n]."""
        seen = self.nuisances.across(vector)
        inner = self._inner @ seen
        return float(vector @ self.y - inner @ self._on_y), float(vector @ vector - inner @ seen)

    def gram(self, matrix: FloatArray) -> Gram:
        """Products of the columns of a matrix [n, k], for `within` of this space and of those that are it `without` some nuisances."""
        return Gram(matrix.T @ matrix, self.nuisances.across(matrix))

    def beside(self, known: Gram, matrix: FloatArray, columns: FloatArray) -> Gram:
        """Products of the columns of a matrix [n, k] and of `columns` [n, l] after them, where those of the matrix are `known`.

        Known may be from the space that this one is `widened` from.
        """
        first = len(known.projected)
        more = self.nuisances.across(matrix, first)[first:]
        across = matrix.T @ columns
        plain = np.block([[known.plain, across], [across.T, columns.T @ columns]])
        return Gram(plain, np.hstack([np.vstack([known.projected, more]), self.nuisances.across(columns)]))

    def within(self, gram: Gram, chosen: Sequence[int]) -> FloatArray:
        """The inner products of the `chosen` columns in this space, [chosen, chosen]."""
        part = gram.projected[:, chosen]
        return np.asarray(gram.plain[np.ix_(chosen, chosen)] - part.T @ (self._inner @ part))

    def chi2_of(self, vectors: FloatArray) -> FloatArray:
        """chi2 of each column of [n, k], <v, v>: [k]."""
        left = self.nuisances.across(vectors)
        return np.asarray((vectors * vectors).sum(axis=0) - (left * (self._inner @ left)).sum(axis=0))

    def only(self, blocks: Sequence[str]) -> Space:
        """Space restricted to the rows of some conditions; it has no blocks."""
        rows = self.rows(blocks)
        return Space(self.y[rows], {}, self.nuisances.restricted([self.blocks[b] for b in blocks]), self.names, self.gone)

    def rows(self, blocks: Sequence[str]) -> FloatArray:
        """Indices of the rows of y that belong to some conditions."""
        return np.concatenate([np.arange(self.y.size)[self.blocks[b]] for b in blocks])


def quadratic_fit(
    model: Model, base: FloatArray, sensitivities: FloatArray, start: FloatArray, space: Space, form: FloatArray | None = None
) -> Fit:
    """The best x for the signature base + sensitivities (x - start), with bounds and priors.

    `base` [n]; `sensitivities` [n, k] per prior scale; `start` [k] in prior scales; `form` as in `Fit`.
    """
    own, y = space.without([a for c in model for a in c.addresses]).widened(form), space.y
    together = np.column_stack([sensitivities, y - base + sensitivities @ start])
    fit = solved(model, own.dot(together, together), space, own)
    fit.form = form
    return fit


def solved(model: Model, products: FloatArray, space: Space, own: Space) -> Fit:
    """The best x from inner products [k + 1, k + 1] in `own`: those of the k sensitivities and, last, of the residual at x = 0.

    `own`: `space` without the nuisances that the model has as effects.
    """
    hessian, gradient, constant = products[:-1, :-1], products[:-1, -1], float(products[-1, -1])
    fit = solve(model, hessian, gradient, constant, space.chi2, *scaled_bounds(model))
    fit.log_evidence += 0.5 * (space.log_determinant - own.log_determinant)
    return fit


def scaled_bounds(model: Model) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Prior scales [unit], lower and upper bounds [prior scales] of the parameters of a model, [k] each."""
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
    chi2: float,
    scales: FloatArray,
    low: FloatArray,
    high: FloatArray,
) -> Fit:
    """The best x within the bounds, and the evidence: the integral of exp(-(chi2(x) - chi2) / 2) prior(x).

    chi2(x) = x'Hx - 2 g'x + constant is minimised together with the prior's part, taken as normal.

    H = `hessian` [k, k], g = `gradient` [k], x in prior scales; `chi2`: that of the nominal model, to which the evidence is relative.
    `scales` [unit], `low` and `high` [prior scales], [k] each. One parameter: the integral is numerical; several: Laplace's approximation.
    """
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
        terms = -0.5 * (hessian[0, 0] * u * u - 2.0 * gradient[0] * u + constant - chi2)
        density = np.array([c.prior.log_density(v * scales[0]) for v in u]) + math.log(scales[0])
        weights = np.log(np.maximum(np.gradient(u), 1e-300))
        log_evidence = float(logsumexp(terms + density + weights))
    else:
        density_at = sum(p.log_density(float(v) * s) + math.log(s) for p, v, s in zip(priors, x, scales, strict=True))
        log_evidence = (
            0.5 * (chi2 - remaining) + density_at + 0.5 * k * math.log(2.0 * math.pi) - 0.5 * float(np.linalg.slogdet(regular)[1])
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


@dataclass(frozen=True)
class LeftOut:
    """One part of the data, left out of the fit, and what the others say about it."""

    predicted: float
    """Gain in log score there [nats] when the model is fitted to all the others (linear about the best values)."""
    fitted: float
    """Gain in log score there [nats] at the best values of all parts together."""


def leave_one_out(fit: Fit, space: Space) -> dict[str, LeftOut]:
    """Each part (block of the space), left out of the fit: name -> what the others say of it; empty where there is one part only.

    With x the fit to the others, the gain in a part is (chi2 of y - chi2 of y - s(x)) / 2 there, s linear about the best values.
    """
    assert fit.signature is not None
    assert fit.sensitivities is not None
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
        target = inner.y - fit.signature[rest] + fit.sensitivities[rest] @ best
        sensitivities = fit.sensitivities[rest]
        refit = solve(fit.model, inner.dot(sensitivities, sensitivities), inner.dot(sensitivities, target), 0.0, 0.0, scales, low, high)
        x = np.array([refit.values[a] for a in addresses]) / scales
        plain = space.only([name])
        there = plain.lacking(own.gone)
        left = there.y - fit.signature[here]
        moved = left - fit.sensitivities[here] @ (x - best)
        gains[name] = LeftOut(
            0.5 * (plain.chi2 - there.square(moved)),
            0.5 * (plain.chi2 - there.square(left)),
        )
    return gains
