"""Periods in an angle or a way: the number k in sin(k x) that a residual asks for, chosen anew in each fold."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar

from robomill.diagnosis.forms.library import SLIDES, Term
from robomill.diagnosis.forms.ports import Problem
from robomill.diagnosis.forms.selection import MOST, Divided, Labels, Rows, fitted, worse
from robomill.diagnosis.forms.signals import Variable
from robomill.diagnosis.inference.ceiling import FOLDS
from robomill.orchestration.slaves.protocol import FloatArray

Place = tuple[str, Variable]


def grid(x: Sequence[FloatArray], decimation: int) -> FloatArray:
    """Values of k from half a wave in the range of x to two samples a wave (Nyquist) at the usual speed.

    Four of them are on the width of a peak, 2 pi / range: with two, a wave between them came as two waves.
    The usual speed is the median of a condition while it moves (SLIDES), in the slowest one: a wave is seen where the motion is slow.
    That it goes by too fast elsewhere makes it no other wave: the angle is known at each sample that was logged.
    N samples tell no more than N / 2 waves apart: what swings fast in a wide range has no more values of k than that.
    """
    way = max(float(np.ptp(v)) for v in x)
    steps = [np.abs(np.diff(v[::decimation])) for v in x]
    usual = min((float(np.median(s[s > SLIDES * s.max()])) for s in steps if s.max() > 0.0), default=0.0)
    if way <= 0.0 or usual <= 0.0:
        return np.zeros(0)
    highest = min(np.pi / usual, np.pi * max(map(len, steps)) / way)
    return np.asarray(np.arange(np.pi / way, highest, 0.5 * np.pi / way))


def _waves(problem: Problem, place: Place, ks: FloatArray) -> Iterator[npt.NDArray[np.complex128]]:
    """exp(i k x) as columns for all these k, which are evenly spaced, in goes: [values, rows]; sines are the imaginary parts."""
    element, v = place
    n = sum(map(len, problem.gap))
    step = [np.exp(1j * (ks[1] - ks[0]) * known[v]) if len(ks) > 1 else np.ones(len(known[v])) for known in problem.seen.known]
    for some in np.array_split(ks, max(1, len(ks) * n >> 21)):  # in goes of 2 million numbers, whatever memory there is
        made = []
        for known, turn, effect in zip(problem.seen.known, step, problem.effect, strict=True):
            wave = np.empty((len(some), len(turn)), dtype=np.complex128)
            wave[0] = np.exp(1j * some[0] * known[v])
            for j in range(1, len(some)):
                np.multiply(wave[j - 1], turn, out=wave[j])
            d, rows = problem.decimation, len(turn) // problem.decimation
            for e in effect[element].T / d:
                moved = e * wave
                made.append(sum((moved[:, i : rows * d : d] for i in range(1, d)), start=moved[:, 0 : rows * d : d]))
        yield np.concatenate(made, axis=1)


def _gains(problem: Problem, place: Place, left: FloatArray, parts: Labels) -> tuple[FloatArray, FloatArray]:
    """Values of k, and what sine and cosine explain of what is left without each fold, and (last row) of all: [folds + 1, values]."""
    ks = grid([k[place[1]] for k in problem.seen.known], problem.decimation)
    names, gains = np.unique(parts), []
    inside = (parts[:, None] == names).astype(np.float64)
    for wave in _waves(problem, place, ks) if len(ks) else ():
        squares, products, sizes = (wave * wave) @ inside, (wave * left) @ inside, (wave.real**2 + wave.imag**2) @ inside
        sums = [0.5 * (sizes - squares.real), 0.5 * (sizes + squares.real), 0.5 * squares.imag, products.imag, products.real]
        ss, cc, sc, sr, cr = (np.concatenate([x.sum(axis=0) - x, x.sum(axis=0)[None]]) for x in (y.T for y in sums))
        determinant = ss * cc - sc**2
        good = determinant > 1e-6 * ss * cc + 1e-300
        gains.append(np.where(good, (sr**2 * cc - 2.0 * sr * cr * sc + cr**2 * ss) / np.where(good, determinant, 1.0), 0.0))
    return ks, np.concatenate(gains, axis=1) if gains else np.zeros((len(names) + 1, 0))


def with_periods(
    problem: Problem, terms: list[tuple[str, Term]], rho: float, places: Sequence[Place], divided: Divided
) -> list[tuple[str, Term]]:
    """The terms, and sines and cosines of as many angles as blocks that have not seen their choice are predicted better by."""
    while len(terms) + 2 <= MOST:
        rows = problem.rows(terms)
        parts, left = divided(rows, FOLDS), rows.y - rows.X @ fitted(rows)
        best: tuple[float, Place, FloatArray, FloatArray] | None = None
        for place in places:
            ks, gains = _gains(problem, place, left, parts)
            if len(ks) and (best is None or gains[-1].max() > best[0]):
                best = (float(gains[-1].max()), place, ks, gains)
        if best is None:
            break
        _, (element, v), ks, gains = best
        before = rows.products(parts, rho).errors(list(range(len(terms))))
        after = np.zeros_like(before)
        for f, k in enumerate(ks[gains[:-1].argmax(axis=1)]):
            trial = problem.rows([*terms, *problem.periodic(element, v, float(k))])
            products = trial.products(parts, rho)
            every = list(range(trial.X.shape[1]))
            after[f] = products.error(f, every, products.fit(every, f))
        if not worse(before, after):
            break
        middle, width = float(ks[gains[-1].argmax()]), float(ks[1] - ks[0]) if len(ks) > 1 else float(ks[0])
        terms = [*terms, *problem.periodic(element, v, _sharp(problem, terms, (element, v), middle, width))]
    return terms


def _sharp(problem: Problem, terms: Sequence[tuple[str, Term]], place: Place, k: float, width: float) -> float:
    """The k within `width` of one that leaves least."""

    def squares(x: float) -> float:
        rows: Rows = problem.rows([*terms, *problem.periodic(*place, x)])
        return float(((rows.y - rows.X @ fitted(rows)) ** 2).sum())

    return float(minimize_scalar(squares, bounds=(k - width, k + width), method="bounded").x)
