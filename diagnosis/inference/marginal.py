"""Marginal likelihood of linear models whose noise may be wider in some outputs than in others.

y = A x + noise with x ~ N(0, 1) and noise of variance v_k in output k; with M = I + sum_k A_k'A_k / v_k the log of the evidence is
-(sum_k chi2_k / v_k + x'x + log det M + sum_k n_k log v_k) / 2, chi2_k what the best x leaves of output k.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from robomill.orchestration.slaves.protocol import FloatArray

TEMPERATURE = 2.0
"""Variance of whitened noise: it is not exactly what it is taken for."""
VARIANCE_ROUNDS = 6
"""Rounds in which the variance of what no effect explains is found."""


class MarginalLikelihood:
    """Evidence of a whitened residual [samples], given which components have effects; noise has one variance per output.

    `row`: output of each sample, [samples]; `doubt`: sensitivities at the size of their priors that every model has, [samples, m];
    `effects`: component -> those that it adds, [samples, k].
    """

    def __init__(self, residual: FloatArray, row: npt.NDArray[np.intp], doubt: FloatArray, effects: Mapping[str, FloatArray]) -> None:
        everything = np.concatenate([doubt, *effects.values()], axis=1)
        rows = [row == k for k in range(int(row.max()) + 1)]
        self._grams = np.array([everything[r].T @ everything[r] for r in rows])
        self._on_residual = np.array([everything[r].T @ residual[r] for r in rows])
        self._chi2 = np.array([residual[r] @ residual[r] for r in rows])
        self._counts = np.array([r.sum() for r in rows])
        self._doubt = np.arange(doubt.shape[1])
        start, self._places = doubt.shape[1], dict[str, npt.NDArray[np.intp]]()
        for c, sensitivities in effects.items():
            self._places[c] = np.arange(start, start + sensitivities.shape[1])
            start += sensitivities.shape[1]

    def log(self, components: Sequence[str], free: Collection[int]) -> tuple[float, FloatArray]:
        """Log evidence [nats] with the effects of these components, and the variance of what is left in each output, [outputs].

        The variance of the outputs in `free` is what fits best, but at least `TEMPERATURE`; of the others it is that.
        """
        at = np.concatenate([self._doubt, *(self._places[c] for c in components)])
        grams, on_y = self._grams[:, at[:, None], at], self._on_residual[:, at]
        variance, best = np.full(len(grams), TEMPERATURE), -math.inf
        for _ in range(VARIANCE_ROUNDS):
            inner = np.eye(len(at)) + np.tensordot(1.0 / variance, grams, 1)
            x = np.linalg.solve(inner, (on_y / variance[:, None]).sum(axis=0))
            chi2 = self._chi2 - 2.0 * on_y @ x + np.einsum("i,kij,j->k", x, grams, x)
            size = (chi2 / variance).sum() + x @ x + np.linalg.slogdet(inner)[1] + (self._counts * np.log(variance)).sum()
            wider = sum(math.log(self._counts[k]) for k in free if variance[k] > TEMPERATURE)
            best = max(best, -0.5 * float(size + wider))
            for k in free:
                variance[k] = max(TEMPERATURE, chi2[k] / self._counts[k])
        return best, variance
