"""Recursive least squares with exponential forgetting: linear models y = x^T theta that change with time."""

from __future__ import annotations

from robomill.models.model.declaration import FloatArray, kernel


@kernel
def innovation(theta: FloatArray, x: FloatArray, y: float) -> float:
    """Return y - x^T theta: what the model does not foresee of y."""
    left = y
    for i in range(theta.shape[0]):
        left -= x[i] * theta[i]
    return left


@kernel
def update(theta: FloatArray, P: FloatArray, Px: FloatArray, x: FloatArray, y: float, forgetting: float, bound: float) -> float:
    """One observation (x, y): set theta (n,) and its covariance P (n, n) over the variance of y; Px (n,) is scratch.

    L = P x / (lambda + x^T P x), theta += L (y - x^T theta), P = (P - L x^T P) / lambda (Ljung, System Identification, 11.2).
    Where x does not change, P grows by 1/lambda each time in the directions that x does not show; it is scaled down
    to the trace `bound`. Returns the trace of P before.
    """
    n = theta.shape[0]
    left = innovation(theta, x, y)
    scale = forgetting
    for i in range(n):
        Px[i] = 0.0
        for j in range(n):
            Px[i] += P[i, j] * x[j]
        scale += x[i] * Px[i]
    trace = 0.0
    for i in range(n):
        theta[i] += Px[i] / scale * left
        for j in range(n):
            P[i, j] = (P[i, j] - Px[i] * Px[j] / scale) / forgetting
        trace += P[i, i]
    if trace > bound:
        for i in range(n):
            for j in range(n):
                P[i, j] *= bound / trace
    return trace
