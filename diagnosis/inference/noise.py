"""What scatters: covariance of the residuals from repeats, and the whitening that it gives.

Per channel an autoregressive model, between the channels the covariance of its innovations. A floor stands for what
the models are not trusted to: without it noiseless channels would decide everything.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.fft import dct
from scipy.linalg import solve_toeplitz, solve_triangular
from scipy.ndimage import uniform_filter1d

from robomill.orchestration.slaves.protocol import FloatArray

FAST = 5
"""Samples over which a mean is what is slow, where there are no repeats to tell noise by: the rest is noise."""
ORDER = 3
"""Order of the autoregressive models, in (decimated) samples."""
SPELL = 125
"""Length [communication steps] of the spells in which the noise is looked at, too."""
RARE = 2.5
"""Variance of a spell, over that of white noise, that chance rarely gives to so few repeats."""
SLOW = (0, 1, 2, 4, 8)
"""Bands of slow cosines (half waves in a run) in which the noise is looked at apart from the autoregressive model."""
SHRINKAGE = 0.05
"""Part by which covariances between channels are drawn to zero."""


@dataclass(frozen=True)
class Whitening:
    """`apply` turns residuals into white noise of standard deviation 1: innovations e of the channels, then L^-1 e with L = `factor`."""

    coefficients: FloatArray
    """a[channel, lag]: e(t) = x(t) - sum_k a[k] x(t - 1 - k)."""
    factor: FloatArray
    """Lower Cholesky factor of the covariance of the innovations, channels x channels."""
    deviation: FloatArray
    """Standard deviation of a single run about its mean, per channel [unit of the channel]."""
    guessed: bool
    """Whether there were no repeats, so that only the fast part of what a model leaves could be used."""
    begin: int = ORDER
    """Samples at the beginning of each run that do not count."""

    def of(self, independent: bool) -> Whitening:
        """The whitening of a condition: where its samples are `independent` of each other, it has no memory, and every sample counts."""
        return replace(self, coefficients=self.coefficients[:, :0], begin=0) if independent else self

    def apply(
        self,
        residual: FloatArray,
        repeats: float = 1.0,
        sudden: FloatArray | None = None,
        there: npt.NDArray[np.bool_] | None = None,
    ) -> FloatArray:
        """White, flat; `residual` [samples, channels] is a mean over so many repeats.

        `sudden` [samples, channels]: standard deviation, in the unit of the channel, that single runs have beyond the noise. `there`:
        which channels were measured, [channels]; the others stay zero, and say nothing of those that were.
        """
        e = residual.copy()
        for k in range(self.coefficients.shape[1]):
            e[k + 1 :] -= self.coefficients[:, k] * residual[: -k - 1]
        e[: self.begin] = 0.0
        if sudden is not None:
            own = np.sqrt((self.factor**2).sum(axis=1))
            e /= np.hypot(1.0, sudden / own)
        if there is None or there.all():
            white: FloatArray = solve_triangular(self.factor, e.T, lower=True, check_finite=False).T * np.sqrt(repeats)
            return white.ravel()
        rows = self.factor[there]
        white = np.zeros_like(e)
        factor = np.linalg.cholesky(rows @ rows.T)
        white[:, there] = solve_triangular(factor, e[:, there].T, lower=True, check_finite=False).T * np.sqrt(repeats)
        return white.ravel()


def whitening(
    groups: Sequence[Sequence[FloatArray]],
    floor: FloatArray,
    begin: int = ORDER,
    left: Sequence[Sequence[FloatArray]] = (),
    there: Sequence[npt.NDArray[np.bool_]] = (),
    independent: Sequence[bool] = (),
) -> Whitening:
    """The whitening from the repeats [samples, channels] of each condition; `floor` [unit] per channel is added as white noise.

    The first `begin` samples of a run do not count, nor the first ORDER ones: what comes before these is not known. Without repeats the
    noise is the fast part of what a model leaves of each run (`left`; `groups` are that, if it is not given). `there`: which channels each
    condition has, [channels]; one that no condition with repeats has is guessed, the others are not. `independent`: of which conditions
    each sample is a measurement of its own; without repeats all that is left there is noise, and it has no memory.
    """
    channels = len(floor)
    there = there or [np.ones(channels, dtype=np.bool_)] * len(groups)
    independent = independent or [False] * len(groups)
    repeated = np.any([on & (len(g) > 1) for g, on in zip(groups, there, strict=True)], axis=0)
    deviations, shown, series = [], [], []
    freedom, serial, total = np.zeros(channels), np.zeros(channels), np.zeros(channels)
    for group, rest, on, apart in zip(groups, left or groups, there, independent, strict=True):
        if len(group) > 1:
            mean = np.mean(group, axis=0)
            deviations += [(x - mean) * on for x in group]
            shown += [on] * len(group)
            series += [not apart] * len(group)
            freedom += (len(group) - 1) * len(mean) * on
            serial += (len(group) - 1) * len(mean) * on * (not apart)
            total += len(group) * len(mean) * on
        if guess := [(x if apart else fast(x)) * (on & ~repeated) for x in rest if np.any(on & ~repeated)]:
            deviations += guess
            shown += [on & ~repeated] * len(guess)
            series += [not apart] * len(guess)
            freedom += sum(len(x) for x in guess) * (on & ~repeated)
            serial += sum(len(x) for x in guess) * (on & ~repeated) * (not apart)
            total += sum(len(x) for x in guess) * (on & ~repeated)
    freedom = np.maximum(freedom, 1.0)
    scale = np.sqrt(np.maximum(total, 1.0) / freedom)
    deviation = np.sqrt(sum((d * d).sum(axis=0) for d in deviations) / freedom)
    covariance = np.zeros((ORDER + 1, channels))
    for d in itertools.compress(deviations, series):
        covariance += [(d[k:] * d[: len(d) - k]).sum(axis=0) for k in range(ORDER + 1)]
    covariance /= np.maximum(serial, 1.0)
    # the fast part of white noise goes with itself: that is not the noise's own
    alone = np.zeros(8 * FAST)
    alone[4 * FAST] = 1.0
    part = fast(alone[:, None])[:, 0]
    covariance[1:] -= covariance[0] * np.array([[part[k:] @ part[:-k]] for k in range(1, ORDER + 1)]) * ~repeated
    covariance[0] += floor**2 + 1e-30
    coefficients = np.zeros((channels, ORDER))
    for c in range(channels):
        coefficients[c] = solve_toeplitz(covariance[:ORDER, c] * _taper(ORDER), covariance[1:, c] * _taper(ORDER + 1)[1:])
    innovations = []
    for d, memory in zip(deviations, series, strict=True):
        e = d.copy()
        for k in range(ORDER if memory else 0):
            e[k + 1 :] -= coefficients[:, k] * d[: -k - 1]
        innovations.append(e[ORDER if memory else 0 :])
    joined = np.concatenate(innovations)
    # of two channels, what those have in common that were measured together: a little less where one was measured more often
    rows = np.sqrt(np.maximum(np.sum([len(e) * on for e, on in zip(innovations, shown, strict=True)], axis=0), 1.0))
    s = joined.T @ joined * np.outer(scale / rows, scale / rows)
    s *= 1.0 - SHRINKAGE * (1.0 - np.eye(channels))
    s += np.diag(floor**2 * (1.0 + (coefficients**2).sum(axis=1)) + 1e-30)
    size = np.sqrt(np.diag(s))
    factor = np.linalg.cholesky(s / np.outer(size, size) + 1e-9 * np.eye(channels)) * size[:, None]
    return Whitening(coefficients, factor, deviation, not repeated.any(), max(begin, ORDER))


def fast(left: FloatArray) -> FloatArray:
    """What of [samples, channels] is no mean over FAST samples, as large as white noise is that has this fast part."""
    return np.asarray((left - uniform_filter1d(left, FAST, axis=0, mode="nearest")) / np.sqrt(1.0 - 1.0 / FAST))


def own_noise(groups: Sequence[Sequence[FloatArray]], channels: int, rows_of_a_spell: int) -> FloatArray:
    """What single runs of a condition have of their own beyond whitened noise: columns [n, m], of deviation 1 in a mean of repeats.

    `groups`: whitened repeats, flat [samples * channels], measured ones and simulated ones with different noise. Offsets and drifts
    (cosines, in the bands of SLOW) and spells (boxes) of each channel should scatter from repeat to repeat by 1. Where they do by
    more, the excess is a nuisance, one column: an axis that stands a little off until it moves again is no white noise.
    """
    runs = [np.stack(g).reshape(len(g), -1, channels) for g in groups if len(g) > 1]
    if not runs:
        return np.zeros((groups[0][0].size, 0))
    rows = runs[0].shape[1]
    cosines = dct(np.eye(rows), axis=0, norm="ortho")[: min(SLOW[-1], rows)]  # [coefficient, row]
    edges = np.linspace(0, rows, max(1, rows // rows_of_a_spell) + 1).astype(int)
    boxes = np.zeros((len(edges) - 1, rows))
    for box, low, high in zip(boxes, edges, edges[1:], strict=False):
        box[low:high] = 1.0 / np.sqrt(high - low)
    columns: list[FloatArray] = []
    for shapes, bands, least in ((cosines, SLOW, 1.0), (boxes, tuple(range(len(edges))), RARE)):
        scatter = [np.einsum("kr,irc->ikc", shapes, r - r.mean(axis=0)) for r in runs]
        for low, high in itertools.pairwise(b for b in bands if b <= len(shapes)):
            variance = np.max([(x[:, low:high] ** 2).sum(axis=(0, 1)) / ((len(x) - 1) * (high - low)) for x in scatter], axis=0)
            for c in np.flatnonzero(variance > least):
                for k in range(low, high):
                    column = np.zeros((rows, channels))
                    column[:, c] = np.sqrt(variance[c] - 1.0) * shapes[k]
                    columns.append(column.ravel())
    return np.stack(columns).T if columns else np.zeros((rows * channels, 0))


def _taper(n: int) -> FloatArray:
    """Keeps the autoregressive model off the edge of stability, where a drift would be differenced away."""
    return np.asarray(0.995 ** np.arange(n))
