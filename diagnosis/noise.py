"""What scatters: covariance of the residuals from repeats, and the whitening that it gives.

Per channel an autoregressive model, between the channels the covariance of its innovations. A floor stands for what
the models are not trusted to: without it noiseless channels would decide everything.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_toeplitz, solve_triangular
from scipy.ndimage import uniform_filter1d

from orchestration.slave import FloatArray

ORDER = 3
"""Order of the autoregressive models, in (decimated) samples."""
SHRINKAGE = 0.05
"""Part by which covariances between channels are drawn to zero."""


@dataclass(frozen=True)
class Whitening:
    """`apply` turns residuals into white noise of standard deviation 1."""

    coefficients: FloatArray
    """a[channel, lag]: e(t) = x(t) - sum_k a[k] x(t - 1 - k)."""
    factor: FloatArray
    """Lower Cholesky factor of the covariance of the innovations, channels x channels."""
    deviation: FloatArray
    """Standard deviation of a single run about its mean, per channel [unit of the channel]."""
    guessed: bool
    """Whether there were no repeats, so that only the fast part of the residual could be used."""

    def apply(self, residual: FloatArray, repeats: float = 1.0) -> FloatArray:
        """White, flat; `residual` [samples, channels] is a mean over so many repeats."""
        e = residual.copy()
        for k in range(self.coefficients.shape[1]):
            e[k + 1 :] -= self.coefficients[:, k] * residual[: -k - 1]
        white: FloatArray = solve_triangular(self.factor, e.T, lower=True, check_finite=False).T * np.sqrt(repeats)
        return white.ravel()


def whitening(groups: Sequence[Sequence[FloatArray]], floor: FloatArray) -> Whitening:
    """From the repeats [samples, channels] of each condition; `floor` [unit] per channel is added as white noise."""
    deviations, freedom, total = [], 0.0, 0
    guessed = all(len(g) < 2 for g in groups)
    for group in groups:
        if guessed:
            for x in group:
                d = x - uniform_filter1d(x, 5, axis=0, mode="nearest")
                deviations.append(d / np.sqrt(0.8))  # a mean over 5 takes a fifth of the variance of white noise
                freedom += len(d)
        elif len(group) > 1:
            mean = np.mean(group, axis=0)
            deviations += [x - mean for x in group]
            freedom += (len(group) - 1) * len(mean)
        total += sum(len(x) for x in group) if guessed or len(group) > 1 else 0
    scale = total / freedom
    channels = len(floor)
    covariance = np.array([sum((d[k:] * d[: len(d) - k]).sum(axis=0) for d in deviations) for k in range(ORDER + 1)]) / freedom
    deviation = np.sqrt(covariance[0])
    covariance[0] += floor**2 + 1e-30
    coefficients = np.zeros((channels, ORDER))
    for c in range(channels):
        coefficients[c] = solve_toeplitz(covariance[:ORDER, c] * _taper(ORDER), covariance[1:, c] * _taper(ORDER + 1)[1:])
    innovations = []
    for d in deviations:
        e = d.copy()
        for k in range(ORDER):
            e[k + 1 :] -= coefficients[:, k] * d[: -k - 1]
        innovations.append(e[ORDER:])
    joined = np.concatenate(innovations)
    s = joined.T @ joined / len(joined) * scale
    s *= 1.0 - SHRINKAGE * (1.0 - np.eye(channels))
    s += np.diag(floor**2 * (1.0 + (coefficients**2).sum(axis=1)) + 1e-30)
    size = np.sqrt(np.diag(s))
    factor = np.linalg.cholesky(s / np.outer(size, size) + 1e-9 * np.eye(channels)) * size[:, None]
    return Whitening(coefficients, factor, deviation, guessed)


def _taper(n: int) -> FloatArray:
    """Keeps the autoregressive model off the edge of stability, where a drift would be differenced away."""
    return np.asarray(0.995 ** np.arange(n))
