"""Which terms: greedy forward, then pruned backward, as block cross-validation says, with the choice repeated inside each fold.

The rows are samples of one or several channels; `Rows` keeps them apart so that noise is whitened (AR(1)) within each channel of a
condition. With X the terms, y the residual: forward selection takes the term with which left-out folds are predicted best (orthogonal
matching pursuit, Pati et al. 1993, by cross-validation). Errors of k = 0, 1, ... terms are those in the fold that choice and fit have not
seen; taken is the smallest k that is not worse than the best one by more than a standard error of the difference (Breiman et al. 1984,
over folds). The noise's memory is one number: the correlation of what is left from sample to sample.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from robomill.diagnosis.experiment.repeats import RESAMPLES
from robomill.diagnosis.inference.intervals import MATERIAL, MEMORY
from robomill.diagnosis.outcome.ceiling import FOLDS
from robomill.diagnosis.outcome.closure import BLOCKS
from robomill.orchestration.slaves.protocol import FloatArray

MOST = 12
"""Terms of a port, at most: more than that is no law that anybody reads."""
BAND = 0.2
"""Correlation of the whitened residual from sample to sample from which samples are averaged in pairs (DIAGNOSIS2, lesson 2)."""

Labels = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Rows:
    """Residual y [n], terms X [n, p], and which series (channel of a condition) each row belongs to; rows of a series are in time order."""

    y: FloatArray
    X: FloatArray
    series: Labels
    condition: Labels
    """Number of the condition, from 0."""
    position: FloatArray
    """Where in its series a row is, 0..1."""
    step: float
    """Time between rows [s]."""

    def paired(self) -> Rows:
        """Means of pairs of neighbours."""
        keep = []
        for s in np.unique(self.series):
            at = np.flatnonzero(self.series == s)
            keep.append(at[: len(at) // 2 * 2])
        order = np.concatenate(keep)

        def mean(x: FloatArray) -> FloatArray:
            return np.asarray(x[order].reshape(-1, 2, *x.shape[1:]).mean(axis=1))

        return Rows(mean(self.y), mean(self.X), self.series[order][::2], self.condition[order][::2], mean(self.position), 2.0 * self.step)

    def whitened(self, rho: float) -> Rows:
        """Without what goes on from one sample to the next: x_k - rho x_{k-1}; the first of each series is scaled alike."""
        first = np.diff(self.series, prepend=-1) != 0

        def white(x: FloatArray) -> FloatArray:
            e = x.copy()
            e[1:] -= rho * x[:-1]
            e[first] = np.sqrt(1.0 - rho * rho) * x[first]
            return e

        return replace(self, y=white(self.y), X=white(self.X))

    def memory(self, left: FloatArray) -> float:
        """Correlation of what is left [n] from sample to sample, from 0 to that of MEMORY."""
        inside = np.diff(self.series) == 0
        total = float((left**2).sum())
        return min(max(float((left[1:] * left[:-1])[inside].sum()) / total, 0.0), np.exp(-self.step / MEMORY)) if total > 0.0 else 0.0

    def parts(self, count: int) -> Labels:
        """Which block of time each row is in: at least `count` of them, as many in each condition; channels of a condition go together."""
        each = -(-count // (int(self.condition.max()) + 1))
        return np.asarray(self.condition * each + np.minimum((self.position * each).astype(np.intp), each - 1))


class Products:
    """Inner products of rows, of all and of each fold, [folds, p, p]."""

    def __init__(self, rows: Rows, parts: Labels) -> None:
        names = np.unique(parts)
        self.gram = np.stack([rows.X[parts == f].T @ rows.X[parts == f] for f in names])
        self.right = np.stack([rows.X[parts == f].T @ rows.y[parts == f] for f in names])
        self.square = np.array([float(rows.y[parts == f] @ rows.y[parts == f]) for f in names])
        self._all, self._right = self.gram.sum(axis=0), self.right.sum(axis=0)

    def fit(self, chosen: list[int], without: int | None = None) -> FloatArray:
        """Least squares of these terms, a fold left out."""
        gram, right = self._all[np.ix_(chosen, chosen)], self._right[chosen]
        if without is not None:
            gram, right = gram - self.gram[without][np.ix_(chosen, chosen)], right - self.right[without][chosen]
        return _solve(gram, right)

    def error(self, fold: int, chosen: list[int], values: FloatArray) -> float:
        """Squares that a fit leaves in a fold."""
        g = self.gram[fold][np.ix_(chosen, chosen)]
        return float(self.square[fold] - 2.0 * values @ self.right[fold][chosen] + values @ g @ values)

    def path(self, most: int, without: int | None = None) -> list[int]:
        """Terms in the order in which they are taken: the next is that with which left-out folds are predicted best.

        It ends where no term helps. A term that is large for a moment only explains that moment, and predicts nothing of the others.
        """
        taken = list[int]()
        best = float(self.square.sum() if without is None else self.square.sum() - self.square[without])
        while len(taken) < min(most, self.gram.shape[1]):
            left = self.left_beside(taken, without)[:, 0]
            j = int(left.argmin())
            if left[j] >= best:
                break
            best = float(left[j])
            taken.append(j)
        return taken

    def left_beside(
        self, taken: list[int], without: int | None = None, right: FloatArray | None = None, square: FloatArray | None = None
    ) -> FloatArray:
        """Squares left in the folds by fits to the others of the terms `taken` and each further one, [p, m]; inf where it adds nothing new.

        Of these rows, m is 1. `right` [folds, p, m] and `square` [folds, m]: products with m other residuals in place of y.
        """
        right = self.right[..., None] if right is None else right
        square = self.square[:, None] if square is None else square
        whole, of_all = self._all, right.sum(axis=0)
        if without is not None:
            whole, of_all = whole - self.gram[without], of_all - right[without]
        left = np.zeros(of_all.shape)
        for f in range(len(self.square)):
            if f == without:
                continue
            here, product = self.gram[f], of_all - right[f]
            gram = whole - here
            along = _solve(gram[np.ix_(taken, taken)], gram[taken])  # what the terms taken have of each other one
            values_ = _solve(gram[np.ix_(taken, taken)], product[taken])
            rest = np.diag(gram) - (gram[taken] * along).sum(axis=0)
            new = rest > np.sqrt(np.finfo(float).eps) * np.diag(gram)  # the rest of it is no roundoff
            value = np.where(new[:, None], product - along.T @ product[taken], 0.0) / np.where(new, rest, 1.0)[:, None]
            own, both = right[f][taken], here[np.ix_(taken, taken)]
            cross = right[f] - here[:, taken] @ values_ - along.T @ (own - both @ values_)
            size = np.diag(here) - 2.0 * (along * here[taken]).sum(axis=0) + (along * (both @ along)).sum(axis=0)
            before = square[f] - 2.0 * (values_ * own).sum(axis=0) + (values_ * (both @ values_)).sum(axis=0)
            left += np.where(new[:, None], before - 2.0 * value * cross + value**2 * size[:, None], np.inf)
        left[taken] = np.inf
        return left

    def errors(self, chosen: list[int]) -> FloatArray:
        """Squares left in each fold by a fit to the others, [folds]."""
        folds = range(len(self.square))
        return np.array([self.error(f, chosen, self.fit(chosen, f)) for f in folds])


def _solve(gram: FloatArray, right: FloatArray) -> FloatArray:
    if not len(right):
        return np.zeros(right.shape)
    scale = np.sqrt(np.maximum(np.diag(gram), 0.0))
    scale[scale == 0.0] = 1.0  # a term that is there in the left-out fold only has no value
    return np.asarray((np.linalg.lstsq(gram / np.outer(scale, scale), (right.T / scale).T, rcond=1e-10)[0].T / scale).T)


def worse(errors: FloatArray, than: FloatArray) -> bool:
    """Whether errors [folds] are larger than others by more than a standard error of the difference."""
    d = errors - than
    return bool(d.mean() > d.std(ddof=1) / np.sqrt(len(d)))


@dataclass(frozen=True)
class Chosen:
    """Terms that are taken, and what they are worth in folds that have not seen them."""

    terms: list[int]
    closure: float
    """1 - squares left / squares, in left-out folds, which choice and fit have not seen; of rows that are not whitened."""
    rho: float
    rows: Rows
    """Averaged to the band that the noise allows, not whitened."""
    pairs: int
    """How often neighbours were averaged for that."""
    errors: FloatArray
    """Squares left in each left-out fold, of whitened rows."""


def choose(rows: Rows) -> Chosen:
    """The terms, in a band and with a memory of the noise that fit what they leave."""
    rho, pairs = 0.0, 0
    while True:
        for _ in range(2):  # the noise is known when the terms are, and the other way round
            terms, sets, errors = _chosen(rows.whitened(rho))
            left = rows.y - rows.X[:, terms] @ fitted(rows, terms)
            rho = rows.memory(left)
        white = rows.whitened(rho)
        again = white.memory(white.y - white.X[:, terms] @ fitted(white, terms))
        if again < BAND or len(rows.y) < 4 * FOLDS * MOST or 4.0 * rows.step > MEMORY:
            plain = Products(rows, rows.parts(FOLDS))
            lost = sum(plain.error(f, some, plain.fit(some, f)) for f, some in enumerate(sets))
            return Chosen(terms, 1.0 - lost / max(float(plain.square.sum()), 1e-300), rho, rows, pairs, errors)
        rows, pairs = rows.paired(), pairs + 1


def _chosen(white: Rows) -> tuple[list[int], list[list[int]], FloatArray]:
    """Terms by all rows, those that each fold would have taken without its own rows, and squares left in the folds."""
    products = Products(white, white.parts(FOLDS))
    folds = range(len(products.square))
    paths = [products.path(MOST, f) for f in folds]
    longest = max(map(len, paths))
    table = np.array([[products.error(f, paths[f][:k], products.fit(paths[f][:k], f)) for f in folds] for k in range(longest + 1)])
    best = int(table.mean(axis=1).argmin())
    count = next(k for k in range(best + 1) if not worse(table[k], table[best]))
    terms = pruned(products, products.path(count))
    return terms, [p[:count] for p in paths], table[count]


def pruned(products: Products, terms: list[int]) -> list[int]:
    """Terms without those that the others do not need: without one, folds are not predicted worse, or it closes too little (MATERIAL)."""
    while terms:
        errors, total = products.errors(terms), float(products.square.sum())
        left = {t: products.errors([x for x in terms if x != t]) for t in terms}
        least = min(terms, key=lambda t: float(left[t].sum()))
        if worse(left[least], errors) and float((left[least] - errors).sum()) >= MATERIAL * total:
            break
        terms = [t for t in terms if t != least]
    return terms


def fitted(rows: Rows, terms: list[int] | None = None) -> FloatArray:
    """Ordinary least squares of these terms, or of all."""
    X = rows.X if terms is None else rows.X[:, terms]
    return _solve(X.T @ X, X.T @ rows.y)


@dataclass(frozen=True)
class Values:
    """Coefficients by ordinary least squares, with 90 % intervals by a bootstrap over blocks of time."""

    values: FloatArray
    intervals: FloatArray
    """[terms, 2]"""
    adds: FloatArray
    """Part of the squares of y that each closes beside those before it."""


def values(rows: Rows, terms: list[int]) -> Values:
    """Fit the terms; rows that are not whitened (DIAGNOSIS2, lesson 3: whitening lets reversals decide, where laws are wrong)."""
    products = Products(replace(rows, X=rows.X[:, terms]), rows.parts(BLOCKS))
    every = list(range(len(terms)))
    best = products.fit(every)
    rng = np.random.default_rng(0)
    drawn = []
    for _ in range(RESAMPLES):
        some = rng.integers(0, len(products.square), len(products.square))
        drawn.append(_solve(products.gram[some].sum(axis=0), products.right[some].sum(axis=0)))
    low, high = np.quantile(np.array(drawn), [0.05, 0.95], axis=0)
    gram, right, total = products.gram.sum(axis=0), products.right.sum(axis=0), float(products.square.sum())
    closed = [0.0]
    for k in range(1, len(terms) + 1):
        first = list(range(k))
        closed.append(float(right[first] @ _solve(gram[np.ix_(first, first)], right[first])) / max(total, 1e-300))
    return Values(best, np.stack([low, high], axis=1), np.diff(closed))
