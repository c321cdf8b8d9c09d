"""Which terms: greedy forward, then pruned backward, as block cross-validation says, with the choice repeated inside each fold.

The rows are samples of one or several channels; `Rows` keeps them apart so that noise is whitened (AR(1)) within each channel of a
condition. With X the terms, y the residual: forward selection takes the term with which left-out folds are predicted best (orthogonal
matching pursuit, Pati et al. 1993, by cross-validation). Errors of k = 0, 1, ... terms are those in the fold that choice and fit have not
seen; taken is the smallest k that is not worse than the best one by more than a standard error of the difference (Breiman et al. 1984,
over folds). The noise's memory is one number: the correlation of what is left from sample to sample.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from robomill.diagnosis.experiment.repeats import RESAMPLES
from robomill.diagnosis.inference.ceiling import FOLDS
from robomill.diagnosis.inference.intervals import MATERIAL, MEMORY
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
        y, X = self._white(np.arange(len(self.y)), rho)
        return replace(self, y=y, X=X)

    def products(self, parts: Labels, rho: float = 0.0) -> Products:
        """Products of the rows `whitened` by rho, by part; no more than one part is held a second time."""
        folds = np.unique(parts)
        made = np.empty((len(folds), self.X.shape[1] + 1, self.X.shape[1] + 1))
        for part, out in zip(folds, made, strict=True):
            y, X = self._white(np.flatnonzero(parts == part), rho)
            both = np.column_stack([X, y])
            np.matmul(both.T, both, out=out)  # of a matrix with itself: half the work
        return Products(made)

    def _white(self, at: Labels, rho: float) -> tuple[FloatArray, FloatArray]:
        """The rows `at` of y and X, whitened."""
        first = np.diff(self.series, prepend=-1)[at] != 0

        def white(x: FloatArray) -> FloatArray:
            e = x[at]
            if rho:
                e -= rho * x[at - 1]
                e[first] = np.sqrt(1.0 - rho * rho) * x[at[first]]
            return e

        return white(self.y), white(self.X)

    def memory(self, left: FloatArray) -> float:
        """Correlation of what is left [n] from sample to sample, from 0 to that of MEMORY."""
        inside = np.diff(self.series) == 0
        total = float((left**2).sum())
        return min(max(float((left[1:] * left[:-1])[inside].sum()) / total, 0.0), np.exp(-self.step / MEMORY)) if total > 0.0 else 0.0

    def spans(self, count: int) -> Labels:
        """Which block of time each row is in: at least `count` of them, as many in each condition; channels of a condition go together."""
        each = -(-count // (int(self.condition.max()) + 1))
        return np.asarray(self.condition * each + np.minimum((self.position * each).astype(np.intp), each - 1))

    def blocks(self) -> Labels:
        """Which of BLOCKS blocks of time of its condition each row is in, numbered through all conditions."""
        return np.asarray(self.condition * BLOCKS + np.minimum((self.position * BLOCKS).astype(np.intp), BLOCKS - 1))

    def parts(self, count: int) -> Labels:
        """Which of at most `count` parts each row is in: `blocks` one after the other, with about as much of the squares of y in each part.

        Where a gap is large for a short time only, one of `spans` has it all, and nothing that is fitted to the others has seen it. What
        lasts for one block only stays in one part.
        """
        blocks = self.blocks()
        squares = np.bincount(blocks, self.y**2) + np.finfo(float).tiny
        middle = (np.cumsum(squares) - 0.5 * squares) / squares.sum()
        return np.asarray(np.minimum((middle * count).astype(np.intp), count - 1)[blocks])

    def left_out(self, parts: Labels) -> FloatArray:
        """What fits of all terms to the other parts leave of y, [n]."""
        products, left = self.products(parts), self.y.copy()
        for fold, part in enumerate(np.unique(parts)):
            here = parts == part
            left[here] -= self.X[here] @ products.fit(list(range(self.X.shape[1])), fold)
        return left


Divided = Callable[[Rows, int], Labels]
"""Divides rows into so many folds: number of the fold of each row."""


class Products:
    """Inner products of rows, of all and of each fold, [folds, p, p]."""

    def __init__(self, products: FloatArray) -> None:
        """`products` of terms and, behind them, y [folds, p + 1, p + 1]."""
        self.gram, self.right, self.square = products[:, :-1, :-1], products[:, :-1, -1], products[:, -1, -1]
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

    def path(self, most: int, without: int | None = None, first: Sequence[int] = ()) -> list[int]:
        """Terms in the order in which they are taken: the next is that with which left-out folds are predicted best.

        `first`: terms that are taken before all others, whatever they help. It ends where no term helps. A term that is large for a moment
        only explains that moment, and predicts nothing of the others.
        """
        beside = self._beside(without)
        for t in first:
            beside.take(t)
        best = float(beside.before.sum())
        while len(beside.taken) < min(most, self.gram.shape[1]):
            left = beside.left()[:, 0]
            same = left <= left.min() + np.sqrt(np.finfo(float).eps) * float(self.square.sum())
            j = int(same.argmax())  # the first of those that differ by roundoff: signs of two variables may be one column
            if left[j] >= best:
                break
            best = float(left[j])
            beside.take(j)
        return beside.taken

    def left_beside(
        self, taken: list[int], without: int | None = None, right: FloatArray | None = None, square: FloatArray | None = None
    ) -> FloatArray:
        """Squares left in the folds by fits to the others of the terms `taken` and each further one, [p, m]; inf where it adds nothing new.

        Of these rows, m is 1. `right` [folds, p, m] and `square` [folds, m]: products with m other residuals in place of y.
        """
        beside = self._beside(without, right, square)
        for t in taken:
            beside.take(t)
        return beside.left()

    def _beside(self, without: int | None, right: FloatArray | None = None, square: FloatArray | None = None) -> Beside:
        right = self.right[..., None] if right is None else right
        square = self.square[:, None] if square is None else square
        folds = np.array([f for f in range(len(self.square)) if f != without], dtype=np.intp)
        whole = self._all if without is None else self._all - self.gram[without]
        return Beside(self.gram, folds, whole, right[folds], square[folds])

    def errors(self, chosen: list[int]) -> FloatArray:
        """Squares left in each fold by a fit to the others, [folds]."""
        return np.asarray(self.errors_of([chosen])[0])

    def errors_of(self, sets: list[list[int]]) -> FloatArray:
        """`errors` of several sets of as many terms each, [sets, folds]."""
        at = np.array(sets, dtype=np.intp).reshape(len(sets), -1)
        here, right = self.gram[:, at[:, :, None], at[:, None, :]], self.right[:, at]  # [folds, sets, k, k], [folds, sets, k]
        values_ = _solve(here.sum(axis=0) - here, right.sum(axis=0) - right)
        size = np.einsum("fsk,fskl,fsl->fs", values_, here, values_)
        return np.asarray((self.square[:, None] - 2.0 * (values_ * right).sum(axis=2) + size).T)


class Beside:
    """Terms that are taken one after the other, and what each further one would leave in each fold, fitted to the others beside them.

    Each term that is taken gives a direction d: what it has of no direction before it, in the folds it is fitted to (Gram and Schmidt).
    Of every other term, e is what it has of no direction. One more direction changes the products of e; nothing is solved again.
    """

    def __init__(self, gram: FloatArray, folds: Labels, whole: FloatArray, right: FloatArray, square: FloatArray) -> None:
        """Products of the terms, `gram` [all folds, p, p] and `whole`, their sum in the `folds`.

        `right` [folds, p, m]: products with m residuals, `square` [folds, m]: of these, in the `folds`.
        """
        self._gram, self._folds, self._whole = gram, folds, whole
        here = np.diagonal(gram, axis1=1, axis2=2)[folds]
        self._own = here.sum(axis=0) - here
        self._rest, self._size = self._own.copy(), here.copy()  # e e where it is fitted, and in the fold left out
        self._there, self._right = right, right.sum(axis=0) - right
        none = np.zeros((len(folds), 0, len(self._whole)))
        self._along, self._lines = none, none  # parts of d in the terms x, and d x where they are fitted
        self._across, self._met = none, none  # d x and, when d was taken, d e in the fold left out
        self._directions = none[:, :, :0]  # d d in the fold left out
        self._sums = self._values = self._kept = np.zeros((len(folds), 0, right.shape[2]))  # d y, value of d, and d (y - fit) left out
        self.before = square.copy()
        """Squares that the terms taken leave in each fold, [folds, m]."""
        self.taken: list[int] = []
        """Terms, in the order in which they were taken."""

    @property
    def _new(self) -> npt.NDArray[np.bool_]:
        """Where the rest of a term is no roundoff, [folds, p]."""
        return np.asarray(self._rest > np.sqrt(np.finfo(float).eps) * self._own)

    def _products(self, at: slice) -> tuple[FloatArray, FloatArray]:
        """Products of e with y, where it is fitted, and with what is left of y in the fold left out, [folds, terms, m]."""
        along, met = (np.swapaxes(x[:, :, at], 1, 2) for x in (self._along, self._met))
        return self._right[:, at] - along @ self._sums, self._there[:, at] - met @ self._values - along @ self._kept

    def left(self) -> FloatArray:
        """Squares left in all folds with each further term, [p, m]; inf where it adds nothing new."""
        new, (product, cross) = self._new[..., None], self._products(slice(None))
        value = np.where(new, product, 0.0) / np.where(new, self._rest[..., None], 1.0)
        more = (value * (value * self._size[..., None] - 2.0 * cross)).sum(axis=0)
        left = np.where(new.all(axis=0), self.before.sum(axis=0) + more, np.inf)
        left[self.taken] = np.inf
        return np.asarray(left)

    def take(self, t: int) -> None:
        """One more term; it has no value in folds where it adds nothing new."""
        parts, here = self._along[:, :, t, None], self._gram[self._folds, t]
        line = self._whole[t] - here - (parts * self._lines).sum(axis=1)
        across = here - (parts * self._across).sum(axis=1)
        others = self._across[:, :, t] - (self._directions @ parts)[..., 0]  # d with the directions before it
        met = across - (others[..., None] * self._along).sum(axis=1)
        pivot = np.where(self._new[:, t], self._rest[:, t], np.inf)[:, None]
        product, cross = (x[:, 0] for x in self._products(slice(t, t + 1)))
        along, value, size = line / pivot, product / pivot, self._size[:, t, None].copy()
        self.before += value * (value * size - 2.0 * cross)
        self._size -= along * (2.0 * met - along * size)
        self._rest -= along * line
        self._directions = _bordered(self._directions, others, size)
        self._along, self._lines = _with(self._along, along), _with(self._lines, line)
        self._across, self._met = _with(self._across, across), _with(self._met, met)
        self._sums, self._values, self._kept = (
            _with(self._sums, product),
            _with(self._values, value),
            _with(self._kept, cross - value * size),
        )
        self.taken.append(t)


def _with(lines: FloatArray, line: FloatArray) -> FloatArray:
    """One more of the lines [folds, k, n]."""
    return np.concatenate([lines, line[:, None]], axis=1)


def _bordered(square: FloatArray, others: FloatArray, own: FloatArray) -> FloatArray:
    """Symmetric matrices [folds, k, k] with one more line and column."""
    return np.concatenate([_with(square, others), np.concatenate([others, own], axis=1)[..., None]], axis=2)


def _solve(gram: FloatArray, right: FloatArray) -> FloatArray:
    """Least squares of the smallest norm, [..., k], by products [..., k, k] and [..., k]."""
    scale = np.sqrt(np.maximum(np.diagonal(gram, axis1=-2, axis2=-1), 0.0))
    scale = np.where(scale == 0.0, 1.0, scale)  # a term that is there in the left-out fold only has no value
    inverse = np.linalg.pinv(gram / (scale[..., :, None] * scale[..., None, :]), rcond=1e-10, hermitian=True)
    return np.asarray((inverse @ (right / scale)[..., None])[..., 0] / scale)


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
    divided: Divided
    """How the rows were divided into the folds: `Rows.spans` or `Rows.parts`."""


def choose(rows: Rows, offsets: Sequence[int] = ()) -> Chosen:
    """The terms, in a band and with a memory of the noise that fit what they leave.

    It is made in four ways, and taken is that which predicts most of what was left out. Folds are spans of time, which ask most of a law,
    or parts that share the gap: a span that has all of it cannot tell. Any term comes first, or those that are constant (`offsets`): where
    there is an offset, no other term alone says much.
    """
    firsts = dict.fromkeys([(), tuple(offsets)])
    found = []
    for divided in (Rows.spans, Rows.parts):
        whitened = _by_memory(rows, divided)
        found += [chosen_in(rows, first, divided, whitened) for first in firsts]
    return max(found, key=lambda c: c.closure)


def chosen_in(rows: Rows, offsets: Sequence[int], divided: Divided, whitened: Callable[[float], Products] | None = None) -> Chosen:
    """The terms, where rows are divided into folds in this way; `whitened`: products of these rows by memory of the noise, if there are."""
    rho, pairs = 0.0, 0
    while True:
        whitened = whitened or _by_memory(rows, divided)
        for _ in range(2):  # the noise is known when the terms are, and the other way round
            used = rho
            terms, sets = _chosen(whitened(used), offsets)
            left = rows.y - rows.X[:, terms] @ fitted(rows, terms)
            rho = rows.memory(left)
            if rho == used:
                break
        white = replace(rows, X=rows.X[:, terms]).whitened(rho)
        again = white.memory(white.y - white.X @ fitted(white))
        if again < BAND or len(rows.y) < 4 * FOLDS * MOST or 4.0 * rows.step > MEMORY:
            plain = whitened(0.0)
            lost = sum(plain.error(f, some, plain.fit(some, f)) for f, some in enumerate(sets))
            return Chosen(terms, 1.0 - lost / max(float(plain.square.sum()), 1e-300), rho, rows, pairs, divided)
        rows, pairs, whitened = rows.paired(), pairs + 1, None


def _by_memory(rows: Rows, divided: Divided) -> Callable[[float], Products]:
    """Products of the rows whitened by a memory of the noise; the last two are kept."""
    folds = divided(rows, FOLDS)
    return lru_cache(2)(lambda rho: rows.products(folds, rho))


def _chosen(products: Products, offsets: Sequence[int]) -> tuple[list[int], list[list[int]]]:
    """Terms by all rows, and those that each fold would have taken without its own rows."""
    folds = range(len(products.square))
    paths = [products.path(MOST, f, offsets) for f in folds]
    longest = max(map(len, paths))
    table = np.array([[products.error(f, paths[f][:k], products.fit(paths[f][:k], f)) for f in folds] for k in range(longest + 1)])
    best = int(table.mean(axis=1).argmin())
    count = next(k for k in range(best + 1) if not worse(table[k], table[best]))
    terms = pruned(products, products.path(count, None, offsets)[:count])
    return terms, [p[:count] for p in paths]


def pruned(products: Products, terms: list[int]) -> list[int]:
    """Terms without those that the others do not need: without one, folds are not predicted worse, or it closes too little (MATERIAL)."""
    while terms:
        errors, total = products.errors(terms), float(products.square.sum())
        left = products.errors_of([[x for x in terms if x != t] for t in terms])
        k = int(left.sum(axis=1).argmin())
        if worse(left[k], errors) and float((left[k] - errors).sum()) >= MATERIAL * total:
            break
        terms = [*terms[:k], *terms[k + 1 :]]
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
    products = replace(rows, X=rows.X[:, terms]).products(rows.spans(BLOCKS))
    every = list(range(len(terms)))
    best = products.fit(every)
    rng = np.random.default_rng(0)
    some = rng.integers(0, len(products.square), (RESAMPLES, len(products.square)))
    times = (some[..., None] == np.arange(len(products.square))).sum(axis=1).astype(np.float64)  # each block is drawn
    drawn = _solve(np.tensordot(times, products.gram, axes=1), times @ products.right)
    low, high = np.quantile(drawn, [0.05, 0.95], axis=0)
    gram, right, total = products.gram.sum(axis=0), products.right.sum(axis=0), float(products.square.sum())
    closed = [0.0]
    for k in range(1, len(terms) + 1):
        first = list(range(k))
        closed.append(float(right[first] @ _solve(gram[np.ix_(first, first)], right[first])) / max(total, 1e-300))
    return Values(best, np.stack([low, high], axis=1), np.diff(closed))
